"""Make a variable from the section that describes it: its type, access, values and limits.

The section of a VAR, of a sub-object, and of an array in compact form have the same keys (CiA 306-1 v1.4.0, 4.6). A key that is
missing or makes no sense is replaced, with a finding:

- DataType: UNSIGNED8 for subindex 0 of an array or record; the array's type for its entries; else the type that the standards
  give the object; else OCTET_STRING, which can hold anything that a device sends;
- AccessType: that of the standards; else `rw` (the device refuses an access that it does not allow);
- a value that cannot be read, or does not fit the type, is left out;
- PDOMapping is 0.

The first three are warnings; a lost value is an error. A missing name is left to the linter.

Speed: most sections repeat another one except for their name (ini.py). Their result is made once, unless there was a finding,
which has its own place each time. Texts repeat too: their meanings are kept in a table that fills as they occur.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Final

from canopen_data.eds.ini import EdsDocument, Findings, Section, quoted
from canopen_data.eds.numbers import Reading, read_number, read_value
from canopen_data.eds.writer_values import BYTES_KEY, NOT_READ_KEY, text_beside
from canopen_data.findings import LOST_SETTING, Severity
from canopen_proto.datatypes import DataType, Value, decode, is_number, range_of
from canopen_proto.dictionary.objects import Access, ObjectType, Variable
from canopen_proto.dictionary.standard import find_standard

PROFILES: Final = 0x2000
"""Below it an object means the same in all devices (CiA 301 v4.2.0, table 41)."""
OBJECT_FLAGS: Final = 0xFFFF_FFFF
"""The greatest ObjFlags: it is an UNSIGNED32."""

_COMMON: Final = frozenset(
    ("parametername", "objecttype", "datatype", "accesstype", "defaultvalue", "pdomapping", "lowlimit", "highlimit")
)
_RARE: Final = frozenset(
    (
        "compactsubobj",
        "denotation",
        "description",
        "downloadfile",
        "factor",
        "objflags",
        "parametervalue",
        "subnumber",
        "unit",
        "uploadfile",
    )
)
_KNOWN: Final = _COMMON | _RARE
_BYTES: Final = BYTES_KEY.lower()
_NOT_READ: Final = NOT_READ_KEY.lower()
FOREIGN: Final = "_"
"""By custom, a key that begins with this or a semicolon is a maker's own."""
_ACCESSES: Final = {spelling: each for each in Access for spelling in (each.value, each.value.upper(), each.value.title())}
_FLAGS: Final[dict[str | None, bool]] = {"0": False, "0x0": False, "": False, None: False, "1": True, "0x1": True}
_NUMBERS: Final = {
    each: (is_number(each), limits[1] if (limits := range_of(each)) is not None and each is not DataType.BOOLEAN else -1)
    for each in DataType
}
"""By type: whether it has limits, and its greatest whole number."""
_DECIMAL: Final = re.compile(r"[1-9][0-9]{0,18}", re.ASCII)
TYPES: Final = {int(each): each for each in DataType}
_TEXTS_OF_TYPES: Final[Mapping[str, DataType]] = {
    text: each for each in DataType for text in (f"0x{each:04X}", f"0x{each:X}", f"0x{each:04x}", str(int(each)))
}


class _Readings(dict[str, Reading]):
    """The meaning of each text for one data type. has_limits: the type is a number."""

    def __init__(self, data_type: DataType) -> None:
        super().__init__()
        self.data_type = data_type
        self.has_limits, self._highest = _NUMBERS[data_type]

    def __missing__(self, text: str) -> Reading:
        if _DECIMAL.fullmatch(text) and (number := int(text)) <= self._highest:  # a short cut for the usual case
            reading: Reading = number, False, "", False
        else:
            reading = read_value(text, self.data_type)
        self[text] = reading
        return reading


class Variables:
    """The maker of variables from sections. has_configured: whether one of them had a ParameterValue. types: the codes of data
    types that were looked up in the file itself."""

    def __init__(self, document: EdsDocument, findings: Findings) -> None:
        self.has_configured = False
        self.types: set[int] = set()
        self._document = document
        self._told = 0  # findings; a variable made without one can be reused
        self._findings = findings
        self._readings: dict[DataType, _Readings] = {}
        self._by_text: dict[str, _Readings] = {}

    def read(
        self, section: Section, index: int, subindex: int, likely: DataType | None = None, *, in_array: bool = False
    ) -> Variable:
        """Return the variable of a section. likely: its type if the section has none. in_array: subindex 0 counts the others."""
        body = section.body
        name = section.title
        told = self._told
        if body.made is not None:
            return Variable(index, subindex, name or "", *body.made)
        values = body.values
        get = values.get
        if name is None:
            name = get("parametername", "")
        type_text = get("datatype", "")
        readings = self._by_text.get(type_text)
        if readings is None and (data_type := _TEXTS_OF_TYPES.get(type_text)) is not None:
            readings = self._by_text[type_text] = self._readings_of(data_type)
        access = _ACCESSES.get(get("accesstype", ""))
        is_plain = readings is not None and access is not None
        if readings is None:
            readings = self._readings_of(self._odd_type(section, index, subindex, likely, in_array))
        if access is None:
            access = self._odd_access(section, index, subindex)
        mappable = _FLAGS.get(get("pdomapping"))
        if mappable is None:
            mappable = bool(self.number(section, "PDOMapping", 1))
        default: Value | None = None
        adds_node_id = False
        if text := get("defaultvalue"):
            default, adds_node_id, remark, lost = readings[text]
            if remark:
                self._remark(section, "DefaultValue", remark, lost)
        low = self._limit(section, "LowLimit", text, readings) if (text := get("lowlimit")) else None
        high = self._limit(section, "HighLimit", text, readings) if (text := get("highlimit")) else None
        made: tuple[Any, ...] = (readings.data_type, access, default, low, high, mappable, (), adds_node_id)
        if not values.keys() <= _COMMON:
            made += self._rest(section, readings.data_type)
        if is_plain and self._told == told:
            body.made = made
        return Variable(index, subindex, name, *made)

    def _readings_of(self, data_type: DataType) -> _Readings:
        readings = self._readings.get(data_type)
        if readings is None:
            readings = self._readings[data_type] = _Readings(data_type)
        return readings

    def _rest(self, section: Section, data_type: DataType) -> tuple[Any, ...]:
        """Return the fields of a variable that few sections have."""
        get = section.body.values.get
        self.foreign(section)
        configured: Value | None = None
        configured_adds = False
        text = get("parametervalue", "")
        if (octets := get(_BYTES)) is not None and (configured := self._exact(section, octets, text, data_type)) is not None:
            self.has_configured = True
        elif text:
            configured, configured_adds = self.value(section, "ParameterValue", text, data_type)
            self.has_configured = True
        flags = _FLAGS.get(get("objflags"))
        return (
            configured,
            configured_adds,
            self.number(section, "ObjFlags", OBJECT_FLAGS) if flags is None else int(flags),
            get("unit", ""),
            self._factor(section) if get("factor") else 1.0,
            get("description", ""),
            get("denotation", ""),
            get("uploadfile", ""),
            get("downloadfile", ""),
            get(_NOT_READ, ""),
        )

    def _exact(self, section: Section, octets: str, text: str, data_type: DataType) -> Value | None:
        """Return the value whose bytes the file holds; None, with a finding, if they make no value or disagree with
        ParameterValue. It is an error if there is no ParameterValue, which would count."""
        try:
            value = decode(bytes.fromhex(octets), data_type)
        except ValueError:
            reason = f"is no {data_type.name} in pairs of hexadecimal digits"
        else:
            if not text or text == text_beside(value, data_type):
                return value
            reason = f"does not agree with ParameterValue {quoted(text)!r}, which counts"
        lost = (LOST_SETTING, Severity.ERROR) if not text else ("value", Severity.WARNING)
        self.warn(section, BYTES_KEY, lost[0], f"{BYTES_KEY} {quoted(octets)!r} {reason}; left out", lost[1])
        return None

    def value(self, section: Section, key: str, text: str, data_type: DataType) -> tuple[Value | None, bool]:
        """Return the configured value of a text in a section, and whether the node-ID is added to it. key: that has the text."""
        value, adds_node_id, remark, lost = self._readings_of(data_type)[text]
        if remark:
            self._remark(section, key, remark, lost, LOST_SETTING if lost else "value")
        return value, adds_node_id

    def number(self, section: Section, key: str, most: int) -> int:
        """Return a whole number 0..most; 0, with a warning, if it cannot be read."""
        text = section.body.values.get(key.lower(), "")
        if not text:
            return 0
        number, remark = read_number(text)
        if number is None or not 0 <= number <= most:
            remark, number = remark or f"is outside 0..{most}", 0
        if remark:
            self.warn(section, key, "number", f"{key} {quoted(text)!r} {remark}; taken as {number}")
        return number

    def foreign(self, section: Section) -> None:
        """Add a notice of keys that CiA 306 does not have: one may be misspelt."""
        values = section.body.values
        if values.keys() <= _KNOWN:
            return
        self._told += 1
        keys = [key for key in reversed(values) if key not in _KNOWN and not key.startswith(FOREIGN)]
        if keys:
            message = f"CiA 306 has no {', '.join(map(quoted, keys[:5]))}{' ...' if len(keys) > 5 else ''}"
            self._findings.in_section(section, keys[0], Severity.NOTICE, "unknown-key", message)

    def warn(self, section: Section, key: str, code: str, message: str, severity: Severity = Severity.WARNING) -> None:
        """Add a finding about a key of a section. code: of the finding. message: for people."""
        self._told += 1
        self._findings.in_section(section, key, severity, code, message)

    def _remark(self, section: Section, key: str, remark: str, lost: bool, code: str = "value") -> None:
        self.warn(section, key, code, f"{key} {remark}", Severity.ERROR if lost else Severity.WARNING)

    def _limit(self, section: Section, key: str, text: str, readings: _Readings) -> int | float | None:
        if not readings.has_limits:
            return self._idle_limit(section, key, text)
        value, adds_node_id, remark, lost = readings[text]
        if adds_node_id:
            self._remark(section, key, f"{quoted(text)!r} depends on the node-ID, which a limit cannot; left out", True)
            return None
        if remark:
            self._remark(section, key, remark, lost)
        return value  # type: ignore[return-value]  # a type with limits is a number

    def _idle_limit(self, section: Section, key: str, text: str) -> int | None:
        """Return a limit of a type that is not a number: it has no effect, but the linter is to see it."""
        number, _ = read_number(text)
        if number is None:
            self._remark(section, key, f"{quoted(text)!r} is not a number; left out", True)
        return number

    def _factor(self, section: Section) -> float:
        text = section.body.values["factor"]
        factor, _, remark, _ = self._readings_of(DataType.REAL64)[text]
        if isinstance(factor, float) and factor and math.isfinite(factor):
            if remark:
                self._remark(section, "Factor", remark, False)
            return factor
        self.warn(section, "Factor", "number", f"Factor {quoted(text)!r} is not a number other than 0; taken as 1")
        return 1.0

    def _odd_type(self, section: Section, index: int, subindex: int, likely: DataType | None, in_array: bool) -> DataType:
        """Return the type for a text that the table lacks."""
        text = section.body.values.get("datatype", "")
        number, remark = read_number(text) if text else (None, "")
        if number in TYPES:
            if remark:
                self.warn(section, "DataType", "number", f"DataType {quoted(text)!r}: {remark}")
            return TYPES[number]
        described = None if number is None or number < 0x20 else self._described_type(number)
        if described is not None:
            return described
        if in_array and subindex == 0:
            guess: DataType = DataType.UNSIGNED8
        elif likely is not None:
            guess = likely
        elif not text and read_number(section.body.values.get("objecttype", ""))[0] == ObjectType.DOMAIN:
            return DataType.DOMAIN
        else:
            guess = likely_type(index, subindex)
        reason = f"DataType {quoted(text)!r} is not a type for values" if text else "DataType is missing"
        self.warn(section, "DataType", "data-type", f"{reason}; taken as {guess.name}")
        return guess

    def _described_type(self, code: int) -> DataType | None:
        """Return the type that a DEFTYPE of this file stands for. One of the tools gives it in the default of subindex 1."""
        text = None
        self.types.add(code)
        if (sub := self._document.subs.get(code, {}).get(1) or self._document.section(f"{code:X}sub1")) is not None:
            text = sub.get("DefaultValue")
        elif (whole := self._document.objects.get(code)) is not None:
            text = whole.get("DataType")
        number = read_number(text)[0] if text else None
        return None if number is None else TYPES.get(number)

    def _odd_access(self, section: Section, index: int, subindex: int) -> Access:
        text = section.body.values.get("accesstype", "")
        bare = text.partition("#")[0].partition(";")[0].strip().lower()
        access = _ACCESSES.get(bare)
        if access is not None:
            if len(bare) != len(text):
                self.warn(section, "AccessType", "access", "the comment after AccessType was left out")
            return access
        access = likely_access(index, subindex)
        reason = f"AccessType {quoted(text)!r} is none of {', '.join(Access)}" if text else "AccessType is missing"
        self.warn(section, "AccessType", "access", f"{reason}; taken as {access}")
        return access


def likely_type(index: int, subindex: int) -> DataType:
    """Return the type for an object without one in its file: the standard's, else OCTET_STRING."""
    standard = find_standard(index, subindex) if index < PROFILES else None
    return DataType.OCTET_STRING if standard is None else standard.data_type


def likely_access(index: int, subindex: int) -> Access:
    """Return the access for an object without one in its file: the standard's, else rw; the device refuses what it does not
    allow."""
    standard = find_standard(index, subindex) if index < PROFILES else None
    return Access.RW if standard is None else standard.access
