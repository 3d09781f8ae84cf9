"""Reading what a drive says of its limits; `canopen_proto.cia402.limits` says what they are for.

They are read by number, whatever the dictionary has: it may be that of another drive, and a limit that it lacks is one all the
same. An object that the drive does not have, or does not let us read, says nothing. Nor does 0x607D if its minimum is not below
its maximum (0 and 0 are none), an end of INTEGER32, or a speed or an acceleration of 0 or beyond INTEGER32.

Units. 0x607F is in velocity units, 0x6080 in motor revolutions per minute (CiA 402-2). Counts per motor revolution are feed
constant / gear ratio (0x6092, 0x6091), or, where the feed constant is the 1 that stands for none, the encoder's increments
(0x608F). A velocity unit is a count per second, unless the drive tells another one: in 0x60A9 (0xB4 is a revolution, 0xB5 an
increment; 0x03 a second, 0x47 a minute; the first byte a power of ten), or as the older 0x608C (0xA4 is rev/min, its power of ten
in 0x608B). A speed whose unit we do not know, or cannot convert, is left out.

Source: IEC 61800-7-201 (CiA 402-2), factor group; CiA 303-2 (units); all from memory, and as the files of four makers have them.
"""

from __future__ import annotations

from typing import Final

from canopen_proto.abort import AbortOrigin
from canopen_proto.cia402.axis import Axis
from canopen_proto.cia402.limits import DriveLimits, Limit, SetPointLimits, limits_of
from canopen_proto.procedures.steps import Procedure, SdoFailed, upload
from canopen_proto.remote_node import RemoteNode

_INTEGER32: Final = 1 << 31
_REVOLUTION, _INCREMENT = 0xB4, 0xB5
_SECONDS: Final = {0x03: 1, 0x47: 60}
_REVOLUTIONS_PER_MINUTE: Final = 0xA4
_OF_DRIVE: Final = "of the drive"


def read_limits(axis: Axis) -> Procedure[SetPointLimits]:
    """The limits of an axis, by its settings and by what its drive says. Raises SdoFailed where the drive does not answer."""
    node = axis.node
    lowest = yield from _read(node, 0x607D, 1, signed=True)
    highest = yield from _read(node, 0x607D, 2, signed=True)
    speeds = []
    profile = yield from _read_amount(node, 0x607F)
    if profile is not None:
        unit = yield from _velocity_unit(node)
        if unit is not None:
            speeds.append(Limit(profile * unit, f"0x607F {_OF_DRIVE}"))
    motor = yield from _read_amount(node, 0x6080)
    if motor is not None:
        counts = yield from _counts_per_revolution(node)
        if counts is not None:
            speeds.append(Limit(motor * counts / 60, f"0x6080 {_OF_DRIVE}"))
    acceleration = yield from _read_amount(node, 0x60C5)
    told = DriveLimits(
        *_position_limits(lowest, highest),
        min(speeds, default=None),
        None if acceleration is None else Limit(acceleration, f"0x60C5 {_OF_DRIVE}"),
    )
    return limits_of(axis, told)


def _position_limits(lowest: int | None, highest: int | None) -> tuple[Limit | None, Limit | None]:
    if lowest is not None and highest is not None and lowest >= highest:
        return None, None
    return (
        None if lowest is None or lowest <= -_INTEGER32 + 1 else Limit(lowest, f"0x607D:01 {_OF_DRIVE}"),
        None if highest is None or highest >= _INTEGER32 - 1 else Limit(highest, f"0x607D:02 {_OF_DRIVE}"),
    )


def _read(node: RemoteNode, index: int, subindex: int = 0, *, signed: bool = False) -> Procedure[int | None]:
    try:
        data = yield from upload(node.sdo, index, subindex)
    except SdoFailed as failed:
        if failed.origin is AbortOrigin.PEER:
            return None
        raise
    return int.from_bytes(data, "little", signed=signed) if 0 < len(data) <= 4 else None


def _read_amount(node: RemoteNode, index: int) -> Procedure[int | None]:
    """A limit that is an amount; None where it is none."""
    amount = yield from _read(node, index)
    return amount if amount is not None and 0 < amount < _INTEGER32 - 1 else None


def _read_ratio(node: RemoteNode, index: int) -> Procedure[float]:
    """Subindex 1 by subindex 2; 1, which changes nothing, where the drive has none."""
    numerator = yield from _read(node, index, 1)
    denominator = yield from _read(node, index, 2)
    return numerator / denominator if numerator and denominator else 1.0


def _counts_per_revolution(node: RemoteNode) -> Procedure[float | None]:
    """Counts on the wire for a turn of the motor; None if the drive does not tell."""
    feed = yield from _read_ratio(node, 0x6092)
    if feed > 1:
        gear = yield from _read_ratio(node, 0x6091)
        return feed / gear
    increments = yield from _read_ratio(node, 0x608F)
    return increments if increments > 1 else None


def _velocity_unit(node: RemoteNode) -> Procedure[float | None]:
    """Counts per second in one velocity unit; None if that cannot be told."""
    unit = yield from _read(node, 0x60A9)
    if unit:
        prefix, numerator, denominator, _ = unit.to_bytes(4, "big")
        power, is_revolution, seconds = prefix, numerator == _REVOLUTION, _SECONDS.get(denominator)
        if seconds is None or numerator not in (_REVOLUTION, _INCREMENT):
            return None
    else:
        dimension = yield from _read(node, 0x608C)
        if not dimension:
            return 1.0
        if dimension & 0xFF != _REVOLUTIONS_PER_MINUTE:
            return None
        power = (yield from _read(node, 0x608B)) or 0
        is_revolution, seconds = True, 60
    counts = (yield from _counts_per_revolution(node)) if is_revolution else 1.0
    exponent = power - 256 if power & 0x80 else power
    return None if counts is None else counts / seconds * 10.0**exponent
