"""CiA 402 modes of operation: their numbers, and the meaning of the mode bits of controlword and statusword in each.

The master requests a mode in 6060h, the drive shows the active one in 6061h, and 6502h says which modes it has: bit 0 for mode 1,
and so on. Positive numbers are the standard's, negative ones the manufacturer's. Unknown numbers are allowed: every function here
takes an int, and none raises. Bits 4, 5, 6 and 9 of the controlword and 10, 12 and 13 of the statusword change their meaning with
the mode.

Left out: the mode bits of manufacturers' modes.

Source: IEC 61800-7-201 (CiA 402-2), modes of operation; CiA 402-2, 6502h supported drive modes.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import Final

from canopen_proto.drives.cia402.states import COMMANDS, Command, State, StatusBit, state_of


class Mode(IntEnum):
    """Modes of operation (6060h, 6061h)."""

    NO_MODE = 0
    PROFILE_POSITION = 1
    VELOCITY = 2
    PROFILE_VELOCITY = 3
    TORQUE = 4
    HOMING = 6
    INTERPOLATED_POSITION = 7
    CYCLIC_SYNCHRONOUS_POSITION = 8
    CYCLIC_SYNCHRONOUS_VELOCITY = 9
    CYCLIC_SYNCHRONOUS_TORQUE = 10


_SHORT_NAMES: Final[dict[int, str]] = {1: "pp", 2: "vl", 3: "pv", 4: "tq", 6: "hm", 7: "ip", 8: "csp", 9: "csv", 10: "cst"}
_SUPPORTED_MODES_BITS: Final = 16  # 6502h: bits 0 to 15 for modes 1 to 16, bits 16 to 31 for the manufacturer


def supported(supported_drive_modes: int, mode: int) -> bool:
    """Return whether a drive with this value of 6502h has the mode; False for a manufacturer's mode (below 0): it has no bit."""
    return 1 <= mode <= _SUPPORTED_MODES_BITS and bool(supported_drive_modes >> (mode - 1) & 1)


def supported_modes(supported_drive_modes: int) -> tuple[int, ...]:
    """Return the standard modes of a drive with this value of 6502h, as numbers: some may be newer than `Mode`."""
    return tuple(mode for mode in range(1, _SUPPORTED_MODES_BITS + 1) if supported(supported_drive_modes, mode))


def mode_name(mode: int) -> str:
    """Return a mode in words: "interpolated position (ip)", "manufacturer's mode -3", "reserved mode 5"."""
    if mode == Mode.NO_MODE:
        return "no mode"
    if mode in _SHORT_NAMES:
        return f"{Mode(mode).name.replace('_', ' ').lower()} ({_SHORT_NAMES[mode]})"
    return f"{'manufacturer’s' if mode < 0 else 'reserved'} mode {mode}"


def short_name(mode: int) -> str:
    """Return the standard's short name of a mode: "csp"; the number for a mode that has none."""
    return _SHORT_NAMES.get(mode, str(mode))


class ModeControl:
    """Bits of the controlword whose meaning depends on the mode."""

    NEW_SET_POINT: Final = 1 << 4  # pp: rising edge
    CHANGE_SET_IMMEDIATELY: Final = 1 << 5  # pp: 1 drops the running set-point, 0 finishes it first
    RELATIVE: Final = 1 << 6  # pp: 0 target position is absolute, 1 relative (60F2h says to what)
    CHANGE_ON_SET_POINT: Final = 1 << 9  # pp: go through the running set-point without stopping there
    START_HOMING: Final = 1 << 4  # hm: hold 1; 0 interrupts
    ENABLE_INTERPOLATION: Final = 1 << 4  # ip
    ENABLE_RAMP: Final = 1 << 4  # vl
    UNLOCK_RAMP: Final = 1 << 5  # vl
    REFERENCE_RAMP: Final = 1 << 6  # vl


class ModeStatus:
    """Bits of the statusword whose meaning depends on the mode (bit 10: StatusBit.TARGET_REACHED)."""

    SET_POINT_ACKNOWLEDGE: Final = 1 << 12  # pp: 1 the set-point was taken, 0 ready for the next
    FOLLOWING_ERROR: Final = 1 << 13  # pp, csp
    SPEED_ZERO: Final = 1 << 12  # pv
    MAX_SLIPPAGE: Final = 1 << 13  # pv
    HOMING_ATTAINED: Final = 1 << 12  # hm
    HOMING_ERROR: Final = 1 << 13  # hm
    IP_MODE_ACTIVE: Final = 1 << 12  # ip
    FOLLOWS_COMMAND: Final = 1 << 12  # csp, csv, cst: 0 means that the drive ignores the target


class HomingStatus(StrEnum):
    """The meaning of bits 13, 12 and 10 in homing mode; str() gives words for messages."""

    IN_PROGRESS = "homing is in progress"
    INTERRUPTED = "homing was interrupted or has not started"
    ATTAINED = "homing is attained, the axis still moves"
    COMPLETE = "homing is complete"
    ERROR_MOVING = "homing failed, the axis still moves"
    ERROR_STOPPED = "homing failed, the axis stands"
    RESERVED = "homing shows a combination that the standard reserves"


HOMING_STATUS: Final[dict[tuple[int, int, int], HomingStatus]] = {
    (0, 0, 0): HomingStatus.IN_PROGRESS,
    (0, 0, 1): HomingStatus.INTERRUPTED,
    (0, 1, 0): HomingStatus.ATTAINED,
    (0, 1, 1): HomingStatus.COMPLETE,
    (1, 0, 0): HomingStatus.ERROR_MOVING,
    (1, 0, 1): HomingStatus.ERROR_STOPPED,
    (1, 1, 0): HomingStatus.RESERVED,
    (1, 1, 1): HomingStatus.RESERVED,
}
"""(bit 13, bit 12, bit 10) of the statusword in homing mode -> their meaning."""

HOMING_BITS: Final[dict[HomingStatus, int]] = {
    status: error << 13 | attained << 12 | reached << 10
    for (error, attained, reached), status in HOMING_STATUS.items()
    if status is not HomingStatus.RESERVED
}
"""The reverse: a meaning -> the bits that a drive shows."""


def homing_status(statusword: int) -> HomingStatus:
    """Return what a statusword shows of a homing; valid only while 6061h shows homing mode."""
    return HOMING_STATUS[statusword >> 13 & 1, statusword >> 12 & 1, statusword >> 10 & 1]


_COMMON_BITS: Final = (
    (StatusBit.VOLTAGE_ENABLED, "voltage enabled"),
    (StatusBit.WARNING, "warning"),
    (StatusBit.REMOTE, "remote"),
    (StatusBit.TARGET_REACHED, "target reached"),
    (StatusBit.INTERNAL_LIMIT, "internal limit active"),
)
_MODE_BITS: Final[dict[int, tuple[str, str]]] = {
    Mode.PROFILE_POSITION: ("set-point acknowledged", "following error"),
    Mode.PROFILE_VELOCITY: ("speed is zero", "slippage too large"),
    Mode.INTERPOLATED_POSITION: ("interpolation active", ""),
    Mode.CYCLIC_SYNCHRONOUS_POSITION: ("follows the command", "following error"),
    Mode.CYCLIC_SYNCHRONOUS_VELOCITY: ("follows the command", ""),
    Mode.CYCLIC_SYNCHRONOUS_TORQUE: ("follows the command", ""),
}
"""Mode -> the meaning of bits 12 and 13 in it ("" if the standard reserves the bit)."""


def describe_status(statusword: int, mode: int | None = None) -> tuple[str, ...]:
    """Return a statusword in words, by the mode that 6061h shows: ("operation enabled", "interpolation active").

    The state comes first. In homing mode, one `HomingStatus` stands for bits 10, 12 and 13; "in progress" (none of them) is said
    only of a drive that is enabled. mode: None if it is not known; bits 12 and 13, whose meaning depends on it, are left out
    then.
    """
    state = state_of(statusword)
    words = [str(state) if state is not State.UNKNOWN else f"unknown state 0x{statusword:04X}"]
    for bit, text in _COMMON_BITS:
        if statusword & bit and not (mode == Mode.HOMING and bit == StatusBit.TARGET_REACHED):
            words.append(text)
    if mode == Mode.HOMING:
        homing = homing_status(statusword)
        if state is State.OPERATION_ENABLED or homing is not HomingStatus.IN_PROGRESS:
            words.append(str(homing))
    for shift, text in zip((12, 13), _MODE_BITS.get(mode if mode is not None else Mode.NO_MODE, ("", "")), strict=True):
        if text and statusword >> shift & 1:
            words.append(text)
    return tuple(words)


_COMMAND_WORDS: Final[dict[Command, str]] = {command: command.name.replace("_", " ").lower() for command in Command}
_CONTROL_BITS: Final[dict[int, dict[int, str]]] = {
    Mode.PROFILE_POSITION: {4: "new set-point", 5: "change immediately", 6: "relative", 9: "change on set-point"},
    Mode.VELOCITY: {4: "ramp enabled", 5: "ramp unlocked", 6: "ramp follows the target"},
    Mode.HOMING: {4: "homing"},
    Mode.INTERPOLATED_POSITION: {4: "interpolation"},
}
"""Mode -> the meaning of the bits of the controlword that are its own."""


def describe_command(controlword: int, mode: int | None = None) -> tuple[str, ...]:
    """Return a controlword in words, by the mode that 6061h shows: ("enable operation", "new set-point", "halt").

    The command comes first. mode: None if it is not known; bits 4, 5, 6 and 9 are then only numbered, as the manufacturer's are.
    """
    names = {8: "halt", **_CONTROL_BITS.get(mode if mode is not None else Mode.NO_MODE, {})}
    command = next(each for each, (mask, value) in COMMANDS.items() if controlword & mask == value)
    others = (bit for bit in (4, 5, 6, *range(8, 16)) if controlword >> bit & 1)
    return (_COMMAND_WORDS[command], *(names.get(bit, f"bit {bit}") for bit in others))
