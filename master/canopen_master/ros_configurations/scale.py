"""The scale of a joint: from what goes to the drive and what comes from it, the keys of `[joints.NAME]`.

    counts = factor * position + offset         to the drive; position in rad or m
    position = factor * counts + offset         from it

Both are one fact said twice: the second has to be the inverse of the first, within AGREES, or within what the last digits of both
leave open (0.00001745 is the inverse of 57295.78). Then the one with more digits counts. Where they contradict each other, nobody
can know which one is right, and no scale is taken: a joint without a scale refuses set-points.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any, Final, NamedTuple

from canopen_master.ros_configurations.report import key_text
from canopen_master.ros_configurations.unit_expression import ONE, ZERO, Exact, Line

AGREES: Final = 1e-6
"""Relative; conversions are often written with six to ten digits."""
_THOUSAND: Final = Exact(Fraction(1000))


class JointKeys(NamedTuple):
    """keys: of a joint. notes: what is not exactly as it was."""

    keys: Mapping[str, Any]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        shown = ", ".join(key_text(key, value) for key, value in self.keys.items())
        return "; ".join([shown, *self.notes])


class ContradictionError(ValueError):
    """The scale to the drive and the scale from it contradict each other. The text is the reason."""


def position_keys(to_device: Line, from_device: Line, *, is_linear: bool) -> JointKeys:
    """Return the keys of the position. is_linear: it is in metres, and the joint's unit will be the millimetre.

    Raises ContradictionError.
    """
    if not to_device.factor.fraction or not from_device.factor.fraction:
        raise ContradictionError("a factor is 0")
    notes: list[str] = []
    scale = _agreed(to_device, from_device, notes)
    keys: dict[str, Any] = {"unit": "millimetre" if is_linear else "radian"}
    size = Exact(abs(scale.fraction), scale.power)
    keys |= _scale_keys(size / _THOUSAND if is_linear else size, notes)
    if scale.fraction < 0:
        keys["direction"] = -1
    if offset := _offset(to_device, from_device):
        keys["offset"] = offset
    return JointKeys(keys, tuple(notes))


def _agreed(to_device: Line, from_device: Line, notes: list[str]) -> Exact:
    """Return the factor to the drive, or the inverse of that from the drive: which of them has more digits, as a note says.

    Raises ContradictionError if they are not each other's inverse.
    """
    there, back = to_device.factor, from_device.factor
    error = abs(float(there * back) - 1)
    if error > AGREES + float(to_device.rounding + from_device.rounding):
        raise ContradictionError(f"{_shown(back)} is not the inverse of {_shown(there)}")
    if error <= AGREES:
        if error:
            notes.append(f"what comes from the drive had a factor that differs by {error:.1e}; it is the inverse now")
        return there
    is_back = _uncertainty(from_device) < _uncertainty(to_device)
    kept, other = ("from", "to") if is_back else ("to", "from")
    notes.append(
        f"the two factors differ by {error:.1e}, as their last digits allow: the one {kept} the drive has more digits and "
        f"counts; the one {other} the drive is its inverse now"
    )
    return ONE / back if is_back else there


def _uncertainty(line: Line) -> Fraction:
    """Return the rounding of a factor; one of few digits is less certain than any other."""
    return line.rounding or Fraction(1)


def _scale_keys(scale: Exact, notes: list[str]) -> dict[str, Any]:
    """Return the scale by the key that holds it exactly; if none does, by the nearest float, with a note."""
    key, counts = ("counts_per_turn", scale * Exact(Fraction(2), 1)) if scale.power == -1 else ("counts_per_unit", scale)
    return {key: number_in_toml(counts, notes)}


def number_in_toml(number: Exact, notes: list[str]) -> int | float:
    """Return a number as TOML holds it. One that it cannot hold is the nearest float, and a note says so.

    Raises ContradictionError for one that is too large or too small for a float.
    """
    if not number.power and number.fraction.denominator == 1 and abs(number.fraction) < 1 << 53:
        return int(number.fraction)
    nearest = float(number)
    if not math.isfinite(nearest) or not nearest:
        raise ContradictionError("it is too large or too small for a float")
    if number.power or Fraction(repr(nearest)) != number.fraction:
        notes.append("rounded to 17 digits, as every float")
    return nearest


def _offset(to_device: Line, from_device: Line) -> int:
    """Return the counts at position 0. Raises ContradictionError."""
    expected = to_device.offset * from_device.factor + from_device.offset if _same_power(to_device, from_device) else None
    counts = float(to_device.offset)
    rounding = to_device.rounding + from_device.rounding + to_device.offset_rounding + from_device.offset_rounding
    size = abs(counts * float(from_device.factor))
    if expected is None or abs(float(expected)) > AGREES * max(1.0, size) + float(rounding) * size:
        raise ContradictionError(
            f"the offsets {_shown(to_device.offset)} and {_shown(from_device.offset)} do not belong together"
        )
    if to_device.offset.power or to_device.offset.fraction.denominator != 1:
        raise ContradictionError(f"an offset is a whole number of counts here, and {_shown(to_device.offset)} is none")
    return int(to_device.offset.fraction)


def _same_power(to_device: Line, from_device: Line) -> bool:
    product = to_device.offset * from_device.factor
    return not product.fraction or not from_device.offset.fraction or product.power == from_device.offset.power


def velocity_keys(scale: Exact, to_device: Line, from_device: Line) -> JointKeys:
    """Return the velocity unit: counts per second in one unit of 0x60FF and 0x606C. scale: counts per rad or m.

    Raises ContradictionError.
    """
    if not to_device.factor.fraction or to_device.offset != ZERO or from_device.offset != ZERO:
        raise ContradictionError("a velocity has a factor other than 0 and no offset")
    if not from_device.factor.fraction:
        raise ContradictionError("a factor is 0")
    notes: list[str] = []
    try:
        factor = _agreed(to_device, from_device, notes)
    except ContradictionError as error:
        raise ContradictionError(f"{error}; by CiA 402 0x60FF and 0x606C have one unit, and 0x6042 (vl) has another") from None
    unit = scale / factor
    if unit.fraction < 0:
        raise ContradictionError("position and velocity have opposite signs")
    return JointKeys({"velocity_unit": number_in_toml(unit, notes)}, tuple(notes))


def _shown(number: Exact) -> str:
    return f"{float(number):.10g}"
