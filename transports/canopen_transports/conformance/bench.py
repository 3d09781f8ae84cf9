"""Where a transport is tried, and what the body of a case works with there: a `Site` says how to get a fresh bus, a `Bus` how one
gets on it, and a `Bench` has the tools."""

from __future__ import annotations

import functools
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from random import Random
from typing import Final, TypeAlias, TypeVar

import trio

from canopen_proto.frame import Frame
from canopen_transports.conformance.expectations import NotApplicable, Violation, expect
from canopen_transports.conformance.frames import END, number_of
from canopen_transports.errors import ReceiveOverrun
from canopen_transports.opening import open_transport
from canopen_transports.transport import Received, Transport

HEAR_TIME: Final = 10.0
"""Seconds that a frame may take at most: many times of what any of them takes on a busy computer."""
T = TypeVar("T", bound=Transport)

DISTURBANCE: Final = 3e-4
"""Seconds until a cancel comes at the latest: some frames of a bus with 1 Mbit/s."""


BURST: Final = 10_000
"""Frames; more than a second of a fully loaded bus, so that a receive queue of any reasonable size is full."""
STREAM: Final = 2_000
"""Frames."""

Join: TypeAlias = Callable[[int], Awaitable[Transport]]
Opening: TypeAlias = Callable[[], Awaitable[Transport]]


class Bus:
    """One bus, fresh for each case.

    join: opens the member at a place: 0, 1 or 2, each a different one. A place is used again only after its member was closed.
    Raise NotApplicable for a place that there is not.
    """

    def __init__(self, join: Join) -> None:
        self.join = join

    async def told(self, bench: Bench, frames: Sequence[Frame]) -> Transport:
        """A member that hears these frames, and no others, from now on.

        Override it for a transport that can only hear. Somebody else then has to say them, perhaps by `bench.say`; who is opened
        for it, `bench.keep` closes in the end.
        """
        speaker, hearer = await bench.members(2)
        bench.say(speaker, frames)
        return hearer


@dataclass(frozen=True, slots=True)
class Site:
    """How a transport is tried.

    open_bus: makes a fresh bus. unopenable: openings that must fail, each in a way of its own, see `openings`. virtual_time: it
    needs neither threads nor the world outside, so cases run on trio's MockClock. burst: how many frames are sent while nobody
    takes any; fewer for what cannot count what it loses then. stream: how many are sent while they are taken.
    """

    open_bus: Callable[[], AbstractAsyncContextManager[Bus]]
    unopenable: tuple[Opening, ...] = ()
    virtual_time: bool = False
    burst: int = BURST
    stream: int = STREAM


def openings(*locators: str) -> tuple[Opening, ...]:
    """What `open_transport` would open."""
    return tuple(functools.partial(open_transport, locator) for locator in locators)


def at(*locators: str) -> Callable[[], AbstractAsyncContextManager[Bus]]:
    """A bus that is already there: one locator for all its members, or one for each place (adapters that are cabled)."""

    async def join(place: int) -> Transport:
        if len(locators) == 1:
            return await open_transport(locators[0])
        if place >= len(locators):
            raise NotApplicable(f"it takes {place + 1} members of a bus, and {len(locators)} were given")
        return await open_transport(locators[place])

    @asynccontextmanager
    async def bus() -> AsyncIterator[Bus]:
        yield Bus(join)

    return bus


class Bench:
    """A fresh bus of a site. What is opened here is closed when the case is over. nursery: for tasks beside the case's own."""

    def __init__(self, site: Site, bus: Bus, stack: AsyncExitStack, nursery: trio.Nursery) -> None:
        self.site = site
        self.nursery = nursery
        self._bus = bus
        self._stack = stack

    async def join(self, place: int) -> Transport:
        """One more member of the bus."""
        return self.keep(await self._bus.join(place))

    def keep(self, member: T) -> T:
        """Close it when the case is over."""
        self._stack.push_async_callback(member.aclose)
        return member

    async def members(self, count: int) -> list[Transport]:
        """So many, at the places from 0 on."""
        return [await self.join(place) for place in range(count)]

    async def close_all(self) -> None:
        """Close what was opened so far."""
        await self._stack.aclose()

    async def told(self, frames: Sequence[Frame]) -> Transport:
        """A member that hears these frames from others, and nothing else."""
        return await self._bus.told(self, frames)

    def say(self, member: Transport, frames: Sequence[Frame]) -> None:
        """Send these frames from now on, in a task of their own."""
        self.nursery.start_soon(_say, member, frames)

    async def hear(self, member: Transport) -> Received:
        """The next frame; passes over what the bus tells of its state. Violation if none comes, or if frames were lost."""
        received = await self._next(member)
        if isinstance(received, ReceiveOverrun):
            raise Violation(f"{received.failed}: {received.seen}")
        return received

    async def _next(self, member: Transport) -> Received | ReceiveOverrun:
        with trio.move_on_after(HEAR_TIME):
            while True:
                received = await member.receive()
                if isinstance(received, tuple | ReceiveOverrun):
                    return received
        raise Violation(f"a frame that was sent has not come in {HEAR_TIME:g} s")

    async def numbers(self, member: Transport, count: int) -> list[int]:
        """The numbers of the next frames."""
        numbers: list[int] = []
        try:
            while len(numbers) < count:
                numbers.append(number_of((await self.hear(member))[0]))
        except Violation as nothing:
            if not numbers:
                raise
            raise Violation(
                f"{len(numbers)} of {count} frames came, the last ones {numbers[-5:]}, then nothing more"
            ) from nothing
        return numbers

    async def numbers_until_end(self, member: Transport) -> list[int]:
        """The numbers of all frames that come before END."""
        numbers = []
        while (frame := (await self.hear(member))[0]) != END:
            numbers.append(number_of(frame))
        return numbers

    async def account(self, member: Transport, count: int) -> None:
        """Take the numbered frames 0 to count - 1 in, of which some may be lost, if the transport says so before it goes on."""
        heard = told = 0
        expected = 0
        while heard + told < count:
            try:
                received = await self._next(member)
            except Violation as nothing:
                raise Violation(f"of {count} frames {heard} came and {told} were told as lost, then nothing more") from nothing
            if isinstance(received, ReceiveOverrun):
                expect(received.lost > 0, f"an overrun of {received.lost} frames")
                told += received.lost
                continue
            number = number_of(received[0])
            heard += 1
            expect(number >= expected, f"frame {number} came behind frame {expected - 1}: twice, or out of order")
            expected = number + 1
            missing = expected - heard
            expect(missing <= told, f"frame {number} came when {missing} before it were missing and {told} told as lost")
        expect(heard + told == count, f"of {count} frames {heard} came, and {told} were told as lost")

    def disturb(self, scope: trio.CancelScope, random: Random) -> None:
        """Cancel what runs in that scope, or is to run there, at some moment; or not."""
        choice = random.randrange(4)
        if choice == 0:
            scope.deadline = trio.current_time() + random.uniform(0, DISTURBANCE)
        elif choice < 3:
            self.nursery.start_soon(_cancel_later, scope, random.randrange(6))


async def turns(count: int) -> None:
    """Let the other tasks run so many times."""
    for _ in range(count):
        await trio.lowlevel.checkpoint()


async def _say(member: Transport, frames: Sequence[Frame]) -> None:
    for frame in frames:
        await member.send(frame)


async def _cancel_later(scope: trio.CancelScope, count: int) -> None:
    await turns(count)
    scope.cancel()
