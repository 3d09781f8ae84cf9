"""The simulated drive against the theory of its plant: step answers, stopping distances, torques, following errors.

Each check measures a drive and compares it with a formula of the nominal mechanics. So a drive with other mechanics must fail
them: the planted faults at the end.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import pytest

from canopen_proto.machine import MICROSECOND, Time
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from tests.simulation.drive_bench import Bench

CROSSOVER = 2 * math.pi * 10  # rad/s, of the velocity loop
NOMINAL = Mechanics(
    inertia=0.5,
    viscous_friction=0.0,
    coulomb_friction=0.0,
    peak_torque=300.0,
    torque_lag=0.0,
    velocity_gain=0.5 * CROSSOVER,
    integral_time=math.inf,
    position_gain=CROSSOVER,  # damping 0.5: it overshoots by 16 %
    velocity_feed_forward=0.0,
    acceleration_feed_forward=0.0,
)
UNITS = NOMINAL.units_per_radian
FED_FORWARD = {"velocity_feed_forward": 1.0, "acceleration_feed_forward": 1.0}
FREE = Track(-math.inf, math.inf)


class Result(NamedTuple):
    """A measured value, that of the theory, and by how much of it they may differ."""

    measured: float
    expected: float
    tolerance: float

    @property
    def is_right(self) -> bool:
        return abs(self.measured - self.expected) <= self.tolerance * abs(self.expected)


Check: TypeAlias = Callable[[Mechanics], list[Result]]


def bench_of(mode: int, mechanics: Mechanics) -> Bench:
    """An enabled drive at position 0 that nothing limits but its torque."""
    bench = Bench(DriveSettings(position=0, mechanics=mechanics, track=FREE))
    for index in (0x6072, 0x6073, 0x60E0, 0x60E1):
        bench.write(index, 30_000)
    for index in (0x6080, 0x6065):
        bench.write(index, 2**32 - 1)
    bench.write(0x60C2, 1, 1)  # 1 ms
    bench.enable(mode)
    return bench


def record(bench: Bench, seconds: float, index: int) -> list[tuple[float, int]]:
    """(s since now, value) of an object, each millisecond."""
    seen = []
    for step in range(round(seconds * 1000)):
        seen.append((step / 1000, bench.read(index)))
        bench.run(1)
    return seen


def time_at(seen: list[tuple[float, int]], level: float) -> float:
    """When the value first reaches a level, between two samples by a straight line."""
    for (before, low), (after, high) in itertools.pairwise(seen):
        if high >= level:
            return before + (after - before) * (level - low) / (high - low)
    raise AssertionError(f"it never reached {level}")


def step_answer(frequency: float, damping: float, time: float) -> float:
    """Of a second-order system without zeros: rad/s, damping below 1, s."""
    damped = frequency * math.sqrt(1 - damping**2)
    swing = math.cos(damped * time) + damping / math.sqrt(1 - damping**2) * math.sin(damped * time)
    return 1 - math.exp(-damping * frequency * time) * swing


def position_step(mechanics: Mechanics) -> list[Result]:
    """P over P: s² + ωv s + ωv Kp = 0, so ωn = √(ωv Kp) and the damping is √(ωv / Kp) / 2."""
    size = 5_000
    bench = bench_of(8, mechanics)
    bench.write(0x607A, size)
    bench.drive.on_sync(bench.now)
    seen = record(bench, 0.4, 0x6064)
    frequency, damping = CROSSOVER, 0.5
    theory = [(step / 1e5, step_answer(frequency, damping, step / 1e5)) for step in range(5_000)]
    rise = next(time for time, value in theory if value >= 0.9) - next(time for time, value in theory if value >= 0.1)
    overshoot = math.exp(-math.pi * damping / math.sqrt(1 - damping**2))
    peak_time = math.pi / (frequency * math.sqrt(1 - damping**2))
    top = max(value for _, value in seen)
    return [
        Result(time_at(seen, 0.9 * size) - time_at(seen, 0.1 * size), rise, 0.03),
        Result(top / size - 1, overshoot, 0.03),
        Result(next(time for time, value in seen if value == top), peak_time, 0.05),
    ]


def velocity_step(mechanics: Mechanics) -> list[Result]:
    """The velocity loop alone is of first order: 63 % after 1 / ωv, 10 to 90 % in 2.2 / ωv."""
    bench = bench_of(9, mechanics)
    bench.write(0x60FF, 10_000)
    bench.drive.on_sync(bench.now)
    seen = record(bench, 0.09, 0x606C)
    return [
        Result(time_at(seen, 10_000 * (1 - math.exp(-1))), 1 / CROSSOVER, 0.04),
        Result(time_at(seen, 9_000) - time_at(seen, 1_000), math.log(9) / CROSSOVER, 0.03),
    ]


def torque_of_an_acceleration(mechanics: Mechanics) -> list[Result]:
    """J a, and with friction J a + b v + Tc, whatever the gains are."""
    results = []
    for viscous, coulomb in ((0.0, 0.0), (2.0, 1.0)):
        drive = replace(mechanics, **FED_FORWARD, viscous_friction=viscous, coulomb_friction=coulomb)
        bench = bench_of(1, drive)
        bench.write(0x6083, 200_000)
        bench.write(0x6081, 200_000)
        bench.write(0x607A, 10**6)
        bench.control(0x1F)
        bench.run(500)
        speed = bench.read(0x606C) / UNITS
        expected = NOMINAL.inertia * 200_000 / UNITS + viscous * speed + coulomb
        results.append(Result(bench.read(0x6077) / 100, expected, 0.02))
    return results


def acceleration_of_a_torque(mechanics: Mechanics) -> list[Result]:
    """T / J in profile torque."""
    bench = bench_of(4, mechanics)
    bench.write(0x6087, 10**9)
    bench.write(0x6071, 500)  # 5 N·m
    bench.run(20)
    start = bench.read(0x606C)
    bench.run(100)
    return [Result((bench.read(0x606C) - start) / 0.1, 5.0 / NOMINAL.inertia * UNITS, 0.01)]


def steady_following_error(mechanics: Mechanics) -> list[Result]:
    """v / Kv without feed-forward."""
    bench = bench_of(3, mechanics)
    bench.write(0x60FF, 30_000)
    bench.run(2_000)
    return [Result(bench.read(0x60F4), 30_000 / CROSSOVER, 0.01)]


def stopping_distance(mechanics: Mechanics) -> list[Result]:
    """v² / 2a with feed-forward; without, the mass has to make up for v / Kv as well."""
    results = []
    for feed_forward, behind in ((FED_FORWARD, 0.0), ({}, 40_000 / CROSSOVER)):
        bench = bench_of(3, replace(mechanics, **feed_forward))
        bench.write(0x605A, 6)
        bench.write(0x60FF, 40_000)
        bench.run(2_000)
        start = bench.position
        bench.control(0x02)
        bench.run(1_500)
        results.append(Result(bench.position - start, 40_000**2 / 2 / 400_000 + behind, 0.01))
    return results


def fall_by_a_load(mechanics: Mechanics) -> list[Result]:
    """½ (T / J) t² once the power is cut and there is no brake."""
    bench = bench_of(1, replace(mechanics, load=2.0, brake_torque=0.0))
    bench.run(2_000)
    start = bench.position
    bench.control(0x00)
    bench.run(300)
    return [Result(start - bench.position, 0.5 * 2.0 / NOMINAL.inertia * 0.3**2 * UNITS, 0.01)]


CHECKS: list[Check] = [
    position_step,
    velocity_step,
    torque_of_an_acceleration,
    acceleration_of_a_torque,
    steady_following_error,
    stopping_distance,
    fall_by_a_load,
]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_the_drive_is_as_theory_says(check: Check) -> None:
    for result in check(NOMINAL):
        assert result.is_right, result


@pytest.mark.parametrize(
    ("fault", "caught_by"),
    [
        (
            replace(NOMINAL, inertia=2 * NOMINAL.inertia),
            {position_step, velocity_step, torque_of_an_acceleration, acceleration_of_a_torque, fall_by_a_load},
        ),
        (replace(NOMINAL, position_gain=CROSSOVER / 2), {position_step, steady_following_error, stopping_distance}),
        (replace(NOMINAL, velocity_gain=0.25 * CROSSOVER), {position_step, velocity_step}),
        (replace(NOMINAL, torque_lag=0.01), {position_step, velocity_step}),
        (replace(NOMINAL, load=0.5), {acceleration_of_a_torque, torque_of_an_acceleration}),
    ],
    ids=["twice the inertia", "half the position gain", "half the velocity gain", "a slow current loop", "a load"],
)
def test_planted_faults_are_caught(fault: Mechanics, caught_by: set[Check]) -> None:
    for check in caught_by:
        assert not all(result.is_right for result in check(fault)), check.__name__


def test_the_answer_does_not_depend_on_where_the_grid_of_steps_lies() -> None:
    """A command between two steps shifts the answer by less than one step."""
    shifts: list[Time] = [0, 60 * MICROSECOND, 130 * MICROSECOND, 249 * MICROSECOND]
    overshoots = []
    for shift in shifts:
        bench = bench_of(8, NOMINAL)
        bench.run(shift / 1e6)
        bench.write(0x607A, 5_000)
        bench.drive.on_sync(bench.now)
        overshoots.append(max(value for _, value in record(bench, 0.1, 0x6064)) / 5_000 - 1)
    assert max(overshoots) - min(overshoots) < 0.005
