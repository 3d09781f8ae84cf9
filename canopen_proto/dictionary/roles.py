"""The role of each object in a backup: a restore writes settings and leaves the rest alone.

A configuration tool saves all that it can read, and writes back the settings (CiA 302-3: the download of a device's
configuration). download_order.py leaves out most other objects: read-only ones, commands, histories. Process data remain:
set-points and outputs. A restore must not write them, because that would switch outputs or move a drive.

An object is process data if

- it is read-only and a PDO may carry it (an actual value), or it shows the present error state;
- it is writable, and a set-point of CiA 402 or an output of CiA 401. The indices of both profiles count if the device type is not
  known;
- it is writable, and a valid RPDO of the device carries it: the next PDO sets its value.

A writable object is not process data just because a PDO *may* carry it (PDOMapping, `rww`). Most files say so of half of the
parameters, of the profile velocity as well as of the target position.

Source: CiA 301 v4.2.0, 7.4.1, table 41; CiA 302-3; the objects of CiA 401 and CiA 402-2.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from enum import StrEnum
from typing import Final

from canopen_proto import indices
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.download_order import reason_to_leave_out
from canopen_proto.dictionary.model import ObjectDictionary, Variable
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.multiplexer import AXIS_STEP, Mux, mapped, mux

IO_PROFILE: Final = 401
DRIVE_PROFILE: Final = 402
_PROFILE_MASK: Final = 0xFFFF
_ERROR_STATE: Final = (indices.ERROR_REGISTER, indices.MANUFACTURER_STATUS_REGISTER, indices.PREDEFINED_ERROR_FIELD)
"""Error register, manufacturer status register and history: process data even if no PDO may carry them."""

SET_POINTS: Final[Mapping[int, Collection[int]]] = {
    0x6042: range(1),  # vl target velocity
    0x6071: range(1),  # target torque
    0x607A: range(1),  # target position
    0x60B0: range(1),  # position offset
    0x60B1: range(1),  # velocity offset
    0x60B2: range(1),  # torque offset
    0x60C1: range(1, 0xFF),  # interpolation data record
    0x60FE: range(1, 2),  # digital outputs; :02 is their mask, a setting
    0x60FF: range(1),  # target velocity
}
"""Set-points of CiA 402, first axis: index -> subindices. (The control word is a command.)"""

_OUTPUTS: Final = (
    range(0x6200, 0x6201),  # 8 bits at once
    range(0x6220, 0x6230),  # single bits
    range(0x6300, 0x6301),  # 16 bits
    range(0x6320, 0x6321),  # 32 bits
    range(0x6410, 0x6415),  # analogue ones: 8, 16, 32 bits, REAL32, the manufacturer's form
)
"""Outputs of CiA 401."""


class Role(StrEnum):
    """The role of an object in a backup."""

    COMMUNICATION = "communication"
    """A setting of the communication profile area: PDOs, heartbeat, COB-IDs."""
    APPLICATION = "application"
    """Any other setting."""
    PROCESS = "process"
    """Actual values, set-points, outputs, error state: they change by themselves, and a restore leaves them alone."""
    FIXED = "fixed"
    """Read-only objects that are no actual values: identity, versions, capabilities."""
    COMMAND = "command"
    """Writable objects that are no settings: commands, and objects whose ObjFlags forbid a download."""


def role_of(
    dictionary: ObjectDictionary, variable: Variable, *, profile: int | None = None, carried: Collection[int] = ()
) -> Role:
    """Return the role of an object of this dictionary.

    profile: the device's profile number from `profile_in`; None = not known. carried: the muxes that valid RPDOs carry, from
    `carried_in`.
    """
    reason = reason_to_leave_out(dictionary.objects[variable.index], variable)
    if variable.index in _ERROR_STATE:
        return Role.PROCESS
    if not variable.access.writable:
        return Role.PROCESS if variable.pdo_mappable else Role.FIXED
    if reason:
        return Role.COMMAND
    if variable.index in indices.COMMUNICATION_AREA:
        return Role.COMMUNICATION
    if variable.mux in carried or _is_output(variable.index, variable.subindex, profile):
        return Role.PROCESS
    return Role.APPLICATION


def roles_in(dictionary: ObjectDictionary, values: Mapping[Mux, Value]) -> dict[int, Role]:
    """Return the role of each object of a device, by mux. values: of the device; missing ones are taken from the dictionary."""
    known = {each.mux: each.default if each.configured is None else each.configured for each in dictionary}
    held = {key: value for key, value in known.items() if value is not None} | dict(values)
    profile, carried = profile_in(held), carried_in(held)
    return {each.mux: role_of(dictionary, each, profile=profile, carried=carried) for each in dictionary}


def profile_in(values: Mapping[Mux, Value]) -> int | None:
    """Return the number of the device profile from the device type (0x1000); None if a device's values do not tell it."""
    device_type = values.get(mux(indices.DEVICE_TYPE))
    return (device_type & _PROFILE_MASK) or None if isinstance(device_type, int) else None


def carried_in(values: Mapping[Mux, Value]) -> frozenset[Mux]:
    """Return the muxes that the valid RPDOs carry, from the values of a device. An RPDO without a COB-ID counts as valid."""
    found: set[Mux] = set()
    for number in range(len(indices.RPDO_MAPPINGS)):
        count = values.get(mux(indices.RPDO_MAPPINGS.start + number))
        cob_id = values.get(mux(indices.RPDO_COMMUNICATION.start + number, 1), 0)
        if not isinstance(count, int) or (isinstance(cob_id, int) and cob_id & COB_ID_INVALID):
            continue
        for subindex in range(1, min(count, 64) + 1):
            entry = values.get(mux(indices.RPDO_MAPPINGS.start + number, subindex))
            if isinstance(entry, int):
                index, mapped_subindex, _ = mapped(entry)
                found.add(mux(index, mapped_subindex))
    return frozenset(found)


def _is_output(index: int, subindex: int, profile: int | None) -> bool:
    if profile in (DRIVE_PROFILE, None) and index in indices.PROFILE_AREA:
        first_axis = indices.PROFILE_AREA.start + (index - indices.PROFILE_AREA.start) % AXIS_STEP
        if subindex in SET_POINTS.get(first_axis, ()):
            return True
    return profile in (IO_PROFILE, None) and any(index in each for each in _OUTPUTS)
