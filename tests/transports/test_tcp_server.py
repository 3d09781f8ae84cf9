"""The bus server and its guests, bad ones too: over trio's streams in memory, in virtual time."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
import trio
import trio.testing

from canopen_proto.frame import Frame
from canopen_transports.tcp import server as server_module
from canopen_transports.tcp.server import FAREWELL_TIME, HALF_LINE_TIME, HELLO_TIME, STALL_TIME, BusServer
from tests.transports.support import LIMIT, trio_test

Stream = trio.abc.HalfCloseableStream


class Bench:
    def __init__(self, nursery: trio.Nursery, **options: int) -> None:
        self.told: list[str] = []
        self.frames: list[str] = []
        self.server = BusServer(self.told.append, lambda frame: self.frames.append(str(frame)), **options)
        self._nursery = nursery
        self._count = 0

    def connect(self, *, lockstep: bool = False) -> Stream:
        """Our end of a new connection. lockstep: nothing is buffered on the way."""
        make = trio.testing.lockstep_stream_pair if lockstep else trio.testing.memory_stream_pair
        ours, theirs = make()
        self._count += 1
        self._nursery.start_soon(self.server.serve, theirs, f"guest{self._count}")
        return ours

    async def join(self, *, lockstep: bool = False) -> Stream:
        stream = self.connect(lockstep=lockstep)
        await stream.send_all(b"canopen-bus 1\n")
        assert await stream.receive_some() == b"canopen-bus 1\n"
        return stream


@asynccontextmanager
async def bench(**options: int) -> AsyncIterator[Bench]:
    async with trio.open_nursery() as nursery:
        made = Bench(nursery, **options)
        nursery.start_soon(made.server.watch)
        yield made
        nursery.cancel_scope.cancel()


async def read_all(stream: Stream) -> bytes:
    data = b""
    while chunk := await stream.receive_some():
        data += chunk
    await stream.aclose()
    return data


@trio_test()
async def test_frames_go_to_all_others_in_one_order() -> None:
    async with bench() as bus:
        one, other, third = [await bus.join() for _ in range(3)]
        await one.send_all(b"601#40\n60")
        await other.send_all(b"581#4")
        await trio.testing.wait_all_tasks_blocked()
        await other.send_all(b"3\r\n")
        await trio.testing.wait_all_tasks_blocked()
        await one.send_all(b"2#aa\n18ff0001#R3\n")
        await trio.testing.wait_all_tasks_blocked()
        assert await third.receive_some() == b"601#40\n581#43\n602#AA\n18FF0001#R3\n"
        assert await one.receive_some() == b"581#43\n"
        assert await other.receive_some() == b"601#40\n602#AA\n18FF0001#R3\n"
        assert bus.frames == ["601#40", "581#43", "602#AA", "18FF0001#R3"]
        assert bus.server.members == 3
        await one.aclose()
        await trio.testing.wait_all_tasks_blocked()
        await other.send_all(b"702#05\n")
        assert await third.receive_some() == b"702#05\n"
        assert bus.told == [
            "guest1 joined: 1 on the bus",
            "guest2 joined: 2 on the bus",
            "guest3 joined: 3 on the bus",
            "guest1 left",
        ]


@pytest.mark.parametrize("line", [b"GET / HTTP/1.1\r\n", b"605#40\n", b"\n", b"x" * 300, b"canopen-bus 2\n"])
def test_who_says_no_hello_is_turned_away(line: bytes) -> None:
    @trio_test()
    async def body() -> None:
        async with bench() as bus:
            guest, member = bus.connect(), await bus.join()
            await guest.send_all(line + b"601#40\n")
            assert (await read_all(guest)).startswith(b"bye this is a CAN bus: expected 'canopen-bus 1' first, got the line '")
            await trio.testing.wait_all_tasks_blocked()
            assert bus.told[-1].startswith("guest1 turned away: this is a CAN bus")
            assert bus.frames == []
            assert bus.server.members == 1
            await member.aclose()

    body()


@trio_test()
async def test_who_says_nothing_is_turned_away_in_time() -> None:
    assert HELLO_TIME < LIMIT
    async with bench() as bus:
        guest = bus.connect()
        start = trio.current_time()
        assert (await read_all(guest)).endswith(b"got nothing\n")
        assert HELLO_TIME <= trio.current_time() - start <= HELLO_TIME + 2
        await trio.sleep(1)
        await bus.join()
        assert bus.told[0].startswith("guest1 turned away")


@trio_test()
async def test_garbage_ends_a_membership_and_the_others_go_on() -> None:
    async with bench() as bus:
        hostile, one, other = [await bus.join() for _ in range(3)]
        await hostile.send_all(b"601#40\n\x00\xff garbage\n602#40\n")
        assert b"bye the line '\\x00\\xff garbage' is no CAN frame" in await read_all(hostile)
        await one.send_all(b"603#\n")
        await trio.testing.wait_all_tasks_blocked()
        assert await other.receive_some() == b"601#40\n603#\n"
        assert "guest1 left, cut off: the line " in bus.told[-1]
        assert bus.server.members == 2


@pytest.mark.parametrize("begin", [b"601#40\n60", b"60"])
def test_a_half_line_times_out_even_if_it_drips(begin: bytes) -> None:
    @trio_test()
    async def body() -> None:
        async with bench() as bus:
            guest = await bus.join()
            await guest.send_all(begin)
            start = trio.current_time()
            try:
                while True:
                    await guest.send_all(b"0")
                    await trio.sleep(0.5)
            except trio.BrokenResourceError:
                pass
            assert HALF_LINE_TIME <= trio.current_time() - start <= HALF_LINE_TIME + FAREWELL_TIME + 2
            assert await read_all(guest) == b"bye the line that you began has no end\n"

    body()


@trio_test()
async def test_a_member_that_only_listens_may_stay() -> None:
    async with bench() as bus:
        quiet, other = await bus.join(), await bus.join()
        await quiet.send_all(b"601#")
        await trio.sleep(1)
        await quiet.send_all(b"40\n")
        await trio.sleep(20)
        await other.send_all(b"701#05\n")
        assert await quiet.receive_some() == b"701#05\n"


@trio_test()
async def test_a_member_that_takes_nothing_is_cut_off_and_told_why_if_it_wakes_in_time() -> None:
    async with bench(queue_size=3) as bus:
        stalled, quick = await bus.join(lockstep=True), await bus.join()
        for number in range(9):
            await quick.send_all(b"601#%02X\n" % number)
            await trio.testing.wait_all_tasks_blocked()
        await trio.sleep(STALL_TIME + 1.5)
        data = await read_all(stalled)  # what was on its way is still whole
        assert data.startswith(b"601#00\nbye you have taken no frame for 5 s")
        await trio.testing.wait_all_tasks_blocked()
        assert "guest1 left, cut off: you have taken no frame" in bus.told[-1]


@trio_test()
async def test_a_member_that_sleeps_on_is_gone() -> None:
    async with bench() as bus:
        await bus.join(lockstep=True)
        quick = await bus.join()
        await quick.send_all(b"601#40\n")
        await trio.sleep(STALL_TIME + FAREWELL_TIME + 3)
        assert "guest1 left, cut off" in bus.told[-1]
        assert bus.server.members == 1


@trio_test()
async def test_losses_are_marked_at_their_place() -> None:
    async with bench(queue_size=2) as bus:
        slow, quick = await bus.join(lockstep=True), await bus.join()
        for number in range(6):
            await quick.send_all(b"601#%02X\n" % number)
            await trio.testing.wait_all_tasks_blocked()
        data = b""
        while not data.endswith(b"lost 3\n"):
            data += await slow.receive_some()
        assert data == b"601#00\n601#01\n601#02\nlost 3\n"
        await slow.aclose()


@trio_test()
async def test_connections_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "MAX_CONNECTIONS", 2)
    async with bench() as bus:
        first = await bus.join()
        bus.connect()
        await trio.testing.wait_all_tasks_blocked()
        assert await read_all(bus.connect()) == b"bye the bus server has 2 connections already\n"
        await first.aclose()
        await trio.testing.wait_all_tasks_blocked()
        await bus.join()


@trio_test()
async def test_of_a_flood_of_connections_few_are_told_and_none_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server_module, "MAX_CONNECTIONS", 2)
    async with bench() as bus:
        one, other = await bus.join(), await bus.join()
        turned_away = [bus.connect(), bus.connect()]
        await trio.testing.wait_all_tasks_blocked()
        assert [await read_all(bus.connect()) for _ in range(100)] == [b""] * 100
        assert len(bus.told) == 2
        for guest in turned_away:
            assert (await read_all(guest)).startswith(b"bye the bus server has 2 connections already")
        await one.send_all(b"601#40\n")
        assert await other.receive_some() == b"601#40\n"


@trio_test()
async def test_an_end_is_told_to_all() -> None:
    async with bench() as bus:
        one, guest = await bus.join(), bus.connect()
        await trio.testing.wait_all_tasks_blocked()
        bus.server.end("the lab closes")
        assert await read_all(one) == b"bye the lab closes\n"
        assert await read_all(guest) == b"bye the lab closes\n"


@trio_test()
async def test_connections_that_break() -> None:
    class Broken(trio.abc.SendStream, trio.abc.ReceiveStream):
        async def send_all(self, data: bytes | bytearray | memoryview) -> None:
            raise trio.BrokenResourceError

        async def receive_some(self, max_bytes: int | None = None) -> bytearray:
            raise trio.BrokenResourceError

        async def wait_send_all_might_not_block(self) -> None:
            raise trio.BrokenResourceError

        async def aclose(self) -> None:
            pass

    async with bench() as bus:
        member = await bus.join()
        ours, theirs = trio.testing.memory_stream_one_way_pair()
        await ours.send_all(b"canopen-bus 1\n")
        await bus.server.serve(trio.StapledStream(Broken(), theirs), "one")
        await bus.server.serve(trio.StapledStream(ours, Broken()), "other")
        await member.send_all(b"601#40\n")
        await trio.testing.wait_all_tasks_blocked()
        assert bus.frames == [str(Frame(0x601, b"\x40"))]
        assert bus.server.members == 1
