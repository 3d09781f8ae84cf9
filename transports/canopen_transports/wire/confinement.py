"""`Confinement`: counts each member's errors, and takes it off the bus (ISO 11898-1; Bosch CAN specification, fault confinement).

    a transmitter sees an error              TEC + 8
    a receiver sees an error                 REC + 1; the one that saw it first, 8 more: the flags of the others follow its own
    a frame was sent                         TEC - 1
    a frame was taken                        REC - 1; from 128 on it becomes 119 (the standard allows 119 to 127)
    TEC or REC 96                            error warning
    TEC or REC 128                           error-passive: it no longer disturbs others, and waits 8 bits after sending
    TEC 256                                  bus-off: its queue is lost; error-active again after 128 times 11 recessive bits
    no acknowledge, of one error-passive     no change: a lone member never becomes bus-off

Rules that cannot apply here: bits that stay dominant after an error flag (there are none), overload frames.
"""

from __future__ import annotations

from collections.abc import Container
from typing import Final

from canopen_proto.frame_bits import duration
from canopen_proto.machine import Time
from canopen_transports.errors import BusState
from canopen_transports.wire.faults import FaultKind
from canopen_transports.wire.member import WireMember
from canopen_transports.wire.reports import FaultHappened, StateReported, WireEvent
from canopen_transports.wire.segment import CableSegment

WARNING_LIMIT: Final = 96
PASSIVE_LIMIT: Final = 128
BUS_OFF_LIMIT: Final = 256
AFTER_PASSIVE: Final = 119
RECOVERY: Final = 128
"""How many times a member that is bus-off must see 11 recessive bits."""
RECESSIVE: Final = 11


class Confinement:
    """The error counters and states of a wire's members. events: the list to which it appends changes of state and lost frames.

    disturbed: the members whose counters are not 0.
    """

    __slots__ = ("_auto_recovery", "_bitrate", "_events", "disturbed")

    def __init__(self, bitrate: int, auto_recovery: bool, events: list[WireEvent]) -> None:
        self.disturbed: dict[WireMember, None] = {}
        self._bitrate = bitrate
        self._auto_recovery = auto_recovery
        self._events = events

    def count(self, segment: CableSegment, member: WireMember, now: Time, *, transmit: int = 0, receive: int = 0) -> None:
        """Count an error."""
        member.transmit_errors += transmit
        member.receive_errors = min(member.receive_errors + receive, BUS_OFF_LIMIT - 1)
        self.disturbed[member] = None
        self._recount(segment, member, now)

    def got_through(
        self, segment: CableSegment, senders: Container[WireMember], takers: Container[WireMember], now: Time
    ) -> None:
        """Count a frame without an error: `senders` sent it, `takers` took it."""
        for member in list(self.disturbed):
            if member in senders:
                member.transmit_errors = max(member.transmit_errors - 1, 0)
            elif member in takers:
                above = member.receive_errors >= PASSIVE_LIMIT
                member.receive_errors = AFTER_PASSIVE if above else max(member.receive_errors - 1, 0)
            else:
                continue
            self._recount(segment, member, now)
            if not (member.transmit_errors or member.receive_errors):
                del self.disturbed[member]

    def recover(self, segment: CableSegment, member: WireMember, now: Time) -> None:
        """Start a member's way back from bus-off."""
        self.settle(segment, now)
        member.recovery = RECOVERY
        segment.recovering.append(member)

    def settle(self, segment: CableSegment, now: Time, frames: int = 0) -> None:
        """Count the runs of 11 recessive bits since the bus became free, and one for each frame (between its delimiter and
        intermission)."""
        seen = frames
        if not frames and segment.current is None and now > segment.free_at:
            seen = (now - segment.free_at) // self._time_of(1)
            segment.free_at = segment.free_at + seen * self._time_of(1) if segment.recovering else now
        for member in list(segment.recovering):
            member.recovery -= min(seen, member.recovery)
            if not member.recovery:
                segment.recovering.remove(member)
                member.transmit_errors = member.receive_errors = 0
                self.disturbed.pop(member, None)
                self._recount(segment, member, now)

    def next_recovery(self, segment: CableSegment) -> Time:
        """Return when the first recovering member is back if no frame is sent until then."""
        return segment.free_at + self._time_of(min(member.recovery for member in segment.recovering))

    def _time_of(self, times: int) -> Time:
        return duration(RECESSIVE * times, self._bitrate)

    def _recount(self, segment: CableSegment, member: WireMember, now: Time) -> None:
        """Set the member's state by its counters."""
        state = _state_of(member)
        if state is member.state:
            return
        member.state = state
        segment.changed()
        if state is BusState.BUS_OFF:
            dropped = member.clear()
            segment.wanting.pop(member, None)
            self._events += [FaultHappened(now, FaultKind.NOT_SENT, each.frame, member) for each in dropped]
            if member.babbles_until is not None:
                member.joined = False
            elif self._auto_recovery:
                self.recover(segment, member, now)
        self._events.append(StateReported(now, state, member))


def _state_of(member: WireMember) -> BusState:
    if member.transmit_errors >= BUS_OFF_LIMIT:
        return BusState.BUS_OFF
    worst = max(member.transmit_errors, member.receive_errors)
    if worst >= PASSIVE_LIMIT:
        return BusState.PASSIVE
    return BusState.WARNING if worst >= WARNING_LIMIT else BusState.ACTIVE
