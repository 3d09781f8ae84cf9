"""`run_at`: run at a velocity, in profile velocity mode (pv) or velocity mode (vl), for as long as the procedure runs.

    pv   0x60FF = 0, mode, enable, 0x000F, 0x60FF = velocity                          end: halt (bit 8), standstill, 0x60FF = 0
    vl   0x6042 = 0, mode, enable, 0x000F, 0x6042 = velocity, 0x007F (bits 4, 5, 6)   end: halt (bit 8), standstill, 0x6042 = 0

**Dead man.** A velocity holds only while the procedure runs: its end, a cancellation and a failure halt the drive, and its
standstill is seen. Then its target is 0, so that no later controlword sends it on. If the master itself is gone, `axis.watchdog`
lets the drive stop by itself.

**Position limits** (min_position and max_position of the settings; 0x607D). Drives differ in whether 0x607D holds in these modes.
So the procedure watches the position (0x6064), and halts the drive before a limit: as early as it needs for `obeys_within` of the
settings, for the age of the position, and for its ramp (0x605D). Near a limit it does not begin. Both ends count: a drive may
run the other way, by its polarity (0x607E) or because a load pulls it.

**Units of vl.** 0x6042 is an INTEGER16. Times the set-point factor 0x604B and the dimension factor 0x604C it is in turns of the
motor per minute. The ramps 0x6048 and 0x6049 are in the unit of 0x604C. Firmware of Nanotec before 2017 takes 0x604C = 1/60 for
turns per minute: counts_per_motor_turn of the settings then has to be 60 times as large.

Source: IEC 61800-7-201 (CiA 402-2): profile velocity mode, velocity mode.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from canopen_proto.drives.axis.axis import OBEYED, Axis
from canopen_proto.drives.axis.controlword import bring, command
from canopen_proto.drives.axis.exclusive_motion import moves
from canopen_proto.drives.axis.failures import (
    DriveError,
    LimitReachedError,
    ModeUnsupportedError,
    as_drive_errors,
    late,
    require_reference,
)
from canopen_proto.drives.axis.halting import halt, halt_after, halt_and_forget, halt_ramp
from canopen_proto.drives.axis.identity import learn_units
from canopen_proto.drives.axis.limits import Limit, read_limits
from canopen_proto.drives.axis.state import enable, set_mode
from canopen_proto.drives.axis.watching import POLL_INTERVAL, DriveWait
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, ModeControl, ModeStatus, mode_name, supported, supported_modes
from canopen_proto.drives.cia402.states import Command, State, StatusBit
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux, mux_text
from canopen_proto.procedures.objects import read_if_present, write
from canopen_proto.procedures.steps import Cancelled, Procedure, current_time
from canopen_proto.remote_node import FRESH

VELOCITY_MODES: Final = (Mode.PROFILE_VELOCITY, Mode.VELOCITY)
"""The modes of `run_at`, the first choice first."""
TARGET_OF: Final = {Mode.PROFILE_VELOCITY: objects.TARGET_VELOCITY, Mode.VELOCITY: objects.VL_TARGET_VELOCITY}

_RAMP_BITS: Final = ModeControl.ENABLE_RAMP | ModeControl.UNLOCK_RAMP | ModeControl.REFERENCE_RAMP
_ALL: Final = 1 + 1e-6
"""A velocity at the limit itself is not refused for a rounding error."""
_FINE: Final = 100
"""A ramp of vl is written with a delta speed of at least so much, if a longer delta time allows that."""
_MEASURED: Final = 30 * MILLISECOND
"""Between two positions of which a speed is made."""


class Running(NamedTuple):
    """A command that was given. velocity: rounded to its unit, in the user's unit per second. is_reached: it shows that."""

    mode: Mode
    velocity: float
    is_reached: bool


@moves
@as_drive_errors
def run_at(
    axis: Axis,
    velocity: float,
    *,
    duration: Time | None = None,
    mode: Mode | None = None,
    acceleration: float | None = None,
    deceleration: float | None = None,
    news: Callable[[Running], object] | None = None,
) -> Procedure[float | None]:
    """Run at a velocity, in the user's unit per second, for `duration` ns (None: until this is cancelled); then halt.

    Returns the velocity that the drive showed last before its halt (0x606C; in vl 0x6044 before it), in the user's unit per
    second; None: it shows none, or in a unit that is not known.

    mode: pv or vl; None: pv, else vl, whichever the drive has. acceleration, deceleration: per second², rounded down to the
    drive's unit; None: the drive's own. news: called when the drive has its command, and when it shows the velocity.

    Raises with nothing sent: ModeUnsupportedError; LimitReachedError for a velocity beyond max_speed of the settings, 0x607F or
    0x6080 (see limits.py), and for a position limit that is too near; ReferenceLostError if the settings have position limits;
    DriveError for a unit that is not known, or a velocity below it; ValueRangeError. Later: LimitReachedError at a limit of the
    position or of the drive, DriveTimeoutError if it does not reach the velocity, DriveInFaultError, StateLostError,
    ModeLostError, DriveLostError. The drive is halted then.
    """
    if duration is not None and duration < 0:
        raise LocalProtocolError(f"duration must not be below 0, or None for no end; it is {duration!r}")
    run = _Run(axis, velocity, acceleration, deceleration, news)
    yield from run.prepare(mode)
    try:
        yield from run.start()
        yield from run.watch(duration)
    except (Cancelled, Exception) as cause:
        yield from halt_after(axis, cause, run.forget)
        raise
    yield from halt_and_forget(axis, run.forget)
    return run.measured


class _Run:
    """One run of a drive at a velocity."""

    def __init__(
        self,
        axis: Axis,
        velocity: float,
        acceleration: float | None,
        deceleration: float | None,
        news: Callable[[Running], object] | None,
    ) -> None:
        self._axis = axis
        self._velocity = velocity
        self._rates = acceleration, deceleration
        self._news = news
        self._mode = Mode.PROFILE_VELOCITY
        self._number = 0  # the velocity on the wire
        self._unit = 1.0  # counts per second in one unit of it
        self._ramp_unit = 1.0  # counts per second² in one unit of a ramp
        self._ramps: dict[Mux, int] = {}
        self._bound: Limit | None = None  # ahead
        self._behind: Limit | None = None  # for a drive that runs the other way: a polarity (0x607E), a load
        self._first: int | None = None
        self._side = 1 if velocity * axis.settings.direction >= 0 else -1
        self._margin = 0.0
        self.measured: float | None = None
        self._is_reached = False
        self._began: Time = 0
        self._reach: Time = 0  # how long it may take to reach its velocity
        self._looked: tuple[Time, int] | None = None

    # ---- before it moves ----

    def prepare(self, mode: Mode | None) -> Procedure[None]:
        """Check all that is known before anything is sent."""
        axis = self._axis
        if not math.isfinite(self._velocity):
            raise LocalProtocolError(f"a velocity must be a finite number; it is {self._velocity!r}")
        if axis.settings.min_position is not None or axis.settings.max_position is not None:
            require_reference(axis)
        self._mode = yield from choose_velocity_mode(axis, mode)
        yield from self._learn_units()
        limits = yield from read_limits(axis)
        if abs(self._velocity) > limits.speed.value * _ALL:
            failed = f"was not run at {self._velocity:g}"
            reason = f"{limits.speed.source} allows {limits.speed.value:g}; nothing was sent"
            remedy = "a lower velocity; max_speed (--max-speed, AxisSettings, the machine file), if it may go as fast as that"
            raise LimitReachedError(axis, failed, reason=reason, remedy=remedy, looks=False)
        exact = axis.settings.direction * self._velocity * axis.scale.counts_of_amount(1.0) / self._unit
        self._number = round(exact)
        if axis.scale.amount_from_counts(abs(self._number * self._unit)) > limits.speed.value * _ALL:
            self._number = math.trunc(exact)  # rounded up it would be beyond the limit
        if self._velocity and not self._number:
            failed = f"cannot run at {self._velocity:g}: it is less than one unit of {mux_text(TARGET_OF[self._mode])}"
            raise DriveError(axis, failed, remedy="a higher velocity", looks=False)
        axis.node.encode(TARGET_OF[self._mode], self._number)
        if self._mode is Mode.VELOCITY:
            yield from self._keep_amounts()
        self._plan_ramps()
        if self._velocity and not axis.has_lost_reference:
            self._behind, self._bound = (limits.lowest, limits.highest)[:: 1 if self._velocity > 0 else -1]
        yield from self._guard()

    def _learn_units(self) -> Procedure[None]:
        axis = self._axis
        units = yield from learn_units(axis)
        if self._mode is Mode.PROFILE_VELOCITY:
            if axis.scale.velocity_unit is None:
                raise DriveError(axis, "does not tell its velocity unit", remedy="AxisSettings(velocity_unit=...)", looks=False)
            self._unit = axis.scale.velocity_unit
            ramp_unit = axis.scale.acceleration_unit
            if ramp_unit is None:  # how far it runs until it stands, and its ramps, depend on it
                raise DriveError(
                    axis,
                    "has an acceleration unit that cannot be converted",
                    reason=axis.scale.units.origins.get("per_acceleration", ""),
                    remedy="AxisSettings(acceleration_unit=...), by its manual",
                    looks=False,
                )
            self._ramp_unit = ramp_unit
            return
        turn = axis.settings.counts_per_motor_turn or units.per_motor_turn
        if turn is None:
            failed = "does not tell how many counts a turn of its motor has, in which velocity mode (vl) counts"
            raise DriveError(axis, failed, remedy="AxisSettings(counts_per_motor_turn=...), by its manual", looks=False)
        unit = (yield from _ratio(axis, objects.VL_DIMENSION_FACTOR)) * turn / 60
        self._ramp_unit = abs(unit)
        self._unit = unit * (yield from _ratio(axis, objects.VL_SET_POINT_FACTOR))

    def _keep_amounts(self) -> Procedure[None]:
        """Refuse a velocity that the drive would change by 0x6046: it would run at another one, faster than it was told."""
        axis = self._axis
        lowest, highest = yield from _pair(axis, objects.VL_VELOCITY_MIN_AMOUNT)
        amount = abs(self._number * self._unit) / self._ramp_unit  # in the unit of the dimension factor
        if amount * _ALL < lowest or 0 < highest < amount / _ALL:
            ends = [axis.scale.amount_from_counts(each * self._ramp_unit) for each in (lowest, highest)]
            failed = f"was not run at {self._velocity:g}"
            reason = f"it runs at {ends[0]:g} to {ends[1]:g} only (0x6046); nothing was sent"
            raise LimitReachedError(axis, failed, reason=reason, remedy="a velocity between them, or another 0x6046", looks=False)

    def _plan_ramps(self) -> None:
        """Find the values of the ramps that were asked for."""
        axis = self._axis
        keys = {
            Mode.PROFILE_VELOCITY: (objects.PROFILE_ACCELERATION, objects.PROFILE_DECELERATION),
            Mode.VELOCITY: (objects.VL_VELOCITY_ACCELERATION, objects.VL_VELOCITY_DECELERATION),
        }[self._mode]
        for key, rate in zip(keys, self._rates, strict=True):
            if rate is None:
                continue
            amount = rate * axis.scale.counts_of_amount(1.0) / self._ramp_unit
            time = 1
            if self._mode is Mode.VELOCITY:
                time = next((each for each in (1, 10, 100, 1000) if amount * each >= _FINE), 1000)
                self._ramps[Mux(key + 1)] = time
            self._ramps[key] = math.floor(amount * time * (1 + 1e-12))
            if self._ramps[key] < 1:
                raise DriveError(
                    axis, f"cannot take a ramp of {rate:g}: it is less than one unit of {mux_text(key)}", looks=False
                )
        for key, value in self._ramps.items():
            if key not in axis.node.dictionary:
                raise DriveError(axis, f"has no {mux_text(key)}, which this ramp needs; nothing was sent", looks=False)
            axis.node.encode(key, value)

    def _guard(self) -> Procedure[None]:
        """Find how early the drive has to be halted before its limit; refuse to begin where that is already behind it."""
        axis = self._axis
        if not self._is_bounded:
            return
        position = yield from read_if_present(axis.node, objects.POSITION_ACTUAL_VALUE)
        if not isinstance(position, int):
            if (axis.settings.min_position, axis.settings.max_position) == (None, None):
                self._bound = self._behind = None  # only the drive's own limits, which it keeps or not
                return
            raise DriveError(axis, "shows no position (0x6064), so its position limits cannot be kept", looks=False)
        self._margin = yield from self._way_to_stop(abs(self._velocity) * axis.scale.counts_of_amount(1.0))
        if self._bound is not None and self._room(position, self._bound) <= self._margin:
            way = axis.scale.amount_from_counts(self._margin)
            failed = f"was not run at {self._velocity:g}: it stands at {axis.scale.from_counts(position):g}"
            reason = f"it needs {way:g} to stop before {self._bound.value:g} ({self._bound.source}); nothing was sent"
            raise LimitReachedError(axis, failed, reason=reason, remedy="the other direction, or a lower velocity", looks=False)

    def _way_to_stop(self, speed: float) -> Procedure[float]:
        """Return the counts that the drive needs to stop from a speed in counts per second."""
        settings = self._axis.settings
        delay = (settings.obeys_within + FRESH) / SECOND
        ramp: float | None = None
        if self._mode is Mode.PROFILE_VELOCITY:
            ramp = yield from halt_ramp(self._axis)
            if ramp and objects.PROFILE_DECELERATION in self._ramps:
                ramp = min(ramp, self._ramps[objects.PROFILE_DECELERATION])  # it is written later, if the halt goes by it
        else:
            ramp = yield from self._halt_ramp_of_vl()
        if not ramp:
            return speed * (delay + settings.halt_time / SECOND)
        return speed * (delay + (yield from self._time_of_ramp(speed, ramp)) / 2)

    def _time_of_ramp(self, speed: float, ramp: float) -> Procedure[float]:
        """Return how long the drive takes from rest to a speed (counts per second), or back, in s. ramp: in its unit.

        A profile with limited jerk (0x6086 is not 0) takes longer than its ramp: by the time in which its acceleration grows and
        goes (0x60A4; its unit is that of the ramp, per second). Of one that tells no jerk, twice the time of the ramp is taken.
        """
        time = speed / (ramp * self._ramp_unit)
        if self._mode is not Mode.PROFILE_VELOCITY or not (
            yield from read_if_present(self._axis.node, objects.MOTION_PROFILE_TYPE)
        ):
            return time
        told = yield from _pair(self._axis, objects.PROFILE_JERK)
        jerk = min((each for each in told if each > 0), default=0)
        if not jerk:
            return 2 * time
        growth = ramp / jerk
        return time + growth if time >= growth else 2 * math.sqrt(time * growth)

    def _halt_ramp_of_vl(self) -> Procedure[float | None]:
        """Return the deceleration with which the drive halts (0x605D) in vl, in its unit; None if it does not tell."""
        option = yield from read_if_present(self._axis.node, objects.HALT_OPTION_CODE)
        keys = {1: objects.VL_VELOCITY_DECELERATION, 2: objects.VL_VELOCITY_QUICK_STOP}
        key = keys.get(option if isinstance(option, int) else 1)
        if key is None:
            return None
        deltas = yield from _pair(self._axis, key)
        speed_change, time = self._ramps.get(key, deltas[0]), self._ramps.get(Mux(key + 1), deltas[1])
        return speed_change / time if speed_change and time else None

    @property
    def _is_bounded(self) -> bool:
        return self._bound is not None or self._behind is not None

    def _room(self, position: int, limit: Limit) -> float:
        """Return how far a limit is ahead, in counts; below 0 behind it."""
        return (self._axis.scale.to_counts(limit.value) - position) * self._side

    # ---- while it moves ----

    def start(self) -> Procedure[None]:
        """Give the drive the mode, its power and the velocity."""
        axis, target = self._axis, TARGET_OF[self._mode]
        yield from halt(axis)
        yield from bring(axis, target, 0)
        for key, value in self._ramps.items():
            yield from write(axis.node, key, value)
        self._reach = yield from self._time_to_reach()  # now: once it runs, only its limits may be looked at
        yield from set_mode(axis, self._mode)
        yield from enable(axis)
        yield from command(axis, int(Command.ENABLE_OPERATION))
        axis.started_at = yield from current_time()
        yield from bring(axis, target, self._number)
        if self._mode is Mode.VELOCITY:
            yield from command(axis, Command.ENABLE_OPERATION | _RAMP_BITS)
        axis.started_at = self._began = yield from current_time()
        self._tell()

    def forget(self) -> Procedure[None]:
        """Make the target 0: no later word without bit 8 sends the drive on."""
        return bring(self._axis, TARGET_OF[self._mode], 0)

    def watch(self, duration: Time | None) -> Procedure[None]:
        """Watch the drive until its time is over."""
        axis = self._axis
        reads = {
            objects.POSITION_ACTUAL_VALUE: POLL_INTERVAL if self._is_bounded else FRESH,
            **dict.fromkeys(self._shown, FRESH),
            objects.VL_VELOCITY_DEMAND: FRESH,
        }
        if self._mode is not Mode.VELOCITY:
            del reads[objects.VL_VELOCITY_DEMAND]
        present = {key: pause for key, pause in reads.items() if key in axis.node.dictionary}
        end = NEVER if duration is None else self._began + duration
        watch: DriveWait[bool] = DriveWait(axis, "its velocity", mode=self._mode, stays=State.OPERATION_ENABLED, reads=present)

        def judge(statusword: int, heard_at: Time) -> bool | None:
            self._keep_limits(watch, statusword, heard_at)
            if not self._is_reached and self._shows_velocity(watch, statusword, heard_at):
                self._is_reached = True
                axis.started_at = OBEYED
                self._tell()
            is_over = heard_at >= end or (not self._is_reached and heard_at - self._began >= self._reach)
            return True if is_over else None

        yield from watch.until(judge, NEVER)
        for key, unit in self._shown.items():
            shown = axis.node.values.store.get(key)
            if self.measured is None and watch.heard(key) is not None and isinstance(shown, int):
                self.measured = axis.scale.way_from_counts(shown * unit)
        if not self._is_reached and (yield from current_time()) < end:
            raise (yield from late(axis, f"did not reach {self._velocity:g} within {self._reach / SECOND:g} s"))

    @property
    def _shown(self) -> dict[Mux, float]:
        """The objects in which the drive may show its velocity, the best first, and the counts per second in one unit of each."""
        unit = self._axis.scale.velocity_unit
        shown = {objects.VL_VELOCITY_ACTUAL_VALUE: self._unit} if self._mode is Mode.VELOCITY else {}
        return shown if unit is None else {**shown, objects.VELOCITY_ACTUAL_VALUE: unit}

    def _time_to_reach(self) -> Procedure[Time]:
        """Return how long the drive may take to reach its velocity: its ramp, and `reaction_time` and `state_timeout` more."""
        axis = self._axis
        if self._mode is Mode.PROFILE_VELOCITY:
            rate = yield from read_if_present(axis.node, objects.PROFILE_ACCELERATION)
            ramp = float(rate) if isinstance(rate, int) else 0.0
        else:
            change, time = yield from _pair(axis, objects.VL_VELOCITY_ACCELERATION)
            ramp = change / time if change and time else 0.0
        slope = (yield from self._time_of_ramp(abs(self._number * self._unit), ramp)) if ramp else 0.0
        return axis.settings.reaction_time + axis.settings.state_timeout + round(slope * SECOND)

    def _keep_limits(self, watch: DriveWait[bool], statusword: int, heard_at: Time) -> None:
        """Raise LimitReachedError if the drive has to stop now, or a limit of its own holds it."""
        axis, position = self._axis, self._axis.position_counts
        known_at = watch.heard(objects.POSITION_ACTUAL_VALUE)
        if self._is_bounded:
            refusal = watch.refusal(objects.POSITION_ACTUAL_VALUE)
            if refusal is not None:
                raise refusal
            near = None if known_at is None or position is None else self._limit_near(position, known_at)
            if near is not None and position is not None:
                failed = f"was halted at {axis.scale.from_counts(position):g}"
                reason = f"it came near {near.value:g} ({near.source})"
                remedy = "the other direction" if near is self._bound else "look at its polarity (0x607E), and for what pulls it"
                raise LimitReachedError(axis, failed, reason=reason, remedy=remedy, looks=False)
        stands = self._mode is Mode.PROFILE_VELOCITY and statusword & ModeStatus.SPEED_ZERO
        has_begun = heard_at - self._began >= axis.settings.reaction_time
        if stands and self._number and has_begun and statusword & StatusBit.INTERNAL_LIMIT:
            raise LimitReachedError(axis, "does not run", remedy="the other direction")

    def _limit_near(self, position: int, known_at: Time) -> Limit | None:
        """Return the limit before which the drive has to be halted now."""
        needs = self._needs(position, known_at)
        if self._bound is not None and self._room(position, self._bound) <= needs:
            return self._bound
        if self._first is None:
            self._first = position
        back = (self._first - position) * self._side  # a little of it is noise
        runs_back = back > abs(self._number * self._unit) * FRESH / SECOND
        return self._behind if self._behind is not None and runs_back and -self._room(position, self._behind) <= needs else None

    def _needs(self, position: int, known_at: Time) -> float:
        """Return the way that the drive needs to stop: more than planned if it goes faster than it was told."""
        before, self._looked = self._looked, self._looked or (known_at, position)
        if before is None or known_at - before[0] < _MEASURED:
            return self._margin
        self._looked = known_at, position
        speed = abs(position - before[1]) * SECOND / (known_at - before[0])
        told = abs(self._number * self._unit)
        return self._margin * max(1.0, (speed / told) ** 2) if told else self._margin

    def _shows_velocity(self, watch: DriveWait[bool], statusword: int, heard_at: Time) -> bool:
        """Return whether the drive shows that it runs at its velocity."""
        if self._mode is Mode.PROFILE_VELOCITY:
            is_new = not statusword & ModeStatus.SPEED_ZERO or heard_at - self._began >= self._axis.settings.reaction_time
            return is_new and bool(statusword & StatusBit.TARGET_REACHED)
        is_missing = objects.VL_VELOCITY_DEMAND not in self._axis.node.dictionary
        if is_missing or watch.refusal(objects.VL_VELOCITY_DEMAND) is not None:
            return heard_at - self._began >= self._axis.settings.reaction_time  # it does not show it
        demand = self._axis.node.values.store.get(objects.VL_VELOCITY_DEMAND)
        known = watch.heard(objects.VL_VELOCITY_DEMAND) is not None
        return (
            known and isinstance(demand, int) and (abs(demand - self._number) <= 1 or bool(statusword & StatusBit.INTERNAL_LIMIT))
        )

    def _tell(self) -> None:
        if self._news is not None:
            axis = self._axis
            self._news(Running(self._mode, axis.scale.way_from_counts(self._number * self._unit), self._is_reached))


@as_drive_errors
def choose_velocity_mode(axis: Axis, wanted: Mode | None = None) -> Procedure[Mode]:
    """Return the mode in which a drive runs at a velocity: the wanted one, else pv, else vl.

    Raises ModeUnsupportedError, which says what the drive has.
    """
    modes = yield from read_if_present(axis.node, objects.SUPPORTED_DRIVE_MODES)
    for mode in VELOCITY_MODES if wanted is None else (wanted,):
        if mode not in VELOCITY_MODES:
            raise LocalProtocolError(f"a velocity needs profile velocity or velocity mode, not {mode_name(mode)}")
        has_mode = not isinstance(modes, int) or supported(modes, mode)
        if has_mode and TARGET_OF[mode] in axis.node.dictionary:
            return mode
    names = " nor ".join(mode_name(each) for each in (VELOCITY_MODES if wanted is None else (wanted,)))
    has = ", ".join(map(mode_name, supported_modes(modes))) if isinstance(modes, int) else ""
    reason = f"it has {has} (0x6502)" if has else "its dictionary has no target for it"
    raise ModeUnsupportedError(axis, f"has no {names}", reason=reason, remedy="a mode that it has", looks=False)


def _pair(axis: Axis, key: Mux) -> Procedure[tuple[int, int]]:
    """Read subindices 1 and 2 of an object; 0 for one that the drive lacks."""
    found = []
    for each in (key, Mux(key + 1)):
        value = yield from read_if_present(axis.node, each)
        found.append(value if isinstance(value, int) else 0)
    return found[0], found[1]


def _ratio(axis: Axis, key: Mux) -> Procedure[float]:
    """Read a factor, subindex 1 / subindex 2; 1 if the drive lacks it, or one of them is 0."""
    numerator, denominator = yield from _pair(axis, key)
    return numerator / denominator if numerator and denominator else 1.0
