"""Running trio code in a test, in virtual time or in real time."""

from __future__ import annotations

import functools
import re
from collections.abc import Awaitable, Callable
from typing import ParamSpec, TypeVar

import trio
import trio.testing

from canopen_transports import BusStateChanged, Report, Transport
from canopen_transports.conformance import (
    CASES,
    Site,
    TransportCase,
    cancelling_cases,
    carrying_cases,
    closing_cases,
    flooding_cases,
    optional_cases,
)
from canopen_transports.conformance.opening_cases import what_cannot_be_opened_says_what_to_do as UNOPENABLE

LIMIT = 100
"""Seconds. In virtual time a test that hangs gets there at once, and a computer that is busy may need them in real time."""

HEARING = (
    UNOPENABLE,
    carrying_cases.every_kind_of_frame,
    flooding_cases.stream,
    flooding_cases.two_receivers,
    cancelling_cases.storm_on_receive,
    closing_cases.closing_wakes_the_receiver,
    closing_cases.closing_by_two_tasks,
    closing_cases.cancelled_close,
)
"""The cases for a transport that can only hear."""

P = ParamSpec("P")
R = TypeVar("R", bound=Report)


def cases(site: Site, *, hears_only: bool = False, optional: tuple[str, ...] = ()) -> list[TransportCase]:
    """The cases of the conformance kit that apply to a transport. optional: what it can do besides, by the cases' names."""
    return [
        case
        for case in (HEARING if hears_only else CASES)
        if (case not in vars(optional_cases).values() or case.name in optional) and (site.unopenable or case is not UNOPENABLE)
    ]


def run(body: Callable[[], Awaitable[None]], *, real_time: bool = False) -> None:
    """Run `body` in trio; TooSlowError if it hangs."""

    async def main() -> None:
        with trio.fail_after(LIMIT):
            await body()

    trio.run(main, clock=None if real_time else trio.testing.MockClock(autojump_threshold=0))


def trio_test(real_time: bool = False) -> Callable[[Callable[P, Awaitable[None]]], Callable[P, None]]:
    """Makes an async function a test. Threads and sockets of the real world need real time."""

    def decorate(body: Callable[P, Awaitable[None]]) -> Callable[P, None]:
        @functools.wraps(body)
        def test(*args: P.args, **kwargs: P.kwargs) -> None:
            run(lambda: body(*args, **kwargs), real_time=real_time)

        return test

    return decorate


async def reported(transport: Transport, kind: type[R] = BusStateChanged, match: str = "") -> R:  # type: ignore[assignment]
    """The report that comes next, and no frame before it."""
    report = await transport.receive()
    assert isinstance(report, kind)
    assert re.search(match, str(report))
    return report
