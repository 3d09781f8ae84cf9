"""`SetPointLimits`: the limits of a drive's set-points, in the user's unit. `limits_of` gathers them for one axis.

Origin of the limits
--------------------
    position   0x607D of the drive, and min_position, max_position of the settings; the narrower, if both are given
    speed      max_speed of the settings; else the lower of 0x607F and 0x6080 of the drive; else DEFAULT_SPEED
               in profile position also 0x6081 of the drive: it goes no faster, and would fall behind
    max_acceleration   of the settings; else the lower of 0x60C5 and 0x60C6 of the drive; else the speed limit within DEFAULT_RAMP
    max_jerk           of the settings; else the limit of the acceleration within DEFAULT_ONSET

The settings go before the drive's speeds: the unit of 0x607F is the maker's choice, and few drives tell it. Without either, the
position has no limit: a turntable has none.

**A path** is kept within what the object of the set-points can hold, too (`ends_of_paths`): most hold an INTEGER32. No drive can
be given a position beyond it, however long the path takes to get there. A set-point that does not fit is refused by itself.

A direction of -1 makes the drive's upper limit the user's lower one.

**Acceleration and jerk** are limits of paths: these are planned, checked and stopped within them. A set-point is not refused for
them. A path that misses a cycle stands still for that cycle and then goes on. From one period to the next this is an acceleration
to its whole speed; to refuse it would stop the path for good. If a drive cannot follow for that reason, its following error shows
it.

Left out: 0x607D is used without the home offset 0x607C (drives differ in whether it counts).

**The drive's limits** (`read_limits`) are read by number, whatever the dictionary has: it may be that of another drive, and a
drive obeys a limit that the dictionary lacks. An object sets no limit if the drive does not have it or does not let us read it.
Nor does 0x607D if its minimum is not below its maximum (0 and 0 are no limits), an end of INTEGER32, or a speed or acceleration
that is 0 or beyond INTEGER32.

Units. 0x607F and 0x6081 are in velocity units, 0x6080 in motor revolutions per minute (CiA 402-2). units.py converts both, unless
`velocity_unit` of the settings says the first. 0x60C5 and 0x60C6 are in velocity units per second, unless the drive (0x60AA,
0x6097) or `acceleration_unit` of the settings says otherwise. A limit is left out if its unit is not known or cannot be
converted.

Source: IEC 61800-7-201 (CiA 402-2), software position limit 607Dh, max profile velocity 607Fh, max motor speed 6080h, max
acceleration 60C5h, max deceleration 60C6h, all from memory, and as the files of four makers have them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

from canopen_proto.datatypes import ValueRangeError
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.axis.failures import as_drive_errors
from canopen_proto.drives.axis.units import DriveUnits, read_number, read_units
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.trajectory.limit_check import EXACT, JointLimits
from canopen_proto.drives.trajectory.path import POSITION_TOLERANCE
from canopen_proto.machine import SECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux, mux_text
from canopen_proto.procedures.steps import Procedure

DEFAULT_SPEED: Final = 30_000
"""Counts per second, for a drive whose speed nothing limits: three times the speed of the manual's paths. On the manual's arm it
is 30 degrees per second. Half a metre from the joint that is 250 mm/s, which ISO 10218-1 calls reduced speed."""

DEFAULT_RAMP: Final = 0.5
"""Seconds from rest to the speed limit, for a drive whose acceleration nothing limits."""
DEFAULT_ONSET: Final = 0.1
"""Seconds from none to the full acceleration, for a joint whose jerk nothing limits: an arm may well follow that."""

BY_DEFAULT: Final = "the default, as neither the settings nor the drive say how fast it may go"
"""The source of a speed limit that nobody gave."""
_OF_DRIVE: Final = "of the drive"
FROM_SPEED: Final = f"the default: the speed limit, reached in {DEFAULT_RAMP:g} s"
FROM_ACCELERATION: Final = f"the default: the limit of the acceleration, reached in {DEFAULT_ONSET:g} s"
"""The sources of limits that nobody gave."""
ROUNDING: Final = 2 * POSITION_TOLERANCE
"""So far before the end of what an object can hold does a path end, in the user's unit, and as a part of positions above 1: the
check of a path lets it go beyond its limits by half of that."""


class Limit(NamedTuple):
    """A limit and its source, in words: "0x607D:02 of the drive", "the settings (max_speed)", "the default ..."."""

    value: float
    source: str


class DriveLimits(NamedTuple):
    """The drive's own limits, in counts, counts per second, counts per second²; None: it has no such limit."""

    lowest: Limit | None = None
    highest: Limit | None = None
    speed: Limit | None = None
    acceleration: Limit | None = None
    profile_speed: Limit | None = None


class Excess(NamedTuple):
    """A limit that a set-point exceeds. is_speed: the limit is of the speed, else of the position. value: as requested."""

    is_speed: bool
    value: float
    limit: Limit


@dataclass(frozen=True, slots=True)
class SetPointLimits:
    """The limits of one axis, in its user's unit; see this module's text. lowest, highest: positions, None for no limit.

    speed: per second. acceleration: the drive's own limit, per second², None if it has none. max_acceleration, max_jerk: what a
    path may ask for, per second² and per second³; a single set-point is not refused because of them.
    """

    axis: Axis
    lowest: Limit | None
    highest: Limit | None
    speed: Limit
    acceleration: Limit | None
    max_acceleration: Limit
    max_jerk: Limit

    @property
    def of_paths(self) -> JointLimits:
        """The limits for a path of this joint: to plan it, to check it, and to stop on it. See `ends_of_paths` and
        `speed_of_paths`."""
        lowest, highest = (None if limit is None else limit.value for limit in self.ends_of_paths)
        return JointLimits(lowest, highest, self.speed_of_paths.value, self.max_acceleration.value, self.max_jerk.value)

    @property
    def ends_of_paths(self) -> tuple[Limit | None, Limit | None]:
        """The lowest and the highest position of a path: the position limits, and what the object of the set-points can hold."""
        set_points = self.axis.set_points
        if set_points.reach is None:
            return self.lowest, self.highest
        mux = objects.INTERPOLATION_SET_POINT if len(set_points.objects) > 1 else set_points.objects[0]
        source = f"what {mux_text(mux).removesuffix(':00')} {_OF_DRIVE} can hold"
        least, most = sorted(map(self.axis.scale.from_counts, set_points.reach))
        least, most = least + ROUNDING * max(1.0, abs(least)), most - ROUNDING * max(1.0, abs(most))
        return (
            Limit(least, source) if self.lowest is None or self.lowest.value < least else self.lowest,
            Limit(most, source) if self.highest is None or self.highest.value > most else self.highest,
        )

    @property
    def speed_of_paths(self) -> Limit:
        """The speed limit of a path: that of the joint, or what the object of the velocity that goes along can hold."""
        reach = self.axis.set_points.velocity_reach
        if reach is None:
            return self.speed
        mux, counts = reach
        greatest = self.axis.scale.amount_from_counts(counts) / EXACT**2  # the check of a path lets it go a bit faster
        if greatest > self.speed.value:
            return self.speed
        return Limit(greatest, f"what {mux_text(mux).removesuffix(':00')} {_OF_DRIVE} can hold")

    def allows(self, start: float, target: float, time: Time) -> bool:
        """Return whether a set-point may be given: `excess` has nothing against it, and it fits the drive's object.

        In one call what each joint is asked in each cycle. False: see `excess`, and what is said of the object by `Scale` and
        `AxisSetPoints.check`. start, target, time: as of `excess`.
        """
        lowest, highest = self.lowest, self.highest
        if not (
            abs(target - start) * SECOND / time <= self.speed.value * EXACT
            and (lowest is None or lowest.value <= target)
            and (highest is None or target <= highest.value)
        ):
            return False  # or it is no number, or a joint comes back from beyond a limit
        axis = self.axis
        try:
            axis.set_points.check(axis.scale.to_counts(target))
        except (LocalProtocolError, ValueRangeError):
            return False
        return axis.scale.is_known

    def excess(self, start: float, target: float, time: Time) -> Excess | None:
        """Return the limit that a straight way from `start` to `target` within `time` ns exceeds; None if it is allowed."""
        speed = abs(target - start) * SECOND / time
        if speed > self.speed.value * EXACT:
            return Excess(True, speed, self.speed)
        limit = self.position_excess(start, target)
        return None if limit is None else Excess(False, target, limit)

    def position_excess(self, start: float, target: float) -> Limit | None:
        """Return the position limit that a way from `start` to `target` exceeds; None if it is allowed.

        A joint that stands beyond a limit may stay there and come back, but not go further.
        """
        lowest, highest = self.lowest, self.highest
        if (lowest is None or lowest.value <= target) and (highest is None or target <= highest.value):
            return None  # as nearly all are
        for limit, outward in ((highest, 1), (lowest, -1)):
            # Compared as counts: a set-point that is rounded to the limit is within it.
            if limit is not None and self._is_further(target, limit.value, outward) and self._is_further(target, start, outward):
                return limit
        return None

    def _is_further(self, one: float, other: float, outward: int) -> bool:
        to_counts = self.axis.scale.to_counts
        return (to_counts(one) - to_counts(other)) * outward * self.axis.settings.direction > 0


def limits_of(axis: Axis, told: DriveLimits | None = None) -> SetPointLimits:
    """Return the limits of an axis. told: the drive's own limits, None if they were not read."""
    settings, told, amount = axis.settings, told or DriveLimits(), axis.scale.amount_from_counts
    ends = [_converted(limit, axis.scale.from_counts) for limit in (told.lowest, told.highest)]
    lowest, highest = ends[:: settings.direction]
    if settings.min_position is not None and (lowest is None or settings.min_position > lowest.value):
        lowest = Limit(settings.min_position, "the settings (min_position)")
    if settings.max_position is not None and (highest is None or settings.max_position < highest.value):
        highest = Limit(settings.max_position, "the settings (max_position)")
    if settings.max_speed is not None:
        speed = Limit(settings.max_speed, "the settings (max_speed)")
    else:
        speed = _converted(told.speed, amount) or Limit(amount(DEFAULT_SPEED), BY_DEFAULT)
    profile = _converted(told.profile_speed, amount)
    if profile is not None and profile.value < speed.value:
        speed = profile
    acceleration = _converted(told.acceleration, amount)
    if settings.max_acceleration is not None:
        max_acceleration = Limit(settings.max_acceleration, "the settings (max_acceleration)")
    else:
        max_acceleration = acceleration or Limit(speed.value / DEFAULT_RAMP, FROM_SPEED)
    if settings.max_jerk is not None:
        max_jerk = Limit(settings.max_jerk, "the settings (max_jerk)")
    else:
        max_jerk = Limit(max_acceleration.value / DEFAULT_ONSET, FROM_ACCELERATION)
    return SetPointLimits(axis, lowest, highest, speed, acceleration, max_acceleration, max_jerk)


def _converted(limit: Limit | None, convert: Callable[[float], float]) -> Limit | None:
    return None if limit is None else Limit(convert(limit.value), limit.source)


_INTEGER32: Final = 1 << 31


@as_drive_errors
def read_limits(axis: Axis, mode: int = Mode.INTERPOLATED_POSITION) -> Procedure[SetPointLimits]:
    """Return the limits of an axis, by its settings and by its drive. Raises SdoTransferError if the drive does not answer.

    mode: in which it is going to follow set-points.
    """
    node = axis.node
    lowest = yield from read_number(node, objects.MIN_SOFTWARE_POSITION_LIMIT, signed=True)
    highest = yield from read_number(node, objects.MAX_SOFTWARE_POSITION_LIMIT, signed=True)
    profile = yield from _read_amount(node, objects.MAX_PROFILE_VELOCITY)
    motor = yield from _read_amount(node, objects.MAX_MOTOR_SPEED)
    in_profile = (yield from _read_amount(node, objects.PROFILE_VELOCITY)) if mode == Mode.PROFILE_POSITION else None
    hardest: list[Limit] = []  # a path brakes as hard as it accelerates
    for key in (objects.MAX_ACCELERATION, objects.MAX_DECELERATION):
        amount = yield from _read_amount(node, key)
        hardest += [] if amount is None else [Limit(amount, f"{mux_text(key).removesuffix(':00')} {_OF_DRIVE}")]
    acceleration = min(hardest, default=None)
    asks = any(each is not None for each in (profile, motor, in_profile, acceleration))
    units = (yield from read_units(node)) if asks else DriveUnits()
    per_velocity = units.per_velocity if axis.settings.velocity_unit is None else axis.settings.velocity_unit
    speeds = []
    if profile is not None and per_velocity is not None:
        speeds.append(Limit(profile * per_velocity, f"0x607F {_OF_DRIVE}"))
    turn = units.per_motor_turn or axis.settings.counts_per_motor_turn
    if motor is not None and turn is not None:
        speeds.append(Limit(motor * turn / 60, f"0x6080 {_OF_DRIVE}"))
    per_acceleration = axis.settings.acceleration_unit
    if per_acceleration is None:
        per_acceleration = units.acceleration_unit(per_velocity)
    told = DriveLimits(
        *_position_limits(lowest, highest),
        min(speeds, default=None),
        None
        if acceleration is None or per_acceleration is None
        else Limit(acceleration.value * per_acceleration, acceleration.source),
        None if in_profile is None or per_velocity is None else Limit(in_profile * per_velocity, f"0x6081 {_OF_DRIVE}"),
    )
    return limits_of(axis, told)


def _position_limits(lowest: int | None, highest: int | None) -> tuple[Limit | None, Limit | None]:
    if lowest is not None and highest is not None and lowest >= highest:
        return None, None
    return (
        None if lowest is None or lowest <= -_INTEGER32 + 1 else Limit(lowest, f"0x607D:01 {_OF_DRIVE}"),
        None if highest is None or highest >= _INTEGER32 - 1 else Limit(highest, f"0x607D:02 {_OF_DRIVE}"),
    )


def _read_amount(node: AxisNode, key: Mux) -> Procedure[int | None]:
    """Read a limit of a speed or an acceleration; return None if the value is no limit."""
    amount = yield from read_number(node, key)
    return amount if amount is not None and 0 < amount < _INTEGER32 - 1 else None
