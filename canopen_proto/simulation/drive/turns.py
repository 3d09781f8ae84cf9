"""Positions of an axis without end: they begin again at the ends of 607Bh. Its track goes on.

A range whose lower end is not below its upper one counts as the range of INTEGER32.

Source: IEC 61800-7-201 (CiA 402-2), 607Bh, 60F2h; ETG.6010, table 78.
"""

from __future__ import annotations

import math

from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.positioning import RotaryDirection
from canopen_proto.simulation.drive.servo import Servo

_INT32 = 1 << 31


def shown_range(servo: Servo) -> tuple[int, int]:
    """Return the lowest position that is shown, and how many there are."""
    low, high = servo.parameter(objects.MIN_POSITION_RANGE_LIMIT), servo.parameter(objects.MAX_POSITION_RANGE_LIMIT)
    return (low, high - low + 1) if low < high else (-_INT32, 2 * _INT32)


def shown(servo: Servo, place: float) -> int:
    """Return the position that a place on the track has for the user."""
    low, count = shown_range(servo)
    return within(low, count, place - servo.zero)


def within(low: int, count: int, position: float) -> int:
    """Return a position as it is shown. low, count: as `shown_range` has them."""
    return (round(position) - low) % count + low


def place_of(servo: Servo, target: float, direction: RotaryDirection) -> float:
    """Return the place on the track of an absolute target, from the present demand."""
    low, count = shown_range(servo)
    here = servo.demand_position
    turns = math.floor((here - servo.zero - low) / count)
    place = target + servo.zero + turns * count
    if direction is RotaryDirection.LINEAR:
        return place
    up = (place - here) % count
    down = up - count if up else 0.0
    if direction is RotaryDirection.SHORTEST:
        direction = RotaryDirection.POSITIVE if up <= -down or not up else RotaryDirection.NEGATIVE
    return here + (up if direction is RotaryDirection.POSITIVE else down)
