"""Homing in the simulated drive: each method is a row of searches along the track.

A homing method is a short list of `Seek`s: go in this direction, fast or slowly, until that switch changes, or to the next index
pulse. They follow from the standard's picture of the method (`cia402.homing_methods`). A seek whose switch is already as wanted
is skipped. The edge of the last seek is the home position. The end of a seek on the track is known when it begins, and the drive
latches the edge as the encoder hardware of real drives does: neither the step of the simulation nor the overshoot matters. A fast
search may overshoot a narrow switch: a search in the same direction goes on from the latched edge, one in the other direction
from where the axis is. An index pulse at the very edge is passed over; the next one counts.

**Limit switches are obstacles.** One that comes before the edge is a homing error, unless the seek `turns`: then the search goes
on in the other direction.

At the home position, the position becomes 607Ch, home offset. (The standard's picture can be read with the other sign; drives
do it this way.) The axis returns to the edge, then homing is complete.

    bit 4 rises --> in progress --> attained (edge found, the axis returns) --> complete
                    in progress --> error, moving --> error, stopped
    bit 4 falls or halt rises: interrupted; the bits say "in progress" until the axis stands

A maker has methods of its own, with numbers below 0: `DriveSettings.own_homing`.

A method onto a hard stop (`Track.ends`) pushes until the torque reaches `DriveSettings.stop_torque`; home is the place where the
axis stands then.

Left out: homing by a touch probe (36).

Source: IEC 61800-7-201 (CiA 402-2), homing mode.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, assert_never

from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.homing_methods import HOMING_METHODS, HomingMethod, HomingSwitch
from canopen_proto.drives.cia402.modes import HOMING_BITS, HomingStatus, ModeControl
from canopen_proto.drives.cia402.states import ControlBit
from canopen_proto.machine import Event, Outbox
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive.profile_modes import OperationMode
from canopen_proto.simulation.drive.servo import Servo
from canopen_proto.simulation.drive.settings import Shape, Track


class HomingFinished(Event):
    """A homing has ended. status: COMPLETE, INTERRUPTED or ERROR_STOPPED. method: of 6098h, or the drive's own."""

    __match_args__ = ("node_id", "status", "method")

    def __init__(self, node_id: int, status: HomingStatus, method: int) -> None:
        self.node_id = node_id
        self.status = status
        self.method = method


STOPS: Final = (HomingSwitch.NEGATIVE_STOP, HomingSwitch.POSITIVE_STOP)


class Seek(NamedTuple):
    """A search: go in `direction` until the switch is active, or no longer is. switch: None for the next index pulse.

    turns: at the limit switch in that direction, the search goes on in the other one.
    """

    direction: int
    is_fast: bool
    switch: HomingSwitch | None
    active: bool = True
    turns: bool = False

    def edge(self, track: Track, position: float) -> float:
        """Return the track position where it ends: `position` if the switch is as wanted, infinite if it never will be."""
        if self.switch is None:
            pulses = (position - track.index_offset) / track.index_distance
            number = math.floor(pulses) + 1 if self.direction > 0 else math.ceil(pulses) - 1
            return track.index_offset + number * track.index_distance
        if self.switch in STOPS:
            return self.direction * math.inf  # it is felt, not seen
        low, high = _range_of(self.switch, track)
        near, far = (low, high) if self.direction > 0 else (high, low)
        if not self.active:  # an axis before the switch passes it: a fast seek may have overshot
            return far if (far - position) * self.direction >= 0 else position
        if low <= position <= high:
            return position
        return near if (near - position) * self.direction > 0 else self.direction * math.inf


def _range_of(switch: HomingSwitch, track: Track) -> tuple[float, float]:
    """Return the track positions between which a switch is active."""
    match switch:
        case HomingSwitch.NEGATIVE_LIMIT:
            return -math.inf, track.negative_limit
        case HomingSwitch.POSITIVE_LIMIT:
            return track.positive_limit, math.inf
        case HomingSwitch.HOME:
            return track.home_switch
        case HomingSwitch.NEGATIVE_STOP:
            return -math.inf, track.ends[0]
        case HomingSwitch.POSITIVE_STOP:
            return track.ends[1], math.inf
        case _:
            assert_never(switch)


def _seeks_of(method: HomingMethod) -> tuple[Seek, ...]:
    """Return the searches that a picture asks for: onto the switch, slowly over the edge that counts, to the index pulse."""
    switch, seeks = method.switch, []
    if switch in STOPS:
        seeks.append(Seek(method.start, True, switch))
    elif switch is not None:
        seeks.append(Seek(method.start, True, switch, turns=method.turns))
        leaves = method.last == method.edge
        if not leaves:  # it leaves the switch first, and comes back slowly
            seeks.append(Seek(method.edge, True, switch, active=False))
        seeks.append(Seek(method.last, False, switch, active=not leaves))
    if method.has_index:
        seeks.append(Seek(method.last, False, None))
    return tuple(seeks)


METHODS: Final[dict[int, tuple[Seek, ...]]] = {number: _seeks_of(method) for number, method in HOMING_METHODS.items()}
"""Homing method (6098h) -> its seeks, in order. Without any, home is where the axis stands."""


def has_method(servo: Servo, method: int) -> bool:
    """Return whether a drive takes a value of 6098h: 0, or a method that the simulation has and its list (60E3h), if any, too."""
    store = servo.store
    count = store.get(objects.SUPPORTED_HOMING_METHODS)
    places = range(1, count + 1) if isinstance(count, int) else range(0)
    listed = {store.get(Mux(objects.SUPPORTED_HOMING_METHODS + place)) for place in places} - {0, None}  # zeros are no list
    return method == 0 or (_seeks_by(servo, method) is not None and (not listed or method in listed))


def _seeks_by(servo: Servo, number: int) -> tuple[Seek, ...] | None:
    """Return the searches of a method, of the standard or the maker; None if the drive lacks it."""
    own = dict(servo.settings.own_homing).get(number)
    return METHODS.get(number) if own is None else _seeks_of(own)


_START: Final = ModeControl.START_HOMING
_UNDER_WAY: Final = (HomingStatus.IN_PROGRESS, HomingStatus.ATTAINED, HomingStatus.ERROR_MOVING)


class Homing(OperationMode):
    """Homing mode (hm). is_referenced: a homing found its edge since power-on, and no other has begun after it."""

    def __init__(self, servo: Servo, out: Outbox, node_id: int) -> None:
        super().__init__(servo, out, node_id)
        self.is_referenced = False
        self._status = HomingStatus.INTERRUPTED
        self._method = 0
        self._seeks: tuple[Seek, ...] = ()  # those that follow the present one
        self._seek: Seek | None = None
        self._edge = self._limit = 0.0
        self._stood_at = math.inf

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
        seeks = _seeks_by(servo, self._method)
        if seeks is None or not (has_own or has_method(servo, self._method)):
            self._finish(HomingStatus.ERROR_STOPPED)
            return
        self._status = HomingStatus.IN_PROGRESS
        servo.obeys_switches = False
        self._seeks = seeks
        self._seek = None
        self._edge = servo.position
        self._next_seek()

    def _next_seek(self) -> None:
        """Begin the next seek whose switch is not as wanted yet; if there is none, home is found."""
        for number, seek in enumerate(self._seeks):
            goes_on = self._seek is not None and self._seek.direction == seek.direction
            begin = self._edge if goes_on else self.servo.position
            self._edge = seek.edge(self.servo.settings.track, begin)
            if self._edge != begin:
                self._seeks = self._seeks[number + 1 :]
                self._run(seek)
                return
        self._attain()

    def _run(self, seek: Seek) -> None:
        servo, track = self.servo, self.servo.settings.track
        self._seek = seek
        self._stood_at = math.inf
        self._limit = track.positive_limit if seek.direction > 0 else track.negative_limit
        if (self._edge - self._limit) * seek.direction > 0:  # the limit switch comes first
            self._edge = seek.direction * math.inf
        if self._is_past(self._limit) and not self._is_past(self._edge):  # it stands on the limit switch
            self._meet_limit(seek)
            return
        speed = objects.HOMING_SPEED_SEARCH_SWITCH if seek.is_fast else objects.HOMING_SPEED_SEARCH_ZERO
        rate = servo.rate(objects.HOMING_ACCELERATION)
        servo.run(seek.direction * servo.rate(speed), rate, rate, limited=False)

    def _is_past(self, place: float) -> bool:
        """Return whether the axis has reached a place on the track, in the direction of the present seek."""
        return self._seek is not None and (self.servo.position - place) * self._seek.direction >= 0

    def _feels_stop(self) -> bool:
        """Return whether the axis pushes against the hard stop that it seeks, and has not moved for a tick. Its place is the
        edge then."""
        seek, servo = self._seek, self.servo
        if seek is None or seek.switch not in STOPS:
            return False
        before, self._stood_at = self._stood_at, servo.position
        if self._stood_at != before or servo.torques[1] * seek.direction < servo.settings.stop_torque:
            return False
        self._edge = servo.position
        return True

    def _meet_limit(self, seek: Seek) -> None:
        """Act on the limit switch at the end of the track: turn round, or end the homing with an error."""
        if seek.turns:
            back = Seek(-seek.direction, seek.is_fast, seek.switch)
            self._edge = back.edge(self.servo.settings.track, self.servo.position)
            self._run(back)
            return
        self.servo.brake(self.servo.rate(objects.HOMING_ACCELERATION))
        self._status = HomingStatus.ERROR_MOVING

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
            seek = self._seek
            if self._is_past(self._edge) or self._feels_stop():
                self._next_seek()
            elif seek is not None and self._is_past(self._limit):
                self._meet_limit(seek)
        elif servo.is_settled:
            if self._status is HomingStatus.ATTAINED:
                self._finish(HomingStatus.COMPLETE)
            elif self._status is HomingStatus.ERROR_MOVING:
                self._finish(HomingStatus.ERROR_STOPPED)

    def _finish(self, status: HomingStatus) -> None:
        self._status = status
        self.servo.obeys_switches = True
        self.out.events.append(HomingFinished(self.node_id, status, self._method))

    @property
    def status(self) -> int:
        if self._status is HomingStatus.INTERRUPTED and self.servo.is_moving:
            return HOMING_BITS[HomingStatus.IN_PROGRESS]  # it still brakes, and bit 10 would show that it stands
        return HOMING_BITS[self._status]

    @property
    def is_waiting(self) -> bool:
        return self._status in _UNDER_WAY
