"""`Network`: everything that one participant runs on one bus, and the handle that a driver holds.

The driver loop, the only one there is:

    1. mutate: `network.receive(frame, now)`, `network.handle_timeout(now)`, or a command of any attached machine
    2. frames, events = network.drain(now)
    3. send the frames, in order          4. deliver the events
    5. wait for a frame, a command, or `network.next_deadline()`

`drain` also feeds the events to running procedures (`run`), whose next requests then leave in the same turn. A boot-up in a burst
is handled behind a feed of the answers before it, as if each frame had been drained by itself: a procedure that goes on by such
an answer has its next request open then, and learns of the boot. A driver never empties the outbox itself. A driver of several
networks with one Runner must drain all of them, repeatedly, until nothing comes out: a procedure fed by one may have changed
another.

A bus does not hand our own frames back to us. So a Network tells every attached `RemoteNode` of a SYNC that we sent (or heard),
which releases its synchronous PDOs, and of an NMT command that we sent, which changes the state that we expect of it.

A Network also remembers what it last heard from each node (bus_knowledge.py), so that errors can say what was seen.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, TypeVar

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.bus_knowledge import SLOTS, BusKnowledge, Gap, NodeHeard
from canopen_proto.compiling import mypyc_attr
from canopen_proto.follower import Follower
from canopen_proto.frame import ERROR_CONTROL, MAX_NODE_ID, Frame, RoutingKey
from canopen_proto.frame_bits import FRAME_BITS
from canopen_proto.group import Members
from canopen_proto.machine import (
    NEVER,
    Event,
    FrameIgnored,
    LocalProtocolError,
    Machine,
    Outbox,
    Outcome,
    Reaction,
    RequestId,
    Time,
)
from canopen_proto.nmt import STATE_OF_BYTE, NmtCommandSent, NmtState
from canopen_proto.procedures.runner import Runner
from canopen_proto.procedures.steps import Procedure
from canopen_proto.sdo.events import SdoAborted
from canopen_proto.sync import SyncReceived, SyncSent

T = TypeVar("T")

MAX_UNDRAINED_EVENTS: Final = 10_000
"""Notifications held for a driver that does not drain: half a second of a 1 Mbit/s bus that is full of empty frames."""

_BOOT_UPS: Final = frozenset(bytes((byte,)) for byte, state in enumerate(STATE_OF_BYTE) if state is NmtState.INITIALISING)


class EventsDropped(Event):
    """The driver did not drain for so long that `count` notifications were dropped, the oldest first. Outcomes never are."""

    __slots__ = ("count",)
    __match_args__ = ("node_id", "count")

    def __init__(self, node_id: int, count: int) -> None:
        self.node_id = node_id
        self.count = count


class OutageChanged(Event):
    """The driver has said that frames pass no longer, or again. outage: why they do not; "" if they do."""

    __slots__ = ("outage",)
    __match_args__ = ("node_id", "outage")

    def __init__(self, node_id: int, outage: str) -> None:
        self.node_id = node_id
        self.outage = outage


@mypyc_attr(allow_interpreted_subclasses=True)
class Network:
    """All machines of one participant on one bus.

    quiet: the driver sets it while nobody asks for PdoReceived and HeartbeatReceived. `receive` and `receive_many` then make
    neither where a node has taken all that they say (values, state, supervision), unless a procedure waits for one of them. bits:
    of all frames that came by `receive_many`, about (FRAME_BITS).
    """

    __slots__ = (
        "_armed", "_back_at", "_dropped", "_fed", "_followers", "_frames", "_heap", "_knowledge", "_lone", "_members", "_now",
        "_reactions", "_rerouted", "_root", "_routes", "_sent", "_settled", "_tasks", "_times", "_told", "bits", "out", "quiet",
        "runner",
    )  # fmt: skip

    def __init__(self, runner: Runner | None = None) -> None:
        """runner: that of another Network, so that procedures can span several buses; by default one of its own."""
        self.out = Outbox()
        # As near as can be: looked at for each frame
        self._sent, self._root = self.out.frames, self.out.root
        self._told: list[Any] = self.out.events  # Any: compiled, each event would be looked at whether it is one
        self._armed, self._rerouted = self.out.armed, self.out.rerouted
        self._members = Members(self.out, SLOTS)
        self._lone, self._routes, self._heap = self._members.lone, self._members.receivers, self._members.heap
        self._followers: dict[Machine, Follower] = {}  # never changed, but replaced: one of them may attach another
        self._now: Time = -NEVER  # the last time seen; a clock may begin anywhere
        self._back_at: Time = -NEVER
        self._dropped = 0
        self._settled = 0
        self._fed = 0
        self.quiet = False
        self.bits = 0
        self._reactions: dict[type[Event], Reaction] = {
            SyncSent: self._on_sync,
            SyncReceived: self._on_sync,
            NmtCommandSent: self._on_nmt_command,
            SdoAborted: self._on_sdo_aborted,
            FrameIgnored: self._on_ignored,
            OutageChanged: self._on_outage,
        }
        self._knowledge = BusKnowledge()
        self._times, self._frames = self._knowledge.times, self._knowledge.frames  # as near as can be: written for each frame
        if runner is None:
            runner = Runner(self.out)
            self.attach(runner)
        self.runner = runner
        self._tasks = runner.tasks  # asked for at each drain

    def attach(self, machine: Machine) -> None:
        """Route frames to a machine that was made with this network's `out`, and wake it at its deadlines.

        Raises LocalProtocolError if it is attached already, was made with another `out`, or is a second RemoteNode of one
        node-ID: each of the two would hear the answers to the other's requests.
        """
        if machine._is_attached:
            raise LocalProtocolError(f"the {type(machine).__name__} is attached already")
        machine.check_beside(self._members)
        self._members.attach(machine)
        if hasattr(machine, "on_nmt_command") and isinstance(machine, Follower):  # that takes 9 µs in Python 3.11
            self._followers = self._followers | {machine: machine}

    def detach(self, machine: Machine) -> None:
        """Forget a machine. Its open requests get no outcome: abort them first."""
        self._members.detach(machine)
        self._followers = {key: each for key, each in self._followers.items() if key is not machine}

    def can_ids(self) -> tuple[RoutingKey, ...]:
        """Return the keys of all frames that a machine wants, for a transport that can filter."""
        self._members.refresh()
        return tuple(self._members.routes)

    def receive(self, frame: Frame, now: Time, timestamp: int | None = None) -> None:
        """Hand a received frame to the machines that want it. timestamp: the transport's own, in ns, for information only."""
        if now < self._now:
            now = self._now  # a clock that ran back counts as the last time seen
        self._now = now
        events, root, key = self._told, self._root, frame.key
        mark = 0
        if events:
            if self._tasks and key > ERROR_CONTROL and frame.data in _BOOT_UPS:
                self._before_boot(key, now)
            mark = len(events)
        if self._rerouted:
            self._members.refresh()
        root.timestamp = timestamp  # also None: after a bug, that of the frame that caused it may stand there
        # Whoever is told of what was reported may ask for what comes behind it, and a procedure may wait for the usual traffic
        root.quiet = self.quiet and not mark and not (self._tasks and self.runner.waits_for_the_usual)
        machine = self._lone[key] if key < SLOTS else None
        if machine is not None:
            machine.receive(frame, now)
        elif key in self._routes:
            for each in self._routes[key]:
                each.receive(frame, now)
        root.quiet = False
        if events:  # a segment of a transfer reports nothing
            if machine is not None and machine.out is not self.out:  # it is a member of a node, which reacts first
                group = machine.out.reactions
                while mark < len(events):
                    kind = type(events[mark])
                    if kind in group:
                        group[kind](events[mark], now)
                    mark += 1
            settled, count, reactions = self._settled, len(events), self._reactions
            while settled < count:  # as `_settle` does, without a call
                report = events[settled]
                kind = type(report)
                settled += 1
                if kind in reactions:
                    self._settled = settled  # what the reaction causes may be settled within it
                    reactions[kind](report, now)
                    settled, count = self._settled, len(events)
            self._settled = settled
            if settled > MAX_UNDRAINED_EVENTS:
                self._shed()
        if timestamp is not None:
            root.timestamp = None
        if machine is not None or key < SLOTS:
            self._times[key] = now
            self._frames[key] = frame
        else:
            self._knowledge.other = now

    def receive_many(self, received: Iterator[object], now: Time) -> object | None:
        """Hand over received frames, as `receive` does one after the other. received: frames with their time stamps.

        Stops behind the first item that is no such pair, and returns it; None if there is none. After an exception (a bug of the
        core), `received` still has the items after the one that caused it. Networks that share a Runner are drained between two
        bursts: what one of them tells may make a procedure wait for what comes on another.
        """
        if now < self._now:
            now = self._now
        self._now = now
        out, lone, frames, reactions = self.out, self._lone, self._frames, self._reactions
        times: list[Any] = self._times
        time: Any = now  # compiled, a number would be put into a new object for each frame
        root, events, routes, costs = out.root, self._told, self._routes, FRAME_BITS
        root.quiet = self.quiet and not events and not (self._tasks and self.runner.waits_for_the_usual)
        bits, mark = 0, len(events)
        try:
            for item in received:
                if not isinstance(item, tuple):
                    return item
                frame: Frame = item[0]
                key = frame.key
                if events and self._tasks and key > ERROR_CONTROL and frame.data in _BOOT_UPS:
                    root.timestamp = None
                    self._before_boot(key, now)
                    mark = len(events)
                root.timestamp = item[1]
                bits += costs[len(frame.data)]
                if out.rerouted:
                    self._members.refresh()
                machine = lone[key] if key < SLOTS else None
                if machine is not None:
                    machine.receive(frame, now)
                elif key in routes:
                    for each in routes[key]:
                        each.receive(frame, now)
                settled, count = self._settled, len(events)
                if settled < count:
                    root.quiet = False  # whoever is told of this may ask for what comes behind it
                    if machine is not None and machine.out is not out:  # as in `receive`
                        group = machine.out.reactions
                        while mark < len(events):
                            kind = type(events[mark])
                            if kind in group:
                                group[kind](events[mark], now)
                            mark += 1
                        settled, count = self._settled, len(events)
                    while settled < count:  # as in `receive`: a call would cost as much as all of it
                        report = events[settled]
                        kind = type(report)
                        settled += 1
                        if kind in reactions:
                            self._settled = settled
                            reactions[kind](report, now)
                            settled, count = self._settled, len(events)
                    self._settled = settled
                    if settled > MAX_UNDRAINED_EVENTS:
                        self._shed()
                        settled = self._settled
                    mark = settled
                if machine is not None or key < SLOTS:
                    times[key] = time
                    frames[key] = frame
                else:
                    self._knowledge.other = now
        finally:
            self.bits += bits
            root.timestamp = None
            root.quiet = False
        return None

    def _before_boot(self, key: RoutingKey, now: Time) -> None:
        """Feed the answers from before a boot-up, so that no procedure goes on by them behind it. Whoever waits for anything else
        is told behind the boot, as it is in the same burst."""
        if key <= ERROR_CONTROL + MAX_NODE_ID:
            end = len(self._told)
            while end > self._fed and not isinstance(self._told[end - 1], Outcome):
                end -= 1
            self._feed(now, end)

    @property
    def last_heard(self) -> Time | None:
        """When the last frame of any node came; None on a bus that has been silent. Not O(1): for errors."""
        return self._knowledge.last_heard

    @property
    def hears_all(self) -> bool:
        """Whether every frame of the bus comes here. A driver whose transport filters (by `can_ids`) sets it to False: then a
        frame that was not heard may have been on the bus."""
        return self._knowledge.hears_all

    @hears_all.setter
    def hears_all(self, hears_all: bool) -> None:
        self._knowledge.hears_all = hears_all

    @property
    def outage(self) -> str:
        """Why no frames pass at present, in words such as "can0 is bus-off"; "" while the bus works. The driver sets it.

        Event: OutageChanged, when it begins and when it ends.
        """
        return self._knowledge.outage

    @outage.setter
    def outage(self, outage: str) -> None:
        has_changed = bool(outage) is not bool(self._knowledge.outage)
        self._knowledge.outage = outage
        if has_changed:
            self._back_at = self._back_at if outage else NEVER  # until `_on_outage` has the time
            self.out.events.append(OutageChanged(0, outage))

    @property
    def gap(self) -> Gap | None:
        """The last received frames that were lost before they came here: what seems to be missing may be among them."""
        return self._knowledge.gap

    def note_gap(self, lost: int, reason: str, now: Time) -> None:
        """Take note that received frames were lost, as the driver's transport says. lost: how many, at least. reason: where, for
        people."""
        self._knowledge.gap = Gap(now, lost, reason)

    @property
    def back_at(self) -> Time:
        """When the last outage ended; NEVER: it has just ended. A node that was silent before may only not have been heard."""
        return self._back_at

    def _on_outage(self, event: Event, now: Time) -> None:
        if isinstance(event, OutageChanged) and not event.outage:
            self._back_at = now

    def heard(self, node_id: int) -> NodeHeard:
        """Return what was last heard of a node (1..127, else LocalProtocolError), whether a machine wanted it or not."""
        return self._knowledge.heard(node_id)

    def last_heard_of(self, can_id: int) -> Time | None:
        """Return when a frame with an 11-bit CAN-ID was last received; None if never, and for 29-bit CAN-IDs."""
        return self._knowledge.time_of(can_id)

    def heard_nodes(self) -> tuple[int, ...]:
        """Return the node-IDs that were heard so far, in order."""
        return self._knowledge.nodes()

    def next_deadline(self) -> Time:
        """Return when to call `handle_timeout`: perhaps early, never late; NEVER if nothing waits. O(1) if nothing changed."""
        if self._armed or self._rerouted:
            self._members.refresh()
        heap: list[Any] = self._heap  # Any: compiled, all of an entry would be taken out of it
        return heap[0][0] if heap else NEVER

    def handle_timeout(self, now: Time) -> None:
        """Wake every machine whose deadline has come. Early calls do nothing."""
        if now < self._now:
            now = self._now
        self._now = now
        self._members.handle_timeout(now)
        if len(self.out.events) > self._settled:
            self._settle(now)
            if self._settled > MAX_UNDRAINED_EVENTS:
                self._shed()

    def drain(self, now: Time) -> tuple[list[Frame], list[Event]]:
        """Return the frames to send and the events to deliver since the last drain, each in order."""
        frames, events = self._sent, self._told
        if events:  # a segment of a transfer tells nothing
            if self._tasks or len(events) > self._settled:
                if now < self._now:
                    now = self._now
                self._now = now
                self._settle(now)
                self._feed(now)
            to_deliver = [*events]  # quicker than a copy
            events.clear()
            self._settled = self._fed = 0
            if self._dropped:
                to_deliver.insert(0, EventsDropped(0, self._dropped))
                self._dropped = 0
        else:
            to_deliver = []
        if not frames:  # a frame that was received seldom leads to both: what is empty need not be copied and cleared
            return [], to_deliver
        to_send = [*frames]
        frames.clear()
        return to_send, to_deliver

    def _feed(self, now: Time, end: int = NEVER) -> None:
        """Feed the events to the running procedures, and also the events that these cause; those before place `end` only."""
        events, root, observe = self.out.events, self.out.root, self.runner.observe
        while self._tasks and self._fed < min(len(events), end):
            self._fed += 1
            observe(root, events[self._fed - 1], now)
            if len(events) > self._settled:
                self._settle(now)

    def run(self, procedure: Procedure[T], now: Time) -> RequestId:
        """Start a procedure (see `canopen_proto.procedures`); ProcedureFinished, -Failed or -Cancelled follows with this id.

        A request to a machine that is not attached fails with a LocalProtocolError, and nothing is sent.
        """
        now = max(now, self._now)
        self._now = now
        self.out.root.quiet = False  # in the middle of a burst it may ask for what comes behind
        request_id = self.runner.start(procedure, now)
        self._settle(now)
        return request_id

    def cancel(self, request_id: RequestId, now: Time) -> None:
        """Cancel a running procedure: it cleans up first (CLEAN_UP_TIME), then ProcedureCancelled follows. request_id: the one
        that `run` returned."""
        now = max(now, self._now)
        self._now = now
        self.runner.cancel(request_id, now)
        self._settle(now)

    def _settle(self, now: Time) -> None:
        """React to the events since the last time, whether an input or a command of a machine caused them."""
        events, reactions = self.out.events, self._reactions
        while self._settled < len(events):
            report = events[self._settled]
            self._settled += 1
            reaction = reactions.get(type(report))
            if reaction is not None:
                reaction(report, now)

    def _shed(self) -> None:
        """Drop the oldest notifications, down to half of the bound, so that the cost is spread."""
        events = self.out.events
        excess, fed = len(events) - MAX_UNDRAINED_EVENTS // 2, self._fed
        kept: list[Event] = []
        for place, report in enumerate(events):
            if excess > 0 and not isinstance(report, Outcome):
                excess -= 1
                self._dropped += 1
                if place < fed:
                    self._fed -= 1
            else:
                kept.append(report)
        events[:] = kept
        self._settled = len(kept)

    def _on_sync(self, sync: SyncSent | SyncReceived, now: Time) -> None:
        counter, heard = sync.counter, isinstance(sync, SyncReceived)
        for follower in self._present_followers():
            follower.on_sync(counter, now, heard=heard)

    def _present_followers(self) -> Iterator[Follower]:
        """Yield the followers that are attached, though what one of them does may detach another."""
        followers = self._followers
        for machine, each in followers.items():
            if followers is self._followers or machine in self._followers:
                yield each

    def _on_nmt_command(self, sent: NmtCommandSent, now: Time) -> None:
        for follower in self._present_followers():
            if sent.node_id in (0, follower.node_id):
                follower.on_nmt_command(sent.command, now)

    def _on_sdo_aborted(self, aborted: SdoAborted, now: Time) -> None:
        if aborted.abort_code == AbortCode.TIMED_OUT and aborted.origin is AbortOrigin.TIMEOUT:
            self._knowledge.on_given_up(aborted.node_id, aborted.index, aborted.subindex, now)

    def _on_ignored(self, ignored: FrameIgnored, now: Time) -> None:
        self._knowledge.on_ignored(ignored.frame, now)
