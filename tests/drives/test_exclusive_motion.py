"""One motion command at a time on each axis: a second one is refused, a stop takes over, and each is told; in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.slow_position import start_slow_position
from canopen_proto.drives.cia402.states import Command, ControlBit, State
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, Outbox, RequestId
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Procedure
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.drives.rig import CYCLE, Rig

FAR = 3.0
"""Radians: seconds away."""

Make = Callable[[Axis], Procedure[Any]]

MOTIONS: dict[str, Make] = {
    "move_to": lambda axis: drive.move_to(axis, FAR, timeout=60 * SECOND),
    "move_along": lambda axis: drive.move_along(axis, [drive.ProfileTarget(FAR)], timeout=60 * SECOND),
    "home": drive.home,
    "run_at": lambda axis: drive.run_at(axis, 0.1),
    "apply_torque": lambda axis: drive.apply_torque(axis, 0.01, 60 * SECOND, max_speed=100.0),
}
OTHERS: dict[str, Make] = {
    **MOTIONS,
    "set_mode": lambda axis: drive.set_mode(axis, 3),
    "enable": drive.enable,
    "select_motionless_mode": drive.select_motionless_mode,
    "start_interpolation": lambda axis: drive.start_interpolation(axis, CYCLE, sends_itself=True),
    "start_cyclic_position": lambda axis: drive.start_cyclic_position(axis, CYCLE, sends_itself=True),
    "start_slow_position": start_slow_position,
}
STOPS: dict[str, Make] = {
    "halt": drive.halt,
    "quick_stop": drive.quick_stop,
    "engage_brake": drive.engage_brake,
    "shut_down": drive.shut_down,
    "change_state_down": lambda axis: drive.change_state(axis, State.SWITCHED_ON),
}


def rig_of() -> Rig:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=0, lag=0, track=Track(negative_limit=-1e9)))
    rig.axis.settings = replace(rig.axis.settings, homing_method=17)
    return rig


def begun(rig: Rig, make: Make) -> RequestId:
    """Start a motion and let it run until the drive moves."""
    request_id = rig.master.run(make(rig.axis), rig.bus.now)
    rig.bus.run(400 * MILLISECOND)
    assert rig.master.runner.busy
    return request_id


def commands(rig: Rig) -> int:
    """How many objects were written to the drive."""
    return sum(frame.can_id == 0x605 and frame.data[0] & 0xE0 == 0x20 for _, frame in rig.bus.sent)


@pytest.mark.parametrize("second", OTHERS)
def test_a_second_motion_is_refused_and_the_first_goes_on(second: str) -> None:
    rig = rig_of()
    first = rig.master.run(drive.move_to(rig.axis, 0.2, timeout=60 * SECOND), rig.bus.now)
    rig.bus.run(500 * MILLISECOND)
    before = commands(rig)
    with pytest.raises(
        drive.AxisBusyError, match=f"^drive 5 cannot {second} now: move_to is under way; nothing was sent"
    ) as caught:
        rig.run(OTHERS[second](rig.axis))
    assert "wait for its end, or halt the drive first" in str(caught.value)
    assert commands(rig) == before
    assert isinstance(rig.outcome(first), ProcedureFinished)
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(0.2, abs=0.001)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("stop", STOPS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_stop_takes_over_and_the_motion_says_so(motion: str, stop: str) -> None:
    rig = rig_of()
    first = begun(rig, MOTIONS[motion])
    rig.run(STOPS[stop](rig.axis))
    ended = rig.outcome(first)
    assert isinstance(ended, ProcedureFailed)
    assert isinstance(ended.error, drive.TakenOverError)
    assert str(ended.error).startswith(f"drive 5 was taken from {motion}: {stop} took over")
    rig.bus.run(2 * SECOND)
    here = rig.run(drive.read_position(rig.axis))
    rig.bus.run(SECOND)
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(here, abs=1e-6)
    assert stop != "halt" or rig.axis.controlword & ControlBit.HALT


def test_the_motion_ends_before_the_drive_stands() -> None:
    rig = rig_of()
    first = begun(rig, MOTIONS["move_to"])
    halting = rig.master.run(drive.halt(rig.axis), rig.bus.now)
    began = rig.bus.now
    rig.outcome(first)
    assert rig.bus.now - began <= 20 * MILLISECOND
    assert isinstance(rig.outcome(halting), ProcedureFinished)


def test_a_motion_waits_for_the_halt_of_the_one_before() -> None:
    rig = rig_of()
    first = begun(rig, MOTIONS["move_to"])
    rig.master.cancel(first, rig.bus.now)
    rig.run(drive.move_to(rig.axis, 0.0, timeout=60 * SECOND))
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(0.0, abs=0.001)


@pytest.mark.parametrize("stop", STOPS)
def test_a_stop_ends_a_motion_that_waits_for_the_halt_of_the_one_before(stop: str) -> None:
    """It was commanded before the stop: behind it, it would move the axis that was told to stand."""
    rig = rig_of()
    first = begun(rig, MOTIONS["move_to"])
    rig.master.cancel(first, rig.bus.now)
    waiting = rig.master.run(MOTIONS["move_to"](rig.axis), rig.bus.now)
    rig.bus.run(20 * MILLISECOND)
    assert isinstance(rig.outcome(rig.master.run(STOPS[stop](rig.axis), rig.bus.now)), ProcedureFinished)
    ended = rig.outcome(waiting)
    assert isinstance(ended, ProcedureFailed)
    assert str(ended.error).startswith(f"drive 5 was taken from move_to: {stop} took over")
    rig.bus.run(SECOND)  # a quick stop is over once the drive brakes
    here = rig.run(drive.read_position(rig.axis))
    rig.bus.run(SECOND)
    assert rig.run(drive.read_position(rig.axis)) == here


def test_a_stop_beside_another_one_takes_no_command_from_it() -> None:
    """The first one has a word that waits behind a read without an answer; both succeed."""
    for step in range(20):
        rig = rig_of()
        rig.run(drive.change_state(rig.axis, State.SWITCHED_ON))
        rig.bus.run(200 * MILLISECOND)  # its state is read anew
        deliver = rig.bus._deliver

        def lose(receiver: Outbox, frame: Frame, deliver: Callable[[Outbox, Frame], None] = deliver) -> None:
            if frame.can_id != 0x585 or frame.data[1:3] != b"\x00\x10":
                deliver(receiver, frame)

        rig.bus._deliver = lose  # type: ignore[method-assign]
        brake = rig.master.run(drive.engage_brake(rig.axis), rig.bus.now)
        rig.bus.run(step * MILLISECOND // 10)
        rig.remote.read("0x1000", rig.bus.now)
        rig.bus.run(MILLISECOND)
        again = rig.master.run(drive.engage_brake(rig.axis), rig.bus.now)
        assert isinstance(rig.outcome(brake), ProcedureFinished)
        assert isinstance(rig.outcome(again), ProcedureFinished)
        assert rig.drive.state is State.READY_TO_SWITCH_ON


@pytest.mark.parametrize("stop", ["engage_brake", "shut_down", "change_state_down"])
def test_a_halt_does_not_lead_back_a_drive_that_another_stop_leads_down(stop: str) -> None:
    """The drive acts 40 ms later, so it still shows that it is enabled: bit 8 comes with the command to enable."""
    for later in range(0, 50, 2):
        rig = rig_of()
        rig.node.drives[0].settings = replace(rig.node.drives[0].settings, reaction=40 * MILLISECOND)
        begun(rig, MOTIONS["move_to"])
        down = rig.master.run(STOPS[stop](rig.axis), rig.bus.now)
        rig.bus.run(later * MILLISECOND)
        halting = rig.master.run(drive.halt(rig.axis), rig.bus.now)
        assert isinstance(rig.outcome(halting), ProcedureFinished)
        assert isinstance(rig.outcome(down), ProcedureFinished)
        rig.bus.run(SECOND)
        assert rig.drive.state is not State.OPERATION_ENABLED


def test_a_motion_waits_for_a_stop() -> None:
    rig = rig_of()
    first = begun(rig, MOTIONS["run_at"])
    halting = rig.master.run(drive.halt(rig.axis), rig.bus.now)
    rig.run(drive.move_to(rig.axis, 0.0, timeout=60 * SECOND))
    assert isinstance(rig.outcome(first), ProcedureFailed)
    assert isinstance(rig.outcome(halting), ProcedureFinished)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("stop", STOPS)
def test_a_stop_that_is_cancelled_leaves_the_drive_halted(stop: str) -> None:
    rig = rig_of()
    begun(rig, MOTIONS["move_to"])
    stopping = rig.master.run(STOPS[stop](rig.axis), rig.bus.now)  # nothing of it has left yet
    rig.master.cancel(stopping, rig.bus.now)
    assert isinstance(rig.outcome(stopping), ProcedureCancelled)
    here = rig.run(drive.read_position(rig.axis))
    rig.bus.run(SECOND)
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(here, abs=1e-6)


def test_a_procedure_that_was_given_up_leaves_the_axis_free() -> None:
    rig = rig_of()
    moving = drive.move_to(rig.axis, FAR, timeout=60 * SECOND)
    moving.send(None)
    moving.close()
    rig.run(drive.move_to(rig.axis, 0.1, timeout=60 * SECOND))


def words_since(rig: Rig, began: int) -> list[int]:
    """The controlwords that went by SDO behind the first `began` frames."""
    writes = (frame.data for _, frame in rig.bus.sent[began:] if frame.can_id == 0x605 and frame.data[:3] == b"\x2b\x40\x60")
    return [data[4] | data[5] << 8 for data in writes]


@pytest.mark.parametrize("stop", STOPS)
@pytest.mark.parametrize("motion", ["move_to", "run_at"])
def test_no_command_that_waits_behind_another_transfer_undoes_a_stop(motion: str, stop: str) -> None:
    """Somebody reads an object, and the answer is lost: for 500 ms all others wait. The stop goes first of them."""
    for step in range(45):
        rig = rig_of()
        deliver = rig.bus._deliver

        def lose(receiver: Outbox, frame: Frame, deliver: Callable[[Outbox, Frame], None] = deliver) -> None:
            if frame.can_id != 0x585 or frame.data[1:3] != b"\x00\x10":
                deliver(receiver, frame)

        rig.bus._deliver = lose  # type: ignore[method-assign]
        moving = rig.master.run(MOTIONS[motion](rig.axis), rig.bus.now)
        rig.bus.run(step * MILLISECOND // 5)
        rig.remote.read("0x1000", rig.bus.now)
        rig.bus.run(100 * MILLISECOND)
        began = len(rig.bus.sent)
        stopping = rig.master.run(STOPS[stop](rig.axis), rig.bus.now)
        assert isinstance(rig.outcome(stopping), ProcedureFinished)
        rig.outcome(moving)
        rig.bus.run(SECOND)
        here = rig.run(drive.read_position(rig.axis))
        rig.bus.run(SECOND)
        assert rig.run(drive.read_position(rig.axis)) == here
        assert stop == "halt" or rig.drive.state is not State.OPERATION_ENABLED
        assert all(word & ControlBit.HALT for word in words_since(rig, began) if word & 0x0F == Command.ENABLE_OPERATION)
