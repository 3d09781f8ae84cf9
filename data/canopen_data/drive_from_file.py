"""Put the simulated drive behind the dictionary from a real drive's file.

A drive's EDS often has no defaults for values that the drive keeps in its memory: no supported modes, no speeds. A simulated
drive that took these as 0 would have no mode and stand still. So `drive_dictionary_of` gives such objects the values of the
simulated drive (see `drive_dictionary`). A value in the file stays, even 0: if that 0 would keep the drive from moving, the drive
shows it and moves by its own values (fallbacks.UNSET_BY_ZERO). Only supported modes of 0 are filled in: every master believes
that object, with the modes of the simulated drive for which the file has the commands.

The drive shows its state in objects with the types of CiA 402. A file with other types for these cannot have the simulated drive;
`drive_obstacle` says why.

Source: IEC 61800-7-201 (CiA 402-2).
"""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import Final

from canopen_proto import indices
from canopen_proto.datatypes import Value, range_of
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.drives.axis.set_points import SET_POINT_OF
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.multiplexer import mux, split_mux
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.fallbacks import FALLBACKS
from canopen_proto.simulation.drive.settings import Shape

SHOWN: Final = (
    objects.ERROR_CODE,
    objects.STATUSWORD,
    objects.CONTROLWORD,
    objects.MODES_OF_OPERATION_DISPLAY,
    objects.POSITION_DEMAND_VALUE,
    objects.POSITION_ACTUAL_VALUE,
    objects.VELOCITY_DEMAND_VALUE,
    objects.VELOCITY_ACTUAL_VALUE,
    objects.TORQUE_DEMAND_VALUE,
    objects.TORQUE_ACTUAL_VALUE,
    objects.CURRENT_ACTUAL_VALUE,
    objects.FOLLOWING_ERROR_ACTUAL_VALUE,
    objects.DIGITAL_INPUTS,
)
"""The objects that the drive writes."""

_COMMAND_OF: Final = {
    **SET_POINT_OF,
    Mode.VELOCITY: objects.VL_TARGET_VELOCITY,
    Mode.PROFILE_VELOCITY: objects.TARGET_VELOCITY,
    Mode.TORQUE: objects.TARGET_TORQUE,
    Mode.HOMING: objects.HOMING_METHOD,
}
"""Mode -> the object without which a drive cannot be commanded in it."""

_DEVICE_TYPE: Final = mux(indices.DEVICE_TYPE)

NEEDED: Final = (objects.CONTROLWORD, objects.STATUSWORD)


def drive_obstacle(dictionary: ObjectDictionary) -> str:
    """Return why the simulated drive cannot stand behind a dictionary; empty if it can."""
    for key in SHOWN:
        variable, standard = dictionary.get(*split_mux(key)), find_standard(*split_mux(key))
        assert standard is not None  # CiA 402 has all of them
        if variable is None:
            if key in NEEDED:
                return f"it has no {standard.label}"
            continue
        ours, needed = range_of(variable.data_type), range_of(standard.data_type)
        assert needed is not None  # they are integers
        if ours is None or ours[0] > needed[0] or ours[1] < needed[1]:
            return f"{variable.label} is {variable.data_type.name}; in CiA 402 it is {standard.data_type.name}"
    return ""


def drive_dictionary_of(dictionary: ObjectDictionary, shape: Shape) -> tuple[ObjectDictionary, list[Variable]]:
    """Return the dictionary with values for the objects that the drive needs and the file has no value for; and these
    variables."""
    simulated = drive_dictionary(shape)
    filled: dict[int, dict[int, Variable]] = {}
    for key in (_DEVICE_TYPE, objects.VENDOR_ID, *FALLBACKS, objects.SUPPORTED_DRIVE_MODES):
        variable, model = dictionary.get(*split_mux(key)), simulated.get(*split_mux(key))
        default = FALLBACKS.get(key) if model is None else model.default
        if key == objects.SUPPORTED_DRIVE_MODES and isinstance(default, int):
            default = _modes_with_objects(dictionary, default)
        if variable is not None and default is not None and _is_open(variable):
            changed = _with_default(variable, default)
            if changed is not None:
                filled.setdefault(variable.index, {})[variable.subindex] = changed
    changed_objects = []
    for index, members in filled.items():
        described = dictionary.objects[index]
        changed_objects.append(replace(described, variables=MappingProxyType({**described.variables, **members})))
    variables = [variable for members in filled.values() for variable in members.values()]
    return dictionary.with_objects(changed_objects) if filled else dictionary, variables


def _modes_with_objects(dictionary: ObjectDictionary, modes: int) -> int:
    """Return those of the modes (as in 0x6502) whose commands the dictionary has; all of them if it has none."""
    has = sum(1 << mode - 1 for mode, key in _COMMAND_OF.items() if split_mux(key) in dictionary)
    return modes & has or modes


def _is_open(variable: Variable) -> bool:
    """Return whether the file leaves the value open."""
    said = variable.default if variable.configured is None else variable.configured
    return said is None or (said == 0 and variable.mux == objects.SUPPORTED_DRIVE_MODES)


def _with_default(variable: Variable, default: Value) -> Variable | None:
    """Return the variable with that value, within the file's type and limits; None if the value cannot fit."""
    numbers = range_of(variable.data_type)
    if numbers is None or not isinstance(default, int):
        return None
    low, high = numbers
    if isinstance(variable.low_limit, int):
        low = max(low, variable.low_limit)
    if isinstance(variable.high_limit, int):
        high = min(high, variable.high_limit)
    value = max(low, min(high, default))
    return replace(variable, default=value, configured=None, adds_node_id=False) if low <= high else None
