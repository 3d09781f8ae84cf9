"""The extremes of a path, worked out from its polynomials by hand: the independent check of what planners promise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from canopen_proto.drives.trajectory import JointLimits, Path


class Extremes(NamedTuple):
    """Of one joint: its range, the largest amounts of its derivatives, and its largest jumps at knots."""

    lowest: float
    highest: float
    speed: float
    acceleration: float
    jerk: float
    speed_jump: float
    acceleration_jump: float


def derivative(coefficients: Sequence[float]) -> list[float]:
    return [power * each for power, each in enumerate(coefficients)][1:] or [0.0]


def value(coefficients: Sequence[float], time: float) -> float:
    return math.fsum(each * time**power for power, each in enumerate(coefficients))


def zeros(coefficients: Sequence[float], duration: float) -> list[float]:
    """Return the times within a segment at which a polynomial changes its sign, found between the zeros of its derivative."""
    if not any(coefficients[1:]):
        return []
    marks = [0.0, *sorted(zeros(derivative(coefficients), duration)), duration]
    found = []
    for low, high in pairwise(marks):
        if value(coefficients, low) * value(coefficients, high) > 0.0:
            continue
        rising = value(coefficients, high) > 0.0
        for _ in range(60):
            middle = (low + high) / 2.0
            if (value(coefficients, middle) > 0.0) is rising:
                high = middle
            else:
                low = middle
        found.append((low + high) / 2.0)
    return found


def extremes(path: Path, joint: int) -> Extremes:
    positions, amounts = [], [[0.0], [0.0], [0.0]]
    jumps = [[0.0], [0.0]]
    before: list[float] | None = None
    for duration, coefficients in path.segments[joint]:
        derivatives: list[Sequence[float]] = [coefficients]
        for _ in range(4):
            derivatives.append(derivative(derivatives[-1]))
        for order, of in enumerate(derivatives[:4]):
            times = [0.0, duration, *zeros(derivatives[order + 1], duration)]
            values = [value(of, time) for time in times]
            if order == 0:
                positions += values
            else:
                amounts[order - 1] += [abs(each) for each in values]
        if before is not None:
            for order in (1, 2):
                jumps[order - 1].append(abs(value(derivatives[order], 0.0) - before[order]))
        before = [value(each, duration) for each in derivatives]
    speed, acceleration, jerk = (max(each) for each in amounts)
    return Extremes(min(positions), max(positions), speed, acceleration, jerk, max(jumps[0]), max(jumps[1]))


def assert_keeps(path: Path, limits: Sequence[JointLimits], margin: float, exact: float = 1e-6) -> None:
    """Assert that no joint exceeds its speed, nor what the margin leaves of acceleration and jerk, nor jumps."""
    for joint, each in enumerate(limits):
        assert each.speed is not None
        assert each.acceleration is not None
        assert each.jerk is not None
        seen = extremes(path, joint)
        assert seen.speed <= each.speed * (1.0 + exact), joint
        assert seen.acceleration <= each.acceleration * (1.0 - margin) * (1.0 + exact), joint
        assert seen.jerk <= each.jerk * (1.0 - margin) * (1.0 + exact), joint
        assert seen.speed_jump <= each.speed * 1e-9, joint
        assert seen.acceleration_jump <= each.acceleration * 1e-9, joint
        tolerance = exact * each.speed
        assert each.lowest is None or seen.lowest >= each.lowest - tolerance, joint
        assert each.highest is None or seen.highest <= each.highest + tolerance, joint
