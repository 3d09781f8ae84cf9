"""The contract of the core: `Machine`, `Event`, `Outbox`.

Theory of operation
-------------------
Every service of CANopen is a `Machine`: frames and time go in, frames and events come out, and nothing else happens. A machine

- never reads a clock: every input carries `now`, nanoseconds on one monotonic clock that the driver chose;
- never calls anybody: what it has to say it appends to its `Outbox`, in order;
- never raises because of a peer: what a peer does wrong becomes an event. Only a wrong call of our own user raises, always
  `LocalProtocolError`, and then nothing has changed and nothing was sent. *Any other exception is a bug in this library*: that
  sentence is the oracle of every fuzz target.

There are three kinds of method, and no other:

1. inputs: `receive(frame, now)` for a frame that the machine asked for in `can_ids()`; `handle_timeout(now)` at `deadline`;
2. commands: verbs such as `upload(...)`. They only change the machine and append to the outbox. A command with a later outcome
   returns a `RequestId`, and exactly one `Outcome` event with that id follows;
3. getters, which change nothing.

The one driver loop, whatever the framework: 1. mutate (input or command); 2. take `frames, events`; 3. send the frames;
4. deliver the events; 5. wait for a frame, a command, or the deadline. `Network.drain` does step 2 for many machines; a machine
that stands alone is drained by reading and clearing `out.frames` and `out.events`.

A machine works alone (`SdoClient(Outbox(), node_id=12)`), and it works in a `Group` or `Network`, which route frames to it and
wake it. For those it keeps two promises: it enters itself in `out.armed` when its deadline came nearer than the wake that is
held for it, and in `out.rerouted` when its `can_ids()` changed.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar, Final, TypeAlias

from canopen_proto.frame import MAX_NODE_ID, Frame, RoutingKey

Time: TypeAlias = int
"""Nanoseconds on any monotonic clock that the driver chooses. Durations are ns too."""

RequestId: TypeAlias = int
"""Identity of a command with a later outcome; unique within one Outbox (and the outboxes nested in it)."""

NEVER: Final = (1 << 62) - 1
"""No deadline. (Below 2**62, so that it stays an unboxed integer if this is ever compiled.)"""

MICROSECOND: Final = 1_000
MILLISECOND: Final = 1_000_000
SECOND: Final = 1_000_000_000


class LocalProtocolError(Exception):
    """Our own caller broke a rule (a busy client, node-ID 200). Nothing changed and nothing was sent."""


class Event:
    """Something that a machine reports. Plain values only, no references to machines; usable in `match`. Never change one.

    A kind of event is a subclass with its own fields in `__slots__`, all fields in `__match_args__`, and an `__init__` that sets
    all of them itself: the call of another `__init__` would cost as much again. Equality and repr come from here.

    node_id: the node that it is about, 1..127; 0 where it is about the network (SYNC, a procedure) and no single node.
    """

    __slots__ = ("node_id",)
    __match_args__: ClassVar[tuple[str, ...]] = ("node_id",)

    def __init__(self, node_id: int) -> None:
        self.node_id = node_id

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(getattr(self, name) == getattr(other, name) for name in self.__match_args__)

    def __repr__(self) -> str:
        return f"{type(self).__qualname__}({', '.join(f'{name}={value!r}' for name, value in fields_of(self).items())})"


class Outcome(Event):
    """The one answer to a command that returned a RequestId. Never dropped: there are as many as there were requests."""

    __slots__ = ("request_id",)
    __match_args__ = ("node_id", "request_id")

    def __init__(self, node_id: int, request_id: RequestId) -> None:
        self.node_id = node_id
        self.request_id = request_id


class FrameIgnored(Event):
    """A frame that was ours by its CAN-ID made no sense, and was not acted on. reason: one line for people."""

    __slots__ = ("frame", "reason")
    __match_args__ = ("node_id", "frame", "reason")

    def __init__(self, node_id: int, frame: Frame, reason: str) -> None:
        self.node_id = node_id
        self.frame = frame
        self.reason = reason


class Outbox:
    """Where machines put what they have to say. One per network, shared by all its machines, so that order is kept.

    frames, events: what came out, oldest first. armed, rerouted: the machines whose deadline came nearer and whose can_ids
    changed; a machine stands at most once in each. root: what all nested outboxes share.
    """

    __slots__ = ("armed", "events", "frames", "owner", "rerouted", "root")

    def __init__(self, within: Outbox | None = None, owner: Machine | None = None) -> None:
        """A new outbox; or, for a Group, one nested `within` another: the same frames and events, its own armed and rerouted."""
        self.frames: list[Frame] = [] if within is None else within.frames
        self.events: list[Event] = [] if within is None else within.events
        self.armed: list[Machine] = []
        self.rerouted: list[Machine] = []
        self.owner = owner
        self.root: OutboxRoot = OutboxRoot() if within is None else within.root

    @property
    def timestamp(self) -> int | None:
        """What the transport said about the time of the frame that is being handled; events about frames carry it.

        ns of another clock, of unknown origin: information, never compared with `now`. None while no frame is handled. One for
        all nested outboxes; the hottest machines read it as `out.root.timestamp`, which saves this call.
        """
        return self.root.timestamp

    @timestamp.setter
    def timestamp(self, timestamp: int | None) -> None:
        self.root.timestamp = timestamp

    def next_request_id(self) -> RequestId:
        """A number not yet given to a request of this outbox."""
        self.root.request_id += 1
        return self.root.request_id


class OutboxRoot:
    """What all nested outboxes share. request_id: the last one given. timestamp: see `Outbox.timestamp`."""

    __slots__ = ("request_id", "timestamp")

    def __init__(self) -> None:
        self.request_id: RequestId = 0
        self.timestamp: int | None = None


class Machine:
    """A pure state machine; see this module's text for the contract."""

    __slots__ = ("_in_armed", "_in_rerouted", "_wake", "deadline", "out")

    def __init__(self, out: Outbox) -> None:
        self.out = out
        self.deadline: Time = NEVER
        self._wake: Time = NEVER  # the nearest wake that is held for us, by a Group or by whoever empties out.armed
        self._in_armed = False
        self._in_rerouted = False

    def can_ids(self) -> Iterable[RoutingKey]:
        """The keys (`Frame.key`) of the frames that it wants. Changes are announced in `out.rerouted`."""
        return ()

    def receive(self, frame: Frame, now: Time) -> None:
        """Handle a frame whose key is among `can_ids()`. Never raises, whatever the frame holds."""

    def receiver_of(self, key: RoutingKey) -> Machine:
        """Return the machine whose `receive` gets the frames of a key: this one, or one that has done its look-ups already."""
        return self

    def handle_timeout(self, now: Time) -> None:
        """Handle the passing of time. Called early it does nothing; called late it is still right."""

    def _arm(self, deadline: Time) -> None:
        """Set the deadline. A later one than the held wake waits for that wake: the early call does nothing but arm again."""
        self.deadline = deadline
        if deadline < self._wake:
            self._wake = deadline
            if not self._in_armed:
                self._in_armed = True
                self.out.armed.append(self)
            owner = self.out.owner
            if owner is not None and deadline < owner.deadline:
                owner._arm(deadline)

    def _reroute(self) -> None:
        """Announce that `can_ids()` changed."""
        if not self._in_rerouted:
            self._in_rerouted = True
            self.out.rerouted.append(self)
            if self.out.owner is not None:
                self.out.owner._reroute()


def check_node_id(node_id: int) -> int:
    """node_id itself if it is an integer of 1..127, else LocalProtocolError."""
    if not isinstance(node_id, int) or isinstance(node_id, bool):  # it may come from a file or a form: True is no node 1
        raise LocalProtocolError(f"node-ID {node_id!r} is no integer: node-IDs are 1..{MAX_NODE_ID}")
    if 1 <= node_id <= MAX_NODE_ID:
        return node_id
    raise LocalProtocolError(f"node-ID {node_id} is outside 1..{MAX_NODE_ID}")


def fields_of(report: Event) -> dict[str, Any]:
    """An event's fields by name, for logs and JSON."""
    return {name: getattr(report, name) for name in report.__match_args__}
