"""`point_to_point`: a time-optimal motion of all joints to their targets, from any state of motion, as an exact `Path`.

ruckig finds for each joint the profile of seven phases of constant jerk, after one or two phases that bring a state beyond the
limits back within them. Each phase becomes one segment, with the numbers of ruckig: nothing is sampled. All joints arrive at the
same time; the joint that needs longest goes at its limits, the others go slower.

Source: Berscheid and Kröger, "Jerk-limited Real-time Trajectory Generation with Arbitrary Target States", 2021.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, TypeAlias

from canopen_master.errors import PlanRefusedError
from canopen_master.trajectories.scaled_joints import (
    ScaledJoint,
    beyond_limit,
    check_values,
    limit_exceeded,
    load_ruckig,
    position_excess,
    ruckig_refused,
    scaled_joints,
)
from canopen_proto.drives.trajectory import JointLimits, Path, PathPoint, Segment
from canopen_proto.drives.trajectory.polynomial import quintic_top, with_constant_jerk

MARGIN: Final = 0.2
"""The part of acceleration and jerk that a plan leaves free, so that it can be slowed down and stopped on its own path."""
STANDSTILL: Final = 1e-3
"""Seconds that a plan takes whose joints are all at their targets already: a path must take some time."""
_SHORTEST: Final = 1e-12
"""Phases that are shorter, in seconds, are rounding errors and are left out."""


_State: TypeAlias = tuple[float, float, float]
"""Position, velocity and acceleration of one joint at one moment."""


def point_to_point(
    start: PathPoint,
    targets: Sequence[float],
    limits: Sequence[JointLimits],
    *,
    margin: float = MARGIN,
    speed_factor: float = 1.0,
    minimum_duration: float = 0.0,
) -> Path:
    """Return the fastest path from `start` to rest at `targets` that keeps the limits; it ends exactly there.

    start: where the joints are and how they move. It may be any point of another path: the new path goes on from it without a
    stop. It may be beyond the limits of speed and acceleration: they are then kept as soon as the jerk allows. targets: one
    position for each joint. limits: each joint needs speed, acceleration and jerk; positions are optional.

    margin: the part of acceleration and jerk that stays free (0 to below 1). speed_factor: the part of each speed limit that is
    used (above 0, at most 1). minimum_duration: in seconds; the path takes at least so long.

    A joint that starts beyond a position limit may stay there or come back, but not go further. A joint that would leave its
    position limits on its way only because it waits for the others arrives earlier, and rests until they have arrived.

    Raises PlanRefusedError (with joint, value and limit) for a target beyond a position limit, for a start that is too fast to
    stop before one, for values that are not finite or not one for each joint, and if ruckig fails; PackageMissingError without
    ruckig.
    """
    joints = scaled_joints(start, limits, margin=margin, speed_factor=speed_factor)
    check_values(targets, len(joints), "target")
    for number, (target, joint) in enumerate(zip(targets, joints, strict=True)):
        limit = limit_exceeded(target, joint)
        if limit is not None:
            raise beyond_limit(number, target, limit, f"joint {number} cannot go to {target:g}", "a target within its limits")
    if not (math.isfinite(minimum_duration) and minimum_duration >= 0.0):
        raise PlanRefusedError("minimum_duration must be 0 s or more", value=minimum_duration, seen=repr(minimum_duration))
    ruckig = load_ruckig("planning a motion")
    request = _request(ruckig, joints, start, targets)
    if minimum_duration:
        request.minimum_duration = minimum_duration
    path = _calculated(ruckig, request, joints, start, targets)
    if beyond := [number for number, each in enumerate(joints) if position_excess(path, number, each) is not None]:
        synchronization = ruckig.Synchronization
        request.per_dof_synchronization = [
            synchronization.No if number in beyond else synchronization.Time for number in range(len(joints))
        ]
        path = _calculated(ruckig, request, joints, start, targets)
        for number in beyond:
            if (excess := position_excess(path, number, joints[number])) is not None:
                failed = f"joint {number} moves too fast to stop before its limit"
                raise beyond_limit(number, *excess, failed, "stop on the path under way, then plan")
    return path


def _request(ruckig: Any, joints: Sequence[ScaledJoint], start: PathPoint, targets: Sequence[float]) -> Any:
    """Return the input of ruckig, in its units."""
    request = ruckig.InputParameter(len(joints))
    request.current_position = [0.0] * len(joints)
    request.current_velocity = [value / joint.unit for value, joint in zip(start.velocities, joints, strict=True)]
    request.current_acceleration = [value / joint.unit for value, joint in zip(start.accelerations, joints, strict=True)]
    request.target_position = [(value - joint.origin) / joint.unit for value, joint in zip(targets, joints, strict=True)]
    request.max_velocity = [1.0] * len(joints)
    request.max_acceleration = [joint.acceleration for joint in joints]
    request.max_jerk = [joint.jerk for joint in joints]
    return request


def _calculated(ruckig: Any, request: Any, joints: Sequence[ScaledJoint], start: PathPoint, targets: Sequence[float]) -> Path:
    """Let ruckig calculate, and return the path."""
    trajectory = ruckig.Trajectory(len(joints))
    try:
        ruckig.Ruckig(len(joints)).calculate(request, trajectory)
    except (ruckig.RuckigError, ValueError) as error:
        raise ruckig_refused(error, "path") from error
    if trajectory.duration < _SHORTEST:
        return Path([[Segment(STANDSTILL, (target,))] for target in targets])
    states = zip(*start, strict=True)
    return Path([
        _segments(profile, state, target, joint.unit, trajectory.duration)
        for profile, state, target, joint in zip(trajectory.profiles[0], states, targets, joints, strict=True)
    ])  # fmt: skip


def _segments(profile: Any, start: _State, target: float, unit: float, duration: float) -> list[Segment]:
    """Return the phases of one joint's profile as segments, in the user's unit. The last one ends exactly at the target."""
    phases = [
        (time, jerk * unit)
        for time, jerk in (
            *zip(profile.brake.t, profile.brake.j, strict=True),
            *zip(profile.t, profile.j, strict=True),
        )
        if time > _SHORTEST
    ]
    durations = [time for time, _ in phases]
    segments: list[Segment] = []
    if phases:
        longest = max(range(len(phases)), key=durations.__getitem__)
        p, v, a = start
        states = [(p, v, a)]
        for time, jerk in phases:
            p, v, a = with_constant_jerk(time, p, v, a, jerk)
            states.append((p, v, a))
        error = with_constant_jerk(-math.fsum(durations[longest + 1 :]), target - p, -v, -a, 0.0)
        for number, (time, jerk) in enumerate(phases):
            if number <= longest:
                p, v, a = states[number]
            coefficients: tuple[float, ...] = (p, v, a / 2.0, jerk / 6.0)
            if number == longest:
                coefficients = (p, v, a / 2.0, *_added(jerk / 6.0, error, time))
                p, v, a = (one + other for one, other in zip(states[number + 1], error, strict=True))
            elif number > longest:
                p, v, a = with_constant_jerk(time, p, v, a, jerk)
            segments.append(Segment(time, coefficients))
    rest = duration - math.fsum(durations)
    if rest > _SHORTEST or not segments:
        segments.append(Segment(rest, (target,)))
    return segments


def _added(cubic: float, error: _State, time: float) -> tuple[float, float, float]:
    """Return the upper coefficients of a segment that also takes up an error until its end, and nothing of it at its start."""
    position, velocity, acceleration = error
    c3, c4, c5 = quintic_top(position, velocity * time, acceleration * time * time / 2.0, time)
    return cubic + c3, c4, c5
