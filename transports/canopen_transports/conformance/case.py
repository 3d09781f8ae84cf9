"""What a case is, and how it ends.

A body gets a `Bench` with a fresh bus and says what it expects by `expect`; the first expectation that is not met ends it. What
can end a case:

    it returns              passed
    Violation               the transport did what it must not, or did not what it must; or it left something behind
    NotApplicable           the transport does not have what the case is about
    anything else           failed, too: a transport raises what the contract says, and nothing else
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from typing import Final, TypeAlias

import trio
import trio.testing

from canopen_proto.verdict import Result, Verdict
from canopen_transports.conformance import leftovers
from canopen_transports.conformance.bench import Bench, Site
from canopen_transports.conformance.expectations import NotApplicable, Violation, expect

LIMIT: Final = 120.0
"""Seconds. In virtual time a case that hangs gets there at once."""

Body: TypeAlias = Callable[[Bench], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class Case:
    """One case. name: for programs. title: what is promised, in a line."""

    name: str
    title: str
    body: Body

    def __str__(self) -> str:
        return self.name

    def run(self, site: Site) -> None:
        """Ask the transport, in a `trio.run` of its own. Raises what ends the case, see this module's text."""
        clock = trio.testing.MockClock(autojump_threshold=0) if site.virtual_time else None
        failure: BaseException
        try:
            trio.run(self._in_trio, site, clock=clock)
        except trio.TooSlowError as error:
            raise Violation(f"{self.title}: it hangs, not over after {LIMIT:g} s") from error
        except BaseExceptionGroup as group:
            failure = group
            while isinstance(failure, BaseExceptionGroup):
                failure = failure.exceptions[0]
            raise failure from failure.__cause__

    def verdict(self, site: Site) -> Verdict:
        """The same; never raises an Exception."""
        try:
            self.run(site)
        except NotApplicable as reason:
            return Verdict(Result.NOT_APPLICABLE, str(reason))
        except Violation as violation:
            return Verdict(Result.FAILED, str(violation))
        except Exception as error:  # noqa: BLE001 - whatever a transport may raise that it should not
            return Verdict(Result.FAILED, f"{type(error).__name__}: {error}")
        return Verdict(Result.PASSED)

    async def _in_trio(self, site: Site) -> None:
        before = leftovers.held()
        with trio.fail_after(LIMIT):
            async with site.open_bus() as bus, AsyncExitStack() as stack, trio.open_nursery() as nursery:
                await self.body(Bench(site, bus, stack, nursery))
                nursery.cancel_scope.cancel()
        left = sorted(leftovers.held() - before)
        expect(not left, f"all members are closed, and this is left: {', '.join(left)}")


def case(body: Body) -> Case:
    """Makes a case of its body, whose docstring is the title."""
    title = (body.__doc__ or "").strip().splitlines()[0].rstrip(".")
    return Case(body.__name__, title, body)
