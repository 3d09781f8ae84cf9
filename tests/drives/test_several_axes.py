"""Several axes on one node: their objects, their PDOs, and each drive under its own command."""

from __future__ import annotations

from dataclasses import replace

import pytest

from canopen_proto.dictionary import Object, ObjectDictionary
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.axis_node import FurtherAxis
from canopen_proto.drives.axis.following import Following, FollowingLost
from canopen_proto.drives.axis.limits import Limit
from canopen_proto.drives.axis.motion_plan import exchange_planned, plan_motion
from canopen_proto.drives.axis.view import view_of
from canopen_proto.drives.cia402 import axes, objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.emcy import EmcyReceived
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.procedures.objects import read_int, write
from canopen_proto.procedures.steps import all_of
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import CYCLE, MILLIDEGREES, Rig

TWO = drive_dictionary(axes=2)
SETTINGS = replace(MILLIDEGREES, counts_per_unit=1.0, homing_method=35)


class TwoAxes(Rig):
    """A node with two axes, both known to the master."""

    def __init__(self) -> None:
        super().__init__(Shape.STANDARD, axis=1)
        self.first, self.second = Axis(self.remote, SETTINGS), self.axis
        self.second.settings = SETTINGS

    def follow(self, *modes: Mode) -> None:
        """Both axes follow set-points from where they stand, each in its own mode."""
        for axis, mode in zip((self.first, self.second), modes, strict=True):
            plan = plan_motion(TWO, 5, CYCLE, wish=mode, axis=axis.number)
            self.run(exchange_planned(self.remote, plan))
        self.start_sync()
        starts = {
            Mode.CYCLIC_SYNCHRONOUS_POSITION: drive.start_cyclic_position,
            Mode.INTERPOLATED_POSITION: drive.start_interpolation,
        }
        pairs = zip((self.first, self.second), modes, strict=True)
        self.run(all_of(*(starts[mode](axis, CYCLE) for axis, mode in pairs)))


def test_the_objects_of_two_axes_change_places_and_all_others_stay() -> None:
    for axis in range(axes.MAX_AXES):
        for index in range(0x1000, 0xA000, 0x55):
            key = mux(index, 3)
            there = axes.swapped(key, axis)
            assert axes.swapped(there, axis) == key
            assert axes.axis_of(there) == {0: axis, axis: 0}.get(place := axes.axis_of(key), place)  # type: ignore[call-overload]
    assert axes.swapped(objects.CONTROLWORD, 7) == mux(0x9840)
    assert axes.axis_of(mux(0x5FFF)) is axes.axis_of(mux(0xA000)) is None
    assert [axes.usual_axis_of_pdo(number) for number in (1, 64, 65, 512)] == [0, 0, 1, 7]


def test_a_dictionary_shows_its_axes_and_names_their_objects() -> None:
    assert axes.axes_of(TWO) == (0, 1)
    assert axes.axes_of(drive_dictionary()) == (0,)
    assert [axes.profile_of(TWO, axis) for axis in (0, 1, 2)] == [402, 402, None]
    assert TWO.variable("controlword").mux == objects.CONTROLWORD
    assert TWO.variable("controlword_axis_1").label == "controlword_axis_1 (0x6840:00)"
    assert TWO.variable("interpolation_data_record_axis_1:ip_data_position").mux == mux(0x68C1, 1)


def test_an_axis_sees_itself_as_the_first_one_in_mappings_too() -> None:
    seen = axes.dictionary_of_axis(TWO, 1)
    assert seen.variable("controlword").mux == objects.CONTROLWORD
    assert seen.at(0x1640, 1).default == 0x6040_0010
    assert seen.at(0x1600, 1).default == 0x6840_0010
    assert axes.dictionary_of_axis(TWO, 0) is TWO


def test_a_file_with_equal_names_means_the_first_axis() -> None:
    """Many makers name the objects of all axes alike."""
    alike = ObjectDictionary(
        [Object.of("Controlword", [replace(TWO.at(index, 0), name="Controlword", aliases=())]) for index in (0x6840, 0x6040)]
    )
    assert alike.variable("Controlword").index == alike.variable("CONTROLWORD").index == 0x6040


def test_a_dictionary_without_the_axis_is_refused_by_name() -> None:
    remote = RemoteNode(TwoAxes().master.out, 5, drive_dictionary())
    with pytest.raises(LocalProtocolError, match="node 5 has no axis 1 by .*: no 0x6840:00 with a statusword; it has axis 0"):
        Axis(remote, number=1)
    with pytest.raises(LocalProtocolError, match="axes 0 to 7, not 8"):
        Axis(remote, number=8)


def test_the_view_of_a_further_axis_shares_all_values_with_the_node() -> None:
    rig = TwoAxes()
    node = rig.second.node
    assert isinstance(node, FurtherAxis)
    rig.run(write(node, objects.PROFILE_VELOCITY, 4321))
    assert rig.drive.values.store[objects.PROFILE_VELOCITY] == rig.remote.values.store[mux(0x6881)] == 4321
    assert node.values.store[objects.PROFILE_VELOCITY] == 4321
    assert rig.run(read_int(node, objects.PROFILE_VELOCITY)) == 4321
    assert objects.PROFILE_VELOCITY in node.heard_at
    assert mux(0x6881) in rig.remote.heard_at
    assert objects.PROFILE_VELOCITY not in rig.remote.heard_at
    assert {objects.CONTROLWORD, mux(0x6840)} <= rig.remote.commanded
    assert len(node.values.store) == len(list(node.values.store)) == len(rig.remote.values.store)
    assert node.fresh(objects.PROFILE_VELOCITY, rig.bus.now) == 4321


def test_two_axes_home_and_move_at_once_each_on_its_own() -> None:
    rig = TwoAxes()
    rig.run(all_of(drive.home(rig.first), drive.home(rig.second)))
    assert rig.first.is_homed
    assert rig.second.is_homed
    ways = ((rig.first, 8_000.0), (rig.second, -5_000.0))
    rig.run(all_of(*(drive.move_to(axis, target, timeout=20 * SECOND) for axis, target in ways)))
    for axis, target in ways:
        assert rig.run(read_int(axis.node, objects.POSITION_ACTUAL_VALUE)) == pytest.approx(target, abs=5)
        assert axis.state is State.OPERATION_ENABLED
    assert rig.run(read_int(rig.remote, "0x6864")) == pytest.approx(-5_000, abs=5)


@pytest.mark.parametrize(
    "modes",
    [
        (Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION),
        (Mode.INTERPOLATED_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION),
        (Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.INTERPOLATED_POSITION),
    ],
)
def test_two_axes_follow_set_points_at_once_each_in_its_mode(modes: tuple[Mode, Mode]) -> None:
    rig = TwoAxes()
    rig.follow(*modes)
    start = rig.first.set_points.position
    for step in range(1, 101):
        rig.first.set_points.set_position(start + 10 * step)
        rig.second.set_points.set_position(start - 20 * step)
        rig.bus.run(CYCLE)
    rig.bus.run(20 * CYCLE)
    assert rig.first.position == pytest.approx(start + 1_000, abs=5)
    assert rig.second.position == pytest.approx(start - 2_000, abs=5)
    assert (rig.first.mode, rig.second.mode) == modes


def test_a_fault_of_one_axis_leaves_the_other_under_its_command() -> None:
    rig = TwoAxes()
    rig.follow(Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION)
    rig.node.raise_fault(0x3210, rig.bus.now, axis=1)
    start = rig.first.set_points.position
    for step in range(1, 51):
        rig.first.set_points.set_position(start + 10 * step)
        rig.bus.run(CYCLE)
    rig.bus.run(20 * CYCLE)
    assert rig.second.state is State.FAULT
    assert rig.first.state is State.OPERATION_ENABLED
    assert rig.first.position == pytest.approx(start + 500, abs=5)
    (emcy,) = (each for each in rig.bus.events if isinstance(each, EmcyReceived))
    assert (emcy.code, emcy.vendor_data[0]) == (0x3210, 1)
    assert rig.run(read_int(rig.second.node, objects.ERROR_CODE)) == 0x3210
    assert rig.run(read_int(rig.first.node, objects.ERROR_CODE)) == 0
    rig.run(drive.reset_fault(rig.second))
    assert rig.second.state is State.SWITCH_ON_DISABLED
    assert rig.first.state is State.OPERATION_ENABLED


def test_one_emcy_entry_for_each_axis_with_the_same_fault() -> None:
    rig = TwoAxes()
    for axis in (0, 1):
        rig.node.raise_fault(0x3210, rig.bus.now, axis=axis)
    rig.run(drive.reset_fault(rig.first))
    assert rig.node.values.store[Mux(0x100100)] != 0, "the other axis still has it"
    rig.run(drive.reset_fault(rig.second))
    assert rig.node.values.store[Mux(0x100100)] == 0


def test_the_watch_names_the_axis_that_was_lost() -> None:
    rig = TwoAxes()
    rig.follow(Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.CYCLIC_SYNCHRONOUS_POSITION)
    watches = [Following(axis) for axis in (rig.first, rig.second)]
    limit = Limit(1_000.0, "the test")
    for watch in watches:
        watch.begin(limit, Mode.CYCLIC_SYNCHRONOUS_POSITION, cyclic={objects.STATUSWORD: 1, objects.POSITION_ACTUAL_VALUE: 1})
    rig.node.block(True, rig.bus.now, axis=1)
    for _ in range(200):
        for axis in (rig.first, rig.second):
            axis.set_points.set_position(axis.set_points.position + 20)
        rig.bus.run(CYCLE)
    (lost,) = (each for each in rig.bus.events if isinstance(each, FollowingLost))
    assert lost.axis == 1
    assert watches[0].is_on


def test_nmt_stop_reaches_all_axes() -> None:
    rig = TwoAxes()
    store = [each.values.store for each in rig.node.drives]
    for each in store:
        each[objects.ABORT_CONNECTION_OPTION_CODE] = 3
    rig.run(all_of(drive.enable(rig.first), drive.enable(rig.second)))
    rig.nmt.stop(5, rig.bus.now)
    rig.bus.run(SECOND)
    assert all(each.state is not State.OPERATION_ENABLED for each in rig.node.drives)


def test_an_error_of_a_further_axis_names_it_and_its_objects() -> None:
    rig = TwoAxes()
    rig.node.raise_fault(0x3210, rig.bus.now, axis=1, lasting=True)
    with pytest.raises(drive.DriveInFaultError, match=r"drive 5, axis 1 is in fault .*0x3210") as failed:
        rig.run(drive.enable(rig.second))
    assert failed.value.axis == 1
    rig.run(drive.enable(rig.first))


def test_a_command_of_another_master_is_named_at_the_axis_that_it_is_for() -> None:
    rig = TwoAxes()
    rig.run(all_of(drive.enable(rig.first), drive.enable(rig.second)))
    rig.bus.run(MILLISECOND)
    rig.bus.send("605#2B40680006000000")
    rig.bus.run(100 * MILLISECOND)
    rig.run(read_int(rig.second.node, objects.STATUSWORD))
    assert view_of(rig.first).foreign is None
    assert "commanded 0x0006" in str(view_of(rig.second).foreign)


@pytest.mark.thorough(5)
@pytest.mark.parametrize("axis", range(8))
def test_each_axis_of_a_node_with_eight_has_a_plan(axis: int) -> None:
    """The predefined connection set has CAN-IDs for four; the others are slow."""
    plan = plan_motion(drive_dictionary(axes=8), 5, CYCLE, axis=axis)
    assert plan.mode == (Mode.CYCLIC_SYNCHRONOUS_POSITION if axis < 4 else Mode.PROFILE_POSITION)
    assert {pdo.number for pdo in plan.pdos} == ({64 * axis + 1} if axis < 4 else set())
    assert ("axis" in plan.describe()) is bool(axis)


def test_one_rpdo_for_two_axes_is_found_by_what_it_carries() -> None:
    """Some makers put the controlwords of all axes into one PDO; it is nobody's to remap."""
    shared = TWO.with_objects([_mapping((0x6040_0010, 0x607A_0020, 0x6840_0010))])
    first, second = (plan_motion(shared, 5, CYCLE, axis=axis) for axis in (0, 1))
    assert [pdo.number for pdo in first.pdos if pdo.direction == "RPDO"] == [1]
    assert first.written == second.written == ()
    assert first.extras == (mux(0x6840),)
    assert [pdo.number for pdo in second.pdos if pdo.direction == "RPDO"] == [65]


def _mapping(entries: tuple[int, ...]) -> Object:
    record = TWO.objects[0x1600]
    variables = dict(record.variables)
    variables[0] = replace(variables[0], default=len(entries))
    for place, entry in enumerate(entries, start=1):
        variables[place] = replace(variables[place], default=entry)
    return replace(record, variables=variables)


def test_an_eighth_axis_is_a_drive_too() -> None:
    rig = Rig(Shape.STANDARD, drive=DriveSettings(), axis=7)
    rig.run(drive.home(rig.axis))
    rig.run(drive.move_to(rig.axis, 0.1, timeout=20 * SECOND))
    assert rig.axis.position == pytest.approx(0.1, abs=1e-3)
