"""`file:trace.log`, a log file as a bus, and the recording of buses. In virtual time."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
import trio

from canopen_proto.frame import Frame
from canopen_transports import (
    BusState,
    BusStateChanged,
    ReceiveOverrun,
    ReplayTransport,
    TransportError,
    VirtualTransport,
    open_transport,
)
from canopen_transports.conformance.frames import IMPOSSIBLE, numbered
from canopen_transports.log_files import LogReader, log_writer
from canopen_transports.receive_test import listen_on
from canopen_transports.record import Record
from canopen_transports.tracing import Trace, TracingTransport, current_trace, for_devices, recording
from canopen_transports.transport import CyclicTransport, EagerTransport, FilteringTransport
from tests.transports.support import reported, run, trio_test

LOG = "(100.0) can0 601#40\n(100.5) can0 581#43\n(103.0) can0 701#05\n(102.0) can0 701#7F\n"
TIMES = [0.0, 0.5, 3.0, 3.0]


async def opened(locator: str) -> ReplayTransport:
    transport = await open_transport(locator)
    assert isinstance(transport, ReplayTransport)
    return transport


@pytest.fixture
def log(tmp_path: Path) -> str:
    path = tmp_path / "a@b.log"
    path.write_text(LOG)
    return f"file:{path}"


@pytest.mark.parametrize(("speed", "factor"), [("", 1.0), ("?speed=10", 0.1), ("?speed=0.5", 2.0), ("?speed=max", 0.0)])
def test_frames_come_in_their_time(log: str, speed: str, factor: float) -> None:
    async def body() -> None:
        async with await opened(log + speed) as bus:
            start = trio.current_time()
            heard, times = [], []
            for _ in range(4):
                assert not bus.ended
                frame, timestamp = await bus.receive()
                heard.append((str(frame), timestamp))
                times.append(trio.current_time() - start)
            assert heard == [
                ("601#40", 100 * 10**9),
                ("581#43", 100_500_000_000),
                ("701#05", 103 * 10**9),
                ("701#7F", 102 * 10**9),
            ]
            assert times == pytest.approx([time * factor for time in TIMES])
            assert bus.ended
            caught = await reported(bus, BusStateChanged, match="down")
            assert caught.state is BusState.DOWN
            with trio.move_on_after(5) as scope:
                await bus.receive()
            assert scope.cancelled_caught

    run(body)


@trio_test()
async def test_step_by_step(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(LOG)
    async with await opened(f"file:{tmp_path}/a.log?speed=step") as bus:
        heard: list[str] = []

        async def listen() -> None:
            with pytest.raises(trio.ClosedResourceError):
                while True:
                    heard.append(str((await bus.receive())[0]))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(listen)
            for count, expected in ((0, 0), (1, 1), (2, 3)):
                bus.step(count)
                await trio.testing.wait_all_tasks_blocked()
                assert len(heard) == expected
            await bus.aclose()


@trio_test()
async def test_what_is_sent_is_swallowed_or_refused(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(LOG)
    async with await opened(f"file:{tmp_path}/a.log") as bus:
        await bus.send(numbered(1))
        assert bus.swallowed == 1
        for frame in IMPOSSIBLE.values():
            with pytest.raises(ValueError, match="cannot send"):
                await bus.send(frame)
    with pytest.raises(trio.ClosedResourceError):
        await bus.send(numbered(1))
    async with await opened(f"file:{tmp_path}/a.log?send=refuse") as bus:
        with pytest.raises(TransportError, match="this bus is a recording"):
            await bus.send(numbered(1))


@trio_test()
async def test_a_cancelled_receive_takes_no_frame_and_closing_wakes(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(LOG)
    bus = await opened(f"file:{tmp_path}/a.log")
    await bus.receive()
    with trio.move_on_after(0.1):
        await bus.receive()
    assert str((await bus.receive())[0]) == "581#43"

    async def listen() -> None:
        with pytest.raises(trio.ClosedResourceError):
            await bus.receive()

    async with trio.open_nursery() as nursery:
        nursery.start_soon(listen)
        await trio.testing.wait_all_tasks_blocked()
        await bus.aclose()


@pytest.mark.parametrize(
    ("options", "seen"),
    [
        ("?speed=fast", "neither a positive number"),
        ("?speed=0", "neither a positive number"),
        ("?speed=-1", "neither a positive number"),
        ("?speed=true", "neither a positive number"),
        ("?send=no", "neither swallow nor refuse"),
        ("?loop=1", "no option 'loop'; it has speed, send"),
    ],
)
def test_options_that_make_no_sense(log: str, options: str, seen: str) -> None:
    async def body() -> None:
        with pytest.raises(TransportError, match=seen) as caught:
            await open_transport(log + options)
        assert caught.value.code == "CO100"

    run(body)


@trio_test()
async def test_files_that_cannot_be_replayed(tmp_path: Path) -> None:
    for locator, seen in (
        ("file:", "the locator names no file"),
        (f"file:{tmp_path}/none.log", "No such file"),
        (f"file:{tmp_path}/none.csv", "does not say what kind of log"),
    ):
        with pytest.raises(TransportError, match=seen):
            await open_transport(locator)
    (tmp_path / "bad.log").write_text(LOG + "(1.0) can0 123##1AA\nhello\n")
    async with await opened(f"file:{tmp_path}/bad.log?speed=max") as bus:
        for _ in range(4):
            await bus.receive()
        assert bus.skipped == 1
        for _ in range(2):
            with pytest.raises(TransportError, match="CO111.*(?s:.)*bad.log:6 is not understood"):
                await bus.receive()
    (tmp_path / "empty.log").write_text("")
    async with await opened(f"file:{tmp_path}/empty.log") as bus:
        assert bus.ended


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="asks Linux which files are open")
def test_closed_amid_a_file_it_does_not_hold_the_file(log: str) -> None:
    async def body() -> None:
        async with await opened(log) as bus:
            await bus.receive()
        assert log.removeprefix("file:") not in [os.path.realpath(each) for each in Path("/proc/self/fd").iterdir()]

    run(body)


# ---- recording ----


def lines(path: Path) -> list[str]:
    """The trace without its times: channel, frame, direction."""
    return [f"{record.channel} {record.frame} {'T' if record.sent else 'R'}" for record in LogReader(path)]


@trio_test()
async def test_what_is_said_is_recorded_once_and_in_order(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    async with VirtualTransport("a") as stranger:
        with recording(log_writer(path)) as trace:
            assert current_trace() is trace
            with for_devices():
                drive = await open_transport("virtual:a")
            master = await open_transport("virtual:a")
            other = await open_transport("virtual:b")
            await master.send(Frame.parse("601#40"))
            await drive.receive()
            await drive.send(Frame.parse("581#43"))
            await stranger.send(Frame.parse("702#05"))
            for member in (master, drive):
                await member.receive()
            await trio.sleep(1)
            await master.receive()
            await other.send(Frame.parse("000#0100"))
            await other.aclose()
            await drive.aclose()
            await drive.aclose()
            await master.send(Frame.parse("601#41"))
            await master.aclose()
    assert current_trace() is None
    assert trace.recorded == 5
    assert lines(path) == [
        "virtual0 601#40 T",
        "virtual0 581#43 R",
        "virtual0 702#05 T",
        "virtual1 000#0100 T",
        "virtual0 601#41 T",
    ]
    times = [record.time for record in LogReader(path)]
    assert times[3] - times[0] == pytest.approx(10**9, abs=2000)
    assert not isinstance(await open_transport("virtual:a"), TracingTransport)


@trio_test()
async def test_a_transport_outlives_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    with recording(log_writer(path)) as trace:
        master = await open_transport("virtual:a")
        await master.send(Frame.parse("601#40"))
    async with master:
        await master.send(Frame.parse("601#41"))
    assert (trace.recorded, trace.failure) == (1, None)
    assert lines(path) == ["virtual0 601#40 T"]


@trio_test()
async def test_devices_may_be_ours(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    with recording(log_writer(path), devices_are_ours=True), for_devices():
        async with await open_transport("virtual:a") as drive:
            await drive.send(Frame.parse("701#00"))
    assert lines(path) == ["virtual0 701#00 T"]


class Slow(VirtualTransport):
    """A bus on which sending takes its time, or fails. It can do what a transport may do besides."""

    filtered = True
    sends_sync = True
    failing = False
    has_room = True
    errors = 3

    async def send(self, frame: Frame) -> None:
        await super().send(frame)
        await trio.sleep(1)
        if self.failing:
            raise TransportError("CO111", self.locator, "gone")

    def send_nowait(self, frame: Frame) -> bool:
        if self.failing:
            raise TransportError("CO111", self.locator, "gone")
        if self.has_room:
            for member in self._line.members:
                if member is not self:
                    member._queue.put((frame, None))
                    member._queue.wake()
        return self.has_room

    def set_filters(self, keys: object) -> bool:
        raise NotImplementedError

    def start_cyclic(self, frames: object, period: int) -> None:
        self.period = period

    def stop_cyclic(self) -> None:
        self.period = 0


@trio_test()
async def test_an_answer_stands_behind_its_request_and_what_fails_was_not_sent(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    with recording(log_writer(path)) as trace:
        inner = Slow("a")
        tap = trace.wrap(inner)

        async def answer(member: VirtualTransport) -> None:
            await member.receive()
            await member.send(Frame.parse("581#43"))

        async with tap, VirtualTransport("a") as other, trio.open_nursery() as nursery:
            nursery.start_soon(answer, other)
            nursery.start_soon(tap.receive)
            await tap.send(Frame.parse("601#40"))
            inner.failing = True
            nursery.start_soon(answer, other)
            nursery.start_soon(tap.receive)
            with pytest.raises(TransportError):
                await tap.send(Frame.parse("601#41"))
    assert lines(path) == ["virtual0 601#40 T", "virtual0 581#43 R", "virtual0 581#43 R"]


@trio_test()
async def test_a_receive_test_counts_error_frames_while_it_is_recorded(tmp_path: Path) -> None:
    with recording(log_writer(tmp_path / "a.log")) as trace:
        async with trace.wrap(Slow("a")) as tap, trace.wrap(VirtualTransport("a")) as plain:
            assert (await listen_on(tap, "here", 0.1)).faults == 3
            assert (await listen_on(plain, "here", 0.1)).faults == 0


@trio_test()
async def test_abilities_of_the_transport_below(tmp_path: Path) -> None:
    with recording(log_writer(tmp_path / "a.log")) as trace:
        inner = Slow("a")
        tap = trace.wrap(inner)
        assert isinstance(tap, CyclicTransport)
        assert not isinstance(tap, FilteringTransport)  # all is to be recorded
        assert isinstance(tap, EagerTransport)
        async with VirtualTransport("a") as kernel:
            tap.start_cyclic([Frame(0x80)], 1000)
            assert inner.period == 1000
            await kernel.send(Frame(0x80))
            await kernel.send(Frame(0x81))
            for _ in range(2):
                await tap.receive()
            tap.stop_cyclic()
            assert inner.period == 0
            await kernel.send(Frame(0x80))
            await tap.receive()
        assert lines(tmp_path / "a.log") == ["virtual0 080# T", "virtual0 081# R", "virtual0 080# R"]
        plain = await open_transport(f"file:{tmp_path}/a.log")  # a recording does none of that
        assert isinstance(plain, TracingTransport)
        assert not plain.sends_sync
        assert not plain.send_nowait(Frame(0x80))
        assert [str(item[0]) for item in await plain.receive_many(64) if isinstance(item, tuple)] == ["080#"]
        assert [
            trace.channel_of(name) for name in ("can3", "socketcan:can4", "tcp", "/dev/pcan32", "pcan:PCAN_USBBUS2@500k")
        ] == [
            "can3",
            "can4",
            "tcp0",
            "pcan0",
            "pcan1",
        ]


@trio_test()
async def test_what_is_sent_at_once_is_recorded_at_its_place(tmp_path: Path) -> None:
    with recording(log_writer(tmp_path / "a.log")) as trace:
        inner = Slow("a")
        tap = trace.wrap(inner)
        async with tap, VirtualTransport("a") as other, trio.open_nursery() as nursery:
            assert tap.send_nowait(Frame.parse("601#40"))
            nursery.start_soon(tap.send, Frame.parse("601#41"))
            await trio.testing.wait_all_tasks_blocked()
            assert tap.send_nowait(Frame.parse("601#42"))  # behind the one that is on its way
            inner.has_room = False
            assert not tap.send_nowait(Frame.parse("601#43"))
            inner.failing = True
            with pytest.raises(TransportError):
                tap.send_nowait(Frame.parse("601#44"))
            inner.failing = False
            heard = [str((await other.receive())[0]) for _ in range(3)]
    assert (
        lines(tmp_path / "a.log")
        == [f"virtual0 {frame} T" for frame in heard]
        == [
            "virtual0 601#40 T",
            "virtual0 601#41 T",
            "virtual0 601#42 T",
        ]
    )


@trio_test()
async def test_what_is_lost_on_its_way_to_us_is_counted(tmp_path: Path) -> None:
    with recording(log_writer(tmp_path / "a.log")) as trace:
        async with trace.wrap(VirtualTransport("a", 2)) as tap, VirtualTransport("a") as other:
            for number in range(5):
                await other.send(numbered(number))
            for _ in range(2):
                await tap.receive()
            await reported(tap, ReceiveOverrun)
    assert (trace.recorded, trace.lost) == (2, 3)
    reader = LogReader(tmp_path / "a.log")
    assert (len(list(reader)), reader.overruns) == (2, 1), "who reads the file knows it, too"


class FullDisk:
    left_out = 3

    def __init__(self, room: int) -> None:
        self.room = room

    def write(self, record: Record) -> None:
        if not self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        self.room -= 1

    def lost(self, time: int, channel: str) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    def close(self) -> None:
        raise OSError(errno.EIO, "Input/output error")


def test_a_full_disk_that_cannot_take_that_frames_were_lost_ends_the_trace() -> None:
    trace = Trace(FullDisk(9))
    trace.lose(2, "can0", 0)
    trace.record(Record(0, "can0", numbered(1)))
    trace.close()
    assert (trace.lost, trace.recorded) == (2, 0)
    assert trace.failure is not None
    assert trace.failure.errno == errno.ENOSPC


def test_a_full_disk_ends_the_trace_and_nothing_else() -> None:
    for room, number in ((2, errno.ENOSPC), (9, errno.EIO)):
        trace = Trace(FullDisk(room))
        for _ in range(5):
            trace.record(Record(0, "can0", numbered(1)))
        trace.close()
        assert trace.recorded == min(room, 5)
        assert trace.failure is not None
        assert trace.failure.errno == number
        assert trace.left_out == 3
