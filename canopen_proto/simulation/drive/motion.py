"""Motion in closed form: trapezoidal profiles and stop ramps that are planned once and can be evaluated at any time.

A `Profile` is a row of pieces of constant acceleration, or of constant jerk. Its last piece (rest, or constant speed) holds for
ever. `move`, `through`, `stop`, `run`, `line` and `hold` plan a profile from any position *and any velocity*; so a running motion
is changed by a new plan from its present position. There are no simulation steps: `at(now)` computes the position directly from a
few numbers, however old the plan is, and always gives the same answer. Arithmetic is float (IEEE 754 double), hence the same on
every machine.

A point-to-point move is the time-optimal one within its limits: speed grows by at most `acceleration` and falls by at most
`deceleration`. If a stop from the present velocity would end beyond the target (or if the axis moves away), it first brakes to
rest and comes back. If it is faster than `max_velocity`, it first brakes to that.

Units are the caller's (device units, units/s, units/s²). A profile's own time is in seconds since its `start`, the clock's in ns.
`through` passes its target at a given speed instead, and keeps that speed.
Profiles with limited jerk are planned by smooth_motion.py.

Source: IEC 61800-7-201 (CiA 402-2), profile position mode, linear ramp (6086h = 0).
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

from canopen_proto.drives.trajectory.polynomial import with_constant_jerk
from canopen_proto.machine import NEVER, Time

_SECONDS: Final = 1e-9
_NANOSECONDS: Final = 1e9

Piece: TypeAlias = tuple[float, float, float, float, float]
"""The start of the piece (s after the profile's start); position, velocity (units/s) and acceleration (units/s²) there; its jerk
(units/s³)."""


class Profile:
    """A planned motion. It never changes.

    start: when it was planned; end: the first nanosecond at which only its last piece is left, NEVER if that lies beyond the
    clock. pieces: oldest first, at least one. final_velocity: of the last piece; if it is 0, the motion ends there.
    """

    __slots__ = ("end", "final_velocity", "pieces", "start")

    def __init__(self, start: Time, pieces: tuple[Piece, ...]) -> None:
        self.start = start
        self.pieces = pieces
        duration, _, self.final_velocity, _, _ = pieces[-1]
        self.end: Time = min(start + math.ceil(duration * _NANOSECONDS), NEVER)

    def at(self, now: Time) -> tuple[float, float, float]:
        """Return position, velocity and acceleration at `now`; before `start`, those of the start."""
        time = (now - self.start) * _SECONDS if now > self.start else 0.0
        number = len(self.pieces) - 1
        while self.pieces[number][0] > time:  # the first piece begins at 0
            number -= 1
        begin, position, velocity, acceleration, jerk = self.pieces[number]
        return with_constant_jerk(time - begin, position, velocity, acceleration, jerk)

    def at_rest(self, now: Time) -> bool:
        """Return whether the motion is over: the axis rests from now on."""
        return now >= self.end and self.final_velocity == 0.0


class _Plan:
    """A plan in the making: a row of pieces. Each piece begins at the end of the one before."""

    __slots__ = ("pieces", "position", "time", "velocity")

    def __init__(self, position: float, velocity: float) -> None:
        self.pieces: list[Piece] = []
        self.time = 0.0
        self.position = position
        self.velocity = velocity

    def ramp(self, velocity: float, rate: float) -> None:
        """Change to `velocity` at `rate` units/s² (a magnitude)."""
        change = velocity - self.velocity
        if change:
            duration = abs(change) / rate
            self.pieces.append((self.time, self.position, self.velocity, math.copysign(rate, change), 0.0))
            self.position += 0.5 * (self.velocity + velocity) * duration
            self.velocity = velocity
            self.time += duration

    def cruise(self, distance: float) -> None:
        """Keep the velocity for `distance`, in its direction; do nothing if `distance` is against it."""
        if distance * self.velocity > 0.0:
            self.pieces.append((self.time, self.position, self.velocity, 0.0, 0.0))
            self.position += distance
            self.time += distance / self.velocity

    def finish(self, start: Time, position: float) -> Profile:
        """Hold the present velocity for ever, from `position`, where the pieces end except for rounding."""
        self.pieces.append((self.time, position, self.velocity, 0.0, 0.0))
        return Profile(start, tuple(self.pieces))


def hold(start: Time, position: float) -> Profile:
    """Plan to rest at a position. start: ns, when it begins."""
    return Profile(start, ((0.0, position, 0.0, 0.0, 0.0),))


def line(
    start: Time, position: float, target: float, duration: float, leaving: float = 0.0, deceleration: float = 1.0
) -> Profile:
    """Plan one step of an interpolation: from `position` to `target` at constant speed in `duration` seconds (above 0). start:
    ns, when it begins.

    Then it brakes from the velocity `leaving` at `deceleration` (above 0); it rests at `target` if `leaving` is 0.
    """
    plan = _Plan(target, leaving)
    plan.pieces.append((0.0, position, (target - position) / duration, 0.0, 0.0))
    plan.time = duration
    plan.ramp(0.0, deceleration)
    return plan.finish(start, plan.position)


def passage(
    start: Time,
    position: float,
    velocity: float,
    target: float,
    passing: float,
    duration: float,
    deceleration: float,
    *,
    stands: bool = False,
) -> Profile:
    """Plan one step of an interpolation that passes `target` at the velocity `passing`, `duration` seconds (above 0) from now.

    On the way there are two parabolas, half of the time each. Behind the target it brakes at `deceleration` (above 0), or
    stands at once, if it `stands`.
    """
    half = duration / 2.0
    change = (passing - velocity) / half
    first = (target - position - velocity * duration) / (half * half) - change / 2.0
    middle = position + (velocity + 0.5 * first * half) * half
    plan = _Plan(target, 0.0 if stands else passing)
    plan.pieces.append((0.0, position, velocity, first, 0.0))
    plan.pieces.append((half, middle, velocity + first * half, change - first, 0.0))
    plan.time = duration
    plan.ramp(0.0, deceleration)
    return plan.finish(start, plan.position)


def stop(start: Time, position: float, velocity: float, deceleration: float) -> Profile:
    """Plan to brake to rest at `deceleration` (above 0). start: ns, when it begins, at this position and velocity."""
    plan = _Plan(position, velocity)
    plan.ramp(0.0, deceleration)
    return plan.finish(start, plan.position)


def run(start: Time, position: float, velocity: float, to_velocity: float, acceleration: float, deceleration: float) -> Profile:
    """Plan to change to `to_velocity` (of either sign) and keep it. Both rates are magnitudes above 0. start: ns, when it begins,
    at this position and velocity."""
    plan = _Plan(position, velocity)
    if velocity * to_velocity < 0.0:
        plan.ramp(0.0, deceleration)
    plan.ramp(to_velocity, acceleration if abs(to_velocity) > abs(plan.velocity) else deceleration)
    return plan.finish(start, plan.position)


def move(
    start: Time, position: float, velocity: float, target: float, max_velocity: float, acceleration: float, deceleration: float
) -> Profile:
    """Plan to go from `position` at `velocity` to `target` and rest there. Limits: magnitudes above 0; see this module's text.
    start: ns, when it begins."""
    plan = _Plan(position, velocity)
    ahead = target - position - _braking_distance(velocity, deceleration)
    if velocity and ahead and (velocity > 0.0) is not (ahead > 0.0):  # it moves away, or cannot stop in time: brake, come back
        plan.ramp(0.0, deceleration)
    direction = math.copysign(1.0, ahead or velocity)
    distance = (target - plan.position) * direction
    speed = plan.velocity * direction
    if speed < max_velocity:
        # the peak from which braking ends at the target: v² = 2 a d d' / (a + d') with the speed at the start added
        peak_squared = (2.0 * acceleration * distance + speed * speed) * deceleration / (acceleration + deceleration)
        peak = min(max_velocity, math.sqrt(max(peak_squared, 0.0)))
        if peak > speed:
            plan.ramp(peak * direction, acceleration)
    else:
        plan.ramp(max_velocity * direction, deceleration)
    plan.cruise(target - plan.position - _braking_distance(plan.velocity, deceleration))
    plan.ramp(0.0, deceleration)
    return plan.finish(start, target)


def through(
    start: Time,
    position: float,
    velocity: float,
    target: float,
    max_velocity: float,
    acceleration: float,
    deceleration: float,
    end_velocity: float,
) -> Profile:
    """Plan to go to `target`, pass it at the speed `end_velocity` (0 to max_velocity), and keep that speed. Else as `move`.

    Without room to slow down for that, it passes the target as slowly as it can; without room to speed up, as fast as it can.
    """
    plan = _Plan(position, velocity)
    if velocity * (target - position) < 0.0:
        plan.ramp(0.0, deceleration)
    distance, direction = abs(target - plan.position), math.copysign(1.0, target - plan.position)
    speed = abs(plan.velocity)
    end = min(end_velocity, math.sqrt(speed * speed + 2.0 * acceleration * distance))  # there may be no room to get faster
    if speed * speed - end * end > 2.0 * deceleration * distance:  # nor to get slower
        plan.ramp(direction * math.sqrt(speed * speed - 2.0 * deceleration * distance), deceleration)
        return plan.finish(start, target)
    peak_squared = 2.0 * acceleration * distance * deceleration + speed * speed * deceleration + end * end * acceleration
    peak = min(max_velocity, math.sqrt(peak_squared / (acceleration + deceleration)))
    plan.ramp(direction * peak, acceleration if peak > speed else deceleration)
    change = (plan.velocity * plan.velocity - end * end) / (2.0 * deceleration)
    plan.cruise(target - plan.position - direction * change)
    plan.ramp(direction * end, deceleration)
    return plan.finish(start, target)


def _braking_distance(velocity: float, deceleration: float) -> float:
    """Return the distance, with its sign, in which an axis brakes to rest."""
    return velocity * abs(velocity) / (2.0 * deceleration)


def follow(profile: Profile, position: float, since: Time, now: Time, lag: float) -> float:
    """Return the position at `now` of an axis that was at `position` at `since` and follows the profile with a first-order lag.

    lag: in s. Exact for any two times: in each piece y = u - lag u' + lag² u'' - lag³ j + c exp(-t / lag), with its jerk j.
    It does not matter how often it is called. At constant speed the axis stays behind by speed * lag.
    """
    pieces = profile.pieces
    time = max(0.0, (since - profile.start) * _SECONDS)
    until = (now - profile.start) * _SECONDS
    last = len(pieces) - 1
    for number, piece in enumerate(pieces):
        end = until if number == last else min(until, pieces[number + 1][0])
        if end <= time:
            continue
        left = position - _settled(piece, time, lag)
        position = _settled(piece, end, lag) + left * math.exp((time - end) / lag)
        time = end
    return position


def _settled(piece: Piece, time: float, lag: float) -> float:
    """Return the position of an axis that has followed this piece for ever: u - lag u' + lag² u'' - lag³ j."""
    begin, position, velocity, acceleration, jerk = piece
    here, speed, change = with_constant_jerk(time - begin, position, velocity, acceleration, jerk)
    return here - lag * (speed - lag * (change - lag * jerk))
