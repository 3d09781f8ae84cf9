"""The path of the demonstration: each joint swings around the position where it stands, and comes to rest there.

A joint follows a sine with a frequency of its own, times a window that rises and falls smoothly. So position, velocity and
acceleration begin and end at zero, and nothing jumps. Speed and acceleration are limited: a joint that would exceed a limit
swings less far, so that it can be halted at any moment well within the time that a halt may take.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

SLOWEST: Final = 0.20
"""Swings per second of the first joint."""
STEP: Final = 0.03
"""Swings per second that each further joint adds."""
MAX_RAMP: Final = 1.5
"""Seconds in which the window rises, and falls; a third of the time in a short motion."""
MAX_SPEED: Final = math.radians(60)
"""Per second. A drive that brakes with 100°/s² stands within 0.6 s."""
MAX_ACCELERATION: Final = math.radians(300)

SHARE: Final = 0.8
"""Of a drive's greatest acceleration: positions are rounded to counts, and a step must not exceed it for that."""

_SLOPE: Final = 1.875  # the steepest slope of _smooth
_CURVATURE: Final = 5.774  # the strongest curvature of _smooth


class SwingPath:
    """Positions over time, in radians. start: the joints' present positions; swing: how far they go; duration: seconds.

    speeds: the speed limit of each joint, if that is less than MAX_SPEED. accelerations: likewise; None: it has none.
    """

    def __init__(
        self,
        start: list[float],
        swing: float,
        duration: float,
        speeds: Sequence[float] = (),
        accelerations: Sequence[float | None] = (),
    ) -> None:
        self.start = start
        self.duration = duration
        self._ramp = min(MAX_RAMP, duration / 3)
        self._speeds = [2 * math.pi * (SLOWEST + STEP * number) for number in range(len(start))]
        fastest = [min(MAX_SPEED, limit) for limit in speeds] or [MAX_SPEED] * len(start)
        hardest = [MAX_ACCELERATION if limit is None else min(MAX_ACCELERATION, SHARE * limit) for limit in accelerations]
        limits = zip(self._speeds, fastest, hardest or [MAX_ACCELERATION] * len(start), strict=True)
        self._swings = [min(swing, self._limit(*each)) for each in limits]

    def _limit(self, speed: float, fastest: float, hardest: float) -> float:
        """Return how far a joint may swing, by the triangle inequality over sine, window and their derivatives."""
        slope, curvature = _SLOPE / self._ramp, _CURVATURE / self._ramp**2
        return min(fastest / (speed + slope), hardest / (speed**2 + 2 * speed * slope + curvature))

    def at(self, time: float) -> list[float]:
        """Return the set-points of the joints; before 0 and after `duration` the start."""
        window = _smooth(time / self._ramp) * _smooth((self.duration - time) / self._ramp)
        return [
            start + window * swing * math.sin(speed * time)
            for start, swing, speed in zip(self.start, self._swings, self._speeds, strict=True)
        ]


def _smooth(x: float) -> float:
    """Rise from 0 to 1 for x from 0 to 1, with first and second derivative 0 at both ends."""
    x = min(max(x, 0.0), 1.0)
    return x * x * x * (x * (6 * x - 15) + 10)
