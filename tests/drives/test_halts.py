"""A halt takes what the drive's speed and ramp take: it is waited for, also as the clean-up of what was cancelled."""

from __future__ import annotations

import pytest

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.runner import CLEAN_UP_TIME, ProcedureCancelled
from canopen_proto.procedures.steps import Procedure, StepTimeoutError, sleep
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.drive import Drive
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.builds import replaces_what_is_compiled
from tests.drives.rig import Rig

SPEED = 50_000
ENDLESS = Track(positive_limit=1e9)


def running(rig: Rig, ramp: int) -> None:
    """Let the drive run at SPEED for ever, with that deceleration."""
    rig.node.values.store[objects.PROFILE_DECELERATION] = ramp
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    rig.run(drive.enable(rig.axis))
    rig.run(write(rig.remote, "0x60FF", SPEED))
    rig.bus.run(SECOND)
    assert rig.drive._servo.velocity == pytest.approx(SPEED)


def speed_of(rig: Rig) -> float:
    rig.drive.refresh(rig.bus.now)
    return rig.drive._servo.velocity


HIDDEN = {
    "speed and ramp": (),
    "speed": (0x6084, 0x6083),
    "position and ramp": (0x606C,),
    "position": (0x606C, 0x6084, 0x6083, 0x605D),
}


@pytest.mark.thorough(4)
@pytest.mark.parametrize("reaction", [0, 500 * MILLISECOND])
@pytest.mark.parametrize("ramp", [5_000, 10_000, 16_000, 500_000])
def test_a_drive_that_brakes_is_waited_for_whatever_its_ramp(ramp: int, reaction: int) -> None:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(reaction=reaction, track=ENDLESS))
    running(rig, ramp)
    began = rig.bus.now
    rig.run(drive.halt(rig.axis))
    assert speed_of(rig) == 0
    assert rig.bus.now - began == pytest.approx(SPEED / ramp * SECOND + reaction, abs=100 * MILLISECOND)


@pytest.mark.parametrize("after", [0, 300, 20_000])
def test_a_halt_that_is_cancelled_halts_all_the_same(after: int) -> None:
    """after: its cancellation, in us."""
    rig = Rig(Shape.STANDARD, pdos=False)
    running(rig, 500_000)
    request = rig.master.run(drive.halt(rig.axis), rig.bus.now)
    rig.bus.run(after * MICROSECOND)
    rig.master.cancel(request, rig.bus.now)
    assert isinstance(rig.outcome(request), ProcedureCancelled)
    assert speed_of(rig) == 0


@pytest.mark.thorough(2)
@pytest.mark.parametrize("told", HIDDEN)
def test_a_drive_that_brakes_is_waited_for_whatever_it_tells(told: str) -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    running(rig, 10_000)
    rest = [each for index, each in rig.node.dictionary.objects.items() if index not in HIDDEN[told]]
    rig.master.detach(rig.remote)
    remote = RemoteNode(rig.master.out, 5, ObjectDictionary(rest))
    rig.master.attach(remote)
    rig.run(drive.halt(Axis(remote)))
    assert speed_of(rig) == 0


def test_the_halt_of_a_cancelled_move_is_waited_for() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    for key, value in ((objects.PROFILE_VELOCITY, SPEED), (objects.PROFILE_DECELERATION, 16_000)):
        rig.node.values.store[key] = value
    request = rig.master.run(drive.move_to(rig.axis, 15.0, timeout=60 * SECOND), rig.bus.now)
    rig.bus.run(2 * SECOND)
    assert speed_of(rig) == SPEED
    began = rig.bus.now
    rig.master.cancel(request, began)
    ended = rig.outcome(request)
    assert isinstance(ended, ProcedureCancelled)
    assert ended.clean_up_error is None
    assert speed_of(rig) == 0
    assert rig.bus.now - began > 3 * SECOND


def test_the_halt_of_a_dead_drive_holds_up_nobody() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    request = rig.master.run(drive.move_to(rig.axis, 15.0, timeout=60 * SECOND), rig.bus.now)
    rig.bus.run(SECOND)
    rig.bus.detach(rig.device)
    began = rig.bus.now
    rig.master.cancel(request, began)
    ended = rig.outcome(request)
    assert isinstance(ended, ProcedureCancelled)
    assert ended.clean_up_error is not None
    assert rig.bus.now - began <= CLEAN_UP_TIME


def test_a_drive_that_goes_on_as_before_is_told_within_reaction_and_halt_time() -> None:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(reaction=2900 * MILLISECOND, track=ENDLESS))
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    rig.run(drive.enable(rig.axis))
    rig.run(write(rig.remote, "0x60FF", SPEED))
    rig.bus.run(SECOND)
    began = rig.bus.now
    with pytest.raises(StepTimeoutError, match="standstill after a halt"):
        rig.run(drive.halt(rig.axis))
    settings = rig.axis.settings
    assert rig.bus.now - began <= settings.reaction_time + settings.halt_time + 100 * MILLISECOND
    assert speed_of(rig) == pytest.approx(SPEED)


@pytest.mark.thorough(6)
@pytest.mark.parametrize("is_refused", [False, True])
@pytest.mark.parametrize("speed", [0, SPEED])
@pytest.mark.parametrize("reaction", [0, 600, 1_300, 2_900])
def test_a_drive_without_a_position_is_halted_however_late_it_acts(reaction: int, speed: int, is_refused: bool) -> None:
    """Its bit 10 may be left from before the halt: as long as the drive may take to obey, it proves nothing.

    is_refused: the drive's dictionary has a position, and the drive refuses to have it read.
    """
    settings = DriveSettings(reaction=reaction * MILLISECOND, track=ENDLESS)
    complete = Rig(Shape.STANDARD, pdos=False).node.dictionary
    rest = ObjectDictionary([each for index, each in complete.objects.items() if index not in (0x6063, 0x6064)])
    rig = Rig(Shape.STANDARD, pdos=False, drive=settings, dictionary=rest)
    if is_refused:
        rig.master.detach(rig.remote)
        rig.remote = RemoteNode(rig.master.out, 5, complete)
        rig.master.attach(rig.remote)
        rig.axis = Axis(rig.remote)
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    rig.run(drive.enable(rig.axis))
    rig.run(write(rig.remote, "0x60FF", speed))
    rig.bus.run(5 * SECOND)
    rig.run(drive.halt(rig.axis))
    assert speed_of(rig) == 0


def test_a_quick_stop_by_somebody_else_is_waited_for_too() -> None:
    """A drive that is not enabled is not commanded; one that brakes moves all the same."""
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.node.values.store[objects.QUICK_STOP_DECELERATION] = 20_000
    running(rig, 10_000)
    rig.run(drive.quick_stop(rig.axis))
    assert speed_of(rig) > 0
    rig.run(drive.halt(rig.axis))
    assert speed_of(rig) == 0


@replaces_what_is_compiled
@pytest.mark.parametrize("hidden", [300 * MILLISECOND, 60 * SECOND])
def test_a_drive_that_shows_no_state_is_no_drive_that_stands(hidden: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A statusword that fits no pattern says nothing: the next one that does is waited for, and then it is halted."""
    rig = Rig(Shape.STANDARD, pdos=False)
    running(rig, 500_000)
    rig.bus.run(SECOND)
    ends, real = rig.bus.now + hidden, Drive._statusword
    monkeypatch.setattr(Drive, "_statusword", lambda drive: real(drive) if rig.bus.now >= ends else 0x0203)
    rig.drive.refresh(rig.bus.now)
    try:
        rig.run(drive.halt(rig.axis))
    except StepTimeoutError as unknown:
        assert hidden > SECOND
        assert "a statusword that shows a state" in str(unknown)
        assert speed_of(rig) == SPEED
    else:
        assert hidden < SECOND
        assert speed_of(rig) == 0


def test_a_drive_in_its_fault_reaction_is_shut_down_when_it_stands() -> None:
    """It has power, and brakes: whoever makes it stop by itself lets it go only then."""
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.node.values.store[objects.QUICK_STOP_DECELERATION] = 40_000
    running(rig, 10_000)
    speeds: list[float] = []

    class Watchdog:
        def hold(self) -> Procedure[None]:
            yield from sleep(0)

        def let_go(self) -> Procedure[None]:
            speeds.append(speed_of(rig))
            yield from sleep(0)

    rig.axis.watchdog = Watchdog()
    rig.node.raise_fault(0x2310, rig.bus.now)
    assert speed_of(rig) == SPEED
    rig.run(drive.shut_down(rig.axis))
    assert speeds == [0]
    assert rig.drive.state is State.FAULT
