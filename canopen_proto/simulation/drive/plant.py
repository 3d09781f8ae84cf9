"""A mass that a simulated drive moves with a limited torque, under the three loops of a servo drive.

    position loop (P)  -> velocity loop (PI) -> torque, limited -> current loop (first-order lag) -> mass, friction, load
         ^ demand of the profile, and its velocity and acceleration as feed-forward
                          ^ velocity offset        ^ torque offset, or the target torque

`Mechanics` has the numbers; `Plant` is the state: position, velocity, torque. So following error, overshoot and torque are those
of a second-order system, and a drive at its torque limit falls behind its demand. `Control` says which loops are closed.

**A torque has no speed of its own.** In torque control the velocity loop only guards: it takes back torque as the axis comes near
`fastest`, or so near to an end of its range that the quick stop ramp is needed to stop there. The standard has 6080h for that
(max motor speed: protects the motor) and leaves to the maker how it limits; drives have objects of their own for it, too.

**Steps.** The state is integrated in steps of PERIOD on a grid of the clock, and only there. `advance` may be called at any
times: the result is the same to the last bit. Friction is taken implicitly, so that a body at rest sticks until more than the
Coulomb friction acts. An axis that rests costs nothing: no steps run until `wake`.

Positions are those of the track, in user-defined units; torques are in N·m. Positive torque accelerates towards positive
positions.

**The brake** holds the shaft by friction while the drive has no power. It takes `brake_release` to open and `brake_apply` to
close. For this time a drive that is disabled in order holds the load by its motor, and one that loses its power lets it fall.
60FEh may command the brake instead (`brake_command`).

**I²t.** What the motor gives beyond its rated torque heats it. The peak torque is allowed for `overload_time`, less torque for
longer; then `is_overloaded` limits the torque to the rated one, until the heat has fallen by a tenth.

Left out: an elastic coupling (two masses), backlash, noise and resolution of the encoder, temperature, the voltage limit.

Source: IEC 61800-7-201 (CiA 402-2), position, velocity and torque control functions. They leave the loops to the maker; these
are the cascade and the gains of textbooks on servo drives.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Final

from canopen_proto.machine import MICROSECOND, NEVER, SECOND, Time
from canopen_proto.simulation.drive.motion import Profile

PERIOD: Final = 250 * MICROSECOND
"""One step; the cycle time of the loops, as short as that of real drives."""

STANDSTILL: Final = 1.0
"""Units/s below which an axis counts as standing."""
_NEAR: Final = 0.5  # units: an encoder would show that the axis has arrived
_STEADY: Final = 1e-9  # N·m of change in a step: the loops have come to rest
_SETTLED: Final = 1e-4  # of the peak torque: what an axis that has arrived may still change in a step
_STEP: Final = PERIOD / SECOND


class Control(Enum):
    """The outermost loop that is closed."""

    POSITION = "position"
    VELOCITY = "velocity"
    TORQUE = "torque"


@dataclass(frozen=True, slots=True)
class Mechanics:
    """The mass behind a drive, its motor, and the gains of its loops. The defaults suit an arm's joint in millidegrees.

    units_per_radian: user-defined units in one radian of the shaft. inertia: kg·m². viscous_friction: N·m·s/rad.
    coulomb_friction: N·m. load: N·m, acts towards negative positions, as a weight on a vertical axis. brake_torque: N·m by which
    the brake holds the shaft; 0 for a drive without brake. brake_release, brake_apply: s until it is open, and closed.
    peak_torque: N·m, the most that the motor gives; 6072h, 6073h, 60E0h and 60E1h may limit it further. overload_time: how long
    it gives it from cold, s; inf: for ever. torque_lag: time constant of the current loop, s.

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
    brake_release: float = 0.0
    brake_apply: float = 0.0
    peak_torque: float = 30.0
    overload_time: float = math.inf
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
    nothing changes any more, so that no step is needed. velocity_offset, torque_offset: added in front of the velocity loop and
    behind it, units/s and N·m.

    In torque control the demand goes to target_torque by torque_slope (N·m, N·m/s). lowest, highest: the ends of the range, with
    the ramp that stops there (units/s²); fastest: units/s.
    """

    __slots__ = (
        "_acceleration_gain", "_brake_closes", "_brake_moves_at", "_heat", "_heat_limit", "_inertia", "_integral",
        "_integral_gain", "_position_gain", "_ramped", "_share", "_velocity_feed_forward", "_velocity_gain", "_viscous",
        "brake_command", "control", "ends", "fastest", "highest", "highest_torque", "is_blocked", "is_braked", "is_overloaded",
        "is_powered", "is_saturated", "lowest", "lowest_torque", "mechanics", "position", "ramp", "rated_torque", "rests",
        "target_torque", "time", "torque", "torque_demand", "torque_offset", "torque_slope", "velocity", "velocity_offset",
    )  # fmt: skip

    def __init__(self, mechanics: Mechanics, position: float, ends: tuple[float, float] = (-math.inf, math.inf)) -> None:
        self.ends = ends
        crossover = 2.0 * math.pi * mechanics.bandwidth
        per_unit = 1.0 / mechanics.units_per_radian
        gain = mechanics.velocity_gain
        integral_time = mechanics.integral_time
        position_gain = mechanics.position_gain
        self.mechanics = mechanics
        self._inertia = mechanics.inertia * per_unit
        self._viscous = mechanics.viscous_friction * per_unit
        self._velocity_gain = self._inertia * crossover if gain is None else gain * per_unit
        self._integral_gain = self._velocity_gain / (4.0 / crossover if integral_time is None else integral_time)
        self._position_gain = crossover / 4.0 if position_gain is None else position_gain
        self._velocity_feed_forward = mechanics.velocity_feed_forward
        self._acceleration_gain = mechanics.acceleration_feed_forward * self._inertia
        self._share = 1.0 - math.exp(-_STEP / mechanics.torque_lag) if mechanics.torque_lag > 0.0 else 1.0
        self._integral = 0.0
        self._ramped = 0.0
        self.control = Control.POSITION
        self.velocity_offset = self.torque_offset = self.target_torque = 0.0
        self.torque_slope = self.fastest = self.ramp = self.highest = math.inf
        self.lowest = -math.inf
        self.time: Time = -NEVER
        self.position = position
        self.velocity = 0.0
        self.torque = self.torque_demand = 0.0
        self.lowest_torque, self.highest_torque = -mechanics.peak_torque, mechanics.peak_torque
        self.rated_torque = mechanics.peak_torque
        self.is_powered = self.is_blocked = self.is_saturated = self.is_overloaded = False
        self.is_braked = self._brake_closes = True
        self.brake_command: bool | None = None
        self._brake_moves_at: Time = NEVER
        self._heat, self._heat_limit = 0.0, math.inf
        self.rests = True

    def wake(self, now: Time) -> None:
        """Run steps again from `now` on: something outside has changed."""
        if self.rests:
            self.rests = False
            before, self.time = self.time, now - now % PERIOD
            self._warm((self.time - before) / SECOND)

    def limit_torque(self, lowest: float, highest: float, rated: float) -> None:
        """Limit the torque, in N·m; the motor's peak torque limits it as well. rated: the torque that does not overload it."""
        peak = self.mechanics.peak_torque
        self.rated_torque = rated
        self._heat_limit = max(0.0, (peak / rated) ** 2 - 1.0) * self.mechanics.overload_time if peak > rated else math.inf
        self.lowest_torque, self.highest_torque = max(-peak, lowest), min(peak, highest)

    def power_on(self) -> None:
        """Switch the power on: the loops hold the axis, and the brake begins to open."""
        if not self.is_powered:
            self._cut()
            self.is_powered = True
        self._move_brake(False, self.mechanics.brake_release)

    def power_off(self, *, holds: bool) -> None:
        """Close the brake, and switch the power off: at once, or, if the drive `holds` the axis, when the brake is closed."""
        self._move_brake(True, self.mechanics.brake_apply)
        if not (holds and self.moves_brake):
            self._cut()

    @property
    def moves_brake(self) -> bool:
        """Whether the brake is on its way."""
        return self._brake_moves_at != NEVER

    @property
    def holds_brake(self) -> bool:
        """Whether the brake is closed, by the drive or by 60FEh."""
        return self.is_braked if self.brake_command is None else self.brake_command

    def _move_brake(self, closes: bool, delay: float) -> None:
        self._brake_closes = closes
        self._brake_moves_at = self.time + round(delay * SECOND)
        if delay <= 0.0 or self.is_braked is closes:
            self._end_brake_move()

    def _end_brake_move(self) -> None:
        self._brake_moves_at = NEVER
        self.is_braked = self._brake_closes

    def _cut(self) -> None:
        self.is_powered = self.is_saturated = False
        self.torque = self.torque_demand = self._integral = self._ramped = 0.0

    def close(self, control: Control) -> None:
        """Close the loops of a kind of control, without offsets. The torque goes on from the present one."""
        if control is not self.control:
            self.control = control
            self._integral = self._ramped = self.torque_demand
        self.velocity_offset = self.torque_offset = 0.0

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
        if self.time >= self._brake_moves_at:
            self._end_brake_move()
            if self.is_braked:
                self._cut()
        torque_before, has_arrived, is_ramping = self.torque, not self.is_powered, False
        if self.is_powered:
            if self.control is Control.TORQUE:
                wanted = self._guard(self._ramp_torque() + self.torque_offset)
                is_ramping = self._ramped != self.target_torque
            else:
                wanted, has_arrived = self._regulate(demand)
            self.torque_demand = wanted
            self.torque += (wanted - self.torque) * self._share
        self._move()
        self._warm(_STEP)
        self.time += PERIOD
        change = abs(self.torque - torque_before)
        self.rests = (
            not is_ramping
            and not self.moves_brake
            and not self.is_overloaded
            and (abs(self.torque) <= self.rated_torque or self._heat_limit == math.inf)
            and (not self.is_powered or demand.at_rest(self.time))
            and abs(self.velocity) < STANDSTILL
            and ((has_arrived and change < _SETTLED * self.mechanics.peak_torque) or change < _STEADY)
        )
        if self.rests:
            self.velocity = 0.0
            self.torque = self.torque_demand

    def _regulate(self, demand: Profile) -> tuple[float, bool]:
        """Run position and velocity loop once. Return the torque that they ask for, and whether the axis is at its demand."""
        position, velocity, acceleration = demand.at(self.time)
        error, added = 0.0, self.torque_offset
        if self.control is Control.POSITION:
            error = position - self.position
            velocity *= self._velocity_feed_forward
            added += self._acceleration_gain * acceleration
        gap = self._position_gain * error + velocity + self.velocity_offset - self.velocity
        wanted = self._velocity_gain * gap + self._integral + added
        given = self._limited(wanted)
        self.is_saturated = given != wanted
        if (wanted - given) * gap <= 0.0:  # at the limit, the integral must not grow further (anti-windup)
            self._integral += self._integral_gain * gap * _STEP
        return given, abs(error) < _NEAR

    def _ramp_torque(self) -> float:
        """Return the torque on its way to the target."""
        change = self.torque_slope * _STEP
        self._ramped = min(max(self.target_torque, self._ramped - change), self._ramped + change)
        return self._ramped

    def _guard(self, torque: float) -> float:
        """Return the torque within its limits, and less where the axis becomes too fast or comes to an end of its range."""
        gain = self._velocity_gain
        up = gain * (self._speed_before(self.highest - self.position) - self.velocity)
        down = gain * (-self._speed_before(self.position - self.lowest) - self.velocity)
        given = self._limited(min(max(torque, down), up))
        self.is_saturated = given != torque
        return given

    def _limited(self, torque: float) -> float:
        """Return the torque within the drive's limits and, if the motor is overloaded, within its rated torque."""
        if self.is_overloaded:
            torque = min(max(torque, -self.rated_torque), self.rated_torque)
        return min(max(torque, self.lowest_torque), self.highest_torque)

    def _warm(self, seconds: float) -> None:
        """Let the motor become warmer or cooler."""
        if self._heat_limit == math.inf:
            return
        self._heat = max(0.0, self._heat + ((self.torque / self.rated_torque) ** 2 - 1.0) * seconds)
        self.is_overloaded = self._heat >= (0.9 if self.is_overloaded else 1.0) * self._heat_limit

    def _speed_before(self, distance: float) -> float:
        """Return how fast the axis may be so far from an end of its range; below 0: it must come back."""
        by_loop = self._position_gain * distance
        if distance <= 0.0:
            return max(by_loop, -self.fastest)
        return min(self.fastest, math.sqrt(2.0 * self.ramp * distance), by_loop)

    def _move(self) -> None:
        """Move the mass by one step: friction implicitly, the position by the mean of both velocities."""
        if self.is_blocked:
            return
        before = self.velocity
        by_torque = _STEP / (self._inertia + self._viscous * _STEP)
        free = before + (self.torque - self.mechanics.load - self._viscous * before) * by_torque
        friction = (self.mechanics.coulomb_friction + self.mechanics.brake_torque * self.holds_brake) * by_torque
        self.velocity = 0.0 if abs(free) <= friction else free - math.copysign(friction, free)
        self.position += 0.5 * (before + self.velocity) * _STEP
        low, high = self.ends
        if not low <= self.position <= high:  # a hard stop takes the whole impulse
            self.position, self.velocity = min(max(self.position, low), high), 0.0
