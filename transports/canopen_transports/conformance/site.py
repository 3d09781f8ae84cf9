"""Where a transport is tried: a `Site` says how to get a fresh bus, and a `Bus` how one gets on it."""

from __future__ import annotations

import functools
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

from canopen_proto.frame import Frame
from canopen_transports.conformance.case import NotApplicable
from canopen_transports.opening import open_transport
from canopen_transports.transport import Transport

if TYPE_CHECKING:
    from canopen_transports.conformance.bench import Bench

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
