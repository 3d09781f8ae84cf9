"""Move a drive: along set-points, one a SYNC (ip and csp), or to a position (pp)."""

from __future__ import annotations

from canopen_proto.cia402.axis import Axis
from canopen_proto.cia402.modes import Mode, ModeControl, ModeStatus
from canopen_proto.cia402.states import Command, StatusBit
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.procedures.drive.halting import halt_after
from canopen_proto.procedures.drive.state import enable, set_mode
from canopen_proto.procedures.drive.statusword import command, wait_for_statusword
from canopen_proto.procedures.objects import read_int, write
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, current_time


class ReferenceLost(ProcedureError):
    """Positions of the drive mean something else than before, or nothing: it has to be homed again. Nothing was sent."""


def _require_reference(axis: Axis) -> None:
    if axis.has_lost_reference:
        raise ReferenceLost(
            f"drive {axis.node.node_id} has lost its reference: it was homed, and then reset or without power, or homed without "
            "success. Try: home it again; AxisSettings(keeps_reference=True) if it has an absolute encoder"
        )


def start_interpolation(axis: Axis, cycle_time: Time) -> Procedure[float]:
    """Make the drive follow a set-point per SYNC in interpolated position mode; the position from which it does so.

    cycle_time: ns between two SYNCs, 1 to 255 ms or 0.1 ms steps below. The actual position is read and is the first set-point,
    so that nothing jumps when bit 4 is set. Raises ReferenceLost, ModeUnsupported, DriveFault, StepTimeout. Halted if cancelled
    half-way.
    """
    _require_reference(axis)
    yield from set_mode(axis, Mode.INTERPOLATED_POSITION)
    yield from _set_interpolation_period(axis, cycle_time)
    return (yield from _follow(axis, 0x60C1, 1, ModeControl.ENABLE_INTERPOLATION, ModeStatus.IP_MODE_ACTIVE))


def start_cyclic_position(axis: Axis, cycle_time: Time) -> Procedure[float]:
    """As start_interpolation, in cyclic synchronous position mode (0x607A is the set-point, and there is no bit 4)."""
    _require_reference(axis)
    yield from set_mode(axis, Mode.CYCLIC_SYNCHRONOUS_POSITION)
    yield from _set_interpolation_period(axis, cycle_time)
    return (yield from _follow(axis, 0x607A, 0, 0, ModeStatus.FOLLOWS_COMMAND))


def _set_interpolation_period(axis: Axis, cycle_time: Time) -> Procedure[None]:
    """Write 0x60C2: period = :1 * 10 ** :2 seconds, :1 being UNSIGNED8."""
    if (0x60C2, 1) not in axis.node.dictionary:
        return
    exponent = -4 if cycle_time % MILLISECOND else -3
    units, rest = divmod(cycle_time, 10 ** (9 + exponent))
    if rest or not 1 <= units <= 255:
        cycle = f"{cycle_time / MILLISECOND:g} ms"
        raise ProcedureError(f"a cycle of {cycle} cannot be written to 0x60C2: it holds 1 to 255 units of 1 ms or 0.1 ms")
    yield from write(axis.node, (0x60C2, 2), exponent)
    yield from write(axis.node, (0x60C2, 1), units)


def _follow(axis: Axis, index: int, subindex: int, start: int, active: int) -> Procedure[float]:
    node = axis.node
    yield from enable(axis)
    try:
        position = yield from read_int(node, "0x6064")
        axis.set_position_counts(position)
        if (index, subindex) in node.dictionary:
            yield from write(node, (index, subindex), position)
        now = yield from current_time()
        for number, producer in node.rpdos.items():
            if producer.mapping.find_component((index, subindex)) is not None:
                node.enable_rpdo(number, now)
        yield from command(axis, int(Command.ENABLE_OPERATION))
        yield from command(axis, Command.ENABLE_OPERATION | start)
        goal = "interpolation active (bit 12)" if start else "follows command (bit 12)"
        yield from wait_for_statusword(axis, lambda word: bool(word & active), axis.settings.state_timeout, goal)
    except (Cancelled, ProcedureError) as cause:
        yield from halt_after(axis, cause)
        raise
    return axis.from_counts(position)


def move_to(axis: Axis, position: float, *, timeout: Time, relative: bool = False) -> Procedure[None]:
    """Profile position: move to a position in the user's unit, with the drive's profile (0x6081, 0x6083), and wait for the end.

    The set-point handshake of CiA 402: bit 4 clear, target, bit 4 set, bit 12 acknowledges, bit 4 clear, bit 10 at the target.
    Halted when cancelled or failed. Raises ReferenceLost for a position that is not relative.
    """
    if not relative:
        _require_reference(axis)
    settings = axis.settings
    counts = axis.to_counts(position) - (settings.offset if relative else 0)
    yield from set_mode(axis, Mode.PROFILE_POSITION)
    yield from enable(axis)
    try:
        yield from command(axis, int(Command.ENABLE_OPERATION))
        yield from _wait_for_acknowledge(axis, False)
        yield from write(axis.node, "0x607A", counts)
        options = ModeControl.NEW_SET_POINT | (ModeControl.RELATIVE if relative else 0)
        yield from command(axis, Command.ENABLE_OPERATION | options)
        yield from _wait_for_acknowledge(axis, True)
        yield from command(axis, Command.ENABLE_OPERATION | options & ~ModeControl.NEW_SET_POINT)
        yield from wait_for_statusword(axis, lambda word: bool(word & StatusBit.TARGET_REACHED), timeout, "its target position")
    except (Cancelled, ProcedureError) as cause:
        yield from halt_after(axis, cause)
        raise


def _wait_for_acknowledge(axis: Axis, wanted: bool) -> Procedure[None]:
    yield from wait_for_statusword(
        axis,
        lambda word: bool(word & ModeStatus.SET_POINT_ACKNOWLEDGE) is wanted,
        axis.settings.state_timeout,
        f"set-point acknowledge (bit 12) = {int(wanted)}",
    )


def read_position(axis: Axis) -> Procedure[float]:
    """The actual position (0x6064), in the user's unit, read by SDO."""
    return axis.from_counts((yield from read_int(axis.node, "0x6064")))
