"""Async tests in a world: the loop that runs them has its time, and `canopen_master` is opened within it."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any, TypeVar

import sniffio
import trio
import trio.testing

from canopen_master import open_master
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Key
from canopen_proto.machine import LocalProtocolError
from canopen_proto.nmt import NmtCommand
from canopen_proto.procedures.objects import read, write
from canopen_proto.procedures.steps import Procedure
from canopen_proto.testing import WorldMaster
from canopen_testing.program_world import ProgramWorld
from canopen_testing.world_loop import WorldLoop

T = TypeVar("T")

_NO_ASYNCIO, _NO_TRIO = "no running event loop", "must be called from async context"
"""What asyncio and trio say in the loop of the other."""
CLOCK = "_canopen_world_as_clock"
"""The argument by which pytest-trio finds the clock of a test."""


class MasterToOpen:
    """Stands for the master of an async test, until its loop runs."""


class AsyncioMaster:
    """A master of a World for asyncio: `WorldMaster`, whose calls are awaited. master: that one."""

    def __init__(self, master: WorldMaster) -> None:
        self.master = master

    async def read(self, node_id: int, key: Key) -> Value:
        """Read an object by SDO; return its value. Raises SdoTransferError, UnexpectedLengthError."""
        return await self.run(read(self.master.node(node_id), key))

    async def write(self, node_id: int, key: Key, value: Value) -> None:
        """Write an object by SDO. Raises SdoTransferError."""
        await self.run(write(self.master.node(node_id), key, value))

    def command(self, command: NmtCommand, node_id: int = 0) -> None:
        """Send an NMT command. node_id: 0: to all nodes."""
        self.master.command(command, node_id)

    async def run(self, procedure: Procedure[T]) -> T:
        """Run a procedure to its end; return its result, or raise its error."""
        ended = asyncio.Event()
        request_id = self.master.start(procedure, ended.set)
        await ended.wait()
        result: T = self.master.result(request_id)
        return result


def hosted(test: Callable[..., Awaitable[T]], world: ProgramWorld) -> Callable[..., Awaitable[T]]:
    """Return an async test that checks whose time it has, and opens its master first."""

    @functools.wraps(test)
    async def run(**arguments: Any) -> T:
        __tracebackhide__ = True
        arguments.pop(CLOCK, None)
        in_trio = sniffio.current_async_library() == "trio"
        _check_time(world, in_trio)
        async with _opened(arguments, world, in_trio) as opened:
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
async def _opened(arguments: Mapping[str, Any], world: ProgramWorld, in_trio: bool) -> AsyncIterator[dict[str, Any]]:
    wanted = [name for name, value in arguments.items() if isinstance(value, MasterToOpen)]
    if not wanted:
        yield dict(arguments)
    elif in_trio:
        async with open_master("virtual:can0") as master:
            await trio.testing.wait_all_tasks_blocked()  # then it hears the boot-up of a device that the test makes first
            yield {**arguments, **dict.fromkeys(wanted, master)}
    else:
        yield {**arguments, **dict.fromkeys(wanted, AsyncioMaster(world.master()))}
