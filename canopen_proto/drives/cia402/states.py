"""CiA 402 device control: states, commands and transitions as tables, for the drive's side and the master's.

A drive is in one of eight states and shows it in the low bits of its statusword (6041h). It changes state because the master
commands it (bits 7, 3, 2, 1, 0 of the controlword, 6040h) or because something happened inside. Both kinds of transition are in
one dict, `TRANSITIONS`: the drive (`drive.py`) executes it, the master finds the way to a state by `next_command`, and the tests
go through it row by row. No other place in this package knows a transition.

    start --0-> NOT READY TO SWITCH ON --1-> SWITCH ON DISABLED <-7--2-> READY TO SWITCH ON <-6--3-> SWITCHED ON <-5--4->
    OPERATION ENABLED.    OPERATION ENABLED --8-> READY TO SWITCH ON, --9-> SWITCH ON DISABLED, --11-> QUICK STOP ACTIVE.
    SWITCHED ON --10-> SWITCH ON DISABLED.    QUICK STOP ACTIVE --12-> SWITCH ON DISABLED, --16-> OPERATION ENABLED.
    Any state --13-> FAULT REACTION ACTIVE --14-> FAULT --15-> SWITCH ON DISABLED.

Three things that many stacks get wrong:

- A fault is reset by a rising edge of bit 7, so the bit has to be 0 first. While bit 7 is 1, there is no other command: every
  other row of the command table needs a 0 there.
- A quick stop ends in QUICK STOP ACTIVE only from OPERATION ENABLED. From READY TO SWITCH ON and SWITCHED ON it ends in SWITCH ON
  DISABLED (7, 10): never wait for the other state there.
- A statusword that fits no pattern is UNKNOWN; it is not a fault.

Source: IEC 61800-7-201 (CiA 402-2), device control: state machine, controlword, statusword.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import Final, TypeAlias

from canopen_proto.machine import LocalProtocolError


class State(StrEnum):
    """The states of a drive; str() gives words for messages. UNKNOWN: the statusword fits no pattern, or none came yet."""

    NOT_READY_TO_SWITCH_ON = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY_TO_SWITCH_ON = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION_ACTIVE = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "unknown"


FAULT_STATES: Final = (State.FAULT, State.FAULT_REACTION_ACTIVE)
"""In fault. In the second state the drive still has power, and brakes."""


POWERED: Final = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE)
"""The axis has power and may move. In all other states it has none, and there is nothing to stop."""


class StatusBit:
    """Bits of the statusword (6041h) that mean the same in all modes; those of the modes are in `modes.py`."""

    READY_TO_SWITCH_ON: Final = 1 << 0
    SWITCHED_ON: Final = 1 << 1
    OPERATION_ENABLED: Final = 1 << 2
    FAULT: Final = 1 << 3
    VOLTAGE_ENABLED: Final = 1 << 4
    QUICK_STOP: Final = 1 << 5  # 0 means that the quick stop is active
    SWITCH_ON_DISABLED: Final = 1 << 6
    WARNING: Final = 1 << 7
    MANUFACTURER_8: Final = 1 << 8  # Schunk: the drive is moving
    REMOTE: Final = 1 << 9
    TARGET_REACHED: Final = 1 << 10
    INTERNAL_LIMIT: Final = 1 << 11
    MANUFACTURER_14: Final = 1 << 14
    MANUFACTURER_15: Final = 1 << 15  # Schunk: the drive is referenced


class ControlBit:
    """Bits of the controlword (6040h) that mean the same in all modes; bits 4 to 6 and 9 belong to the mode (`modes.py`)."""

    SWITCH_ON: Final = 1 << 0
    ENABLE_VOLTAGE: Final = 1 << 1
    QUICK_STOP: Final = 1 << 2  # 0 commands the quick stop
    ENABLE_OPERATION: Final = 1 << 3
    FAULT_RESET: Final = 1 << 7  # rising edge
    HALT: Final = 1 << 8


STATUS_PATTERNS: Final[dict[State, tuple[int, int]]] = {
    State.NOT_READY_TO_SWITCH_ON: (0x4F, 0x00),
    State.SWITCH_ON_DISABLED: (0x4F, 0x40),
    State.READY_TO_SWITCH_ON: (0x6F, 0x21),
    State.SWITCHED_ON: (0x6F, 0x23),
    State.OPERATION_ENABLED: (0x6F, 0x27),
    State.QUICK_STOP_ACTIVE: (0x6F, 0x07),
    State.FAULT_REACTION_ACTIVE: (0x4F, 0x0F),
    State.FAULT: (0x4F, 0x08),
}
"""State -> (mask, value): the drive is in a state if `statusword & mask == value`; the patterns exclude each other."""

_STATE_BITS: Final = 0x6F


def _state_by_pattern(bits: int) -> State:
    for state, (mask, value) in STATUS_PATTERNS.items():
        if bits & mask == value:
            return state
    return State.UNKNOWN


_STATE_OF: Final = tuple(_state_by_pattern(bits) for bits in range(_STATE_BITS + 1))


def state_of(statusword: int) -> State:
    """Return the state that a statusword shows; UNKNOWN if it fits no pattern. Never raises."""
    return _STATE_OF[statusword & _STATE_BITS]


class Command(IntEnum):
    """The commands of a controlword. The value is the word that is usually sent for it (mode bits 0)."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    DISABLE_OPERATION = 0x07  # the same bits: SWITCH ON going up, DISABLE OPERATION coming down
    ENABLE_OPERATION = 0x0F
    FAULT_RESET = 0x80


COMMANDS: Final[dict[Command, tuple[int, int]]] = {
    Command.DISABLE_VOLTAGE: (0x82, 0x00),
    Command.QUICK_STOP: (0x86, 0x02),
    Command.SHUTDOWN: (0x87, 0x06),
    Command.SWITCH_ON: (0x8F, 0x07),
    Command.ENABLE_OPERATION: (0x8F, 0x0F),
    Command.FAULT_RESET: (0x80, 0x80),
}
"""Command -> (mask, value) over bits 7, 3, 2, 1, 0 of the controlword. Every word fits exactly one row."""

COMMAND_BITS: Final = 0x8F
"""The bits of a controlword that carry the command."""


def enables_operation(controlword: object) -> bool:
    """Return whether a controlword enables operation; True for an unknown one (None), which may do so."""
    return controlword is None or (isinstance(controlword, int) and controlword & COMMAND_BITS == Command.ENABLE_OPERATION)


def _command_by_pattern(word: int) -> Command:
    return next(command for command, (mask, value) in COMMANDS.items() if word & mask == value)


_COMMAND_OF: Final = tuple(_command_by_pattern(word) for word in range(256))


def command_of(controlword: int, previous: int) -> Command | None:
    """Return the command of a controlword after `previous`; None if bit 7 was 1 before, too (a reset is its rising edge)."""
    command = _COMMAND_OF[controlword & 0xFF]
    if command is Command.FAULT_RESET and previous & ControlBit.FAULT_RESET:
        return None
    return command


class Occurrence(IntEnum):
    """The events that make a drive change state by itself. (Their numbers differ from Command's: both are in TRANSITIONS.)"""

    POWER_ON = 0x100
    SELF_TEST_PASSED = 0x101
    QUICK_STOP_FINISHED = 0x102  # only if the quick stop option code (605Ah) does not say to stay
    FAULT_DETECTED = 0x103
    FAULT_REACTION_FINISHED = 0x104


Arc: TypeAlias = tuple[State, int]
"""The next state of a transition, and the transition's number in the standard."""

TRANSITIONS: Final[dict[tuple[State, Command | Occurrence], Arc]] = {
    # on the way up
    (State.UNKNOWN, Occurrence.POWER_ON): (State.NOT_READY_TO_SWITCH_ON, 0),
    (State.NOT_READY_TO_SWITCH_ON, Occurrence.SELF_TEST_PASSED): (State.SWITCH_ON_DISABLED, 1),
    (State.SWITCH_ON_DISABLED, Command.SHUTDOWN): (State.READY_TO_SWITCH_ON, 2),
    (State.READY_TO_SWITCH_ON, Command.SWITCH_ON): (State.SWITCHED_ON, 3),
    (State.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION): (State.SWITCHED_ON, 3),  # 4 follows at once, by the same word
    (State.SWITCHED_ON, Command.ENABLE_OPERATION): (State.OPERATION_ENABLED, 4),
    # on the way down
    (State.OPERATION_ENABLED, Command.DISABLE_OPERATION): (State.SWITCHED_ON, 5),
    (State.SWITCHED_ON, Command.SHUTDOWN): (State.READY_TO_SWITCH_ON, 6),
    (State.READY_TO_SWITCH_ON, Command.DISABLE_VOLTAGE): (State.SWITCH_ON_DISABLED, 7),
    (State.READY_TO_SWITCH_ON, Command.QUICK_STOP): (State.SWITCH_ON_DISABLED, 7),
    (State.OPERATION_ENABLED, Command.SHUTDOWN): (State.READY_TO_SWITCH_ON, 8),
    (State.OPERATION_ENABLED, Command.DISABLE_VOLTAGE): (State.SWITCH_ON_DISABLED, 9),
    (State.SWITCHED_ON, Command.DISABLE_VOLTAGE): (State.SWITCH_ON_DISABLED, 10),
    (State.SWITCHED_ON, Command.QUICK_STOP): (State.SWITCH_ON_DISABLED, 10),
    # quick stop
    (State.OPERATION_ENABLED, Command.QUICK_STOP): (State.QUICK_STOP_ACTIVE, 11),
    (State.QUICK_STOP_ACTIVE, Command.DISABLE_VOLTAGE): (State.SWITCH_ON_DISABLED, 12),
    (State.QUICK_STOP_ACTIVE, Occurrence.QUICK_STOP_FINISHED): (State.SWITCH_ON_DISABLED, 12),
    (State.QUICK_STOP_ACTIVE, Command.ENABLE_OPERATION): (State.OPERATION_ENABLED, 16),  # only if 605Ah says to stay (5 to 8)
    # faults
    (State.NOT_READY_TO_SWITCH_ON, Occurrence.FAULT_DETECTED): (State.FAULT_REACTION_ACTIVE, 13),
    (State.SWITCH_ON_DISABLED, Occurrence.FAULT_DETECTED): (State.FAULT_REACTION_ACTIVE, 13),
    (State.READY_TO_SWITCH_ON, Occurrence.FAULT_DETECTED): (State.FAULT_REACTION_ACTIVE, 13),
    (State.SWITCHED_ON, Occurrence.FAULT_DETECTED): (State.FAULT_REACTION_ACTIVE, 13),
    (State.OPERATION_ENABLED, Occurrence.FAULT_DETECTED): (State.FAULT_REACTION_ACTIVE, 13),
    (State.QUICK_STOP_ACTIVE, Occurrence.FAULT_DETECTED): (State.FAULT_REACTION_ACTIVE, 13),
    (State.FAULT_REACTION_ACTIVE, Occurrence.FAULT_REACTION_FINISHED): (State.FAULT, 14),
    (State.FAULT, Command.FAULT_RESET): (State.SWITCH_ON_DISABLED, 15),  # only if the fault's cause is gone
}
"""(state, command or occurrence) -> (next state, number of the transition). Any other pair changes nothing."""

TARGETS: Final = (
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.OPERATION_ENABLED,
    State.QUICK_STOP_ACTIVE,
)
"""The states into which a master can command a drive."""

_IN_MOTION: Final = (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)


def _first_commands() -> dict[tuple[State, State], Command]:
    """Return (current, target) -> the first command of the shortest way, found by breadth-first search backwards.

    No way leads through OPERATION ENABLED or QUICK STOP ACTIVE: a drive must not get power on its way to a state without power,
    nor be enabled only to be stopped.
    """
    first: dict[tuple[State, State], Command] = {}
    for target in TARGETS:
        reached = [target]
        for state in reached:
            for (current, trigger), (following, _) in TRANSITIONS.items():
                if following is not state or not isinstance(trigger, Command) or current in reached:
                    continue
                if state is target or state not in _IN_MOTION:
                    first[current, target] = trigger
                    reached.append(current)
    return first


_FIRST_COMMAND: Final = _first_commands()


def next_command(current: State, target: State) -> Command | None:
    """Return the command that leads a drive one state nearer to `target`. Call it again with the state that the drive shows then.

    Returns None if there is nothing to command: the drive is there, or leaves `current` by itself (NOT READY TO SWITCH ON, FAULT
    REACTION ACTIVE), or its state is UNKNOWN; wait for the next statusword. Command.FAULT_RESET takes effect on its rising edge:
    send a word with bit 7 clear before it. In QUICK STOP ACTIVE, a drive whose 605Ah is below 5 ignores ENABLE_OPERATION; it goes
    to SWITCH ON DISABLED by itself, and the next call continues from there.

    Raises LocalProtocolError for a target that cannot be commanded, and for QUICK STOP ACTIVE from any state except OPERATION
    ENABLED: from the others, a quick stop ends in SWITCH ON DISABLED or does nothing.
    """
    if target not in TARGETS:
        raise LocalProtocolError(f"state {target}: a drive cannot be commanded into it, only into {', '.join(TARGETS)}")
    if target is State.QUICK_STOP_ACTIVE and current not in _IN_MOTION:
        raise LocalProtocolError(f"state {target}: a quick stop leads there from {State.OPERATION_ENABLED}, not from {current}")
    return _FIRST_COMMAND.get((current, target))
