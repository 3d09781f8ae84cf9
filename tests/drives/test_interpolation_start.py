"""The start of interpolated position mode: period, sub-modes, the drive's buffer; then the path as the drive takes it."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from canopen_proto.dictionary import Direction, ObjectDictionary, PdoDescription
from canopen_proto.dictionary.model import Object
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.following import Following, FollowingLost
from canopen_proto.drives.axis.following_error import LAG
from canopen_proto.drives.axis.interpolation import InterpolationBuffer
from canopen_proto.drives.axis.limits import Limit
from canopen_proto.drives.axis.sub_modes import PositionAndVelocity, RecordPoint
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.pdo.configure import define_pdo, use_device_pdo
from canopen_proto.procedures.objects import write
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.interpolated_position import SetPointUnderrun
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import CYCLE, Rig


def dictionary_with(**limits: int) -> ObjectDictionary:
    """The standard shape's, with limits of 0x60C2:02."""
    described = dict(drive_dictionary().objects)
    record = described[0x60C2]
    fields = [replace(each, **limits) if each.subindex == 2 else each for each in record.variables.values()]
    described[0x60C2] = Object.of(record.name, fields, record.object_type)
    return ObjectDictionary(list(described.values()))


def period_of(rig: Rig) -> tuple[object, object]:
    store = rig.node.values.store
    return store[objects.INTERPOLATION_TIME_UNITS], store[objects.INTERPOLATION_TIME_INDEX]


@pytest.mark.parametrize(
    ("cycle", "period"),
    [
        (10 * MILLISECOND, (10, -3)),
        (2500 * MICROSECOND, (25, -4)),
        (250 * MICROSECOND, (25, -5)),
        (125 * MICROSECOND, (125, -6)),
        (300 * MILLISECOND, (30, -2)),
        (25 * SECOND, (250, -1)),
    ],
)
def test_the_period_is_written_exactly_in_the_unit_that_fits(cycle: Time, period: tuple[int, int]) -> None:
    rig = Rig(Shape.STANDARD)
    rig.run(drive.start_interpolation(rig.axis, cycle))
    assert period_of(rig) == period


def test_an_exponent_that_the_drive_refuses_is_followed_by_another_exact_one() -> None:
    rig = Rig(Shape.STANDARD, dictionary=dictionary_with(low_limit=-4, high_limit=-4))
    rig.remote.dictionary = drive_dictionary()  # the master's file does not tell
    rig.run(drive.start_interpolation(rig.axis, CYCLE))
    assert period_of(rig) == (100, -4)
    with pytest.raises(drive.DriveError, match="0x60C2:02"):
        rig.run(drive.start_interpolation(rig.axis, 100 * MILLISECOND))


def test_a_drive_in_another_sub_mode_is_put_into_the_linear_one() -> None:
    rig = Rig(Shape.STANDARD)
    rig.run(write(rig.remote, "0x60C0", -1))
    rig.run(drive.start_interpolation(rig.axis, CYCLE))
    assert rig.node.values.store[objects.INTERPOLATION_SUB_MODE_SELECT] == 0


@dataclass(frozen=True)
class NoSuch:
    """Festo's "linear without buffer": a word comes first that says whether the position is absolute."""

    number: int = -2
    objects: tuple[Mux, ...] = (mux(0x60C1, 2), mux(0x60C1, 1))

    def record(self, point: RecordPoint) -> tuple[int, ...]:
        return 0, point.position


def rig_with_records(start: float = 3_000.0) -> Rig:
    """A rig whose RPDO 2 carries position and velocity at each SYNC."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=start, lag=0))
    record = tuple(rig.remote.dictionary.variable(key) for key in ("0x60C1:01", "0x60C1:02"))
    rig.run(define_pdo(rig.remote, PdoDescription("record", 0x300, Direction.RPDO, 2, record)))
    return rig


def test_a_sub_mode_that_the_drive_refuses_is_named_and_nothing_moves() -> None:
    rig = rig_with_records()
    rig.start_sync()
    with pytest.raises(drive.ModeUnsupportedError, match="refused interpolation sub-mode -2"):
        rig.run(drive.start_interpolation(rig.axis, CYCLE, sub_mode=NoSuch()))
    assert not rig.axis.statusword & 0x1000


def test_a_record_is_written_by_sdo_in_its_own_order() -> None:
    rig = rig_with_records()
    sub_mode = replace(PositionAndVelocity(), objects=(mux(0x60C1, 2), mux(0x60C1, 1)))
    rig.axis.set_points.select_record(sub_mode, CYCLE)
    assert rig.axis.set_points.objects == (mux(0x60C1, 2), mux(0x60C1, 1))


@pytest.mark.parametrize("told", [True, False])
def test_records_of_position_and_velocity_are_followed(told: bool) -> None:
    """Half a t² with 20,000 counts/s². Told or not, the velocity at the points makes a path without steps in velocity."""
    rig = rig_with_records()
    rig.start_sync()
    position = rig.run(drive.start_interpolation(rig.axis, CYCLE, sub_mode=PositionAndVelocity()))
    assert position == rig.axis.set_points.position
    start = rig.axis.set_points.counts
    velocities = []
    for step in range(1, 50):
        time = step * CYCLE / SECOND
        counts = start + round(10_000 * time * time)
        rig.axis.set_points.set_position_counts(counts, 20_000 * time if told else None)
        assert rig.axis.set_points.counts == counts
        rig.bus.run(CYCLE)
        rig.drive.refresh(rig.bus.now)
        velocities.append(rig.drive.values.store[objects.VELOCITY_DEMAND_VALUE])
    assert rig.axis.statusword & 0x1000
    if told:
        steps = [after - before for before, after in pairwise(velocities)]
        assert max(steps) <= 250  # 20,000 * 10 ms, and rounding of positions


def test_the_sub_mode_of_the_documentation_works() -> None:
    page = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "class Cubic" in block)
    names: dict[str, Any] = {"__name__": __name__}
    exec(code, names)
    rig = rig_with_records()
    rig.start_sync()
    start = rig.run(drive.start_interpolation(rig.axis, CYCLE, sub_mode=names["Cubic"]()))
    assert rig.node.values.store[objects.INTERPOLATION_SUB_MODE_SELECT] == -1
    for step in range(1, 20):
        rig.axis.set_points.set_position(start + 0.001 * step, velocity=0.1)
        rig.bus.run(CYCLE)
    rig.drive.refresh(rig.bus.now)
    assert rig.drive.values.store[objects.VELOCITY_DEMAND_VALUE] == pytest.approx(rig.axis.scale.to_counts(0.1), rel=0.02)
    assert rig.axis.statusword & 0x1000


def test_a_path_in_records_must_be_carried_whole() -> None:
    rig = Rig(Shape.STANDARD)
    with pytest.raises(drive.DriveError, match="carries 0x60C1:02"):
        rig.run(drive.start_interpolation(rig.axis, CYCLE, sub_mode=PositionAndVelocity()))


def stream(rig: Rig, following: Following, lead: int, missing: int) -> None:
    """Follow 5,000 counts/s. The RPDOs of `missing` SYNCs in a row are lost in the middle."""
    cyclic = {objects.VELOCITY_ACTUAL_VALUE: 1, objects.POSITION_ACTUAL_VALUE: 1}
    following.begin(Limit(500, "this test"), Mode.INTERPOLATED_POSITION, cyclic=cyclic, lag=LAG + lead)
    start = rig.axis.set_points.counts
    for step in range(1, 60):
        rig.remote.rpdos[4].set_enabled(not 30 <= step < 30 + missing, rig.bus.now)
        if not 30 <= step < 30 + missing:
            rig.axis.set_points.set_position_counts(start + 50 * step)
        rig.bus.run(CYCLE)


@pytest.mark.parametrize("is_ring", [False, True])
@pytest.mark.parametrize(("lead", "missing"), [(0, 0), (2, 0), (2, 2), (2, 3), (5, 5)])
def test_records_that_wait_in_the_drive_bridge_late_ones(is_ring: bool, lead: int, missing: int) -> None:
    rig = Rig(Shape.STANDARD, drive=DriveSettings(lag=0))
    rig.run(use_device_pdo(rig.remote, Direction.TPDO, 4))
    rig.start_sync()
    buffer = InterpolationBuffer(lead, is_ring, record_size=4)
    rig.run(drive.start_interpolation(rig.axis, CYCLE, buffer=buffer))
    store = rig.node.values.store
    assert (store[objects.BUFFER_ORGANISATION], store[objects.BUFFER_CLEAR]) == (is_ring, 1)
    assert store[objects.SIZE_OF_DATA_RECORD] == 4
    following = Following(rig.axis)
    stream(rig, following, lead, missing)
    underruns = rig.bus.take_events(SetPointUnderrun)
    assert bool(underruns) is (missing > lead)
    if not missing:
        assert following.largest_error == 0
        assert not rig.bus.take_events(FollowingLost)


def test_a_buffer_that_is_too_small_or_not_there_is_told_before_anything_is_written() -> None:
    for shape, lead, seen in ((Shape.STANDARD, 16, "its buffer holds 16"), (Shape.SCHUNK_POWERBALL, 1, "its buffer holds 1 ")):
        rig = Rig(shape)
        with pytest.raises(drive.DriveError, match=seen):
            rig.run(drive.start_interpolation(rig.axis, CYCLE, buffer=InterpolationBuffer(lead)))
        assert rig.axis.controlword == 0
    with pytest.raises(LocalProtocolError, match="lead must be"):
        InterpolationBuffer(-1)
