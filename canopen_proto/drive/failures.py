"""Why a drive does not do what it was told: the errors of these procedures, and what is found out for their texts."""

from __future__ import annotations

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
    """The drive is in Fault, or fell into it while something else was awaited."""


class NodeLost(ProcedureError):
    """The drive's node booted, fell silent (heartbeat, node guarding) or was stopped while something was awaited."""


class StateLost(ProcedureError):
    """The drive left the state that was needed: a quick stop, or a disable, that was not ours."""


class ModeLost(ProcedureError):
    """The drive shows another mode of operation (0x6061) than the one that was selected."""


class ModeUnsupported(ProcedureError):
    """The drive does not have a mode of operation (0x6502), or did not take it."""


class HomingFailed(ProcedureError):
    """The drive reported a homing error, or ended its homing unreferenced."""


class LimitReached(ProcedureError):
    """A limit lies before the target of a move. The drive has stopped there (0x607D, or another limit of its own), or was not
    moved at all (min_position, max_position of its settings)."""


class ReferenceLost(ProcedureError):
    """Positions of the drive mean something else than before, or nothing: it has to be homed again. Nothing was sent."""


def name_of(axis: Axis) -> str:
    """The drive in messages."""
    return f"drive {axis.node.node_id}"


def fault_of(axis: Axis, when: str) -> Procedure[DriveFault]:
    """What to raise for a drive in fault: with its error code (0x603F), which is read first, and its last EMCY."""
    try:
        yield from read_if_present(axis.node, "0x603F")
    except ProcedureError as error:
        when = f"{when} (its error code could not be read: {error})"
    return DriveFault(f"{name_of(axis)} is in fault {when}: {axis.describe()}. Try: find the cause, then reset the fault")


def state_lost(axis: Axis, state: State, goal: str) -> StateLost:
    """What to raise for a drive that shows `state`, and should not before `goal` is reached."""
    return StateLost(
        f"{name_of(axis)} went to {state} while waiting for {goal}: {axis.describe()}. Try: find out what took it there: another "
        "master, a quick stop, or an input of the drive (enable, safe torque off, limit switch)"
    )


def mode_lost(axis: Axis, mode: int, goal: str) -> ModeLost:
    """What to raise for a drive that shows another mode than `mode`, which it had."""
    return ModeLost(
        f"{name_of(axis)} left {mode_name(mode)} while waiting for {goal}: 0x6061 shows {mode_name(axis.mode or 0)}. Try: find "
        "out which other master writes its mode of operation (0x6060)"
    )


def is_loss_of(node: RemoteNode, report: Event) -> bool:
    """Whether an event says that the node booted, fell silent or was stopped."""
    if report.node_id != node.node_id:
        return False
    lost = isinstance(report, NodeBooted | HeartbeatLost | NodeGuardingLost)
    return lost or (isinstance(report, NmtStateReported) and report.state is NmtState.STOPPED)


def node_lost(axis: Axis, report: Event, goal: str) -> NodeLost:
    """What to raise for such an event."""
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
