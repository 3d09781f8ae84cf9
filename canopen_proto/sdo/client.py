"""SDO client: reads (uploads) and writes (downloads) the objects of one server. CiA 301 v4.2.0, 7.2.4.

Theory of operation
-------------------
A client and a server share one channel, a pair of COB-IDs, and at most one transfer is under way on it. Requests queue up (first
in, first out; urgent ones before all others) and each ends in exactly one outcome: SdoUploaded, SdoDownloaded or SdoAborted.

Up to 4 bytes go expedited, in the initiate frames themselves; more, and none at all, go in segments of 7 bytes, each asked for or
acknowledged before the next one goes. The server chooses how an upload goes. Each response starts the `timeout` anew.

What is checked: the command specifier, the multiplexer of every frame that has one, the toggle bit in both directions, the
announced size against what arrives, and `max_upload`. A fault ends the transfer with an abort that names its object.

What is not of this transfer is ignored and reported (FrameIgnored) where that is safe:
- an initiate response or abort for another object: late, of a transfer that we gave up (an abort for 0x0000:00 counts while
  segments go, because a server that lost its transfer cannot name the object);
- the second copy of the last response, which CAN itself can make. Its toggle tells it from the next one;
- anything unexpected before the first response, if the transfer before ended without its last response.
Everything else unexpected is an abort with 0x05040001 or 0x05030000.

What SDO cannot tell apart: a second copy (or a late one, after a timeout or `cancel`) of an answer, and the answer to the *next*
request, where both transfer the same object in the same direction. `copy_guard` closes that gap by time: such a request, and any
request after a transfer that was given up, waits until that long after the end of the one before. It is 0 by default, for buses
that make no copies; about a millisecond will do on a real one. Under copies that come later still, or out of order, every
transfer still ends, but its bytes may be wrong: a segmented transfer has a one-bit sequence number and no checksum. Block
transfer has one.

Left out: block transfer (files of its own), and network indication. Retries are the caller's: SDO knows no repetition, and a
repeated download may be executed twice.
"""

from __future__ import annotations

from collections import deque
from typing import Final

from canopen_proto.frame import SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, Frame
from canopen_proto.machine import (
    MILLISECOND,
    NEVER,
    FrameIgnored,
    LocalProtocolError,
    Machine,
    Outbox,
    Outcome,
    RequestId,
    Time,
    check_node_id,
    event,
)
from canopen_proto.sdo.abort import AbortCode, AbortOrigin, text_of
from canopen_proto.sdo.codec import (
    ABORT,
    DOWNLOAD_SEGMENT,
    DOWNLOAD_SEGMENT_RESPONSE,
    EXPEDITED_BIT,
    INITIATE,
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
from canopen_proto.sdo.request import Buffer, Request, download_request, upload_request

TIMEOUT: Final = 500 * MILLISECOND
"""How long a server may take for each response: devices that write flash on the way take 100 ms and more."""
MAX_UPLOAD: Final = 16 << 20
"""Largest value that is accepted: a firmware image fits, and a server gone mad does not fill the memory."""
MAX_QUEUE: Final = 256
"""Requests that may wait, urgent ones counted apart (at least 1): enough to configure all PDOs of a node at once."""

# States
_IDLE: Final = 0
_UPLOAD_INITIATED: Final = 1
_UPLOAD_SEGMENT: Final = 2
_DOWNLOAD_INITIATED: Final = 3
_DOWNLOAD_SEGMENT: Final = 4

_UNKNOWN_SIZE: Final = -1


@event
class SdoUploaded(Outcome):
    """An object was read: its bytes as the server sent them (4 where it sent an expedited value without its size)."""

    index: int
    subindex: int
    data: bytes


@event
class SdoDownloaded(Outcome):
    """An object was written: the server has confirmed it."""

    index: int
    subindex: int


@event
class SdoAborted(Outcome):
    """A transfer ended without success. After TIMEOUT or CANCELLED a download may have been executed nevertheless."""

    index: int
    subindex: int
    abort_code: int
    origin: AbortOrigin

    @property
    def text(self) -> str:
        """What the abort code says."""
        return text_of(self.abort_code)


class SdoClient(Machine):
    """The client of one SDO channel; see this module's text."""

    __slots__ = (
        "_announced", "_buffer", "_command", "_ended", "_last", "_limit", "_multiplexer", "_offset", "_queue",
        "_request", "_request_can_id", "_request_flags", "_response_key", "_segment_requests", "_state", "_unsettled", "_urgent",
        "copy_guard", "max_queue", "max_upload", "node_id", "timeout",
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
    ) -> None:
        """node_id: of the server. request_key, response_key: the channel (client to server, server to client) as `Frame.key`;
        the server's first one by default. timeout, copy_guard: ns; see this module's text. All may be changed later.
        """
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.timeout = timeout
        self.max_upload = max_upload
        self.max_queue = max_queue
        self.copy_guard = copy_guard
        request_key = SDO_CLIENT_TO_SERVER + node_id if request_key is None else request_key
        self._response_key = SDO_SERVER_TO_CLIENT + node_id if response_key is None else response_key
        self._request_can_id = request_key & 0x1FFFFFFF
        self._request_flags = request_key >> 29
        self._segment_requests = {
            toggle: Frame(self._request_can_id, bytes((UPLOAD_SEGMENT | toggle,)).ljust(8, b"\x00"), self._request_flags)
            for toggle in (0, TOGGLE)
        }
        self._urgent: deque[Request] = deque()
        self._queue: deque[Request] = deque()
        # The transfer under way
        self._state = _IDLE
        self._request = Request(0, 0, bytes(8))  # while idle: the one before
        self._multiplexer = b""  # bytes 1..3 of each frame that names its object
        self._command = 0  # the command byte of a plain segment response with the toggle that is due
        self._buffer = bytearray()  # uploaded so far
        self._announced = _UNKNOWN_SIZE
        self._limit = 0  # of _buffer
        self._offset = 0  # downloaded so far
        # What is remembered of responses and of the transfer before
        self._last = b""  # the last accepted response; empty once its copy was seen
        self._unsettled = False  # the transfer before ended without its last response
        self._ended: Time = -NEVER

    # ---- commands ----

    def upload(self, index: int, subindex: int, now: Time, *, urgent: bool = False) -> RequestId:
        """Ask the server for an object's value.

        Sends an initiate request, at once if no transfer is under way. SdoUploaded or SdoAborted follows, at the latest `timeout`
        after the last frame of the transfer. index 0..0xFFFF, subindex 0..0xFF. urgent: goes before all requests that are not.
        Raises LocalProtocolError if the queue is full or the numbers are impossible. Source: CiA 301 v4.2.0, 7.2.4.3.5.
        """
        return self._submit(upload_request(index, subindex), urgent, now)

    def download(self, index: int, subindex: int, data: Buffer, now: Time, *, urgent: bool = False) -> RequestId:
        """Write an object's value: 1 to 4 bytes expedited, anything else (nothing too) in segments.

        Sends an initiate request, at once if no transfer is under way. SdoDownloaded or SdoAborted follows, at the latest
        `timeout` after the last frame of the transfer. index 0..0xFFFF, subindex 0..0xFF. urgent: goes before all requests that
        are not. Raises LocalProtocolError if the queue is full or the numbers are impossible. Source: CiA 301 v4.2.0, 7.2.4.3.2.
        """
        return self._submit(download_request(index, subindex, data), urgent, now)

    def cancel(self, request_id: RequestId, now: Time) -> bool:
        """Give a request up: SdoAborted with origin CANCELLED follows at once. False if it is not open (any more).

        Of a request that waits nothing was sent and nothing is. A running transfer is aborted on the wire with 0x08000000, and
        the next request goes out at once.
        """
        if self._state != _IDLE and self._request.request_id == request_id:
            self._abort(AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED, now)
            return True
        for queue in (self._urgent, self._queue):
            for request in queue:
                if request.request_id == request_id:
                    queue.remove(request)
                    self.out.events.append(self._aborted(request, AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED))
                    if self._state == _IDLE:
                        self._begin_next(now)  # copy_guard may have held back the one that is gone
                    return True
        return False

    def abort_all(self, abort_code: int, now: Time) -> None:
        """End all requests (the server is gone): SdoAborted with origin LOCAL for each; the running one is aborted on the bus."""
        if not 0 <= abort_code <= 0xFFFFFFFF:
            raise LocalProtocolError(f"node {self.node_id}: {abort_code} is no abort code (0..0xFFFFFFFF)")
        waiting = [*self._urgent, *self._queue]
        self._urgent.clear()
        self._queue.clear()
        if self._state != _IDLE:
            self._abort(abort_code, AbortOrigin.LOCAL, now)
        for request in waiting:
            self.out.events.append(self._aborted(request, abort_code, AbortOrigin.LOCAL))
        self.deadline = NEVER

    # ---- getters ----

    @property
    def busy(self) -> bool:
        """Whether any request is running or waiting."""
        return self._state != _IDLE or bool(self._queue or self._urgent)

    @property
    def waiting(self) -> int:
        """The number of requests that wait."""
        return len(self._queue) + len(self._urgent)

    def can_ids(self) -> tuple[int, ...]:
        return (self._response_key,)

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
        if state == _UPLOAD_SEGMENT:
            if command & ~0x0F == self._command:
                self._on_upload_segment(command, data, now)
                return
        elif state == _DOWNLOAD_SEGMENT:
            if command & ~0x0F == self._command:
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
        elif self._state in (_UPLOAD_SEGMENT, _DOWNLOAD_SEGMENT) and not self._last:
            # What we took for a copy of the last response was all that came: the server does not alternate its toggle
            self._abort(AbortCode.TOGGLE_NOT_ALTERNATED, AbortOrigin.TIMEOUT, now)
        else:
            # The abort also brings the server out of its state (peers without it need a reset after a timeout)
            self._abort(AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT, now)

    # ---- responses ----

    def _on_upload_initiated(self, command: int, data: bytes, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.6"""
        self._last = data
        self._unsettled = False
        if command & EXPEDITED_BIT:
            unused = command >> 2 & 3 if command & SIZE_BIT else 0
            request = self._request
            content = data[4 : 8 - unused]
            self._end(SdoUploaded(self.node_id, request.request_id, request.index, request.subindex, content), now)
            return
        if command & SIZE_BIT:
            self._limit = self._announced = SIZE.unpack_from(data, 4)[0]
            if self._announced > self.max_upload:
                self._abort(AbortCode.OUT_OF_MEMORY, AbortOrigin.LOCAL, now)
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
            self._abort(AbortCode.LENGTH_TOO_HIGH if known else AbortCode.OUT_OF_MEMORY, AbortOrigin.LOCAL, now)
        elif not command & LAST:
            if command & 0x0E == 0x0E:  # no data and yet not the last: without this a transfer might never end
                self._abort(AbortCode.INVALID_COMMAND, AbortOrigin.LOCAL, now)
                return
            self._last = data
            toggle = ~command & TOGGLE
            self._command = UPLOAD_SEGMENT_RESPONSE | toggle
            self.out.frames.append(self._segment_requests[toggle])
            self.deadline = deadline = now + self.timeout
            if deadline < self._wake:
                self._arm(deadline)
        elif len(buffer) < self._announced:
            self._abort(AbortCode.LENGTH_TOO_LOW, AbortOrigin.LOCAL, now)
        else:
            self._last = data
            request = self._request
            self._end(SdoUploaded(self.node_id, request.request_id, request.index, request.subindex, bytes(buffer)), now)

    def _on_download_initiated(self, data: bytes, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.3"""
        self._last = data
        self._unsettled = False
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
        if state == _IDLE:
            self._ignore(frame, "no transfer is under way")
        elif specifier == ABORT:
            multiplexer = data[1:4]
            in_segments = state in (_UPLOAD_SEGMENT, _DOWNLOAD_SEGMENT)
            if multiplexer == self._multiplexer or (in_segments and multiplexer == NO_MULTIPLEXER):
                self._last = data
                self._end(self._aborted(self._request, SIZE.unpack_from(data, 4)[0], AbortOrigin.PEER), now)
            else:
                self._ignore(frame, "abort of another object's transfer")
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
            self._abort(AbortCode.TOGGLE_NOT_ALTERNATED, AbortOrigin.LOCAL, now)
        else:
            self._abort(AbortCode.INVALID_COMMAND, AbortOrigin.LOCAL, now)

    # ---- inside ----

    def _submit(self, request: Request, urgent: bool, now: Time) -> RequestId:
        queue = self._urgent if urgent else self._queue
        if len(queue) >= self.max_queue:
            raise LocalProtocolError(f"{request}, node {self.node_id}: {len(queue)} requests are waiting already")
        request.request_id = request_id = self.out.next_request_id()
        if self._state == _IDLE and not queue and not self.copy_guard:
            self._begin(request, now)
        else:
            queue.append(request)
            if self._state == _IDLE:
                self._begin_next(now)
        return request_id

    def _begin_next(self, now: Time) -> None:
        """Begin the transfer whose turn it is, if there is one."""
        queue = self._urgent or self._queue
        if not queue:
            self.deadline = NEVER
            return
        request = queue[0]
        if now < self._ended + self.copy_guard and (self._unsettled or self._request.is_like(request)):
            self._arm(self._ended + self.copy_guard)
            return
        self._begin(queue.popleft(), now)

    def _begin(self, request: Request, now: Time) -> None:
        self._request = request
        self._multiplexer = request.first[1:4]
        self._state = _UPLOAD_INITIATED if request.first[0] == INITIATE_UPLOAD else _DOWNLOAD_INITIATED
        self.out.frames.append(Frame(self._request_can_id, request.first, self._request_flags, 8))
        self.deadline = deadline = now + self.timeout
        if deadline < self._wake:
            self._arm(deadline)

    def _send_segment(self, now: Time) -> None:
        """The next one, with the other toggle than the last response; CiA 301 v4.2.0, 7.2.4.3.4"""
        self._command = command = self._command ^ TOGGLE
        offset = self._offset
        self._offset = offset + 7
        payload = segment(DOWNLOAD_SEGMENT | command & TOGGLE, self._request.content, offset)
        self.out.frames.append(Frame(self._request_can_id, payload, self._request_flags, 8))
        self.deadline = deadline = now + self.timeout
        if deadline < self._wake:
            self._arm(deadline)

    def _end_download(self, now: Time) -> None:
        request = self._request
        self._end(SdoDownloaded(self.node_id, request.request_id, request.index, request.subindex), now)

    def _abort(self, abort_code: int, origin: AbortOrigin, now: Time) -> None:
        """Abort the running transfer on the wire (CiA 301 v4.2.0, 7.2.4.3.17) and begin the next one."""
        request = self._request
        payload = INITIATE.pack(ABORT, request.index, request.subindex, abort_code)
        self.out.frames.append(Frame(self._request_can_id, payload, self._request_flags))
        self._unsettled = True
        self._end(self._aborted(request, abort_code, origin), now)

    def _end(self, outcome: Outcome, now: Time) -> None:
        self.out.events.append(outcome)
        self._request.content = b""
        self._ended = now
        self._state = _IDLE
        self.deadline = NEVER
        if self._buffer:
            self._buffer = bytearray()
        if self._queue or self._urgent:
            self._begin_next(now)

    def _aborted(self, request: Request, abort_code: int, origin: AbortOrigin) -> SdoAborted:
        return SdoAborted(self.node_id, request.request_id, request.index, request.subindex, abort_code, origin)

    def _ignore(self, frame: Frame, reason: str) -> None:
        self.out.events.append(FrameIgnored(self.node_id, frame, reason))
