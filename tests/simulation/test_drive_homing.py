"""Homing of the simulated drive: each method finds its edge, from wherever it starts; interruption, errors, the Schunk way."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.drives.cia402.homing_methods import HomingSwitch
from canopen_proto.drives.cia402.modes import HomingStatus, homing_status
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import NEVER
from canopen_proto.simulation.drive.homing import HomingFinished, Seek
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.examples import examples
from tests.simulation.drive_bench import NODE_ID, Bench

TRACK = Track(negative_limit=-50_000, positive_limit=60_000, home_switch=(-7_000, 9_000), index_offset=123, index_distance=5_000)
COMPLETE, FAILED, INTERRUPTED = HomingStatus.COMPLETE, HomingStatus.ERROR_STOPPED, HomingStatus.INTERRUPTED


def at(position: float, method: int, track: Track = TRACK, home_offset: int = 0) -> Bench:
    bench = Bench(DriveSettings(position=position, track=track))
    bench.write(0x6098, method)
    bench.write(0x607C, home_offset)
    bench.enable(6)
    return bench


def status_of(bench: Bench) -> HomingStatus:
    return homing_status(bench.read(0x6041))


def home(bench: Bench, timeout: int = 30_000) -> HomingStatus:
    bench.control(0x1F)
    for _ in range(timeout // 10):
        finished = bench.reported(HomingFinished)
        if finished:
            assert status_of(bench) is finished[0].status
            return finished[0].status
        bench.run(10)
    return status_of(bench)


@pytest.mark.parametrize(
    ("method", "start", "edge"),
    [
        (17, 3_000, -50_000),
        (17, -50_000, -50_000),  # on the switch already
        (17, -55_000, -50_000),
        (18, 3_000, 60_000),
        (18, 66_000, 60_000),
        (19, -20_000, -7_000),  # runs onto the switch, then back off it
        (19, 0, -7_000),  # starts on it
        (21, 20_000, 9_000),
        (21, 0, 9_000),
        (33, 3_000, 123),
        (33, 123, -4_877),  # on a pulse: the next one
        (34, 3_000, 5_123),
        (34, 5_123, 10_123),
        (35, 3_000, 3_000),
        (37, -4_321, -4_321),
    ],
)
def test_each_method_finds_its_home(method: int, start: int, edge: int) -> None:
    bench = at(start, method)
    assert status_of(bench) is INTERRUPTED  # has not started
    assert home(bench) is COMPLETE
    bench.run(100)
    assert bench.position == 0  # it stands on the edge, and that is home
    assert bench.drive.deadline == NEVER
    assert bench.drive._servo.position == pytest.approx(edge, abs=0.01)


def test_the_home_position_is_the_home_offset() -> None:
    bench = at(3_000, 34, home_offset=-777)
    assert home(bench) is COMPLETE
    assert bench.position == -777
    bench.write(0x6060, 1)
    bench.write(0x607A, 0)
    bench.control(0x0F, 0x1F)
    bench.run(1_000)
    assert bench.position == 0
    assert bench.drive._servo.position == pytest.approx(5_123 + 777, abs=0.01)


def test_the_status_on_the_way() -> None:
    bench = at(-20_000, 19)
    bench.control(0x1F)
    assert status_of(bench) is HomingStatus.IN_PROGRESS
    seen: list[HomingStatus] = []
    for _ in range(1_000):
        bench.run(10)
        if not seen or seen[-1] is not status_of(bench):
            seen.append(status_of(bench))
    assert seen == [HomingStatus.IN_PROGRESS, HomingStatus.ATTAINED, COMPLETE]
    assert bench.reported(HomingFinished) == [HomingFinished(NODE_ID, COMPLETE, 19)]


def test_homing_twice_needs_bit_4_to_fall() -> None:
    bench = at(3_000, 34)
    assert home(bench) is COMPLETE
    bench.control(0x1F)
    bench.run(1_000)
    assert bench.position == 0
    bench.control(0x0F)
    assert status_of(bench) is COMPLETE  # stays so until the next one begins
    assert home(bench) is COMPLETE
    assert bench.drive._servo.position == pytest.approx(10_123, abs=0.01)


@pytest.mark.parametrize("word", [0x0F, 0x11F])
def test_falling_bit_4_and_halt_interrupt(word: int) -> None:
    bench = at(3_000, 17)
    bench.control(0x1F)
    bench.run(500)
    bench.events()
    bench.control(word)
    assert bench.events() == [HomingFinished(NODE_ID, INTERRUPTED, 17)]
    assert status_of(bench) is HomingStatus.IN_PROGRESS  # bit 10 rises when it stands
    bench.run(500)
    assert status_of(bench) is INTERRUPTED
    assert bench.read(0x606C) == 0
    assert bench.position < -2_000
    bench.control(0x0F)
    assert bench.events() == []
    assert home(bench) is COMPLETE


def test_leaving_the_mode_or_the_power_interrupts() -> None:
    bench = at(3_000, 17)
    bench.control(0x1F)
    bench.run(100)
    bench.write(0x6060, 1)
    assert bench.reported(HomingFinished) == [HomingFinished(NODE_ID, INTERRUPTED, 17)]
    bench = at(3_000, 17)
    bench.control(0x1F)
    bench.run(100)
    bench.control(0x00)
    assert bench.reported(HomingFinished) == [HomingFinished(NODE_ID, INTERRUPTED, 17)]
    bench = at(3_000, 17)
    bench.control(0x1F)
    bench.run(100)
    bench.control(0x07)
    bench.run(500)
    assert bench.reported(HomingFinished) == [HomingFinished(NODE_ID, INTERRUPTED, 17)]
    assert bench.state is State.SWITCHED_ON


def test_a_limit_switch_before_the_edge_is_an_error() -> None:
    bench = at(20_000, 19)  # the home switch lies behind
    bench.control(0x1F)
    seen = set()
    for _ in range(600):
        bench.run(10)
        seen.add(status_of(bench))
    assert seen == {HomingStatus.IN_PROGRESS, HomingStatus.ERROR_MOVING, FAILED}
    assert bench.read(0x606C) == 0
    assert bench.state is State.OPERATION_ENABLED  # a homing error is no fault
    assert bench.reported(HomingFinished) == [HomingFinished(NODE_ID, FAILED, 19)]
    bench.write(0x6098, 17)
    bench.control(0x0F)
    assert home(bench) is COMPLETE


def test_method_0_and_one_that_a_pdo_brought_fail_at_once() -> None:
    for method in (0, 15, 36, -3):
        bench = at(3_000, 37)
        bench.put(0x6098, method)
        assert home(bench) is FAILED
        assert bench.position == 3_000


def test_the_switches_are_in_the_digital_inputs() -> None:
    for position, inputs in ((0, 0b100), (-7_000, 0b100), (20_000, 0), (-50_000, 0b001), (61_000, 0b010)):
        assert Bench(DriveSettings(position=position, track=TRACK)).read(0x60FD) == inputs


def test_homing_ignores_software_limits_and_moves_them_with_the_zero() -> None:
    bench = at(3_000, 17)
    bench.preset(0x607D, -1_000, 1)
    bench.preset(0x607D, 1_000, 2)
    assert home(bench) is COMPLETE
    bench.write(0x6060, 1)
    bench.write(0x607A, 5_000)
    bench.control(0x0F, 0x1F)
    bench.run(1_000)
    assert bench.position == 1_000  # 1000 from the new zero


def test_power_on_forgets_the_reference_but_moves_nothing() -> None:
    bench = at(3_000, 34)
    home(bench)
    bench.drive.reset(bench.now)
    assert bench.position == 5_123
    assert bench.state is State.SWITCH_ON_DISABLED


@examples(50)
@given(
    method=st.sampled_from([17, 18, 19, 20, 21, 22, *range(23, 31), 33, 34, 35]),
    start=st.integers(-49_000, 59_000),
    low=st.integers(-40_000, 40_000),
    width=st.integers(200, 15_000),
    fast=st.integers(10_000, 100_000),
    slow=st.integers(5_000, 50_000),
    rate=st.integers(20_000, 10_000_000),
)
def test_home_is_the_exact_edge_whatever_the_speeds(
    method: int, start: int, low: int, width: int, fast: int, slow: int, rate: int
) -> None:
    track = Track(-50_000, 60_000, (low, low + width), 123, 5_000)
    bench = at(start, method, track)
    for index, subindex, value in ((0x6099, 1, fast), (0x6099, 2, slow), (0x609A, 0, rate)):
        bench.preset(index, value, subindex)
    bench.run(0)
    status = home(bench, 60_000)
    behind = (method in (19, 20) and start > low + width) or (method in (21, 22) and start < low)
    beyond = (method == 33 and start <= -49_877) or (method == 34 and start >= 55_123)
    assert status is (FAILED if behind or beyond else COMPLETE)
    if status is COMPLETE:
        assert abs(bench.position) <= 1
        zero = bench.drive._servo.zero
        edges = {17: -50_000, 18: 60_000} | dict.fromkeys((19, 20, 23, 24, 29, 30), low)
        edges |= dict.fromkeys((21, 22, 25, 26, 27, 28), low + width)
        if method in edges:
            assert zero == edges[method]
        elif method in (33, 34):
            assert (zero - 123) % 5_000 == 0
            assert 0 < (start - zero) * (1 if method == 33 else -1) <= 5_000
        else:
            assert zero == start


def test_a_seek_that_will_never_end_ends_at_infinity() -> None:
    endless = Track(home_switch=(0.0, math.inf))
    assert Seek(-1, True, HomingSwitch.HOME, True).edge(endless, -5.0) == -math.inf
    assert Seek(+1, True, HomingSwitch.HOME, True).edge(endless, -5.0) == 0.0
    assert Seek(+1, False, HomingSwitch.HOME, False).edge(endless, 5.0) == math.inf
    assert Seek(-1, False, HomingSwitch.HOME, False).edge(endless, -5.0) == -5.0  # it is off the switch already


# ---- Schunk Powerball ----


def test_the_powerball_homes_as_the_manual_does_it() -> None:
    """6060 <- 6, 6040 <- 1F out of Switched on; bit 8 comes and goes, bit 15 is set. 6502h lacks the mode, 6098h is constant."""
    bench = Bench(DriveSettings(shape=Shape.SCHUNK_POWERBALL))
    assert bench.read(0x6502) == 0x43
    assert not bench.values.dictionary.variable(0x6098).access.writable
    bench.control(0x06, 0x07)
    bench.write(0x6060, 6)
    bench.control(0x1F)
    assert bench.state is State.OPERATION_ENABLED
    assert not bench.has(15)
    moved = 0
    for _ in range(1_000):
        bench.run(10)
        moved += bench.has(8)
        if moved and not bench.has(8):
            break
    assert moved > 10  # a master that polls each 10 ms sees it
    assert not bench.has(8)
    assert bench.has(15)
    assert bench.position == 0
    bench.control(0x07)
    assert bench.has(15)  # for good


def test_a_powerball_whose_axis_is_blocked_gets_a_fault_and_no_reference() -> None:
    bench = Bench(DriveSettings(shape=Shape.SCHUNK_POWERBALL))
    bench.drive.block(True, bench.now)
    bench.write(0x6060, 6)
    bench.control(0x06, 0x07, 0x1F)
    bench.run(5_000)
    assert bench.state is State.FAULT
    assert not bench.has(15)
    assert not bench.has(8)
