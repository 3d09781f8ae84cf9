"""Simulated devices made of real devices' own files (EDS, DCF, XDD, XDC), or written in Python, as the entries of a plant file
name them.

    plant = read_plant(Path("plant.toml"))
    async with simulated_devices({"virtual:bus": list(models_of(plant.devices))}):
        ...

`models_of` tells what it finds by events: FileRead, Finding (of a side file), ValueFilled, ModelMade.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

from canopen_data import load_dictionary
from canopen_data.configured import configure, without_configured_values
from canopen_data.declared import describe_device
from canopen_data.describing import identified
from canopen_data.description import DeviceDescription
from canopen_data.descriptions import with_names
from canopen_data.drive_from_file import drive_dictionary_of, drive_obstacle
from canopen_data.findings import Finding
from canopen_data.named_files import DescriptionFile, open_description, read_text
from canopen_data.overlay import lay_over
from canopen_master.errors import DeviceRefusedError, NoDriveInFileError
from canopen_master.simulation.device_code import SUFFIX, load_device
from canopen_master.simulation.hooks import Script
from canopen_master.simulation.host import DeviceModel
from canopen_master.simulation.plant import AUTOMATIC, DRIVE, DeviceEntry, PlantFile, parse_plant
from canopen_master.simulation.serving import SERIAL, with_serial
from canopen_proto import indices
from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.declared import DeclaredDevice
from canopen_proto.dictionary import NotInDictionaryError, ObjectDictionary, Variable
from canopen_proto.drives.cia402.names import is_drive, with_drive_names
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.lss.messages import UNCONFIGURED
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive.settings import DriveSettings, Shape


@dataclass(frozen=True)
class FileRead:
    """A device's own file was read; `file.description.findings` are its faults."""

    file: DescriptionFile


@dataclass(frozen=True)
class ValueFilled:
    """An object of a drive has got a value without which it would not move: the file has none, or one of 0."""

    node_id: int
    before: Variable
    after: Variable


@dataclass(frozen=True)
class ModelMade:
    """A device was made. obstacle: why no drive moves behind it though it is one; "" otherwise."""

    model: DeviceModel
    file: str
    obstacle: str


MakingEvent: TypeAlias = FileRead | Finding | ValueFilled | ModelMade


def read_plant(path: Path) -> PlantFile:
    """Return the plant of a plant file, with paths that are relative to the present folder.

    A device's file that is not there may be a sample, and keeps its name. Raises DataError, DictionaryError.
    """

    def beside(name: str) -> str:
        return str(path.parent / name) if name else ""

    plant = parse_plant(read_text(path), str(path))
    devices = tuple(
        replace(
            each,
            file=beside(each.file) if (path.parent / each.file).exists() else each.file,
            script=beside(each.script),
            overlays=tuple(map(beside, each.overlays)),
        )
        for each in plant.devices
    )
    return replace(plant, devices=devices, state=beside(plant.state))


def models_of(entries: Iterable[DeviceEntry], tell: Callable[[MakingEvent], object] = lambda event: None) -> list[DeviceModel]:
    """Make the models of devices, one for each node-ID of an entry. tell: is called with what is found. A Python file is run.

    A device without a node-ID (255) gets a serial number of its own, by which LSS finds it. Raises DeviceRefusedError for an
    entry that cannot be served, NoDriveInFileError, DataError, DictionaryError, ScriptError.
    """
    names, _ = load_dictionary()
    made: list[DeviceModel] = []
    files: dict[int, str] = {}
    for entry in entries:
        code = load_device(entry.file) if entry.file.endswith(SUFFIX) else None
        description = _load(entry, names, tell) if code is None else _laid_over(entry, describe_device(code), tell)
        script = Script(read_text(Path(entry.script)), entry.script) if entry.script else None
        for node_id in _node_ids(entry, description):
            other = files.setdefault(node_id, entry.file)
            if node_id != UNCONFIGURED and any(model.node_id == node_id for model in made):
                raise DeviceRefusedError(
                    f"there are two devices of node-ID {node_id}: of {other} and of {entry.file}",
                    tries=("give each its own: 5=a.eds 6=b.eds",),
                )
            if node_id == UNCONFIGURED:
                description = _with_own_serial(entry, description, len(made))
            made.append(_model(entry, description, node_id, script, tell, code))
    return made


def _with_own_serial(entry: DeviceEntry, description: DeviceDescription, number: int) -> DeviceDescription:
    """Give a device without a node-ID a serial number of its own, counting on from that of its file: LSS needs it."""
    variable = description.dictionary.get(indices.IDENTITY_OBJECT, SERIAL)
    if variable is None or any(description.dictionary.variable(key).mux == variable.mux for key in entry.values):
        return description
    first = variable.initial_of(UNCONFIGURED)
    serial = (first if isinstance(first, int) else 0) + (number > 0)
    return replace(description, dictionary=with_serial(description.dictionary, serial, UNCONFIGURED))


def _load(entry: DeviceEntry, names: ObjectDictionary, tell: Callable[[MakingEvent], object]) -> DeviceDescription:
    file = open_description(entry.file, entry.encoding)
    tell(FileRead(file))
    description = with_names(file.description, names)
    dictionary = with_drive_names(identified(description))
    if entry.defaults:
        dictionary = without_configured_values(dictionary)
    return _laid_over(entry, replace(description, dictionary=dictionary), tell)


def _laid_over(entry: DeviceEntry, description: DeviceDescription, tell: Callable[[MakingEvent], object]) -> DeviceDescription:
    dictionary = description.dictionary
    for path in entry.overlays:
        dictionary, findings = lay_over(dictionary, read_text(Path(path)), path)
        for finding in findings:
            tell(finding)
    return replace(description, dictionary=dictionary)


def _node_ids(entry: DeviceEntry, description: DeviceDescription) -> tuple[int, ...]:
    if entry.node_ids:
        return entry.node_ids
    node_id = description.node_id
    if node_id is None or not 1 <= node_id <= MAX_NODE_ID:
        seen = "the file names none" if node_id is None else f"the file names {node_id}, which is not valid"
        tries = (f"canopen sim {entry.file} --id 5", f"canopen sim 5={entry.file}")
        raise DeviceRefusedError(f"which node-ID is {entry.file} to have?", seen=seen, tries=tries)
    return (node_id,)


def _model(
    entry: DeviceEntry,
    description: DeviceDescription,
    node_id: int,
    script: Script | None,
    tell: Callable[[MakingEvent], object],
    code: type[DeclaredDevice] | None,
) -> DeviceModel:
    dictionary = _with_values(description.dictionary, entry.values, node_id, entry.file)
    drive, obstacle = None, ""
    if code is None and (entry.profile == DRIVE or (entry.profile == AUTOMATIC and is_drive(dictionary))):
        obstacle = drive_obstacle(dictionary)
        if obstacle and entry.profile == DRIVE:
            raise NoDriveInFileError(f"{entry.file} cannot be a simulated drive: {obstacle}", 'profile = "none"')
        if not obstacle:
            shape = Shape(entry.shape) if entry.shape else shape_of(description)
            before = dictionary
            dictionary, filled = drive_dictionary_of(before, shape)
            drive = DriveSettings(shape=shape, stops_at_switches=False)  # a file does not tell where its switches are
            for variable in filled:
                tell(ValueFilled(node_id, before.variable((variable.index, variable.subindex)), variable))
    model = DeviceModel(dictionary, node_id, drive, script, code)
    tell(ModelMade(model, entry.file, obstacle))
    return model


def shape_of(description: DeviceDescription) -> Shape:
    """Return how the drives of that maker behave, beyond their dictionary."""
    return Shape.SCHUNK_POWERBALL if "schunk" in description.device_info.vendor_name.casefold() else Shape.STANDARD


def _with_values(dictionary: ObjectDictionary, values: Mapping[str, Any], node_id: int, file: str) -> ObjectDictionary:
    """Return the dictionary with other values at power-on, by key."""
    by_mux: dict[Mux, Value] = {}
    for key, value in values.items():
        try:
            variable = dictionary.variable(key)
            chosen = dictionary.value_from(variable, value)
            variable.encode(chosen)
        except (NotInDictionaryError, ValueRangeError) as error:
            raise DeviceRefusedError(f"{file}: values: {error}") from None
        by_mux[variable.mux] = chosen
    return configure(dictionary, by_mux, node_id) if by_mux else dictionary
