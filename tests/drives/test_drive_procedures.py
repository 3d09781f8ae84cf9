"""The manual's sequences against the simulated drive, in both shapes, by SDO alone and with PDOs and SYNC."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from canopen_proto.application import PlainMemory
from canopen_proto.dictionary import Direction
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis, AxisSettings, AxisStateChanged
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outbox
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoTransferError, StepTimeoutError
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import CYCLE, Rig

SHAPES = [Shape.STANDARD, Shape.SCHUNK_POWERBALL]


def moving(rig: Rig) -> bool:
    rig.drive.refresh(rig.bus.now)
    return not rig.drive._servo.at_rest


def writes_of(rig: Rig, index: int) -> list[int]:
    """The values that the master wrote to an object by expedited SDO."""
    head = index.to_bytes(2, "little")
    return [
        int.from_bytes(frame.data[4:], "little")
        for _, frame in rig.bus.sent
        if frame.can_id == 0x605 and frame.data[0] in (0x23, 0x2B, 0x2F) and frame.data[1:3] == head
    ]


@pytest.mark.parametrize("pdos", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_enable_leads_step_by_step_to_operation_enabled(shape: Shape, pdos: bool) -> None:
    rig = Rig(shape, pdos=pdos)
    rig.run(drive.enable(rig.axis))
    assert rig.drive.state is rig.axis.state is State.OPERATION_ENABLED
    assert writes_of(rig, 0x6040) == [0x06, 0x0F] or writes_of(rig, 0x6040) == [0x06, 0x07, 0x0F]
    states = [event.state for event in rig.bus.events if isinstance(event, AxisStateChanged)]
    assert states[-1] is State.OPERATION_ENABLED


@pytest.mark.parametrize("shape", SHAPES)
def test_a_fault_is_reset_by_a_rising_edge_and_only_on_request(shape: Shape) -> None:
    rig = Rig(shape)
    rig.run(drive.enable(rig.axis))
    rig.node.raise_fault(0x3220, rig.bus.now)
    rig.bus.run(200 * MILLISECOND)  # what a TPDO said before is too old now
    with pytest.raises(drive.DriveInFaultError, match=r"drive 5 is in fault and cannot go to operation enabled.*0x3220"):
        rig.run(drive.enable(rig.axis))
    rig.bus.sent.clear()
    rig.run(drive.reset_fault(rig.axis))
    assert writes_of(rig, 0x6040) == [0x0000, 0x0080, 0x0000]
    assert rig.drive.state is State.SWITCH_ON_DISABLED
    rig.run(drive.reset_fault(rig.axis))  # nothing to reset: nothing is sent
    assert writes_of(rig, 0x6040) == [0x0000, 0x0080, 0x0000]


def test_a_fault_whose_cause_stays_is_told() -> None:
    rig = Rig(Shape.STANDARD)
    rig.node.raise_fault(0x3220, rig.bus.now, lasting=True)
    with pytest.raises(drive.DriveInFaultError, match="that a fault reset did not clear"):
        rig.run(drive.reset_fault(rig.axis))


@pytest.mark.parametrize("shape", SHAPES)
def test_homing_can_be_repeated(shape: Shape) -> None:
    """Trap 31 of peers: a second homing that begins with bit 4 set never starts."""
    rig = Rig(shape)
    for _ in range(2):
        rig.run(drive.home(rig.axis))
        assert rig.axis.is_homed
        assert rig.axis.mode == Mode.HOMING
        assert rig.run(drive.read_position(rig.axis)) == 0
    written = writes_of(rig, 0x6040)
    assert written.count(0x1F) == 2
    assert all(written[place - 1] == 0x0F for place, word in enumerate(written) if word == 0x1F)


def test_homing_of_a_schunk_waives_the_check_of_6502_and_the_method() -> None:
    rig = Rig(Shape.SCHUNK_POWERBALL)
    rig.run(drive.home(rig.axis))
    assert rig.node.values.store[objects.SUPPORTED_DRIVE_MODES] == 0x43
    assert writes_of(rig, 0x6098) == []


def test_homing_without_the_mode_writes_nothing() -> None:
    rig = Rig(Shape.STANDARD)
    rig.node.values.store[objects.SUPPORTED_DRIVE_MODES] = 0x01
    with pytest.raises(drive.ModeUnsupportedError, match=r"does not support homing.*0x00000001, which is profile position"):
        rig.run(drive.home(rig.axis))
    assert writes_of(rig, 0x6060) == writes_of(rig, 0x6040) == []


def test_a_homing_error_is_told_and_the_drive_halted() -> None:
    rig = Rig(Shape.STANDARD)
    rig.node.values.store[objects.HOMING_METHOD] = 0
    rig.axis = Axis(rig.remote, AxisSettings(homing_method=None))
    with pytest.raises(drive.HomingError, match="homing error"):
        rig.run(drive.home(rig.axis))
    assert not rig.axis.is_homed
    assert not moving(rig)


def test_a_homing_that_does_not_end_is_halted() -> None:
    rig = Rig(Shape.STANDARD)
    rig.axis = Axis(rig.remote, AxisSettings(homing_method=17, homing_timeout=200 * MILLISECOND))
    with pytest.raises(StepTimeoutError, match=r"did not reach the end of homing within 0.2 s"):
        rig.run(drive.home(rig.axis))
    assert writes_of(rig, 0x6040)[-1] & 0x100
    assert not moving(rig)


def test_a_fault_in_the_middle_of_homing_is_told_with_its_emcy() -> None:
    rig = Rig(Shape.STANDARD)
    rig.axis = Axis(rig.remote, AxisSettings(homing_method=17))
    request = rig.master.run(drive.home(rig.axis), rig.bus.now)
    rig.bus.run(200 * MILLISECOND)
    assert moving(rig)
    rig.node.raise_fault(0x2310, rig.bus.now)
    ended = rig.outcome(request)
    assert isinstance(ended, ProcedureFailed)
    assert isinstance(ended.error, drive.DriveInFaultError)
    assert "while waiting for the end of homing" in str(ended.error)
    assert "last EMCY 0x2310" in str(ended.error)


@pytest.mark.parametrize("shape", SHAPES)
def test_interpolation_starts_where_the_drive_stands_and_follows(shape: Shape) -> None:
    rig = Rig(shape)
    rig.run(drive.home(rig.axis))
    rig.start_sync()
    start = rig.run(drive.start_interpolation(rig.axis, CYCLE))
    assert start == rig.axis.set_points.position == 0
    assert rig.axis.statusword & 0x1000
    for step in range(1, 51):
        rig.axis.set_points.set_position(step * 0.002)
        rig.bus.run(CYCLE)
    rig.bus.run(10 * CYCLE)
    assert rig.axis.position == pytest.approx(0.1, abs=1e-4)
    assert rig.drive.state is State.OPERATION_ENABLED


def test_interpolation_needs_the_mode() -> None:
    rig = Rig(Shape.STANDARD)
    rig.node.values.store[objects.SUPPORTED_DRIVE_MODES] = 0x21
    with pytest.raises(drive.ModeUnsupportedError, match="interpolated position"):
        rig.run(drive.start_interpolation(rig.axis, CYCLE))


@pytest.mark.parametrize("cycle_time", [1_001_000, 1_234_567, 256 * SECOND])
def test_a_cycle_that_60c2_cannot_hold_is_refused(cycle_time: int) -> None:
    rig = Rig(Shape.STANDARD)
    with pytest.raises(ProcedureError, match="cannot be written to 0x60C2"):
        rig.run(drive.start_interpolation(rig.axis, cycle_time))


def test_interpolation_without_sync_starts_by_sdo() -> None:
    """The manual's direct API: bit 4 is set by SDO, SYNC begins with the first sendSync."""
    rig = Rig(Shape.SCHUNK_POWERBALL)
    rig.run(drive.home(rig.axis))
    rig.run(drive.start_interpolation(rig.axis, CYCLE))
    assert writes_of(rig, 0x6040)[-1] == 0x1F
    assert rig.axis.controlword == 0x1F, "the image follows the SDO write, or the first RPDO would drop the drive"
    rig.bus.sent.clear()
    rig.sync.send(rig.bus.now)
    rig.bus.run(MILLISECOND)
    assert rig.bus.trace()[:2] == ["080#", "205#1F00000000000000"]


def test_cyclic_position_follows() -> None:
    rig = Rig(Shape.STANDARD)
    rig.run(drive.home(rig.axis))
    rig.run(use_device_pdo(rig.remote, Direction.RPDO, 3))
    with pytest.raises(ProcedureError):
        rig.run(drive.start_cyclic_position(rig.axis, 1))
    assert rig.run(drive.start_cyclic_position(rig.axis, CYCLE)) == 0
    assert rig.axis.mode == Mode.CYCLIC_SYNCHRONOUS_POSITION


def test_cyclic_position_does_not_jump_to_an_old_target() -> None:
    """In csp a drive follows 0x607A as soon as it has the mode and power."""
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.node.values.store[objects.TARGET_POSITION] = -50_000
    rig.start_sync()
    rig.run(drive.start_cyclic_position(rig.axis, CYCLE, sends_itself=True))
    assert rig.drive._servo.demand_position == rig.drive.settings.position
    assert not moving(rig)


STARTS = {"ip": (drive.start_interpolation, "0x60C1:01"), "csp": (drive.start_cyclic_position, "0x607A:00")}


@pytest.mark.parametrize("name", STARTS)
def test_following_without_an_rpdo_that_carries_set_points_is_refused(name: str) -> None:
    start, carried = STARTS[name]
    rig = Rig(Shape.STANDARD, pdos=False)
    with pytest.raises(ProcedureError, match=f"would get no set-points: no RPDO .* carries {carried}"):
        rig.run(start(rig.axis, CYCLE))
    assert writes_of(rig, 0x6060) == writes_of(rig, 0x6040) == []
    rig.run(start(rig.axis, CYCLE, sends_itself=True))


def test_following_with_a_node_that_is_not_operational_is_refused() -> None:
    rig = Rig(Shape.STANDARD)
    rig.nmt.enter_pre_operational(5, rig.bus.now)
    rig.bus.run(MILLISECOND)
    with pytest.raises(ProcedureError, match=r"would get no set-points: .*PRE_OPERATIONAL"):
        rig.run(drive.start_interpolation(rig.axis, CYCLE))


def test_profile_position_absolute_and_relative() -> None:
    rig = Rig(Shape.STANDARD)
    rig.run(drive.home(rig.axis))
    rig.run(drive.move_to(rig.axis, 0.5, timeout=20 * SECOND))
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(0.5, abs=1e-3)
    rig.run(drive.move_to(rig.axis, -0.2, timeout=20 * SECOND, relative=True))
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(0.3, abs=1e-3)
    with pytest.raises(StepTimeoutError, match="its target position"):
        rig.run(drive.move_to(rig.axis, 1.5, timeout=50 * MILLISECOND))
    assert not moving(rig)


@pytest.mark.parametrize("by_pdo", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_halt_brake_and_shut_down(shape: Shape, by_pdo: bool) -> None:
    rig = Rig(shape)
    rig.run(drive.home(rig.axis))
    if by_pdo:
        rig.start_sync()
        rig.run(drive.start_interpolation(rig.axis, CYCLE))
        for step in range(1, 20):
            rig.axis.set_points.set_position(step * 0.002)
            rig.bus.run(CYCLE)
        assert moving(rig)
    rig.run(drive.halt(rig.axis))
    assert rig.drive.state is State.OPERATION_ENABLED
    assert rig.axis.controlword & 0x100
    assert not moving(rig)
    rig.run(drive.engage_brake(rig.axis))
    assert rig.drive.state is State.READY_TO_SWITCH_ON
    rig.run(drive.halt(rig.axis))  # not enabled: left alone
    rig.run(drive.shut_down(rig.axis))
    assert rig.drive.state is State.SWITCH_ON_DISABLED
    assert not any(producer.is_live for producer in rig.remote.rpdos.values())


def test_shutting_down_a_drive_in_fault_leaves_it() -> None:
    rig = Rig(Shape.STANDARD)
    rig.node.raise_fault(0x3220, rig.bus.now)
    rig.run(drive.shut_down(rig.axis))
    assert rig.drive.state is State.FAULT


def test_quick_stop() -> None:
    rig = Rig(Shape.STANDARD)
    rig.run(drive.enable(rig.axis))
    rig.run(drive.quick_stop(rig.axis))
    assert rig.drive.state in (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)
    rig.bus.run(SECOND)
    assert rig.drive.state is State.SWITCH_ON_DISABLED


def test_a_drive_that_does_not_answer() -> None:
    rig = Rig(Shape.STANDARD)
    rig.bus.detach(rig.device)
    with pytest.raises(SdoTransferError, match=r"node 5 did not answer reading 0x6041:00"):
        rig.run(drive.enable(rig.axis))


def test_a_mode_that_the_drive_does_not_take_up() -> None:
    rig = Rig(Shape.STANDARD)
    rig.node.application = PlainMemory()  # it stores what is written, and does nothing
    with pytest.raises(drive.ModeUnsupportedError, match="did not take up homing"):
        rig.run(drive.set_mode(rig.axis, Mode.HOMING))


def test_commands_go_by_an_event_driven_rpdo_at_once() -> None:
    rig = Rig(Shape.STANDARD)
    rig.run(use_device_pdo(rig.remote, Direction.RPDO, 1))
    rig.remote.enable_rpdo(1, rig.bus.now)
    rig.bus.sent.clear()
    rig.run(drive.enable(rig.axis))
    assert writes_of(rig, 0x6040) == []
    assert [frame for frame in rig.bus.trace() if frame.startswith("205#")] in (
        ["205#0600", "205#0700", "205#0F00"],
        ["205#0600", "205#0F00"],
    )


def test_a_sync_that_stops_makes_commands_go_by_sdo() -> None:
    rig = Rig(Shape.STANDARD)
    rig.run(drive.home(rig.axis))
    rig.start_sync()
    rig.run(drive.start_interpolation(rig.axis, CYCLE))
    rig.sync.stop()
    rig.bus.sent.clear()
    rig.run(drive.halt(rig.axis))  # SYNC ran a moment ago: it waits for the next, in vain
    assert writes_of(rig, 0x6040) == [0x11F]


def test_the_fault_of_a_node_that_falls_silent_is_told_all_the_same() -> None:
    rig = Rig(Shape.STANDARD)
    rig.start_sync()
    rig.node.raise_fault(0x3220, rig.bus.now)
    rig.bus.run(2 * CYCLE)
    rig.bus.detach(rig.device)
    with pytest.raises(drive.DriveInFaultError, match="its error code could not be read: node 5 did not answer"):
        rig.run(drive.enable(rig.axis))


def schunk_whose_status_is(rig: Rig, statusword: int) -> None:
    """The drive shows this statusword from now on, whatever happens; no drive stands behind it."""
    rig.node.application = PlainMemory()
    rig.node.values.store[objects.STATUSWORD] = statusword
    rig.node.values.store[objects.MODES_OF_OPERATION_DISPLAY] = Mode.HOMING


def test_a_schunk_that_stands_unreferenced_has_failed() -> None:
    rig = Rig(Shape.SCHUNK_POWERBALL, pdos=False)
    schunk_whose_status_is(rig, 0x0237)  # operation enabled
    request = rig.master.run(drive.home(rig.axis), rig.bus.now)
    for statusword in (0x0237, 0x0337, 0x0237):  # moving, in the middle
        schunk_whose_status_is(rig, statusword)
        rig.bus.run(200 * MILLISECOND)
    ended = rig.outcome(request)
    assert isinstance(ended, ProcedureFailed)
    assert isinstance(ended.error, drive.HomingError)
    assert "not referenced" in str(ended.error)


def test_a_schunk_that_does_not_begin_to_home_has_failed() -> None:
    rig = Rig(Shape.SCHUNK_POWERBALL, pdos=False)
    schunk_whose_status_is(rig, 0x0237)
    with pytest.raises(drive.HomingError, match=r"did not begin to home within 1 s"):
        rig.run(drive.home(rig.axis))


def test_a_halt_that_is_not_confirmed_is_told() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    schunk_whose_status_is(rig, 0x0237)  # operation enabled, and never at standstill
    rig.remote.values.store[objects.MODES_OF_OPERATION_DISPLAY] = Mode.PROFILE_POSITION
    rig.remote.heard_at[objects.MODES_OF_OPERATION_DISPLAY] = rig.bus.now
    with pytest.raises(StepTimeoutError, match="standstill after a halt"):
        rig.run(drive.halt(rig.axis))


def test_a_cancelled_procedure_tells_of_the_halt_that_failed() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    prepare_homing(rig)
    request = rig.master.run(drive.home(rig.axis), rig.bus.now)
    rig.bus.run(200 * MILLISECOND)
    schunk_whose_status_is(rig, 0x0237)
    rig.master.cancel(request, rig.bus.now)
    ended = rig.outcome(request)
    assert isinstance(ended, ProcedureCancelled)
    assert isinstance(ended.clean_up_error, StepTimeoutError)


def test_a_mechanical_block_becomes_a_following_error() -> None:
    rig = Rig(Shape.STANDARD)
    rig.run(drive.home(rig.axis))
    rig.node.block(True, rig.bus.now)
    with pytest.raises(drive.DriveInFaultError, match="0x8611"):
        rig.run(drive.move_to(rig.axis, 1.0, timeout=20 * SECOND))


def test_entering_operational_tells_the_statusword_to_whoever_waits_for_events() -> None:
    rig = Rig(Shape.STANDARD)
    rig.bus.sent.clear()
    rig.nmt.enter_pre_operational(5, rig.bus.now)
    rig.nmt.start(5, rig.bus.now)
    rig.bus.run(MILLISECOND)
    assert "185#4002" in rig.bus.trace()


def test_a_second_boot_is_refused_and_changes_nothing() -> None:
    rig = Rig(Shape.STANDARD)
    rig.run(drive.enable(rig.axis))
    with pytest.raises(LocalProtocolError):
        rig.node.boot(rig.bus.now)
    assert rig.drive.state is State.OPERATION_ENABLED


def test_a_failing_halt_is_noted_at_its_cause() -> None:
    rig = Rig(Shape.STANDARD)
    rig.axis = Axis(rig.remote, AxisSettings(homing_method=17))
    request = rig.master.run(drive.home(rig.axis), rig.bus.now)
    rig.bus.run(200 * MILLISECOND)
    rig.bus.detach(rig.device)
    ended = rig.outcome(request)
    assert isinstance(ended, ProcedureFailed)
    assert any("the halt of drive 5 failed" in note for note in ended.error.__notes__)


def test_a_halt_that_the_drive_has_is_never_called_failed_for_want_of_its_answer() -> None:
    """Another SDO client took the answers: the drive had its halt bit, and power, and neither was said."""
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.axis = Axis(rig.remote, AxisSettings(homing_method=17, homing_timeout=400 * MILLISECOND))
    request = rig.master.run(drive.home(rig.axis), rig.bus.now)
    rig.bus.run(200 * MILLISECOND)
    deliver = rig.bus._deliver

    def deliver_without(receiver: Outbox, frame: Frame) -> None:
        if frame.data[:4] != b"\x60\x40\x60\x00":
            deliver(receiver, frame)

    rig.bus._deliver = deliver_without  # type: ignore[method-assign]
    ended = rig.outcome(request)
    assert isinstance(ended, ProcedureFailed)
    (note,) = ended.error.__notes__
    assert note == (
        "and drive 5 has its halt bit (controlword 0x011F), which it did not confirm; it still has power (operation enabled)"
    )


# ---- cancelled at every step ----


def cancel_after(make: Callable[[Rig], Procedure[object]], rig: Rig, frames: int) -> bool:
    """Start a procedure, cancel it after that many frames; whether it was still running then."""
    request = rig.master.run(make(rig), rig.bus.now)
    start = len(rig.bus.sent)
    rig.bus.run_until(lambda: len(rig.bus.sent) - start >= frames or not rig.master.runner.busy, 200 * SECOND)
    if not rig.master.runner.busy:
        return False
    rig.master.cancel(request, rig.bus.now)
    ended = rig.outcome(request)
    assert isinstance(ended, ProcedureCancelled)
    assert ended.clean_up_error is None
    return True


def prepare_homing(rig: Rig) -> None:
    rig.axis = Axis(rig.remote, AxisSettings(homing_method=17))


def prepare_interpolation(rig: Rig) -> None:
    rig.run(drive.home(rig.axis))
    rig.start_sync()


MOVES: dict[str, tuple[Callable[[Rig], None], Callable[[Rig], Procedure[object]]]] = {
    "home": (prepare_homing, lambda rig: drive.home(rig.axis)),
    "interpolate": (prepare_interpolation, lambda rig: drive.start_interpolation(rig.axis, CYCLE)),
    "move": (lambda rig: None, lambda rig: drive.move_to(rig.axis, 0.2, timeout=20 * SECOND)),
}


@pytest.mark.parametrize("name", MOVES)
def test_cancelled_at_every_step_the_drive_is_halted(name: str) -> None:
    prepare, make = MOVES[name]
    for frames in [*range(40), 60, 100, 200]:
        rig = Rig(Shape.STANDARD)
        prepare(rig)
        cancelled = cancel_after(make, rig, frames)
        rig.bus.run(20 * MILLISECOND)
        if cancelled:
            assert not moving(rig), f"still moving when cancelled after {frames} frames"
            assert not rig.remote.sdo.busy


def test_a_second_cancel_and_a_late_one_change_nothing() -> None:
    rig = Rig(Shape.STANDARD)
    prepare_homing(rig)
    request = rig.master.run(drive.home(rig.axis), rig.bus.now)
    rig.bus.run(200 * MILLISECOND)
    rig.master.cancel(request, rig.bus.now)
    rig.master.cancel(request, rig.bus.now)
    assert isinstance(rig.outcome(request), ProcedureCancelled)
    rig.master.cancel(request, rig.bus.now)
    rig.bus.run(SECOND)
    assert [event for event in rig.bus.events if isinstance(event, ProcedureCancelled)] == [
        ProcedureCancelled(0, request, None),
    ]


# ---- the axis ----


def test_units_direction_and_offset() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    axis = Axis(rig.remote, AxisSettings(counts_per_unit=1000.0, direction=-1, offset=50))
    assert axis.scale.to_counts(1.5) == -1450
    assert axis.scale.from_counts(-1450) == 1.5
    axis.set_points.set_position(1.5)
    assert axis.set_points.position == 1.5
    assert rig.remote.values.read("6064") == 0
    with pytest.raises(LocalProtocolError):
        AxisSettings(direction=2)
    with pytest.raises(LocalProtocolError):
        AxisSettings(counts_per_unit=0)


def test_a_set_point_beyond_the_object_is_refused_and_the_last_one_stays() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.axis.set_points.set_position(1.0)
    with pytest.raises(ValueError, match="607A|60C1"):
        rig.axis.set_points.set_position(1e9)
    assert rig.axis.set_points.position == pytest.approx(1.0, abs=1e-4)


def test_actual_values_and_settings_of_a_drive() -> None:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(position=90_000))
    store = rig.remote.values.store
    store[objects.VELOCITY_ACTUAL_VALUE] = 18_000
    store[objects.TORQUE_ACTUAL_VALUE] = 250
    rig.remote.heard_at.update(dict.fromkeys((objects.VELOCITY_ACTUAL_VALUE, objects.TORQUE_ACTUAL_VALUE), rig.bus.now))
    assert rig.axis.velocity == pytest.approx(0.314159, abs=1e-6)
    assert rig.axis.torque == 0.25
    assert rig.run(drive.read_position(rig.axis)) == pytest.approx(1.570796, abs=1e-6)
    assert not rig.axis.has_fault
