"""Polynomials of one variable, as rows of coefficients in ascending powers: value, derivatives, extremes on an interval.

Also the search for the place at which a function comes to a value, by halving.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

_HALVINGS: Final = 100
"""More than a float has bits: a root that Newton's steps do not find is found by halving."""


class Extremes(NamedTuple):
    """The least and the greatest value on an interval, each with a time at which it occurs."""

    low: float
    low_time: float
    high: float
    high_time: float

    @property
    def magnitude(self) -> float:
        """The largest magnitude."""
        return self.high if self.high >= -self.low else -self.low


def value_at(coefficients: Sequence[float], time: float) -> float:
    """Return the value at `time`. coefficients: of the powers of the time, from 0 on."""
    value = 0.0
    for coefficient in reversed(coefficients):
        value = value * time + coefficient
    return value


def derivative_of(coefficients: Sequence[float]) -> list[float]:
    """Return the coefficients of the derivative; of a constant, none."""
    return [number * coefficients[number] for number in range(1, len(coefficients))]


def derivatives_at(t: float, c1: float, c2: float, c3: float, c4: float, c5: float) -> tuple[float, float, float]:
    """Return the first, second and third derivative of a polynomial of degree 5 at `t`: velocity, acceleration and jerk. c1 to
    c5: the coefficients of the powers of `t`."""
    return (
        c1 + t * (2.0 * c2 + t * (3.0 * c3 + t * (4.0 * c4 + t * (5.0 * c5)))),
        2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * (20.0 * c5))),
        6.0 * c3 + t * (24.0 * c4 + t * (60.0 * c5)),
    )


def quintic_top(position: float, velocity: float, acceleration: float, duration: float) -> tuple[float, float, float]:
    """Return the coefficients of the powers 3 to 5 that add this much at the end of a segment, and nothing at its begin.

    Each in the unit of a position: velocity times duration, acceleration times duration² / 2.
    """
    return (
        (10.0 * position - 4.0 * velocity + acceleration) / duration**3,
        (-15.0 * position + 7.0 * velocity - 2.0 * acceleration) / duration**4,
        (6.0 * position - 3.0 * velocity + acceleration) / duration**5,
    )


def with_constant_jerk(
    time: float, position: float, velocity: float, acceleration: float, jerk: float
) -> tuple[float, float, float]:
    """Return position, velocity and acceleration after `time` s (it may be negative) of constant jerk."""
    return (
        position + time * (velocity + time * (acceleration / 2.0 + time * jerk / 6.0)),
        velocity + time * (acceleration + time * jerk / 2.0),
        acceleration + time * jerk,
    )


def turning_point(is_late: Callable[[float], bool], late: float, halvings: int) -> tuple[float, float]:
    """Return the last time found at which `is_late` is false, and the first at which it is true, between 0 and `late`.
    halvings: of that interval."""
    early = 0.0
    for _ in range(halvings):
        middle = 0.5 * (early + late)
        if is_late(middle):
            late = middle
        else:
            early = middle
    return early, late


def extremes_of(coefficients: Sequence[float], duration: float, begin: float = 0.0) -> Extremes:
    """Return the extremes for times from 0 to `duration`. No coefficients: 0. begin: is added to the times in the answer."""
    low = high = coefficients[0] if coefficients else 0.0
    low_time = high_time = begin
    times = roots_of(derivative_of(coefficients), duration) if len(coefficients) > 2 else []
    times.append(duration)
    for each in times:
        value, time = value_at(coefficients, each), begin + each
        if value < low:
            low, low_time = value, time
        elif value > high:
            high, high_time = value, time
    return Extremes(low, low_time, high, high_time)


def roots_of(coefficients: Sequence[float], duration: float) -> list[float]:
    """Return the times between 0 and `duration` at which the value changes its sign, in order. coefficients: of the powers of the
    time, from 0 on."""
    degree = len(coefficients) - 1
    while degree > 0 and coefficients[degree] == 0.0:
        degree -= 1
    if degree <= 0:
        return []
    if degree == 1:
        found = [-coefficients[0] / coefficients[1]]
    elif degree == 2:
        found = _roots_of_parabola(coefficients[0], coefficients[1], coefficients[2])
    else:
        slope = derivative_of(coefficients[: degree + 1])
        turns = [0.0, *roots_of(slope, duration), duration]  # between two of them it only rises, or only falls
        found = []
        for begin, end in itertools.pairwise(turns):
            before, after = value_at(coefficients, begin), value_at(coefficients, end)
            if before < 0.0 < after or after < 0.0 < before:
                found.append(_root_between(coefficients, slope, begin, end))
    return [each for each in found if 0.0 < each < duration]


def _roots_of_parabola(c0: float, c1: float, c2: float) -> list[float]:
    square = c1 * c1 - 4.0 * c0 * c2
    if not square > 0.0:
        return []
    sum_of_both = -0.5 * (c1 + math.copysign(math.sqrt(square), c1))  # no difference of two near numbers
    return sorted([sum_of_both / c2, c0 / sum_of_both])


def _root_between(coefficients: Sequence[float], slope: Sequence[float], begin: float, end: float) -> float:
    """Return the root between two times at which the values have different signs: Newton's steps, else halving."""
    rises = value_at(coefficients, end) > 0.0
    time = 0.5 * (begin + end)
    for _ in range(_HALVINGS):
        value = value_at(coefficients, time)
        if value == 0.0:
            break
        if (value > 0.0) is rises:
            end = time
        else:
            begin = time
        steepness = value_at(slope, time)
        step = time - value / steepness if steepness else begin
        following = step if begin < step < end else 0.5 * (begin + end)
        if following == time or not begin < following < end:
            break
        time = following
    return time
