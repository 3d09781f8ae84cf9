"""The parameters of a simulated drive: the values of its objects, as numbers to compute with."""

from __future__ import annotations

from typing import Final

from canopen_proto.datatypes import Value
from canopen_proto.drives.cia402 import objects
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive.fallbacks import FALLBACKS
from canopen_proto.simulation.drive.settings import DriveSettings
from canopen_proto.simulation.drive.smooth_motion import JERK_LIMITED

_MIN_PERIOD: Final = 1e-6  # s; used for an interpolation time of 0, which an RPDO can write
_NO_TURN: Final = 60.0  # units in a turn of a motor that does not tell (608Fh): a revolution per minute is a unit per second


class Parameters:
    """The values in a device's store, read when they are needed."""

    def __init__(self, store: dict[Mux, Value], settings: DriveSettings) -> None:
        self.store = store
        self.settings = settings

    def parameter(self, key: Mux) -> int:
        """Return an object's present value, or its fallback."""
        value = self.store.get(key)
        if isinstance(value, int) and (value or key not in self.settings.unset):
            return value
        return FALLBACKS.get(key, 0)

    def rate(self, key: Mux) -> float:
        """Return a speed or an acceleration; at least 1."""
        return float(max(1, self.parameter(key)))

    @property
    def profile_jerks(self) -> tuple[float, float] | None:
        """The jerks of a profile (60A4h; 60A3h says whether there are two), if 6086h asks for limited jerk; else None."""
        if self.parameter(objects.MOTION_PROFILE_TYPE) != JERK_LIMITED:
            return None
        first = self.rate(objects.PROFILE_JERK)
        return first, (self.rate(objects.SECOND_PROFILE_JERK) if self.parameter(objects.PROFILE_JERK_USE) == 2 else first)

    def ramp(self, option: int) -> float:
        """Return the deceleration of an option code: 1 slow-down ramp, 2 quick stop ramp, 3 and 4 as hard as it can.

        Any other option, which an RPDO can write, means the quick stop ramp.
        """
        if option == 1:
            return self.rate(objects.PROFILE_DECELERATION)
        return self.rate(objects.MAX_DECELERATION if option in (3, 4) else objects.QUICK_STOP_DECELERATION)

    def ratio(self, key: Mux) -> float:
        """Return an object's subindex 1 / subindex 2; 1 if one of them is missing or 0."""
        numerator, denominator = self.parameter(key), self.parameter(Mux(key + 1))
        return numerator / denominator if numerator and denominator else 1.0

    @property
    def vl_unit(self) -> float:
        """One velocity unit of vl in units/s: the dimension factor 604Ch, in revolutions of the motor per minute."""
        turn = self.ratio(objects.POSITION_ENCODER_RESOLUTION)
        return self.ratio(objects.VL_DIMENSION_FACTOR) * (turn if turn > 1.0 else _NO_TURN) / 60.0

    def interpolation_period(self) -> float:
        """Return 60C2h in seconds."""
        index = max(-9, min(9, self.parameter(objects.INTERPOLATION_TIME_INDEX)))
        return max(_MIN_PERIOD, self.parameter(objects.INTERPOLATION_TIME_UNITS) * 10.0**index)
