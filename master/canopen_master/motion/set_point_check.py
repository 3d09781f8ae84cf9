"""The check of a set-point before it goes to a joint: for a chain, and for the blocking API."""

from __future__ import annotations

import math

from canopen_master.errors import SetPointRefusedError
from canopen_master.motion.device import Device
from canopen_proto.datatypes import ValueRangeError
from canopen_proto.drives.axis.limits import Excess
from canopen_proto.machine import LocalProtocolError, Time

NO_SCALE = ("give its scale: AxisSettings(counts_per_unit=...) in `axes`, 180_000 / math.pi for millidegrees on the wire",)
FINER = "a finer path, or more `cycles`"
FASTER = "a larger max_speed, if it may go as fast as that: AxisSettings(max_speed=...) in `axes`; `set_max_speed` of `direct`"
NARROWER = "a path within the limits of the joint: its `limits` tells them"


def check_set_point(device: Device, start: float, target: float, time: Time) -> int:
    """Return a set-point in counts. Raises SetPointRefusedError if it is beyond the `limits` of the joint, or does not fit its
    object.

    start: the set-point before. time: ns for the way from there to `target`.
    """
    axis = device.axis
    if not axis.scale.is_known:
        raise refused(device, target, "the joint has no scale: its unit is not known", NO_SCALE)
    if not math.isfinite(target):
        raise refused(device, target, "it is not a finite number")
    try:
        counts = axis.scale.to_counts(target)
        axis.set_points.check(counts)
    except (LocalProtocolError, ValueRangeError) as error:
        raise refused(device, target, str(error)) from error
    check_limits(device, start, target, time)
    return counts


def check_limits(device: Device, start: float, target: float, time: Time) -> None:
    """As `check_set_point`, for a set-point that is known to fit the drive's object."""
    excess = device.limits.excess(start, target, time)
    if excess is not None:
        raise refused(device, target, *_words(excess, start))


def refused(device: Device, target: float, seen: str, tries: tuple[str, ...] = ()) -> SetPointRefusedError:
    """The exception for a set-point of a joint. seen: why; tries: what to try. target: that set-point, in the user's unit."""
    return SetPointRefusedError(f"set-point {target} of {device.name} was refused", device.name, seen, tries)


def _words(excess: Excess, start: float) -> tuple[str, tuple[str, ...]]:
    """`seen` and `tries` of the error."""
    limit, source = f"{excess.limit.value:.6g}", excess.limit.source
    if excess.is_speed:
        return f"from {start:.6g} that is {excess.value:.6g} per second, more than {limit}: {source}", (FINER, FASTER)
    where = "above" if excess.value > excess.limit.value else "below"
    return f"it is {where} {limit}: {source}", (NARROWER,)
