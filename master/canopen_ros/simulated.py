"""Simulated devices for all nodes of a machine, on virtual buses in the process of the node: `simulate:=true`."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import replace
from functools import partial
from typing import Final

import trio

from canopen_data.drive_from_file import drive_dictionary_of, drive_obstacle
from canopen_master.machine_file import MachineFile, NodeEntry
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.simulation.host import DeviceMaker, DeviceModel, Host, simulate
from canopen_proto.drives.cia402.names import is_drive
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from canopen_transports import open_transport

BOOT_TIME: Final = 0.05
"""Seconds from power-on until the boot-up frames are sent."""

_POWERBALL: Final = DriveSettings(shape=Shape.SCHUNK_POWERBALL, track=Track(home_switch=(0.0, math.inf)))
"""The home switch is active from the middle to the positive end. With one in the middle only, homing from beyond it would run
into the limit switch."""


def on_virtual_buses(machine: MachineFile) -> MachineFile:
    """Return the machine with a virtual bus in the place of each of its buses."""
    buses = {name: replace(bus, locator=f"virtual:{name}", bitrate=None) for name, bus in machine.buses.items()}
    return replace(machine, buses=buses)


@asynccontextmanager
async def simulated_machine(machine: MachineFile) -> AsyncIterator[Mapping[str, Host]]:
    """Serve all devices of a machine, simulated, while the block runs. Yields what serves them, by the name of the bus.

    A node without a file is a joint of Schunk's Powerball arm. Raises DataError, DictionaryError for a file that cannot be used.
    """
    files = Dictionaries(machine)
    made: dict[str, list[DeviceMaker]] = {}
    for node in machine.nodes.values():
        made.setdefault(node.bus, []).append(_maker(node, files))
    failure: BaseException | None = None
    async with trio.open_nursery() as nursery:
        hosts = {}
        for bus, makers in made.items():
            hosts[bus] = await nursery.start(simulate, await open_transport(machine.buses[bus].locator), makers)
        await trio.sleep(BOOT_TIME)
        try:
            yield hosts
        except BaseException as error:  # noqa: BLE001 - raised below: the nursery would make a group of it
            failure = error
        nursery.cancel_scope.cancel()
    if failure is not None:
        raise failure


def _maker(node: NodeEntry, files: Dictionaries) -> DeviceMaker:
    description = files.description_of(node)
    if description is None:
        return partial(DriveNode, node_id=node.node_id, settings=_POWERBALL)
    dictionary, shape = description.dictionary, Shape.STANDARD
    if "schunk" in description.device_info.vendor_name.casefold() or node.device.shape == "schunk":
        shape = Shape.SCHUNK_POWERBALL
    if node.device.profile == "none" or not is_drive(dictionary) or drive_obstacle(dictionary):
        return DeviceModel(dictionary, node.node_id)
    dictionary, _ = drive_dictionary_of(dictionary, shape)
    return DeviceModel(dictionary, node.node_id, DriveSettings(shape=shape, stops_at_switches=False))
