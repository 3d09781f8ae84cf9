"""Goals as ROS gives them, `control_msgs/FollowJointTrajectory` and `trajectory_msgs/JointTrajectory`, and the path of one.

**Points.** A point is at its time after the start. The path begins where the joints are when the goal begins, at rest or moving.
A first point at time 0 only says where the client thinks that they are; it is refused if a joint is farther off than
`start_tolerance`. From there a polynomial of degree 5 leads from point to point, through every position exactly: through
velocities and accelerations if the points have them, else those of the smoothest curve. The last point is at rest.

**Joints** are found by their names, in any order. Joints of the chain that are not in the goal stay where they are; a
goal without a joint that moves at present is refused.

**Times.** A start in the past: points that are past already are left out. A start less than LATE ago counts as now.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import Final, NamedTuple

from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.drives.trajectory import Path, PathPoint, Segment
from canopen_proto.drives.trajectory.interpolation import quintic, spline_velocities

START: Final = 0.01
"""Radians, or metres, by which a motion may begin off a joint (`start_tolerance`): as MoveIt's `allowed_start_tolerance`."""
LATE: Final = 0.5
"""Seconds: a message with a start so short ago was on its way. A path begins late then; it never catches up."""
REST: Final = 1e-3
"""Radians, or metres, per second: a last point with less is at rest."""
STANDSTILL: Final = 1e-3
"""Seconds that a path takes whose joints are at their places already: a path must take some time."""
NO_LIMIT: Final = -1.0
"""A tolerance that is this lets the joint be anywhere; 0 is the default of the node."""


class GoalCode(IntEnum):
    """`error_code` of control_msgs/FollowJointTrajectoryResult."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class GoalOutcome(Enum):
    """How a goal ended: the status of an action."""

    SUCCEEDED = "succeeded"
    PREEMPTED = "preempted"
    """Cancelled, or another motion took over. "Canceled" in ROS 2."""
    ABORTED = "aborted"
    """It began, and did not come to its end."""
    REJECTED = "rejected"
    """Nothing has moved because of it."""


class TrajectoryPoint(NamedTuple):
    """positions: rad or m, in the order of the goal's joints. velocities, accelerations: per second, per second², or empty.

    time_from_start: seconds.
    """

    positions: Sequence[float]
    velocities: Sequence[float] = ()
    accelerations: Sequence[float] = ()
    time_from_start: float = 0.0


class Tolerance(NamedTuple):
    """How far a joint may be off: rad or m, per second, per second². 0: the default; -1 (NO_LIMIT): no limit."""

    joint: str
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryGoal:
    """A goal. joint_names: in any order. points: none means "stop". start: ns since 1970; 0 means now.

    path_tolerance: on the way; by default the chain's own supervision only. goal_tolerance: at the end; by default none.
    goal_time_tolerance: seconds behind the end until the joints have to be within `goal_tolerance`; 0: the default of the node.
    """

    joint_names: Sequence[str]
    points: Sequence[TrajectoryPoint]
    path_tolerance: Sequence[Tolerance] = ()
    goal_tolerance: Sequence[Tolerance] = ()
    goal_time_tolerance: float = 0.0
    start: int = field(default=0)


class GoalResult(NamedTuple):
    """code: of control_msgs. text: for people. outcome: the status of the action."""

    code: GoalCode
    text: str
    outcome: GoalOutcome


class Feedback(NamedTuple):
    """Where all joints of the chain are, in its order; in SI units.

    error: desired minus actual, of the same instant. The `time_from_start` of all three is the time since the motion began.
    """

    joint_names: tuple[str, ...]
    desired: TrajectoryPoint
    actual: TrajectoryPoint
    error: TrajectoryPoint


class GoalRefusedError(Exception):
    """A goal cannot be followed. code: why. text: for people."""

    def __init__(self, code: GoalCode, text: str) -> None:
        super().__init__(text)
        self.code = code


class JointPoint(NamedTuple):
    """A point, with its values in the order of the chain; None for a joint that the goal does not name. time: in seconds."""

    time: float
    positions: list[float | None]
    velocities: list[float | None]
    accelerations: list[float | None]


def checked(goal: TrajectoryGoal, names: Sequence[str], now: int) -> list[JointPoint]:
    """Return the points of a goal from now on, in the order of the chain. names: of its joints. now: ns since 1970.

    Raises GoalRefusedError, with the joint, the time and the value where there are such.
    """
    order = _order(goal.joint_names, names)
    for tolerance in (*goal.path_tolerance, *goal.goal_tolerance):
        _check_tolerance(tolerance, names)
    if not math.isfinite(goal.goal_time_tolerance) or goal.goal_time_tolerance < 0:
        raise _invalid(f"goal_time_tolerance is {goal.goal_time_tolerance!r}; it has to be 0 s or more")
    _check_points(goal)
    points = [
        JointPoint(
            point.time_from_start,
            _placed(point.positions, order, len(names)),
            _placed(point.velocities, order, len(names)),
            _placed(point.accelerations, order, len(names)),
        )
        for point in goal.points
    ]
    late = (now - goal.start) / 1e9 if goal.start else 0.0
    if points and late > LATE:
        if late >= points[-1].time:
            text = f"the trajectory ended {late - points[-1].time:.3g} s ago: it starts {late:.3g} s in the past"
            raise GoalRefusedError(GoalCode.OLD_HEADER_TIMESTAMP, text)
        points = [point._replace(time=point.time - late) for point in points if point.time > late]
    return points


def path_of(
    points: Sequence[JointPoint], start: PathPoint, names: Sequence[str], scales: Sequence[float], tolerance: float = START
) -> Path:
    """Return the path of a goal, in the joints' own units. start: where the joints are and how they move, in these units. names:
    of the joints.

    scales: radians, or metres, in one unit of each joint. tolerance: how far, in these, a joint may be off a first point at time
    0. Raises GoalRefusedError; PathError for values that make no path.
    """
    first = points[0]
    if first.time <= 0.0:
        for name, wanted, position, scale in zip(names, first.positions, start.positions, scales, strict=True):
            here = position * scale
            if wanted is not None and abs(wanted - here) > tolerance:
                raise _invalid(
                    f"{name} is at {here:.6g} at 0 s, and the trajectory begins at {wanted:.6g}: {abs(wanted - here):.3g} away, "
                    f"{tolerance:g} are allowed. Try: a trajectory from where the joints are, or a first point at a later time"
                )
        points = points[1:]
    for name, wanted, velocity in zip(names, first.positions, start.velocities, strict=True):
        if wanted is None and velocity:
            raise _invalid(f"{name} moves, and is not in the trajectory. Try: all joints, or an empty trajectory before")
    if not points:
        return Path(_resting(start))
    times = [0.0, *(point.time for point in points)]
    rows: list[tuple[list[float], list[float], list[float]]] = []
    for joint, scale in enumerate(scales):
        begin = start.positions[joint], start.velocities[joint], start.accelerations[joint]
        rows.append(_knots(times, points, joint, scale, begin))
    positions, velocities, accelerations = ([list(row) for row in zip(*each, strict=True)] for each in zip(*rows, strict=True))
    return quintic(times, positions, velocities, accelerations)


def _knots(
    times: Sequence[float], points: Sequence[JointPoint], joint: int, scale: float, start: tuple[float, float, float]
) -> tuple[list[float], list[float], list[float]]:
    """Return positions, velocities and accelerations of one joint at all times."""
    given = [point.positions[joint] for point in points]
    positions = [start[0], *(start[0] if value is None else value / scale for value in given)]
    told = [point.velocities[joint] for point in points]
    if None in told:
        steps = [end - begin for begin, end in itertools.pairwise(times)]
        velocities = spline_velocities(steps, positions, (start[1], 0.0))
    else:
        velocities = [start[1], *((value or 0.0) / scale for value in told)]
    wanted = [point.accelerations[joint] for point in points]
    if None in wanted or None in told:
        accelerations = [start[2], *_smooth(times, positions, velocities), 0.0]
    else:
        accelerations = [start[2], *((value or 0.0) / scale for value in wanted)]
    return positions, velocities, accelerations


def _smooth(times: Sequence[float], positions: Sequence[float], velocities: Sequence[float]) -> list[float]:
    """Return accelerations at the inner times: the mean of those that the cubic polynomials on both sides have there."""
    found = []
    for number in range(1, len(times) - 1):
        sides = []
        for begin, sign in ((number - 1, 1.0), (number, -1.0)):
            h = times[begin + 1] - times[begin]
            way = 3.0 * (positions[begin + 1] - positions[begin]) / h
            other, here = (velocities[begin], velocities[begin + 1]) if sign > 0 else (velocities[begin + 1], velocities[begin])
            sides.append(sign * 2.0 * (other + 2.0 * here - way) / h)
        found.append(sum(sides) / 2.0)
    return found


def _resting(start: PathPoint) -> list[list[Segment]]:
    if any(start.velocities):
        raise _invalid("the joints move, and the trajectory ends at 0 s. Try: a point at a later time, or an empty trajectory")
    return [[Segment(STANDSTILL, (position,))] for position in start.positions]


def _order(joint_names: Sequence[str], names: Sequence[str]) -> list[int]:
    """Return the places of the goal's joints in the chain."""
    for number, name in enumerate(joint_names):
        if name not in names:
            text = f"there is no joint {name!r}{did_you_mean(name, names)}; the joints are {', '.join(names)}"
            raise GoalRefusedError(GoalCode.INVALID_JOINTS, text)
        if name in joint_names[:number]:
            raise GoalRefusedError(GoalCode.INVALID_JOINTS, f"joint {name!r} is named twice")
    return [names.index(name) for name in joint_names]


def _placed(values: Sequence[float], order: Sequence[int], count: int) -> list[float | None]:
    placed: list[float | None] = [None] * count
    for place, value in zip(order, values, strict=False):
        placed[place] = value
    return placed


def _check_tolerance(tolerance: Tolerance, names: Sequence[str]) -> None:
    if tolerance.joint not in names:
        raise GoalRefusedError(
            GoalCode.INVALID_JOINTS, f"a tolerance is for {tolerance.joint!r}; the joints are {', '.join(names)}"
        )
    for kind in ("position", "velocity", "acceleration"):
        value: float = getattr(tolerance, kind)
        if not math.isfinite(value) or (value < 0 and value != NO_LIMIT):
            raise _invalid(f"the tolerance of {tolerance.joint} in {kind} is {value!r}; it has to be above 0, 0 (default) or -1")
    if tolerance.acceleration > 0:
        raise _invalid(f"{tolerance.joint} has a tolerance of acceleration, which no drive tells. Try: 0 there")


def _check_points(goal: TrajectoryGoal) -> None:
    names, points = goal.joint_names, goal.points
    if points and not names:
        raise GoalRefusedError(GoalCode.INVALID_JOINTS, "the goal names no joints")
    before = -math.inf
    for number, point in enumerate(points):
        time = point.time_from_start
        where = f"point {number} (counted from 0)"
        if not math.isfinite(time) or time < 0.0 or time <= before:
            least = "0 s or later" if number == 0 else f"later than {before:g} s, the time of the point before"
            raise _invalid(f"{where} is at {time!r} s; it has to be {least}")
        before = time
        for kind in ("positions", "velocities", "accelerations"):
            values: Sequence[float] = getattr(point, kind)
            if len(values) != len(names) and not (kind != "positions" and not values):
                raise _invalid(f"{where} has {len(values)} {kind} for {len(names)} joints")
            for name, value in zip(names, values, strict=False):
                if not math.isfinite(value):
                    raise _invalid(f"{name} has no finite number in the {kind} of {where}, at {time:g} s: {value!r}")
            if bool(values) != bool(getattr(points[0], kind)):
                raise _invalid(f"{where} has {'' if values else 'no '}{kind}, unlike point 0. Try: all points alike")
        if point.accelerations and not point.velocities:
            raise _invalid(f"{where} has accelerations and no velocities. Try: both, or neither")
    for name, value in zip(names, points[-1].velocities if points else (), strict=False):
        if abs(value) > REST:
            raise _invalid(f"{name} does not rest at the end, at {before:g} s: its velocity is {value:.6g}. Try: 0 there")


def _invalid(text: str) -> GoalRefusedError:
    return GoalRefusedError(GoalCode.INVALID_GOAL, text)
