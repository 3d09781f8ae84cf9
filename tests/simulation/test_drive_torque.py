"""The simulated drive's modes of torque and velocity control: tq, cst, csv, and the offsets of csp; with and without a mass."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import NEVER
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from canopen_proto.simulation.drive.synchronous_modes import SyncOverdue
from tests.simulation.drive_bench import Bench

JOINT = Mechanics()
UNITS = JOINT.units_per_radian
TQ, CSP, CSV, CST = 4, 8, 9, 10
BOTH = pytest.mark.parametrize("mechanics", [None, JOINT], ids=["lag", "mass"])


def bench_of(mode: int, mechanics: Mechanics | None = JOINT, **values: int) -> Bench:
    """An enabled drive at position 0. values: objects as x6071=200."""
    bench = Bench(DriveSettings(position=0, mechanics=mechanics))
    for name, value in values.items():
        bench.write(int(name[1:], 16), value)
    bench.enable(mode)
    return bench


def syncs(bench: Bench, number: int) -> None:
    for _ in range(number):
        bench.sync()


# ---- profile torque ----


@BOTH
def test_a_torque_accelerates_the_inertia(mechanics: Mechanics | None) -> None:
    bench = bench_of(TQ, mechanics, x6087=1_000_000)
    bench.write(0x6071, 200)  # 2 N·m
    bench.run(100)
    acceleration = (2.0 - JOINT.coulomb_friction) / JOINT.inertia
    assert bench.read(0x606C) == pytest.approx(acceleration * 0.1 * UNITS, rel=0.06)  # less by the viscous friction
    assert bench.read(0x6074) == bench.read(0x6077) == 200
    assert bench.read(0x60F4) == 0


@BOTH
def test_the_slope_leads_to_the_target_and_bit_10_says_when(mechanics: Mechanics | None) -> None:
    bench = bench_of(TQ, mechanics, x6087=100)
    assert bench.has(10)  # 0 is reached
    bench.write(0x6071, 20)
    bench.run(100)
    assert bench.read(0x6074) == pytest.approx(10, abs=1)
    assert not bench.has(10)
    bench.run(120)
    assert bench.read(0x6077) == 20
    assert bench.has(10)
    assert bench.position == 0  # 0.2 N·m do not overcome the friction
    bench.run(100)
    assert bench.drive.deadline == NEVER


@BOTH
def test_an_unloaded_axis_does_not_run_away(mechanics: Mechanics | None) -> None:
    bench = Bench(DriveSettings(position=0, mechanics=mechanics, track=Track(-math.inf, math.inf)))
    bench.enable(TQ)
    bench.write(0x6080, 20)
    bench.write(0x6071, 2_000)
    bench.run(2_000)
    assert bench.read(0x606C) == pytest.approx(20 / 60 * 2 * math.pi * UNITS, rel=0.01)
    assert bench.has(11)
    assert not bench.has(10)  # the torque is taken back
    bench.write(0x6071, -2_000)
    bench.run(4_000)
    assert bench.read(0x606C) == pytest.approx(-20 / 60 * 2 * math.pi * UNITS, rel=0.01)


@BOTH
@pytest.mark.parametrize("mode", [TQ, CST])
def test_a_software_limit_stops_it_and_lets_it_come_back(mechanics: Mechanics | None, mode: int) -> None:
    bench = bench_of(mode, mechanics)
    bench.write(0x607D, 30_000, 2)
    bench.write(0x6087, 100_000)
    bench.write(0x6071, 300)
    syncs(bench, 300)
    assert 29_900 <= bench.position <= 30_100
    assert bench.read(0x606C) == 0
    assert bench.has(11)
    bench.write(0x6071, -300)
    syncs(bench, 20)
    assert bench.position < 29_000
    assert not bench.has(11)


@BOTH
def test_the_torque_limits_hold_for_a_torque(mechanics: Mechanics | None) -> None:
    bench = bench_of(TQ, mechanics, x6072=150, x6087=1_000_000)
    bench.write(0x6071, 200)
    bench.run(20)
    assert bench.read(0x6077) == 150
    assert bench.has(11)
    assert not bench.has(10)


@BOTH
def test_halt_stops_the_axis_and_its_end_lets_the_torque_act_again(mechanics: Mechanics | None) -> None:
    bench = bench_of(TQ, mechanics, x6087=1_000_000)
    bench.write(0x6071, 200)
    bench.run(100)
    start, speed = bench.position, bench.read(0x606C)
    bench.control(0x10F)
    assert not bench.has(10)
    bench.run(500)
    assert bench.has(10)
    assert bench.read(0x606C) == 0
    assert bench.position - start == pytest.approx(speed**2 / 2 / 100_000, rel=0.05)
    bench.write(0x6071, 300)  # does nothing before halt ends
    bench.run(100)
    assert bench.read(0x606C) == 0
    bench.control(0x0F)
    bench.run(100)
    assert bench.read(0x6077) == 300
    assert bench.read(0x606C) > 10_000


@BOTH
@pytest.mark.parametrize("word", [0x02, 0x07])
def test_quick_stop_and_disable_brake_by_their_ramps(mechanics: Mechanics | None, word: int) -> None:
    bench = bench_of(TQ, mechanics)
    bench.write(0x6071, 300)
    bench.run(500)
    start, speed = bench.position, bench.read(0x606C)
    assert speed > 10_000
    bench.control(word)
    bench.run(1_000)
    assert bench.state is {0x02: State.SWITCH_ON_DISABLED, 0x07: State.SWITCHED_ON}[word]
    assert bench.position - start == pytest.approx(speed**2 / 2 / {0x02: 400_000, 0x07: 100_000}[word], rel=0.05)


def test_a_drive_with_the_lag_goes_back_to_it() -> None:
    """An axis that a torque moved is at rest where the lag takes over: no jump, and pp goes on as ever."""
    bench = bench_of(TQ, None)
    bench.write(0x6071, 300)
    bench.run(200)
    bench.write(0x6060, 1)
    bench.run(2_000)
    rest = bench.position
    assert bench.read(0x606C) == 0
    bench.write(0x607A, rest + 5_000)
    bench.control(0x0F, 0x1F)
    bench.run(1_000)
    assert bench.position == rest + 5_000
    assert bench.drive.deadline == NEVER


# ---- cyclic synchronous torque and velocity ----


@BOTH
def test_cst_takes_target_and_offset_at_each_sync(mechanics: Mechanics | None) -> None:
    bench = bench_of(CST, mechanics)
    bench.write(0x6071, 150)
    bench.write(0x60B2, 50)
    bench.run(50)
    assert bench.read(0x6077) < 150
    syncs(bench, 2)
    assert bench.has(12)
    assert bench.read(0x6077) == 200
    bench.write(0x60B2, -150)
    syncs(bench, 2)
    assert bench.read(0x6077) == 0


@BOTH
def test_csv_takes_target_and_offset_at_each_sync(mechanics: Mechanics | None) -> None:
    bench = bench_of(CSV, mechanics)
    bench.write(0x60FF, 8_000)
    bench.write(0x60B1, 2_000)
    bench.run(50)
    assert bench.read(0x606C) == 0
    syncs(bench, 20)
    assert bench.has(12)
    assert not bench.has(11)
    assert bench.read(0x606B) == 10_000
    assert bench.read(0x606C) == pytest.approx(10_000, abs=2)
    bench.write(0x60FF, -2_000)
    syncs(bench, 30)
    assert bench.read(0x606C) == 0


def test_csv_adds_a_torque_and_does_not_catch_up() -> None:
    bench = bench_of(CSV)
    bench.write(0x60FF, 10_000)
    syncs(bench, 30)
    bench.drive.block(True, bench.now)
    bench.write(0x60B2, 500)
    syncs(bench, 2)
    assert bench.read(0x6077) > 500
    syncs(bench, 30)
    assert bench.state is State.OPERATION_ENABLED  # no following error: nothing has to catch up
    bench.drive.block(False, bench.now)
    bench.write(0x60B2, 0)
    before = bench.position
    syncs(bench, 100)
    assert bench.position - before < 13_000  # 10,000 and what the integral had wound up


@BOTH
def test_csv_obeys_speed_and_position_limits(mechanics: Mechanics | None) -> None:
    bench = bench_of(CSV, mechanics, x607F=5_000)
    bench.write(0x607D, 3_000, 2)
    bench.write(0x60FF, 20_000)
    syncs(bench, 30)
    assert bench.read(0x606C) == pytest.approx(5_000, abs=2)
    assert bench.has(11)
    syncs(bench, 200)
    assert bench.position == pytest.approx(3_000, abs=60)
    assert bench.has(11)
    bench.write(0x60FF, -1_000)
    syncs(bench, 30)
    assert bench.read(0x606C) == pytest.approx(-1_000, abs=2)
    assert not bench.has(11)


@BOTH
@pytest.mark.parametrize(("mode", "target"), [(CSV, 0x60FF), (CST, 0x6071)])
def test_a_lost_sync_stops_the_axis_until_the_target_is_0(mechanics: Mechanics | None, mode: int, target: int) -> None:
    bench = bench_of(mode, mechanics)
    bench.write(target, {CSV: 20_000, CST: 200}[mode])
    syncs(bench, 50)
    bench.events()
    assert bench.read(0x606C) > 15_000
    bench.run(100)
    assert bench.reported(SyncOverdue)
    bench.run(2_000)
    assert bench.read(0x606C) == 0
    assert bench.has(7)
    assert not bench.has(12)
    rest = bench.position
    syncs(bench, 10)
    assert bench.position == rest
    bench.write(target, 0)
    syncs(bench, 2)
    assert bench.has(12)
    assert not bench.has(7)
    bench.write(target, {CSV: 20_000, CST: 200}[mode])
    syncs(bench, 10)
    assert bench.position > rest


@BOTH
@pytest.mark.parametrize(("mode", "target"), [(CSV, 0x60FF), (CST, 0x6071)])
def test_a_lost_rpdo_and_halt_stop_it_too(mechanics: Mechanics | None, mode: int, target: int) -> None:
    for stop in (lambda bench: bench.drive.rpdo_overdue(bench.now), lambda bench: bench.control(0x10F)):
        bench = bench_of(mode, mechanics)
        bench.write(target, {CSV: 20_000, CST: 200}[mode])
        syncs(bench, 50)
        stop(bench)
        assert not bench.has(12)
        syncs(bench, 100)
        assert bench.read(0x606C) == 0


# ---- offsets of csp ----


def test_csp_adds_the_position_offset() -> None:
    bench = bench_of(CSP, None)
    bench.write(0x60C2, 10, 1)
    bench.write(0x60B0, 100)
    bench.write(0x607A, 50)
    syncs(bench, 10)
    assert bench.position == 150


def test_csp_feeds_velocity_and_torque_forward() -> None:
    """Without feed-forward of its own the loop lags by v / Kv; with the master's it does not."""
    own = replace(JOINT, velocity_feed_forward=0.0, acceleration_feed_forward=0.0, integral_time=math.inf)
    errors = []
    for velocity, torque in ((0, 0), (10_000, 0), (10_000, 39)):
        bench = bench_of(CSP, own)
        bench.write(0x60C2, 10, 1)
        bench.write(0x60B1, velocity)
        bench.write(0x60B2, torque)  # friction at that speed: 0.3 + 0.5 * 0.1745 N·m
        for step in range(100):
            bench.put(0x607A, 100 * step)
            bench.sync()
        errors.append(bench.read(0x60F4))
    gain = 2 * math.pi * JOINT.bandwidth / 4
    friction = 0.387 / (JOINT.inertia * 4 * gain) * UNITS / gain
    assert errors[0] == pytest.approx(10_000 / gain + friction, rel=0.05)
    assert errors[1] == pytest.approx(friction, abs=2)
    assert abs(errors[2]) <= 2


@BOTH
@pytest.mark.parametrize(("mode", "index", "amount"), [(TQ, 0x6071, 200), (CST, 0x6071, 200), (CSV, 0x60FF, 20_000)])
def test_a_limit_switch_stops_it_and_lets_it_come_back(mechanics: Mechanics | None, mode: int, index: int, amount: int) -> None:
    settings = DriveSettings(position=0, mechanics=mechanics, track=Track(positive_limit=10_000.0))
    bench = Bench(settings)
    bench.enable(mode)
    bench.write(index, amount)
    syncs(bench, 150)
    rest = bench.position
    assert 10_000 <= rest < 15_000
    assert bench.read(0x606C) == 0
    assert bench.has(11)
    bench.write(index, amount + 1)
    syncs(bench, 20)
    assert bench.position == rest
    bench.write(index, -amount)
    syncs(bench, 50)
    assert bench.position < rest - 2_000
    assert not bench.has(11)
