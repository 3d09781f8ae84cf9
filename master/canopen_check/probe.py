"""`RawProbe`: sends any frame and keeps those that come with given CAN-IDs, for tests of what no well-behaved machine would send.

It knows nothing of CANopen. What it keeps is bounded: beyond MAX_HEARD frames the oldest are forgotten.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.machine import Event, Machine, Outbox, Time

MAX_HEARD: Final = 10_000
"""Frames kept; ten seconds of heartbeats each millisecond, the most that any case counts."""


class FrameHeard(Event):
    """A frame with one of the probe's keys came. node_id is 0: whose it is, is for the caller to know. at: on the driver's
    clock."""

    __slots__ = ("at", "frame")
    __match_args__ = ("node_id", "frame", "at")

    def __init__(self, node_id: int, frame: Frame, at: Time) -> None:
        self.node_id = node_id
        self.frame = frame
        self.at = at


class RawProbe(Machine):
    """See this module's text. heard: the frames that were not taken yet, oldest first."""

    __slots__ = ("_keys", "heard")

    def __init__(self, out: Outbox, keys: Iterable[int] = ()) -> None:
        """keys: `Frame.key` of what it listens to."""
        super().__init__(out)
        self._keys = tuple(keys)
        self.heard: deque[FrameHeard] = deque(maxlen=MAX_HEARD)

    def can_ids(self) -> Iterable[RoutingKey]:
        return map(RoutingKey, self._keys)

    def listen(self, keys: Iterable[int]) -> None:
        """Listen to these keys from now on, and to no others. What was heard is forgotten."""
        self._keys = tuple(dict.fromkeys(keys))
        self.heard.clear()
        self._reroute()

    def listen_also(self, key: int) -> None:
        """Listen to one more key. What was heard of it is forgotten."""
        self.forget(key)
        if key not in self._keys:
            self._keys = (*self._keys, key)
            self._reroute()

    def send(self, frame: Frame, now: Time) -> None:
        """Put a frame on the bus."""
        self.out.frames.append(frame)

    def take(self, key: int) -> FrameHeard | None:
        """The oldest frame with that key that was not taken yet, or None."""
        for report in self.heard:
            if report.frame.key == key:
                self.heard.remove(report)
                return report
        return None

    def take_all(self, key: int) -> list[FrameHeard]:
        """All frames with that key that were not taken yet, oldest first."""
        taken = [report for report in self.heard if report.frame.key == key]
        self.forget(key)
        return taken

    def forget(self, key: int) -> None:
        """Drop the frames with that key."""
        rest = [report for report in self.heard if report.frame.key != key]
        self.heard.clear()
        self.heard.extend(rest)

    def receive(self, frame: Frame, now: Time) -> None:
        report = FrameHeard(0, frame, now)
        self.heard.append(report)
        self.out.events.append(report)
