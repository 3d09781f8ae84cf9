"""Whether a stop along a path keeps the limits of the joints, piece by piece.

While the clock brakes, its rate r falls, and with it the acceleration of the path by r², the jerk by r³; see margin.py. So a
stop may be much stronger than the largest values on its way allow, each with the worst sign. Here a stop is cut in time. In each
piece the rate and its changes lie in small intervals, and so do the derivatives of each joint's position: by their values at both
ends, and by how far a function can leave the line between them (the largest second derivative times width² / 8). The jerk follows
as an interval too, and the acceleration can leave its values at both ends no further than this jerk lets it.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from typing import Final, TypeAlias

from canopen_proto.drives.trajectory.limit_check import JointLimits, jumps
from canopen_proto.drives.trajectory.path import Piece
from canopen_proto.drives.trajectory.polynomial import derivatives_at, with_constant_jerk
from canopen_proto.drives.trajectory.speed_change import SpeedChange

_PARTS: Final = 3
"""So many pieces for each of the three phases of a stop."""
_ROUNDING: Final = 1 + 1e-9


Stretch: TypeAlias = tuple[float, float, float, float, float, float, float, float, float, float, bool]
"""A segment of one joint, as a stop needs it: its begin and end, the coefficients of its velocity (not yet multiplied by their
powers), the largest magnitudes of its third, fourth and fifth derivative; and whether velocity or acceleration jump at its begin.
Plain tuples of numbers are no work for the garbage collector; long paths have many thousands."""

StopPiece: TypeAlias = tuple[float, float, float, float, float, float, float, float, float, float, float, float]
"""A piece of a stop. At its begin and its end: the path's time, the rate r, the change of the rate; how long it takes, how its
change changes; the bounds of r³, the highest one first; the least and the greatest value of 3 r dr/dt."""


def stretches_of(pieces: Sequence[Piece], first: int, count: int) -> list[Stretch]:
    """Return so many segments of a joint, from this one on, as a stop needs them. first: the number of that segment, from 0."""
    found: list[Stretch] = []
    velocity = acceleration = 0.0
    for number in range(max(0, first - 1), min(first + count, len(pieces))):
        begin, duration, _, c1, c2, c3, c4, c5 = pieces[number]
        is_jump = number > 0 and jumps(velocity, acceleration, c1, 2.0 * c2)
        if c4 == 0.0 == c5:  # of constant jerk, as nearly all are: the same numbers, from fewer products
            velocity, acceleration = c1 + duration * (2.0 * c2 + duration * (3.0 * c3)), 2.0 * c2 + duration * (6.0 * c3)
            if number >= first:
                found.append((begin, begin + duration, c1, c2, c3, c4, c5, abs(6.0 * c3), 0.0, 0.0, is_jump))
            continue
        velocity, acceleration, jerk = derivatives_at(duration, c1, c2, c3, c4, c5)
        if number >= first:
            fifth, fourth = 120.0 * abs(c5), max(abs(24.0 * c4), abs(24.0 * c4 + 120.0 * c5 * duration))
            third = max(abs(6.0 * c3), abs(jerk)) + duration * duration * fifth / 8.0
            found.append((begin, begin + duration, c1, c2, c3, c4, c5, third, fourth, fifth, is_jump))
    return found


def motion_at(stretches: Sequence[Stretch], time: float) -> tuple[float, float]:
    """Return the velocity and the acceleration of a joint at this time of the path."""
    begin, end, c1, c2, c3, c4, c5, _, _, _, _ = stretches[max(0, bisect_right(stretches, time, key=_begin_of) - 1)]
    velocity, acceleration, _ = derivatives_at(min(time, end) - begin, c1, c2, c3, c4, c5)
    return velocity, acceleration


def pieces_of(stop: SpeedChange, time: float) -> list[StopPiece]:
    """Cut a stop that begins at this time of the path."""
    pieces: list[StopPiece] = []
    for number in range(3):
        begin, distance, rate, change, onset = stop.phases[number]
        lasts = (stop.phases[number + 1][0] - begin) / _PARTS
        if lasts <= 0.0:
            continue
        place = time + distance
        for _ in range(_PARTS):
            further, slower, last = with_constant_jerk(lasts, place, rate, change, onset)
            if not slower > 0.0:
                slower = 0.0
            lowest, highest = (slower, rate) if slower < rate else (rate, slower)
            if last < 0.0 < change:
                highest = rate - change * change / (2.0 * onset)
            if change <= 0.0 and last <= 0.0:
                steepest, mildest = 3.0 * highest * min(change, last), 3.0 * lowest * max(change, last)
            else:
                steepest, mildest = 3.0 * highest * min(change, last, 0.0), 3.0 * highest * max(change, last, 0.0)
            cube, low_cube = highest * highest * highest, lowest * lowest * lowest
            pieces.append((place, rate, change, further, slower, last, lasts, onset, cube, low_cube, steepest, mildest))
            place, rate, change = further, slower, last
    return pieces


def keeps_limits(pieces: Sequence[StopPiece], stretches: Sequence[Stretch], limits: JointLimits, seen: float) -> bool:
    """Return whether a joint surely keeps its limits of acceleration and jerk during these pieces of a stop.

    seen: seconds for which a drive still sees a knot. Where velocity or acceleration jump the answer is False.
    """
    _, most, most_jerk = limits.most
    most, most_jerk = most * _ROUNDING, most_jerk * _ROUNDING
    since = pieces[0][0]
    number = max(0, bisect_right(stretches, since, key=_begin_of) - 1)
    before = number
    while stretches[before][0] >= since - seen:
        if stretches[before][10]:
            return False
        if before == 0:
            break
        before -= 1
    count = len(stretches)
    goal = stretches[-1][1]
    is_known = False  # what holds at the begin of a piece, from the end of the one before
    known_v = known_a = known_j = 0.0
    for place, rate, change, further, slower, last, lasts, onset, cube, low_cube, steepest, mildest in pieces:
        if place >= goal:
            return True
        lowest_jerk, highest_jerk = math.inf, -math.inf
        first_acceleration = last_acceleration = 0.0
        is_first = True
        while True:
            begin, end, c1, c2, c3, c4, c5, third, fourth, fifth, _ = stretches[number]
            t, u = place - begin, (end if end < further else further) - begin
            if not t > 0.0:  # written out, here and below: `min` and `max` would take a fourth of all
                t = 0.0
            bow = (u - t) * (u - t) / 8.0
            if c4 == 0.0 == c5:  # of constant jerk, as nearly all are
                v, w = c1 + t * (2.0 * c2 + t * 3.0 * c3), c1 + u * (2.0 * c2 + u * 3.0 * c3)
                j = k = 6.0 * c3
                a, b = 2.0 * c2 + t * j, 2.0 * c2 + u * j
            else:
                v, a, j = (known_v, known_a, known_j) if is_known else derivatives_at(t, c1, c2, c3, c4, c5)
                w, b, k = derivatives_at(u, c1, c2, c3, c4, c5)
                known_v, known_a, known_j = w, b, k
            is_known = further <= end and u > 0.0 and (c4 != 0.0 or c5 != 0.0)
            if is_first:
                first_acceleration = a * rate * rate + v * change
                is_first = False
            last_acceleration = b * slower * slower + w * last
            if v > w:
                v, w = w, v
            if a > b:
                a, b = b, a
            v, w = v - bow * third, w + bow * third
            if fourth:
                if j > k:
                    j, k = k, j
                a, b, j, k = a - bow * fourth, b + bow * fourth, j - bow * fifth, k + bow * fifth
            least = (j * (low_cube if j > 0.0 else cube)) + (v * onset if onset > 0.0 else w * onset)
            greatest = (k * (cube if k > 0.0 else low_cube)) + (w * onset if onset > 0.0 else v * onset)
            if mildest <= 0.0:
                least += b * (steepest if b > 0.0 else mildest)
                greatest += a * (mildest if a > 0.0 else steepest)
            else:
                least += min(b * steepest, a * mildest)
                greatest += max(a * steepest, b * mildest)
            if least < lowest_jerk:
                lowest_jerk = least
            if greatest > highest_jerk:
                highest_jerk = greatest
            if further <= end or number + 1 == count:
                break
            number += 1
            if stretches[number][10]:
                return False
        if lowest_jerk < -most_jerk or highest_jerk > most_jerk:
            return False
        low, high = first_acceleration, last_acceleration
        if high < low:
            low, high = high, low
        if lowest_jerk < 0.0 < highest_jerk:
            gain, width = last_acceleration - first_acceleration, highest_jerk - lowest_jerk
            high = first_acceleration + highest_jerk * (gain - lowest_jerk * lasts) / width
            low = first_acceleration + lowest_jerk * (highest_jerk * lasts - gain) / width
        if low < -most or high > most:
            return False
    return True


def _begin_of(stretch: Stretch) -> float:
    return stretch[0]
