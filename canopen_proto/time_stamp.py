"""TIME: one node sends the time of day to the others (CiA 301 v4.2.0, 7.2.6).

The producer sends one frame of six bytes on CAN-ID 0x100 (0x1012): a TIME_OF_DAY, which is 28 bits of milliseconds since
midnight, 4 unused bits, and 16 bits of days since 1984-01-01. There is no answer. Day 65535 is in June of 2163.

`TimeProducer` sends the time that its caller gives, when the caller says: this core has no clock. A frame is a moment old when it
is received; its priority is high, so that the moment is short.

`TimeConsumer` reports the time of each frame. The host uses it (to set a clock, to compare clocks).

The standard names no time zone. Here it is UTC; a device that was set to local time shows by its offset.

Left out: the high resolution time stamp (0x1013), which is a plain object that a PDO may carry.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable

from canopen_proto.datatypes import DataType, ValueRangeError, decode, encode
from canopen_proto.frame import TIME, Frame, RoutingKey, frame_for_key
from canopen_proto.machine import Event, FrameIgnored, Machine, Outbox, Time


class TimeSent(Event):
    """Our producer's TIME is in the outbox; node_id is 0. time: as sent (whole milliseconds, UTC)."""

    __match_args__ = ("node_id", "time")

    def __init__(self, node_id: int, time: datetime.datetime) -> None:
        self.node_id = node_id
        self.time = time


class TimeReceived(Event):
    """A TIME came; node_id is 0. time: in UTC. timestamp: the transport's, if it has one."""

    __match_args__ = ("node_id", "time", "timestamp")

    def __init__(self, node_id: int, time: datetime.datetime, timestamp: int | None) -> None:
        self.node_id = node_id
        self.time = time
        self.timestamp = timestamp


class TimeProducer(Machine):
    """Sends TIME. key: the routing key of its COB-ID; may be set."""

    __slots__ = ("key",)

    def __init__(self, out: Outbox, key: RoutingKey = TIME) -> None:
        """Take a routing key (`key_of_cob_id`), 11 or 29 bits."""
        super().__init__(out)
        self.key = key

    def send(self, time: datetime.datetime, now: Time) -> None:
        """Send TIME once. time: with its time zone, 1984-01-01 to 2163-06-06 UTC; parts of a millisecond are cut off.

        Event: TimeSent, at once. Raises ValueRangeError for another time, or for one without a zone. CiA 301 v4.2.0, 7.2.6.2
        """
        data = encode(time, DataType.TIME_OF_DAY, "TIME")
        self.out.frames.append(frame_for_key(self.key, data))
        self.out.events.append(TimeSent(0, time_of(data)))


class TimeConsumer(Machine):
    """Reports each TIME on the bus. key: the routing key of its COB-ID, None to hear none; read-only outside."""

    __slots__ = ("key",)

    def __init__(self, out: Outbox, key: RoutingKey | None = TIME) -> None:
        """Take a routing key (`key_of_cob_id`), 11 or 29 bits, or None."""
        super().__init__(out)
        self.key = key

    def can_ids(self) -> Iterable[RoutingKey]:
        return () if self.key is None else (self.key,)

    def set_key(self, key: RoutingKey | None) -> None:
        """Take another COB-ID (0x1012); None to hear none. key: the COB-ID as a routing key."""
        if key != self.key:
            self.key = key
            self._reroute()

    def receive(self, frame: Frame, now: Time) -> None:
        """Take a TIME. Event: TimeReceived, or FrameIgnored for a wrong length or an impossible time of day. 7.2.6.3"""
        try:
            time = time_of(frame.data)
        except ValueRangeError as error:
            self.out.events.append(FrameIgnored(0, frame, str(error)))
            return
        self.out.events.append(TimeReceived(0, time, self.out.timestamp))


def time_of(data: bytes) -> datetime.datetime:
    """Return the time of the six bytes of a TIME_OF_DAY, in UTC. Raises ValueRangeError."""
    time = decode(data, DataType.TIME_OF_DAY, "TIME")
    assert isinstance(time, datetime.datetime)
    return time
