"""A case, and how it ends.

The body of a case gets a `TransportBench` with a fresh bus and states what it expects by `expect` (canopen_proto/verdict.py). The
first expectation that is not met ends it. A case ends in one of these ways:

    it returns              passed
    ViolationError          failed: the transport broke a promise, or left something behind
    NotApplicable           the transport lacks the feature that the case is about
    anything else           failed: a transport raises only what the contract allows
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from typing import Final, TypeAlias

import trio
import trio.testing

from canopen_proto.verdict import NotApplicable, Result, Verdict, ViolationError, expect
from canopen_transports.conformance import leftovers
from canopen_transports.conformance.bench import Site, TransportBench

LIMIT: Final = 120.0
"""Seconds. In virtual time a case that hangs gets there at once."""

Body: TypeAlias = Callable[[TransportBench], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class TransportCase:
    """One case. name: for programs. title: the promise, in one line."""

    name: str
    title: str
    body: Body

    def __str__(self) -> str:
        return self.name

    def run(self, site: Site) -> None:
        """Run the case in its own `trio.run`. Raises the exception that ends the case; see this module's text."""
        clock = trio.testing.MockClock(autojump_threshold=0) if site.virtual_time else None
        failure: BaseException
        try:
            trio.run(self._in_trio, site, clock=clock)
        except trio.TooSlowError as error:
            raise ViolationError(f"{self.title}: the case hangs; it was not over after {LIMIT:g} s") from error
        except BaseExceptionGroup as group:
            failure = group
            while isinstance(failure, BaseExceptionGroup):
                failure = failure.exceptions[0]
            raise failure from failure.__cause__

    def verdict(self, site: Site) -> Verdict:
        """Run the case and return its verdict. Never raises an Exception."""
        try:
            self.run(site)
        except NotApplicable as reason:
            return Verdict(Result.NOT_APPLICABLE, str(reason))
        except ViolationError as violation:
            return Verdict(Result.FAILED, str(violation))
        except Exception as error:  # noqa: BLE001 - a faulty transport may raise anything
            return Verdict(Result.FAILED, f"{type(error).__name__}: {error}")
        return Verdict(Result.PASSED)

    async def _in_trio(self, site: Site) -> None:
        before = leftovers.held()
        with trio.fail_after(LIMIT):
            async with site.open_bus() as bus, AsyncExitStack() as stack, trio.open_nursery() as nursery:
                await self.body(TransportBench(site, bus, stack, nursery))
                nursery.cancel_scope.cancel()
        left = sorted(leftovers.held() - before)
        expect(not left, f"all members are closed, but this is left open: {', '.join(left)}")


def case(body: Body) -> TransportCase:
    """Make a case of its body. The body's docstring is the title."""
    title = (body.__doc__ or "").strip().splitlines()[0].rstrip(".")
    return TransportCase(body.__name__, title, body)
