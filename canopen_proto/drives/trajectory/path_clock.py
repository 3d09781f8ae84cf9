"""`PathClock`: how fast the time of a path runs. All joints share it, so they stay on the path whatever it does.

The path's time s runs at the rate r = ds/dt, from 0 (a pause) to 1 (as planned), and never back. The rate changes with limits of
its own, which come from what the path leaves free of the limits of its joints: see margin.py. A plan that keeps a margin can
stop soon. A path that uses up its limits cannot, and is refused if a stop might take longer than a named time.

**Start and end.** A path that starts at rest (velocity and acceleration 0) starts at the rate of the override. Any other one
starts at the rate 0, and its clock gathers speed; `moving` says that the joints already move as the path starts. A path that ends
at rest is left to its own braking, at any rate. Before the end of any other one the clock brakes, so that it rests at the end.

**Late cycles.** `advance` gets the time of a cycle, not the time since the last call: so a cycle that comes late, or is missed,
delays the path, and no joint goes faster to catch up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, final

from canopen_proto.drives.trajectory.limit_check import JointLimits
from canopen_proto.drives.trajectory.margin import Margin, margin_in_steps, rest_time
from canopen_proto.drives.trajectory.path import TIME_TOLERANCE, Path, PathError, PathPoint
from canopen_proto.drives.trajectory.polynomial import turning_point
from canopen_proto.drives.trajectory.speed_change import SpeedChange
from canopen_proto.drives.trajectory.steps import finished

LONGEST_STOP: Final = 10.0
"""Seconds that a stop along the path may take, unless the caller says otherwise."""
_HALVINGS: Final = 60


@final
class PathClock:
    """Runs a path once, from its start to its end.

    limits: one for each joint. cycle_time: in s; jumps at knots count as spread over it. override: 0 to 1, see `override`.
    moving: the joints already have the velocities and accelerations of the path's start. longest_stop: in s. margin: what
    `margin_in_steps` has found for the same path, limits and times; without it that is done here, at once.

    Raises PathError if a stop along the path may take longer than that, with the joint and the place that are to blame.
    """

    __slots__ = (
        "_change", "_elapsed", "_is_ending", "_is_stopping", "_margin", "_origin", "_override", "_resumes", "_time", "path",
        "stop_time",
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
        margin: Margin | None = None,
    ) -> None:
        check_override(override)
        self.path: Final = path
        if margin is None:
            margin = finished(margin_in_steps(path, limits, cycle_time, longest_stop))
        self._margin: Final = margin
        self.stop_time: Final = margin.stop_time
        """Seconds that a stop takes at most, whenever it begins. Most are shorter: `stop` says how long."""
        rate = override if margin.rests_at_start else 1.0 if moving else 0.0
        if not margin.rests_at_end and margin.braking(rate, 0.0).distance > path.duration:
            if moving and not margin.rests_at_start:
                raise PathError(
                    f"The path takes {path.duration:g} s and ends in motion: the joints cannot brake along it before its end. "
                    "Try: a path that ends at rest."
                )
            rate = 0.0
        self._override = override
        self._is_stopping = False
        self._resumes = False  # as soon as the stop under way is over
        self._is_ending = False  # it brakes for the end of the path
        self._time = 0.0
        self._origin = 0.0  # of the path's time, where the change under way began
        self._elapsed = 0.0  # since then
        self._change = SpeedChange(rate, 0.0, override, margin.max_change, margin.max_onset)

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
        return self._is_stopping and not self._resumes

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
        """Brake along the path to rest, as soon as this place of the path allows. Near the end of a path that ends at rest
        nothing may be sooner than its end.

        Return the seconds until then, at most; 0 if the joints rest already.
        """
        self._resumes = False
        if not self._is_stopping and not self.is_at_rest:
            distance, rate, change = self._change.at(self._elapsed)
            self._begin(self._margin.stop_at(self._time, rate, change), distance)
        self._is_stopping = True
        return 0.0 if self.is_at_rest else rest_time(self._change, self.path.duration - self._origin) - self._elapsed

    def resume(self) -> None:
        """Go on along the path, at the rate of the override. A stop under way comes to its end first."""
        self._resumes = self._is_stopping

    def after_gap(self, lost_cycles: int = 0, *, from_rest: bool = True) -> None:
        """Go on after cycles without a SYNC. However many they are, the path is where it was.

        from_rest: at the rate 0, and gather speed again: the joints have come to rest by themselves, as drives do if a SYNC stays
        away. They would have to jump to the speed of the path otherwise.
        """
        if from_rest and not self.is_finished:
            self._origin = self._time
            wanted = 0.0 if self._is_stopping else self._override
            self._begin(SpeedChange(0.0, 0.0, wanted, self._margin.max_change, self._margin.max_onset), 0.0)

    def advance(self, cycle_time: float) -> PathPoint:
        """Let one cycle pass, and return where the joints have to be at its end, in real time.

        cycle_time: in s, 0 or more. Never the time since the last call: see this module's text.
        """
        if not 0.0 <= cycle_time < math.inf:
            raise PathError(f"The path cannot go on by {cycle_time!r} s. Try: the time of one cycle.")
        if self._resumes and self.is_at_rest:
            self._resumes = self._is_stopping = False
            self._aim_at(self._override)
        duration = self.path.duration
        ends_itself = self._margin.rests_at_end or self._is_ending or self._is_stopping
        if not ends_itself and duration - self._time <= self.stop_time + cycle_time:
            cycle_time -= self._brake_for_end(cycle_time)
        self._elapsed += cycle_time
        distance, rate, change = self._change.at(self._elapsed)
        self._time = max(self._time, self._origin + distance)
        if self._time >= duration - TIME_TOLERANCE * max(1.0, duration):
            self._time = duration
            rate = change = 0.0
        point = self.path.at(self._time)
        if rate == 1.0 and change == 0.0:
            return point  # as planned, in nearly all cycles
        rate = max(0.0, rate)
        square = rate * rate
        positions, velocities, accelerations = point
        return PathPoint(
            positions,
            [velocity * rate for velocity in velocities],
            [acceleration * square + velocity * change for velocity, acceleration in zip(velocities, accelerations, strict=True)],
        )

    def _aim_at(self, rate: float) -> None:
        """Change the rate from now on. If the clock brakes for the end, the next `advance` finds that out again."""
        if self.is_finished or (rate == self._change.wanted and not self._is_ending):
            return
        distance, now, change = self._change.at(self._elapsed)
        self._begin(SpeedChange(now, change, rate, self._margin.max_change, self._margin.max_onset), distance)

    def _begin(self, change: SpeedChange, distance: float) -> None:
        """Begin this change of the rate, `distance` after the one before began."""
        self._change = change
        self._origin += distance
        self._elapsed = 0.0
        self._is_ending = False

    def _spare(self, after: float) -> float:
        """Return the path's time that is left if the clock begins to brake `after` s from now."""
        distance, rate, change = self._change.at(self._elapsed + after)
        return self.path.duration - self._origin - distance - self._margin.braking(rate, change).distance

    def _brake_for_end(self, cycle_time: float) -> float:
        """Begin to brake if the end would be missed otherwise. Return the part of the cycle that passed before."""
        if self._spare(cycle_time) >= 0.0:
            return 0.0
        early, _ = turning_point(lambda after: not self._spare(after) >= 0.0, cycle_time, _HALVINGS)
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
