"""The base of the simulated drive's modes of operation, and its velocity modes: profile velocity (pv), velocity (vl).

While operation is enabled, the drive hands its inputs to one `OperationMode`: `control` for each controlword, `written` for an
object that changed, `on_sync`, and `tick` when time has passed. The mode plans motions on the `Servo` and gives the mode bits of
the statusword. The other modes have files of their own: profile_position.py, homing.py, interpolated_position.py and
synchronous_modes.py.

pv: follows 60FFh as soon as it is written, with the ramps of 6083h and 6084h. Bit 10: the velocity has been within 606Dh of the
target for 606Eh. Bit 12: it has been below 606Fh for 6070h. Bit 13: it is further from the demand than 60F8h.

vl: 6042h, times the set-point factor 604Bh, is a velocity in the user's unit; times the dimension factor 604Ch, it is one in
revolutions of the motor per minute. 6046h limits it in the user's unit: a velocity below the minimum becomes the minimum, so that
6042h = 0 does not stop a drive that has one. Ramps: 6048h up, 6049h down, 604Ah for a quick stop.

    bit 6   0: the ramp's input is 0, so that it goes to rest by 6049h
    bit 5   0: the ramp's output stays at its present value
    bit 4   0: the axis goes to rest by 604Ah. The standard leaves this to the maker
    bit 8   1: the axis stops, by 605Dh

A turn of the motor is 608Fh; without it, 60 counts, so that one revolution per minute is one count per second.

Source: IEC 61800-7-201 (CiA 402-2): profile velocity; velocity. Bits 4 to 6 are as in the manuals of Novanta (emcl) and LS
(iG5A), the minimum as a limit as in those of Bonfiglioli and Control Techniques, the dimension factor as in Nanotec's.
"""

from __future__ import annotations

import math

from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import ModeControl, ModeStatus
from canopen_proto.drives.cia402.states import ControlBit, StatusBit
from canopen_proto.machine import MILLISECOND, NEVER, Outbox, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive.servo import Servo


class Dwell:
    """Whether something has lasted long enough."""

    __slots__ = ("_since",)

    def __init__(self) -> None:
        self._since: Time | None = None

    def end(self) -> None:
        """Begin from the start: it does not last."""
        self._since = None

    def lasts(self, holds: bool, now: Time, duration: Time) -> bool:
        """Return whether it has held for `duration` ns without a break, and holds now."""
        if not holds:
            self._since = None
            return False
        if self._since is None:
            self._since = now
        return now - self._since >= duration


class OperationMode:
    """The base of all modes. By itself it is "no mode", in which the axis stands. See this module's text."""

    listens_to: frozenset[Mux] = frozenset()
    """The objects that act when they are written; all others are read when they are needed."""

    def __init__(self, servo: Servo, out: Outbox, node_id: int) -> None:
        self.servo = servo
        self.out = out
        self.node_id = node_id
        self.controlword = 0
        self.due: Time = NEVER
        """When the next SYNC is overdue; NEVER if the mode needs no SYNC."""
        self.released = 0
        """Bits of the controlword that the drive has cleared by itself since it was last written."""
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

    def ramp(self, option: int) -> float:
        """Return the deceleration of an option code in this mode; see `Servo.ramp`."""
        return self.servo.ramp(option)

    def _halt(self) -> None:
        self.servo.brake(self.ramp(self.servo.parameter(objects.HALT_OPTION_CODE)))

    def _reached(self) -> int:
        return StatusBit.TARGET_REACHED if self.servo.is_settled else 0


class ProfileVelocity(OperationMode):
    """Profile velocity mode (pv): follows 60FFh as soon as it is written, with the ramps of 6083h and 6084h."""

    listens_to = frozenset((objects.TARGET_VELOCITY,))

    def enter(self) -> None:
        self._target = 0.0
        self._speed = 0.0
        self._window, self._threshold = Dwell(), Dwell()
        self._watch()

    def leave(self) -> None:
        self._reached_target = False  # the drive brakes, and goes on showing the bits of this mode

    def control(self, controlword: int, previous: int) -> None:
        self.controlword = controlword
        if controlword & ~previous & ControlBit.HALT:
            self._target = self._speed = 0.0
            self._halt()
        else:
            self._follow()
        self._watch()

    def written(self, key: Mux) -> None:
        self._follow()
        self._watch()

    def _follow(self) -> None:
        if self.is_halted:
            return
        target = float(self.servo.parameter(objects.TARGET_VELOCITY))
        if target != self._target:
            self._target = target
            rates = self.servo.rate(objects.PROFILE_ACCELERATION), self.servo.rate(objects.PROFILE_DECELERATION)
            self._speed = self.servo.run(target, *rates, jerks=self.servo.profile_jerks)

    def tick(self) -> None:
        self.servo.internal_limit = self._target != 0.0 and self.servo.at_rest  # it stands at a software limit
        self._watch()

    def _watch(self) -> None:
        """Compare the velocity with the windows of 606Dh and 606Fh."""
        servo = self.servo
        near = abs(servo.velocity - self._speed) <= servo.parameter(objects.VELOCITY_WINDOW)
        near = near and abs(servo.demand_velocity - self._speed) < 1.0
        slow = abs(servo.velocity) <= servo.parameter(objects.VELOCITY_THRESHOLD)
        self._reached_target = self._window.lasts(near, servo.time, servo.parameter(objects.VELOCITY_WINDOW_TIME) * MILLISECOND)
        time = servo.parameter(objects.VELOCITY_THRESHOLD_TIME) * MILLISECOND
        self._is_slow = self._threshold.lasts(slow, servo.time, time)

    @property
    def status(self) -> int:
        servo = self.servo
        reached = servo.is_settled if self.is_halted else self._reached_target
        slips = abs(servo.demand_velocity - servo.velocity) > servo.parameter(objects.MAX_SLIPPAGE)
        return reached * StatusBit.TARGET_REACHED | self._is_slow * ModeStatus.SPEED_ZERO | slips * ModeStatus.MAX_SLIPPAGE

    @property
    def is_waiting(self) -> bool:
        return not self.is_halted and not (self._reached_target and (self._is_slow or self._speed != 0.0))


class Velocity(OperationMode):
    """Velocity mode (vl) of frequency converters; see this module's text."""

    listens_to = frozenset((objects.VL_TARGET_VELOCITY, objects.VL_VELOCITY_MIN_AMOUNT, objects.VL_VELOCITY_MAX_AMOUNT))

    def enter(self) -> None:
        self._ramp = 0.0, 0.0  # the velocity to which the present ramp leads, and its rate

    def control(self, controlword: int, previous: int) -> None:
        self.controlword = controlword
        if controlword & ~previous & ControlBit.HALT:
            self.enter()
            self._halt()
        else:
            self._follow()

    def written(self, key: Mux) -> None:
        self._follow()

    def _follow(self) -> None:
        """Plan the ramp that the control bits and 6042h ask for, unless it is the present one."""
        word, servo = self.controlword, self.servo
        if self.is_halted:
            return
        up, down = self._rate(objects.VL_VELOCITY_ACCELERATION), self._rate(objects.VL_VELOCITY_DECELERATION)
        speed = 0.0
        if not word & ModeControl.ENABLE_RAMP:
            up = down = self._rate(objects.VL_VELOCITY_QUICK_STOP)
        elif not word & ModeControl.UNLOCK_RAMP:
            speed = servo.demand_velocity
        elif word & ModeControl.REFERENCE_RAMP:
            speed = self._limited(servo.parameter(objects.VL_TARGET_VELOCITY) * servo.ratio(objects.VL_SET_POINT_FACTOR))
            speed *= servo.vl_unit
        if self._ramp != (speed, down):
            self._ramp = speed, down
            servo.run(speed, up, down)

    def _limited(self, velocity: float) -> float:
        """Return a velocity in the user's unit within 6046h, with its sign; one of 0 counts as positive."""
        low = self.servo.parameter(objects.VL_VELOCITY_MIN_AMOUNT)
        high = self.servo.parameter(objects.VL_VELOCITY_MAX_AMOUNT)
        amount = min(max(abs(velocity), low), high)
        self.servo.internal_limit = amount != abs(velocity)
        return math.copysign(amount, velocity)

    def _rate(self, delta_speed: Mux) -> float:
        """Return a ramp of 6048h to 604Ah, delta speed / delta time; a time of 0 means as fast as the drive can."""
        servo = self.servo
        time = servo.parameter(Mux(delta_speed + 1))
        if not time:
            return servo.rate(objects.MAX_ACCELERATION)
        return max(1.0, servo.parameter(delta_speed) * abs(servo.vl_unit) / time)

    def ramp(self, option: int) -> float:
        keys = {1: objects.VL_VELOCITY_DECELERATION, 2: objects.VL_VELOCITY_QUICK_STOP}
        return self._rate(keys[option]) if option in keys else self.servo.ramp(option)
