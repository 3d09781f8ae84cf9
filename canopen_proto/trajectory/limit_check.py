"""The limits of joints, and the first place at which a path exceeds one.

The check looks at the extremes of each polynomial, not at samples of it. A jump at a knot counts as spread over one cycle: a
velocity that jumps by dv asks for the acceleration dv / cycle, an acceleration that jumps by da for the jerk da / cycle. So it is
seen by a drive that gets a position each cycle. For the same reason a jump of the velocity asks for the jerk dv / cycle², which
hardly any limit allows: a path of straight lines has no limited jerk.

The ends of a path count as they are, at rest or not: `PathClock` leaves the start and reaches the end within the limits.

Units: the user's unit of each joint, seconds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from canopen_proto.trajectory.path import POSITION_TOLERANCE, Path, PathError, Segment
from canopen_proto.trajectory.polynomial import Extremes, derivative_of, extremes_of, value_at

EXACT: Final = 1 + 1e-6
"""A path at the limit itself is not refused for a rounding error of floating point."""
_KINDS: Final = ("speed", "acceleration", "jerk")


@dataclass(frozen=True, slots=True)
class JointLimits:
    """The limits of one joint, in its user's unit; None or math.inf: no limit.

    lowest, highest: positions. speed, acceleration, jerk: per second, per second², per second³, above 0, for both directions.
    Raises PathError for limits that allow nothing.
    """

    lowest: float | None = None
    highest: float | None = None
    speed: float | None = None
    acceleration: float | None = None
    jerk: float | None = None

    def __post_init__(self) -> None:
        if self.lowest is not None and self.highest is not None and not self.lowest < self.highest:
            raise PathError(f"The lowest position must be below the highest one; they are {self.lowest!r} and {self.highest!r}.")
        for name, limit in (("speed", self.speed), ("acceleration", self.acceleration), ("jerk", self.jerk)):
            if limit is not None and not limit > 0.0:
                raise PathError(f"A limit of the {name} must be above 0, or None for no limit; it is {limit!r}.")


class Violation(NamedTuple):
    """A path exceeds a limit. joint: counted from 0. time: of the path, in s. kind: "position", "speed", "acceleration", "jerk".

    value: as the path has it, with its sign; limit: the magnitude that it exceeds, of a position the limit itself.
    """

    joint: int
    time: float
    kind: str
    value: float
    limit: float

    def __str__(self) -> str:
        return f"joint {self.joint} at {self.time:.6g} s: {self.kind} {self.value:.6g}, limit {self.limit:.6g}"


class Demand(NamedTuple):
    """The demands of a segment, or of a knot between two of them, on its joint. begin, and the times: of the path."""

    begin: float
    speed: Extremes
    acceleration: Extremes
    jerk: Extremes


def check_same_count(path: Path, limits: Sequence[JointLimits]) -> None:
    """Raise PathError unless there are limits for each joint of the path."""
    if len(limits) != path.joints:
        raise PathError(f"The path has {path.joints} joints, but there are limits for {len(limits)}. Try: one JointLimits each.")


def check_cycle(cycle_time: float) -> None:
    """Raise PathError unless this is the time of a cycle."""
    if not 0.0 < cycle_time < math.inf:
        raise PathError(f"A cycle takes {cycle_time!r} s. Try: the period of the SYNC in seconds, such as 0.004.")


def first_violation(path: Path, limits: Sequence[JointLimits], cycle_time: float) -> Violation | None:
    """Return the earliest place at which the path exceeds a limit, None if it is within all of them.

    cycle_time: in s; see this module's text. Of each segment that exceeds a limit the place where it does so most is compared.
    A position may be off by POSITION_TOLERANCE, another value by EXACT. Raises PathError for arguments that do not fit the path.
    """
    check_same_count(path, limits)
    check_cycle(cycle_time)
    first: Violation | None = None
    for joint, own in enumerate(limits):
        for found in _violations(path, joint, own, cycle_time):
            if first is None or found.time < first.time:
                first = found
    return first


def reach_of(path: Path, joint: int) -> tuple[float, float]:
    """Return the lowest and the highest position of a joint on the path."""
    found = [extremes_of(segment.coefficients, segment.duration) for segment in path.segments[joint]]
    return min([each.low for each in found]), max([each.high for each in found])


def demands_of(path: Path, joint: int, cycle_time: float) -> Iterator[Demand]:
    """Yield what each segment of a joint asks for, and before it what the knot at its begin does."""
    begin = 0.0
    before: Segment | None = None
    for segment in path.segments[joint]:
        if before is not None:
            yield _demand_of_knot(before, segment, begin, cycle_time)
        duration = segment.duration
        speed = derivative_of(segment.coefficients)
        acceleration = derivative_of(speed)
        yield Demand(
            begin,
            extremes_of(speed, duration, begin),
            extremes_of(acceleration, duration, begin),
            extremes_of(derivative_of(acceleration), duration, begin),
        )
        before = segment
        begin += duration


def _violations(path: Path, joint: int, limits: JointLimits, cycle_time: float) -> Iterator[Violation]:
    lowest = -math.inf if limits.lowest is None else limits.lowest - POSITION_TOLERANCE * max(1.0, abs(limits.lowest))
    highest = math.inf if limits.highest is None else limits.highest + POSITION_TOLERANCE * max(1.0, abs(limits.highest))
    begin = 0.0
    for duration, coefficients in path.segments[joint]:
        reach = value_at([abs(each) for each in coefficients], duration) - abs(coefficients[0])  # it goes no further than that
        if coefficients[0] - reach < lowest or coefficients[0] + reach > highest:
            low, low_time, high, high_time = extremes_of(coefficients, duration, begin)
            if limits.lowest is not None and low < lowest:
                yield Violation(joint, low_time, "position", low, limits.lowest)
            if limits.highest is not None and high > highest:
                yield Violation(joint, high_time, "position", high, limits.highest)
        begin += duration
    for demand in demands_of(path, joint, cycle_time):
        for kind, found, limit in zip(_KINDS, demand[1:], (limits.speed, limits.acceleration, limits.jerk), strict=True):
            if limit is not None and -found.low > limit * EXACT:
                yield Violation(joint, found.low_time, kind, found.low, limit)
            if limit is not None and found.high > limit * EXACT:
                yield Violation(joint, found.high_time, kind, found.high, limit)


def _demand_of_knot(before: Segment, after: Segment, time: float, cycle_time: float) -> Demand:
    left: Sequence[float] = before.coefficients
    right: Sequence[float] = after.coefficients
    ends, starts = [], []
    for _ in range(3):
        left, right = derivative_of(left), derivative_of(right)
        ends.append(value_at(left, before.duration))
        starts.append(right[0] if right else 0.0)
    jump = (starts[0] - ends[0]) / cycle_time
    jerk = (abs(jump) + abs(starts[1] - ends[1])) / cycle_time + max(abs(ends[2]), abs(starts[2]))
    return Demand(
        time,
        _between(ends[0], starts[0], time),
        _between(jump + ends[1], jump + starts[1], time),
        _between(0.0, jerk, time),
    )


def _between(one: float, other: float, time: float) -> Extremes:
    return Extremes(min(one, other), time, max(one, other), time)
