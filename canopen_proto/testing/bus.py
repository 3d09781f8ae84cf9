"""`WorldBus`: a bus of a World. Every frame reaches all participants but its sender, in one order for all. Faults sit in between.

    sender --> transmission --> faults --> receivers
               |                |
               |                `- faults.py, those of the world, in their order
               `- a time drawn from `transmission`, in the order of sending; or a cable with bit timing and arbitration

What was on the bus stays in `trace`, for the assertions (seen.py) and the observer (judge.py).
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, Protocol

from canopen_proto.frame import Frame
from canopen_proto.machine import NEVER, LocalProtocolError, Time
from canopen_proto.testing.armed_fault import ArmedFault, Transit
from canopen_proto.testing.draws import Draws
from canopen_proto.testing.faults import FrameFault, Lie, Refuse, SecondMaster, Sudden
from canopen_proto.testing.judge import Judge, Passed
from canopen_proto.testing.member import WorldMember
from canopen_proto.testing.patterns import Names, Pattern, as_pattern
from canopen_proto.testing.seen import SeenFrame, check_never, find
from canopen_proto.testing.times import nanoseconds

MOST_WAITING: Final = 4096
"""Frames of one member that wait for the bus: as a driver's queue holds. More are lost, and the trace says so."""


class Cable(Protocol):
    """A bus with bit timing and arbitration, as canopen_transports.wire has one: `Wire`."""

    def join(self, now: Time, *, queue_size: int) -> Any:
        """Add a member, and return it. queue_size: how many of its frames can wait."""

    def send(self, member: Any, frame: Frame, now: Time) -> None:
        """Queue a frame."""

    def next_output(self) -> Time:
        """Return when something comes out at the earliest."""

    def handle_timeout(self, now: Time) -> None:
        """Do what is due."""

    def drain(self) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return the frames that came out, with `frame` and `senders`, and the reports, with `member` and perhaps `state`."""

    def time_of(self, bits: int) -> Time:
        """Return the time of so many bits."""


class _Sent(NamedTuple):
    at: Time
    number: int
    frame: Frame
    sender: WorldMember | None


class _Late(NamedTuple):
    at: Time
    number: int
    transit: Transit
    sender: WorldMember | None


class WorldBus:
    """See this module's text; made by `World.bus`. trace: all frames so far. participants: in the order of joining. bitrate: of
    its cable, bit/s; 0 without one."""

    def __init__(
        self,
        name: str,
        clock: Callable[[], Time],
        names: Names,
        faults: list[ArmedFault],
        on_sudden: Callable[[ArmedFault], None],
        draws: Draws,
        transmission: tuple[Time, Time],
    ) -> None:
        self.name = name
        self.bitrate = 0
        self.names = names
        self.participants: list[WorldMember] = []
        self.trace: list[Passed] = []
        self.observer = Judge(name, self.trace, clock, names, self._under_way)
        self._clock = clock
        self._faults = faults
        self._on_sudden = on_sudden
        self._draws = draws
        self._transmission = transmission
        self._cable: Cable | None = None
        self._members: dict[WorldMember, Any] = {}
        self._sent: list[_Sent] = []
        self._late: list[_Late] = []
        self._held: dict[tuple[int, int], Time] = {}  # until when frames wait behind a late one, by routing key and receiver
        self._last_at: Time = 0
        self._second_master = WorldMember("2nd master")
        self._count = 0
        self._since: Time = 0

    # ---- for tests ----

    def send(self, frame: Frame | str) -> None:
        """Put a frame on the bus, as somebody whom nobody knows. candump's notation will do: "605#4041600000000000"."""
        self.put(Frame.parse(frame) if isinstance(frame, str) else frame, None)

    def mark(self) -> None:
        """Let `saw` and `never` look only at what comes from now on."""
        self._since = self._clock()

    def saw(self, pattern: Pattern | Frame | str, *, after: Time | float | None = None) -> SeenFrame:
        """Return the first frame that fits, for more questions. pattern: also a frame, or one as candump writes it. after: only
        frames from this time on; default: since `mark`.

        Raises AssertionError, which says what came instead.
        """
        __tracebackhide__ = True
        return find(as_pattern(pattern), self.observer, self.names, self._from(after))

    def never(self, pattern: Pattern | Frame | str, *, after: Time | float | None = None) -> None:
        """Check that no frame came that fits. Raises AssertionError, which shows the first one, with what was before it.

        after: only frames from this time on, ns; None: since `mark`, or from the start.
        """
        __tracebackhide__ = True
        check_never(as_pattern(pattern), self.observer, self.names, self._from(after))

    def _from(self, after: Time | float | None) -> Time:
        __tracebackhide__ = True
        return self._since if after is None else nanoseconds(after, "after")

    def lines(self, last: int = 20) -> list[str]:
        """Return the last frames in words."""
        return self.observer.lines()[-last:] if last else []

    def _under_way(self) -> list[Frame]:
        """The frames that were sent, and have not come yet."""
        queued = [frame for each in self.participants if each.network is not None for frame in each.network.out.frames]
        return [*(sent.frame for sent in self._sent), *(late.transit.frame for late in self._late), *queued]

    # ---- for the world ----

    def intrude(self, text: str) -> None:
        """Put a frame on the bus, as a second master."""
        self.put(Frame.parse(text), self._second_master)

    def join(self, participant: WorldMember) -> None:
        self.participants.append(participant)
        if self._cable is not None:
            self._members[participant] = self._cable.join(self._clock(), queue_size=MOST_WAITING)

    def use_cable(self, cable: Cable, bitrate: int) -> None:
        """Let frames take the time of their bits from now on. Raises LocalProtocolError if it has a cable already, or if frames
        are under way."""
        if self._cable is not None:
            raise LocalProtocolError(f"the bus {self.name} has {self.bitrate} bit/s already: it cannot have {bitrate} bit/s too")
        if self._sent or self._late:
            raise LocalProtocolError(
                f"frames are under way on the bus {self.name}: give it its bit rate before anything is sent, or let time pass"
            )
        self._cable, self.bitrate = cable, bitrate
        for participant in self.participants:
            self._members[participant] = cable.join(self._clock(), queue_size=MOST_WAITING)

    def leave(self, participant: WorldMember) -> None:
        """Take a participant off the bus: it hears nothing more. What it has sent arrives."""
        self.participants.remove(participant)

    def put(self, frame: Frame, sender: WorldMember | None) -> None:
        """Take a frame for transmission. A controller that is bus-off loses it."""
        now = self._clock()
        if sender is not None and now < sender.off_until:
            return
        if self._cable is not None and sender in self._members:
            try:
                self._cable.send(self._members[sender], frame, now)
            except LocalProtocolError:
                self._record(Transit(frame, now, fate="lost"), sender, now)
            return
        least, most = self._transmission
        at = self._last_at = max(now, self._last_at) + self._draws.between(least, most)
        self._count += 1
        heapq.heappush(self._sent, _Sent(at, self._count, frame, sender))

    def next_time(self) -> Time:
        """Return when the next frame comes; NEVER if none is under way."""
        due = self._sent[0].at if self._sent else NEVER
        if self._late:
            due = min(due, self._late[0].at)
        if self._cable is not None:
            # One bit late, so that all who send at one time take part in the arbitration
            due = min(due, self._cable.next_output() + self._cable.time_of(1))
        return due

    def step(self, now: Time) -> None:
        """Let the frames come that are due."""
        if self._late and self._late[0].at <= now:
            late = heapq.heappop(self._late)
            self._deliver(late.transit, late.sender, now)
        elif self._sent and self._sent[0].at <= now:
            sent = heapq.heappop(self._sent)
            self.arrive(sent.frame, sent.sender, now)
        elif self._cable is not None:
            self._cable.handle_timeout(now - self._cable.time_of(1))
            deliveries, reports = self._cable.drain()
            owners = {member: participant for participant, member in self._members.items()}
            for each in deliveries:
                self.arrive(each.frame, owners.get(each.senders[0]), now)
            for report in reports:
                state, participant = getattr(report, "state", None), owners.get(report.member)
                if state is not None and participant is not None:
                    participant.controller_is(state.value == "bus-off", now)

    def arrive(self, frame: Frame, sender: WorldMember | None, now: Time) -> None:
        """Carry a frame past the faults, at the end of its transmission."""
        transits = [Transit(frame, now)]
        moments: list[ArmedFault] = []
        answers = []
        for armed in self._faults:
            if sender is self._second_master and isinstance(armed.fault, SecondMaster):
                continue  # it does not answer itself
            if not armed.meets(frame, self.name, now, self.names):
                continue
            fault = armed.fault
            to = fault.to if isinstance(fault, FrameFault) else 0
            if not isinstance(fault, Sudden) and (not to or any(each.node_id == to for each in self.participants)):
                armed.hit(now)
            if isinstance(fault, FrameFault):
                transits = [altered for transit in transits for altered in armed.alter(transit)]
            elif isinstance(fault, Refuse | Lie):
                note = f"node {fault.node_id} answers otherwise"
                transits = [
                    transit._replace(but=transit.but | {fault.node_id}, fate=transit.fate or note) for transit in transits
                ]
                answers.append((armed.answer(frame, self.names), fault.node_id))
            elif isinstance(fault, Sudden):
                moments.append(armed)
        for transit in transits:
            self._forward(transit, sender, now)
        for answer, node_id in answers:
            self.put(answer, next((each for each in self.participants if each.node_id == node_id), None))
        for moment in moments:
            self._on_sudden(moment)

    def _forward(self, transit: Transit, sender: WorldMember | None, now: Time) -> None:
        if transit.fate == "lost":
            self._record(transit, sender, now)
            return
        place = (transit.frame.key, transit.only)
        at = transit.at
        if not transit.is_loose:
            at = max(at, self._held.get(place, 0))
        if transit.is_late:
            self._held[place] = at
        if at <= now:
            self._deliver(transit, sender, now)
        else:
            self._count += 1
            heapq.heappush(self._late, _Late(at, self._count, transit, sender))

    def _deliver(self, transit: Transit, sender: WorldMember | None, now: Time) -> None:
        self._record(transit, sender, now)
        for participant in tuple(self.participants):
            if participant is sender:
                continue
            node_id = participant.node_id
            if transit.only in (0, node_id) and node_id not in transit.but:
                participant.hear(transit.frame, now)

    def _record(self, transit: Transit, sender: WorldMember | None, now: Time) -> None:
        fate = f"{transit.fate} at node {transit.only}" if transit.only and transit.fate else transit.fate
        self.trace.append(Passed(now, transit.frame, "" if sender is None else sender.name, fate, transit.only))
