"""Profile position mode (pp): the drive goes to a position by its own profile."""

from __future__ import annotations

import math
from typing import Final

from canopen_proto.drives.axis.axis import OBEYED, Axis
from canopen_proto.drives.axis.controlword import command
from canopen_proto.drives.axis.exclusive_motion import moves
from canopen_proto.drives.axis.failures import DriveError, LimitReachedError, as_drive_errors, require_reference
from canopen_proto.drives.axis.halting import halt, halt_after
from canopen_proto.drives.axis.identity import learn_units
from canopen_proto.drives.axis.limits import limits_of
from canopen_proto.drives.axis.motionless_mode import takes
from canopen_proto.drives.axis.reasons import LIMIT_SWITCHES
from canopen_proto.drives.axis.state import enable, set_mode, settle
from canopen_proto.drives.axis.watching import POLL_INTERVAL, DriveWait, wait_for_statusword
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, ModeControl, ModeStatus
from canopen_proto.drives.cia402.positioning import (
    DIRECTION_OPTION,
    DIRECTION_SHIFT,
    RELATIVE_OPTION,
    REQUEST_RESPONSE_OPTION,
    RelativeTo,
    RotaryDirection,
)
from canopen_proto.drives.cia402.states import Command, ControlBit, State, StatusBit
from canopen_proto.drives.trajectory.limit_check import EXACT
from canopen_proto.machine import LocalProtocolError, Time
from canopen_proto.procedures.objects import read_if_present, read_int, write
from canopen_proto.procedures.steps import Cancelled, Procedure, StepTimeoutError, current_time, sleep
from canopen_proto.remote_node import FRESH

NO_WINDOW: Final = 2**32 - 1
"""0x6067, position window: the drive does not watch it."""

_NO_NEARER: Final = 0.001
"""A drive comes no nearer to its target if it loses less than this share of its way in `reaction_time`."""

OTHER_TARGET: Final = "a target within the limit, or another limit"

_OPPOSITE: Final = {RotaryDirection.POSITIVE: RotaryDirection.NEGATIVE, RotaryDirection.NEGATIVE: RotaryDirection.POSITIVE}

AT_ONCE: Final = Command.ENABLE_OPERATION | ModeControl.CHANGE_SET_IMMEDIATELY
"""The controlword with which a new set-point drops the one before."""


@moves
@as_drive_errors
def move_to(
    axis: Axis, position: float, *, timeout: Time, relative: bool = False, direction: RotaryDirection | None = None
) -> Procedure[None]:
    """Profile position: move to a position in the user's unit, with the drive's profile (0x6081, 0x6083), and wait for the end.

    The set-point handshake of CiA 402: bit 4 clear, target, bit 4 set, bit 12 acknowledges, bit 4 clear, bit 10 at the target.
    Bit 5 is always set: it drops a target that a halt has kept, or that is under way. A drive in another mode is halted first.
    The position (0x6062, 0x6064) shows whether the target is reached: bit 10 also rises when a drive stops at a software limit.
    direction: the way to the target of an axis without end, in the user's direction; None leaves 0x60F2 as it is.
    timeout: ns for the whole way. Raises LimitReachedError; nothing is sent if the target is beyond min_position or max_position
    of the settings, if 0x6081 is beyond their max_speed, or if the target does not fit 0x607A (ValueRangeError). Raises
    DriveInFaultError, StateLostError, ModeLostError, DriveLostError, ModeUnsupportedError, StepTimeoutError; ReferenceLostError
    for a position that is not relative. The drive is halted if this fails or is cancelled, once anything was
    written: the checks before stop no motion that somebody else has begun.
    """
    if not relative:
        require_reference(axis)
    elif direction is not None:
        raise LocalProtocolError("a relative target has its direction already: by its sign")
    require_option(axis, direction)
    settings = axis.settings
    counts = axis.scale.to_counts(position) - (settings.offset if relative else 0)
    axis.node.encode(objects.TARGET_POSITION, counts)
    if not axis.has_lost_reference:
        start = yield from demand_of(axis)
        require_within_limits(axis, start, counts + (start if relative else 0))
    yield from require_profile_speed(axis)
    relation = ModeControl.RELATIVE if relative else 0
    try:
        yield from select_profile_position(axis)
        yield from _end_at_rest(axis)
        yield from set_options(axis, direction)
        yield from enable(axis)
        if relative and axis.controlword & ControlBit.HALT:
            # The drive may count from the target that the halt kept: so first make its present position the target.
            yield from _give_set_point(axis, (yield from demand_of(axis)), 0)
            yield from wait_for_acknowledge(axis, True)
        target = counts + ((yield from demand_of(axis)) if relative else 0)
        yield from _give_set_point(axis, counts, relation)
        given_at = yield from current_time()
        try:
            yield from wait_for_acknowledge(axis, True)
        except StepTimeoutError as refused:
            limit = yield from limit_before(axis, target)
            if limit:
                raise LimitReachedError(axis, "did not take its target", reason=limit, remedy=OTHER_TARGET) from refused
            axis.leave_unanswered("a target")
            raise
        axis.started_at = OBEYED
        yield from command(axis, AT_ONCE | relation)
        yield from wait_for_target(axis, target, given_at, timeout, relative)
    except (Cancelled, Exception) as cause:
        yield from halt_after(axis, cause)
        raise


def select_profile_position(axis: Axis) -> Procedure[None]:
    """Go to profile position; at rest before, if it was in another mode or may still obey what it has not answered."""
    if axis.mode != Mode.PROFILE_POSITION or axis.unanswered:
        yield from halt(axis)
    if axis.unanswered:
        yield from settle(axis)
    yield from set_mode(axis, Mode.PROFILE_POSITION)


def _end_at_rest(axis: Axis) -> Procedure[None]:
    """Write 0 to the end velocity (0x6082), if another tool left one: the drive would not stop at its target."""
    if (yield from read_if_present(axis.node, objects.END_VELOCITY)):
        yield from write(axis.node, objects.END_VELOCITY, 0)


def require_option(axis: Axis, direction: RotaryDirection | None, relative_to: RelativeTo | None = None) -> None:
    """Raise DriveError if these options need 0x60F2 and the drive does not have it. Without it, drives count from the target
    before. direction: of a rotary axis. relative_to: what a relative target counts from."""
    if objects.POSITIONING_OPTION_CODE in axis.node.dictionary:
        return
    if direction is not None:
        raise DriveError(axis, "has no 0x60F2: it goes its own way to a target", remedy="no direction", looks=False)
    if relative_to not in (None, RelativeTo.PREVIOUS):
        remedy = "RelativeTo.PREVIOUS, from which drives without it count"
        raise DriveError(axis, "has no 0x60F2: it cannot count from another position", remedy=remedy, looks=False)


def option_code(axis: Axis, present: int, direction: RotaryDirection | None = None, relative_to: RelativeTo | None = None) -> int:
    """Return 0x60F2 (`present`) with these options; None leaves one as it is. Bits 4 and 5 become 0: the master itself
    clears bit 4 of the controlword, and an acknowledge that falls by itself could be missed. direction: in the user's sense.
    relative_to: what a relative target counts from."""
    option = present & ~REQUEST_RESPONSE_OPTION
    if direction is not None:
        if axis.settings.direction < 0:
            direction = _OPPOSITE.get(direction, direction)
        option = option & ~DIRECTION_OPTION | direction << DIRECTION_SHIFT
    return option if relative_to is None else option & ~RELATIVE_OPTION | relative_to


def set_options(axis: Axis, direction: RotaryDirection | None = None) -> Procedure[None]:
    """Make 0x60F2 fit `direction`: see `option_code`. Does nothing if the drive lacks it."""
    present = yield from read_if_present(axis.node, objects.POSITIONING_OPTION_CODE)
    if isinstance(present, int) and present != (option := option_code(axis, present, direction)):
        yield from write(axis.node, objects.POSITIONING_OPTION_CODE, option)


def _give_set_point(axis: Axis, counts: int, relation: int) -> Procedure[None]:
    """Give a set-point that replaces any other.

    A halt keeps the drive's target, and a word without bit 8 lets the drive go on to it. So the halt ends with the same word that
    gives the new set-point. A halted drive need not accept a set-point, then: the standard does not say whether it does.
    """
    yield from make_room(axis, AT_ONCE | relation)
    yield from write(axis.node, objects.TARGET_POSITION, counts)
    yield from command(axis, AT_ONCE | relation | ModeControl.NEW_SET_POINT)


def make_room(axis: Axis, word: int) -> Procedure[None]:
    """Command `word`, which ends no halt, and wait until the drive has room for a set-point (bit 12 = 0).

    A halted drive keeps its queue of set-points. If that is full, the drive is led to another mode and back, as its settings
    allow: CiA 402 empties the queue with the mode. Raises StepTimeoutError if it has no other mode in which it stands.
    """
    halted = axis.controlword & ControlBit.HALT
    yield from command(axis, word | halted)
    try:
        yield from wait_for_acknowledge(axis, False, axis.settings.reaction_time if halted else None)
        return
    except StepTimeoutError:
        if not halted or not axis.statusword & ModeStatus.SET_POINT_ACKNOWLEDGE:
            raise
        has_left = (yield from takes(axis, Mode.HOMING)) or (yield from takes(axis, Mode.INTERPOLATED_POSITION))
        if not has_left:
            raise
    yield from set_mode(axis, Mode.PROFILE_POSITION)
    yield from enable(axis)
    yield from command(axis, word | axis.controlword & ControlBit.HALT)
    yield from wait_for_acknowledge(axis, False)


def require_within_limits(axis: Axis, start: int, target: int) -> None:
    """Raise LimitReachedError for a target beyond the limits of the settings. start, target: counts."""
    limit = limits_of(axis).position_excess(axis.scale.from_counts(start), axis.scale.from_counts(target))
    if limit is not None:
        raise LimitReachedError(
            axis,
            f"was not moved to {axis.scale.from_counts(target):g}",
            reason=f"{limit.source} say {limit.value:g}; it got no such target",
            remedy=OTHER_TARGET,
        )


def require_profile_speed(axis: Axis) -> Procedure[None]:
    """Raise LimitReachedError if the drive's own profile velocity (0x6081) is beyond max_speed of the settings.

    A drive without 0x6081, or whose velocity unit cannot be converted, is not judged.
    """
    limit = axis.settings.max_speed
    if limit is None or math.isinf(limit):
        return
    number = yield from read_if_present(axis.node, objects.PROFILE_VELOCITY)
    if axis.scale.velocity_unit is None:
        yield from learn_units(axis)
    unit = axis.scale.velocity_unit
    if not isinstance(number, int) or unit is None:
        return
    speed = axis.scale.amount_from_counts(number * unit)
    if speed > limit * EXACT:
        raise LimitReachedError(
            axis,
            f"was not moved at {speed:g} per second",
            reason=f"that is its profile velocity (0x6081 = {number}); the settings (max_speed) say {limit:g}; nothing was sent",
            remedy="a lower 0x6081, or move_along, which sets the velocity of each target",
            looks=False,
        )


def _wait_for_bit(axis: Axis, bit: int, wanted: bool, timeout: Time, goal: str) -> Procedure[int]:
    """Wait for a bit of the statusword in profile position mode."""
    return (
        yield from wait_for_statusword(
            axis,
            lambda word: bool(word & bit) is wanted,
            timeout,
            goal,
            mode=Mode.PROFILE_POSITION,
            stays=State.OPERATION_ENABLED,
        )
    )


def wait_for_acknowledge(axis: Axis, wanted: bool, timeout: Time | None = None) -> Procedure[None]:
    """Wait until bit 12 is 1 (the set-point was taken) or 0 (there is room for one). timeout: ns; None: `state_timeout`. wanted:
    which of the two."""
    goal = f"set-point acknowledge (bit 12) = {int(wanted)}"
    limit = axis.settings.state_timeout if timeout is None else timeout
    yield from _wait_for_bit(axis, ModeStatus.SET_POINT_ACKNOWLEDGE, wanted, limit, goal)


def wait_for_target(axis: Axis, target: int, given_at: Time, timeout: Time, relative: bool) -> Procedure[None]:
    """Wait for bit 10 at the target. For `reaction_time` it may still belong to the target before.

    target: counts. given_at: when the drive got it. timeout: ns. relative: the drive decided what the target counts from.
    """
    deadline = (yield from current_time()) + timeout
    while True:
        left = max(0, deadline - (yield from current_time()))
        statusword = yield from _arrival(axis, target, left)
        is_there = yield from _is_at(axis, target)
        if is_there:
            return
        if (yield from current_time()) - given_at >= axis.settings.reaction_time:
            break
        yield from sleep(POLL_INTERVAL)
    position = yield from read_int(axis.node, objects.POSITION_ACTUAL_VALUE)
    limit = yield from limit_before(axis, target)
    if not limit:
        limit = yield from _switch_before(axis, target - position)
    if not limit and statusword & StatusBit.INTERNAL_LIMIT:
        limit = "an internal limit of the drive is active (bit 11)"
    if limit or (is_there is False and not relative):  # 0x60F2: the drive decides what a relative target counts from
        raise LimitReachedError(
            axis,
            f"stands at {axis.scale.from_counts(position):g} ({position} counts), "
            f"not at its target {axis.scale.from_counts(target):g} ({target} counts)",
            reason=limit,
            remedy=OTHER_TARGET,
        )


def _arrival(axis: Axis, target: int, timeout: Time) -> Procedure[int]:
    """Wait until the drive says that it is at its target (bit 10), or shows a limit (bit 11) and comes no nearer; return its
    statusword. A drive that a limit switch has stopped need not set bit 10."""
    position = objects.POSITION_ACTUAL_VALUE
    watch: DriveWait[int] = DriveWait(
        axis, "its target position", mode=Mode.PROFILE_POSITION, stays=State.OPERATION_ENABLED, reads={position: FRESH}
    )
    held_since: Time | None = None
    held_at = 0

    def judge(statusword: int, heard_at: Time) -> int | None:
        nonlocal held_since, held_at
        if statusword & StatusBit.TARGET_REACHED:
            return statusword
        here = axis.position_counts
        if not statusword & StatusBit.INTERNAL_LIMIT or here is None or watch.heard(position) is None:
            held_since = None
        elif held_since is None or abs(here - held_at) > _NO_NEARER * abs(target - held_at):
            held_since, held_at = heard_at, here
        elif heard_at - held_since >= axis.settings.reaction_time:
            return statusword
        return None

    return (yield from watch.until(judge, timeout))


def _switch_before(axis: Axis, way: int) -> Procedure[str]:
    """Return the limit switch that holds the axis back from going `way` counts further, in words; "" if there is none."""
    inputs = yield from read_if_present(axis.node, objects.DIGITAL_INPUTS)
    side = int(way > 0)
    is_active = isinstance(inputs, int) and bool(inputs >> side & 1)
    return f"it stands on its {LIMIT_SWITCHES[side]} (0x60FD)" if is_active and way else ""


def demand_of(axis: Axis) -> Procedure[int]:
    """Return the present position demand (0x6062) of the drive, in counts; the actual position if it has no demand."""
    demand = yield from read_if_present(axis.node, objects.POSITION_DEMAND_VALUE)
    return demand if isinstance(demand, int) else (yield from read_int(axis.node, objects.POSITION_ACTUAL_VALUE))


def _is_at(axis: Axis, target: int) -> Procedure[bool | None]:
    """Return whether the drive is at its target; None if it has neither a demand (0x6062) nor a window (0x6067)."""
    node = axis.node
    demand = yield from read_if_present(node, objects.POSITION_DEMAND_VALUE)
    position = yield from read_int(node, objects.POSITION_ACTUAL_VALUE)
    window = yield from read_if_present(node, "0x6067")
    has_window = isinstance(window, int) and window != NO_WINDOW
    tolerance = window if isinstance(window, int) and has_window else 1
    turn = yield from _turn(axis)
    if any(isinstance(each, int) and _distance(each, target, turn) <= tolerance for each in (demand, position)):
        return True
    return False if has_window or isinstance(demand, int) else None


def _turn(axis: Axis) -> Procedure[int]:
    """Return the counts of one turn of an endless axis (0x607B); 0 for an axis with ends."""
    low = yield from read_if_present(axis.node, objects.MIN_POSITION_RANGE_LIMIT)
    high = yield from read_if_present(axis.node, objects.MAX_POSITION_RANGE_LIMIT)
    return high - low + 1 if isinstance(low, int) and isinstance(high, int) and low < high else 0


def _distance(position: int, target: int, turn: int) -> int:
    distance = abs(position - target)
    return min(distance % turn, -distance % turn) if turn else distance


def limit_before(axis: Axis, target: int) -> Procedure[str]:
    """Return the software limit (0x607D) that lies before a target, in words; "" if there is none.

    The standard counts the limits from the mechanical zero: the home offset (0x607C) is subtracted before they are compared. Not
    all drives do so. So a limit is named if the target is beyond it in either way.
    """
    node = axis.node
    low = yield from read_if_present(node, objects.MIN_SOFTWARE_POSITION_LIMIT)
    high = yield from read_if_present(node, objects.MAX_SOFTWARE_POSITION_LIMIT)
    offset = yield from read_if_present(node, "0x607C")
    if not isinstance(low, int) or not isinstance(high, int) or low >= high:
        return ""
    shift = offset if isinstance(offset, int) else 0
    if target < max(low, low - shift):
        subindex, limit = 1, low
    elif target > min(high, high - shift):
        subindex, limit = 2, high
    else:
        return ""
    return f"its software limit 0x607D:{subindex:02X} is {axis.scale.from_counts(limit):g} ({limit} counts)"
