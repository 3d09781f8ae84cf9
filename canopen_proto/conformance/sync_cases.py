"""Chapter 6 of the conformance test: SYNC."""

from __future__ import annotations

from typing import Final

from canopen_proto.conformance.case import Case

_NEXT: Final = "this chapter"

CASES: Final = (
    Case("6.1", "Synchronization 01", "Check the default COB-ID of SYNC", None, waits_for=_NEXT),
    Case("6.2", "Synchronization 02", "Count SYNC messages", None, waits_for=_NEXT),
    Case("6.3", "Synchronization 03", "Count the TPDOs that SYNC sets off", None, waits_for=_NEXT),
    Case("6.4", "Synchronization 04", "Be a SYNC consumer, with 0x1006 set to 0", None, waits_for=_NEXT),
    Case("6.5", "Synchronization 05", "Set the SYNC counter overflow value to invalid values", None, waits_for=_NEXT),
    Case("6.6", "Synchronization 06", "Set the SYNC counter overflow value to 0", None, waits_for=_NEXT),
    Case("6.7", "Synchronization 07", "Check the SYNC counter", None, waits_for=_NEXT),
    Case("6.8", "Synchronization 08", "Save the SYNC counter configuration and reset the node", None, waits_for=_NEXT),
    Case(
        "6.9", "Synchronization 09", "Try to write the counter overflow value while a SYNC period is set", None, waits_for=_NEXT
    ),
    Case("6.10", "Synchronization 10", "Save the SYNC configuration and reset the node", None, waits_for=_NEXT),
)
