"""Home a drive: by the standard's homing mode, or as Schunk's joints do."""

from __future__ import annotations

from typing import Final

from canopen_proto.cia402.axis import Axis, HomingStyle
from canopen_proto.cia402.modes import HomingStatus, Mode, ModeControl, homing_status
from canopen_proto.cia402.states import Command, StatusBit
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.procedures.drive.halting import halt_after
from canopen_proto.procedures.drive.state import enable, set_mode
from canopen_proto.procedures.drive.statusword import command, name_of, wait_for_statusword
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, StepTimeout, sleep

REACTION_TIME: Final = 50 * MILLISECOND
"""What a drive may take until its statusword answers a command: an older "homing complete" must not end the next homing."""

START_TIME: Final = 1 * SECOND
"""How long a homing may take to begin to move."""


class HomingFailed(ProcedureError):
    """The drive reported a homing error, or ended its homing unreferenced."""


def home(axis: Axis) -> Procedure[None]:
    """Home the drive, from any state without fault, and wait for the end.

    Raises HomingFailed, DriveFault, ModeUnsupported, StepTimeout (`homing_timeout`). The drive is halted when that happens, and
    when it is cancelled.
    """
    settings = axis.settings
    axis.is_homed = False
    is_schunk = settings.homing is HomingStyle.SCHUNK
    yield from set_mode(axis, Mode.HOMING, waive_check=is_schunk)
    if settings.homing_method is not None and not is_schunk:
        yield from write(axis.node, "0x6098", settings.homing_method)
    yield from enable(axis)
    try:
        yield from command(axis, int(Command.ENABLE_OPERATION))
        yield from command(axis, Command.ENABLE_OPERATION | ModeControl.START_HOMING)
        yield from (_schunk_homing(axis) if is_schunk else _standard_homing(axis))
    except (Cancelled, ProcedureError) as cause:
        yield from halt_after(axis, cause)
        raise
    yield from command(axis, int(Command.ENABLE_OPERATION))
    axis.is_homed = True


def _standard_homing(axis: Axis) -> Procedure[None]:
    yield from sleep(REACTION_TIME)
    ends = (HomingStatus.COMPLETE, HomingStatus.ERROR_STOPPED, HomingStatus.ERROR_MOVING)
    statusword = yield from wait_for_statusword(
        axis,
        lambda word: homing_status(word) in ends,
        axis.settings.homing_timeout,
        "the end of homing",
    )
    if homing_status(statusword) is not HomingStatus.COMPLETE:
        raise HomingFailed(f"{name_of(axis)} reports a homing error: {axis.describe()}")


def _schunk_homing(axis: Axis) -> Procedure[None]:
    moving, referenced = StatusBit.MANUFACTURER_8, StatusBit.MANUFACTURER_15
    try:
        yield from wait_for_statusword(axis, lambda word: bool(word & moving), START_TIME, "the start of homing (bit 8)")
    except StepTimeout:
        # A joint that stands at its reference already need not move; or the movement was over between two reads.
        if not axis.statusword & referenced:
            raise
    timeout = axis.settings.homing_timeout
    statusword = yield from wait_for_statusword(axis, lambda word: not word & moving, timeout, "the end of homing (bit 8)")
    if not statusword & referenced:
        raise HomingFailed(f"{name_of(axis)} stopped, but is not referenced (bit 15): {axis.describe()}")
