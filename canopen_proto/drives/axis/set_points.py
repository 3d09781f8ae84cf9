"""`AxisSetPoints`: what a drive is given at each SYNC, in each cyclic mode, and in slow pp: its set-points and offsets.

Each cyclic mode has its own object, and the RPDO behind the next SYNC takes its image along: `set_position` (ip and csp; `select`
says which), `set_velocity` (csv), `set_torque` (cst), `set_offsets`.

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
from canopen_proto.dictionary.standard import standard_variable
from canopen_proto.drives.axis.axis_node import AxisNode, rpdos_with
from canopen_proto.drives.axis.scale import Scale
from canopen_proto.drives.axis.sub_modes import PositionAndVelocity, RecordPoint, SubMode
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.machine import SECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux, mux_text

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
    def sub_mode(self) -> SubMode | None:
        """What makes the record; None if it is a position alone."""
        return None

    @property
    def number(self) -> int:
        """The present value of the image; 0 if it was never set."""
        value = self._store.get(self.mux, 0)
        return value if isinstance(value, int) else 0

    @property
    def reach(self) -> tuple[int, int] | None:
        """The least and the greatest number that the drive's object can hold; None if it holds no integer."""
        return range_of(self._variable.data_type)

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
        """period: ns between two records. Raises ObjectNotFoundError if the dictionary lacks an object of the record."""
        self._variables = [dictionary.variable(mux) for mux in sub_mode.objects]
        super().__init__(self._variables[0], store)
        self._sub_mode = sub_mode
        self._period = period
        self._position = 0

    @property
    def objects(self) -> tuple[Mux, ...]:
        return self._sub_mode.objects

    @property
    def reach(self) -> tuple[int, int] | None:
        """The lowest and the highest position, counts, that 0x60C1:01 can hold; None for a record without this object."""
        found = [each for each in self._variables if each.mux == objects.INTERPOLATION_SET_POINT]
        return range_of(found[0].data_type) if found else None

    @property
    def sub_mode(self) -> SubMode | None:
        return self._sub_mode

    @property
    def number(self) -> int:
        return self._position

    def check(self, number: int) -> None:
        self._encoded(number, None)

    def put(self, number: int, velocity: float | None = None) -> None:
        """Set the images of the record. velocity: counts per second at that position; None: that of the step there. number: the
        position, counts."""
        values = self._encoded(number, velocity)
        for variable, value in zip(self._variables, values, strict=True):
            self._store[variable.mux] = value
        self._position = number

    def _encoded(self, number: int, velocity: float | None) -> tuple[int, ...]:
        if velocity is None:
            velocity = (number - self._position) * SECOND / self._period
        values = self._sub_mode.record(RecordPoint(number, velocity, self._period))
        for variable, value in zip(self._variables, values, strict=True):
            variable.encode(value)
        return values


class AxisSetPoints:
    """The set-points of one axis; see this module's text. given: how many velocities and torques were set so far."""

    def __init__(self, node: AxisNode, scale: Scale, title: str) -> None:
        """title: of the drive, for messages. scale: between the user's units and those of the wire."""
        self.given = 0
        self._node = node
        self._scale = scale
        self._title = title
        self._store = node.values.store
        self._images: dict[Mux, SetPoint] = {}
        self._position = SetPoint(standard_variable(0x607A), self._store)  # of a drive without position set-points
        for mode in (Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.INTERPOLATED_POSITION):
            if SET_POINT_OF[mode] in node.dictionary:
                self.select(mode)
        for mux in SET_POINT_OF.values():
            node.keep_commanded(mux)

    def select(self, mode: int) -> None:
        """Make position set-points go into the object of this mode: 0x60C1:01 in ip, 0x607A in csp and pp.

        0x60C1:01 is the one from the beginning, if the dictionary has it. The image of the other one is left as it is. A mode
        without position set-points changes nothing. `select_record` is for sub-modes of ip that are not linear.
        """
        if mode in (Mode.PROFILE_POSITION, Mode.INTERPOLATED_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION):
            self._position = self._image_of(SET_POINT_OF[mode])

    def select_record(self, sub_mode: SubMode, period: Time) -> None:
        """Make position set-points go into data records of ip. period: ns between two of them. sub_mode: which objects a record
        has."""
        if sub_mode.objects == (objects.INTERPOLATION_SET_POINT,):
            self.select(Mode.INTERPOLATED_POSITION)
        else:
            self._position = RecordSetPoint(self._node.dictionary, self._store, sub_mode, period)
            for mux in sub_mode.objects:
                self._node.keep_commanded(mux)

    def _image_of(self, mux: Mux) -> SetPoint:
        found = self._images.get(mux)
        if found is None:
            found = self._images[mux] = SetPoint(self._node.dictionary.variable(mux), self._store)
        return found

    @property
    def position(self) -> float:
        """The position that the next RPDO commands, in the user's unit."""
        return self._scale.from_counts(self._position.number)

    @property
    def counts(self) -> int:
        """The position that the next RPDO commands, in counts."""
        return self._position.number

    @property
    def objects(self) -> tuple[Mux, ...]:
        """The objects that take position set-points, in the order in which SDO has to write them."""
        return self._position.objects

    def set_position(self, position: float, velocity: float | None = None) -> None:
        """Set the next set-point of interpolated and cyclic synchronous position mode; the RPDO behind the next SYNC carries it.

        velocity: at which the axis passes it, per second, for sub-modes of ip whose records have one; None: that of the step from
        the set-point before. Raises ValueRangeError if the drive's object cannot hold it; the last set-point stays then.
        """
        counts_per_second = None if velocity is None else self._scale.way_to_counts(velocity)
        self._position.put(self._scale.to_counts(position), counts_per_second)

    def set_position_counts(self, counts: int, velocity: float | None = None) -> None:
        """Set the next set-point in counts, the velocity in counts per second; else as `set_position`."""
        if velocity is None:
            self._position.put(counts)
        else:
            self._position.put(counts, velocity)

    @property
    def reach(self) -> tuple[int, int] | None:
        """The least and the greatest position, in counts, that the object of the drive can hold; None if it holds no integer."""
        return self._position.reach

    @property
    def velocity_reach(self) -> tuple[Mux, float] | None:
        """The object of the velocity that goes along with position set-points, and the greatest speed that it can hold, in counts
        per second; None if no velocity goes along, or nothing is known of it."""
        sub_mode = self._position.sub_mode
        if sub_mode is None:
            mux, unit = objects.VELOCITY_OFFSET, self._scale.velocity_unit
            if unit is None or not rpdos_with(self._node, (mux,)):
                return None
        elif isinstance(sub_mode, PositionAndVelocity):
            mux, unit = objects.INTERPOLATION_VELOCITY, sub_mode.velocity_unit
        else:
            return None
        least, most = range_of(self._node.dictionary.variable(mux).data_type) or _NO_RANGE
        greatest = min(-least, most) * unit
        return (mux, greatest) if greatest > 0.0 else None

    def check(self, counts: int) -> None:
        """Raise ValueRangeError for a position, in counts, that the object of the drive cannot hold."""
        self._position.check(counts)

    def set_velocity(self, velocity: float) -> float:
        """Set the next set-point of cyclic synchronous velocity mode (0x60FF), in the user's unit per second.

        Returns the velocity that the drive is given: `velocity`, rounded to its velocity unit. Raises LocalProtocolError if that
        unit is not known; ValueRangeError if 0x60FF cannot hold it; the last set-point stays then.
        """
        number = self._scale.velocity_to_wire(velocity)
        self._image_of(objects.TARGET_VELOCITY).put(number)
        self.given += 1
        return self._scale.velocity_from_wire(number)

    def set_torque(self, torque: float) -> float:
        """Set the next set-point of cyclic synchronous torque mode (0x6071), as a share of the rated torque.

        Returns the torque that the drive is given: `torque`, rounded to a thousandth. Raises as `set_velocity`.
        """
        number = self._scale.torque_to_wire(torque)
        self._image_of(objects.TARGET_TORQUE).put(number)
        self.given += 1
        return self._scale.torque_from_wire(number)

    def set_offsets(self, *, position: float = 0.0, velocity: float = 0.0, torque: float = 0.0) -> None:
        """Set what the drive adds to its set-points from the next RPDO on: 0x60B0, 0x60B1, 0x60B2 (feed-forward).

        Units as those of the set-points; position: a way. The values are rounded to the wire's units. Raises LocalProtocolError,
        with nothing changed, for an offset other than 0 that no RPDO carries, or whose unit is not known; ValueRangeError.
        """
        numbers = {
            objects.POSITION_OFFSET: round(self._scale.way_to_counts(position)),
            objects.VELOCITY_OFFSET: self._scale.velocity_to_wire(velocity) if velocity else 0,
            objects.TORQUE_OFFSET: self._scale.torque_to_wire(torque),
        }
        carried = [mux for mux in numbers if rpdos_with(self._node, (mux,))]
        for mux, number in numbers.items():
            if number and mux not in carried:
                raise LocalProtocolError(
                    f"no RPDO that is exchanged with {self._title} carries the offset {mux_text(mux)}. "
                    "Try: procedures.configure_pdo, with this object in the mapping"
                )
            if mux in carried:
                self._image_of(mux).check(number)
        for mux in carried:
            self._image_of(mux).put(numbers[mux])
