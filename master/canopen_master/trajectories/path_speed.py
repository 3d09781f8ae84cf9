"""How fast to go along a curve: a rate that keeps speed and acceleration limits, smoothed so that it keeps those of jerk.

The curve has a parameter s of its own, and each joint its derivatives q', q'', q''' by s. At the rate r = ds/dt a joint has

    speed         q' r
    acceleration  q'' r² + q' dr/dt
    jerk          q''' r³ + 3 q'' r dr/dt + q' d²r/dt²

`fastest_profile` finds the rate with which no joint exceeds speed and acceleration: a limit from the curve at each place, then
accelerations forward from the start and braking backward from the end. Its dr/dt jumps. `SmoothedMotion` averages it over a
window of time, so that dr/dt has finite slopes: the curve itself stays as it is.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Final, NamedTuple

from canopen_proto.drives.trajectory.polynomial import turning_point, with_constant_jerk

_HALVINGS: Final = 60


class Bend(NamedTuple):
    """The largest q', q'', q''' (amounts) of one joint at a place of the curve, and its limits in the same unit."""

    slope: float
    curvature: float
    twist: float
    speed: float
    acceleration: float
    jerk: float


def fastest_profile(places: Sequence[float], bends: Sequence[Sequence[Bend]], pace: Sequence[float]) -> list[float]:
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


def _cap(bend: Bend) -> float:
    cap = bend.speed / bend.slope if bend.slope else math.inf
    if bend.curvature:
        cap = min(cap, math.sqrt(bend.acceleration / bend.curvature))
    if bend.twist:
        cap = min(cap, (bend.jerk / bend.twist) ** (1.0 / 3.0))
    return cap


def _change(bends: Sequence[Bend], square: float) -> float:
    """Return by how much the rate may change there: the accelerations that the curve itself leaves free."""
    free = math.inf
    for bend in bends:
        if bend.slope:
            free = min(free, (bend.acceleration - bend.curvature * square) / bend.slope)
    return max(free, 0.0)


class SmoothedMotion:
    """The motion along a curve at a rate that is averaged over `window` seconds.

    places, rates: as of `fastest_profile`, with a rate of 0 at the ends only.
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
        return turning_point(lambda time: not self.at(time)[0] < place, 0.0, self.duration, _HALVINGS)[1]

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
