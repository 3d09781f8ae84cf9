"""Paths for tests, and what a drive that gets their positions cycle by cycle would see of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from canopen_proto.drives.trajectory import JointLimits, Path, Segment
from canopen_proto.drives.trajectory.limit_check import demands_of

CYCLE = 0.004
State = tuple[float, float, float]
"""Position, velocity, acceleration."""


def quintic(start: State, end: State, duration: float) -> Segment:
    """The segment between two states, by its textbook formula."""
    (p, v, a), (q, w, b), t = start, end, duration
    return Segment(
        t,
        (
            p,
            v,
            a / 2,
            (20 * (q - p) - (8 * w + 12 * v) * t - (3 * a - b) * t**2) / (2 * t**3),
            (30 * (p - q) + (14 * w + 16 * v) * t + (3 * a - 2 * b) * t**2) / (2 * t**4),
            (12 * (q - p) - 6 * (w + v) * t - (a - b) * t**2) / (2 * t**5),
        ),
    )


def through(states: Sequence[State], durations: Sequence[float]) -> list[Segment]:
    """One joint's row of segments through these states."""
    return [quintic(a, b, t) for a, b, t in zip(states, states[1:], durations, strict=False)]


def limits_with_margin(path: Path, margin: float, cycle_time: float = CYCLE) -> list[JointLimits]:
    """The limits of which the path leaves this part of acceleration and jerk free, 0 to 1. Joints that rest have limits too."""
    found = []
    for joint in range(path.joints):
        demands = [demand[1:] for demand in demands_of(path, joint, cycle_time)]
        speed, acceleration, jerk = (max(extremes[order].magnitude for extremes in demands) or 1.0 for order in range(3))
        found.append(JointLimits(speed=speed, acceleration=acceleration / (1 - margin), jerk=jerk / (1 - margin)))
    return found


def differences(positions: Sequence[float], cycle_time: float = CYCLE) -> Iterator[tuple[float, float, float]]:
    """The speed, acceleration and jerk that a row of positions asks for, one a cycle: plain difference quotients."""
    for p, q, r, s in zip(positions, positions[1:], positions[2:], positions[3:], strict=False):
        speed, acceleration = (s - r) / cycle_time, (s - 2 * r + q) / cycle_time**2
        yield abs(speed), abs(acceleration), abs(s - 3 * r + 3 * q - p) / cycle_time**3
