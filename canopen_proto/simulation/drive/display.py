"""The values that a simulated drive shows: statusword, position, velocity, torque, inputs and outputs."""

from __future__ import annotations

from typing import Final

from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State, StatusBit
from canopen_proto.simulation.drive.servo import Servo
from canopen_proto.simulation.drive.settings import STO_OF_AX8000, Shape
from canopen_proto.simulation.drive.turns import shown_range, within

_STATE_BITS: Final[dict[State, int]] = {
    State.UNKNOWN: 0x0000,
    State.NOT_READY_TO_SWITCH_ON: 0x0000,
    State.SWITCH_ON_DISABLED: StatusBit.REMOTE | 0x40,
    State.READY_TO_SWITCH_ON: StatusBit.REMOTE | 0x21,
    State.SWITCHED_ON: StatusBit.REMOTE | StatusBit.VOLTAGE_ENABLED | 0x23,
    State.OPERATION_ENABLED: StatusBit.REMOTE | StatusBit.VOLTAGE_ENABLED | 0x27,
    State.QUICK_STOP_ACTIVE: StatusBit.REMOTE | StatusBit.VOLTAGE_ENABLED | 0x07,
    State.FAULT_REACTION_ACTIVE: StatusBit.REMOTE | StatusBit.VOLTAGE_ENABLED | 0x0F,
    State.FAULT: StatusBit.REMOTE | 0x08,
}
"""State -> its bits in the statusword; the voltage is on from Switched on."""

_INT32: Final = 1 << 31
_INT16: Final = 1 << 15


def statusword_of(state: State, mode_status: int, servo: Servo, *, is_referenced: bool) -> int:
    """Return 6041h. mode_status: the bits of the mode, while operation is enabled. is_referenced: the drive knows its
    position."""
    word = _STATE_BITS[state] | mode_status
    if state is State.QUICK_STOP_ACTIVE and servo.is_settled:
        word |= StatusBit.TARGET_REACHED
    if servo.is_overloaded:
        word |= StatusBit.WARNING
    if servo.internal_limit or servo.is_stopped_by_switch or servo.limits_torque:
        word |= StatusBit.INTERNAL_LIMIT
    if servo.settings.shape is Shape.SCHUNK_POWERBALL:
        word |= servo.is_moving * StatusBit.MANUFACTURER_8 | is_referenced * StatusBit.MANUFACTURER_15
    return word


def show_values(servo: Servo, *, torque_is_off: bool) -> None:
    """Write the present values into the store. torque_is_off: by the STO input."""
    store = servo.store
    low, count = shown_range(servo)
    store[objects.POSITION_DEMAND_VALUE] = within(low, count, servo.demand_position - servo.zero)
    store[objects.POSITION_ACTUAL_VALUE] = within(low, count, servo.position - servo.zero)
    store[objects.VELOCITY_DEMAND_VALUE] = _limited(servo.demand_velocity)
    store[objects.VELOCITY_ACTUAL_VALUE] = _limited(servo.velocity)
    if objects.VL_VELOCITY_DEMAND in store:
        is_vl = store.get(objects.MODES_OF_OPERATION_DISPLAY) == Mode.VELOCITY  # in other modes they are not defined: 0
        unit = servo.vl_unit * servo.ratio(objects.VL_SET_POINT_FACTOR) if is_vl else 0.0
        store[objects.VL_VELOCITY_DEMAND] = _limited(servo.demand_velocity / unit, _INT16) if is_vl else 0
        store[objects.VL_VELOCITY_ACTUAL_VALUE] = _limited(servo.velocity / unit, _INT16) if is_vl else 0
    store[objects.TORQUE_DEMAND_VALUE], torque = servo.torques
    store[objects.TORQUE_ACTUAL_VALUE] = store[objects.CURRENT_ACTUAL_VALUE] = torque
    store[objects.FOLLOWING_ERROR_ACTUAL_VALUE] = _limited(servo.following_error)
    store[objects.DIGITAL_INPUTS] = servo.settings.track.inputs_at(servo.position)
    if objects.ADDITIONAL_POSITION in store:  # the second encoder has a zero of its own
        store[objects.ADDITIONAL_POSITION] = _wrapped(servo.position * servo.settings.second_encoder)
    sto_bit = servo.settings.sto_bit
    if torque_is_off or sto_bit is not STO_OF_AX8000:  # which is 0 in the inputs otherwise
        _show_bit(servo, sto_bit, torque_is_off)
    if servo.settings.brake_bit is not None:
        _show_bit(servo, servo.settings.brake_bit, servo.holds_brake)


def _show_bit(servo: Servo, shown: DriveBit, is_active: bool) -> None:
    word = servo.store.get(shown.mux)
    if isinstance(word, int):
        bit = 1 << shown.bit
        servo.store[shown.mux] = word | bit if is_active is (shown.value == 1) else word & ~bit


def _wrapped(position: float) -> int:
    """Return a position as INTEGER32; an endless axis starts again at the other end."""
    return (round(position) + _INT32) % (2 * _INT32) - _INT32


def _limited(value: float, bound: int = _INT32) -> int:
    """Return a speed or distance as INTEGER32 (INTEGER16 with that bound), clipped to its range."""
    if -bound <= value <= bound - 1:
        return round(value)
    return round(max(-bound, min(bound - 1, value)))
