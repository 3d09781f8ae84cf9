"""`Wire`: a CAN bus as a machine. Members queue frames; the lowest identifier is sent; all others hear it; faults happen.

**Arbitration.** When the bus is free, all members that have a frame start to send it at once, and the lowest arbitration field
wins. Frames that are queued at the same time take part together. On an idle bus a frame starts at once. Two equal frames are sent
as one; two different frames with one identifier destroy each other again and again, until their members are bus-off.

**Time.** A frame takes its exact number of bits (frame_bits.py). The receivers have it at the end of EOF; 3 bits of intermission
follow. An error frame is an error flag and the flags of the others, 12 bits together, then 8 bits of delimiter and the
intermission. An error-passive member waits 8 bits more between two frames of its own.

**Acknowledge.** A frame that nobody else hears is not acknowledged, and is sent again for ever. Its member becomes error-passive,
but not bus-off (ISO 11898-1, fault confinement, exception 1). From then on its attempts are not computed until another member
joins. With `acknowledge=False` an unseen node acknowledges.

**Faults** come from the rates and the seed, or from commands: `bus_off`, `babble`, `cut` and `mend`. The same seed and calls give
the same trace. `FaultHappened` reports each frame that was hit, `StateReported` each change of a member's state. A member that
goes bus-off loses its queue, and returns after 128 times 11 recessive bits (or by `restart`).

**A cut cable** makes two buses, each of which runs by itself. The cut destroys a frame that is on the wire; so does the mending.

Simplified: all members see a bit at the same time (no propagation, no clock tolerance, no resynchronisation); a frame that is
queued in the first bit of another waits; an error flag and its echoes always last 12 bits; there are no overload frames.

It is driven like a machine of the core: `send` and the other commands change it, `drain` returns what came out, `next_deadline`
says when to call `handle_timeout`. A late driver loses nothing: each step happens at the time when it was due.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from canopen_proto.frame import Frame
from canopen_proto.frame_bits import INTERMISSION, duration, frame_bits
from canopen_proto.machine import NEVER, LocalProtocolError, Time
from canopen_transports.errors import BusState
from canopen_transports.wire.confinement import BUS_OFF_LIMIT, Confinement
from canopen_transports.wire.course import decide
from canopen_transports.wire.faults import FaultKind, FaultRates
from canopen_transports.wire.member import TRANSMIT_QUEUE_SIZE, QueueOrder, WaitingFrame, WireMember
from canopen_transports.wire.reports import Delivery, FaultHappened, StateReported, WireEvent
from canopen_transports.wire.segment import CableSegment, Transmission

ERROR_FLAG: Final = 6
ERROR_DELIMITER: Final = 8
ERROR_FRAME: Final = 2 * ERROR_FLAG + ERROR_DELIMITER
"""Bits of an error that one member saw first: its flag, then those of the others, then the delimiter."""
SUSPEND: Final = 8
"""Bits that an error-passive member waits after it has sent."""
MAX_STEPS: Final = 10_000
"""Steps in one call of `handle_timeout`: a driver that comes hours late gets the results in portions."""


@dataclass(frozen=True, slots=True)
class WireSettings:
    """The properties of a wire.

    bitrate: bit/s. rates: of faults; `seed` decides what they hit. acknowledge: whether frames need a second member.
    auto_recovery: whether members return from bus-off by themselves, as soon as they may.
    """

    bitrate: int = 1_000_000
    rates: FaultRates = field(default_factory=FaultRates)
    seed: int = 0
    acknowledge: bool = True
    auto_recovery: bool = True


class Wire:
    """See this module's text. frames, error_frames: their numbers so far. rates: of faults; may be set."""

    def __init__(self, settings: WireSettings = WireSettings(), now: Time = 0) -> None:
        if settings.bitrate < 1:
            raise LocalProtocolError(f"a bit rate is 1 bit/s or more, not {settings.bitrate}")
        self.settings = settings
        self.rates = settings.rates
        self.frames = 0
        self.error_frames = 0
        self._busy: Time = 0
        self._now = self._since = now
        self._random = random.Random(settings.seed)
        self._segments = [CableSegment((), now)]
        self._joined = 0
        self._late: list[tuple[Time, int, Delivery]] = []
        self._late_so_far = 0
        self._deliveries: list[Delivery] = []
        self._events: list[WireEvent] = []
        self._confinement = Confinement(settings.bitrate, settings.auto_recovery, self._events)
        self._tails: dict[int, Time] = {}
        self._measured: tuple[Frame | None, int] = (None, 0)
        self._intermission = self.time_of(INTERMISSION)

    # ---- getters ----

    @property
    def members(self) -> tuple[WireMember, ...]:
        """The members on the wire."""
        return tuple(member for segment in self._segments for member in segment.members)

    @property
    def is_cut(self) -> bool:
        """Whether the cable is in two halves."""
        return len(self._segments) > 1

    def time_of(self, bits: int) -> Time:
        """Return the time of so many bits, in ns."""
        time = self._tails.get(bits)
        if time is None:
            time = self._tails[bits] = duration(bits, self.settings.bitrate)
        return time

    def load(self, now: Time) -> float:
        """Return the part of the time since the start, or since `begin_load`, in which the bus was busy: 0 to 1.

        Intermissions and error frames count as busy. A frame counts when it ends. On a cut cable, the sum of both halves.
        """
        unheard = sum(now - each.unheard_since for each in self._segments if each.unheard_since is not None)
        return (self._busy + unheard) / (now - self._since) if now > self._since else 0.0

    def begin_load(self, now: Time) -> None:
        """Measure the load from now on."""
        self._advance(now)
        self._busy, self._since = 0, now
        for segment in self._segments:
            if segment.unheard_since is not None:
                segment.unheard_since = now

    # ---- commands ----

    def join(self, now: Time, *, order: QueueOrder = QueueOrder.FIFO, queue_size: int = TRANSMIT_QUEUE_SIZE) -> WireMember:
        """Add a member. order, queue_size: of its transmit queue. On a cut cable it joins the first half."""
        self._advance(now)
        member = WireMember(self._joined, order, queue_size)
        self._joined += 1
        self._segments[0].members.append(member)
        self._segments[0].changed()
        self._schedule(self._segments[0])
        return member

    def leave(self, member: WireMember, now: Time) -> None:
        """Take a member off the wire. Its queued frames vanish; a frame that is on the wire is sent to its end."""
        self._advance(now)
        if not member.joined:
            return
        segment = self._segment_of(member)
        member.joined = False
        if not (segment.current and member in segment.current.senders):
            self._forget(segment, member)

    def send(self, member: WireMember, frame: Frame, now: Time) -> None:
        """Queue a frame. Raises QueueFullError if there is no room, LocalProtocolError if the member is bus-off or has left."""
        self._advance(now)
        if not member.joined or member.state is BusState.BUS_OFF:
            raise LocalProtocolError(f"{member!r} cannot send: it is {member.state.value if member.joined else 'gone'}")
        member.put(frame, self._now)
        segment = self._segments[0] if len(self._segments) == 1 else self._segment_of(member)
        segment.wanting[member] = None
        if segment.current is None:
            self._schedule(segment)

    def bus_off(self, member: WireMember, now: Time) -> None:
        """Take a member's controller bus-off, as 32 transmit errors in a row would."""
        self._advance(now)
        segment = self._segment_of(member)
        current = segment.current
        if current is not None and member in current.senders:
            self._destroy(segment, FaultKind.CORRUPTION)
        self._confinement.count(segment, member, self._now, transmit=BUS_OFF_LIMIT - member.transmit_errors)
        if not member.joined:
            self._forget(segment, member)
        self._schedule(segment)

    def restart(self, member: WireMember, now: Time) -> None:
        """Start the recovery of a member that is bus-off, as `auto_recovery` does. It takes 128 times 11 recessive bits."""
        self._advance(now)
        if member.state is BusState.BUS_OFF and not member.recovery:
            self._confinement.recover(self._segment_of(member), member, self._now)

    def babble(self, frame: Frame, until: Time, now: Time) -> WireMember:
        """Add a faulty member, which hears nothing, sends this frame again and again until `until`, and then leaves."""
        member = self.join(now, queue_size=1)
        member.babbles_until = until
        self._segments[0].changed()
        self.send(member, frame, now)
        return member

    def cut(self, half: Iterable[WireMember], now: Time) -> None:
        """Cut the cable: these members on one side, all others on the other. Raises LocalProtocolError if it is cut already."""
        self._advance(now)
        if self.is_cut:
            raise LocalProtocolError("the cable is cut already; mend it first")
        (whole,) = self._segments
        self._destroy(whole, FaultKind.CUT)
        self._confinement.settle(whole, self._now)
        self._schedule(whole)
        here = set(half)
        parts = [member for member in whole.members if member in here], [each for each in whole.members if each not in here]
        self._segments = [CableSegment(part, whole.free_at) for part in parts]
        for segment in self._segments:
            self._schedule(segment)

    def mend(self, now: Time) -> None:
        """Join the two halves again. Does nothing if the cable is whole."""
        self._advance(now)
        if not self.is_cut:
            return
        for segment in self._segments:
            self._destroy(segment, FaultKind.CUT)
            self._confinement.settle(segment, self._now)
            self._schedule(segment)
        free_at = max(segment.free_at for segment in self._segments)
        self._segments = [CableSegment(sorted(self.members, key=lambda member: member.number), free_at)]
        self._schedule(self._segments[0])

    # ---- time and output ----

    def next_deadline(self) -> Time:
        """Return when to call `handle_timeout`; NEVER if nothing is under way."""
        deadline = self._late[0][0] if self._late else NEVER
        if deadline == NEVER and len(self._segments) == 1:
            return self._due(self._segments[0])
        for segment in self._segments:
            due = self._due(segment)
            if due < deadline:
                deadline = due
        return deadline

    def next_output(self) -> Time:
        """Return when something comes out at the earliest if nobody commands anything until then; NEVER if nothing does.

        A driver that wakes at this time, in place of `next_deadline`, gets the same: each step happens when it was due.
        """
        segment = self._segments[0]
        is_plain = len(self._segments) == 1 and not (self._late or segment.recovering or self._confinement.disturbed)
        if segment.current is not None or segment.begins >= NEVER or not is_plain or self.rates.total:
            return self.next_deadline()
        winners = segment.winners(segment.begins)
        head = winners[0].head()
        if len(winners) > 1 or head is None or not segment.others(winners)[0]:
            return segment.begins
        return segment.begins + self.time_of(self._bits_of(head.frame) - INTERMISSION)

    def _bits_of(self, frame: Frame) -> int:
        """Return the length of a frame in bits. The last one is remembered: each is asked for twice."""
        if frame is not self._measured[0]:
            self._measured = frame, frame_bits(frame)
        return self._measured[1]

    def handle_timeout(self, now: Time) -> None:
        """Do what is due. An early call does nothing; after a very late one `next_deadline` may still be due."""
        self._run(now + 1, MAX_STEPS)
        if self.next_deadline() > now:
            self._now = max(self._now, now)

    def drain(self) -> tuple[list[Delivery], list[WireEvent]]:
        """Return the frames and the events since the last drain, each in order."""
        drained = self._deliveries, self._events[:]
        self._deliveries = []
        self._events.clear()
        return drained

    def _advance(self, now: Time) -> None:
        """Do what was due before now. What is due right now waits for more commands."""
        if now > self._now:
            self._run(now, None)
            self._now = now

    def _run(self, end: Time, most: int | None) -> None:
        steps = 0
        while (due := self.next_deadline()) < end and (most is None or steps < most):
            steps += 1
            self._now = max(self._now, due)
            if self._late and self._late[0][0] <= due:
                self._deliveries.append(heapq.heappop(self._late)[2])
                continue
            for segment in self._segments:
                if self._due(segment) <= due:
                    self._step(segment, due)

    def _due(self, segment: CableSegment) -> Time:
        if segment.current is not None:
            return segment.current.ends
        if segment.recovering:
            return min(segment.begins, self._confinement.next_recovery(segment))
        return segment.begins

    def _step(self, segment: CableSegment, now: Time) -> None:
        if segment.current is not None:
            self._finish(segment, segment.current)
        elif segment.begins <= now:
            self._begin(segment, now)
        else:
            self._confinement.settle(segment, now)
            self._schedule(segment)

    # ---- a transmission ----

    def _schedule(self, segment: CableSegment) -> None:
        """Set when the next frame begins. While a frame is being sent, its end does that."""
        if segment.current is not None:
            return
        if segment.unheard_since is not None:
            self._busy += max(self._now - segment.unheard_since, 0)
            segment.unheard_since = None
        if self._confinement.disturbed and segment.is_unheard and segment.wanting and self.settings.acknowledge:
            segment.unheard_since = max(self._now, segment.free_at)
            segment.begins = NEVER
            return
        if not segment.wanting:
            segment.begins = NEVER
            return
        begins = segment.free_at
        if self._confinement.disturbed:
            begins = max(begins, min(member.suspended_until for member in segment.wanting))
        segment.begins = begins if begins > self._now else self._now

    def _begin(self, segment: CableSegment, now: Time) -> None:
        senders = segment.winners(now)
        if segment.recovering:
            self._confinement.settle(segment, now)
        for member in senders:
            member.begin()
        first = senders[0].sending
        assert first is not None
        sending = segment.current = Transmission(now, first, senders)
        segment.begins = NEVER
        bits = self._bits_of(first.frame)
        sending.ends = now + self.time_of(decide(sending, segment, self.rates, self._random, self.settings.acknowledge, bits))

    def _finish(self, segment: CableSegment, sending: Transmission) -> None:
        """Carry out what was decided when the frame began."""
        now, outcome = sending.ends, sending.outcome
        segment.current = None
        if outcome is FaultKind.CORRUPTION or outcome is FaultKind.COLLISION:
            self._fail(segment, sending, outcome, now)
        elif outcome is FaultKind.LOSS and sending.victim in sending.senders:
            self._not_acknowledged(segment, sending, now)
        else:
            self._deliver(segment, sending, now)
        for member in sending.senders:
            if not member.joined:
                self._forget(segment, member)
        self._busy += segment.free_at - sending.begun
        if segment.recovering:
            self._confinement.settle(segment, segment.free_at, frames=1)
        self._schedule(segment)

    def _deliver(self, segment: CableSegment, sending: Transmission, now: Time) -> None:
        waiting, senders, outcome, victim = sending.waiting, sending.senders, sending.outcome, sending.victim
        takers = receivers = segment.others(senders)[1]
        self.frames += 1
        segment.free_at = now + self._intermission
        if outcome is not None:
            self._events.append(FaultHappened(now, outcome, waiting.frame, victim))
            if outcome is not FaultKind.REPETITION:
                receivers = tuple(member for member in receivers if member is not victim)
            if outcome is FaultKind.LOSS and victim.state is BusState.PASSIVE:
                takers = receivers
                self._confinement.count(segment, victim, now, receive=1)
            if outcome is FaultKind.DELAY and victim.babbles_until is None:
                late = now + self._random.randint(1, self.rates.delay_time)
                victim.delayed_until = max(victim.delayed_until, late)
                self._late_for(victim, Delivery(now, waiting.frame, waiting.queued, tuple(senders), (victim,)))
        if self._late:
            for member in receivers:
                if member.delayed_until > now:
                    self._late_for(member, Delivery(now, waiting.frame, waiting.queued, tuple(senders), (member,)))
            receivers = tuple(member for member in receivers if member.delayed_until <= now)
        self._deliveries.append(Delivery(now, waiting.frame, waiting.queued, tuple(senders), receivers))
        repeated = outcome is FaultKind.REPETITION
        if self._confinement.disturbed:
            self._confinement.got_through(segment, () if repeated else senders, takers, now)
        if repeated:
            self._end_in_error(segment, senders, ERROR_FRAME, now)
        else:
            for member in senders:
                self._sent(segment, member, waiting, now)

    def _late_for(self, member: WireMember, delivery: Delivery) -> None:
        self._late_so_far += 1
        heapq.heappush(self._late, (member.delayed_until, self._late_so_far, delivery._replace(at=member.delayed_until)))

    def _sent(self, segment: CableSegment, member: WireMember, waiting: WaitingFrame, now: Time) -> None:
        member.sending = None
        member.sent += 1
        member.unacknowledged = False
        if member.babbles_until is not None:
            if now < member.babbles_until:
                member.put(waiting.frame, now)
            else:
                member.joined = False
        elif not member.queued:
            segment.wanting.pop(member, None)
        self._suspend(segment, member)

    def _fail(self, segment: CableSegment, sending: Transmission, outcome: FaultKind, now: Time) -> None:
        """Start an error frame."""
        self._events.append(FaultHappened(now, outcome, sending.waiting.frame, sending.senders[0]))
        self._end_in_error(segment, sending.senders, ERROR_FRAME, now)
        for member in segment.others(sending.senders)[0]:
            self._confinement.count(segment, member, now, receive=9 if member is sending.victim else 1)

    def _not_acknowledged(self, segment: CableSegment, sending: Transmission, now: Time) -> None:
        for member in sending.senders:
            if not member.unacknowledged:
                member.unacknowledged = True
                self._events.append(StateReported(now, BusState.NO_ACKNOWLEDGE, member))
        to_blame = [member for member in sending.senders if member.state is not BusState.PASSIVE]
        self._end_in_error(segment, sending.senders, ERROR_FLAG + ERROR_DELIMITER, now, to_blame)

    def _end_in_error(
        self, segment: CableSegment, senders: list[WireMember], bits: int, now: Time, to_blame: list[WireMember] | None = None
    ) -> None:
        """End a transmission with an error frame of so many bits. The senders get their frame back."""
        self.error_frames += 1
        segment.free_at = now + self.time_of(bits + INTERMISSION)
        for member in senders:
            member.failed()
            if to_blame is None or member in to_blame:
                self._confinement.count(segment, member, now, transmit=8)
            self._suspend(segment, member)

    def _suspend(self, segment: CableSegment, member: WireMember) -> None:
        """Make an error-passive member wait after sending, so that others can begin first."""
        if member.state is BusState.PASSIVE:
            member.suspended_until = segment.free_at + self.time_of(SUSPEND)

    def _destroy(self, segment: CableSegment, outcome: FaultKind) -> None:
        """Destroy the frame on the wire; it is sent again."""
        sending = segment.current
        if sending is not None:
            segment.current = None
            self._fail(segment, sending, outcome, self._now)
            self._busy += segment.free_at - sending.begun
            for member in sending.senders:
                if not member.joined:
                    self._forget(segment, member)

    # ---- members ----

    def _segment_of(self, member: WireMember) -> CableSegment:
        for segment in self._segments:
            if member in segment.members:
                return segment
        raise LocalProtocolError(f"{member!r} is not on this wire")

    def _forget(self, segment: CableSegment, member: WireMember) -> None:
        if member in segment.members:
            member.clear()
            segment.remove(member)
            self._confinement.disturbed.pop(member, None)
            self._schedule(segment)
