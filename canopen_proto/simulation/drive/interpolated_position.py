"""The simulated drive's interpolated position mode (ip): a data record at each SYNC, out of a buffer.

Each SYNC takes one record from the buffer; the axis is there one period (60C2h) later.

**Record** (60C0h). 0, linear: the position 60C1h:01 is the record; the axis goes there in a straight line. -1, position and
velocity, if the dictionary has 60C1h:02: the velocity in units/s there completes the record, and the axis passes the position at
that velocity. (So it is with Infranor and Parker. On the way this drive has two parabolas, theirs a cubic.)

**Buffer** (60C4h). Disabled (:06 = 0, the default), it keeps only the latest record. Enabled, it holds :01 records. In a FIFO
(:03 = 0) a record that finds it full is lost. In a ring (:03 = 1) it drives out the oldest. Either is reported. :02 shows how
many records wait, :04 the next free place, from 0. In a ring :04 may be written: the next records go there, in the place of those
that wait there. Writing 0 to :06 clears it.

**Underrun**: a SYNC finds no record while the axis moves. The axis stops by the halt option code (605Dh), the mode stops
following (synchronous_modes.py), and `SetPointUnderrun` is reported. An axis that stands needs no record: it stays there.

Source: IEC 61800-7-201 (CiA 402-2): interpolated position mode, 60C0h to 60C4h. The manuals of Kollmorgen (AKD), Festo (CMMP) and
Novanta (emcl) have the entries of 60C4h, and :03, as here; the rest is from memory. Makers differ in 60C4h:02: here as Nanotec
has it.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import ModeControl, ModeStatus
from canopen_proto.drives.cia402.positioning import RotaryDirection
from canopen_proto.drives.cia402.states import ControlBit, StatusBit
from canopen_proto.machine import NEVER, Event, Outbox
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive.servo import Servo
from canopen_proto.simulation.drive.synchronous_modes import SynchronousMode
from canopen_proto.simulation.drive.turns import place_of

POSITION_AND_VELOCITY: Final = -1
"""60C0h: the sub-mode in which a record has a velocity too."""

_INTERPOLATE: Final = ModeControl.ENABLE_INTERPOLATION
_RING: Final = 1


class SetPointUnderrun(Event):
    """A SYNC found no set-point while the axis moved. The axis stops by the halt option code, and interpolation is over."""


class SetPointLost(Event):
    """A set-point came while the buffer was full. set_point: the position that is lost."""

    __match_args__ = ("node_id", "set_point")

    def __init__(self, node_id: int, set_point: int) -> None:
        self.node_id = node_id
        self.set_point = set_point


class DataRecord(NamedTuple):
    """A data record. velocity: None in linear interpolation."""

    position: int
    velocity: int | None


class RecordBuffer:
    """The places of 60C4h. write: where the next record goes; waiting: how many records wait."""

    __slots__ = ("_is_placed", "_places", "_read", "waiting", "write")

    def __init__(self) -> None:
        self.clear(1)

    def clear(self, size: int) -> None:
        """Drop all records. size: how many places there are from now on."""
        self._places: list[DataRecord | None] = [None] * size
        self._read = self.write = self.waiting = 0
        self._is_placed = False  # the host has written where to write

    def place(self, position: int) -> None:
        """Let the next records go to this place on, and take that of those which wait there. position: counted from 0; beyond the
        last place it begins again."""
        self.write = position % len(self._places)
        self._is_placed = True

    def push(self, record: DataRecord, *, drives_out: bool) -> DataRecord | None:
        """Store a record; return the one that is lost. drives_out: a full buffer loses its oldest one, else the new one."""
        old = self._places[self.write]
        if old is None:
            self._is_placed = False
            self.waiting += 1
        elif not drives_out:
            return record
        self._places[self.write] = record
        was, self.write = self.write, (self.write + 1) % len(self._places)
        if old is None or self._is_placed:
            return None
        if was == self._read:
            self._read = self.write
        return old

    def pop(self) -> DataRecord | None:
        """Take the record whose turn it is; None: there is none."""
        record = self._places[self._read]
        if record is not None:
            self._places[self._read] = None
            self._read = (self._read + 1) % len(self._places)
            self.waiting -= 1
        return record


class InterpolatedPosition(SynchronousMode):
    """Interpolated position mode (ip); see this module's text."""

    listens_to = frozenset(
        (objects.INTERPOLATION_SET_POINT, objects.INTERPOLATION_VELOCITY, objects.BUFFER_CLEAR, objects.BUFFER_POSITION)
    )

    def __init__(self, servo: Servo, out: Outbox, node_id: int) -> None:
        super().__init__(servo, out, node_id)
        self._buffer = RecordBuffer()
        self._size = 1

    def leave(self) -> None:
        self._follows = self._warning = False
        self._clear()

    def control(self, controlword: int, previous: int) -> None:
        self.controlword = controlword
        runs = controlword & _INTERPOLATE and not controlword & ControlBit.HALT
        ran = previous & _INTERPOLATE and not previous & ControlBit.HALT
        if runs and not ran:
            self._begin_following()
        elif self._follows and not runs:
            self._follows = False
            self.due = NEVER
            self._halt()

    @property
    def is_full(self) -> bool:
        """Whether the FIFO takes no further set-point. (A ring takes every one.)"""
        return self._queues and not self._is_ring and self._buffer.waiting >= self._capacity

    @property
    def record_end(self) -> Mux:
        """The object whose write completes a record."""
        return objects.INTERPOLATION_VELOCITY if self._has_velocity else objects.INTERPOLATION_SET_POINT

    @property
    def _has_velocity(self) -> bool:
        return self.servo.parameter(objects.INTERPOLATION_SUB_MODE_SELECT) == POSITION_AND_VELOCITY

    @property
    def _queues(self) -> bool:
        """Whether the buffer is enabled; this may be long before the mode acts."""
        return bool(self.servo.parameter(objects.BUFFER_CLEAR))

    @property
    def _is_ring(self) -> bool:
        return self.servo.parameter(objects.BUFFER_ORGANISATION) == _RING

    @property
    def _capacity(self) -> int:
        return max(1, self.servo.parameter(objects.MAXIMUM_BUFFER_SIZE)) if self._queues else 1

    def written(self, key: Mux) -> None:
        if key == self.record_end:
            self._push()
        elif key == objects.BUFFER_CLEAR and not self._queues:
            self._clear()
        elif key == objects.BUFFER_POSITION and self._queues and self._is_ring:
            self._fit()
            self._buffer.place(self.servo.parameter(key))
        self._show()

    def _push(self) -> None:
        servo = self.servo
        velocity = servo.parameter(objects.INTERPOLATION_VELOCITY) if self._has_velocity else None
        self._fit()
        record = DataRecord(servo.parameter(objects.INTERPOLATION_SET_POINT), velocity)
        lost = self._buffer.push(record, drives_out=self._is_ring or not self._queues)
        if lost is not None and self._queues:
            self.out.events.append(SetPointLost(self.node_id, lost.position))

    def _fit(self) -> None:
        """Give the buffer the size that 60C4h asks for: 1 while it is disabled."""
        if self._capacity != self._size:
            kept = self._buffer.pop()
            self._size = self._capacity
            self._buffer.clear(self._size)
            if kept is not None:
                self._buffer.push(kept, drives_out=False)

    def _clear(self) -> None:
        self._size = self._capacity
        self._buffer.clear(self._size)
        self._show()

    def _show(self) -> None:
        self.servo.store[objects.ACTUAL_BUFFER_SIZE] = self._buffer.waiting
        self.servo.store[objects.BUFFER_POSITION] = self._buffer.write

    def on_sync(self) -> None:
        if not self._follows:
            return
        servo = self.servo
        self._await_sync()
        record = self._buffer.pop()
        if record is not None:
            servo.interpolate(place_of(servo, record.position, RotaryDirection.SHORTEST), record.velocity)
            self._show()
        elif servo.moving_at:
            self._stop_following()
            self._halt()
            self.out.events.append(SetPointUnderrun(self.node_id))

    @property
    def status(self) -> int:
        return self._follows * ModeStatus.IP_MODE_ACTIVE | self._warning * StatusBit.WARNING | self._reached()
