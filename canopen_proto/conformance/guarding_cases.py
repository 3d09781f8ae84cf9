"""Chapters 7.1 and 7.2 of the conformance test: node guarding and life guarding."""

from __future__ import annotations

from typing import Final

from canopen_proto.conformance.case import Case

_NEXT: Final = "this chapter"

CASES: Final = (
    Case("7.1", "Guarding 01", "Read 0x100C and 0x100D", None, waits_for=_NEXT),
    Case("7.2", "Guarding 02", "Send a remote frame and wait for the answer", None, waits_for=_NEXT),
    Case("7.3", "Guarding 03", "Check the toggle bit", None, waits_for=_NEXT),
    Case("7.4", "Guarding 04", "Check that only the own guarding CAN-ID is answered", None, waits_for=_NEXT),
    Case("7.5", "Guarding 05", "Write 0x100C and 0x100D", None, waits_for=_NEXT),
    Case("7.6", "Guarding 06", "Test life guarding", None, waits_for=_NEXT),
    Case("7.201", "Heartbeat versus guarding 01", "Check the heartbeat and guarding objects", None, waits_for=_NEXT),
    Case("7.202", "Heartbeat versus guarding 02", "Switch off the heartbeat", None, waits_for=_NEXT),
    Case("7.203", "Heartbeat versus guarding 03", "Test node guarding", None, waits_for=_NEXT),
    Case("7.204", "Heartbeat versus guarding 04", "Guarding off and heartbeat on", None, waits_for=_NEXT),
    Case("7.205", "Heartbeat versus guarding 05", "Heartbeat on, guarding off: send remote frames", None, waits_for=_NEXT),
    Case("7.206", "Heartbeat versus guarding 06", "Heartbeat on, guarding on: wait for heartbeats", None, waits_for=_NEXT),
    Case("7.207", "Heartbeat versus guarding 07", "Heartbeat on, guarding on: send remote frames", None, waits_for=_NEXT),
)
