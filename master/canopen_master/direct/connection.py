"""`Connection`: a master in the background, perhaps with simulated drives beside it.

A command that takes time and may fail is an `attempt`: it returns True or False, and `last_error` says why. The error is kept for
each thread, like C's errno, so that threads do not read each other's.
"""

from __future__ import annotations

import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from functools import partial
from typing import Final, TypeVar

import trio

from canopen_data import DataError, load_dictionary
from canopen_data.findings import DictionaryError
from canopen_master.blocking.background import Background
from canopen_master.errors import MASTER_CLOSED, MasterClosedError, MasterError
from canopen_master.machine_file import MachineFile
from canopen_master.master import Master
from canopen_master.participant.dispatch import ProcedureTakenBackError
from canopen_master.participant.patient_clock import PatientClock
from canopen_master.session import MasterSession, open_master
from canopen_master.simulation.host import IN_PROCESS, DeviceMaker, powerballs, simulate
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, Watchdog
from canopen_proto.procedures.steps import ProcedureError
from canopen_transports import TransportError, open_transport
from canopen_transports.loop.beside import beside
from canopen_transports.realtime import Realtime

R = TypeVar("R")

OPENING_ERRORS: Final = (MasterError, TransportError, DataError, DictionaryError)
"""The errors for which `open` returns False."""


class NotConnectedError(MasterError):
    """There is no open connection. failed: what could not be done, for the text."""

    def __init__(self, failed: str = "there is no open connection") -> None:
        super().__init__(MASTER_CLOSED, failed, tries=("open_connection(bus) first",))


class AlreadyConnectedError(MasterError):
    """A connection is open already, and a session has only one. bus: its locator."""

    def __init__(self, bus: str) -> None:
        super().__init__(MASTER_CLOSED, f"the connection to {bus} is still open", tries=("close_connection() first",))


class Connection:
    """At most one open master at a time; see this module's text. bus: the open one, "" while none is."""

    def __init__(self) -> None:
        self.bus = ""
        self._background: Background[Master] | None = None
        self._lock = threading.Lock()  # open and close, one at a time
        self._errors = threading.local()
        self._simulated: list[tuple[str, Sequence[DeviceMaker]]] = []

    @property
    def is_open(self) -> bool:
        """Whether the connection takes commands."""
        return self._background is not None and self._background.is_running

    @property
    def is_simulated(self) -> bool:
        """Whether the drives of the next connection are simulated in this process."""
        return bool(self._simulated)

    @property
    def last_error(self) -> Exception | None:
        """Why the last attempt of the calling thread returned False; None if it returned True, or there was none."""
        error: Exception | None = getattr(self._errors, "last", None)
        return error

    @contextmanager
    def simulated(self, node_ids: Sequence[int], bus: str) -> Iterator[None]:
        """Simulate joints on a bus for connections that are opened in the block; leaving the block closes the connection.
        node_ids: one for each joint. bus: the locator of a virtual bus."""
        entry = bus, powerballs(*node_ids, sync_tolerance=IN_PROCESS, waits_for_sync=True)
        self._simulated.append(entry)
        try:
            yield
        finally:
            self._simulated.remove(entry)
            self.close()

    def open(
        self,
        bus: str,
        buses: Mapping[str, str],
        sdo_timeout: float | None = None,
        dictionary: ObjectDictionary | None = None,
        watchdog: Watchdog | None = DEFAULT_WATCHDOG,
        prepare: Callable[[Master], object] = lambda _: None,
        machine: MachineFile | None = None,
        realtime: Realtime | bool | None = None,
    ) -> bool:
        """Open the buses and begin the master's thread. buses: further ones, by name; those of a machine go before them.

        prepare: called with the master at once.

        sdo_timeout: s, None: the default. watchdog, realtime: as of `open_master`.
        """
        with self._lock:
            try:
                if self.is_open:
                    raise AlreadyConnectedError(self.bus)
                self._end()
                if dictionary is None:
                    dictionary, _ = load_dictionary()  # now, so that a fault in the files is raised now
                named = {**buses} if machine is not None else {bus: bus, **buses}
                options = partial(
                    open_master,
                    machine=machine,
                    buses=named,
                    sdo_timeout=sdo_timeout,
                    dictionary=dictionary,
                    watchdog=watchdog,
                    realtime=realtime,
                )
                make = partial(_master, tuple(self._simulated), options, prepare)
                background = Background(make, lambda master: master.failure, clock=self._clock(named.values(), machine))
                background.start()
            except OPENING_ERRORS as error:
                self._errors.last = error
                return False
            self._background, self.bus = background, bus
            self._errors.last = None
            return True

    def close(self) -> None:
        """Halt what moves and end the thread. Without an open connection it does nothing.

        Raises HaltNotConfirmedError, or BusError if the bus failed and no call has met that error yet.
        """
        with self._lock:
            self._end()

    def call(self, function: Callable[[Master], Awaitable[R]]) -> R:
        """Run an async function of the master in its thread. Returns and raises as that; NotConnectedError without a master."""
        background = self._background
        if background is None:
            raise NotConnectedError
        return background.call(function)

    def attempt(self, function: Callable[[Master], Awaitable[object]]) -> bool:
        """Call as `call` does; return True for success, False if a bus or a device failed (`last_error`). function: gets the
        master, and runs in its thread.

        A wrong call raises: no connection, a node-ID of 200, an unknown name, a value that does not fit.
        """
        try:
            self.call(function)
        except (NotConnectedError, MasterClosedError):
            raise
        except (ProcedureError, ProcedureTakenBackError, MasterError) as error:
            self._errors.last = error
            return False
        self._errors.last = None
        return True

    def _clock(self, locators: Iterable[str], machine: MachineFile | None) -> PatientClock | None:
        """Return the clock of a world that is in this process as a whole; None if nothing is simulated, or a bus leads out."""
        more = () if machine is None else (bus.locator for bus in machine.buses.values())
        simulated = (bus for bus, _ in self._simulated)
        is_apart = all(each.partition(":")[0] == "virtual" for each in (*locators, *more, *simulated))
        return PatientClock() if self._simulated and is_apart else None

    def _end(self) -> None:
        background, self._background, self.bus = self._background, None, ""
        if background is not None:
            error = background.stop()
            if error is not None:
                raise error


@asynccontextmanager
async def _master(
    simulated: Sequence[tuple[str, Sequence[DeviceMaker]]],
    open_it: Callable[[], MasterSession],
    prepare: Callable[[Master], object],
) -> AsyncIterator[Master]:
    """Open the master inside the simulated drives: they must outlive it, because it halts them at its end."""
    async with AsyncExitStack() as stack:
        if simulated:
            nursery = await stack.enter_async_context(beside(trio.open_nursery()))
        for locator, devices in simulated:
            await nursery.start(simulate, await open_transport(locator), devices)
        async with open_it() as master:
            prepare(master)
            yield master
