"""SDO server: lets a client read (upload) and write (download) the objects of a device. CiA 301 v4.2.0, 7.2.4.

A server has one channel, a pair of COB-IDs, and at most one transfer under way on it: a `Transfer` (transfer.py) of
segmented_server.py, block_server.py or host.py, which gets the client's frames first. SdoServer begins and ends transfers.

An `ObjectStore` knows the objects and their values. It is asked

- at an initiate upload for the value: up to 4 bytes go expedited, more (and none at all) in segments out of that one copy;
- at an initiate download in segments whether the object may be written, with the size if it is announced; and to write once
  all of it is there (which is at once if it is expedited).

The store may say `PENDING`: only the host can serve the object (it stores parameters, it computes a value). Then
ObjectAccessPending goes out, the answer is held, and the host says `complete(access_id, ...)`. A host that stays silent for
`access_timeout` costs the transfer.

So that a large object (a DOMAIN: firmware, a log) never has to be held whole, it may go in pieces, by block and by segmented
transfer. If `check_write` says PENDING, the host gets what is downloaded piece by piece (about 890 bytes, each in an
ObjectAccessPending, the last one with more = False), and the client waits until it has taken each. A read goes in pieces if the
host gives the first one with `more=True`; it is then asked for the others in turn.

A new initiate request takes the place of a running transfer; an abort ends it, whatever object it names (field clients send
0x0000:00). A segment request without a transfer is answered by an abort for 0x0000:00. Block transfer: see block.py.
If a block download ends before its time (our abort, an NMT reset), segments may still be in the client's queue, and come much
later. The one with number 0x23 would be taken for an expedited download of whatever object its data name. So segments that follow
the last one are not acted on until something else comes.

CAN can deliver a frame twice. The second copy of a segment is known by its toggle and not acted on, once; any other wrong toggle,
or a third copy, is an abort. The second copy of an initiate is served again (a client that repeats its request after a lost
answer looks just the same), unless the host is serving it: two copies of "store parameters" store once.

SDO lives in the NMT states pre-operational and operational only (CiA 301 v4.2.0, 7.3.2.3): `disable` and `enable` it.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.compiling import mypyc_attr
from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.machine import NEVER, SECOND, LocalProtocolError, Outbox, Time
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.sdo.access import PENDING, ObjectStore, Pending
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, MAX_BURST, is_next, next_number
from canopen_proto.sdo.block_server import ServerBlockDownload
from canopen_proto.sdo.codec import (
    ABORT,
    BLOCK_DOWNLOAD,
    BLOCK_SIZE_BIT,
    BLOCK_UPLOAD,
    DOWNLOAD_SEGMENT,
    EXPEDITED_BIT,
    EXPEDITED_BITS,
    INITIATE_DOWNLOAD,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD,
    INITIATE_UPLOAD_RESPONSE,
    LEAST_REQUEST,
    MAX_EXPEDITED,
    SIZE,
    SIZE_BIT,
    SPECIFIER,
    UPLOAD_SEGMENT,
    complete,
    is_initiate,
    pack_expedited,
    pack_initiate,
    unpack_initiate,
    unpack_multiplexer,
)
from canopen_proto.sdo.events import ObjectAccessPending, ObjectWritten, SdoServerAborted
from canopen_proto.sdo.host import Door
from canopen_proto.sdo.segmented_server import ReadAccess, ServerDownload, answer_upload
from canopen_proto.sdo.transfer import OVER, ChannelEnd, Transfer

__all__ = [
    "ACCESS_TIMEOUT", "MAX_DOWNLOAD", "PENDING", "TIMEOUT", "ObjectAccessPending", "ObjectStore", "ObjectWritten", "Pending",
    "SdoServer", "SdoServerAborted",
]  # fmt: skip

TIMEOUT: Final = 1 * SECOND
"""How long a client may take for each segment. Longer than clients usually wait, who give up first and say so."""
ACCESS_TIMEOUT: Final = 5 * SECOND
"""How long the host may take for an access: storing parameters in flash takes seconds."""
MAX_DOWNLOAD: Final = 16 << 20
"""Largest value that is accepted: a firmware image fits, and a client gone mad does not fill the memory."""


@mypyc_attr(allow_interpreted_subclasses=True)
class SdoServer(ChannelEnd):
    """The server of one SDO channel; see this module's text."""

    __slots__ = ("_door", "_straggler", "_transfer", "enabled", "max_download", "serves_blocks")

    def __init__(
        self,
        out: Outbox,
        node_id: int,
        store: ObjectStore,
        *,
        request_key: RoutingKey | None = None,
        response_key: RoutingKey | None = None,
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
        one by default. timeout, access_timeout: ns. max_download: bytes, of what does not go in pieces. It starts enabled. store:
        the objects and their values.

        For block transfer: crc, if the client has it too; block_size: segments (1..127) that we take in one sub-block; max_burst,
        burst_interval: segments (1 or more) that go out in one turn, and ns between two turns; copy_guard: ns between an
        acknowledgement and the next sub-block (see block.py). All may be changed later (access_timeout as
        `stream_timeout`), and count for the transfers that begin from then on.
        """
        super().__init__(out, node_id, True, request_key, response_key)
        self.timeout = timeout
        self.stream_timeout = access_timeout
        self.copy_guard = copy_guard
        self.crc = crc
        self.block_size = block_size
        self.max_burst = max_burst
        self.burst_interval = burst_interval
        self.max_download = max_download
        self.enabled = True
        self.serves_blocks = True
        """False: block transfer is refused (0x05040001), as by servers that do not have it."""
        self._door = Door(store)
        self._transfer: Transfer | None = None
        self._straggler = 0  # the number of a segment that may come though its block download has ended; 0: none

    # ---- commands ----

    def complete(
        self, access_id: int, result: bytes | AbortCode | None, now: Time, *, more: bool = False, size: int | None = None
    ) -> bool:
        """Answer an ObjectAccessPending: bytes if it was a read, None if it was a write and is done, an abort code to refuse it.
        access_id: the event's. result: the answer.

        more: the bytes are a piece, others follow, and will be asked for. size: with the first piece, that of the whole, if it
        is known. Sends the response that was held. Returns False if nobody waits for it any longer (timeout, abort, a new
        request), which is no fault of the host. Raises LocalProtocolError if the result is not of the access's kind.
        """
        door, transfer = self._door, self._transfer
        if transfer is None or not access_id or access_id != door.access_id:
            return False
        if isinstance(result, AbortCode):
            transfer.abort(result)
        elif isinstance(result, bytes) and door.is_reading:
            door.access_id = 0
            door.handed += len(result)
            door.size = size
            transfer.feed(result, not more, now)
        elif result is None and not door.is_reading:
            door.access_id = 0
            transfer.proceed(now)
        else:
            expected = "bytes" if door.is_reading else "None"
            where = f"access {access_id} to 0x{transfer.index:04X}:{transfer.subindex:02X}, node {self.node_id}"
            raise LocalProtocolError(f"completion of {where}: {expected} or an AbortCode expected, not {result!r}")
        self._follow(transfer)
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
        if self._transfer is not None:
            self.report_abort(self._transfer, AbortCode.DEVICE_STATE, AbortOrigin.CANCELLED, False)
            self._become_idle()

    def set_channel(self, channel: tuple[RoutingKey, RoutingKey] | None) -> None:
        """Be the server of another channel: client to server, server to client, as `Frame.key`. None: of no channel.

        Does nothing if it is the same one. Else a running transfer ends, still on the old channel, with an abort (0x08000022), so
        that its client need not wait in vain.
        """
        if channel != self.channel:
            if self._transfer is not None:
                self._transfer.abort(AbortCode.DEVICE_STATE)
                self._become_idle()
            self._use(channel)
            self._reroute()

    # ---- getters ----

    @property
    def object_for_host(self) -> Mux | None:
        """The mux of the object that is downloaded to the host: it has been asked to take it, or takes it in pieces."""
        door, transfer = self._door, self._transfer
        if transfer is not None and (door.takes_pieces or (door.access_id and not door.is_reading)):
            return mux(transfer.index, transfer.subindex)
        return None

    @property
    def busy(self) -> bool:
        """Whether a transfer is under way."""
        return self._transfer is not None

    def can_ids(self) -> tuple[RoutingKey, ...]:
        return (self._hears,) if self.channel is not None and self.enabled else ()

    # ---- inputs ----

    def receive(self, frame: Frame, now: Time) -> None:
        if not self.enabled:
            return
        data = frame.data
        if len(data) != 8:
            completed = complete(data, LEAST_REQUEST)
            if completed is None:
                self.ignore(frame, "too short for an SDO request")
                return
            data = completed
        command = data[0]
        transfer = self._transfer
        if transfer is None:
            if self._straggler and self._is_straggler(command, frame):
                return
        elif transfer.receive(command, data, frame, now):
            if transfer.state is OVER:
                self._follow(transfer)
                return
            self.deadline = deadline = transfer.deadline
            if deadline < self._wake:
                self._arm(deadline)
            return
        specifier = command & SPECIFIER
        if specifier == INITIATE_UPLOAD:
            self._on_initiate_upload(command, data, frame, now)
        elif specifier == INITIATE_DOWNLOAD:
            self._on_initiate_download(command, data, frame, now)
        elif specifier in (DOWNLOAD_SEGMENT, UPLOAD_SEGMENT):
            self._on_other_segment(command, data, frame, now)
        elif specifier in (BLOCK_UPLOAD, BLOCK_DOWNLOAD):
            self._on_block(command, data, frame, now)
        elif specifier == ABORT:
            self._on_abort(data)
        else:
            self._on_unknown(command, data, frame, now)

    def handle_timeout(self, now: Time) -> None:
        transfer = self._transfer
        if transfer is not None and now >= self.deadline:
            transfer.handle_timeout(now)
            self._follow(transfer)

    # ---- requests that begin a transfer ----

    def _on_initiate_upload(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.6; and of a block upload: 7.2.4.3.13"""
        if self._transfer is not None and not self._make_way(data, frame):
            return
        index, subindex = unpack_multiplexer(data)
        self.last = data
        if command >= BLOCK_UPLOAD and not 1 <= data[4] <= MAX_BLOCK_SIZE:
            Transfer(self, index, subindex, data).abort(AbortCode.INVALID_BLOCK_SIZE)
            return
        content = self._door.store.read(index, subindex, now)
        if isinstance(content, bytes):
            size = len(content)
            if 0 < size <= MAX_EXPEDITED and command < BLOCK_UPLOAD:  # what is read most: `answer_upload` without its call
                if content != self.shown or data != self.asked:  # else it is the answer before once more: somebody polls
                    payload = pack_expedited(INITIATE_UPLOAD_RESPONSE | EXPEDITED_BITS[size], index, subindex, content)
                    self.asked, self.shown, self.answer = data, content, Frame(self.can_id, payload, self.flags)
                self.out.frames.append(self.answer)
                return
            transfer = answer_upload(self, index, subindex, data, self._door, content, False, now)
            if transfer is not None:
                self._follow(transfer)
        elif isinstance(content, Pending):
            self._follow(ReadAccess(self, index, subindex, data, self._door, now))
        else:
            Transfer(self, index, subindex, data).abort(content)

    def _on_initiate_download(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.3; and of a block download: 7.2.4.3.9"""
        if self._transfer is not None and not self._make_way(data, frame):
            return
        _, index, subindex, announced = unpack_initiate(data)
        self.last = data
        is_block = command >= BLOCK_UPLOAD
        if command & EXPEDITED_BIT and not is_block:
            unused = command >> 2 & 3 if command & SIZE_BIT else self._surplus(index, subindex)
            content = data[4 : 8 - unused]
            name = data[1:4]
            if name != self.confirmed:  # else the confirmation is the one of the write before, of the same object
                payload = pack_initiate(INITIATE_DOWNLOAD_RESPONSE, index, subindex, 0)
                self.confirmed, self.confirmation = name, Frame(self.can_id, payload, self.flags)
            answer = self.confirmation
            result = self._door.store.write(index, subindex, content, now)
            if result is None:
                self.out.events.append(ObjectWritten(self.node_id, index, subindex))
                self.out.frames.append(answer)
                return
            transfer = Transfer(self, index, subindex, data)
            self._door.defer(transfer, result, content, 0, answer, now)
            self._follow(transfer)
            return
        size = announced if command & (BLOCK_SIZE_BIT if is_block else SIZE_BIT) else None
        if self._door.may_download(Transfer(self, index, subindex, data), size, self.max_download):
            kind = ServerBlockDownload if is_block else ServerDownload
            self._follow(kind(self, index, subindex, data, self._door, size, self.max_download, now))

    def _surplus(self, index: int, subindex: int) -> int:
        """Return how many of four bytes of unspecified size are too many for the object."""
        for unused in (0, 1, 2, 3):
            if not isinstance(self._door.store.check_write(index, subindex, 4 - unused), AbortCode):
                return unused
        return 0

    def _make_way(self, data: bytes, frame: Frame) -> bool:
        """End the running transfer for a new one. False if it is only a copy of the request that the host is serving."""
        transfer = self._transfer
        assert transfer is not None
        if data != self.last:
            self.report_abort(transfer, AbortCode.GENERAL_ERROR, AbortOrigin.REPLACED, False)
        elif transfer.is_with_host:
            self.ignore(frame, "second copy of a request that the host is serving")
            return False
        self._become_idle()
        self._straggler = 0  # a request comes behind all segments
        return True

    # ---- everything else ----

    def _on_other_segment(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """Take a segment, or a request for one, that is not due."""
        if data == self.last and self._transfer is not None:
            self.last = b""  # once
            self.ignore(frame, "second copy of the last segment")
        else:
            self._on_unknown(command, data, frame, now)

    def _on_abort(self, data: bytes) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.17. Without a transfer there is nothing to do: the client saw its end later than we did."""
        if self._transfer is not None:
            self.report_abort(self._transfer, SIZE.unpack_from(data, 4)[0], AbortOrigin.PEER, False)
            self._become_idle()
        self._straggler = 0  # the client sends nothing behind its abort

    def _on_block(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.9 and 7.2.4.3.13: an initiate ends a running transfer like any other."""
        if not is_initiate(command):
            if data == self.last:
                self.last = b""  # once
                self.ignore(frame, "second copy of the last frame")
            else:
                self._on_unknown(command, data, frame, now)
        elif not self.serves_blocks:
            if self._transfer is None or self._make_way(data, frame):
                index, subindex = unpack_multiplexer(data)
                Transfer(self, index, subindex, data).abort(AbortCode.INVALID_COMMAND)
        elif command & SPECIFIER == BLOCK_UPLOAD:
            self._on_initiate_upload(command, data, frame, now)
        else:
            self._on_initiate_download(command, data, frame, now)

    def _on_unknown(self, command: int, data: bytes, frame: Frame, now: Time) -> None:
        transfer = self._transfer or Transfer(self, 0, 0, data)  # without a transfer there is none to name
        transfer.abort(transfer.fault_of(command))
        self._follow(transfer)

    def _is_straggler(self, command: int, frame: Frame) -> bool:
        """Return whether it is a segment of a block download that has ended: the next one, or of the beginning of a sub-block.

        The sender may have all of it in a queue that stands still, so time tells nothing. Its order does: a request comes behind
        all segments. A request that looks like the next segment is lost, and heard when it comes again.
        """
        if is_next(command, self._straggler):
            self._straggler = next_number(command)
            self.ignore(frame, "segment of a block download that has ended")
            return True
        self._straggler = 0
        return False

    # ---- inside ----

    def report_abort(self, transfer: Transfer, abort_code: int, origin: AbortOrigin, not_confirmed: bool) -> None:
        self._straggler = transfer.straggler
        self.out.events.append(SdoServerAborted(self.node_id, transfer.index, transfer.subindex, abort_code, origin))

    def _follow(self, transfer: Transfer) -> None:
        """Do what the transfer wants now: wait for its deadline, go on with another one, or wait for the next request."""
        if transfer.state is not OVER:
            self._transfer = transfer
            self._arm(transfer.deadline)
        elif transfer.instead is not None:
            self._follow(transfer.instead)
        else:
            self._become_idle()

    def _become_idle(self) -> None:
        self._transfer = None
        self._door.close()
        self.deadline = NEVER
