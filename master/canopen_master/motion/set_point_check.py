"""The check of a set-point before it goes to a joint: for a chain, and for the blocking API."""

from __future__ import annotations

import math

from canopen_master.errors import SetPointRefusedError
from canopen_master.motion.device import Device
from canopen_proto.datatypes import ValueRangeError
from canopen_proto.drives.axis.limits import Excess
from canopen_proto.machine import LocalProtocolError, Time

NO_SCALE = "give its scale: {}, 180_000 / math.pi for millidegrees on the wire"
FASTER = "a larger max_speed, if it may go as fast as that: {}; `set_max_speed` of `direct`"
FINER = "a finer path, or more `cycles`"
NARROWER = "a path within the limits of the joint: its `limits` tells them"


def check_set_point(device: Device, start: float, target: float, time: Time) -> int:
    """Return a set-point in counts. Raises SetPointRefusedError if it is beyond the `limits` of the joint, or does not fit its
    object.

    start: the set-point before. time: ns for the way from there to `target`.
    """
    axis = device.axis
    if not axis.scale.is_known:
        raise refused(
            device,
            target,
            "the joint has no scale: its unit is not known",
            (NO_SCALE.format(setting_of(device, "counts_per_unit")),),
        )
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
        raise refused(device, target, *_words(device, excess, start))


def refused(device: Device, target: float, seen: str, tries: tuple[str, ...] = ()) -> SetPointRefusedError:
    """The exception for a set-point of a joint. seen: why; tries: what to try. target: that set-point, in the user's unit."""
    return SetPointRefusedError(f"set-point {target} of {device.name} was refused", device.name, seen, tries)


def setting_of(device: Device, key: str) -> str:
    """Return where a field of the joint's AxisSettings is given, for advice: in its machine file, or else in a program."""
    return f"AxisSettings({key}=...) in `axes`" if device.entry is None else f"{device.entry[0]}.{key} in {device.entry[1]}"


def _words(device: Device, excess: Excess, start: float) -> tuple[str, tuple[str, ...]]:
    """`seen` and `tries` of the error."""
    limit, source = f"{excess.limit.value:.6g}", excess.limit.source
    if excess.is_speed:
        return f"from {start:.6g} that is {excess.value:.6g} per second, more than {limit}: {source}", (
            FINER,
            FASTER.format(setting_of(device, "max_speed")),
        )
    where = "above" if excess.value > excess.limit.value else "below"
    return f"it is {where} {limit}: {source}", (NARROWER,)
