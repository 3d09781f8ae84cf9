"""How a drive follows set-points by its dictionary alone: the mode, its PDOs, what goes by SDO, or why it cannot."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto import indices
from canopen_proto.dictionary import Access, Direction, ObjectDictionary
from canopen_proto.dictionary.values import Values
from canopen_proto.drives.axis.motion_plan import FEEDBACK, MODES, MotionPlan, NoMotionPlanError, exchange_planned, plan_motion
from canopen_proto.drives.axis.set_points import SET_POINT_OF
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.frame import COB_ID_INVALID, Frame
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.multiplexer import mux
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.pdo.rules import PdoWriteRules
from canopen_proto.pdo.settings import PdoSettings, muxes_of
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import Shape
from canopen_proto.testing import World
from tests.drives.drive_dictionaries import (
    NOTHING_MAPPABLE,
    TELLS,
    Changes,
    changed,
    empty_pdos,
    fixed,
    supports,
    unmappable,
    without_pdos,
)

NODE = 5
CYCLE = 10 * MILLISECOND
CONTROLWORD, SET_POINT, TARGET = 0x6040_0010, 0x60C1_0120, 0x607A_0020
STATUSWORD, POSITION, DISPLAY, VELOCITY = 0x6041_0010, 0x6064_0020, 0x6061_0008, 0x606C_0020
LISTED = {Mode.PROFILE_POSITION: 0x01, Mode.INTERPOLATED_POSITION: 0x41, Mode.CYCLIC_SYNCHRONOUS_POSITION: 0xC1}


def plan(dictionary: ObjectDictionary, **options: Any) -> MotionPlan:
    made = plan_motion(dictionary, NODE, CYCLE, **options)
    assert_writable(made)
    return made


def assert_writable(made: MotionPlan) -> None:
    """Each write of a plan is one that a device with this dictionary takes, by the rules of CiA 301."""
    values = Values(made.dictionary, made.node_id)
    rules = PdoWriteRules(values, ())
    for index, subindex, data in made.steps:
        variable = made.dictionary.at(index, subindex)
        assert variable.access.writable, variable
        value = variable.decode(data)
        assert rules.check_write(index, subindex, value) is None, (variable, data)
        values.store[variable.mux] = value


def pdos(made: MotionPlan) -> dict[str, tuple[int, ...]]:
    return {f"{pdo.direction}{pdo.number}": pdo.entries for pdo in made.pdos}


# ---- the mode ----


def test_the_best_mode_that_the_drive_has() -> None:
    for mode, modes in LISTED.items():
        made = plan(changed(supports(modes)))
        assert made.mode is mode
        assert [each.mode for each in made.rejected] == [each for each in MODES if each > mode]


def test_what_the_drive_shows_goes_before_the_file() -> None:
    made = plan(changed(supports(0xC1)), modes=0x41)
    assert made.mode is Mode.INTERPOLATED_POSITION
    assert made.rejected[0].reason == "0x6502 of the drive lists pp, ip"
    assert "0x6502 of the drive lists pp, ip" in made.reason


def test_without_0x6502_profile_position_is_assumed_and_others_may_be_wished() -> None:
    dictionary = changed({}, without=[0x6502])
    assert plan(dictionary).mode is Mode.PROFILE_POSITION
    assert "0x6502" in plan(dictionary).reason
    assert plan(dictionary, wish=Mode.CYCLIC_SYNCHRONOUS_POSITION).mode is Mode.CYCLIC_SYNCHRONOUS_POSITION
    assert plan(dictionary, modes=0xC1).mode is Mode.CYCLIC_SYNCHRONOUS_POSITION


@pytest.mark.parametrize(
    ("changes", "without", "reason"),
    [
        ({objects.MODES_OF_OPERATION: {"low_limit": -1, "high_limit": 7}}, (), "takes -1 to 7, not 8"),
        ({}, (indices.COB_ID_SYNC,), "no 0x1005"),
        ({objects.INTERPOLATION_TIME_UNITS: {"high_limit": 1}}, (), "0x60C2 cannot be set to a cycle of 10 ms"),
        ({objects.INTERPOLATION_TIME_INDEX: {"access": Access.CONST}}, (), "0x60C2 cannot be set to a cycle of 10 ms"),
        ({objects.TARGET_POSITION: {"access": Access.RO}}, (), "it takes no set-points"),
    ],
)
def test_why_not_cyclic_synchronous_position(changes: Changes, without: Collection[int], reason: str) -> None:
    dictionary = changed(supports(0x80) | dict(changes), without=without)
    with pytest.raises(NoMotionPlanError) as refused:
        plan(dictionary)
    assert reason in refused.value.obstacles[0].reason
    assert [each.mode for each in refused.value.obstacles] == list(MODES)
    assert all(text in str(refused.value) for text in ("test.eds", "csp: ", "ip: ", "pp: "))


def test_limits_that_exclude_each_other_are_none() -> None:
    made = plan(changed({objects.MODES_OF_OPERATION: {"low_limit": 0, "high_limit": -1}}))
    assert made.mode is Mode.CYCLIC_SYNCHRONOUS_POSITION


def test_an_interpolation_that_only_its_maker_knows() -> None:
    changes = {objects.INTERPOLATION_SUB_MODE_SELECT: {"low_limit": -1, "high_limit": -1}} | supports(0x41)
    made = plan(changed(changes))
    assert made.mode is Mode.PROFILE_POSITION
    assert "only the maker's own interpolation" in made.rejected[1].reason


def test_a_wish_for_a_mode_without_positions() -> None:
    with pytest.raises(NoMotionPlanError, match="it takes no positions"):
        plan(changed({}), wish=Mode.HOMING)


# ---- its PDOs ----


def test_pdos_that_carry_what_is_needed_stay_as_they_are() -> None:
    made = plan(changed(supports(0x41) | TELLS))
    assert pdos(made)["RPDO4"] == (CONTROLWORD, SET_POINT)
    assert made.steps == []
    assert made.written == ()
    assert "RPDO 4: on 0x505, at each SYNC, as in the file: controlword (0x6040:00), " in made.describe()


def test_an_rpdo_of_another_type_becomes_synchronous_and_keeps_its_objects() -> None:
    made = plan(changed(supports(0x41) | {0x1403_02: {"default": 255}} | TELLS))
    assert [(pdo.number, pdo.transmission_type, pdo.entries) for pdo in made.written] == [(4, 1, (CONTROLWORD, SET_POINT))]


def test_an_event_driven_rpdo_that_cannot_be_changed_is_sent_at_each_sync() -> None:
    made = plan(changed(supports(0x41) | {0x1403_02: {"default": 255, "access": Access.RO}} | fixed(0x1400) | TELLS))
    assert made.mode is Mode.INTERPOLATED_POSITION
    assert [pdo.number for pdo in made.pdos if pdo.direction is Direction.RPDO] == [4]
    assert made.steps == []


def test_a_mapping_to_be_written() -> None:
    made = plan(changed(empty_pdos()))
    assert pdos(made) == {"RPDO1": (CONTROLWORD, TARGET), "TPDO1": (STATUSWORD, POSITION, DISPLAY)}
    assert {pdo.transmission_type for pdo in made.pdos} == {1}
    assert [pdo.cob_id & 0x7FF for pdo in made.pdos] == [0x205, 0x185]
    assert made.commands_by_sdo == (objects.MODES_OF_OPERATION,)
    assert made.watched_by_sdo == ()
    assert "as in the file" not in made.describe()
    first, *_, last = made.steps
    assert first == (0x1400, 1, (COB_ID_INVALID | 0x205).to_bytes(4, "little"))  # the device's own CAN-ID, destroyed
    assert last[:2] == (0x1800, 1)


def test_no_more_than_eight_bytes_and_what_matters_most_first() -> None:
    made = plan(changed(empty_pdos() | unmappable(objects.MODES_OF_OPERATION_DISPLAY)))
    assert pdos(made)["TPDO1"] == (STATUSWORD, POSITION, 0x603F_0010)
    assert made.watched_by_sdo == (objects.MODES_OF_OPERATION_DISPLAY,)


def test_the_only_rpdo_is_given_another_mapping() -> None:
    left = without_pdos(except_rpdos=[1], except_tpdos=[1])
    made = plan(changed({mux(0x1600, 0): {"default": 1}}, without=left))
    assert pdos(made)["RPDO1"] == (CONTROLWORD, TARGET)


def test_too_few_places_in_a_mapping() -> None:
    only_one = {mux(0x1600 + number, 2): {"access": Access.RO} for number in range(4)}
    with pytest.raises(NoMotionPlanError) as refused:
        plan(changed(empty_pdos() | only_one | supports(0x80)))
    assert "RPDO 4 has room for 1 object" in refused.value.obstacles[0].reason


def test_a_fixed_mapping_without_the_set_point() -> None:
    made = plan(changed(supports(0xC1) | fixed(0x1400) | {mux(0x1602): {"default": 1, "access": Access.RO}}))
    assert made.mode is Mode.INTERPOLATED_POSITION  # RPDO 4 carries it
    assert "RPDO 3 has a fixed mapping" in made.rejected[0].reason


def test_what_no_rpdo_may_carry() -> None:
    made = plan(changed(empty_pdos() | unmappable(objects.TARGET_POSITION)))
    assert made.mode is Mode.INTERPOLATED_POSITION
    assert "(PDOMapping)" in made.rejected[0].reason
    # in profile position the target goes by SDO instead
    slow = plan(changed(empty_pdos() | unmappable(objects.TARGET_POSITION)), wish=Mode.PROFILE_POSITION)
    assert pdos(slow)["RPDO1"] == (CONTROLWORD,)
    assert slow.commands_by_sdo == (objects.TARGET_POSITION, objects.MODES_OF_OPERATION)


def test_a_set_point_by_pdo_and_a_controlword_by_sdo() -> None:
    made = plan(changed(empty_pdos() | unmappable(objects.CONTROLWORD)))
    assert pdos(made)["RPDO1"] == (TARGET,)
    assert made.commands_by_sdo == (objects.CONTROLWORD, objects.MODES_OF_OPERATION)


@pytest.mark.parametrize("without", [(), without_pdos()])
def test_a_drive_without_any_pdo_moves_slowly_by_sdo(without: Collection[int]) -> None:
    changes = NOTHING_MAPPABLE if without else NOTHING_MAPPABLE | empty_pdos()
    made = plan(changed(changes, without=without))
    assert made.mode is Mode.PROFILE_POSITION
    assert made.is_slow
    assert made.pdos == ()
    assert made.commands_by_sdo == (objects.CONTROLWORD, objects.TARGET_POSITION, objects.MODES_OF_OPERATION)
    assert made.watched_by_sdo == (objects.STATUSWORD, objects.POSITION_ACTUAL_VALUE, objects.MODES_OF_OPERATION_DISPLAY)


def test_an_rpdo_that_nothing_else_needs_goes_before_one_in_use() -> None:
    free = {mux(0x1602): {"default": 0}, mux(0x1402, 1): {"default": COB_ID_INVALID | 0x400}}
    made = plan(changed(supports(0x80) | free | TELLS))
    assert [pdo.number for pdo in made.written] == [1]  # it carries only the controlword, which stays in it
    made = plan(changed(supports(0x80) | free | {mux(0x1600, 1): {"default": VELOCITY}} | TELLS))
    assert [pdo.number for pdo in made.written] == [3]
    assert made.written[0].cob_id == 0x405


def test_slow_set_points_by_an_event_driven_rpdo() -> None:
    made = plan(changed(supports(0x01) | empty_pdos() | {mux(0x1400, 2): {"default": 254}}))
    assert [(pdo.number, pdo.transmission_type) for pdo in made.pdos] == [(1, 254), (1, 1)]
    assert "event-driven" in made.describe()


def test_a_dictionary_without_sync_has_event_driven_pdos() -> None:
    made = plan(changed(supports(0xC1) | empty_pdos(), without=[indices.COB_ID_SYNC]))
    assert {pdo.transmission_type for pdo in made.pdos} == {255}
    assert made.cyclic == {}
    assert set(made.watched_by_sdo) >= {objects.STATUSWORD, objects.POSITION_ACTUAL_VALUE}


def test_the_can_ids_of_another_node() -> None:
    """A file that was exported from node 32: its PDOs would collide with those of each drive that has the same file."""
    changes = {
        mux(first + number, 1): {"default": base + 0x100 * number + 32, "adds_node_id": False}
        for first, base in ((0x1400, 0x200), (0x1800, 0x180))
        for number in range(4)
    }
    made = plan(changed(changes))
    assert [pdo.cob_id & 0x7FF for pdo in made.pdos] == [0x405, 0x285]
    assert [(str(pdo.direction), pdo.number) for pdo in made.destroyed] == [
        *(("RPDO", number) for number in (1, 2, 4)),
        *(("TPDO", number) for number in (1, 3, 4)),
    ]
    assert all(pdo.cob_id & COB_ID_INVALID for pdo in made.destroyed)
    stuck = plan(changed(changes | {mux(0x1803, 1): {**changes[mux(0x1803, 1)], "access": Access.RO}}))
    assert any("TPDO 4 has CAN-ID 0x4A0 of another node" in note for note in stuck.notes)


def test_two_pdos_with_one_can_id_are_not_used() -> None:
    doubled = {mux(0x1402, 1): {"default": 0x500, "adds_node_id": True}}  # that of RPDO 4
    made = plan(changed(doubled))
    assert [(pdo.number, pdo.cob_id) for pdo in made.pdos if pdo.direction is Direction.RPDO] == [(1, 0x205)]
    with pytest.raises(NoMotionPlanError, match="RPDO 3 cannot have CAN-ID 0x505: another one has it"):
        plan(changed(supports(0x80) | doubled, without=without_pdos(except_rpdos=[3, 4])))


def test_objects_that_an_rpdo_carries_besides() -> None:
    made = plan(drive_dictionary(Shape.SCHUNK_POWERBALL))
    assert made.extras == (objects.VL_TARGET_VELOCITY,)
    assert "0x6042" in made.describe()


def test_dummy_entries_stay() -> None:
    with_dummy = {mux(0x1603): {"default": 3}, mux(0x1603, 2): {"default": 0x0006_0010}, mux(0x1603, 3): {"default": SET_POINT}}
    made = plan(changed(supports(0x41) | with_dummy | TELLS))
    assert pdos(made)["RPDO4"] == (CONTROLWORD, 0x0006_0010, SET_POINT)
    assert "16 bits empty" in made.describe()


# ---- any file ----

ENTRIES = (CONTROLWORD, SET_POINT, TARGET, STATUSWORD, POSITION, DISPLAY, VELOCITY, 0, 0x0006_0010, 0x7777_0020, 0x6040_0040)
RIGHTS = st.sampled_from((Access.RW, Access.RW, Access.RO, Access.CONST))
CAN_IDS = st.sampled_from((0x205, 0x305, 0x405, 0x185, 0x285, 0x220, 0x1A0, 0x000, 0x605, 0x6B0, 0x2000_1234)) | st.integers(
    0, 0x7FF
)


@st.composite
def files(draw: st.DrawFn) -> ObjectDictionary:
    """A drive's dictionary with PDO records, rights and limits as no maker should write them."""
    changes: dict[int, dict[str, Any]] = {}
    for first in (0x1400, 0x1800):
        for index in range(first, first + draw(st.integers(0, 4))):
            cob_id = draw(CAN_IDS) | draw(st.sampled_from((0, COB_ID_INVALID, 1 << 30)))
            changes[mux(index, 1)] = {"default": cob_id, "adds_node_id": False, "access": draw(RIGHTS)}
            changes[mux(index, 2)] = {"default": draw(st.sampled_from((0, 1, 2, 240, 245, 254, 255))), "access": draw(RIGHTS)}
            changes[mux(index + 0x200)] = {"default": draw(st.integers(0, 9)), "access": draw(RIGHTS)}
            for place in range(1, 4):
                changes[mux(index + 0x200, place)] = {"default": draw(st.sampled_from(ENTRIES)), "access": draw(RIGHTS)}
    for key in (*SET_POINT_OF.values(), objects.CONTROLWORD, *FEEDBACK):
        changes[key] = {"pdo_mappable": draw(st.booleans())}
    changes[objects.MODES_OF_OPERATION] = {"high_limit": draw(st.sampled_from((None, 6, 10)))}
    changes[objects.SUPPORTED_DRIVE_MODES] = {"default": draw(st.sampled_from((None, 0, 0x01, 0x41, 0xC1, 0x80, 0x24)))}
    return changed(changes, without=draw(st.sampled_from(((), (indices.COB_ID_SYNC,)))))


@given(files(), st.sampled_from((None, *MODES)))
def test_any_file_has_a_plan_that_can_be_written_or_a_reason(dictionary: ObjectDictionary, wish: Mode | None) -> None:
    try:
        made = plan(dictionary, wish=wish)
    except NoMotionPlanError as refused:
        assert all(each.reason for each in refused.obstacles)
        return
    places = [(pdo.direction, pdo.number) for pdo in (*made.pdos, *made.destroyed)]
    assert len(set(places)) == len(places)
    can_ids = [pdo.cob_id & 0x1FFF_FFFF for pdo in made.pdos]
    assert len(set(can_ids)) == len(can_ids)
    for pdo in made.pdos:
        assert Mapping.from_parameters(pdo.entries, dictionary).bit_length <= 64
        assert not pdo.cob_id & COB_ID_INVALID
    rpdos = [key for pdo in made.pdos if pdo.direction is Direction.RPDO for key in muxes_of(pdo.entries)]
    assert made.is_slow or made.set_point in rpdos
    assert made.describe()


# ---- a bus without room ----


def test_a_lean_plan_leaves_out_what_nobody_needs() -> None:
    """The simulated drive has event-driven statusword and position, and velocity at each SYNC."""
    full, lean = (plan(drive_dictionary(), lean=lean) for lean in (False, True))
    assert [name for name in pdos(full) if name.startswith("TPDO")] == ["TPDO2", "TPDO1", "TPDO3", "TPDO4"]
    assert pdos(lean)["TPDO2"] == (STATUSWORD, POSITION, DISPLAY)
    assert [name for name in pdos(lean) if name.startswith("TPDO")] == ["TPDO2"]
    assert [(pdo.number, bool(pdo.cob_id & COB_ID_INVALID)) for pdo in lean.spare] == [(1, True), (3, True), (4, True)]
    assert (full.mode, full.watched_by_sdo, full.spare) == (lean.mode, lean.watched_by_sdo, ())
    assert_writable(lean)


def test_a_lean_plan_keeps_what_nobody_else_tells_and_what_cannot_be_switched_off() -> None:
    inputs = changed({mux(0x1A00, 0): {"default": 2}, mux(0x1A00, 2): {"default": 0x60FD_0020}})
    assert [pdo.number for pdo in plan(inputs, lean=True).spare] == [3, 4]
    fixed = changed({mux(0x1803, 1): {"access": Access.RO}})
    assert [pdo.number for pdo in plan(fixed, lean=True).spare] == [1, 3]


def test_a_lean_plan_is_written_once_and_a_full_one_takes_it_back() -> None:
    full, lean = (plan(drive_dictionary(), lean=lean) for lean in (False, True))
    scene = Scene(drive_dictionary(), lean)
    assert [bool(scene.settings(Direction.TPDO, number).cob_id & COB_ID_INVALID) for number in (1, 2, 3, 4)] == [1, 0, 1, 1]
    assert scene.exchange(lean) == []
    scene.exchange(full)
    assert not any(scene.settings(Direction.TPDO, number).cob_id & COB_ID_INVALID for number in (1, 2, 3, 4))


def test_a_drive_that_keeps_a_spare_tpdo_is_used_all_the_same() -> None:
    lean = plan(drive_dictionary(), lean=True)
    scene = Scene(changed({mux(0x1800, 1): {"access": Access.RO}}), lean)  # its file says otherwise
    assert not scene.settings(Direction.TPDO, 1).cob_id & COB_ID_INVALID
    assert scene.settings(Direction.TPDO, 4).cob_id & COB_ID_INVALID


# ---- the drive gets them ----


class Scene:
    """A device and its master, which has read another file."""

    def __init__(self, device: ObjectDictionary, made: MotionPlan) -> None:
        self.world = World()
        self.device = self.world.device(device, NODE)
        self.master = self.world.master()
        self.node = self.master.node(NODE, made.dictionary)
        self.written = self.exchange(made)

    def exchange(self, made: MotionPlan) -> list[Frame]:
        """Returns the requests that write."""
        trace = self.world.bus().trace
        before = len(trace)
        self.master.run(exchange_planned(self.node, made), 5 * SECOND)
        frames = [each.frame for each in trace[before:]]
        return [frame for frame in frames if frame.can_id == 0x605 and frame.data[0] & 0xE0 == 0x20]

    def settings(self, direction: Direction, number: int) -> PdoSettings:
        store = self.device.values.store
        first = (0x1400 if direction is Direction.RPDO else 0x1800) + number - 1
        count = store[mux(first + 0x200)]
        assert isinstance(count, int)
        found: list[int] = []
        for key in (mux(first, 1), mux(first, 2), *(mux(first + 0x200, each + 1) for each in range(count))):
            value = store[key]
            assert isinstance(value, int)
            found.append(value)
        return PdoSettings(number, direction, found[0], found[1], tuple(found[2:]))


def test_the_device_gets_the_plan_and_is_only_read_the_second_time() -> None:
    made = plan(changed(empty_pdos()))
    scene = Scene(made.dictionary, made)
    assert [scene.settings(pdo.direction, pdo.number) for pdo in made.pdos] == list(made.pdos)
    assert len(scene.written) == len(made.steps)
    has_it = changed(supports(0x41) | TELLS)
    assert Scene(has_it, plan(has_it)).written == []


def test_a_device_with_can_ids_of_its_own_keeps_them() -> None:
    foreign = {mux(0x1801, 1): {"default": 0x2A0, "adds_node_id": False}}
    made = plan(changed(foreign | supports(0x41) | TELLS))
    assert len(made.destroyed) == 1
    scene = Scene(made.dictionary, made)
    assert scene.settings(Direction.TPDO, 2).cob_id == COB_ID_INVALID | 0x2A0
    scene = Scene(changed(supports(0x41) | TELLS), made)
    assert not scene.settings(Direction.TPDO, 2).cob_id & COB_ID_INVALID
    assert scene.written == []


def test_what_an_rpdo_carries_besides_is_sent_back() -> None:
    made = plan(drive_dictionary(Shape.SCHUNK_POWERBALL))
    device = changed({objects.VL_TARGET_VELOCITY: {"default": 77}}, base=drive_dictionary(Shape.SCHUNK_POWERBALL))
    assert Scene(device, made).node.values.store[objects.VL_TARGET_VELOCITY] == 77
