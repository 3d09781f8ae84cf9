"""Chapter 5 of the conformance test: emergency."""

from __future__ import annotations

from typing import Final

from canopen_proto.conformance.case import Case

_NEXT: Final = "this chapter"

CASES: Final = (
    Case("5.1", "Emergency 01", "Check the COB-ID in 0x1014:00", None, waits_for=_NEXT),
    Case("5.2", "Emergency 02", "Read 0x1001:00", None, waits_for=_NEXT),
    Case("5.3", "Emergency 03", "Read 0x1003:01", None, waits_for=_NEXT),
    Case("5.4", "Emergency 04", "Force an emergency message", None, waits_for=_NEXT),
    Case("5.5", "Emergency 05", "Read 0x1001:00 while there is an error", None, waits_for=_NEXT),
    Case("5.6", "Emergency 06", "Compare 0x1003:01 with the message", None, waits_for=_NEXT),
)
