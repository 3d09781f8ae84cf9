"""`open_master`: how a master comes and goes.

**The way out.** However the `async with` block ends (its end, an error, a cancel, Ctrl-C, a bus that fails), the master takes no
new commands, cancels all procedures, halts every drive that is enabled, and waits until that is done and sent: SHUTDOWN_TIME at
most, or up to BRAKING_TIME for a drive that answers and still slows down. Only then do its tasks end and its transports close.
The tasks are shielded all that time: without that a cancel would put nothing on the wire, and the drives would run on. Drives
that did not confirm that they stand are told by HaltNotConfirmed, or in a note on the exception that is under way.

A further Ctrl-C on the way out shortens it to SHUTDOWN_TIME, and no more. trio raises it in the main task, which only waits
there; the halts go out in a task of their own. It comes out of the block when the way out is over.

The block's own exception comes out as it is, never wrapped in a group: the nursery of the master's tasks does not see it.

**A bus that fails** takes the master with it: whoever waits gets BusError, the body is cancelled, and BusError comes out of the
block. Drives on the other buses are halted as ever.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack
from types import TracebackType
from typing import Final, TypeAlias

import trio
from trio.lowlevel import enable_ki_protection

from canopen_master.errors import HALT_NOT_CONFIRMED, BusError, HaltNotConfirmed
from canopen_master.master import SDO_TIMEOUT, Master
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.machine import LocalProtocolError
from canopen_proto.procedures.grip import DEFAULT_GRIP, Grip
from canopen_transports import Transport, TransportError, open_transport

BusSource: TypeAlias = str | Transport
"""A locator, or a transport that is open already; the master closes it."""

SHUTDOWN_TIME: Final = 2.0
"""Seconds that the way out may take: a person who pressed Ctrl-C does not wait longer for a drive that is dead. A drive that is
seen to brake is waited for (`procedures.steps.ask_for_time`)."""

BRAKING_TIME: Final = 30.0
"""Seconds that the way out may take if a drive brakes as long as that."""


def open_master(
    *locators: BusSource,
    buses: Mapping[str, BusSource] | None = None,
    sdo_timeout: float = SDO_TIMEOUT,
    heartbeat_timeout: float = 0.0,
    dictionary: ObjectDictionary | None = None,
    grip: Grip | None = DEFAULT_GRIP,
) -> MasterSession:
    """The master of one or several buses: `async with open_master("socketcan:can0") as master: ...`

    locators: the buses, each known by its locator. buses: buses by names of your own, such as those that a chain file uses;
    several names may mean one bus. Times in seconds: sdo_timeout, for each answer of a device; heartbeat_timeout, after which a
    node whose heartbeat stops is lost, 0 for no supervision (a chain that initialises its joints then has them send heartbeats).
    dictionary: for nodes that are given none; by default that of the data files. grip: how drives notice that this master is
    gone, and stop: once it enables one, it sends its heartbeat as node 127. None to have none of that. See grip.py.

    On entering: BusError for a bus that cannot be opened. On leaving: see this module's text.
    """
    named: dict[str, BusSource] = {}
    for number, locator in enumerate(locators):
        name = locator if isinstance(locator, str) else getattr(locator, "locator", f"bus{number}")
        if name in named:
            raise LocalProtocolError(f"the bus {name} is named twice")
        named[name] = locator
    named.update(buses or {})
    if not named:
        raise LocalProtocolError('a master needs a bus: open_master("virtual:demo")')

    def make(transports: Mapping[str, Transport], aliases: Mapping[str, str]) -> Master:
        return Master(
            transports,
            aliases=aliases,
            sdo_timeout=sdo_timeout,
            heartbeat_timeout=heartbeat_timeout,
            dictionary=dictionary,
            grip=grip,
        )

    return MasterSession(named, make)


class MasterSession:
    """What `open_master` gives: an async context manager, to be entered once."""

    def __init__(
        self, sources: Mapping[str, BusSource], make: Callable[[Mapping[str, Transport], Mapping[str, str]], Master]
    ) -> None:
        self._sources = sources
        self._make = make
        self._open_transports = AsyncExitStack()

    @enable_ki_protection
    async def __aenter__(self) -> Master:
        try:
            self._master = self._make(*await self._open())
            self._tasks = trio.open_nursery()
            self._nursery = await self._tasks.__aenter__()
        except BaseException:
            await self._close()
            raise
        self._nursery.start_soon(self._serve)
        self._master.body.__enter__()
        return self._master

    @enable_ki_protection
    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool:
        master = self._master
        try:
            came = None if master.body.__exit__(kind, error, traceback) else error
        except BaseException as rest:  # noqa: BLE001 - of a group, the Cancelled that was ours was taken out; raised again below
            came = rest
        self._nursery.start_soon(self._halt)
        try:
            await self._tasks.__aexit__(None, None, None)
        except BaseExceptionGroup as late:  # a Ctrl-C on the way out, or a bug there
            came = came if _is_interrupt(came) else late.exceptions[0]
        ours = came is None or _is_only(came, master.failure)
        result = master.failure if ours else came
        problems = "; ".join(f"{halt.where}: {halt.problem}" for halt in master.halts if halt.problem)
        if problems:
            if result is not None and not _is_cancelled(result):
                result.add_note(f"not confirmed to stand: {problems}")
            else:  # in place of Cancelled, too: a note on that would be lost with it
                result = _not_confirmed(problems)
        if result is None:
            return True
        if result is error:
            return False
        raise result

    @enable_ki_protection
    async def _serve(self) -> None:
        """Run the pump until it is stopped, then close the transports."""
        try:
            await self._master.pump.run()
        finally:
            await self._close()

    @enable_ki_protection
    async def _halt(self) -> None:
        """The way out: see this module's text."""
        try:
            begun = trio.current_time()
            with trio.CancelScope(shield=True, deadline=begun + SHUTDOWN_TIME) as scope:
                await self._master.halt_and_flush(scope, begun + BRAKING_TIME, self._was_interrupted)
        finally:
            self._master.pump.stop()

    def _was_interrupted(self) -> bool:
        """Whether a Ctrl-C came on the way out: it cancels the nursery in whose end it is raised."""
        return self._nursery.cancel_scope.cancel_called

    async def _open(self) -> tuple[dict[str, Transport], dict[str, str]]:
        """Open the buses, each once: the transports by name, and the names beyond the first of each."""
        transports: dict[str, Transport] = {}
        aliases: dict[str, str] = {}
        first_names: dict[object, str] = {}
        for name, source in self._sources.items():
            key = source if isinstance(source, str) else id(source)
            if key in first_names:
                aliases[name] = first_names[key]
                continue
            first_names[key] = name
            try:
                transport = await open_transport(source) if isinstance(source, str) else source
            except TransportError as error:
                raise BusError(name, error) from error
            transports[name] = transport
            self._open_transports.push_async_callback(transport.aclose)
        return transports, aliases

    async def _close(self) -> None:
        with trio.CancelScope(shield=True):
            await self._open_transports.aclose()


def _is_only(error: BaseException, failure: Exception | None) -> bool:
    """Whether an exception is the master's own failure, be it in a group that a nursery of the body made of it."""
    if failure is not None and isinstance(error, BaseExceptionGroup):
        return all(_is_only(each, failure) for each in error.exceptions)
    return error is failure


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether an exception is a Ctrl-C, or a group that bears one."""
    if isinstance(error, BaseExceptionGroup):
        return error.subgroup(KeyboardInterrupt) is not None
    return isinstance(error, KeyboardInterrupt)


def _is_cancelled(error: BaseException) -> bool:
    """Whether an exception ends with the scope that was cancelled: Cancelled, or a group of nothing else."""
    if isinstance(error, BaseExceptionGroup):
        return error.split(trio.Cancelled)[1] is None
    return isinstance(error, trio.Cancelled)


def _not_confirmed(problems: str) -> HaltNotConfirmed:
    return HaltNotConfirmed(
        HALT_NOT_CONFIRMED,
        "the master was left, but not every drive confirmed that it stands",
        seen=problems,
        cause="the drive is off, does not answer, or needs long to stop",
        tries=("look at the drive; press the emergency stop if it moves",),
    )
