"""What an Axis knows, and when it has to forget it."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import groupby

import pytest

from canopen_proto.datatypes import DataType, ValueRangeError
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis, AxisSettings, AxisStateChanged
from canopen_proto.drives.axis.view import view_of
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outbox
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.steps import ProcedureError, StepTimeoutError
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.builds import takes_any_type
from tests.drives.rig import CYCLE, MILLIDEGREES, Rig


@pytest.mark.parametrize("scale", [math.nan, math.inf, -math.inf, 0.0, -1.0])
def test_a_scale_that_is_none_is_refused(scale: float) -> None:
    with pytest.raises(LocalProtocolError, match="counts_per_unit"):
        AxisSettings(counts_per_unit=scale)


def test_without_a_scale_positions_are_counts() -> None:
    axis = Axis(RemoteNode(Outbox(), 5, drive_dictionary()), AxisSettings(direction=-1, offset=100))
    assert (axis.scale.to_counts(-7), axis.scale.from_counts(107)) == (107, -7)


def test_a_node_never_heard_has_no_position_and_no_state() -> None:
    axis = Axis(RemoteNode(Outbox(), 5, drive_dictionary()))
    assert (axis.position, axis.velocity, axis.torque, axis.mode, axis.state) == (None, None, None, None, State.UNKNOWN)
    assert view_of(axis).describe() == "its statusword was not heard yet"


@pytest.mark.parametrize("shape", list(Shape))
def test_a_drive_that_boots_is_not_homed_any_more_and_its_state_is_not_known(shape: Shape) -> None:
    """It may have lost its power, and with it its reference: what it was before says nothing."""
    rig = Rig(shape)
    rig.run(drive.home(rig.axis))
    assert rig.axis.is_homed
    assert rig.axis.state is State.OPERATION_ENABLED
    rig.bus.events.clear()
    rig.nmt.reset_node(5, rig.bus.now)
    rig.bus.run(10 * MILLISECOND)
    assert not rig.axis.is_homed
    assert rig.axis.state is State.UNKNOWN
    assert rig.axis.position is None
    changes = [event for event in rig.bus.events if isinstance(event, AxisStateChanged)]
    assert [(change.previous, change.state) for change in changes] == [(State.OPERATION_ENABLED, State.UNKNOWN)]


def test_the_set_point_of_a_drive_without_60c1_is_its_target_position() -> None:
    objects = [each for index, each in drive_dictionary().objects.items() if index != 0x60C1]
    axis = Axis(RemoteNode(Outbox(), 5, ObjectDictionary(objects)), MILLIDEGREES)
    axis.set_points.set_position(0.25)
    assert axis.set_points.position == pytest.approx(0.25, abs=1e-4)


def axis_with(*set_points: Variable) -> Axis:
    """The axis of a drive that has these objects for its set-points."""
    others = [each for index, each in drive_dictionary().objects.items() if index not in (0x607A, 0x60C1)]
    records = [Object.of(variable.name, [variable]) for variable in set_points]
    return Axis(RemoteNode(Outbox(), 5, ObjectDictionary([*others, *records])), MILLIDEGREES)


IP_DATA = Variable(0x60C1, 1, "ip_data_position", DataType.INTEGER32, Access.RW)


@pytest.mark.parametrize(
    ("data_type", "fits", "too_small", "too_large"),
    [
        (DataType.INTEGER32, (-(1 << 31), 0, (1 << 31) - 1), -(1 << 31) - 1, 1 << 31),
        (DataType.INTEGER16, (-(1 << 15), 0, (1 << 15) - 1), -(1 << 15) - 1, 1 << 15),
        (DataType.UNSIGNED16, (0, 1, (1 << 16) - 1), -1, 1 << 16),
    ],
)
def test_a_set_point_must_fit_the_object_that_carries_it(
    data_type: DataType, fits: tuple[int, ...], too_small: int, too_large: int
) -> None:
    """The object of the mode decides, and its name is told; the image of the other one is not touched."""
    target = Variable(0x607A, 0, "target_position", data_type, Access.RW)
    axis = axis_with(IP_DATA, target)
    axis.set_points.set_position_counts(7)
    axis.set_points.select(Mode.CYCLIC_SYNCHRONOUS_POSITION)
    for counts in fits:
        axis.set_points.check(counts)
        axis.set_points.set_position_counts(counts)
        assert (axis.set_points.counts, axis.node.values[target.mux], axis.node.values[IP_DATA.mux]) == (counts, counts, 7)
    for counts in (too_small, too_large):
        with pytest.raises(ValueRangeError, match="target_position"):
            axis.set_points.set_position_counts(counts)
        with pytest.raises(ValueRangeError):
            axis.set_points.check(counts)
        assert axis.set_points.counts == fits[-1]
    axis.set_points.select(Mode.INTERPOLATED_POSITION)
    assert axis.set_points.counts == 7


@takes_any_type
@pytest.mark.parametrize("counts", [1.0, 1.5, math.nan, "1", None])
def test_a_set_point_that_is_no_integer_is_refused(counts: object) -> None:
    axis = axis_with(IP_DATA)
    with pytest.raises(ValueRangeError, match="ip_data_position"):
        axis.set_points.check(counts)  # type: ignore[arg-type]


def test_a_set_point_for_an_object_that_holds_no_integer_is_tried() -> None:
    """Some drives take set-points as REAL32: which numbers fit is for the type to say."""
    axis = axis_with(Variable(0x607A, 0, "target_position", DataType.REAL32, Access.RW))
    axis.set_points.check(1_000)
    with pytest.raises(ValueRangeError, match="target_position"):
        axis.set_points.check(10**40)


def test_other_settings_count_at_once() -> None:
    axis = axis_with(IP_DATA)
    axis.set_points.set_position_counts(5_100)
    axis.settings = AxisSettings(counts_per_unit=1000.0, direction=-1, offset=100)
    assert (axis.set_points.position, axis.scale.to_counts(-5.0), axis.scale.is_known) == (-5.0, 5_100, True)
    axis.settings = AxisSettings()
    assert (axis.set_points.position, axis.scale.is_known) == (5_100, False)


@pytest.mark.parametrize("enabled", [False, True])
@pytest.mark.parametrize("mode", [0, 8])
def test_a_halt_in_a_mode_whose_bit_10_says_nothing_of_it(mode: int, enabled: bool) -> None:
    """Csp reserves bit 10, and "no mode" has none: the actual position tells that the axis stands."""
    rig = Rig(Shape.STANDARD)
    rig.start_sync()
    if mode:
        rig.run(drive.set_mode(rig.axis, mode))
    if enabled:
        rig.run(drive.enable(rig.axis))
    rig.run(drive.halt(rig.axis))
    assert bool(rig.axis.controlword & 0x100) is enabled


def test_a_halt_of_a_moving_axis_in_csp_ends_when_it_stands() -> None:
    rig = Rig(Shape.STANDARD)
    rig.start_sync()
    rig.run(drive.start_cyclic_position(rig.axis, CYCLE, sends_itself=True))
    position = rig.axis.position
    for _ in range(20):
        position += 0.002
        rig.axis.set_points.set_position(position)
        rig.node.values.store[0x607A00] = rig.axis.scale.to_counts(position)  # as an RPDO of it would
        rig.drive.written(0x607A, 0, rig.bus.now)
        rig.bus.run(CYCLE)
    assert abs(rig.drive._servo.velocity) > 10_000
    rig.run(drive.halt(rig.axis))
    assert rig.drive._servo.velocity == 0


def test_an_axis_that_does_not_slow_down_is_told() -> None:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(reaction=2900 * MILLISECOND))
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    rig.run(drive.enable(rig.axis))
    rig.run(write(rig.remote, "0x60FF", 10_000))
    rig.bus.run(SECOND)
    with pytest.raises(StepTimeoutError, match=r"did not reach standstill after a halt within 2 s"):
        rig.run(drive.halt(rig.axis))  # it shows bit 10, "target velocity reached", all the time
    assert rig.drive._servo.velocity == pytest.approx(10_000)


def test_a_halt_of_a_drive_without_an_actual_position_goes_by_bit_10() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.run(drive.set_mode(rig.axis, 1))
    rig.run(drive.enable(rig.axis))
    objects = [each for index, each in rig.node.dictionary.objects.items() if index != 0x6064]
    other = RemoteNode(rig.master.out, 5, ObjectDictionary(objects))
    rig.master.detach(rig.remote)
    rig.master.attach(other)
    rig.run(drive.halt(Axis(other)))
    assert rig.node.values.store[0x604000] == 0x10F


@pytest.mark.parametrize("shape", list(Shape))
def test_bit_4_is_clear_before_the_mode_changes(shape: Shape) -> None:
    """A drive that goes by the level of bit 4 would begin to home while it still bears "enable interpolation"."""
    rig = Rig(shape)
    rig.start_sync()
    rig.run(drive.start_interpolation(rig.axis, CYCLE, sends_itself=True))
    assert rig.axis.controlword == 0x1F
    rig.bus.run(5 * CYCLE)
    rig.bus.sent.clear()
    rig.run(drive.home(rig.axis))
    frames = [str(frame) for _, frame in rig.bus.sent]
    change = frames.index("605#2F60600006000000")
    words = [frame[4:8] for frame in frames[:change] if frame.startswith(("205#", "505#"))]
    assert words[-1] == "0F01", "and the halt stays in force"


def test_a_command_waits_for_the_sync_whose_pdo_takes_it_along() -> None:
    """An RPDO of type 3 goes at every third SYNC: two words in a row have to be two PDOs, or an edge is none."""
    rig = Rig(Shape.STANDARD)
    rig.start_sync()
    rig.run(drive.enable(rig.axis))
    rig.remote.add_rpdo(4, 0x505, rig.remote.rpdos[4].mapping, 3)
    rig.remote.enable_rpdo(4, rig.bus.now)
    rig.bus.run(SECOND)
    rig.bus.sent.clear()
    for word in (0x0F, 0x10F, 0x0F):
        rig.run(drive.command(rig.axis, word))
    words = [frame.data[:2].hex() for _, frame in rig.bus.sent if frame.can_id == 0x505]
    assert [word for word, _ in groupby(words)] == ["0f00", "0f01", "0f00"]


STARTS = {
    "ip": lambda axis: drive.start_interpolation(axis, CYCLE, sends_itself=True),
    "csp": lambda axis: drive.start_cyclic_position(axis, CYCLE, sends_itself=True),
    "pp": lambda axis: drive.move_to(axis, 0.1, timeout=SECOND),
}


def reset(rig: Rig) -> None:
    rig.nmt.reset_node(5, rig.bus.now)
    rig.bus.run(10 * MILLISECOND)
    rig.nmt.start(5, rig.bus.now)
    rig.bus.run(10 * MILLISECOND)


@pytest.mark.parametrize("start", STARTS)
def test_a_reference_that_was_lost_is_lost_until_the_drive_is_homed_again(start: str) -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.run(drive.home(rig.axis))
    assert not rig.axis.has_lost_reference
    reset(rig)
    assert rig.axis.has_lost_reference
    rig.bus.sent.clear()
    with pytest.raises(drive.ReferenceLostError, match=r"drive 5 has lost its reference: .*keeps_reference"):
        rig.run(STARTS[start](rig.axis))
    assert not rig.bus.sent
    rig.run(drive.home(rig.axis))
    assert not rig.axis.has_lost_reference
    if start != "pp":
        rig.start_sync()
    rig.run(STARTS[start](rig.axis))


def test_a_relative_move_needs_no_reference() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.run(drive.home(rig.axis))
    reset(rig)
    rig.run(drive.move_to(rig.axis, 0.01, timeout=SECOND, relative=True))


def test_a_homing_that_fails_leaves_no_reference_behind() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.run(drive.home(rig.axis))
    before = rig.axis.settings
    rig.axis.settings = replace(before, homing_method=0)  # refused before anything is sent: the reference stays
    with pytest.raises(ProcedureError):
        rig.run(drive.home(rig.axis))
    assert not rig.axis.has_lost_reference
    rig.axis.settings = replace(before, homing_method=17, homing_timeout=100 * MILLISECOND)
    with pytest.raises(ProcedureError):
        rig.run(drive.home(rig.axis))
    assert rig.axis.has_lost_reference


def test_what_was_never_homed_has_nothing_to_lose() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    reset(rig)
    assert not rig.axis.has_lost_reference
    rig.start_sync()
    rig.run(drive.start_interpolation(rig.axis, CYCLE, sends_itself=True))


def test_a_drive_that_keeps_its_reference_stays_homed() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.axis.settings = replace(rig.axis.settings, keeps_reference=True)
    rig.run(drive.home(rig.axis))
    reset(rig)
    assert rig.axis.is_homed
    assert not rig.axis.has_lost_reference
    rig.start_sync()
    rig.run(drive.start_interpolation(rig.axis, CYCLE, sends_itself=True))
