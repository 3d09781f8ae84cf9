"""What an SDO server is besides its transfers: the channel, the object that is accessed, and the door to the host.

`ServerBase` is the part of SdoServer (server.py) that does not depend on how a transfer goes. The door to the host: an access
that the store calls PENDING is reported as ObjectAccessPending, and waits for `complete`; at most one at a time.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, Frame
from canopen_proto.machine import NEVER, SECOND, FrameIgnored, LocalProtocolError, Machine, Outbox, Time, check_node_id
from canopen_proto.sdo.access import ObjectStore
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, MAX_BURST, is_next, next_number
from canopen_proto.sdo.codec import ABORT, DOWNLOAD_SEGMENT_RESPONSE, INITIATE, TOGGLE
from canopen_proto.sdo.events import ObjectAccessPending, SdoServerAborted

TIMEOUT: Final = 1 * SECOND
"""How long a client may take for each segment. Longer than clients usually wait, who give up first and say so."""
ACCESS_TIMEOUT: Final = 5 * SECOND
"""How long the host may take for an access: storing parameters in flash takes seconds."""
MAX_DOWNLOAD: Final = 16 << 20
"""Largest value that is accepted: a firmware image fits, and a client gone mad does not fill the memory."""

IDLE: Final = 0
"""The state in which no transfer is under way."""

_NO_FRAME: Final = Frame(0)


class ServerBase(Machine):
    """See this module's text."""

    __slots__ = (
        "_access_id", "_acknowledgements", "_answer", "_channel", "_handed", "_in_pieces", "_index", "_is_reading", "_last",
        "_more", "_send_can_id", "_send_flags", "_state", "_store", "_straggler", "_subindex", "access_timeout", "block_size",
        "burst_interval", "copy_guard", "crc", "enabled", "max_burst", "max_download", "node_id", "timeout",
    )  # fmt: skip

    def __init__(
        self,
        out: Outbox,
        node_id: int,
        store: ObjectStore,
        request_key: int | None,
        response_key: int | None,
    ) -> None:
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.timeout = TIMEOUT
        self.access_timeout = ACCESS_TIMEOUT
        self.max_download = MAX_DOWNLOAD
        self.copy_guard: Time = 0
        self.crc = True
        self.block_size = MAX_BLOCK_SIZE
        self.max_burst = MAX_BURST
        self.burst_interval: Time = 0
        self.enabled = True
        self._store = store
        request_key = SDO_CLIENT_TO_SERVER + node_id if request_key is None else request_key
        response_key = SDO_SERVER_TO_CLIENT + node_id if response_key is None else response_key
        self._go_by((request_key, response_key))
        # The transfer under way
        self._state = IDLE
        self._index = 0
        self._subindex = 0
        self._last = b""  # the last accepted request; empty once its copy was seen
        # The access that the host is to serve
        self._access_id = 0  # 0: none
        self._is_reading = False
        self._answer = _NO_FRAME  # what confirms a download
        self._straggler = 0  # the number of a segment that may come though its block download has ended; 0: none
        self._in_pieces = False  # a download that the host takes piece by piece
        self._more = False  # an upload of which the host has given but a part
        self._handed = 0  # bytes that the host has taken, or given

    # ---- commands ----

    def complete(
        self, access_id: int, result: bytes | AbortCode | None, now: Time, *, more: bool = False, size: int | None = None
    ) -> bool:
        """Answer an ObjectAccessPending: bytes if it was a read, None if it was a write and is done, an abort code to refuse it.

        more: the bytes are a piece, others follow, and will be asked for. size: with the first piece, that of the whole, if it
        is known. Sends the response that was held. False if nobody waits for it any more (timeout, abort, a new request), which
        is no fault of the host. Raises LocalProtocolError if the result is not of the access's kind.
        """
        if not access_id or access_id != self._access_id:
            return False
        if isinstance(result, AbortCode):
            self._abort(result)
        elif isinstance(result, bytes) and self._is_reading:
            self._access_id = 0
            self._on_given(result, more, size, now)
        elif result is None and not self._is_reading:
            self._access_id = 0
            self._on_taken(now)
        else:
            expected = "bytes" if self._is_reading else "None"
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
        if self._state != IDLE:
            self._report(AbortCode.DEVICE_STATE, AbortOrigin.CANCELLED)
            self._become_idle()

    def set_channel(self, channel: tuple[int, int] | None) -> None:
        """Be the server of another channel: client to server, server to client, as `Frame.key`. None: of no channel.

        Does nothing if it is the same one. Else a running transfer ends, still on the old channel, with an abort (0x08000022), so
        that its client need not wait in vain.
        """
        if channel != self._channel:
            if self._state != IDLE:
                self._abort(AbortCode.DEVICE_STATE)
            self._go_by(channel)
            self._reroute()

    # ---- getters ----

    @property
    def channel(self) -> tuple[int, int] | None:
        """Client to server, server to client, as `Frame.key`; None if it has none."""
        return self._channel

    @property
    def object_for_host(self) -> int | None:
        """The mux of the object that is downloaded to the host: it has been asked to take it, or takes it in pieces."""
        if self._in_pieces or (self._access_id and not self._is_reading):
            return self._index << 8 | self._subindex
        return None

    @property
    def busy(self) -> bool:
        """Whether a transfer is under way."""
        return self._state != IDLE

    @property
    def stream_timeout(self) -> Time:
        """How long the host may take for each piece, in ns: as for any access."""
        return self.access_timeout

    def can_ids(self) -> tuple[int, ...]:
        return self._channel[:1] if self._channel is not None and self.enabled else ()

    # ---- the host ----

    def _on_given(self, piece: bytes, more: bool, size: int | None, now: Time) -> None:
        """The host gives an object, or a piece of it."""
        raise NotImplementedError

    def _on_taken(self, now: Time) -> None:
        """The host has taken what was downloaded."""
        raise NotImplementedError

    def _ask_for_piece(self) -> None:
        """The host is to give an object, or the next piece of it. Once: it may be asked before the answer is needed."""
        if not self._access_id:
            self._report_access(None, self._handed > 0, self._handed)
            self._is_reading = True

    def _hand_over_piece(self, piece: bytes, offset: int) -> None:
        self._report_access(piece, True, offset)
        self._is_reading = False

    def _report_access(self, content: bytes | None, more: bool, offset: int) -> None:
        self._access_id = self.out.next_request_id()
        report = ObjectAccessPending(self.node_id, self._access_id, self._index, self._subindex, content, more, offset)
        self.out.events.append(report)

    # ---- inside ----

    def _go_by(self, channel: tuple[int, int] | None) -> None:
        self._channel = channel
        response_key = 0 if channel is None else channel[1]
        self._send_can_id = response_key & 0x1FFFFFFF
        self._send_flags = response_key >> 29
        self._acknowledgements = {
            toggle: Frame(self._send_can_id, bytes((DOWNLOAD_SEGMENT_RESPONSE | toggle,)).ljust(8, b"\x00"), self._send_flags)
            for toggle in (0, TOGGLE)
        }

    def _abort(self, abort_code: int, origin: AbortOrigin = AbortOrigin.LOCAL) -> None:
        """CiA 301 v4.2.0, 7.2.4.3.17"""
        self._send(INITIATE.pack(ABORT, self._index, self._subindex, abort_code))
        self._report(abort_code, origin)
        self._become_idle()

    def _fail(self, abort_code: int, origin: AbortOrigin, now: Time) -> None:
        """The same, for a block transfer."""
        self._abort(abort_code, origin)

    def _is_straggler(self, command: int, frame: Frame) -> bool:
        """Whether it is a segment of a block download that has ended: the next one, or of the beginning of a sub-block.

        The sender may have all of it in a queue that stands still, so time tells nothing. Its order does: a request comes behind
        all segments. A request that looks like the next segment is lost, and heard when it comes again.
        """
        if is_next(command, self._straggler):
            self._straggler = next_number(command)
            self._ignore(frame, "segment of a block download that has ended")
            return True
        self._straggler = 0
        return False

    def _become_idle(self) -> None:
        self._state = IDLE
        self._access_id = 0
        self._in_pieces = False
        self.deadline = NEVER

    def _send(self, payload: bytes) -> None:
        self.out.frames.append(Frame(self._send_can_id, payload, self._send_flags, 8))

    def _report(self, abort_code: int, origin: AbortOrigin) -> None:
        self.out.events.append(SdoServerAborted(self.node_id, self._index, self._subindex, abort_code, origin))

    def _ignore(self, frame: Frame, reason: str) -> None:
        self.out.events.append(FrameIgnored(self.node_id, frame, reason))
