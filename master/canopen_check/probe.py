"""`RawProbe`: sends any frame, and keeps the frames with given CAN-IDs: for tests with frames that no other machine would send.

It knows nothing of CANopen. It keeps at most MAX_HEARD frames, and drops the oldest.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

from canopen_proto.frame import ERROR_CONTROL, MAX_NODE_ID, NMT, SDO_CLIENT_TO_SERVER, Frame, RoutingKey
from canopen_proto.machine import Event, Machine, Outbox, Time
from canopen_proto.nmt import ALL_NODES

MAX_HEARD: Final = 10_000
"""The most frames that are kept: ten seconds of heartbeats each millisecond, the most that any case counts."""


class FrameHeard(Event):
    """A frame with one of the probe's routing keys came. node_id is 0: the caller knows the sender. at: on the driver's clock."""

    __slots__ = ("at", "frame")
    __match_args__ = ("node_id", "frame", "at")

    def __init__(self, node_id: int, frame: Frame, at: Time) -> None:
        self.node_id = node_id
        self.frame = frame
        self.at = at


class RawProbe(Machine):
    """Sends and hears raw frames; see this module's text. heard: the frames that were not taken yet, oldest first."""

    __slots__ = ("_keys", "heard")

    def __init__(self, out: Outbox, keys: Iterable[RoutingKey] = ()) -> None:
        """Listen to these routing keys (`Frame.key`)."""
        super().__init__(out)
        self._keys = tuple(keys)
        self.heard: deque[FrameHeard] = deque(maxlen=MAX_HEARD)

    def can_ids(self) -> Iterable[RoutingKey]:
        return self._keys

    def listen(self, keys: Iterable[RoutingKey]) -> None:
        """Listen to these routing keys from now on, and to no others. Drop all frames heard so far."""
        self._keys = tuple(dict.fromkeys(keys))
        self.heard.clear()
        self._reroute()

    def listen_also(self, key: RoutingKey) -> None:
        """Listen to one more routing key. Drop its frames heard so far."""
        self.forget(key)
        if key not in self._keys:
            self._keys = (*self._keys, key)
            self._reroute()

    def send(self, frame: Frame, now: Time) -> None:
        """Put a frame on the bus."""
        self.out.frames.append(frame)

    def take(self, key: RoutingKey) -> FrameHeard | None:
        """Return the oldest frame with this routing key that was not taken yet, or None."""
        for report in self.heard:
            if report.frame.key == key:
                self.heard.remove(report)
                return report
        return None

    def take_all(self, key: RoutingKey) -> list[FrameHeard]:
        """Return all frames with this routing key that were not taken yet, oldest first."""
        taken = [report for report in self.heard if report.frame.key == key]
        self.forget(key)
        return taken

    def forget(self, key: RoutingKey) -> None:
        """Drop the frames with this routing key."""
        rest = [report for report in self.heard if report.frame.key != key]
        self.heard.clear()
        self.heard.extend(rest)

    def receive(self, frame: Frame, now: Time) -> None:
        report = FrameHeard(0, frame, now)
        self.heard.append(report)
        self.out.events.append(report)


class Bystander(Machine):
    """Hears who else is on the bus of the device under test; our own frames are not heard.

    nodes: those that have sent a boot-up or a heartbeat. command: the first frame since `forget` that another master sent to the
    device, by NMT or on its SDO channel; None: there was none.
    """

    __slots__ = ("_addressed", "_keys", "_node_id", "command", "nodes")

    def __init__(self, out: Outbox, node_id: int) -> None:
        """node_id: of the device under test."""
        super().__init__(out)
        self._node_id = node_id
        self._addressed = bytes((ALL_NODES,)), bytes((node_id,))
        self._keys = NMT, RoutingKey(SDO_CLIENT_TO_SERVER + node_id)
        self.nodes: set[int] = set()
        self.command: Frame | None = None

    def can_ids(self) -> Iterable[RoutingKey]:
        others = (RoutingKey(ERROR_CONTROL + each) for each in range(1, MAX_NODE_ID + 1) if each != self._node_id)
        return (*self._keys, *others)

    def forget(self) -> None:
        """Forget the command."""
        self.command = None

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.key not in self._keys:
            self.nodes.add(frame.can_id - ERROR_CONTROL)
        elif self.command is None and (frame.key != NMT or frame.data[1:2] in self._addressed):
            self.command = frame
