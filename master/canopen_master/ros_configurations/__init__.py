"""Configurations of ros_canopen and ros2_canopen become machine files: `import_configuration`. docs/ros-migration.md has it all.

Every key of a configuration has a line in the report: taken over as what, not needed and why, or left out and why.

Values that cannot be used end nothing: each is told, and the rest is imported as if it were not there. A value is left out with
what would be wrong without it: a PDO as a whole, and a list in which places count.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from canopen_data import DataError, content_of
from canopen_data.findings import DictionaryError
from canopen_master.machine_file import MachineFile, parse_machine
from canopen_master.ros_configurations.device_settings import configured_file
from canopen_master.ros_configurations.draft import BUS, Choices, Draft
from canopen_master.ros_configurations.report import ImportReport, KeyOutcome, Told, YamlSection, section_of
from canopen_master.ros_configurations.ros2_canopen import is_ros2_canopen, take_ros2_canopen
from canopen_master.ros_configurations.ros_canopen import is_ros_canopen, take_ros_canopen
from canopen_master.ros_configurations.yaml_text import UnusableValueError, Value, read_yaml

__all__ = ["Choices", "Imported", "KeyOutcome", "Told", "import_configuration"]

_NO_FILE: Final = "without the device's file no DCF can hold it; by hand: `canopen write NODE OBJECT VALUE`"
_MAX_UNUSABLE: Final = 100
"""In one configuration. With more of them it is another kind of file."""
_WHOLES: Final = re.compile(r"(?P<pdo>.*\.[tr]pdo\.\d+)\..*|(?P<list>.*\.(?:channels|channel_names))\[.*")


@dataclass(frozen=True, slots=True)
class Imported:
    """A configuration as a machine file. kind: of the configuration. machine, text: what the machine file says, and its text.

    files: what stands beside it, by name: a DCF for each node in which values are to be set.
    """

    kind: str
    machine: MachineFile
    text: str
    files: Mapping[str, bytes]
    report: tuple[Told, ...]

    @property
    def is_complete(self) -> bool:
        """Whether nothing was left out."""
        return all(each.outcome is not KeyOutcome.LEFT_OUT for each in self.report)


def import_configuration(paths: Sequence[str | Path], folder: Path, choices: Choices | None = None) -> Imported:
    """Return the machine that these files describe together: parts of one configuration, as they are loaded together.

    folder: where the machine file will stand; paths in it are relative to that. Raises DataError for a file that cannot be read,
    DictionaryError for one that is no YAML, PackageMissingError without `ruamel.yaml`.
    """
    whole: dict[str, Value] = {}
    for path in paths:
        content = content_of(Path(path), str(path))
        if content is None:
            raise DataError(f"there is no file {str(path)!r}", "check the path")
        for key, value in read_yaml(content, str(path)).entries.items():
            if key in whole:
                raise value.failure(f"it is in {whole[key].source}, line {whole[key].line}, too")
            whole[key] = value
    unusable: list[_Unusable] = []
    while True:
        try:
            return _imported(_without(whole, unusable), unusable, folder, choices or Choices())
        except UnusableValueError as error:
            if len(unusable) == _MAX_UNUSABLE:
                raise
            unusable.append(_unusable_part(whole, error))


def _imported(top: Mapping[str, Value], unusable: Sequence[_Unusable], folder: Path, choices: Choices) -> Imported:
    """Return the machine of the values that can be used. Raises UnusableValueError for the next one that cannot."""
    report = ImportReport()
    for each in unusable:
        each.tell(report)
    places = (place for each in unusable for place in (each.error.value.place, each.part.place))
    draft = Draft(choices, report, lost=frozenset(places))
    section = YamlSection(top, report)
    if is_ros2_canopen(top) and not is_ros_canopen(top):
        kind = "ros2_canopen"
        take_ros2_canopen(section, top, draft)
    else:
        kind = "ros_canopen"
        if not is_ros_canopen(top) and not unusable:
            first = next(iter(top.values()), None)
            message = "this is no configuration of ros_canopen (bus, nodes with id) or ros2_canopen (master, nodes with node_id)"
            raise DataError(message) if first is None else DictionaryError(first.failure(message).findings)
        take_ros_canopen(section, draft)
    draft.take_limits(section_of(section.take("joint_limits"), report))
    section.close()
    files = _device_files(draft, folder)
    for value in top.values():
        _tell_unused(value, {each.key for each in report.lines if each.line}, report)
    text = _text(draft)
    machine = parse_machine(text, "the machine file")  # what the reader refuses is told here, not with the first command
    return Imported(kind, machine, text, files, tuple(report.lines))


def _device_files(draft: Draft, folder: Path) -> dict[str, bytes]:
    """Return the new DCFs by name, and name the file of each node in its table."""
    files: dict[str, bytes] = {}
    for name, device in draft.devices.items():
        program = device.entry.get("boot", {}).get("program")
        if program is not None:
            device.entry["boot"]["program"] = os.path.relpath(program, folder)
        if device.file is None:
            for setting in device.settings:
                draft.report.left_out(setting.whole, _NO_FILE)
            continue
        dcf = f"{name.replace('/', '_')}.dcf"
        content = configured_file(draft.description_of(device.file), device.entry["id"], device.settings, draft.report)
        if content is None:
            device.entry["file"] = os.path.relpath(device.file, folder)
        else:
            device.entry["file"], files[dcf] = dcf, content
            if "boot" in device.entry:
                device.entry["boot"]["configuration"] = dcf
        if device.file_key is not None:
            made = "" if content is None else f": {device.file.name}, with the node's settings"
            draft.report.taken(device.file_key, f'file = "{device.entry["file"]}"{made}')
    return files


def _tell_unused(value: Value, told: AbstractSet[str], report: ImportReport) -> None:
    """Tell of each scalar of which, and of whose maps and lists, nothing was told yet: a default that no node takes."""
    if value.place in told:
        return
    for each in (*value.entries.values(), *value.items):
        _tell_unused(each, told, report)
    if value.kind not in ("map", "list"):
        report.not_needed(value, "nothing uses it: each node or channel has its own value, or none is there that would")


def _text(draft: Draft) -> str:
    """Return the machine file."""
    import tomli_w  # only for those that write

    chain: dict[str, Any] = {"joints": list(draft.joints)} | ({"mode": draft.mode} if draft.mode else {})
    bus = draft.bus | ({"locator": draft.choices.locator} if draft.choices.locator else {})
    tables: dict[str, Any] = {
        "master": draft.master,
        "network": draft.network,
        "buses": {BUS: {key: value for key, value in bus.items() if (key, value) != ("locator", BUS)}},
        "nodes": {name: device.entry for name, device in draft.devices.items()},
        "joints": draft.joints,
        "chains": {draft.choices.chain or draft.chain: chain} if draft.joints else {},
    }
    return tomli_w.dumps({name: table for name, table in tables.items() if table})


# ---- values that cannot be used ----


class _Unusable(NamedTuple):
    """What is left out: part, which holds the value that the error is about, or is it."""

    error: UnusableValueError
    part: Value

    def tell(self, report: ImportReport) -> None:
        """Tell of the value, and of the part that goes with it."""
        value = self.error.value
        report.left_out(value, self.error.message)
        if self.part.place != value.place:
            what = "the PDO" if self.part.kind == "map" else "the list"
            report.left_out(self.part, f"{value.place} cannot be used, and without it {what} would be another one")


def _unusable_part(top: Mapping[str, Value], error: UnusableValueError) -> _Unusable:
    """Return what has to be left out with a value."""
    match = _WHOLES.fullmatch(error.value.place)
    place = error.value.place if match is None else match["pdo"] or match["list"]
    parts = (each for value in top.values() for each in _all(value) if each.place == place)
    return _Unusable(error, next(parts, error.value))


def _without(top: Mapping[str, Value], unusable: Iterable[_Unusable]) -> dict[str, Value]:
    """Return the values of files without these parts."""
    places = {each.part.place for each in unusable}
    return {key: _rest(value, places) for key, value in top.items() if value.place not in places}


def _all(value: Value) -> Iterator[Value]:
    yield value
    for each in (*value.entries.values(), *value.items):
        yield from _all(each)


def _rest(value: Value, places: set[str]) -> Value:
    entries = {key: _rest(each, places) for key, each in value.entries.items() if each.place not in places}
    return replace(value, entries=entries, items=tuple(_rest(each, places) for each in value.items if each.place not in places))
