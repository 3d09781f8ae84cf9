"""Every homing method ends where the standard's picture says, from every part of the track, fast and slow drives alike.

The tables below were read from the pictures and computed by hand; nothing in them comes from the code.

    -50 000        -7 000   -3 000   2 000    9 000            60 000
    negative limit  |----- home switch of 7-14, 23-30 -----|   positive limit
                             |                                        home switch of 5, 6, 21, 22: active from here down
                                      |                               home switch of 3, 4, 19, 20: active from here up
    index pulses: ... -54 877, -49 877, ..., -9 877, -4 877, 123, 5 123, 10 123, ..., 55 123, 60 123 ...
"""

from __future__ import annotations

import math

import pytest

from canopen_proto.drives.cia402.modes import HomingStatus, homing_status
from canopen_proto.machine import MILLISECOND
from canopen_proto.simulation.drive.homing import METHODS
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from tests.simulation.drive_bench import Bench

MIDDLE, UPPER, LOWER = (-7_000.0, 9_000.0), (2_000.0, math.inf), (-math.inf, -3_000.0)
INDEX = (123, 5_000)

HOME = {
    1: -49_877, 2: 55_123, 3: 123, 4: 5_123, 5: 123, 6: -4_877,
    7: -9_877, 8: -4_877, 9: 5_123, 10: 10_123, 11: 10_123, 12: 5_123, 13: -4_877, 14: -9_877,
    17: -50_000, 18: 60_000, 19: 2_000, 20: 2_000, 21: -3_000, 22: -3_000,
    23: -7_000, 24: -7_000, 25: 9_000, 26: 9_000, 27: 9_000, 28: 9_000, 29: -7_000, 30: -7_000,
}  # fmt: skip
"""Method -> where home is."""

STARTS = (-56_000, -50_000, -40_000, -9_877, -7_000, -4_000, 0, 5_123, 9_000, 10_000, 20_000, 60_000, 66_000)
FIRST = {
    #       on the negative limit   below   on the switch of 7-14    above     on the positive limit
    (1, 17):          "+    +        -    -      -  -  -  -  -      -    -        -    -",
    (2, 18):          "+    +        +    +      +  +  +  +  +      +    +        -    -",
    (3, 4, 19, 20):   "+    +        +    +      +  +  +  -  -      -    -        -    -",
    (5, 6, 21, 22):   "+    +        +    +      +  +  -  -  -      -    -        -    -",
    (7, 8, 23, 24):   "+    +        +    +      -  -  -  -  -      +    +        -    -",
    (9, 10, 25, 26):  "+    +        +    +      +  +  +  +  +      +    +        -    -",
    (11, 12, 27, 28): "+    +        -    -      +  +  +  +  +      -    -        -    -",
    (13, 14, 29, 30): "+    +        -    -      -  -  -  -  -      -    -        -    -",
}  # fmt: skip
"""Methods -> the direction in which each of STARTS begins. On a limit switch that lies in the way, a method that turns there
begins with the way back."""

DRIVES = {
    "at once": DriveSettings(lag=0),
    "slow": DriveSettings(lag=15 * MILLISECOND, reaction=200 * MILLISECOND),
}


def switch_of(method: int) -> tuple[float, float]:
    if method in (3, 4, 19, 20):
        return UPPER
    return LOWER if method in (5, 6, 21, 22) else MIDDLE


def homed(method: int, start: float, home_switch: tuple[float, float], drive: DriveSettings) -> tuple[HomingStatus, float, int]:
    """Home a drive: how it ended, where home is on the track, and in which direction it began (0: it did not move)."""
    track = Track(-50_000, 60_000, home_switch, *INDEX)
    bench = Bench(DriveSettings(position=start, track=track, lag=drive.lag, reaction=drive.reaction))
    for index, subindex, value in ((0x6098, 0, method), (0x6099, 1, 200_000), (0x6099, 2, 60_000), (0x609A, 0, 2_000_000)):
        bench.write(index, value, subindex)
    bench.write(0x6060, 6)
    for word in (0x06, 0x07, 0x0F, 0x1F):
        bench.write(0x6040, word)
        bench.run(drive.reaction / MILLISECOND)
    servo = bench.drive._servo
    began = 0
    for _ in range(1_000):
        bench.run(10)
        began = began or round(math.copysign(1, servo.position - start)) * (abs(servo.position - start) > 1)
        status = homing_status(bench.read(0x6041))
        if status in (HomingStatus.COMPLETE, HomingStatus.ERROR_STOPPED):
            break
    if status is HomingStatus.COMPLETE:
        assert abs(bench.position) <= 1  # it stands at home
    return status, servo.zero, began


def test_the_tables_are_whole() -> None:
    assert {*HOME, 33, 34, 35, 37} == set(METHODS)
    assert sorted(method for methods in FIRST for method in methods) == sorted(HOME)


@pytest.mark.thorough(6)
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("method", HOME)
def test_home_is_where_the_picture_says(method: int, drive: str) -> None:
    directions = next(row for methods, row in FIRST.items() if method in methods).split()
    for start, direction in zip(STARTS, directions, strict=True):
        status, home, began = homed(method, start, switch_of(method), DRIVES[drive])
        assert status is HomingStatus.COMPLETE, start
        assert home == pytest.approx(HOME[method], abs=0.01), start
        if start not in (HOME[method], HOME.get(method + 16)):  # at the very edge it has nothing to leave
            assert began == int(f"{direction}1"), start


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize(
    ("method", "start", "home"),
    [
        (33, 0, -4_877), (33, 123, -4_877), (33, 10_000, 5_123), (33, 66_000, 65_123),
        (34, 0, 123), (34, 123, 5_123), (34, 10_000, 10_123), (34, -56_000, -54_877),
    ],
)  # fmt: skip
def test_the_next_index_pulse(method: int, start: int, home: int, drive: str) -> None:
    direction = -1 if method == 33 else 1
    assert homed(method, start, MIDDLE, DRIVES[drive]) == (HomingStatus.COMPLETE, home, direction)


@pytest.mark.parametrize("method", [35, 37])
def test_the_present_position(method: int) -> None:
    for start in STARTS:
        assert homed(method, start, MIDDLE, DRIVES["slow"]) == (HomingStatus.COMPLETE, start, 0)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("method", [method for method in HOME if 7 <= method <= 14 or method >= 23])
def test_a_narrow_switch_is_overshot_in_every_search_and_found_all_the_same(method: int) -> None:
    """Its width is 200; the axis needs 10 000 to stop."""
    narrow = {1: 1_000, 2: 1_200}
    edge = narrow[1] if method in (7, 8, 13, 14, 23, 24, 29, 30) else narrow[2]
    after = {7: 123, 14: 123, 9: 123, 12: 123, 8: 5_123, 13: 5_123, 10: 5_123, 11: 5_123}
    for start in (-50_000, -20_000, 1_100, 20_000, 60_000):
        status, home, _ = homed(method, start, (1_000, 1_200), DRIVES["slow"])
        assert (status, home) == (HomingStatus.COMPLETE, after.get(method, edge)), start


@pytest.mark.parametrize(
    ("method", "start", "home_switch"),
    [
        (19, 20_000, MIDDLE),  # the switch lies behind, and this method does not turn
        (20, 20_000, MIDDLE),
        (21, -20_000, MIDDLE),
        (22, -20_000, MIDDLE),
        (3, 20_000, MIDDLE),
        (6, -20_000, MIDDLE),
        (23, 0, (70_000, 80_000)),  # there is no home switch: it turns once
        (30, 0, (70_000, 80_000)),
        (33, -49_900, MIDDLE),  # the next pulse lies beyond the limit switch
        (34, 59_000, MIDDLE),
        (33, -56_000, MIDDLE),  # on the limit switch in its way
        (34, 66_000, MIDDLE),
        (19, 66_000, MIDDLE),
    ],
)
def test_the_wrong_limit_switch_is_a_homing_error(method: int, start: int, home_switch: tuple[float, float]) -> None:
    status, zero, began = homed(method, start, home_switch, DRIVES["slow"])
    assert (status, zero) == (HomingStatus.ERROR_STOPPED, 0)
    if start in (-56_000, 66_000):
        assert began == 0  # it does not move further onto the switch
