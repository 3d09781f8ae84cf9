"""`LiveSource`: a bus, a file and standard input read alike. In virtual time; only the thread that reads a pipe is real."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Awaitable, Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st
from trio.testing import MockClock

from canopen_cli.live.source import AHEAD, BATCH, INPUT, Heard, LiveSource, open_live_source
from canopen_cli.shared.options import Settings
from canopen_cli.shared.problem import CommandError
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_transports import BusState, BusStateChanged, open_transport
from canopen_transports.errors import ReceiveOverrun
from canopen_transports.log_files import LogFileError
from canopen_transports.record import Record
from canopen_transports.stamp_clock import StampClock
from tests.examples import examples

T = TypeVar("T")
LINES = [f"({number}.000000) can0 705#{number % 128:02X}" for number in range(1000)]


def in_virtual_time(body: Callable[[], Awaitable[T]]) -> T:
    return trio.run(body, clock=MockClock(autojump_threshold=0))


async def everything(source: Path | None, **settings: str) -> list[Heard]:
    async with open_live_source(Settings(**settings), source) as live:  # type: ignore[arg-type]
        return [heard async for heard in live]


def texts(heard: list[Heard]) -> list[str]:
    return [str(each.frame) for each in heard if isinstance(each, Record)]


def test_a_file_is_read_to_its_end(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text("\n".join([*LINES, "(2000.0) can0 123##1AA"]))

    async def body() -> None:
        async with open_live_source(Settings(), path) as live:
            first = await live.take()
            assert len(first) == BATCH
            assert live.now() == (BATCH - 1) * SECOND
            rest = [heard async for heard in live]
            assert texts([*first, *rest]) == [line.split()[2] for line in LINES]
            assert (live.now(), live.skipped, live.last_skip) == (999 * SECOND, 1, "a CAN FD frame")
            assert (live.is_live, live.name) == (False, str(path))
            assert await live.take() == []

    in_virtual_time(body)


def test_all_of_a_damaged_file_that_can_be_read_comes_before_the_error(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text("\n".join([*LINES[:300], "what is this"]))

    async def body() -> None:
        async with open_live_source(Settings(), path) as live:
            assert texts(await live.take() + await live.take()) == [line.split()[2] for line in LINES[:300]]
            with pytest.raises(LogFileError, match="a.log:301"):
                await live.take()

    in_virtual_time(body)


@pytest.mark.parametrize("bus", ["", "virtual:x"])
def test_a_name_that_is_no_file_may_be_a_bus(bus: str, tmp_path: Path) -> None:
    with pytest.raises(CommandError) as refused:
        in_virtual_time(lambda: everything(tmp_path / "can0", bus=bus))
    assert refused.value.tries[0].startswith(f"-b {tmp_path / 'can0'}")


def test_the_demonstration_is_heard_from_its_boot_up_on() -> None:
    async def body() -> None:
        async with open_live_source(Settings(bus="demo"), None) as live:
            heard = [await anext(live) for _ in range(12)]
            assert texts(heard) == [*(f"70{node}#00" for node in range(3, 9)), *(f"70{node}#7F" for node in range(3, 9))]
            first, last = heard[0], heard[-1]
            assert isinstance(first, Record)
            assert isinstance(last, Record)
            assert last.time - first.time == 450 * MILLISECOND  # a heartbeat each 500 ms, a boot-up after 50 ms
            assert live.now() == last.time
            await trio.sleep(0.25)
            assert live.now() - last.time == 250 * MILLISECOND
            assert (live.is_live, live.name) == (True, "demo")

    in_virtual_time(body)


def test_what_a_bus_reports_comes_in_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    class Reporting:
        def __init__(self) -> None:
            self.items = [
                (Frame(0x705, b"\x05"), 7 * SECOND),
                ReceiveOverrun("x", 3, "too slow"),
                BusStateChanged("x", BusState.DOWN, "unplugged"),
                (Frame(0x705, b"\x05"), 8 * SECOND),
            ]

        async def receive(self) -> object:
            await trio.sleep(1)
            return self.items.pop(0)

        async def __aenter__(self) -> None: ...
        async def __aexit__(self, *_: object) -> None: ...

    async def opening(locator: str) -> Reporting:
        assert locator == "pcan:PCAN_USBBUS1@500k?listen_only=true"
        return Reporting()

    monkeypatch.setattr("canopen_cli.live.source.open_transport", opening)

    async def body() -> None:
        async with open_live_source(Settings(bus="pcan:PCAN_USBBUS1@500k"), None) as live:
            assert (live.is_silent, live.bitrate) == (True, 500_000)
            kinds = [type(await anext(live)) for _ in range(4)]
            assert kinds == [Record, ReceiveOverrun, BusStateChanged, Record]
            assert live.lost == 3

    in_virtual_time(body)


def test_nothing_is_sent(tmp_path: Path) -> None:
    async def body() -> list[str]:
        async with await open_transport("virtual:x") as other, open_live_source(Settings(bus="virtual:x"), None) as live:
            await other.send(Frame(0x605, b"\x40\x00\x10\x00\x00\x00\x00\x00"))
            heard = texts(await live.take())
            with trio.move_on_after(100):
                pytest.fail(str(await other.receive()))
            return heard

    assert in_virtual_time(body) == ["605#4000100000000000"]


def test_a_replayed_file_ends_and_keeps_its_times(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("(100.0) can0 705#00\n(102.0) can0 705#05\n")
    heard = in_virtual_time(lambda: everything(None, bus=f"file:{tmp_path}/a.log?speed=10"))
    assert [(str(each.frame), each.time) for each in heard if isinstance(each, Record)] == [
        ("705#00", 100 * SECOND),
        ("705#05", 102 * SECOND),
    ]


# ---- standard input ----


def test_standard_input_that_is_at_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    text = io.TextIOWrapper(io.BufferedReader(io.BytesIO(b"  can0  705   [1]  05\n")))  # type: ignore[arg-type]
    monkeypatch.setattr(sys, "stdin", text)
    assert texts(in_virtual_time(lambda: everything(INPUT))) == ["705#05"]


@pytest.fixture
def writing(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The other end of a pipe that is standard input."""
    reading, writing = os.pipe()
    with os.fdopen(reading, "r") as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield writing
        monkeypatch.undo()
        with suppress(OSError):  # the test has closed it
            os.close(writing)


def test_standard_input_that_makes_us_wait(writing: int) -> None:
    count = 2 * AHEAD

    async def body() -> None:
        async with open_live_source(Settings(), INPUT) as live:
            os.write(writing, b"(1.0) can0 705#00\n(2.0) can0 70")
            assert texts(await live.take()) == ["705#00"]  # a line is taken as soon as it is there
            os.write(writing, b"5#05\n")
            assert texts(await live.take()) == ["705#05"]
            async with trio.open_nursery() as nursery:
                nursery.start_soon(trio.to_thread.run_sync, write_many)
                heard = texts([each async for each in live])
            assert heard == ["705#7F"] * count

    def write_many() -> None:
        with os.fdopen(writing, "wb") as stream:
            stream.write(b"(3.0) can0 705#7F\n" * count)

    trio.run(body)


def test_standard_input_that_says_nothing_does_not_hold_up_the_end(writing: int) -> None:
    async def body() -> LiveSource:
        async with open_live_source(Settings(), INPUT) as live:
            os.write(writing, b"(1.0) can0 705#00\n")
            await live.take()
            with trio.move_on_after(0) as scope:
                await live.take()
            assert scope.cancelled_caught
            return live

    assert trio.run(body).now() == SECOND


# ---- time stamps ----


@examples(200)
@given(
    st.lists(st.tuples(st.integers(1, 50 * MILLISECOND), st.integers(0, 20 * MILLISECOND)), min_size=2),
    st.integers(-(10**18), 10**18),
    st.floats(-100e-6, 100e-6),
)
def test_a_delay_on_the_way_does_not_move_a_stamp_for_long(gaps: list[tuple[int, int]], offset: int, drift: float) -> None:
    """Where each eighth frame comes without delay, all get their true times, but for the drift of the two clocks."""
    clock = StampClock()
    truth = before = 0
    clock.time_of(offset, 0)
    for number, (gap, delay) in enumerate(gaps):
        truth += gap
        got = clock.time_of(offset + round(truth * (1 + drift)), truth + (delay if number % 8 else 0))
        assert before <= got
        assert abs(got - truth) <= 400e-6 * (truth + 20 * MILLISECOND) + 1
        before = got


def test_a_clock_that_was_set() -> None:
    clock = StampClock(10)
    assert clock.time_of(100 * SECOND, 0) == 10
    assert clock.time_of(3700 * SECOND, SECOND) == SECOND + 10  # an hour on
    assert clock.time_of(101 * SECOND, 2 * SECOND) == 2 * SECOND + 10  # and back
    assert clock.time_of(None, 3 * SECOND) == 3 * SECOND + 10
    assert clock.time_of(101_900 * MILLISECOND, 3 * SECOND + 5) == 3 * SECOND + 10  # the one before had no stamp, and came late


@pytest.mark.parametrize("step", [20 * MILLISECOND, 500 * MILLISECOND, 1900 * MILLISECOND])
@pytest.mark.parametrize("gap", [MILLISECOND, 300 * MILLISECOND, 1500 * MILLISECOND])
def test_a_clock_that_is_set_back_a_little_is_known_again_soon(step: int, gap: int) -> None:
    """As NTP does: else each node would be late by so much, for hours."""
    clock = StampClock()
    end = 10 * SECOND
    for truth in range(0, end, gap):
        stamp = truth if truth < 3 * SECOND else truth - step
        got = clock.time_of(stamp, truth)
        if truth < 3 * SECOND or truth > 5 * SECOND + 2 * gap:
            assert abs(got - truth) <= 5 * MILLISECOND


def test_frames_that_wait_for_long_while_the_computer_is_busy_keep_their_times() -> None:
    """They are handed over each 400 ms, and the last ones of each time have hardly waited."""
    clock = StampClock()
    clock.time_of(0, 0)
    for batch in range(1, 30):
        now = batch * 400 * MILLISECOND
        for truth in range(now - 399 * MILLISECOND, now, 10 * MILLISECOND):
            assert abs(clock.time_of(truth, now) - truth) <= 10 * MILLISECOND
