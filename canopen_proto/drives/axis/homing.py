"""Home a drive: by the standard's homing mode, or as Schunk's joints do.

A homing begins with the rising edge of bit 4. For up to `reaction_time` after the edge, the drive may still show the end of the
homing before. So a bit that shows an end counts for this homing once it was seen 0 after the edge. If it never was 0, it counts
once it was 1 for `reaction_time` without a break: the homing was done between two looks (methods 35 and 37), or the drive was at
its reference.

              homed                          failed            neither, and it stands
    standard  bits 13, 12, 10 = 0, 1, 1      bit 13 = 1        bits 13, 12, 10 = 0, 0, 1
    Schunk    bit 15 = 1, bit 8 = 0          -                 bit 15 = 0, bit 8 = 0

A drive shows "neither" before it begins, and between two parts of its way. For `reaction_time` without a break it means that the
homing did not begin, or was interrupted.

**A drive may act later than that.** So a homing that did not begin may still begin: bit 4 is withdrawn, and the axis remembers it
(`Axis.unanswered`). What such a homing shows later must not pass for the end of the next one. The next homing therefore first
sees that the drive has obeyed everything before (`drive.settle`), and fails if it has not. An end that stands in the statusword
before the edge is believed again only of a drive whose delay is known (`Axis.answer_time`): else it is settled, too.

The method is checked before anything is sent, then what the settings say of the homing is written (homing_parameters.py).

Source: IEC 61800-7-201 (CiA 402-2), homing mode: statusword.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import Final

from canopen_proto.drives.axis.axis import OBEYED, Axis, HomingStyle
from canopen_proto.drives.axis.controlword import command
from canopen_proto.drives.axis.exclusive_motion import moves
from canopen_proto.drives.axis.failures import HomingError, as_drive_errors
from canopen_proto.drives.axis.halting import halt, halt_after
from canopen_proto.drives.axis.homing_parameters import (
    check_home_position,
    check_homing_method,
    method_text,
    write_homing_parameters,
)
from canopen_proto.drives.axis.reasons import LIMIT_SWITCHES
from canopen_proto.drives.axis.state import enable, set_mode, settle
from canopen_proto.drives.axis.units import read_number
from canopen_proto.drives.axis.watching import DriveWait, read_statusword
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import HomingStatus, Mode, ModeControl, ModeStatus, homing_status
from canopen_proto.drives.cia402.states import Command, ControlBit, State, StatusBit
from canopen_proto.machine import SECOND, Event, Time
from canopen_proto.procedures.steps import Cancelled, Procedure, current_time


class HomingProgressed(Event):
    """A drive that homes as CiA 402 says shows another status of its homing. position: in the user's unit, as last heard.
    axis: of the node."""

    __match_args__ = ("node_id", "status", "position", "axis")

    def __init__(self, node_id: int, status: HomingStatus, position: float | None, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis
        self.status = status
        self.position = position


class _Ending(Enum):
    """The end of a homing that a statusword shows."""

    NONE = auto()
    HOMED = auto()
    FAILED = auto()
    STANDS = auto()


_STANDARD_ENDINGS: Final = {
    HomingStatus.COMPLETE: _Ending.HOMED,
    HomingStatus.ERROR_MOVING: _Ending.FAILED,
    HomingStatus.ERROR_STOPPED: _Ending.FAILED,
    HomingStatus.INTERRUPTED: _Ending.STANDS,
}
_STANDARD_BITS: Final = {_Ending.HOMED: ModeStatus.HOMING_ATTAINED, _Ending.FAILED: ModeStatus.HOMING_ERROR}
_SCHUNK_BITS: Final = {_Ending.HOMED: StatusBit.MANUFACTURER_15}
"""The bit that shows an end."""
_FREE: Final = "look whether the axis can move freely, and at its homing method (0x6098)"


@moves
@as_drive_errors
def home(axis: Axis) -> Procedure[None]:
    """Home the drive, from any state without fault, and wait for the end. A drive that moves is halted first.

    Returns when the drive stands at its new reference. On the way, `HomingProgressed` tells what the drive shows. Raises
    HomingError, DriveInFaultError, ModeUnsupportedError (also for a method that the drive lacks), StateLostError, ModeLostError,
    DriveLostError, StepTimeoutError (`homing_timeout`). After an error or a cancellation the drive is halted.
    """
    yield from check_homing_method(axis)
    yield from halt(axis)
    axis.is_homed = False
    if axis.unanswered:
        yield from settle(axis)
    is_schunk = axis.settings.homing is HomingStyle.SCHUNK
    yield from set_mode(axis, Mode.HOMING, waive_check=is_schunk)
    if not is_schunk:
        yield from write_homing_parameters(axis)
    yield from enable(axis)
    judge = _EndOfHoming(axis)
    if axis.answer_time is None and judge.shows_homed((yield from read_statusword(axis))):
        yield from settle(axis)
        yield from enable(axis)
    try:
        yield from command(axis, int(Command.ENABLE_OPERATION))
        judge.begin((yield from current_time()))
        yield from command(axis, Command.ENABLE_OPERATION | ModeControl.START_HOMING)
        yield from _wait_for_end(axis, judge)
    except (Cancelled, Exception) as cause:
        if judge.is_awaited:
            axis.leave_unanswered("a homing")
        yield from halt_after(axis, cause)
        raise
    axis.started_at = OBEYED
    yield from command(axis, int(Command.ENABLE_OPERATION))
    if not is_schunk:
        yield from check_home_position(axis)
    axis.is_homed = True


@moves
@as_drive_errors
def home_if_needed(axis: Axis) -> Procedure[bool]:
    """Home the drive unless it has its reference; return whether it was homed. Else as `home`.

    It has its reference if this master homed it and it did not boot since, if its settings say that it keeps its reference, or
    (Schunk) if bit 15 shows it.
    """
    has_reference = axis.is_homed or axis.settings.keeps_reference
    if not has_reference and axis.settings.homing is HomingStyle.SCHUNK and not axis.unanswered:
        has_reference = bool((yield from read_statusword(axis)) & StatusBit.MANUFACTURER_15)
    if not has_reference:
        yield from home(axis)
    return not has_reference


def _wait_for_end(axis: Axis, judge: _EndOfHoming) -> Procedure[None]:
    """Wait for the end of the homing whose edge has just reached the drive."""
    judge.begin((yield from current_time()))
    watch: DriveWait[_Ending] = DriveWait(axis, "the end of homing", mode=Mode.HOMING, stays=State.OPERATION_ENABLED)
    ending = yield from watch.until(judge.judge, axis.settings.homing_timeout)
    if ending is not _Ending.HOMED:
        remedy = _FREE
        if judge.is_awaited:
            yield from command(axis, Command.ENABLE_OPERATION | ControlBit.HALT)  # bit 4 is 0: it has nothing to begin
            remedy = f"{_FREE}; if it is only slow, a longer reaction_time in its settings"
        failed = "reports a homing error" if ending is _Ending.FAILED else judge.why_it_stands()
        raise HomingError(axis, failed, reason=(yield from _why_it_failed(axis)), remedy=remedy)


def _why_it_failed(axis: Axis) -> Procedure[str]:
    """Return the limit switch that the drive stands on, and the method it homed by, in words."""
    inputs = yield from read_number(axis.node, objects.DIGITAL_INPUTS)
    switches = [f"it stands on its {name} (0x60FD)" for bit, name in enumerate(LIMIT_SWITCHES) if (inputs or 0) >> bit & 1]
    return "; ".join(each for each in (*switches, method_text(axis)) if each)


class _EndOfHoming:
    """Judges which statuswords show the end of one homing; see this module's text.

    is_awaited: the homing was commanded, and the drive has shown nothing of it yet.
    """

    def __init__(self, axis: Axis) -> None:
        self.is_awaited = False
        self._axis = axis
        self._told: HomingStatus | None = None
        self._reaction_time: Time = 0
        self._is_schunk = axis.settings.homing is HomingStyle.SCHUNK
        self._bits = _SCHUNK_BITS if self._is_schunk else _STANDARD_BITS
        self._seen_clear = 0  # bits that were 0 after the edge
        self._shown: _Ending | None = None
        self._shown_since: Time = 0
        self._before = _Ending.STANDS  # what it showed when the edge was sent

    def begin(self, edge: Time) -> None:
        """Begin, or begin again, with the rising bit 4 that goes to the drive, or has reached it, at `edge`."""
        self.is_awaited, self._shown_since = True, edge
        self._reaction_time = self._axis.reaction_time
        self._before = self._ending_of(self._axis.statusword)

    def shows_homed(self, statusword: int) -> bool:
        """Return whether a statusword shows that a homing is complete, whichever it was."""
        return self._ending_of(statusword) is _Ending.HOMED

    def judge(self, statusword: int, heard_at: Time) -> _Ending | None:
        """Return the end that this statusword shows for certain, else None."""
        ending = self._ending_of(statusword)
        self._tell(statusword)
        self._seen_clear |= ~statusword
        if ending is not self._shown:
            if self._shown is not None:
                self._shown_since = heard_at
            self._shown = ending
        if ending is not self._before:
            self.is_awaited = False
        if ending is _Ending.NONE:
            return None
        is_new = self._seen_clear & self._bits.get(ending, 0)
        return ending if is_new or heard_at - self._shown_since >= self._reaction_time else None

    def _tell(self, statusword: int) -> None:
        """Report what the drive shows of the homing, if it has changed."""
        status = None if self._is_schunk else homing_status(statusword)
        if status is not None and status is not self._told:
            self._told = status
            node = self._axis.node
            node.out.events.append(HomingProgressed(node.node_id, status, self._axis.position, self._axis.number))

    def _ending_of(self, statusword: int) -> _Ending:
        if not self._is_schunk:
            return _STANDARD_ENDINGS.get(homing_status(statusword), _Ending.NONE)
        if statusword & StatusBit.MANUFACTURER_8:
            return _Ending.NONE
        return _Ending.HOMED if statusword & StatusBit.MANUFACTURER_15 else _Ending.STANDS

    def why_it_stands(self) -> str:
        """Return, for a message, why the drive stands, neither homed nor with an error."""
        if self.is_awaited:
            return f"did not begin to home within {self._reaction_time / SECOND:g} s (reaction_time), and may still begin"
        return "stopped, but is not referenced (bit 15)" if self._is_schunk else "stopped before it was homed: it was interrupted"
