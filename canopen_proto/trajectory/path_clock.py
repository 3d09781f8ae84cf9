"""`PathClock`: how fast the time of a path runs. All joints share it, so they stay on the path whatever it does.

The path's time s runs at the rate r = ds/dt, from 0 (a pause) to 1 (as planned), and never back. With q the path of a joint and
' for d/ds, the joint moves at

    speed         q' r
    acceleration  q'' r² + q' dr/dt
    jerk          q''' r³ + 3 q'' r dr/dt + q' d²r/dt²

so a change of the rate costs acceleration and jerk. The rate changes by at most A, and its change by at most J, such that each
joint keeps its limits in each segment of the path:

    |q''| + |q'| A <= acceleration          |q'''| + 3 |q''| A + |q'| J <= jerk

A plan that keeps a reserve of both can stop soon. A path that uses up its limits cannot: it is refused if a stop would take
longer than a named time. Of the pairs A, J that the path allows, one is taken with which a stop is short.

**Start and end.** A path that starts at rest (velocity and acceleration 0) starts at the rate of the override. Any other one
starts at the rate 0, and its clock gathers speed; `moving` says that the joints already move as the path starts. A path that ends
at rest is left to its own braking, at any rate. Before the end of any other one the clock brakes, so that it rests at the end.

**Late cycles.** `advance` gets the time of a cycle, not the time since the last call: so a cycle that comes late, or is missed,
delays the path, and no joint goes faster to catch up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, final

from canopen_proto.trajectory.limit_check import Demand, JointLimits, check_cycle, check_same_count, demands_of
from canopen_proto.trajectory.path import TIME_TOLERANCE, Path, PathError, PathPoint
from canopen_proto.trajectory.polynomial import Extremes
from canopen_proto.trajectory.speed_change import SpeedChange

FASTEST_CHANGE: Final = 20.0
"""The rate changes by no more per second, even where no joint has a limit."""
FASTEST_ONSET: Final = 20.0 * FASTEST_CHANGE
"""Nor does its change, per second². So a stop takes 0.1 s at least: within a few cycles it would be a step for the drives."""
LONGEST_STOP: Final = 10.0
"""Seconds that a stop along the path may take, unless the caller says otherwise."""
REST: Final = 1e-7
"""A velocity or acceleration at an end of a path counts as 0 up to this part of the largest one of its joint."""
_STEEPNESS: Final[tuple[float, ...]] = (1.0, 2.0, 4.0, 8.0, 16.0)
"""The ratios J / A² that are tried. With 1 the change of the rate grows, and falls at once; with 16 it is mostly held."""
_HALVINGS: Final = 60


@final
class PathClock:
    """Runs a path once, from its start to its end.

    limits: one for each joint. cycle_time: in s; jumps at knots count as spread over it. override: 0 to 1, see `override`.
    moving: the joints already have the velocities and accelerations of the path's start. longest_stop: in s.

    Raises PathError if a stop along the path may take longer than that, with the joint and the place that are to blame.
    """

    __slots__ = (
        "_brakes_at_end", "_change", "_elapsed", "_is_ending", "_is_stopping", "_max_change", "_max_onset", "_origin",
        "_override", "_time", "path", "stop_time",
    )  # fmt: skip

    def __init__(
        self,
        path: Path,
        limits: Sequence[JointLimits],
        cycle_time: float,
        *,
        override: float = 1.0,
        moving: bool = False,
        longest_stop: float = LONGEST_STOP,
    ) -> None:
        check_same_count(path, limits)
        check_cycle(cycle_time)
        check_override(override)
        self.path: Final = path
        room = _Room()
        rests_at_start = rests_at_end = True
        start, end = path.start, path.end
        for joint, own in enumerate(limits):
            speed = acceleration = 0.0
            for demand in demands_of(path, joint, cycle_time):
                room.narrow(joint, demand, own)
                speed = max(speed, demand.speed.magnitude)
                acceleration = max(acceleration, demand.acceleration.magnitude)
            rests_at_start = rests_at_start and _rests(start, joint, REST * speed, REST * acceleration)
            rests_at_end = rests_at_end and _rests(end, joint, REST * speed, REST * acceleration)
        self._max_change, self._max_onset = room.best(longest_stop)
        self._brakes_at_end: Final = not rests_at_end
        rate = override if rests_at_start else 1.0 if moving else 0.0
        if self._brakes_at_end and self._braking(rate, 0.0).distance > path.duration:
            if moving and not rests_at_start:
                raise PathError(
                    f"The path takes {path.duration:g} s and ends in motion: the joints cannot brake along it before its end. "
                    "Try: a path that ends at rest."
                )
            rate = 0.0
        self.stop_time: Final = self._braking(1.0, 0.0).duration + self._max_change / self._max_onset
        """Seconds that a stop takes at most, whenever it begins."""
        self._override = override
        self._is_stopping = False
        self._is_ending = False  # it brakes for the end of the path
        self._time = 0.0
        self._origin = 0.0  # of the path's time, where the change under way began
        self._elapsed = 0.0  # since then
        self._change = SpeedChange(rate, 0.0, override, self._max_change, self._max_onset)

    @property
    def time(self) -> float:
        """The path's time in s, from 0 to its duration."""
        return self._time

    @property
    def rate(self) -> float:
        """How fast the path's time runs, 0 to 1. It goes to the override with limited changes."""
        return 0.0 if self.is_finished else max(0.0, self._change.at(self._elapsed)[1])

    @property
    def is_finished(self) -> bool:
        """Whether the joints rest at the end of the path."""
        return self._time >= self.path.duration

    @property
    def is_at_rest(self) -> bool:
        """Whether the joints rest, on the path or at its end: stopped, finished, or paused by an override of 0."""
        return self.is_finished or (self._change.wanted == 0.0 and self._elapsed >= self._change.duration)

    @property
    def is_stopping(self) -> bool:
        """Whether `stop` was called and `resume` was not; the joints may already rest."""
        return self._is_stopping

    @property
    def override(self) -> float:
        """The rate that is wanted, 0 to 1; 0 is a pause on the path. It may be set at any time, and counts unless `stop` holds.

        Raises PathError for any other value.
        """
        return self._override

    @override.setter
    def override(self, override: float) -> None:
        check_override(override)
        self._override = override
        if not self._is_stopping:
            self._aim_at(override)

    def stop(self) -> float:
        """Brake along the path, to rest. Return the seconds until then, at most; 0 if the joints rest already."""
        self._is_stopping = True
        self._aim_at(0.0)
        return 0.0 if self.is_at_rest else self._change.duration - self._elapsed

    def resume(self) -> None:
        """Go on along the path, at the rate of the override. A stop under way need not be over."""
        self._is_stopping = False
        self._aim_at(self._override)

    def start_again(self) -> None:
        """Go on from the present point at the rate 0, and gather speed again: the joints have come to rest by themselves.

        Drives do that if a SYNC stays away. They would have to jump to the speed of the path otherwise.
        """
        if not self.is_finished:
            self._origin, self._elapsed, self._is_ending = self._time, 0.0, False
            self._change = SpeedChange(0.0, 0.0, self._change.wanted, self._max_change, self._max_onset)

    def advance(self, cycle_time: float) -> PathPoint:
        """Let one cycle pass, and return where the joints have to be at its end, in real time.

        cycle_time: in s, 0 or more. Never the time since the last call: see this module's text.
        """
        if not 0.0 <= cycle_time < math.inf:
            raise PathError(f"The path cannot go on by {cycle_time!r} s. Try: the time of one cycle.")
        duration = self.path.duration
        if self._brakes_at_end and not self._is_ending and duration - self._time <= self.stop_time + cycle_time:
            cycle_time -= self._brake_for_end(cycle_time)
        self._elapsed += cycle_time
        distance, rate, change = self._change.at(self._elapsed)
        self._time = max(self._time, self._origin + distance)
        if self._time >= duration - TIME_TOLERANCE * max(1.0, duration):
            self._time = duration
            rate = change = 0.0
        rate = max(0.0, rate)
        square = rate * rate
        positions, velocities, accelerations = self.path.at(self._time)
        return PathPoint(
            positions,
            [velocity * rate for velocity in velocities],
            [acceleration * square + velocity * change for velocity, acceleration in zip(velocities, accelerations, strict=True)],
        )

    def _aim_at(self, rate: float) -> None:
        """Change the rate from now on. If the clock brakes for the end, the next `advance` finds that out again."""
        if rate == self._change.wanted and not self._is_ending:
            return
        distance, now, change = self._change.at(self._elapsed)
        self._change = SpeedChange(now, change, rate, self._max_change, self._max_onset)
        self._origin += distance
        self._elapsed = 0.0
        self._is_ending = False

    def _braking(self, rate: float, change: float) -> SpeedChange:
        return SpeedChange(rate, change, 0.0, self._max_change, self._max_onset)

    def _spare(self, after: float) -> float:
        """Return the path's time that is left if the clock begins to brake `after` s from now."""
        distance, rate, change = self._change.at(self._elapsed + after)
        return self.path.duration - self._origin - distance - self._braking(rate, change).distance

    def _brake_for_end(self, cycle_time: float) -> float:
        """Begin to brake if the end would be missed otherwise. Return the part of the cycle that passed before."""
        if self._spare(cycle_time) >= 0.0:
            return 0.0
        early, late = 0.0, cycle_time
        for _ in range(_HALVINGS):
            middle = 0.5 * (early + late)
            if self._spare(middle) >= 0.0:
                early = middle
            else:
                late = middle
        self._elapsed += early
        self._aim_at(0.0)
        self._is_ending = True
        return early


def check_override(override: float) -> None:
    """Raise PathError unless this is an override."""
    if not 0.0 <= override <= 1.0:
        raise PathError(
            f"An override is from 0 (a pause on the path) to 1 (as planned); it is {override!r}. Try: 0.5 for half speed."
        )


def _rests(point: PathPoint, joint: int, velocity: float, acceleration: float) -> bool:
    return abs(point.velocities[joint]) <= velocity and abs(point.accelerations[joint]) <= acceleration


class _Cause(NamedTuple):
    """Where a path leaves least free."""

    joint: int
    kind: str
    extremes: Extremes
    limit: float

    def __str__(self) -> str:
        low, low_time, high, high_time = self.extremes
        value, time = (high, high_time) if high >= -low else (-low, low_time)
        return f"Joint {self.joint} needs the {self.kind} {value:.6g} at {time:.6g} s of the path, and has {self.limit:.6g}."


@final
class _Room:
    """What a path leaves free for changes of its rate: for each ratio J / A² the largest A, and what set it."""

    __slots__ = ("causes", "changes")

    def __init__(self) -> None:
        self.changes = [min(FASTEST_CHANGE, math.sqrt(FASTEST_ONSET / steepness)) for steepness in _STEEPNESS]
        self.causes: list[_Cause | None] = [None] * len(_STEEPNESS)

    def narrow(self, joint: int, demand: Demand, limits: JointLimits) -> None:
        """Lower each A to what this part of the path leaves free."""
        speed, acceleration, jerk = demand.speed.magnitude, demand.acceleration.magnitude, demand.jerk.magnitude
        most = math.inf if limits.acceleration is None else limits.acceleration
        most_jerk = math.inf if limits.jerk is None else limits.jerk
        # A falls with the ratio and J grows, so these two are the largest ones: most parts of a path allow even both.
        change, onset = self.changes[0], _STEEPNESS[-1] * self.changes[-1] * self.changes[-1]
        if acceleration + speed * change <= most and jerk + 3.0 * acceleration * change + speed * onset <= most_jerk:
            return
        for number, steepness in enumerate(_STEEPNESS):
            change = self.changes[number]
            if acceleration + speed * change > most:
                change = max(0.0, most - acceleration) / speed if speed else 0.0
                self.causes[number] = _Cause(joint, "acceleration", demand.acceleration, most)
            if jerk + 3.0 * acceleration * change + speed * steepness * change * change > most_jerk:
                free = max(0.0, most_jerk - jerk)
                root = math.sqrt(9.0 * acceleration * acceleration + 4.0 * speed * steepness * free)
                change = 2.0 * free / (3.0 * acceleration + root) if free else 0.0
                self.causes[number] = _Cause(joint, "jerk", demand.jerk, most_jerk)
            self.changes[number] = change

    def best(self, longest_stop: float) -> tuple[float, float]:
        """Return the A and J with the shortest stop. Raises PathError if it is longer than `longest_stop`."""
        shortest, chosen = math.inf, 0
        for number, steepness in enumerate(_STEEPNESS):
            change = self.changes[number]
            takes = (1.0 + 1.0 / steepness) / change if change else math.inf
            if takes < shortest:
                shortest, chosen = takes, number
        cause = self.causes[chosen]
        if shortest > longest_stop:
            reason = "" if cause is None else f" {cause}"
            free = "nothing free for a stop along it"
            if shortest < math.inf:
                free = f"so little free that a stop along it would take {shortest:.3g} s, and {longest_stop:g} s are allowed"
            raise PathError(
                f"The path leaves {free}.{reason} Try: the path `stretched`, a plan with a larger reserve, or higher limits."
            )
        change = self.changes[chosen]
        return change, _STEEPNESS[chosen] * change * change
