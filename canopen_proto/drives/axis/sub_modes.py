"""Sub-modes of interpolated position (0x60C0): how a point of the path becomes the data record of a drive.

The standard knows one, linear interpolation (0): a record is a position. All others are makers' own, with numbers below 0, and
the same number means different things:

    -1   position and velocity, cubic (Infranor, Parker); a record of 64 bits with position, velocity and time (Technosoft)
    -2   position alone, cubic (Infranor, Parker); position, velocity, time (Kollmorgen); linear, without buffer (Festo)

So a sub-mode is never chosen by its number: the user passes a `SubMode` to `start_interpolation`. docs/extending.md shows how to
write one.

Source: IEC 61800-7-201 (CiA 402-2), interpolation sub mode select 60C0h, interpolation data record 60C1h; the makers' manuals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import Time
from canopen_proto.multiplexer import Mux


class RecordPoint(NamedTuple):
    """A point of the path. position: counts. velocity: counts per second at this point. time: ns from the point before."""

    position: int
    velocity: float
    time: Time


class SubMode(Protocol):
    """Makes data records of points; see this module's text. It keeps no state of a drive: one may serve several drives."""

    @property
    def number(self) -> int:
        """The value of 0x60C0."""

    @property
    def objects(self) -> tuple[Mux, ...]:
        """The objects of a record, in the order in which SDO has to write them: the last one completes it.

        Each must be carried by an RPDO. Among RPDOs, and within one, the drive's mapping decides the order.
        """

    def record(self, point: RecordPoint) -> tuple[int, ...]:
        """Return the values of `objects`, as they go on the wire. point: counts, and counts per second."""


@dataclass(frozen=True, slots=True)
class Linear:
    """Linear interpolation, the standard's own: a record is a position."""

    number: int = 0
    objects: tuple[Mux, ...] = (objects.INTERPOLATION_SET_POINT,)

    def record(self, point: RecordPoint) -> tuple[int, ...]:
        return (point.position,)


@dataclass(frozen=True, slots=True)
class PositionAndVelocity:
    """A record of a position (0x60C1:01) and the velocity at which it is passed (:02), as Infranor and Parker have it.

    velocity_unit: counts per second in one unit of 0x60C1:02.
    """

    velocity_unit: float = 1.0
    number: int = -1
    objects: tuple[Mux, ...] = (objects.INTERPOLATION_SET_POINT, objects.INTERPOLATION_VELOCITY)

    def record(self, point: RecordPoint) -> tuple[int, ...]:
        return point.position, round(point.velocity / self.velocity_unit)


LINEAR: Final = Linear()
