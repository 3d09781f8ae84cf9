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

A new initiate request takes the place of a running transfer; an abort ends it, whatever object it names (field clients send
0x0000:00). A segment request without a transfer is answered by an abort for 0x0000:00. Block transfer is refused with 0x05040001;
a client then goes on with segments (block transfer is in files of its own).

CAN can deliver a frame twice. The second copy of a segment is told by its toggle and ignored, once; any other wrong toggle, or a
third, is an abort. The second copy of an initiate is served once more (a client that repeats its request after a lost answer
looks just the same), unless its answer is with the host: two copies of "store parameters" store once.

SDO lives in the NMT states pre-operational and operational only (CiA 301 v4.2.0, 7.3.2.3): `disable` and `enable` it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol, TypeAlias

from canopen_proto.frame import SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, Frame
from canopen_proto.machine import (
    NEVER,
    SECOND,
    Event,
    FrameIgnored,
    LocalProtocolError,
    Machine,
    Outbox,
    Time,
    check_node_id,
    event,
)
from canopen_proto.sdo.abort import AbortCode, AbortOrigin
from canopen_proto.sdo.codec import (
    ABORT,
    BLOCK_UPLOAD,
    DOWNLOAD_SEGMENT,
    DOWNLOAD_SEGMENT_RESPONSE,
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

TIMEOUT: Final = 1 * SECOND
"""How long a client may take for each segment. Longer than clients usually wait, who give up first and say so."""
ACCESS_TIMEOUT: Final = 5 * SECOND
"""How long the host may take for an access: storing parameters in flash takes seconds."""
MAX_DOWNLOAD: Final = 16 << 20
"""Largest value that is accepted: a firmware image fits, and a client gone mad does not fill the memory."""

# States
_IDLE: Final = 0
_UPLOADING: Final = 1
_DOWNLOADING: Final = 2
_AWAITING_HOST: Final = 3

_UNKNOWN_SIZE: Final = -1


class Pending:
    """The type of PENDING: the host will answer, by `SdoServer.complete`."""

    __slots__ = ()


PENDING: Final = Pending()


class ObjectStore(Protocol):
    """What a server serves. None of these may raise; index is 0..0xFFFF, subindex 0..0xFF."""

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        """The bytes of an object, or why it cannot be read."""

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | None:
        """Why an object cannot be written with so many bytes (None: not known yet), or None if it can. Changes nothing."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        """Write an object, or say why it cannot be written (`check_write` may not have been asked) or the value is refused."""


@event
class ObjectAccessPending(Event):
    """The host has to serve an access: data to write, or None to read; it answers by `complete(access_id, ...)`."""

    access_id: int
    index: int
    subindex: int
    data: bytes | None


@event
class ObjectWritten(Event):
    """A client wrote an object; the store has it, and the confirmation is on its way."""

    index: int
    subindex: int


@event
class SdoServerAborted(Event):
    """A transfer ended without success. A pending access of it needs no answer any more. 0x0000:00: there was no transfer."""

    index: int
    subindex: int
    abort_code: int
    origin: AbortOrigin


class SdoServer(Machine):
    """The server of one SDO channel; see this module's text."""

    __slots__ = (
        "_access_id", "_acknowledgements", "_announced", "_answer", "_buffer", "_command", "_content", "_index", "_last",
        "_limit", "_offset", "_request_key", "_response_can_id", "_response_flags", "_state", "_store", "_subindex",
        "access_timeout", "enabled", "max_download", "node_id", "timeout",
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
    ) -> None:
        """node_id: our own. request_key, response_key: the channel (client to server, server to client) as `Frame.key`; the first
        one by default. timeout, access_timeout: ns. max_download: bytes. It starts enabled.
        """
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.timeout = timeout
        self.access_timeout = access_timeout
        self.max_download = max_download
        self.enabled = True
        self._store = store
        self._request_key = SDO_CLIENT_TO_SERVER + node_id if request_key is None else request_key
        response_key = SDO_SERVER_TO_CLIENT + node_id if response_key is None else response_key
        self._response_can_id = response_key & 0x1FFFFFFF
        self._response_flags = response_key >> 29
        self._acknowledgements = {
            toggle: self._frame(bytes((DOWNLOAD_SEGMENT_RESPONSE | toggle,)).ljust(8, b"\x00")) for toggle in (0, TOGGLE)
        }
        # The transfer under way
        self._state = _IDLE
        self._index = 0
        self._subindex = 0
        self._command = 0  # the command byte of a plain segment with the toggle that is due
        self._content = b""  # to upload
        self._offset = 0  # uploaded so far
        self._buffer = bytearray()  # downloaded so far
        self._announced = _UNKNOWN_SIZE
        self._limit = 0  # of _buffer
        self._access_id = 0
        self._answer: Frame | None = None  # what confirms a pending download; None: an upload is pending
        self._last = b""  # the last accepted request; empty once its copy was seen

    # ---- commands ----

    def complete(self, access_id: int, result: bytes | AbortCode | None, now: Time) -> bool:
        """Answer an ObjectAccessPending: bytes if it was a read, None if it was a write and is done, an abort code to refuse it.

        Sends the response that was held. False if nobody waits for it any more (timeout, abort, a new request), which is no fault
        of the host. Raises LocalProtocolError if the result is not of the access's kind.
        """
        if self._state != _AWAITING_HOST or access_id != self._access_id:
            return False
        if isinstance(result, AbortCode):
            self._abort(result)
        elif result is None and self._answer is not None:
            self._confirm(self._answer)
        elif isinstance(result, bytes) and self._answer is None:
            self._state = _IDLE
            self._respond_upload(result, now)
        else:
            expected = "bytes" if self._answer is None else "None"
            where = f"access {access_id} to 0x{self._index:04X}:{self._subindex:02X}, node {self.node_id}"
            raise LocalProtocolError(f"completion of {where}: {expected} or an AbortCode expected, not {result!r}")
        return True

    def enable(self) -> None:
        """Answer requests (NMT states pre-operational and operational)."""
        if not self.enabled:
            self.enabled = True
            self._reroute()

    def disable(self) -> None:
        """Be silent (NMT states initialising and stopped). A running transfer is forgotten without a frame, as by `reset`."""
        self.reset()
        if self.enabled:
            self.enabled = False
            self._reroute()

    def reset(self) -> None:
        """Forget a running transfer without a frame: SdoServerAborted with origin CANCELLED says so."""
        if self._state != _IDLE:
            self._report(AbortCode.DEVICE_STATE, AbortOrigin.CANCELLED)
            self._become_idle()

    # ---- getters ----

    @property
    def busy(self) -> bool:
        """Whether a transfer is under way."""
        return self._state != _IDLE

    def can_ids(self) -> tuple[int, ...]:
        return (self._request_key,) if self.enabled else ()

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
        if state == _UPLOADING:
            if command & ~0x0F == self._command:
                self._on_upload_segment(command, data, now)
                return
        elif state == _DOWNLOADING and command & ~0x0F == self._command:
            self._on_download_segment(command, data, now)
            return
        _HANDLERS[command >> 5](self, command, data, frame, now)

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        if self._state == _AWAITING_HOST:
            self._abort(AbortCode.CANNOT_TRANSFER, AbortOrigin.TIMEOUT)
        elif not self._last:  # what we took for a copy was all that came: the client does not alternate its toggle
            self._abort(AbortCode.TOGGLE_NOT_ALTERNATED, AbortOrigin.TIMEOUT)
        else:
            self._abort(AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT)

    # ---- upload ----

    def _on_initiate_upload(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.6"""
        if self._state != _IDLE and not self._replace(data, frame):
            return
        self._index, self._subindex = MULTIPLEXER.unpack(data)
        self._last = data
        content = self._store.read(self._index, self._subindex, now)
        if isinstance(content, bytes):
            self._respond_upload(content, now)
        elif isinstance(content, Pending):
            self._await_host(None, None, now)
        else:
            self._abort(content)

    def _respond_upload(self, content: bytes, now: Time) -> None:
        size = len(content)
        if 0 < size <= MAX_EXPEDITED:
            command = INITIATE_UPLOAD_RESPONSE | EXPEDITED_BITS[size]
            payload = EXPEDITED.pack(command, self._index, self._subindex, content)
            self.out.frames.append(Frame(self._response_can_id, payload, self._response_flags, 8))
            self.deadline = NEVER
            return
        payload = INITIATE.pack(INITIATE_UPLOAD_RESPONSE | SIZE_BIT, self._index, self._subindex, size)
        self.out.frames.append(self._frame(payload))
        self._state = _UPLOADING
        self._command = UPLOAD_SEGMENT
        self._content = content
        self._offset = 0
        self._arm(now + self.timeout)

    def _on_upload_segment(self, command: int, data: bytes, now: Time) -> None:
        """A request with the right toggle; CiA 301 v4.2.0, 7.2.4.3.7"""
        content = self._content
        offset = self._offset
        payload = segment(command & TOGGLE, content, offset)
        self.out.frames.append(Frame(self._response_can_id, payload, self._response_flags, 8))
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
            answer = Frame(self._response_can_id, payload, self._response_flags, 8)
            self._write(data[4 : 8 - unused], answer, now)
            return
        size = announced if command & SIZE_BIT else None
        refusal = self._store.check_write(index, subindex, size)
        if refusal is None and size is not None and size > self.max_download:
            refusal = AbortCode.OUT_OF_MEMORY
        if refusal is not None:
            self._abort(refusal)
            return
        self.out.frames.append(self._frame(INITIATE.pack(INITIATE_DOWNLOAD_RESPONSE, index, subindex, 0)))
        self._announced = _UNKNOWN_SIZE if size is None else size
        self._limit = self.max_download if size is None else size
        self._state = _DOWNLOADING
        self._command = DOWNLOAD_SEGMENT
        self._arm(now + self.timeout)

    def _surplus(self, index: int, subindex: int) -> int:
        """How many of four bytes of unspecified size are too many for the object."""
        for unused in (0, 1, 2, 3):
            if self._store.check_write(index, subindex, 4 - unused) is None:
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
            self.out.frames.append(acknowledgement)
            self.deadline = deadline = now + self.timeout
            if deadline < self._wake:
                self._arm(deadline)
        elif len(buffer) < self._announced:
            self._abort(AbortCode.LENGTH_TOO_LOW)
        else:
            self._last = data
            self._write(bytes(buffer), acknowledgement, now)

    def _write(self, content: bytes, answer: Frame, now: Time) -> None:
        result = self._store.write(self._index, self._subindex, content, now)
        if result is None:
            self._confirm(answer)
        elif isinstance(result, Pending):
            self._await_host(content, answer, now)
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

    def _on_block(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """Block transfer is refused; an initiate ends a running transfer like any other. CiA 301 v4.2.0, 7.2.4.3.9, .13"""
        is_initiate = not command & (3 if command & SPECIFIER == BLOCK_UPLOAD else 1)
        if is_initiate:
            if self._state != _IDLE and not self._replace(data, frame):
                return
            self._index, self._subindex = MULTIPLEXER.unpack(data)
            self._abort(AbortCode.INVALID_COMMAND)
        else:
            self._on_unknown(command, data, frame, now)

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
        return True

    def _await_host(self, content: bytes | None, answer: Frame | None, now: Time) -> None:
        self._access_id = self.out.next_request_id()
        self._answer = answer
        self._state = _AWAITING_HOST
        self.out.events.append(ObjectAccessPending(self.node_id, self._access_id, self._index, self._subindex, content))
        self._arm(now + self.access_timeout)

    def _abort(self, abort_code: AbortCode, origin: AbortOrigin = AbortOrigin.LOCAL) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.17"""
        self.out.frames.append(self._frame(INITIATE.pack(ABORT, self._index, self._subindex, abort_code)))
        self._report(abort_code, origin)
        self._become_idle()

    def _become_idle(self) -> None:
        self._state = _IDLE
        self.deadline = NEVER
        self._content = b""
        if self._buffer:
            self._buffer = bytearray()

    def _frame(self, payload: bytes) -> Frame:
        return Frame(self._response_can_id, payload, self._response_flags)

    def _report(self, abort_code: int, origin: AbortOrigin) -> None:
        self.out.events.append(SdoServerAborted(self.node_id, self._index, self._subindex, abort_code, origin))

    def _ignore(self, frame: Frame, reason: str) -> None:
        self.out.events.append(FrameIgnored(self.node_id, frame, reason))


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
