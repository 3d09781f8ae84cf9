"""What a demonstration records in each cycle, and what it says about each joint at the end."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class JointTrack:
    """One joint's course. commanded, actual: degrees, one value per cycle, both for the same instant."""

    name: str
    node_id: int
    commanded: list[float] = field(default_factory=list)
    actual: list[float] = field(default_factory=list)

    @property
    def largest_error(self) -> float:
        """The largest following error, in degrees."""
        return max((abs(a - b) for a, b in zip(self.commanded, self.actual, strict=False)), default=0.0)


@dataclass
class Recording:
    """times: seconds since the first cycle, one for each value of the joints."""

    joints: list[JointTrack]
    times: list[float] = field(default_factory=list)
