"""Nothing jumps: whatever a drive was doing, the next command takes it over at a halt that is in force, and seen.

The simulated drive's own demand is the judge.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.machine import MILLISECOND, SECOND, RequestId, Time
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.runner import ProcedureFinished
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import CYCLE, Ended, Rig
from tests.examples import examples

RAMP = 40_000
"""Of each acceleration and deceleration, in counts per second squared."""
RAMPS = (
    objects.PROFILE_ACCELERATION, objects.PROFILE_DECELERATION, objects.QUICK_STOP_DECELERATION, objects.HOMING_ACCELERATION,
)  # fmt: skip
ROUNDING = 110
"""A count, on its way for one cycle, is 100 counts per second."""


def rig_of(reaction: Time = 0, *, pdos: bool = False) -> Rig:
    rig = Rig(Shape.STANDARD, pdos=pdos, drive=DriveSettings(reaction=reaction))
    rig.node.values.store.update(dict.fromkeys(RAMPS, RAMP))
    return rig


def velocity_of(rig: Rig) -> float:
    rig.drive.refresh(rig.bus.now)
    return rig.drive._servo.demand_velocity


def run_velocity(rig: Rig) -> None:
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    rig.run(drive.enable(rig.axis))
    rig.run(write(rig.remote, "0x60FF", 25_000))


def run_homing(rig: Rig) -> None:
    rig.run(drive.set_mode(rig.axis, Mode.HOMING))
    rig.run(write(rig.remote, "0x6098", 17))
    rig.run(drive.enable(rig.axis))
    rig.run(drive.command(rig.axis, 0x1F))


def run_move(rig: Rig) -> RequestId:
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_POSITION))
    rig.run(drive.enable(rig.axis))
    return rig.master.run(drive.move_to(rig.axis, 1.0, timeout=60 * SECOND), rig.bus.now)


def cancelled_move(rig: Rig) -> None:
    request = run_move(rig)
    rig.bus.run(300 * MILLISECOND)
    rig.master.cancel(request, rig.bus.now)
    rig.outcome(request)


def follow(rig: Rig) -> None:
    position = rig.run(drive.start_interpolation(rig.axis, CYCLE))
    for step in range(1, 30):
        rig.axis.set_points.set_position(position + step * min(step, 20) * 0.0002)
        rig.bus.run(CYCLE)


DOINGS: dict[str, Callable[[Rig], object]] = {
    "nothing": lambda rig: None,
    "standing": lambda rig: rig.run(drive.enable(rig.axis)),
    "velocity": run_velocity,
    "homing": run_homing,
    "cancelled move": cancelled_move,
    "interpolation": follow,
}


STARTS = {"ip": drive.start_interpolation, "csp": drive.start_cyclic_position, "csv": drive.start_cyclic_velocity}


@pytest.mark.thorough(6)
@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("doing", DOINGS)
@given(reaction=st.integers(0, 300), later=st.integers(0, 1000))
@example(reaction=0, later=700)
@examples(2)
def test_following_begins_with_a_drive_that_stands(doing: str, start: str, reaction: int, later: int) -> None:
    """Whatever the drive was doing, the start changes its velocity by no more than its ramps."""
    is_following = doing == "interpolation"  # set-points end with it: a late drive would stop dead at the last one
    rig = rig_of(0 if is_following else reaction * MILLISECOND, pdos=True)
    rig.start_sync()
    DOINGS[doing](rig)
    if not is_following:
        rig.bus.run(later * MILLISECOND)
    request = rig.master.run(STARTS[start](rig.axis, CYCLE, sends_itself=True), rig.bus.now)
    ended: list[Ended] = []
    rig.bus.on_event = lambda event: ended.append(event) if isinstance(event, Ended) and event.request_id == request else None
    before, left = velocity_of(rig), 50
    while left:
        rig.bus.run(MILLISECOND)
        now = velocity_of(rig)
        assert abs(now - before) <= RAMP / 1000 + ROUNDING
        before = now
        left -= bool(ended)
    assert abs(before) <= ROUNDING
    assert rig.axis.statusword & 0x1000


MOTIONS: dict[str, Callable[[Rig], object]] = {"velocity": run_velocity, "move": run_move}


@pytest.mark.parametrize("motion", MOTIONS)
@given(reaction=st.integers(0, 900), later=st.integers(0, 900))
@example(reaction=100, later=565)
@example(reaction=900, later=100)
@examples(5)
def test_a_halt_returns_with_a_drive_that_stands(motion: str, reaction: int, later: int) -> None:
    """Whenever it is given, and however late the drive acts on it."""
    rig = rig_of(reaction * MILLISECOND)
    request = MOTIONS[motion](rig)
    rig.bus.run(later * MILLISECOND)
    if isinstance(request, int):
        rig.master.cancel(request, rig.bus.now)
        rig.outcome(request)
    else:
        rig.run(drive.halt(rig.axis))
    assert velocity_of(rig) == 0
    position = rig.drive._servo.demand_position
    rig.bus.run(2 * SECOND)
    assert rig.drive._servo.demand_position == position, "it moved afterwards"


@given(reaction=st.integers(0, 900), later=st.integers(0, 2500), pdos=st.booleans())
@example(reaction=500, later=1300, pdos=False)
@example(reaction=500, later=1100, pdos=True)
@example(reaction=50, later=101, pdos=False)
@examples(10)
def test_a_halt_that_comes_while_a_drive_is_being_enabled_finds_it(reaction: int, later: int, pdos: bool) -> None:
    """It stands at the end, and goes on standing: no command that it got before the halt moves it."""
    rig = rig_of(reaction * MILLISECOND, pdos=pdos)
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    rig.run(write(rig.remote, "0x60FF", 25_000))
    request = rig.master.run(drive.enable(rig.axis), rig.bus.now)
    rig.bus.run(later * MILLISECOND)
    rig.master.cancel(request, rig.bus.now)
    rig.bus.run(MILLISECOND)
    rig.run(drive.halt(rig.axis))
    assert velocity_of(rig) == 0
    rig.bus.run(2 * SECOND)
    assert velocity_of(rig) == 0


def halted_move(rig: Rig, later: int) -> float:
    """A move that was cancelled; where the drive stands."""
    request = run_move(rig)
    rig.bus.run(later * MILLISECOND)
    rig.master.cancel(request, rig.bus.now)
    rig.outcome(request)
    assert velocity_of(rig) == 0
    return rig.drive._servo.demand_position


@pytest.mark.thorough(2)
@pytest.mark.parametrize("relative", [False, True])
@given(reaction=st.integers(0, 300), later=st.integers(0, 1500), target=st.floats(-0.5, 1.5))
@example(reaction=0, later=700, target=0.0)
@examples(4)
def test_a_move_after_a_cancelled_one_goes_straight_to_its_own_target(
    relative: bool, reaction: int, later: int, target: float
) -> None:
    rig = rig_of(reaction * MILLISECOND)
    start = halted_move(rig, later)
    end = rig.axis.scale.to_counts(target) + (start if relative else 0)
    request = rig.master.run(drive.move_to(rig.axis, target, timeout=60 * SECOND, relative=relative), rig.bus.now)
    while rig.master.runner.busy:
        rig.bus.run(2 * MILLISECOND)
        rig.drive.refresh(rig.bus.now)
        assert min(start, end) - 1 <= rig.drive._servo.demand_position <= max(start, end) + 1
    assert isinstance(rig.outcome(request), ProcedureFinished)
    assert rig.drive._servo.demand_position == pytest.approx(end, abs=1)


@pytest.mark.parametrize("mode", [Mode.PROFILE_VELOCITY, Mode.HOMING, Mode.INTERPOLATED_POSITION])
@given(reaction=st.integers(0, 300), later=st.integers(0, 300))
@example(reaction=200, later=10)
@examples(3)
def test_a_halt_stays_in_force_while_the_mode_changes(mode: Mode, reaction: int, later: int) -> None:
    rig = rig_of(reaction * MILLISECOND)
    position = halted_move(rig, later)
    began = len(rig.bus.sent)
    rig.run(drive.set_mode(rig.axis, mode))
    rig.bus.run(2 * SECOND)
    assert rig.drive._servo.demand_position == position
    words = [frame.data[4] | frame.data[5] << 8 for _, frame in rig.bus.sent[began:] if frame.data[1:3] == b"\x40\x60"]
    assert all(word & 0x100 for word in words if word)


def test_a_move_from_another_mode_begins_where_the_drive_stands() -> None:
    rig = rig_of()
    run_velocity(rig)
    rig.bus.run(SECOND)
    moved: list[float] = []
    rig.bus.on_event = lambda event: moved.append(velocity_of(rig)) if rig.axis.mode == Mode.PROFILE_POSITION else None
    rig.run(drive.move_to(rig.axis, 0.0, timeout=60 * SECOND))
    assert max(moved) <= 0
