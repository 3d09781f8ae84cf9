"""Read XDD and XDC: CANopen device descriptions in XML (CiA 311, after ISO 15745-1 and -4).

An XDD describes a type of device, as an EDS does; an XDC, as a DCF, describes one device of it, with actual values and
commissioning. Both are read into the same `DeviceDescription`.

The file is a container of profiles. The device profile has the identity and, in newer files, the parameters (parameters.py); the
communication network profile has the objects, bit rates and features (device.py). The objects are read here. An object's own
attributes take precedence over its parameter (`uniqueIDRef`).

The reader loads what it can and reports everything wrong, with its place:

- error: an object or a value was left out;
- warning: something was read, but its form is not that of CiA 311, or something had to be guessed.

Values are written as in CiA 306. Index, subindex, type and flags are hexadecimal without 0x in CiA 311; a 0x is accepted.
PDOmapping names a direction: with access rw, TPDO makes it rwr and RPDO rww.

Left out, with a warning: modules. Left out: profiles of networks (nodelists), and the parts of the device profile for people or
for a programmable device (functions, characteristics, graphical elements).

`XddDocument` finds the place of each object in the file, to which a finding about it points.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, TypeAlias

from canopen_data.describing import lists_of
from canopen_data.description import DeviceDescription, FileKind
from canopen_data.eds.ini import quoted
from canopen_data.eds.variables import TYPES, likely_access, likely_type
from canopen_data.findings import DictionaryError, Severity
from canopen_data.xdd import device
from canopen_data.xdd.elements import Element, XddFindings, parse, place_in
from canopen_data.xdd.parameters import ACCESS, ApplicationProcess, XddParameter
from canopen_data.xdd.texts import HEXADECIMAL, hexadecimal_of, limit_of, number_of, value_of
from canopen_proto.datatypes import DataType, Value, bit_length_of, is_integer
from canopen_proto.dictionary.model import Constant, ObjectDictionary
from canopen_proto.dictionary.objects import Access, Object, ObjectType, Variable
from canopen_proto.multiplexer import Mux, mux

_OF_EDS: Final = {"parametername": "name", "parametervalue": "actualvalue"}
"""Names of CiA 306 that differ from those of CiA 311, apart from upper and lower case."""
_OF_PARAMETER: Final = {
    "defaultvalue": ("defaultValue",),
    "actualvalue": ("actualValue",),
    "lowlimit": ("allowedValues", "range", "minValue"),
    "highlimit": ("allowedValues", "range", "maxValue"),
    "unit": ("unit",),
    "description": ("description",),
    "denotation": ("denotation",),
    "name": ("label",),
}
"""Where a parameter holds the fields that a CANopenObject may leave to it."""


class XddDocument:
    """The places of a file's objects. text: the file as UTF-8. objects, parameters: by index and subindex; subindex None is the
    object itself."""

    def __init__(
        self,
        text: bytes,
        objects: Mapping[tuple[int, int | None], Element],
        parameters: Mapping[tuple[int, int | None], Element],
    ) -> None:
        self._text = text
        self._objects = objects
        self._parameters = parameters

    def place_of(self, index: int, subindex: int | None = None, field: str = "") -> tuple[int, int]:
        """Return the place; see `description.Document`. field: its name in CiA 311 or CiA 306 ("DefaultValue"), in upper or lower
        case.

        The place of a field that a parameter of the device profile holds is in that parameter.
        """
        for place in ((index, subindex), (index, None)):
            element = self._objects.get(place)
            if element is None:
                continue
            folded = _OF_EDS.get(field.lower(), field.lower())
            name = next((each for each in element.attributes if each.lower() == folded), "")
            if folded and not name:
                found = self._in_parameter(self._parameters.get(place), folded)
                if found is not None:
                    return found
            return place_in(self._text, element, name)
        return 0, 0

    def _in_parameter(self, parameter: Element | None, field: str) -> tuple[int, int] | None:
        if parameter is None:
            return None
        if field == "accesstype":
            return place_in(self._text, parameter, "access")
        element = parameter.first(*_OF_PARAMETER[field]) if field in _OF_PARAMETER else None
        return None if element is None else place_in(self._text, element, "value")


"""Below it, an object means the same in all devices (CiA 301 v4.2.0, table 41); above, the meaning depends on the profile."""
SUB_OBJECT: Final = "CANopenSubObject"
ROOT: Final = "ISO15745ProfileContainer"
MAX_OBJECTS: Final = 20_000
"""Of one file, with MAX_VARIABLES in all. The largest devices have 3000 objects."""
MAX_VARIABLES: Final = 100_000

_MODULES: Final = (("ApplicationLayers", "moduleManagement"), ("DeviceManager", "moduleManagement"))
"""Where an XDD of version 1.1 says that a device has modules, or is one."""
_MODULE_INTERFACE: Final = "moduleInterface"
"""In such an element: the file describes a module, which is a part of another device."""
_HAS_MODULES: Final = "this device has modules; their objects are not read from an XDD, and are missing here"
_IS_MODULE: Final = "this file describes a module, a part of a device; the objects may have other indices there"
_ACCESS: Final = {each.value: each for each in Access} | ACCESS
_IN_PARAMETER: Final = {
    "defaultValue": "default",
    "actualValue": "actual",
    "lowLimit": "low_limit",
    "highLimit": "high_limit",
}
_MAPPINGS: Final = {"no": False, "default": True, "optional": True, "tpdo": True, "rpdo": True}


def read_xdd(data: bytes, source: str = "", *, strict: bool = False) -> DeviceDescription:
    """Read an XDD or an XDC. source: the file's name, for findings. data: the file's bytes.

    Any bytes are accepted: the description's findings hold everything wrong with them. With strict, raises the first error as a
    DictionaryError. A broken file gives the content before the break. Source: CiA 311 v1.1.
    """
    findings = XddFindings(source)
    root, encoding = parse(data, findings)
    bodies: list[Element] = []
    if root is not None:
        if root.name != ROOT:
            findings.error("not-xdd", f"the file's root is <{quoted(root.name)}>, not <{ROOT}>: this is not an XDD", root)
        bodies = list(device.find_all([root], "ISO15745Profile", "ProfileBody"))
    reader = _Reader(bodies, findings)
    lists = list(device.find_all(bodies, "ApplicationLayers", "CANopenObjectList"))
    for each in lists:
        reader.read(each)
    if root is not None and root.name == ROOT and not lists:
        findings.error("no-objects", "there is no CANopenObjectList, and so no object", root)
    for path in _MODULES:
        for each in device.find_all(bodies, *path):
            message = _IS_MODULE if list(each.all(_MODULE_INTERFACE)) else _HAS_MODULES
            findings.warning("modules", f"{message}: an EDS or DCF of the device has them", each)
    commissioning = device.commissioning(bodies, findings)
    mandatory, optional, manufacturer = lists_of(reader.objects)  # an XDD has no lists
    description = DeviceDescription(
        reader.dictionary(source),
        FileKind.XDC if commissioning is not None or reader.has_actual else FileKind.XDD,
        source,
        file_info=device.file_info(bodies, findings),
        device_info=device.device_info(bodies, findings),
        commissioning=commissioning,
        dummies=device.dummies(bodies, findings),
        mandatory=mandatory,
        optional=optional,
        manufacturer=manufacturer,
        dynamic_channels=device.dynamic_channels(bodies, findings),
        findings=findings.all(),
        encoding=encoding,
        document=XddDocument(findings.text, reader.elements, reader.parameters),
    )
    errors = [each for each in description.findings if each.severity is Severity.ERROR]
    if strict and errors:
        raise DictionaryError(errors[:1])
    return description


@dataclass(frozen=True, slots=True)
class _Part:
    """The description of one object or sub-object: its element and its parameter, if any."""

    element: Element
    parameter: XddParameter | None

    def text(self, attribute: str) -> tuple[str, Element, str]:
        """Return the text of an attribute, else of its parameter, and the element and attribute that hold it."""
        own = self.element.attributes.get(attribute, "")
        other: Element | None = None if self.parameter is None else getattr(self.parameter, _IN_PARAMETER[attribute])
        if own.strip() or other is None:
            return own, self.element, attribute
        return other.attributes.get("value", ""), other, "value"


_ValueKey: TypeAlias = tuple[int, str, str, DataType]
"""An element, its attribute, the field that it gives, and the data type."""


class _Reader:
    """The reader of lists of objects. objects: by index; elements, parameters: their places (see XddDocument)."""

    def __init__(self, bodies: Iterable[Element], findings: XddFindings) -> None:
        self.objects: dict[int, Object] = {}
        self.elements: dict[tuple[int, int | None], Element] = {}
        self.parameters: dict[tuple[int, int | None], Element] = {}
        self.has_actual = False
        self._constants: dict[Mux, list[Constant]] = {}
        self._findings = findings
        self._process = ApplicationProcess(device.find_all(bodies, "ApplicationProcess"), findings)
        self._variables = 0
        self._values: dict[_ValueKey, tuple[Value | None, bool]] = {}
        self._limits: dict[_ValueKey, int | float | None] = {}
        self._named: dict[tuple[int, DataType], list[Constant]] = {}

    def dictionary(self, source: str) -> ObjectDictionary:
        """Return all objects read."""
        return ObjectDictionary(self.objects.values(), constants=self._constants, source=source)

    def read(self, object_list: Element) -> None:
        """Read the objects of one CANopenObjectList."""
        for element in object_list.all("CANopenObject"):
            if len(self.objects) >= MAX_OBJECTS or self._variables >= MAX_VARIABLES:
                limits = f"{MAX_OBJECTS} objects, or {MAX_VARIABLES} with their subindices"
                self._findings.error("too-many", f"there are more than {limits}; the rest was not read", element)
                return
            index = hexadecimal_of(element, "index", self._findings, most=0xFFFF, least=1, severity=Severity.ERROR)
            if index is None:
                continue
            if index in self.objects:
                message = f"0x{index:04X} is in line {self.elements[index, None].line} already; this one was left out"
                self._findings.error("duplicate", message, element, "index")
                continue
            self.objects[index] = self._object(element, index)

    def _part(self, element: Element, index: int, subindex: int | None) -> _Part:
        """Record the place of an element, and find its parameter."""
        self.elements[index, subindex] = element
        unique_id = element.get("uniqueIDRef")
        parameter = self._process.parameter(unique_id) if unique_id else None
        if parameter is not None:
            self.parameters[index, subindex] = parameter.element
        elif unique_id:
            self._findings.warning("reference", f"there is no parameter {quoted(unique_id)!r}", element, "uniqueIDRef")
        return _Part(element, parameter)

    def _object(self, element: Element, index: int) -> Object:
        part = self._part(element, index, None)
        subs = list(element.all(SUB_OBJECT))
        object_type = self._object_type(element, bool(subs))
        name, flags = self._name(part), self._flags(element)
        own_type = _code_of(element.get("dataType"))
        if subs or object_type in (ObjectType.ARRAY, ObjectType.RECORD):
            variables = self._sub_objects(part, index, subs)
            if own_type is None and part.parameter is not None and part.parameter.entry is not None:
                own_type = int(part.parameter.entry)
        elif object_type is ObjectType.NULL or (own_type is None and object_type in (ObjectType.DEFTYPE, ObjectType.DEFSTRUCT)):
            variables = {}
        else:
            only = DataType.DOMAIN if object_type is ObjectType.DOMAIN else None
            variables = {0: self._variable(part, index, 0, name, flags, only)}
            own_type = int(variables[0].data_type) if own_type is None else own_type
        return Object(index, name, object_type, MappingProxyType(variables), own_type, flags, self._denotation(part))

    def _object_type(self, element: Element, has_subs: bool) -> ObjectType:
        likely = ObjectType.RECORD if has_subs else ObjectType.VAR
        text = element.get("objectType")
        if not text:
            self._findings.warning("object-type", f"objectType is missing; taken as {likely.name}", element)
            return likely
        number = number_of(text, self._findings, element, "objectType", most=0xFF)
        try:
            object_type = likely if number is None else ObjectType(number)
        except ValueError:
            self._findings.warning(
                "object-type", f"there is no object type {number}; taken as {likely.name}", element, "objectType"
            )
            return likely
        if has_subs and object_type in (ObjectType.VAR, ObjectType.DOMAIN, ObjectType.NULL):
            message = f"a {object_type.name} has no sub-objects; taken as {likely.name}"
            self._findings.warning("object-type", message, element, "objectType")
            return likely
        return object_type

    def _sub_objects(self, whole: _Part, index: int, subs: list[Element]) -> dict[int, Variable]:
        declared = (
            number_of(text, self._findings, whole.element, "subNumber", most=0xFFFFFFFF)
            if (text := whole.element.get("subNumber"))
            else None
        )
        if declared is not None and declared != len(subs):
            message = f"subNumber is {declared}, but there are {len(subs)} sub-objects"
            self._findings.warning("sub-number", message, whole.element, "subNumber")
        variables: dict[int, Variable] = {}
        for position, element in enumerate(subs):
            subindex = hexadecimal_of(element, "subIndex", self._findings, most=0xFF, severity=Severity.ERROR)
            if subindex is None:
                continue
            if subindex in variables:
                message = f"0x{index:04X}:{subindex:02X} is in line {self.elements[index, subindex].line} already; left out"
                self._findings.error("duplicate", message, element, "subIndex")
                continue
            part = self._part(element, index, subindex)
            likely = _member_type(whole.parameter, subindex, position, len(subs))
            variables[subindex] = self._variable(part, index, subindex, self._name(part), self._flags(element), likely)
        return variables

    def _variable(self, part: _Part, index: int, subindex: int, name: str, flags: int, likely: DataType | None) -> Variable:
        self._variables += 1
        element, parameter = part.element, part.parameter
        data_type = self._data_type(part, index, subindex, likely)
        default, adds_node_id = self._value(part, "defaultValue", data_type)
        configured, configured_adds = self._value(part, "actualValue", data_type)
        self.has_actual = self.has_actual or configured is not None
        low = self._limit(part, "lowLimit", data_type)
        high = self._limit(part, "highLimit", data_type)
        if parameter is not None and (constants := self._constants_of(parameter, data_type)):
            self._constants[mux(index, subindex)] = constants
        mapping = element.get("PDOmapping").lower()
        if mapping and mapping not in _MAPPINGS:
            known = "no, default, optional, TPDO, RPDO"
            message = f"PDOmapping {quoted(mapping)!r} is none of {known}; taken as no"
            self._findings.warning("pdo-mapping", message, element, "PDOmapping")
        return Variable(
            index,
            subindex,
            name,
            data_type,
            self._access(part, index, subindex, mapping),
            default,
            low,
            high,
            _MAPPINGS.get(mapping, False),
            adds_node_id=adds_node_id,
            configured=configured,
            configured_adds_node_id=configured_adds,
            object_flags=flags,
            unit=parameter.unit if parameter is not None else "",
            factor=parameter.factor if parameter is not None else 1.0,
            description=parameter.description if parameter is not None else "",
            denotation=self._denotation(part),
        )

    # ---- fields ----

    def _name(self, part: _Part) -> str:
        name = part.element.get("name")
        return name if name or part.parameter is None else part.parameter.label

    def _denotation(self, part: _Part) -> str:
        denotation = part.element.get("denotation")
        return denotation if denotation or part.parameter is None else part.parameter.denotation

    def _flags(self, element: Element) -> int:
        if not element.get("objFlags"):
            return 0
        return hexadecimal_of(element, "objFlags", self._findings, most=0xFFFFFFFF) or 0

    def _data_type(self, part: _Part, index: int, subindex: int, likely: DataType | None) -> DataType:
        text = part.element.get("dataType")
        if text:
            code = _code_of(text)
            if code in TYPES:
                return TYPES[code]
        elif part.parameter is not None and part.parameter.data_type is not None:
            return part.parameter.data_type
        elif likely is not None:
            return likely
        counts_others = subindex == 0 and part.element.name == SUB_OBJECT
        guess = DataType.UNSIGNED8 if counts_others else likely_type(index, subindex)
        reason = f"{quoted(text)!r} is no data type that a value can have" if text else "the data type is missing"
        self._findings.warning("data-type", f"{reason}; taken as {guess.name}", part.element, "dataType")
        return guess

    def _value(self, part: _Part, attribute: str, data_type: DataType) -> tuple[Value | None, bool]:
        text, element, at = part.text(attribute)
        if not text:
            return None, False
        key = (id(element), at, attribute, data_type)
        if key not in self._values:  # thousands of objects may share one parameter: read it once
            self._values[key] = value_of(text, data_type, attribute, self._findings, element, at)
        return self._values[key]

    def _limit(self, part: _Part, attribute: str, data_type: DataType) -> int | float | None:
        text, element, at = part.text(attribute)
        key = (id(element), at, attribute, data_type)
        if key not in self._limits:
            self._limits[key] = limit_of(text, data_type, attribute, self._findings, element, at)
        return self._limits[key]

    def _access(self, part: _Part, index: int, subindex: int, mapping: str) -> Access:
        """Return the access; rw with a mapping in one direction becomes rwr or rww."""
        own = part.element.get("accessType").lower()
        text = own or (part.parameter.access.lower() or "read" if part.parameter is not None else "")
        access = _ACCESS.get(text)
        if access is None:
            access = likely_access(index, subindex)
            reason = f"the access {quoted(text)!r} is none of SDO" if text else "the access is missing"
            at, name = (part.element, "accessType") if own or part.parameter is None else (part.parameter.element, "access")
            self._findings.warning("access", f"{reason}; taken as {access}", at, name)
        if access is Access.RW:
            return {"tpdo": Access.RWR, "rpdo": Access.RWW}.get(mapping, access)
        return access

    def _constants_of(self, parameter: XddParameter, data_type: DataType) -> list[Constant]:
        """Return the named values of a whole number; other types have no constants."""
        bits = bit_length_of(data_type)
        if not parameter.named_values or not is_integer(data_type) or bits is None:
            return []
        key = id(parameter.element), data_type
        if key not in self._named:
            mask = (1 << bits) - 1
            constants: dict[str, Constant] = {}
            for name, text in parameter.named_values:
                value, _ = value_of(text, data_type, f"the value of {quoted(name)!r}", self._findings, parameter.element)
                if isinstance(value, int):
                    constants.setdefault(name, Constant(name, mask, value & mask))
            self._named[key] = list(constants.values())
        return self._named[key]


def _code_of(text: str) -> int | None:
    """Return the index of a data type."""
    match = HEXADECIMAL.fullmatch(text)
    return int(match[1], 16) if match is not None else None


def _member_type(whole: XddParameter | None, subindex: int, position: int, count: int) -> DataType | None:
    """Return a sub-object's type by the type of its array or structure. A structure gives the types of all sub-objects, or of
    none."""
    if whole is None:
        return None
    if whole.entry is not None:
        return whole.entry if subindex else DataType.UNSIGNED8
    return whole.members[position] if len(whole.members) == count else None
