"""Make the objects that an EDS abbreviates: arrays in compact form, and the PDO parameters of a device that has many.

CompactSubObj=n in the section of an object stands for subindex 0, which holds n, and for subindices 1 to n, which are all like
the object's own section. [1234Name], [1234Value] and [1234Denotation] give single ones a name, a configured value (in a DCF) and
a denotation. A sub-object with a section of its own is read from that. An entry without a name has the object's name with its
number added.

CompactPDO in [DeviceInfo], if it is not 0, stands for the communication and mapping parameters of NrOfRXPDO and NrOfTXPDO PDOs
that have no sections: bit n - 1 for subindex n of the communication parameter record. Their values are those of the predefined
connection set for the first four PDOs; all others begin invalid. The mapping is empty, and has MAPPED entries.

A small file could stand for millions of variables in this way, so their total is bounded.

Source: CiA 306-1 v1.4.0, 4.4.2 and 4.6 (compact storage).
"""

from __future__ import annotations

from collections.abc import Iterator
from types import MappingProxyType
from typing import Any, Final

from canopen_data.description import DeviceInfo
from canopen_data.eds.ini import EdsDocument, Findings, Section, quoted
from canopen_data.eds.keys import NUMBERED
from canopen_data.eds.variables import FOREIGN, Variables
from canopen_data.findings import LOST_SETTING, Severity
from canopen_proto import indices
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary.objects import Access, Object, ObjectType, Variable

MAX_MADE: Final = 100_000
"""Variables without a section of their own. A device with all 512 PDOs both ways has 15 000 of them."""
MAX_SUBINDEX: Final = 254
"""Subindex 255 describes the structure of an object (CiA 301 v4.2.0, 7.4.1)."""
MAX_PDOS: Final = 512
"""In each direction (CiA 301 v4.2.0, table 41)."""
MAPPED: Final = 8
"""Objects that a PDO can carry at a granularity of 8 bits."""

_COUNT: Final = "NrOfObjects"
_INVALID: Final = 0x8000_0000
_COMMUNICATION: Final = (
    (2, "Transmission type", DataType.UNSIGNED8, 254),
    (3, "Inhibit time", DataType.UNSIGNED16, 0),
    (5, "Event timer", DataType.UNSIGNED16, 0),
    (6, "SYNC start value", DataType.UNSIGNED8, 0),
)
"""CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38; subindex 4 is reserved."""


class Compact:
    """Makes the variables that a file abbreviates, MAX_MADE at most."""

    def __init__(self, document: EdsDocument, variables: Variables, findings: Findings) -> None:
        self._document = document
        self._variables = variables
        self._findings = findings
        self._made = 0
        self._refused = False

    def array(self, section: Section, index: int, own: dict[int, Variable]) -> dict[int, Variable]:
        """Return all variables of an object with CompactSubObj. own: those that have sections."""
        count = self._variables.number(section, "CompactSubObj", 0xFFFF_FFFF)
        if count > MAX_SUBINDEX:
            message = f"CompactSubObj is {count}; there are {MAX_SUBINDEX} subindices"
            self._variables.warn(section, "CompactSubObj", "count", message)
            count = MAX_SUBINDEX
        if not self.may_make(count + 1, section.line):
            return own
        like = self._variables.read(section, index, 1)
        first = Variable(index, 0, _COUNT, DataType.UNSIGNED8, Access.RO, default=count)
        lists = [self._document.lists.get((index, kind)) for kind in ("name", "value", "denotation")]
        for entries, code in zip(lists, ("unused-entry", LOST_SETTING, "unused-entry"), strict=True):
            self._report_unused(entries, code, count, own)
        names, values, denotations = lists
        called = {} if names is None else names.values
        denoted = {} if denotations is None else denotations.values
        before = (
            like.data_type,
            like.access,
            like.default,
            like.low_limit,
            like.high_limit,
            like.pdo_mappable,
            (),
            like.adds_node_id,
        )
        behind = like.object_flags, like.unit, like.factor, like.description
        variables = {0: own.get(0, first)}
        for subindex in range(1, count + 1):
            if subindex in own:
                variables[subindex] = own[subindex]
                continue
            key = str(subindex)
            configured = like.configured, like.configured_adds_node_id
            if values is not None and (text := values.get(key)):
                configured = self._variables.value(values, key, text, like.data_type)
                self._variables.has_configured |= configured[0] is not None
            name = called.get(key) or f"{like.name}{key}"
            said: tuple[Any, ...] = (*before, *configured, *behind, denoted.get(key, ""))
            variables[subindex] = Variable(index, subindex, name, *said)
        return variables | own

    def _report_unused(self, entries: Section | None, code: str, count: int, own: dict[int, Variable]) -> None:
        """Report the entries of a list that no variable takes. code: of one that names no subindex of the compact form."""
        for key, text in () if entries is None else entries.values.items():
            if key == "nrofentries" or key.startswith(FOREIGN) or not text:
                continue
            subindex = int(key) if NUMBERED.fullmatch(key) else 0
            what = f"{quoted(key)}={quoted(text)}"
            if subindex in own and subindex:
                message = f"{what} is not used: sub-object {key} has a section of its own"
                self._findings.in_section(entries, key, Severity.WARNING, "unused-entry", message)
            elif not 1 <= subindex <= count:
                message = f"{what} is for no subindex from 1 to {count}; left out"
                self._findings.in_section(entries, key, Severity.ERROR, code, message)

    def pdos(self, info: DeviceInfo, known: dict[int, Object]) -> Iterator[Object]:
        """Yield the PDO parameters that CompactPDO stands for, without those that the file has. known: the objects of the
        file."""
        if not info.compact_pdo:
            return
        bases = (
            (indices.RPDO1_COMMUNICATION_PARAMETER, 0x200, info.rpdo_count, "RPDO"),
            (indices.TPDO1_COMMUNICATION_PARAMETER, 0x180, info.tpdo_count, "TPDO"),
        )
        for index, cob_base, count, what in bases:
            for number in range(min(count or 0, MAX_PDOS)):
                if index + number not in known and self.may_make(2 + len(_COMMUNICATION), 0):
                    cob_id = cob_base + 0x100 * number if number < 4 else _INVALID
                    name = f"{what} {number + 1} communication parameter"
                    yield _communication(index + number, name, cob_id, number < 4, info.compact_pdo)
                if index + 0x200 + number not in known and self.may_make(1 + MAPPED, 0):
                    yield _mapping(index + 0x200 + number, f"{what} {number + 1} mapping parameter")

    def may_make(self, count: int, line: int) -> bool:
        """Return whether so many more variables may be made, and count them. The first time that they may not is an error. line:
        of the compact form, for the error."""
        self._made += count
        if self._made <= MAX_MADE:
            return True
        if not self._refused:
            self._refused = True
            message = f"compact forms stand for more than {MAX_MADE} variables; the rest was not made"
            self._findings.add(Severity.ERROR, "too-long", message, line, 1 if line else 0)
        return False


def _communication(index: int, name: str, cob_id: int, adds_node_id: bool, mask: int) -> Object:
    variables = [Variable(index, 1, "COB-ID", DataType.UNSIGNED32, default=cob_id, adds_node_id=adds_node_id)]
    variables += [
        Variable(index, subindex, field, data_type, default=default)
        for subindex, field, data_type, default in _COMMUNICATION
        if mask >> subindex - 1 & 1 and (subindex != 6 or index >= indices.TPDO1_COMMUNICATION_PARAMETER)
    ]
    return _record(index, name, variables, variables[-1].subindex, Access.RO)


def _mapping(index: int, name: str) -> Object:
    entries = [
        Variable(index, subindex, f"Mapped object {subindex}", DataType.UNSIGNED32, default=0)
        for subindex in range(1, MAPPED + 1)
    ]
    return _record(index, name, entries, 0, Access.RW)


def _record(index: int, name: str, entries: list[Variable], count: int, access: Access) -> Object:
    first = Variable(index, 0, "Highest sub-index supported", DataType.UNSIGNED8, access, default=count)
    variables = {each.subindex: each for each in (first, *entries)}
    return Object(index, name, ObjectType.RECORD, MappingProxyType(variables))
