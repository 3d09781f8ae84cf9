"""The scale of a joint: from what goes to the drive and what comes from it, the keys of `[joints.NAME]`.

    counts = factor * position + offset         to the drive; position in rad or m
    position = factor * counts + offset         from it

Both are one fact said twice: the second has to be the inverse of the first, within AGREES. Where they contradict each other,
nobody can know which one is right, and no scale is taken: a joint without a scale refuses set-points.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any, Final, NamedTuple

from canopen_master.ros_configurations.unit_expression import ZERO, Exact, Line

AGREES: Final = 1e-6
"""Relative; conversions are often written with six to ten digits."""
_THOUSAND: Final = Exact(Fraction(1000))


class Keys(NamedTuple):
    """keys: of a joint. notes: what is not exactly as it was."""

    keys: Mapping[str, Any]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        shown = ", ".join(f"{key} = {value!r}".replace("'", '"') for key, value in self.keys.items())
        return "; ".join([shown, *self.notes])


class Contradiction(ValueError):
    """The scale to the drive and the scale from it contradict each other. The text is the reason."""


def position_keys(to_device: Line, from_device: Line, *, is_linear: bool) -> Keys:
    """Return the keys of the position. is_linear: it is in metres, and the joint's unit will be the millimetre.

    Raises Contradiction.
    """
    scale = to_device.factor
    if not scale.fraction or not from_device.factor.fraction:
        raise Contradiction("a factor is 0")
    notes = []
    error = abs(float(scale * from_device.factor) - 1)
    if error > AGREES:
        raise Contradiction(f"{_shown(from_device.factor)} is not the inverse of {_shown(scale)}")
    if error:
        notes.append(f"what comes from the drive had a factor that differs by {error:.1e}; it is the inverse now")
    keys: dict[str, Any] = {"unit": "millimetre" if is_linear else "radian"}
    size = Exact(abs(scale.fraction), scale.power)
    keys |= _scale_keys(size / _THOUSAND if is_linear else size, notes)
    if scale.fraction < 0:
        keys["direction"] = -1
    if offset := _offset(to_device, from_device):
        keys["offset"] = offset
    return Keys(keys, tuple(notes))


def _scale_keys(scale: Exact, notes: list[str]) -> dict[str, Any]:
    """Return the scale by the key that holds it exactly; if none does, by the nearest float, with a note."""
    key, counts = ("counts_per_turn", scale * Exact(Fraction(2), 1)) if scale.power == -1 else ("counts_per_unit", scale)
    return {key: number_in_toml(counts, notes)}


def number_in_toml(number: Exact, notes: list[str]) -> int | float:
    """Return a number as TOML holds it. One that it cannot hold is the nearest float, and a note says so.

    Raises Contradiction for one that is too large or too small for a float.
    """
    if not number.power and number.fraction.denominator == 1 and abs(number.fraction) < 1 << 53:
        return int(number.fraction)
    nearest = float(number)
    if not math.isfinite(nearest) or not nearest:
        raise Contradiction("it is too large or too small for a float")
    if number.power or Fraction(repr(nearest)) != number.fraction:
        notes.append("rounded to 17 digits, as every float")
    return nearest


def _offset(to_device: Line, from_device: Line) -> int:
    """Return the counts at position 0. Raises Contradiction."""
    expected = to_device.offset * from_device.factor + from_device.offset if _same_power(to_device, from_device) else None
    counts = float(to_device.offset)
    if expected is None or abs(float(expected)) > AGREES * max(1.0, abs(counts * float(from_device.factor))):
        raise Contradiction(f"the offsets {_shown(to_device.offset)} and {_shown(from_device.offset)} do not belong together")
    if to_device.offset.power or to_device.offset.fraction.denominator != 1:
        raise Contradiction(f"an offset is a whole number of counts here, and {_shown(to_device.offset)} is none")
    return int(to_device.offset.fraction)


def _same_power(to_device: Line, from_device: Line) -> bool:
    product = to_device.offset * from_device.factor
    return not product.fraction or not from_device.offset.fraction or product.power == from_device.offset.power


def velocity_keys(scale: Exact, to_device: Line, from_device: Line) -> Keys:
    """Return the velocity unit: counts per second in one unit of 0x60FF and 0x606C. scale: counts per rad or m.

    Raises Contradiction.
    """
    if not to_device.factor.fraction or to_device.offset != ZERO or from_device.offset != ZERO:
        raise Contradiction("a velocity has a factor other than 0 and no offset")
    if abs(float(to_device.factor * from_device.factor) - 1) > AGREES:
        shown = f"{_shown(from_device.factor)} is not the inverse of {_shown(to_device.factor)}"
        raise Contradiction(f"{shown}; by CiA 402 0x60FF and 0x606C have one unit, and 0x6042 (vl) has another")
    unit = scale / to_device.factor
    if unit.fraction < 0:
        raise Contradiction("position and velocity have opposite signs")
    notes: list[str] = []
    return Keys({"velocity_unit": number_in_toml(unit, notes)}, tuple(notes))


def _shown(number: Exact) -> str:
    return f"{float(number):.10g}"
