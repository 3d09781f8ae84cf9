"""The words of CiA 402 for the values of a drive's objects. An EDS has none; with these, values are read and written by name.

`with_drive_names` adds them to a dictionary: the states and bits of the statusword, the commands of the controlword, the modes of
6060h and 6061h, the option codes. They are those of the product's constants.csv, which goes first if both are used.

A device is a drive if the lower half of its device type (1000h) is 402. If the file gives no device type, or 0 ("no standard"),
it is a drive if it has a controlword and a statusword. The objects of several axes are 0x800 apart.

Bits 10, 12 and 13 of the statusword mean something else in each mode; only bit 10 is named. Bits 8, 14 and 15 are the
manufacturer's. A side file (canopen_data/overlay.py) may name them. If a dictionary names the same bit for several modes, as
constants.csv does, `names_in_mode` picks the names for the active mode.

Source: IEC 61800-7-201 (CiA 402-2), controlword, statusword, modes of operation; CiA 301 v4.2.0, 7.5.2.1 (device type).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from canopen_proto import indices
from canopen_proto.dictionary import Constant, ObjectDictionary
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.option_codes import OPTION_CODES
from canopen_proto.drives.cia402.states import STATUS_PATTERNS, ControlBit, State, StatusBit
from canopen_proto.multiplexer import AXIS_STEP, Mux, index_of, split_mux, subindex_of

PROFILE: Final = 402
"""Low word of a drive's device type."""

_AXES: Final = 8

_STATES: Final = {
    State.NOT_READY_TO_SWITCH_ON: "not_ready_to_switch_on",
    State.SWITCH_ON_DISABLED: "switch_on_disabled",
    State.READY_TO_SWITCH_ON: "ready_to_switch_on",
    State.SWITCHED_ON: "switched_on",
    State.OPERATION_ENABLED: "operation_enable",
    State.QUICK_STOP_ACTIVE: "quick_stop_active",
    State.FAULT_REACTION_ACTIVE: "fault_reaction_active",
    State.FAULT: "fault",
}
_STATUS_BITS: Final = {
    "voltage_enabled": StatusBit.VOLTAGE_ENABLED,
    "warning": StatusBit.WARNING,
    "remote": StatusBit.REMOTE,
    "target_reached": StatusBit.TARGET_REACHED,
    "internal_limit_active": StatusBit.INTERNAL_LIMIT,
}
_INPUTS: Final = {
    "negative_limit_switch": 1 << 0,
    "positive_limit_switch": 1 << 1,
    "home_switch": 1 << 2,
    "interlock": 1 << 3,
}
_COMMANDS: Final = {
    "disable_voltage": 0x0000,
    "sm_quick_stop": 0x0002,
    "sm_shutdown": 0x0006,
    "sm_switch_on": 0x0007,
    "sm_enable_operation": 0x000F,
}
_MODES: Final = {
    "no_mode": 0, "profile_position_mode": 1, "pp": 1, "velocity_mode": 2, "vl": 2, "profile_velocity_mode": 3, "pv": 3,
    "torque_profile_mode": 4, "tq": 4, "homing_mode": 6, "hm": 6, "interpolated_position_mode": 7, "ip": 7,
    "cyclic_synchronous_position_mode": 8, "csp": 8, "cyclic_synchronous_velocity_mode": 9, "csv": 9,
    "cyclic_synchronous_torque_mode": 10, "cst": 10,
}  # fmt: skip

_NAMES: Final[dict[Mux, tuple[Constant, ...]]] = {
    objects.STATUSWORD: (
        *(Constant(_STATES[state], mask, value) for state, (mask, value) in STATUS_PATTERNS.items()),
        *(Constant(name, bit, bit) for name, bit in _STATUS_BITS.items()),
    ),
    objects.CONTROLWORD: (
        *(Constant(name, 0xFFFF, value) for name, value in _COMMANDS.items()),
        Constant("fault_reset", ControlBit.FAULT_RESET, ControlBit.FAULT_RESET),
        Constant("halt", ControlBit.HALT, ControlBit.HALT),
    ),
    objects.DIGITAL_INPUTS: tuple(Constant(name, bit, bit) for name, bit in _INPUTS.items()),
    objects.DIGITAL_OUTPUTS: (Constant("set_brake", 1, 1),),
    objects.DIGITAL_OUTPUT_MASK: (Constant("set_brake", 1, 1),),
    objects.MODES_OF_OPERATION: tuple(Constant(name, 0xFF, value) for name, value in _MODES.items()),
    objects.MODES_OF_OPERATION_DISPLAY: tuple(Constant(name, 0xFF, value) for name, value in _MODES.items()),
    **{key: tuple(Constant(name, 0xFFFF, value) for value, name in names.items()) for key, names in OPTION_CODES.items()},
}


_MODES_OF: Final[dict[str, tuple[int, ...]]] = {
    "set_point_acknowledge": (Mode.PROFILE_POSITION,),
    "speed_0": (Mode.PROFILE_VELOCITY,),
    "homing_attained": (Mode.HOMING,),
    "homing_error": (Mode.HOMING,),
    "ip_mode_active": (Mode.INTERPOLATED_POSITION,),
    "drive_follows_command": (
        Mode.CYCLIC_SYNCHRONOUS_POSITION,
        Mode.CYCLIC_SYNCHRONOUS_VELOCITY,
        Mode.CYCLIC_SYNCHRONOUS_TORQUE,
    ),
    "following_error": (Mode.PROFILE_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION),
}
"""The names of bits 12 and 13 of the statusword in constants.csv -> the modes in which the bit means this."""


def names_in_mode(names: Iterable[str], mode: int | None) -> tuple[str, ...]:
    """Return those of a statusword's names that are true in a mode (0x6061). mode: None if it is not known; names that are true
    in some modes only are left out then."""
    return tuple(name for name in names if name not in _MODES_OF or mode in _MODES_OF[name])


def is_drive(dictionary: ObjectDictionary) -> bool:
    """Return whether a dictionary is that of a drive; see this module's text."""
    device_type = dictionary.get(indices.DEVICE_TYPE)
    value = device_type.initial_of(0) if device_type is not None else 0
    profile = value & 0xFFFF if isinstance(value, int) else 0
    words = objects.CONTROLWORD, objects.STATUSWORD
    return profile == PROFILE or (profile == 0 and all(dictionary.get(*split_mux(word)) for word in words))


def with_drive_names(dictionary: ObjectDictionary) -> ObjectDictionary:
    """Return the dictionary with CiA 402's names for values; names that it already has stay. Unchanged if it is not a drive's."""
    if not is_drive(dictionary):
        return dictionary
    constants: dict[Mux, tuple[Constant, ...]] = {}
    for key, names in _NAMES.items():
        for axis in range(_AXES):
            variable = dictionary.get(index_of(key) + axis * AXIS_STEP, subindex_of(key))
            if variable is not None:
                known = {constant.name for constant in dictionary.constants_of(variable)}
                constants[variable.mux] = tuple(name for name in names if name.name not in known)
    return dictionary.with_names_of(ObjectDictionary([], constants=constants))
