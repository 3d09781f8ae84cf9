"""`Sample`: the positions, velocities and efforts of all joints at one time, in SI units; and the units of joints."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from canopen_master.errors import ChainError
from canopen_master.motion.device import Device
from canopen_proto.drives.axis.settings import SCHUNK_POWERBALL, AxisSettings, HomingStyle
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE
from canopen_proto.machine import MILLISECOND, Time

NO_UNIT: Final = "CO325"
"""A joint has no unit that ROS knows."""

SI: Final = {Unit.RADIAN: 1.0, Unit.DEGREE: math.pi / 180, Unit.TURN: 2 * math.pi, Unit.MILLIMETRE: 0.001}
"""Radians, or metres, in each unit of a joint."""

STALE: Final = 500 * MILLISECOND
"""A joint that was not heard for so long is left out of a sample: an old position must not look like a new one."""


class Sample(NamedTuple):
    """The joints that were heard lately, each with its position; a value for each joint in every other field, or none at all.

    names: of the joints. positions: rad or m. velocities: rad/s or m/s. efforts: N·m (as the drives tell their rated torques).
    stamp: when the oldest of these positions was received, in ns since 1970.
    """

    names: tuple[str, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...]
    efforts: tuple[float, ...]
    stamp: int


def si_per_unit(device: Device) -> float:
    """Return the radians, or metres, in one unit of a joint. Raises ChainError for a joint whose unit is not known (yet)."""
    settings = device.axis.settings
    unit = Unit.RADIAN if settings.unit is None and _is_powerball(settings) else settings.unit
    if unit is None or not device.axis.scale.is_known:
        raise _no_unit(device)
    return SI[unit]


def is_unit_missing(settings: AxisSettings) -> bool:
    """Return whether a joint with these settings can never have a unit that ROS knows: its scale is given, its unit is not."""
    return settings.unit is None and settings.counts_per_unit is not None and not _is_powerball(settings)


def _is_powerball(settings: AxisSettings) -> bool:
    """Return whether the unit is the radian without being named: see `AxisSettings.of_vendor`."""
    return settings.homing is HomingStyle.SCHUNK and settings.counts_per_unit == SCHUNK_POWERBALL.counts_per_unit


def _no_unit(device: Device) -> ChainError:
    is_named = device.axis.settings.unit is not None
    missing = "its drive does not tell its scale" if is_named else "it has no unit, and ROS wants radians or metres"
    keys = f"[joints.{device.name}] counts_per_turn = ..." if is_named else f'[joints.{device.name}] unit = "degree", or {_UNITS}'
    if not device.axis.is_identified:
        missing += ", or it has not been asked yet"
    failed = f"positions of {device.where} cannot be converted"
    return ChainError(NO_UNIT, "", failed, joint=device.name, seen=missing, tries=(f"in the machine file: {keys}", "init, once"))


_UNITS: Final = ", ".join(f'"{unit}"' for unit in Unit if unit is not Unit.DEGREE)


def sample_of(devices: Iterable[Device], now: Time, wall: int) -> Sample:
    """Return what was heard of these joints. now: of the master, in ns; wall: the same moment in ns since 1970.

    A joint without a unit, and one that was not heard for STALE, is left out.
    """
    names: list[str] = []
    positions: list[float] = []
    velocities: list[float | None] = []
    efforts: list[float | None] = []
    oldest = now
    for device in devices:
        heard = device.axis.node.heard_at.get(POSITION_ACTUAL_VALUE)
        position = device.position
        if heard is None or position is None or now - heard > STALE:
            continue
        try:
            scale = si_per_unit(device)
        except ChainError:
            continue
        velocity = device.velocity
        names.append(device.name)
        positions.append(position * scale)
        velocities.append(None if velocity is None else velocity * scale)
        efforts.append(_effort(device))
        oldest = min(oldest, heard)
    return Sample(tuple(names), tuple(positions), _known(velocities), _known(efforts), wall - (now - oldest))


def _effort(device: Device) -> float | None:
    share, rated = device.torque, device.axis.scale.units.rated_torque
    return None if share is None or rated is None else share * rated


def _known(values: Sequence[float | None]) -> tuple[float, ...]:
    """Return the values, or none of them if one is not known."""
    known = tuple(value for value in values if value is not None)
    return known if len(known) == len(values) else ()
