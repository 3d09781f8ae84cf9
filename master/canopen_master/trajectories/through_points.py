"""`through_points`: a path through waypoints without times, as fast as the limits allow on the smooth curve through them.

The curve is a cubic spline, whose parameter is the time that the joint with the longest way needs at full speed. A rate is found
at which to go along it. The result is laid through quintic polynomials, with the curve's positions, and the speeds and
accelerations of the motion, at many knots; all waypoints are knots. Where such a path asks for more than the limits, the pace is
lowered there, some times over; in the end the whole path is stretched by what is left, and checked.

It is no optimum, but near: in a comparison along the same curves it took 3 to 7 % longer than the optimum that knows no limit of
the jerk (toppra 0.6.10, six joints, 3 to 30 points). A path of two points is a straight line; `point_to_point` is faster, as it
lets each joint take its own way.

**How fast to go along the curve.** The curve has a parameter s of its own, and each joint its derivatives q', q'', q''' by s. At
the rate r = ds/dt a joint has

    speed         q' r
    acceleration  q'' r² + q' dr/dt
    jerk          q''' r³ + 3 q'' r dr/dt + q' d²r/dt²

`_fastest_profile` finds the rate with which no joint exceeds speed and acceleration: a limit from the curve at each place, then
accelerations forward from the start and braking backward from the end. Its dr/dt jumps. `_SmoothedMotion` averages it over a
window of time, so that dr/dt has finite slopes: the curve itself stays as it is.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Final, NamedTuple

from canopen_master.errors import PlanRefusedError
from canopen_master.trajectories.point_to_point import MARGIN
from canopen_master.trajectories.scaled_joints import ScaledJoint, beyond_limit, check_values, position_excess, scaled_joints
from canopen_proto.drives.trajectory import JointLimits, Path, PathPoint
from canopen_proto.drives.trajectory.interpolation import cubic, quintic
from canopen_proto.drives.trajectory.limit_check import demands_of
from canopen_proto.drives.trajectory.polynomial import derivative_of, turning_point, value_at, with_constant_jerk

NEAREST: Final = 1e-6
"""How far apart two points have to be: the way of this time, in seconds, at full speed."""
PLACES: Final = 240
"""On the whole curve, at least: where its limits are looked at."""
KNOTS: Final = 4
"""Segments of the path in one window of the average."""
MAX_KNOTS: Final = 1200
WINDOWS: Final = (2.0, 1.0, 0.5, 0.25, 0.125)
"""Windows that are tried, in parts of the time that the slowest joint needs for its full acceleration."""
ROUNDS: Final = 8
"""How often the pace is lowered where a limit is exceeded, with the window that was best at first."""
_HALVINGS: Final = 60


def through_points(
    points: Sequence[Sequence[float]],
    limits: Sequence[JointLimits],
    *,
    margin: float = MARGIN,
    speed_factor: float = 1.0,
) -> Path:
    """Return a path from rest at the first point through all others to rest at the last one, within all limits.

    points: two or more; each one position for each joint, and no two equal ones in a row. limits, margin, speed_factor: as
    of `point_to_point`. The path goes exactly through the points, along a cubic spline; between them it may swing beyond them,
    and so beyond a position limit, which is refused: points that are closer together keep it nearer.

    Raises PlanRefusedError with the joint, and value and limit where there are such; the first point may be beyond a position
    limit.
    """
    if len(points) < 2:
        raise PlanRefusedError("a path needs at least two points", seen=f"{len(points)}")
    start = PathPoint(list(points[0]), [0.0] * len(points[0]), [0.0] * len(points[0]))
    joints = scaled_joints(start, limits, margin=margin, speed_factor=speed_factor)
    for number, point in enumerate(points):
        check_values(point, len(joints), f"position in point {number}")
    places = _places(points, joints)
    curve = cubic(places, points, natural=True)
    for number, joint in enumerate(joints):
        if (excess := position_excess(curve, number, joint)) is not None:
            failed = f"joint {number} would leave its limits on the curve through the points"
            raise beyond_limit(number, *excess, failed, "points within the limits, and closer together near them")
    fine = _refined(places)
    bends = [_bends(curve, places, place, joints) for place in fine]
    searches = [_Search(curve, points, places, joints, fine, bends, window) for window in _windows(joints, places[-1])]
    for each in searches:
        each.go_on(1)
    best = min(searches, key=lambda each: each.duration)
    best.go_on(ROUNDS)
    return best.path.stretched(_exact_stretch(best.path, joints))


def _places(points: Sequence[Sequence[float]], joints: Sequence[ScaledJoint]) -> list[float]:
    """Return the curve's parameter at each point: the sum of the times that the slowest joint needs at full speed."""
    steps = [
        max(abs(q - p) / joint.unit for p, q, joint in zip(before, after, joints, strict=True))
        for before, after in itertools.pairwise(points)
    ]
    for number, step in enumerate(steps):
        if step < NEAREST:
            raise PlanRefusedError(
                f"points {number} and {number + 1} are the same, or nearly (counted from 0)",
                cause="a path through points does not stop at them",
                tries=("leave one of them out", "for a stop there: two paths, one after the other"),
            )
    return list(itertools.accumulate(steps, initial=0.0))


def _windows(joints: Sequence[ScaledJoint], way: float) -> list[float]:
    """Return the windows to try, in seconds; none so short that MAX_KNOTS would be too few. way: the least time of the path."""
    slowest = max(joint.acceleration / joint.jerk for joint in joints)
    return sorted({max(part * slowest, way * KNOTS / MAX_KNOTS) for part in WINDOWS})


class _Search:
    """The search for the best path with one window: round by round, the pace is lowered where limits are exceeded."""

    def __init__(
        self, curve: Path, points: Sequence[Sequence[float]], marks: Sequence[float], joints: Sequence[ScaledJoint],
        places: Sequence[float], bends: Sequence[Sequence[_Bend]], window: float,
    ) -> None:  # fmt: skip
        self._curve, self._points, self._marks, self._joints = curve, points, marks, joints
        self._places, self._bends, self._window = places, bends, window
        self._pace = [1.0] * len(places)
        self.duration = math.inf
        """Of the best path, once it is stretched so that it keeps all limits."""
        self.path: Path

    def go_on(self, rounds: int) -> None:
        """Try so many times, and keep the best path of all."""
        for _ in range(rounds):
            motion = _SmoothedMotion(self._places, _fastest_profile(self._places, self._bends, self._pace), self._window)
            knots = _knots(motion, self._marks, self._window)
            path = _path(self._curve, motion, knots, self._points)
            stretches = _stretches(path, self._joints)
            duration = path.duration * max(stretches)
            if duration < self.duration:
                self.duration, self.path = duration, path
            _slow_down(self._pace, self._places, motion, [*itertools.chain(*knots)], stretches)


def _refined(marks: Sequence[float]) -> list[float]:
    """Return the places between the points where limits are looked at; closer and closer together at both ends."""
    parts = max(4, math.ceil(PLACES / (len(marks) - 1)))
    places = [
        begin + (end - begin) * part / parts for begin, end in itertools.pairwise(marks) for part in range(parts)
    ]  # fmt: skip
    first, last = places[1], marks[-1] - places[-1]
    closer = [0.5**power for power in range(12, 0, -1)]
    return [
        0.0, *[first * part for part in closer], *places[1:],
        *[marks[-1] - last * part for part in reversed(closer)], marks[-1],
    ]  # fmt: skip


def _bends(curve: Path, marks: Sequence[float], place: float, joints: Sequence[ScaledJoint]) -> list[_Bend]:
    """Return what the curve asks of each joint at a place; at a point the larger one of both sides."""
    after = min(bisect_right(marks, place), len(marks) - 1) - 1
    sides = (after - 1, after) if after and place == marks[after] else (after,)
    found = []
    for row, joint in zip(curve.segments, joints, strict=True):
        amounts = [0.0, 0.0, 0.0]
        for side in sides:
            coefficients: Sequence[float] = row[side].coefficients
            for order in range(3):
                coefficients = derivative_of(coefficients)
                amounts[order] = max(amounts[order], abs(value_at(coefficients, place - marks[side])) / joint.unit)
        slope, curvature, twist = amounts
        found.append(_Bend(slope, curvature, twist, 1.0, joint.acceleration, joint.jerk))
    return found


def _knots(motion: _SmoothedMotion, marks: Sequence[float], window: float) -> list[list[float]]:
    """Return the times of the knots from each point to the next, without that of the latter."""
    times = [0.0, *[motion.time_at(mark) for mark in marks[1:-1]], motion.duration]
    gap = max(window / KNOTS, motion.duration / MAX_KNOTS)
    knots = []
    for begin, end in itertools.pairwise(times):
        count = math.ceil((end - begin) / gap)
        knots.append([begin + (end - begin) * part / count for part in range(count)])
    return knots


def _path(curve: Path, motion: _SmoothedMotion, knots: Sequence[Sequence[float]], points: Sequence[Sequence[float]]) -> Path:
    times, positions, velocities, accelerations = [], [], [], []
    for row, point in zip([*knots, [motion.duration]], points, strict=True):
        for number, time in enumerate(row):
            place, rate, change = motion.at(time)
            there, slopes, curvatures = curve.at(place)
            times.append(time)
            positions.append(there if number else point)
            velocities.append([slope * rate for slope in slopes])
            accelerations.append(
                [curvature * rate * rate + slope * change for slope, curvature in zip(slopes, curvatures, strict=True)]
            )
    return quintic(times, positions, velocities, accelerations)


def _stretches(path: Path, joints: Sequence[ScaledJoint]) -> list[float]:
    """Return for each segment by which factor it would have to be slower, for all joints; nearly, by a few samples."""
    factors = [0.0] * len(path.segments[0])
    for row, joint in zip(path.segments, joints, strict=True):
        for number, (time, (_, c1, c2, c3, c4, c5)) in enumerate(row):
            jerks = (6.0 * c3, 6.0 * c3 + time * (12.0 * c4 + time * 15.0 * c5), 6.0 * c3 + time * (24.0 * c4 + time * 60.0 * c5))
            factors[number] = max(factors[number], _factor(abs(c1), 2.0 * abs(c2), max(map(abs, jerks)), joint))
    return factors


def _exact_stretch(path: Path, joints: Sequence[ScaledJoint]) -> float:
    """Return by which factor the path has to be stretched, from the extremes of its polynomials."""
    factor = 0.0
    for number, joint in enumerate(joints):
        for _, speed, acceleration, jerk in demands_of(path, number, path.duration):
            factor = max(factor, _factor(speed.magnitude, acceleration.magnitude, jerk.magnitude, joint))
    return factor


def _factor(speed: float, acceleration: float, jerk: float, joint: ScaledJoint) -> float:
    """Return by which factor a joint with these amounts would have to be slower."""
    unit = joint.unit
    return max(speed / unit, math.sqrt(acceleration / unit / joint.acceleration), math.cbrt(jerk / unit / joint.jerk))


def _slow_down(
    pace: list[float], places: Sequence[float], motion: _SmoothedMotion, times: Sequence[float], stretches: Sequence[float]
) -> None:
    """Lower the pace at all places that have a share in a segment that is too fast."""
    before = tuple(pace)
    for begin, end, stretch in zip(times, [*times[1:], motion.duration], stretches, strict=True):
        if stretch > 1.0:
            first, last = motion.places_of(begin, end)
            for number in range(max(bisect_right(places, first) - 1, 0), min(bisect_right(places, last) + 1, len(places))):
                pace[number] = min(pace[number], before[number] / stretch)


# ---- how fast to go along the curve ----


class _Bend(NamedTuple):
    """The largest q', q'', q''' (amounts) of one joint at a place of the curve, and its limits in the same unit."""

    slope: float
    curvature: float
    twist: float
    speed: float
    acceleration: float
    jerk: float


def _fastest_profile(places: Sequence[float], bends: Sequence[Sequence[_Bend]], pace: Sequence[float]) -> list[float]:
    """Return the rate at each place. It is 0 at both ends. pace: at most 1 for each place; 0.5 makes it take twice as long there.

    places: the parameters s, rising. bends: for each place those of all joints.
    """
    caps = [min(_cap(each) for each in row) * part for row, part in zip(bends, pace, strict=True)]
    squares = [cap * cap for cap in caps]
    squares[0] = squares[-1] = 0.0
    last = len(places) - 1
    for order in (range(last), range(last, 0, -1)):
        step = order.step
        for number in order:
            distance = abs(places[number + step] - places[number])
            change = min(
                _change(row, squares[number]) * pace[at] ** 2
                for at, row in ((number, bends[number]), (number + step, bends[number + step]))
            )
            squares[number + step] = min(squares[number + step], squares[number] + 2.0 * distance * change)
    return [math.sqrt(square) for square in squares]


def _cap(bend: _Bend) -> float:
    cap = bend.speed / bend.slope if bend.slope else math.inf
    if bend.curvature:
        cap = min(cap, math.sqrt(bend.acceleration / bend.curvature))
    if bend.twist:
        cap = min(cap, (bend.jerk / bend.twist) ** (1.0 / 3.0))
    return cap


def _change(bends: Sequence[_Bend], square: float) -> float:
    """Return by how much the rate may change there: the accelerations that the curve itself leaves free."""
    free = math.inf
    for bend in bends:
        if bend.slope:
            free = min(free, (bend.acceleration - bend.curvature * square) / bend.slope)
    return max(free, 0.0)


class _SmoothedMotion:
    """The motion along a curve at a rate that is averaged over `window` seconds.

    places, rates: as of `_fastest_profile`, with a rate of 0 at the ends only.
    """

    def __init__(self, places: Sequence[float], rates: Sequence[float], window: float) -> None:
        self._window = window
        self._end = places[-1]
        self._times, self._pieces = [0.0], []
        time = area = 0.0
        for s, r, s_after, r_after in zip(places, rates, places[1:], rates[1:], strict=False):
            lasts = 2.0 * (s_after - s) / (r + r_after)
            change = (r_after - r) / lasts
            self._pieces.append((area, s, r, change))
            area, _, _ = with_constant_jerk(lasts, area, s, r, change)
            time += lasts
            self._times.append(time)
        self._pieces.append((area, self._end, 0.0, 0.0))
        self.duration = time + window
        """In seconds, from rest to rest."""

    def at(self, time: float) -> tuple[float, float, float]:
        """Return the place s on the curve, the rate r = ds/dt, and dr/dt. time: seconds from the begin, 0 to `duration`."""
        area, s, r = self._sharp(time)
        area_before, s_before, r_before = self._sharp(time - self._window)
        window = self._window
        return (area - area_before) / window, (s - s_before) / window, (r - r_before) / window

    def time_at(self, place: float) -> float:
        """Return the time at which s is `place`."""
        return turning_point(lambda time: not self.at(time)[0] < place, self.duration, _HALVINGS)[1]

    def places_of(self, begin: float, end: float) -> tuple[float, float]:
        """Return the first and the last s that have a share in the motion between two times."""
        return self._sharp(begin - self._window)[1], self._sharp(end)[1]

    def _sharp(self, time: float) -> tuple[float, float, float]:
        """Return the integral of s, s and r, without the average."""
        if time <= 0.0:
            return 0.0, 0.0, 0.0
        number = min(bisect_right(self._times, time), len(self._pieces)) - 1
        area, s, r, change = self._pieces[number]
        return with_constant_jerk(time - self._times[number], area, s, r, change)
