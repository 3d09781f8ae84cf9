"""The simulated drive's profile position mode (pp): it goes from set-point to set-point, each with its own profile.

A set-point is taken on the rising edge of bit 4, with the values that its objects have then: target 607Ah, velocity 6081h, end
velocity 6082h, ramps 6083h and 6084h. Bit 12 acknowledges it. Once bit 4 has fallen, bit 12 falls as soon as there is room for
another one.

    bit 5 = 1             it starts at once; whatever runs or waits is dropped
    bit 5 = 0, bit 9 = 0  it waits until the ones before have ended, and the axis stands at their targets
    bit 5 = 0, bit 9 = 1  the one before is left at its own velocity, without a stop, unless the way turns back there. It is
                          left more slowly if the axis could not stop at the next target otherwise

`DriveSettings.set_points` set-points can wait. If there is no room, bit 12 stays 1, and a further edge is not taken. A drive in
which none can wait takes set-points with bit 5 only.

Bit 6 makes a target relative. 60F2h, bits 0 and 1, says to what: 0 the target before, 1 the demand, 2 the actual position. The
first target after the mode began counts from the demand. Bits 6 and 7 of it say which way an axis without end goes to an absolute
target (turns.py). Bits 4 and 5: the drive itself clears bit 4 of the controlword, and then bit 12, at once (2) or at the target
(1).

An end velocity other than 0 is kept behind the target, up to the software limit, until the next set-point or a halt.

Halt (bit 8) stops the axis and keeps the set-point, which continues when the halt ends. Bit 10 means "velocity 0" then; else
"within 6067h of the target for 6068h".

Source: IEC 61800-7-201 (CiA 402-2): profile position, set-points, 60F2h. It does not say what follows an end velocity.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import ModeControl, ModeStatus
from canopen_proto.drives.cia402.positioning import (
    DIRECTION_SHIFT,
    RELATIVE_OPTION,
    REQUEST_RESPONSE_OPTION,
    RequestResponse,
    RotaryDirection,
)
from canopen_proto.drives.cia402.states import ControlBit, StatusBit
from canopen_proto.machine import MILLISECOND
from canopen_proto.simulation.drive.profile_modes import Dwell, OperationMode
from canopen_proto.simulation.drive.servo import UNLIMITED
from canopen_proto.simulation.drive.turns import place_of

_ROUNDING: Final = 1e-3
"""Units by which an axis may stop short of a target that it could just reach."""


class _SetPoint(NamedTuple):
    """A set-point, with the values of its objects at the time when it was given."""

    target: float  # on the track
    velocity: float
    acceleration: float
    deceleration: float
    end_velocity: float
    is_blended: bool  # bit 9: the one before is left without a stop


class ProfilePosition(OperationMode):
    """Profile position mode; see this module's text."""

    def enter(self) -> None:
        self._running: _SetPoint | None = None
        self._waiting: deque[_SetPoint] = deque()
        self._goal = self.servo.demand_position
        self._acknowledged = False
        self._reached_target = True
        self._window = Dwell()

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
        option = servo.parameter(objects.POSITIONING_OPTION_CODE)
        if controlword & ModeControl.RELATIVE:
            last = self._waiting[-1] if self._waiting else self._running
            bases = (last.target if last else self._goal, servo.demand_position, servo.position, self._goal)
            target += bases[option & RELATIVE_OPTION]
        else:
            target = place_of(servo, target, RotaryDirection(option >> DIRECTION_SHIFT & 3))
        return _SetPoint(
            target,
            servo.rate(objects.PROFILE_VELOCITY),
            servo.rate(objects.PROFILE_ACCELERATION),
            servo.rate(objects.PROFILE_DECELERATION),
            float(servo.parameter(objects.END_VELOCITY)),
            bool(controlword & ModeControl.CHANGE_ON_SET_POINT),
        )

    def _take(self, set_point: _SetPoint, immediately: bool) -> None:
        room = self.servo.settings.set_points
        if immediately or (self._running is None and room):
            self._waiting.clear()
            self._start(set_point)
        elif len(self._waiting) < room:
            self._waiting.append(set_point)
            if set_point.is_blended and self._running is not None and len(self._waiting) == 1 and not self.is_halted:
                self._plan(self._running)
        else:
            return  # no room, as bit 12 shows
        self._acknowledged = True
        if self._response is RequestResponse.AT_ONCE:
            self._release()

    def _start(self, set_point: _SetPoint) -> None:
        self._running = set_point
        self._reached_target = False
        self._window.end()
        if not self.is_halted:
            self._plan(set_point)

    def _plan(self, set_point: _SetPoint) -> None:
        target, velocity, acceleration, deceleration, _, _ = set_point
        end_velocity = self._end_velocity(set_point)
        self._goal = self.servo.move_to(
            target, velocity, acceleration, deceleration, end_velocity=end_velocity, jerks=self.servo.profile_jerks
        )

    def _end_velocity(self, set_point: _SetPoint) -> float:
        """Return the speed at which a set-point is to be left: that of bit 9, if the next one asks for that, else its own."""
        if not self._waiting or not self._waiting[0].is_blended:
            return set_point.end_velocity
        following, here = self._waiting[0], self.servo.demand_position
        way = following.target - set_point.target
        if way * (set_point.target - here) <= 0.0:
            return 0.0  # it turns back
        deceleration = min(following.deceleration, self.servo.rate(objects.MAX_DECELERATION))
        return min(set_point.velocity, math.sqrt(2.0 * deceleration * max(0.0, abs(way) - _ROUNDING)))

    @property
    def _response(self) -> RequestResponse:
        option = self.servo.parameter(objects.POSITIONING_OPTION_CODE) & REQUEST_RESPONSE_OPTION
        return RequestResponse(option >> 4 if option >> 4 < 3 else 0)

    def _release(self) -> None:
        """Clear bit 4 of the controlword as the master would; 60F2h asks for that."""
        self.released |= self.controlword & ModeControl.NEW_SET_POINT
        self.controlword &= ~ModeControl.NEW_SET_POINT
        self._ready_for_next()

    def _ready_for_next(self) -> None:
        has_room = len(self._waiting) < max(1, self.servo.settings.set_points)
        if has_room and not self.controlword & ModeControl.NEW_SET_POINT:
            self._acknowledged = False

    def tick(self) -> None:
        servo = self.servo
        if self.is_halted:
            return
        if self._running is not None and servo.time >= servo.demand.end:
            ended, self._running = self._running, None
            if self._waiting:
                self._start(self._waiting.popleft())
                self._ready_for_next()
            elif servo.demand_velocity:
                servo.run(servo.demand_velocity, ended.acceleration, ended.deceleration)
        self._watch_window()
        if self._reached_target and self._response is RequestResponse.WHEN_REACHED:
            self._release()

    def _watch_window(self) -> None:
        """Show "target reached" once the axis has been within 6067h of the target for 6068h."""
        servo = self.servo
        window = servo.parameter(objects.POSITION_WINDOW)
        within = self._running is None
        if window != UNLIMITED:
            within = within and abs(self._goal - servo.position) < window + 0.5  # positions are shown rounded
        self._reached_target = self._window.lasts(within, servo.time, servo.parameter(objects.POSITION_WINDOW_TIME) * MILLISECOND)

    @property
    def status(self) -> int:
        reached = self.servo.is_settled if self.is_halted else self._reached_target
        return reached * StatusBit.TARGET_REACHED | self._acknowledged * ModeStatus.SET_POINT_ACKNOWLEDGE

    @property
    def is_waiting(self) -> bool:
        return not self._reached_target and not self.is_halted

    @property
    def awaits_end(self) -> bool:
        """A set-point that is left in motion is left exactly at its target."""
        return (
            self._running is not None and not self.is_halted and (bool(self._waiting) or bool(self.servo.demand.final_velocity))
        )
