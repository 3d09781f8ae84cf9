"""Where in an XDD each object stands: what a finding about it points to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from canopen_data.xdd.elements import Element, place_in

_OF_EDS: Final = {"parametername": "name", "parametervalue": "actualvalue"}
"""What CiA 306 calls otherwise than CiA 311; all other names differ in the case of letters only."""
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
"""Where a parameter says what a CANopenObject may leave to it."""


class XddDocument:
    """The places of a file's objects. text: the file as UTF-8. objects, parameters: by index and subindex, None = the object."""

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
        """See `description.Document`. field: the name of CiA 311 or that of CiA 306 ("DefaultValue"), in any case of letters.

        A field that a parameter of the device profile has stands there.
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
