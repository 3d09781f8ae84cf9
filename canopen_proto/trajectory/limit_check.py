"""`JointLimits`: what one joint may do on a path.

Units: the user's unit of the joint, seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

from canopen_proto.trajectory.path import PathError


@dataclass(frozen=True, slots=True)
class JointLimits:
    """The limits of one joint, in its user's unit; None or math.inf: no limit.

    lowest, highest: positions. speed, acceleration, jerk: per second, per second², per second³, above 0, for both directions.
    Raises PathError for limits that allow nothing.
    """

    lowest: float | None = None
    highest: float | None = None
    speed: float | None = None
    acceleration: float | None = None
    jerk: float | None = None

    def __post_init__(self) -> None:
        if self.lowest is not None and self.highest is not None and not self.lowest < self.highest:
            raise PathError(f"The lowest position must be below the highest one; they are {self.lowest!r} and {self.highest!r}.")
        for name, limit in (("speed", self.speed), ("acceleration", self.acceleration), ("jerk", self.jerk)):
            if limit is not None and not limit > 0.0:
                raise PathError(f"A limit of the {name} must be above 0, or None for no limit; it is {limit!r}.")
