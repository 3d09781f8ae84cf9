"""Look whether the transfers of an SDO channel keep to the protocol, by listening only.

`SdoRules` follows one pair of client and server. It says of each frame what is wrong with it: a toggle bit that does not
alternate, a CRC or a size that does not fit the data, an answer that nobody asked for, a frame of another transfer.

It takes nothing for granted. Before the first request is heard it says nothing: recordings begin in the middle. Where the
recording itself lacks a part of a block, neither its CRC nor its size is judged. A request that is given up without an abort is
no fault of its own.

Source: CiA 301 v4.2.0, 7.2.4.3.
"""

from __future__ import annotations

import enum
from binascii import crc_hqx
from typing import Final

from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.observer.finding import Finding
from canopen_proto.sdo.block import ACKNOWLEDGEMENT, END, END_RESPONSE, FINAL, KIND, MAX_BLOCK_SIZE, SEQUENCE, START_UPLOAD
from canopen_proto.sdo.codec import (
    ABORT,
    BLOCK_DOWNLOAD,
    BLOCK_UPLOAD,
    DOWNLOAD_SEGMENT,
    DOWNLOAD_SEGMENT_RESPONSE,
    EXPEDITED_BIT,
    INITIATE_DOWNLOAD,
    INITIATE_DOWNLOAD_RESPONSE,
    INITIATE_UPLOAD,
    INITIATE_UPLOAD_RESPONSE,
    LAST,
    LEAST_REQUEST,
    LEAST_RESPONSE,
    SIZE_BIT,
    SPECIFIER,
    TOGGLE,
    UPLOAD_SEGMENT,
    UPLOAD_SEGMENT_RESPONSE,
    complete,
)

TWO_CLIENTS: Final = 20 * MILLISECOND
"""Another request within this time behind one without an answer is another client's: no client gives up as soon."""

SECOND_ANSWER: Final = 500 * MILLISECOND
"""Another answer within this time behind the first one is to the same request: clients wait as long, usually."""

_BLOCK_CRC: Final = 0x04
_BLOCK_SIZE_BIT: Final = 0x02


class _Phase(enum.Enum):
    """The step of a transfer for which the channel waits."""

    UNKNOWN = enum.auto()  # nothing was heard yet that begins a transfer
    IDLE = enum.auto()
    INITIATE_ANSWER = enum.auto()
    SEGMENT_REQUEST = enum.auto()
    SEGMENT_ANSWER = enum.auto()
    BLOCK_START = enum.auto()  # an upload's: by the client
    BLOCK_SEGMENTS = enum.auto()
    BLOCK_ACKNOWLEDGEMENT = enum.auto()
    BLOCK_END = enum.auto()
    BLOCK_END_ANSWER = enum.auto()


class SdoRules:
    """See this module's text. node_id: of the server."""

    __slots__ = (
        "_announced", "_answer", "_answered", "_block_size", "_crc", "_findings", "_has_crc", "_is_upload", "_is_whole",
        "_last", "_node_id", "_pending", "_phase", "_place", "_request", "_sent", "_since", "_size", "_tail", "_toggle",
        "_was_final",
    )  # fmt: skip

    def __init__(self, node_id: int) -> None:
        self._node_id = node_id
        self._phase = _Phase.UNKNOWN
        self._findings: list[Finding] = []
        self._since: Time = 0  # of the request that waits for its answer
        self._request = b""
        self._answer = b""  # the last one that ended a transfer
        self._answered: Time = 0
        self._place = b""  # index and subindex, as they are sent
        self._is_upload = False
        self._announced: int | None = None  # bytes
        self._size = 0  # bytes so far
        self._toggle = 0
        self._last = False
        self._has_crc = False
        self._crc = 0  # without the tail
        self._tail = b""  # the last segment so far, of which the end may leave some bytes out
        self._block_size = MAX_BLOCK_SIZE
        self._pending: list[bytes] = []  # segments of this block, without a gap
        self._sent = 0  # the number of the last segment
        self._was_final = False
        self._is_whole = True  # all that the receiver has taken was heard

    def client(self, data: bytes, now: Time) -> list[Finding]:
        """Return what is wrong with a frame of the client."""
        self._findings = []
        if self._phase is _Phase.BLOCK_SEGMENTS and not self._is_upload and not self._is_abort(data):
            self._block_segment(data)
            return self._findings
        frame = complete(data, LEAST_REQUEST)
        if frame is None:
            self._say("sdo", "an SDO request is too short for its command")
            return self._findings
        specifier = frame[0] & SPECIFIER
        if specifier == ABORT:
            self._end()
        elif specifier in (INITIATE_DOWNLOAD, INITIATE_UPLOAD) or (
            specifier in (BLOCK_UPLOAD, BLOCK_DOWNLOAD) and not frame[0] & (0x03 if specifier == BLOCK_UPLOAD else LAST)
        ):
            self._initiate(frame, now)
        elif self._phase is _Phase.UNKNOWN:
            return self._findings
        elif specifier in (DOWNLOAD_SEGMENT, UPLOAD_SEGMENT):
            self._segment_request(frame, is_upload=specifier == UPLOAD_SEGMENT)
        else:
            self._block_of_client(frame)
        return self._findings

    def server(self, data: bytes, now: Time) -> list[Finding]:
        """Return what is wrong with a frame of the server."""
        self._findings = []
        if self._phase is _Phase.UNKNOWN:
            return self._findings
        if self._phase is _Phase.BLOCK_SEGMENTS and self._is_upload and not self._is_abort(data):
            self._block_segment(data)
            return self._findings
        frame = complete(data, LEAST_RESPONSE)
        if frame is None:
            self._say("sdo", "an SDO answer is too short for its command")
            return self._findings
        specifier = frame[0] & SPECIFIER
        if specifier == ABORT:
            if self._phase is _Phase.IDLE:
                self._say("no request", "the server aborts a transfer, and none is under way")
            self._end()
        elif self._phase is _Phase.IDLE:
            self._unasked(frame, now)
        elif self._phase is _Phase.INITIATE_ANSWER:
            self._initiate_answer(frame)
        elif specifier in (UPLOAD_SEGMENT_RESPONSE, DOWNLOAD_SEGMENT_RESPONSE) and self._phase in (
            _Phase.SEGMENT_ANSWER,
            _Phase.SEGMENT_REQUEST,
        ):
            self._segment_answer(frame, is_upload=specifier == UPLOAD_SEGMENT_RESPONSE)
        else:
            self._block_of_server(frame)
        if self._phase is _Phase.IDLE:
            self._answer, self._answered = frame, now
        return self._findings

    def _unasked(self, frame: bytes, now: Time) -> None:
        if now - self._answered > SECOND_ANSWER:
            self._say("no request", "an SDO answer to which there is no request")
        elif frame == self._answer:
            self._say("no request", "the same SDO answer once more: the bus or the server has sent it twice")
        else:
            self._say("double id", "a second answer to one SDO request: two nodes have one ID")

    # ---- initiate ----

    def _initiate(self, frame: bytes, now: Time) -> None:
        if self._phase is _Phase.INITIATE_ANSWER and frame != self._request and now - self._since < TWO_CLIENTS:
            self._say("two masters", "a second SDO request before the first one has its answer: two clients use one channel")
        command = frame[0]
        specifier = command & SPECIFIER
        self._begin(frame, is_upload=specifier in (INITIATE_UPLOAD, BLOCK_UPLOAD))
        self._phase, self._since = _Phase.INITIATE_ANSWER, now
        if specifier == INITIATE_DOWNLOAD and command & SIZE_BIT and not command & EXPEDITED_BIT:
            self._announced = int.from_bytes(frame[4:8], "little")
        elif specifier == BLOCK_DOWNLOAD:
            self._announced = int.from_bytes(frame[4:8], "little") if command & _BLOCK_SIZE_BIT else None
            self._has_crc = bool(command & _BLOCK_CRC)
        elif specifier == BLOCK_UPLOAD:
            self._has_crc = bool(command & _BLOCK_CRC)
            self._block_size = frame[4]

    def _initiate_answer(self, frame: bytes) -> None:
        command, asked = frame[0], self._request[0] & SPECIFIER
        specifier = command & SPECIFIER
        if (asked, specifier) not in _ANSWERS:
            self._say("no request", "an SDO answer of another kind than the request")
            return
        if frame[1:4] != self._place:
            self._say("no request", f"an SDO answer for {_name(frame[1:4])}; the request was for {_name(self._place)}")
            return
        if specifier == INITIATE_DOWNLOAD_RESPONSE:
            self._phase = _Phase.IDLE if self._request[0] & EXPEDITED_BIT else _Phase.SEGMENT_REQUEST
        elif specifier == INITIATE_UPLOAD_RESPONSE:  # also of a block upload: the server may change to the other protocol
            self._announced = int.from_bytes(frame[4:8], "little") if command & SIZE_BIT else None
            self._phase = _Phase.IDLE if command & EXPEDITED_BIT else _Phase.SEGMENT_REQUEST
        elif asked == BLOCK_DOWNLOAD:
            self._has_crc = self._has_crc and bool(command & _BLOCK_CRC)
            self._block_size = frame[4]
            self._phase = _Phase.BLOCK_SEGMENTS
        else:
            self._has_crc = self._has_crc and bool(command & _BLOCK_CRC)
            self._announced = int.from_bytes(frame[4:8], "little") if command & _BLOCK_SIZE_BIT else None
            self._phase = _Phase.BLOCK_START

    # ---- segments ----

    def _segment_request(self, frame: bytes, *, is_upload: bool) -> None:
        if self._phase not in (_Phase.SEGMENT_REQUEST, _Phase.SEGMENT_ANSWER) or is_upload != self._is_upload:
            self._say("sdo", "a request for a segment, outside of such a transfer")
            return
        self._check_toggle(frame[0], "request")
        self._phase = _Phase.SEGMENT_ANSWER
        if not is_upload:
            self._count(frame)

    def _segment_answer(self, frame: bytes, *, is_upload: bool) -> None:
        if self._phase is not _Phase.SEGMENT_ANSWER or is_upload != self._is_upload:
            self._say("no request", "a segment's answer to which there is no request")
            return
        self._check_toggle(frame[0], "answer")
        if is_upload:
            self._count(frame)
        self._toggle ^= TOGGLE
        if self._last:
            self._end()
        else:
            self._phase = _Phase.SEGMENT_REQUEST

    def _check_toggle(self, command: int, what: str) -> None:
        if command & TOGGLE != self._toggle:
            self._say("toggle", f"the toggle bit of a segment's {what} is {command >> 4 & 1}, and has to be {self._toggle >> 4}")
            self._toggle = command & TOGGLE  # said once

    def _count(self, frame: bytes) -> None:
        self._size += 7 - (frame[0] >> 1 & 7)
        self._last = bool(frame[0] & LAST)
        if self._last:
            self._check_size()

    def _check_size(self) -> None:
        if self._announced is not None and self._size != self._announced:
            self._say("size", f"{_name(self._place)} was announced with {self._announced} bytes, and has {self._size}")

    # ---- blocks ----

    def _block_segment(self, data: bytes) -> None:
        """Take a segment of the side that has the data."""
        frame = data[:8].ljust(8, b"\0")
        number = frame[0] & SEQUENCE
        self._sent = number
        if number == len(self._pending) + 1:
            self._pending.append(frame[1:])
        if frame[0] & FINAL or number >= self._block_size:
            self._was_final = bool(frame[0] & FINAL)
            self._phase = _Phase.BLOCK_ACKNOWLEDGEMENT

    def _block_of_client(self, frame: bytes) -> None:
        kind = frame[0] & KIND
        if self._is_upload and frame[0] == START_UPLOAD and self._phase is _Phase.BLOCK_START:
            self._phase = _Phase.BLOCK_SEGMENTS
        elif self._is_upload and frame[0] == ACKNOWLEDGEMENT and self._in_block:
            self._acknowledged(frame)
        elif self._is_upload and frame[0] == END_RESPONSE and self._phase is _Phase.BLOCK_END_ANSWER:
            self._end()
        elif not self._is_upload and kind == END and self._phase is _Phase.BLOCK_END:
            self._block_end(frame)
        else:
            self._say("sdo", "a frame of a block transfer that does not fit here")

    def _block_of_server(self, frame: bytes) -> None:
        kind = frame[0] & KIND
        if not self._is_upload and frame[0] == ACKNOWLEDGEMENT and self._in_block:
            self._acknowledged(frame)
        elif not self._is_upload and frame[0] == END_RESPONSE and self._phase is _Phase.BLOCK_END_ANSWER:
            self._end()
        elif self._is_upload and kind == END and self._phase is _Phase.BLOCK_END:
            self._block_end(frame)
        else:
            self._say("no request", "an SDO answer that does not fit the request")

    @property
    def _in_block(self) -> bool:
        return self._phase in (_Phase.BLOCK_SEGMENTS, _Phase.BLOCK_ACKNOWLEDGEMENT)

    def _acknowledged(self, frame: bytes) -> None:
        """Count what the receiver has. The sender goes on behind that: with the rest of this sub-block, if something was lost."""
        taken, self._block_size = frame[1], frame[2] or MAX_BLOCK_SIZE
        if taken > self._sent:
            self._say("sdo", f"{taken} segments are acknowledged, and {self._sent} were sent")
        self._is_whole = self._is_whole and taken <= len(self._pending)
        for content in self._pending[:taken]:
            self._crc = crc_hqx(self._tail, self._crc)
            self._size += len(self._tail)
            self._tail = content  # the last one of all has unused bytes, which only the end tells
        is_over = self._was_final and taken == self._sent
        self._pending.clear()
        self._sent = 0
        self._was_final = False
        self._phase = _Phase.BLOCK_END if is_over else _Phase.BLOCK_SEGMENTS

    def _block_end(self, frame: bytes) -> None:
        unused = frame[0] >> 2 & 7
        self._phase = _Phase.BLOCK_END_ANSWER
        if not self._is_whole:
            return
        last = self._tail[: 7 - unused]
        self._size += len(last)
        crc = crc_hqx(last, self._crc)
        said = int.from_bytes(frame[1:3], "little")
        if self._has_crc and crc != said:
            self._say("crc", f"the CRC of {_name(self._place)} is said to be 0x{said:04X}, and is 0x{crc:04X}")
        self._check_size()

    # ---- all ----

    def _begin(self, request: bytes, *, is_upload: bool) -> None:
        self._request, self._place = request, request[1:4]
        self._is_upload = is_upload
        self._announced = None
        self._size = 0
        self._toggle = 0
        self._last = False
        self._has_crc = False
        self._crc = 0
        self._tail = b""
        self._block_size = MAX_BLOCK_SIZE
        self._pending = []
        self._sent = 0
        self._was_final = False
        self._is_whole = True

    def _end(self) -> None:
        if self._phase is not _Phase.UNKNOWN:
            self._phase = _Phase.IDLE
        self._pending.clear()

    def _is_abort(self, data: bytes) -> bool:
        """Return whether a frame among the segments of a block is an abort: it names the transfer's object."""
        return len(data) == 8 and data[0] == ABORT and data[1:4] == self._place

    def _say(self, rule: str, text: str) -> None:
        self._findings.append(Finding(rule, self._node_id, text))


def _name(place: bytes) -> str:
    return f"{place[1]:02X}{place[0]:02X}:{place[2]:02X}"


_ANSWERS: Final = frozenset(
    {
        (INITIATE_DOWNLOAD, INITIATE_DOWNLOAD_RESPONSE),
        (INITIATE_UPLOAD, INITIATE_UPLOAD_RESPONSE),
        (BLOCK_DOWNLOAD, BLOCK_UPLOAD),  # the server's specifiers are the other way round
        (BLOCK_UPLOAD, BLOCK_DOWNLOAD),
        (BLOCK_UPLOAD, INITIATE_UPLOAD_RESPONSE),
    }
)
"""By the specifier of the request: those of its answers."""
