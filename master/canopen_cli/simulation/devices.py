"""The devices that the arguments of `canopen sim` name, and what is told while their models are made."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from canopen_cli.shared.eds_files import tell_faults
from canopen_cli.shared.options import NodeIds, Settings
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, escape, node_text
from canopen_data.device_notices import notices_of
from canopen_data.findings import Finding
from canopen_data.named_files import read_text
from canopen_data.toml_file import parse_toml
from canopen_master.machine_file import MachineFile
from canopen_master.simulation.device_files import FileRead, MakingEvent, ModelMade, ValueFilled, read_plant
from canopen_master.simulation.plant import AUTOMATIC, DeviceEntry, PlantFile
from canopen_proto.lss.messages import UNCONFIGURED
from canopen_proto.machine import Outbox

PLANT_SUFFIX: Final = ".toml"
MAX_NOTICES: Final = 5
"""Notices about a device that are shown, line by line; the rest is counted, and shown with -v."""

_WITH_IDS: Final = re.compile(r"([0-9][0-9A-Fa-fxX,-]*)=(.+)")


class SimulatedIds(NodeIds):
    """Node-IDs of simulated devices: "1-32,40"; 255 for a device without one, as often as there are such devices."""

    def read(self, text: str) -> tuple[int, ...]:
        parts = text.split(",")
        without = [part for part in parts if part.strip().lower() in ("255", "0xff")]
        others = ",".join(part for part in parts if part not in without)
        return (super().read(others) if others else ()) + (UNCONFIGURED,) * len(without)


def named_devices(files: Sequence[str], node_ids: tuple[int, ...] | None, common: DeviceEntry) -> PlantFile:
    """Return the devices that the arguments name: "5=drive.eds", "drive.eds" with --id, "plant.toml".

    common: the options for all of them. Raises CommandError, DataError, DictionaryError.
    """
    plants = [name for name in files if name.lower().endswith(PLANT_SUFFIX)]
    if plants:
        if len(files) > 1:
            raise usage(
                "CO127", f"{plants[0]} is a plant file, which names all devices itself", tries=(f"canopen sim {plants[0]}",)
            )
        plant = read_plant(Path(plants[0]))
        return replace(plant, devices=tuple(_completed(each, common) for each in plant.devices))
    entries = []
    for name in files:
        match = None if Path(name).exists() else _WITH_IDS.fullmatch(name)
        if match is None and re.fullmatch("[0-9][0-9,-]*", name) and not Path(name).exists():
            raise usage("CO127", f"there is no file {name!r}", tries=(f"canopen sim --id {name}    (simulated drives)",))
        ids = () if match is None else SimulatedIds().read(match[1])
        entries.append(replace(common, file=name if match is None else match[2], node_ids=ids))
    if node_ids is not None:
        if len(entries) > 1 or entries[0].node_ids:
            raise usage("CO127", "--id is for one file", tries=("canopen sim 5=a.eds 6=b.eds     node-IDs of several",))
        entries = [replace(entries[0], node_ids=node_ids)]
    return PlantFile(tuple(entries))


def _completed(entry: DeviceEntry, common: DeviceEntry) -> DeviceEntry:
    """Complete an entry of a plant file: the options fill in what it leaves out."""
    return replace(
        entry,
        script=entry.script or common.script,
        overlays=(*common.overlays, *entry.overlays),
        profile=entry.profile if entry.profile != AUTOMATIC else common.profile,
        shape=entry.shape or common.shape,
        defaults=entry.defaults or common.defaults,
        encoding=entry.encoding or common.encoding,
    )


def machine_of(files: Sequence[str], settings: Settings) -> MachineFile | None:
    """Return the machine to simulate: that of the only argument, or without arguments that of -m; None if there is none.

    A file with [buses] is a machine file, one with [[device]] a plant file. Raises DataError, DictionaryError.
    """
    if not files:
        return settings.machine_file()
    path = Path(files[0])
    if len(files) > 1 or path.suffix.lower() != PLANT_SUFFIX or "buses" not in parse_toml(read_text(path), str(path)):
        return None
    settings.machine = path
    return settings.machine_file()


def buses_of(machine: MachineFile, settings: Settings) -> dict[str, str] | None:
    """Return the bus of -b, if it is given: its locator by its name. Raises CommandError."""
    if settings.bus is None:
        return None
    locator = settings.required_bus()
    return {settings.chosen.bus: locator}


def teller(screen: Screen) -> Callable[[MakingEvent], None]:
    """Tell what is found while models are made: what each is, and what in its file does not work."""
    return partial(_tell_event, screen)


def _tell_event(screen: Screen, event: MakingEvent) -> None:
    match event:
        case FileRead(file=file):
            tell_faults(screen, file)
        case Finding():
            screen.detail(str(event))
        case ValueFilled():
            _tell_filled(screen, event)
        case ModelMade():
            _tell_model(screen, event)


def _tell_filled(screen: Screen, filled: ValueFilled) -> None:
    node_id, before, after = filled.node_id, filled.before, filled.after
    said = before.default if before.configured is None else before.configured
    if said is None:
        screen.detail(f"node {node_id}: {after.label} = {after.default!r}, which the file does not say")
    else:
        why = "with the file's, no drive would have a mode"
        screen.say(f"[yellow]node {node_id}: {escape(after.label)} = {after.default!r} in place of {said!r}: {why}[/]")


def _tell_model(screen: Screen, made: ModelMade) -> None:
    model = made.model
    node = model(Outbox())
    counts = f"objects: {len(model.dictionary)}, TPDOs: {len(node.pdos.producers)}, RPDOs: {len(node.pdos.consumers)}"
    kind = "a simulated drive" if model.drive is not None else "plain memory" if model.code is None else model.code.__name__
    what = f"{kind}{' with a script' if model.script is not None else ''}; {counts}"
    screen.say(f"{node_text(model.node_id)}  {escape(made.file)}: {what}")
    reason = [f"no drive moves behind it: {made.obstacle}"] if made.obstacle else []
    notices = [*reason, *map(str, notices_of(node))]
    for notice in notices[:MAX_NOTICES]:
        screen.say(f"    [yellow]{escape(notice)}[/]")
    for notice in notices[MAX_NOTICES:]:
        screen.detail(f"    {notice}")
    if len(notices) > MAX_NOTICES and screen.verbosity < 1:
        screen.say(f"    [yellow]and {len(notices) - MAX_NOTICES} more: -v shows them[/]")
