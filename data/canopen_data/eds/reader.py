"""Read EDS and DCF: CANopen device descriptions as sections, keys and values (CiA 306-1).

An EDS describes a type of device, a DCF one device of it, with its node-ID and the values to set in its objects (ParameterValue).
Both are read into a `DeviceDescription`, from the sections that ini.py gives: the objects here, in variables.py and compact.py,
the rest in device.py.

Few files in the field are quite right. The reader loads what it can, and reports everything wrong in one pass:

- error: a section, a key or a value was left out;
- warning: something was read, but its form is not that of CiA 306, or something had to be guessed;
- notice: which of two possible readings was taken, if tools differ.

Each section of an object gives an object, whether a list names it or not; the order of sections does not matter. A sub-object
without its object gives an object without a name. A missing ObjectType is taken as VAR, the standard's default, or as RECORD if
there are sub-objects. Everything that a file can multiply is bounded (ini.py, compact.py), so that 5 MiB of anything take
seconds.

Left out: [Tools] and object links, which are for people.

**Sections that were not read** are reported, since an object may be lost in one. The name of a section tells its purpose. The
index of an object in another spelling (`[0x2002]`, `[2002h]`), and a name much like one of the standard (`[OptionalObject]`,
`[DeviceInfos]`), are errors: the section was meant, but is left out. Sections of CiA 306 that we do not read (tools, object
links) give no finding. All others are a maker's own: a notice.

Source: CiA 306-1 v1.4.0; the names of sections: 4.4 to 4.8 and 5.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection
from os import PathLike
from types import MappingProxyType
from typing import Final

from canopen_data.description import DeviceDescription, FileKind
from canopen_data.eds import device
from canopen_data.eds.compact import Compact
from canopen_data.eds.encodings import text_of
from canopen_data.eds.ini import MAX_FILE_SIZE, MAX_QUOTED, EdsDocument, Findings, Section, quoted
from canopen_data.eds.keys import Fields
from canopen_data.eds.modules import Modules
from canopen_data.eds.numbers import read_number
from canopen_data.eds.variables import OBJECT_FLAGS, TYPES, Variables
from canopen_data.findings import LOST_SETTING, DictionaryError, Severity
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary.model import WITH_FIELDS, ObjectDictionary
from canopen_proto.dictionary.objects import Object, ObjectType, Variable
from canopen_proto.machine import LocalProtocolError

_NAMES: Final = {
    each.lower(): each
    for each in (
        "FileInfo",
        "DeviceInfo",
        "DummyUsage",
        "Comments",
        "MandatoryObjects",
        "OptionalObjects",
        "ManufacturerObjects",
        "DeviceComissioning",
        "SupportedModules",
        "ConnectedModules",
        "DynamicChannels",
        "Tools",
    )
}
_OTHERS: Final = re.compile(
    r"m[0-9]{1,6}(?:moduleinfo|comments|fixedobjects|subextends|subext[0-9a-f]{1,4}|fixed(?:obj)?[0-9a-f]{1,4}(?:sub[0-9a-f]+)?)"
    r"|tool[0-9]{1,6}|[0-9a-f]{4}objectlinks",
    re.ASCII,
)
_SHORT: Final = re.compile(r"([0-9a-f]{1,3})(?:sub1)?", re.ASCII)
_LIKE_AN_OBJECT: Final = re.compile(
    r"(?:0?x)?0*[0-9a-f]{4}h?(?:(?:sub|var|name|value|index|obj)[0-9a-z]*)?|sub0*[0-9a-f]{4}.*", re.ASCII
)
_NO_LETTERS_OR_DIGITS: Final = re.compile(r"[\W_]+")
_ALIKE: Final = 0.8


def report_unused(document: EdsDocument, findings: Findings, types: Collection[int]) -> None:
    """Report each section that the reader does not use. types: the data types that were looked up; one tool names their sections
    without leading zeros."""
    for name, section in document.named.items():
        short = _SHORT.fullmatch(name)
        is_type = short is not None and int(short[1], 16) in types
        if name not in _NAMES and _OTHERS.fullmatch(name) is None and not is_type:
            _report(section, name, findings)
    for (index, kind), section in document.lists.items():
        whole = document.objects.get(index)
        if whole is None or whole.get("CompactSubObj") is None:
            said = f"[{quoted(section.name)}] was left out; a list of {kind}s is for a CompactSubObj, and [{index:04X}] has none"
            code = LOST_SETTING if kind == "value" else "unused-section"
            findings.add(Severity.ERROR, code, said, section.line, 1)


def _report(section: Section, name: str, findings: Findings) -> None:
    bare = _NO_LETTERS_OR_DIGITS.sub("", name)
    near = difflib.get_close_matches(bare[:100], _NAMES, n=1, cutoff=_ALIKE)
    if _LIKE_AN_OBJECT.fullmatch(bare) is not None and any(each.isdigit() for each in bare):
        what = "objects have the names 0001 to FFFF, sub-objects 1018sub1"
        _tell(section, Severity.ERROR, f"[{quoted(section.name)}] was left out; {what}", findings)
    elif near:
        _tell(section, Severity.ERROR, f"[{quoted(section.name)}] was left out; is [{_NAMES[near[0]]}] meant?", findings)
    else:
        _tell(section, Severity.NOTICE, f"[{quoted(section.name)}] is not a section of CiA 306, and was left out", findings)


def _tell(section: Section, severity: Severity, message: str, findings: Findings) -> None:
    findings.add(severity, "unused-section", message, section.line, 1)


_OBJECT_TYPES: Final[dict[str | None, ObjectType]] = {
    text: each for each in ObjectType for text in (str(int(each)), f"0x{int(each):X}", f"0x0{int(each):X}")
}
_CODES: Final = {int(each) for each in ObjectType}
_SUFFIXES: Final = (".eds", ".dcf", ".xdd", ".xdc")
_NO_SUBS: Final[dict[int, Section]] = {}


def read_eds(
    data: bytes | str, source: str = "", *, strict: bool = False, encoding: str = "", connected: tuple[int, ...] = ()
) -> DeviceDescription:
    """Read an EDS or a DCF. source: the file's name, for findings. encoding: of its bytes, "" = guess it. connected: the
    module in each slot of a modular device, instead of [ConnectedModules]; see modules.py. data: the file's bytes, or its text.

    Any bytes are accepted: the description's findings hold everything wrong with them. With strict, raises the first error as a
    DictionaryError. The kind is DCF if the file commissions a device or configures one of its objects. The default of an object
    that has none is None; for a default relative to the node-ID, the number added to the node-ID is kept.

    Raises LocalProtocolError for a path in place of a text: `load_description` reads a file. Source: CiA 306-1 v1.4.0.
    """
    if isinstance(data, PathLike) or (isinstance(data, str) and data[-4:].lower() in _SUFFIXES and "\n" not in data):
        told = f"{str(data)[:MAX_QUOTED]!r} is no text of an EDS"
        raise LocalProtocolError(f"{told}: give the text, or its bytes; if it is a path, `load_description` reads the file")
    findings = Findings(source)
    if len(data) > MAX_FILE_SIZE:
        message = f"the file has more than {MAX_FILE_SIZE >> 20} MiB; only its beginning was read"
        findings.add(Severity.ERROR, "too-long", message)
        data = data[:MAX_FILE_SIZE]
    if isinstance(data, str):
        text, encoding = data.removeprefix("\ufeff"), "utf-8"
    else:
        text, encoding, remark = text_of(data, encoding)
        if remark is not None:
            findings.add(Severity.NOTICE, "encoding", *remark)
    document = EdsDocument(text, encoding, findings)
    variables = Variables(document, findings)
    info = device.device_info(document, findings)
    objects = _Objects(document, variables, findings)
    objects.read()
    compact_pdos = objects.compact.pdos(info, objects.found)
    objects.found.update({each.index: each for each in list(compact_pdos)})
    modules = device.modules(document, findings)
    slots = device.connected_modules(document, findings)
    Modules(document, variables, objects.compact, findings, objects.found, objects.of_section).connect(
        modules, connected or slots, is_expanded=not connected
    )
    slots = connected or slots
    report_unused(document, findings, variables.types)
    if not objects.found:
        findings.add(Severity.ERROR, "no-objects", "there is no section of an object in this file")
    commissioning = device.commissioning(document, findings)
    description = DeviceDescription(
        ObjectDictionary(objects.found.values(), source=source),
        FileKind.DCF if commissioning is not None or variables.has_configured else FileKind.EDS,
        source,
        file_info=device.file_info(document, findings),
        device_info=info,
        commissioning=commissioning,
        dummies=device.dummies(document, findings),
        comments=Fields(document.named.get("comments"), findings).comments(),
        mandatory=_list(document, "mandatoryobjects", findings),
        optional=_list(document, "optionalobjects", findings),
        manufacturer=_list(document, "manufacturerobjects", findings),
        modules=modules,
        connected_modules=slots,
        dynamic_channels=device.dynamic_channels(document, findings),
        findings=findings.all(),
        encoding=encoding,
        document=document,
    )
    errors = [each for each in description.findings if each.severity is Severity.ERROR]
    if strict and errors:
        raise DictionaryError(errors[:1])
    return description


def _list(document: EdsDocument, name: str, findings: Findings) -> tuple[int, ...]:
    return Fields(document.named.get(name), findings).indices("SupportedObjects")


class _Objects:
    """The reader of objects. found: by index."""

    def __init__(self, document: EdsDocument, variables: Variables, findings: Findings) -> None:
        self.found: dict[int, Object] = {}
        self.compact = Compact(document, variables, findings)
        self._document = document
        self._variables = variables
        self._findings = findings

    def read(self) -> None:
        """Read all objects that have a section, then those with sections of sub-objects only."""
        subs_of = self._document.subs
        for index, section in self._document.objects.items():
            if not index:
                self._refuse(section)
            else:
                self._put(self.of_section(section, index, subs_of.get(index, _NO_SUBS)))
        for index, subs in subs_of.items():
            if index not in self._document.objects:
                self._orphans(index, subs)

    def of_section(self, section: Section, index: int, subs: dict[int, Section]) -> Object:
        """Return the object of a section and those of its sub-objects."""
        values = section.body.values
        object_type = _OBJECT_TYPES.get(values.get("objecttype"))
        if object_type is ObjectType.VAR and not subs and "compactsubobj" not in values:
            variable = self._variables.read(section, index, 0)
            return Object(index, variable.name, object_type, MappingProxyType({0: variable}), *_of_single(variable))
        return self._object(section, index, subs, object_type or self._object_type(section, bool(subs)))

    def _put(self, each: Object) -> None:
        self.found[each.index] = each

    def _object(self, section: Section, index: int, subs: dict[int, Section], object_type: ObjectType) -> Object:
        """Return an object that is not a plain VAR."""
        values = section.body.values
        is_compact = values.get("compactsubobj", "0") not in ("0", "", "0x0")
        name = section.title if section.title is not None else values.get("parametername", "")
        if subs and object_type not in WITH_FIELDS and (object_type is not ObjectType.VAR or set(subs) - {0, 0xFF}):
            message = f"a {object_type.name} has no sub-objects; taken as RECORD"
            self._variables.warn(section, "ObjectType", "object-type", message)
            object_type = ObjectType.RECORD
        if object_type not in WITH_FIELDS and not subs and not is_compact:
            if object_type is ObjectType.NULL or (object_type is ObjectType.DEFTYPE and "datatype" not in values):
                return self._whole(section, index, name, object_type, {}, None)
            variable = self._variables.read(section, index, 0)
            return Object(index, name, object_type, MappingProxyType({0: variable}), *_of_single(variable))
        code = self._variables.number(section, "DataType", 0xFFFF) or None
        likely = TYPES.get(code) if code is not None and object_type is ObjectType.ARRAY else None
        found = self._subs(index, subs, likely)
        if is_compact:
            found = self.compact.array(section, index, found)
        else:
            self._check_count(section, object_type, found)
        return self._whole(section, index, name, object_type, found, code)

    def _whole(
        self,
        section: Section,
        index: int,
        name: str,
        object_type: ObjectType,
        variables: dict[int, Variable],
        code: int | None,
    ) -> Object:
        self._variables.foreign(section)
        flags = self._variables.number(section, "ObjFlags", OBJECT_FLAGS) if "objflags" in section.body.values else 0
        denotation = section.body.values.get("denotation", "")
        return Object(index, name, object_type, MappingProxyType(variables), code, flags, denotation)

    def _subs(self, index: int, subs: dict[int, Section], likely: DataType | None) -> dict[int, Variable]:
        found: dict[int, Variable] = {}
        read = self._variables.read
        for subindex, section in subs.items():
            if subindex > 0xFF:
                self._refuse(section)
            else:
                found[subindex] = read(section, index, subindex, likely, in_array=True)
        return dict(sorted(found.items()))

    def _orphans(self, index: int, subs: dict[int, Section]) -> None:
        """Make an object of sub-objects whose object has no section."""
        first = next(iter(subs.values()))
        if not index:
            self._refuse(first)
            return
        message = f"[{quoted(first.name)}]: there is no [{index:04X}]; taken as a RECORD without a name"
        self._findings.add(Severity.WARNING, "no-parent", message, first.line, 1)
        self._put(Object(index, "", ObjectType.RECORD, MappingProxyType(self._subs(index, subs, None))))

    def _refuse(self, section: Section) -> None:
        if not self._findings.full(Severity.ERROR):
            message = f"[{quoted(section.name)}] is not an object: indices are 0001 to FFFF, subindices 0 to FF; left out"
            self._findings.add(Severity.ERROR, "no-object", message, section.line, 1)

    def _object_type(self, section: Section, has_subs: bool) -> ObjectType:
        """Return the object type for a text that the table lacks."""
        text = section.body.values.get("objecttype", "")
        is_compact = "compactsubobj" in section.body.values
        likely = ObjectType.ARRAY if is_compact else ObjectType.RECORD if has_subs else ObjectType.VAR
        if not text:
            if likely is not ObjectType.VAR:
                message = f"ObjectType is missing; taken as {likely.name}"
                self._variables.warn(section, "ObjectType", "object-type", message)
            return likely
        number, remark = read_number(text)
        if number is not None and number in _CODES:
            if remark:
                self._variables.warn(section, "ObjectType", "number", f"ObjectType {quoted(text)!r}: {remark}")
            return ObjectType(number)
        message = f"ObjectType {quoted(text)!r} does not exist; taken as {likely.name}"
        self._variables.warn(section, "ObjectType", "object-type", message)
        return likely

    def _check_count(self, section: Section, object_type: ObjectType, found: dict[int, Variable]) -> None:
        """Check SubNumber: the number of sub-objects, without 255, which describes the structure."""
        text = section.body.values.get("subnumber", "")
        if not text:
            if object_type in WITH_FIELDS:
                self._variables.warn(section, "SubNumber", "sub-number", "SubNumber is missing")
            return
        count = len(found)
        if text == str(count):
            return
        number, _ = read_number(text)
        if number is None:
            self._variables.warn(section, "SubNumber", "sub-number", f"SubNumber {quoted(text)!r} is not a number")
        elif number != count and number != count - (0xFF in found):
            self._variables.warn(section, "SubNumber", "sub-number", f"SubNumber is {number}, but there are {count} sub-objects")


def _of_single(variable: Variable) -> tuple[int, int, str]:
    """Return the facts that an object shares with its only variable."""
    return int(variable.data_type), variable.object_flags, variable.denotation
