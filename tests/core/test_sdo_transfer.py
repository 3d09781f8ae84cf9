"""Client against server over a bus with faults: every transfer ends once, with the right bytes or an abort.

The premises, which the client's text names: answers come within `timeout`, and where the same object is read twice in a row,
copies come within `copy_guard`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, FrameIgnored, Outbox, Outcome, Time
from canopen_proto.sdo.client import SdoAborted, SdoClient, SdoDownloaded, SdoUploaded
from canopen_proto.sdo.server import PENDING, ObjectAccessPending, Pending, SdoServer
from tests.core.bus import CAN_FATES, Bus, Fate
from tests.core.machines import held_data
from tests.examples import examples

MAX_DELAY = 5 * MILLISECOND
AT_FIRST = {0x2000: bytes(range(20)), 0x2001: b"\x37\x02", 0x2002: b"hello world"}
INDICES = tuple(AT_FIRST)
BY_HOST = 0x2002  # served late, by the host


class HistoryStore:
    """Objects of any length that remember what they held, and since when."""

    def __init__(self) -> None:
        self.history: dict[int, list[tuple[Time, bytes]]] = {index: [(0, content)] for index, content in AT_FIRST.items()}
        self.writes: list[tuple[Time, int, bytes]] = []

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        if index not in self.history:
            return bytes(4)  # 0x1000: the client's questions
        return PENDING if index == BY_HOST else self.held(index)

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | None:
        return None

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        if index == BY_HOST:
            return PENDING
        self.put(index, data, now)
        self.writes.append((now, index, data))
        return None

    def held(self, index: int) -> bytes:
        return self.history[index][-1][1]

    def put(self, index: int, data: bytes, now: Time) -> None:
        self.history[index].append((now, data))

    def held_between(self, index: int, start: Time, end: Time) -> set[bytes]:
        """All values that the object had at some time from start to end."""
        entries = self.history[index]
        ends = [time for time, _ in entries[1:]] + [NEVER]
        return {value for (since, value), until in zip(entries, ends, strict=True) if since <= end and until >= start}


@dataclass
class Job:
    """A request, as its caller sees it."""

    index: int
    content: bytes | None
    asked: Time
    outcomes: list[tuple[Time, Outcome]] = field(default_factory=list)


class Pair:
    """A client and a server on a bus, with somebody who writes down everything."""

    def __init__(self, bus: Bus, copy_guard: Time) -> None:
        self.bus = bus
        self.store = HistoryStore()
        self.client = bus.attach(SdoClient(Outbox(), 12, copy_guard=copy_guard, max_upload=500))
        self.server = bus.attach(SdoServer(Outbox(), 12, self.store, max_download=500))
        self.jobs: dict[int, Job] = {}
        self.finished: list[Outcome] = []
        bus.on_event = self.on_event

    def request(self, index: int, content: bytes | None) -> int:
        if content is None:
            request_id = self.client.upload(index, 0, self.bus.now)
        else:
            request_id = self.client.download(index, 0, content, self.bus.now)
        self.jobs[request_id] = Job(index, content, self.bus.now)
        return request_id

    def on_event(self, report: Event) -> None:
        for transfer, limit in (
            (self.client._transfer, self.client.max_upload),
            (self.server._transfer, self.server.max_download),
        ):
            assert held_data(transfer) <= limit + 7
        if isinstance(report, Outcome):
            self.jobs[report.request_id].outcomes.append((self.bus.now, report))
            self.finished.append(report)
        elif isinstance(report, ObjectAccessPending):
            if report.data is None:
                self.server.complete(report.access_id, self.store.held(report.index), self.bus.now)
            elif self.server.complete(report.access_id, None, self.bus.now):
                self.store.put(report.index, report.data, self.bus.now)
                self.store.writes.append((self.bus.now, report.index, report.data))

    def check_ended(self) -> None:
        """Each request has one outcome, and nothing is left over."""
        assert all(len(job.outcomes) == 1 for job in self.jobs.values())
        assert not self.client.busy
        assert not self.server.busy
        assert self.client.deadline == self.server.deadline == NEVER
        assert self.client._transfer is None
        assert self.server._transfer is None

    def check_bytes(self) -> None:
        """What was reported as read was there, what was reported as written was written, and nothing else was."""
        for job in self.jobs.values():
            ((ended, outcome),) = job.outcomes
            if isinstance(outcome, SdoUploaded):
                assert outcome.data in self.store.held_between(job.index, job.asked, ended)
            elif isinstance(outcome, SdoDownloaded):
                written = [data for time, index, data in self.store.writes if index == job.index and job.asked <= time <= ended]
                assert job.content in written
        for time, index, data in self.store.writes:
            assert any(job.index == index and job.content == data and job.asked <= time for job in self.jobs.values())


CONTENTS = st.binary(max_size=40)
REQUESTS = st.tuples(st.sampled_from(INDICES), st.one_of(st.none(), CONTENTS))
POKES = st.tuples(st.just("poke"), st.sampled_from(INDICES), CONTENTS)
WAITS = st.tuples(st.just("wait"), st.integers(0, 40 * MILLISECOND))
CANCEL = st.just(("cancel",))
Step = tuple[object, ...]


def play(pair: Pair, steps: list[Step]) -> None:
    """Requests queue up as they come; the device changes its own values; time passes."""
    last = 0
    for step in steps:
        match step:
            case ("poke", int(index), bytes(content)):
                pair.store.put(index, content, pair.bus.now)
            case ("wait", int(duration)):
                pair.bus.run(duration)
            case ("cancel",):
                pair.client.cancel(last, pair.bus.now)
            case (int(index), bytes() | None as content):
                last = pair.request(index, content)
    pair.bus.settle()


@examples(300)
@given(
    steps=st.lists(st.one_of(REQUESTS, REQUESTS, POKES, WAITS, CANCEL), max_size=12),
    fates=st.lists(st.sampled_from(CAN_FATES), max_size=60),
    seed=st.integers(0, 1000),
)
def test_under_the_faults_of_can_bytes_are_right_or_there_is_an_abort(steps: list[Step], fates: list[Fate], seed: int) -> None:
    bus = Bus(seed, delay=(0, MAX_DELAY), fates=fates)
    pair = Pair(bus, copy_guard=2 * MAX_DELAY + 1)
    play(pair, steps)
    pair.check_ended()
    pair.check_bytes()


@examples(200)
@given(
    requests=st.lists(REQUESTS, max_size=12),
    fates=st.lists(st.sampled_from(CAN_FATES), max_size=80),
    seed=st.integers(0, 1000),
)
def test_without_the_guard_too_if_no_object_is_read_twice_in_a_row(
    requests: list[tuple[int, bytes | None]], fates: list[Fate], seed: int
) -> None:
    pair = Pair(Bus(seed, delay=(0, MAX_DELAY), fates=fates), copy_guard=0)
    last_read: int | None = None
    for index, content in requests:
        if content is not None or index != last_read:
            pair.request(index, content)
        last_read = index if content is None else None
    pair.bus.settle()
    pair.check_ended()
    pair.check_bytes()


@examples(100)
@given(steps=st.lists(st.one_of(REQUESTS, POKES, WAITS), max_size=12), seed=st.integers(0, 1000))
def test_copies_alone_cost_no_transfer(steps: list[Step], seed: int) -> None:
    pair = Pair(Bus(seed, delay=(0, MAX_DELAY), copies=0.3), copy_guard=2 * MAX_DELAY + 1)
    play(pair, steps)
    pair.check_ended()
    pair.check_bytes()
    # A value that changes between the two copies of an initiate request may cost one, by its size
    changed = any(step[0] == "poke" for step in steps)
    assert changed or not any(isinstance(end, SdoAborted) for end in pair.finished)


@examples(100)
@given(
    steps=st.lists(st.one_of(REQUESTS, POKES, WAITS, CANCEL), max_size=12),
    fates=st.lists(st.sampled_from(list(Fate)), max_size=60),
    seed=st.integers(0, 1000),
)
def test_whatever_the_bus_does_each_transfer_ends_and_nothing_is_left(steps: list[Step], fates: list[Fate], seed: int) -> None:
    pair = Pair(Bus(seed, delay=(0, MAX_DELAY), fates=fates, late=(0, 2 * SECOND)), copy_guard=0)
    play(pair, steps)
    pair.check_ended()


@pytest.mark.parametrize("rate", [0.02, 0.2])
def test_long_runs_on_a_bad_bus(rate: float) -> None:
    pair = Pair(Bus(7, delay=(0, MAX_DELAY), loss=rate, copies=rate, late_copies=rate, reordering=rate), copy_guard=0)
    for round_ in range(150):
        pair.request(INDICES[round_ % 3], None if round_ % 2 else bytes(round_))
    pair.bus.settle()
    pair.check_ended()


@given(st.binary(max_size=200), st.sampled_from(INDICES))
def test_on_a_good_bus_what_is_written_is_read(content: bytes, index: int) -> None:
    pair = Pair(Bus(), copy_guard=0)
    pair.request(index, content)
    pair.request(index, None)
    pair.bus.settle()
    pair.check_bytes()
    written, read = pair.finished
    assert isinstance(written, SdoDownloaded)
    assert isinstance(read, SdoUploaded)
    assert read.data == content
    assert not pair.bus.take_events(FrameIgnored)


def test_64_kib_both_ways() -> None:
    content = bytes(range(256)) * 256
    pair = Pair(Bus(), copy_guard=0)
    pair.client.max_upload = pair.server.max_download = len(content)
    pair.request(0x2000, content)
    pair.request(0x2000, None)
    pair.bus.settle()
    assert [type(end) for end in pair.finished] == [SdoDownloaded, SdoUploaded]
    assert pair.store.held(0x2000) == content
    assert len(pair.bus.sent) == 4 + 4 * -(-len(content) // 7)


def read_twice(copy_guard: Time) -> list[bytes]:
    """What is read, if the answer to the first read comes twice, and the value changes before the second one."""
    pair = Pair(Bus(fates=[Fate.DELIVERED, Fate.COPIED]), copy_guard)
    pair.bus.on_event = lambda report: (
        pair.on_event(report),
        pair.store.put(0x2000, b"new", pair.bus.now) if isinstance(report, SdoUploaded) else None,
    )
    pair.store.put(0x2000, b"old", 0)
    pair.request(0x2000, None)
    pair.request(0x2000, None)
    pair.bus.settle()
    return [end.data for end in pair.finished if isinstance(end, SdoUploaded)]


def test_what_the_guard_is_for() -> None:
    """Two reads of one object in a row: the limit that docs/limits.md tells of."""
    assert read_twice(copy_guard=MILLISECOND) == [b"old", b"new"]
    assert read_twice(copy_guard=0) == [b"old", b"old"]  # nothing in these frames tells that it is the first answer


@pytest.mark.parametrize("kind", [Fate.LOST, Fate.COPIED])
@pytest.mark.parametrize("content", [b"\x01", bytes(range(1, 31)), b""], ids=["expedited", "segmented", "empty"])
@pytest.mark.parametrize("make", [lambda content: None, lambda content: content], ids=["upload", "download"])
def test_each_single_fault_in_each_frame(kind: Fate, content: bytes, make: Callable[[bytes], bytes | None]) -> None:
    """One fault, in the first, the second ... frame: a loss costs at most this transfer, a copy none."""
    for position in range(14):
        pair = Pair(Bus(fates=[Fate.DELIVERED] * position + [kind]), copy_guard=MILLISECOND)
        pair.store.put(0x2000, content, 0)
        pair.request(0x2000, make(content))
        pair.request(0x2000, None)
        pair.bus.settle()
        pair.check_ended()
        pair.check_bytes()
        assert sum(isinstance(end, SdoAborted) for end in pair.finished) <= (1 if kind is Fate.LOST else 0)
