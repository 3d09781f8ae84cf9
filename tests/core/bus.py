"""A CAN bus in virtual time that couples machines, for tests: deterministic, and as faulty as asked for.

It is a driver like any other: it takes frames from outboxes, hands each to every other participant that asks for its key, and
calls `handle_timeout` when a deadline comes. Machines that share an Outbox are one participant, which does not hear itself; so is
a Network. It asks for `can_ids()` and deadlines anew in each step, so any Machine will do, alone or as a Group.

    bus = Bus(seed=1, delay=(50 * MICROSECOND, 2 * MILLISECOND), loss=0.1, copies=0.1)
    client = bus.attach(SdoClient(Outbox(), node_id=12))
    bus.attach(SdoServer(Outbox(), 12, store))
    client.upload(0x1018, 1, bus.now)
    bus.settle()                                   # until nothing is on the way and no deadline is set
    assert bus.events == [SdoUploaded(...)]

Faults happen per frame and receiver. `loss`, `copies`, `late_copies`, `reordering` are their probabilities; or `fates` says it
frame by frame (hypothesis shrinks such a list well); what lies behind its end is delivered. What a real CAN can do is LOST,
COPIED, PAUSED and any delay: the order within a CAN-ID is kept, another CAN-ID may overtake. COPIED_LATE and LATE break that
order; no CAN does so, but gateways do.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Iterable, Iterator
from enum import Enum
from typing import Any, TypeVar

from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.machine import MICROSECOND, NEVER, SECOND, Event, Machine, Outbox, RequestId, Time
from canopen_proto.network import Network
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished

M = TypeVar("M", bound=Machine | Network)
E = TypeVar("E", bound=Event)

MAX_STEPS = 2_000_000  # a machine whose deadline does not move, or two that chat for ever, end here and not never


Ended = ProcedureFinished | ProcedureFailed | ProcedureCancelled
ENDED = (ProcedureFinished, ProcedureFailed, ProcedureCancelled)
"""The same, for what looks at each event."""


def result_of(ended: Ended) -> Any:
    """The result of a procedure; its error is raised."""
    if isinstance(ended, ProcedureFailed):
        raise ended.error
    assert isinstance(ended, ProcedureFinished), ended
    return ended.result


class Fate(Enum):
    """What becomes of a frame on its way to one receiver."""

    DELIVERED = "delivered"
    LOST = "lost"
    COPIED = "copied"  # delivered, and once more right behind it
    PAUSED = "paused"  # it waits in its sender's queue, and so do all that stand behind it there
    COPIED_LATE = "copied late"  # delivered, and once more at any later time, out of order
    LATE = "late"  # overtaken by frames of its own CAN-ID


CAN_FATES = (Fate.DELIVERED, Fate.LOST, Fate.COPIED)
"""What CAN itself can do to a frame."""


class Bus:
    """See this module's text."""

    def __init__(
        self,
        seed: int | random.Random = 0,
        *,
        delay: tuple[Time, Time] = (100 * MICROSECOND, 100 * MICROSECOND),
        loss: float = 0.0,
        copies: float = 0.0,
        late_copies: float = 0.0,
        reordering: float = 0.0,
        late: tuple[Time, Time] = (0, SECOND),
        pause: Time = 0,
        fates: Iterable[Fate] = (),
        frame_time: Time = 0,
        now: Time = 0,
    ) -> None:
        """delay: least and largest; late: how much later than that COPIED_LATE and LATE frames come; pause: PAUSED ones;
        frame_time: between two frames of one CAN-ID, at least."""
        self.now = now
        self.machines: list[Machine | Network] = []
        self.sent: list[tuple[Time, Frame]] = []  # every frame that was put on the bus, lost ones too
        self.events: list[Event] = []  # of all participants, in order
        self.on_event: Callable[[Event], object] | None = None  # the host: may give commands to machines
        self._random = seed if isinstance(seed, random.Random) else random.Random(seed)
        self._late = late
        self._pause = pause
        self._frame_time = frame_time
        self.disturb(delay, loss, copies, late_copies, reordering)
        self._fates: Iterator[Fate] | None = iter(fates)
        self._on_the_way: list[tuple[Time, int, Outbox, Frame]] = []
        self._count = 0
        self._last_arrival: dict[tuple[int, int], Time] = {}  # per receiver and key: order within a CAN-ID is kept

    def attach(self, machine: M) -> M:
        """Couple a machine or a network to the bus; it comes back, so that the call can stand around its construction."""
        self.machines.append(machine)
        return machine

    def disturb(
        self,
        delay: tuple[Time, Time],
        loss: float = 0.0,
        copies: float = 0.0,
        late_copies: float = 0.0,
        reordering: float = 0.0,
    ) -> None:
        """From now on, frames have these fates and delays."""
        self._delay = delay
        odds = ((Fate.LOST, loss), (Fate.COPIED, copies), (Fate.COPIED_LATE, late_copies), (Fate.LATE, reordering))
        self._odds = tuple((fate, probability) for fate, probability in odds if probability)
        self._is_plain = not self._odds and delay[0] == delay[1]  # then nothing is drawn

    def detach(self, machine: Machine | Network) -> None:
        """The machine vanishes from the bus (a cable is pulled)."""
        self.machines.remove(machine)

    def send(self, frame: Frame | str) -> None:
        """Put a frame (candump text will do) on the bus as a participant of your own; all machines hear it."""
        self._put(Frame.parse(frame) if isinstance(frame, str) else frame, None)

    def pump(self) -> None:
        """Take what the outboxes hold: frames go on their way, events to `events` and `on_event`."""
        busy = True
        while busy:
            busy = False
            for machine in tuple(self.machines):
                out = machine.out
                if not (out.frames or out.events):
                    continue
                frames, events = self._drain(machine)
                for frame in frames:
                    self._put(frame, out)
                self.events += events
                if self.on_event is not None and events:
                    busy = True
                    for event in events:
                        self.on_event(event)

    def next_time(self) -> Time:
        """When the next thing happens: an arrival or a deadline; NEVER if the bus is idle."""
        self.pump()
        return self._next()[0]

    def step(self, end: Time = NEVER) -> bool:
        """Let the next thing happen: one arrival, or one deadline if no frame arrives by then. False if there is nothing by
        `end`."""
        self.pump()
        return self._happen(end)

    def _happen(self, end: Time) -> bool:
        """As `step`, where nobody did anything since the last one: the outboxes are empty."""
        time, first = self._next()
        if time == NEVER or time > end:
            return False
        self.now = max(self.now, time)
        if first is None or (self._on_the_way and self._on_the_way[0][0] <= self.now):
            _, _, receiver, frame = heapq.heappop(self._on_the_way)
            self._deliver(receiver, frame)
        else:
            first.handle_timeout(self.now)
        self.pump()
        return True

    def settle(self, limit: Time = 3600 * SECOND) -> None:
        """Run until nothing is on the way and no deadline is set. Fails if that takes longer than `limit`."""
        end = self.now + limit
        self.pump()
        for _ in range(MAX_STEPS):
            if not self._happen(NEVER):
                return
            assert self.now <= end, f"still busy after {limit} ns"
        raise AssertionError(f"still busy after {MAX_STEPS} steps")

    def run(self, duration: Time) -> None:
        """Run for `duration`; `now` is exactly that much later then."""
        end = self.now + duration
        self.pump()
        for _ in range(MAX_STEPS):
            if not self._happen(end):
                self.now = end
                return
        raise AssertionError(f"more than {MAX_STEPS} steps in {duration} ns")

    def run_until(self, condition: Callable[[], bool], limit: Time = 60 * SECOND) -> None:
        """Run until the condition holds. Fails if the bus falls idle or `limit` passes before."""
        end = self.now + limit
        self.pump()
        while not condition():
            assert self.step(), "the bus is idle and the condition does not hold"
            assert self.now <= end, f"the condition does not hold after {limit} ns"

    def outcome(self, request_id: RequestId, limit: Time = 600 * SECOND) -> Ended:
        """Run until a procedure has ended; return how."""
        end = self.now + limit
        seen = 0
        self.pump()
        while True:
            if len(self.events) != seen:
                for event in self.events[seen:]:
                    if isinstance(event, ENDED) and event.request_id == request_id:
                        return event
                seen = len(self.events)
            assert self._happen(NEVER), "the bus is idle and the procedure has not ended"
            assert self.now <= end, f"the procedure has not ended after {limit} ns"

    def take_events(self, kind: type[E]) -> list[E]:
        """The events of one type; they are taken out of `events`."""
        taken = [event for event in self.events if isinstance(event, kind)]
        self.events = [event for event in self.events if not isinstance(event, kind)]
        return taken

    def trace(self) -> list[str]:
        """All frames that were put on the bus, in candump's notation."""
        return [str(frame) for _, frame in self.sent]

    # --- inside

    def _next(self) -> tuple[Time, Machine | Network | None]:
        """When the next thing happens, and whose deadline it is; None: it is an arrival, or there is nothing."""
        soonest, first = self._on_the_way[0][0] if self._on_the_way else NEVER, None
        for machine in self.machines:
            time = machine.next_deadline() if isinstance(machine, Network) else machine.deadline
            if time < soonest:
                soonest, first = time, machine
        return soonest, first

    def _drain(self, machine: Machine | Network) -> tuple[list[Frame], list[Event]]:
        out = machine.out
        if isinstance(machine, Network):
            return machine.drain(self.now)
        frames, events = out.frames[:], out.events[:]
        out.frames.clear()
        out.events.clear()
        return frames, events

    def _put(self, frame: Frame, sender: Outbox | None) -> None:
        self.sent.append((self.now, frame))
        told = {id(sender)}
        for machine in self.machines:
            receiver = machine.out
            if id(receiver) not in told:
                told.add(id(receiver))
                self._schedule(frame, receiver)

    def _schedule(self, frame: Frame, receiver: Outbox) -> None:
        fate = Fate.DELIVERED if self._is_plain and self._fates is None else self._fate()
        if fate is Fate.LOST:
            return
        arrival = self.now + (self._delay[0] if self._is_plain else self._random.randint(*self._delay))
        if fate is Fate.LATE:
            self._enter(arrival + self._random.randint(*self._late), receiver, frame)
            return
        if fate is Fate.PAUSED:
            arrival += self._pause
        last = (id(receiver), frame.key)
        if last in self._last_arrival:
            arrival = max(arrival, self._last_arrival[last] + self._frame_time)
        self._enter(arrival, receiver, frame)
        if fate is Fate.COPIED:
            self._enter(arrival, receiver, frame)
        self._last_arrival[last] = arrival
        if fate is Fate.COPIED_LATE:
            self._enter(arrival + self._random.randint(*self._late), receiver, frame)

    def _enter(self, arrival: Time, receiver: Outbox, frame: Frame) -> None:
        self._count += 1
        heapq.heappush(self._on_the_way, (arrival, self._count, receiver, frame))

    def _fate(self) -> Fate:
        if self._fates is not None:
            fate = next(self._fates, None)
            if fate is not None:
                return fate
            self._fates = None
        for fate, odds in self._odds:
            if self._random.random() < odds:
                return fate
        return Fate.DELIVERED

    def _deliver(self, receiver: Outbox, frame: Frame) -> None:
        for machine in self.machines:
            if machine.out is receiver and self._wants(machine, frame.key):
                machine.receive(frame, self.now)

    def _wants(self, machine: Machine | Network, key: RoutingKey) -> bool:
        if not isinstance(machine, Network):
            return key in machine.can_ids()
        machine._members.refresh()  # as its `can_ids` does, which makes a tuple of hundreds
        return key in machine._members.routes


class Wire(Bus):
    """A bus as CAN is: one frame at a time, in one order for all receivers; of those that wait, the lowest key goes first.

    A frame waits in the queue of its sender, and in that of each receiver, for part of `delay`. Queues keep their order. Nothing
    is lost. A participant does not learn when its own frames went.
    """

    def __init__(self, seed: int | random.Random = 0, *, delay: tuple[Time, Time], frame_time: Time = 100 * MICROSECOND) -> None:
        super().__init__(seed, delay=delay, frame_time=frame_time)
        self._queues: dict[int, list[tuple[Time, Frame]]] = {}  # per sender: when each frame is ready for the bus
        self._free_at: Time = 0
        self._arrived: dict[int, Time] = {}
        self.wired: list[tuple[Time, Frame, int]] = []  # as they went: when, what, id of the sender's outbox
        self._tick = Outbox()  # stands for the bus itself among the receivers

    def _put(self, frame: Frame, sender: Outbox | None) -> None:
        self.sent.append((self.now, frame))
        queue = self._queues.setdefault(id(sender), [])
        ready = self.now + self._random.randint(*self._delay)
        if queue:
            ready = max(ready, queue[-1][0])
        queue.append((ready, frame))
        self._enter(max(ready, self._free_at), self._tick, frame)

    def _deliver(self, receiver: Outbox, frame: Frame) -> None:
        if receiver is not self._tick:
            super()._deliver(receiver, frame)
            return
        if self.now < self._free_at:  # it was taken meanwhile
            self._enter(self._free_at, self._tick, frame)
            return
        heads = [(queue[0][1].key, sender) for sender, queue in self._queues.items() if queue and queue[0][0] <= self.now]
        if not heads:
            return
        lowest = min(key for key, _ in heads)
        first = [sender for key, sender in heads if key == lowest]
        sender = first[0] if len(first) == 1 else self._random.choice(first)  # by id, a case would not come again
        frame = self._queues[sender].pop(0)[1]
        self.wired.append((self.now, frame, sender))
        self._free_at = self.now + self._frame_time
        told = {sender}
        for machine in self.machines:
            out = machine.out
            if id(out) not in told:
                told.add(id(out))
                arrival = max(self._free_at + self._random.randint(*self._delay), self._arrived.get(id(out), 0))
                self._arrived[id(out)] = arrival
                self._enter(arrival, out, frame)


def take_frames(out: Outbox) -> list[str]:
    """For a machine that stands alone: what it sent, in candump's notation; the outbox is emptied of it."""
    frames = [str(frame) for frame in out.frames]
    out.frames.clear()
    return frames


def take_events(out: Outbox) -> list[Event]:
    """For a machine that stands alone: what it reported; the outbox is emptied of it."""
    events = out.events[:]
    out.events.clear()
    return events
