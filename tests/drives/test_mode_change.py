"""Drives that take another mode only in some states, or not while they are halted; modes of the maker."""

from __future__ import annotations

from dataclasses import replace

import pytest

from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.settings import MODE_CHANGE_STATES, AxisSettings
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import MILLIDEGREES, Rig

RULES = [
    *({"mode_change_state": state} for state in MODE_CHANGE_STATES),
    {"changes_mode_halted": False},
    {"mode_change_state": State.SWITCHED_ON, "changes_mode_halted": False},
]


def rig_with(known: bool = True, **rules: object) -> Rig:
    """A drive with these rules, which the settings of its axis know or not."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(**rules))  # type: ignore[arg-type]
    settings = replace(MILLIDEGREES, homing_method=35)
    rig.axis.settings = replace(settings, **rules) if known else settings  # type: ignore[arg-type]
    return rig


@pytest.mark.thorough(4)
@pytest.mark.parametrize("rules", RULES)
def test_homing_and_moves_in_turn(rules: dict[str, object]) -> None:
    rig = rig_with(**rules)
    for target in (0.2, 0.1):
        rig.run(drive.home(rig.axis))
        rig.run(drive.move_to(rig.axis, target, timeout=20 * SECOND))
        assert rig.run(drive.read_position(rig.axis)) == pytest.approx(target, abs=1e-3)
        assert rig.drive.mode == Mode.PROFILE_POSITION


@pytest.mark.parametrize("rules", RULES)
def test_a_drive_that_moves_is_halted_before_it_goes_down(rules: dict[str, object]) -> None:
    rig = rig_with(**rules)
    rig.run(drive.home(rig.axis))
    rig.master.run(drive.move_to(rig.axis, 3.0, timeout=20 * SECOND), rig.bus.now)
    rig.bus.run(300 * MILLISECOND)
    axis = Axis(rig.remote, rig.axis.settings)  # a second master's hand
    lower = rig.axis.settings.mode_change_state
    assert rig.drive._servo.is_moving
    rig.node.values.store[objects.DISABLE_OPERATION_OPTION_CODE] = 0  # without a halt it would lose its power while it moves
    rig.bus.sent.clear()
    rig.run(drive.set_mode(axis, Mode.HOMING))
    words = [frame.data[4:6] for _, frame in rig.bus.sent if frame.can_id == 0x605 and frame.data[:4] == b"\x2b\x40\x60\x00"]
    assert rig.drive.mode == Mode.HOMING
    if lower is not State.OPERATION_ENABLED:
        assert rig.drive.state is lower
        assert words[0][1] & 1, "a halt (bit 8) comes first"


def test_the_mode_that_it_has_needs_no_way_down() -> None:
    rig = rig_with(mode_change_state=State.SWITCH_ON_DISABLED)
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_POSITION))
    rig.run(drive.enable(rig.axis))
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_POSITION))
    assert rig.drive.state is State.OPERATION_ENABLED


def test_a_refusal_names_the_setting() -> None:
    rig = rig_with(known=False, mode_change_state=State.SWITCHED_ON)
    rig.run(drive.move_to(rig.axis, 0.1, timeout=20 * SECOND))
    with pytest.raises(drive.DriveAccessError, match=r"refused writing 0x6060:00.*mode_change_state"):
        rig.run(drive.home(rig.axis))


def test_a_mode_of_the_maker_by_its_number() -> None:
    rig = rig_with(known=False, own_modes=frozenset({-3}))
    rig.run(drive.set_mode(rig.axis, -3))
    assert rig.drive.mode == rig.axis.mode == -3
    with pytest.raises(drive.DriveAccessError):
        rig.run(drive.set_mode(rig.axis, -4))
    assert rig.node.values.store[objects.MODES_OF_OPERATION] == -3


def test_a_state_in_which_no_drive_takes_a_mode() -> None:
    with pytest.raises(LocalProtocolError, match="mode_change_state must be one of"):
        AxisSettings(mode_change_state=State.FAULT)
