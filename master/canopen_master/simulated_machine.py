"""The simulated devices of a machine file: all devices of its buses, or the drives of its joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from canopen_master.machine_file import MachineFile
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_master.simulation.device_files import MakingEvent, models_of
from canopen_master.simulation.drive_files import DriveFile, drive_of
from canopen_master.simulation.host import DeviceMaker
from canopen_master.simulation.plant import DeviceEntry
from canopen_master.simulation.serving import drive_maker
from canopen_proto.simulation.drive.settings import SYNC_TOLERANCE, Shape


def devices_of_machine(
    machine: MachineFile,
    buses: Mapping[str, str] | None = None,
    overlays: Sequence[str] = (),
    tell: Callable[[MakingEvent], object] = lambda event: None,
) -> dict[str, tuple[str, list[DeviceMaker]]]:
    """Return the locator of each bus of a machine that has nodes, and the simulated devices on it, by the name of the bus.

    buses: locators by name, to simulate these buses only. overlays: side files for all devices, below their own. tell: as of
    `models_of`. A node without a file is a joint of the manual's arm. Raises as `models_of`.
    """

    def beside(entry: DeviceEntry) -> DeviceEntry:
        own = (*overlays, *map(machine.path, entry.overlays))
        return replace(entry, file=machine.path(entry.file), script=machine.path(entry.script), overlays=own)

    made: dict[str, tuple[str, list[DeviceMaker]]] = {}
    for name, locator in ({bus.name: bus.locator for bus in machine.buses.values()} if buses is None else buses).items():
        nodes = [node for node in machine.nodes.values() if node.bus == name]
        described = models_of([beside(node.device) for node in nodes if node.device.file], tell)
        joints = [
            drive_maker(number, node.node_id, sync_tolerance=SYNC_TOLERANCE)
            for number, node in enumerate(nodes)
            if not node.device.file
        ]
        if nodes:
            made[name] = locator, [*described, *joints]
    return made


def drives_of_machine(machine: MachineFile, *, defaults: bool = False) -> dict[str, DriveFile]:
    """Return the files of a machine's joints, by their names; joints without a file are left out. defaults: as of `drive_of`.

    Raises DataError, DictionaryError for a file that cannot be used, NoDriveInFileError.
    """
    dictionaries = Dictionaries(machine)
    made = {}
    for joint in machine.joints.values():
        node = machine.nodes[joint.node]
        description = dictionaries.description_of(node)
        if description is not None:
            file = drive_of(description, defaults=defaults or node.device.defaults)
            made[joint.name] = replace(file, shape=Shape(node.device.shape)) if node.device.shape else file
    return made
