"""`DriveUnits`: what the numbers of a drive mean, by its factor group. `read_units` asks the drive.

    position   0x60A8 if it names an angle or a length; else the feed constant 0x6092, in counts for a turn of the shaft; else the
               encoder 0x608F times the gear 0x6091; else millidegrees, if the vendor-ID is Schunk's, whose joints do not tell
    velocity   0x60A9; else the older 0x608C and 0x608B; else the velocity factor 0x6096; else a count per second
    acceleration   0x60AA; else the acceleration factor 0x6097; else the velocity unit per second
    torque     per thousand of the rated torque 0x6076, which is in mN·m
    polarity   0x607E: bit 7 reverses positions, bit 6 velocities, bit 5 torques, inside the drive
    offset     0x607C: the position that a homing gives to the reference point

A "count" is the unit of 0x6064 and 0x607A, whatever it is in the drive. The shaft is the one behind the gear.

A feed constant or an encoder of 1 counts as "not set": that is the default of files that leave the factor group alone. If two
objects give different scales, the first in the table above is used, and `conflicts` names the other.

A unit in 0x60A8, 0x60A9 and 0x60AA has four bytes: the power of ten, the unit, the unit below the fraction bar, 0. Of CiA
303-2's units these are known: 0x01 metre, 0x10 radian, 0x41 degree, 0xB4 turn, 0xB5 increment; 0x03 second, 0x47 minute, 0x57
square second.

Source: IEC 61800-7-201 (CiA 402-2), factor group, from memory, and as the manuals and files of six makers have it. CiA 303-2
v1.1, 4 and 5; 0xB4, 0x47 and the order of the bytes are also in Nanotec's and Synapticon's manuals (60A9h = 00B44700h).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final

from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.cia402 import objects
from canopen_proto.multiplexer import Mux, mux_text, split_mux
from canopen_proto.procedures.objects import unless_refused
from canopen_proto.procedures.steps import Procedure, upload

_METRE, _RADIAN, _DEGREE, _TURN = 0x01, 0x10, 0x41, 0xB4
_ANGLES: Final = {_RADIAN: ("radian", 2 * math.pi), _DEGREE: ("degree", 360.0), _TURN: ("turn", 1.0)}
"""Each unit of angle: its name, and how many make a turn."""
_INCREMENT: Final = 0xB5
_SECONDS: Final = {0x03: 1, 0x47: 60}
"""Each unit of time, in seconds."""
_SQUARE_SECONDS: Final = {0x57: 1}
_REVOLUTIONS_PER_MINUTE: Final = 0xA4
"""In the older 0x608C."""

_RATIOS: Final = (
    objects.POSITION_ENCODER_RESOLUTION, objects.GEAR_RATIO, objects.FEED_CONSTANT, objects.VELOCITY_FACTOR,
    objects.ACCELERATION_FACTOR,
)  # fmt: skip
FACTOR_GROUP: Final = (
    objects.SI_UNIT_POSITION, objects.SI_UNIT_VELOCITY, objects.SI_UNIT_ACCELERATION,
    objects.VELOCITY_DIMENSION_INDEX, objects.VELOCITY_NOTATION_INDEX,
    *(Mux(key + part) for key in _RATIOS for part in (0, 1)),
    objects.POLARITY, objects.HOME_OFFSET, objects.MOTOR_RATED_TORQUE, objects.VENDOR_ID,
)  # fmt: skip
"""The objects that `read_units` reads."""


COUNTS: Final = "counts"
"""What positions are in without a unit."""


class Unit(StrEnum):
    """A user's unit of position."""

    RADIAN = "radian"
    DEGREE = "degree"
    TURN = "turn"
    MILLIMETRE = "millimetre"


@dataclass(frozen=True, slots=True)
class DriveUnits:
    """The units of a drive, as it tells them; None: it does not tell.

    per_turn: counts for a turn of the shaft. per_motor_turn: counts for a turn of the motor. per_metre: counts, of a drive that
    positions a length. per_velocity: counts per second in one velocity unit. per_acceleration: counts per second² in one unit of
    0x6083, 0x6084, 0x609A, 0x60C5 and 0x60C6, if the drive has one of its own: see `acceleration_unit`. rated_torque: N·m.
    reversed: of "position", "velocity" and "torque", those that the drive reverses. home_offset: counts.
    origins: by the name of a field, the objects that it was computed from, in words. conflicts: in words.
    """

    per_turn: float | None = None
    per_motor_turn: float | None = None
    per_metre: float | None = None
    per_velocity: float | None = None
    rated_torque: float | None = None
    reversed: tuple[str, ...] = ()
    home_offset: int = 0
    origins: Mapping[str, str] = field(default_factory=dict)
    conflicts: tuple[str, ...] = ()
    per_acceleration: float | None = None

    def counts_per(self, unit: Unit) -> float | None:
        """Return the counts in one unit of position, for `AxisSettings.counts_per_unit`; None if the drive does not tell."""
        if unit is Unit.MILLIMETRE:
            return None if self.per_metre is None else self.per_metre / 1000
        parts = {Unit.RADIAN: 2 * math.pi, Unit.DEGREE: 360.0, Unit.TURN: 1.0}[unit]
        return None if self.per_turn is None else self.per_turn / parts

    def acceleration_unit(self, velocity_unit: float | None) -> float | None:
        """Return the counts per second² in one unit of an acceleration: the drive's own, else one velocity unit per second.

        velocity_unit: counts per second, None: not known. None: not known, or the drive has a unit that cannot be converted.
        """
        return self.per_acceleration if "per_acceleration" in self.origins else velocity_unit

    def torque(self, per_thousand: float) -> float | None:
        """Return a torque of 0x6071 or 0x6077 in N·m; None if the drive does not tell its rated torque. per_thousand: of the
        rated torque."""
        return None if self.rated_torque is None else per_thousand / 1000 * self.rated_torque

    def per_thousand(self, torque: float) -> float | None:
        """Return a torque in N·m in thousandths of the rated torque; None if the drive does not tell its rated torque."""
        return None if self.rated_torque is None else torque / self.rated_torque * 1000


def read_units(node: AxisNode) -> Procedure[DriveUnits]:
    """Read the factor group by SDO, by number, whatever the dictionary has. Raises SdoTransferError if the drive does not
    answer."""
    values: dict[Mux, int] = {}
    for key in FACTOR_GROUP:
        value = yield from read_number(node, key, signed=key == objects.HOME_OFFSET)
        if value is not None:
            values[key] = value
    return units_of(values)


def read_number(node: AxisNode, key: Mux, *, signed: bool = False) -> Procedure[int | None]:
    """Read an integer of 1 to 4 bytes by its number alone; return None if the drive refuses, or sends another length.

    signed: it may be below 0.
    """
    data = yield from unless_refused(upload(node.sdo, *split_mux(node.on_device(key))))
    return int.from_bytes(data, "little", signed=signed) if data is not None and 0 < len(data) <= 4 else None


def units_of(values: Mapping[Mux, int]) -> DriveUnits:
    """Compute the units from the values of the factor group, without what the drive does not have."""
    origins: dict[str, str] = {}
    conflicts: list[str] = []
    per_turn, per_metre = _of_si_unit(values, origins)
    for found, origin in _scales(values):
        if per_turn is None:
            per_turn, origins["per_turn"] = found, origin
        elif not math.isclose(per_turn, found, rel_tol=1e-6) and per_metre is None:
            conflicts.append(f"{origin}: {found:g} counts for a turn; {origins['per_turn']}: {per_turn:g}")
    gear = _ratio(values, objects.GEAR_RATIO)
    per_motor_turn = None if per_turn is None else per_turn / gear
    if per_turn is None and per_metre is None and values.get(objects.VENDOR_ID) == objects.SCHUNK_VENDOR_ID:
        per_turn, origins["per_turn"] = 360_000.0, "0x1018:01, the vendor-ID: joints of Schunk's count millidegrees"
    if per_motor_turn is not None:
        origins["per_motor_turn"] = origins["per_turn"] + (
            "" if gear == 1 or "0x6091" in origins["per_turn"] else f", {_said(values, objects.GEAR_RATIO)}"
        )
    per_velocity = _velocity(values, per_turn, per_motor_turn, per_metre, origins)
    per_acceleration = _acceleration(values, per_turn, per_metre, origins)
    rated = values.get(objects.MOTOR_RATED_TORQUE) or None
    if rated is not None:
        origins["rated_torque"] = f"0x6076 = {rated} mN·m"
    polarity = values.get(objects.POLARITY, 0)
    return DriveUnits(
        per_turn,
        per_motor_turn,
        per_metre,
        per_velocity,
        None if rated is None else rated / 1000,
        tuple(name for bit, name in ((7, "position"), (6, "velocity"), (5, "torque")) if polarity >> bit & 1),
        values.get(objects.HOME_OFFSET, 0),
        origins,
        tuple(conflicts),
        per_acceleration,
    )


def _of_si_unit(values: Mapping[Mux, int], origins: dict[str, str]) -> tuple[float | None, float | None]:
    """Return counts for a turn and for a metre, by 0x60A8; None for what it does not name."""
    unit = values.get(objects.SI_UNIT_POSITION, 0)
    power, numerator, _, _ = unit.to_bytes(4, "big")
    counts = 10.0 ** -_exponent(power)
    said = f"0x60A8 = 0x{unit:08X}"
    if numerator in _ANGLES:
        name, parts = _ANGLES[numerator]
        origins["per_turn"] = f"{said}, a count is {1 / counts:g} {name}"
        return parts * counts, None
    if numerator == _METRE:
        origins["per_metre"] = f"{said}, a count is {1 / counts:g} m"
        return None, counts
    return None, None


def _scales(values: Mapping[Mux, int]) -> list[tuple[float, str]]:
    """Return the counts for a turn of the shaft by feed constant, or else by encoder and gear, and what they come from."""
    feed = _ratio(values, objects.FEED_CONSTANT)
    if feed > 1:
        return [(feed, _said(values, objects.FEED_CONSTANT))]
    increments = _ratio(values, objects.POSITION_ENCODER_RESOLUTION)
    gear = _ratio(values, objects.GEAR_RATIO)
    if increments <= 1:
        return []
    said = _said(values, objects.POSITION_ENCODER_RESOLUTION)
    return [(increments * gear, said if gear == 1 else f"{said}, {_said(values, objects.GEAR_RATIO)}")]


def _velocity(
    values: Mapping[Mux, int],
    per_turn: float | None,
    per_motor_turn: float | None,
    per_metre: float | None,
    origins: dict[str, str],
) -> float | None:
    """Return the counts per second in one velocity unit; None if it is not known, or cannot be converted."""
    unit, dimension = values.get(objects.SI_UNIT_VELOCITY, 0), values.get(objects.VELOCITY_DIMENSION_INDEX, 0) & 0xFF
    if unit:
        origins["per_velocity"] = f"0x60A9 = 0x{unit:08X}"
        return _si_rate(unit, _SECONDS, per_turn, per_metre)
    if dimension:
        power = values.get(objects.VELOCITY_NOTATION_INDEX, 0) & 0xFF
        origins["per_velocity"] = f"0x608C = 0x{dimension:02X}, 0x608B = {_exponent(power)}"
        if dimension != _REVOLUTIONS_PER_MINUTE or per_motor_turn is None:
            return None
        return per_motor_turn / 60 * 10.0 ** _exponent(power)
    factor = _ratio(values, objects.VELOCITY_FACTOR)
    origins["per_velocity"] = "the default" if factor == 1 else _said(values, objects.VELOCITY_FACTOR)
    return 1 / factor


def _acceleration(
    values: Mapping[Mux, int], per_turn: float | None, per_metre: float | None, origins: dict[str, str]
) -> float | None:
    """Return the counts per second² in one unit of an acceleration; None if the drive names none, or it cannot be converted."""
    unit, factor = values.get(objects.SI_UNIT_ACCELERATION, 0), _ratio(values, objects.ACCELERATION_FACTOR)
    if unit:
        origins["per_acceleration"] = f"0x60AA = 0x{unit:08X}"
        return _si_rate(unit, _SQUARE_SECONDS, per_turn, per_metre)
    if factor != 1:
        origins["per_acceleration"] = _said(values, objects.ACCELERATION_FACTOR)
        return 1 / factor
    return None


def _si_rate(unit: int, times: Mapping[int, int], per_turn: float | None, per_metre: float | None) -> float | None:
    """Return the counts per second (or second²) in one unit of 0x60A9 (0x60AA); None if it is not known."""
    power, numerator, denominator, _ = unit.to_bytes(4, "big")
    parts = _ANGLES[numerator][1] if numerator in _ANGLES else 1.0
    whole = {_METRE: per_metre, _INCREMENT: 1.0}.get(numerator, per_turn if numerator in _ANGLES else None)
    time = times.get(denominator)
    return None if whole is None or time is None else whole / parts / time * 10.0 ** _exponent(power)


def _exponent(byte: int) -> int:
    return byte - 256 if byte & 0x80 else byte


def _ratio(values: Mapping[Mux, int], key: Mux) -> float:
    """Return subindex 1 / subindex 2; 1, which changes nothing, if one of them is missing or 0."""
    numerator, denominator = values.get(key), values.get(Mux(key + 1))
    return numerator / denominator if numerator and denominator else 1.0


def _said(values: Mapping[Mux, int], key: Mux) -> str:
    return f"{mux_text(key)[:-3]} = {values[key]} / {values[Mux(key + 1)]}"
