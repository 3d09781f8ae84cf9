"""Follow set-points, one a SYNC: interpolated position mode (ip) and cyclic synchronous position mode (csp)."""

from __future__ import annotations

from canopen_proto.cia402 import objects
from canopen_proto.cia402.modes import Mode, ModeControl, ModeStatus
from canopen_proto.cia402.states import Command, State
from canopen_proto.drive.axis import OBEYED, Axis
from canopen_proto.drive.controlword import command
from canopen_proto.drive.failures import DriveError, accounted, require_reference
from canopen_proto.drive.halting import halt, halt_after
from canopen_proto.drive.state import enable, set_mode
from canopen_proto.drive.watching import wait_for_statusword
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.multiplexer import Mux, mux_text
from canopen_proto.procedures.objects import read_int, write
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, current_time


@accounted
def start_interpolation(axis: Axis, cycle_time: Time, *, sends_itself: bool = False) -> Procedure[float]:
    """Make the drive follow one set-point per SYNC in interpolated position mode; return the position where it starts.

    cycle_time: ns between two SYNCs, 1 to 255 ms, or 0.1 ms steps below 25.5 ms. sends_itself: the caller sends the set-points by
    a PDO of its own; else an RPDO that the node exchanges must carry them. The actual position is read and becomes the first
    set-point, so that nothing jumps. Raises ReferenceLost, ModeUnsupported, DriveFault, StateLost, ModeLost, NodeLost,
    StepTimeout; ProcedureError if no RPDO carries set-points, or none is sent. The drive is halted if this is cancelled.
    """
    goal = "interpolation active (bit 12)"
    set_point = objects.INTERPOLATION_SET_POINT
    yield from _prepare(axis, Mode.INTERPOLATED_POSITION, set_point, cycle_time, sends_itself)
    return (yield from _follow(axis, Mode.INTERPOLATED_POSITION, set_point, ModeStatus.IP_MODE_ACTIVE, goal))


@accounted
def start_cyclic_position(axis: Axis, cycle_time: Time, *, sends_itself: bool = False) -> Procedure[float]:
    """Do as `start_interpolation`, in cyclic synchronous position mode: 0x607A is the set-point, and bit 4 is not used."""
    goal = "follows command (bit 12)"
    yield from _prepare(axis, Mode.CYCLIC_SYNCHRONOUS_POSITION, objects.TARGET_POSITION, cycle_time, sends_itself)
    return (yield from _follow(axis, Mode.CYCLIC_SYNCHRONOUS_POSITION, objects.TARGET_POSITION, ModeStatus.FOLLOWS_COMMAND, goal))


def _carriers(axis: Axis, set_point: Mux) -> list[int]:
    """Return the numbers of the RPDOs that carry a set-point."""
    return [number for number, rpdo in axis.node.rpdos.items() if rpdo.mapping.find_component(set_point) is not None]


def _prepare(axis: Axis, mode: Mode, set_point: Mux, cycle_time: Time, sends_itself: bool) -> Procedure[None]:
    """Check that the drive has a reference and that set-points reach it; halt it, and select the mode."""
    require_reference(axis)
    if not sends_itself and not _carriers(axis, set_point):
        raise DriveError(
            axis,
            "would get no set-points",
            reason=f"no RPDO that is exchanged with it carries {mux_text(set_point)}",
            remedy="exchange one first (RemoteNode.add_pdo, or procedures.configure_pdo)",
        )
    axis.select_set_point(mode)
    yield from halt(axis)  # a moving drive would jump back to the position that was read
    yield from _align(axis, set_point)  # in csp the drive follows as soon as it has mode and power
    yield from set_mode(axis, mode)
    yield from _set_interpolation_period(axis, cycle_time)


def _align(axis: Axis, set_point: Mux) -> Procedure[int]:
    """Make the actual position the set-point, so that nothing jumps; return that position, in counts."""
    position = yield from read_int(axis.node, objects.POSITION_ACTUAL_VALUE)
    axis.set_position_counts(position)
    if set_point in axis.node.dictionary:
        yield from write(axis.node, set_point, position)
    return position


def _set_interpolation_period(axis: Axis, cycle_time: Time) -> Procedure[None]:
    """Write 0x60C2: the period is :1 * 10 ** :2 seconds; :1 is an UNSIGNED8."""
    if objects.INTERPOLATION_TIME_UNITS not in axis.node.dictionary:
        return
    exponent = -4 if cycle_time % MILLISECOND else -3
    units, rest = divmod(cycle_time, 10 ** (9 + exponent))
    if rest or not 1 <= units <= 255:
        cycle = f"{cycle_time / MILLISECOND:g} ms"
        reason = "it cannot be written to 0x60C2, which holds 1 to 255 units of 1 ms or 0.1 ms"
        raise DriveError(axis, f"cannot be given a cycle of {cycle}", reason=reason, remedy="another cycle")
    yield from write(axis.node, objects.INTERPOLATION_TIME_INDEX, exponent)
    yield from write(axis.node, objects.INTERPOLATION_TIME_UNITS, units)


def _follow(axis: Axis, mode: Mode, set_point: Mux, active: int, goal: str) -> Procedure[float]:
    node = axis.node
    yield from enable(axis)
    try:
        position = yield from _align(axis, set_point)
        now = yield from current_time()
        carriers = _carriers(axis, set_point)
        for number in carriers:
            node.enable_rpdo(number, now)
        if carriers and not any(node.rpdos[number].is_live for number in carriers):
            state = node.nmt_state.name if node.nmt_state is not None else "in an unknown NMT state"
            reason = f"RPDOs are sent to a node that is Operational, and this one is {state}"
            raise DriveError(axis, "would get no set-points", reason=reason, remedy="NMT start")
        yield from command(axis, int(Command.ENABLE_OPERATION))
        if mode == Mode.INTERPOLATED_POSITION:
            yield from command(axis, Command.ENABLE_OPERATION | ModeControl.ENABLE_INTERPOLATION)
        yield from wait_for_statusword(
            axis,
            lambda word: bool(word & active),
            axis.settings.state_timeout,
            goal,
            mode=mode,
            stays=State.OPERATION_ENABLED,
        )
        axis.started_at = OBEYED
    except (Cancelled, ProcedureError) as cause:
        yield from halt_after(axis, cause)
        raise
    return axis.from_counts(position)
