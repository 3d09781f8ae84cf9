"""Paths from waypoints with times, and from functions.

    linear          straight lines; the velocities jump at the waypoints
    cubic           with velocities: through them; without: the smoothest curve (a spline, whose accelerations do not jump either)
    quintic         through velocities and accelerations
    from_function   a spline through the values of a function

The times may begin anywhere; the path begins at 0. Positions, velocities, accelerations: one row for each waypoint, in each row
one value for each joint, in its user's unit, per second, per second².

All raise PathError for rows that do not fit each other, for fewer than two waypoints, and for times that do not rise.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

from canopen_proto.drives.trajectory.path import LARGEST, TIME_TOLERANCE, Path, PathError, Segment, is_number, shown
from canopen_proto.drives.trajectory.polynomial import quintic_top

Rows: TypeAlias = Sequence[Sequence[float]]

LONGEST_STEP: Final = 1e15
"""Seconds from waypoint to waypoint, at most: their fifth power is still a number."""
MIN_STEPS: Final = 3
"""The velocities at the ends of a function are taken from four of its values."""
MAX_STEPS: Final = 1_000_000
"""More steps than this are a mistake in a unit, and would fill the memory."""


def linear(times: Sequence[float], positions: Rows) -> Path:
    """Return the path of straight lines. Between any two waypoints the velocities are constant. times: s, from 0 on, rising.
    positions: a row for each time, a value for each joint."""
    steps = _steps(times)
    columns = _columns(positions, len(times), 0, "positions")
    return Path([
        [Segment(step, (p, (q - p) / step)) for step, p, q in zip(steps, row, row[1:], strict=False)] for row in columns
    ])  # fmt: skip


def cubic(times: Sequence[float], positions: Rows, velocities: Rows | None = None, *, natural: bool = False) -> Path:
    """Return the path of cubic polynomials. times, positions: as of `linear`. velocities: rows like the positions, per second.

    With velocities it has these at the waypoints; its accelerations jump there. Without, it is the spline with continuous
    accelerations: at rest at both ends, or with free velocities there, and no acceleration, if it is `natural`.
    """
    steps = _steps(times)
    columns = _columns(positions, len(times), 0, "positions")
    if velocities is None:
        slopes = [spline_velocities(steps, row, None if natural else (0.0, 0.0)) for row in columns]
    else:
        slopes = _columns(velocities, len(times), len(columns), "velocities")
    return Path([_cubics(steps, row, own) for row, own in zip(columns, slopes, strict=True)])


def quintic(times: Sequence[float], positions: Rows, velocities: Rows, accelerations: Rows) -> Path:
    """Return the path of polynomials of degree 5 that has these velocities and accelerations at its waypoints. times, positions:
    as of `linear`. velocities, accelerations: rows like the positions, per second and per second²."""
    steps = _steps(times)
    columns = _columns(positions, len(times), 0, "positions")
    slopes = _columns(velocities, len(times), len(columns), "velocities")
    curvatures = _columns(accelerations, len(times), len(columns), "accelerations")
    return Path([_quintics(steps, *own) for own in zip(columns, slopes, curvatures, strict=True)])


def from_function(function: Callable[[float], Sequence[float]], duration: float, step: float) -> Path:
    """Return a spline through the values of a function of the time, from 0 to `duration`, both in s.

    function: returns the position of each joint. step: how far apart the values are taken, at most; between them the error falls
    with its fourth power. The velocities at the ends are those of the function.
    """
    if not (0.0 < duration < math.inf and 0.0 < step < math.inf and duration / step <= MAX_STEPS):
        raise PathError(
            f"A path of {duration!r} s cannot have steps of {step!r} s. Try: both above 0, at most {MAX_STEPS:,} steps."
        )
    count = max(MIN_STEPS, math.ceil(duration / step - 1e-9))
    times = [duration * number / count for number in range(count + 1)]
    columns = _columns([function(time) for time in times], len(times), 0, "positions")
    steps = _steps(times)
    return Path([_cubics(steps, row, spline_velocities(steps, row, _end_velocities(row, duration / count))) for row in columns])


def _steps(times: Sequence[float]) -> list[float]:
    """Return the times from waypoint to waypoint."""
    if len(times) < 2:
        raise PathError(f"A path needs at least two waypoints; there are {len(times)}.")
    steps = [end - begin for begin, end in itertools.pairwise(times)]
    for number, step in enumerate(steps):
        if not TIME_TOLERANCE <= step <= LONGEST_STEP:
            raise PathError(
                f"The times of waypoints must rise by {TIME_TOLERANCE:g} s to {LONGEST_STEP:g} s: waypoint {number + 1} (counted "
                f"from 0) is at {shown([times[number + 1]])} s, the one before at {shown([times[number]])} s."
            )
    return steps


def _columns(rows: Rows, count: int, joints: int, name: str) -> list[list[float]]:
    """Return the values of each joint. joints: how many there have to be; 0: as many as the first row has."""
    if len(rows) != count:
        raise PathError(f"There are {count} times, but {len(rows)} rows of {name}. Try: one row for each time.")
    wanted = joints or len(rows[0])
    for number, row in enumerate(rows):
        if len(row) != wanted:
            raise PathError(
                f"Row {number} (counted from 0) of the {name} has {len(row)} values. Try: {wanted}, one for each joint."
            )
        if not all(map(is_number, row)):
            raise PathError(
                f"Row {number} (counted from 0) of the {name} has a value that is no finite number up to {LARGEST:g}: "
                f"{shown(row)}."
            )
    return [[float(row[joint]) for row in rows] for joint in range(wanted)]


def _cubics(steps: Sequence[float], positions: Sequence[float], velocities: Sequence[float]) -> list[Segment]:
    row = []
    for number, h in enumerate(steps):
        p, v, w = positions[number], velocities[number], velocities[number + 1]
        mean = (positions[number + 1] - p) / h
        row.append(Segment(h, (p, v, (3.0 * mean - 2.0 * v - w) / h, (v + w - 2.0 * mean) / (h * h))))
    return row


def _quintics(
    steps: Sequence[float], positions: Sequence[float], velocities: Sequence[float], accelerations: Sequence[float]
) -> list[Segment]:
    row = []
    for number, h in enumerate(steps):
        p, v, a = positions[number], velocities[number], accelerations[number]
        # what the end has beyond a motion of constant acceleration, each in the unit of a position
        ahead = positions[number + 1] - p - h * (v + h * a / 2.0)
        faster = h * (velocities[number + 1] - v - h * a)
        rising = h * h * (accelerations[number + 1] - a) / 2.0
        row.append(Segment(h, (p, v, a / 2.0, *quintic_top(ahead, faster, rising, h))))
    return row


def spline_velocities(steps: Sequence[float], positions: Sequence[float], ends: tuple[float, float] | None) -> list[float]:
    """Return the velocities with which the accelerations do not jump. ends: those at the ends; None: no acceleration there.
    steps: s between the positions.

    A system of equations with three diagonals, solved from the front to the back and then backwards. Each of its rows has the
    diagonal as its largest term, so that this is stable.
    """
    means = [(q - p) / h for h, p, q in zip(steps, positions, positions[1:], strict=False)]
    last = len(steps)
    factors: list[float] = []
    rests: list[float] = []
    for number in range(last + 1):
        if number in (0, last) and ends is not None:
            below, diagonal, above, right = 0.0, 1.0, 0.0, ends[0 if number == 0 else 1]
        else:
            below = 1.0 / steps[number - 1] if number > 0 else 0.0
            above = 1.0 / steps[number] if number < last else 0.0
            diagonal = 2.0 * (below + above)
            right = 3.0 * ((below * means[number - 1] if number > 0 else 0.0) + (above * means[number] if number < last else 0.0))
        pivot = diagonal - (below * factors[-1] if factors else 0.0)
        rests.append((right - (below * rests[-1] if rests else 0.0)) / pivot)
        factors.append(above / pivot)
    velocities = [rests[-1]]
    for number in range(last - 1, -1, -1):
        velocities.append(rests[number] - factors[number] * velocities[-1])
    velocities.reverse()
    return velocities


def _end_velocities(row: Sequence[float], step: float) -> tuple[float, float]:
    """Return the velocities at both ends: those of the cubic polynomial through four values."""
    a, b, c, d = row[:4]
    z, y, x, w = row[-1], row[-2], row[-3], row[-4]
    return (
        (-11.0 * a + 18.0 * b - 9.0 * c + 2.0 * d) / (6.0 * step),
        (11.0 * z - 18.0 * y + 9.0 * x - 2.0 * w) / (6.0 * step),
    )
