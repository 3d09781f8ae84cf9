"""Find the place of each object in an XDD, which a finding about it points to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from canopen_data.xdd.elements import Element, place_in

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
