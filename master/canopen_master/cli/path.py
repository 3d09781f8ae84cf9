"""The path of the demonstration: each joint swings around the position where it stands, and ends there, all at rest.

A sine per joint, of a frequency of its own so that the arm's figure is not dull, times a window that rises and falls smoothly:
position, velocity and acceleration begin and end at zero, and nothing jumps.
"""

from __future__ import annotations

import math
from typing import Final

SLOWEST: Final = 0.20
"""Swings per second of the first joint."""
STEP: Final = 0.05
"""How much faster each further joint swings."""
MAX_RAMP: Final = 1.0
"""Seconds in which the window rises and falls; a third of a short motion."""


class Path:
    """Positions over time, in the unit of `start` and `amplitude`. duration: seconds."""

    def __init__(self, start: list[float], amplitude: float, duration: float) -> None:
        self.start = start
        self.amplitude = amplitude
        self.duration = duration
        self._ramp = min(MAX_RAMP, duration / 3)

    def at(self, time: float) -> list[float]:
        """Where the joints are to be; before 0 and after `duration` at their start."""
        swing = self.amplitude * self._window(time)
        return [
            start + swing * math.sin(2 * math.pi * (SLOWEST + STEP * number) * time) for number, start in enumerate(self.start)
        ]

    def _window(self, time: float) -> float:
        return _smooth(time / self._ramp) * _smooth((self.duration - time) / self._ramp)


def _smooth(x: float) -> float:
    """From 0 to 1 for x from 0 to 1, with first and second derivative 0 at both ends."""
    x = min(max(x, 0.0), 1.0)
    return x * x * x * (x * (6 * x - 15) + 10)
