"""`open_master`: opens a master, and halts its drives when it is left.

**The way out.** However the `async with` block ends (its end, an error, a cancel, Ctrl-C, a bus that fails), the master takes no
new commands, cancels all procedures, halts every drive that is enabled, and waits until that is done and sent: SHUTDOWN_TIME at
most, or up to BRAKING_TIME for a drive that answers and still slows down. Chains that move along a path first brake on it, for
LONGEST_STOP at most; drives that no chain leads do not wait for that. Only then do its tasks end and its transports close.
The tasks are shielded all that time: without that a cancel would put nothing on the wire, and the drives would run on. If a
drive did not confirm that it stands, HaltNotConfirmedError is raised, or a note is added to the exception under way.

Another Ctrl-C on the way out only shortens it to SHUTDOWN_TIME. It reaches the main task, which only waits there; the
halts are sent by a task of their own. The KeyboardInterrupt leaves the block when the way out is over.

The block's own exception leaves it unchanged, never wrapped in a group: the nursery of the master's tasks does not see it.

**A bus that fails** ends the master: every waiting task gets BusError, the body is cancelled, and BusError leaves the block.
Drives on the other buses are halted as always.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack, ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final, TypeAlias

from canopen_master.errors import HALT_NOT_CONFIRMED, REALTIME_REFUSED, BusError, HaltNotConfirmedError, RealtimeRefusedError
from canopen_master.master import SDO_TIMEOUT, Master
from canopen_master.plain_text import clean
from canopen_master.seconds import check_seconds
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, Watchdog
from canopen_proto.machine import SECOND, LocalProtocolError
from canopen_transports import NarrowTransport, Transport, TransportError, open_transport
from canopen_transports.loop import current_loop, protected
from canopen_transports.realtime import Grant, Realtime

if TYPE_CHECKING:
    from canopen_master.machine_file import MachineFile

LOGGER: Final = logging.getLogger("canopen_master")

BusSource: TypeAlias = str | Transport
"""A locator, or an open transport; the master closes it."""

SHUTDOWN_TIME: Final = 2.0
"""Seconds that the way out may take: a person who pressed Ctrl-C does not wait longer for a dead drive. A drive that is seen to
brake is waited for (`procedures.steps.ask_for_time`)."""

BRAKING_TIME: Final = 30.0
"""Seconds that the way out may take while a drive still brakes."""


def open_master(
    *locators: BusSource,
    machine: MachineFile | str | Path | None = None,
    buses: Mapping[str, BusSource] | None = None,
    sdo_timeout: float | None = None,
    heartbeat_timeout: float | None = None,
    dictionary: ObjectDictionary | None = None,
    watchdog: Watchdog | None = DEFAULT_WATCHDOG,
    realtime: Realtime | bool | None = None,
) -> MasterSession:
    """Open a master of one or several buses: `async with open_master("socketcan:can0") as master: ...`

    locators: the buses, each named by its locator. buses: buses by names of your own, such as those of a chain file; several
    names may mean one bus. sdo_timeout: seconds (above 0) that a device may take for each answer; by default 0.5.
    heartbeat_timeout: seconds after which a node whose heartbeat stops is lost (chains then have their joints send
    heartbeats); by default 0, no supervision. dictionary: for nodes that are given none; by default that of the data files.
    watchdog: how drives notice that this master is gone, and stop: once it enables a drive, it sends its heartbeat as node
    127; None for none. See watchdog.py. realtime: what to ask the operating system for, so that SYNC is in time on a busy
    computer; True for `Realtime()`; by default nothing. `Master.realtime` and the log say what was given. It is for the
    thread that runs the loop; at the end it is given back.

    machine: a machine file, or what was read of one: its buses are opened, and its nodes, joints and chains are in `nodes`,
    `joints` and `chains` of the master. buses then replace those of the file, by their names. Arguments go before what the
    file says; a watchdog that is DEFAULT_WATCHDOG is not given. Raises DataError, DictionaryError with every error in the file;
    LocalProtocolError, with nothing opened, for an argument of another kind.

    Entering the block raises BusError if a bus cannot be opened, RealtimeRefusedError for `Realtime(required=True)`. On leaving
    it, see this module's text.
    """
    if sdo_timeout is not None:
        check_seconds("sdo_timeout", sdo_timeout, above_zero=True)
    if heartbeat_timeout is not None:
        check_seconds("heartbeat_timeout", heartbeat_timeout)
    settings = None if isinstance(realtime, bool) else realtime
    kinds = (("dictionary", dictionary, ObjectDictionary), ("watchdog", watchdog, Watchdog), ("realtime", settings, Realtime))
    for argument, given, kind in kinds:
        if given is not None and not isinstance(given, kind):
            raise LocalProtocolError(f"{argument} is {given!r}; give {kind.__name__}(...), or None")
    if buses is not None and not isinstance(buses, Mapping):
        raise LocalProtocolError(f'buses is {buses!r}; give locators by name, as {{"left": "socketcan:can0"}}')
    if isinstance(machine, str | Path):
        from canopen_master.machine_file import read_machine  # only here: most programs name their bus

        machine = read_machine(machine)
    named: dict[str, BusSource] = {}
    if machine is not None:
        if not hasattr(machine, "buses"):
            raise LocalProtocolError(f"machine is {machine!r}; give the path of a machine file, or what `read_machine` returns")
        if unknown := (buses or {}).keys() - machine.buses.keys():
            raise LocalProtocolError(f"{machine.source} has no bus {min(unknown)!r}{did_you_mean(min(unknown), machine.buses)}")
        named.update({bus.name: bus.locator for bus in machine.buses.values()})
        told = machine.master
        sdo_timeout = told.timeout / SECOND if sdo_timeout is None else sdo_timeout
        heartbeat_timeout = told.heartbeat_timeout / SECOND if heartbeat_timeout is None else heartbeat_timeout
        watchdog = told.watchdog if watchdog is DEFAULT_WATCHDOG else watchdog
        realtime = told.realtime if realtime is None else realtime
    for number, locator in enumerate(locators):
        name = locator if isinstance(locator, str) else getattr(locator, "locator", f"bus{number}")
        if name in named:
            raise LocalProtocolError(f"the bus {name} is named twice")
        named[name] = locator
    named.update(buses or {})
    for name, source in named.items():
        if not isinstance(source, str) and not hasattr(source, "receive"):
            raise LocalProtocolError(f'the locator of {name} is {source!r}; give one as "socketcan:can0", or an open transport')
    if not named:
        raise LocalProtocolError('a master needs a bus: open_master("virtual:demo")')

    def make(transports: Mapping[str, Transport], aliases: Mapping[str, str]) -> Master:
        master = Master(
            transports,
            aliases=aliases,
            sdo_timeout=SDO_TIMEOUT if sdo_timeout is None else sdo_timeout,
            heartbeat_timeout=heartbeat_timeout or 0.0,
            dictionary=dictionary,
            watchdog=watchdog,
        )
        if machine is not None:
            from canopen_master.assembly import assemble

            assemble(master, machine)
        return master

    return MasterSession(named, make, Realtime() if realtime is True else realtime or None)


class MasterSession:
    """The async context manager that `open_master` returns; to be entered once. sources: the buses, by name. make: makes the
    master of the open transports and their aliases. realtime: what is asked of the operating system; None: nothing."""

    def __init__(
        self,
        sources: Mapping[str, BusSource],
        make: Callable[[Mapping[str, Transport], Mapping[str, str]], Master],
        realtime: Realtime | None = None,
    ) -> None:
        self._realtime = realtime
        self._sources = sources
        self._make = make
        self._open_transports = AsyncExitStack()
        self._interrupts = ExitStack()  # closed when the drives stand, and the transports are closed
        self._is_halting = False

    @protected
    async def __aenter__(self) -> Master:
        try:
            grant = self._ask_for_realtime()
            self._master = self._make(*await self._open())
            self._master.realtime = () if grant is None else tuple(grant.measures)
            self._watch = current_loop().cancel_scope(shield=True)
            self._has_closed = current_loop().event()
            self._tasks = current_loop().open_nursery()
            self._nursery = await self._tasks.__aenter__()
        except BaseException:
            await self._close()
            raise
        self._nursery.start_soon(self._serve)
        if current_loop().cancels_at_end:
            self._nursery.start_soon(self._halt_when_cancelled)
        self._master.body.__enter__()
        return self._master

    @protected
    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool:
        master = self._master
        try:
            came = None if master.body.__exit__(kind, error, traceback) else error
        except BaseException as rest:  # noqa: BLE001 - a group without the Cancelled that was ours; raised again below
            came = rest
        self._begin_halt()
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
            else:  # also in place of Cancelled, which would take the note with it
                result = _not_confirmed(problems)
        if result is None:
            return True
        if result is error:
            return False
        raise result

    def hurry(self) -> None:
        """Shorten the way out to SHUTDOWN_TIME, as a Ctrl-C does that comes meanwhile."""
        self._nursery.cancel_scope.cancel()

    @protected
    async def _serve(self) -> None:
        """Run the pump until it is stopped, then close the transports."""
        try:
            await self._master.pump.run()
        finally:
            await self._close()
            self._interrupts.close()
            self._has_closed.set()

    @protected
    async def _halt_when_cancelled(self) -> None:
        """asyncio.run cancels all tasks at its end, also those of a master that nobody will leave any more, as when a generator
        that holds it was forgotten: the drives must be halted then."""
        with self._watch:
            await current_loop().cancelled_from_outside()
            LOGGER.warning("the event loop ends, and the master has not been left: its drives are halted now")
            self._begin_halt()
            with current_loop().cancel_scope(shield=True):  # who ends the loop waits for this task
                await self._has_closed.wait()

    def _begin_halt(self) -> None:
        if not self._is_halting:
            self._is_halting = True
            self._has_come = self._interrupts.enter_context(current_loop().interrupts_wait())
            self._watch.cancel()
            self._nursery.start_soon(self._halt)

    @protected
    async def _halt(self) -> None:
        """End the session: see this module's text."""
        try:
            begun = current_loop().current_time()
            with current_loop().cancel_scope(shield=True, deadline=begun + SHUTDOWN_TIME) as scope:
                await self._master.halt_and_flush(scope, begun + BRAKING_TIME, self._was_interrupted)
        finally:
            self._master.pump.stop()

    def _was_interrupted(self) -> bool:
        """Return whether a Ctrl-C came during the halt. On trio it cancels the nursery, and comes at its end."""
        return self._has_come() or (not current_loop().cancels_at_end and self._nursery.cancel_scope.cancel_called)

    def _ask_for_realtime(self) -> Grant | None:
        """Ask for what is wanted, and say what was given; it is given back when the session closes. Raises
        RealtimeRefusedError."""
        if self._realtime is None:
            return None
        grant = Grant(self._realtime)
        self._open_transports.callback(_give_back, grant)
        given = [each.name for each in grant.measures if not each.refusal]
        if given:
            LOGGER.info("real time: %s", ", ".join(given))
        for each in grant.refused:
            remedy = f". Try: {each.remedy}" if each.remedy else ""
            LOGGER.warning("real time: %s was not given (%s)%s", each.name, each.refusal, remedy)
        if grant.refused and self._realtime.required:
            failed = f"the operating system does not give {', '.join(each.name for each in grant.refused)}"
            seen = "; ".join(each.refusal for each in grant.refused)
            tries = tuple(dict.fromkeys(each.remedy for each in grant.refused if each.remedy))
            raise RealtimeRefusedError(REALTIME_REFUSED, failed, seen=seen, tries=(*tries, "canopen doctor"))
        return grant

    async def _open(self) -> tuple[dict[str, Transport], dict[str, str]]:
        """Open each bus once. Returns the transports by their first names, and the first names by the other ones."""
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
            if isinstance(transport, NarrowTransport) and transport.unheard:
                LOGGER.warning(
                    "%s: frames of others may not be heard here, as %s: if another SDO client uses a node too, "
                    "wrong values may count as read",
                    clean(name),
                    clean(transport.unheard),
                )
            self._open_transports.push_async_callback(transport.aclose)
        return transports, aliases

    async def _close(self) -> None:
        with current_loop().cancel_scope(shield=True):
            await self._open_transports.aclose()


def _give_back(grant: Grant) -> None:
    for problem in grant.end():
        LOGGER.warning("real time: it could not be given back: %s", problem)


def _is_only(error: BaseException, failure: Exception | None) -> bool:
    """Return whether an exception is the master's own failure, perhaps in a group of a nursery in the body."""
    if failure is not None and isinstance(error, BaseExceptionGroup):
        return all(_is_only(each, failure) for each in error.exceptions)
    return error is failure


def _is_interrupt(error: BaseException | None) -> bool:
    """Return whether an exception is a Ctrl-C, or a group with one in it."""
    if isinstance(error, BaseExceptionGroup):
        return error.subgroup(KeyboardInterrupt) is not None
    return isinstance(error, KeyboardInterrupt)


def _is_cancelled(error: BaseException) -> bool:
    """Return whether an exception is Cancelled, or a group of nothing else: the cancelled scope will catch it."""
    if isinstance(error, BaseExceptionGroup):
        return error.split(current_loop().Cancelled)[1] is None
    return isinstance(error, current_loop().Cancelled)


def _not_confirmed(problems: str) -> HaltNotConfirmedError:
    return HaltNotConfirmedError(
        HALT_NOT_CONFIRMED,
        "the master was left, but not every drive confirmed that it stands",
        seen=problems,
        cause="the drive is off, does not answer, or needs long to stop",
        tries=("look at the drive; press the emergency stop if it moves",),
    )
