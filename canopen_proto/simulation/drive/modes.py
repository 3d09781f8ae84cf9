"""The modes of operation that a simulated drive has, and when it takes another one."""

from __future__ import annotations

from typing import Final

from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, supported
from canopen_proto.drives.cia402.states import ControlBit, State
from canopen_proto.machine import Outbox
from canopen_proto.simulation.drive.homing import Homing
from canopen_proto.simulation.drive.interpolated_position import InterpolatedPosition
from canopen_proto.simulation.drive.profile_modes import OperationMode, ProfileVelocity, Velocity
from canopen_proto.simulation.drive.profile_position import ProfilePosition
from canopen_proto.simulation.drive.servo import Servo
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from canopen_proto.simulation.drive.synchronous_modes import CyclicPosition
from canopen_proto.simulation.drive.torque_modes import CyclicTorque, CyclicVelocity, ProfileTorque

_POWER: Final = {
    State.READY_TO_SWITCH_ON: 1,
    State.SWITCHED_ON: 2,
    State.OPERATION_ENABLED: 3,
    State.QUICK_STOP_ACTIVE: 3,
    State.FAULT_REACTION_ACTIVE: 3,
}
"""How near a state is to Operation enabled; 0 for all others."""


def modes_of(servo: Servo, out: Outbox, node_id: int, homing: Homing) -> dict[int, OperationMode]:
    """Return the modes that a drive can be in, by number; which of them it has, 6502h says."""
    common = (servo, out, node_id)
    return {
        Mode.NO_MODE: OperationMode(*common),
        Mode.PROFILE_POSITION: ProfilePosition(*common),
        Mode.VELOCITY: Velocity(*common),
        Mode.PROFILE_VELOCITY: ProfileVelocity(*common),
        Mode.TORQUE: ProfileTorque(*common),
        Mode.HOMING: homing,
        Mode.INTERPOLATED_POSITION: InterpolatedPosition(*common),
        Mode.CYCLIC_SYNCHRONOUS_POSITION: CyclicPosition(*common),
        Mode.CYCLIC_SYNCHRONOUS_VELOCITY: CyclicVelocity(*common),
        Mode.CYCLIC_SYNCHRONOUS_TORQUE: CyclicTorque(*common),
        **{mode: OperationMode(*common) for mode in servo.settings.own_modes},
    }


def has_mode(servo: Servo, modes: dict[int, OperationMode], mode: int) -> bool:
    """Return whether a mode can be selected: "no mode" always; without 6502h any; on a Schunk homing, whatever 6502h says."""
    if mode == Mode.NO_MODE or (mode == Mode.HOMING and servo.settings.shape is Shape.SCHUNK_POWERBALL):
        return True
    known = servo.store.get(objects.SUPPORTED_DRIVE_MODES)
    return mode in modes and (mode < 0 or not isinstance(known, int) or supported(known, mode))


def changes_mode(settings: DriveSettings, state: State, controlword: int) -> bool:
    """Return whether a drive takes another mode in this state, after this controlword."""
    if controlword & ControlBit.HALT and not settings.changes_mode_halted:
        return False
    return _POWER.get(state, 0) <= _POWER.get(settings.mode_change_state, 0)
