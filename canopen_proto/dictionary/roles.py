"""What the objects of a device are to a backup: settings, which a restore writes, and the rest, which it leaves alone.

Theory of operation
-------------------
A configuration tool saves all that it can read, and writes back what configures the device (CiA 302-3: the download of a device's
configuration). Most of what is left out follows from the object itself: read-only, a command, a history (download_order.py). What
remains is process data: set-points and outputs. Writing these back is no configuration: it would switch outputs, or move a drive.

An object is process data where

- it is read-only, and a PDO may carry it: an actual value; or it tells the device's present error state;
- it can be written, and is a set-point of CiA 402 or an output of CiA 401. Of another profile, or where the device type is not
  known, these indices count too where nothing says otherwise;
- it can be written, and a valid RPDO of the device carries it: the next PDO decides what it holds.

That a PDO *may* carry it (PDOMapping, `rww`) does not make a writable object process data: in most files that stands at half of
the parameters, at the profile velocity as at the target position.

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
from canopen_proto.multiplexer import Mux, mapped, mux

IO_PROFILE: Final = 401
DRIVE_PROFILE: Final = 402
_PROFILE_MASK: Final = 0xFFFF
_ERROR_STATE: Final = (indices.ERROR_REGISTER, indices.MANUFACTURER_STATUS_REGISTER, indices.PREDEFINED_ERROR_FIELD)
"""Error register, manufacturer status register, history: they tell what is, whether a PDO may carry them or not."""
_PER_AXIS: Final = 0x800

_SET_POINTS: Final[Mapping[int, Collection[int]]] = {
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
"""Of CiA 402, first axis: index -> subindices. (The control word is a command.)"""

_OUTPUTS: Final = (
    range(0x6200, 0x6201),  # 8 bits at once
    range(0x6220, 0x6230),  # single bits
    range(0x6300, 0x6301),  # 16 bits
    range(0x6320, 0x6321),  # 32 bits
    range(0x6410, 0x6415),  # analogue ones: 8, 16, 32 bits, REAL32, the manufacturer's form
)
"""Of CiA 401."""


class Role(StrEnum):
    """What an object is to a backup."""

    COMMUNICATION = "communication"
    """A setting of the communication profile area: PDOs, heartbeat, COB-IDs."""
    APPLICATION = "application"
    """Any other setting."""
    PROCESS = "process"
    """Actual values, set-points, outputs, error state: they change by themselves, and are not written back."""
    FIXED = "fixed"
    """Read-only and no actual value: identity, versions, capabilities."""
    COMMAND = "command"
    """Writable, but no setting: commands, or kept out of a download by its ObjFlags."""


def role_of(
    dictionary: ObjectDictionary, variable: Variable, *, profile: int | None = None, carried: Collection[int] = ()
) -> Role:
    """What an object of this dictionary is to a backup.

    profile: the device's profile number, None = not known (see `profile_in`). carried: muxes that valid RPDOs carry (see
    `carried_in`).
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
    """The role of each object of a device, by mux. values: what it holds; what they do not tell, the dictionary does."""
    known = {each.mux: each.default if each.configured is None else each.configured for each in dictionary}
    held = {key: value for key, value in known.items() if value is not None} | dict(values)
    profile, carried = profile_in(held), carried_in(held)
    return {each.mux: role_of(dictionary, each, profile=profile, carried=carried) for each in dictionary}


def profile_in(values: Mapping[Mux, Value]) -> int | None:
    """The number of the device profile, by the device type (0x1000) among a device's values; None where it tells none."""
    device_type = values.get(mux(indices.DEVICE_TYPE))
    return (device_type & _PROFILE_MASK) or None if isinstance(device_type, int) else None


def carried_in(values: Mapping[Mux, Value]) -> frozenset[Mux]:
    """The muxes that the valid RPDOs carry of a device that holds these values. An RPDO of unknown COB-ID counts as valid."""
    found: set[Mux] = set()
    for number in range(len(indices.RPDO_MAPPINGS)):
        count = values.get(mux(indices.RPDO_MAPPINGS.start + number))
        cob_id = values.get(mux(indices.RPDO_COMMUNICATION.start + number, 1), 0)
        if not isinstance(count, int) or (isinstance(cob_id, int) and cob_id & COB_ID_INVALID):
            continue
        for subindex in range(1, min(count, 64) + 1):
            entry = values.get(mux(indices.RPDO_MAPPINGS.start + number, subindex))
            if isinstance(entry, int):
                found.add(mux(*mapped(entry)[:2]))
    return frozenset(found)


def _is_output(index: int, subindex: int, profile: int | None) -> bool:
    if profile in (DRIVE_PROFILE, None) and index in indices.PROFILE_AREA:
        first_axis = indices.PROFILE_AREA.start + (index - indices.PROFILE_AREA.start) % _PER_AXIS
        if subindex in _SET_POINTS.get(first_axis, ()):
            return True
    return profile in (IO_PROFILE, None) and any(index in each for each in _OUTPUTS)
