"""Read the application process of an XDD: parameters and their types, which objects refer to.

CiA 311 has two ways to describe an object. Its CANopenObject says everything itself, in the terms of CiA 306; or it names a
parameter of the device profile (uniqueIDRef), which has type, access, default value, limits, unit and texts in the terms of ISO
15745-1 and IEC 61131-3. Newer editors write the second form only. An attribute of the CANopenObject itself takes precedence over
its parameter.

- A type is elementary (UDINT), or refers to an enumeration, a derived type, an array or a structure. An object of several
  subindices can take its sub-objects' types from an array or a structure only.
- BITSTRING stands for OCTET_STRING if there is a default value, else for DOMAIN, as in the editor that writes it.
- Engineering value = (value + offset) x multiplier. The multiplier is the factor of `Variable`; it has no offset.
- Named values (allowedValues, enumerations) become constants; a single range of allowed values becomes the limits.

Left out: parameter groups, function types and instances, conditional support, references to external dictionaries of texts.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final

from canopen_data.eds.ini import quoted
from canopen_data.xdd.elements import Element, XddFindings
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary.objects import Access

ELEMENTARY: Final = {
    "BOOL": DataType.BOOLEAN,
    "BITSTRING": DataType.OCTET_STRING,
    "BYTE": DataType.UNSIGNED8,
    "CHAR": DataType.VISIBLE_STRING,
    "WORD": DataType.UNSIGNED16,
    "DWORD": DataType.UNSIGNED32,
    "LWORD": DataType.UNSIGNED64,
    "SINT": DataType.INTEGER8,
    "INT": DataType.INTEGER16,
    "DINT": DataType.INTEGER32,
    "LINT": DataType.INTEGER64,
    "USINT": DataType.UNSIGNED8,
    "UINT": DataType.UNSIGNED16,
    "UDINT": DataType.UNSIGNED32,
    "ULINT": DataType.UNSIGNED64,
    "REAL": DataType.REAL32,
    "LREAL": DataType.REAL64,
    "STRING": DataType.VISIBLE_STRING,
    "WSTRING": DataType.UNICODE_STRING,
}
"""The data types of CiA 301 by the elementary types of IEC 61131-3, as CiA 311 names them."""

ACCESS: Final = {
    "const": Access.CONST,
    "read": Access.RO,
    "write": Access.WO,
    "readwrite": Access.RW,
    "readwriteinput": Access.RWR,
    "readwriteoutput": Access.RWW,
}
"""Access by the word of a parameter, in small letters; noAccess is missing."""
MAX_REFERENCES: Final = 16
"""Depth of types that refer to each other; beyond it there is a circle."""
MAX_NAMED_VALUES: Final = 256
"""Of one parameter."""
MAX_MEMBERS: Final = 255
"""An object has the subindices 0 to 254."""
_FROM_TEMPLATE: Final = (
    "data_type",
    "members",
    "entry",
    "access",
    "default",
    "actual",
    "low_limit",
    "high_limit",
    "named_values",
    "label",
    "description",
    "denotation",
    "unit",
)


@dataclass(frozen=True, slots=True)
class XddParameter:
    """The content of a parameter; values are text. "" or None: not given.

    members: the types of a structure's parts, in order. entry: the type of each element of an array. default, actual, low_limit,
    high_limit: the elements that hold these values in their attribute `value`.
    """

    element: Element
    data_type: DataType | None
    members: tuple[DataType | None, ...]
    entry: DataType | None
    access: str
    default: Element | None
    actual: Element | None
    low_limit: Element | None
    high_limit: Element | None
    named_values: tuple[tuple[str, str], ...]
    label: str
    description: str
    denotation: str
    unit: str
    factor: float


@dataclass(frozen=True, slots=True)
class _Type:
    """A resolved type. members, entry: see `XddParameter`."""

    data_type: DataType | None = None
    members: tuple[DataType | None, ...] = ()
    entry: DataType | None = None
    named_values: tuple[tuple[str, str], ...] = ()


class ApplicationProcess:
    """The parameters of a device by their unique ID. Each parameter and each type is read once."""

    def __init__(self, processes: Iterable[Element], findings: XddFindings) -> None:
        self._findings = findings
        self._types: dict[str, Element] = {}
        self._parameters: dict[str, Element] = {}
        self._known_types: dict[str, _Type] = {}
        self._known: dict[str, XddParameter | None] = {}
        self._own: dict[str, XddParameter | None] = {}
        for process in processes:
            for part in process.children:
                if part.name == "dataTypeList":
                    self._types |= {each.get("uniqueID"): each for each in part.children}
                elif part.name in ("parameterList", "templateList"):
                    self._parameters |= {each.get("uniqueID"): each for each in part.children}

    def parameter(self, unique_id: str) -> XddParameter | None:
        """Return the parameter of that ID, or None. Its template supplies what it lacks."""
        if unique_id not in self._known:
            own = self._own_of(unique_id)
            template = None if own is None else self._own_of(own.element.get("templateIDRef"))
            self._known[unique_id] = own if own is None or template is None else _merged(own, template)
        return self._known[unique_id]

    def _own_of(self, unique_id: str) -> XddParameter | None:
        """Return a parameter or a template by itself."""
        if unique_id not in self._own:
            element = self._parameters.get(unique_id) if unique_id else None
            self._own[unique_id] = None if element is None else self._read(element)
        return self._own[unique_id]

    def _read(self, element: Element) -> XddParameter:
        kind = self._type_of(element, MAX_REFERENCES)
        default, actual, allowed = element.first("defaultValue"), element.first("actualValue"), element.first("allowedValues")
        unit, denotation = element.first("unit"), element.first("denotation")
        if element.get("offset") not in ("", "0", "0.0"):
            message = "an offset of physical values is not supported: they are the value times the multiplier"
            self._findings.warning("offset", message, element, "offset")
        data_type = kind.data_type
        if data_type is DataType.OCTET_STRING and (default is None or not default.get("value")):
            data_type = DataType.DOMAIN
        low, high = self._limits(allowed)
        return XddParameter(
            element,
            data_type,
            kind.members,
            kind.entry,
            element.get("access"),
            default,
            actual,
            low,
            high,
            (*_named(allowed), *kind.named_values)[:MAX_NAMED_VALUES],
            _text(element, "label"),
            _text(element, "description"),
            "" if denotation is None else _text(denotation, "label"),
            "" if unit is None else _text(unit, "label"),
            self._factor(element) * (1.0 if unit is None else self._factor(unit)),
        )

    def _factor(self, element: Element) -> float:
        text = element.get("multiplier")
        try:
            factor = float(text or 1)
        except ValueError:
            factor = 0.0
        if factor and math.isfinite(factor):
            return factor
        message = f"the multiplier {quoted(text)!r} is not a number other than 0; it was left out"
        self._findings.warning("number", message, element, "multiplier")
        return 1.0

    def _limits(self, allowed: Element | None) -> tuple[Element | None, Element | None]:
        """Return the lowest and the highest allowed value, if they form one range."""
        if allowed is None:
            return None, None
        ranges = list(allowed.all("range"))
        if len(ranges) != 1 or allowed.first("value") is not None:
            return None, None
        return ranges[0].first("minValue"), ranges[0].first("maxValue")

    def _type_of(self, element: Element, depth: int) -> _Type:
        """Return the type of a parameter, of a declared variable, or of a part of another type."""
        for child in element.children:
            if child.name in ELEMENTARY:
                return _Type(ELEMENTARY[child.name])
            if child.name == "dataTypeIDRef":
                return self._named_type(child, depth)
        return _Type()

    def _named_type(self, reference: Element, depth: int) -> _Type:
        unique_id = reference.get("uniqueIDRef")
        if unique_id in self._known_types:
            return self._known_types[unique_id]
        element = self._types.get(unique_id)
        if element is None or depth == 0:
            reason = (
                f"there is no type {quoted(unique_id)!r}" if element is None else f"the type {quoted(unique_id)!r} has no end"
            )
            self._findings.warning("reference", reason, reference, "uniqueIDRef")
            return _Type()
        if element.name == "struct":
            declared = islice(element.all("varDeclaration"), MAX_MEMBERS)
            kind = _Type(members=tuple(self._type_of(each, depth - 1).data_type for each in declared))
        else:
            kind = self._type_of(element, depth - 1)
            if element.name == "array":
                kind = _Type(entry=kind.data_type)
            elif element.name == "enum":
                values = islice(_pairs(element.all("enumValue")), MAX_NAMED_VALUES)
                kind = replace(kind, named_values=tuple(values))
        self._known_types[unique_id] = kind
        return kind


def _merged(own: XddParameter, template: XddParameter) -> XddParameter:
    """Return a parameter with the fields that it lacks taken from its template."""
    absent = {name: value for name in _FROM_TEMPLATE if not getattr(own, name) and (value := getattr(template, name))}
    if own.factor == 1.0:
        absent["factor"] = template.factor
    return replace(own, **absent)


def _named(allowed: Element | None) -> Iterator[tuple[str, str]]:
    return iter(()) if allowed is None else islice(_pairs(allowed.all("value")), MAX_NAMED_VALUES)


def _pairs(elements: Iterable[Element]) -> Iterator[tuple[str, str]]:
    """Yield name and value of the elements that have both."""
    for each in elements:
        name, value = _text(each, "label"), each.get("value")
        if name and value:
            yield name, value


def _text(element: Element, name: str) -> str:
    """Return a text in English if there is one, else in the first language."""
    texts = [each for each in element.children if each.name == name]
    english = [each for each in texts if each.get("lang").lower().startswith("en")]
    return (english or texts)[0].text if texts else ""
