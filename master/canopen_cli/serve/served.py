"""What the commands that serve a machine share: its buses, and the life of a door from its address to its end.

The machine is the bus of -b, or all buses of the machine file; with `-b demo` it is simulated.
"""

from __future__ import annotations

import gc
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Iterator
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager, contextmanager
from typing import Protocol, Self, TypeVar

import trio

from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import DEMO, Settings
from canopen_cli.shared.problem import usage
from canopen_cli.shared.running import first_error, run_until_interrupted
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.session import open_session
from canopen_cli.simulation.devices import teller
from canopen_gateway import GatewayService, Permission, open_gateway
from canopen_master.machine_file import MachineFile
from canopen_master.master import Master
from canopen_master.session import open_master
from canopen_master.simulated_machine import devices_of_machine
from canopen_master.simulation.serving import simulated_devices, virtual_buses


class ServedDoor(Protocol):
    """A door of a gateway, which has its address already. failure: why it was closed, or None."""

    failure: Exception | None

    async def __aenter__(self) -> Self: ...

    async def __aexit__(self, *exc: object) -> None: ...

    async def serve(self, service: GatewayService, begun: Callable[[], object]) -> None:
        """Serve clients until cancelled, or until the door itself fails. begun: called once it serves."""


D = TypeVar("D", bound=ServedDoor)


def serve_door(
    settings: Settings,
    screen: Screen,
    bind: Callable[[], Awaitable[D]],
    opened: Callable[[], AbstractAsyncContextManager[GatewayService]],
    tell: Callable[[D, GatewayService], None],
    seconds: float,
) -> None:
    """Serve a door until Ctrl-C. bind: gives it its address, before anything else: a port in use is told while nothing moves yet.
    opened: the machine. tell: says where the door is, once it serves. seconds: end after this time from then on. Raises why the
    door failed, too."""

    @first_error()
    async def serve() -> None:
        door = await bind()
        over = trio.CancelScope()

        def begun() -> None:
            tell(door, service)
            over.deadline = trio.current_time() + seconds

        async with door, opened() as service:
            with _old_objects_at_rest(), over:
                await door.serve(service, begun)
        if door.failure is not None:
            raise door.failure

    run_until_interrupted(settings, screen, serve)


@contextmanager
def _old_objects_at_rest() -> Iterator[None]:
    """Let the garbage collector leave alone, while the block runs, what was imported and read before: it would take 35 ms to look
    at all of it, again and again, and that is three cycles of 10 ms (benchmarks/web_clients.py)."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@asynccontextmanager
async def open_service(settings: Settings, screen: Screen, allow: Collection[Permission]) -> AsyncIterator[GatewayService]:
    """Open the buses, and a gateway to them, while the block runs. Raises as `open_served`."""
    async with open_served(settings, screen) as master, open_gateway(master, allow=allow) as service:
        yield service


@asynccontextmanager
async def open_served(settings: Settings, screen: Screen) -> AsyncIterator[Master]:
    """Open the buses while the block runs. Raises as `open_with_files`."""
    async with open_with_files(settings, screen) as (master, _):
        yield master


@asynccontextmanager
async def open_with_files(settings: Settings, screen: Screen) -> AsyncIterator[tuple[Master, NodeFiles | None]]:
    """Open the buses while the block runs; and the files of the nodes of the bus of -b. None: the machine file names those of all
    its nodes, and the master has them. Raises a CommandError, BusError, DataError, DictionaryError."""
    machine = settings.machine_file()
    if machine is None:
        async with open_session(settings, screen) as session:
            for node_id in session.files.node_ids:  # whoever asks for it later gets it as its file describes it
                session.node(node_id)
            yield session.master, session.files
        return
    locators = locators_of(settings, machine)
    async with AsyncExitStack() as stack:
        if settings.bus == DEMO:
            made = devices_of_machine(machine, locators, settings.overlays, teller(screen))
            await stack.enter_async_context(simulated_devices(dict(made.values())))
        opened = open_master(machine=machine, buses=locators, sdo_timeout=settings.sdo_timeout, watchdog=settings.watchdog)
        yield await stack.enter_async_context(opened), None


def locators_of(settings: Settings, machine: MachineFile) -> dict[str, str]:
    """Return the locators of the buses of a machine, by name, as far as -b replaces those of the file. Raises a CommandError."""
    if settings.bus == DEMO:
        return virtual_buses(machine.buses)
    if settings.bus is None or settings.bus in machine.buses:
        return {}
    if len(machine.buses) > 1:
        names = ", ".join(machine.buses)
        raise usage("CO121", f"-b: {machine.source} has the buses {names}", tries=("the same without -b",))
    return dict.fromkeys(machine.buses, settings.bus)
