"""`SpeedChange`: a speed goes to another one as soon as its limits of acceleration and jerk allow.

Three phases: the acceleration grows at the full jerk, is held at its peak, and falls to 0. Before them the speed may be held for
some time. Any speed and acceleration may be its start, so a change under way is replaced by a new one from its present state,
without a jump of speed or acceleration.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias, final

from canopen_proto.drives.trajectory.polynomial import turning_point, with_constant_jerk
from canopen_proto.machine import LocalProtocolError

_ROUNDING: Final = 1 + 1e-9
_HALVINGS: Final = 20

Phase: TypeAlias = tuple[float, float, float, float, float]
"""Its start in s; distance, speed and acceleration there; its jerk."""


@final
class SpeedChange:
    """The change of a speed from `speed`, with the acceleration `acceleration`, to the constant speed `wanted`. It never changes.

    max_acceleration, max_jerk: magnitudes above 0; |acceleration| is at most max_acceleration. The speed overshoots `wanted` only
    if the acceleration cannot end before. hold: seconds of the present speed before; only without an acceleration.
    """

    __slots__ = ("distance", "duration", "max_acceleration", "max_jerk", "phases", "wanted")

    def __init__(
        self, speed: float, acceleration: float, wanted: float, max_acceleration: float, max_jerk: float, hold: float = 0.0
    ) -> None:
        if not (
            abs(acceleration) <= max_acceleration * _ROUNDING and 0.0 < max_jerk < math.inf and math.isfinite(speed + wanted)
        ):
            raise LocalProtocolError(
                f"A speed cannot change from {speed!r} to {wanted!r} with the acceleration {acceleration!r}, "
                f"the limits {max_acceleration!r} and {max_jerk!r} of acceleration and jerk. Try: limits above 0, a start within."
            )
        self.wanted: Final = wanted
        self.max_acceleration: Final = max_acceleration
        self.max_jerk: Final = max_jerk
        towards, grows, held, falls = _times(speed, acceleration, wanted, max_acceleration, max_jerk)
        time, distance = hold, hold * speed
        self.phases: Final[list[Phase]] = [(0.0, 0.0, speed, 0.0, 0.0)] if hold else []
        """That of `hold`, if there is one; three, the jerk of the middle one is 0; then what follows, for ever."""
        for lasts, jerk in (
            (grows, towards * max_jerk),
            (held, 0.0),
            (falls, -towards * max_jerk),
        ):
            self.phases.append((time, distance, speed, acceleration, jerk))
            time += lasts
            distance, speed, acceleration = with_constant_jerk(lasts, distance, speed, acceleration, jerk)
        self.phases.append((time, distance, wanted, 0.0, 0.0))
        self.duration: Final = time
        """Seconds until the speed is the wanted one."""
        self.distance: Final = distance
        """The way until then."""

    @staticmethod
    def seconds(speed: float, acceleration: float, wanted: float, max_acceleration: float, max_jerk: float) -> float:
        """Return the duration of a change with these values, which must make one: see the class. It costs a third of a change."""
        _, grows, held, falls = _times(speed, acceleration, wanted, max_acceleration, max_jerk)
        return grows + held + falls

    def at(self, time: float) -> tuple[float, float, float]:
        """Return the distance, the speed and the acceleration `time` seconds (0 or more) after the start."""
        number = len(self.phases) - 1
        while number and self.phases[number][0] > time:
            number -= 1
        begin, distance, speed, acceleration, jerk = self.phases[number]
        return with_constant_jerk(time - begin, distance, speed, acceleration, jerk)

    def time_at(self, distance: float) -> float:
        """Return the seconds after which it has gone this far, rounded up by 1e-6 of its duration at most; math.inf: never.
        distance: s of the path.

        The speed must not be negative on the way.
        """
        beyond = distance - self.distance
        if beyond > 0.0:
            return self.duration + beyond / self.wanted if self.wanted > 0.0 else math.inf
        return turning_point(lambda time: not self.at(time)[0] < distance, self.duration, _HALVINGS)[1]


def _times(
    speed: float, acceleration: float, wanted: float, max_acceleration: float, max_jerk: float
) -> tuple[float, float, float, float]:
    """Return the sign of the change, and for how long the acceleration grows, is held, and falls."""
    without = speed + acceleration * abs(acceleration) / (2.0 * max_jerk)  # the speed if the acceleration just ends
    towards = 1.0 if wanted >= without else -1.0
    gain, given = towards * (wanted - speed), towards * acceleration
    peak = math.sqrt(max(0.0, max_jerk * gain + 0.5 * given * given))
    held = 0.0
    if peak > max_acceleration:
        peak = max_acceleration
        held = max(0.0, gain - (2.0 * peak * peak - given * given) / (2.0 * max_jerk)) / peak
    return towards, max(0.0, peak - given) / max_jerk, held, peak / max_jerk
