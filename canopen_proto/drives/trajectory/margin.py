"""`Margin`: what a path leaves free for changes of its rate, over all of it, or just ahead.

With q the path of a joint and ' for d/ds, at the rate r = ds/dt the joint moves at

    speed         q' r
    acceleration  q'' r² + q' dr/dt
    jerk          q''' r³ + 3 q'' r dr/dt + q' d²r/dt²

so a change of the rate costs acceleration and jerk. If dr/dt stays within A, and d²r/dt² within J, each joint keeps its limits
where

    |q''| + |q'| A <= acceleration          |q'''| + 3 |q''| A + |q'| J <= jerk

These hold for each segment with its largest q', q'' and q'''. Of the pairs A, J that a path allows, the one with the shortest
stop is taken. They are found over the whole path, for any change at any time. A stop looks only as far ahead as it goes: often
the joints have a constant speed there, and may brake as hard as they can. And where a joint gathers speed, braking along the path
takes acceleration away at first: q'' r² and q' dr/dt have different signs, and |q'| A <= acceleration is enough.

A stop that is stronger than that is tried too, and checked along its own way, where the rate falls: see stop_check.py.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Generator, Sequence
from typing import Final, NamedTuple, TypeAlias, final

from canopen_proto.drives.trajectory.limit_check import Demand, JointLimits, check_cycle, check_same_count, demands_of
from canopen_proto.drives.trajectory.path import Path, PathError, PathPoint
from canopen_proto.drives.trajectory.polynomial import Extremes
from canopen_proto.drives.trajectory.speed_change import SpeedChange
from canopen_proto.drives.trajectory.steps import PART
from canopen_proto.drives.trajectory.stop_check import Stretch, keeps_limits, motion_at, pieces_of, stretches_of

FASTEST_CHANGE: Final = 20.0
"""The rate changes by no more per second, even where no joint has a limit."""
FASTEST_ONSET: Final = 20.0 * FASTEST_CHANGE
"""Nor does its change, per second². So a stop takes 0.1 s at least: within a few cycles it would be a step for the drives."""
REST: Final = 1e-7
"""A velocity or acceleration at an end of a path counts as 0 up to this part of the largest one of its joint."""
_STEEPNESS: Final[tuple[float, ...]] = (1.0, 2.0, 4.0, 8.0, 16.0)
"""The ratios J / A² that are tried. With 1 the change of the rate grows, and falls at once; with 16 it is mostly held."""
_SEEN_CYCLES: Final = 3
"""Cycles for which a drive that computes a jerk from its positions still sees a knot."""

_TRIED_STEEPNESS: Final[tuple[float, ...]] = (3.0, 8.0)
"""The ratios J / A² of a stop that is checked along its own way."""
_LADDER: Final = 1.2
"""Each stop that is tried takes so many times as long as the one before."""
_WORTH: Final = 0.97
"""A stop that is longer than this part of the known one is not worth its check."""
_CHECKS: Final = 50
"""So many joints are asked at most, about all stops that are tried: a stop begins in the turn of one cycle."""


Need: TypeAlias = tuple[float, float, float, float, bool]
"""A `Demand`, as far as a stop has to know it: its begin, the largest amounts of speed, acceleration and jerk; and whether the
joint gathers speed, all along."""


@final
class Margin:
    """The speed, acceleration and jerk that a path leaves free; made by `margin_in_steps`.

    max_change, max_onset: A and J for the whole path. stop_time: seconds that a stop takes with them at most, whenever it begins.
    rests_at_start, rests_at_end: whether no joint has a velocity or an acceleration there.
    """

    __slots__ = (
        "_cycle_time", "_duration", "_limits", "_needs", "_stretches", "max_change", "max_onset", "rests_at_end",
        "rests_at_start", "stop_time",
    )  # fmt: skip

    def __init__(
        self,
        duration: float,
        limits: Sequence[JointLimits],
        cycle_time: float,
        needs: list[list[Need]],
        stretches: list[list[Stretch]],
        best: tuple[float, float, float],
        rests: tuple[bool, bool],
    ) -> None:
        """duration: of the path. needs, stretches: of its joints. best: see `_Room.best`. rests: at start and end."""
        self._limits = limits
        self._cycle_time = cycle_time
        self._duration = duration
        self._needs = needs
        self._stretches = stretches
        self.max_change, self.max_onset, self.stop_time = best
        self.rests_at_start, self.rests_at_end = rests

    def braking(self, rate: float, change: float) -> SpeedChange:
        """Return how the clock brakes from this rate and change of rate, anywhere on the path."""
        return SpeedChange(rate, change, 0.0, self.max_change, self.max_onset)

    def stop_at(self, time: float, rate: float, change: float) -> SpeedChange:
        """Return the stop that is over soonest of those that are tried, from this time of the path on. time: s of the path. rate:
        s of the path per second, 0 or more. change: of the rate, per second.

        While joints gather speed, the rate can fall only slowly, with what the path leaves of their jerk. Braking behind that may
        be over sooner, and no further on the path; then the rate is held until there.
        """
        ramps = self._own_stops(time, rate, change)
        stop = self.braking_at(time, rate, change, ramps)
        if change != 0.0 or rate <= 0.0 or not self.rests_at_end:
            return stop
        left = self._duration - time
        lasts = rest_time(stop, left)
        latest = time + rate * (_WORTH * lasts - max(ramps))
        places = [place for needs in self._needs if time < (place := _end_of_gathering(needs, time)) < latest]
        if not places:
            return stop
        place = max(places)
        hold = (place - time) / rate
        later = self.braking_at(place, rate, 0.0, self._own_stops(place, rate, 0.0), _WORTH * lasts - hold)
        if later.wanted != 0.0 or hold + later.duration > _WORTH * lasts:
            return stop
        held = SpeedChange(rate, 0.0, 0.0, later.max_acceleration, later.max_jerk, hold)
        return held if held.distance <= min(left, stop.at(lasts)[0]) else stop

    def braking_at(
        self, time: float, rate: float, change: float, ramps: Sequence[float] | None = None, worth: float = math.inf
    ) -> SpeedChange:
        """Return the shortest stop whose braking begins at this time of the path. time, rate, change: as of `stop_at`. ramps: the
        `_own_stops`, if they are known. worth: a stop that takes longer, in s, is as good as any other one.

        It looks at the place itself, then as far as the stop would go that this place allows, and so on until a stop ends within
        what was looked at. Then it tries whether a stronger one, or the end of the path, is sooner: see `rest_time`.
        """
        ramps = self._own_stops(time, rate, change) if ramps is None else ramps
        anywhere = self.braking(rate, change)
        room = _Room()
        since, until = time - _SEEN_CYCLES * self._cycle_time, time
        nexts = [max(0, bisect_right(needs, since, key=_begin_of) - 1) for needs in self._needs]
        while True:
            for joint, needs in enumerate(self._needs):
                number = nexts[joint]
                while number < len(needs) and needs[number][0] <= until:
                    room.narrow(joint, needs[number], self._limits[joint])
                    number += 1
                nexts[joint] = number
            found = room.braking(rate, change)
            if found is None or found.duration >= anywhere.duration:
                return self._sooner(time, rate, change, anywhere, ramps, worth)
            if time + found.distance <= until:
                return self._sooner(time, rate, change, found, ramps, worth)
            until = time + found.distance

    def _sooner(
        self, time: float, rate: float, change: float, known: SpeedChange, ramps: Sequence[float], worth: float
    ) -> SpeedChange:
        """Return a stop that is over sooner than the known one if there is one that surely keeps the limits, else the known one.
        ramps, worth: as of `braking_at`.

        The end of the path may be that stop. Of the others the shortest ones are tried first, and the joint that refused the last
        one is asked first about the next.
        """
        left = self._duration - time
        if self.rests_at_end:
            onwards = max(0.0, rate + change * abs(change) / (2.0 * self.max_onset))
            until_end = SpeedChange(rate, change, onwards, self.max_change, self.max_onset)
            known = min(known, until_end, key=lambda each: rest_time(each, left))
        order = sorted(range(len(ramps)), key=ramps.__getitem__, reverse=True)
        seen = _SEEN_CYCLES * self._cycle_time
        room = _CHECKS
        within = rest_time(known, left) * _WORTH
        takes = max(2.0 / FASTEST_CHANGE, ramps[order[0]])
        while takes < within and room > 0:
            # Without a change of the rate now, a stop takes `takes`, or less if its peak is not reached: 2 sqrt(r / J) then
            if change == 0.0 and takes * _least_part(rate) > worth:
                return known
            for steepness in _TRIED_STEEPNESS:
                most = (rate + 1.0 / steepness) / takes
                onset = steepness * most * most
                without = rate + change * abs(change) / (2.0 * onset)
                if most > FASTEST_CHANGE or onset > FASTEST_ONSET or most < abs(change) or not 0.0 <= without <= 1.0:
                    continue
                stop = SpeedChange(rate, change, 0.0, most, onset)
                if stop.distance > left and (not self.rests_at_end or rest_time(stop, left) > within):
                    continue
                if stop.duration > within and stop.distance <= left:
                    continue
                pieces = pieces_of(stop, time)
                for number, joint in enumerate(order):
                    room -= 1
                    if not keeps_limits(pieces, self._stretches[joint], self._limits[joint], seen):
                        order.insert(0, order.pop(number))
                        break
                else:
                    return stop
            takes *= _LADDER
        return known

    def _own_stops(self, time: float, rate: float, change: float) -> list[float]:
        """Return the seconds that each joint would need to stop by its own ramp."""
        return [self._own_stop(joint, time, rate, change) for joint in range(len(self._stretches))]

    def _own_stop(self, joint: int, time: float, rate: float, change: float) -> float:
        """Return the seconds that the joint would need to stop by its own ramp; 0 if it has not both limits."""
        limits = self._limits[joint]
        if limits.acceleration is None or limits.jerk is None or limits.acceleration + limits.jerk == math.inf:
            return 0.0
        speed, acceleration = motion_at(self._stretches[joint], time)
        now = acceleration * rate * rate + speed * change
        now = min(max(now, -limits.acceleration), limits.acceleration)
        return SpeedChange.seconds(speed * rate, now, 0.0, limits.acceleration, limits.jerk)


def margin_in_steps(
    path: Path, limits: Sequence[JointLimits], cycle_time: float, longest_stop: float
) -> Generator[None, None, Margin]:
    """Find what a path leaves free, in steps; see steps.py. limits: one for each joint. cycle_time: s between two set-points.
    longest_stop: s.

    Raises PathError for arguments that do not fit the path; and if its stop_time is above `longest_stop`, with the joint and the
    place to blame.
    """
    check_same_count(path, limits)
    check_cycle(cycle_time)
    rests_at_start = rests_at_end = True
    start, end = path.start, path.end
    room = _Room()
    all_needs, all_stretches = [], []
    for joint, own in enumerate(limits):
        most_speed = most_acceleration = 0.0
        needs: list[Need] = []
        stretches: list[Stretch] = []
        for number in range(0, len(path.pieces[joint]), PART):
            for demand in demands_of(path, joint, cycle_time, number, PART):
                begin, speed, acceleration, jerk = demand
                need = begin, speed.magnitude, acceleration.magnitude, jerk.magnitude, _gathers_speed(speed, acceleration)
                room.narrow(joint, need, own, demand)
                most_speed = max(most_speed, need[1])
                most_acceleration = max(most_acceleration, need[2])
                needs.append(need)
            stretches += stretches_of(path.pieces[joint], number, PART)
            yield
        all_needs.append(needs)
        all_stretches.append(stretches)
        rests_at_start = rests_at_start and _rests(start, joint, REST * most_speed, REST * most_acceleration)
        rests_at_end = rests_at_end and _rests(end, joint, REST * most_speed, REST * most_acceleration)
    rests = rests_at_start, rests_at_end
    return Margin(path.duration, limits, cycle_time, all_needs, all_stretches, room.best(longest_stop), rests)


def _least_part(rate: float) -> float:
    """Return which part of `takes` the stops from this rate that are tried need at least."""
    parts = [1.0 if rate * each >= 1.0 else 2.0 * math.sqrt(rate * each) / (rate * each + 1.0) for each in _TRIED_STEEPNESS]
    return min(parts) * (1.0 - 1e-9)


def rest_time(stop: SpeedChange, left: float) -> float:
    """Return the seconds after which the joints rest, at the latest. left: of the path's time, when the change begins. stop: the
    change of the rate."""
    end = stop.time_at(left)
    return min(stop.duration, end) if stop.wanted == 0.0 else end


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
    """The room that a path leaves for changes of its rate: for each ratio J / A² the largest A, and its cause."""

    __slots__ = ("causes", "changes")

    def __init__(self) -> None:
        self.changes = [min(FASTEST_CHANGE, math.sqrt(FASTEST_ONSET / steepness)) for steepness in _STEEPNESS]
        self.causes: list[_Cause | None] = [None] * len(_STEEPNESS)

    def narrow(self, joint: int, need: Need, limits: JointLimits, demand: Demand | None = None) -> None:
        """Lower each A to what this part of the path leaves free. demand: the need as it was found, which may be to blame.

        Without it the room is for a stop: dr/dt grows no more, wherever it is above 0.
        """
        _, speed, acceleration, jerk, gathers_speed = need
        most = math.inf if limits.acceleration is None else limits.acceleration
        free = most if demand is None and gathers_speed and acceleration <= most else max(0.0, most - acceleration)
        most_jerk = math.inf if limits.jerk is None else limits.jerk
        # A falls with the ratio and J grows, so these two are the largest ones: most parts of a path allow even both.
        change, onset = self.changes[0], _STEEPNESS[-1] * self.changes[-1] * self.changes[-1]
        if speed * change <= free and jerk + 3.0 * acceleration * change + speed * onset <= most_jerk:
            return
        for number, steepness in enumerate(_STEEPNESS):
            change = self.changes[number]
            if speed * change > free:
                change = free / speed
                if demand is not None:
                    self.causes[number] = _Cause(joint, "acceleration", demand.acceleration, most)
            if jerk + 3.0 * acceleration * change + speed * steepness * change * change > most_jerk:
                left = max(0.0, most_jerk - jerk)
                root = 3.0 * acceleration + math.sqrt(9.0 * acceleration * acceleration + 4.0 * speed * steepness * left)
                change = 2.0 * left / root if root else 0.0
                if demand is not None:
                    self.causes[number] = _Cause(joint, "jerk", demand.jerk, most_jerk)
            self.changes[number] = change

    def best(self, longest_stop: float) -> tuple[float, float, float]:
        """Return the A and J with the shortest stop, and how long it takes at most: the rate may still grow when it begins.

        Raises PathError if that is longer than `longest_stop`.
        """
        shortest, chosen = math.inf, 0
        for number, steepness in enumerate(_STEEPNESS):
            change = self.changes[number]
            takes = (1.0 + 2.0 / steepness) / change if change else math.inf
            if takes < shortest:
                shortest, chosen = takes, number
        if shortest > longest_stop:
            free = "nothing free for a stop along it"
            if shortest < math.inf:
                free = f"so little free that a stop along it may take {shortest:.3g} s, and {longest_stop:g} s are allowed"
            raise PathError(
                f"The path leaves {free}. {self.causes[chosen] or ''} Try: the path `stretched`, a plan with a larger margin, "
                "or higher limits."
            )
        change = self.changes[chosen]
        return change, _STEEPNESS[chosen] * change * change, shortest

    def braking(self, rate: float, change: float) -> SpeedChange | None:
        """Return the fastest way to the rate 0 that keeps the rate within 0 to 1; None if each one leaves this range."""
        fastest: SpeedChange | None = None
        for number, steepness in enumerate(_STEEPNESS):
            most = self.changes[number]
            onset = steepness * most * most
            if most < abs(change) or onset == 0.0:
                continue
            without = rate + change * abs(change) / (2.0 * onset)
            if 0.0 <= without <= 1.0 + 1e-9:
                found = SpeedChange(rate, change, 0.0, most, onset)
                if fastest is None or found.duration < fastest.duration:
                    fastest = found
        return fastest


def _gathers_speed(speed: Extremes, acceleration: Extremes) -> bool:
    """Return whether velocity and acceleration have one sign, all along."""
    return (speed.low >= 0.0 and acceleration.low >= 0.0) or (speed.high <= 0.0 and acceleration.high <= 0.0)


def _end_of_gathering(needs: Sequence[Need], time: float) -> float:
    """Return the time of the path at which a joint has stopped gathering speed, or this time if it does not."""
    number = max(0, bisect_right(needs, time, key=_begin_of) - 1)
    while number < len(needs) and needs[number][4] and needs[number][2] > 0.0:
        time = math.inf if number + 1 == len(needs) else needs[number + 1][0]
        number += 1
    return time


def _begin_of(need: Need) -> float:
    return need[0]
