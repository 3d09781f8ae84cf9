"""The errors of the drive procedures, and the functions that make their texts."""

from __future__ import annotations

from canopen_proto.cia402 import objects
from canopen_proto.cia402.modes import mode_name
from canopen_proto.cia402.states import State
from canopen_proto.drive.axis import Axis
from canopen_proto.guarding import NodeGuardingLost
from canopen_proto.heartbeat import HeartbeatLost, NmtStateReported, NodeBooted
from canopen_proto.machine import SECOND, Event
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.objects import read_if_present
from canopen_proto.procedures.steps import Procedure, ProcedureError
from canopen_proto.remote_node import RemoteNode


class DriveFault(ProcedureError):
    """The drive is in Fault, or went into Fault during a wait."""


class NodeLost(ProcedureError):
    """The drive's node booted, fell silent (heartbeat, node guarding) or was stopped during a wait."""


class StateLost(ProcedureError):
    """The drive left the state that was needed: a quick stop or a disable that this master did not command."""


class ModeLost(ProcedureError):
    """The drive shows another mode of operation (0x6061) than the one that was selected."""


class ModeUnsupported(ProcedureError):
    """The drive does not have a mode of operation (0x6502), or did not take it."""


class HomingFailed(ProcedureError):
    """The drive reported a homing error, or ended its homing unreferenced."""


class LimitReached(ProcedureError):
    """A limit lies before the target of a move. The drive stopped at its own limit (0x607D or another), or was not moved at all
    (min_position, max_position of its settings)."""


class ReferenceLost(ProcedureError):
    """Positions of the drive may not mean what they meant before: the drive must be homed again. Nothing was sent."""


def name_of(axis: Axis) -> str:
    """Return the drive's name for messages."""
    return f"drive {axis.node.node_id}"


def fault_of(axis: Axis, when: str) -> Procedure[DriveFault]:
    """Read the error code (0x603F) of a drive in fault; return the error to raise, with that code and the last EMCY."""
    try:
        yield from read_if_present(axis.node, objects.ERROR_CODE)
    except ProcedureError as error:
        when = f"{when} (its error code could not be read: {error})"
    return DriveFault(f"{name_of(axis)} is in fault {when}: {axis.describe()}. Try: find the cause, then reset the fault")


def state_lost(axis: Axis, state: State, goal: str) -> StateLost:
    """Return the error to raise for a drive that went to `state` before it reached `goal`."""
    return StateLost(
        f"{name_of(axis)} went to {state} while waiting for {goal}: {axis.describe()}. Try: find out what took it there: another "
        "master, a quick stop, or an input of the drive (enable, safe torque off, limit switch)"
    )


def mode_lost(axis: Axis, mode: int, goal: str) -> ModeLost:
    """Return the error to raise for a drive that left `mode`."""
    return ModeLost(
        f"{name_of(axis)} left {mode_name(mode)} while waiting for {goal}: 0x6061 shows {mode_name(axis.mode or 0)}. Try: find "
        "out which other master writes its mode of operation (0x6060)"
    )


def is_loss_of(node: RemoteNode, report: Event) -> bool:
    """Return whether an event says that the node booted, fell silent or was stopped."""
    if report.node_id != node.node_id:
        return False
    lost = isinstance(report, NodeBooted | HeartbeatLost | NodeGuardingLost)
    return lost or (isinstance(report, NmtStateReported) and report.state is NmtState.STOPPED)


def node_lost(axis: Axis, report: Event, goal: str) -> NodeLost:
    """Return the error to raise for such an event."""
    match report:
        case HeartbeatLost(timeout=timeout):
            seen = f"no heartbeat came for {timeout / SECOND:g} s"
        case NodeGuardingLost(life_time=life_time):
            seen = f"it did not answer node guarding for {life_time / SECOND:g} s"
        case NodeBooted():
            seen = "it booted: it was reset, or its power was off"
        case _:
            seen = "it was stopped (NMT)"
    return NodeLost(f"{name_of(axis)} was lost while waiting for {goal}: {seen}. Try: look at the drive, its power and its cable")


def require_reference(axis: Axis) -> None:
    """Raise ReferenceLost for a drive that was homed and has lost its reference since."""
    if axis.has_lost_reference:
        raise ReferenceLost(
            f"{name_of(axis)} has lost its reference: it was homed, and then reset or without power, or homed without "
            "success. Try: home it again; AxisSettings(keeps_reference=True) if it has an absolute encoder"
        )
