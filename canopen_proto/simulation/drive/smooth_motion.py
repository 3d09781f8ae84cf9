"""Profiles with limited jerk (6086h = 3): the acceleration changes steadily, so that nothing is hit.

A `Profile` here is a row of pieces of constant jerk. `move` and `run` plan it from any position, velocity *and acceleration*. So
a new plan goes on where a running one is, without a step in the acceleration.

A change of velocity takes three pieces: the acceleration rises to its peak, stays there if the peak is the limit, and falls to 0.
A move is such a change to a cruising speed, the cruise, and a change to rest. The cruising speed is the highest from which the
axis still stops at the target; it is found by bisection, since its equation is of the fourth degree. Between two points of rest
this is the fastest move within the limits. If a stop from the present state would end beyond the target, or if the axis moves
away, it first stops and then comes back.

jerk_up holds for changes to a higher speed, with `acceleration`; jerk_down for changes to a lower one, with `deceleration`.
Brakes (halt, quick stop) have linear ramps: they are the shortest.

Source: IEC 61800-7-201 (CiA 402-2), profile position mode, 60A3h and 60A4h: one to six jerks, in whose meaning makers differ
(Nanotec's has four: the begin and the end of both ramps); that of two is from memory. Seven-segment profiles as in textbooks.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from canopen_proto.drives.trajectory.polynomial import turning_point, with_constant_jerk
from canopen_proto.machine import Time
from canopen_proto.simulation.drive.motion import Piece, Profile

JERK_LIMITED: Final = 3
"""6086h: profiles with limited jerk; 0: linear ramps."""

_HALVINGS: Final = 64
_NOTHING: Final = 1e-6  # units: a rest of a way that rounding leaves


class ProfileLimits(NamedTuple):
    """The limits of a profile: magnitudes above 0, in units, s."""

    velocity: float
    acceleration: float
    deceleration: float
    jerk_up: float
    jerk_down: float


class _Way:
    """A plan in the making: where it has come to, and the pieces so far."""

    __slots__ = ("acceleration", "limits", "pieces", "position", "time", "velocity")

    def __init__(self, limits: ProfileLimits, time: float, position: float, velocity: float, acceleration: float) -> None:
        self.limits = limits
        self.pieces: list[Piece] = []
        self.time = time
        self.position = position
        self.velocity = velocity
        self.acceleration = acceleration

    def fork(self) -> _Way:
        """Return a way that begins where this one has come to."""
        return _Way(self.limits, self.time, self.position, self.velocity, self.acceleration)

    def change(self, velocity: float) -> None:
        """Change to this velocity, with no acceleration left at the end."""
        limits = self.limits
        if abs(velocity) > abs(self.velocity):
            limit, jerk = limits.acceleration, limits.jerk_up
        else:
            limit, jerk = limits.deceleration, limits.jerk_down
        now_at = self.acceleration
        settled = self.velocity + now_at * abs(now_at) / (2.0 * jerk)  # if the acceleration only falls to 0
        sign = math.copysign(1.0, velocity - settled)
        now_at *= sign
        if now_at > limit:  # of another plan, or of a brake: back to the limit first
            peak, hold = limit, (velocity - settled) * sign / limit
        else:
            change = (velocity - self.velocity) * sign
            peak = min(limit, math.sqrt(max(0.0, jerk * change + 0.5 * now_at * now_at)))
            hold = (change - (2.0 * peak * peak - now_at * now_at) / (2.0 * jerk)) / peak if peak == limit else 0.0
        self._keep(abs(peak - now_at) / jerk, math.copysign(jerk, peak - now_at) * sign)
        self._keep(hold, 0.0)
        self._keep(peak / jerk, -jerk * sign)
        self.velocity, self.acceleration = velocity, 0.0

    def cruise(self, distance: float) -> None:
        """Keep the velocity for `distance`, in its direction; do nothing if `distance` is against it."""
        if distance * self.velocity > 0.0:
            self._keep(distance / self.velocity, 0.0)

    def _keep(self, duration: float, jerk: float) -> None:
        if duration > 0.0:
            position, velocity, acceleration = self.position, self.velocity, self.acceleration
            self.pieces.append((self.time, position, velocity, acceleration, jerk))
            end = with_constant_jerk(duration, position, velocity, acceleration, jerk)
            self.position, self.velocity, self.acceleration = end
            self.time += duration

    def stop_after(self, velocity: float) -> float:
        """Return the position of rest if the axis changes to `velocity` and then stops."""
        fork = self.fork()
        fork.change(velocity)
        fork.change(0.0)
        return fork.position

    def go_to(self, target: float) -> None:
        """Go to `target`, as far as possible in one go, and rest."""
        left = target - self.stop_after(0.0)
        if abs(left) <= _NOTHING:
            self.change(0.0)
            return
        direction = math.copysign(1.0, left)

        def goes_beyond(speed: float) -> bool:
            return not (self.stop_after(speed * direction) - target) * direction <= 0.0

        speed = self.limits.velocity
        if goes_beyond(speed):
            speed, _ = turning_point(goes_beyond, speed, _HALVINGS)
        self.change(speed * direction)
        self.cruise(target - self.stop_after(0.0))
        self.change(0.0)

    def finish(self, start: Time, position: float) -> Profile:
        """Hold the present velocity for ever, from `position`, where the pieces end except for rounding."""
        self.pieces.append((self.time, position, self.velocity, 0.0, 0.0))
        return Profile(start, tuple(self.pieces))


def move(start: Time, position: float, velocity: float, acceleration: float, target: float, limits: ProfileLimits) -> Profile:
    """Plan to go from this state to `target` and rest there; see this module's text. start: ns, when it begins."""
    way = _Way(limits, 0.0, position, velocity, acceleration)
    if velocity * (target - way.stop_after(0.0)) < 0.0:
        way.change(0.0)
    way.go_to(target)
    if abs(target - way.position) > _NOTHING:  # it could only stop at first
        way.go_to(target)
    return way.finish(start, target)


def run(start: Time, position: float, velocity: float, acceleration: float, to_velocity: float, limits: ProfileLimits) -> Profile:
    """Plan to change to `to_velocity` (of either sign) and keep it. start: ns, when it begins."""
    way = _Way(limits, 0.0, position, velocity, acceleration)
    if velocity * to_velocity < 0.0:
        way.change(0.0)
    way.change(to_velocity)
    return way.finish(start, way.position)
