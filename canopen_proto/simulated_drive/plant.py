"""A mass that a simulated drive moves with a limited torque, under the three loops of a servo drive.

    position loop (P)  -> velocity loop (PI) -> torque, limited -> current loop (first-order lag) -> mass, friction, load
         ^ demand of the profile, and its velocity and acceleration as feed-forward

`Mechanics` has the numbers; `Plant` is the state: position, velocity, torque. So following error, overshoot and torque are those
of a second-order system, and a drive at its torque limit falls behind its demand.

**Steps.** The state is integrated in steps of PERIOD on a grid of the clock, and only there. `advance` may be called at any
times: the result is the same to the last bit. Friction is taken implicitly, so that a body at rest sticks until more than the
Coulomb friction acts. An axis that rests costs nothing: no steps run until `wake`.

Positions are those of the track, in user-defined units; torques are in N·m. Positive torque accelerates towards positive
positions.

Left out: an elastic coupling (two masses), backlash, noise and resolution of the encoder, temperature, the voltage limit.

Source: IEC 61800-7-201 (CiA 402-2), position, velocity and torque control functions. They leave the loops to the maker; these
are the cascade and the gains of textbooks on servo drives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from canopen_proto.machine import MICROSECOND, NEVER, SECOND, Time
from canopen_proto.simulated_drive.motion import Profile

PERIOD: Final = 250 * MICROSECOND
"""One step; the cycle time of the loops, as short as that of real drives."""

STANDSTILL: Final = 1.0
"""Units/s below which an axis counts as standing."""
_NEAR: Final = 0.5  # units: an encoder would show that the axis has arrived
_STEADY: Final = 1e-9  # N·m of change in a step: the loops have come to rest
_STEP: Final = PERIOD / SECOND


@dataclass(frozen=True, slots=True)
class Mechanics:
    """The mass behind a drive, its motor, and the gains of its loops. The defaults suit an arm's joint in millidegrees.

    units_per_radian: user-defined units in one radian of the shaft. inertia: kg·m². viscous_friction: N·m·s/rad.
    coulomb_friction: N·m. load: N·m, acts towards negative positions, as a weight on a vertical axis. brake_torque: N·m that
    holds the shaft while the drive has no power; 0 for a drive without brake. peak_torque: N·m, the most that the motor gives;
    6072h, 6073h, 60E0h and 60E1h may limit it further. torque_lag: time constant of the current loop, s.

    bandwidth: of the velocity loop, Hz. It gives the gains that are None: velocity_gain (N·m·s/rad) = inertia * 2π * bandwidth;
    integral_time (s; inf: no integral part) = 4 / (2π * bandwidth); position_gain (1/s) = a quarter of 2π * bandwidth, with which
    the two proportional loops are critically damped. velocity_feed_forward, acceleration_feed_forward: 0 none, 1 full.
    """

    units_per_radian: float = 180_000.0 / math.pi
    inertia: float = 0.5
    viscous_friction: float = 0.5
    coulomb_friction: float = 0.3
    load: float = 0.0
    brake_torque: float = 20.0
    peak_torque: float = 30.0
    torque_lag: float = 0.0005
    bandwidth: float = 40.0
    velocity_gain: float | None = None
    integral_time: float | None = None
    position_gain: float | None = None
    velocity_feed_forward: float = 1.0
    acceleration_feed_forward: float = 1.0


class Plant:
    """The state of the mass and of its loops; see this module's text. Call `wake` after each change from outside.

    position, velocity: units, units/s, at `time`. torque, torque_demand: N·m. is_saturated: the torque is at its limit. rests:
    nothing changes any more, so that no step is needed.
    """

    __slots__ = (
        "_acceleration_gain",
        "_coulomb",
        "_inertia",
        "_integral",
        "_integral_gain",
        "_position_gain",
        "_share",
        "_velocity_feed_forward",
        "_velocity_gain",
        "_viscous",
        "highest_torque",
        "is_blocked",
        "is_powered",
        "is_saturated",
        "lowest_torque",
        "mechanics",
        "position",
        "rests",
        "time",
        "torque",
        "torque_demand",
        "velocity",
    )

    def __init__(self, mechanics: Mechanics, position: float) -> None:
        crossover = 2.0 * math.pi * mechanics.bandwidth
        per_unit = 1.0 / mechanics.units_per_radian
        gain = mechanics.velocity_gain
        integral_time = mechanics.integral_time
        position_gain = mechanics.position_gain
        self.mechanics = mechanics
        self._inertia = mechanics.inertia * per_unit
        self._viscous = mechanics.viscous_friction * per_unit
        self._coulomb = mechanics.coulomb_friction
        self._velocity_gain = self._inertia * crossover if gain is None else gain * per_unit
        self._integral_gain = self._velocity_gain / (4.0 / crossover if integral_time is None else integral_time)
        self._position_gain = crossover / 4.0 if position_gain is None else position_gain
        self._velocity_feed_forward = mechanics.velocity_feed_forward
        self._acceleration_gain = mechanics.acceleration_feed_forward * self._inertia
        self._share = 1.0 - math.exp(-_STEP / mechanics.torque_lag) if mechanics.torque_lag > 0.0 else 1.0
        self._integral = 0.0
        self.time: Time = -NEVER
        self.position = position
        self.velocity = 0.0
        self.torque = self.torque_demand = 0.0
        self.lowest_torque, self.highest_torque = -mechanics.peak_torque, mechanics.peak_torque
        self.is_powered = self.is_blocked = self.is_saturated = False
        self.rests = True

    def wake(self, now: Time) -> None:
        """Run steps again from `now` on: something outside has changed."""
        if self.rests:
            self.rests = False
            self.time = now - now % PERIOD

    def limit_torque(self, lowest: float, highest: float) -> None:
        """Limit the torque, in N·m; the motor's peak torque limits it as well."""
        peak = self.mechanics.peak_torque
        self.lowest_torque, self.highest_torque = max(-peak, lowest), min(peak, highest)

    def power(self, is_powered: bool) -> None:
        """Switch the power on (the brake opens, the loops start) or off (no torque at once; the brake closes)."""
        self.is_powered = is_powered
        self.is_saturated = False
        self.torque = self.torque_demand = self._integral = 0.0
        self._coulomb = self.mechanics.coulomb_friction + (0.0 if is_powered else self.mechanics.brake_torque)

    def block(self, is_blocked: bool) -> None:
        """Hold the mass where it is, or free it."""
        self.is_blocked = is_blocked
        if is_blocked:
            self.velocity = 0.0

    def advance(self, now: Time, demand: Profile) -> None:
        """Run the steps up to `now`. demand: in force since the last call."""
        until = now - now % PERIOD
        while self.time < until and not self.rests:
            self._step(demand)
        self.time = until

    def position_at(self, now: Time) -> float:
        """Return the position less than a step after `time`."""
        return self.position + self.velocity * ((now - self.time) / SECOND)

    def _step(self, demand: Profile) -> None:
        torque_before, error = self.torque, 0.0
        if self.is_powered:
            error = self._control(demand)
        self._move()
        self.time += PERIOD
        self.rests = (
            (not self.is_powered or demand.at_rest(self.time))
            and abs(self.velocity) < STANDSTILL
            and (abs(error) < _NEAR or abs(self.torque - torque_before) < _STEADY)
        )
        if self.rests:
            self.velocity = 0.0

    def _control(self, demand: Profile) -> float:
        """Run the loops once: from the demand to the torque. Return the following error."""
        position, velocity, acceleration = demand.at(self.time)
        error = position - self.position
        gap = self._position_gain * error + self._velocity_feed_forward * velocity - self.velocity
        wanted = self._velocity_gain * gap + self._integral + self._acceleration_gain * acceleration
        given = min(max(wanted, self.lowest_torque), self.highest_torque)
        self.is_saturated = given != wanted
        if (wanted - given) * gap <= 0.0:  # at the limit, the integral must not grow further (anti-windup)
            self._integral += self._integral_gain * gap * _STEP
        self.torque_demand = given
        self.torque += (given - self.torque) * self._share
        return error

    def _move(self) -> None:
        """Move the mass by one step: friction implicitly, the position by the mean of both velocities."""
        if self.is_blocked:
            return
        before = self.velocity
        by_torque = _STEP / (self._inertia + self._viscous * _STEP)
        free = before + (self.torque - self.mechanics.load - self._viscous * before) * by_torque
        friction = self._coulomb * by_torque
        self.velocity = 0.0 if abs(free) <= friction else free - math.copysign(friction, free)
        self.position += 0.5 * (before + self.velocity) * _STEP
