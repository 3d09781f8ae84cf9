"""`Axis`: the master's side of one CiA 402 drive. It holds what is known of the drive, and the one image of its controlword.

An Axis stands on a `RemoteNode` and adds meaning to its values: state, mode, position in the user's unit. Its sequences (enable,
homing, interpolation) are procedures, in `canopen_proto.drives.axis`.

**One controlword image per axis.** It is the node's own image of 0x6040, from which RPDOs are built. While a live RPDO carries
0x6040, a command goes into the image, and that PDO sends it. Otherwise the command goes by SDO. A confirmed SDO write sets the
image too: else the next RPDO would send a stale 0 and take the drive out of operation.

Units: the user sees positions in the user's unit (radians for an arm). On the wire they are counts (millidegrees for the Schunk
arm). counts = round(direction * unit * counts_per_unit) + offset. Without a scale, the user sees counts too. The drive's velocity
unit is that of `units`, or of the settings; torques are shares of the rated torque (0x6076), with the sign of `direction`.

**Set-points** (set_points.py). Each cyclic mode has its own object, and the RPDO behind the next SYNC takes its image along:
`set_position` (ip and csp; `select_set_point` says which), `set_velocity` (csv), `set_torque` (cst), `set_offsets`.

**Kind of drive.** A drive is a CiA 402 drive unless the user or its vendor-ID (0x1018:01) says Schunk.
`drive.identity.identify` reads the vendor-ID once, and fills in the settings that are None. 0x6502 decides nothing.

**Reference.** A drive that boots after this master homed it counts as not homed: it may have lost its power, and its positions
may mean something else. It `has_lost_reference` until it is homed again. Until then absolute set-points are refused
(`drive.ReferenceLost`), unless the settings say that the drive keeps its reference. A drive that this master never homed
has no reference to lose.

**A drive may act late.** A command that was not answered in time may still act at any later moment. The axis remembers that
(`unanswered`), and `settle` ends it: the drive is led to another state, and has to show it. A drive obeys its commands in their
order, so none is left from before then. While none is left, `answer_time` is the time that the drive took to show the state that
it was last led to, and a drive that takes long is given more time: `reaction_time`. It keeps that time while something is left.

Events: `AxisStateChanged` when a statusword shows another state, or when the node boots (the state is UNKNOWN then).

Source: IEC 61800-7-201 (CiA 402-2).
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final

from canopen_proto.dictionary.standard import standard_variable
from canopen_proto.drives.axis.axis_node import node_of_axis
from canopen_proto.drives.axis.axis_state import AxisGrip as AxisGrip
from canopen_proto.drives.axis.axis_state import AxisStateChanged as AxisStateChanged
from canopen_proto.drives.axis.foreign import COMMANDS, foreign_command
from canopen_proto.drives.axis.occupancy import Occupancy
from canopen_proto.drives.axis.set_points import SET_POINT_OF, RecordSetPoint, SetPoint
from canopen_proto.drives.axis.settings import MILLIDEGREES_PER_RADIAN as MILLIDEGREES_PER_RADIAN
from canopen_proto.drives.axis.settings import SCHUNK_POWERBALL as SCHUNK_POWERBALL
from canopen_proto.drives.axis.settings import AxisSettings as AxisSettings
from canopen_proto.drives.axis.settings import HomingStyle as HomingStyle
from canopen_proto.drives.axis.sub_modes import SubMode
from canopen_proto.drives.axis.units import DriveUnits
from canopen_proto.drives.axis.view import DriveView
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.axes import axis_of
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import FAULT_STATES, State, state_of
from canopen_proto.machine import NEVER, Event, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux, mux_text
from canopen_proto.remote_node import FRESH, RemoteNode

_OPEN: Final = AxisSettings()
_EXACT: Final = 1 + 1e-12
"""So that a whole number is not rounded down to the next one, because of the rounding of floating point."""
OBEYED: Final = -NEVER
"""`Axis.started_at` of a drive that has obeyed every start."""


class Axis:
    """One drive as its master sees it; see this module's text. Properties show what was heard; they send nothing.

    number: of the axis, 0 for the first one of a node. node: as this axis sees it, with the numbers of the first axis
    (axis_node.py); remote: the node itself. settings: those in force; open ones are filled in once `is_identified`; may be
    set. has_scale: whether the user's unit is known; else it is the count. units: as the drive told them when they were last
    read. grip: takes hold before the drive is enabled, and lets go once it is shut down. started_at: when the drive last got
    a rising bit 4 of the controlword, which starts a motion; OBEYED once the drive has shown that it took it. selected_mode:
    the mode of operation that this master selected last; None: none since the drive's last boot. unanswered: what the drive
    was told and did not answer in time, in words; "": nothing. answer_time: ns, see above; None: not known. commanded_at,
    selected_at: when this master last sent a controlword, and a mode; None: not since then. has_opened_brake: whether this
    master holds the brake open by an output, see digital_io.py. occupancy: the motion under way, see one_motion.py.
    """

    __slots__ = (
        "_direction", "_given", "_heard_at", "_is_homed", "_offset", "_position", "_scale", "_set_points", "_settings",
        "_shown", "_store", "_was_answer_time", "_was_homed", "answer_time", "commanded_at", "grip", "has_opened_brake",
        "has_scale", "is_identified", "node", "number", "occupancy", "remote", "selected_at", "selected_mode", "set_points_given",
        "started_at", "state", "unanswered", "units",
    )  # fmt: skip

    def __init__(self, node: RemoteNode, settings: AxisSettings = _OPEN, number: int = 0) -> None:
        """Make axis `number` (0..7) of a node. Raises LocalProtocolError if its dictionary lacks an object that it needs."""
        self.number = number
        self.remote = node
        self.node = node_of_axis(node, number)
        for key in (objects.CONTROLWORD, objects.STATUSWORD, objects.MODES_OF_OPERATION, objects.MODES_OF_OPERATION_DISPLAY):
            self.node.dictionary.variable(key)
        self._store, self._heard_at = self.node.values.store, self.node.heard_at  # as near as can be: looked at for each PDO
        self.settings = self._given = settings
        self.is_identified = False
        self.state = State.UNKNOWN
        self._shown: int | None = None  # the statusword that `state` was taken from
        self._is_homed = self._was_homed = False
        self.grip: AxisGrip | None = None
        self.started_at: Time = OBEYED
        self.unanswered = ""
        self.answer_time: Time | None = None
        self._was_answer_time: Time = 0  # the last one that was known
        self.selected_mode: int | None = None
        self.commanded_at: Time | None = None
        self.selected_at: Time | None = None
        self.has_opened_brake = False
        self.occupancy = Occupancy()
        self.units = DriveUnits()
        self._set_points: dict[Mux, SetPoint] = {}
        self.set_points_given = 0
        self._position = SetPoint(standard_variable(0x607A), self._store)  # of a drive without position set-points
        for mode in (Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.INTERPOLATED_POSITION):
            if SET_POINT_OF[mode] in self.node.dictionary:
                self.select_set_point(mode)
        self._command(objects.CONTROLWORD, *SET_POINT_OF.values())
        self.node.foreign_writes.listen(COMMANDS)
        self.node.add_listener(self._on_values, self._on_boot)

    @property
    def title(self) -> str:
        """The drive for messages: "drive 5", and "drive 5, axis 1" for a further axis of a node."""
        return f"drive {self.node.node_id}" + (f", axis {self.number}" if self.number else "")

    @property
    def settings(self) -> AxisSettings:
        """See the class."""
        return self._settings

    @settings.setter
    def settings(self, settings: AxisSettings) -> None:
        self._settings = settings
        self._direction, self._offset = settings.direction, settings.offset
        self.has_scale = settings.counts_per_unit is not None
        self._scale = 1.0 if settings.counts_per_unit is None else settings.counts_per_unit

    @property
    def reaction_time(self) -> Time:
        """ns until what the drive shows answers the last command: that of the settings, or more for a drive that answers late."""
        return max(self._settings.reaction_time, 2 * (self.answer_time or self._was_answer_time))

    def leave_unanswered(self, what: str) -> None:
        """Remember that the drive did not answer this in time. What was left before counts on."""
        self._was_answer_time = self.answer_time or self._was_answer_time
        self.unanswered, self.answer_time = self.unanswered or what, None

    @property
    def statusword(self) -> int:
        """0x6041 as last heard; 0 if it never was: `state` is UNKNOWN then."""
        return self._int(objects.STATUSWORD)

    @property
    def controlword(self) -> int:
        """The image of 0x6040: what the drive was last commanded."""
        return self._int(objects.CONTROLWORD)

    @property
    def mode(self) -> int | None:
        """0x6061, the active mode of operation, as last heard; None if it never was."""
        return self._heard(objects.MODES_OF_OPERATION_DISPLAY)

    @property
    def error_code(self) -> int:
        """0x603F as last heard, 0 for none."""
        return self._int(objects.ERROR_CODE)

    @property
    def position(self) -> float | None:
        """0x6064 as last heard, in the user's unit (counts without a scale); None if it never was since the node's last boot."""
        counts = self.position_counts
        return None if counts is None else self.from_counts(counts)

    @property
    def position_counts(self) -> int | None:
        """0x6064 as last heard, in counts; None if it never was since the node's last boot."""
        return self._heard(objects.POSITION_ACTUAL_VALUE)

    @property
    def velocity(self) -> float | None:
        """0x606C as last heard, in the user's unit per second; None if it never was."""
        counts = self.velocity_counts
        return None if counts is None else self.velocity_from_wire(counts)

    @property
    def velocity_counts(self) -> int | None:
        """0x606C as last heard, in the drive's own unit; None if it never was since the node's last boot."""
        return self._heard(objects.VELOCITY_ACTUAL_VALUE)

    @property
    def torque(self) -> float | None:
        """0x6077 as last heard, as a share of the rated torque (0.5 is half of it); None if it never was.

        Its sign is that of the user's direction, as that of positions and velocities.
        """
        per_mille = self._heard(objects.TORQUE_ACTUAL_VALUE)
        return None if per_mille is None else self._direction * per_mille / 1000

    @property
    def has_fault(self) -> bool:
        """Whether the drive is in Fault or on its way there."""
        return self.state in FAULT_STATES

    @property
    def is_homed(self) -> bool:
        """Whether this master homed the drive since it was switched on; `drive.home` sets it."""
        return self._is_homed

    @is_homed.setter
    def is_homed(self, is_homed: bool) -> None:
        self._is_homed = is_homed
        self._was_homed = self._was_homed or is_homed

    @property
    def has_lost_reference(self) -> bool:
        """Whether this master homed the drive, and the reference is lost: a reset, or a later homing that failed."""
        return self._was_homed and not self._is_homed and not self.settings.keeps_reference

    def is_told_by(self, report: Event) -> bool:
        """Return whether an event with a field `axis`, such as AxisStateChanged, is about this axis."""
        return report.node_id == self.node.node_id and getattr(report, "axis", None) == self.number

    def fresh_statusword(self, now: Time, not_before: Time = -NEVER) -> int | None:
        """Return 0x6041 if it was heard at `not_before` or later and is not older than FRESH (100 ms), else None."""
        heard = self.node.heard_at.get(objects.STATUSWORD)
        if heard is None or heard < not_before or now - heard > FRESH:
            return None
        return self._int(objects.STATUSWORD)

    def view(self) -> DriveView:
        """Return what was heard from the drive, and what it was commanded; nothing is read."""
        producer = self.node.rpdo_of(objects.CONTROLWORD)
        commanded = None if self.commanded_at is None else self.controlword
        return DriveView(
            self.statusword,
            mode=self.mode,
            error_code=self.error_code,
            position=self.position_counts,
            inputs=self._heard(objects.DIGITAL_INPUTS),
            supported_modes=self._heard(objects.SUPPORTED_DRIVE_MODES),
            nmt_state=self.node.nmt_state,
            controlword=commanded,
            commanded=commanded,
            selected_mode=self.selected_mode,
            wanted_mode=self.selected_mode,
            rpdo=None if producer is None else producer.number,
            emcy=self.node.emcy.last,
            has_lost_reference=self.has_lost_reference,
            safe_torque_off=self._if_shown(self._settings.sto_input),
            brake=self._if_shown(self._settings.brake_bit),
            foreign=foreign_command(self.node, self.remote, commanded, self.commanded_at, self.selected_mode, self.selected_at),
            is_heard=objects.STATUSWORD in self._heard_at,
        )

    def describe(self) -> str:
        """Return one line for people: see `DriveView.describe`."""
        return self.view().describe()

    def identify(self, vendor_id: int | None) -> None:
        """Fill in open settings (None) by the drive's vendor-ID (None: it has none). Later calls change nothing."""
        if not self.is_identified:
            self.settings, self.is_identified = self._given.of_vendor(vendor_id), True

    def check_settings(self, wanted: AxisSettings) -> None:
        """Raise LocalProtocolError, naming the differences, unless these settings are those in force or those first given."""
        if wanted not in (self.settings, self._given):
            difference = self.settings.difference(wanted)
            raise LocalProtocolError(f"{self.title} is in use with other settings: {difference}")

    def to_counts(self, position: float) -> int:
        """Convert a position in the user's unit to counts on the wire. Raises LocalProtocolError unless they are a number."""
        try:
            return round(self._direction * position * self._scale) + self._offset
        except (ValueError, OverflowError):
            raise LocalProtocolError(f"a position must be a finite number; it is {position!r}") from None

    def from_counts(self, counts: float) -> float:
        """Convert counts on the wire to a position in the user's unit."""
        return self._direction * (counts - self._offset) / self._scale

    def way_from_counts(self, counts: float) -> float:
        """Convert the difference of two positions from counts to the user's unit."""
        return self._direction * counts / self._scale

    def amount_from_counts(self, counts: float) -> float:
        """Convert an amount, such as a speed, from counts to the user's unit."""
        return counts / self._scale

    def counts_of_amount(self, amount: float) -> float:
        """Convert an amount, such as a speed, from the user's unit to counts."""
        return amount * self._scale

    @property
    def velocity_unit(self) -> float | None:
        """Counts per second in one velocity unit of the drive; None if it is not known."""
        return self.units.per_velocity if self._settings.velocity_unit is None else self._settings.velocity_unit

    @property
    def acceleration_unit(self) -> float | None:
        """Counts per second² in one acceleration unit of the drive; None if it is not known."""
        given = self._settings.acceleration_unit
        return self.units.acceleration_unit(self.velocity_unit) if given is None else given

    def velocity_to_wire(self, velocity: float) -> int:
        """Convert a velocity in the user's unit per second to the drive's velocity unit, rounded to a whole number.

        Raises LocalProtocolError if that unit is not known: `drive.learn_units` asks the drive.
        """
        unit = self.velocity_unit
        if unit is None:
            raise LocalProtocolError(
                f"the velocity unit of {self.title} is not known, so it gets no velocity. "
                "Try: AxisSettings(velocity_unit=...), in counts per second, by its manual"
            )
        return round(self._direction * velocity * self._scale / unit)

    def speed_to_wire(self, speed: float) -> int:
        """Convert a speed of a profile (0 or more) to the drive's velocity unit, rounded down. Raises as `velocity_to_wire`."""
        self.velocity_to_wire(0.0)
        return math.floor(speed * self._scale / (self.velocity_unit or 1.0) * _EXACT)

    def rate_to_wire(self, rate: float) -> int:
        """Convert an acceleration (0 or more) in the user's unit per second² to the drive's unit, rounded down. Raises
        LocalProtocolError as `velocity_to_wire`, unless the settings name the acceleration unit."""
        unit = self.acceleration_unit
        if unit is None:
            origin = self.units.origins.get("per_acceleration")
            if origin is None:
                return self.speed_to_wire(rate)
            raise LocalProtocolError(
                f"the acceleration unit of drive {self.node.node_id} cannot be converted ({origin}), so it gets no acceleration. "
                "Try: AxisSettings(acceleration_unit=...), in counts per second², by its manual"
            )
        return math.floor(rate * self._scale / unit * _EXACT)

    def velocity_from_wire(self, number: float) -> float:
        """Convert a velocity in the drive's unit (a count per second if it is not known) to the user's unit per second."""
        return self.way_from_counts(number * (self.velocity_unit or 1.0))

    def torque_to_wire(self, torque: float) -> int:
        """Convert a torque, as a share of the rated torque, to thousandths of it on the wire, rounded to a whole number.

        Raises LocalProtocolError unless it is a finite number.
        """
        try:
            return round(self._direction * torque * 1000)
        except (ValueError, OverflowError):
            raise LocalProtocolError(f"a torque must be a finite number; it is {torque!r}") from None

    # ---- set-points: what the RPDO behind the next SYNC takes along ----

    def select_set_point(self, mode: int) -> None:
        """Make position set-points go into the object of this mode: 0x60C1:01 in ip, 0x607A in csp and pp.

        0x60C1:01 is the one from the beginning, if the dictionary has it. The image of the other one is left as it is. A mode
        without position set-points changes nothing. `select_record` is for sub-modes of ip that are not linear.
        """
        if mode in (Mode.PROFILE_POSITION, Mode.INTERPOLATED_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION):
            self._position = self._set_point_at(SET_POINT_OF[mode])

    def select_record(self, sub_mode: SubMode, period: Time) -> None:
        """Make position set-points go into data records of ip. period: ns between two of them."""
        if sub_mode.objects == (objects.INTERPOLATION_SET_POINT,):
            self.select_set_point(Mode.INTERPOLATED_POSITION)
        else:
            self._position = RecordSetPoint(self.node.dictionary, self._store, sub_mode, period)
            self._command(*sub_mode.objects)

    def _set_point_at(self, mux: Mux) -> SetPoint:
        found = self._set_points.get(mux)
        if found is None:
            found = self._set_points[mux] = SetPoint(self.node.dictionary.variable(mux), self._store)
        return found

    @property
    def set_point(self) -> float:
        """The position that the next RPDO commands, in the user's unit."""
        return self.from_counts(self._position.number)

    @property
    def set_point_counts(self) -> int:
        """The position that the next RPDO commands, in counts."""
        return self._position.number

    @property
    def set_point_objects(self) -> tuple[Mux, ...]:
        """The objects that take position set-points, in the order in which SDO has to write them."""
        return self._position.objects

    def set_position(self, position: float, velocity: float | None = None) -> None:
        """Set the next set-point of interpolated and cyclic synchronous position mode; the RPDO behind the next SYNC carries it.

        velocity: at which the axis passes it, per second, for sub-modes of ip whose records have one; None: that of the step from
        the set-point before. Raises ValueRangeError if the drive's object cannot hold it; the last set-point stays then.
        """
        counts_per_second = None if velocity is None else self._direction * velocity * self._scale
        self._position.put(self.to_counts(position), counts_per_second)

    def set_position_counts(self, counts: int, velocity: float | None = None) -> None:
        """Set the next set-point in counts, the velocity in counts per second; else as `set_position`."""
        if velocity is None:
            self._position.put(counts)
        else:
            self._position.put(counts, velocity)

    def check_set_point(self, counts: int) -> None:
        """Raise ValueRangeError for a position, in counts, that the object of the drive cannot hold."""
        self._position.check(counts)

    def set_velocity(self, velocity: float) -> float:
        """Set the next set-point of cyclic synchronous velocity mode (0x60FF), in the user's unit per second.

        Returns the velocity that the drive is given: `velocity`, rounded to its velocity unit. Raises LocalProtocolError if that
        unit is not known; ValueRangeError if 0x60FF cannot hold it; the last set-point stays then.
        """
        number = self.velocity_to_wire(velocity)
        self._set_point_at(objects.TARGET_VELOCITY).put(number)
        self.set_points_given += 1
        return self.velocity_from_wire(number)

    def set_torque(self, torque: float) -> float:
        """Set the next set-point of cyclic synchronous torque mode (0x6071), as a share of the rated torque.

        Returns the torque that the drive is given: `torque`, rounded to a thousandth. Raises as `set_velocity`.
        """
        number = self.torque_to_wire(torque)
        self._set_point_at(objects.TARGET_TORQUE).put(number)
        self.set_points_given += 1
        return self._direction * number / 1000

    def set_offsets(self, *, position: float = 0.0, velocity: float = 0.0, torque: float = 0.0) -> None:
        """Set what the drive adds to its set-points from the next RPDO on: 0x60B0, 0x60B1, 0x60B2 (feed-forward).

        Units as those of the set-points; position: a way. The values are rounded to the wire's units. Raises LocalProtocolError,
        with nothing changed, for an offset other than 0 that no RPDO carries, or whose unit is not known; ValueRangeError.
        """
        numbers = {
            objects.POSITION_OFFSET: round(self._direction * position * self._scale),
            objects.VELOCITY_OFFSET: self.velocity_to_wire(velocity) if velocity else 0,
            objects.TORQUE_OFFSET: self.torque_to_wire(torque),
        }
        carried = [mux for mux in numbers if self.rpdos_with((mux,))]
        for mux, number in numbers.items():
            if number and mux not in carried:
                raise LocalProtocolError(
                    f"no RPDO that is exchanged with {self.title} carries the offset {mux_text(mux)}. "
                    "Try: procedures.configure_pdo, with this object in the mapping"
                )
            if mux in carried:
                self._set_point_at(mux).check(number)
        for mux in carried:
            self._set_point_at(mux).put(numbers[mux])

    def set_controlword(self, word: int, now: Time) -> None:
        """Put a command into the image; see `put`. `drive.command` sends in every case."""
        self.put(objects.CONTROLWORD, word & 0xFFFF, now)

    def put(self, mux: Mux, value: int, now: Time) -> None:
        """Put a value into the image of an object. An event-driven RPDO sends it at once, a synchronous one behind the next SYNC.

        Without a live RPDO that carries the object nothing is sent.
        """
        self._store[mux] = value
        producer = self.node.rpdo_of(mux)
        if producer is not None:
            producer.trigger(now)

    def rpdos_with(self, muxes: Collection[Mux]) -> list[int]:
        """Return the numbers of the RPDOs, live or not, that are exchanged with the node and carry one of these objects."""
        places = [self.node.on_device(mux) for mux in muxes]
        return [number for number, rpdo in self.node.rpdos.items() if any(mux in rpdo.mapping.muxes for mux in places)]

    def own_rpdos(self) -> list[int]:
        """Return the numbers of the RPDOs that are exchanged with the node and carry nothing for another axis of it."""
        carried = {
            number: {place for mux in rpdo.mapping.muxes if (place := axis_of(mux)) is not None}
            for number, rpdo in self.node.rpdos.items()
        }
        return [number for number, axes in carried.items() if (axes or {0}) == {self.number}]

    def _command(self, *muxes: Mux) -> None:
        """Count objects as commanded by us: see `RemoteNode.commanded`."""
        for mux in muxes:
            self.node.commanded.add(mux)

    def _if_shown(self, bit: DriveBit | None) -> DriveBit | None:
        """Return the bit if the drive shows it, as last heard, else None."""
        value = None if bit is None else self._heard(bit.mux)
        return bit if bit is not None and value is not None and bit.is_shown_by(value) else None

    def _heard(self, key: Mux) -> int | None:
        if key not in self._heard_at:
            return None
        value = self._store.get(key)
        return value if isinstance(value, int) else 0

    def _int(self, key: Mux) -> int:
        value = self._store.get(key, 0)
        return value if isinstance(value, int) else 0

    def _on_values(self, muxes: Collection[Mux], now: Time) -> None:
        if objects.STATUSWORD in muxes and (word := self.statusword) != self._shown:
            self._shown = word
            self._enter(state_of(word))

    def _on_boot(self) -> None:
        if not self.settings.keeps_reference:
            self.is_homed = False
        self._shown = self.selected_mode = self.commanded_at = self.selected_at = None
        self.has_opened_brake = False
        self.unanswered, self.answer_time, self._was_answer_time = "", None, 0
        self._enter(State.UNKNOWN)

    def _enter(self, state: State) -> None:
        if state is not self.state:
            previous, self.state = self.state, state
            self.node.out.events.append(AxisStateChanged(self.node.node_id, previous, state, self.statusword, self.number))
