"""The devices of `canopen sim`: make models of devices from their files and the options."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import click

from canopen_cli.shared.options import NodeIds, Settings
from canopen_cli.shared.overlays import overlaid
from canopen_cli.shared.problem import ExitCode, Problem, usage
from canopen_cli.shared.screen import Screen, escape, node_text
from canopen_data import load_dictionary
from canopen_data.configured import configure, without_configured_values
from canopen_data.describing import identified
from canopen_data.description import DeviceDescription
from canopen_data.device_notices import notices_of
from canopen_data.drive_from_file import drive_dictionary_of, drive_obstacle
from canopen_data.named_files import read_text
from canopen_data.toml_file import parse_toml
from canopen_master.machine_file import MachineFile
from canopen_master.simulation.fleet import SERIAL, drive_maker, with_serial
from canopen_master.simulation.hooks import Script
from canopen_master.simulation.host import DeviceMaker, DeviceModel
from canopen_master.simulation.plant import DeviceEntry, Plant, parse_plant
from canopen_proto import indices
from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary import NotInDictionary, ObjectDictionary, Variable
from canopen_proto.drives.cia402.names import is_drive, with_drive_names
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.lss.messages import UNCONFIGURED
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive.settings import SYNC_TOLERANCE, DriveSettings, Shape

SHAPES: Final = {"schunk": Shape.SCHUNK_POWERBALL, "standard": Shape.STANDARD}
PLANT_SUFFIX: Final = ".toml"
MAX_NOTICES: Final = 5
"""Notices about a device that are shown, line by line; the rest is counted, and shown with -v."""

_WITH_IDS: Final = re.compile(r"([0-9][0-9A-Fa-fxX,-]*)=(.+)")


class SimulatedIds(NodeIds):
    """Node-IDs of simulated devices: "1-32,40"; 255 for a device without one, as often as there are such devices."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        if isinstance(value, tuple):
            return value
        parts = str(value).split(",")
        without = [part for part in parts if part.strip().lower() in ("255", "0xff")]
        others = ",".join(part for part in parts if part not in without)
        return (super().convert(others, param, ctx) if others else ()) + (UNCONFIGURED,) * len(without)


def wanted(files: Sequence[str], node_ids: tuple[int, ...] | None, common: DeviceEntry) -> Plant:
    """Return the devices that the arguments name: "5=drive.eds", "drive.eds" with --id, "plant.toml".

    common: the options for all of them. Raises Problem, DictionaryError.
    """
    plants = [name for name in files if name.lower().endswith(PLANT_SUFFIX)]
    if plants:
        if len(files) > 1:
            raise usage(
                "CO127", f"{plants[0]} is a plant file, which names all devices itself", tries=(f"canopen sim {plants[0]}",)
            )
        path = Path(plants[0])
        plant = parse_plant(read_text(path), str(path))
        return replace(
            plant, devices=tuple(_beside(path, each, common) for each in plant.devices), state=_path(path, plant.state)
        )
    entries = []
    for name in files:
        match = None if Path(name).exists() else _WITH_IDS.fullmatch(name)
        ids = () if match is None else SimulatedIds().convert(match[1], None, None)
        entries.append(replace(common, file=name if match is None else match[2], node_ids=ids))
    if node_ids is not None:
        if len(entries) > 1 or entries[0].node_ids:
            raise usage("CO127", "--id is for one file", tries=("canopen sim 5=a.eds 6=b.eds     node-IDs of several",))
        entries = [replace(entries[0], node_ids=node_ids)]
    return Plant(tuple(entries))


def machine_of(files: Sequence[str], settings: Settings) -> MachineFile | None:
    """Return the machine to simulate: that of the only argument, or without arguments that of -m; None if there is none.

    A file with [buses] is a machine file, one with [[device]] a plant file. Raises Problem, DictionaryError.
    """
    if not files:
        return settings.machine_file()
    path = Path(files[0])
    if len(files) > 1 or path.suffix.lower() != PLANT_SUFFIX or "buses" not in parse_toml(read_text(path), str(path)):
        return None
    settings.machine = path
    return settings.machine_file()


def devices_of(machine: MachineFile, settings: Settings, screen: Screen) -> dict[str, tuple[str, list[DeviceMaker]]]:
    """Return the locator of each bus of a machine, and the simulated devices on it; with -b of that bus only. Raises Problem."""
    buses = {bus.name: bus.locator for bus in machine.buses.values()}
    if settings.bus is not None:
        locator = settings.required_bus()
        buses = {settings.chosen.bus: locator}
    return devices_on(buses, machine, settings, screen)


def devices_on(
    buses: Mapping[str, str], machine: MachineFile, settings: Settings, screen: Screen
) -> dict[str, tuple[str, list[DeviceMaker]]]:
    """Return the locator of each of these buses that has nodes, and the simulated devices on it. buses: locators by name.

    A node without a file is a joint of the manual's arm. Raises Problem.
    """
    made: dict[str, tuple[str, list[DeviceMaker]]] = {}
    for name, locator in buses.items():
        nodes = [node for node in machine.nodes.values() if node.bus == name]
        described = models([_beside_machine(machine, node.device, settings) for node in nodes if node.device.file], screen)
        joints = [
            drive_maker(number, node.node_id, sync_tolerance=SYNC_TOLERANCE)
            for number, node in enumerate(nodes)
            if not node.device.file
        ]
        if nodes:
            made[name] = locator, [*described, *joints]
    return made


def _beside_machine(machine: MachineFile, entry: DeviceEntry, settings: Settings) -> DeviceEntry:
    overlays = (*settings.overlays, *map(machine.path, entry.overlays))
    return replace(entry, file=machine.path(entry.file), script=machine.path(entry.script), overlays=overlays)


def _path(plant: Path, name: str) -> str:
    return str(plant.parent / name) if name else ""


def _beside(plant: Path, entry: DeviceEntry, common: DeviceEntry) -> DeviceEntry:
    """Complete an entry of a plant file. Paths are relative to that file; the options fill in what it leaves out."""
    return replace(
        entry,
        file=_path(plant, entry.file) if (plant.parent / entry.file).exists() else entry.file,  # else the name of a sample
        script=_path(plant, entry.script) or common.script,
        overlays=(*common.overlays, *(_path(plant, name) for name in entry.overlays)),
        profile=entry.profile if entry.profile != "auto" else common.profile,
        shape=entry.shape or common.shape,
        defaults=entry.defaults or common.defaults,
        encoding=entry.encoding or common.encoding,
    )


def models(entries: Iterable[DeviceEntry], screen: Screen) -> list[DeviceModel]:
    """Make the models of the devices. Tells what each is, and what in its file does not work. Raises Problem."""
    names, _ = load_dictionary()
    made: list[DeviceModel] = []
    for entry in entries:
        description = _load(entry, names, screen)
        script = _script(entry.script)
        for node_id in _node_ids(entry, description):
            if node_id != UNCONFIGURED and any(model.node_id == node_id for model in made):
                raise usage("CO127", f"there are two devices of node-ID {node_id}", tries=("give each its own: 5=a.eds 6=b.eds",))
            if node_id == UNCONFIGURED:
                description = _with_own_serial(entry, description, len(made))
            made.append(_model(entry, description, node_id, script, len(made), screen))
    return made


def _with_own_serial(entry: DeviceEntry, description: DeviceDescription, number: int) -> DeviceDescription:
    """Give a device without a node-ID a serial number of its own, counting on from that of its file: LSS needs it."""
    variable = description.dictionary.get(indices.IDENTITY_OBJECT, SERIAL)
    if variable is None or any(description.dictionary.variable(key).mux == variable.mux for key in entry.values):
        return description
    first = variable.initial_of(UNCONFIGURED)
    serial = (first if isinstance(first, int) else 0) + (number > 0)
    return replace(description, dictionary=with_serial(description.dictionary, serial, UNCONFIGURED))


def _load(entry: DeviceEntry, names: ObjectDictionary, screen: Screen) -> DeviceDescription:
    from canopen_cli.shared.eds_files import tell_faults
    from canopen_data.descriptions import with_names  # the readers are imported only if there is a file
    from canopen_data.named_files import open_description

    file = open_description(entry.file, entry.encoding)
    tell_faults(screen, file)
    description = with_names(file.description, names)
    dictionary = with_drive_names(identified(description))
    if entry.defaults:
        dictionary = without_configured_values(dictionary)
    return replace(description, dictionary=overlaid(dictionary, entry.overlays, screen))


def _script(path: str) -> Script | None:
    return Script(read_text(Path(path)), path) if path else None


def _node_ids(entry: DeviceEntry, description: DeviceDescription) -> tuple[int, ...]:
    if entry.node_ids:
        return entry.node_ids
    node_id = description.node_id
    if node_id is None or not 1 <= node_id <= MAX_NODE_ID:
        seen = "the file names none" if node_id is None else f"the file names {node_id}, which is not valid"
        tries = (f"canopen sim {entry.file} --id 5", f"canopen sim 5={entry.file}")
        raise usage("CO127", f"which node-ID is {entry.file} to have?", seen=seen, tries=tries)
    return (node_id,)


def _model(
    entry: DeviceEntry, description: DeviceDescription, node_id: int, script: Script | None, number: int, screen: Screen
) -> DeviceModel:
    dictionary = configured(description.dictionary, entry.values, node_id, entry.file)
    drive, reason = None, ""
    if entry.profile == "402" or (entry.profile == "auto" and is_drive(dictionary)):
        obstacle = drive_obstacle(dictionary)
        if obstacle and entry.profile == "402":
            raise Problem(
                ExitCode.BAD_FILE, "CO332", f"{entry.file} cannot be a simulated drive: {obstacle}", tries=("--profile none",)
            )
        reason = f"no drive moves behind it: {obstacle}" if obstacle else ""
        if not obstacle:
            shape = SHAPES[entry.shape] if entry.shape else shape_of(description)
            before = dictionary
            dictionary, filled = drive_dictionary_of(before, shape)
            drive = DriveSettings(shape=shape, stops_at_switches=False)  # a file does not tell where its switches are
            for variable in filled:
                _tell_filled(screen, node_id, before.variable((variable.index, variable.subindex)), variable)
    model = DeviceModel(dictionary, node_id, drive, script)
    _tell(screen, model, entry, reason)
    return model


def shape_of(description: DeviceDescription) -> Shape:
    """Return how the drives of that maker behave, beyond their dictionary."""
    return Shape.SCHUNK_POWERBALL if "schunk" in description.device_info.vendor_name.casefold() else Shape.STANDARD


def configured(dictionary: ObjectDictionary, values: Mapping[str, Any], node_id: int, file: str) -> ObjectDictionary:
    """Return the dictionary with other values at power-on, by key. Raises Problem."""
    by_mux: dict[Mux, Value] = {}
    for key, value in values.items():
        try:
            variable = dictionary.variable(key)
            chosen = dictionary.value_from(variable, value)
            variable.encode(chosen)
        except (NotInDictionary, ValueRangeError) as error:
            raise usage("CO127", f"{file}: values: {error}") from None
        by_mux[variable.mux] = chosen
    return configure(dictionary, by_mux, node_id) if by_mux else dictionary


def _tell_filled(screen: Screen, node_id: int, before: Variable, after: Variable) -> None:
    said = before.default if before.configured is None else before.configured
    if said is None:
        screen.detail(f"node {node_id}: {after.label} = {after.default!r}, which the file does not say")
    else:
        why = "with the file's, no drive would have a mode"
        screen.say(f"[yellow]node {node_id}: {escape(after.label)} = {after.default!r} in place of {said!r}: {why}[/]")


def _tell(screen: Screen, model: DeviceModel, entry: DeviceEntry, reason: str) -> None:
    from canopen_proto.machine import Outbox

    node = model(Outbox())
    counts = f"objects: {len(model.dictionary)}, TPDOs: {len(node.pdos.producers)}, RPDOs: {len(node.pdos.consumers)}"
    kind = "a simulated drive" if model.drive is not None else "plain memory"
    what = f"{kind}{' with a script' if model.script is not None else ''}; {counts}"
    screen.say(f"{node_text(model.node_id)}  {escape(entry.file)}: {what}")
    notices = [*([reason] if reason else []), *map(str, notices_of(node))]
    for notice in notices[:MAX_NOTICES]:
        screen.say(f"    [yellow]{escape(notice)}[/]")
    for notice in notices[MAX_NOTICES:]:
        screen.detail(f"    {notice}")
    if len(notices) > MAX_NOTICES and screen.verbosity < 1:
        screen.say(f"    [yellow]and {len(notices) - MAX_NOTICES} more: -v shows them[/]")
