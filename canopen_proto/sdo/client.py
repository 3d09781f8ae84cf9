"""SDO client: reads (uploads) and writes (downloads) the objects of one server. CiA 301 v4.2.0, 7.2.4.

Theory of operation
-------------------
A client and a server share one channel, a pair of COB-IDs, and at most one transfer is under way on it. Requests queue up (first
in, first out; urgent ones before all others) and each ends in exactly one outcome: SdoUploaded, SdoDownloaded or SdoAborted.

Up to 4 bytes go expedited, in the initiate frames themselves; more, and none at all, go in segments of 7 bytes, each asked for or
acknowledged before the next one goes. The server chooses how an upload goes. Each response starts the `timeout` again.

What is checked: the command specifier, the multiplexer of every frame that has one, the toggle bit in both directions, the
announced size against what arrives, and `max_upload`. A fault ends the transfer with an abort that names its object.

What is not of this transfer is ignored and reported (FrameIgnored) where that is safe:
- an initiate response or abort for another object: late, of a transfer that we gave up (an abort for 0x0000:00 counts while
  segments go, because a server that lost its transfer cannot name the object; before, it answers a copy of the last segment);
- the second copy of the last response, which CAN itself can make. Its toggle tells it from the next one;
- anything unexpected before the first response, if the transfer before ended without its last response.
Everything else unexpected is an abort with 0x05040001 or 0x05030000.

What SDO cannot tell apart: a second copy (or a late one, after a timeout or `cancel`) of an answer, and the answer to the *next*
request, where both transfer the same object in the same direction. Two pauses close that gap by time.
- `late_guard`, after a time-out: the same object is not accessed again until its late answer has come (it is ignored and
  reported), until the server has answered something else, or until that much time is over. Without it a server that is slower
  than `timeout` would be misunderstood for as long as somebody asks: each answer would be taken for the next one's. Both
  directions wait, since an abort does not say which it means. Other objects need not wait, and urgent requests don't (a halt
  matters more than its confirmation).
- `copy_guard`: such a request, and any request after a transfer that was given up, waits until that long after the end of the
  one before. It is 0 by default, for buses that make no copies; about a millisecond will do on a real one.
Under copies that come later still, or out of order, every transfer still ends, but its bytes may be wrong: a segmented transfer
has a one-bit sequence number and no checksum. Block transfer has one.

A download that ends without an answer may have been executed: SdoAborted says so (`not_confirmed`).

Block transfer, on request: `block=True` (that or an abort), `block="auto"` (for downloads of more than AUTO_BLOCK bytes and any
upload, where the server knows it; see block_client.py), and streams, which never hold the whole: `download_stream` is fed piece
by piece, `upload_stream` hands out SdoChunk by SdoChunk. block.py tells how it goes.

Left out: network indication. Retries are the caller's: SDO knows no repetition (block transfer repeats lost segments only), and a
repeated download may be executed twice.
"""

from __future__ import annotations

from typing import Final, Literal, TypeAlias

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import NEVER, LocalProtocolError, Outbox, Outcome, RequestId, Time
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, MAX_BURST, STREAM_TIMEOUT, silence_limit
from canopen_proto.sdo.block_client import (
    BlockDownload,
    BlockRequest,
    BlockUpload,
    block_download_request,
    block_upload_request,
    take_for_refusal,
)
from canopen_proto.sdo.codec import (
    ABORT,
    BLOCK_UPLOAD,
    DOWNLOAD_SEGMENT,
    DOWNLOAD_SEGMENT_RESPONSE,
    EXPEDITED_BIT,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD,
    INITIATE_UPLOAD_RESPONSE,
    LAST,
    LEAST_RESPONSE,
    NO_MULTIPLEXER,
    SIZE,
    SIZE_BIT,
    SPECIFIER,
    TOGGLE,
    UPLOAD_SEGMENT,
    UPLOAD_SEGMENT_RESPONSE,
    complete,
    segment,
)
from canopen_proto.sdo.events import SdoAborted, SdoChunk, SdoDataWanted, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from canopen_proto.sdo.request import Buffer, Request, download_request, own, upload_request
from canopen_proto.sdo.request_queue import IDLE as _IDLE
from canopen_proto.sdo.request_queue import LATE_GUARD, MAX_QUEUE, TIMEOUT, RequestQueue
from canopen_proto.sdo.request_queue import UPLOAD_INITIATED as _UPLOAD_INITIATED

__all__ = [
    "AUTO_BLOCK", "LATE_GUARD", "MAX_QUEUE", "MAX_UPLOAD", "TIMEOUT", "Block", "SdoAborted", "SdoChunk", "SdoClient",
    "SdoDataWanted", "SdoDownloaded", "SdoStreamUploaded", "SdoUploaded",
]  # fmt: skip

MAX_UPLOAD: Final = 16 << 20
"""Largest value that is accepted: a firmware image fits, and a server gone mad does not fill the memory."""
AUTO_BLOCK: Final = 28
"""Bytes from which on (not included) a block transfer takes fewer frames than a segmented one."""

Block: TypeAlias = bool | Literal["auto"]
"""Whether a transfer goes in blocks: False, True (or it fails), or where it pays and the server knows it."""

# States; 0 is IDLE, 1 is UPLOAD_INITIATED
_DOWNLOAD_INITIATED: Final = 2
_UPLOAD_SEGMENT: Final = 3  # these three have frames that do not name the object
_DOWNLOAD_SEGMENT: Final = 4
_BLOCK: Final = 5

_UNKNOWN_SIZE: Final = -1

_OUT_OF_PLACE: Final = (AbortCode.INVALID_COMMAND, AbortCode.TOGGLE_NOT_ALTERNATED)
"""What servers say to a second copy of a segment."""


class SdoClient(RequestQueue):
    """The client of one SDO channel; see this module's text."""

    __slots__ = (
        "_announced", "_buffer", "_command", "_limit", "_multiplexer", "_nameless_abort", "_offset", "_segment_requests",
        "_transfer", "block_size", "burst_interval", "crc", "max_burst", "max_upload", "serves_blocks", "stream_timeout",
    )  # fmt: skip

    def __init__(
        self,
        out: Outbox,
        node_id: int,
        *,
        request_key: int | None = None,
        response_key: int | None = None,
        timeout: Time = TIMEOUT,
        max_upload: int = MAX_UPLOAD,
        max_queue: int = MAX_QUEUE,
        copy_guard: Time = 0,
        late_guard: Time = LATE_GUARD,
        crc: bool = True,
        block_size: int = MAX_BLOCK_SIZE,
        max_burst: int = MAX_BURST,
        burst_interval: Time = 0,
        stream_timeout: Time = STREAM_TIMEOUT,
    ) -> None:
        """node_id: of the server. request_key, response_key: the channel (client to server, server to client) as `Frame.key`;
        the server's first one by default. timeout, copy_guard, late_guard: ns; see this module's text. Inside a block transfer
        pauses of at least 1 s are survived whatever the timeout is; see `silence_limit` in block.py.

        For block transfer: crc, if the server has it too; block_size: segments (1..127) that we take in one sub-block; max_burst,
        burst_interval: segments (1 or more) that go out in one turn, and ns between two turns; stream_timeout: ns that the caller
        of a stream may take for each piece. All may be changed later.
        """
        super().__init__(out, node_id, request_key, response_key, timeout, max_queue, copy_guard, late_guard)
        self.max_upload = max_upload
        self.crc = crc
        self.block_size = block_size
        self.max_burst = max_burst
        self.burst_interval = burst_interval
        self.stream_timeout = stream_timeout
        self.serves_blocks = True
        """False once the server has refused a block transfer with 0x05040001 and the object's name: "auto" does without then."""
        self._segment_requests = {
            toggle: Frame(self._send_can_id, bytes((UPLOAD_SEGMENT | toggle,)).ljust(8, b"\x00"), self._send_flags)
            for toggle in (0, TOGGLE)
        }
        # The transfer under way
        self._transfer: BlockDownload | BlockUpload | None = None
        self._nameless_abort = b""  # one that came while a block transfer was initiated
        self._multiplexer = b""  # bytes 1..3 of each frame that names its object
        self._command = 0  # the command byte of a plain segment response with the toggle that is due
        self._buffer = bytearray()  # uploaded so far
        self._announced = _UNKNOWN_SIZE
        self._limit = 0  # of _buffer
        self._offset = 0  # downloaded so far

    # ---- commands ----

    def upload(self, index: int, subindex: int, now: Time, *, urgent: bool = False, block: Block = False) -> RequestId:
        """Ask the server for an object's value.

        Sends an initiate request, at once if no transfer is under way. SdoUploaded or SdoAborted follows, at the latest `timeout`
        after the last frame of the transfer; in blocks two silences after it (`silence_limit`, block.py). index 0..0xFFFF,
        subindex 0..0xFF. urgent: goes before all requests that are not. block: see `Block`; "auto" asks for a block transfer
        first, whatever the size. Raises LocalProtocolError if the queue is full or the numbers are impossible.
        Source: CiA 301 v4.2.0, 7.2.4.3.5 and 7.2.4.3.12.
        """
        if not block or (block == "auto" and not self.serves_blocks):
            return self._submit(upload_request(index, subindex), urgent, now)
        plain = upload_request(index, subindex) if block == "auto" else None
        request = block_upload_request(index, subindex, self.block_size, self.crc, False, plain)
        return self._submit(request, urgent, now)

    def download(
        self, index: int, subindex: int, data: Buffer, now: Time, *, urgent: bool = False, block: Block = False
    ) -> RequestId:
        """Write an object's value: 1 to 4 bytes expedited, anything else (nothing too) in segments or, on request, in blocks.

        Sends an initiate request, at once if no transfer is under way. SdoDownloaded or SdoAborted follows, at the latest
        `timeout` after the last frame of the transfer; in blocks two silences after it (`silence_limit`, block.py).
        index 0..0xFFFF, subindex 0..0xFF. urgent: goes before all requests that are not. block: see `Block`.
        Raises LocalProtocolError if the queue is full or the numbers are impossible.
        Source: CiA 301 v4.2.0, 7.2.4.3.2 and 7.2.4.3.8.
        """
        if not block or (block == "auto" and (not self.serves_blocks or len(data) <= AUTO_BLOCK)):
            return self._submit(download_request(index, subindex, data), urgent, now)
        content = own(data, index, subindex)
        plain = download_request(index, subindex, content) if block == "auto" else None
        request = block_download_request(index, subindex, content, len(content), self.crc, plain)
        return self._submit(request, urgent, now)

    def upload_stream(self, index: int, subindex: int, now: Time, *, urgent: bool = False) -> RequestId:
        """Read an object piece by piece, by block transfer, whatever its size (`max_upload` is not looked at).

        SdoChunk follows for each piece, and waits for `proceed` (the last one does not); then SdoStreamUploaded or SdoAborted.
        Else as `upload(block=True)`. Source: CiA 301 v4.2.0, 7.2.4.3.12.
        """
        return self._submit(block_upload_request(index, subindex, self.block_size, self.crc, True, None), urgent, now)

    def proceed(self, request_id: RequestId, now: Time) -> bool:
        """The last SdoChunk was taken, the next may come. The server waits meanwhile: for `stream_timeout` at most, and for as
        long as it has patience. False if the request is not under way (any more)."""
        if self._state != _BLOCK or self._request.request_id != request_id or not isinstance(self._transfer, BlockUpload):
            return False
        self._transfer.proceed(now)
        return True

    def download_stream(
        self, index: int, subindex: int, now: Time, *, size: int | None = None, urgent: bool = False
    ) -> RequestId:
        """Write an object piece by piece, by block transfer. size: in bytes, if it is known; servers may insist on it.

        `feed` it, at once or when SdoDataWanted asks for more; then SdoDownloaded or SdoAborted follows. Who lets it starve for
        `stream_timeout` aborts it. Else as `download(block=True)`. Source: CiA 301 v4.2.0, 7.2.4.3.8.
        """
        return self._submit(block_download_request(index, subindex, None, size, self.crc, None), urgent, now)

    def feed(self, request_id: RequestId, piece: Buffer, now: Time, *, last: bool = False) -> bool:
        """The next bytes of a download stream, any number; last: there are no more (known by itself where the size is).

        They are copied, and held until the server has them. False if the request is not open (any more). Raises
        LocalProtocolError if more than MAX_FED bytes would be held, if they are more or fewer than were announced, and after the
        last; nothing has changed then.
        """
        request = self._find(request_id)
        if request is None:
            return False
        if not isinstance(request, BlockRequest):
            raise LocalProtocolError(f"{request}: it is no stream")
        request.feed(piece, last)
        if request is self._request and isinstance(self._transfer, BlockDownload):
            self._transfer.extend(piece, request.is_whole, now)
        else:
            request.content += piece
        return True

    def room(self, request_id: RequestId) -> int:
        """How many bytes a download stream may be fed now; 0 for what is no open one."""
        request = self._find(request_id)
        return request.room if isinstance(request, BlockRequest) and not request.is_whole else 0

    # ---- inputs ----

    def receive(self, frame: Frame, now: Time) -> None:
        data = frame.data
        if len(data) != 8:
            completed = complete(data, LEAST_RESPONSE)
            if completed is None:
                self._ignore(frame, "too short for an SDO response")
                return
            data = completed
        command = data[0]
        state = self._state
        if state >= _UPLOAD_SEGMENT:
            if self._transfer is not None:
                self._transfer.receive(command, data, frame, now)
                return
            if command & ~0x0F == self._command:
                if state == _UPLOAD_SEGMENT:
                    self._on_upload_segment(command, data, now)
                else:
                    self._on_download_segment(data, now)
                return
        elif data[1:4] == self._multiplexer:
            if state == _UPLOAD_INITIATED:
                if command & SPECIFIER == INITIATE_UPLOAD_RESPONSE:
                    self._on_upload_initiated(command, data, now)
                    return
            elif state == _DOWNLOAD_INITIATED and command & SPECIFIER == INITIATE_DOWNLOAD_RESPONSE:
                self._on_download_initiated(data, now)
                return
        self._on_other(command, data, frame, now)

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        if self._state == _IDLE:
            self._begin_next(now)  # a request was held back by copy_guard
        elif self._nameless_abort and self._transfer is not None and not self._transfer.has_begun:
            take_for_refusal(self, self._nameless_abort, now)
        elif self._transfer is not None:
            self._transfer.handle_timeout(now)
        elif self._state in (_UPLOAD_SEGMENT, _DOWNLOAD_SEGMENT) and not self._last:
            # What we took for a copy of the last response was all that came: the server does not alternate its toggle
            self._fail(AbortCode.TOGGLE_NOT_ALTERNATED, AbortOrigin.TIMEOUT, now)
        else:
            # The abort also brings the server out of its state (peers without it need a reset after a timeout)
            self._fail(AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT, now)

    # ---- responses ----

    def _on_upload_initiated(self, command: int, data: bytes, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.6"""
        self._last = data
        if self._unsettled:
            self._settle()
        if command & EXPEDITED_BIT:
            unused = command >> 2 & 3 if command & SIZE_BIT else 0
            request = self._request
            content = data[4 : 8 - unused]
            self._end(SdoUploaded(self.node_id, request.request_id, request.index, request.subindex, content), now)
            return
        if command & SIZE_BIT:
            self._limit = self._announced = SIZE.unpack_from(data, 4)[0]
            if self._announced > self.max_upload:
                self._fail(AbortCode.OUT_OF_MEMORY, AbortOrigin.LOCAL, now)
                return
        else:
            self._announced = _UNKNOWN_SIZE
            self._limit = self.max_upload
        self._state = _UPLOAD_SEGMENT
        self._command = UPLOAD_SEGMENT_RESPONSE
        self.out.frames.append(self._segment_requests[0])
        self.deadline = deadline = now + self.timeout
        if deadline < self._wake:
            self._arm(deadline)

    def _on_upload_segment(self, command: int, data: bytes, now: Time) -> None:
        """A segment with the right toggle; CiA 301 v4.2.0, 7.2.4.3.7"""
        buffer = self._buffer
        if command == self._command:
            buffer += data[1:]
        else:
            unused = command >> 1 & 7
            buffer += data[1 : 8 - unused]
        if len(buffer) > self._limit:
            known = self._announced != _UNKNOWN_SIZE
            self._fail(AbortCode.LENGTH_TOO_HIGH if known else AbortCode.OUT_OF_MEMORY, AbortOrigin.LOCAL, now)
        elif not command & LAST:
            if command & 0x0E == 0x0E:  # no data and yet not the last: without this a transfer might never end
                self._fail(AbortCode.INVALID_COMMAND, AbortOrigin.LOCAL, now)
                return
            self._last = data
            toggle = ~command & TOGGLE
            self._command = UPLOAD_SEGMENT_RESPONSE | toggle
            self.out.frames.append(self._segment_requests[toggle])
            self.deadline = deadline = now + self.timeout
            if deadline < self._wake:
                self._arm(deadline)
        elif len(buffer) < self._announced:
            self._fail(AbortCode.LENGTH_TOO_LOW, AbortOrigin.LOCAL, now)
        else:
            self._last = data
            request = self._request
            self._end(SdoUploaded(self.node_id, request.request_id, request.index, request.subindex, bytes(buffer)), now)

    def _on_download_initiated(self, data: bytes, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.3"""
        self._last = data
        if self._unsettled:
            self._settle()
        if self._request.first[0] & EXPEDITED_BIT:
            self._end_download(now)
            return
        self._state = _DOWNLOAD_SEGMENT
        self._command = DOWNLOAD_SEGMENT_RESPONSE | TOGGLE
        self._offset = 0
        self._send_segment(now)

    def _on_download_segment(self, data: bytes, now: Time) -> None:
        """A response with the right toggle; CiA 301 v4.2.0, 7.2.4.3.4"""
        self._last = data
        if self._offset < len(self._request.content):
            self._send_segment(now)
        else:
            self._end_download(now)

    def _on_other(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """Aborts, and whatever is not the response that is due."""
        specifier = command & SPECIFIER
        state = self._state
        if self._overdue and data[1:4] != (self._multiplexer if state else b"") and self._is_overdue(specifier, data[1:4]):
            self._ignore(frame, "late response to a request that timed out")
            if state == _IDLE:
                self._begin_next(now)  # it may have waited for this
        elif state == _IDLE:
            self._ignore(frame, "no transfer is under way")
        elif specifier == ABORT:
            self._on_abort(data, frame, now)
        elif specifier in (INITIATE_UPLOAD_RESPONSE, INITIATE_DOWNLOAD_RESPONSE) and data[1:4] != self._multiplexer:
            self._ignore(frame, "response about another object")
        elif specifier in (INITIATE_UPLOAD_RESPONSE, INITIATE_DOWNLOAD_RESPONSE) and data[:4] == self._last[:4]:
            # Up to three: request and answer may both be copied, and the value may have changed between the two answers
            self._ignore(frame, "second copy of the last response")
        elif data == self._last:
            self._last = b""  # once
            self._ignore(frame, "second copy of the last response")
        elif self._unsettled:
            self._ignore(frame, "late response of a transfer that was given up")
        elif state in (_UPLOAD_SEGMENT, _DOWNLOAD_SEGMENT) and specifier == self._command & SPECIFIER:
            self._fail(AbortCode.TOGGLE_NOT_ALTERNATED, AbortOrigin.LOCAL, now)
        else:
            self._fail(AbortCode.INVALID_COMMAND, AbortOrigin.LOCAL, now)

    def _on_abort(self, data: bytes, frame: Frame, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.17.

        Where a last segment came twice and the answer to the first copy was lost, the server says that the second one is out of
        place, without an object or with that of the transfer that it has just executed: that is no refusal. Where the answer was
        not lost, this abort meets the next transfer. Servers that do not know block transfer say the same to its initiation: so
        there it counts only if nothing else comes.
        """
        is_named = data[1:4] == self._multiplexer
        transfer = self._transfer
        in_segments = self._state in (_UPLOAD_SEGMENT, _DOWNLOAD_SEGMENT) or (transfer is not None and transfer.has_begun)
        if is_named or (in_segments and data[1:4] == NO_MULTIPLEXER):
            finds_a_copy = in_segments and SIZE.unpack_from(data, 4)[0] in _OUT_OF_PLACE
            is_refusal = is_named and not finds_a_copy
            self._end_by_abort(data, not is_refusal and self._is_all_sent(), now)
            return
        if transfer is not None and data[1:4] == NO_MULTIPLEXER:
            self._nameless_abort = data
        self._ignore(frame, "abort of another object's transfer")

    def _end_by_abort(self, data: bytes, not_confirmed: bool, now: Time) -> None:
        self._last = data
        code: int = SIZE.unpack_from(data, 4)[0]
        self._end(self._aborted(self._request, code, AbortOrigin.PEER, not_confirmed), now)

    # ---- inside ----

    def _begin(self, request: Request, now: Time) -> None:
        self._request = request
        self._multiplexer = request.first[1:4]
        command = request.first[0]
        if command < BLOCK_UPLOAD:
            self._state = _UPLOAD_INITIATED if command == INITIATE_UPLOAD else _DOWNLOAD_INITIATED
        else:
            assert isinstance(request, BlockRequest)
            is_upload = command & SPECIFIER == BLOCK_UPLOAD
            self._transfer = BlockUpload(self, request) if is_upload else BlockDownload(self, request)
            self._nameless_abort = b""
            self._state = _BLOCK
        self.out.frames.append(Frame(self._send_can_id, request.first, self._send_flags, 8))
        self.deadline = deadline = now + self.timeout
        if deadline < self._wake:
            self._arm(deadline)

    def _send_segment(self, now: Time) -> None:
        """The next one, with the other toggle than the last response; CiA 301 v4.2.0, 7.2.4.3.4"""
        self._command = command = self._command ^ TOGGLE
        offset = self._offset
        self._offset = offset + 7
        payload = segment(DOWNLOAD_SEGMENT | command & TOGGLE, self._request.content, offset)
        self.out.frames.append(Frame(self._send_can_id, payload, self._send_flags, 8))
        self.deadline = deadline = now + self.timeout
        if deadline < self._wake:
            self._arm(deadline)

    def _patience(self) -> Time:
        transfer = self._transfer
        return self.timeout if transfer is None or not transfer.has_begun else 2 * silence_limit(self.timeout)

    def _is_all_sent(self) -> bool:
        state, request = self._state, self._request
        if state == _BLOCK:
            return isinstance(self._transfer, BlockDownload) and self._transfer.is_all_sent
        if state == _DOWNLOAD_INITIATED:
            return bool(request.first[0] & EXPEDITED_BIT)
        return state == _DOWNLOAD_SEGMENT and self._offset >= len(request.content)

    def _is_answer_ambiguous(self) -> bool:
        return self._state == _UPLOAD_INITIATED or (self._state == _DOWNLOAD_INITIATED and self._is_all_sent())

    def _end_download(self, now: Time) -> None:
        request = self._request
        self._end(SdoDownloaded(self.node_id, request.request_id, request.index, request.subindex), now)

    def _end(self, outcome: Outcome, now: Time) -> None:
        self.out.events.append(outcome)
        self._request.content = b""
        self._ended = now
        self._state = _IDLE
        self._transfer = None
        self.deadline = NEVER
        if self._buffer:
            self._buffer = bytearray()
        if self._queue or self._urgent:
            self._begin_next(now)

    def _accept(self, data: bytes) -> None:
        """The first response of a block transfer came."""
        self._last = data
        self._settle()
