"""A drive's own file for both ends of a bus: the simulated drive behind it, and the master's settings for such a drive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from canopen_data.configured import without_configured_values
from canopen_data.description import DeviceDescription
from canopen_data.drive_from_file import drive_obstacle
from canopen_master.errors import NoDriveInFileError
from canopen_master.simulation.device_files import shape_of
from canopen_master.simulation.host import DeviceMaker
from canopen_master.simulation.serving import drive_maker
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


def joint_maker(number: int, node_id: int, file: DriveFile | None) -> DeviceMaker:
    """Return the maker of the simulated drive of a joint: of its file, else a Powerball joint. number: as of `drive_maker`."""
    return drive_maker(number, node_id) if file is None else drive_maker(number, node_id, file.shape, file.dictionary)


def drive_of(description: DeviceDescription, *, defaults: bool = False) -> DriveFile:
    """Return the drive that a file describes. defaults: drop the values that a DCF configures. Raises NoDriveInFileError."""
    dictionary = without_configured_values(description.dictionary) if defaults else description.dictionary
    obstacle = drive_obstacle(dictionary)
    if obstacle:
        failed = f"{description.source} describes no drive that can be moved: {obstacle}"
        raise NoDriveInFileError(failed, f"canopen eds show {description.source}", "the file of a CiA 402 drive")
    return DriveFile(description.source, dictionary, shape_of(description))
