"""Frames that CAN delivers twice: a write is confirmed by its own answer alone, and refused by its own alone.

CAN repeats a frame of which its sender alone saw an error; the copy comes behind it, before anything else of that sender. It does
so with answers, and with requests, which a server then answers twice. `python -m fuzz copied_frames` plays as many cases as one
likes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random
from typing import Final

import pytest
from hypothesis import given, note
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, Outbox, Outcome, RequestId, Time
from canopen_proto.sdo.client import TIMEOUT, Block, SdoAborted, SdoClient, SdoDownloaded, SdoUploaded
from canopen_proto.sdo.server import SdoServer
from fuzz.two_ended import WithoutBlocks
from tests.core.bus import Bus, Fate, take_events
from tests.core.test_sdo_client import Bench
from tests.core.test_sdo_client_faults import ignored
from tests.examples import examples

NODE = 12
SHORT, OTHER, LONG = 0x2000, 0x2001, 0x2002
SIZES: Final = {SHORT: 4, OTHER: 2, LONG: 40}
FATES: Final = (*[Fate.DELIVERED] * 4, Fate.COPIED, Fate.COPIED, Fate.LOST, Fate.PAUSED)
PAUSES: Final = (40 * MILLISECOND, 200 * MILLISECOND)
"""Of a frame in its sender's queue: with request and answer held up the answer still comes within the time-out."""


# ---- whatever comes twice ----


@dataclass(frozen=True)
class Asked:
    """One request. pause: ns after the outcome of the one before; None: at once, it waits in the queue. is_refused: the device
    does not take what it writes. patience: ns after which the caller gives it up; None: never."""

    index: int
    is_write: bool
    is_refused: bool
    block: Block
    pause: Time | None
    patience: Time | None


@dataclass(frozen=True)
class Case:
    """Requests, and the fates of the frames. forgets: a device that refuses a write which it has just executed."""

    asked: tuple[Asked, ...]
    fates: tuple[Fate, ...]
    seed: int
    slowest: Time
    held: Time
    forgets: bool
    has_blocks: bool


def case_of(source: Random) -> Case:
    """Draw a case. Most requests name the object of the one before."""
    asked: list[Asked] = []
    index = SHORT
    for _ in range(source.randint(1, 6)):
        index = index if source.random() < 0.7 else source.choice(tuple(SIZES))
        block: Block = source.choice((False, False, True, "auto")) if index == LONG else False
        pause = source.choice((None, 0, 0, MILLISECOND, 30 * MILLISECOND))
        patience = source.choice((*[None] * 5, 0, 100_000, MILLISECOND))
        asked.append(Asked(index, source.random() < 0.7, source.random() < 0.3, block, pause, patience))
    forgets = source.random() < 0.5
    fates = [source.choice(FATES) for _ in range(source.randint(0, 40))]
    if forgets:  # with a request that came twice, and the first answer lost, nothing would tell
        fates = [Fate.DELIVERED if fate is Fate.LOST else fate for fate in fates]
    slowest = source.choice((0, 100_000, 5 * MILLISECOND))
    seed = source.getrandbits(32)
    return Case(tuple(asked), tuple(fates), seed, slowest, source.choice(PAUSES), forgets, source.random() < 0.7)


def content(index: int, number: int) -> bytes:
    """What request `number` writes: different bytes each time."""
    return bytes((number + 1,)) * SIZES[index]


class Device:
    """A store in which each reading of an object gives another value. taken, refused: what was written, and when."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.taken: list[tuple[Time, int, bytes]] = []
        self.refused: list[tuple[Time, int]] = []
        self.given: dict[bytes, Time] = {}

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode:
        if index not in SIZES:
            return bytes(4)
        value = (1000 + len(self.given)).to_bytes(2, "little") * (SIZES[index] // 2)
        self.given[value] = now
        return value

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | None:
        return None

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | None:
        has_it = bool(self.taken) and self.taken[-1][1:] == (index, data)
        if self.case.asked[data[0] - 1].is_refused or (self.case.forgets and has_it):
            self.refused.append((now, index))
            return AbortCode.DEVICE_STATE
        self.taken.append((now, index, data))
        return None


@dataclass
class Job:
    """A request as its caller sees it."""

    number: int
    asked: Asked
    since: Time
    outcome: Outcome | None = None
    was_sent: bool = True


@dataclass
class Scene:
    """A case that is played."""

    case: Case
    jobs: dict[RequestId, Job] = field(default_factory=dict)

    def __post_init__(self) -> None:
        case = self.case
        self.device = Device(case)
        self.bus = Bus(case.seed, delay=(0, case.slowest), fates=case.fates, pause=case.held)
        self.client = self.bus.attach(SdoClient(Outbox(), NODE))
        self.bus.attach((SdoServer if case.has_blocks else WithoutBlocks)(Outbox(), NODE, self.device))
        self.bus.on_event = self._hear
        for number, asked in enumerate(case.asked):
            if asked.pause is not None:
                self.bus.run_until(lambda: all(job.outcome for job in self.jobs.values()))
                self.bus.run(asked.pause)
            self._ask(number, asked)
            if asked.patience is not None:
                self.bus.run(asked.patience)
                self._give_up(max(self.jobs))
        self.bus.settle(600 * SECOND)

    def _ask(self, number: int, asked: Asked) -> None:
        now = self.bus.now
        if asked.is_write:
            request_id = self.client.download(asked.index, 0, content(asked.index, number), now, block=asked.block)
        else:
            request_id = self.client.upload(asked.index, 0, now, block=asked.block)
        self.jobs[request_id] = Job(number, asked, now)

    def _give_up(self, request_id: RequestId) -> None:
        under_way = self.client._transfer
        is_open = self.jobs[request_id].outcome is None
        self.jobs[request_id].was_sent = not is_open or (under_way is not None and under_way.request_id == request_id)
        self.client.cancel(request_id, self.bus.now)

    def _hear(self, report: Event) -> None:
        if isinstance(report, Outcome):
            job = self.jobs[report.request_id]
            assert job.outcome is None, "one outcome each"
            job.outcome = report

    def wrong(self) -> list[str]:
        """What is not true of what was said."""
        jobs = list(self.jobs.values())
        words = [self._wrong(job, jobs[: job.number]) for job in jobs]
        return [f"{word}: request {number} of {self.case}" for number, word in enumerate(words) if word]

    def _wrong(self, job: Job, before: list[Job]) -> str:
        asked, outcome = job.asked, job.outcome
        was_taken = asked.is_write and any(
            (index, data) == (asked.index, content(asked.index, job.number)) for _, index, data in self.device.taken
        )
        match outcome:
            case SdoDownloaded():
                return "" if was_taken else "confirmed what was not written"
            case SdoUploaded():
                return "" if self.device.given[outcome.data] >= self._first_of(job, before).since else "an old value as a new one"
            case SdoAborted(not_confirmed=False) if was_taken:
                return "not a word that it was written"
            case SdoAborted(abort_code=AbortCode.DEVICE_STATE):
                is_so = any(index == asked.index and job.since <= time for time, index in self.device.refused)
                return "" if asked.is_write and is_so else f"refused, which it was not ({outcome})"
        return "" if outcome else "no outcome"

    def _first_of(self, job: Job, before: list[Job]) -> Job:
        """The first of the reads of the object in a row that this one ends: their answers look alike (docs/limits.md)."""
        first = job
        for each in reversed(before):
            if each.was_sent:
                if each.asked.is_write or each.asked.index != job.asked.index:
                    break
                first = each
        return first


def judge(case: Case) -> None:
    """Play a case: nothing that is said is false."""
    words = Scene(case).wrong()
    assert not words, words


@examples(400, least=100)
@given(source=st.randoms(use_true_random=False))
def test_whatever_comes_twice_nothing_that_is_said_is_false(source: Random) -> None:
    case = case_of(source)
    note(str(case))
    judge(case)


# ---- a question between two requests for one object ----

CONFIRMED = "60 40 60 00 00 00 00 00"
REFUSED = "80 40 60 00 22 00 00 08"
TYPE = "43 00 10 00 92 01 02 00"


def write(bench: Bench, word: int, *, urgent: bool = False) -> RequestId:
    return bench.client.download(0x6040, 0, word.to_bytes(2, "little"), bench.now, urgent=urgent)


def wrote() -> Bench:
    """A client that has just written 0x6040, once."""
    bench = Bench()
    write(bench, 6)
    bench.hear(CONFIRMED)
    assert bench.frames() == ["60C#2B40600006000000"]
    take_events(bench.out)
    return bench


def test_the_copy_of_an_answer_confirms_no_second_write_of_the_object() -> None:
    bench = wrote()
    second = write(bench, 7)
    assert bench.frames() == ["60C#4000100000000000"]
    bench.hear(CONFIRMED)  # the copy
    assert ignored(bench) == "response about another object"
    bench.hear(TYPE)
    assert bench.frames() == ["60C#2B40600007000000"]
    bench.hear(TYPE)
    assert ignored(bench) == "response about another object"
    bench.hear(REFUSED)
    (refused,) = take_events(bench.out)
    assert isinstance(refused, SdoAborted)
    assert (refused.request_id, refused.origin, refused.not_confirmed) == (second, AbortOrigin.PEER, False)
    assert bench.client.deadline == NEVER


@pytest.mark.parametrize("pause", [0, TIMEOUT - 1, TIMEOUT])
def test_after_the_time_out_the_server_has_nothing_more_to_say(pause: Time) -> None:
    bench = wrote()
    bench.now += pause
    write(bench, 7)
    assert bench.frames() == ["60C#2B40600007000000" if pause == TIMEOUT else "60C#4000100000000000"]


def test_no_question_where_the_answers_differ() -> None:
    bench = wrote()
    bench.client.upload(0x6040, 0, bench.now)
    assert bench.frames() == ["60C#4040600000000000"]
    bench.hear("4B 40 60 00 06 00 00 00")
    write(bench, 7)  # its object was read just before
    assert bench.frames() == ["60C#2B40600007000000"]
    bench.hear(CONFIRMED)
    bench.client.download(0x6041, 0, b"\0\0", bench.now)
    bench.hear("60 41 60 00")
    write(bench, 15)  # another one was written just before
    assert bench.frames() == ["60C#2B41600000000000", "60C#2B4060000F000000"]


def test_a_write_in_segments_needs_no_question_for_the_server_answers_each_of_them() -> None:
    bench = wrote()
    second = bench.client.download(0x6040, 0, b"12345", bench.now)
    bench.hear(CONFIRMED)  # the copy
    assert bench.frames() == ["60C#2140600005000000", "60C#0531323334350000"]
    bench.hear(CONFIRMED)
    assert ignored(bench) == "second copy of the last response"
    bench.hear("20 00 00 00 00 00 00 00")
    assert bench.outcome() == SdoDownloaded(12, second, 0x6040, 0)


def test_a_halt_waits_for_no_question() -> None:
    bench = wrote()
    halt = write(bench, 2, urgent=True)
    assert bench.frames() == ["60C#2B40600002000000"]
    bench.hear(CONFIRMED)
    assert bench.outcome() == SdoDownloaded(12, halt, 0x6040, 0)


def test_a_halt_comes_before_what_waits_for_a_question() -> None:
    bench = wrote()
    write(bench, 7)
    bench.frames()
    halt = write(bench, 2, urgent=True)
    bench.hear(TYPE)
    assert bench.frames() == ["60C#2B40600002000000"]
    bench.hear(CONFIRMED)
    assert bench.outcome() == SdoDownloaded(12, halt, 0x6040, 0)
    assert bench.frames() == ["60C#4000100000000000"]  # the first question was asked before the halt


def test_a_question_without_an_answer_has_no_outcome_and_holds_nothing_for_longer() -> None:
    bench = wrote()
    second = write(bench, 7)
    bench.client.handle_timeout(bench.client.deadline)
    assert bench.frames() == ["60C#4000100000000000", "60C#8000100000000405", "60C#2B40600007000000"]
    assert take_events(bench.out) == []
    bench.hear(CONFIRMED)
    assert bench.outcome() == SdoDownloaded(12, second, 0x6040, 0)


@pytest.mark.parametrize(
    ("answer", "behind"), [("80 00 10 00 22 00 00 08", []), ("41 00 10 00 04 00 00 00", ["60C#8000100000000008"])]
)
def test_any_answer_to_a_question_is_one(answer: str, behind: list[str]) -> None:
    bench = wrote()
    write(bench, 7)
    bench.frames()
    bench.hear(answer)
    assert bench.frames() == [*behind, "60C#2B40600007000000"]
    assert take_events(bench.out) == []


def test_a_device_that_refuses_every_question_is_asked_one() -> None:
    bench = Bench()
    bench.client.cancel(write(bench, 6), bench.now)
    write(bench, 7)
    bench.frames()
    bench.hear("80 00 10 00 22 00 00 08")
    assert bench.frames() == ["60C#2B40600007000000"]


def test_a_question_names_no_object_that_anything_else_may_speak_of() -> None:
    bench = Bench()
    for index, question in ((0x1000, "0110"), (0x1001, "0010"), (0x6040, "0010")):
        for _ in range(2):
            bench.client.download(index, 0, b"\0", bench.now)
            asked = bench.frames()[0]
            if not asked.startswith("60C#2F"):
                assert asked == f"60C#40{question}0000000000"
                bench.hear(f"4F {question} 00 00 00 00 00")
            bench.hear(f"60 {index & 0xFF:02X} {index >> 8:02X} 00 00 00 00 00")
            bench.frames()
    bench.client.upload(0x1000, 0, bench.now)
    bench.hear(TYPE)
    bench.client.cancel(write(bench, 6), bench.now)
    bench.frames()
    write(bench, 7)
    assert bench.frames() == ["60C#4001100000000000"]  # the answer about 0x1000 may come twice


def test_who_waits_for_a_question_may_be_cancelled_and_ends_with_the_server() -> None:
    bench = wrote()
    second = write(bench, 7)
    assert bench.client.cancel(second, bench.now)
    (cancelled,) = take_events(bench.out)
    assert isinstance(cancelled, SdoAborted)
    assert (cancelled.request_id, cancelled.not_confirmed) == (second, False)  # it has not been sent
    third = write(bench, 7)
    bench.client.abort_all(AbortCode.NO_SDO_CONNECTION, bench.now)
    (gone,) = take_events(bench.out)
    assert isinstance(gone, SdoAborted)
    assert (gone.request_id, gone.not_confirmed) == (third, False)
    assert bench.client.deadline == NEVER
    assert not bench.client.busy


def test_a_read_that_is_refused_right_behind_a_write_is_made_again() -> None:
    """The refusal may be that of the write, whose request came twice."""
    bench = wrote()
    read = bench.client.upload(0x6040, 0, bench.now)
    bench.hear(REFUSED)
    assert bench.frames() == ["60C#4040600000000000", "60C#4000100000000000"]
    assert take_events(bench.out) == []
    bench.hear(TYPE)
    assert bench.frames() == ["60C#4040600000000000"]
    bench.hear("4B 40 60 00 06 00 00 00")
    assert bench.outcome() == SdoUploaded(12, read, 0x6040, 0, b"\x06\0")


def test_a_second_refusal_is_one() -> None:
    bench = wrote()
    bench.client.upload(0x6040, 0, bench.now)
    bench.hear(REFUSED, TYPE, REFUSED)
    assert bench.aborted() == (AbortCode.DEVICE_STATE, AbortOrigin.PEER)
