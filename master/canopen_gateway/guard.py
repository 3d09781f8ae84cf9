"""What a gateway lets its clients do: `Permission`s, the objects that need each of them, and the `Guard` that asks.

Reading is always allowed. Everything else is refused unless whoever started the gateway has allowed that kind. Each object has
one kind, by the table below; a kind that is allowed allows no other.

    write     any object that is in no other row: settings
    motion    what moves a drive: controlword, mode, targets, set-points, offsets, outputs (its brake); how it stops: option
              codes, error behaviour, whom it watches (0x100C, 0x100D, 0x1016, 0x1029); and what else may reach these: RPDOs and
              their mapping, SYNC, MPDOs. Of all eight axes. And all PDOs that a gateway sends: any may carry a set-point
    store     what outlasts the power: store and restore (0x1010, 0x1011), configurations kept in a device (0x1F20 to 0x1F22)
    program   programs and commands to the device's operating system (0x1023 to 0x1026, 0x1F50 to 0x1F58)
    nmt       NMT commands, node guarding, our own heartbeat; and the objects by which another NMT master gives commands
              (0x1F80 to 0x1F83)
    lss       all layer setting services: a search selects devices, too

An object of a maker's own (0x2000 to 0x5FFF) counts as a setting: only its manual knows whether it moves something. So does an
output of a device of another profile.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import Final

from canopen_gateway.errors import NotAllowedError
from canopen_proto import indices
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.axes import axis_of, swapped
from canopen_proto.multiplexer import index_of, mux


class Permission(Enum):
    """A kind of what clients may change."""

    WRITE = "write"
    MOTION = "motion"
    STORE = "store"
    PROGRAM = "program"
    NMT = "nmt"
    LSS = "lss"


_MOTION: Final = frozenset(
    map(
        index_of,
        (
            objects.ABORT_CONNECTION_OPTION_CODE,
            objects.CONTROLWORD,
            objects.VL_TARGET_VELOCITY,
            objects.QUICK_STOP_OPTION_CODE,
            objects.SHUTDOWN_OPTION_CODE,
            objects.DISABLE_OPERATION_OPTION_CODE,
            objects.HALT_OPTION_CODE,
            objects.FAULT_REACTION_OPTION_CODE,
            objects.MODES_OF_OPERATION,
            objects.TARGET_TORQUE,
            objects.TARGET_POSITION,
            objects.POSITION_OFFSET,
            objects.VELOCITY_OFFSET,
            objects.TORQUE_OFFSET,
            objects.INTERPOLATION_SET_POINT,
            objects.DIGITAL_OUTPUTS,
            objects.TARGET_VELOCITY,
            objects.POLARITY,
        ),
    )
) | {0x60EA}  # commutation angle, of cyclic synchronous torque with commutation angle

_RANGES: Final = (
    (range(indices.COB_ID_SYNC, indices.SYNCHRONOUS_WINDOW_LENGTH + 1), Permission.MOTION),
    (range(indices.GUARD_TIME, indices.LIFE_TIME_FACTOR + 1), Permission.MOTION),
    # What sends under a COB-ID of its own may be made to send under that of a set-point, or of the heartbeat that drives watch
    (range(indices.COB_ID_TIME_STAMP, 0x1016), Permission.MOTION),  # TIME, EMCY
    (range(0x1200, 0x1300), Permission.MOTION),  # SDO channels
    (range(0x1800, 0x1C00), Permission.MOTION),  # TPDOs
    (range(indices.CONSUMER_HEARTBEAT_TIME, indices.CONSUMER_HEARTBEAT_TIME + 1), Permission.MOTION),
    (range(indices.ERROR_BEHAVIOR, indices.ERROR_BEHAVIOR + 1), Permission.MOTION),
    (indices.RPDO_COMMUNICATION, Permission.MOTION),
    (indices.RPDO_MAPPINGS, Permission.MOTION),
    (range(0x1FA0, 0x2000), Permission.MOTION),  # what MPDOs carry, and where to: object scanner and dispatching lists
    (range(indices.STORE_PARAMETERS, indices.RESTORE_DEFAULT_PARAMETERS + 1), Permission.STORE),
    (range(indices.OS_COMMAND, indices.OS_PROMPT + 1), Permission.PROGRAM),
    (range(indices.STORE_DCF, indices.CONCISE_DCF + 1), Permission.STORE),
    (range(indices.PROGRAM_DATA, indices.FLASH_STATUS + 2), Permission.PROGRAM),
    (range(indices.NMT_STARTUP, indices.REQUEST_GUARDING + 1), Permission.NMT),
)


def permission_to_write(index: int, subindex: int = 0) -> Permission:
    """Return what a write of an object needs. The subindex decides nothing at present: a record is one thing."""
    for span, permission in _RANGES:
        if index in span:
            return permission
    axis = axis_of(mux(index, subindex))
    if axis is not None and index_of(swapped(mux(index, subindex), axis)) in _MOTION:
        return Permission.MOTION
    return Permission.WRITE


def parse_permissions(text: str) -> frozenset[Permission]:
    """Return the permissions of a text such as "write,motion". Raises ValueError for another word."""
    words = [word.strip() for word in text.split(",") if word.strip()]
    known = {each.value: each for each in Permission}
    if unknown := [word for word in words if word not in known]:
        raise ValueError(f"{unknown[0]!r} is no permission; there are {', '.join(known)}")
    return frozenset(known[word] for word in words)


class Guard:
    """Says no to what was not allowed. allowed: what was."""

    def __init__(self, allowed: Iterable[Permission] = ()) -> None:
        self.allowed = frozenset(allowed)

    def require(self, permission: Permission, what: str) -> None:
        """Raise NotAllowedError unless this was allowed. what: that it is for, for the text."""
        if permission not in self.allowed:
            raise NotAllowedError(permission.value, what)

    def require_write(self, index: int, subindex: int) -> None:
        """Raise NotAllowedError unless this object may be written."""
        self.require(permission_to_write(index, subindex), f"writing 0x{index:04X}:{subindex:02X}")

    @property
    def mode(self) -> str:
        """What is allowed, in words: "read-only", or "read, write, motion"."""
        if not self.allowed:
            return "read-only"
        return ", ".join(["read", *(each.value for each in Permission if each in self.allowed)])
