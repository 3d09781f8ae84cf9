"""The errors of the drive procedures. Each carries one account of what the drive showed, and one text is made of it.

    drive 5 did not reach operation enabled within 3 s: its power stage has no voltage (bit 4 is 0); statusword 0x0240: switch on
    disabled, remote; commanded 0x0006 (shutdown). Try: look at the motor supply, and at safe torque off

First comes what failed, then the one obstacle that was found (reasons.py), then what the drive showed, then what to try.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Concatenate, ParamSpec, TypeVar

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.axis.reasons import Reason, look_closer, outer_reason
from canopen_proto.drives.axis.view import DriveView, view_of
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import mode_name
from canopen_proto.drives.cia402.states import State
from canopen_proto.error_codes import error_text
from canopen_proto.guarding import NodeGuardingLost
from canopen_proto.heartbeat import HeartbeatLost, NmtStateReported, NodeBooted
from canopen_proto.machine import SECOND, Event
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.objects import read_if_present
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoTransferError, StepTimeoutError

T = TypeVar("T")
P = ParamSpec("P")


class DriveError(ProcedureError):
    """A drive did not do what it was told.

    node_id: of the drive; axis: of the node, 0 for the first one. failed: what failed. view: what the drive showed and was
    commanded (state, statusword, modes, error code, last emergency). reason: the obstacle that was found, in words; "" if
    there is none. remedy: what to try, or "".
    """

    def __init__(
        self, axis: Axis, failed: str, *, reason: str = "", remedy: str = "", view: DriveView | None = None, looks: bool = True
    ) -> None:
        """failed: without the drive's name, as "is in fault". reason, remedy: without a reason, those that `view` shows count, if
        it shows any and unless `looks` is False. view: by default what was heard."""
        self.view = view_of(axis) if view is None else view
        found = outer_reason(self.view) if looks and not reason else None
        self._tell(axis, f"{name_of(axis)} {failed}", found or Reason(reason, remedy))

    def _tell(self, axis: Axis, failed: str, found: Reason) -> None:
        self.node_id, self.axis = axis.node.node_id, axis.number
        self.failed = failed
        self.reason, self.remedy, _ = found
        reason = f"{self.reason}; " if self.reason else ""
        Exception.__init__(self, f"{failed}: {reason}{self.view.describe()}" + (f". Try: {self.remedy}" if self.remedy else ""))


class DriveTimeoutError(DriveError, StepTimeoutError):
    """The drive did not reach a goal in time."""


class DriveAccessError(DriveError, SdoTransferError):
    """The drive refused an object that a procedure reads or writes (6040h, 6060h, 607Ah ...), or did not answer. It has the
    fields of SdoTransferError, too."""

    def __init__(self, axis: Axis, failed: SdoTransferError) -> None:
        SdoTransferError.__init__(self, failed.aborted, failed.attempt)
        self.view = view_of(axis)
        found = outer_reason(self.view)
        if found is None and failed.origin is AbortOrigin.TIMEOUT:
            found = Reason("it is silent", "look at its power, its cable and its node-ID")
        elif found is None and is_loss(failed):
            is_silent = axis.remote.heartbeat.lost or axis.remote.guarding.lost
            found = Reason(_NO_SIGN if is_silent else _BOOTED, _LOOK_AT_POWER)
        elif found is None:
            found = Reason("", _REMEDIES.get(axis.node.on_device(mux(failed.index, failed.subindex)), ""))
        self._tell(axis, str(failed), found)


_REMEDIES = {
    objects.CONTROLWORD: "look whether the drive lets the fieldbus command it, in this NMT state",
    objects.MODES_OF_OPERATION: (
        "AxisSettings(mode_change_state=State.SWITCHED_ON), or lower: some drives change their mode only while they have no power"
    ),
    objects.TARGET_POSITION: "look at its limits (0x607D), and whether it is homed",
}
"""The remedy if a drive refuses an object, and shows no obstacle."""

_BOOTED = "it booted: it was reset, or its power was off"
_NO_SIGN = "its heartbeat, or its answers to node guarding, stopped"
_LOOK_AT_POWER = "look at the drive, its power and its cable"

_WHAT_TOOK_IT = (
    "find out what took it there: another master, a quick stop, or an input of the drive (enable, safe torque off, limit switch)"
)


class DriveInFaultError(DriveError):
    """The drive is in Fault, or went into Fault during a wait."""


class DriveLostError(DriveError):
    """The drive's node booted, fell silent (heartbeat, node guarding) or was stopped during a wait."""


class StateLostError(DriveError):
    """The drive left the state that was needed: a quick stop or a disable that this master did not command."""


class ModeLostError(DriveError):
    """The drive shows another mode of operation (0x6061) than the one that was selected."""


class ModeUnsupportedError(DriveError):
    """The drive does not have a mode of operation (0x6502), or did not take it."""


class HomingError(DriveError):
    """The drive reported a homing error, or ended its homing unreferenced."""


class LimitReachedError(DriveError):
    """A limit lies before the target of a move. The drive stopped at its own limit (0x607D or another), or was not moved at all
    (min_position, max_position of its settings)."""


class AxisBusyError(DriveError):
    """Another command moves the axis. Nothing was sent."""

    def __init__(self, axis: Axis, name: str, occupant: str) -> None:
        """name: the command that was refused; occupant: the one under way."""
        reason = f"{occupant} is under way; nothing was sent"
        super().__init__(axis, f"cannot {name} now", reason=reason, remedy="wait for its end, or halt the drive first")


class TakenOverError(DriveError):
    """A stop took the place of a command that moved the axis, and sees that the axis stands."""

    def __init__(self, axis: Axis, name: str, stop: str) -> None:
        """name: the command that ended; stop: the one that ended it."""
        super().__init__(axis, f"was taken from {name}", reason=f"{stop} took over", looks=False)


class ReferenceLostError(DriveError):
    """Positions of the drive may not mean what they meant before: the drive must be homed again. Nothing was sent."""


def name_of(axis: Axis) -> str:
    """Return the drive's name for messages."""
    return axis.title


def as_drive_errors(procedure: Callable[Concatenate[Axis, P], Procedure[T]]) -> Callable[Concatenate[Axis, P], Procedure[T]]:
    """Let a procedure's SDO failures tell what the drive showed: they become DriveAccessError."""

    @wraps(procedure)
    def run(axis: Axis, /, *args: P.args, **kwargs: P.kwargs) -> Procedure[T]:
        try:
            return (yield from procedure(axis, *args, **kwargs))
        except SdoTransferError as failed:
            if isinstance(failed, DriveError):
                raise
            error = DriveAccessError(axis, failed)
            for note in getattr(failed, "__notes__", ()):
                error.add_note(note)
            raise error from failed

    return run


def fault_of(axis: Axis, when: str) -> Procedure[DriveInFaultError]:
    """Read the error code (0x603F) of a drive in fault; return the error to raise, with that code and the last EMCY. when: for
    the text, as in "while it moved"."""
    try:
        yield from read_if_present(axis.node, objects.ERROR_CODE)
    except ProcedureError as error:
        when = f"{when} (its error code could not be read: {error})"
    code = axis.error_code
    reason = f"0x{code:04X} {error_text(code)}" if code else ""
    return DriveInFaultError(
        axis, f"is in fault {when}", reason=reason, remedy="find the cause, then reset the fault", looks=False
    )


def late(axis: Axis, failed: str, *, looks: bool = True) -> Procedure[DriveTimeoutError]:
    """Return the error to raise for a drive that did not do something in time. looks: read first what tells why. failed: what it
    did not do, for the text."""
    view = (yield from look_closer(axis)) if looks else view_of(axis)
    return DriveTimeoutError(axis, failed, remedy="more time, if it is only slow", view=view)


def state_lost(axis: Axis, state: State, goal: str) -> StateLostError:
    """Return the error to raise for a drive that went to `state` before it reached `goal`."""
    return StateLostError(axis, f"went to {state} while waiting for {goal}", remedy=_WHAT_TOOK_IT)


def taken_down(axis: Axis) -> StateLostError:
    """Return the error to raise for a drive that somebody else has disabled since its motion began: it is not enabled again."""
    return StateLostError(axis, "was disabled during its motion, and is not enabled again", remedy=_WHAT_TOOK_IT)


def mode_lost(axis: Axis, mode: int, goal: str) -> ModeLostError:
    """Return the error to raise for a drive that left `mode`. goal: what was waited for, for the text."""
    view = view_of(axis)
    reason, remedy = (
        f"0x6061 shows {mode_name(axis.mode or 0)}",
        "find out which other master writes its mode of operation (0x6060)",
    )
    if view.foreign is not None:
        reason = f"{view.foreign}"
    return ModeLostError(axis, f"left {mode_name(mode)} while waiting for {goal}", reason=reason, remedy=remedy, view=view)


def is_loss_of(node: AxisNode, report: Event) -> bool:
    """Return whether an event says that the node booted, fell silent or was stopped."""
    if report.node_id != node.node_id:
        return False
    lost = isinstance(report, NodeBooted | HeartbeatLost | NodeGuardingLost)
    return lost or (isinstance(report, NmtStateReported) and report.state is NmtState.STOPPED)


def is_loss(error: ProcedureError) -> bool:
    """Return whether a procedure failed because the node booted, fell silent or was stopped."""
    return isinstance(error, DriveLostError) or (
        isinstance(error, SdoTransferError)
        and error.origin is AbortOrigin.LOCAL
        and error.abort_code == AbortCode.NO_SDO_CONNECTION
    )


def node_lost(axis: Axis, report: Event, goal: str) -> DriveLostError:
    """Return the error to raise for an event of `is_loss_of`. goal: what was waited for, for the text."""
    match report:
        case HeartbeatLost(timeout=timeout):
            seen = f"no heartbeat came for {timeout / SECOND:g} s"
        case NodeGuardingLost(life_time=life_time):
            seen = f"it did not answer node guarding for {life_time / SECOND:g} s"
        case NodeBooted():
            seen = _BOOTED
        case _:
            seen = "it was stopped (NMT)"
    return DriveLostError(axis, f"was lost while waiting for {goal}", reason=seen, remedy=_LOOK_AT_POWER)


def require_reference(axis: Axis) -> None:
    """Raise ReferenceLostError for a drive that was homed and has lost its reference since."""
    if axis.has_lost_reference:
        raise ReferenceLostError(
            axis,
            "has lost its reference",
            reason="it was homed, and then reset or without power, or homed without success",
            remedy="home it again; AxisSettings(keeps_reference=True) if it has an absolute encoder",
        )
