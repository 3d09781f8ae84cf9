"""Halt a drive: it stops and stays enabled. Also the clean-up of everything that moves a drive."""

from __future__ import annotations

from typing import Final

from canopen_proto.cia402.axis import Axis, HomingStyle
from canopen_proto.cia402.modes import Mode
from canopen_proto.cia402.states import Command, ControlBit, State, StatusBit, state_of
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.procedures.drive.statusword import command, name_of, read_statusword, wait_for_statusword
from canopen_proto.procedures.objects import read_int
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, StepTimeout, current_time, sleep

STANDSTILL_TIME: Final = 800 * MILLISECOND
"""How long a halt waits for the drive to report standstill; within CLEAN_UP_TIME."""

STANDSTILL_LOOK: Final = 30 * MILLISECOND
"""Between two looks at the position of a drive whose statusword does not tell that it stands."""

_SHOWS_STANDSTILL: Final = (
    Mode.PROFILE_POSITION,
    Mode.PROFILE_VELOCITY,
    Mode.TORQUE,
    Mode.HOMING,
    Mode.INTERPOLATED_POSITION,
)
"""Modes in which bit 10 of the statusword means "velocity 0" while bit 8 of the controlword is set. Others reserve it."""


def halt(axis: Axis) -> Procedure[None]:
    """Stop the drive by bit 8 (it stays enabled) and wait for standstill. A drive that is not enabled is left alone.

    Any later command without bit 8 ends the halt. Raises StepTimeout where the drive does not report standstill, SdoFailed.
    """
    statusword = yield from read_statusword(axis)
    if state_of(statusword) is not State.OPERATION_ENABLED:
        return
    controlword = axis.controlword if axis.controlword & 0x0F == Command.ENABLE_OPERATION else int(Command.ENABLE_OPERATION)
    yield from command(axis, controlword | ControlBit.HALT)

    is_schunk = axis.settings.homing is HomingStyle.SCHUNK
    if not is_schunk and axis.mode not in _SHOWS_STANDSTILL and "0x6064" in axis.node.dictionary:
        yield from _wait_for_same_position(axis)
        return

    def stands(word: int) -> bool:
        if state_of(word) is not State.OPERATION_ENABLED:
            return True
        return not word & StatusBit.MANUFACTURER_8 if is_schunk else bool(word & StatusBit.TARGET_REACHED)

    yield from wait_for_statusword(axis, stands, STANDSTILL_TIME, "standstill after a halt", accept_fault=True)


def _wait_for_same_position(axis: Axis) -> Procedure[None]:
    """Standstill as the actual position shows it: the same after STANDSTILL_LOOK, but for the last digit."""
    deadline = (yield from current_time()) + STANDSTILL_TIME
    position = yield from read_int(axis.node, "0x6064")
    while True:
        yield from sleep(STANDSTILL_LOOK)
        before, position = position, (yield from read_int(axis.node, "0x6064"))
        if abs(position - before) <= 1:
            return
        if (yield from current_time()) >= deadline:
            limit = f"{STANDSTILL_TIME / SECOND:g} s"
            raise StepTimeout(f"{name_of(axis)} did not reach standstill after a halt within {limit}: {axis.describe()}")


def halt_after(axis: Axis, cause: BaseException) -> Procedure[None]:
    """Halt as the clean-up of something that ended with `cause`; what goes wrong is noted there, or raised for a Cancelled."""
    try:
        yield from halt(axis)
    except ProcedureError as error:
        if isinstance(cause, Cancelled):
            raise
        cause.add_note(f"and the halt of {name_of(axis)} failed: {error}")
