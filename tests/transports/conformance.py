"""What every transport must do. Subclass `TransportConformance` for yours, give it `join`, and pytest runs the kit.

No test waits in order to see that nothing comes: a later frame proves that nothing came before it.
"""

from __future__ import annotations

import functools
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack

import pytest
import trio
import trio.testing

from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_transports import ReceiveOverrun, Transport, TransportError, open_transport
from tests.transports.support import run

EVERY_KIND = [
    *(Frame(0x580 + length, bytes(range(length))) for length in range(9)),
    *(Frame.parse(text) for text in ("000#8000", "7FF#", "00000000#01", "1FFFFFFF#0102030405060708", "000007FF#AA")),
    *(Frame(0x701, b"", REMOTE, dlc) for dlc in range(9)),
    *(Frame.parse(text) for text in ("12345678#R4", "1FFFFFFF#R")),
]
IMPOSSIBLE = {
    "identifier too high": Frame(0x800),
    "29-bit identifier too high": Frame(0x20000000, b"", EXTENDED),
    "negative identifier": Frame(-1),
    "nine bytes": Frame(0x601, bytes(9)),
    "length is not that of the data": Frame(0x601, b"\1", 0, 8),
    "remote frame with data": Frame(0x701, b"\1", REMOTE),
    "remote frame with length 9": Frame(0x701, b"", REMOTE, 9),
    "unknown flag": Frame(0x601, b"", 4),
}
END = Frame.parse("7E5#0E")


def numbered(number: int) -> Frame:
    """A frame that says which one it is."""
    return Frame(0x100 + number % 0x400, number.to_bytes(4, "little"))


def number_of(frame: Frame) -> int:
    return int.from_bytes(frame.data, "little")


def scenario(body: Callable[[TransportConformance], Awaitable[None]]) -> Callable[[TransportConformance], None]:
    @functools.wraps(body)
    def test(self: TransportConformance) -> None:
        async def within() -> None:
            async with AsyncExitStack() as stack:
                self._stack = stack
                await body(self)

        run(within, real_time=self.real_time)

    return test


class TransportConformance:
    """The kit. `join` opens one more member of one and the same bus, which is fresh for each test (see pytest's setup_method)."""

    real_time = True
    burst = 10_000
    unopenable: tuple[str, ...] = ()

    _stack: AsyncExitStack

    async def join(self) -> Transport:
        raise NotImplementedError

    async def members(self, count: int) -> list[Transport]:
        members = []
        for _ in range(count):
            member = await self.join()
            self._stack.push_async_callback(member.aclose)
            members.append(member)
        return members

    @scenario
    async def test_every_kind_of_frame_arrives_as_it_was_sent(self) -> None:
        one, other = await self.members(2)
        for frame in EVERY_KIND:
            await one.send(frame)
            received, timestamp = await other.receive()
            assert received == frame
            assert timestamp is None or (isinstance(timestamp, int) and timestamp >= 0)

    @scenario
    async def test_impossible_frames_are_refused_and_not_sent(self) -> None:
        one, other = await self.members(2)
        for frame in IMPOSSIBLE.values():
            with pytest.raises(ValueError, match="cannot send"):
                await one.send(frame)
        await one.send(END)
        assert (await other.receive())[0] == END

    @scenario
    async def test_order_is_kept(self) -> None:
        one, other = await self.members(2)

        async def send() -> None:
            for number in range(200):
                await one.send(numbered(number))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(send)
            assert [number_of((await other.receive())[0]) for _ in range(200)] == list(range(200))

    @scenario
    async def test_own_frames_do_not_come_back(self) -> None:
        one, other = await self.members(2)
        for number in range(5):
            await one.send(numbered(number))
        for number in range(5):
            assert number_of((await other.receive())[0]) == number
        await other.send(END)  # had they come back, they would stand before it
        assert (await one.receive())[0] == END

    @scenario
    async def test_three_members_each_hear_the_two_others(self) -> None:
        members = await self.members(3)
        for number in range(30):
            await members[number % 3].send(numbered(number))
        for place, member in enumerate(members):
            heard = [number_of((await member.receive())[0]) for _ in range(20)]
            assert sorted(heard) == [number for number in range(30) if number % 3 != place]
            for sender in range(3):  # in order as far as one sender is concerned
                from_one = [number for number in heard if number % 3 == sender]
                assert from_one == sorted(from_one)

    @scenario
    async def test_a_member_that_leaves_does_not_disturb_the_others(self) -> None:
        one, other, leaver = await self.members(3)
        await leaver.send(numbered(1))
        await leaver.aclose()
        await one.send(numbered(2))
        assert [number_of((await other.receive())[0]) for _ in range(2)] == [1, 2]

    @scenario
    async def test_one_member_alone_can_send(self) -> None:
        (one,) = await self.members(1)
        for number in range(3):
            await one.send(numbered(number))
        (late,) = await self.members(1)
        await one.send(END)
        assert (await late.receive())[0] == END

    @scenario
    async def test_of_a_burst_nothing_is_lost_silently(self) -> None:
        one, other = await self.members(2)
        for number in range(self.burst):
            await one.send(numbered(number))
        numbers: list[int] = []
        losses: list[int] = []
        while len(numbers) + sum(losses) < self.burst:
            try:
                numbers.append(number_of((await other.receive())[0]))
            except ReceiveOverrun as overrun:
                losses.append(overrun.lost)
        assert numbers == sorted(set(numbers))
        assert len(numbers) + sum(losses) == self.burst
        assert all(lost > 0 for lost in losses)
        await one.send(END)  # and it works on
        assert (await other.receive())[0] == END

    @scenario
    async def test_a_cancelled_receive_takes_no_frame(self) -> None:
        one, other = await self.members(2)
        heard: list[int] = []

        async def receive_once(scope: trio.CancelScope) -> None:
            with scope:
                heard.append(number_of((await other.receive())[0]))

        for number in range(50):
            async with trio.open_nursery() as nursery:
                scope = trio.CancelScope()
                nursery.start_soon(receive_once, scope)
                if number % 2:
                    await trio.testing.wait_all_tasks_blocked()
                await one.send(numbered(number))
                if number % 3 == 0:
                    await trio.lowlevel.checkpoint()
                scope.cancel()
        while len(heard) < 50:
            heard.append(number_of((await other.receive())[0]))
        assert heard == list(range(50))

    @scenario
    async def test_a_cancelled_send_has_sent_nothing(self) -> None:
        one, other = await self.members(2)
        sent: list[int] = []

        async def send_once(number: int, scope: trio.CancelScope) -> None:
            with scope:
                await one.send(numbered(number))
                sent.append(number)

        for number in range(30):
            async with trio.open_nursery() as nursery:
                scope = trio.CancelScope()
                if number % 3 == 0:
                    scope.cancel()
                nursery.start_soon(send_once, number, scope)
                if number % 3 == 1:
                    await trio.lowlevel.checkpoint()
                    scope.cancel()
        await one.send(END)
        heard: list[int] = []
        while (frame := (await other.receive())[0]) != END:
            heard.append(number_of(frame))
        assert heard == sent
        assert set(range(2, 30, 3)) <= set(sent)
        assert not set(range(0, 30, 3)) & set(sent)

    @scenario
    async def test_closing_wakes_the_receiver(self) -> None:
        (one,) = await self.members(1)

        async def receive() -> None:
            with pytest.raises(trio.ClosedResourceError):
                await one.receive()

        async with trio.open_nursery() as nursery:
            nursery.start_soon(receive)
            await trio.testing.wait_all_tasks_blocked()
            await one.aclose()

    @scenario
    async def test_closing_amid_traffic_wakes_reader_and_sender(self) -> None:
        one, other, third = await self.members(3)
        count = 0

        async def read(member: Transport) -> None:
            nonlocal count
            with pytest.raises(trio.ClosedResourceError):
                while True:
                    try:
                        await member.receive()
                    except ReceiveOverrun:
                        continue
                    count += 1

        async def send(member: Transport) -> None:
            with pytest.raises(trio.ClosedResourceError):
                for number in range(1_000_000):
                    await member.send(numbered(number))

        async with trio.open_nursery() as nursery:
            for member in (one, other):
                nursery.start_soon(read, member)
                nursery.start_soon(send, member)
            while count < 50:
                await trio.lowlevel.checkpoint()
            await one.aclose()
            before = count
            while count < before + 50:  # the others go on: `other` hears only `third`, which hears them, now
                await third.send(numbered(0))
            await other.aclose()
        await third.aclose()

    @scenario
    async def test_what_is_closed_stays_closed(self) -> None:
        one, other = await self.members(2)
        await other.send(END)
        await one.aclose()
        await one.aclose()
        with pytest.raises(trio.ClosedResourceError):
            await one.send(END)
        with pytest.raises(trio.ClosedResourceError):
            await one.receive()

    @scenario
    async def test_a_cancelled_close_closes_all_the_same(self) -> None:
        (one,) = await self.members(1)
        with trio.CancelScope() as scope:
            scope.cancel()
            await one.aclose()
        with pytest.raises(trio.ClosedResourceError):
            await one.receive()

    @scenario
    async def test_what_cannot_be_opened_says_what_to_do(self) -> None:
        for locator in self.unopenable:
            with pytest.raises(TransportError) as caught:
                await open_transport(locator)
            error = caught.value
            assert error.locator == locator
            assert error.code in ("CO100", "CO101", "CO102")
            assert error.seen
            assert error.tries
            lines = str(error).splitlines()
            assert lines[0].startswith(f"{error.code}: ")
            assert locator in lines[0]
            assert len(lines) <= 10
            assert any(line.startswith("  try:  ") for line in lines)
