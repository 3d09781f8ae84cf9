"""`TargetStream`: targets or velocities that come at any time become a motion that keeps every limit in every cycle.

For a joystick, a camera that follows a part, a jog key. Each cycle is one step of ruckig from the state that the last one ended
in; the joints are independent of each other. A goal may be replaced before it is reached, and a stream that nobody feeds ends at
rest by itself: a target is a place to rest at, and velocities have a dead man's switch.

Position limits. A joint is only ever brought into a state from which it can stop before its limits. A velocity that would end
this is replaced by a motion to the limit, no faster than that velocity: so a joint that is jogged into its limit brakes in time
and rests there, without a jolt.
"""

from __future__ import annotations

import math
from collections.abc import Sequence, Set
from enum import Enum, auto
from typing import Any, Final, NamedTuple, TypeAlias

from canopen_master.errors import PlanRefusedError
from canopen_master.trajectories.scaled_joints import ScaledJoint, check_values, load_ruckig, ruckig_refused, scaled_joints
from canopen_proto.drives.trajectory import JointLimits, PathPoint
from canopen_proto.drives.trajectory.polynomial import with_constant_jerk
from canopen_proto.drives.trajectory.speed_change import SpeedChange

_TOLERANCE: Final = 1e-9
"""Rounding errors of positions, in seconds at full speed."""
_REST: Final = 1e-9
"""A speed below is standstill, as a part of the full speed."""


class _StreamGoal(Enum):
    POSITIONS = auto()
    VELOCITIES = auto()
    STANDSTILL = auto()


_State: TypeAlias = tuple[float, float, float]
"""Position, velocity and acceleration of one joint, in the units of ruckig."""


class _Reach(NamedTuple):
    """The range of positions that a joint covers if it brakes now, and the highest speed that it has until then."""

    low: float
    high: float
    speed: float


class TargetStream:
    """Filter targets or velocities of several joints to their limits, one cycle after the other.

    start: where the joints are and how they move, at rest or not. limits: each joint needs speed, acceleration and jerk;
    positions are optional. They are used in full: a stream stops each joint by itself, so it needs no margin. cycle_time: in
    seconds; each `step` is one cycle, late or not. speed_factor: this part of the speed limits is used (above 0, at most 1).

    renew_cycles: the dead man's switch. So many steps may follow a call of `aim_at`, `move_at` or `renew`; the next one stops the
    stream. None: no such switch.

    Until the first goal the stream brakes to rest. Raises PlanRefusedError for a wrong argument; PackageMissingError without
    ruckig.
    """

    def __init__(
        self,
        start: PathPoint,
        limits: Sequence[JointLimits],
        cycle_time: float,
        *,
        speed_factor: float = 1.0,
        renew_cycles: int | None = None,
    ) -> None:
        self._joints = scaled_joints(start, limits, speed_factor=speed_factor)
        if not (math.isfinite(cycle_time) and cycle_time > 0.0):
            raise PlanRefusedError("cycle_time must be above 0 s", value=cycle_time, seen=repr(cycle_time))
        if renew_cycles is not None and renew_cycles < 1:
            raise PlanRefusedError("renew_cycles must be 1 or more", value=renew_cycles, seen=repr(renew_cycles))
        self._ruckig: Any = load_ruckig("a stream of targets")
        self._renew_cycles = renew_cycles
        self._unrenewed = 0
        self._goal = _StreamGoal.STANDSTILL
        self._wanted = [0.0] * len(self._joints)
        self._is_stopping = False
        self._point = start
        self._ranges = [
            ((joint.lowest - joint.origin) / joint.unit, (joint.highest - joint.origin) / joint.unit) for joint in self._joints
        ]
        self._is_given = False  # ruckig has the goal
        self.failure: PlanRefusedError | None = None
        """Why ruckig failed; the stream has then stopped. None as long as all is well."""
        count = len(self._joints)
        self._generator = self._ruckig.Ruckig(count, cycle_time)
        self._output = self._ruckig.OutputParameter(count)
        self._request = self._ruckig.InputParameter(count)
        self._request.synchronization = self._ruckig.Synchronization.No
        self._request.max_acceleration = [joint.acceleration for joint in self._joints]
        self._request.max_jerk = [joint.jerk for joint in self._joints]
        self._go_on_from(start)

    @property
    def point(self) -> PathPoint:
        """Where the joints are to be after the last step."""
        return self._point

    @property
    def is_stopping(self) -> bool:
        """Whether the stream has ended: by `stop`, by its dead man's switch, or by a failure. It takes no new goal."""
        return self._is_stopping

    @property
    def is_at_rest(self) -> bool:
        """Whether all joints stand still."""
        return all(
            abs(velocity) <= _REST * joint.unit and abs(acceleration) <= _REST * joint.unit * joint.acceleration
            for velocity, acceleration, joint in zip(self._point.velocities, self._point.accelerations, self._joints, strict=True)
        )

    @property
    def is_finished(self) -> bool:
        """Whether the stream has ended, and the joints stand."""
        return self._is_stopping and self.is_at_rest

    def aim_at(self, targets: Sequence[float]) -> None:
        """Go to these positions, one for each joint, and rest there. A target beyond a position limit counts as that limit.

        Raises PlanRefusedError for values that are not finite or not one for each joint (the goal before stays), and if the
        stream has ended.
        """
        self._check("target", targets)
        self._goal, self._is_given = _StreamGoal.POSITIONS, False
        self._wanted = [
            (min(max(target, joint.lowest), joint.highest) - joint.origin) / joint.unit
            for target, joint in zip(targets, self._joints, strict=True)
        ]
        self._unrenewed = 0

    def move_at(self, velocities: Sequence[float]) -> None:
        """Move at these velocities, one for each joint, in its unit per second. One beyond the speed limit counts as that limit.

        A joint that comes to a position limit rests there. Raises as `aim_at` does.
        """
        self._check("velocity", velocities)
        self._goal, self._is_given = _StreamGoal.VELOCITIES, False
        self._wanted = [
            min(max(velocity / joint.unit, -1.0), 1.0) for velocity, joint in zip(velocities, self._joints, strict=True)
        ]
        self._unrenewed = 0

    def renew(self) -> None:
        """Hold the dead man's switch: the caller is still there and wants its goal. Does nothing after the end."""
        self._unrenewed = 0

    def stop(self) -> None:
        """Brake each joint to rest as fast as its limits allow. This ends the stream."""
        self._is_stopping = True
        self._goal, self._is_given = _StreamGoal.STANDSTILL, False
        self._wanted = [0.0] * len(self._joints)

    def after_gap(self, lost_cycles: int, *, from_rest: bool) -> None:
        """Go on after cycles without a step. They count for the dead man's switch: nobody held it meanwhile.

        from_rest: at the present point, since the joints have come to rest there by themselves.
        """
        self._unrenewed += lost_cycles
        if not from_rest:
            return
        rest = [0.0] * len(self._joints)
        self._go_on_from(PathPoint(self._point.positions, rest, rest))

    def stand_at(self, first: int, positions: Sequence[float]) -> None:
        """Go on from where joints are that came to rest by themselves, from joint `first` on; the others stay as they are.
        positions: of these joints, each in its unit."""
        point, last = self._point, first + len(positions)
        rest = [0.0] * len(positions)
        each = zip(point, (positions, rest, rest), strict=True)
        self._go_on_from(PathPoint(*([*values[:first], *new, *values[last:]] for values, new in each)))

    def _go_on_from(self, point: PathPoint) -> None:
        self._point = point
        states = self._states(point)
        self._reaches = self._reaches_of(states)
        request = self._request
        request.current_position = [position for position, _, _ in states]
        request.current_velocity = [velocity for _, velocity, _ in states]
        request.current_acceleration = [acceleration for _, _, acceleration in states]
        self._is_given = False

    def step(self) -> PathPoint:
        """Go on by one cycle, and return where the joints are to be at its end, how fast, and how they accelerate.

        If ruckig fails, the stream stops and `failure` says why. Raises PlanRefusedError if it fails even then.
        """
        if self._renew_cycles is not None and not self._is_stopping:
            self._unrenewed += 1
            if self._unrenewed > self._renew_cycles:
                self.stop()
        if self._goal is _StreamGoal.STANDSTILL and self.is_at_rest:
            return self._point
        try:
            states = self._moved()
        except PlanRefusedError as failure:
            self.failure = failure
            self.stop()
            states = self._stepped({*range(len(self._joints))}, set())
            self._reaches = self._reaches_of(states)
        self._output.pass_to_input(self._request)
        self._point = PathPoint(
            [joint.origin + position * joint.unit for (position, _, _), joint in zip(states, self._joints, strict=True)],
            [velocity * joint.unit for (_, velocity, _), joint in zip(states, self._joints, strict=True)],
            [acceleration * joint.unit for (_, _, acceleration), joint in zip(states, self._joints, strict=True)],
        )
        return self._point

    def _check(self, kind: str, values: Sequence[float]) -> None:
        if self._is_stopping:
            raise PlanRefusedError(
                "the stream has ended", cause="it was stopped, or was not renewed in time", tries=("start another one",)
            ) from self.failure
        check_values(values, len(self._joints), kind)

    def _states(self, point: PathPoint) -> list[_State]:
        """Return the state of each joint in the units of ruckig."""
        return [
            ((position - joint.origin) / joint.unit, velocity / joint.unit, acceleration / joint.unit)
            for position, velocity, acceleration, joint in zip(*point, self._joints, strict=True)
        ]

    def _moved(self) -> list[_State]:
        """Let ruckig move to the goal. Joints that could not stop before a limit then go to that limit, or brake."""
        stopped: set[int] = set()
        to_limits: set[int] = set()
        states = self._stepped(stopped, to_limits)
        reaches = self._reaches_of(states)
        while self._goal is not _StreamGoal.STANDSTILL and (unsafe := self._unsafe(reaches) - stopped):
            if self._goal is _StreamGoal.VELOCITIES and not to_limits:
                to_limits = {number for number in unsafe if self._wanted[number] and self._can_stop_in_time(number)}
                stopped = unsafe - to_limits
            else:
                stopped |= unsafe
            states = self._stepped(stopped, to_limits)
            reaches = self._reaches_of(states)
        self._reaches = reaches
        return states

    def _stepped(self, stopped: Set[int], to_limits: Set[int]) -> list[_State]:
        """Return the states one cycle on. stopped, to_limits: joints that brake, or go to their limit, instead of to the goal."""
        if stopped or to_limits or not self._is_given:
            self._give(stopped, to_limits)
            self._is_given = not (stopped or to_limits)
        request, output = self._request, self._output
        try:
            self._generator.update(request, output)
        except (self._ruckig.RuckigError, ValueError) as error:
            raise ruckig_refused(error, "motion") from error
        return list(zip(output.new_position, output.new_velocity, output.new_acceleration, strict=True))

    def _give(self, stopped: Set[int], to_limits: Set[int]) -> None:
        """Hand ruckig what `_stepped` is asked for."""
        interfaces = self._ruckig.ControlInterface
        positions, velocities, fastest, used = [], [], [], []
        for number, (wanted, limits) in enumerate(zip(self._wanted, self._ranges, strict=True)):
            position, velocity, speed, interface = 0.0, 0.0, 1.0, interfaces.Velocity
            if number in stopped:
                pass
            elif number in to_limits:
                position = limits[1] if wanted > 0.0 else limits[0]
                speed = max(abs(wanted), self._reaches[number].speed)
                interface = interfaces.Position
            elif self._goal is _StreamGoal.POSITIONS:
                position, interface = wanted, interfaces.Position
            else:
                velocity = wanted
            positions.append(position)
            velocities.append(velocity)
            fastest.append(speed)
            used.append(interface)
        request = self._request
        request.target_position, request.target_velocity, request.max_velocity = positions, velocities, fastest
        request.per_dof_control_interface = used

    def _reaches_of(self, states: Sequence[_State]) -> list[_Reach]:
        return [_reach(*each) for each in zip(states, self._joints, self._ranges, strict=True)]

    def _unsafe(self, reaches: Sequence[_Reach]) -> set[int]:
        """Return the joints that could no longer stop before a limit after this step, or would stop further beyond it."""
        return {
            number
            for number, (after, before, (lowest, highest)) in enumerate(zip(reaches, self._reaches, self._ranges, strict=True))
            if after.low < min(lowest, before.low) - _TOLERANCE or after.high > max(highest, before.high) + _TOLERANCE
        }

    def _can_stop_in_time(self, number: int) -> bool:
        """Return whether a joint that brakes now stays within its position limits."""
        lowest, highest = self._ranges[number]
        return lowest - _TOLERANCE <= self._reaches[number].low and self._reaches[number].high <= highest + _TOLERANCE


def _reach(state: _State, joint: ScaledJoint, limits: tuple[float, float]) -> _Reach:
    """Return the range that a joint cannot help to cover: its stop from this state, as fast as the limits allow."""
    position, velocity, acceleration = state
    jerk, greatest = joint.jerk, max(joint.acceleration, abs(acceleration))
    speed = abs(velocity) + acceleration * acceleration / (2.0 * jerk)
    distance = speed * (abs(acceleration) / jerk + (greatest / jerk + speed / greatest) / 2.0)
    lowest, highest = limits
    if lowest <= position - distance and position + distance <= highest:
        return _Reach(position - distance, position + distance, speed)  # more than it needs, and quickly found: as nearly always
    end = position + SpeedChange(velocity, acceleration, 0.0, greatest, jerk).distance
    turn = position
    if velocity * acceleration < 0.0 and acceleration * acceleration > 2.0 * jerk * abs(velocity):
        # It brakes so hard that it turns back before its acceleration ends.
        time = (abs(acceleration) - math.sqrt(acceleration * acceleration - 2.0 * jerk * abs(velocity))) / jerk
        way, _, _ = with_constant_jerk(time, 0.0, abs(velocity), -abs(acceleration), jerk)
        turn += math.copysign(way, velocity)
    return _Reach(min(position, end, turn), max(position, end, turn), speed)
