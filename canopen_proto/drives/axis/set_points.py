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

from collections.abc import Mapping, MutableMapping
from typing import Final

from canopen_proto.datatypes import Value, range_of
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.drives.axis.sub_modes import Point, SubMode
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.machine import SECOND, Time
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

    def __init__(self, variable: Variable, store: MutableMapping[Mux, Value]) -> None:
        """variable: the object, as the drive's dictionary has it. store: the node's images."""
        self.mux = variable.mux
        self._variable = variable
        self._store = store
        self._least, self._greatest = range_of(variable.data_type) or _NO_RANGE

    @property
    def objects(self) -> tuple[Mux, ...]:
        """The objects that carry it, in the order in which SDO has to write them."""
        return (self.mux,)

    @property
    def number(self) -> int:
        """The present value of the image; 0 if it was never set."""
        value = self._store.get(self.mux, 0)
        return value if isinstance(value, int) else 0

    def check(self, number: int) -> None:
        """Raise ValueRangeError for a number that the drive's object cannot hold."""
        if type(number) is not int or not self._least <= number <= self._greatest:
            self._variable.encode(number)

    def put(self, number: int, velocity: float | None = None) -> None:
        """Set the image. Raises as `check`; the last number stays then. velocity: see `RecordSetPoint`; no use is made of it."""
        if type(number) is not int or not self._least <= number <= self._greatest:
            self._variable.encode(number)
        self._store[self.mux] = number


class RecordSetPoint(SetPoint):
    """The image of a data record of interpolated position mode that is more than a position; see sub_modes.py.

    number: the position of the last record, in counts.
    """

    __slots__ = ("_period", "_position", "_sub_mode", "_variables")

    def __init__(self, dictionary: ObjectDictionary, store: MutableMapping[Mux, Value], sub_mode: SubMode, period: Time) -> None:
        """period: ns between two records. Raises ObjectNotFound if the dictionary lacks an object of the record."""
        self._variables = [dictionary.variable(mux) for mux in sub_mode.objects]
        super().__init__(self._variables[0], store)
        self._sub_mode = sub_mode
        self._period = period
        self._position = 0

    @property
    def objects(self) -> tuple[Mux, ...]:
        return self._sub_mode.objects

    @property
    def number(self) -> int:
        return self._position

    def check(self, number: int) -> None:
        self._encoded(number, None)

    def put(self, number: int, velocity: float | None = None) -> None:
        """Set the images of the record. velocity: counts per second at that position; None: that of the step there."""
        values = self._encoded(number, velocity)
        for variable, value in zip(self._variables, values, strict=True):
            self._store[variable.mux] = value
        self._position = number

    def _encoded(self, number: int, velocity: float | None) -> tuple[int, ...]:
        if velocity is None:
            velocity = (number - self._position) * SECOND / self._period
        values = self._sub_mode.record(Point(number, velocity, self._period))
        for variable, value in zip(self._variables, values, strict=True):
            variable.encode(value)
        return values
