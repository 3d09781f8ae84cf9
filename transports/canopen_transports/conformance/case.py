"""A case, and how it ends.

The body of a case gets a `TransportBench` with a fresh bus and states what it expects by `expect` (canopen_proto/verdict.py). The
first expectation that is not met ends it. A case ends in one of these ways:

    it returns              passed
    ViolationError          failed: the transport broke a promise, or left something behind
    NotApplicable           the transport lacks the feature that the case is about
    anything else           failed: a transport raises only what the contract allows

`held` lists the threads, files and sockets that this process has open: a closed transport has given back its own.
"""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeAlias

from canopen_proto.verdict import NotApplicable, Result, Verdict, ViolationError, expect
from canopen_transports.conformance.bench import Site, TransportBench
from canopen_transports.loop import current_loop
from canopen_transports.loop.beside import beside

_DESCRIPTORS: Final = Path("/dev/fd")
_END_BY_THEMSELVES: Final = ("Trio thread", "in_thread")
"""How trio names its idle worker threads, and canopen_transports.loop those on asyncio."""


def held() -> frozenset[str]:
    """Return a text for each thread and descriptor, equal as long as it is the same one. Descriptors only on Linux and macOS."""
    threads = {
        f"thread {thread.name!r} ({thread.ident})"
        for thread in threading.enumerate()
        if not thread.name.startswith(_END_BY_THEMSELVES)
    }
    files = set()
    with suppress(OSError):
        for name in os.listdir(_DESCRIPTORS):
            with suppress(OSError):  # the descriptor that listed them is closed by now
                files.add(f"descriptor {name} ({os.readlink(_DESCRIPTORS / name)})")
    return frozenset(threads | files)


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

    def run(self, site: Site, on: str = "trio") -> None:
        """Run the case in a loop of its own. Raises the exception that ends the case; see this module's text. on: "trio", or
        "asyncio"."""
        failure: BaseException
        try:
            RUN_ON[on](functools.partial(self._in_loop, site), site.virtual_time)
        except BaseExceptionGroup as group:
            failure = group
            while isinstance(failure, BaseExceptionGroup):
                failure = failure.exceptions[0]
            raise failure from failure.__cause__

    def verdict(self, site: Site, on: str = "trio") -> Verdict:
        """Run the case and return its verdict. Never raises an Exception. on: as of `run`."""
        try:
            self.run(site, on)
        except NotApplicable as reason:
            return Verdict(Result.NOT_APPLICABLE, str(reason))
        except ViolationError as violation:
            return Verdict(Result.FAILED, str(violation))
        except Exception as error:  # noqa: BLE001 - a faulty transport may raise anything
            return Verdict(Result.FAILED, f"{type(error).__name__}: {error}")
        return Verdict(Result.PASSED)

    async def _in_loop(self, site: Site) -> None:
        loop = current_loop()
        before = held()
        with loop.move_on_after(LIMIT) as limit:
            async with site.open_bus() as bus, AsyncExitStack() as stack, beside(loop.open_nursery()) as nursery:
                await self.body(TransportBench(site, bus, stack, nursery))
        expect(not limit.cancelled_caught, f"{self.title}: the case hangs; it was not over after {LIMIT:g} s")
        left = sorted(held() - before)
        expect(not left, f"all members are closed, but this is left open: {', '.join(left)}")


def _on_trio(run: Callable[[], Awaitable[None]], virtual_time: bool) -> None:
    import trio.testing

    trio.run(run, clock=trio.testing.MockClock(autojump_threshold=0) if virtual_time else None)


def _on_asyncio(run: Callable[[], Awaitable[None]], virtual_time: bool) -> None:
    import asyncio

    async def main() -> None:
        await run()

    asyncio.run(main())


RUN_ON: Final[dict[str, Callable[[Callable[[], Awaitable[None]], bool], None]]] = {"trio": _on_trio, "asyncio": _on_asyncio}
"""The loops on which a case can run. Of virtual time asyncio knows nothing."""


def case(body: Body) -> TransportCase:
    """Make a case of its body. The body's docstring is the title."""
    title = (body.__doc__ or "").strip().splitlines()[0].rstrip(".")
    return TransportCase(body.__name__, title, body)
