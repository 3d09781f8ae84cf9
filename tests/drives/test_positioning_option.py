"""0x60F2 on both sides: the way of an axis without end to its target, and the drive that clears bit 4 by itself; virtual time."""

from __future__ import annotations

from dataclasses import replace

import pytest

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis import ProfileTarget, RelativeTo, RotaryDirection
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.slow_position import start_slow_position
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import SECOND, LocalProtocolError
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.drives.rig import Rig
from tests.simulation.drive_bench import Bench

DEGREES = AxisSettings(counts_per_unit=1000.0)
LIMIT = 60 * SECOND
ENDLESS = Track(negative_limit=-1e9, positive_limit=1e9)


def turntable(position: int = 10_000) -> Rig:
    """An axis without end: 0 to 360 degrees."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=position, lag=0, track=ENDLESS))
    rig.axis.settings = DEGREES
    store = rig.node.values.store
    store[objects.PROFILE_VELOCITY] = 100_000
    store[objects.MIN_POSITION_RANGE_LIMIT], store[objects.MAX_POSITION_RANGE_LIMIT] = 0, 359_999
    return rig


WAYS = [
    (RotaryDirection.LINEAR, 350, 340),
    (RotaryDirection.POSITIVE, 350, 340),
    (RotaryDirection.NEGATIVE, 350, -20),
    (RotaryDirection.SHORTEST, 350, -20),
    (RotaryDirection.SHORTEST, 30, 20),
    (RotaryDirection.POSITIVE, 5, 355),
    (RotaryDirection.NEGATIVE, 5, -5),
    (RotaryDirection.SHORTEST, 190, 180),
    (RotaryDirection.NEGATIVE, 10, 0),
    (RotaryDirection.POSITIVE, 10, 0),
]


@pytest.mark.thorough(5)
@pytest.mark.parametrize(("direction", "target", "way"), WAYS)
def test_the_way_to_a_target(direction: RotaryDirection, target: float, way: float) -> None:
    for along in (False, True):
        rig = turntable()
        moving = (
            drive.move_along(rig.axis, [ProfileTarget(target, direction=direction)], timeout=LIMIT)
            if along
            else drive.move_to(rig.axis, target, timeout=LIMIT, direction=direction)
        )
        rig.run(moving)
        assert rig.drive._servo.position == pytest.approx(10_000 + 1000 * way, abs=1)
        assert rig.run(drive.read_position(rig.axis)) == pytest.approx(target, abs=0.01)


def test_directions_are_the_users() -> None:
    rig = turntable()
    rig.axis.settings = replace(DEGREES, direction=-1)
    rig.run(drive.move_to(rig.axis, -350, timeout=LIMIT, direction=RotaryDirection.POSITIVE))  # down, for the drive
    assert rig.drive._servo.position == pytest.approx(-10_000, abs=1)


def test_none_leaves_the_direction_as_the_drive_has_it() -> None:
    rig = turntable()
    rig.node.values.store[objects.POSITIONING_OPTION_CODE] = RotaryDirection.SHORTEST << 6 | RelativeTo.ACTUAL
    rig.run(drive.move_to(rig.axis, 350, timeout=LIMIT))
    assert rig.drive._servo.position == pytest.approx(-10_000, abs=1)
    assert rig.node.values.store[objects.POSITIONING_OPTION_CODE] == RotaryDirection.SHORTEST << 6 | RelativeTo.ACTUAL


def test_set_points_beyond_the_end_of_the_range_go_on_from_the_present_turn() -> None:
    bench = Bench(DriveSettings(position=0, lag=0, track=ENDLESS))
    bench.write(0x607B, 0, 1)
    bench.write(0x607B, 359_999, 2)
    bench.enable(1)
    bench.write(0x607A, 359_000)
    bench.control(0x2F, 0x3F, 0x2F)
    bench.run(30_000)
    bench.write(0x6060, 8)
    for target in (359_000, 359_500, 0, 500):
        bench.write(0x607A, target)
        bench.sync()
    bench.sync()
    assert bench.position == 500
    assert bench.drive._servo.position == pytest.approx(360_500)


@pytest.mark.parametrize("response", [1, 2])
@pytest.mark.parametrize("second", ["move_to", "move_along", "slow"])
def test_the_handshake_is_the_masters_whatever_60f2_was(response: int, second: str) -> None:
    rig = turntable()
    rig.node.values.store[objects.POSITIONING_OPTION_CODE] = response << 4 | 1
    if second == "slow":
        rig.run(start_slow_position(rig.axis))
    elif second == "move_to":
        rig.run(drive.move_to(rig.axis, 20, timeout=LIMIT))
    else:
        rig.run(drive.move_along(rig.axis, [ProfileTarget(20), ProfileTarget(30), ProfileTarget(20)], timeout=LIMIT))
    assert rig.node.values.store[objects.POSITIONING_OPTION_CODE] == 1
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(10 if second == "slow" else 20, abs=0.01)


@pytest.mark.parametrize(("response", "released_at"), [(0, None), (1, "target"), (2, "once")])
def test_a_drive_clears_bit_4_as_60f2_says(response: int, released_at: str | None) -> None:
    bench = Bench(DriveSettings(position=0, lag=0, track=ENDLESS))
    bench.write(0x60F2, response << 4)
    bench.enable(1)
    bench.write(0x607A, 1000)
    bench.control(0x2F, 0x3F)
    assert bench.has(12) is (released_at != "once")
    bench.run(5000)
    assert bench.position == 1000
    assert bench.has(12) is (released_at is None)
    bench.write(0x607A, 2000)
    bench.control(0x3F)  # an edge for a drive that has cleared the bit
    bench.run(5000)
    assert bench.position == (1000 if released_at is None else 2000)


@pytest.mark.parametrize("value", [3, 0x0C, 0x04, 0x30, 0x100, 0x8000])
def test_values_without_a_known_meaning_are_refused(value: int) -> None:
    bench = Bench(DriveSettings())
    assert bench.drive.check_write(0x60F2, 0, value) == 0x0609_0030


def test_a_drive_without_60f2_gets_no_direction() -> None:
    rig = turntable()
    rest = [each for index, each in rig.node.dictionary.objects.items() if index != 0x60F2]
    rig = Rig(Shape.STANDARD, pdos=False, dictionary=ObjectDictionary(rest))
    for moving in (
        drive.move_to(rig.axis, 0.1, timeout=LIMIT, direction=RotaryDirection.SHORTEST),
        drive.move_along(rig.axis, [ProfileTarget(0.1, direction=RotaryDirection.SHORTEST)], timeout=LIMIT),
    ):
        before = len(rig.bus.sent)
        with pytest.raises(drive.DriveError, match="has no 0x60F2: it goes its own way"):
            rig.run(moving)
        assert not any(frame.data[0] & 0xE0 == 0x20 for _, frame in rig.bus.sent[before:] if frame.can_id == 0x605)


def test_a_relative_target_takes_no_direction() -> None:
    with pytest.raises(LocalProtocolError, match="by its sign"):
        ProfileTarget(1, relative_to=RelativeTo.DEMAND, direction=RotaryDirection.POSITIVE)
    rig = turntable()
    with pytest.raises(LocalProtocolError, match="by its sign"):
        rig.run(drive.move_to(rig.axis, 1, timeout=LIMIT, relative=True, direction=RotaryDirection.POSITIVE))
