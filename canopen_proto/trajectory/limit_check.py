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
from canopen_proto.trajectory.polynomial import derivative_of, extremes_of, value_at

EXACT: Final = 1 + 1e-6
"""A path at the limit itself is not refused for a rounding error of floating point."""


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


class Peak(NamedTuple):
    """The value with the largest magnitude, and the time of the path at which it occurs."""

    value: float
    time: float


class Demand(NamedTuple):
    """The largest speed, acceleration and jerk that a segment, or a knot, asks for."""

    speed: Peak
    acceleration: Peak
    jerk: Peak


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


def demands_of(path: Path, joint: int, cycle_time: float) -> Iterator[Demand]:
    """Yield what each segment of a joint asks for, and each knot between two of them."""
    begin = 0.0
    before: Segment | None = None
    for segment in path.segments[joint]:
        if before is not None:
            yield _demand_of_knot(before, segment, begin, cycle_time)
        speed = derivative_of(segment.coefficients)
        acceleration = derivative_of(speed)
        jerk = derivative_of(acceleration)
        duration = segment.duration
        yield Demand(_peak(speed, begin, duration), _peak(acceleration, begin, duration), _peak(jerk, begin, duration))
        before = segment
        begin += duration


def _violations(path: Path, joint: int, limits: JointLimits, cycle_time: float) -> Iterator[Violation]:
    begin = 0.0
    for segment in path.segments[joint]:
        low, low_time, high, high_time = extremes_of(segment.coefficients, segment.duration)
        if limits.lowest is not None and low < limits.lowest - POSITION_TOLERANCE * max(1.0, abs(limits.lowest)):
            yield Violation(joint, begin + low_time, "position", low, limits.lowest)
        if limits.highest is not None and high > limits.highest + POSITION_TOLERANCE * max(1.0, abs(limits.highest)):
            yield Violation(joint, begin + high_time, "position", high, limits.highest)
        begin += segment.duration
    for demand in demands_of(path, joint, cycle_time):
        for kind, peak, limit in (
            ("speed", demand.speed, limits.speed),
            ("acceleration", demand.acceleration, limits.acceleration),
            ("jerk", demand.jerk, limits.jerk),
        ):
            if limit is not None and abs(peak.value) > limit * EXACT:
                yield Violation(joint, peak.time, kind, peak.value, limit)


def _peak(coefficients: Sequence[float], begin: float, duration: float) -> Peak:
    low, low_time, high, high_time = extremes_of(coefficients, duration)
    return Peak(high, begin + high_time) if high >= -low else Peak(low, begin + low_time)


def _demand_of_knot(before: Segment, after: Segment, time: float, cycle_time: float) -> Demand:
    left: Sequence[float] = before.coefficients
    right: Sequence[float] = after.coefficients
    ends, starts = [], []
    for _ in range(3):
        left, right = derivative_of(left), derivative_of(right)
        ends.append(value_at(left, before.duration))
        starts.append(value_at(right, 0.0))
    jump = (starts[0] - ends[0]) / cycle_time
    jerk = (abs(jump) + abs(starts[1] - ends[1])) / cycle_time + max(abs(ends[2]), abs(starts[2]))
    return Demand(
        Peak(max(ends[0], starts[0], key=abs), time),
        Peak(max(jump + ends[1], jump + starts[1], key=abs), time),
        Peak(jerk, time),
    )
