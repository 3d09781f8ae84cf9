"""The mechanics of the simulated drive: a track with switches, and a servo that moves along it.

A `Servo` has a demand (a `motion.Profile`) and an actual position that follows it, in one of two ways:

- By default with a first-order lag. Both are closed forms, so there are no steps: `advance(now)` is exact, however much time has
  passed, and costs little. A blocked axis stays where it is while its demand moves on; this makes a following error.
- With `DriveSettings.mechanics`, as a mass under control loops and a limited torque (`plant.py`). That costs 10 to 20 ms of
  computing for each second in which the axis moves.

A torque moves nothing but a mass. So a drive with the lag gets the default `Mechanics` when a torque is commanded, and keeps them
until it has come to rest in another mode.

Positions inside are those of the track. The user's are `track position - zero`; homing sets `zero`. Rates and speeds come from
the object dictionary at the moment of planning, in units, units/s and units/s² (one count is one user-defined unit). If the
dictionary lacks an object, or an object in `DriveSettings.unset` is 0, the value in fallbacks.py is used. Any other speed or rate
of 0 counts as 1, which is practically standstill, but always ends.

**Limit switches.** An axis that runs onto one brakes by the quick stop ramp (6085h), or harder if it brakes harder already. There
it goes no further in that direction, and away from the switch when it is told to. Homing searches for switches and is not
stopped. The switches are looked at each time the drive is.

Left out: factor group (608Fh to 6096h), polarity (607Eh); with the lag, limited torque.

Source: IEC 61800-7-201 (CiA 402-2), position control function, homing mode.
"""

from __future__ import annotations

import math
from typing import Final

from canopen_proto.datatypes import Value
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import NEVER, SECOND, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.simulation.drive import motion, smooth_motion
from canopen_proto.simulation.drive.parameters import Parameters
from canopen_proto.simulation.drive.plant import STANDSTILL, Control, Mechanics, Plant
from canopen_proto.simulation.drive.settings import DriveSettings

BRAKE: Final = 1
"""Bit 0 of 60FEh, "set brake": 1 closes it."""
UNLIMITED: Final = 2**32 - 1
"""6065h, 6067h: the window is switched off."""

_ROUNDING: Final = 0.5  # positions are shown rounded: a target that is nearer is where the axis stands
_GIVES_UP: Final = SECOND  # after the end of a ramp; ours, the standard has no time for it
_AT_REST: Final = 0.01  # units between demand and actual position below which the axis counts as arrived
_STIFFNESS: Final = 1.0  # per mille of rated torque per unit of following error: friction, for 6077h to show something
_RATED_TORQUE: Final = 1000
_MILLI: Final = 1e-3
_INT16: Final = 1 << 15


class Servo(Parameters):
    """The moving part of a drive; see this module's text. Motions are planned from `time`: call `advance(now)` first.

    is_settled: demand and axis are at rest at the same place. internal_limit: the last demand was cut (statusword, bit 11).
    is_stopped_by_switch: a limit switch has cut it; has_met_switch: it just did, until somebody clears this. obeys_switches:
    whether limit switches stop the axis; homing sets it.
    """

    def __init__(self, store: dict[Mux, Value], settings: DriveSettings) -> None:
        super().__init__(store, settings)
        self.time: Time = -NEVER  # before any time of a clock
        self.zero = 0.0
        self.position = self.demand_position = float(settings.position)
        self.velocity = self.demand_velocity = 0.0
        self.demand = motion.hold(self.time, self.position)
        self.is_settled = True
        self.is_blocked = False
        self.is_powered = False
        self.internal_limit = False
        self.is_stopped_by_switch = self.has_met_switch = False
        self.obeys_switches = True
        self._lag = settings.lag / SECOND
        self._plant = None if settings.mechanics is None else Plant(settings.mechanics, self.position, settings.track.ends)
        self._target: tuple[Time, float] | None = None  # of the last interpolation step: until when the next one goes on from it
        self._step: tuple[Time, float] | None = None  # until when the last interpolation step counts as under way; its velocity

    def limits(self) -> tuple[float, float]:
        """Return the software position limits (607Dh) on the track; infinite if the lower is not below the upper one (off)."""
        low = self.parameter(objects.MIN_SOFTWARE_POSITION_LIMIT)
        high = self.parameter(objects.MAX_SOFTWARE_POSITION_LIMIT)
        return (low + self.zero, high + self.zero) if low < high else (-math.inf, math.inf)

    def advance(self, now: Time) -> None:
        """Move on to `now`. A time before the last one counts as the last one."""
        since = self.time
        if now <= since:
            return
        self.time = now
        if self.is_settled:
            return
        demand = self.demand
        self.demand_position, self.demand_velocity, _ = demand.at(now)
        if self._plant is not None:
            self._follow(self._plant)
        elif not self.is_blocked:
            self._lag_behind(demand, since)
        if not self.is_stopped_by_switch and self._is_barred(self.demand_velocity):
            self._stop_at_switch()

    def _lag_behind(self, demand: motion.Profile, since: Time) -> None:
        """Let the axis follow the demand with its lag; `since` is the time of its position."""
        now = self.time
        if self._lag:
            self.position = motion.follow(demand, self.position, since, now, self._lag)
            self.velocity = (self.demand_position - self.position) / self._lag
        else:
            self.position, self.velocity = self.demand_position, self.demand_velocity
        low, high = self.settings.track.ends
        if not low <= self.position <= high:
            self.position, self.velocity = min(max(self.position, low), high), 0.0
        if demand.at_rest(now) and abs(self.demand_position - self.position) < _AT_REST:
            self.position, self.velocity = self.demand_position, 0.0
            self.is_settled = True

    def _follow(self, plant: Plant) -> None:
        """Let the mass follow the demand. Without power the demand follows the mass."""
        plant.advance(self.time, self.demand)
        self.position, self.velocity = plant.position_at(self.time), plant.velocity
        if not plant.is_powered:
            self.demand_position, self.demand_velocity = self.position, 0.0
        elif plant.control is not Control.POSITION:
            self.demand_position = self.position
            if plant.control is Control.TORQUE:
                self.demand_velocity = self.velocity
        has_arrived = not self.is_blocked or abs(self.following_error) < 1.0
        self.is_settled = plant.rests and has_arrived
        if self.is_settled and self.settings.mechanics is None and plant.control is not Control.TORQUE:
            self._plant = None
            self.position, self.velocity = self.demand_position, 0.0

    @property
    def at_rest(self) -> bool:
        """Whether the demand rests: the last motion is commanded to its end."""
        return self.demand.at_rest(self.time)

    @property
    def has_stopped(self) -> bool:
        """Whether a ramp that ends in rest has ended: of the demand, and of the mass if there is one. A mass that the torque
        cannot brake is given up after _GIVES_UP: the power goes, and the brake has to stop it."""
        if not self.at_rest:
            return False
        return self._plant is None or abs(self.velocity) < STANDSTILL or self.time - self.demand.end > _GIVES_UP

    @property
    def limits_torque(self) -> bool:
        """Whether the torque is at its limit, so that the axis cannot follow."""
        return self._plant is not None and self._plant.is_saturated

    @property
    def is_overloaded(self) -> bool:
        """Whether the torque is limited to the rated one, because the motor is too warm (I²t)."""
        return self._plant is not None and self._plant.is_overloaded

    @property
    def opens_brake(self) -> bool:
        """Whether the brake is still opening, so that the axis cannot move yet."""
        return self._plant is not None and self.is_powered and self._plant.moves_brake

    @property
    def holds_brake(self) -> bool:
        """Whether the brake is closed."""
        return not self.is_powered if self._plant is None else self._plant.holds_brake

    def command_brake(self) -> None:
        """Take over bit 0 of 60FEh: the master commands the brake if it has set this bit of the mask 60FEh:02, else the drive."""
        plant = self._plant
        if plant is not None:
            is_commanded = self.parameter(objects.DIGITAL_OUTPUT_MASK) & BRAKE
            plant.brake_command = bool(self.parameter(objects.DIGITAL_OUTPUTS) & BRAKE) if is_commanded else None
            self._wake(plant)

    @property
    def is_moving(self) -> bool:
        """Whether the axis visibly moves, or is about to."""
        return not self.at_rest or abs(self.velocity) >= 1.0

    @property
    def following_error(self) -> float:
        return self.demand_position - self.position

    @property
    def torques(self) -> tuple[int, int]:
        """6074h and 6077h, the torque demanded and the actual one, per mille of the rated torque; with the lag, both are one."""
        if self._plant is not None:
            return self._per_mille(self._plant.torque_demand), self._per_mille(self._plant.torque)
        if not self.is_powered:
            return 0, 0
        torque = round(max(-_RATED_TORQUE, min(_RATED_TORQUE, self.settings.load + _STIFFNESS * self.following_error)))
        return torque, torque

    @property
    def fastest(self) -> float:
        """The highest speed, units/s: 607Fh, and with a mass also 6080h, which is in revolutions per minute."""
        speed = self.rate(objects.MAX_PROFILE_VELOCITY)
        if self._plant is None:
            return speed
        return min(speed, self.rate(objects.MAX_MOTOR_SPEED) / 60.0 * 2.0 * math.pi * self._plant.mechanics.units_per_radian)

    def torque_of(self, per_mille: float) -> float:
        """Return a torque, per mille of the rated torque 6076h (which is in mN·m), in N·m."""
        return per_mille * self.rate(objects.MOTOR_RATED_TORQUE) * _MILLI * _MILLI

    def _per_mille(self, torque: float) -> int:
        """Return a torque in N·m per mille of the rated torque, clipped to INTEGER16."""
        return round(max(-_INT16, min(_INT16 - 1, torque * 1e6 / self.rate(objects.MOTOR_RATED_TORQUE))))

    def limit_torque(self) -> None:
        """Take over the objects of TORQUE_LIMITS. In force from `time`."""
        plant = self._plant
        if plant is not None:
            both = min(self.parameter(objects.MAX_TORQUE), self.parameter(objects.MAX_CURRENT))
            highest = max(0, min(both, self.parameter(objects.POSITIVE_TORQUE_LIMIT)))
            lowest = -max(0, min(both, self.parameter(objects.NEGATIVE_TORQUE_LIMIT)))
            plant.limit_torque(self.torque_of(lowest), self.torque_of(highest), self.torque_of(_RATED_TORQUE))
            self._wake(plant)

    def move_to(
        self,
        target: float,
        velocity: float,
        acceleration: float,
        deceleration: float,
        *,
        limited: bool = True,
        end_velocity: float = 0.0,
        jerks: tuple[float, float] | None = None,
    ) -> float:
        """Go to a track position and stop there. Return where it will stop: a software limit may lie before the target. A limit
        switch may too; the target that is not reached is returned then.

        end_velocity: pass the target at this speed, and keep it. An axis that a software limit holds stops there all the same.
        jerks: limits of the jerk, units/s³, with which it gets faster, and slower; None for linear ramps. With an end velocity
        the ramps are linear.
        """
        speed = min(velocity, self.fastest)
        wanted = target
        if limited:
            target = self._clip(target)
        here, now_at = self.demand_position, self.demand_velocity
        rates = self._clip_rates(acceleration, deceleration)
        if self._is_barred(target - here, _ROUNDING):
            self._stop_at_switch()
        elif end_velocity and target == wanted:
            self._plan(motion.through(self.time, here, now_at, target, speed, *rates, min(end_velocity, speed)))
        else:
            self._plan(self._way_to(target, speed, rates, jerks))
        return target

    def run(
        self,
        velocity: float,
        acceleration: float,
        deceleration: float,
        *,
        limited: bool = True,
        control: Control = Control.POSITION,
        jerks: tuple[float, float] | None = None,
    ) -> float:
        """Go at a velocity for ever, or to the software limit in that direction. Return the velocity, as limited by `fastest`.

        control: VELOCITY lets a mass that was held up go on from where it is; POSITION makes it catch up. jerks: as in move_to.
        """
        fastest = self.fastest
        velocity = max(-fastest, min(fastest, velocity))
        if self._is_barred(velocity):
            self._stop_at_switch()
            return velocity
        rates = self._clip_rates(acceleration, deceleration)
        here, now_at = self.demand_position, self.demand_velocity
        low, high = self.limits()
        bound = max(high, here) if velocity > 0 else min(low, here)
        if velocity and limited and math.isfinite(bound):
            self._plan(self._way_to(bound, abs(velocity), rates, jerks), control)
        elif jerks is not None:
            limits = smooth_motion.ProfileLimits(fastest, *rates, *jerks)
            _, _, acceleration_now = self.demand.at(self.time)
            self._plan(smooth_motion.run(self.time, here, now_at, acceleration_now, velocity, limits), control)
        else:
            self._plan(motion.run(self.time, here, now_at, velocity, *rates), control)
        return velocity

    def _way_to(
        self, target: float, speed: float, rates: tuple[float, float], jerks: tuple[float, float] | None
    ) -> motion.Profile:
        """Plan to go to `target` and rest there. rates: acceleration and deceleration."""
        here, now_at = self.demand_position, self.demand_velocity
        if jerks is None:
            return motion.move(self.time, here, now_at, target, speed, *rates)
        _, _, acceleration = self.demand.at(self.time)
        return smooth_motion.move(
            self.time, here, now_at, acceleration, target, smooth_motion.ProfileLimits(speed, *rates, *jerks)
        )

    def interpolate(self, target: float, passing: int | None = None) -> None:
        """Make one step of ip or csp: reach `target` one interpolation period from now, in a straight line.

        An axis that was already moving passes `target` and brakes by the quick stop ramp until the next step comes, since there
        may be none; one whose world waits for SYNC (`DriveSettings.waits_for_sync`) stands at `target` until then. passing: the
        velocity at `target`; the way there is then no straight line. A step beyond the drive's speed or
        acceleration becomes a profile, as fast as allowed, that passes `target` at the speed of the targets, to catch up
        with them; internal_limit is set.
        """
        target = self._clip(target)
        period = self.interpolation_period()
        counts = self.settings.sync_tolerance if self.settings.waits_for_sync else math.ceil(2.0 * period * SECOND)
        last, self._target = self._target, (self.time + counts, target)
        here, now_at = self.demand_position, self.moving_at
        if self._is_barred(target - here, _ROUNDING):
            self._stop_at_switch()
            return
        target = here if self._is_barred(target - here) else target
        if self.is_settled and target == here and not passing:
            self._step = None  # it stands there already, and goes on showing that
            return
        fastest = self.fastest
        acceleration, deceleration = self.rate(objects.MAX_ACCELERATION), self.rate(objects.MAX_DECELERATION)
        velocity = (target - here) / period
        waits = self.settings.waits_for_sync
        if passing is None:
            passes = velocity * now_at > 0.0 and not self.internal_limit and not waits
            leaving = math.copysign(min(abs(velocity), abs(now_at)), velocity) if passes else 0.0
            change = (acceleration if abs(velocity) > abs(now_at) else deceleration) * period
            is_allowed = abs(velocity) <= fastest and abs(velocity - now_at) <= change
            step = motion.line(self.time, here, target, period, leaving, self.ramp(2))
        else:
            velocity = 0.0 if self.internal_limit else float(passing)
            step = motion.passage(self.time, here, now_at, target, velocity, period, self.ramp(2), stands=waits)
            middle, hardest = step.pieces[1][2], max(abs(step.pieces[0][3]), abs(step.pieces[1][3]))
            is_allowed = max(abs(velocity), abs(middle)) <= fastest and hardest <= min(acceleration, deceleration)
        if is_allowed:
            self._plan(step)
            self._step = self.time + counts, velocity
        else:
            self.internal_limit = True
            low, high = self.limits()
            way = 0.0 if last is None or self.time >= last[0] else target - last[1]
            speed = min(abs(now_at), abs(way) / period) if way * (target - here) > 0.0 else 0.0
            beyond = speed * speed / (2.0 * deceleration)
            goal = max(low, min(high, target + math.copysign(beyond, way)))
            self._plan(motion.move(self.time, here, now_at, goal, fastest, acceleration, deceleration))

    def _is_barred(self, way: float, least: float = 0.0) -> bool:
        """Return whether a limit switch bars the way (of either sign, and longer than `least`): the axis is on the switch in that
        direction."""
        track = self.settings.track
        onto = (way > least and self.position >= track.positive_limit) or (way < -least and self.position <= track.negative_limit)
        return onto and self.obeys_switches and self.settings.stops_at_switches

    def _stop_at_switch(self) -> None:
        """Brake, because a limit switch bars the way."""
        _, velocity, acceleration = self.demand.at(self.time)
        harder = abs(acceleration) if velocity * acceleration < 0.0 else 0.0
        self.brake(max(self.ramp(2), harder))
        self.is_stopped_by_switch = self.has_met_switch = True

    def push(self, target: float, slope: float = math.inf) -> None:
        """Command a torque, per mille of the rated torque; it is reached by `slope`, per mille per second. target: that torque,
        with its sign.

        The axis moves as the torque makes it, up to `fastest` and to the software limits.
        """
        if self._is_barred(target):
            self._stop_at_switch()
            return
        plant = self._plant
        if plant is None:
            plant = self._plant = Plant(Mechanics(), self.position, self.settings.track.ends)
            plant.velocity = self.velocity
            plant.wake(self.time)
            plant.power_on()
            plant.block(self.is_blocked)
            self.limit_torque()
        if plant.control is not Control.TORQUE:
            plant.lowest, plant.highest = -math.inf, math.inf
        low, high = self.limits()  # an axis that is already beyond one may stay there and come back, but is not pushed
        plant.lowest = min(low, max(self.position, plant.lowest))
        plant.highest = max(high, min(self.position, plant.highest))
        self._plan(motion.hold(self.time, self.position), Control.TORQUE)
        self.demand_velocity = self.velocity  # a brake that follows at once begins with it
        plant.target_torque, plant.torque_slope = self.torque_of(target), self.torque_of(slope)
        plant.fastest, plant.ramp = self.fastest, self.ramp(2)

    def feed_forward(self, *, velocity: bool = False) -> None:
        """Add 60B2h to the torque until the next plan, and 60B1h to the velocity if asked for. The lag has no loops to add to."""
        plant = self._plant
        if plant is not None:
            offsets = (
                float(self.parameter(objects.VELOCITY_OFFSET)) if velocity else 0.0,
                self.torque_of(self.parameter(objects.TORQUE_OFFSET)),
            )
            if offsets != (plant.velocity_offset, plant.torque_offset):
                plant.velocity_offset, plant.torque_offset = offsets
                self._wake(plant)

    def brake(self, deceleration: float) -> None:
        """Stop with this ramp. deceleration: units/s², above 0."""
        self._plan(motion.stop(self.time, self.demand_position, self.demand_velocity, deceleration))

    def energise(self) -> None:
        """Put the power on. An axis that still moves is braked by the quick stop ramp."""
        self.is_powered = True
        if self._plant is not None:
            self._wake(self._plant)
            self._plant.power_on()
            self.limit_torque()
            self._plan(motion.stop(self.time, self.position, self.velocity, self.ramp(2)))

    def release(self, *, holds: bool = False) -> None:
        """Take the power off: the brake holds the axis where it is, and the demand is set to that position.

        A mass first runs on until brake and friction have stopped it. holds: the motor holds it until the brake is closed.
        """
        self.is_powered = False
        self.internal_limit = False
        self._plan(motion.hold(self.time, self.position))
        self.demand_position, self.demand_velocity = self.position, 0.0
        if self._plant is not None:
            self._plant.power_off(holds=holds)
        else:
            self.velocity = 0.0
            self.is_settled = True

    def block(self, blocked: bool) -> None:
        """Block the axis against its drive, or free it."""
        self.is_blocked = blocked
        if blocked:
            self.velocity = 0.0
        if self._plant is not None:
            self._plant.block(blocked)
            self._wake(self._plant)

    @property
    def moving_at(self) -> float:
        """The velocity at which the next interpolation step starts: that of the last step, until one period after its end."""
        if self._step is not None and self.time < self._step[0]:
            return self._step[1]
        return self.demand_velocity

    def _plan(self, profile: motion.Profile, control: Control = Control.POSITION) -> None:
        self.demand = profile
        self.demand_position, self.demand_velocity, _ = profile.at(self.time)
        self.is_settled = self.is_stopped_by_switch = self.has_met_switch = False
        self._step = None
        if self._plant is not None:
            self._plant.close(control)
            self._wake(self._plant)

    def _wake(self, plant: Plant) -> None:
        plant.wake(self.time)
        self.is_settled = False

    def _clip(self, target: float) -> float:
        low, high = self.limits()
        self.internal_limit = not low <= target <= high
        return max(low, min(high, target))

    def _clip_rates(self, acceleration: float, deceleration: float) -> tuple[float, float]:
        return min(acceleration, self.rate(objects.MAX_ACCELERATION)), min(deceleration, self.rate(objects.MAX_DECELERATION))
