"""The drives of `canopen demo --eds`: read their files, and check that a simulated drive can stand behind each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from canopen_cli.shared.device_files import read_device_files
from canopen_cli.shared.problem import ExitCode, Problem
from canopen_cli.shared.screen import Screen
from canopen_cli.simulation.devices import SHAPES, shape_of
from canopen_data import load_dictionary
from canopen_data.configured import without_configured_values
from canopen_data.description import DeviceDescription
from canopen_data.drive_from_file import drive_obstacle
from canopen_master.machine_file import MachineFile
from canopen_master.machine_file.dictionaries import Dictionaries
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives.axis.axis import SCHUNK_POWERBALL, AxisSettings
from canopen_proto.drives.cia402.modes import Mode, supported
from canopen_proto.drives.cia402.objects import HOMING_METHOD, SUPPORTED_DRIVE_MODES
from canopen_proto.multiplexer import split_mux
from canopen_proto.simulation.drive.settings import Shape

HERE: Final = 35
"""The homing method that takes the present position as home. Its successor 37 is unknown to older drives."""


@dataclass(frozen=True)
class DriveFile:
    """A drive that a file describes. shape: how such drives behave, beyond their dictionary."""

    source: str
    dictionary: ObjectDictionary
    shape: Shape

    @property
    def axis(self) -> AxisSettings:
        """The master's settings for this drive."""
        return SCHUNK_POWERBALL if self.shape is Shape.SCHUNK_POWERBALL else AxisSettings()

    @property
    def has_homing(self) -> bool:
        """Whether such a drive homes: it has 0x6098, and its modes (0x6502), if it tells them, include homing. Schunk's do."""
        if self.shape is Shape.SCHUNK_POWERBALL:
            return True
        modes = self.dictionary.get(*split_mux(SUPPORTED_DRIVE_MODES))
        told = None if modes is None else modes.default if modes.configured is None else modes.configured
        told = told if isinstance(told, int) else 0
        return self.dictionary.get(*split_mux(HOMING_METHOD)) is not None and (not told or supported(told, Mode.HOMING))

    @property
    def simulated_axis(self) -> AxisSettings:
        """The master's settings for a simulated drive behind this file.

        It moves in counts per second, whatever unit its file means. So a search for its home could take hours: a drive that homes
        by 0x6098 takes the place where it stands (method 35), if the file allows that. One without homing is not homed.
        """
        if not self.has_homing:
            return replace(self.axis, velocity_unit=1.0, keeps_reference=True)
        method = self.dictionary.get(*split_mux(HOMING_METHOD))
        if self.shape is Shape.SCHUNK_POWERBALL or method is None or not method.access.writable:
            return replace(self.axis, velocity_unit=1.0)
        high = method.high_limit
        return replace(self.axis, velocity_unit=1.0, homing_method=HERE if high is None or high >= HERE else None)


def drive_files(texts: Sequence[str], defaults: bool, screen: Screen, encoding: str = "") -> dict[int | None, DriveFile]:
    """Return the files of `-e`, by node-ID (None: all others). defaults: drop the values that a DCF configures. encoding: of the
    files, "" = guess it.

    Raises DataError, and Problem for a file that does not describe a drive.
    """
    if not texts:
        return {}
    made = {}
    for node_id, description in read_device_files(texts, load_dictionary()[0], screen, encoding).items():
        made[node_id] = _drive_file(description, defaults)
    return made


def drives_of(machine: MachineFile, defaults: bool) -> dict[str, DriveFile]:
    """Return the files of a machine's joints, by their names; joints without a file are left out. Raises as `drive_files`."""
    dictionaries = Dictionaries(machine)
    made = {}
    for joint in machine.joints.values():
        node = machine.nodes[joint.node]
        description = dictionaries.description_of(node)
        if description is not None:
            file = _drive_file(description, defaults or node.device.defaults)
            made[joint.name] = replace(file, shape=SHAPES[node.device.shape]) if node.device.shape else file
    return made


def _drive_file(description: DeviceDescription, defaults: bool) -> DriveFile:
    dictionary = without_configured_values(description.dictionary) if defaults else description.dictionary
    obstacle = drive_obstacle(dictionary)
    if obstacle:
        raise Problem(
            ExitCode.BAD_FILE,
            "CO332",
            f"{description.source} describes no drive that can be moved: {obstacle}",
            tries=(f"canopen eds show {description.source}", "the file of a CiA 402 drive"),
        )
    return DriveFile(description.source, dictionary, shape_of(description))
