"""The values that a demonstration records in each cycle, and what they show for each joint."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass
class JointTrack:
    """One joint's course. commanded, actual: degrees, one value per cycle, both for the same instant. commanded: NaN while
    the joint follows no set-point."""

    name: str
    node_id: int
    commanded: list[float] = field(default_factory=list)
    actual: list[float] = field(default_factory=list)

    @property
    def largest_error(self) -> float:
        """The largest following error, in degrees."""
        errors = [abs(a - b) for a, b in zip(self.commanded, self.actual, strict=False)]
        return max((each for each in errors if not math.isnan(each)), default=0.0)


@dataclass
class Recording:
    """times: seconds since the first cycle, one for each value of the joints. planned_from: the time at which a planned move
    begins. broken: the time at which a fault stopped the chain, and the name of the faulty joint."""

    joints: list[JointTrack]
    times: list[float] = field(default_factory=list)
    planned_from: float | None = None
    broken: tuple[float, str] | None = None
