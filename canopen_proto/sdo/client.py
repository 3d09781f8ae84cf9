"""SDO client: reads (uploads) and writes (downloads) the objects of one server. CiA 301 v4.2.0, 7.2.4.

A client and a server share one channel, a pair of COB-IDs, and at most one transfer is under way on it. Requests queue up (first
in, first out; urgent ones before all others) and each ends in exactly one outcome: SdoUploaded, SdoDownloaded or SdoAborted.

A request is a `Transfer` from the beginning (transfer.py; segmented_client.py and block_client.py have the kinds). SdoClient
begins it when its turn comes, hands it the server's frames, and judges those that are not due.

Up to 4 bytes go expedited, in the initiate frames themselves; more, and none at all, go in segments of 7 bytes, each asked for or
acknowledged before the next one goes. The server chooses how an upload goes. Each response starts the `timeout` again.

Checked are the command specifier, the multiplexer of every frame that has one, the toggle bit in both directions, the
announced size against what arrives, and `max_upload`. A fault ends the transfer with an abort that names its object.

A frame that is not of this transfer is not acted on, and reported (FrameIgnored), where that is safe:
- an initiate response or abort for another object: late, of a transfer that we gave up. (An abort for 0x0000:00 counts while
  segments go, because a server that lost its transfer cannot name the object; before, it answers a copy of the last segment.)
- the second copy of the last response, which CAN itself can make. Its toggle tells it from the next one.
- anything unexpected before the first response, if the transfer before ended without its last response.
Everything else unexpected is an abort with 0x05040001 or 0x05030000.

SDO cannot tell two things apart: a second copy (or a late one, after a timeout or `cancel`) of an answer, and the answer to the
*next* request, if both transfer the same object in the same direction. Two pauses close that gap by time.
- `late_guard`, after a time-out: the same object is not accessed again until its late answer has come (it is reported as
  FrameIgnored), until the server has answered something else, or until that much time is over. Without it, each answer of a
  server that is slower than `timeout` would be taken for the answer to the next request. Both directions wait, since an abort
  does not say which it means. Other objects need not wait, nor do urgent requests (a halt matters more than its confirmation).
- `copy_guard`: such a request, and any request after a transfer that was given up, waits until that long after the end of the
  one before. It is 0 by default, for buses that make no copies; about a millisecond will do on a real one.
Under copies that come later still, or out of order, every transfer still ends, but its bytes may be wrong: a segmented transfer
has a one-bit sequence number and no checksum. Block transfer has one.

A download that ends without an answer may have been executed: SdoAborted says so (`not_confirmed`).

Block transfer, on request: `block=True` (that or an abort), `block="auto"` (for downloads of more than AUTO_BLOCK bytes and any
upload, if the server has it; see block_client.py), and streams, which never hold the whole: `download_stream` is fed piece by
piece, `upload_stream` hands out SdoChunk by SdoChunk. block.py tells how it goes.

Left out: network indication. Retries are the caller's: SDO knows no repetition (block transfer repeats lost segments only), and a
repeated download may be executed twice.
"""

from __future__ import annotations

from typing import Final, Literal, TypeAlias

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.machine import MILLISECOND, NEVER, LocalProtocolError, Outbox, RequestId, Time
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, MAX_BURST, MAX_SIZE, STREAM_TIMEOUT
from canopen_proto.sdo.block_client import NO_BLOCKS, BlockDownload, BlockUpload
from canopen_proto.sdo.codec import (
    ABORT,
    INITIATE,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD,
    INITIATE_UPLOAD_RESPONSE,
    LEAST_RESPONSE,
    NO_MULTIPLEXER,
    SIZE,
    SPECIFIER,
    complete,
)
from canopen_proto.sdo.events import SdoAborted, SdoChunk, SdoDataWanted, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from canopen_proto.sdo.request_queue import RequestQueue
from canopen_proto.sdo.segmented_client import Download, Upload, own
from canopen_proto.sdo.transfer import INITIATED, OVER, Buffer, ChannelEnd, Transfer

__all__ = [
    "AUTO_BLOCK", "LATE_GUARD", "MAX_QUEUE", "MAX_UPLOAD", "TIMEOUT", "Block", "SdoAborted", "SdoChunk", "SdoClient",
    "SdoDataWanted", "SdoDownloaded", "SdoStreamUploaded", "SdoUploaded",
]  # fmt: skip

TIMEOUT: Final = 500 * MILLISECOND
"""How long a server may take for each response: devices that write flash on the way take 100 ms and more."""
LATE_GUARD: Final = 500 * MILLISECOND
"""How long after a time-out its answer is waited for before the same object is asked for again: a server that is twice as slow as
expected is still understood, and a dead one costs no more than another time-out."""
MAX_QUEUE: Final = 256
"""Requests that may wait, urgent ones counted apart (at least 1): enough to configure all PDOs of a node at once."""
MAX_UPLOAD: Final = 16 << 20
"""Largest value that is accepted: a firmware image fits, and a server gone mad does not fill the memory."""
AUTO_BLOCK: Final = 28
"""Above so many bytes, a block transfer takes fewer frames than a segmented one."""

Block: TypeAlias = bool | Literal["auto"]
"""Whether a transfer goes in blocks: False; True (or it fails); "auto": if that takes fewer frames and the server has blocks."""

_OUT_OF_PLACE: Final = (AbortCode.INVALID_COMMAND, AbortCode.TOGGLE_NOT_ALTERNATED)
"""How servers answer a second copy of a segment."""


class SdoClient(ChannelEnd):
    """The client of one SDO channel; see this module's text.

    serves_blocks: False once the server has refused a block transfer with 0x05040001 and the object's name: "auto" does without
    then.
    """

    __slots__ = ("_nameless_abort", "_queue", "_transfer", "late_guard", "max_queue", "max_upload", "serves_blocks")

    def __init__(
        self,
        out: Outbox,
        node_id: int,
        *,
        request_key: RoutingKey | None = None,
        response_key: RoutingKey | None = None,
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
        of a stream may take for each piece. All may be changed later, and then count for the requests that are made from then on.
        """
        super().__init__(out, node_id, False, request_key, response_key)
        self.timeout = timeout
        self.stream_timeout = stream_timeout
        self.copy_guard = copy_guard
        self.crc = crc
        self.block_size = block_size
        self.max_burst = max_burst
        self.burst_interval = burst_interval
        self.late_guard = late_guard
        self.max_queue = max_queue
        self.max_upload = max_upload
        self.serves_blocks = True
        self._queue = RequestQueue()
        self._transfer: Transfer | None = None
        self._nameless_abort = b""  # one that came while a block transfer was initiated

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
            return self._submit(Upload(self, index, subindex, self.max_upload), urgent, now)
        plain = Upload(self, index, subindex, self.max_upload) if block == "auto" else None
        return self._submit(BlockUpload(self, index, subindex, False, self.max_upload, plain), urgent, now)

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
            return self._submit(Download(self, index, subindex, data), urgent, now)
        content = own(data, index, subindex)
        plain = Download(self, index, subindex, content) if block == "auto" else None
        return self._submit(BlockDownload(self, index, subindex, content, len(content), plain), urgent, now)

    def upload_stream(self, index: int, subindex: int, now: Time, *, urgent: bool = False) -> RequestId:
        """Read an object piece by piece, by block transfer, whatever its size (`max_upload` is not looked at).

        SdoChunk follows for each piece, and waits for `proceed` (the last one does not); then SdoStreamUploaded or SdoAborted.
        Else as `upload(block=True)`. Source: CiA 301 v4.2.0, 7.2.4.3.12.
        """
        return self._submit(BlockUpload(self, index, subindex, True, MAX_SIZE), urgent, now)

    def proceed(self, request_id: RequestId, now: Time) -> bool:
        """Ask for the next piece of an upload stream: the last SdoChunk was taken.

        The server waits meanwhile, for `stream_timeout` at most, and for as long as it has patience. Returns False if the request
        is not under way, or no longer.
        """
        transfer = self._transfer
        if transfer is None or transfer.request_id != request_id or not transfer.proceed(now):
            return False
        self._arm(transfer.deadline)
        return True

    def download_stream(
        self, index: int, subindex: int, now: Time, *, size: int | None = None, urgent: bool = False
    ) -> RequestId:
        """Write an object piece by piece, by block transfer. size: in bytes, if it is known; servers may insist on it.

        `feed` it, at once or when SdoDataWanted asks for more; then SdoDownloaded or SdoAborted follows. If it is not fed for
        `stream_timeout`, the transfer is aborted. Else as `download(block=True)`. Source: CiA 301 v4.2.0, 7.2.4.3.8.
        """
        return self._submit(BlockDownload(self, index, subindex, None, size), urgent, now)

    def feed(self, request_id: RequestId, piece: Buffer, now: Time, *, last: bool = False) -> bool:
        """Give a download stream its next bytes, any number. last: no more follow; may be left out if the size was announced.

        They are copied, and held until the server has them. Returns False if the request is not open, or no longer. Raises
        LocalProtocolError if more than MAX_FED bytes would be held, if they are more or fewer than were announced, and after the
        last; nothing has changed then.
        """
        transfer = self._find(request_id)
        if transfer is None:
            return False
        transfer.feed(piece, last, now)
        if transfer is self._transfer:
            self._arm(transfer.deadline)
        return True

    def room(self, request_id: RequestId) -> int:
        """Return how many bytes a download stream may be fed now; 0 if it is not open, or is no download stream."""
        transfer = self._find(request_id)
        return 0 if transfer is None else transfer.room

    def delivered(self, request_id: RequestId) -> int:
        """Return how many bytes of a download the server has acknowledged; 0 if it is not open. The last segment, filled up with
        unused bytes, counts whole."""
        transfer = self._find(request_id)
        return 0 if transfer is None else transfer.delivered

    def cancel(self, request_id: RequestId, now: Time) -> bool:
        """Give a request up: SdoAborted with origin CANCELLED follows at once. Returns False if it is not open, or no longer.

        For a request that waits, nothing was sent and nothing is. A running transfer is aborted on the wire with 0x08000000, and
        the next request goes out at once.
        """
        transfer = self._find(request_id)
        if transfer is None:
            return False
        if transfer is self._transfer:
            transfer.abort(AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED)
            self._follow(transfer, now)
            return True
        self._queue.remove(transfer)
        self.report_abort(transfer, AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED, False)
        if self._transfer is None:
            self._begin_next(now)  # copy_guard may have held back the one that is gone
        return True

    def abort_all(self, abort_code: int, now: Time) -> None:
        """End all requests (the server is gone): SdoAborted with origin LOCAL for each; the running one is aborted on the bus."""
        if not 0 <= abort_code <= 0xFFFFFFFF:
            raise LocalProtocolError(f"node {self.node_id}: {abort_code} is no abort code (0..0xFFFFFFFF)")
        waiting = self._queue.clear()
        if self._transfer is not None:
            transfer = self._transfer
            transfer.abort(abort_code)
            self._follow(transfer, now)
        for transfer in waiting:
            self.report_abort(transfer, abort_code, AbortOrigin.LOCAL, False)
        self.deadline = NEVER

    # ---- getters ----

    @property
    def busy(self) -> bool:
        """Whether any request is running or waiting."""
        return self._transfer is not None or len(self._queue) > 0

    @property
    def waiting(self) -> int:
        """The number of requests that wait."""
        return len(self._queue)

    def can_ids(self) -> tuple[RoutingKey, ...]:
        return (self._hears,)

    # ---- inputs ----

    def receive(self, frame: Frame, now: Time) -> None:
        data = frame.data
        if len(data) != 8:
            completed = complete(data, LEAST_RESPONSE)
            if completed is None:
                self.ignore(frame, "too short for an SDO response")
                return
            data = completed
        transfer = self._transfer
        if transfer is None:
            self._on_stray(data, frame, now)
            return
        if not transfer.receive(data[0], data, frame, now):
            self._on_other(transfer, data[0], data, frame)
        if transfer.state is OVER:
            self._go_on(transfer, now)
        else:
            self.deadline = deadline = transfer.deadline
            if deadline < self._wake:
                self._arm(deadline)

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        transfer = self._transfer
        if transfer is None:
            self._begin_next(now)  # a request was held back
            return
        if self._nameless_abort and transfer.state is INITIATED:
            self._take_for_refusal(transfer, self._nameless_abort)
        else:
            if transfer.state is INITIATED and (transfer.first[0] == INITIATE_UPLOAD or transfer.is_all_sent):
                # A late answer may be a whole one, and would look like that to the next such request
                self._queue.expect_late(transfer.first[1:4], now + self.late_guard)
            transfer.handle_timeout(now)
        self._follow(transfer, now)

    # ---- what is not due ----

    def _on_stray(self, data: bytes, frame: Frame, now: Time) -> None:
        """Take a frame while no transfer is under way."""
        if self._queue.is_overdue(data[0] & SPECIFIER, data[1:4]):
            self.ignore(frame, "late response to a request that timed out")
            self._begin_next(now)  # it may have waited for this
        else:
            self.ignore(frame, "no transfer is under way")

    def _on_other(self, transfer: Transfer, command: int, data: bytes, frame: Frame) -> None:
        """Take an abort, or whatever is not the response that is due."""
        specifier = command & SPECIFIER
        is_named = data[1:4] == transfer.first[1:4]
        is_initiate = specifier in (INITIATE_UPLOAD_RESPONSE, INITIATE_DOWNLOAD_RESPONSE)
        if not is_named and not transfer.is_answered and self._queue.is_overdue(specifier, data[1:4]):
            self.ignore(frame, "late response to a request that timed out")
        elif specifier == ABORT:
            self._on_abort(transfer, is_named, data, frame)
        elif is_initiate and not is_named:
            self.ignore(frame, "response about another object")
        elif is_initiate and data[:4] == self.last[:4]:
            # Up to three: request and answer may both be copied, and the value may have changed between the two answers
            self.ignore(frame, "second copy of the last response")
        elif data == self.last:
            self.last = b""  # once
            self.ignore(frame, "second copy of the last response")
        elif self._queue.unsettled and not transfer.is_answered:
            self.ignore(frame, "late response of a transfer that was given up")
        else:
            transfer.abort(transfer.fault_of(command))

    def _on_abort(self, transfer: Transfer, is_named: bool, data: bytes, frame: Frame) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.17.

        If a last segment came twice and the answer to the first copy was lost, the server says that the second one is out of
        place, without an object or with that of the transfer that it has just executed: that is no refusal. If the answer was not
        lost, this abort meets the next transfer. Servers that do not know block transfer say the same to its initiation: so there
        it counts only if nothing else comes.
        """
        is_nameless = data[1:4] == NO_MULTIPLEXER
        if is_named or (transfer.has_begun and is_nameless):
            finds_a_copy = transfer.has_begun and SIZE.unpack_from(data, 4)[0] in _OUT_OF_PLACE
            is_refusal = is_named and not finds_a_copy
            self._end_by_abort(transfer, data, not is_refusal and transfer.is_all_sent)
            return
        if is_nameless and transfer.in_blocks:
            self._nameless_abort = data
        self.ignore(frame, "abort of another object's transfer")

    def _end_by_abort(self, transfer: Transfer, data: bytes, not_confirmed: bool) -> None:
        """The server has aborted the transfer; if it is blocks that it refuses, a plain one may take its place."""
        abort_code: int = SIZE.unpack_from(data, 4)[0]
        self.last = data
        if transfer.state is INITIATED and transfer.in_blocks:
            if abort_code == AbortCode.INVALID_COMMAND and data[1:4] == transfer.first[1:4]:  # else it is a guess
                self.serves_blocks = False
            plain = transfer.plain
            if plain is not None and abort_code in NO_BLOCKS:
                plain.request_id = transfer.request_id
                transfer.is_given_up = True  # a second copy of the abort may come: copy_guard
                self._queue.urgent.appendleft(plain)
                transfer.state = OVER
                return
        self.report_abort(transfer, abort_code, AbortOrigin.PEER, not_confirmed)
        transfer.state = OVER

    def _take_for_refusal(self, transfer: Transfer, data: bytes) -> None:
        """Take an abort without an object's name for the server's: nothing else has come in time.

        The server has no blocks, or its answer is late. So the transfer is aborted on the wire, and a late answer does not count.
        """
        self.send(INITIATE.pack(ABORT, transfer.index, transfer.subindex, AbortCode.TIMED_OUT))
        transfer.is_given_up = True
        self._end_by_abort(transfer, data, False)

    def report_abort(self, transfer: Transfer, abort_code: int, origin: AbortOrigin, not_confirmed: bool) -> None:
        is_silent = origin is AbortOrigin.TIMEOUT and abort_code != AbortCode.CANNOT_TRANSFER  # that is our own side's silence
        waited = transfer.patience if is_silent else 0
        request_id, index, subindex = transfer.request_id, transfer.index, transfer.subindex
        self.out.events.append(SdoAborted(self.node_id, request_id, index, subindex, abort_code, origin, not_confirmed, waited))

    # ---- the queue ----

    def _find(self, request_id: RequestId) -> Transfer | None:
        """Return the request of that id, if it is open."""
        transfer = self._transfer
        if transfer is not None and transfer.request_id == request_id:
            return transfer
        return self._queue.find(request_id)

    def _submit(self, transfer: Transfer, urgent: bool, now: Time) -> RequestId:
        queue = self._queue
        line = queue.urgent if urgent else queue.others
        if len(line) >= self.max_queue:
            raise LocalProtocolError(f"{transfer}, node {self.node_id}: {len(line)} requests are waiting already")
        transfer.request_id = request_id = self.out.next_request_id()
        if self._transfer is not None:
            line.append(transfer)
        elif line or queue.urgent or self.copy_guard or queue.overdue:
            line.append(transfer)
            self._begin_next(now)
        else:
            self._begin(transfer, now)
        return request_id

    def _begin_next(self, now: Time) -> None:
        """Begin the transfer whose turn it is, if there is one."""
        transfer = self._queue.take(now, self.copy_guard)
        if transfer is not None:
            self._begin(transfer, now)
        else:
            self._arm(self._queue.held_until)

    def _begin(self, transfer: Transfer, now: Time) -> None:
        self._transfer = transfer
        self._nameless_abort = b""
        self.out.frames.append(Frame(self.can_id, transfer.first, self.flags, 8))
        transfer.deadline = self.deadline = deadline = now + self.timeout
        if deadline < self._wake:
            self._arm(deadline)

    def _follow(self, transfer: Transfer, now: Time) -> None:
        """Do what the transfer under way wants now: wait for its deadline, or go on without it."""
        if transfer.state is OVER:
            self._go_on(transfer, now)
        else:
            self._arm(transfer.deadline)

    def _go_on(self, transfer: Transfer, now: Time) -> None:
        """The transfer is over: go on with the one that takes its place, or with the next request."""
        if transfer.instead is not None:
            self._transfer = transfer.instead
            self._follow(transfer.instead, now)
            return
        self._transfer = None
        self.deadline = NEVER
        queue = self._queue
        queue.remember(transfer, now)
        if queue.urgent or queue.others:
            self._begin_next(now)
