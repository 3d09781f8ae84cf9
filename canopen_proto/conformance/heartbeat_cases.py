"""Chapter 7.1xx of the conformance test: heartbeat."""

from __future__ import annotations

from typing import Final

from canopen_proto.conformance.case import Case

_NEXT: Final = "this chapter"

CASES: Final = (
    Case("7.101", "Heartbeat 01", "Write 0x1017:00", None, waits_for=_NEXT),
    Case("7.102", "Heartbeat 02", "Count the heartbeats", None, waits_for=_NEXT),
    Case("7.103", "Heartbeat 03", "Switch off the heartbeat", None, waits_for=_NEXT),
    Case("7.104", "Heartbeat 04", "Try to monitor one node twice in 0x1016", None, waits_for=_NEXT),
    Case("7.105", "Heartbeat 05", "Monitor a heartbeat that is faster than the consumer time", None, waits_for=_NEXT),
    Case("7.106", "Heartbeat 06", "Monitor a heartbeat that is slower than the consumer time", None, waits_for=_NEXT),
    Case("7.107", "Heartbeat 07", "Monitor a heartbeat after a reset of the node", None, waits_for=_NEXT),
)
