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
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from canopen_proto.drives.trajectory.path import POSITION_TOLERANCE, Path, PathError, Piece
from canopen_proto.drives.trajectory.polynomial import Extremes, derivatives_at, extremes_of
from canopen_proto.drives.trajectory.steps import PART, finished

EXACT: Final = 1 + 1e-6
"""A path at the limit itself is not refused for a rounding error of floating point."""
_SAME_SPEED: Final = 1e-12
"""A velocity that changes by no more than this at a knot does not jump (above 1: this part of itself)."""
_SAME_ACCELERATION: Final = 1e-9
"""The same of an acceleration."""
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
        lowest, highest = self.range
        if not lowest < highest:
            raise PathError(f"The lowest position must be below the highest one; they are {self.lowest!r} and {self.highest!r}.")
        for name, limit in (("speed", self.speed), ("acceleration", self.acceleration), ("jerk", self.jerk)):
            if limit is not None and not limit > 0.0:
                raise PathError(f"A limit of the {name} must be above 0, or None for no limit; it is {limit!r}.")

    @property
    def range(self) -> tuple[float, float]:
        """The lowest and the highest position; without a limit infinity, with its sign."""
        return -math.inf if self.lowest is None else self.lowest, math.inf if self.highest is None else self.highest

    @property
    def most(self) -> tuple[float, float, float]:
        """The limits of speed, acceleration and jerk; infinity for none."""
        return (
            math.inf if self.speed is None else self.speed,
            math.inf if self.acceleration is None else self.acceleration,
            math.inf if self.jerk is None else self.jerk,
        )


class LimitViolation(NamedTuple):
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
    """Raise PathError unless this is the time of a cycle: seconds, above 0 and finite."""
    if not 0.0 < cycle_time < math.inf:
        raise PathError(f"A cycle takes {cycle_time!r} s. Try: the period of the SYNC in seconds, such as 0.004.")


def first_violation(path: Path, limits: Sequence[JointLimits], cycle_time: float) -> LimitViolation | None:
    """Return the earliest place at which the path exceeds a limit, None if it is within all of them.

    cycle_time: in s; see this module's text. Of each segment that exceeds a limit the place where it does so most is compared.
    A position may be off by POSITION_TOLERANCE, another value by EXACT. Raises PathError for arguments that do not fit the path.
    """
    return finished(first_violation_in_steps(path, limits, cycle_time))


def first_violation_in_steps(
    path: Path, limits: Sequence[JointLimits], cycle_time: float
) -> Generator[None, None, LimitViolation | None]:
    """Find what `first_violation` returns, in steps; see steps.py. For the arguments see there."""
    check_same_count(path, limits)
    check_cycle(cycle_time)
    first: LimitViolation | None = None
    for joint, own in enumerate(limits):
        for number in range(0, len(path.pieces[joint]), PART):
            for found in _violations(path, joint, own, cycle_time, number):
                if first is None or found.time < first.time:
                    first = found
            yield
    return first


def reach_of(path: Path, joint: int) -> tuple[float, float]:
    """Return the lowest and the highest position of a joint on the path."""
    found = [extremes_of(segment.coefficients, segment.duration) for segment in path.segments[joint]]
    return min([each.low for each in found]), max([each.high for each in found])


def demands_of(path: Path, joint: int, cycle_time: float, first: int = 0, count: int | None = None) -> Iterator[Demand]:
    """Yield what segments of a joint ask for, and before each of them what the knot at its begin does, if anything jumps there.
    cycle_time: s.

    first, count: from this segment on, and so many of them; all, unless told otherwise.
    """
    pieces = path.pieces[joint]
    v1 = a1 = j1 = 0.0  # where the segment before ends
    if first:
        _, d, _, c1, c2, c3, c4, c5 = pieces[first - 1]
        v1, a1, j1 = derivatives_at(d, c1, c2, c3, c4, c5)
    for number in range(first, len(pieces) if count is None else min(first + count, len(pieces))):
        begin, d, _, c1, c2, c3, c4, c5 = pieces[number]
        a, j = 2.0 * c2, 6.0 * c3
        if number and jumps(v1, a1, c1, a):  # else it asks for no more than its neighbours
            jump = (c1 - v1) / cycle_time
            jerk = (abs(jump) + abs(a - a1)) / cycle_time + max(abs(j1), abs(j))
            yield Demand(
                begin,
                _between(v1, begin, c1, begin),
                _between(jump + a1, begin, jump + a, begin),
                Extremes(0.0, begin, jerk, begin),
            )
        end = begin + d
        if c4 == 0.0 == c5:  # of constant jerk, as nearly all are
            v1, a1, j1 = c1 + d * (a + d * (3.0 * c3)), a + d * j, j
            speed = _between(c1, begin, v1, end)
            if a < 0.0 < a1 or a1 < 0.0 < a:
                turn = c1 - a * a / (2.0 * j)
                if a < 0.0:
                    speed = Extremes(turn, begin - a / j, speed.high, speed.high_time)
                else:
                    speed = Extremes(speed.low, speed.low_time, turn, begin - a / j)
            yield Demand(begin, speed, _between(a, begin, a1, end), Extremes(j, begin, j, begin))
        else:
            v1, a1, j1 = derivatives_at(d, c1, c2, c3, c4, c5)
            yield Demand(
                begin,
                extremes_of((c1, a, 3.0 * c3, 4.0 * c4, 5.0 * c5), d, begin),
                extremes_of((a, j, 12.0 * c4, 20.0 * c5), d, begin),
                extremes_of((j, 24.0 * c4, 60.0 * c5), d, begin),
            )


def positions_beyond(pieces: Iterable[Piece], least: float, most: float) -> Iterator[tuple[float, float]]:
    """Yield time and position of each extreme of these segments that is below `least` or above `most`; infinity: no limit."""
    if math.isinf(least) and math.isinf(most):
        return
    for begin, d, c0, c1, c2, c3, c4, c5 in pieces:
        reach = d * (abs(c1) + d * (abs(c2) + d * (abs(c3) + d * (abs(c4) + d * abs(c5)))))  # it goes no further than that
        if c0 - reach < least or c0 + reach > most:
            low, low_time, high, high_time = extremes_of((c0, c1, c2, c3, c4, c5), d, begin)
            if low < least:
                yield low_time, low
            if high > most:
                yield high_time, high


def jumps(velocity: float, acceleration: float, next_velocity: float, next_acceleration: float) -> bool:
    """Return whether velocity or acceleration jump at a knot, by more than a rounding error. velocity, acceleration: before it.
    next_velocity, next_acceleration: behind it."""
    if abs(next_velocity - velocity) > _SAME_SPEED * max(1.0, abs(next_velocity)):
        return True
    return abs(next_acceleration - acceleration) > _SAME_ACCELERATION * max(1.0, abs(next_acceleration))


def _violations(path: Path, joint: int, limits: JointLimits, cycle_time: float, first: int) -> Iterator[LimitViolation]:
    """Yield the violations of PART segments, from this one on."""
    lowest, highest = limits.range
    least, most = lowest - POSITION_TOLERANCE * max(1.0, abs(lowest)), highest + POSITION_TOLERANCE * max(1.0, abs(highest))
    for time, position in positions_beyond(path.pieces[joint][first : first + PART], least, most):
        yield LimitViolation(joint, time, "position", position, lowest if position < least else highest)
    own = limits.most
    for demand in demands_of(path, joint, cycle_time, first, PART):
        for order, peaks in enumerate((demand.speed, demand.acceleration, demand.jerk)):
            low, low_time, high, high_time = peaks
            if -low > own[order] * EXACT:
                yield LimitViolation(joint, low_time, _KINDS[order], low, own[order])
            if high > own[order] * EXACT:
                yield LimitViolation(joint, high_time, _KINDS[order], high, own[order])


def _between(one: float, one_time: float, other: float, other_time: float) -> Extremes:
    """Return the extremes of what only rises or falls from one value to the other."""
    if one < other:
        return Extremes(one, one_time, other, other_time)
    return Extremes(other, other_time if other < one else one_time, one, one_time)
