"""Planted bugs of trajectories: limits, clock, blends and stops. No fuzz target knows a path; tests find them.

Believed equivalent, and so not planted: in stop_check.py, `v, w = v - bow * third, w + bow * third` left out. A velocity bulges
between two looks only where the acceleration changes its sign, and there the bounds of 3 r dr/dt p'' have more to spare than the
bulge needs. Of 30,000 random stops none was let pass that exceeds a limit.
"""

from __future__ import annotations

from typing import Final

from fuzz.mutant import Mutant

CLOCK: Final = ("tests/drives/test_path_clock.py",)
ROUNDED: Final = ("tests/data/test_path_rounding.py",)
STOPS: Final = ("tests/drives/test_stop_check.py",)
LIMITS: Final = ("tests/drives/test_path_limits.py",)
PATHS: Final = ("tests/drives/test_path.py",)

_CHECK: Final = "drives/trajectory/limit_check.py"
_CLOCK: Final = "drives/trajectory/path_clock.py"
_FITTING: Final = "drives/trajectory/fitting.py"
_MARGIN: Final = "drives/trajectory/margin.py"
_SPEED: Final = "drives/trajectory/speed_change.py"
_STOP: Final = "drives/trajectory/stop_check.py"

TRAJECTORY_MUTANTS: Final = tuple(
    Mutant(*each, in_corpus=False)
    for each in (
        # ---- the check before a motion ----
        (
            "ends_only",
            _CHECK,
            "if a < 0.0 < a1 or a1 < 0.0 < a:",
            "if a < a1 < a:",
            "a speed is highest where the acceleration is 0, and not at an end of a segment",
            LIMITS,
        ),
        (
            "corner_unseen",
            _CHECK,
            "_SAME_SPEED: Final = 1e-12",
            "_SAME_SPEED: Final = 1.0",
            "a velocity that jumps at a waypoint",
            LIMITS,
        ),
        (
            "demand_without_number",
            "drives/trajectory/path.py",
            "t * abs(c5))))) > LARGEST:",
            "t * abs(c5))))) > math.inf:",
            "a path whose speed cannot be calculated is above no limit",
            PATHS,
        ),
        # ---- the clock ----
        (
            "peak_beyond",
            _SPEED,
            "if peak > max_acceleration:",
            "if peak > 2.0 * max_acceleration:",
            "the rate changes faster than the path leaves free",
            CLOCK,
        ),
        (
            "held_without_way",
            _SPEED,
            "time, distance = hold, hold * speed",
            "time, distance = hold, 0.0",
            "behind a speed that was held for a while the path stands still",
            CLOCK,
        ),
        (
            "change_forgotten",
            _CLOCK,
            "stop_at(self._time, rate, change)",
            "stop_at(self._time, rate, 0.0)",
            "a stop that begins while the rate changes begins with a jump of the acceleration",
            CLOCK,
        ),
        (
            "resumed_at_once",
            _CLOCK,
            "if self._resumes and self.is_at_rest:",
            "if self._resumes:",
            "a stop may brake harder than the path leaves free in general; it cannot be taken back halfway",
            CLOCK,
        ),
        (
            "speed_behind_gap",
            _CLOCK,
            "self._begin(SpeedChange(0.0, 0.0, wanted,",
            "self._begin(SpeedChange(self._override, 0.0, wanted,",
            "joints that have stopped by themselves jump to the speed of the path",
            CLOCK,
        ),
        (
            "end_too_late",
            _CLOCK,
            "duration - self._time <= self.stop_time + cycle_time",
            "duration - self._time <= 0.0",
            "a path that ends in motion stops dead at its end",
            CLOCK,
        ),
        (
            "blend_from_rest",
            _CLOCK,
            "rate = override if margin.rests_at_start else 1.0 if moving else 0.0",
            "rate = override if margin.rests_at_start else 0.0",
            "a path that goes on from a motion under way begins with a standstill",
            CLOCK,
        ),
        # ---- samples with few decimals ----
        (
            "twice_the_rounding",
            _FITTING,
            "problem = _Problem(steps, positions, resolution / 2.0)",
            "problem = _Problem(steps, positions, resolution)",
            "the path leaves the positions that a file can have meant",
            ROUNDED,
        ),
        (
            "rounding_taken_for_motion",
            _FITTING,
            "return shares[-1] > _NOTHING * half and shares[len(shares) // 2] <= half",
            "return False",
            "the rounding of a file is followed, with a jerk of thousands",
            ROUNDED,
        ),
        (
            "starts_with_a_jerk",
            _FITTING,
            "            a, c = 0.0, c + a\n",
            "            a = 0.0\n",
            "the smoothest positions do not know that the path is at rest at its start",
            ROUNDED,
        ),
        # ---- what a path leaves free ----
        (
            "jerk_of_a_change",
            _MARGIN,
            "change = 2.0 * left / root if root else 0.0",
            "change = 4.0 * left / root if root else 0.0",
            "a change of the rate costs jerk, and more than the path leaves free",
            CLOCK,
        ),
        (
            "corner_on_the_way",
            _STOP,
            "if stretches[number][10]:",
            "if stretches[number][10] is None:",
            "a stop that is tried along its own way passes a jump of the acceleration unseen",
            CLOCK,
        ),
        (
            "acceleration_of_a_stop_nearly",
            _STOP,
            "if low < -most or high > most:",
            "if low < -1.05 * most or high > 1.05 * most:",
            "a stop may exceed the acceleration by a little",
            STOPS,
        ),
        (
            "jerk_of_a_stop",
            _STOP,
            "if lowest_jerk < -most_jerk or highest_jerk > most_jerk:",
            "if lowest_jerk < -2.0 * most_jerk or highest_jerk > 2.0 * most_jerk:",
            "a stop that is tried along its own way keeps no limit of the jerk",
            CLOCK,
        ),
        (
            "acceleration_of_a_stop",
            _STOP,
            "if low < -most or high > most:",
            "if low < -1.3 * most or high > 1.3 * most:",
            "nor one of the acceleration",
            CLOCK,
        ),
    )
)
