"""The state machine and the option codes of CiA 402, written by hand from the standard's tables. Nothing here is our code.

The tests of the simulated drive and of the master's procedures ask this file for the truth. A mistake that stood in the product's
tables, which both sides share, would be seen by neither.

Source: IEC 61800-7-201 (CiA 402-2): state machine, controlword, statusword, option codes.
"""

from __future__ import annotations

from typing import Final, NamedTuple

START = "start"
NOT_READY = "not ready to switch on"
DISABLED = "switch on disabled"
READY = "ready to switch on"
SWITCHED_ON = "switched on"
ENABLED = "operation enabled"
QUICK_STOP = "quick stop active"
REACTION = "fault reaction active"
FAULT = "fault"
STATES = (NOT_READY, DISABLED, READY, SWITCHED_ON, ENABLED, QUICK_STOP, REACTION, FAULT)

STATUSWORDS: Final = {  # bits 6 to 0; x: any
    NOT_READY: "x0xx0000",
    DISABLED: "x1xx0000",
    READY: "x01x0001",
    SWITCHED_ON: "x01x0011",
    ENABLED: "x01x0111",
    QUICK_STOP: "x00x0111",
    REACTION: "x0xx1111",
    FAULT: "x0xx1000",
}

COMMANDS: Final = {  # bits 7, 3, 2, 1, 0 of the controlword
    "shutdown": "0x110",
    "switch on or disable operation": "00111",
    "enable operation": "01111",
    "disable voltage": "0xx0x",
    "quick stop": "0x01x",
}
RESET = "fault reset"  # bit 7 rises; the others do not matter

TRANSITIONS: Final = {  # number: from, command, to
    2: (DISABLED, "shutdown", READY),
    3: (READY, "switch on or disable operation", SWITCHED_ON),
    4: (SWITCHED_ON, "enable operation", ENABLED),
    5: (ENABLED, "switch on or disable operation", SWITCHED_ON),
    6: (SWITCHED_ON, "shutdown", READY),
    8: (ENABLED, "shutdown", READY),
    9: (ENABLED, "disable voltage", DISABLED),
    11: (ENABLED, "quick stop", QUICK_STOP),
    15: (FAULT, RESET, DISABLED),
    16: (QUICK_STOP, "enable operation", ENABLED),
}
TWICE: Final = {  # numbers with two commands, or with one that is another number elsewhere
    (READY, "disable voltage"): (DISABLED, 7),
    (READY, "quick stop"): (DISABLED, 7),
    (SWITCHED_ON, "disable voltage"): (DISABLED, 10),
    (SWITCHED_ON, "quick stop"): (DISABLED, 10),
    (QUICK_STOP, "disable voltage"): (DISABLED, 12),
}
ARCS: Final = {(here, command): (there, number) for number, (here, command, there) in TRANSITIONS.items()} | TWICE


def fits(word: int, pattern: str) -> bool:
    """Whether the low bits of a word are those of a pattern; x fits both."""
    return all(bit in ("x", "01"[word >> place & 1]) for place, bit in enumerate(reversed(pattern)))


def command_bits(word: int) -> int:
    """Bits 7, 3, 2, 1 and 0 side by side."""
    return word >> 3 & 0x10 | word & 0x0F


def command(word: int, previous: int) -> str:
    """The name of a controlword's command after another one; "" if it has none."""
    if word & 0x80:
        return "" if previous & 0x80 else RESET
    (found,) = (name for name, pattern in COMMANDS.items() if fits(command_bits(word), pattern))
    return found


def walk(state: str, word: int, previous: int) -> tuple[str, list[int]]:
    """The state that a controlword leads to, and the numbers of the transitions. 0x0F switches on and enables (3, then 4)."""
    given, numbers = command(word, previous), []
    if state == READY and given == "enable operation":
        state, numbers = SWITCHED_ON, [3]
    if (state, given) in ARCS:
        state, number = ARCS[state, given]
        numbers.append(number)
    return state, numbers


def state_of(statusword: int) -> str:
    """The name of a statusword's state; "" if it fits none."""
    return next((name for name, pattern in STATUSWORDS.items() if fits(statusword, pattern)), "")


class Stop(NamedTuple):
    """How an axis that moves comes to stand. ramp: the object that holds the deceleration, 0: the power is taken off at once.

    ends: the state in the end; numbers: of the transitions, in order; brakes_in: the state in which it brakes.
    """

    ramp: int
    ends: str
    numbers: list[int]
    brakes_in: str = ENABLED


OFF, SLOW_DOWN, QUICK, HARDEST = 0, 0x6084, 0x6085, 0x60C6

QUICK_STOP_OPTIONS: Final = {
    0: Stop(OFF, DISABLED, [11, 12]),
    1: Stop(SLOW_DOWN, DISABLED, [11, 12], QUICK_STOP),
    2: Stop(QUICK, DISABLED, [11, 12], QUICK_STOP),
    3: Stop(HARDEST, DISABLED, [11, 12], QUICK_STOP),
    4: Stop(HARDEST, DISABLED, [11, 12], QUICK_STOP),
    5: Stop(SLOW_DOWN, QUICK_STOP, [11], QUICK_STOP),
    6: Stop(QUICK, QUICK_STOP, [11], QUICK_STOP),
    7: Stop(HARDEST, QUICK_STOP, [11], QUICK_STOP),
    8: Stop(HARDEST, QUICK_STOP, [11], QUICK_STOP),
}
SHUTDOWN_OPTIONS: Final = {0: Stop(OFF, READY, [8]), 1: Stop(SLOW_DOWN, READY, [8])}
DISABLE_OPERATION_OPTIONS: Final = {0: Stop(OFF, SWITCHED_ON, [5]), 1: Stop(SLOW_DOWN, SWITCHED_ON, [5])}
HALT_OPTIONS: Final = {
    1: Stop(SLOW_DOWN, ENABLED, []),
    2: Stop(QUICK, ENABLED, []),
    3: Stop(HARDEST, ENABLED, []),
    4: Stop(HARDEST, ENABLED, []),
}
FAULT_REACTION_OPTIONS: Final = {
    0: Stop(OFF, FAULT, [13, 14]),
    1: Stop(SLOW_DOWN, FAULT, [13, 14], REACTION),
    2: Stop(QUICK, FAULT, [13, 14], REACTION),
    3: Stop(HARDEST, FAULT, [13, 14], REACTION),
    4: Stop(HARDEST, FAULT, [13, 14], REACTION),
}
"""Of an axis in Operation enabled."""
OPTIONS: Final = {
    0x605A: QUICK_STOP_OPTIONS,
    0x605B: SHUTDOWN_OPTIONS,
    0x605C: DISABLE_OPERATION_OPTIONS,
    0x605D: HALT_OPTIONS,
    0x605E: FAULT_REACTION_OPTIONS,
}
ABORT_CONNECTION_COMMANDS: Final = {0: "", 1: "fault", 2: "disable voltage", 3: "quick stop"}
"""0x6007 -> the command that a lost connection stands for."""

MODE_STATUS_BITS: Final = {  # mode -> the bits of 10, 12 and 13 that mean something in it
    1: {10, 12, 13},
    2: set(),
    3: {10, 12, 13},
    4: {10},
    6: {10, 12, 13},
    7: {10, 12},
    8: {12, 13},
    9: {12},
    10: {12},
}
MODES: Final = {1: "pp", 2: "vl", 3: "pv", 4: "tq", 6: "hm", 7: "ip", 8: "csp", 9: "csv", 10: "cst"}
