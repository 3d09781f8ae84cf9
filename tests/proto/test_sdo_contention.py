"""Several clients on one SDO channel (contention.py): never wrong bytes as success, never "confirmed" for what is not there.

The bus is a CAN without losses: one order of frames, queues of any length at each end. The oracle is the server's own history:
what an object held while a read of it was open, what was written to it while a write was.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, SECOND, Event, Machine, Outbox, Outcome, RequestId, Time
from canopen_proto.sdo.client import (
    CONTEST_LIMIT,
    LATE_GUARD,
    TIMEOUT,
    Block,
    SdoAborted,
    SdoChunk,
    SdoClient,
    SdoDownloaded,
    SdoStreamUploaded,
    SdoUploaded,
)
from canopen_proto.sdo.codec import INITIATE, LEAST_REQUEST, complete, what_was_asked
from canopen_proto.sdo.contention import SPREAD
from canopen_proto.sdo.server import SdoServer
from tests.examples import examples
from tests.proto.bus import Wire, take_events
from tests.proto.test_sdo_client import Bench

NODE = 5
SIZES = {0x2000: 1, 0x2001: 4, 0x2002: 8, 0x2003: 8, 0x2004: 40, 0x2005: 300}
"""The objects and their bytes: expedited, two segments, and more than a sub-block of the smallest size."""


class History:
    """A store that remembers what each object held, and since when."""

    def __init__(self) -> None:
        self.held: dict[int, list[tuple[Time, bytes]]] = {index: [(0, bytes(size))] for index, size in SIZES.items()}

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode:
        return self.held[index][-1][1] if index in self.held else AbortCode.NO_SUCH_OBJECT

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | None:
        return None if index in self.held else AbortCode.NO_SUCH_OBJECT

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | None:
        if index in self.held:
            self.held[index].append((now, bytes(data)))
            return None
        return AbortCode.NO_SUCH_OBJECT

    def between(self, index: int, start: Time, end: Time) -> set[bytes]:
        """All values that the object had from start to end."""
        entries = self.held[index]
        ends = [time for time, _ in entries[1:]] + [NEVER]
        return {value for (since, value), until in zip(entries, ends, strict=True) if since <= end and until >= start}

    def was_written(self, index: int, data: bytes, start: Time, end: Time) -> bool:
        return any(start <= time <= end and value == data for time, value in self.held[index][1:])


class Firmware(SdoServer):
    """A server as much firmware has it: during a segmented transfer it hears no initiate request, of whomever.

    is_loud: it answers these with an abort, 0x05040001, that names them.
    """

    is_loud = False

    def receive(self, frame: Frame, now: Time) -> None:
        data = complete(frame.data, LEAST_REQUEST)
        if data is not None and self.busy and data[0] >> 5 in (1, 2) and not (self._transfer and self._transfer.in_blocks):
            if self.is_loud:
                self.send(INITIATE.pack(0x80, data[1] | data[2] << 8, data[3], AbortCode.INVALID_COMMAND))
            return
        super().receive(frame, now)


class LoudFirmware(Firmware):
    is_loud = True


SERVERS: dict[str, type[SdoServer]] = {"restarts": SdoServer, "is deaf in a transfer": Firmware, "aborts intruders": LoudFirmware}


class Script(Machine):
    """A stranger that follows no rule: it sends what it was told, when it was told, and listens to nobody."""

    def __init__(self, out: Outbox, frames: list[tuple[Time, bytes]]) -> None:
        super().__init__(out)
        self._frames = sorted(frames, key=lambda each: each[0])
        self.deadline = self._frames[0][0] if self._frames else NEVER

    def handle_timeout(self, now: Time) -> None:
        while self._frames and self._frames[0][0] <= now:
            self.out.frames.append(Frame(0x600 + NODE, self._frames.pop(0)[1]))
        self.deadline = self._frames[0][0] if self._frames else NEVER


@dataclass(frozen=True)
class Asked:
    """One request of one of our clients."""

    client: int
    at: Time
    index: int
    is_write: bool
    block: Block
    urgent: bool
    stream: bool = False


def content(index: int, salt: int) -> bytes:
    """What request number `salt` writes: different bytes each time."""
    return bytes((salt * 17 + place * 31 + index) & 0xFF for place in range(SIZES[index]))


def run(seed: int, slowest: Time, kind: str, asked: list[Asked], script: list[tuple[Time, bytes]]) -> list[str]:
    """Let them all go, and return what is wrong."""
    bus, history = Wire(seed, delay=(0, slowest)), History()
    bus.attach(SERVERS[kind](Outbox(), NODE, history))
    clients = [bus.attach(SdoClient(Outbox(), NODE)) for _ in range(1 + max(each.client for each in asked))]
    bus.attach(Script(Outbox(), script))
    for number, client in enumerate(clients):
        client.out.root.request_id = number * 1000  # so that an outcome tells whose it is
    opened: dict[RequestId, tuple[Asked, Time, int]] = {}
    ends: Counter[RequestId] = Counter()
    wrong: list[str] = []
    pieces: dict[RequestId, bytes] = {}

    def judge(event: Event) -> None:
        if isinstance(event, SdoChunk):
            pieces[event.request_id] = pieces.get(event.request_id, b"") + event.data
            clients[event.request_id // 1000].proceed(event.request_id, bus.now)
        if not isinstance(event, Outcome):
            return
        request, since, salt = opened[event.request_id]
        ends[event.request_id] += 1
        if isinstance(event, SdoUploaded | SdoStreamUploaded):
            data = event.data if isinstance(event, SdoUploaded) else pieces.get(event.request_id, b"")
            if data not in history.between(request.index, since, bus.now):
                wrong.append(f"read {data.hex()} as success: {request}")
        elif isinstance(event, SdoDownloaded):
            if not history.was_written(request.index, content(request.index, salt), since, bus.now):
                wrong.append(f"confirmed what was not written: {request}")
        elif isinstance(event, SdoAborted):
            if event.origin is AbortOrigin.PEER:
                wrong.append(f"refused, though the server has it and takes it: {event}, {request}")
            is_there = request.is_write and history.was_written(request.index, content(request.index, salt), since, bus.now)
            if is_there and not event.not_confirmed:
                wrong.append(f"not a word that it may have been written: {event}, {request}")
            if event.origin is AbortOrigin.CONTESTED and not event.others_doing:
                wrong.append(f"nobody is named: {event}")

    bus.on_event = judge
    for salt, each in enumerate(sorted(asked, key=lambda each: each.at)):
        bus.run(each.at - bus.now)
        client, data = clients[each.client], content(each.index, salt)
        if each.is_write:
            request_id = client.download(each.index, 0, data, bus.now, urgent=each.urgent, block=each.block)
        elif each.stream:
            request_id = client.upload_stream(each.index, 0, bus.now, urgent=each.urgent)
        else:
            request_id = client.upload(each.index, 0, bus.now, urgent=each.urgent, block=each.block)
        opened[request_id] = each, bus.now, salt
    bus.settle(120 * SECOND)
    wrong += [f"{ends[request_id]} outcomes: {each}" for request_id, (each, _, _) in opened.items() if ends[request_id] != 1]
    return wrong


TIMES = st.one_of(st.integers(0, 3 * MILLISECOND), st.integers(0, 800 * MILLISECOND))
BLOCKS: st.SearchStrategy[Block] = st.sampled_from([False, False, True, "auto"])


@st.composite
def askings(draw: st.DrawFn) -> list[Asked]:
    count = draw(st.integers(1, 3))
    asked = []
    for _ in range(draw(st.integers(1, 5))):
        is_write = draw(st.booleans())
        stream = not is_write and draw(st.integers(0, 5)) == 0
        index = draw(st.sampled_from(list(SIZES)))
        urgent = draw(st.integers(0, 3)) == 0
        asked.append(Asked(draw(st.integers(0, count - 1)), draw(TIMES), index, is_write, draw(BLOCKS), urgent, stream))
    return asked


@st.composite
def scripted(draw: st.DrawFn) -> list[tuple[Time, bytes]]:
    """Frames of a stranger: whole exchanges without regard to the answers, or anything at all."""
    frames: list[tuple[Time, bytes]] = []
    for _ in range(draw(st.integers(0, 3))):
        at, index = draw(TIMES), draw(st.sampled_from(list(SIZES)))
        gap = draw(st.sampled_from([50 * MICROSECOND, 400 * MICROSECOND, 5 * MILLISECOND, 150 * MILLISECOND]))
        name = bytes((index & 0xFF, index >> 8, 0))
        fill = draw(st.binary(min_size=7, max_size=7))
        kind = draw(st.integers(0, 6))
        if kind == 0:
            whole = [b"\x40" + name + bytes(4), b"\x60" + bytes(7), b"\x70" + bytes(7)]
        elif kind == 1:
            whole = [b"\x21" + name + SIZES[index].to_bytes(4, "little"), b"\x00" + fill, b"\x1d" + fill]
        elif kind == 2:
            whole = [b"\x23" + name + fill[:4]]
        elif kind == 3:
            whole = [b"\xa4" + name + b"\x02\0\0\0", b"\xa3" + bytes(7), b"\xa2\x02\x02" + bytes(5), b"\xa1" + bytes(7)]
        elif kind == 4:
            whole = [b"\xc6" + name + SIZES[index].to_bytes(4, "little"), b"\x01" + fill, b"\x82" + fill, b"\xc1" + fill]
        elif kind == 5:
            whole = [b"\x80" + name + b"\0\0\x04\x05"]
        else:
            whole = draw(st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=4))
        keep = draw(st.integers(1, len(whole)))
        frames += [(at + number * gap, data) for number, data in enumerate(whole[:keep])]
    return frames


@pytest.mark.parametrize("kind", SERVERS)
def test_whoever_else_speaks_no_wrong_bytes_and_no_false_word(kind: str) -> None:
    @examples(400, least=60)
    @given(
        seed=st.integers(0, 2**32),
        slowest=st.sampled_from([0, 60 * MICROSECOND, 1 * MILLISECOND, 8 * MILLISECOND]),
        asked=askings(),
        script=scripted(),
    )
    def check(seed: int, slowest: Time, asked: list[Asked], script: list[tuple[Time, bytes]]) -> None:
        assert run(seed, slowest, kind, asked, script) == []

    check()


# ---- single cases: what is sent when, and what is said ----


class Shared(Bench):
    """A client of node 12 that hears a stranger's requests too."""

    def other(self, *requests: str) -> None:
        for request in requests:
            self.now += MILLISECOND
            self.client.receive(Frame(0x60C, bytes.fromhex(request)), self.now)

    def wait(self, duration: Time) -> None:
        self.now += duration
        self.client.handle_timeout(self.now)

    def outcomes(self) -> list[Event]:
        return [event for event in take_events(self.out) if isinstance(event, Outcome)]


READ, FOREIGN_READ = "60C#4008100000000000", "40 01 10 00 00 00 00 00"


def test_a_request_waits_until_the_strangers_exchange_is_over() -> None:
    bench = Shared()
    bench.other(FOREIGN_READ)
    bench.client.upload(0x1008, 0, bench.now)
    assert bench.frames() == []
    bench.hear("4F 01 10 00 05 00 00 00")
    assert bench.frames() == [READ]


def test_a_request_waits_through_the_segments_of_a_stranger() -> None:
    bench = Shared()
    bench.other("40 08 10 00 00 00 00 00")
    bench.hear("41 08 10 00 08 00 00 00")
    bench.client.upload(0x1008, 0, bench.now)
    bench.other("60 00 00 00 00 00 00 00")
    bench.hear("00 31 32 33 34 35 36 37")
    bench.other("70 00 00 00 00 00 00 00")
    assert bench.frames() == []
    bench.hear("1D 38 00 00 00 00 00 00")
    assert bench.frames() == [READ]


@pytest.mark.parametrize(("requests", "quiet"), [(["40 08 10 00 00 00 00 00"], TIMEOUT), (["C6 50 1F 01 00 10 00 00"], SECOND)])
def test_a_stranger_that_falls_silent_is_waited_for_no_longer_than_that(requests: list[str], quiet: Time) -> None:
    bench = Shared()
    bench.other(*requests)
    bench.client.upload(0x1008, 0, bench.now)
    bench.wait(quiet - 1)
    assert bench.frames() == []
    bench.wait(1)
    assert bench.frames() == [READ]


def test_a_stranger_that_never_ends_is_named_after_the_limit() -> None:
    bench = Shared()
    bench.other("C6 50 1F 01 00 00 10 00")
    requests = [bench.client.upload(0x1008, 0, bench.now), bench.client.download(0x1017, 0, b"\0\0", bench.now)]
    begun = bench.now
    while bench.client.busy:
        bench.other("01 00 00 00 00 00 00 00")
        bench.wait(100 * MILLISECOND)
    assert bench.now <= begun + CONTEST_LIMIT + 200 * MILLISECOND
    first, second = bench.outcomes()
    assert isinstance(first, SdoAborted)
    assert isinstance(second, SdoAborted)
    assert [first.request_id, second.request_id] == requests
    assert first.origin is second.origin is AbortOrigin.CONTESTED
    assert not second.not_confirmed  # it was never sent
    assert bench.frames() == []


def test_an_urgent_request_does_not_wait() -> None:
    bench = Shared()
    bench.other("C6 50 1F 01 00 00 10 00", "01 00 00 00 00 00 00 00")
    request = bench.client.download(0x6040, 0, b"\x07\x01", bench.now, urgent=True)
    assert bench.frames() == ["60C#2B40600007010000"]
    bench.hear("60 40 60 00 00 00 00 00")  # or a frame that looks like it
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.request_id, end.origin, end.not_confirmed) == (request, AbortOrigin.CONTESTED, True)


def test_an_expedited_answer_names_its_object_so_another_read_does_no_harm() -> None:
    bench = Shared()
    request = bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other(FOREIGN_READ)
    bench.hear("4F 01 10 00 05 00 00 00", "60 40 60 00 00 00 00 00")
    assert bench.outcomes() == [SdoDownloaded(12, request, 0x6040, 0)]


@pytest.mark.parametrize("foreign", ["2B 40 60 00 06 00 00 00", "40 40 60 00 00 00 00 00", "80 40 60 00 00 00 04 05"])
def test_a_write_is_not_confirmed_if_the_answer_may_be_the_strangers(foreign: str) -> None:
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other(foreign)
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)
    assert "0x6040:00" in end.others_doing
    bench.hear("60 40 60 00 00 00 00 00")
    assert bench.outcomes() == []


def test_a_read_in_segments_is_made_again_once_the_stranger_is_done() -> None:
    bench = Shared()
    request = bench.client.upload(0x1008, 0, bench.now)
    bench.hear("41 08 10 00 08 00 00 00")
    bench.frames()
    bench.other(FOREIGN_READ)
    assert bench.frames() == []
    bench.hear("4F 01 10 00 05 00 00 00")
    assert bench.frames() == ["60C#8008100000000008", READ]  # some servers stay in the transfer that was left
    bench.hear("41 08 10 00 08 00 00 00", "00 31 32 33 34 35 36 37", "1D 38 00 00 00 00 00 00")
    assert bench.outcomes() == [SdoUploaded(12, request, 0x1008, 0, b"12345678")]


def test_the_servers_abort_because_of_a_stranger_is_no_refusal() -> None:
    bench = Shared()
    request = bench.client.upload(0x1008, 0, bench.now)
    bench.other(FOREIGN_READ)
    bench.hear("80 08 10 00 01 00 04 05")
    assert bench.frames() == [READ]
    assert bench.outcomes() == []
    bench.wait(TIMEOUT + SPREAD)
    assert bench.frames() == ["60C#8008100000000008", READ]
    bench.hear("80 08 10 00 00 00 02 06")
    (end,) = bench.outcomes()
    assert end == SdoAborted(12, request, 0x1008, 0, AbortCode.NO_SUCH_OBJECT, AbortOrigin.PEER)


def test_a_write_in_segments_is_broken_off_at_once_before_both_mix() -> None:
    bench = Shared()
    bench.client.download(0x2000, 0, bytes(20), bench.now)
    bench.hear("60 00 20 00 00 00 00 00")
    bench.frames()
    bench.other("00 01 02 03 04 05 06 07")
    assert bench.frames() == ["60C#8000200000000008"]
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert end.not_confirmed
    assert end.others_doing == "sent a segment of a write"


@pytest.mark.parametrize(
    ("request_data", "words"),
    [
        ("2F 60 60 00 01 00 00 00", "wrote 0x6060:00"),
        ("21 60 60 00 01 00 00 00", "began to write 0x6060:00"),
        (FOREIGN_READ, "asked for 0x1001:00"),
        ("70 00 00 00 00 00 00 00", "asked for a segment of a read"),
        ("80 01 10 00 00 00 04 05", "aborted the transfer of 0x1001:00 with 0x05040000"),
        ("A4 01 10 00 7F 00 00 00", "began a block read of 0x1001:00"),
        ("C6 50 1F 01 00 10 00 00", "began a block write of 0x1F50:01"),
        ("A2 7F 7F 00 00 00 00 00", "sent a frame of a block transfer (command 0xA2)"),
    ],
)
def test_what_the_stranger_did_is_said_in_words(request_data: str, words: str) -> None:
    assert what_was_asked(bytes.fromhex(request_data)) == words


def test_an_urgent_write_is_not_confirmed_by_the_late_answer_to_the_write_before() -> None:
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other("A4 01 10 00 02 00 00 00")
    bench.hear("C6 01 10 00 04 00 00 00")
    bench.other("80 01 10 00 00 00 04 05")
    bench.wait(SPREAD)
    bench.outcomes()
    bench.client.download(0x6040, 0, b"\x07\0", bench.now, urgent=True)
    bench.hear("60 40 60 00 00 00 00 00")
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)


def test_nor_by_the_late_answer_to_a_write_that_timed_out_though_the_strangers_exchange_is_over() -> None:
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.wait(TIMEOUT)
    bench.other(FOREIGN_READ)
    bench.hear("4F 01 10 00 05 00 00 00")
    bench.outcomes()
    bench.client.download(0x6040, 0, b"\x07\0", bench.now, urgent=True)
    bench.hear("60 40 60 00 00 00 00 00")
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)


def test_an_acknowledgement_of_the_segment_before_is_not_the_last_one() -> None:
    bench = Shared()
    bench.other("21 00 20 00 08 00 00 00", "00 01 02 03 04 05 06 07", "1D 08 00 00 00 00 00 00")
    bench.hear("60 00 20 00 00 00 00 00", "20 00 00 00 00 00 00 00")
    bench.client.upload(0x1008, 0, bench.now)
    assert bench.frames() == []
    bench.hear("30 00 00 00 00 00 00 00")
    assert bench.frames() == [READ]


def test_a_read_does_not_go_on_in_segments_that_may_be_another_clients() -> None:
    bench = Shared()
    bench.client.upload(0x1008, 0, bench.now)
    bench.other("40 09 10 00 00 00 00 00")
    bench.hear("41 08 10 00 08 00 00 00", "41 09 10 00 08 00 00 00")
    assert bench.frames() == [READ]
    bench.wait(TIMEOUT + SPREAD)
    assert bench.frames() == ["60C#8008100000000008", READ]


def test_two_answers_about_one_object_are_both_waited_for() -> None:
    """Ours was ended by a stranger's abort; then it writes the same object. The first answer must not free the way."""
    bench = Shared()
    bench.client.download(0x6040, 0, b"\x0f\0", bench.now)
    bench.other("80 01 10 00 00 00 04 05", "2B 40 60 00 06 00 00 00")
    bench.outcomes()
    bench.frames()
    bench.client.download(0x6040, 0, b"\x07\0", bench.now)
    bench.hear("60 40 60 00 00 00 00 00")
    assert bench.frames() == []
    bench.hear("60 40 60 00 00 00 00 00")
    assert bench.outcomes() == []
    bench.wait(TIMEOUT + SPREAD)
    assert bench.frames() == ["60C#2B40600007000000"]


def test_a_client_that_asks_without_a_pause_does_not_keep_us_out() -> None:
    """Both have asked for one object; after that each answer of the other's is followed by its next request."""
    bench = Shared()
    bench.client.upload(0x1000, 0, bench.now)
    bench.other("40 00 10 00 00 00 00 00")
    bench.frames()
    bench.hear("43 00 10 00 92 01 02 00", "43 00 10 00 92 01 02 00")
    bench.other(FOREIGN_READ)
    bench.hear("4F 01 10 00 05 00 00 00")
    assert bench.frames() == ["60C#8000100000000008", "60C#4000100000000000"]


@pytest.mark.parametrize("urgent", [False, True])
@examples(100, least=20)
@given(data=st.data())
def test_what_was_lost_is_no_reason_to_doubt_for_ever(urgent: bool, data: st.DataObject) -> None:
    """Whatever a stranger once did and whatever was lost: a write that is alone again, and is answered, is confirmed."""
    bench = Shared()
    name = "40 60 00"
    frames = ["40 08 10 00", "40 40 60 00", "2B 40 60 00", "21 40 60 00", "80 40 60 00", "60 00 00 00", "C6 40 60 00"]
    pauses = st.sampled_from([0, SPREAD, TIMEOUT, SECOND, 3600 * SECOND])
    bench.other(data.draw(st.sampled_from(frames)) + " 00 00 00 00")
    for step in data.draw(st.lists(st.sampled_from(["stranger", "write", "answer", "refusal"]), max_size=6)):
        bench.wait(data.draw(pauses))
        if step == "stranger":
            bench.other(data.draw(st.sampled_from(frames)) + " 00 00 00 00")
        elif step == "write":
            bench.client.download(0x6040, 0, b"\x0f\0", bench.now, urgent=data.draw(st.booleans()))
        else:
            bench.hear(f"{'60' if step == 'answer' else '80'} {name} 00 00 04 05")
    while bench.client.busy:  # nobody answers any more
        bench.wait(max(0, bench.client.deadline - bench.now))
    bench.wait(max(CONTEST_LIMIT, LATE_GUARD + SPREAD))
    bench.outcomes()
    bench.frames()
    for _ in range(2):
        bench.client.download(0x6040, 0, b"\x02\0", bench.now, urgent=urgent)
        assert bench.frames() == ["60C#2B40600002000000"]
        bench.hear(f"60 {name} 00 00 00 00")
        (end,) = bench.outcomes()
        assert isinstance(end, SdoDownloaded)
        bench.wait(SPREAD)


@pytest.mark.parametrize(("size", "block", "answer"), [(100, True, "A4"), (100, False, "60"), (0, False, "60")])
def test_a_contested_write_of_more_than_one_frame_leaves_no_server_in_it(size: int, block: bool, answer: str) -> None:
    """It went out beside a stranger's request, so that its answer is in doubt: the server may have begun it."""
    bench = Shared()
    bench.other(FOREIGN_READ)
    bench.client.download(0x1F50, 1, bytes(size), bench.now, urgent=True, block=block)
    bench.frames()
    bench.hear(f"{answer} 50 1F 01 7F 00 00 00")
    assert bench.frames() == ["60C#80501F0100000008"]
    (end,) = bench.outcomes()
    assert isinstance(end, SdoAborted)
    assert (end.origin, end.not_confirmed) == (AbortOrigin.CONTESTED, True)
