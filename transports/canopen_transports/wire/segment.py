"""A piece of cable, and the frame on it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from canopen_proto.machine import NEVER, Time
from canopen_transports.errors import BusState
from canopen_transports.wire.faults import FaultKind
from canopen_transports.wire.member import WaitingFrame, WireMember


class Transmission:
    """A frame on the wire. begun: ns. ends: when the outcome shows, ns. outcome: the fault that ends it; None if it will succeed.
    victim: the member that the fault is about. senders: those that send it at the same time, usually one."""

    __slots__ = ("begun", "ends", "outcome", "senders", "victim", "waiting")

    def __init__(self, begun: Time, waiting: WaitingFrame, senders: list[WireMember]) -> None:
        self.begun = begun
        self.waiting = waiting
        self.senders = senders
        self.ends = begun
        self.outcome: FaultKind | None = None
        self.victim = senders[0]


class CableSegment:
    """A piece of cable, and its members. unheard_since: the time since which `is_unheard` holds, or None."""

    __slots__ = ("_others", "begins", "current", "free_at", "members", "recovering", "unheard_since", "wanting")

    def __init__(self, members: Iterable[WireMember], free_at: Time) -> None:
        self.members = list(members)
        self.free_at = free_at
        self.begins: Time = NEVER
        self.current: Transmission | None = None
        self.wanting = {member: None for member in self.members if member.queued and member.state is not BusState.BUS_OFF}
        self.recovering = [member for member in self.members if member.recovery]
        self.unheard_since: Time | None = None
        self._others: dict[WireMember, tuple[tuple[WireMember, ...], tuple[WireMember, ...]]] = {}

    def winners(self, now: Time) -> list[WireMember]:
        """Return the members whose waiting frame has the lowest arbitration field: usually one."""
        best = -1
        winners: list[WireMember] = []
        for member in self.wanting:
            head = member.head()
            if head is None or member.suspended_until > now:
                continue
            if not winners or head.arbitration < best:
                best, winners = head.arbitration, [member]
            elif head.arbitration == best:
                winners.append(member)
        return winners

    def others(self, senders: Sequence[WireMember]) -> tuple[tuple[WireMember, ...], tuple[WireMember, ...]]:
        """Return the members that acknowledge a frame of these senders, and those of them that take it: a babbling one does not
        listen."""
        if len(senders) == 1 and (known := self._others.get(senders[0])) is not None:
            return known
        hearing = tuple([each for each in self.members if each not in senders and each.state is not BusState.BUS_OFF])
        found = hearing, tuple([each for each in hearing if each.babbles_until is None])
        if len(senders) == 1:
            self._others[senders[0]] = found
        return found

    def remove(self, member: WireMember) -> None:
        """Take a member off this cable."""
        self.members.remove(member)
        self.wanting.pop(member, None)
        if member in self.recovering:
            self.recovering.remove(member)
        self.changed()

    def changed(self) -> None:
        """Forget who hears whom: a member came, left, went bus-off or returned."""
        self._others.clear()

    @property
    def is_unheard(self) -> bool:
        """Whether the only member that is not bus-off repeats a frame in vain, and its counters no longer change."""
        lone = [member for member in self.members if member.state is not BusState.BUS_OFF]
        return len(lone) == 1 and lone[0].unacknowledged and lone[0].state is BusState.PASSIVE
