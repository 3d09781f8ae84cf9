"""SDO server: lets a client read (upload) and write (download) the objects of a device. CiA 301 v4.2.0, 7.2.4.

Theory of operation
-------------------
A server has one channel, a pair of COB-IDs, and at most one transfer under way on it. What the objects are and hold is the
business of an `ObjectStore`, which is asked

- at an initiate upload for the value: up to 4 bytes go expedited, more (and none at all) in segments out of that one copy;
- at an initiate download in segments whether the object may be written, with the size if it is announced; and to write once
  all of it is there (which is at once if it is expedited).

The store may say `PENDING`: only the host can serve the object (it stores parameters, it computes a value). Then
ObjectAccessPending goes out, the answer is held, and the host says `complete(access_id, ...)`. A host that stays silent for
`access_timeout` costs the transfer.

So that a large object (a DOMAIN: firmware, a log) never has to be held whole, it may go in pieces, by block and by segmented
transfer. Where `check_write` says PENDING, the host gets what is downloaded piece by piece (about 890 bytes, each in an
ObjectAccessPending, the last one with more = False), and the client waits until it has taken each. A read goes in pieces if the
host gives the first one with `more=True`; it is then asked for the others in turn.

A new initiate request takes the place of a running transfer; an abort ends it, whatever object it names (field clients send
0x0000:00). A segment request without a transfer is answered by an abort for 0x0000:00. Block transfer: see block.py.
Where a block download ends before its time (our abort, an NMT reset), segments may still be in the client's queue, and come much
later. The one with number 0x23 would be taken for an expedited download of whatever object its data name. So segments that go on
where the last one stopped are ignored until something else comes.

CAN can deliver a frame twice. The second copy of a segment is told by its toggle and ignored, once; any other wrong toggle, or a
third, is an abort. The second copy of an initiate is served once more (a client that repeats its request after a lost answer
looks just the same), unless its answer is with the host: two copies of "store parameters" store once.

SDO lives in the NMT states pre-operational and operational only (CiA 301 v4.2.0, 7.3.2.3): `disable` and `enable` it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import NEVER, Outbox, Time
from canopen_proto.sdo.access import PENDING, ObjectStore, Pending
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, MAX_BURST, MAX_SIZE, SUB_BLOCK_SIZE, is_initiate
from canopen_proto.sdo.block_server import (
    BlockServerDownload,
    BlockServerUpload,
    announced_size,
    may_switch,
)
from canopen_proto.sdo.codec import (
    BLOCK_UPLOAD,
    DOWNLOAD_SEGMENT,
    EXPEDITED,
    EXPEDITED_BIT,
    EXPEDITED_BITS,
    INITIATE,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD_RESPONSE,
    LAST,
    LEAST_REQUEST,
    MAX_EXPEDITED,
    MULTIPLEXER,
    SIZE,
    SIZE_BIT,
    SPECIFIER,
    TOGGLE,
    UPLOAD_SEGMENT,
    complete,
    segment,
)
from canopen_proto.sdo.events import ObjectAccessPending, ObjectWritten, SdoServerAborted
from canopen_proto.sdo.server_base import ACCESS_TIMEOUT, MAX_DOWNLOAD, TIMEOUT, ServerBase
from canopen_proto.sdo.server_base import IDLE as _IDLE

__all__ = [
    "ACCESS_TIMEOUT", "MAX_DOWNLOAD", "PENDING", "TIMEOUT", "ObjectAccessPending", "ObjectStore", "ObjectWritten", "Pending",
    "SdoServer", "SdoServerAborted",
]  # fmt: skip

# States; 0 is IDLE
_UPLOADING: Final = 1
_DOWNLOADING: Final = 2
_AWAITING_HOST: Final = 3
_AWAITING_PIECE: Final = 4  # the host, in the middle of a segmented transfer
_BLOCK: Final = 5

_UNKNOWN_SIZE: Final = -1


class SdoServer(ServerBase):
    """The server of one SDO channel; see this module's text."""

    __slots__ = (
        "_announced", "_block_request", "_buffer", "_command", "_content", "_limit", "_offset", "_transfer",
    )  # fmt: skip

    def __init__(
        self,
        out: Outbox,
        node_id: int,
        store: ObjectStore,
        *,
        request_key: int | None = None,
        response_key: int | None = None,
        timeout: Time = TIMEOUT,
        access_timeout: Time = ACCESS_TIMEOUT,
        max_download: int = MAX_DOWNLOAD,
        copy_guard: Time = 0,
        crc: bool = True,
        block_size: int = MAX_BLOCK_SIZE,
        max_burst: int = MAX_BURST,
        burst_interval: Time = 0,
    ) -> None:
        """node_id: our own. request_key, response_key: the channel (client to server, server to client) as `Frame.key`; the first
        one by default. timeout, access_timeout: ns. max_download: bytes, of what does not go in pieces. It starts enabled.

        For block transfer: crc, if the client has it too; block_size: segments (1..127) that we take in one sub-block; max_burst,
        burst_interval: segments (1 or more) that go out in one turn, and ns between two turns; copy_guard: ns between an
        acknowledgement and the next sub-block (see block.py). All may be changed later.
        """
        super().__init__(out, node_id, store, request_key, response_key)
        self.timeout = timeout
        self.access_timeout = access_timeout
        self.max_download = max_download
        self.copy_guard = copy_guard
        self.crc = crc
        self.block_size = block_size
        self.max_burst = max_burst
        self.burst_interval = burst_interval
        # The transfer under way
        self._command = 0  # the command byte of a plain segment with the toggle that is due
        self._content = b""  # to upload
        self._offset = 0  # uploaded so far
        self._buffer = bytearray()  # downloaded so far
        self._announced = _UNKNOWN_SIZE
        self._limit = 0  # of _buffer
        self._transfer: BlockServerUpload | BlockServerDownload | None = None
        self._block_request = b""  # the initiate request of a block upload; empty: it is a normal one

    # ---- inputs ----

    def receive(self, frame: Frame, now: Time) -> None:
        if not self.enabled:
            return
        data = frame.data
        if len(data) != 8:
            completed = complete(data, LEAST_REQUEST)
            if completed is None:
                self._ignore(frame, "too short for an SDO request")
                return
            data = completed
        command = data[0]
        state = self._state
        if state == _IDLE:
            if self._straggler and self._is_straggler(command, frame):
                return
        elif state == _UPLOADING:
            if command & ~0x0F == self._command:
                self._on_upload_segment(command, data, now)
                return
        elif state == _DOWNLOADING:
            if command & ~0x0F == self._command:
                self._on_download_segment(command, data, now)
                return
        elif state == _BLOCK:
            assert self._transfer is not None
            self._transfer.receive(command, data, frame, now)
            return
        _HANDLERS[command >> 5](self, command, data, frame, now)

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        if self._transfer is not None:
            self._transfer.handle_timeout(now)
        elif self._state in (_AWAITING_HOST, _AWAITING_PIECE):
            self._abort(AbortCode.CANNOT_TRANSFER, AbortOrigin.TIMEOUT)
        elif not self._last:  # what we took for a copy was all that came: the client does not alternate its toggle
            self._abort(AbortCode.TOGGLE_NOT_ALTERNATED, AbortOrigin.TIMEOUT)
        else:
            self._abort(AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT)

    # ---- upload ----

    def _on_initiate_upload(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.6; and of a block upload: 7.2.4.3.13"""
        if self._state != _IDLE and not self._replace(data, frame):
            return
        self._index, self._subindex = MULTIPLEXER.unpack(data)
        self._last = data
        if command < BLOCK_UPLOAD:
            self._block_request = b""
        elif 1 <= data[4] <= MAX_BLOCK_SIZE:
            self._block_request = data
        else:
            self._abort(AbortCode.INVALID_BLOCK_SIZE)
            return
        content = self._store.read(self._index, self._subindex, now)
        if isinstance(content, bytes):
            self._respond_upload(content, now)
        elif isinstance(content, Pending):
            self._state = _AWAITING_HOST
            self._handed = 0
            self._ask_for_piece()
            self._arm(now + self.access_timeout)
        else:
            self._abort(content)

    def _on_given(self, piece: bytes, more: bool, size: int | None, now: Time) -> None:
        """The host's answer."""
        self._handed += len(piece)
        if isinstance(self._transfer, BlockServerUpload):
            self._transfer.extend(piece, not more, now)
        elif self._state == _AWAITING_HOST:
            self._state = _IDLE
            self._respond_upload(piece, now, more, size)
        else:
            self._content = self._content[self._offset :] + piece
            self._offset = 0
            self._more = more
            self._state = _UPLOADING
            self._on_upload_segment(self._command, bytes((self._command,)).ljust(8, b"\x00"), now)

    def _respond_upload(self, content: bytes, now: Time, more: bool = False, whole: int | None = None) -> None:
        """With the whole object, or with the first piece of it."""
        size = len(content)
        request = self._block_request
        if request and (more or not may_switch(request, size)):
            self._state = _BLOCK
            self._transfer = BlockServerUpload(self, request, content, more, whole, now)
            return
        if 0 < size <= MAX_EXPEDITED and not more:
            command = INITIATE_UPLOAD_RESPONSE | EXPEDITED_BITS[size]
            payload = EXPEDITED.pack(command, self._index, self._subindex, content)
            self.out.frames.append(Frame(self._send_can_id, payload, self._send_flags, 8))
            self.deadline = NEVER
            return
        announced = whole if more else size
        command = INITIATE_UPLOAD_RESPONSE if announced is None else INITIATE_UPLOAD_RESPONSE | SIZE_BIT
        self._send(INITIATE.pack(command, self._index, self._subindex, announced or 0))
        self._state = _UPLOADING
        self._more = more
        self._command = UPLOAD_SEGMENT
        self._content = content
        self._offset = 0
        self._arm(now + self.timeout)

    def _on_upload_segment(self, command: int, data: bytes, now: Time) -> None:
        """A request with the right toggle; CiA 301 v4.2.0, 7.2.4.3.7"""
        content = self._content
        offset = self._offset
        if self._more and len(content) - offset <= 7:  # the segment may be the last one, or not
            self._last = data
            self._state = _AWAITING_PIECE
            self._ask_for_piece()
            self._arm(now + self.access_timeout)
            return
        payload = segment(command & TOGGLE, content, offset)
        self.out.frames.append(Frame(self._send_can_id, payload, self._send_flags, 8))
        self._offset = offset = offset + 7
        if offset >= len(content):
            self._become_idle()
            return
        self._last = data
        self._command ^= TOGGLE
        self.deadline = deadline = now + self.timeout
        if deadline < self._wake:
            self._arm(deadline)

    # ---- download ----

    def _on_initiate_download(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.3"""
        if self._state != _IDLE and not self._replace(data, frame):
            return
        _, index, subindex, announced = INITIATE.unpack(data)
        self._index = index
        self._subindex = subindex
        self._last = data
        if command & EXPEDITED_BIT:
            unused = command >> 2 & 3 if command & SIZE_BIT else self._surplus(index, subindex)
            payload = INITIATE.pack(INITIATE_DOWNLOAD_RESPONSE, index, subindex, 0)
            answer = Frame(self._send_can_id, payload, self._send_flags, 8)
            self._write(data[4 : 8 - unused], answer, now)
            return
        size = announced if command & SIZE_BIT else None
        if not self._may_download(size):
            return
        self._send(INITIATE.pack(INITIATE_DOWNLOAD_RESPONSE, index, subindex, 0))
        self._announced = _UNKNOWN_SIZE if size is None else size
        self._limit = size if size is not None else MAX_SIZE if self._in_pieces else self.max_download
        self._state = _DOWNLOADING
        self._command = DOWNLOAD_SEGMENT
        self._arm(now + self.timeout)

    def _on_initiate_block_download(self, data: bytes, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.9"""
        self._index, self._subindex = MULTIPLEXER.unpack(data)
        self._last = data
        size = announced_size(data)
        if self._may_download(size):
            self._state = _BLOCK
            self._transfer = BlockServerDownload(self, data, size, self._in_pieces, now)

    def _may_download(self, size: int | None) -> bool:
        """Ask the store, and abort if it refuses. size: None if it is not announced."""
        refusal = self._store.check_write(self._index, self._subindex, size)
        self._in_pieces = isinstance(refusal, Pending)
        self._handed = 0
        if isinstance(refusal, AbortCode):
            self._abort(refusal)
            return False
        if size is not None and size > self.max_download and not self._in_pieces:
            self._abort(AbortCode.OUT_OF_MEMORY)
            return False
        return True

    def _surplus(self, index: int, subindex: int) -> int:
        """How many of four bytes of unspecified size are too many for the object."""
        for unused in (0, 1, 2, 3):
            if not isinstance(self._store.check_write(index, subindex, 4 - unused), AbortCode):
                return unused
        return 0

    def _on_download_segment(self, command: int, data: bytes, now: Time) -> None:
        """A segment with the right toggle; CiA 301 v4.2.0, 7.2.4.3.4"""
        buffer = self._buffer
        if command == self._command:
            buffer += data[1:]
        else:
            unused = command >> 1 & 7
            buffer += data[1 : 8 - unused]
        acknowledgement = self._acknowledgements[command & TOGGLE]
        if len(buffer) > self._limit:
            known = self._announced != _UNKNOWN_SIZE
            self._abort(AbortCode.LENGTH_TOO_HIGH if known else AbortCode.OUT_OF_MEMORY)
        elif not command & LAST:
            if command & 0x0E == 0x0E:  # no data and yet not the last: without this a transfer might never end
                self._abort(AbortCode.INVALID_COMMAND)
                return
            self._last = data
            self._command ^= TOGGLE
            if self._in_pieces and len(buffer) >= SUB_BLOCK_SIZE:
                self._await_piece(acknowledgement, now)
                return
            self.out.frames.append(acknowledgement)
            self.deadline = deadline = now + self.timeout
            if deadline < self._wake:
                self._arm(deadline)
        elif len(buffer) < self._announced:
            self._abort(AbortCode.LENGTH_TOO_LOW)
        else:
            self._last = data
            if self._in_pieces:
                self._await_host(bytes(buffer), acknowledgement, now, self._handed)
            else:
                self._write(bytes(buffer), acknowledgement, now)

    def _await_piece(self, acknowledgement: Frame, now: Time) -> None:
        """The host gets what came so far of a segmented download; the segment is acknowledged once it has taken that."""
        piece, self._buffer = bytes(self._buffer), bytearray()
        self._limit -= len(piece)
        if self._announced != _UNKNOWN_SIZE:
            self._announced -= len(piece)
        self._hand_over_piece(piece, self._handed)
        self._handed += len(piece)
        self._answer = acknowledgement
        self._state = _AWAITING_PIECE
        self._arm(now + self.access_timeout)

    def _on_taken(self, now: Time) -> None:
        """The host has taken what was downloaded."""
        if isinstance(self._transfer, BlockServerDownload):
            self._transfer.taken(now)
        elif self._state == _AWAITING_PIECE:
            self._state = _DOWNLOADING
            self.out.frames.append(self._answer)
            self._arm(now + self.timeout)
        else:
            self._confirm(self._answer)

    def _write(self, content: bytes, answer: Frame, now: Time) -> None:
        result = self._store.write(self._index, self._subindex, content, now)
        if result is None:
            self._confirm(answer)
        elif isinstance(result, Pending):
            self._await_host(content, answer, now, 0)
        else:
            self._abort(result)

    def _confirm(self, answer: Frame) -> None:
        self.out.events.append(ObjectWritten(self.node_id, self._index, self._subindex))
        self.out.frames.append(answer)
        if self._state != _IDLE:
            self._become_idle()

    # ---- everything else ----

    def _on_other_segment(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """A segment, or a request for one, that is not due."""
        if data == self._last and self._state != _IDLE:
            self._last = b""  # once
            self._ignore(frame, "second copy of the last segment")
        elif self._state in (_UPLOADING, _DOWNLOADING) and command & SPECIFIER == self._command & SPECIFIER:
            self._abort(AbortCode.TOGGLE_NOT_ALTERNATED)
        else:
            self._on_unknown(command, data, frame, now)

    def _on_abort(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.17. Without a transfer there is nothing to do: the client saw its end later than we did."""
        if self._state != _IDLE:
            self._report(SIZE.unpack_from(data, 4)[0], AbortOrigin.PEER)
            self._become_idle()
        self._straggler = 0  # the client sends nothing behind its abort

    def _on_block(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.9 and 7.2.4.3.13: an initiate ends a running transfer like any other."""
        if not is_initiate(command):
            if data == self._last:
                self._last = b""  # once
                self._ignore(frame, "second copy of the last frame")
            else:
                self._on_unknown(command, data, frame, now)
        elif command & SPECIFIER == BLOCK_UPLOAD:
            self._on_initiate_upload(command, data, frame, now)
        elif self._state == _IDLE or self._replace(data, frame):
            self._on_initiate_block_download(data, now)

    def _on_other(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """What is not of the block transfer that is under way."""
        _HANDLERS[command >> 5](self, command, data, frame, now)

    def _on_unknown(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        if self._state == _IDLE:
            self._index = self._subindex = 0  # there is no transfer to name
        self._abort(AbortCode.INVALID_COMMAND)

    # ---- inside ----

    def _replace(self, data: bytes, frame: Frame) -> bool:
        """Make way for a new initiate. False if it is but a copy of the request that the host is serving."""
        if data != self._last:
            self._report(AbortCode.GENERAL_ERROR, AbortOrigin.REPLACED)
        elif self._state == _AWAITING_HOST:
            self._ignore(frame, "second copy of a request that the host is serving")
            return False
        self._become_idle()
        self._straggler = 0  # a request comes behind all segments
        return True

    def _await_host(self, content: bytes, answer: Frame, now: Time, offset: int) -> None:
        """The host gets what was downloaded, all of it or the last piece; `answer` once it has taken that."""
        self._transfer = None
        self._answer = answer
        self._state = _AWAITING_HOST
        self._report_access(content, False, offset)
        self._is_reading = False
        self._arm(now + self.access_timeout)

    def _become_idle(self) -> None:
        if isinstance(self._transfer, BlockServerDownload):
            self._straggler = self._transfer.straggler
        super()._become_idle()
        self._transfer = None
        self._content = b""
        if self._buffer:
            self._buffer = bytearray()


_Handler: TypeAlias = Callable[[SdoServer, int, bytes, Frame, Time], None]

_HANDLERS: Final[tuple[_Handler, ...]] = (
    SdoServer._on_other_segment,  # download segment
    SdoServer._on_initiate_download,
    SdoServer._on_initiate_upload,
    SdoServer._on_other_segment,  # upload segment
    SdoServer._on_abort,
    SdoServer._on_block,  # upload
    SdoServer._on_block,  # download
    SdoServer._on_unknown,
)
"""By client command specifier."""
