"""`Scale`: the units of one axis, between its user and the wire.

The user sees positions in the user's unit (radians for an arm). On the wire they are counts (millidegrees for the Schunk arm).
counts = round(direction * unit * counts_per_unit) + offset. Without a scale, the user sees counts too. The drive's velocity unit
is that of `units`, or of the settings; torques are shares of the rated torque (0x6076), with the sign of `direction`.
"""

from __future__ import annotations

import math
from typing import Final

from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.units import DriveUnits
from canopen_proto.machine import LocalProtocolError

_EXACT: Final = 1 + 1e-12
"""So that a whole number is not rounded down to the next one, because of the rounding of floating point."""


class Scale:
    """See this module's text. settings: those in force; `use` sets them. units: as the drive told them when they were last read.
    is_known: whether the user's unit is known; else it is the count. direction: 1 or -1."""

    def __init__(self, title: str, settings: AxisSettings) -> None:
        """title: of the drive, for messages."""
        self.units = DriveUnits()
        self._title = title
        self.use(settings)

    def use(self, settings: AxisSettings) -> None:
        """Convert by these settings from now on."""
        self.settings = settings
        self.direction, self._offset = settings.direction, settings.offset
        self.is_known = settings.counts_per_unit is not None
        self._scale = 1.0 if settings.counts_per_unit is None else settings.counts_per_unit

    def to_counts(self, position: float) -> int:
        """Convert a position in the user's unit to counts on the wire. Raises LocalProtocolError unless they are a number."""
        try:
            return round(self.direction * position * self._scale) + self._offset
        except (ValueError, OverflowError):
            raise LocalProtocolError(f"a position must be a finite number; it is {position!r}") from None

    def from_counts(self, counts: float) -> float:
        """Convert counts on the wire to a position in the user's unit."""
        return self.direction * (counts - self._offset) / self._scale

    def way_from_counts(self, counts: float) -> float:
        """Convert the difference of two positions from counts to the user's unit."""
        return self.direction * counts / self._scale

    def amount_from_counts(self, counts: float) -> float:
        """Convert an amount, such as a speed, from counts to the user's unit."""
        return counts / self._scale

    def way_to_counts(self, way: float) -> float:
        """Convert the difference of two positions, or a velocity, from the user's unit to counts; not rounded."""
        return self.direction * way * self._scale

    def counts_of_amount(self, amount: float) -> float:
        """Convert an amount, such as a speed, from the user's unit to counts."""
        return amount * self._scale

    @property
    def velocity_unit(self) -> float | None:
        """Counts per second in one velocity unit of the drive; None if it is not known."""
        return self.units.per_velocity if self.settings.velocity_unit is None else self.settings.velocity_unit

    @property
    def acceleration_unit(self) -> float | None:
        """Counts per second² in one acceleration unit of the drive; None if it is not known."""
        given = self.settings.acceleration_unit
        return self.units.acceleration_unit(self.velocity_unit) if given is None else given

    def velocity_to_wire(self, velocity: float) -> int:
        """Convert a velocity in the user's unit per second to the drive's velocity unit, rounded to a whole number.

        Raises LocalProtocolError if that unit is not known: `drive.learn_units` asks the drive.
        """
        unit = self.velocity_unit
        if unit is None:
            raise LocalProtocolError(
                f"the velocity unit of {self._title} is not known, so it gets no velocity. "
                "Try: AxisSettings(velocity_unit=...), in counts per second, by its manual"
            )
        return round(self.direction * velocity * self._scale / unit)

    def speed_to_wire(self, speed: float) -> int:
        """Convert a speed of a profile (0 or more) to the drive's velocity unit, rounded down. Raises as `velocity_to_wire`."""
        self.velocity_to_wire(0.0)
        return math.floor(speed * self._scale / (self.velocity_unit or 1.0) * _EXACT)

    def rate_to_wire(self, rate: float) -> int:
        """Convert an acceleration (0 or more) in the user's unit per second² to the drive's unit, rounded down. Raises
        LocalProtocolError as `velocity_to_wire`, unless the settings name the acceleration unit."""
        unit = self.acceleration_unit
        if unit is None:
            origin = self.units.origins.get("per_acceleration")
            if origin is None:
                return self.speed_to_wire(rate)
            raise LocalProtocolError(
                f"the acceleration unit of {self._title} cannot be converted ({origin}), so it gets no acceleration. "
                "Try: AxisSettings(acceleration_unit=...), in counts per second², by its manual"
            )
        return math.floor(rate * self._scale / unit * _EXACT)

    def velocity_from_wire(self, number: float) -> float:
        """Convert a velocity in the drive's unit (a count per second if it is not known) to the user's unit per second. number:
        as 0x606C has it."""
        return self.way_from_counts(number * (self.velocity_unit or 1.0))

    def torque_from_wire(self, per_mille: float) -> float:
        """Convert a torque in thousandths of the rated torque to a share of it, with the sign of the user's direction."""
        return self.direction * per_mille / 1000

    def torque_to_wire(self, torque: float) -> int:
        """Convert a torque, as a share of the rated torque, to thousandths of it on the wire, rounded to a whole number.

        Raises LocalProtocolError unless it is a finite number.
        """
        try:
            return round(self.direction * torque * 1000)
        except (ValueError, OverflowError):
            raise LocalProtocolError(f"a torque must be a finite number; it is {torque!r}") from None
