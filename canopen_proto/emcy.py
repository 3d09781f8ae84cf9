"""Emergency: a device reports an error, and its end (CiA 301 v4.2.0, 7.2.7).

An emergency frame has 8 bytes: error code (16 bits), the present error register 0x1001, and 5 bytes of the manufacturer. It is
sent once per error event, and not again while the error lasts; CAN-ID 0x80 + node-ID (0x1014). error_codes.py has the meanings of
codes and bits.

`EmcyProducer` is the device's error memory. Several errors may be present at once. An error is identified by its code and its
additional information (the upper half of its entry in 0x1003: two nodes whose heartbeats are lost are two errors with one code).

    error free --raise_error: its code--> error occurred --raise_error: its code--> error occurred
    error occurred --clear, not the last: no frame, the register loses its bits--> error occurred
    error occurred --clear, the last: code 0x0000, register 0--> error free

The frame for the end of one error among several is optional (transition 2) and not sent: consumers read code 0x0000 as "all is
well".

A frame that may not be sent yet waits in a bounded queue until the inhibit time (0x1015) is over, or until EMCY is enabled again
(`set_enabled`; in STOPPED it is not). Of what waited in STOPPED only the most recent error that is still present is sent, as
7.3.2.2.4 says, with the register as it is then; 0x1003 has the rest. If none is present any more, the frame for their end is
sent. If the queue is full, the oldest frame is dropped and reported.

`EmcyConsumer` reports each frame with its text. A frame that is too short but has the error code is filled up with zeros.
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
"""The error code of the frame that means: all errors are gone."""
MAX_PENDING: Final = 16
"""The most frames that wait for the inhibit time. More errors in so short a time need not all be sent."""
MAX_HISTORY: Final = 254
"""0x1003 has sub-indices 1 to 254."""
MAX_ACTIVE: Final = 254
"""The most errors that can be present at once: as many as the history can name. A further one is dropped and reported. It raises
nothing, since a peer may cause it, for example by a PDO of a wrong length."""
VENDOR_BYTES: Final = 5
_RESERVED_BIT: Final = 0x40
_GENERIC_BIT: Final = 0x01

_MESSAGE: Final = struct.Struct("<HB5s")


class EmcySent(Event):
    """Our producer's emergency frame is in the outbox. code, error_register, vendor_data: as in EmcyReceived."""

    __match_args__ = ("node_id", "code", "error_register", "vendor_data")

    def __init__(self, node_id: int, code: int, error_register: int, vendor_data: bytes) -> None:
        self.node_id = node_id
        self.code = code
        self.error_register = error_register
        self.vendor_data = vendor_data


class EmcyDropped(Event):
    """An emergency of ours will not be sent: the oldest of a full queue (it is in the history), or one beyond MAX_ACTIVE. code:
    its emergency error code, 16 bits."""

    __match_args__ = ("node_id", "code")

    def __init__(self, node_id: int, code: int) -> None:
        self.node_id = node_id
        self.code = code


class EmcyReceived(Event):
    """A node sent an emergency frame.

    code: 16 bits; 0x00xx means that errors are gone (all of them if error_register is 0). error_register: 0x1001 at that time
    (`register_names`). vendor_data: always 5 bytes. text: the standards' name for the code. length: the number of bytes that
    came; below 8 the rest was filled up with zeros. timestamp: the transport's, if it has one.
    """

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
    """A device's errors: the present ones, the register 0x1001, the history 0x1003, and the frames that report them.

    error_register: 0x1001. history: 0x1003 from sub-index 1 on, newest first, additional information << 16 | code. key: the
    routing key of its frames, None if its COB-ID is not valid. inhibit_time: ns. enabled: whether the NMT state allows EMCY. All
    read-only outside.
    """

    __slots__ = ("_active", "_next_free", "_pending", "enabled", "error_register", "history", "inhibit_time", "key", "node_id")

    def __init__(self, out: Outbox, node_id: int, key: RoutingKey | None = None, history_length: int = 8) -> None:
        """Make a producer without errors. node_id: 1..127. key: its routing key, None for 0x80 + node-ID. history_length: 1..254
        entries of 0x1003. Raises LocalProtocolError for other values."""
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
        self._pending: deque[tuple[int, bytes]] = deque()  # the error, as in the history, and its frame
        self._next_free: Time = -NEVER  # until then, the inhibit time of the last frame runs

    @property
    def active(self) -> tuple[int, ...]:
        """The present errors, oldest first, as entries of the history."""
        return tuple(self._active)

    def raise_error(self, code: int, register_bits: int, vendor_data: bytes, now: Time, additional_info: int = 0) -> None:
        """Add an error to the register and the history, and send its frame. Does nothing if the error is already present.

        code: 0x0100..0xFFFF. register_bits: of 0x1001 (`register_bits_of(code)`); the generic bit is added. vendor_data: up
        to 5 bytes. additional_info: 16 bits, for the history; distinguishes errors with the same code. Event: EmcySent, at
        once or when the frame may be sent; EmcyDropped beyond MAX_ACTIVE errors. Raises LocalProtocolError for other values.
        CiA 301 v4.2.0, 7.2.7.1, 7.5.2.2, 7.5.2.4
        """
        _check_error(code, additional_info)
        if not 0 <= register_bits <= 0xFF or register_bits & _RESERVED_BIT:
            raise LocalProtocolError(f"error register bits 0x{register_bits:02X}: bit 6 is reserved, and only bits 0 to 7 exist")
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
        self._tell(error, _MESSAGE.pack(code, self.error_register, vendor_data), now)

    def clear(self, code: int, now: Time, additional_info: int = 0) -> None:
        """Remove an error: the register loses the bits that no other error has. With the last error, code 0x0000 is sent. code,
        additional_info: as they were raised.

        Does nothing if the error is not present. Event: EmcySent, with the last error. Raises LocalProtocolError for a code or
        information out of range. CiA 301 v4.2.0, 7.2.7.1, transitions 2 and 4
        """
        _check_error(code, additional_info)
        if self._active.pop(additional_info << 16 | code, None) is None:
            return
        self.error_register = 0
        for bits in self._active.values():
            self.error_register |= bits
        if not self._active:
            self._tell(NO_ERROR, _MESSAGE.pack(NO_ERROR, 0, b""), now)

    def clear_history(self) -> None:
        """Forget the history, as writing 0 to 0x1003:00 does. The errors themselves stay. CiA 301 v4.2.0, 7.5.2.4"""
        self.history.clear()

    def reset(self) -> None:
        """Go back to the state after power-on: no error, no history, no frame waiting. Sends nothing. COB-ID, inhibit time and
        `enabled` stay."""
        self._active.clear()
        self._pending.clear()
        self.history.clear()
        self.error_register = 0
        self._arm(NEVER)

    def set_cob_id(self, cob_id: int, now: Time) -> None:
        """Take a COB-ID as in 0x1014. With bit 31 (not valid) nothing is sent and no frame waits; errors are still kept.

        (Bits 0 to 29 may change only while it is not valid: the dictionary's side checks that.) CiA 301 v4.2.0, 7.5.2.17
        """
        if cob_id & COB_ID_INVALID:
            self.key = None
            self._pending.clear()
            self._arm(NEVER)
        else:
            self.key = key_of_cob_id(cob_id)

    def set_inhibit_time(self, inhibit_time: Time, now: Time) -> None:
        """Set the least time between two emergency frames, in ns (0x1015 counts 100 us), from the next frame on; 0: none.

        Raises LocalProtocolError if it is negative. CiA 301 v4.2.0, 7.5.2.18
        """
        if inhibit_time < 0:
            raise LocalProtocolError(f"the EMCY inhibit time is {inhibit_time} ns, less than 0")
        self.inhibit_time = inhibit_time

    def set_enabled(self, enabled: bool, now: Time) -> None:
        """Set whether the node's NMT state allows EMCY. When it does again, the most recent of the waiting frames that is still
        true is sent.

        Event: EmcySent. CiA 301 v4.2.0, 7.3.2.2.4 ("the most recent active EMCY reason")
        """
        if enabled == self.enabled:
            return
        self.enabled = enabled
        if not enabled:
            self._arm(NEVER)
            return
        self._drop_past()
        if self._pending:
            error, newest = self._pending.pop()
            self._pending.clear()
            code, _, vendor_data = _MESSAGE.unpack(newest)
            self._tell(error, _MESSAGE.pack(code, self.error_register, vendor_data), now)

    def handle_timeout(self, now: Time) -> None:
        """Send the next frame that waits: the inhibit time is over. Send only one, however late."""
        if now < self.deadline:
            return
        self._send(self._pending.popleft()[1], now)
        self._arm(self._next_free if self._pending else NEVER)

    def _tell(self, error: int, message: bytes, now: Time) -> None:
        """Send the frame of an error now, or queue it after those that wait already."""
        if self.key is None:
            return
        if not self.enabled:
            self._drop_past()
        if self.enabled and not self._pending and now >= self._next_free:
            self._send(message, now)
            return
        if len(self._pending) == MAX_PENDING:
            self.out.events.append(EmcyDropped(self.node_id, _MESSAGE.unpack(self._pending.popleft()[1])[0]))
        self._pending.append((error, message))
        if self.enabled:
            self._arm(self._next_free)

    def _drop_past(self) -> None:
        """Drop the waiting frames about errors that are gone, and of an end of all errors if there are new ones."""
        present = self._active or (NO_ERROR,)
        self._pending = deque(each for each in self._pending if each[0] in present)

    def _send(self, message: bytes, now: Time) -> None:
        assert self.key is not None  # without a COB-ID no frame is queued
        self.out.frames.append(frame_for_key(self.key, message))
        self.out.events.append(EmcySent(self.node_id, *_MESSAGE.unpack(message)))
        self._next_free = now + self.inhibit_time


class EmcyConsumer(Machine):
    """Reports one node's emergencies. last: the last one, or None. key: the routing key of its frames. Read-only outside."""

    __slots__ = ("key", "last", "node_id")

    def __init__(self, out: Outbox, node_id: int, key: RoutingKey | None = None) -> None:
        """Hear a node. node_id: 1..127, else LocalProtocolError. key: the routing key, None for 0x80 + node-ID."""
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
