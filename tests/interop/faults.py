"""Faults that are planted in recorded sessions, for the observer to find.

Two kinds. A `Change` makes another session of a recorded one: a bit is flipped, an answer comes twice. It needs such a frame, so
it fits some sessions only. A `Scene` is what two further devices, nodes 98 and 99, do on the same bus: it has its own
times, and its frames go in between those of the session. Each scene has a twin that is right.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import accumulate
from random import Random
from typing import NamedTuple, TypeAlias

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.observer.finding import AT_ONCE
from canopen_proto.observer.observer import Observer
from canopen_proto.observer.sdo import PAUSE
from canopen_proto.sdo.codec import TOGGLE
from tests.interop.recorded import Line

BITRATE = 125_000
"""Of the recorded sessions, for their load: they were made on a bus in software."""

KNOWN = {
    # The session was made for this: the device's own emergency (0x8130) says the same in the same frame
    "canopennode-heartbeat-consumer-emcy": ["late heartbeat", "boot-up"],  # a node that the tool plays boots again
}
"""What is truly wrong in a recorded session."""

Session: TypeAlias = list[Line]


class Found(NamedTuple):
    """A finding. line: the frame that shows it."""

    line: Line
    rule: str
    node_id: int
    is_certain: bool


def found_in(session: Session) -> list[Found]:
    """Observe a session."""
    observer = Observer(bitrate=BITRATE)
    return [
        Found(line, found.rule, found.node_id, found.is_certain)
        for line in session
        for found in observer.observe(line.frame, line.time).findings
    ]


# ---- changes of recorded frames ----


class Change(NamedTuple):
    """rule: the one that the fault breaks. fits: what a frame has to be, by its words and its first byte. plant: the fault.

    has_crc: it fits only into block transfers with a CRC, to which both sides have agreed, and without a pause.
    """

    rule: str
    fits: str
    plant: Callable[[Session, int], Session]
    has_crc: bool = False

    def places(self, session: Session) -> list[int]:
        """The frames at which it can be planted."""
        observer = Observer()
        words = [f"{line.text[:6]} {observer.observe(line.frame, line.time).meaning.text}" for line in session]
        fitting, is_with_crc, begin, last = [], False, 0, 0
        for at, each in enumerate(words):
            if re.match(BLOCK_INITIATE, each):
                is_with_crc = (is_with_crc or each[:2] == "60") and re.match(WITH_CRC, each) is not None
                begin = at
            elif self.has_crc and session[at].time - last > PAUSE and re.match(OF_BLOCK, each):
                # Behind a pause a lost block is as likely as a wrong byte
                is_with_crc, fitting = False, [place for place in fitting if place < begin]
            if re.match("60|58", each):
                last = session[at].time
            if re.match(self.fits, each) and (is_with_crc or not self.has_crc):
                fitting.append(at)
        return fitting

    def found(self, session: Session, at: int, known: list[Found]) -> list[Found]:
        """What is found with this fault at a frame. known: what is found without it."""
        return [each for each in found_in(self.plant(session, at)) if each not in known]


def with_byte(session: Session, at: int, place: int, bits: int) -> Session:
    """The session with some bits of a frame flipped."""
    data = bytearray(session[at].frame.data)
    data[place] ^= bits
    return with_data(session, at, bytes(data))


def with_data(session: Session, at: int, data: bytes) -> Session:
    line = session[at]
    return [*session[:at], line._replace(frame=Frame(line.frame.can_id, data)), *session[at + 1 :]]


def with_copy(session: Session, at: int, place: int, bits: int) -> Session:
    """The session with a frame sent a second time 100 us later, with some bits flipped."""
    copy = with_byte(session, at, place, bits)[at]
    return [*session[: at + 1], copy._replace(time=copy.time + 100_000), *session[at + 1 :]]


def without(session: Session, at: int) -> Session:
    """The session as a recorder leaves it that has lost a frame."""
    return [*session[:at], *session[at + 1 :]]


def with_frame(session: Session, at: int, *texts: str) -> Session:
    """The session with further frames behind one, 10 us apart."""
    line = session[at]
    new = [Line(line.time + 10_000 * number, Frame.parse(text)) for number, text in enumerate(texts, 1)]
    return [*session[: at + 1], *new, *session[at + 1 :]]


def with_boot_up(session: Session, at: int) -> Session:
    """The session with a boot-up of the node that has sent a frame."""
    return with_frame(session, at, f"{0x700 + (session[at].frame.can_id & 0x7F):03X}#00")


def with_stranger(session: Session, at: int) -> Session:
    """The session with an expedited read of another client behind a frame of a transfer."""
    node_id = session[at].frame.can_id & 0x7F
    return with_frame(session, at, f"{0x600 + node_id:03X}#4000100000000000", f"{0x580 + node_id:03X}#4300100091010F00")


ANSWER = "58.#4[^1] read .* ="
"""Of an expedited upload."""
ANSWER_THAT_CHANGES = "58.#4[^1] read (?!1000:00|1018:0[1-4]).* ="
ANSWER_FOR_GOOD = "58.#4[^1] read (1000:00|1018:0[1-4]).* ="
BLOCK_INITIATE = "(60|58).#.. .*(in blocks|segments a block)"
WITH_CRC = "(60|58).#(A4|C[46])"
REQUEST = "60.#40 read "
SEGMENT = "(60|58).#.. .*(next segment|segment confirmed|bytes so far)"
OF_BLOCK = "(60|58).#.. .*(block segment [0-9]+$|segments taken)"
IN_BLOCK = "(60|58).#.. .*block segment [0-9]+$"
ANSWER_IN_SEGMENTS = "58.#.. .*(segment confirmed|bytes so far)"
SIZED = "(60|58).#.. .*in (segments|blocks), [0-9]+ bytes"
CHANGES = [
    Change("toggle", SEGMENT, lambda session, at: with_byte(session, at, 0, TOGGLE)),
    Change("crc", IN_BLOCK, lambda session, at: with_byte(session, at, 1 + at % 7, 1 << at % 8), has_crc=True),
    Change("size", SIZED, lambda session, at: with_byte(session, at, 4, 1 << at % 3)),
    Change("copied", ANSWER, lambda session, at: with_copy(session, at, 0, 0)),
    Change("missing", SEGMENT, without),
    Change("missing", IN_BLOCK, without),
    Change("boot-up", ANSWER, with_boot_up),
    Change("two masters", ANSWER_IN_SEGMENTS, with_stranger),
    Change("missing", ANSWER, lambda session, at: with_byte(session, at, 3, 0x40)),
    Change("missing", ANSWER_THAT_CHANGES, lambda session, at: with_copy(session, at, 4, 1)),
    Change("double id", ANSWER_FOR_GOOD, lambda session, at: with_copy(session, at, 4, 1)),
    Change("sdo", REQUEST, lambda session, at: with_data(session, at, session[at].frame.data[:2])),
]


# ---- further devices ----


@dataclass(frozen=True)
class Scene:
    """A scene that nodes 98 and 99 play. rule: the one that is broken. frames: with the time since the frame before, in ms.
    is_faulty: else nothing is wrong."""

    rule: str
    frames: list[tuple[float, str]]
    is_faulty: bool

    @property
    def has_sync(self) -> bool:
        """Whether SYNCs are among the frames."""
        return any(text.startswith("080#") for _, text in self.frames)

    def begin_in(self, session: Session, random: Random) -> Time:
        """A time from which it can happen: it is not interrupted by a command to all nodes, and no frame of it stands right
        behind one of the session: no bus brings both so soon (`AT_ONCE`)."""
        times = [round(each * MILLISECOND) for each in accumulate(after for after, _ in self.frames)]
        length = times[-1]
        commands = [line.time for line in session if line.frame.can_id == 0 and not line.frame.data[1]]
        while True:
            begin = random.randrange(session[0].time, session[-1].time + SECOND)
            is_possible = not any(0 <= begin + time - line.time < AT_ONCE for time in times for line in ended(session))
            if is_possible and not any(begin <= command <= begin + length for command in commands):
                return begin

    def is_explained(self, session: Session, begin: Time) -> bool:
        """Whether it is no fault there: a node that boots behind a reset of all nodes was told to, however late it is."""
        resets = (line.frame.data for line in session if line.frame.can_id == 0 and line.time <= begin)
        return self.rule == "boot-up" and any(data in (b"\x81\x00", b"\x82\x00") for data in resets)

    def within(self, session: Session, begin: Time) -> Session:
        """The session with these frames too, from a time on."""
        now, lines = begin, []
        for after, text in self.frames:
            now += round(after * MILLISECOND)
            lines.append(Line(now, Frame.parse(text)))
        return sorted([*ended(session), *lines], key=lambda line: line.time)

    def found(self, session: Session, begin: Time, known: list[Found]) -> list[Found]:
        """What is found with this scene from a time on. known: what is found without it.

        Known is by rule and node: a frame of the scene may be the one that shows it. Left out: what its own nodes show
        behind the end of the recording, and for SYNCs that they have not heard.
        """
        end, found = session[-1].time, found_in(self.within(session, begin))
        for rule, node_id in ((each.rule, each.node_id) for each in known):
            found = _without_first(found, rule, node_id)
        return [each for each in found if each.node_id in DEVICES or (each.line.time <= end and not self.has_sync)]


def ended(session: Session) -> Session:
    """The session, and at its end a reset of each of its nodes: behind that they are silent, and that is no gap of the bus."""
    nodes = sorted({line.frame.can_id & 0x7F for line in session if line.frame.can_id & 0x780 == 0x700})
    texts = [text for node in nodes for text in (f"000#81{node:02X}", f"{0x700 + node:03X}#00")]
    return [*session, *(Line(session[-1].time + at * 2 * AT_ONCE, Frame.parse(text)) for at, text in enumerate(texts, 1))]


def _without_first(found: list[Found], rule: str, node_id: int) -> list[Found]:
    at = next((at for at, each in enumerate(found) if (each.rule, each.node_id) == (rule, node_id)), len(found))
    return [*found[:at], *found[at + 1 :]]


def write(index: int, subindex: int, value: int, size: int, node_id: int = 99) -> list[tuple[float, str]]:
    """A write by SDO, and its confirmation."""
    place = f"{index & 0xFF:02X}{index >> 8:02X}{subindex:02X}"
    data = value.to_bytes(4, "little").hex()
    return [
        (1, f"{0x600 + node_id:03X}#{0x23 | (4 - size) << 2:02X}{place}{data}"),
        (1, f"{0x580 + node_id:03X}#60{place}00000000"),
    ]


def mapped(node_id: int, cob_id: int) -> list[tuple[float, str]]:
    """TPDO 1 of a node gets this COB-ID, and 0x6041 as the only object."""
    return [
        *write(0x1800, 1, cob_id, 4, node_id),
        *write(0x1A00, 1, 0x6041_0010, 4, node_id),
        *write(0x1A00, 0, 1, 1, node_id),
    ]


def every(ms: float, *texts: str) -> list[tuple[float, str]]:
    return [(ms, text) for text in texts]


DEVICES = (0, 98, 99)
"""Node-IDs in findings about scenes."""
PDO = "1E3#3702"
READ = "663#4041600000000000"
RUNS = "763#05"
TIMED = [*mapped(99, 0x1E3), (1, RUNS)]
"""Node 99 has a TPDO, and is operational."""


STOP = [(1, "000#8063")]


def pairs() -> Iterator[tuple[str, list[tuple[float, str]], list[tuple[float, str]]]]:
    """Each rule, with what breaks it, and with the like that does not."""
    guarded = ["763#R1", RUNS, "763#R1", "763#85"]
    yield "toggle", every(9, *guarded, *guarded[2:] * 7), every(9, *guarded, *guarded[:2])
    block = every(1, "663#C600200003000000", "5E3#A40020007F000000", "663#8161626300000000", "5E3#A2017F0000000000")
    yield "crc", [*block, (1, "663#D100000000000000")], [*block, *every(1, "663#D1D69D0000000000", "5E3#A100000000000000")]
    begin, end = ["5E3#6000200000000000", "663#0761626364000000"], "5E3#2000000000000000"
    yield "size", every(1, "663#2100200005000000", *begin), every(1, "663#2100200004000000", *begin, end)
    read = [READ, "5E3#4B41600037020000"]
    yield "missing", every(900, *read, read[1]), every(900, *read, *read)
    yield "copied", every(1, *read, read[1]), every(9, *read, *read)
    yield "sdo", every(1, *read, "663#E000000000000000"), every(1, *read, "663#2100200004000000", *begin, end)
    other = ["663#4064600000000000", "5E3#4364600000000000"]
    at_once, in_turn = every(1, READ, other[0], read[1], other[1]), every(1, *read, *other)
    yield "two masters", [*at_once, (1500, RUNS)] * 3, [*in_turn, (1500, RUNS)] * 3
    yield "double id", every(9, *[RUNS, "763#7F"] * 3), every(9, RUNS, "763#7F", RUNS)
    period = write(0x1017, 0, 100, 2)
    steady, ends = [*period, *every(100, *[RUNS] * 5)], write(0x1017, 0, 0, 2)
    yield "double id", [*period, *[(30, RUNS), (70, RUNS)] * 7, *ends], [*steady, *ends]
    both = every(1, "763#05", "762#05")
    yield "shared cob-id", *([*both, *mapped(98, 0x1E2), *mapped(99, each), (1, RUNS)] for each in (0x1E2, 0x1E3))
    yield "pdo length", [*TIMED, (1, PDO), (1, PDO + "00")], [*TIMED, (1, PDO)]
    for inhibit, frame in ((write(0x1800, 3, 500, 2), PDO), (write(0x1015, 0, 500, 2), "0E3#0010010000000000")):
        yield "inhibit time", [*TIMED, *inhibit, *every(20, *[frame] * 4)], [*TIMED, *inhibit, *every(50, *[frame] * 4)]
    timer = [*TIMED, *write(0x1800, 2, 254, 1), *write(0x1800, 5, 100, 2)]
    yield "late pdo", [*timer, (1, PDO), (200, RUNS)], [*timer, *every(100, PDO, PDO, RUNS), *STOP]
    cyclic = [*TIMED, *write(0x1800, 2, 1, 1)]
    cycles = [*cyclic, *every(0, "080#", PDO, "080#", PDO), *STOP]
    yield "late pdo", [*cyclic, *every(0, PDO, "080#", "080#", "080#")], cycles
    twice = [(20, "080#"), (1, PDO), (1, "1E3#3703")]
    yield "synchronous pdo", [*cyclic, *twice * 6], cycles
    ready, halted = (60, "763#7F"), (60, "763#04")
    yield "not operational", [*TIMED, ready, (200, PDO), ready], [*TIMED, ready, (200, PDO), (10, RUNS)]
    yield "stopped", [halted, (200, READ), halted], [halted, ready, (200, READ), ready]
    yield "state", every(1, "763#11"), every(1, "763#04")
    yield "nmt", every(1, "000#0763"), every(1, "000#0163")
    yield "boot-up", every(1, RUNS, "763#00"), every(1, RUNS, "000#8163", "763#00")
    first, second = ([*write(0x1005, 0, 0x4000_0080, 4, each), *write(0x1006, 0, 9000, 4, each)] for each in (98, 99))
    yield "two sync", [*first, *second], first
    yield "sync counter", every(0, "080#F5"), every(0, "080#05")
    listens, listens_no_more = write(0x1016, 1, 99 << 16 | 200, 4, 98), write(0x1016, 1, 0, 4, 98)
    yield "late heartbeat", [*listens, *every(300, RUNS, RUNS)], [*listens, *every(150, RUNS, RUNS), *listens_no_more]
    for whole in ("080#01", "0E3#0010010000000000", "100#000000000000", "000#0163", "763#05", "7E5#0400000000000000"):
        right = "080#" if whole == "080#01" else whole
        yield "length", every(1, whole + "00" if len(whole) < 20 else whole[:-2]), every(1, right)
    full = "1E3#5555555555555555"
    yield "load", every(0.8, *[full] * 2700), every(10, *[full] * 10)
    yield "late heartbeat", [*steady, (300, READ)], [*steady, (150, RUNS), *ends]
    yield "double id", [(20, RUNS), (480, RUNS)] * 7, [(100, RUNS), (200, RUNS)] * 7


SCENES = [Scene(rule, wrong, True) for rule, wrong, _ in pairs()] + [Scene(rule, right, False) for rule, _, right in pairs()]
