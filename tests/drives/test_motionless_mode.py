"""Power moves nothing: the mode that is selected before a drive is enabled, whatever modes the drive has."""

from __future__ import annotations

import pytest

from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import SECOND
from canopen_proto.procedures.objects import write
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import Rig

HERE = 4_321


def rig_with(*modes: Mode) -> Rig:
    """A drive with these modes, at HERE."""
    listed = sum(1 << mode - 1 for mode in modes)
    dictionary = drive_dictionary().with_objects([standard_object(0x6502, listed)])
    return Rig(Shape.STANDARD, drive=DriveSettings(position=HERE), dictionary=dictionary)


@pytest.mark.parametrize(
    ("modes", "selected"),
    [
        ((Mode.PROFILE_POSITION, Mode.HOMING, Mode.INTERPOLATED_POSITION), Mode.INTERPOLATED_POSITION),
        ((Mode.PROFILE_POSITION, Mode.PROFILE_VELOCITY), Mode.PROFILE_POSITION),
        ((Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.PROFILE_VELOCITY), Mode.CYCLIC_SYNCHRONOUS_POSITION),
    ],
)
def test_power_moves_nothing(modes: tuple[Mode, ...], selected: Mode) -> None:
    rig = rig_with(*modes)
    rig.run(write(rig.remote, "0x607A", 90_000))  # what another program has left
    rig.run(write(rig.remote, "0x60B0", 5_000))
    rig.start_sync()
    rig.run(drive.select_motionless_mode(rig.axis))
    assert rig.axis.mode == selected
    rig.run(drive.enable(rig.axis))
    rig.bus.run(SECOND)
    assert rig.drive.state is State.OPERATION_ENABLED
    assert rig.node.values[objects.POSITION_ACTUAL_VALUE] == HERE


def test_a_drive_in_which_power_may_always_move_something() -> None:
    rig = rig_with(Mode.PROFILE_VELOCITY, Mode.TORQUE)
    with pytest.raises(drive.ModeUnsupportedError, match=r"accepts neither .* nor cyclic synchronous position \(csp\)"):
        rig.run(drive.select_motionless_mode(rig.axis))
    assert rig.drive.state is State.SWITCH_ON_DISABLED
