"""`SetPointLimits`: what a drive must not be asked for by set-points, in the user's unit. `limits_of` gathers them for one axis.

Where they come from
--------------------
    position   0x607D of the drive, and min_position, max_position of the settings; where both say something, the narrower
    speed      max_speed of the settings; else the lower of 0x607F and 0x6080 of the drive; else DEFAULT_SPEED

The settings go before the drive's speeds: the unit of 0x607F is the maker's choice, and few drives tell it. Where nobody limits
the position, it has no limit: a turntable has none.

A direction of -1 makes the drive's upper limit the user's lower one.

**Acceleration** (0x60C5) is shown and refuses nothing. A path that misses a cycle stands still for it and then goes on; from one
period to the next that is an acceleration to its whole speed, and to refuse it would be to stop the path for good. What a drive
cannot follow for that reason shows as its following error.

Left out: 0x607D is taken as it stands, without the home offset 0x607C (drives differ in whether it counts).

Source: IEC 61800-7-201 (CiA 402-2), software position limit 607Dh, max profile velocity 607Fh, max motor speed 6080h.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

from canopen_proto.cia402.axis import Axis
from canopen_proto.machine import SECOND, Time

DEFAULT_SPEED: Final = 30_000
"""Counts per second. Nobody says how fast the drive may go: this is three times the speed of the manual's paths. On its arm it is
30 degrees per second. Half a metre from the joint that is 250 mm/s, which ISO 10218-1 calls reduced speed."""

_DEFAULT: Final = "the default, as neither the settings nor the drive say how fast it may go"
_TOLERANCE: Final = 1 + 1e-6
"""A path at the limit itself is not refused for what floating point makes of it."""


class Limit(NamedTuple):
    """source: who says so, for people: "0x607D:02 of the drive", "the settings (max_speed)", "the default ..."."""

    value: float
    source: str


class DriveLimits(NamedTuple):
    """What a drive says by itself, in counts, counts per second, counts per second²; None where it says nothing."""

    lowest: Limit | None = None
    highest: Limit | None = None
    speed: Limit | None = None
    acceleration: Limit | None = None


class Excess(NamedTuple):
    """A limit that a set-point is beyond. is_speed: of the speed, else of the position. value: what was asked for."""

    is_speed: bool
    value: float
    limit: Limit


@dataclass(frozen=True, slots=True)
class SetPointLimits:
    """The limits of one axis, in its user's unit; see this module's text. lowest, highest: positions, None for no limit.

    speed: per second; acceleration: per second², None if the drive tells none; it refuses nothing.
    """

    axis: Axis
    lowest: Limit | None
    highest: Limit | None
    speed: Limit
    acceleration: Limit | None

    def excess(self, start: float, target: float, time: Time) -> Excess | None:
        """The limit that a straight way from `start` to `target` within `time` ns is beyond; None if it may be asked for."""
        speed = abs(target - start) * SECOND / time
        if speed > self.speed.value * _TOLERANCE:
            return Excess(True, speed, self.speed)
        limit = self.position_excess(start, target)
        return None if limit is None else Excess(False, target, limit)

    def position_excess(self, start: float, target: float) -> Limit | None:
        """The position limit that a way from `start` to `target` is beyond; None if it may be asked for.

        A joint that stands beyond a limit may stay there and come back, but not go further.
        """
        for limit, outward in ((self.highest, 1), (self.lowest, -1)):
            # Compared as counts: a set-point that is rounded to the limit is within it.
            if limit is not None and self._is_further(target, limit.value, outward) and self._is_further(target, start, outward):
                return limit
        return None

    def _is_further(self, one: float, other: float, outward: int) -> bool:
        to_counts = self.axis.to_counts
        return (to_counts(one) - to_counts(other)) * outward * self.axis.settings.direction > 0


def limits_of(axis: Axis, told: DriveLimits | None = None) -> SetPointLimits:
    """The limits of an axis. told: what its drive says, None if it was not asked."""
    settings, told = axis.settings, told or DriveLimits()
    ends = [_converted(limit, axis.from_counts) for limit in (told.lowest, told.highest)]
    lowest, highest = ends[:: settings.direction]
    if settings.min_position is not None and (lowest is None or settings.min_position > lowest.value):
        lowest = Limit(settings.min_position, "the settings (min_position)")
    if settings.max_position is not None and (highest is None or settings.max_position < highest.value):
        highest = Limit(settings.max_position, "the settings (max_position)")
    if settings.max_speed is not None:
        speed = Limit(settings.max_speed, "the settings (max_speed)")
    else:
        speed = _converted(told.speed, axis.amount_from_counts) or Limit(axis.amount_from_counts(DEFAULT_SPEED), _DEFAULT)
    acceleration = _converted(told.acceleration, axis.amount_from_counts)
    return SetPointLimits(axis, lowest, highest, speed, acceleration)


def _converted(limit: Limit | None, convert: Callable[[float], float]) -> Limit | None:
    return None if limit is None else Limit(convert(limit.value), limit.source)
