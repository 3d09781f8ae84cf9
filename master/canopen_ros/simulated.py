"""Simulated devices for all nodes of a machine, on virtual buses in the process of the node: `simulate:=true`."""

from __future__ import annotations

import logging
from contextlib import AbstractAsyncContextManager
from dataclasses import replace
from typing import Final

from canopen_master.machine_file import MachineFile
from canopen_master.simulated_machine import devices_of_machine
from canopen_master.simulation.serving import SimulatedDevices, simulated_devices

_LOGGER: Final = logging.getLogger("canopen_master")


def on_virtual_buses(machine: MachineFile) -> MachineFile:
    """Return the machine with a virtual bus in the place of each of its buses."""
    buses = {name: replace(bus, locator=f"virtual:{name}", bitrate=None) for name, bus in machine.buses.items()}
    return replace(machine, buses=buses)


def simulated_machine(machine: MachineFile) -> AbstractAsyncContextManager[SimulatedDevices]:
    """Serve all devices of a machine while the block runs, as `canopen sim` does.

    A node without a file is a joint of the manual's arm. What scripts say goes to the logger `canopen_master`. Raises as
    `devices_of_machine` and `simulated_devices`.
    """
    return simulated_devices(dict(devices_of_machine(machine).values()), say=_LOGGER.warning)
