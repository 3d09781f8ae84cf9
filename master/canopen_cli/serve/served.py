"""The machine that `canopen serve` serves: the bus of -b, or all buses of the machine file; with `-b demo` simulated."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

from canopen_cli.shared.options import DEMO, Settings
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.session import open_session
from canopen_cli.simulation.devices import teller
from canopen_master.machine_file import MachineFile
from canopen_master.master import Master
from canopen_master.session import open_master
from canopen_master.simulated_machine import devices_of_machine
from canopen_master.simulation.serving import simulated_devices, virtual_buses


@asynccontextmanager
async def open_served(settings: Settings, screen: Screen) -> AsyncIterator[Master]:
    """Open the buses while the block runs. Raises a CommandError, BusError, DataError, DictionaryError."""
    machine = settings.machine_file()
    if machine is None:
        async with open_session(settings, screen) as session:
            yield session.master
        return
    locators = locators_of(settings, machine)
    async with AsyncExitStack() as stack:
        if settings.bus == DEMO:
            made = devices_of_machine(machine, locators, settings.overlays, teller(screen))
            await stack.enter_async_context(simulated_devices(dict(made.values())))
        opened = open_master(machine=machine, buses=locators, sdo_timeout=settings.sdo_timeout, watchdog=settings.watchdog)
        yield await stack.enter_async_context(opened)


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
