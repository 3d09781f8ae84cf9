"""The simulated drive in ip and csp when SYNC, or an RPDO, stays away: it brakes by 6085h, bit 12 falls, and nothing jumps."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.simulation.drive.settings import SYNC_TOLERANCE, DriveSettings, Shape
from canopen_proto.simulation.drive.synchronous_modes import SyncOverdue
from tests.drives.rig import Rig
from tests.examples import examples
from tests.simulation.drive_bench import NODE_ID, Bench

IP, CSP = 7, 8
FOLLOWS, WARNING, REACHED, INTERNAL_LIMIT = 12, 7, 10, 11
SET_POINT = {IP: (0x60C1, 1), CSP: (0x607A, 0)}
CYCLE = 10
SPEEDS = st.integers(-1_000, 1_000).map(lambda step: 100 * step)  # a whole number of units in each cycle


def moving(mode: int, speed: int, cycles: int = 20, quick_stop: int = 400_000, waits: bool = False) -> Bench:
    """A drive that follows set-points at `speed` units/s, the last SYNC just now; it lags behind nothing."""
    tolerance = 60 * SECOND if waits else SYNC_TOLERANCE
    bench = Bench(DriveSettings(position=0, lag=0, sync_tolerance=tolerance, waits_for_sync=waits))
    bench.preset(0x60C2, CYCLE, 1)
    bench.preset(0x6085, quick_stop)
    bench.enable(mode)
    bench.control(0x1F)
    bench.sync(CYCLE)
    for number in range(1, cycles + 1):
        give(bench, mode, round(number * speed * CYCLE / 1000))
        bench.sync(CYCLE)
    assert bench.has(FOLLOWS)
    return bench


def give(bench: Bench, mode: int, set_point: int) -> None:
    index, subindex = SET_POINT[mode]
    bench.put(index, set_point, subindex)


@pytest.mark.parametrize("mode", [IP, CSP])
@examples(25)
@given(speed=SPEEDS, quick_stop=st.integers(200_000, 4_000_000), cycles=st.integers(2, 20))
def test_an_axis_whose_sync_is_lost_brakes_by_its_quick_stop_ramp(mode: int, speed: int, quick_stop: int, cycles: int) -> None:
    bench = moving(mode, speed, cycles, quick_stop)
    bench.events()
    last = cycles * speed * CYCLE / 1000
    lost_at = bench.now + SYNC_TOLERANCE
    before = abs(bench.read(0x606B))
    while bench.now < lost_at + 5 * SECOND and (before or bench.now <= lost_at):
        bench.run(2)
        now_at = abs(bench.read(0x606B))
        assert -1 <= before - now_at <= quick_stop / 500 + 1  # units/s in 2 ms: never faster, never dead still at once
        assert bench.has(FOLLOWS) is (bench.now < lost_at)
        before = now_at
    assert bench.position == pytest.approx(last + (abs(speed) * speed) / (2 * quick_stop), abs=2)
    assert bench.has(WARNING)
    assert bench.state is State.OPERATION_ENABLED
    assert bench.events() == [SyncOverdue(NODE_ID, SYNC_TOLERANCE)]


@pytest.mark.parametrize("mode", [IP, CSP])
def test_an_axis_that_stands_is_told_too(mode: int) -> None:
    bench = moving(mode, 0)
    bench.run(99)
    assert bench.has(FOLLOWS)
    bench.run(1)
    assert not bench.has(FOLLOWS)
    assert bench.has(WARNING)
    assert bench.position == 0


@pytest.mark.parametrize("mode", [IP, CSP])
def test_there_is_no_watch_before_the_first_sync(mode: int) -> None:
    bench = Bench(DriveSettings(position=0, lag=0))
    bench.enable(mode)
    bench.control(0x1F)
    bench.run(60_000)
    assert bench.has(FOLLOWS)


@pytest.mark.parametrize("mode", [IP, CSP])
@pytest.mark.parametrize(("cycle_us", "milliseconds"), [(0, 100), (20_000, 100), (50_000, 150), (1_000_000, 3_000)])
def test_how_long_sync_may_stay_away(mode: int, cycle_us: int, milliseconds: int) -> None:
    bench = Bench(DriveSettings(position=0, lag=0))
    bench.preset(0x1006, cycle_us)
    bench.enable(mode)
    bench.control(0x1F)
    bench.sync()
    bench.run(milliseconds - 1)
    assert bench.has(FOLLOWS)
    bench.run(1)
    assert not bench.has(FOLLOWS)


@pytest.mark.parametrize("mode", [IP, CSP])
@examples(25)
@given(late=st.integers(1, 89), speed=SPEEDS)
def test_a_late_sync_takes_the_axis_along_again(mode: int, late: int, speed: int) -> None:
    bench = moving(mode, speed)
    set_point = round(20 * speed * CYCLE / 1000)
    bench.run(late)
    for number in range(30):
        give(bench, mode, round(set_point + min(number, 5) * speed * CYCLE / 1000))
        bench.sync(CYCLE)
    assert bench.position == pytest.approx(set_point + 5 * speed * CYCLE / 1000, abs=1)
    assert bench.has(FOLLOWS)
    assert not bench.has(WARNING)


@pytest.mark.parametrize("mode", [IP, CSP])
@examples(50)
@given(st.lists(st.integers(0, 20_000), min_size=1, max_size=8), SPEEDS)
def test_an_axis_whose_world_waits_for_sync_stands_at_its_set_point_and_goes_on(mode: int, stalls: list[int], speed: int) -> None:
    """However late each SYNC is: it is never beyond its last set-point, and then as fast as before."""
    bench = moving(mode, speed, waits=True)
    given_so_far = [round(number * speed * CYCLE / 1000) for number in (19, 20)]
    for late in stalls:
        bench.run(CYCLE + late)
        assert bench.position == pytest.approx(given_so_far[-1], abs=1)
        assert bench.has(FOLLOWS)
        given_so_far.append(given_so_far[-1] + round(speed * CYCLE / 1000))
        give(bench, mode, given_so_far[-1])
        bench.sync(CYCLE)
        assert not bench.has(INTERNAL_LIMIT)
        assert min(given_so_far[-2:]) - 1 <= bench.position <= max(given_so_far[-2:]) + 1


def test_a_sync_that_waited_while_the_process_slept_is_in_time() -> None:
    bench = moving(IP, 0)
    bench.now += SECOND
    bench.drive.refresh(bench.now)  # a node does so before it hands over the SYNC
    bench.drive.on_sync(bench.now)
    assert bench.has(FOLLOWS)


def test_ip_wants_bit_4_anew() -> None:
    bench = moving(IP, 50_000)
    bench.run(1_000)
    stood = bench.position
    for _ in range(20):
        give(bench, IP, 0)
        bench.sync(CYCLE)
    assert bench.position == stood
    assert not bench.has(FOLLOWS)
    bench.control(0x0F, 0x1F)
    assert bench.has(FOLLOWS)
    assert not bench.has(WARNING)


@pytest.mark.parametrize("window", [0, 10, 2**32 - 1])
def test_csp_follows_again_when_the_target_is_where_the_axis_stands(window: int) -> None:
    bench = moving(CSP, 50_000)
    bench.preset(0x6067, window)
    bench.run(1_000)
    stood = bench.position
    for set_point in (0, stood + 1_000, stood - 1_000, stood + 20):
        give(bench, CSP, set_point)
        bench.sync(CYCLE)
        assert not bench.has(FOLLOWS)
    bench.run(1_000)
    assert bench.position == stood
    give(bench, CSP, stood)
    bench.sync(CYCLE)
    assert bench.has(FOLLOWS)
    assert not bench.has(WARNING)
    for number in range(1, 10):
        give(bench, CSP, stood + 100 * number)
        bench.sync(CYCLE)
    bench.run(CYCLE)
    assert bench.position == stood + 900


def test_a_halted_csp_follows_nothing_and_misses_no_sync() -> None:
    bench = moving(CSP, 50_000)
    bench.control(0x11F)
    bench.run(5_000)
    assert not bench.has(FOLLOWS)
    assert not bench.has(WARNING)
    assert bench.reported(SyncOverdue) == []


@pytest.mark.parametrize(("speed", "comes_back"), [(2_000, True), (50_000, False)])
def test_csp_whose_target_is_not_written_brakes_and_never_jumps_back(speed: int, comes_back: bool) -> None:
    """Behind a slow path it is within 6067h of its last target when it stands, and goes there."""
    bench = moving(CSP, speed)
    bench.sync(CYCLE)
    for _ in range(40):
        before = bench.read(0x606B)
        bench.run(1)
        assert before - bench.read(0x606B) <= 402  # 6085h
    for _ in range(30):
        bench.sync(CYCLE)
    last = 20 * speed * CYCLE // 1_000
    beyond = speed**2 / 800_000
    assert bench.position == pytest.approx(last if comes_back else last + beyond, abs=1)
    assert bench.has(FOLLOWS) is comes_back
    assert bench.has(WARNING) is not comes_back


def test_other_modes_do_not_go_by_sync() -> None:
    bench = Bench(DriveSettings(position=0, lag=0))
    bench.preset(0x60FF, 10_000)
    bench.enable(3)
    bench.sync()
    bench.run(1_000)
    bench.drive.rpdo_overdue(bench.now)
    assert bench.read(0x606B) == 10_000
    assert bench.reported(SyncOverdue) == []


def test_an_underrun_that_an_overdue_rpdo_follows_brakes_by_the_quick_stop_ramp() -> None:
    bench = moving(IP, 100_000)
    bench.sync(CYCLE)  # finds no set-point: 605Dh = 1, by 6084h
    assert not bench.has(FOLLOWS)
    bench.run(CYCLE)
    position, velocity = bench.position, bench.read(0x606B)
    bench.drive.rpdo_overdue(bench.now)
    bench.run(2_000)
    assert bench.position == pytest.approx(position + velocity**2 / 800_000, abs=2)


# ---- on the bus ----


@pytest.mark.parametrize("mode", [IP, CSP])
def test_an_rpdo_that_does_not_come_within_its_event_time(mode: int) -> None:
    """CiA 301 v4.2.0, 7.5.2.35: deadline monitoring. SYNC goes on, from another master."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=0, lag=0))
    store = rig.node.values.store
    number, sign = (4, "505#1F00") if mode == IP else (3, "405#0F00")
    for key, value in ((0x140005 + ((number - 1) << 8), 50), (objects.MODES_OF_OPERATION, mode)):
        rig.node.set_value(key >> 8, key & 0xFF, value, rig.bus.now)
        store[key] = value
    rig.drive.written(0x6060, 0, rig.bus.now)
    for word in ("0600", "0700", "0F00", "1F00"):
        rig.bus.send(f"205#{word}")
        rig.bus.run(MILLISECOND)
    rig.bus.send("080#")
    rig.bus.run(10 * MILLISECOND)
    for cycle in range(1, 21):
        rig.bus.send(f"{sign}{(1_000 * cycle).to_bytes(4, 'little').hex()}")
        rig.bus.run(MILLISECOND)
        rig.bus.send("080#")
        rig.bus.run(9 * MILLISECOND)
    rig.node.drive.refresh(rig.bus.now)
    assert store[objects.VELOCITY_DEMAND_VALUE] == 100_000
    before, is_following = 100_000, True
    for cycle in range(80):
        if cycle % 2 == 0:
            rig.bus.send("080#")
        rig.bus.run(5 * MILLISECOND)
        rig.drive.refresh(rig.bus.now)
        speed, word = store[objects.VELOCITY_DEMAND_VALUE], store[objects.STATUSWORD]
        assert isinstance(speed, int)
        assert isinstance(word, int)
        assert before - speed <= 4 * 500 + 2 if speed >= 0 else speed >= -100_000
        before, is_following = speed, bool(word >> FOLLOWS & 1)
    assert not is_following
    assert before == 0
    assert any(line.startswith("085#5082") for line in rig.bus.trace())
