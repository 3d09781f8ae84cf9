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

An answer of one frame does not tell which request it is for. So a second copy of an answer (or a late one, after a time-out or
`cancel`) looks like the answer to the *next* request, if both transfer the same object in the same direction; a refusal does in
both directions. CAN copies requests too, and a server answers both copies. A question and two pauses close that gap.
- A question: the client reads another object (QUESTIONS, 0x1000 first) and drops its value. CAN keeps the order of the server's
  frames: once that answer has come, nothing that was asked for before it is left. A question comes before a write of 1 to 4 bytes
  to the object of the transfer before, unless that was a read that brought such a value; before any request of one frame for an
  object whose transfer was given up without an answer, or whose write ended because of another client; and before a request that
  is made again, since its refusal may be that of the write before (a read, or a write of which no data were sent). None comes
  before an urgent request, nor once `timeout` has passed since the server's last word. A question without an answer holds its
  request for `timeout`.
- `late_guard`, after a time-out: the same object is not accessed again until its late answer has come (it is reported as
  FrameIgnored), until the server has answered something else, or until that much time is over. Without it, each answer of a
  server that is slower than `timeout` would be taken for the answer to the next request. Both directions wait, since an abort
  does not say which it means. Other objects need not wait, nor do urgent requests (a halt matters more than its confirmation).
- `copy_guard`: a request that looks like the one before, and any request after a transfer that was given up, waits until that
  long after the end of the one before. It is 0 by default. It is there for two reads of one object in a row, which ask no
  question: the second may get the answer to the first again. About a millisecond will do on a real bus.
Under copies that come later still, or out of order, every transfer still ends, but its bytes may be wrong: a segmented transfer
has a one-bit sequence number and no checksum. Block transfer has one.

A download that ends without an answer may have been executed: SdoAborted says so (`not_confirmed`).

Block transfer, on request: `block=True` (that or an abort), `block="auto"` (for downloads of more than AUTO_BLOCK bytes and any
upload, if the server has it; see block_client.py), and streams, which never hold the whole: `download_stream` is fed piece by
piece, `upload_stream` hands out SdoChunk by SdoChunk. block.py tells how it goes.

Another client may use the same channel, against the rules. Its requests are heard (contention.py). A request of ours waits
until its exchange is over, at most `contest_limit`. A frame of it during a transfer of ours ends the transfer: nothing that comes
then is certain. A read is made again, a write is reported (origin CONTESTED, `not_confirmed`). Only while the expedited answer to
our initiate request is due, a stranger's initiate request for another object does no harm: the answer names its object. Urgent
requests do not wait. A server may be deaf in a stranger's transfer; so behind an urgent write of one frame that ended like that,
the next urgent write first aborts that transfer: a halt is sent again, and matters more. A driver never hands us our own frames:
they would be taken for a stranger's.

Left out: network indication. Retries are the caller's: SDO knows no repetition (block transfer repeats lost segments only), and a
repeated download may be executed twice.
"""

from __future__ import annotations

from typing import Final, Literal, TypeAlias

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, LocalProtocolError, Outbox, RequestId, Time
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, MAX_BURST, MAX_SIZE, STREAM_TIMEOUT
from canopen_proto.sdo.block_client import NO_BLOCKS, BlockDownload, BlockUpload
from canopen_proto.sdo.codec import (
    ABORT,
    EXPEDITED_BIT,
    INITIATE_DOWNLOAD,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD,
    INITIATE_UPLOAD_RESPONSE,
    LEAST_REQUEST,
    LEAST_RESPONSE,
    NO_MULTIPLEXER,
    SIZE,
    SPECIFIER,
    complete,
    pack_initiate,
)
from canopen_proto.sdo.contention import SERVICE_ERROR, Contested, OtherClient, is_own_refusal, is_value_for_other, spread
from canopen_proto.sdo.events import SdoAborted, SdoChunk, SdoDataWanted, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from canopen_proto.sdo.request_queue import RequestQueue
from canopen_proto.sdo.segmented_client import NOBODY, Download, Question, Upload, own
from canopen_proto.sdo.transfer import INITIATED, OVER, Buffer, Channel, ChannelEnd, Transfer

__all__ = [
    "AUTO_BLOCK", "CONTEST_LIMIT", "LATE_GUARD", "MAX_QUEUE", "MAX_UPLOAD", "TIMEOUT", "Block", "SdoAborted", "SdoChunk",
    "SdoClient", "SdoDataWanted", "SdoDownloaded", "SdoStreamUploaded", "SdoUploaded",
]  # fmt: skip

TIMEOUT: Final = 500 * MILLISECOND
"""How long a server may take for each response: devices that write flash on the way take 100 ms and more."""
LATE_GUARD: Final = 500 * MILLISECOND
"""How long after a time-out its answer is waited for before the same object is asked for again: a server that is twice as slow as
expected is still understood, and a dead one costs no more than another time-out."""
CONTEST_LIMIT: Final = 3 * SECOND
"""How long requests wait for another client on the channel, or are made again because of it, before they end as CONTESTED. A
client that reads value by value is done with each at once; a download of firmware takes longer than anybody wants to wait."""
MAX_URGENT_TRIES: Final = 3
"""How often an urgent read goes out, at once each time, while another client disturbs it. Then it waits for that client, as one
that is not urgent: more reads at once would only meet the answers to those before."""
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
    then. other: the other client on the channel, if there is one; its `count` of requests is 0 until one was heard.
    """

    __slots__ = (
        "_abandoned", "_collided_at", "_contested_since", "_nameless_abort", "_question", "_queue", "_transfer", "_tries",
        "contest_limit", "late_guard", "max_queue", "max_upload", "other", "serves_blocks",
    )  # fmt: skip

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
        contest_limit: Time = CONTEST_LIMIT,
        crc: bool = True,
        block_size: int = MAX_BLOCK_SIZE,
        max_burst: int = MAX_BURST,
        burst_interval: Time = 0,
        stream_timeout: Time = STREAM_TIMEOUT,
    ) -> None:
        """node_id: of the server. request_key, response_key: the channel (client to server, server to client) as `Frame.key`;
        the server's first one by default. timeout, copy_guard, late_guard, contest_limit: ns; see this module's text. Inside a
        block transfer pauses of at least 1 s are survived whatever the timeout is; see `silence_limit` in block.py. max_upload:
        bytes of an upload that is held whole. max_queue: requests that may wait, urgent ones counted apart.

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
        self.contest_limit = contest_limit
        self.max_queue = max_queue
        self.max_upload = max_upload
        self.serves_blocks = True
        self._queue = RequestQueue()
        self._transfer: Transfer | None = None
        self._nameless_abort = b""  # one that came while a block transfer was initiated
        self.other = OtherClient()
        self._question: Question | None = None  # the last one
        self._abandoned: Transfer | None = None  # ended for a stranger's sake: the server may still be in it
        self._collided_at: Time = -NEVER  # when a stranger last ended a transfer of ours
        self._contested_since: Time = NEVER  # when a stranger first made us wait, and no transfer of ours has gone well since
        self._tries = 0  # of an urgent read, since then

    # ---- commands ----

    def upload(
        self,
        index: int,
        subindex: int,
        now: Time,
        *,
        urgent: bool = False,
        block: Block = False,
        timeout: Time | None = None,
        most: int | None = None,
    ) -> RequestId:
        """Ask the server for an object's value.

        Sends an initiate request, at once if no transfer is under way. SdoUploaded or SdoAborted follows, at the latest `timeout`
        after the last frame of the transfer; in blocks two silences after it (`silence_limit`, block.py). index 0..0xFFFF,
        subindex 0..0xFF. urgent: goes before all requests that are not. block: see `Block`; "auto" asks for a block transfer
        first, whatever the size. timeout, most: ns, and bytes, of this request alone, in place of the client's `timeout` and
        `max_upload`. Raises LocalProtocolError if the queue is full or the numbers are impossible.
        Source: CiA 301 v4.2.0, 7.2.4.3.5 and 7.2.4.3.12.
        """
        if most is None:
            most = self.max_upload
        if not block or (block == "auto" and not self.serves_blocks):
            return self._submit(Upload(self, index, subindex, most), urgent, now, timeout)
        plain = Upload(self, index, subindex, most) if block == "auto" else None
        return self._submit(BlockUpload(self, index, subindex, False, most, plain), urgent, now, timeout)

    def download(
        self,
        index: int,
        subindex: int,
        data: Buffer,
        now: Time,
        *,
        urgent: bool = False,
        block: Block = False,
        timeout: Time | None = None,
    ) -> RequestId:
        """Write an object's value: 1 to 4 bytes expedited, anything else (nothing too) in segments or, on request, in blocks.
        data: its bytes, little-endian.

        Sends an initiate request, at once if no transfer is under way. SdoDownloaded or SdoAborted follows, at the latest
        `timeout` after the last frame of the transfer; in blocks two silences after it (`silence_limit`, block.py).
        index 0..0xFFFF, subindex 0..0xFF. urgent: goes before all requests that are not. block: see `Block`. timeout: ns, of this
        request alone; None: the client's. Raises LocalProtocolError if the queue is full or the numbers are impossible.
        Source: CiA 301 v4.2.0, 7.2.4.3.2 and 7.2.4.3.8.
        """
        if not block or (block == "auto" and (not self.serves_blocks or len(data) <= AUTO_BLOCK)):
            return self._submit(Download(self, index, subindex, data), urgent, now, timeout)
        content = own(data, index, subindex)
        plain = Download(self, index, subindex, content) if block == "auto" else None
        return self._submit(BlockDownload(self, index, subindex, content, len(content), plain), urgent, now, timeout)

    def upload_stream(self, index: int, subindex: int, now: Time, *, urgent: bool = False) -> RequestId:
        """Read an object piece by piece, by block transfer, whatever its size (`max_upload` is not looked at). urgent: goes
        before all requests that are not.

        SdoChunk follows for each piece, and waits for `proceed` (the last one does not); then SdoStreamUploaded or SdoAborted.
        Else as `upload(block=True)`. Source: CiA 301 v4.2.0, 7.2.4.3.12.
        """
        return self._submit(BlockUpload(self, index, subindex, True, MAX_SIZE), urgent, now)

    def proceed(self, request_id: RequestId, now: Time) -> bool:
        """Ask for the next piece of an upload stream: the last SdoChunk was taken. request_id: the chunk's.

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
        """Write an object piece by piece, by block transfer. size: in bytes, if it is known; servers may insist on it. urgent:
        goes before all requests that are not.

        `feed` it, at once or when SdoDataWanted asks for more; then SdoDownloaded or SdoAborted follows. If it is not fed for
        `stream_timeout`, the transfer is aborted. Else as `download(block=True)`. Source: CiA 301 v4.2.0, 7.2.4.3.8.
        """
        return self._submit(BlockDownload(self, index, subindex, None, size), urgent, now)

    def feed(self, request_id: RequestId, piece: Buffer, now: Time, *, last: bool = False) -> bool:
        """Give a download stream its next bytes. request_id: the one that `download_stream` returned. piece: any number of bytes.
        last: no more follow; may be left out if the size was announced.

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
        """Return how many bytes a download stream may be fed now; 0 if it is not open, or is no download stream. request_id: the
        one that `download_stream` returned."""
        transfer = self._find(request_id)
        return 0 if transfer is None else transfer.room

    def delivered(self, request_id: RequestId) -> int:
        """Return how many bytes of a download the server has acknowledged; 0 if it is not open. The last segment, filled up with
        unused bytes, counts whole. request_id: the one that the download returned."""
        transfer = self._find(request_id)
        return 0 if transfer is None else transfer.delivered

    def cancel(self, request_id: RequestId, now: Time) -> bool:
        """Give a request up: SdoAborted with origin CANCELLED follows at once. Returns False if it is not open, or no longer.
        request_id: the one that the request returned.

        For a request that waits, nothing was sent and nothing is. A running transfer is aborted on the wire with 0x08000000, and
        the next request goes out at once.
        """
        transfer = self._find(request_id)
        if transfer is None:
            return False
        if transfer is self._transfer:
            self._leave(transfer, now)
            transfer.abort(AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED)
            self._follow(transfer, now)
            return True
        self._queue.remove(transfer)
        self.report_abort(transfer, AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED, False)
        if self._transfer is None:
            if not self._queue.waits:
                self._contested_since = NEVER
            self._begin_next(now)  # copy_guard may have held back the one that is gone
        return True

    def not_submitted(self, index: int, subindex: int) -> SdoAborted:
        """Return the outcome of a request that its caller has given up before this client had it."""
        return SdoAborted(self.node_id, NOBODY, index, subindex, AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED)

    def make_way(self, now: Time, *, is_asked: bool = False) -> None:
        """Give the transfer under way up, as `cancel` does, if an urgent request waits for it. Does nothing if it is urgent
        itself, or a question, which is over soon. is_asked: an urgent request of another channel waits for an answer."""
        transfer, waits = self._transfer, is_asked or bool(self._queue.urgent)
        if transfer is not None and waits and not transfer.is_urgent and transfer.request_id != NOBODY:
            self.cancel(transfer.request_id, now)

    def abort_all(self, abort_code: int, now: Time) -> None:
        """End all requests (the server is gone): SdoAborted with origin LOCAL for each; the running one is aborted on the bus.
        abort_code: 0..0xFFFFFFFF, else LocalProtocolError."""
        if not 0 <= abort_code <= 0xFFFFFFFF:
            raise LocalProtocolError(f"node {self.node_id}: {abort_code} is no abort code (0..0xFFFFFFFF)")
        waiting = self._queue.clear()
        self._forget_other()
        if self._transfer is not None:
            transfer = self._transfer
            transfer.abort(abort_code)
            self._follow(transfer, now)
        for transfer in waiting:
            self.report_abort(transfer, abort_code, AbortOrigin.LOCAL, False)
        self.deadline = NEVER

    def set_channel(self, channel: Channel | None, now: Time) -> None:
        """Be the client of another channel (client to server, server to client). Does nothing if it is the same.

        Open requests end: SdoAborted, 0x08000022, origin LOCAL. None: of no channel, which only a ChannelClient can do without.
        """
        if channel != self.channel:
            self.abort_all(AbortCode.DEVICE_STATE, now)
            self._question = None  # its frame is of the old channel
            self._use(channel)
            self._reroute()

    # ---- getters ----

    @property
    def busy(self) -> bool:
        """Whether any request is running or waiting."""
        return self._transfer is not None or len(self._queue) > 0

    @property
    def waiting(self) -> int:
        """The number of requests that wait."""
        return len(self._queue)

    def waiting_writes(self, index: int, subindex: int) -> list[RequestId]:
        """Return the downloads of an object that wait and are not urgent: nothing of them was sent. index: 0..0xFFFF, subindex:
        0..0xFF."""
        waiting = self._queue.others
        return [each.request_id for each in waiting if each.is_download and (each.index, each.subindex) == (index, subindex)]

    def can_ids(self) -> tuple[RoutingKey, ...]:
        return (self._hears, RoutingKey(self.can_id | self.flags << 29))  # the requests of others

    # ---- inputs ----

    def receive(self, frame: Frame, now: Time) -> None:
        data = frame.data
        if frame.key != self._hears and frame.can_id == self.can_id:
            self._on_foreign(frame, now)
            return
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
            self._on_other(transfer, data[0], data, frame, now)
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
        if transfer.is_contested:
            self._end_contested(transfer, now)
        elif self._nameless_abort and transfer.state is INITIATED:
            self._take_for_refusal(transfer, self._nameless_abort)
        else:
            if transfer.state is INITIATED and (transfer.first[0] == INITIATE_UPLOAD or transfer.is_all_sent):
                # A late answer may be a whole one, and would look like that to the next such request
                self._queue.expect_late(transfer.name, now, now + self.late_guard)
            else:
                self._leave(transfer, now)
            transfer.handle_timeout(now)
        self._follow(transfer, now)

    # ---- what is not due ----

    def _on_stray(self, data: bytes, frame: Frame, now: Time) -> None:
        """Take a frame while no transfer is under way."""
        was_held = bool(self.other.last)
        self.other.on_answer(data, self.timeout, now)
        if self._queue.is_overdue(data[0] & SPECIFIER, data[1:4]):
            self.ignore(frame, "late response to a request that timed out")
            self._begin_next(now)  # it may have waited for this
            return
        self.ignore(frame, "answer to another client" if was_held else "no transfer is under way")
        if was_held and (self._queue.waits or self._abandoned is not None):
            self._begin_next(now)

    def _on_other(self, transfer: Transfer, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """Take an abort, or whatever is not the response that is due."""
        specifier = command & SPECIFIER
        is_named = data[1:4] == transfer.name
        other = self.other
        if other.last:
            other.on_answer(data, self.timeout, now)
        is_initiate = specifier in (INITIATE_UPLOAD_RESPONSE, INITIATE_DOWNLOAD_RESPONSE)
        is_near = transfer.is_contested or now < other.heard_at + self.contest_limit
        if not is_named and not transfer.is_answered and self._queue.is_overdue(specifier, data[1:4]):
            self.ignore(frame, "late response to a request that timed out")
        elif is_named and is_value_for_other(transfer, command):
            self.ignore(frame, "answer to another client")
        elif is_near and self._is_in_doubt(transfer, specifier, is_named, data):
            if is_named and isinstance(transfer, Contested):
                is_refusal = specifier == ABORT and not transfer.is_shared
                is_alike = is_refusal or (specifier == INITIATE_UPLOAD_RESPONSE and not transfer.is_download)
                transfer.is_answered = transfer.believes and is_alike
            self._end_contested(transfer, now)
        elif specifier == ABORT:
            self._on_abort(transfer, is_named, data, frame, now)
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
            if not is_named:
                self._leave(transfer, now)
            transfer.abort(transfer.fault_of(command))

    def _leave(self, transfer: Transfer, now: Time) -> None:
        """Our side is about to give a transfer up: the server may answer it all the same."""
        if not transfer.is_answered:
            self._queue.leave(transfer.name, now + self.timeout)

    def _is_in_doubt(self, transfer: Transfer, specifier: int, is_named: bool, data: bytes) -> bool:
        """Return whether a frame may be a stranger's doing: one was heard just now."""
        if specifier == ABORT:
            if is_own_refusal(transfer, data):
                return False
            names_another = not is_named and data[1:4] != NO_MULTIPLEXER
            is_of_protocol = data[7] == SERVICE_ERROR
            if is_named and data[1:4] in self.other.unfinished:
                return True
            is_ours = is_named or transfer.has_begun
            return (transfer.is_contested and not names_another) or (is_of_protocol and is_ours)
        if specifier in (INITIATE_UPLOAD_RESPONSE, INITIATE_DOWNLOAD_RESPONSE) and not is_named and not transfer.in_blocks:
            return False
        return transfer.is_contested or data != self.last

    def _on_abort(self, transfer: Transfer, is_named: bool, data: bytes, frame: Frame, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.17.

        If a last segment came twice and the answer to the first copy was lost, the server says that the second one is out of
        place, without an object or with that of the transfer that it has just executed: that is no refusal. If the answer was not
        lost, this abort meets the next transfer. Servers that do not know block transfer say the same to its initiation: so there
        it counts only if nothing else comes.
        """
        is_nameless = data[1:4] == NO_MULTIPLEXER
        if is_named or (transfer.has_begun and is_nameless):
            finds_a_copy = transfer.has_begun and SIZE.unpack_from(data, 4)[0] in _OUT_OF_PLACE
            if is_named and self._queue.may_meet_another(transfer, now, self.timeout) and self._asks_again(transfer, data):
                return
            # Before an urgent write no answer is waited for, so the server may refuse a request that was given up
            is_late = now < self._queue.may_be_answered_until(transfer.name)
            is_refusal = is_named and not finds_a_copy and not is_late
            self._end_by_abort(transfer, data, not is_refusal and transfer.is_all_sent)
            return
        if is_nameless and transfer.in_blocks:
            self._nameless_abort = data
        self.ignore(frame, "abort of another object's transfer")

    def _asks_again(self, transfer: Transfer, data: bytes) -> bool:
        """Make a request again whose refusal may concern the transfer before; return whether it can be. data: of the refusal."""
        again = None if transfer.has_begun else transfer.again()
        if again is None:
            return False
        self.last = data
        transfer.is_given_up = True
        transfer.state = OVER
        self._put_first(again, transfer)
        self._queue.doubted = again
        return True

    def _put_first(self, again: Transfer, transfer: Transfer) -> None:
        """Let a request take the place of one that has ended."""
        again.request_id, again.is_urgent, again.own_timeout = transfer.request_id, transfer.is_urgent, transfer.own_timeout
        (self._queue.urgent if again.is_urgent else self._queue.others).appendleft(again)

    def _end_by_abort(self, transfer: Transfer, data: bytes, not_confirmed: bool) -> None:
        """The server has aborted the transfer; if it is blocks that it refuses, a plain one may take its place."""
        abort_code: int = SIZE.unpack_from(data, 4)[0]
        self.last = data
        if transfer.state is INITIATED and transfer.in_blocks:
            if abort_code == AbortCode.INVALID_COMMAND and data[1:4] == transfer.name:  # else it is a guess
                self.serves_blocks = False
            plain = transfer.plain
            if plain is not None and abort_code in NO_BLOCKS:
                plain.request_id, plain.is_urgent = transfer.request_id, transfer.is_urgent
                plain.own_timeout = transfer.own_timeout
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
        self.send(pack_initiate(ABORT, transfer.index, transfer.subindex, AbortCode.TIMED_OUT))
        transfer.is_given_up = True
        self._end_by_abort(transfer, data, False)

    def report_abort(self, transfer: Transfer, abort_code: int, origin: AbortOrigin, not_confirmed: bool) -> None:
        if transfer.request_id == NOBODY:
            transfer.is_answered |= origin is AbortOrigin.PEER
            return
        is_silent = origin is AbortOrigin.TIMEOUT and abort_code != AbortCode.CANNOT_TRANSFER  # that is our own side's silence
        waited = transfer.patience if is_silent else 0
        request_id, index, subindex = transfer.request_id, transfer.index, transfer.subindex
        other = self.other.heard if origin is AbortOrigin.CONTESTED else b""
        self.out.events.append(
            SdoAborted(self.node_id, request_id, index, subindex, abort_code, origin, not_confirmed, waited, other)
        )

    # ---- another client on the channel: contention.py ----

    def _on_foreign(self, frame: Frame, now: Time) -> None:
        """Take a request that we did not send."""
        data = complete(frame.data, LEAST_REQUEST)
        if data is None:
            self.ignore(frame, "too short for an SDO request")
            return
        transfer = self._transfer
        self.other.on_request(data, transfer, self.timeout, now)
        if transfer is None:
            if self._queue.waits or self._abandoned is not None:
                self._begin_next(now)
        elif not self.other.leaves_sure(transfer):
            self._end_contested(transfer, now)
            self._go_on(transfer, now)
        elif isinstance(transfer, Contested):
            transfer.is_shared |= self.other.has_asked_for(transfer.name)
        else:
            self._transfer = Contested(transfer, True, self.other.has_asked_for(transfer.name))

    def _end_contested(self, transfer: Transfer, now: Time) -> None:
        """End our transfer: what the server did, or does, cannot be known. A read is made again if there is time."""
        self._contested_since = since = min(self._contested_since, now)
        self._collided_at = now
        transfer.is_given_up = True
        if not transfer.is_download:
            self._abandoned = transfer
        elif transfer.first[0] & (SPECIFIER | EXPEDITED_BIT) != INITIATE_DOWNLOAD | EXPEDITED_BIT:
            # before the server stores what both have sent
            self.send(pack_initiate(ABORT, transfer.index, transfer.subindex, AbortCode.GENERAL_ERROR))
        elif transfer.is_urgent and self._abandoned is None:
            self._abandoned = transfer
        if transfer.state is INITIATED and not transfer.is_answered:
            if transfer.is_download:  # it may wait in our queue yet, and a stranger's write of the object is confirmed alike
                self._leave(transfer, now)
            else:
                self._queue.expect_late(transfer.name, now, now + self.late_guard + spread(now))
            self.other.expect(transfer.name)
        transfer.state = OVER
        again = None if transfer.is_download else transfer.again()
        if again is not None and transfer.is_urgent:
            self._tries += 1
            transfer.is_urgent = self._tries < MAX_URGENT_TRIES  # then it waits for the stranger, as others do
        if again is None or now >= since + self.contest_limit:
            self.report_abort(transfer, AbortCode.GENERAL_ERROR, AbortOrigin.CONTESTED, transfer.is_download)
            return
        self._put_first(again, transfer)

    def _yields(self, now: Time) -> bool:
        """Return whether requests wait for a stranger now; then the deadline is set. Requests that waited too long end here."""
        queue, until = self._queue, self.other.until
        if now >= until:
            self.other.expire()
        elif not queue.urgent:
            if queue.others:
                self._contested_since = min(self._contested_since, now)
            limit = self._contested_since + self.contest_limit if queue.others else NEVER
            if now >= limit:
                while queue.others:
                    self.report_abort(queue.others.popleft(), AbortCode.GENERAL_ERROR, AbortOrigin.CONTESTED, False)
                limit = NEVER
            has_collided = now < self._collided_at + self.contest_limit
            self._arm(min(until + spread(now) if has_collided else until, limit))
            return True
        if self._abandoned is not None:  # some servers stay in it, deaf for anybody else
            abandoned, self._abandoned = self._abandoned, None
            # Behind an urgent write, only the next one of them ends a stranger's transfer
            if not abandoned.is_download or (queue.urgent and queue.urgent[0].is_download):
                self.send(pack_initiate(ABORT, abandoned.index, abandoned.subindex, AbortCode.GENERAL_ERROR))
        if not queue.waits:
            self._contested_since = NEVER
        return False

    def _after_contest(self, transfer: Transfer, now: Time) -> None:
        """A transfer of ours is over, and strangers have made others wait, or ended them: if it went well, the next wait has its
        whole limit. After a collision one of the strangers goes first now."""
        if transfer.is_given_up:
            return
        self._tries = 0
        if not transfer.is_urgent or not self._queue.others:
            self._contested_since = NEVER
        if not transfer.is_urgent:
            if now < self._collided_at + self.contest_limit:
                self.other.goes_first(now)
            else:
                self._collided_at = -NEVER

    def _forget_other(self) -> None:
        """Nothing of a stranger is under way: the server was reset, or the channel is another one."""
        self.other.close()
        self._abandoned = None
        self._collided_at = -NEVER
        self._contested_since = NEVER
        self._tries = 0

    # ---- the queue ----

    def _find(self, request_id: RequestId) -> Transfer | None:
        """Return the request of that id, if it is open."""
        transfer = self._transfer
        if transfer is not None and transfer.request_id == request_id:
            return transfer
        return self._queue.find(request_id)

    def _submit(self, transfer: Transfer, urgent: bool, now: Time, timeout: Time | None = None) -> RequestId:
        """Take a request. timeout: ns, in place of the client's."""
        queue = self._queue
        line = queue.urgent if urgent else queue.others
        if len(line) >= self.max_queue:
            raise LocalProtocolError(f"{transfer}, node {self.node_id}: {len(line)} requests are waiting already")
        transfer.request_id = request_id = self.out.next_request_id()
        transfer.is_urgent = urgent
        if timeout is not None:
            transfer.own_timeout = timeout
        if self._transfer is not None:
            line.append(transfer)
        elif line or queue.urgent or self.copy_guard or queue.overdue or self.other.last:
            line.append(transfer)
            self._begin_next(now)
        elif (queue.left or transfer.name == queue.answered) and queue.wants_question(transfer, now, self.timeout):
            line.append(transfer)
            self._ask(queue.question_before(transfer), now)
        else:
            self._begin(transfer, Frame(self.can_id, transfer.first, self.flags), now)
        return request_id

    def _begin_next(self, now: Time) -> None:
        """Begin the transfer whose turn it is, if there is one."""
        if (self.other.last or self._abandoned is not None) and self._yields(now):
            return
        taken = self._queue.take(now, self.copy_guard, self.timeout)
        if taken is None:
            self._arm(self._queue.held_until)
        elif isinstance(taken, bytes):
            self._ask(taken, now)
        else:
            self._begin(taken, Frame(self.can_id, taken.first, self.flags), now)

    def _ask(self, first: bytes, now: Time) -> None:
        """Ask a question before the next request. first: its initiate frame."""
        question = self._question
        if question is None or question.first is not first:
            question = self._question = Question(self, first)
        question.state = INITIATED
        question.is_answered = question.is_given_up = False
        self._begin(question, question.frame, now)

    def _begin(self, transfer: Transfer, frame: Frame, now: Time) -> None:
        self._transfer = transfer
        self._nameless_abort = b""
        self.out.frames.append(frame)
        transfer.deadline = self.deadline = deadline = now + (transfer.own_timeout or self.timeout)
        if deadline < self._wake:
            self._arm(deadline)
        if self.other.count:
            self._begin_beside(transfer, now)

    def _begin_beside(self, transfer: Transfer, now: Time) -> None:
        """A stranger was heard before this transfer began: believe no answer that may be another's."""
        awaits_other = transfer.is_download and self._awaits_other(transfer.name, now)
        if awaits_other or self.other.may_answer(transfer):  # it is urgent, or it would have waited
            is_shared = self.other.has_asked_for(transfer.name)
            self._transfer = Contested(transfer, not awaits_other and self.other.leaves_sure(transfer), is_shared)

    def _awaits_other(self, name: bytes, now: Time) -> bool:
        """Return whether an answer to another write of the object may still come, of ours or of a stranger."""
        is_near = now < self.other.heard_at + self.contest_limit
        return is_near and (now < self._queue.may_be_answered_until(name) or name in self.other.unfinished)

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
        queue.remember(transfer, self.last, now)
        if self._collided_at > -NEVER or self._contested_since < NEVER:
            self._after_contest(transfer, now)
        if queue.urgent or queue.others or self._abandoned is not None:
            self._begin_next(now)
