"""Several machines behind one: routes for frames, the next deadline, and reactions to what the machines report.

A `Group` is a `Machine` made of machines. `LocalNode` and `RemoteNode` are groups, and `Network` is the outermost one, so that a
node can be embedded alone just like a single client. A group

- routes a frame by one look-up: a key (CAN-ID with flags) maps to a tuple of machines, in the order of their attachment;
- keeps its members' deadlines in a lazy heap: a deadline that moved later waits for the early wake (measured five times cheaper
  than pushing at each re-arm); a member announces an earlier deadline in `out.armed`;
- turns one member's events into another's commands, by a table `event type -> reaction`, after each input and before the next
  one: a PDO right after "NMT start" is already received. No machine ever calls a sibling.

Nothing is copied from layer to layer: a nested outbox shares its frames and events with the outer one.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from heapq import heapify, heappop, heappush
from types import TracebackType
from typing import Final

from canopen_proto.compiling import mypyc_attr
from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.machine import NEVER, LocalProtocolError, Machine, Outbox, Time

SPARE_WAKES: Final = 64
"""The heap is built again if it has more than this many entries over two for each member: its memory stays bounded."""


class Members:
    """The machines on one outbox: their routes and their deadlines.

    routes: by key, the machines that want its frames, in the order of their attachment. receivers: by key, what to hand these
    frames to, see `Machine.receiver_of`. lone: for the lowest keys, as a list, the one receiver; None if there are none or
    several. In place of an `Entrance` it has the machine behind it: whoever hands that a frame lets its group settle. changed:
    for a group, the keys whose receivers are others than when the members around it last asked. heap: the wakes that are held,
    the nearest first.
    """

    __slots__ = ("_keys", "_out", "_sequence", "changed", "heap", "lone", "receivers", "routes")

    def __init__(self, out: Outbox, lone: int = 0) -> None:
        """lone: how many keys to have in that list, for a group that is handed every frame of a bus."""
        self._out = out
        self._keys: dict[Machine, dict[RoutingKey, None]] = {}
        self.heap: list[tuple[Time, int, Machine]] = []
        self._sequence = 0
        self.routes: dict[RoutingKey, tuple[Machine, ...]] = {}
        self.receivers: dict[RoutingKey, tuple[Machine, ...]] = {}
        self.changed: set[RoutingKey] = set()
        self.lone: list[Machine | None] = [None] * lone

    def __iter__(self) -> Iterator[Machine]:
        return iter(self._keys)

    def attach(self, machine: Machine) -> None:
        """Route the frames that the machine asks for to it, and hold its deadline. Does nothing if it is attached already.

        Raises LocalProtocolError unless it was made with our outbox.
        """
        if machine.out is not self._out:
            raise LocalProtocolError(f"{type(machine).__name__} was made with another Outbox than that of what it is attached to")
        if machine in self._keys:
            return
        self._keys[machine] = {}
        machine._is_attached = True
        self._route(machine)
        self._announce()
        machine._wake = NEVER
        machine._arm(machine.deadline)

    def detach(self, machine: Machine) -> None:
        """Stop routing frames to the machine and waking it. Does nothing if it is not attached."""
        if machine not in self._keys:
            return
        self._unroute(machine)
        self._announce()
        del self._keys[machine]
        machine._is_attached = False
        machine._wake = NEVER  # what the heap still holds of it no longer counts
        for pending in (self._out.armed, self._out.rerouted):
            if machine in pending:
                pending.remove(machine)
        machine._in_armed = machine._in_rerouted = False

    def _announce(self) -> None:
        """Announce that the CAN-IDs of the group around these members changed."""
        if self._out.owner is not None:
            self._out.owner._reroute()

    def _unroute(self, machine: Machine) -> None:
        for key in self._keys[machine]:
            self._leave(key, machine)

    def _route(self, machine: Machine) -> None:
        """Ask a machine anew what it wants. Only what changed is touched: a group that scans a bus has hundreds of keys."""
        before, changed = self._keys[machine], machine.take_changed()
        self._keys[machine] = keys = dict.fromkeys(machine.can_ids())
        for key in before:
            if key not in keys:
                self._leave(key, machine)
        for key in keys:
            if key not in before:
                self._join(key, machine)
            elif key in changed:
                place, receivers = self.routes[key].index(machine), self.receivers[key]
                self.receivers[key] = (*receivers[:place], machine.receiver_of(key), *receivers[place + 1 :])
                self._on_change(key)

    def _join(self, key: RoutingKey, machine: Machine) -> None:
        receivers = dict(zip(self.routes.get(key, ()), self.receivers.get(key, ()), strict=True))
        receivers[machine] = machine.receiver_of(key)
        # Sorted by attachment, wherever a machine that changed its CAN-IDs comes from.
        order = tuple(each for each in self._keys if each in receivers) if len(receivers) > 1 else (machine,)
        self.routes[key], self.receivers[key] = order, tuple(receivers[each] for each in order)
        self._on_change(key)

    def _leave(self, key: RoutingKey, machine: Machine) -> None:
        place, machines, receivers = self.routes[key].index(machine), self.routes.pop(key), self.receivers.pop(key)
        if len(machines) > 1:
            self.routes[key] = (*machines[:place], *machines[place + 1 :])
            self.receivers[key] = (*receivers[:place], *receivers[place + 1 :])
        self._on_change(key)

    def _on_change(self, key: RoutingKey) -> None:
        receivers = self.receivers.get(key, ())
        if key < len(self.lone):
            receiver = receivers[0] if len(receivers) == 1 else None
            self.lone[key] = receiver.machine if type(receiver) is Entrance else receiver
        if receivers and self._out.owner is not None:
            self.changed.add(key)
        else:
            self.changed.discard(key)

    def refresh(self) -> None:
        """Apply what the members announced: changed CAN-IDs and nearer deadlines."""
        out = self._out
        while out.rerouted:
            machine = out.rerouted.pop()
            machine._in_rerouted = False
            if machine in self._keys:
                self._route(machine)
        if out.armed:
            for machine in out.armed:
                machine._in_armed = False
                if machine in self._keys:
                    self._sequence += 1
                    heappush(self.heap, (machine._wake, self._sequence, machine))
            out.armed.clear()
            if len(self.heap) > SPARE_WAKES + 2 * len(self._keys):
                self._rebuild_heap()

    def _rebuild_heap(self) -> None:
        self.heap.clear()
        for machine in self._keys:
            if machine._wake < NEVER:
                self._sequence += 1
                self.heap.append((machine._wake, self._sequence, machine))
        heapify(self.heap)

    def next_deadline(self) -> Time:
        """Return the nearest wake that is held: never late, perhaps early."""
        if self._out.armed or self._out.rerouted:
            self.refresh()
        return self.heap[0][0] if self.heap else NEVER

    def handle_timeout(self, now: Time) -> None:
        """Wake each member whose deadline has come, once, in the order of their deadlines."""
        if self._out.armed or self._out.rerouted:
            self.refresh()
        heap = self.heap
        due = []
        while heap and heap[0][0] <= now:
            wake, _, machine = heappop(heap)
            if machine._wake == wake:  # else superseded by a nearer one, or detached
                machine._wake = NEVER
                due.append(machine)
        # Only now, so that a machine that arms itself for a past time does not come up again in this turn.
        for machine in due:
            if machine not in self._keys:
                continue  # detached by what another one did
            if machine.deadline <= now:
                machine.handle_timeout(now)
            else:
                machine._arm(machine.deadline)  # the deadline had moved later


class Settling:
    """Stands around a command of a group: the group then reacts to what its members reported. After an exception it does not."""

    __slots__ = ("_group", "_mark", "_now")

    def __init__(self, group: Group, now: Time) -> None:
        self._group = group
        self._mark = len(group.inner.events)
        self._now = now

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self._group._settle(self._mark, self._now)


@mypyc_attr(allow_interpreted_subclasses=True)
class Group(Machine):
    """A machine made of machines; see this module's text. Members are made with `inner` as their outbox."""

    __slots__ = ("_members", "_reactions", "inner")

    def __init__(self, out: Outbox) -> None:
        super().__init__(out)
        self.inner = Outbox(within=out, owner=self)
        self._members = Members(self.inner)
        self._reactions = self.inner.reactions

    def can_ids(self) -> Iterable[RoutingKey]:
        self._members.refresh()
        return tuple(self._members.routes)

    def take_changed(self) -> Collection[RoutingKey]:
        self._members.refresh()
        changed, self._members.changed = self._members.changed, set()
        return changed

    def receive(self, frame: Frame, now: Time) -> None:
        if self.inner.rerouted:
            self._members.refresh()
        mark = len(self.inner.events)
        for machine in self._members.receivers.get(frame.key, ()):
            machine.receive(frame, now)
        self._settle(mark, now)

    def receiver_of(self, key: RoutingKey) -> Machine:
        """Return the entrance for a key; the group itself if its class has a `receive` of its own, which may want every frame."""
        return self._entrance(key) if type(self).receive is Group.receive else self

    def _entrance(self, key: RoutingKey) -> Machine:
        """Return the entrance for a key; the group itself if several members share the key."""
        machines = self._members.receivers.get(key, ())
        return Entrance(self, machines[0]) if len(machines) == 1 else self

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        mark = len(self.inner.events)
        self._members.handle_timeout(now)
        self._settle(mark, now)
        self._arm(self._members.next_deadline())  # even if it is the old one: the wake for that may just have been used up

    def _settling(self, now: Time) -> Settling:
        """Use it as `with self._settling(now): ...` in every command of a group that makes members report something."""
        return Settling(self, now)

    def _settle(self, mark: int, now: Time) -> None:
        """React to what was reported since `mark`, and to what the reactions report. Every input ends with this.

        Deadlines need nothing here: a member that arms a nearer one arms its group too, see `Machine._arm`.
        """
        events = self.inner.events
        reactions = self._reactions
        while mark < len(events):
            reaction = reactions.get(type(events[mark]))
            if reaction is not None:
                reaction(events[mark], now)
            mark += 1


class Entrance(Machine):
    """Where a group that is a member takes in the frames of one key for one machine: `Group.receive` without its look-up.

    The members around it keep it in their routes, and ask for another one when the group's own routes change. A frame passes one
    for each level, so what is saved here counts: a Network does without it (`Members.lone`). A group may have entrances of its
    own for its commonest frames (`_entrance`).

    machine: the one that it hands the frames to. Read-only.
    """

    __slots__ = ("_events", "_reactions", "machine")

    def __init__(self, group: Group, machine: Machine) -> None:
        super().__init__(group.out)
        self._events = group.inner.events
        self._reactions = group._reactions
        self.machine = machine

    def receive(self, frame: Frame, now: Time) -> None:
        """Hand the frame to the machine, then react to what it reported: `Group._settle`, written out to save the call."""
        events = self._events
        mark = len(events)
        self.machine.receive(frame, now)
        while mark < len(events):
            reaction = self._reactions.get(type(events[mark]))
            if reaction is not None:
                reaction(events[mark], now)
            mark += 1
