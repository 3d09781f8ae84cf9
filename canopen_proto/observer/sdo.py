"""Follow SDO transfers by listening only: put each frame in words, with the object and its value, and find what is wrong.

There is one `SdoFollower` for each pair of client and server. It follows a transfer through its segments and blocks, so that the
last frame shows the value. It says of each frame what is wrong with it: a toggle bit that does not alternate, a CRC or a size
that does not fit the data, an answer that nobody asked for, a frame of another transfer.

It takes nothing for granted: recordings begin in the middle, lose frames, and show faulty devices. Before the first request is
heard, nothing is wrong. A frame that does not fit into the transfer is put in words by itself, and the next initiate starts a new
transfer. Where the recording lacks a part of a block, neither its CRC nor its size is judged, and no value is shown. A request
that is given up without an abort is no fault of its own.

Source: CiA 301 v4.2.0, 7.2.4.3.
"""

from __future__ import annotations

import enum
from binascii import crc_hqx
from typing import Final, NamedTuple

from canopen_proto.abort import text_of
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.observer.finding import Finding
from canopen_proto.observer.meaning import Meaning, Say
from canopen_proto.observer.sdo_words import (
    WRITTEN,
    SdoStep,
    a_block_confirmation,
    a_confirmation,
    alone,
    mux_of,
    name_of,
    too_short,
)
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

MAX_KEPT: Final = 1 << 16
"""The most bytes of a value that are kept: a longer one is firmware or the like, and its length is enough."""

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


class Settled(NamedTuple):
    """A value that a device is known to hold: it was read, or a write of it was confirmed."""

    node_id: int
    place: Mux
    data: bytes
    is_read: bool


class SdoFollower:
    """See this module's text. node_id: of the server. dictionary: of its device, for names and types; may be empty.

    By the last frame: settled: the value that the device is known to hold, or None. aborted: the object of an abort, or None.
    """

    __slots__ = (
        "_acknowledgement", "_announced", "_answer", "_answered", "_block_size", "_crc", "_data", "_dictionary", "_found",
        "_has_crc", "_is_doubtful", "_is_judged", "_is_sound", "_is_upload", "_is_whole", "_last", "_length", "_pending",
        "_phase", "_place", "_request", "_sent", "_since", "_tail", "_toggle", "_verb", "_was_final", "aborted",
        "node_id", "settled",
    )  # fmt: skip

    def __init__(self, node_id: int, dictionary: ObjectDictionary) -> None:
        self.node_id = node_id
        self.settled: Settled | None = None
        self.aborted: Mux | None = None
        self._dictionary = dictionary
        self._found: list[Finding] = []
        self._phase = _Phase.UNKNOWN
        self._is_judged = False  # the request that began this transfer was heard
        self._since: Time = 0  # of the request that waits for its answer
        self._answer = b""  # the last one that ended a transfer
        self._answered: Time = 0
        self._begin(bytes(8), is_upload=False)

    def _begin(self, frame: bytes, *, is_upload: bool) -> None:
        self._request, self._place = frame, frame[1:4]
        self._is_upload = is_upload
        self._verb = "read" if is_upload else "write"
        self._announced: int | None = None  # bytes
        self._data = bytearray()
        self._length: int = 0  # bytes so far
        self._toggle: int = 0
        self._last = False
        self._has_crc = False
        self._crc: int = 0  # of what is kept
        self._tail: bytes = b""  # the last segment so far, of which the end may leave some bytes out
        self._block_size = MAX_BLOCK_SIZE
        self._pending: list[bytes] = []  # segments of this block, without a gap
        self._sent: int = 0  # the number of the last segment
        self._was_final = False
        self._acknowledgement = b""  # the last one
        self._is_doubtful = False  # it came twice: the receiver said it again, or a sub-block in between was not heard
        self._is_whole: bool = True  # all that the receiver has taken was heard
        self._is_sound = True  # its size and its CRC are right

    def client(self, frame: Frame, now: Time, found: list[Finding]) -> Meaning:
        """Return the meaning of a frame of the client. found: takes what is wrong."""
        self.settled = self.aborted = None
        self._found = found
        return Meaning("SDO", self.node_id, self._of_client(frame.data, now), frame)

    def server(self, frame: Frame, now: Time, found: list[Finding]) -> Meaning:
        """Return the meaning of a frame of the server. found: takes what is wrong."""
        self.settled = self.aborted = None
        self._found = found
        return Meaning("SDO", self.node_id, self._of_server(frame.data, now), frame)

    def _of_client(self, data: bytes, now: Time) -> Say:
        if self._phase is _Phase.BLOCK_SEGMENTS and not self._is_upload and not self._is_abort(data):
            return self._block_segment(data)
        request = complete(data, LEAST_REQUEST)
        if request is None:
            self._found.append(Finding("sdo", self.node_id, "an SDO request is too short for its command"))
            return too_short
        specifier = request[0] & SPECIFIER
        if specifier == ABORT:
            return self._aborted(request, "client")
        if specifier in (INITIATE_DOWNLOAD, INITIATE_UPLOAD) or (
            specifier in (BLOCK_UPLOAD, BLOCK_DOWNLOAD) and not request[0] & (0x03 if specifier == BLOCK_UPLOAD else LAST)
        ):
            return self._initiate(request, now)
        if self._phase is _Phase.UNKNOWN:
            return alone
        if specifier in (DOWNLOAD_SEGMENT, UPLOAD_SEGMENT):
            return self._segment_request(request, is_upload=specifier == UPLOAD_SEGMENT)
        return self._block_of_client(request)

    def _of_server(self, data: bytes, now: Time) -> Say:
        if self._phase is _Phase.BLOCK_SEGMENTS and self._is_upload and not self._is_abort(data):
            return self._block_segment(data)
        answer = complete(data, LEAST_RESPONSE)
        if answer is None:
            self._say("sdo", "an SDO answer is too short for its command")
            return too_short
        specifier = answer[0] & SPECIFIER
        say: Say
        if specifier == ABORT:
            if self._phase is _Phase.IDLE:
                self._say("no request", "the server aborts a transfer, and none is under way")
            say = self._aborted(answer, "server")
        elif self._phase is _Phase.IDLE or self._phase is _Phase.UNKNOWN:
            say = self._unasked(answer, now)
        elif self._phase is _Phase.INITIATE_ANSWER:
            say = self._initiate_answer(answer)
        elif specifier in (UPLOAD_SEGMENT_RESPONSE, DOWNLOAD_SEGMENT_RESPONSE) and self._phase in (
            _Phase.SEGMENT_ANSWER,
            _Phase.SEGMENT_REQUEST,
        ):
            say = self._segment_answer(answer, is_upload=specifier == UPLOAD_SEGMENT_RESPONSE)
        else:
            say = self._block_of_server(answer)
        if self._phase is _Phase.IDLE:
            self._answer, self._answered = answer, now
        return say

    # ---- initiate ----

    def _initiate(self, request: bytes, now: Time) -> Say:
        if self._phase is _Phase.INITIATE_ANSWER and request != self._request and now - self._since < TWO_CLIENTS:
            self._say("two masters", "a second SDO request before the first one has its answer: two clients use one channel")
        command = request[0]
        specifier = command & SPECIFIER
        self._begin(request, is_upload=specifier in (INITIATE_UPLOAD, BLOCK_UPLOAD))
        self._phase, self._since, self._is_judged = _Phase.INITIATE_ANSWER, now, True
        if specifier == INITIATE_UPLOAD:
            return self._step()
        if specifier == INITIATE_DOWNLOAD:
            if command & EXPEDITED_BIT:
                self._keep(_expedited(request))
                return self._value()
            return self._step(f": in segments{self._announce(request, SIZE_BIT)}")
        self._has_crc = bool(command & _BLOCK_CRC)
        if specifier == BLOCK_DOWNLOAD:
            return self._step(f": in blocks{self._announce(request, _BLOCK_SIZE_BIT)}")
        self._block_size = request[4]
        return self._step(f": in blocks of {request[4]} segments")

    def _initiate_answer(self, answer: bytes) -> Say:
        command, asked = answer[0], self._request[0] & SPECIFIER
        specifier = command & SPECIFIER
        if (asked, specifier) not in _ANSWERS:
            self._say("no request", "an SDO answer of another kind than the request")
            return self._by_itself(answer)
        if answer[1:4] != self._place:
            self._say("no request", f"an SDO answer for {name_of(answer[1:4])}; the request was for {name_of(self._place)}")
            return self._by_itself(answer)
        if specifier == INITIATE_DOWNLOAD_RESPONSE:
            if self._request[0] & EXPEDITED_BIT:
                return self._written()
            self._phase = _Phase.SEGMENT_REQUEST
            return self._step(": go on")
        if specifier == INITIATE_UPLOAD_RESPONSE:  # also of a block upload: the server may change to the other protocol
            return self._upload_answer(answer)
        self._has_crc = self._has_crc and bool(command & _BLOCK_CRC)
        return self._block_answer(answer)

    def _upload_answer(self, answer: bytes) -> Say:
        if answer[0] & EXPEDITED_BIT:
            self._keep(_expedited(answer))
            self._end()
            return self._value()
        self._phase = _Phase.SEGMENT_REQUEST
        return self._step(f": in segments{self._announce(answer, SIZE_BIT)}")

    def _block_answer(self, answer: bytes) -> Say:
        if self._is_upload:
            self._phase = _Phase.BLOCK_START
            return self._step(f": in blocks{self._announce(answer, _BLOCK_SIZE_BIT)}")
        self._phase, self._block_size = _Phase.BLOCK_SEGMENTS, answer[4]
        return self._step(f": go on, {answer[4]} segments a block")

    def _unasked(self, answer: bytes, now: Time) -> Say:
        if now - self._answered > SECOND_ANSWER:
            self._say("no request", "an SDO answer to which there is no request")
        elif answer == self._answer:
            self._say("no request", "the same SDO answer once more: the bus or the server has sent it twice")
        else:
            self._say("double id", "a second answer to one SDO request: two nodes have one ID")
        return self._by_itself(answer)

    def _by_itself(self, answer: bytes) -> Say:
        """Return an answer in words; its request was not heard, or was another one. If nothing else is known, the transfer is
        followed from here."""
        specifier = answer[0] & SPECIFIER
        is_upload = specifier in (INITIATE_UPLOAD_RESPONSE, BLOCK_DOWNLOAD)
        if not is_upload and specifier not in (INITIATE_DOWNLOAD_RESPONSE, BLOCK_UPLOAD):
            return a_confirmation if specifier == DOWNLOAD_SEGMENT_RESPONSE else alone
        if specifier == BLOCK_UPLOAD and answer[0] & KIND:
            return a_block_confirmation if answer[0] & KIND == END_RESPONSE else alone
        if specifier == BLOCK_DOWNLOAD and answer[0] & LAST:
            return alone
        if self._phase is not _Phase.UNKNOWN:  # another transfer is followed, or its end is remembered
            return self._only_step(answer, is_upload=is_upload)
        self._begin(answer, is_upload=is_upload)
        if specifier == INITIATE_UPLOAD_RESPONSE:
            return self._upload_answer(answer)
        return self._step(": go on") if specifier == INITIATE_DOWNLOAD_RESPONSE else self._block_answer(answer)

    def _only_step(self, answer: bytes, *, is_upload: bool) -> Say:
        """Return an initiate answer in words, and leave the transfer as it is."""
        place, verb, data = answer[1:4], "read" if is_upload else "write", None
        if answer[0] & SPECIFIER == INITIATE_UPLOAD_RESPONSE and answer[0] & EXPEDITED_BIT:
            data = _expedited(answer)
            self.settled = Settled(self.node_id, mux_of(place), data, True)
        after = ": begins" if is_upload else ": go on"
        return SdoStep(self._dictionary, self.node_id, place, verb, after, data, data is not None).say

    # ---- segments ----

    def _segment_request(self, request: bytes, *, is_upload: bool) -> Say:
        if self._phase not in (_Phase.SEGMENT_REQUEST, _Phase.SEGMENT_ANSWER) or is_upload != self._is_upload:
            self._say("sdo", "a request for a segment, outside of such a transfer")
            return alone
        self._check_toggle(request[0], "request")
        self._phase = _Phase.SEGMENT_ANSWER
        return self._step(": next segment") if is_upload else self._segment(request)

    def _segment_answer(self, answer: bytes, *, is_upload: bool) -> Say:
        if is_upload != self._is_upload or (self._phase is not _Phase.SEGMENT_ANSWER and self._is_judged):
            self._say("no request", "a segment's answer to which there is no request")
            return alone
        self._check_toggle(answer[0], "answer")
        self._toggle ^= TOGGLE
        self._phase = _Phase.SEGMENT_REQUEST
        if is_upload:
            return self._segment(answer)
        return self._written() if self._last else self._step(": segment confirmed")

    def _segment(self, frame: bytes) -> Say:
        """Take the data of a segment."""
        self._keep(frame[1 : 8 - (frame[0] >> 1 & 7)])
        self._last = bool(frame[0] & LAST)
        if not self._last:
            return self._step(f": segment, {self._length} bytes so far")
        self._check_size()
        if self._is_upload:
            self._end()
        return self._value()

    def _check_toggle(self, command: int, what: str) -> None:
        if command & TOGGLE != self._toggle:
            self._say("toggle", f"the toggle bit of a segment's {what} is {command >> 4 & 1}, and has to be {self._toggle >> 4}")
            self._toggle = command & TOGGLE  # said once

    def _check_size(self) -> None:
        if self._announced is not None and self._length != self._announced:
            self._say("size", f"{name_of(self._place)} was announced with {self._announced} bytes, and has {self._length}")
            self._is_sound = False

    # ---- blocks ----

    def _block_segment(self, data: bytes) -> Say:
        """Take a segment of the side that has the data."""
        segment = data[:8].ljust(8, b"\0")
        number, is_final = segment[0] & SEQUENCE, bool(segment[0] & FINAL)
        self._sent = number
        if number == len(self._pending) + 1:
            self._pending.append(segment[1:])
        if is_final or number >= self._block_size:
            self._was_final = is_final
            self._phase = _Phase.BLOCK_ACKNOWLEDGEMENT
        return self._step(f": block segment {number}{', the last' if is_final else ''}")

    def _block_of_client(self, frame: bytes) -> Say:
        kind = frame[0] & KIND
        if self._is_upload and frame[0] == START_UPLOAD and self._phase is _Phase.BLOCK_START:
            self._phase = _Phase.BLOCK_SEGMENTS
            return self._step(": start")
        if self._is_upload and self._may_acknowledge(frame):
            return self._acknowledged(frame)
        if self._is_upload and frame[0] == END_RESPONSE and self._phase is _Phase.BLOCK_END_ANSWER:
            self._end()
            return self._step(": block transfer ended")
        if not self._is_upload and kind == END and self._phase is _Phase.BLOCK_END:
            return self._block_end(frame)
        self._say("sdo", "a frame of a block transfer that does not fit here")
        return alone

    def _block_of_server(self, frame: bytes) -> Say:
        kind = frame[0] & KIND
        if not self._is_upload and self._may_acknowledge(frame):
            return self._acknowledged(frame)
        if not self._is_upload and frame[0] == END_RESPONSE and self._phase is _Phase.BLOCK_END_ANSWER:
            return self._written()
        if self._is_upload and kind == END and self._phase is _Phase.BLOCK_END:
            return self._block_end(frame)
        self._say("no request", "an SDO answer that does not fit the request")
        return self._by_itself(frame)

    def _may_acknowledge(self, frame: bytes) -> bool:
        if self._phase is _Phase.BLOCK_END:  # it may be said once more
            return frame == self._acknowledgement
        return frame[0] == ACKNOWLEDGEMENT and self._phase in (_Phase.BLOCK_SEGMENTS, _Phase.BLOCK_ACKNOWLEDGEMENT)

    def _acknowledged(self, frame: bytes) -> Say:
        """Count what the receiver has. The sender goes on behind that: with the rest of this sub-block, if something was lost."""
        taken, self._block_size = frame[1], frame[2] or MAX_BLOCK_SIZE
        if not self._sent and frame == self._acknowledgement:
            self._is_doubtful = True
            return self._step(f": {taken} segments taken, once more")
        self._acknowledgement = frame
        if taken > self._sent:
            self._say("sdo", f"{taken} segments are acknowledged, and {self._sent} were sent")
        again = ", the others must be sent again" if taken < self._sent else ""
        self._is_whole = self._is_whole and taken <= len(self._pending)
        for content in self._pending[:taken]:
            self._keep_tail(self._tail)
            self._tail = content  # the last one of all has unused bytes, which only the end tells
        is_over = self._was_final and taken == self._sent
        self._pending.clear()
        self._sent = 0
        self._was_final = False
        self._phase = _Phase.BLOCK_END if is_over else _Phase.BLOCK_SEGMENTS
        return self._step(f": {taken} segments taken{again}")

    def _block_end(self, frame: bytes) -> Say:
        self._phase = _Phase.BLOCK_END_ANSWER
        self._keep_tail(self._tail[: 7 - (frame[0] >> 2 & 7)])
        said = int.from_bytes(frame[1:3], "little")
        if self._is_doubtful:
            has_proof = self._has_crc or self._announced is not None
            fits = (not self._has_crc or self._crc == said) and self._announced in (None, self._length)
            self._is_whole = self._is_whole and has_proof and fits
        if self._is_whole:
            if self._has_crc and self._crc != said:
                self._say("crc", f"the CRC of {name_of(self._place)} is said to be 0x{said:04X}, and is 0x{self._crc:04X}")
                self._is_sound = False
            self._check_size()
        return self._value()

    # ---- all ----

    def _end(self) -> None:
        self._phase = _Phase.IDLE if self._is_judged else _Phase.UNKNOWN
        self._pending.clear()

    def _announce(self, frame: bytes, bit: int) -> str:
        """Take note of the size that an initiate frame announces by a bit of its command. Return it in words."""
        if not frame[0] & bit:
            return ""
        self._announced = int.from_bytes(frame[4:8], "little")
        return f", {self._announced} bytes"

    def _keep(self, data: bytes) -> None:
        self._length += len(data)
        if len(self._data) < MAX_KEPT:
            self._data += data

    def _keep_tail(self, data: bytes) -> None:
        self._crc = crc_hqx(data, self._crc)
        self._keep(data)

    def _value(self) -> Say:
        """All data is there. An upload's value is settled by that."""
        if not self._is_whole:
            return self._step(": not all of it was heard")
        if self._length > len(self._data):
            return self._step(f": {self._length} bytes")
        data = bytes(self._data)
        if self._is_upload:
            self._settle(data)
        return self._step("", data)

    def _written(self) -> Say:
        """The server has confirmed all of a download."""
        self._end()
        data = bytes(self._data) if self._is_whole and self._length == len(self._data) else None
        if data is not None:
            self._settle(data)
        return SdoStep(self._dictionary, self.node_id, self._place, WRITTEN, "", data, self.settled is not None).say

    def _settle(self, data: bytes) -> None:
        if self._is_sound:
            self.settled = Settled(self.node_id, mux_of(self._place), data, self._is_upload)

    def _aborted(self, frame: bytes, whom: str) -> Say:
        self._end()
        self.aborted = mux_of(frame[1:4])
        code = int.from_bytes(frame[4:8], "little")
        text = text_of(code)
        reason = f": {text}" + ("" if "(0x" in text else f" (0x{code:08X})")
        return SdoStep(self._dictionary, self.node_id, frame[1:4], f"aborted by the {whom},", reason, None, False).say

    def _is_abort(self, data: bytes) -> bool:
        """Return whether a frame among the segments of a block is an abort: it names the transfer's object."""
        return len(data) == 8 and data[0] == ABORT and data[1:4] == self._place

    def _step(self, after: str = "", data: bytes | None = None) -> Say:
        is_held = data is not None and self.settled is not None
        return SdoStep(self._dictionary, self.node_id, self._place, self._verb, after, data, is_held).say

    def _say(self, rule: str, text: str) -> None:
        if self._is_judged:
            self._found.append(Finding(rule, self.node_id, text))


def _expedited(frame: bytes) -> bytes:
    """Return the value in an initiate frame."""
    return frame[4 : 8 - (frame[0] >> 2 & 3 if frame[0] & SIZE_BIT else 0)]


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
