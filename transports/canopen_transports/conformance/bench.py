"""`Site`: how to get a fresh bus. `SiteBus`: how to join it. `TransportBench`: the tools that the body of a case works with."""

from __future__ import annotations

import functools
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from random import Random
from typing import Final, TypeAlias, TypeVar

from canopen_proto.frame import Frame
from canopen_proto.verdict import ViolationError, does_not_apply, expect
from canopen_transports.conformance.frames import END, number_of
from canopen_transports.errors import ReceiveOverrun
from canopen_transports.loop import CancelScope, Nursery, current_loop
from canopen_transports.opening import open_transport
from canopen_transports.transport import Received, Transport

HEAR_TIME: Final = 10.0
"""Seconds that a frame may take at most. Even a busy computer needs only a fraction of it."""
T = TypeVar("T", bound=Transport)

DISTURBANCE: Final = 3e-4
"""Seconds until a cancel comes at the latest: the time of some frames at 1 Mbit/s."""


BURST: Final = 10_000
"""Frames: more than a second of a fully loaded bus, which fills a receive queue of any reasonable size."""
STREAM: Final = 2_000  # frames

Join: TypeAlias = Callable[[int], Awaitable[Transport]]
Opening: TypeAlias = Callable[[], Awaitable[Transport]]


class SiteBus:
    """One bus, fresh for each case.

    join: opens the member at a place: 0, 1 or 2, each a different one. A place is used again only after its member was closed. It
    raises NotApplicable if the bus does not have that place.
    """

    def __init__(self, join: Join) -> None:
        self.join = join

    async def hearer(self, bench: TransportBench, frames: Sequence[Frame]) -> Transport:
        """Return a member that hears these frames from now on, and no others.

        Override it for a transport that can only hear. Something else must then send the frames, perhaps through `bench.say`;
        `bench.keep` closes what was opened for it.
        """
        speaker, hearer = await bench.members(2)
        bench.say(speaker, frames)
        return hearer


@dataclass(frozen=True, slots=True)
class Site:
    """How a transport is tried.

    open_bus: makes a fresh bus. unopenable: openings that must fail, each for a different reason; see `openings`. virtual_time:
    the transport needs neither threads nor the outside world, so the cases run on trio's MockClock (asyncio has no such clock).
    burst: how many frames are sent while nobody takes any; choose fewer if the transport cannot count its losses. stream: how
    many are sent while they are taken.
    """

    open_bus: Callable[[], AbstractAsyncContextManager[SiteBus]]
    unopenable: tuple[Opening, ...] = ()
    virtual_time: bool = False
    burst: int = BURST
    stream: int = STREAM


def openings(*locators: str) -> tuple[Opening, ...]:
    """Return openings that call `open_transport` with these locators."""
    return tuple(functools.partial(open_transport, locator) for locator in locators)


def at(*locators: str) -> Callable[[], AbstractAsyncContextManager[SiteBus]]:
    """Return a bus that exists already: one locator for all its members, or one for each place (adapters that are cabled)."""

    async def join(place: int) -> Transport:
        if len(locators) == 1:
            return await open_transport(locators[0])
        if place >= len(locators):
            does_not_apply(f"it needs {place + 1} members of a bus, and {len(locators)} were given")
        return await open_transport(locators[place])

    @asynccontextmanager
    async def bus() -> AsyncIterator[SiteBus]:
        yield SiteBus(join)

    return bus


class TransportBench:
    """A fresh bus of a site. It closes what it opened when the case is over. nursery: for tasks beside the case's own."""

    def __init__(self, site: Site, bus: SiteBus, stack: AsyncExitStack, nursery: Nursery) -> None:
        self.site = site
        self.nursery = nursery
        self._bus = bus
        self._stack = stack

    async def join(self, place: int) -> Transport:
        """Open one more member of the bus. place: which member it is, from 0."""
        return self.keep(await self._bus.join(place))

    def keep(self, member: T) -> T:
        """Close the member when the case is over."""
        self._stack.push_async_callback(member.aclose)
        return member

    async def members(self, count: int) -> list[Transport]:
        """Open `count` members, at the places from 0 on."""
        return [await self.join(place) for place in range(count)]

    async def close_all(self) -> None:
        """Close what was opened so far."""
        await self._stack.aclose()

    async def hearer(self, frames: Sequence[Frame]) -> Transport:
        """Return a member that hears these frames from others, and no others."""
        return await self._bus.hearer(self, frames)

    def say(self, member: Transport, frames: Sequence[Frame]) -> None:
        """Send these frames from now on, in a separate task."""
        self.nursery.start_soon(_say, member, frames)

    async def hear(self, member: Transport) -> Received:
        """Return the next frame; skip reports of the bus's state. Raises ViolationError if none comes, or if frames were lost."""
        received = await self._next(member)
        if isinstance(received, ReceiveOverrun):
            raise ViolationError(f"{received.failed}: {received.seen}")
        return received

    async def _next(self, member: Transport) -> Received | ReceiveOverrun:
        with current_loop().move_on_after(HEAR_TIME):
            while True:
                received = await member.receive()
                if isinstance(received, tuple | ReceiveOverrun):
                    return received
        raise ViolationError(f"a frame that was sent did not come within {HEAR_TIME:g} s")

    async def numbers(self, member: Transport, count: int) -> list[int]:
        """Return the numbers of the next `count` frames."""
        numbers: list[int] = []
        try:
            while len(numbers) < count:
                numbers.append(number_of((await self.hear(member))[0]))
        except ViolationError as nothing:
            if not numbers:
                raise
            raise ViolationError(
                f"{len(numbers)} of {count} frames came, the last ones {numbers[-5:]}, then nothing more"
            ) from nothing
        return numbers

    async def numbers_until_end(self, member: Transport) -> list[int]:
        """Return the numbers of all frames before END."""
        numbers = []
        while (frame := (await self.hear(member))[0]) != END:
            numbers.append(number_of(frame))
        return numbers

    async def expect_no_silent_loss(self, member: Transport, count: int) -> None:
        """Take in the frames 0 to count - 1. Some may be lost, if the transport reports the loss before it hands out a later
        frame."""
        heard = told = 0
        expected = 0
        while heard + told < count:
            try:
                received = await self._next(member)
            except ViolationError as nothing:
                raise ViolationError(
                    f"of {count} frames {heard} came and {told} were reported lost, then nothing more"
                ) from nothing
            if isinstance(received, ReceiveOverrun):
                expect(received.lost > 0, f"an overrun of {received.lost} frames")
                told += received.lost
                continue
            number = number_of(received[0])
            heard += 1
            expect(number >= expected, f"frame {number} came after frame {expected - 1}: twice, or out of order")
            expected = number + 1
            missing = expected - heard
            expect(missing <= told, f"frame {number} came; {missing} before it were missing, {told} reported lost")
        expect(heard + told == count, f"of {count} frames {heard} came, and {told} were reported lost")

    def disturb(self, scope: CancelScope, random: Random) -> None:
        """Perhaps cancel this scope at some moment, before or while it runs."""
        choice = random.randrange(4)
        if choice == 0:
            scope.deadline = current_loop().current_time() + random.uniform(0, DISTURBANCE)
        elif choice < 3:
            self.nursery.start_soon(_cancel_later, scope, random.randrange(6))


async def turns(count: int) -> None:
    """Let the other tasks run `count` times."""
    for _ in range(count):
        await current_loop().checkpoint()


async def _say(member: Transport, frames: Sequence[Frame]) -> None:
    for frame in frames:
        await member.send(frame)


async def _cancel_later(scope: CancelScope, count: int) -> None:
    await turns(count)
    scope.cancel()
