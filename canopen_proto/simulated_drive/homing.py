"""Homing in the simulated drive: the methods as a table of searches along the track.

A homing method is a short list of `Seek`s: go in this direction, fast or slowly, until that switch changes. A seek whose switch
is already as wanted is skipped. The edge of the last seek is the home position. The end of a seek on the track is known when it
begins, and the drive latches the edge as the encoder hardware of real drives does: neither the step of the simulation nor the
overshoot matters. A limit switch that comes before the edge is a homing error.

At the home position, the position becomes 607Ch, home offset. (The standard's picture can be read with the other sign; drives
do it this way.) The axis returns to the edge, then homing is complete.

    bit 4 rises --> in progress --> attained (edge found, the axis returns) --> complete
                    in progress --> error, moving --> error, stopped
    bit 4 falls or halt rises: interrupted; the bits say "in progress" until the axis stands

Left out: methods with switch and index pulse together (1 to 14), those with a home switch that turn round at a limit switch
(23 to 30), touch probe (36).

Source: IEC 61800-7-201 (CiA 402-2), homing mode.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import Final, NamedTuple, assert_never

from canopen_proto.cia402 import objects
from canopen_proto.cia402.modes import HOMING_BITS, HomingStatus, ModeControl
from canopen_proto.cia402.states import ControlBit
from canopen_proto.machine import Event, Outbox
from canopen_proto.simulated_drive.profile_modes import OperationMode
from canopen_proto.simulated_drive.servo import Servo, Shape, Track


class HomingFinished(Event):
    """A homing has ended. status: COMPLETE, INTERRUPTED or ERROR_STOPPED. method: of 6098h, or the drive's own."""

    __slots__ = ("method", "status")
    __match_args__ = ("node_id", "status", "method")

    def __init__(self, node_id: int, status: HomingStatus, method: int) -> None:
        self.node_id = node_id
        self.status = status
        self.method = method


class Switch(Enum):
    """A switch that a seek watches."""

    NEGATIVE_LIMIT = "negative limit switch"
    POSITIVE_LIMIT = "positive limit switch"
    HOME = "home switch"
    INDEX = "index pulse"


class Seek(NamedTuple):
    """A search: go in `direction` until the switch is active, or no longer is."""

    direction: int
    is_fast: bool
    switch: Switch
    active: bool

    def edge(self, track: Track, position: float) -> float:
        """Return the track position where it ends: `position` if the switch is as wanted, infinite if it never will be."""
        match self.switch:
            case Switch.INDEX:
                pulses = (position - track.index_offset) / track.index_distance
                number = math.floor(pulses) + 1 if self.direction > 0 else math.ceil(pulses) - 1
                return track.index_offset + number * track.index_distance
            case Switch.NEGATIVE_LIMIT:
                low, high = -math.inf, track.negative_limit
            case Switch.POSITIVE_LIMIT:
                low, high = track.positive_limit, math.inf
            case Switch.HOME:
                low, high = track.home_switch
            case _:
                assert_never(self.switch)
        near, far = (low, high) if self.direction > 0 else (high, low)
        if not self.active:  # an axis before the switch passes it: a fast seek may have overshot
            return far if (far - position) * self.direction >= 0 else position
        if low <= position <= high:
            return position
        return near if (near - position) * self.direction > 0 else self.direction * math.inf


_UP: Final = +1
_DOWN: Final = -1

METHODS: Final[dict[int, tuple[Seek, ...]]] = {
    17: (Seek(_DOWN, True, Switch.NEGATIVE_LIMIT, True), Seek(_UP, False, Switch.NEGATIVE_LIMIT, False)),
    18: (Seek(_UP, True, Switch.POSITIVE_LIMIT, True), Seek(_DOWN, False, Switch.POSITIVE_LIMIT, False)),
    19: (Seek(_UP, True, Switch.HOME, True), Seek(_DOWN, False, Switch.HOME, False)),
    21: (Seek(_DOWN, True, Switch.HOME, True), Seek(_UP, False, Switch.HOME, False)),
    33: (Seek(_DOWN, False, Switch.INDEX, True),),
    34: (Seek(_UP, False, Switch.INDEX, True),),
    35: (),
    37: (),
}
"""Homing method (6098h) -> its seeks, in order. Without any, home is where the axis stands."""

_START: Final = ModeControl.START_HOMING
_UNDER_WAY: Final = (HomingStatus.IN_PROGRESS, HomingStatus.ATTAINED, HomingStatus.ERROR_MOVING)


class Homing(OperationMode):
    """Homing mode (hm). is_referenced: a homing found its edge since power-on, and no other has begun after it."""

    __slots__ = ("_edge", "_limit", "_method", "_seek", "_seeks", "_status", "is_referenced")

    def __init__(self, servo: Servo, out: Outbox, node_id: int) -> None:
        super().__init__(servo, out, node_id)
        self.is_referenced = False
        self._status = HomingStatus.INTERRUPTED
        self._method = 0
        self._seeks: tuple[Seek, ...] = ()
        self._seek = 0
        self._edge = self._limit = 0.0

    def enter(self) -> None:
        self._status = HomingStatus.INTERRUPTED

    def leave(self) -> None:
        if self._status in _UNDER_WAY:
            self._finish(HomingStatus.INTERRUPTED)

    def control(self, controlword: int, previous: int) -> None:
        self.controlword = controlword
        runs = controlword & _START and not controlword & ControlBit.HALT
        ran = previous & _START and not previous & ControlBit.HALT
        if runs and not ran:
            self._start()
        elif not runs and self._status in _UNDER_WAY:
            if self.is_halted:
                self._halt()
            else:
                self.servo.brake(self.servo.rate(objects.HOMING_ACCELERATION))
            self._finish(HomingStatus.INTERRUPTED)

    def _start(self) -> None:
        servo = self.servo
        self.is_referenced = False
        has_own = servo.settings.shape is Shape.SCHUNK_POWERBALL
        self._method = servo.settings.homing_method if has_own else servo.parameter(objects.HOMING_METHOD)
        seeks = METHODS.get(self._method)
        if seeks is None:
            self._finish(HomingStatus.ERROR_STOPPED)
            return
        self._status = HomingStatus.IN_PROGRESS
        self._seeks = seeks
        self._seek = 0
        self._edge = servo.position
        self._begin_seek()

    def _begin_seek(self) -> None:
        """Start the next seek whose switch is not as wanted yet; if there is none, home is found."""
        servo, track = self.servo, self.servo.settings.track
        for number in range(self._seek, len(self._seeks)):
            seek = self._seeks[number]
            self._edge = seek.edge(track, servo.position)
            if self._edge != servo.position:
                self._seek = number
                self._limit = track.positive_limit if seek.direction > 0 else track.negative_limit
                speed = objects.HOMING_SPEED_SEARCH_SWITCH if seek.is_fast else objects.HOMING_SPEED_SEARCH_ZERO
                rate = servo.rate(objects.HOMING_ACCELERATION)
                servo.run(seek.direction * servo.rate(speed), rate, rate, limited=False)
                return
        self._attain()

    def _attain(self) -> None:
        servo = self.servo
        self._status = HomingStatus.ATTAINED
        self.is_referenced = True
        servo.zero = self._edge - servo.parameter(objects.HOME_OFFSET)
        rate = servo.rate(objects.HOMING_ACCELERATION)
        servo.move_to(self._edge, servo.rate(objects.HOMING_SPEED_SEARCH_ZERO), rate, rate, limited=False)

    def tick(self) -> None:
        servo = self.servo
        if self._status is HomingStatus.IN_PROGRESS:
            direction = self._seeks[self._seek].direction
            if (servo.position - self._edge) * direction >= 0:
                self._seek += 1
                self._begin_seek()
            elif (servo.position - self._limit) * direction >= 0:
                servo.brake(servo.rate(objects.HOMING_ACCELERATION))
                self._status = HomingStatus.ERROR_MOVING
        elif servo.is_settled:
            if self._status is HomingStatus.ATTAINED:
                self._finish(HomingStatus.COMPLETE)
            elif self._status is HomingStatus.ERROR_MOVING:
                self._finish(HomingStatus.ERROR_STOPPED)

    def _finish(self, status: HomingStatus) -> None:
        self._status = status
        self.out.events.append(HomingFinished(self.node_id, status, self._method))

    @property
    def status(self) -> int:
        if self._status is HomingStatus.INTERRUPTED and self.servo.is_moving:
            return HOMING_BITS[HomingStatus.IN_PROGRESS]  # it still brakes, and bit 10 would show that it stands
        return HOMING_BITS[self._status]

    @property
    def is_waiting(self) -> bool:
        return self._status in _UNDER_WAY
