"""The contract of the core: `Machine`, `Event`, `Outbox`.

Every service of CANopen is a `Machine`: frames and time go in, frames and events come out, and nothing else happens. A machine

- never reads a clock: every input carries `now`, nanoseconds on one monotonic clock that the driver chose;
- never calls its driver: it appends its frames and events to its `Outbox`, in order;
- never raises because of a peer: a peer's fault becomes an event. Only a wrong call of our own user raises, always
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

A machine works alone (`SdoClient(Outbox(), node_id=12)`), and in a `Group` or `Network`, which route frames to it and wake it. It
keeps two promises to them: it enters itself in `out.armed` when its deadline becomes earlier than the wake that is held for it,
and in `out.rerouted` when its `can_ids()` change.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import Any, ClassVar, Final, TypeAlias

from canopen_proto.compiling import mypyc_attr
from canopen_proto.frame import MAX_NODE_ID, Frame, RoutingKey

COMPILED: Final = not __file__.endswith(".py")
"""Whether this is the compiled build of the core (docs/compiled.md)."""

Time: TypeAlias = int
"""Nanoseconds on any monotonic clock that the driver chooses. Durations are ns too."""

RequestId: TypeAlias = int
"""Identity of a command with a later outcome; unique within one Outbox (and the outboxes nested in it)."""

NEVER: Final = (1 << 62) - 1
"""No deadline. (Below 2**62, so that it stays an unboxed integer if this is ever compiled.)"""

MICROSECOND: Final = 1_000
MILLISECOND: Final = 1_000_000
SECOND: Final = 1_000_000_000


@mypyc_attr(native_class=False)
class LocalProtocolError(Exception):
    """Our own caller broke a rule (a busy client, node-ID 200). Nothing changed and nothing was sent."""


@mypyc_attr(allow_interpreted_subclasses=True)
class Event:
    """A report of a machine. It holds plain values, no references to machines, and works in `match`. Never change an event.

    A kind of event is a subclass with all fields in `__match_args__`, and an `__init__` that sets all of them itself: the call of
    another `__init__` would cost as much again. A kind of which many are made has its own fields in `__slots__` too. Equality and
    repr come from here.

    It is no data class, and each reason was measured. With `dataclasses`, the start of a network takes 28 ms instead of 20, and a
    class 105 us instead of 7. In the compiled build an event takes 155 ns instead of 28, for its `__init__` would be Python. Rare
    kinds alone cannot be data classes: the compiler fails on a data class whose base has an `__init__` of its own.

    node_id: the node that it is about, 1..127; 0 if it is about the network (SYNC, a procedure), not one node. is_usual: of this
    kind, one may come with each frame of the usual traffic; a quiet network leaves them out (`Network.quiet`).
    """

    __slots__ = ("node_id",)
    __match_args__: ClassVar[tuple[str, ...]] = ("node_id",)
    is_usual: ClassVar[bool] = False

    def __init__(self, node_id: int) -> None:
        self.node_id = node_id

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return all(getattr(self, name) == getattr(other, name) for name in self.__match_args__)

    def __repr__(self) -> str:
        return f"{type(self).__qualname__}({', '.join(f'{name}={value!r}' for name, value in fields_of(self).items())})"


@mypyc_attr(allow_interpreted_subclasses=True)
class Outcome(Event):
    """The one answer to a command that returned a RequestId. It is never dropped: every request gets exactly one. request_id: the
    one that the command returned."""

    __slots__ = ("request_id",)
    __match_args__ = ("node_id", "request_id")

    def __init__(self, node_id: int, request_id: RequestId) -> None:
        self.node_id = node_id
        self.request_id = request_id


@mypyc_attr(allow_interpreted_subclasses=True)
class FrameIgnored(Event):
    """A frame with one of our CAN-IDs made no sense and was ignored. reason: one line for people."""

    __slots__ = ("frame", "reason")
    __match_args__ = ("node_id", "frame", "reason")

    def __init__(self, node_id: int, frame: Frame, reason: str) -> None:
        self.node_id = node_id
        self.frame = frame
        self.reason = reason


Reaction: TypeAlias = Callable[[Any, Time], None]
"""What a group does with an event of one of its members: it is called with the event and the time."""


class Outbox:
    """Takes the frames and events of machines. All machines of a network share one, so that the order is kept.

    frames, events: oldest first. armed, rerouted: the machines whose deadline became earlier, and whose can_ids changed; each
    machine is in each list at most once. reactions: by kind of event, what the owner does when its members report it; empty
    without an owner. root: the part that all nested outboxes share.
    """

    __slots__ = ("armed", "events", "frames", "owner", "reactions", "rerouted", "root")

    def __init__(self, within: Outbox | None = None, owner: Machine | None = None) -> None:
        """Make an outbox; for a Group, one nested `within` another: the same frames and events, its own armed and rerouted.
        owner: the Group, told when one of its members is armed or rerouted."""
        self.frames: list[Frame] = [] if within is None else within.frames
        self.events: list[Event] = [] if within is None else within.events
        self.armed: list[Machine] = []
        self.rerouted: list[Machine] = []
        self.owner = owner
        self.reactions: dict[type[Event], Reaction] = {}
        self.root: OutboxRoot = OutboxRoot() if within is None else within.root

    @property
    def timestamp(self) -> int | None:
        """The transport's timestamp of the frame that is being handled; events about frames carry it.

        In ns of another clock, of unknown origin: for information, never compared with `now`. None while no frame is handled. All
        nested outboxes share it; the hottest machines read it as `out.root.timestamp`, which saves this call.
        """
        return self.root.timestamp

    @timestamp.setter
    def timestamp(self, timestamp: int | None) -> None:
        self.root.timestamp = timestamp

    def next_request_id(self) -> RequestId:
        """Return a number that no request of this outbox has yet."""
        self.root.request_id += 1
        return self.root.request_id


class OutboxRoot:
    """The part that all nested outboxes share. request_id: the last one given. timestamp: see `Outbox.timestamp`. quiet: nobody
    asks for PdoReceived and HeartbeatReceived of the frame that is being handled, see `Network.receive_many`."""

    __slots__ = ("quiet", "request_id", "timestamp")

    def __init__(self) -> None:
        self.request_id: RequestId = 0
        self.timestamp: int | None = None
        self.quiet = False


@mypyc_attr(allow_interpreted_subclasses=True)
class Machine:
    """A pure state machine; see this module's text for the contract."""

    __slots__ = ("_in_armed", "_in_rerouted", "_is_attached", "_wake", "deadline", "out")

    def __init__(self, out: Outbox) -> None:
        self.out = out
        self._is_attached = False
        self.deadline: Time = NEVER
        self._wake: Time = NEVER  # the earliest wake held for this machine, by its Group or its driver
        self._in_armed = False
        self._in_rerouted = False

    def can_ids(self) -> Iterable[RoutingKey]:
        """Return the routing keys (`Frame.key`) of the frames that it wants. It announces changes in `out.rerouted`."""
        return ()

    def check_beside(self, others: Iterable[Machine]) -> None:
        """Raise LocalProtocolError if it cannot be in one network with those that are attached."""

    def receive(self, frame: Frame, now: Time) -> None:
        """Handle a frame whose routing key is among `can_ids()`. Never raises, whatever the frame holds."""

    def receiver_of(self, key: RoutingKey) -> Machine:
        """Return the machine whose `receive` gets the frames with a routing key: itself, or one with the look-ups done."""
        return self

    def take_changed(self) -> Collection[RoutingKey]:
        """Return the keys, of those it wanted before, whose `receiver_of` became another one since this was last asked."""
        return ()

    def handle_timeout(self, now: Time) -> None:
        """Act on the time that has passed. An early call does nothing; a late call is still right."""

    def _arm(self, deadline: Time) -> None:
        """Set the deadline. If it is later than the held wake, that wake stays: the early call only arms again."""
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


def check_node_id(node_id: object) -> int:
    """Return node_id if it is an integer of 1..127. Raises LocalProtocolError for any other."""
    if not isinstance(node_id, int) or isinstance(node_id, bool):  # it may come from a file or a form: True is not node 1
        raise LocalProtocolError(f"node-ID {node_id!r} is not an integer: node-IDs are 1..{MAX_NODE_ID}")
    if 1 <= node_id <= MAX_NODE_ID:
        return node_id
    raise LocalProtocolError(f"node-ID {node_id} is outside 1..{MAX_NODE_ID}")


def fields_of(report: Event) -> dict[str, Any]:
    """Return an event's fields by name, for logs and JSON."""
    return {name: getattr(report, name) for name in report.__match_args__}
