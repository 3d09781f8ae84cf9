"""The values of a simulated drive's objects where its dictionary has none, or one that says nothing."""

from __future__ import annotations

from typing import Final

from canopen_proto.drives.cia402 import objects
from canopen_proto.multiplexer import Mux

FALLBACKS: Final[dict[Mux, int]] = {
    objects.QUICK_STOP_OPTION_CODE: 2,
    objects.SHUTDOWN_OPTION_CODE: 0,
    objects.DISABLE_OPERATION_OPTION_CODE: 1,
    objects.HALT_OPTION_CODE: 1,
    objects.FAULT_REACTION_OPTION_CODE: 2,
    objects.FOLLOWING_ERROR_WINDOW: 10_000,
    objects.FOLLOWING_ERROR_TIME_OUT: 100,
    objects.POSITION_WINDOW: 10,
    objects.POSITION_WINDOW_TIME: 0,
    objects.MIN_SOFTWARE_POSITION_LIMIT: -(2**31),
    objects.MAX_SOFTWARE_POSITION_LIMIT: 2**31 - 1,
    objects.MAX_PROFILE_VELOCITY: 2**32 - 1,
    objects.PROFILE_VELOCITY: 20_000,
    objects.PROFILE_ACCELERATION: 100_000,
    objects.PROFILE_DECELERATION: 100_000,
    objects.QUICK_STOP_DECELERATION: 400_000,
    objects.PROFILE_JERK_USE: 1,
    objects.PROFILE_JERK: 1_000_000,
    objects.SECOND_PROFILE_JERK: 1_000_000,
    objects.HOMING_SPEED_SEARCH_SWITCH: 20_000,
    objects.HOMING_SPEED_SEARCH_ZERO: 10_000,
    objects.HOMING_ACCELERATION: 100_000,
    objects.INTERPOLATION_TIME_UNITS: 8,
    objects.INTERPOLATION_TIME_INDEX: -3,
    objects.MAXIMUM_BUFFER_SIZE: 1,
    objects.MAX_ACCELERATION: 2**32 - 1,
    objects.MAX_DECELERATION: 2**32 - 1,
    objects.MAX_TORQUE: 3_000,
    objects.MAX_CURRENT: 3_000,
    objects.MOTOR_RATED_CURRENT: 5_000,
    objects.MOTOR_RATED_TORQUE: 10_000,
    objects.POSITIVE_TORQUE_LIMIT: 3_000,
    objects.NEGATIVE_TORQUE_LIMIT: 3_000,
    objects.TORQUE_SLOPE: 1_000,
    objects.MAX_MOTOR_SPEED: 100,
    objects.VELOCITY_WINDOW: 100,
    objects.VELOCITY_THRESHOLD: 10,
    objects.MAX_SLIPPAGE: 2**31 - 1,
    objects.VL_VELOCITY_MAX_AMOUNT: 2**32 - 1,
    objects.VL_VELOCITY_ACCELERATION: 100_000,
    Mux(objects.VL_VELOCITY_ACCELERATION + 1): 1,
    objects.VL_VELOCITY_DECELERATION: 100_000,
    Mux(objects.VL_VELOCITY_DECELERATION + 1): 1,
    objects.VL_VELOCITY_QUICK_STOP: 400_000,
    Mux(objects.VL_VELOCITY_QUICK_STOP + 1): 1,
}
"""The values of objects that a drive's dictionary lacks (the Schunk shape has few); also the standard shape's defaults."""

TORQUE_LIMITS: Final = frozenset({
    objects.MAX_TORQUE,
    objects.MAX_CURRENT,
    objects.POSITIVE_TORQUE_LIMIT,
    objects.NEGATIVE_TORQUE_LIMIT,
})  # fmt: skip
"""Limits of the torque, per mille of the rated torque; 6073h, per mille of the rated current, limits the torque that it makes."""

UNSET_BY_ZERO: Final = frozenset({
    objects.FOLLOWING_ERROR_WINDOW,
    objects.MAX_PROFILE_VELOCITY,
    objects.PROFILE_VELOCITY,
    objects.PROFILE_ACCELERATION,
    objects.PROFILE_DECELERATION,
    objects.QUICK_STOP_DECELERATION,
    objects.HOMING_SPEED_SEARCH_SWITCH,
    objects.HOMING_SPEED_SEARCH_ZERO,
    objects.HOMING_ACCELERATION,
    objects.PROFILE_JERK,
    objects.SECOND_PROFILE_JERK,
    objects.MAX_ACCELERATION,
    objects.MAX_DECELERATION,
    objects.INTERPOLATION_TIME_UNITS,
    objects.VL_VELOCITY_MAX_AMOUNT,
    objects.VL_VELOCITY_ACCELERATION,
    objects.VL_VELOCITY_DECELERATION,
    objects.VL_VELOCITY_QUICK_STOP,
    *TORQUE_LIMITS,
    objects.MOTOR_RATED_TORQUE,
    objects.TORQUE_SLOPE,
    objects.MAX_MOTOR_SPEED,
})  # fmt: skip
"""Objects that would keep a drive from moving if they were 0: if its file says 0, the drive uses FALLBACKS."""
