"""The modes of operation of the simulated drive: profile position and the velocity modes.

While operation is enabled, the drive hands its inputs to one `OperationMode`: `control` for each controlword, `written` for an
object that changed, `on_sync`, and `tick` when time has passed. The mode plans motions on the `Servo` and gives the mode bits of
the statusword. Homing (homing.py), ip (interpolated_position.py) and csp (synchronous_modes.py) have files of their own.

Profile position: a set-point is taken on the rising edge of bit 4 and acknowledged by bit 12 until bit 4 falls. With bit 5 it
starts at once; without, it waits until the running one has ended. One set-point can wait; meanwhile bit 12 stays 1, and a further
edge is not taken. Halt stops the axis and keeps the set-point, which continues when halt ends.

Left out: change on set-point (bit 9), end velocity (6082h).

Source: IEC 61800-7-201 (CiA 402-2): profile position, velocity, profile velocity.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from canopen_proto.cia402 import objects
from canopen_proto.cia402.modes import ModeControl, ModeStatus
from canopen_proto.cia402.states import ControlBit, StatusBit
from canopen_proto.machine import MILLISECOND, NEVER, Outbox, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.simulated_drive.servo import UNLIMITED, Servo


class OperationMode:
    """The base of all modes. By itself it is "no mode", in which the axis stands. See this module's text."""

    __slots__ = ("controlword", "due", "node_id", "out", "servo")

    listens_to: frozenset[Mux] = frozenset()
    """The objects that act when they are written; all others are read when they are needed."""

    def __init__(self, servo: Servo, out: Outbox, node_id: int) -> None:
        self.servo = servo
        self.out = out
        self.node_id = node_id
        self.controlword = 0
        self.due: Time = NEVER
        """When the next SYNC is overdue; NEVER if the mode needs no SYNC."""
        self.enter()  # a mode that is selected while the drive ramps down must give its status before it acts

    def enter(self) -> None:
        """Begin to act: operation was enabled, or this mode was selected while it was. A call of `control` follows."""

    def leave(self) -> None:
        """Stop acting; the drive brakes whatever still moves."""

    def control(self, controlword: int, previous: int) -> None:
        """Act on a controlword. An edge is a difference from `previous`."""
        self.controlword = controlword

    def written(self, key: Mux) -> None:
        """Act on the write of an object in `listens_to`."""

    def on_sync(self) -> None:
        """Act on a SYNC."""

    def tick(self) -> None:
        """Act on the time that has passed: the servo has advanced."""

    def sync_lost(self) -> None:
        """Act on a lost SYNC: none came until `due`."""

    def stopped_by_switch(self) -> None:
        """Act on a limit switch that has just stopped the axis, or kept it from going further."""

    def rpdo_lost(self) -> None:
        """Act on a lost RPDO: it did not come within its event time."""

    @property
    def status(self) -> int:
        """The mode bits of the statusword."""
        return 0

    @property
    def is_waiting(self) -> bool:
        """Whether the mode needs ticks although nothing moves."""
        return False

    @property
    def awaits_end(self) -> bool:
        """Whether something begins when the present motion ends: a tick is needed just then."""
        return False

    @property
    def is_halted(self) -> bool:
        return bool(self.controlword & ControlBit.HALT)

    def _halt(self) -> None:
        self.servo.brake(self.servo.ramp(self.servo.parameter(objects.HALT_OPTION_CODE)))

    def _reached(self) -> int:
        return StatusBit.TARGET_REACHED if self.servo.is_settled else 0


class _SetPoint(NamedTuple):
    """A set-point, with the values of its objects at the time when it was given."""

    target: float  # on the track
    velocity: float
    acceleration: float
    deceleration: float


class ProfilePosition(OperationMode):
    """Profile position mode (pp)."""

    __slots__ = ("_acknowledged", "_goal", "_in_window_since", "_next", "_reached_target", "_running")

    def enter(self) -> None:
        self._running: _SetPoint | None = None
        self._next: _SetPoint | None = None
        self._goal = self.servo.demand_position
        self._acknowledged = False
        self._reached_target = True
        self._in_window_since: Time | None = None

    def control(self, controlword: int, previous: int) -> None:
        self.controlword = controlword
        rising, falling = controlword & ~previous, previous & ~controlword
        if rising & ModeControl.NEW_SET_POINT:
            self._take(self._given(controlword), bool(controlword & ModeControl.CHANGE_SET_IMMEDIATELY))
        self._ready_for_next()
        if rising & ControlBit.HALT:
            self._halt()
        elif falling & ControlBit.HALT and self._running is not None:
            self._start(self._running)

    def _given(self, controlword: int) -> _SetPoint:
        servo = self.servo
        target = float(servo.parameter(objects.TARGET_POSITION))
        if controlword & ModeControl.RELATIVE:
            last = self._next or self._running
            bases = (last.target if last else self._goal, servo.demand_position, servo.position, self._goal)
            target += bases[servo.parameter(objects.POSITIONING_OPTION_CODE) & 3]
        else:
            target += servo.zero
        rates = (objects.PROFILE_VELOCITY, objects.PROFILE_ACCELERATION, objects.PROFILE_DECELERATION)
        return _SetPoint(target, *(servo.rate(key) for key in rates))

    def _take(self, set_point: _SetPoint, immediately: bool) -> None:
        if immediately or self._running is None:
            self._next = None
            self._start(set_point)
        elif self._next is None:
            self._next = set_point
        else:
            return  # no room, as bit 12 shows
        self._acknowledged = True

    def _start(self, set_point: _SetPoint) -> None:
        self._running = set_point
        self._reached_target = False
        self._in_window_since = None
        if not self.is_halted:
            self._goal = self.servo.move_to(*set_point)

    def _ready_for_next(self) -> None:
        if self._next is None and not self.controlword & ModeControl.NEW_SET_POINT:
            self._acknowledged = False

    def tick(self) -> None:
        servo = self.servo
        if self.is_halted:
            return
        if self._running is not None and servo.at_rest:
            self._running = None
            if self._next is not None:
                following, self._next = self._next, None
                self._start(following)
                self._ready_for_next()
        self._watch_window()

    def _watch_window(self) -> None:
        """Show "target reached" once the axis has been within 6067h of the target for 6068h."""
        servo = self.servo
        window = servo.parameter(objects.POSITION_WINDOW)
        if window == UNLIMITED:
            within = self._running is None
        else:
            within = self._running is None and abs(self._goal - servo.position) < window + 0.5  # positions are shown rounded
        if not within:
            self._in_window_since = None
            self._reached_target = False
            return
        if self._in_window_since is None:
            self._in_window_since = servo.time
        if servo.time - self._in_window_since >= servo.parameter(objects.POSITION_WINDOW_TIME) * MILLISECOND:
            self._reached_target = True

    @property
    def status(self) -> int:
        reached = self.servo.is_settled if self.is_halted else self._reached_target
        return reached * StatusBit.TARGET_REACHED | self._acknowledged * ModeStatus.SET_POINT_ACKNOWLEDGE

    @property
    def is_waiting(self) -> bool:
        return not self._reached_target and not self.is_halted

    @property
    def awaits_end(self) -> bool:
        return self._next is not None and not self.is_halted


class ProfileVelocity(OperationMode):
    """Profile velocity mode (pv): follows 60FFh as soon as it is written, with the ramps of 6083h and 6084h."""

    __slots__ = ("_speed", "_target")

    listens_to = frozenset((objects.TARGET_VELOCITY,))

    def enter(self) -> None:
        self._target = 0.0
        self._speed = 0.0

    def control(self, controlword: int, previous: int) -> None:
        self.controlword = controlword
        if controlword & ~previous & ControlBit.HALT:
            self._target = self._speed = 0.0
            self._halt()
        else:
            self._follow()

    def written(self, key: Mux) -> None:
        self._follow()

    def _commanded(self) -> float:
        return float(self.servo.parameter(objects.TARGET_VELOCITY))

    def _follow(self) -> None:
        if self.is_halted:
            return
        target = self._commanded()
        if target != self._target:
            self._target = target
            servo = self.servo
            servo.internal_limit = False
            rates = servo.rate(objects.PROFILE_ACCELERATION), servo.rate(objects.PROFILE_DECELERATION)
            self._speed = servo.run(target, *rates)

    def tick(self) -> None:
        self.servo.internal_limit = self._target != 0.0 and self.servo.at_rest  # it stands at a software limit

    @property
    def status(self) -> int:
        stands = not self.servo.is_moving
        reached = self.servo.is_settled if self.is_halted else abs(self.servo.demand_velocity - self._speed) < 1.0
        return reached * StatusBit.TARGET_REACHED | stands * ModeStatus.SPEED_ZERO


class Velocity(ProfileVelocity):
    """Velocity mode (vl) of frequency converters: follows 6042h while bits 4, 5 and 6 of the controlword allow it."""

    __slots__ = ()

    listens_to = frozenset((objects.VL_TARGET_VELOCITY,))
    _THROUGH: Final = ModeControl.ENABLE_RAMP | ModeControl.UNLOCK_RAMP | ModeControl.REFERENCE_RAMP

    def _commanded(self) -> float:
        through = self.controlword & self._THROUGH == self._THROUGH
        return float(self.servo.parameter(objects.VL_TARGET_VELOCITY)) if through else 0.0

    @property
    def status(self) -> int:
        return 0
