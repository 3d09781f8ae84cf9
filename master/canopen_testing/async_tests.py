"""Async tests in a world: the loop that runs them has its time, and `canopen_master` is opened within it."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any, TypeVar

import trio

from canopen_master import open_master
from canopen_proto.machine import LocalProtocolError
from canopen_testing.program_world import ProgramWorld
from canopen_testing.world_loop import WorldLoop
from canopen_transports.loop import current_loop

T = TypeVar("T")

_NO_ASYNCIO, _NO_TRIO = "no running event loop", "must be called from async context"
"""What asyncio and trio say in the loop of the other."""
CLOCK = "_canopen_world_as_clock"
"""The argument by which pytest-trio finds the clock of a test."""


class MasterToOpen:
    """Stands for the master of an async test, until its loop runs."""


def hosted(test: Callable[..., Awaitable[T]], world: ProgramWorld) -> Callable[..., Awaitable[T]]:
    """Return an async test that checks whose time it has, and opens its master first."""

    @functools.wraps(test)
    async def run(**arguments: Any) -> T:
        __tracebackhide__ = True
        arguments.pop(CLOCK, None)
        in_trio = current_loop().name == "trio"
        _check_time(world, in_trio)
        world.take_buses()
        async with _opened(arguments) as opened:
            started = functools.partial(test, **opened)
            try:
                return await (world.watched(started) if in_trio else started())
            except RuntimeError as error:
                if str(error) == (_NO_ASYNCIO if in_trio else _NO_TRIO):
                    other, this = ("asyncio", "trio") if in_trio else ("trio", "asyncio")
                    error.add_note(f"this test runs in {this}; to run it in {other}, mark it @pytest.mark.{other}")
                raise

    return run


def run_in(world: ProgramWorld, test: Callable[..., Awaitable[None]], in_trio: bool, **arguments: Any) -> None:
    """Run a hosted test in the world."""
    __tracebackhide__ = True
    if in_trio:
        world.run(functools.partial(test, **arguments))
    else:
        world.run_asyncio(functools.partial(test, **arguments))


def _check_time(world: ProgramWorld, in_trio: bool) -> None:
    is_its = trio.lowlevel.current_clock() is world if in_trio else isinstance(asyncio.get_running_loop(), WorldLoop)
    if not is_its:
        raise LocalProtocolError("this test runs in real time: its loop is not that of the world (`trio.run(..., clock=world)`)")


@asynccontextmanager
async def _opened(arguments: Mapping[str, Any]) -> AsyncIterator[dict[str, Any]]:
    wanted = [name for name, value in arguments.items() if isinstance(value, MasterToOpen)]
    if not wanted:
        yield dict(arguments)
        return
    async with open_master("virtual:can0") as master:
        await current_loop().wait_all_tasks_blocked()  # then it hears the boot-up of a device that the test makes first
        yield {**arguments, **dict.fromkeys(wanted, master)}
