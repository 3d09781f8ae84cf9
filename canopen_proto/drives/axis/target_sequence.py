"""`move_along`: a set of set-points in profile position mode (pp), each with its own profile, given one after the other.

    start           bits 5, 9   the drive begins it
    WHEN_REACHED    0, 0        when it stands at the target before
    ON_THE_WAY      0, 1        at the target before, which it passes at the speed of that profile (change on set-point)
    AT_ONCE         1, 0        now; the target before is dropped. So the first target begins in any case

For each target: bits 5, 6 and 9 with bit 4 = 0, wait for bit 12 = 0 (there is room), the values of the profile that change, the
target 0x607A, bit 4 = 1, wait for bit 12 = 1, bit 4 = 0. So bits 5, 6 and 9 always come before bit 4, as some drives need it.

The drive plans, and the master only feeds it. A drive that gets no further target stops at the last one it has.

Source: IEC 61800-7-201 (CiA 402-2): profile position mode, set-points; 0x60F2, positioning option code.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from canopen_proto.drives.axis.axis import OBEYED, Axis
from canopen_proto.drives.axis.controlword import command
from canopen_proto.drives.axis.exclusive_motion import moves
from canopen_proto.drives.axis.failures import DriveError, LimitReachedError, as_drive_errors, require_reference
from canopen_proto.drives.axis.halting import halt_after, halt_ramp
from canopen_proto.drives.axis.identity import learn_units
from canopen_proto.drives.axis.limits import limits_of
from canopen_proto.drives.axis.profile_position import (
    OTHER_TARGET,
    demand_of,
    limit_before,
    make_room,
    option_code,
    require_option,
    require_profile_speed,
    require_within_limits,
    select_profile_position,
    wait_for_acknowledge,
    wait_for_target,
)
from canopen_proto.drives.axis.state import enable
from canopen_proto.drives.axis.watching import POLL_INTERVAL, DriveWait
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, ModeControl
from canopen_proto.drives.cia402.positioning import RelativeTo as RelativeTo
from canopen_proto.drives.cia402.positioning import RotaryDirection as RotaryDirection
from canopen_proto.drives.cia402.states import Command, State
from canopen_proto.machine import NEVER, SECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux, mux_text
from canopen_proto.procedures.objects import read_if_present, write
from canopen_proto.procedures.steps import Cancelled, Procedure, StepTimeoutError, current_time
from canopen_proto.remote_node import FRESH


class Start(enum.Enum):
    """When the drive begins a target; see this module's text."""

    WHEN_REACHED = "when the one before is reached"
    ON_THE_WAY = "on the way, at the one before"
    AT_ONCE = "at once"


_BITS: Final = {
    Start.WHEN_REACHED: 0,
    Start.ON_THE_WAY: ModeControl.CHANGE_ON_SET_POINT,
    Start.AT_ONCE: ModeControl.CHANGE_SET_IMMEDIATELY,
}


@dataclass(frozen=True, slots=True)
class ProfileTarget:
    """A target and the profile that leads to it.

    position: in the user's unit; a way if relative_to is given. start: of all but the first. pause: ns to wait before the target
    is given, while the drive goes on. velocity: in the user's unit per second; acceleration, deceleration: per second²; all are
    rounded down to the drive's unit, and stay in the drive. None keeps the last one, which at first is the drive's own (0x6081,
    0x6083, 0x6084). end_velocity: the speed with which the drive passes the target (0x6082); 0 for the last one. A drive that
    gets its next target late runs on at that speed: ON_THE_WAY is safer, because it stops. During a pause it is halted before
    min_position and max_position of the settings; and it is halted where it could not stop before them with the deceleration of a
    target AT_ONCE. direction: the way to an absolute target of an axis without end, in the user's direction (0x60F2); None leaves
    it as the drive has it.
    """

    position: float
    relative_to: RelativeTo | None = None
    start: Start = Start.WHEN_REACHED
    pause: Time = 0
    velocity: float | None = None
    acceleration: float | None = None
    deceleration: float | None = None
    end_velocity: float = 0.0
    direction: RotaryDirection | None = None

    def __post_init__(self) -> None:
        for name in ("velocity", "acceleration", "deceleration"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise LocalProtocolError(f"{name} of a target must be above 0, or None for the last one; it is {value!r}")
        if self.end_velocity < 0 or self.pause < 0:
            raise LocalProtocolError("end_velocity and pause of a target must not be below 0")
        if self.direction is not None and self.relative_to is not None:
            raise LocalProtocolError("a relative target has its direction already: by its sign")


@moves
@as_drive_errors
def move_along(axis: Axis, targets: Iterable[ProfileTarget], *, timeout: Time) -> Procedure[None]:
    """Profile position: go to one target after the other, and wait for the end. Does nothing without targets.

    timeout: ns for the whole way. All limits of the settings (min_position, max_position, max_speed) are checked before anything
    is sent, and again where a target counts from a position that only shows on the way. Raises LimitReachedError, DriveError (the
    drive lacks an object, or a queue, that a target needs), LocalProtocolError (a velocity unit that is not known; an end
    velocity of the last target), ValueRangeError, ReferenceLostError, DriveInFaultError, StateLostError, ModeLostError,
    DriveLostError, ModeUnsupportedError, StepTimeoutError. The drive is halted if this fails or is cancelled, once
    anything was written: the checks before stop no motion that somebody else has begun.
    """
    points = tuple(targets)
    if not points:
        return
    feeder = _Feeder(axis, points, timeout)
    yield from feeder.prepare()
    try:
        yield from select_profile_position(axis)
        yield from enable(axis)
        for number in range(len(points)):
            yield from feeder.give(number)
        yield from feeder.wait_for_end()
    except (Cancelled, Exception) as cause:
        yield from halt_after(axis, cause)
        raise


class _Feeder:
    """Gives a drive its targets."""

    def __init__(self, axis: Axis, points: tuple[ProfileTarget, ...], timeout: Time) -> None:
        self._axis = axis
        self._points = points
        self._timeout = timeout
        self._deadline: Time = NEVER
        self._given_at: Time = 0
        self._target = 0
        """The last target, in counts, as far as it is known."""
        self._is_exact = True
        """Whether it is."""
        self._written: dict[Mux, int] = {}
        self._profiles: list[dict[Mux, int]] = []

    def prepare(self) -> Procedure[None]:
        """Check everything that is known before the drive moves."""
        axis, points = self._axis, self._points
        self._deadline = (yield from current_time()) + self._timeout
        if any(each.relative_to is None for each in points):
            require_reference(axis)
        if points[-1].end_velocity:
            raise LocalProtocolError("the last target must have an end velocity of 0: the drive would run on behind it")
        later = points[1:]
        if not axis.settings.queues_set_points and any(each.start is Start.ON_THE_WAY for each in later):
            remedy = "targets that start when the one before is reached"
            raise DriveError(
                axis, "keeps no set-point (queues_set_points): it can pass none on the way", remedy=remedy, looks=False
            )
        speeds = [each for point in points for each in (point.velocity, point.acceleration, point.deceleration) if each]
        if (speeds or any(each.end_velocity for each in points)) and axis.settings.velocity_unit is None:
            yield from learn_units(axis)
        self._profiles = [self._profile_of(each) for each in points]
        if points[0].velocity is None:
            yield from require_profile_speed(axis)
        for key in (objects.END_VELOCITY, objects.POSITIONING_OPTION_CODE):
            present = yield from read_if_present(axis.node, key)
            if isinstance(present, int):
                self._written[key] = present
        for profile in self._profiles:
            for key, number in profile.items():
                if key not in axis.node.dictionary:
                    raise DriveError(axis, f"has no {mux_text(key)}, which a target needs; nothing was sent", looks=False)
                axis.node.encode(key, number)
        for point in points:
            require_option(axis, point.direction, None if point is points[0] else point.relative_to)
        self._target = start = yield from demand_of(axis)
        known: int | None = start
        for point in points:
            start = start if known is None else known  # a target beyond a limit is allowed from further beyond it only
            known = self._absolute(point, known)
            axis.node.encode(objects.TARGET_POSITION, self._way(point) if known is None else known)
            if known is not None and not axis.has_lost_reference:
                require_within_limits(axis, start, known)

    def _absolute(self, point: ProfileTarget, before: int | None) -> int | None:
        """Return a target in counts; None if it counts from a position that only shows on the way."""
        if point.relative_to is None:
            return self._axis.scale.to_counts(point.position)
        return before + self._way(point) if before is not None and point.relative_to is RelativeTo.PREVIOUS else None

    def _way(self, point: ProfileTarget) -> int:
        return self._axis.scale.to_counts(point.position) - self._axis.settings.offset

    def _profile_of(self, point: ProfileTarget) -> dict[Mux, int]:
        """Return the values of a target's profile on the wire. Raises LimitReachedError for a speed beyond max_speed."""
        axis, limit = self._axis, self._axis.settings.max_speed
        fastest = max(point.velocity or 0.0, point.end_velocity)
        if limit is not None and fastest > limit:
            reason = f"the settings (max_speed) say {limit:g}; nothing was sent"
            raise LimitReachedError(
                axis, f"was not moved at {fastest:g} per second", reason=reason, remedy=OTHER_TARGET, looks=False
            )
        found = {}
        for key, value, convert in (
            (objects.PROFILE_VELOCITY, point.velocity, axis.scale.speed_to_wire),
            (objects.PROFILE_ACCELERATION, point.acceleration, axis.scale.rate_to_wire),
            (objects.PROFILE_DECELERATION, point.deceleration, axis.scale.rate_to_wire),
        ):
            if value is not None:
                found[key] = number = convert(value)
                if not number:
                    failed = f"cannot take {value:g}: it is less than one unit of {mux_text(key)}"
                    raise DriveError(axis, failed, remedy="a larger value", looks=False)
        if point.end_velocity or objects.END_VELOCITY in axis.node.dictionary:
            found[objects.END_VELOCITY] = axis.scale.speed_to_wire(point.end_velocity) if point.end_velocity else 0
        return found

    def give(self, number: int) -> Procedure[None]:
        """Give a target once there is room for it."""
        axis, point = self._axis, self._points[number]
        start = Start.AT_ONCE if number == 0 else point.start
        yield from self._pass(point.pause, self._points[number - 1].end_velocity if number else 0.0)
        if start is Start.WHEN_REACHED and not axis.settings.queues_set_points:
            yield from self._wait_for_target()
            start = Start.AT_ONCE
        value, relation = yield from self._place(point, is_first=number == 0)
        if start is Start.AT_ONCE and number:
            yield from self._require_way_to_stop(self._profiles[number].get(objects.PROFILE_DECELERATION))
        word = Command.ENABLE_OPERATION | relation
        word |= {Start.AT_ONCE: ModeControl.CHANGE_SET_IMMEDIATELY, Start.ON_THE_WAY: ModeControl.CHANGE_ON_SET_POINT}.get(
            start, 0
        )
        # A halt ends with the word that gives the first target, as in `move_to`: it would send the drive on to an old one.
        if number == 0:
            yield from make_room(axis, word)
        else:
            yield from command(axis, word)
            yield from wait_for_acknowledge(axis, False, (yield from self._left()))
        for key, wanted in self._profiles[number].items():
            yield from self._write(key, wanted)
        yield from write(axis.node, objects.TARGET_POSITION, value)
        yield from command(axis, word | ModeControl.NEW_SET_POINT)
        self._given_at = yield from current_time()
        try:
            yield from wait_for_acknowledge(axis, True)
        except StepTimeoutError as refused:
            yield from self._tell_refusal(start, refused)
            axis.leave_unanswered("a target")
            raise
        axis.started_at = OBEYED
        yield from command(axis, word)

    def _tell_refusal(self, start: Start, refused: StepTimeoutError) -> Procedure[None]:
        """Raise the error that says why a target was not taken; return if that is not known."""
        axis = self._axis
        limit = yield from limit_before(axis, self._target)
        if limit:
            raise LimitReachedError(axis, "did not take its target", reason=limit, remedy=OTHER_TARGET) from refused
        if start is not Start.AT_ONCE:
            remedy = "AxisSettings(queues_set_points=False), if it keeps no set-points"
            raise DriveError(axis, "took no target while it was on its way to another one", remedy=remedy) from refused

    def _place(self, point: ProfileTarget, *, is_first: bool) -> Procedure[tuple[int, int]]:
        """Return the value of 0x607A and bit 6 for a target. Keep where it leads, and check that."""
        axis = self._axis
        way, before = self._way(point), self._target
        absolute = self._absolute(point, before)
        if absolute is not None and (point.relative_to is None or is_first):  # before the first there is no target to count from
            self._target, self._is_exact = absolute, True
            yield from self._set_options(direction=point.direction)
            return absolute, 0
        assert point.relative_to is not None
        yield from self._set_options(relative_to=point.relative_to)
        if absolute is None:
            here = yield from demand_of(axis)
            if not axis.has_lost_reference:  # the drive takes it a little later, between here and the target before
                require_within_limits(axis, here, here + way)
                require_within_limits(axis, here, before + way)
            absolute = here + way
            self._is_exact = is_first and point.relative_to is RelativeTo.DEMAND
        self._target = absolute
        return way, int(ModeControl.RELATIVE)

    def _set_options(self, direction: RotaryDirection | None = None, relative_to: RelativeTo | None = None) -> Procedure[None]:
        """Write what a target needs to 0x60F2, if the drive has it."""
        present = self._written.get(objects.POSITIONING_OPTION_CODE)
        if present is not None:
            option = option_code(self._axis, present, direction, relative_to)
            yield from self._write(objects.POSITIONING_OPTION_CODE, option)

    def _write(self, key: Mux, value: int) -> Procedure[None]:
        """Write an object if its value changes."""
        if self._written.get(key) != value:
            yield from write(self._axis.node, key, value)
            self._written[key] = value

    def _left(self) -> Procedure[Time]:
        return max(0, self._deadline - (yield from current_time()))

    def _pass(self, duration: Time, runs_on: float) -> Procedure[None]:
        """Let time pass, and watch the drive meanwhile. runs_on: the speed with which it passes the target before, in the user's
        unit per second; it is halted before a limit of the settings then."""
        if not duration:
            return
        axis = self._axis
        end = (yield from current_time()) + duration
        watch: DriveWait[bool] = DriveWait(
            axis,
            "its next target",
            mode=Mode.PROFILE_POSITION,
            stays=State.OPERATION_ENABLED,
            reads={objects.POSITION_ACTUAL_VALUE: POLL_INTERVAL} if runs_on else None,
        )
        margin = (yield from self._way_to_stop(runs_on)) if runs_on and not axis.has_lost_reference else 0.0
        before: float | None = None

        def judge(statusword: int, heard_at: Time) -> bool | None:
            nonlocal before
            here = axis.position
            if margin and here is not None and watch.heard(objects.POSITION_ACTUAL_VALUE) is not None:
                way = 0.0 if before is None else here - before
                before = here
                limit = limits_of(axis).position_excess(here, here + math.copysign(margin, way)) if way else None
                if limit is not None:
                    reason = f"it passed its target at {runs_on:g} per second, and came near {limit.value:g} ({limit.source})"
                    remedy = "a shorter pause, or an end velocity of 0"
                    raise LimitReachedError(axis, f"was halted at {here:g}", reason=reason, remedy=remedy, looks=False)
            return heard_at >= end or None

        yield from watch.until(judge, (yield from self._left()))

    def _way_to_stop(self, speed: float) -> Procedure[float]:
        """Return the way that the drive needs to stop by a halt, in the user's unit. speed: in it per second."""
        axis = self._axis
        delay = (axis.settings.obeys_within + FRESH) / SECOND
        ramp, unit = (yield from halt_ramp(axis)), axis.scale.acceleration_unit
        if ramp is None or unit is None:
            return speed * (delay + axis.settings.halt_time / SECOND)
        return speed * delay + speed * speed / (2 * axis.scale.amount_from_counts(ramp * unit))

    def _require_way_to_stop(self, rate: int | None) -> Procedure[None]:
        """Raise LimitReachedError if a drive that is under way would pass a limit of the settings while it brakes for the next
        target. rate: the deceleration that comes with that target, in the drive's unit; None: it stays, and the drive can stop at
        the target before."""
        axis, node = self._axis, self._axis.node
        unit, velocity_unit = axis.scale.acceleration_unit, axis.scale.velocity_unit
        if rate is None or unit is None or velocity_unit is None or axis.has_lost_reference:
            return
        present = yield from read_if_present(node, objects.PROFILE_DECELERATION)
        number = yield from read_if_present(node, objects.VELOCITY_ACTUAL_VALUE)
        if not isinstance(number, int) or (isinstance(present, int) and rate >= present):
            return
        velocity = axis.scale.velocity_from_wire(number)
        here = axis.scale.from_counts((yield from demand_of(axis)))
        delay = (axis.settings.obeys_within + FRESH) / SECOND
        way = velocity * delay + velocity * abs(velocity) / (2 * axis.scale.amount_from_counts(rate * unit))
        limit = limits_of(axis).position_excess(here, here + way)
        if limit is not None:
            reason = f"it moves at {abs(velocity):.4g} per second, and would need {abs(way):.4g} to stop with the next target's"
            reason += f" deceleration; {limit.source} say {limit.value:g}"
            remedy = "a larger deceleration, or a target that starts when the one before is reached"
            raise LimitReachedError(axis, f"was halted at {here:g}", reason=reason, remedy=remedy, looks=False)

    def _wait_for_target(self) -> Procedure[None]:
        yield from wait_for_target(self._axis, self._target, self._given_at, (yield from self._left()), not self._is_exact)

    def wait_for_end(self) -> Procedure[None]:
        """Wait until the last target is the one that runs, and is reached."""
        yield from wait_for_acknowledge(self._axis, False, (yield from self._left()))
        yield from self._wait_for_target()
