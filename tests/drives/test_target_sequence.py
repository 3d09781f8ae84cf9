"""`drive.move_along`: sets of set-points of profile position, as the drive gets and goes through them; in virtual time."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.datatypes import ValueRangeError
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.slow_position import start_slow_position
from canopen_proto.drives.axis.target_sequence import ProfileTarget, RelativeTo, Start
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import POWERED, State
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.procedures.runner import ProcedureFailed
from canopen_proto.procedures.steps import Procedure, StepTimeoutError
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import Rig
from tests.examples import examples

DEGREES = AxisSettings(counts_per_unit=1000.0)
LIMIT = 60 * SECOND
SLOW = 150
"""Counts per second: slower than one ms after a stop at 100 degrees per second²."""


def rig_at_zero(**settings: object) -> Rig:
    """A drive that stands at 0, in degrees; 20 degrees a second, 100 degrees a second² are its own."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(**{"position": 0, "lag": 0, **settings}))  # type: ignore[arg-type]
    rig.axis.settings = DEGREES
    return rig


def along(rig: Rig, *targets: ProfileTarget) -> Procedure[None]:
    return drive.move_along(rig.axis, targets, timeout=LIMIT)


def turning_points(rig: Rig, *targets: ProfileTarget) -> list[float]:
    """Run through targets; the places, in degrees, where the drive stood for a moment."""
    rig.master.run(along(rig, *targets), rig.bus.now)
    places: list[float] = []
    while rig.master.runner.busy:
        rig.bus.run(MILLISECOND)
        rig.drive.refresh(rig.bus.now)
        place = round(rig.drive._servo.position / 1000, 1)
        if abs(rig.drive._servo.demand_velocity) < SLOW and (not places or places[-1] != place):
            places.append(place)
    return places


def words_of(rig: Rig) -> list[int]:
    """The control words that went by SDO."""
    return [
        int.from_bytes(frame.data[4:6], "little")
        for _, frame in rig.bus.sent
        if frame.can_id == 0x605 and frame.data[1:3] == b"\x40\x60" and frame.data[0] == 0x2B
    ]


def test_one_after_the_other_each_with_a_stop() -> None:
    assert turning_points(rig_at_zero(), ProfileTarget(10), ProfileTarget(5), ProfileTarget(20)) == [0, 10, 5, 20]


@pytest.mark.parametrize("reaction", [20, 300])
def test_a_drive_that_obeys_late(reaction: int) -> None:
    targets = (
        ProfileTarget(5),
        ProfileTarget(3),
        ProfileTarget(4, start=Start.ON_THE_WAY),
        ProfileTarget(2, relative_to=RelativeTo.PREVIOUS),
    )
    assert turning_points(rig_at_zero(reaction=reaction * MILLISECOND), *targets) == [0, 5, 3, 4, 6]


def test_the_handshake() -> None:
    rig = rig_at_zero()
    rig.run(along(rig, ProfileTarget(1), ProfileTarget(2), ProfileTarget(3, start=Start.ON_THE_WAY)))
    words = words_of(rig)
    assert words[words.index(0x0F) + 1 :] == [0x2F, 0x3F, 0x2F, 0x0F, 0x1F, 0x0F, 0x20F, 0x21F, 0x20F]


def test_on_the_way_nothing_stops_and_each_profile_is_its_own() -> None:
    rig = rig_at_zero()
    rig.master.run(
        along(
            rig,
            ProfileTarget(10, velocity=10, acceleration=50),
            ProfileTarget(20, start=Start.ON_THE_WAY, velocity=5, deceleration=20),
        ),
        0,
    )
    speeds = {}
    while rig.master.runner.busy:
        rig.bus.run(5 * MILLISECOND)
        rig.drive.refresh(rig.bus.now)
        speeds[round(rig.drive._servo.position / 1000)] = rig.drive._servo.velocity / 1000
    assert speeds[9] == pytest.approx(10)
    assert speeds[10] > 8.9, "half a degree further, by 20 degrees a second²"
    assert speeds[15] == pytest.approx(5)
    store = rig.node.values.store
    assert (store[objects.PROFILE_ACCELERATION], store[objects.PROFILE_DECELERATION]) == (50_000, 20_000)


def test_at_once_drops_the_one_before() -> None:
    assert (
        turning_points(rig_at_zero(), ProfileTarget(90), ProfileTarget(2, start=Start.AT_ONCE, pause=500 * MILLISECOND))[-1] == 2
    )


def test_values_are_written_only_where_they_change() -> None:
    rig = rig_at_zero()
    rig.run(
        along(rig, ProfileTarget(1, velocity=5), ProfileTarget(2, velocity=5), ProfileTarget(3), ProfileTarget(4, velocity=6))
    )
    written = [frame.data[4:8] for _, frame in rig.bus.sent if frame.can_id == 0x605 and frame.data[:4] == b"\x23\x81\x60\x00"]
    assert [int.from_bytes(each, "little") for each in written] == [5_000, 6_000]


@pytest.mark.thorough(3)
@pytest.mark.parametrize("option", [0, 1, 2])
@pytest.mark.parametrize("relative_to", RelativeTo)
def test_relative_whatever_60f2_was(option: int, relative_to: RelativeTo) -> None:
    rig = rig_at_zero()
    rig.node.values.store[objects.POSITIONING_OPTION_CODE] = option
    rig.run(along(rig, ProfileTarget(10, relative_to=relative_to), ProfileTarget(5, relative_to=RelativeTo.PREVIOUS)))
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(15, abs=0.05)


def test_relative_to_the_demand_on_the_way() -> None:
    rig = rig_at_zero()
    point = ProfileTarget(2, relative_to=RelativeTo.DEMAND, start=Start.AT_ONCE, pause=500 * MILLISECOND)
    rig.run(along(rig, ProfileTarget(50), point))
    end = rig.run(drive.read_position(rig.axis))
    assert 6 < end < 15  # half a second of the way, and 2 degrees more


def test_an_end_velocity_and_none_that_another_tool_left() -> None:
    rig = rig_at_zero()
    assert turning_points(rig, ProfileTarget(10, end_velocity=5), ProfileTarget(20)) == [0, 20]
    rig.node.values.store[objects.END_VELOCITY] = 5_000
    rig.run(along(rig, ProfileTarget(10)))
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(10, abs=0.05)
    rig.node.values.store[objects.END_VELOCITY] = 5_000
    rig.run(drive.move_to(rig.axis, 0.0, timeout=LIMIT))
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(0, abs=0.05)
    with pytest.raises(LocalProtocolError, match="end velocity"):
        rig.run(along(rig, ProfileTarget(10, end_velocity=5)))


def test_a_drive_without_a_queue() -> None:
    rig = rig_at_zero(set_points=0)
    with pytest.raises(drive.DriveError, match="queues_set_points=False"):
        rig.run(along(rig, ProfileTarget(10), ProfileTarget(5)))
    rig.axis.settings = replace(DEGREES, queues_set_points=False)
    assert turning_points(rig, ProfileTarget(10), ProfileTarget(5), ProfileTarget(20))[-3:] == [10, 5, 20]
    with pytest.raises(drive.DriveError, match="can pass none on the way"):
        rig.run(along(rig, ProfileTarget(10), ProfileTarget(5, start=Start.ON_THE_WAY)))


def test_a_longer_queue_is_used() -> None:
    rig = rig_at_zero(set_points=5)
    rig.master.run(along(rig, *(ProfileTarget(each) for each in (10, 5, 10, 5))), rig.bus.now)
    rig.bus.run(300 * MILLISECOND)
    assert len(rig.drive._mode._waiting) == 3  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("targets", "error"),
    [
        ([ProfileTarget(10), ProfileTarget(50)], "max_position"),
        ([ProfileTarget(10), ProfileTarget(25, relative_to=RelativeTo.PREVIOUS)], "max_position"),
        ([ProfileTarget(10), ProfileTarget(5, velocity=31)], "max_speed"),
        ([ProfileTarget(10), ProfileTarget(5, velocity=20, end_velocity=31), ProfileTarget(0)], "max_speed"),
    ],
)
def test_a_target_beyond_a_limit_is_refused_before_the_first_begins(targets: list[ProfileTarget], error: str) -> None:
    rig = rig_at_zero()
    rig.axis.settings = replace(DEGREES, max_position=30.0, min_position=-30.0, max_speed=30.0)
    with pytest.raises(drive.LimitReachedError, match=error):
        rig.run(along(rig, *targets))
    assert words_of(rig) == []


def test_a_way_from_the_demand_is_checked_when_it_is_known() -> None:
    rig = rig_at_zero()
    rig.axis.settings = replace(DEGREES, max_position=30.0)
    with pytest.raises(drive.LimitReachedError, match="max_position"):
        rig.run(along(rig, ProfileTarget(20), ProfileTarget(15, relative_to=RelativeTo.DEMAND)))
    assert rig.drive._servo.at_rest
    assert rig.axis.controlword & 0x100


@pytest.mark.parametrize(
    "target", [ProfileTarget(1e9), ProfileTarget(1, velocity=1e9), ProfileTarget(1e9, relative_to=RelativeTo.DEMAND)]
)
def test_what_no_object_can_hold(target: ProfileTarget) -> None:
    rig = rig_at_zero()
    with pytest.raises(ValueRangeError):
        rig.run(along(rig, ProfileTarget(1), target))
    assert words_of(rig) == []


def test_a_speed_below_the_drives_unit() -> None:
    rig = rig_at_zero()
    rig.axis.settings = replace(DEGREES, velocity_unit=1000.0)
    with pytest.raises(drive.DriveError, match=r"less than one unit of 0x6081"):
        rig.run(along(rig, ProfileTarget(1, velocity=0.5)))


def test_a_drive_without_60f2_counts_from_the_previous_target_only() -> None:
    rig = rig_at_zero()
    objects_left = [each for index, each in rig.node.dictionary.objects.items() if index != 0x60F2]
    rig.remote.dictionary = ObjectDictionary(objects_left)
    rig.run(along(rig, ProfileTarget(3), ProfileTarget(-1, relative_to=RelativeTo.PREVIOUS)))
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(2, abs=0.05)
    with pytest.raises(drive.DriveError, match="no 0x60F2"):
        rig.run(along(rig, ProfileTarget(10), ProfileTarget(5, relative_to=RelativeTo.DEMAND)))


def test_the_whole_has_a_limit_of_time() -> None:
    rig = rig_at_zero()
    with pytest.raises(StepTimeoutError):
        rig.run(drive.move_along(rig.axis, [ProfileTarget(10), ProfileTarget(0), ProfileTarget(10)], timeout=SECOND))
    assert rig.drive._servo.at_rest


def test_no_targets_do_nothing() -> None:
    rig = rig_at_zero()
    rig.run(along(rig))
    assert rig.axis.mode != Mode.PROFILE_POSITION


TARGETS = (
    ProfileTarget(10, velocity=15),
    ProfileTarget(20, start=Start.ON_THE_WAY),
    ProfileTarget(-5, relative_to=RelativeTo.PREVIOUS),
    ProfileTarget(5, relative_to=RelativeTo.DEMAND, start=Start.AT_ONCE, pause=100 * MILLISECOND),
)


@given(at=st.integers(0, 4_000), how=st.sampled_from(["cancel", "fault", "another master", "unplugged"]))
@example(at=0, how="cancel")
@examples(15)
def test_whenever_it_ends_the_drive_stands_or_has_no_power(at: int, how: str) -> None:
    rig = rig_at_zero()
    request = rig.master.run(along(rig, *TARGETS), rig.bus.now)
    rig.bus.run(at * MILLISECOND)
    if how == "cancel":
        rig.master.cancel(request, rig.bus.now)
    elif how == "fault":
        rig.node.raise_fault(0x2310, rig.bus.now)
    elif how == "unplugged":
        rig.node.values.store[objects.ABORT_CONNECTION_OPTION_CODE] = 3
        rig.bus.detach(rig.device)
        rig.drive.connection_lost(rig.bus.now, 0x8130)
    else:
        rig.drive.values.store[objects.CONTROLWORD] = 0x02
        rig.drive.written(0x6040, 0, rig.bus.now)
    ended = rig.outcome(request)
    rig.bus.run(SECOND)
    rig.drive.refresh(rig.bus.now)
    assert rig.drive.state not in POWERED or rig.drive._servo.at_rest
    if isinstance(ended, ProcedureFailed):
        assert how != "cancel"


@pytest.mark.thorough(6)
@pytest.mark.parametrize("settings", [{}, {"mode_change_state": State.SWITCHED_ON}, {"changes_mode_halted": False}], ids=str)
@pytest.mark.parametrize("points", [0, 1, 3])
@pytest.mark.parametrize("second", ["move_to", "move_along", "slow"])
def test_what_waited_in_a_cancelled_set_stands_in_nobodys_way(points: int, settings: dict[str, Any], second: str) -> None:
    rig = rig_at_zero(set_points=points, **{k: v for k, v in settings.items() if k == "mode_change_state"})
    rig.axis.settings = replace(DEGREES, queues_set_points=bool(points), **settings)
    targets = [ProfileTarget(60 + each) for each in range(points + 3)]
    request_id = rig.master.run(along(rig, *targets), rig.bus.now)
    rig.bus.run(500 * MILLISECOND)
    rig.master.cancel(request_id, rig.bus.now)
    rig.outcome(request_id)
    began = rig.bus.now
    if second == "slow":
        rig.run(start_slow_position(rig.axis))
        rig.bus.run(SECOND)
        assert rig.drive._servo.demand_velocity == 0
        return
    rig.run(drive.move_to(rig.axis, 1, timeout=LIMIT) if second == "move_to" else along(rig, ProfileTarget(1)))
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(1, abs=0.05)
    assert rig.bus.now - began < 4 * SECOND, "it went there at once"


def test_no_target_leads_beyond_a_limit_because_the_drive_stood_beyond_it() -> None:
    """It may stay there and come back, but not go there once more."""
    rig = rig_at_zero(position=22_000)
    rig.axis.settings = replace(DEGREES, max_position=20.0, keeps_reference=True)
    with pytest.raises(drive.LimitReachedError, match=r"was not moved to 21\.5: the settings \(max_position\) say 20"):
        rig.run(along(rig, ProfileTarget(10), ProfileTarget(21.5), ProfileTarget(0)))
    assert not words_of(rig)
    assert turning_points(rig, ProfileTarget(21.5), ProfileTarget(21), ProfileTarget(0)) == [22.0, 21.5, 21.0, 0.0]


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("direction", [1, -1])
def test_a_drive_that_runs_on_behind_its_target_is_halted_before_a_limit(side: int, direction: int) -> None:
    """It passes 10 degrees at 10 a second, and its next target comes only 4 s later."""
    rig = rig_at_zero()
    rig.axis.settings = replace(DEGREES, min_position=-20.0, max_position=20.0, direction=direction, keeps_reference=True)
    targets = ProfileTarget(side * 10, velocity=20, end_velocity=10), ProfileTarget(0, pause=4 * SECOND)
    request = rig.master.run(along(rig, *targets), rig.bus.now)
    farthest = 0.0
    while rig.master.runner.busy:
        rig.bus.run(MILLISECOND)
        rig.drive.refresh(rig.bus.now)
        farthest = max(farthest, side * direction * rig.drive._servo.position / 1000)
    ended = rig.outcome(request)
    assert isinstance(ended, ProcedureFailed)
    assert isinstance(ended.error, drive.LimitReachedError)
    assert "it passed its target at 10 per second, and came near" in str(ended.error)
    assert 12 < farthest <= 20


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("deceleration", [5, 100, 200, None])
@pytest.mark.parametrize("pause", [300, 600, 700])
def test_no_target_at_once_brings_a_deceleration_with_which_the_drive_passes_a_limit(
    side: int, direction: int, deceleration: float | None, pause: int
) -> None:
    """It goes to 18 degrees at 20 a second, and is called back on the way. Where it can still stop, it comes back."""
    rig = rig_at_zero()
    rig.axis.settings = replace(DEGREES, min_position=-20.0, max_position=20.0, direction=direction, keeps_reference=True)
    called_back = ProfileTarget(0, start=Start.AT_ONCE, pause=pause * MILLISECOND, deceleration=deceleration)
    request = rig.master.run(
        along(rig, ProfileTarget(side * 18, velocity=20, acceleration=100, deceleration=100), called_back), rig.bus.now
    )
    farthest = 0.0
    while rig.master.runner.busy:
        rig.bus.run(MILLISECOND)
        rig.drive.refresh(rig.bus.now)
        farthest = max(farthest, side * direction * rig.drive._servo.position / 1000)
    ended = rig.outcome(request)
    assert farthest <= 20
    assert isinstance(ended, ProcedureFailed) == (deceleration == 5)
    if isinstance(ended, ProcedureFailed):
        assert isinstance(ended.error, drive.LimitReachedError)
        assert "would need" in str(ended.error)
        assert farthest > 2, "it was under way"
