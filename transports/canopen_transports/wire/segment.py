"""A piece of cable, and what is on it at a time."""

from __future__ import annotations

from collections.abc import Iterable

from canopen_proto.frame import Frame
from canopen_proto.machine import NEVER, Time
from canopen_transports.errors import BusState
from canopen_transports.wire.faults import FaultKind
from canopen_transports.wire.frame_bits import stuff_bits, stuffed_part
from canopen_transports.wire.member import Waiting, WireMember


class Transmission:
    """What is on the wire. outcome: None where it gets through. ends: when that shows."""

    __slots__ = ("begun", "ends", "outcome", "senders", "victim", "waiting")

    def __init__(self, begun: Time, waiting: Waiting, senders: list[WireMember]) -> None:
        self.begun = begun
        self.waiting = waiting
        self.senders = senders
        self.ends = begun
        self.outcome: FaultKind | None = None
        self.victim = senders[0]


class Segment:
    """A piece of cable, and who is on it. unheard_since: since when `is_unheard` holds."""

    __slots__ = ("begins", "current", "free_at", "members", "recovering", "unheard_since", "wanting")

    def __init__(self, members: Iterable[WireMember], free_at: Time) -> None:
        self.members = list(members)
        self.free_at = free_at
        self.begins: Time = NEVER
        self.current: Transmission | None = None
        self.wanting = {member: None for member in self.members if member.queued and member.state is not BusState.BUS_OFF}
        self.recovering = [member for member in self.members if member.recovery]
        self.unheard_since: Time | None = None

    @property
    def is_unheard(self) -> bool:
        """Whether its one member that is not bus-off repeats a frame for nobody, and this changes its counters no more."""
        lone = [member for member in self.members if member.state is not BusState.BUS_OFF]
        return len(lone) == 1 and lone[0].unacknowledged and lone[0].state is BusState.PASSIVE


def first_difference(one: Frame, other: Frame) -> int:
    """At which bit on the wire two frames with one arbitration field begin to differ, from 1 on; stuff bits are counted."""
    (first, first_count), (second, second_count) = stuffed_part(one), stuffed_part(other)
    common = min(first_count, second_count)
    first >>= first_count - common
    second >>= second_count - common
    place = common - (first ^ second).bit_length() + 1
    return place + stuff_bits(first >> common - place + 1, place - 1)
