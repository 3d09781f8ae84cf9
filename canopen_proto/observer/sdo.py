"""Follow SDO transfers by listening only: put each frame in words, with the object and its value, and find what is wrong.

There is one `SdoFollower` for each pair of client and server. It follows a transfer through its segments and blocks, so that the
last frame shows the value. It says of each frame what is wrong with it: a toggle bit that does not alternate, a CRC or a size
that does not fit the data, an answer that nobody asked for, a frame of another transfer.

It takes nothing for granted: recordings begin in the middle, lose frames, and show faulty devices. Before the first request is
heard, nothing is wrong. A frame that does not fit into the transfer is put in words by itself, and the next initiate starts a new
transfer. Where the recording lacks a part of a block, neither its CRC nor its size is judged, and no value is shown. A request
that is given up without an abort is no fault of its own.

Whatever a missing frame can look like is told as that, once (finding.py). A fault needs a proof:

    toggle        of a segment: all bytes are there that were announced, so no segment is missing; or the server says so itself.
                  It is likely only where a copy of the frame before, in the place of the right one, would look the same
    size          the difference is less than a segment; it is likely only, and is told as missing frames behind another gap
    crc           the announced size is there
    two masters   another client's transfer inside of one that has all its bytes; or _REPEATED times, a second apart, answers to
                  two requests at once
    double id     _REPEATED times in a row a second answer with another value, sooner than any answer to a request has come; or
                  two values of an object that a device has for good (device type, identity), without a boot-up or a write
                  between them. That is likely only where both came more than PAUSE apart: the recording may lack the boot-up

Source: CiA 301 v4.2.0, 7.2.4.3.
"""

from __future__ import annotations

import enum
from binascii import crc_hqx
from functools import partial
from typing import Final, NamedTuple

from canopen_proto.abort import text_of
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.explained import counted
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.observer import words
from canopen_proto.observer.finding import QUIET, BusFinding, Gaps
from canopen_proto.observer.meaning import Meaning, Say
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, SEGMENT_SIZE
from canopen_proto.sdo.codec import (
    ABORT,
    BLOCK_DOWNLOAD,
    BLOCK_UPLOAD,
    CRC_BIT,
    EXPEDITED_BIT,
    FINAL,
    INITIATES,
    LAST,
    LEAST_INITIATE,
    LEAST_REQUEST,
    LEAST_RESPONSE,
    REQUESTS,
    RESPONSES,
    SEQUENCE,
    SPECIFIER,
    TOGGLE,
    SdoFrame,
    announced_size,
    complete,
    expedited_data,
    mux_in,
    number_in,
    segment_data,
    unused_at_end,
)

MAX_KEPT: Final = 1 << 16
"""The most bytes of a value that are kept: a longer one is firmware or the like, and its length is enough."""

TWO_CLIENTS: Final = 20 * MILLISECOND
"""Another request within this time behind one without an answer is another client's: no client gives up as soon."""

COPY: Final = 5 * MILLISECOND
"""The same frame of the same side within this time, with none of the other side between them, is a copy."""

PAUSE: Final = 100 * MILLISECOND
"""Behind such a pause a transfer may be another one, whose beginning is missing."""

_REPEATED: Final = 3
"""So often something has to happen that accuses another client, or another node."""
_MAX_SUPERSEDED: Final = 4
_TOGGLE_ABORT: Final = 0x0503_0000


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


# A name of the module is found in a tenth of the time that a member of an enumeration takes
_UNKNOWN: Final = _Phase.UNKNOWN
_IDLE: Final = _Phase.IDLE
_INITIATE_ANSWER: Final = _Phase.INITIATE_ANSWER
_SEGMENT_REQUEST: Final = _Phase.SEGMENT_REQUEST
_SEGMENT_ANSWER: Final = _Phase.SEGMENT_ANSWER
_BLOCK_START: Final = _Phase.BLOCK_START
_BLOCK_SEGMENTS: Final = _Phase.BLOCK_SEGMENTS
_BLOCK_ACKNOWLEDGEMENT: Final = _Phase.BLOCK_ACKNOWLEDGEMENT
_BLOCK_END: Final = _Phase.BLOCK_END
_BLOCK_END_ANSWER: Final = _Phase.BLOCK_END_ANSWER


class Settled(NamedTuple):
    """A value that a device is known to hold: it was read, or a write of it was confirmed."""

    node_id: int
    place: Mux
    data: bytes
    is_read: bool


_FOR_GOOD: Final = frozenset((b"\x00\x10\x00", *(bytes((0x18, 0x10, subindex)) for subindex in (1, 2, 3, 4))))
"""Objects that say who a device is, as they stand in a frame: 0x1000 and 0x1018."""


class SdoFollower:
    """See this module's text. node_id: of the server. dictionary: of its device, for names and types; may be empty.

    By the last frame: settled: the value that the device is known to hold, or None. aborted: the object of an abort, or None.
    """

    __slots__ = (
        "_acknowledgement", "_announced", "_answer", "_answered", "_asked", "_before", "_block_size", "_copies", "_crc", "_data",
        "_dictionary", "_echo", "_for_good", "_found", "_gaps", "_has_crc", "_held", "_is_client", "_is_doubtful",
        "_is_intruded", "_is_judged", "_is_lost", "_is_odd_proven", "_is_odd_request", "_is_paused", "_is_sound",
        "_is_twin_told", "_is_upload", "_is_whole", "_last", "_last_answer", "_last_request", "_least", "_length", "_now", "_odd",
        "_pending", "_phase", "_place",
        "_request", "_rival_at", "_rivals", "_sent", "_since", "_superseded", "_tail", "_toggle", "_twins", "_verb",
        "_was_final", "aborted", "node_id", "settled",
    )  # fmt: skip

    def __init__(self, node_id: int, dictionary: ObjectDictionary, gaps: Gaps) -> None:
        self.node_id = node_id
        self._gaps = gaps
        self._now: Time = -NEVER
        self._is_client = False  # who has sent the last frame
        self._before = b""  # the last frame
        self._last_request = self._last_answer = b""  # for a segment
        self._copies = 0  # requests that came twice, and may have two answers
        self._superseded: list[tuple[bytes, bool]] = []  # objects of requests without an answer; whether another came at once
        self._rivals = 0  # answers to one of two requests at once
        self._rival_at: Time = -NEVER  # the last of these
        self._twins = 0  # second answers in a row
        self._for_good: dict[bytes, tuple[bytes, Time]] = {}  # by object: its value, and when that came
        self._is_twin_told = False  # that it has two values
        self._least: Time = NEVER  # the least time from a request to its answer
        self._held: _Interrupted | None = None  # a transfer in which another one began
        self._is_lost = False  # frames of this transfer are missing
        self.settled: Settled | None = None
        self.aborted: Mux | None = None
        self._dictionary = dictionary
        self._found: list[BusFinding] = []
        self._phase = _UNKNOWN
        self._is_judged = False  # the request that began this transfer was heard
        self._since: Time = 0  # of the request that waits for its answer
        self._answer = b""  # the last one that ended a transfer
        self._answered: Time = 0
        self._begin(bytes(8), SdoFrame.DOWNLOAD)

    def _begin(self, frame: bytes, asked: SdoFrame) -> None:
        self._request, self._place, self._asked = frame, frame[1:4], asked
        self._is_upload = asked in _UPLOADS
        self._verb = "read" if self._is_upload else "write"
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
        self._odd = ""  # a toggle bit was wrong, in words
        self._is_odd_proven = True  # no copy of the frame before would look the same
        self._echo = b""  # a request for a segment that is a copy, or has a wrong toggle bit
        self._is_intruded = False  # another transfer was inside of this one
        self._is_paused = False  # the end of this transfer, and the beginning of another one, may be missing
        self._is_odd_request = False

    def take(self, frame: Frame, now: Time, found: list[BusFinding], *, is_client: bool) -> Meaning:
        """Return the meaning of a frame of the client, or of the server. found: takes what is wrong."""
        self.settled = self.aborted = None
        self._found = found
        data = frame.data
        if data == self._before and is_client is self._is_client and now - self._now < COPY:
            return self._copy(frame)
        if now - self._now > PAUSE and self._phase not in _BETWEEN:
            self._is_paused = True
        self._now, self._before, self._is_client = now, data, is_client
        return Meaning("SDO", self.node_id, self._of_client(data) if is_client else self._of_server(data), frame)

    def booted(self) -> None:
        """Take note of a boot-up: the device may have another program, and so another identity."""
        self._for_good.clear()
        self._is_twin_told = False

    def _compare(self, answer: bytes) -> None:
        """Report two devices with one node-ID, if an object whose value never changes has another one now. answer: the data of
        the server's frame, eight bytes."""
        place = answer[1:4]
        data = expedited_data(answer) if place in _FOR_GOOD and RESPONSES[answer[0]] is SdoFrame.UPLOAD else None
        if data is None:
            return
        before, at = self._for_good.get(place, (data, self._now))
        if not self._is_judged or (self._phase is _INITIATE_ANSWER and place == self._place):
            self._for_good[place] = data, self._now  # what nobody asked for is no measure
        if data != before and not self._is_twin_told:
            self._is_twin_told = True
            values = " and ".join(f"0x{int.from_bytes(each, 'little'):0{2 * len(each)}X}" for each in (before, data))
            text = f"two devices answer as node {self.node_id}: {words.name_of(answer)} is {values}"
            self._found.append(BusFinding("double id", self.node_id, text, is_certain=self._now - at <= PAUSE))

    def _copy(self, frame: Frame) -> Meaning:
        """Take a frame that has come twice: it counts once, unless both requests have an answer."""
        if not self._is_client and self._copies:
            self._copies -= 1
            return Meaning("SDO", self.node_id, words.once_more, frame)
        if self._is_client:
            self._copies += self._phase is _INITIATE_ANSWER
        if self._is_judged:
            what = "request" if self._is_client else "answer"
            self._gaps.copied(self.node_id, f"the same SDO {what} is there twice", self._now, self._found)
        return Meaning("SDO", self.node_id, words.once_more, frame)

    def _lost(self, text: str) -> None:
        """Take a sign that frames of this transfer are missing."""
        if self._is_judged:
            self._gaps.missing(self.node_id, text, self._now, self._found)
        self._forget()

    def _forget(self) -> None:
        """Judge nothing any more, up to the next request."""
        self._phase, self._is_judged, self._is_lost = _UNKNOWN, False, True
        self._rivals = self._twins = 0
        self._held = None
        self._pending.clear()

    def _lost_in_block(self, text: str) -> None:
        """Take a sign that frames of a block are missing. The block goes on, and its content is not known."""
        if self._is_whole and self._is_judged:
            self._gaps.missing(self.node_id, text, self._now, self._found)
        self._is_whole = False
        self._is_lost = True
        self._pending.clear()

    def _of_client(self, data: bytes) -> Say:
        if not self._is_upload and self._is_block_segment(data):
            return self._block_segment(data)
        request = complete(data, LEAST_REQUEST)
        if request is None:
            self._found.append(BusFinding("sdo", self.node_id, "an SDO request is too short for its command"))
            self._forget()  # what it asked for is not known, so neither is its answer
            return words.too_short
        what = REQUESTS[request[0]]
        if what is SdoFrame.ABORT:
            return self._aborted(request)
        if what in INITIATES:
            return self._initiate(request, what)
        if self._phase is _UNKNOWN:
            return words.alone
        if what in _SEGMENTS:
            return self._segment_request(request, is_upload=what is SdoFrame.UPLOAD_SEGMENT)
        return self._block(request, what)

    def _of_server(self, data: bytes) -> Say:
        if self._is_upload and self._is_block_segment(data):
            return self._block_segment(data)
        answer = complete(data, LEAST_RESPONSE)
        if answer is None:
            self._say("sdo", "an SDO answer is too short for its command")
            return words.too_short
        self._compare(answer)
        what = RESPONSES[answer[0]]
        say: Say
        if what is SdoFrame.ABORT:
            if self._phase is _IDLE and not self._superseded:
                self._lost("the server aborts a transfer whose request is not there")
            say = self._aborted(answer)
        elif self._phase is _IDLE or self._phase is _UNKNOWN:
            say = self._unasked(answer, what)
        elif self._phase is _INITIATE_ANSWER:
            say = self._initiate_answer(answer, what)
        elif what in _SEGMENTS and self._phase in (_SEGMENT_ANSWER, _SEGMENT_REQUEST):
            say = self._segment_answer(answer, is_upload=what is SdoFrame.UPLOAD_SEGMENT)
        else:
            say = self._block(answer, what)
        if self._phase is _IDLE:
            self._answer, self._answered = answer, self._now
        return say

    def _is_block_segment(self, data: bytes) -> bool:
        """Return whether a frame of the side that has the data is a segment of a block, and not an abort of the transfer."""
        if not data or (len(data) == 8 and data[0] == ABORT and data[1:4] == self._place):
            return False
        if self._phase is _BLOCK_SEGMENTS:
            return True
        return 0 < data[0] & SEQUENCE < LEAST_INITIATE and self._has_next_segments()

    # ---- initiate ----

    def _initiate(self, request: bytes, what: SdoFrame) -> Say:
        if self._phase is _INITIATE_ANSWER:
            if request != self._request:
                self._superseded.append((self._place, self._now - self._since < TWO_CLIENTS))
                del self._superseded[:-_MAX_SUPERSEDED]
            else:
                self._copies += 1  # the client asks again, and both may be answered
        elif self._phase in (_SEGMENT_REQUEST, _SEGMENT_ANSWER) and self._is_judged:
            self._end_oddly()
            self._held = _Interrupted(
                self._phase, self._request, self._announced, bytes(self._data), self._length, self._toggle, self._last_request
            )
        self._begin(request, what)
        self._phase, self._since, self._is_judged, self._is_lost = _INITIATE_ANSWER, self._now, True, False
        if what is SdoFrame.UPLOAD:
            return self._step()
        if what is SdoFrame.DOWNLOAD:
            self._for_good.pop(self._place, None)
            return self._value_or_segments(request)
        self._has_crc = bool(request[0] & CRC_BIT)
        if what is SdoFrame.BLOCK_DOWNLOAD:
            return self._step(f": in blocks{self._announce(request)}")
        self._block_size = request[4]
        return self._step(f": in blocks of {counted(request[4], 'segment')}")

    def _initiate_answer(self, answer: bytes, what: SdoFrame) -> Say:
        is_other = what is SdoFrame.UPLOAD and self._asked is SdoFrame.BLOCK_UPLOAD  # it may change to the other protocol
        if not (what is self._asked or is_other) or answer[1:4] != self._place:
            if not self._is_to_another(answer):
                is_named = answer[1:4] == self._place
                seen = "an SDO answer of another kind" if is_named else f"an SDO answer for {words.name_of(answer)}"
                self._lost(f"{seen}; the request was for {words.name_of(self._request)}")
            return self._by_itself(answer, what)
        self._least = min(self._least, self._now - self._since)
        self._twins = self._twins if answer[1:4] == self._answer[1:4] else 0
        if what is SdoFrame.DOWNLOAD:  # whose answer alone does not say whether segments follow
            if self._request[0] & EXPEDITED_BIT:
                return self._written()
            self._phase = _SEGMENT_REQUEST
        self._has_crc = self._has_crc and bool(answer[0] & CRC_BIT)
        return self._begun(answer, what)

    def _begun(self, answer: bytes, what: SdoFrame) -> Say:
        """Take the answer to an initiate request: the data follow, or are in it."""
        if what is SdoFrame.UPLOAD:
            say = self._value_or_segments(answer)
            self._phase = _SEGMENT_REQUEST
            if answer[0] & EXPEDITED_BIT:
                self._end()
            return say
        if what is SdoFrame.DOWNLOAD:
            return self._step(": go on")
        if what is SdoFrame.BLOCK_UPLOAD:
            self._phase = _BLOCK_START
            return self._step(f": in blocks{self._announce(answer)}")
        self._phase, self._block_size = _BLOCK_SEGMENTS, answer[4]
        return self._step(f": go on, {counted(answer[4], 'segment')} a block")

    def _value_or_segments(self, frame: bytes) -> Say:
        """Take the initiate frame of the side that has the data, without blocks."""
        data = expedited_data(frame)
        if data is None:
            return self._step(f": in segments{self._announce(frame)}")
        self._keep(data)
        return self._value()

    def _unasked(self, answer: bytes, what: SdoFrame) -> Say:
        if not self._is_judged or self._is_to_another(answer):
            return self._by_itself(answer, what)
        if self._copies and answer == self._answer:
            self._copies -= 1
            return self._by_itself(answer, what)
        is_twin = answer[1:4] == self._answer[1:4] and (self._now - self._answered) * 2 < self._least < NEVER
        twins = self._twins + 1 if is_twin else 0
        if twins >= _REPEATED:
            self._say(
                "double id",
                f"{counted(twins, 'time')} a second answer, with another value, to one SDO request: two nodes have one ID",
            )
            twins = 0
        else:
            self._lost("an SDO answer whose request is not there" + (", or a second node answers" if is_twin else ""))
        self._twins = twins
        return self._by_itself(answer, what)

    def _is_to_another(self, answer: bytes) -> bool:
        """Return whether an answer is to a request before the last one: its client gave up, or there are two clients."""
        for each in self._superseded:
            if each[0] == answer[1:4]:
                self._superseded.remove(each)
                if each[1] and self._now - self._rival_at > QUIET:
                    self._rival_at = self._now
                    self._rivals += 1
                    text = "answers to two SDO requests at once: another SDO client uses this channel"
                    if self._rivals == _REPEATED:
                        self._rivals = 0
                        self._say("two masters", text)
                    else:
                        self._gaps.missing(self.node_id, f"{text}, or an answer is missing", self._now, self._found)
                return True
        return False

    def _by_itself(self, answer: bytes, what: SdoFrame) -> Say:
        """Return an answer in words; its request was not heard, or was another one. If nothing else is known, the transfer is
        followed from here."""
        if what not in INITIATES:
            return words.STRAY_ANSWERS.get(what, words.alone)
        if self._phase is _UNKNOWN:
            self._begin(answer, what)
            return self._begun(answer, what)
        # Another transfer is followed, or its end is remembered: that stays as it is
        data = expedited_data(answer) if what is SdoFrame.UPLOAD else None
        if data is not None:
            self.settled = Settled(self.node_id, mux_in(answer), data, True)
        return self._said(answer, *(("read", ": begins") if what in _UPLOADS else ("write", ": go on")), data)

    # ---- segments ----

    def _segment_request(self, request: bytes, *, is_upload: bool) -> Say:
        held = self._held
        if held is not None and self._phase is _IDLE and request[0] & TOGGLE == held.toggle:
            self._resume(held)
        if self._phase not in (_SEGMENT_REQUEST, _SEGMENT_ANSWER) or is_upload != self._is_upload:
            self._lost("a request for a segment, outside of such a transfer")
            return words.alone
        if request[0] & TOGGLE != self._toggle and request == self._last_request:
            self._echo = request  # or the next one, with a wrong toggle bit: the answer will tell
            return words.once_more
        self._echo = b""
        self._is_odd_request = request[0] & TOGGLE != self._toggle
        if self._is_odd_request and self._phase is _SEGMENT_ANSWER:
            self._lost("the answer to a segment")
            return words.alone
        self._last_request = request
        self._check_toggle(request[0], "request")
        self._phase = _SEGMENT_ANSWER
        return self._step(": next segment") if is_upload else self._segment(request)

    def _segment_answer(self, answer: bytes, *, is_upload: bool) -> Say:
        if self._echo and self._phase is _SEGMENT_REQUEST and is_upload == self._is_upload:
            echo, self._echo = self._echo, b""
            if answer[0] & TOGGLE == self._toggle:
                self._odd = "the toggle bit of a segment's request does not alternate"
                self._is_odd_proven = False
                self._phase = _SEGMENT_ANSWER
                if not is_upload:
                    self._segment(echo)
        if answer == self._last_answer and answer[0] & TOGGLE != self._toggle and self._phase is _SEGMENT_REQUEST:
            return words.once_more
        if is_upload != self._is_upload or (self._phase is not _SEGMENT_ANSWER and self._is_judged):
            self._lost("a segment's answer to which there is no request")
            return words.alone
        if self._is_odd_request and answer[0] & TOGGLE != self._toggle:
            self._lost("a segment and its answer")
            return words.alone
        if answer[0] & TOGGLE != self._toggle and answer == self._last_answer:
            self._is_odd_proven = False
        self._last_answer = answer
        self._check_toggle(answer[0], "answer")
        self._toggle ^= TOGGLE
        self._phase = _SEGMENT_REQUEST
        if is_upload:
            return self._segment(answer)
        return self._written() if self._last else self._step(": segment confirmed")

    def _segment(self, frame: bytes) -> Say:
        """Take the data of a segment."""
        self._keep(segment_data(frame))
        self._last = bool(frame[0] & LAST)
        if not self._last:
            return self._step(f": segment, {counted(self._length, 'byte')} so far")
        self._check_size()
        if self._is_upload:
            self._end()
        return self._value()

    def _check_toggle(self, command: int, what: str) -> None:
        if command & TOGGLE != self._toggle:
            self._odd = self._odd or f"the toggle bit of a segment's {what} does not alternate"

    def _check_size(self, *, is_complete: bool = False) -> None:
        """Look at the size of a transfer that is over. It proves whether a segment is missing.

        is_complete: the CRC is right. Even then the size may have been announced for another transfer, whose rest is missing.
        """
        announced, length = self._announced, self._length
        if announced is not None and length != announced:
            self._odd = ""
            self._is_sound = False
            is_doubtful = self._is_paused or self._gaps.is_near(self._now)
            text = f"{words.name_of(self._request)} was announced with {announced} bytes, and has {length}"
            if (is_doubtful and not is_complete) or abs(announced - length) >= SEGMENT_SIZE:
                self._lost(text)
                return
            self._say("size", text, is_certain=False)
        self._check_odd()
        if self._is_intruded and announced == length:
            self._say("two masters", "a transfer in the middle of another one: another SDO client uses this channel")

    def _check_odd(self) -> None:
        """Tell a toggle bit that did not alternate, once the size tells whether a segment is missing."""
        odd, self._odd = self._odd, ""
        if odd and self._announced == self._length and (self._is_odd_proven or not self._gaps.is_near(self._now)):
            self._say("toggle", f"{odd}, and no segment is missing", is_certain=self._is_odd_proven)
        elif odd:
            self._is_sound = False
            self._lost(odd)

    def _end_oddly(self) -> None:
        """A transfer ends before its size could tell whether a segment is missing."""
        if self._odd:
            self._gaps.missing(self.node_id, self._odd, self._now, self._found)
            self._odd = ""

    def _resume(self, held: _Interrupted) -> None:
        """Go on with a transfer in which another one was made."""
        self._held = None
        self._begin(held.request, REQUESTS[held.request[0]])
        self._phase, self._announced, self._length, self._toggle = held.phase, held.announced, held.length, held.toggle
        self._data += held.data
        self._last_request = held.last_request
        self._is_intruded = True

    # ---- blocks ----

    def _block_segment(self, data: bytes) -> Say:
        """Take a segment of the side that has the data."""
        segment = data[:8].ljust(8, b"\0")
        number, is_final = segment[0] & SEQUENCE, bool(segment[0] & FINAL)
        if number < self._sent:
            self._lost_in_block("an acknowledgement of a block")
            self._acknowledgement = b""
        self._sent = number
        if number == len(self._pending) + 1:
            self._pending.append(segment[1:])
        elif self._pending and number == len(self._pending) and segment[1:] != self._pending[-1]:
            self._is_doubtful = True  # one of the two is late, from another block
        if is_final or number >= self._block_size:
            self._was_final = is_final
            self._phase = _BLOCK_ACKNOWLEDGEMENT
        elif self._phase is not _BLOCK_SEGMENTS:
            self._phase = _BLOCK_SEGMENTS
        return self._step(f": block segment {number}{', the last' if is_final else ''}")

    def _has_next_segments(self) -> bool:
        """Return whether segments of a block may come here, if the frame before them is missing."""
        if self._phase is _BLOCK_ACKNOWLEDGEMENT:
            return not self._was_final
        is_begun = self._phase is (_BLOCK_START if self._is_upload else _INITIATE_ANSWER)
        if not is_begun or self._asked not in (SdoFrame.BLOCK_DOWNLOAD, SdoFrame.BLOCK_UPLOAD):
            return False
        self._lost_in_block("the beginning of a block")
        return True

    def _block(self, frame: bytes, what: SdoFrame) -> Say:
        """Take a frame of a block transfer, but its initiation and its segments; or a frame that does not fit at all."""
        phase, by_sender = self._phase, self._is_client is not self._is_upload
        if by_sender:
            if what is SdoFrame.BLOCK_END and phase is _BLOCK_END:
                return self._block_end(frame)
        elif what is SdoFrame.BLOCK_START and phase is _BLOCK_START:
            self._phase = _BLOCK_SEGMENTS
            return self._step(": start")
        elif self._may_acknowledge(frame, what):
            return self._acknowledged(frame)
        elif what is SdoFrame.BLOCK_END_RESPONSE and phase is _BLOCK_END_ANSWER:
            if not self._is_upload:
                return self._written()
            self._end()
            return self._step(": block transfer ended")
        if self._is_client and frame[0] & SPECIFIER == SPECIFIER and phase is _IDLE:
            self._say("sdo", f"an SDO request with the command 0x{frame[0]:02X}, which does not exist")
            return words.alone
        if phase in _IN_BLOCK and self._is_of_block(frame, what):
            self._lost_in_block("the end of a block" if self._is_client and by_sender else "a part of a block")
            if by_sender and what is SdoFrame.BLOCK_END:
                return self._block_end(frame)
            if what is SdoFrame.BLOCK_ACKNOWLEDGEMENT:
                return self._acknowledged(frame)
            if what is SdoFrame.BLOCK_END_RESPONSE:
                if not self._is_upload:
                    return self._written()
                self._end()
            if self._is_upload:
                return self._step(": not all of it was heard")
        if self._is_client:
            self._lost("a frame of a block transfer that does not fit here")
            return words.alone
        self._lost("an SDO answer that does not fit the request")
        return self._by_itself(frame, what)

    def _is_of_block(self, frame: bytes, what: SdoFrame) -> bool:
        """Return whether a frame may belong to the block transfer, where frames are missing."""
        if self._is_client:
            return self._is_upload or what is SdoFrame.BLOCK_END
        return frame[0] & SPECIFIER == (BLOCK_DOWNLOAD if self._is_upload else BLOCK_UPLOAD)

    def _may_acknowledge(self, frame: bytes, what: SdoFrame) -> bool:
        if self._phase is _BLOCK_END:  # it may be said once more
            return frame == self._acknowledgement
        is_acknowledgement = what is SdoFrame.BLOCK_ACKNOWLEDGEMENT
        return is_acknowledgement and self._phase in (_BLOCK_SEGMENTS, _BLOCK_ACKNOWLEDGEMENT)

    def _acknowledged(self, frame: bytes) -> Say:
        """Count what the receiver has. The sender goes on behind that: with the rest of this sub-block, if something was lost."""
        taken, self._block_size = frame[1], frame[2] or MAX_BLOCK_SIZE
        if not self._sent and frame == self._acknowledgement:
            self._is_doubtful = True
            return self._step(f": {counted(taken, 'segment')} taken, once more")
        self._acknowledgement = frame
        if taken > MAX_BLOCK_SIZE:
            self._say("sdo", f"{counted(taken, 'segment')} acknowledged, and a block has {MAX_BLOCK_SIZE} at most")
        elif taken > len(self._pending):
            self._lost_in_block(f"{counted(taken, 'segment')} of a block acknowledged")
        again = ", the others must be sent again" if taken < self._sent else ""
        self._is_whole = self._is_whole and taken <= len(self._pending)
        for content in self._pending[:taken]:
            self._keep_tail(self._tail)
            self._tail = content  # the last one of all has unused bytes, which only the end tells
        is_over = self._was_final and taken == self._sent
        self._pending.clear()
        self._sent = 0
        self._was_final = False
        self._phase = _BLOCK_END if is_over else _BLOCK_SEGMENTS
        return self._step(f": {counted(taken, 'segment')} taken{again}")

    def _block_end(self, frame: bytes) -> Say:
        self._phase = _BLOCK_END_ANSWER
        self._keep_tail(self._tail[: SEGMENT_SIZE - unused_at_end(frame)])
        said = int.from_bytes(frame[1:3], "little")
        if self._is_doubtful:
            has_proof = self._has_crc or self._announced is not None
            fits = (not self._has_crc or self._crc == said) and self._announced in (None, self._length)
            self._is_whole = self._is_whole and has_proof and fits
        if self._is_whole:
            is_wrong = self._has_crc and self._crc != said
            self._is_sound = not is_wrong
            if is_wrong and (self._announced is None or self._is_paused):
                self._lost("the CRC of a block does not fit, and its size does not prove that all of it is there")
                return self._step(": not all of it was heard")
            if is_wrong and self._announced == self._length:
                self._say(
                    "crc", f"the CRC of {words.name_of(self._request)} is said to be 0x{said:04X}, and is 0x{self._crc:04X}"
                )
            self._check_size(is_complete=self._has_crc and not is_wrong)
        return self._value()

    # ---- all ----

    def _end(self) -> None:
        self._phase = _IDLE if self._is_judged else _UNKNOWN
        self._pending.clear()

    def _announce(self, frame: bytes) -> str:
        """Take note of the size that an initiate frame announces. Return it in words."""
        size = announced_size(frame)
        if size is None:
            return ""
        self._announced = size
        return f", {counted(size, 'byte')}"

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
            return self._step(f": {counted(self._length, 'byte')}")
        data = bytes(self._data)
        if self._is_upload:
            self._settle(data)
        return self._step("", data)

    def _written(self) -> Say:
        """The server has confirmed all of a download."""
        self._check_odd()  # of this last answer: the size was looked at when the last segment came
        self._end()
        data = bytes(self._data) if self._is_whole and self._length == len(self._data) else None
        if data is not None:
            self._settle(data)
        return self._said(self._request, words.WRITTEN, "", data)

    def _settle(self, data: bytes) -> None:
        if self._is_sound and not self._is_lost:
            self.settled = Settled(self.node_id, mux_in(self._request), data, self._is_upload)

    def _aborted(self, frame: bytes) -> Say:
        code, whom = number_in(frame), "client" if self._is_client else "server"
        if code == _TOGGLE_ABORT and (self._odd or self._is_odd_request or self._echo):
            self._say("toggle", f"the toggle bit of a segment does not alternate; the {whom} says so too")
            self._odd = ""
        self._end_oddly()
        self._end()
        self.aborted = mux_in(frame)
        text = text_of(code)
        reason = f": {text}" + ("" if "(0x" in text else f" (0x{code:08X})")
        return self._said(frame, f"aborted by the {whom},", reason)

    def _step(self, after: str = "", data: bytes | None = None) -> Say:
        return self._said(self._request, self._verb, after, data)

    def _said(self, named: bytes, verb: str, after: str, data: bytes | None = None) -> Say:
        """Return a step of a transfer, to be put in words later. named: a frame that names the object; see `sdo_step`."""
        is_held = data is not None and self.settled is not None
        return partial(words.sdo_step, self._dictionary, self.node_id, named, verb, after, data, is_held)

    def _say(self, rule: str, text: str, *, is_certain: bool = True) -> None:
        if self._is_judged:
            self._found.append(BusFinding(rule, self.node_id, text, is_certain=is_certain))


class _Interrupted(NamedTuple):
    """A transfer in segments in which another one began."""

    phase: _Phase
    request: bytes
    announced: int | None
    data: bytes
    length: int
    toggle: int
    last_request: bytes


_BETWEEN: Final = frozenset((_UNKNOWN, _IDLE, _INITIATE_ANSWER))
_IN_BLOCK: Final = frozenset(
    (
        _BLOCK_START,
        _BLOCK_SEGMENTS,
        _BLOCK_ACKNOWLEDGEMENT,
        _BLOCK_END,
        _BLOCK_END_ANSWER,
    )
)
_SEGMENTS: Final = (SdoFrame.DOWNLOAD_SEGMENT, SdoFrame.UPLOAD_SEGMENT)
_UPLOADS: Final = (SdoFrame.UPLOAD, SdoFrame.BLOCK_UPLOAD)
