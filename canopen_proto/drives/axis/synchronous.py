"""Follow set-points, one a SYNC: cyclic synchronous position, velocity and torque mode (csp, csv, cst).

Interpolated position mode (ip) begins in the same way; see interpolation.py. Each start does this, in this order:

    1. the drive is halted, and stands
    2. its set-point becomes what it has now: its position (csp, ip), velocity 0 (csv), the torque that holds it (cst). Its
       offsets become 0
    3. the mode is selected, the period is written to 0x60C2
    4. the drive is enabled, the set-point is written once more, and the RPDO with it is sent from now on
    5. the halt ends, and the start waits for bit 12, "the drive follows the command"

So nothing jumps. If a start fails or is cancelled, it halts the drive. From then on the caller gives set-points
(`Axis.set_points`), and watches the drive (`Following`).

In csv and cst no position is commanded, and there is no following error. `watch_bounds` watches and halts such a drive instead.

Source: IEC 61800-7-201 (CiA 402-2): cyclic synchronous position, velocity, torque mode; interpolation time period 60C2h.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Final, TypeAlias

from canopen_proto.abort import AbortOrigin
from canopen_proto.datatypes import range_of
from canopen_proto.drives.axis.axis import OBEYED, Axis
from canopen_proto.drives.axis.axis_node import rpdos_with
from canopen_proto.drives.axis.controlword import command
from canopen_proto.drives.axis.exclusive_motion import moves
from canopen_proto.drives.axis.failures import DriveError, as_drive_errors, require_reference
from canopen_proto.drives.axis.halting import halt, halt_after
from canopen_proto.drives.axis.identity import learn_units
from canopen_proto.drives.axis.set_points import OFFSETS_OF
from canopen_proto.drives.axis.state import enable, set_mode
from canopen_proto.drives.axis.watching import read_statusword, wait_for_statusword
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, ModeControl, ModeStatus
from canopen_proto.drives.cia402.states import Command, State, state_of
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.multiplexer import Mux, mux_text
from canopen_proto.procedures.objects import ABSENT, read_if_present, read_int, unless_refused, write
from canopen_proto.procedures.steps import Cancelled, Procedure, SdoTransferError, current_time

Align: TypeAlias = Callable[[Axis], Procedure[float]]
"""Makes what the drive has now its set-point, and returns it in the user's unit."""

_EXPONENTS: Final = (-3, -4, -5, -6, -2, -1, 0)
"""Of 0x60C2:02, in the order in which they are tried: every drive has milliseconds."""


@moves
@as_drive_errors
def start_cyclic_position(axis: Axis, cycle_time: Time, *, sends_itself: bool = False) -> Procedure[float]:
    """Make the drive follow one position per SYNC in cyclic synchronous position mode; return the position where it starts.

    cycle_time: ns between two SYNCs. sends_itself: the caller sends the set-points by a PDO of its own; else an RPDO that the
    node exchanges must carry 0x607A. Raises ReferenceLostError, ModeUnsupportedError, DriveInFaultError, StateLostError,
    ModeLostError, DriveLostError, StepTimeoutError; DriveError if no RPDO carries set-points, or none is sent.
    """
    require_reference(axis)
    carried = (objects.TARGET_POSITION,)
    require_carried(axis, carried, sends_itself)
    axis.set_points.select(Mode.CYCLIC_SYNCHRONOUS_POSITION)
    yield from prepare(axis, Mode.CYCLIC_SYNCHRONOUS_POSITION, cycle_time, align_position)
    return (yield from follow(axis, Mode.CYCLIC_SYNCHRONOUS_POSITION, carried, align_position))


@moves
@as_drive_errors
def start_cyclic_velocity(axis: Axis, cycle_time: Time, *, sends_itself: bool = False) -> Procedure[float]:
    """Make the drive follow one velocity per SYNC (0x60FF) in cyclic synchronous velocity mode; return the first one, 0.

    cycle_time, sends_itself: as of `start_cyclic_position`. The drive's units are read first. Raises DriveError if its velocity
    unit is not known; else as `start_cyclic_position`.
    """
    carried = (objects.TARGET_VELOCITY,)
    require_carried(axis, carried, sends_itself)
    yield from learn_units(axis)
    _require_velocity_unit(axis)

    def align(axis: Axis) -> Procedure[float]:
        axis.set_points.set_velocity(0.0)
        yield from write(axis.node, objects.TARGET_VELOCITY, 0)
        return 0.0

    yield from prepare(axis, Mode.CYCLIC_SYNCHRONOUS_VELOCITY, cycle_time, align)
    return (yield from follow(axis, Mode.CYCLIC_SYNCHRONOUS_VELOCITY, carried, align))


@moves
@as_drive_errors
def start_cyclic_torque(
    axis: Axis, cycle_time: Time, *, torque: float | None = None, sends_itself: bool = False
) -> Procedure[float]:
    """Make the drive follow one torque per SYNC (0x6071) in cyclic synchronous torque mode; return the torque at which it starts.

    torque: the one at which it starts, as a share of the rated torque; None: the actual one (0x6077) of a drive that is enabled
    and stands, else 0. **A load that a brake or the drive holds falls if this is too small.** Only the caller's torques and its
    watch (`watch_bounds`) limit speed and position. cycle_time, sends_itself, errors: as of `start_cyclic_position`.
    """
    carried = (objects.TARGET_TORQUE,)
    require_carried(axis, carried, sends_itself)
    held = torque

    def align(axis: Axis) -> Procedure[float]:
        nonlocal held
        if held is None:
            held = yield from holding_torque(axis)
        held = axis.set_points.set_torque(held)
        yield from write(axis.node, objects.TARGET_TORQUE, axis.scale.torque_to_wire(held))
        return held

    yield from prepare(axis, Mode.CYCLIC_SYNCHRONOUS_TORQUE, cycle_time, align)
    return (yield from follow(axis, Mode.CYCLIC_SYNCHRONOUS_TORQUE, carried, align))


def holding_torque(axis: Axis) -> Procedure[float]:
    """Return the torque (0x6077) with which an enabled drive stands, as a share of the rated torque; 0 if it has no power."""
    if state_of((yield from read_statusword(axis))) is not State.OPERATION_ENABLED:
        return 0.0
    yield from read_if_present(axis.node, objects.TORQUE_ACTUAL_VALUE)
    return axis.torque or 0.0


def _require_velocity_unit(axis: Axis) -> None:
    """Raise DriveError if it is not known what the numbers of velocities mean."""
    if axis.scale.velocity_unit is None:
        raise DriveError(
            axis,
            "gets no velocity",
            reason="it does not tell its velocity unit (0x60A9, 0x6096)",
            remedy="AxisSettings(velocity_unit=...), in counts per second, by its manual",
        )


def require_carried(axis: Axis, carried: Collection[Mux], sends_itself: bool) -> None:
    """Raise DriveError if an object of the set-point is in no RPDO that is exchanged, unless the caller sends it itself. carried:
    the objects of the set-point."""
    for mux in carried:
        if not sends_itself and not rpdos_with(axis.node, (mux,)):
            raise DriveError(
                axis,
                "would get no set-points",
                reason=f"no RPDO that is exchanged with it carries {mux_text(mux)}",
                remedy="exchange one first (RemoteNode.add_pdo, or procedures.configure_pdo)",
            )


def prepare(axis: Axis, mode: Mode, cycle_time: Time, align: Align) -> Procedure[None]:
    """Halt the drive, give it the set-point that it has, clear its offsets, select the mode, and write the period.

    cycle_time: ns between two SYNCs. align: gives it that set-point.
    """
    yield from halt(axis)  # a moving drive would jump back to the position that was read
    yield from align(axis)  # in csp the drive follows as soon as it has mode and power
    yield from clear_offsets(axis, mode)
    yield from set_mode(axis, mode)
    yield from _set_interpolation_period(axis, cycle_time)


def align_position(axis: Axis) -> Procedure[float]:
    """Make the actual position the set-point; return it."""
    position = yield from read_int(axis.node, objects.POSITION_ACTUAL_VALUE)
    axis.set_points.set_position_counts(position, 0.0)
    yield from write_record(axis)
    return axis.scale.from_counts(position)


def write_record(axis: Axis) -> Procedure[None]:
    """Write the images of the position set-point by SDO, in the order of the record."""
    for mux in axis.set_points.objects:
        if mux in axis.node.dictionary:
            yield from write(axis.node, mux, axis.node.values.store[mux])


def _rpdos_of_offsets(axis: Axis, mode: Mode) -> list[int]:
    """Return the RPDOs that carry offsets of the mode and nothing else."""
    offsets = {axis.node.on_device(mux) for mux in OFFSETS_OF[mode]}
    return [number for number, rpdo in axis.node.rpdos.items() if rpdo.mapping.muxes and offsets.issuperset(rpdo.mapping.muxes)]


def clear_offsets(axis: Axis, mode: Mode) -> Procedure[None]:
    """Set the offsets of a mode to 0, as far as the drive has them: one that was left over would be a jump."""
    node = axis.node
    for mux in OFFSETS_OF[mode]:
        if mux in node.dictionary:
            yield from unless_refused(write(node, mux, 0), ABSENT)


def _set_interpolation_period(axis: Axis, cycle_time: Time) -> Procedure[None]:
    """Write 0x60C2, if the drive has it: the period is :1 * 10 ** :2 seconds. :1 has 8 bits, or 16 in some drives.

    Some drives accept few exponents: one that is refused is followed by the next one with which the period is exact.
    """
    node = axis.node
    if objects.INTERPOLATION_TIME_UNITS not in node.dictionary:
        return
    _, most = range_of(node.dictionary.variable(objects.INTERPOLATION_TIME_UNITS).data_type) or (0, 255)
    refused: SdoTransferError | None = None
    for exponent in _EXPONENTS:
        units, rest = divmod(cycle_time, 10 ** (9 + exponent))
        if rest or not 1 <= units <= most:
            continue
        try:
            yield from write(node, objects.INTERPOLATION_TIME_INDEX, exponent)
            yield from write(node, objects.INTERPOLATION_TIME_UNITS, units)
        except SdoTransferError as failed:
            if failed.origin is not AbortOrigin.PEER:
                raise
            refused = refused or failed
        else:
            return
    if refused is not None:
        raise refused
    cycle = f"{cycle_time / MILLISECOND:g} ms"
    reason = f"it cannot be written to 0x60C2, which holds 1 to {most} units of a power of ten of seconds, from 1 us"
    raise DriveError(axis, f"cannot be given a cycle of {cycle}", reason=reason, remedy="another cycle")


def follow(axis: Axis, mode: Mode, carried: Collection[Mux], align: Align) -> Procedure[float]:
    """Enable the drive, have it follow the set-points in `carried`, and return the one at which it starts.

    mode: ip, csp, csv or cst, which `prepare` has selected. align: gives the drive the set-point that it has.
    """
    node = axis.node
    is_ip = mode == Mode.INTERPOLATED_POSITION
    goal = "interpolation active (bit 12)" if is_ip else "follows command (bit 12)"
    active = ModeStatus.IP_MODE_ACTIVE if is_ip else ModeStatus.FOLLOWS_COMMAND
    try:
        yield from enable(axis)  # in cst power alone may let a load move
        start = yield from align(axis)
        now = yield from current_time()
        carriers = rpdos_with(axis.node, carried)
        for number in (*carriers, *_rpdos_of_offsets(axis, mode)):
            node.enable_rpdo(number, now)
        if carriers and not any(node.rpdos[number].is_live for number in carriers):
            state = node.nmt_state.name if node.nmt_state is not None else "in an unknown NMT state"
            reason = f"RPDOs are sent to a node that is Operational, and this one is {state}"
            raise DriveError(axis, "would get no set-points", reason=reason, remedy="NMT start")
        yield from command(axis, int(Command.ENABLE_OPERATION))
        if is_ip:
            yield from command(axis, Command.ENABLE_OPERATION | ModeControl.ENABLE_INTERPOLATION)
        yield from wait_for_statusword(
            axis,
            lambda word: bool(word & active) or not axis.settings.shows_following,
            axis.settings.state_timeout,
            goal,
            mode=mode,
            stays=State.OPERATION_ENABLED,
        )
        axis.started_at = OBEYED
    except (Cancelled, Exception) as cause:
        yield from halt_after(axis, cause)
        raise
    return start
