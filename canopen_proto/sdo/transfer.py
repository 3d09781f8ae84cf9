"""One SDO transfer, in a client or in a server: its states, its inputs, and the end of the channel that it uses.

A `ChannelEnd` is one end of a channel: an SdoClient or an SdoServer. It knows the COB-IDs and the limits, and sends frames. A
`Transfer` is one transfer, as that end sees it; there is a class for each kind, direction and role:

                    client                  server                  the side that gets the data, the side that has it
    segmented (*)   segmented_client.py     segmented_server.py     segmented.py
    block           block_client.py         block_server.py         block_receiver.py, block_sender.py
    by the host                             host.py

    (*) and expedited: it is the server that chooses how an upload goes

The end routes frames to the transfer under way, and looks at it after each input: at its `deadline`, at `state` (OVER?) and at
`instead`. A transfer never looks at the end's queue or at other transfers.

    state       what is awaited                                             when that does not come in time
    INITIATED   the other side's answer to the initiate frame               0x05040000
    SEGMENTS    the next segment, or the request or acknowledgement of one  0x05040000; 0x05030000 if only a copy came
    SENT        the acknowledgement of a sub-block (block sender)           0x05040000
    HELD        our own user: a caller's piece, or the host's answer        0x08000020
    ENDING      the end of a block transfer, or the response to it          0x05040000
    OVER        nothing

    INITIATED -> SEGMENTS <-> SENT, HELD -> ENDING (block transfer only) -> OVER; and OVER from anywhere, by an abort.

Source: CiA 301 v4.2.0, 7.2.4.3.
"""

from __future__ import annotations

from enum import Enum
from typing import ClassVar, Final, TypeAlias

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.compiling import mypyc_attr
from canopen_proto.frame import SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, Frame, RoutingKey, routing_key
from canopen_proto.machine import FrameIgnored, LocalProtocolError, Machine, Outbox, RequestId, Time, check_node_id
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, MAX_BURST, STREAM_TIMEOUT, silence_limit
from canopen_proto.sdo.codec import (
    ABORT,
    BLOCK_UPLOAD,
    DOWNLOAD_SEGMENT_RESPONSE,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD,
    NO_MULTIPLEXER,
    SPECIFIER,
    TOGGLE,
    UPLOAD_SEGMENT,
    pack_initiate,
)

Buffer: TypeAlias = bytes | bytearray | memoryview
Channel: TypeAlias = tuple[RoutingKey, RoutingKey]
"""Client to server, server to client."""

UNKNOWN_SIZE: Final = -1
"""The other side has not announced how many bytes it sends."""


class TransferState(Enum):
    """The states of a transfer; see this module's text."""

    INITIATED = "initiated"
    SEGMENTS = "segments"
    SENT = "sent"
    HELD = "held"
    ENDING = "ending"
    OVER = "over"


INITIATED: Final = TransferState.INITIATED
SEGMENTS: Final = TransferState.SEGMENTS
SENT: Final = TransferState.SENT
HELD: Final = TransferState.HELD
ENDING: Final = TransferState.ENDING
OVER: Final = TransferState.OVER


@mypyc_attr(allow_interpreted_subclasses=True)
class ChannelEnd(Machine):
    """One end of an SDO channel; see this module's text. Limits are in ns, segments and bytes, and may be changed at any time.

    channel: client to server, server to client; None if there is none. last: the last frame that was accepted from the other
    side; empty once its second copy was seen. replies: by the toggle of a segment that came, 0 or 1, what is sent for it: the
    request of the next one, or the acknowledgement. confirmation: of a server, what was sent for the last expedited write;
    confirmed: the three bytes of it that name the object. answer: of a server, what was sent for the last expedited read; asked:
    the request; shown: the value's bytes. All are read-only outside.
    """

    __slots__ = (
        "_hears", "_is_server", "answer", "asked", "block_size", "burst_interval", "can_id", "channel", "confirmation",
        "confirmed", "copy_guard", "crc", "flags", "last", "max_burst", "node_id", "replies", "shown", "stream_timeout",
        "timeout",
    )  # fmt: skip

    def __init__(
        self, out: Outbox, node_id: int, is_server: bool, request_key: RoutingKey | None, response_key: RoutingKey | None
    ) -> None:
        """request_key, response_key: the first channel of the server node_id if None."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.timeout: Time = 0
        self.stream_timeout = STREAM_TIMEOUT
        self.copy_guard: Time = 0
        self.crc = True
        self.block_size = MAX_BLOCK_SIZE
        self.max_burst = MAX_BURST
        self.burst_interval: Time = 0
        self.last = b""
        self._is_server = is_server
        to_server = routing_key(SDO_CLIENT_TO_SERVER + node_id) if request_key is None else request_key
        to_client = routing_key(SDO_SERVER_TO_CLIENT + node_id) if response_key is None else response_key
        self._use((to_server, to_client))

    def send(self, payload: bytes) -> None:
        """Send eight bytes to the other end."""
        self.out.frames.append(Frame(self.can_id, payload, self.flags))

    def ignore(self, frame: Frame, reason: str) -> None:
        """Report that a frame was not acted on. reason: for people."""
        self.out.events.append(FrameIgnored(self.node_id, frame, reason))

    def report_abort(self, transfer: Transfer, abort_code: int, origin: AbortOrigin, not_confirmed: bool) -> None:
        """Report that a transfer ended by an abort. not_confirmed: a download that may have been executed nevertheless.
        abort_code: 32 bits. origin: which side ended it."""
        raise NotImplementedError

    def _use(self, channel: Channel | None) -> None:
        """Use this channel from now on, or none."""
        self.channel = channel
        if channel is None:
            return
        self._hears, sends = channel if self._is_server else channel[::-1]
        self.can_id = can_id = sends & 0x1FFF_FFFF
        self.flags = flags = sends >> 29
        reply = DOWNLOAD_SEGMENT_RESPONSE if self._is_server else UPLOAD_SEGMENT | TOGGLE
        payloads = (bytes((reply ^ toggle,)).ljust(8, b"\x00") for toggle in (0, TOGGLE))
        self.replies: tuple[Frame, ...] = tuple(Frame(can_id, payload, flags) for payload in payloads)
        self.confirmed = NO_MULTIPLEXER
        self.confirmation = Frame(can_id, pack_initiate(INITIATE_DOWNLOAD_RESPONSE, 0, 0, 0), flags)
        self.asked = self.shown = b""
        self.answer = self.confirmation


class Transfer:
    """One transfer, under way or waiting; see this module's text.

    first: the data of the initiate request. name: the three bytes of it that name the object. request_id, is_urgent: of a
    client's request. deadline: once it is under way, until it is over. is_answered: the other side has answered the initiate
    frame: it has nothing more to say about transfers before. is_given_up: it ended, and an answer may still come. instead: the
    transfer that goes on when this one is over, if one does. plain: what a client falls back on if the server refuses block
    transfer, if it may. own_timeout: ns, in place of the time-out of its end; 0: it has none.
    """

    __slots__ = (
        "deadline", "end", "first", "index", "instead", "is_answered", "is_given_up", "is_urgent", "name", "own_timeout", "plain",
        "request_id", "state", "subindex",
    )  # fmt: skip

    is_with_host: ClassVar[bool] = False
    """Whether the host has the whole request, and our answer depends on it alone."""
    in_blocks: ClassVar[bool] = False
    """Whether it is a block transfer."""
    is_contested: ClassVar[bool] = False
    """Whether it stands for a request of a client while another client asks too; see contention.py."""

    request_id: RequestId
    deadline: Time
    is_urgent: bool

    def __init__(self, end: ChannelEnd, index: int, subindex: int, first: bytes) -> None:
        self.end = end
        self.index = index
        self.subindex = subindex
        self.first = first
        self.name = first[1:4]
        self.state = INITIATED
        self.is_answered = False
        self.is_given_up = False
        self.instead: Transfer | None = None
        self.plain: Transfer | None = None
        self.own_timeout: Time = 0

    def __str__(self) -> str:
        return f"{'download' if self.is_download else 'upload'} 0x{self.index:04X}:{self.subindex:02X}"

    # ---- inputs ----

    def receive(self, command: int, data: bytes, frame: Frame, now: Time) -> bool:
        """Take a frame. Returns False, and changes nothing, if it is not due. command: its first byte. data: its eight bytes."""
        return False

    def handle_timeout(self, now: Time) -> None:
        """Act on the silence of the other side, or of the user: `deadline` has come."""
        abort_code = AbortCode.CANNOT_TRANSFER if self.state is HELD else AbortCode.TIMED_OUT
        if self.state is SEGMENTS and not self.end.last:
            # All that came was taken for a copy of the last frame: the other side does not alternate its toggle
            abort_code = AbortCode.TOGGLE_NOT_ALTERNATED
        self.abort(abort_code, AbortOrigin.TIMEOUT)  # this also brings a server out of its state: some need a reset otherwise

    # ---- commands of the user: the caller of a stream, or the host ----

    def feed(self, piece: Buffer, last: bool, now: Time) -> None:
        """Send these bytes too; last: no more follow. piece: those bytes. Raises LocalProtocolError for a transfer that takes
        none."""
        raise LocalProtocolError(f"{self}: nothing can be fed: it is no download stream, or it is complete")

    @property
    def room(self) -> int:
        """How many more bytes may be fed now."""
        return 0

    def proceed(self, now: Time) -> bool:
        """The user has taken what it was given. False if this transfer gives nothing."""
        return False

    def abort(self, abort_code: int, origin: AbortOrigin = AbortOrigin.LOCAL) -> None:
        """End the transfer by an abort frame. CiA 301 v4.2.0, 7.2.4.3.17 abort_code: 32 bits. origin: which side ended it, as it
        is reported."""
        end = self.end
        end.send(pack_initiate(ABORT, self.index, self.subindex, abort_code))
        self.is_given_up = True
        end.report_abort(self, abort_code, origin, self.is_all_sent)
        self.state = OVER

    def again(self) -> Transfer | None:
        """Return the same request, to be made once more; None if that might do more than the first one (a write whose data stand
        in its first frame), or differ from what the user has given or got already (a stream)."""
        return None

    # ---- getters ----

    @property
    def is_download(self) -> bool:
        """Whether a client writes by it."""
        return self.first[0] & SPECIFIER not in (INITIATE_UPLOAD, BLOCK_UPLOAD)

    @property
    def has_begun(self) -> bool:
        """Whether the initiation is over: the frames that come now do not name the object."""
        return self.state is not INITIATED

    @property
    def is_all_sent(self) -> bool:
        """Whether it is a download of which everything has been sent: the server may execute it."""
        return False

    @property
    def delivered(self) -> int:
        """How many bytes of a download the other side has acknowledged."""
        return 0

    @property
    def timeout(self) -> Time:
        """How long the other side may take for each answer, in ns."""
        return self.own_timeout or self.end.timeout

    @property
    def patience(self) -> Time:
        """How long the other side may be silent, in ns; inside a block transfer two silences: it may ask again after one."""
        return 2 * silence_limit(self.timeout) if self.in_blocks and self.has_begun else self.timeout

    @property
    def straggler(self) -> int:
        """If the transfer ends now: the number of the block segment that the other side may still send; 0 if none."""
        return 0

    def fault_of(self, command: int) -> AbortCode:
        """Return the abort code for a frame that is not due. command: its command byte."""
        return AbortCode.INVALID_COMMAND
