"""Chapters 9 and 10 of the conformance test: the NMT states and the transitions between them."""

from __future__ import annotations

from typing import Final

from canopen_proto.conformance.case import Case

_NEXT: Final = "this chapter"

CASES: Final = (
    Case("9.1", "State 01", "Boot-up: the parameters have their default values", None, waits_for=_NEXT),
    Case("9.2", "State 02", "Pre-operational", None, waits_for=_NEXT),
    Case("9.3", "State 03", "Operational", None, waits_for=_NEXT),
    Case("9.4", "State 04", "Stopped", None, waits_for=_NEXT),
    Case("10.1", "Transition 01", "Reset node and reset communication", None, waits_for=_NEXT),
    Case("10.2", "Transition 02", "Enter pre-operational", None, waits_for=_NEXT),
    Case("10.3", "Transition 03", "Start remote node", None, waits_for=_NEXT),
    Case("10.4", "Transition 04", "Stop remote node", None, waits_for=_NEXT),
)
