"""The objects that carry a drive's set-points and offsets, one a SYNC, in each cyclic mode, and in slow pp.

    mode        set-point              offsets that the drive adds to it
    pp          607A    position       -      (a target of the drive's own profile; see slow_position.py)
    ip          60C1:01 position       -
    csp         607A    position       60B0 position, 60B1 velocity, 60B2 torque (feed-forward)
    csv         60FF    velocity       60B1 velocity, 60B2 torque
    cst         6071    torque         60B2 torque

On the wire a position is in counts, a velocity in the drive's velocity unit (`DriveUnits.per_velocity`), a torque in thousandths
of the rated torque (0x6076).

Source: IEC 61800-7-201 (CiA 402-2): cyclic synchronous position, velocity and torque mode; interpolated position mode.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from canopen_proto.cia402 import objects
from canopen_proto.cia402.modes import Mode
from canopen_proto.datatypes import Value, range_of
from canopen_proto.dictionary import Variable
from canopen_proto.multiplexer import Mux

SET_POINT_OF: Final[Mapping[int, Mux]] = {
    Mode.PROFILE_POSITION: objects.TARGET_POSITION,
    Mode.INTERPOLATED_POSITION: objects.INTERPOLATION_SET_POINT,
    Mode.CYCLIC_SYNCHRONOUS_POSITION: objects.TARGET_POSITION,
    Mode.CYCLIC_SYNCHRONOUS_VELOCITY: objects.TARGET_VELOCITY,
    Mode.CYCLIC_SYNCHRONOUS_TORQUE: objects.TARGET_TORQUE,
}
"""Mode -> the object that takes its set-points."""

OFFSETS_OF: Final[Mapping[int, tuple[Mux, ...]]] = {
    Mode.INTERPOLATED_POSITION: (),
    Mode.CYCLIC_SYNCHRONOUS_POSITION: (objects.POSITION_OFFSET, objects.VELOCITY_OFFSET, objects.TORQUE_OFFSET),
    Mode.CYCLIC_SYNCHRONOUS_VELOCITY: (objects.VELOCITY_OFFSET, objects.TORQUE_OFFSET),
    Mode.CYCLIC_SYNCHRONOUS_TORQUE: (objects.TORQUE_OFFSET,),
}
"""Mode -> the objects that the drive adds to its set-points."""

_NO_RANGE: Final = (1, 0)
"""Of an object that holds no integer: each set-point is encoded to see whether it fits."""


class SetPoint:
    """The image of one set-point: the number on the wire that the next RPDO takes along."""

    __slots__ = ("_greatest", "_least", "_store", "_variable", "mux")

    def __init__(self, variable: Variable, store: dict[Mux, Value]) -> None:
        """variable: the object, as the drive's dictionary has it. store: the node's images."""
        self.mux = variable.mux
        self._variable = variable
        self._store = store
        self._least, self._greatest = range_of(variable.data_type) or _NO_RANGE

    @property
    def number(self) -> int:
        """The present value of the image; 0 if it was never set."""
        value = self._store.get(self.mux, 0)
        return value if isinstance(value, int) else 0

    def check(self, number: int) -> None:
        """Raise ValueRangeError for a number that the drive's object cannot hold."""
        if type(number) is not int or not self._least <= number <= self._greatest:
            self._variable.encode(number)

    def put(self, number: int) -> None:
        """Set the image. Raises as `check`; the last number stays then."""
        if type(number) is not int or not self._least <= number <= self._greatest:
            self._variable.encode(number)
        self._store[self.mux] = number
