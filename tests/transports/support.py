"""Running trio code in a test, in virtual time or in real time."""

from __future__ import annotations

import functools
from collections.abc import Awaitable, Callable
from typing import ParamSpec

import pytest
import trio
import trio.testing

from canopen_transports.conformance import Case, NotApplicable, Site

LIMIT = 30
"""Seconds. In virtual time a test that hangs gets there at once."""

P = ParamSpec("P")


def ask(case: Case, site: Site) -> None:
    """Run a case of the conformance kit as a test; it is skipped where it does not apply."""
    try:
        case.run(site)
    except NotApplicable as reason:
        pytest.skip(str(reason))


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
