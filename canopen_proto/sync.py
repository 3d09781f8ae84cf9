"""SYNC: the signal at which synchronous PDOs are sent and taken (CiA 301 v4.2.0, 7.2.5).

The producer sends a frame without data on CAN-ID 0x80 (0x1005), once per communication cycle period (0x1006) or by `send`. With a
synchronous counter overflow value (0x1019) of 2 to 240 the frame has one byte, a counter that runs 1, 2 ... overflow, 1 ..., so
that nodes can send their PDOs in different cycles. 0 means no counter; 1 and 241 to 255 are reserved, and refused.

`SyncProducer` keeps its phase: cycle n is due at start + n * period, however late the driver comes. If the driver is late by a
whole period or more, the producer sends one SYNC, not all missed ones: their cycles are over, and consumers would act twice at
once. `SyncSent.skipped` has their number. The counter counts frames on the bus, so it has no gaps. `start` sends the first SYNC
itself: the standard wants it within one cycle (7.5.2.5).

`SyncConsumer` reports each SYNC. A SYNC of unexpected length becomes `SyncLengthUnexpected` and is otherwise ignored: it has a
counter too many, or none. The node decides whether to send EMCY 0x8240 for it. A counter's value is passed on as it came: the PDO
compares it with its SYNC start value.

Left out: the synchronous window length (0x1007), as it is about the PDOs. The node has two duties. It refuses a change of 0x1019
while a period is set (abort 0x08000022). It stops the producer in STOPPED and INITIALISING, where there is no SYNC, and
starts it again after them, so that it counts from 1.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from canopen_proto.frame import SYNC, Frame, RoutingKey, frame_for_key
from canopen_proto.machine import MICROSECOND, NEVER, Event, FrameIgnored, LocalProtocolError, Machine, Outbox, Time

MAX_COUNTER: Final = 240
"""The largest counter overflow value of 0x1019."""
MIN_PERIOD: Final = MICROSECOND
"""The shortest period: the unit of 0x1006."""


class SyncSent(Event):
    """Our producer's SYNC is in the outbox; node_id is 0.

    counter: its counter, or None. skipped: the number of cycles that were left out before it because the driver came late.
    """

    __slots__ = ("counter", "skipped")
    __match_args__ = ("node_id", "counter", "skipped")

    def __init__(self, node_id: int, counter: int | None, skipped: int) -> None:
        self.node_id = node_id
        self.counter = counter
        self.skipped = skipped


class SyncReceived(Event):
    """A SYNC came; node_id is 0. counter: its counter, or None. timestamp: the transport's, if it has one."""

    __slots__ = ("counter", "timestamp")
    __match_args__ = ("node_id", "counter", "timestamp")

    def __init__(self, node_id: int, counter: int | None, timestamp: int | None) -> None:
        self.node_id = node_id
        self.counter = counter
        self.timestamp = timestamp


class SyncLengthUnexpected(FrameIgnored):
    """A SYNC had another length than 0x1019 says. expected: 0 or 1 byte. (A device may send EMCY 0x8240 for it.) frame: the SYNC.
    reason: for people."""

    __slots__ = ("expected",)
    __match_args__ = ("node_id", "frame", "reason", "expected")

    def __init__(self, node_id: int, frame: Frame, reason: str, expected: int) -> None:
        self.node_id = node_id
        self.frame = frame
        self.reason = reason
        self.expected = expected


def check_counter_overflow(value: int) -> int:
    """Return the value if 0x1019 may hold it (0, 2..240). Raises LocalProtocolError for others. CiA 301 v4.2.0, 7.5.2.22"""
    if value != 0 and not 2 <= value <= MAX_COUNTER:
        raise LocalProtocolError(f"synchronous counter overflow value {value} is neither 0 (no counter) nor 2..{MAX_COUNTER}")
    return value


class SyncProducer(Machine):
    """Sends SYNC, periodically or one at a time.

    key: the routing key of its COB-ID. period: ns, 0 while stopped. counter: of the next SYNC, if it has one. counter_overflow:
    as in 0x1019. All read-only outside.
    """

    __slots__ = ("_put_off", "counter", "counter_overflow", "key", "period")

    def __init__(self, out: Outbox, key: RoutingKey = SYNC, counter_overflow: int = 0) -> None:
        """Take a routing key (`key_of_cob_id`), 11 or 29 bits. LocalProtocolError for a reserved counter overflow value."""
        super().__init__(out)
        self.key = key
        self.counter_overflow = check_counter_overflow(counter_overflow)
        self.counter = 1
        self.period: Time = 0
        self._put_off: Time = NEVER  # when the SYNC was due that is put off

    def configure(self, key: RoutingKey, counter_overflow: int) -> None:
        """Take another COB-ID (0x1005) and counter overflow value (0x1019); LocalProtocolError for a reserved one. key: the
        COB-ID as a routing key. counter_overflow: 0 (no counter) or 2..240.

        The producer stops: a running counter cannot change its range. CiA 301 v4.2.0, 7.5.2.22
        """
        self.counter_overflow = check_counter_overflow(counter_overflow)
        self.key = key
        self.stop()

    def start(self, period: Time, now: Time, counter_overflow: int | None = None) -> None:
        """Send SYNC now and then once per period (ns, 1 us or more); a running producer starts again. The counter starts with 1.

        counter_overflow: 0 or 2..240; None leaves it as it is. Event: SyncSent with each frame. Raises LocalProtocolError for
        other values. CiA 301 v4.2.0, 7.2.5.2, 7.5.2.5, 7.5.2.6 and 7.5.2.22
        """
        if period < MIN_PERIOD:
            raise LocalProtocolError(f"a SYNC period is 1 us or more, not {period} ns; stop() ends it")
        if counter_overflow is not None:
            self.counter_overflow = check_counter_overflow(counter_overflow)
        self.period = period
        self.counter = 1
        self._put_off = NEVER
        self._send(0)
        self._arm(now + period)

    def stop(self) -> None:
        """Stop the periodic SYNC. The counter starts with 1 at its next use."""
        self.period = 0
        self.counter = 1
        self._put_off = NEVER
        self._arm(NEVER)

    def put_off(self) -> None:
        """Send no periodic SYNC until `catch_up`: the driver came late, and has to look at the consumers before."""
        if self.deadline != NEVER:
            self._put_off = self.deadline
            self._arm(NEVER)

    def catch_up(self, now: Time) -> None:
        """Send the SYNC that was put off, if there is one, and go on with the period in its phase. Event: SyncSent."""
        due, self._put_off = self._put_off, NEVER
        if due != NEVER:
            self._arm(due)
            self.handle_timeout(now)

    def send(self, now: Time) -> None:
        """Send one SYNC now. A running period keeps its phase. Event: SyncSent, at once. CiA 301 v4.2.0, 7.2.5.2"""
        self._send(0)

    def handle_timeout(self, now: Time) -> None:
        """Send the due SYNC: only one, however late. Event: SyncSent."""
        if now < self.deadline:
            return
        skipped = (now - self.deadline) // self.period
        self._send(skipped)
        self._arm(self.deadline + (skipped + 1) * self.period)

    def _send(self, skipped: int) -> None:
        if self.counter_overflow:
            counter = self.counter
            self.counter = counter + 1 if counter < self.counter_overflow else 1
            self.out.frames.append(frame_for_key(self.key, bytes((counter,))))
            self.out.events.append(SyncSent(0, counter, skipped))
        else:
            self.out.frames.append(frame_for_key(self.key, b""))
            self.out.events.append(SyncSent(0, None, skipped))


class SyncConsumer(Machine):
    """Reports each SYNC on the bus.

    key: the routing key of its COB-ID. counter_overflow: as in 0x1019; not 0: a counter is expected. Both read-only outside.
    """

    __slots__ = ("counter_overflow", "key")

    def __init__(self, out: Outbox, key: RoutingKey = SYNC, counter_overflow: int = 0) -> None:
        """Take a routing key (`key_of_cob_id`), 11 or 29 bits. LocalProtocolError for a reserved counter overflow value."""
        super().__init__(out)
        self.key = key
        self.counter_overflow = check_counter_overflow(counter_overflow)

    def can_ids(self) -> Iterable[RoutingKey]:
        return (self.key,)

    def configure(self, key: RoutingKey, counter_overflow: int) -> None:
        """Take another COB-ID (0x1005) or counter overflow value (0x1019); LocalProtocolError for a reserved one. key: the COB-ID
        as a routing key. counter_overflow: 0 (no counter) or 2..240."""
        self.counter_overflow = check_counter_overflow(counter_overflow)
        if key != self.key:
            self.key = key
            self._reroute()

    def receive(self, frame: Frame, now: Time) -> None:
        """Take a SYNC. Event: SyncReceived, or SyncLengthUnexpected. CiA 301 v4.2.0, 7.2.5.3"""
        data = frame.data
        expected = 1 if self.counter_overflow else 0
        if len(data) != expected:
            reason = f"a SYNC has {expected} data bytes here, not {len(data)}"
            self.out.events.append(SyncLengthUnexpected(0, frame, reason, expected))
            return
        self.out.events.append(SyncReceived(0, data[0] if data else None, self.out.timestamp))
