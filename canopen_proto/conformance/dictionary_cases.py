"""Chapter 4 of the conformance test: the object dictionary."""

from __future__ import annotations

from typing import Final

from canopen_proto.conformance.case import Case

_NEXT: Final = "this chapter"

CASES: Final = (
    Case("4.1", "OD 01", "Access each object by its access type", None, waits_for=_NEXT),
    Case("4.2", "OD 02", "Compare each object with its default value", None, waits_for=_NEXT),
    Case("4.3", "OD 03", "Try to write what is read-only", None, waits_for=_NEXT),
    Case("4.4", "OD 04", "Try to read what is write-only", None, waits_for=_NEXT),
    Case("4.5", "OD 05", "Compare subindex 255 with data type and object type", None, waits_for=_NEXT),
    Case("4.6", "OD 06", "Check the limits of objects that can be written", None, waits_for=_NEXT),
    Case("4.7", "OD 07", "Access each object by its access type, in Operational", None, waits_for=_NEXT),
    Case("4.8", "OD 08", "Compare objects with their default values after reset communication", None, waits_for=_NEXT),
    Case("4.9", "OD 09", "Write back what each rw object holds", None, waits_for=_NEXT),
)
