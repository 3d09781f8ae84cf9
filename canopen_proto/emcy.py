"""Emergency: a device says what went wrong in it, and when that is over (CiA 301 v4.2.0, 7.2.7).

Theory of operation
-------------------
An emergency frame has 8 bytes: error code (16 bits), the error register 0x1001 as it is now, and 5 bytes that are the
manufacturer's. It goes out once per error event, never again while the error lasts; CAN-ID 0x80 + node-ID (0x1014). The codes'
and bits' meanings are in error_codes.py.

`EmcyProducer` is the device's error memory. Several errors may be there at once; an error is known by its code and its additional
information (the upper half of its entry in 0x1003: two nodes whose heartbeats are lost are two errors with one code).

    error free --raise_error: its code--> error occurred --raise_error: its code--> error occurred
    error occurred --clear, not the last: no frame, the register loses its bits--> error occurred
    error occurred --clear, the last: code 0x0000, register 0--> error free

The frame for a part that is gone is optional (transition 2) and left out: consumers read code 0x0000 as "all is well".

A frame that may not go out yet waits in a bounded queue: until the inhibit time (0x1015) is over, or until EMCY lives again
(`set_enabled`: it does not in STOPPED). Of what waited in STOPPED only the most recent goes out, as 7.3.2.2.4 says; each
frame bears the whole register, and 0x1003 has the rest. If the queue is full, the oldest is dropped and reported.

`EmcyConsumer` reports each frame with its text. A frame that its device cut short is filled up with zeros and not lost, as
long as it has the error code.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Iterable
from typing import Final

from canopen_proto.error_codes import error_text as error_text
from canopen_proto.frame import COB_ID_INVALID, EMCY, Frame, RoutingKey, frame_for_key, key_of_cob_id, routing_key
from canopen_proto.machine import NEVER, Event, FrameIgnored, LocalProtocolError, Machine, Outbox, Time, check_node_id

NO_ERROR: Final = 0x0000
"""The error code of the frame that says: all errors are gone."""
MAX_PENDING: Final = 16
"""Frames that wait for the inhibit time. A device with more errors than that within it has told enough."""
MAX_HISTORY: Final = 254
"""0x1003 has sub-indices 1 to 254."""
MAX_ACTIVE: Final = 254
"""Errors that are there at once: as many as the history can name. A further one is dropped and reported; it does not raise, since
what leads to it may be a peer's doing, such as a PDO of a wrong length."""
VENDOR_BYTES: Final = 5
_RESERVED_BIT: Final = 0x40
_GENERIC_BIT: Final = 0x01

_MESSAGE: Final = struct.Struct("<HB5s")


class EmcySent(Event):
    """Our producer's emergency frame is in the outbox. The fields are those of EmcyReceived."""

    __slots__ = ("code", "error_register", "vendor_data")
    __match_args__ = ("node_id", "code", "error_register", "vendor_data")

    def __init__(self, node_id: int, code: int, error_register: int, vendor_data: bytes) -> None:
        self.node_id = node_id
        self.code = code
        self.error_register = error_register
        self.vendor_data = vendor_data


class EmcyDropped(Event):
    """An emergency of ours will not go out: the oldest of a full queue (it is in the history), or one beyond MAX_ACTIVE."""

    __slots__ = ("code",)
    __match_args__ = ("node_id", "code")

    def __init__(self, node_id: int, code: int) -> None:
        self.node_id = node_id
        self.code = code


class EmcyReceived(Event):
    """A node's emergency frame.

    code: 16 bits; 0x00xx says that errors are gone (all of them if error_register is 0). error_register: 0x1001 as it was
    then (`register_names`). vendor_data: always 5 bytes. text: what the standards say about the code. length: the bytes that
    came; below 8 the rest was filled up with zeros. timestamp: the transport's, if it has one.
    """

    __slots__ = ("code", "error_register", "length", "text", "timestamp", "vendor_data")
    __match_args__ = ("node_id", "code", "error_register", "vendor_data", "text", "length", "timestamp")

    def __init__(
        self, node_id: int, code: int, error_register: int, vendor_data: bytes, text: str, length: int, timestamp: int | None
    ) -> None:
        self.node_id = node_id
        self.code = code
        self.error_register = error_register
        self.vendor_data = vendor_data
        self.text = text
        self.length = length
        self.timestamp = timestamp


class EmcyProducer(Machine):
    """A device's errors: the present ones, the register 0x1001, the history 0x1003, and the frames that tell of them.

    error_register: 0x1001. history: 0x1003 from sub-index 1 on, newest first, additional information << 16 | code. key: the
    routing key of its frames, None if its COB-ID is not valid. inhibit_time: ns. enabled: EMCY lives. All read-only outside.
    """

    __slots__ = ("_active", "_next_free", "_pending", "enabled", "error_register", "history", "inhibit_time", "key", "node_id")

    def __init__(self, out: Outbox, node_id: int, key: RoutingKey | None = None, history_length: int = 8) -> None:
        """node_id: 1..127. key: None for 0x80 + node-ID. history_length: 1..254 entries of 0x1003. Else LocalProtocolError."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        if not 1 <= history_length <= MAX_HISTORY:
            raise LocalProtocolError(f"an error history has 1 to {MAX_HISTORY} entries, not {history_length}")
        self.key: RoutingKey | None = routing_key(EMCY + node_id) if key is None else key
        self.error_register = 0
        self.history: deque[int] = deque(maxlen=history_length)
        self.inhibit_time: Time = 0
        self.enabled = True
        self._active: dict[int, int] = {}  # history entry -> its bits in the error register, oldest first
        self._pending: deque[bytes] = deque()
        self._next_free: Time = -NEVER  # before it, the inhibit time of the last frame runs

    @property
    def active(self) -> tuple[int, ...]:
        """The errors that are there now, oldest first, as entries of the history."""
        return tuple(self._active)

    def raise_error(self, code: int, register_bits: int, vendor_data: bytes, now: Time, additional_info: int = 0) -> None:
        """An error is there: it enters the register and the history, and its frame is sent. Does nothing if it is there already.

        code: 0x0100..0xFFFF. register_bits: of 0x1001 (`register_bits_of(code)`); the generic bit is added. vendor_data: up
        to 5 bytes. additional_info: 16 bits, for the history, and to tell errors of one code apart. Event: EmcySent, at once
        or when the frame may go out. EmcyDropped beyond MAX_ACTIVE errors. Raises LocalProtocolError for values outside
        these. CiA 301 v4.2.0, 7.2.7.1, 7.5.2.2, 7.5.2.4
        """
        _check_error(code, additional_info)
        if not 0 <= register_bits <= 0xFF or register_bits & _RESERVED_BIT:
            raise LocalProtocolError(f"error register bits 0x{register_bits:02X}: bit 6 is reserved, and there are 8")
        if len(vendor_data) > VENDOR_BYTES:
            raise LocalProtocolError(f"an emergency has {VENDOR_BYTES} bytes for the manufacturer, not {len(vendor_data)}")
        error = additional_info << 16 | code
        if error in self._active:
            return
        if len(self._active) == MAX_ACTIVE:
            self.out.events.append(EmcyDropped(self.node_id, code))
            return
        self._active[error] = register_bits | _GENERIC_BIT
        self.error_register |= register_bits | _GENERIC_BIT
        self.history.appendleft(error)
        self._tell(_MESSAGE.pack(code, self.error_register, vendor_data), now)

    def clear(self, code: int, now: Time, additional_info: int = 0) -> None:
        """An error is gone: the register loses the bits that no other error has. With the last one, code 0x0000 is sent.

        Nothing happens if it is not there. Event: EmcySent, with the last one. Raises LocalProtocolError for a code or
        information out of range. CiA 301 v4.2.0, 7.2.7.1, transitions 2 and 4
        """
        _check_error(code, additional_info)
        if self._active.pop(additional_info << 16 | code, None) is None:
            return
        self.error_register = 0
        for bits in self._active.values():
            self.error_register |= bits
        if not self._active:
            self._tell(_MESSAGE.pack(NO_ERROR, 0, b""), now)

    def clear_all(self, now: Time) -> None:
        """All errors are gone (a drive's fault reset): one frame with code 0x0000, none if there was no error. Event: EmcySent"""
        if self._active:
            self._active.clear()
            self.error_register = 0
            self._tell(_MESSAGE.pack(NO_ERROR, 0, b""), now)

    def clear_history(self) -> None:
        """Forget the history, as writing 0 to 0x1003:00 does. The errors themselves stay. CiA 301 v4.2.0, 7.5.2.4"""
        self.history.clear()

    def reset(self) -> None:
        """As after power-on: no error, no history, nothing waiting. Sends nothing. COB-ID, inhibit time and `enabled` stay."""
        self._active.clear()
        self._pending.clear()
        self.history.clear()
        self.error_register = 0
        self._arm(NEVER)

    def set_cob_id(self, cob_id: int, now: Time) -> None:
        """Take a COB-ID as in 0x1014. With bit 31 (not valid) nothing is sent and nothing waits; errors are still kept.

        (That bits 0 to 29 change only while it is not valid is for the dictionary's side to check.) CiA 301 v4.2.0, 7.5.2.17
        """
        if cob_id & COB_ID_INVALID:
            self.key = None
            self._pending.clear()
            self._arm(NEVER)
        else:
            self.key = key_of_cob_id(cob_id)

    def set_inhibit_time(self, inhibit_time: Time, now: Time) -> None:
        """The least time between two emergency frames, in ns (0x1015 counts 100 us); 0 is none. It holds from the next frame on.

        Raises LocalProtocolError if it is negative. CiA 301 v4.2.0, 7.5.2.18
        """
        if inhibit_time < 0:
            raise LocalProtocolError(f"the EMCY inhibit time is {inhibit_time} ns, less than 0")
        self.inhibit_time = inhibit_time

    def set_enabled(self, enabled: bool, now: Time) -> None:
        """Whether EMCY lives in the node's NMT state. When it does again, the most recent frame that waited goes out.

        Event: EmcySent. CiA 301 v4.2.0, 7.3.2.2.4
        """
        if enabled == self.enabled:
            return
        self.enabled = enabled
        if not enabled:
            self._arm(NEVER)
        elif self._pending:
            newest = self._pending.pop()
            self._pending.clear()
            self._tell(newest, now)

    def handle_timeout(self, now: Time) -> None:
        """The inhibit time is over: send the next frame that waits. Late or not, one."""
        if now < self.deadline:
            return
        self._send(self._pending.popleft(), now)
        self._arm(self._next_free if self._pending else NEVER)

    def _tell(self, message: bytes, now: Time) -> None:
        """Send now, or queue; in order, so behind what waits already."""
        if self.key is None:
            return
        if self.enabled and not self._pending and now >= self._next_free:
            self._send(message, now)
            return
        if len(self._pending) == MAX_PENDING:
            self.out.events.append(EmcyDropped(self.node_id, _MESSAGE.unpack(self._pending.popleft())[0]))
        self._pending.append(message)
        if self.enabled:
            self._arm(self._next_free)

    def _send(self, message: bytes, now: Time) -> None:
        assert self.key is not None  # nothing is queued without a COB-ID
        self.out.frames.append(frame_for_key(self.key, message))
        self.out.events.append(EmcySent(self.node_id, *_MESSAGE.unpack(message)))
        self._next_free = now + self.inhibit_time


class EmcyConsumer(Machine):
    """Reports one node's emergencies. last: the last one, or None. key: the routing key of its frames. Read-only outside."""

    __slots__ = ("key", "last", "node_id")

    def __init__(self, out: Outbox, node_id: int, key: RoutingKey | None = None) -> None:
        """node_id: 1..127, else LocalProtocolError. key: None for 0x80 + node-ID."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.key = routing_key(EMCY + node_id) if key is None else key
        self.last: EmcyReceived | None = None

    def can_ids(self) -> Iterable[RoutingKey]:
        return (self.key,)

    def receive(self, frame: Frame, now: Time) -> None:
        """Take an emergency frame. Event: EmcyReceived, or FrameIgnored if it has no error code. CiA 301 v4.2.0, 7.2.7.3"""
        data = frame.data
        length = len(data)
        if length < 2 or length > _MESSAGE.size:
            self.out.events.append(FrameIgnored(self.node_id, frame, f"an emergency has 8 bytes, 2 at least, not {length}"))
            return
        code, error_register, vendor_data = _MESSAGE.unpack(data.ljust(_MESSAGE.size, b"\x00"))
        self.last = EmcyReceived(self.node_id, code, error_register, vendor_data, error_text(code), length, self.out.timestamp)
        self.out.events.append(self.last)


def _check_error(code: int, additional_info: int) -> None:
    if not 0x0100 <= code <= 0xFFFF:
        raise LocalProtocolError(f"error code 0x{code:04X} is outside 0x0100..0xFFFF (0x00xx says that errors are gone)")
    if not 0 <= additional_info <= 0xFFFF:
        raise LocalProtocolError(f"additional information 0x{additional_info:X} has more than 16 bits")
