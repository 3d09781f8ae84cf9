"""The PDOs that a device's own file describes: which there are, which serve, and that the device has them in the end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import pytest

from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.drives.cia402.objects import (
    CONTROLWORD,
    INTERPOLATION_SET_POINT,
    MODES_OF_OPERATION,
    POSITION_ACTUAL_VALUE,
    STATUSWORD,
    TARGET_POSITION,
    TORQUE_ACTUAL_VALUE,
    VELOCITY_ACTUAL_VALUE,
)
from canopen_proto.frame import COB_ID_INVALID, COB_ID_NO_RTR
from canopen_proto.machine import SECOND
from canopen_proto.pdo.configure import exchange_pdos
from canopen_proto.pdo.settings import PdoSettings, cyclic_objects
from canopen_proto.pdo.slots import choose_pdos, described_pdos
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import Shape
from canopen_proto.testing import World

STANDARD = drive_dictionary(Shape.STANDARD)
SCHUNK = drive_dictionary(Shape.SCHUNK_POWERBALL)
COMMANDS = (CONTROLWORD, INTERPOLATION_SET_POINT)


def configured(dictionary: ObjectDictionary, values: Mapping[tuple[int, int], int | None]) -> ObjectDictionary:
    """The dictionary of a DCF with these values. None: the sub-object is not there."""
    changed = {}
    for index, _ in values:
        described = dictionary.objects[index]
        variables = dict(described.variables)
        for subindex in list(variables):
            value = values.get((index, subindex), variables[subindex].configured)
            if (index, subindex) in values and value is None:
                del variables[subindex]
            else:
                variables[subindex] = replace(variables[subindex], configured=value)
        changed[index] = replace(described, variables=MappingProxyType(variables))
    return dictionary.with_objects(changed.values())


def names(pdos: list[PdoSettings]) -> list[str]:
    return [f"{pdo.direction}{pdo.number}" for pdo in pdos]


def test_what_a_dictionary_describes() -> None:
    pdos = described_pdos(SCHUNK, 5)
    assert names(pdos) == ["RPDO1", "TPDO1"]
    assert pdos[0] == PdoSettings(1, Direction.RPDO, 0x205, 1, (0x60400010, 0x60420010, 0x60C10120))
    assert (pdos[1].cob_id & 0x7FF, pdos[1].entries) == (0x185, (0x60410010, 0x60770010, 0x60640020))


def test_what_a_dcf_configures_goes_before_the_defaults() -> None:
    dictionary = configured(SCHUNK, {(0x1A00, 0): 2, (0x1A00, 2): 0x606C0020, (0x1800, 2): 255})
    assert described_pdos(dictionary, 5)[1].entries == (0x60410010, 0x606C0020)
    assert described_pdos(dictionary, 5)[1].transmission_type == 255


@pytest.mark.parametrize(
    ("values", "left"),
    [
        ({(0x1A00, 2): 0x77770010}, ["RPDO1"]),  # an object that is not there
        ({(0x1A00, 2): 0x60640040}, ["RPDO1"]),  # more bits than it has
        ({(0x1A00, 0): 3, (0x1A00, 1): 0x60640020, (0x1A00, 2): 0x606C0020}, ["RPDO1"]),  # 96 bits
        ({(0x1A00, 0): 0}, ["RPDO1"]),
        ({(0x1A00, 0): 255}, ["RPDO1"]),  # a multiplexed one has no mapping
        ({(0x1A00, 0): 4}, ["RPDO1"]),  # the fourth entry is empty
        ({(0x1A00, 1): None}, ["RPDO1"]),  # a hole
        ({(0x1800, 1): None}, ["RPDO1"]),
        ({(0x1800, 1): COB_ID_INVALID | 0x185}, ["RPDO1"]),
        ({(0x1800, 2): None}, ["RPDO1", "TPDO1"]),  # a type that is not said
    ],
)
def test_what_cannot_be_is_left_out(values: Mapping[tuple[int, int], int | None], left: list[str]) -> None:
    assert names(described_pdos(configured(SCHUNK, values), 5)) == left


def test_as_few_rpdos_as_carry_the_commands_and_the_tpdos_that_tell_something() -> None:
    pdos = described_pdos(STANDARD, 5)
    assert names(pdos) == [*(f"RPDO{number}" for number in range(1, 5)), *(f"TPDO{number}" for number in range(1, 5))]
    chosen, missing = choose_pdos(pdos, COMMANDS, {VELOCITY_ACTUAL_VALUE})
    assert (names(chosen), missing) == (["TPDO4", "RPDO4"], [])  # 6040 and 60C1:01 are together in RPDO4
    chosen, missing = choose_pdos(pdos, (CONTROLWORD,), ())
    assert (names(chosen), missing) == (["RPDO1"], [])  # the one with nothing else in it


def test_two_rpdos_never_contradict_each_other() -> None:
    pdos = described_pdos(STANDARD, 5)
    chosen, missing = choose_pdos(pdos, (CONTROLWORD, MODES_OF_OPERATION, TARGET_POSITION), ())
    assert (names(chosen), missing) == (["RPDO2"], [TARGET_POSITION])  # RPDO3 would send a controlword of its own
    assert choose_pdos(pdos, (TORQUE_ACTUAL_VALUE,), ()) == ([], [TORQUE_ACTUAL_VALUE])


class Scene:
    """A device and a master's view of it, which may have another dictionary."""

    def __init__(self, device: ObjectDictionary, ours: ObjectDictionary) -> None:
        self.world = World()
        self.device = self.world.device(device, 5)
        self.master = self.world.master()
        self.node = self.master.node(5, ours)

    def exchange(self) -> list[int]:
        """Exchange what our dictionary describes; return the commands that no RPDO carries."""
        described = described_pdos(self.node.dictionary, 5)
        self.pdos, missing = choose_pdos(described, COMMANDS, (STATUSWORD, POSITION_ACTUAL_VALUE))
        trace = self.world.bus().trace
        before = len(trace)
        self.master.run(exchange_pdos(self.node, self.pdos), 5 * SECOND)
        frames = [each.frame for each in trace[before:]]
        self.written = [frame for frame in frames if frame.can_id == 0x605 and frame.data[0] & 0xE0 == 0x20]
        return list(missing)


def test_a_device_that_has_them_is_only_read() -> None:
    scene = Scene(SCHUNK, SCHUNK)
    assert scene.exchange() == []
    assert scene.written == []
    assert (list(scene.node.rpdos), list(scene.node.tpdos)) == ([1], [1])
    assert cyclic_objects(scene.pdos) == dict.fromkeys((STATUSWORD, TORQUE_ACTUAL_VALUE, POSITION_ACTUAL_VALUE), 1)


def test_a_device_that_allows_remote_requests_is_left_as_it_is() -> None:
    ours = configured(SCHUNK, {(0x1800, 1): 0x185})
    assert not described_pdos(ours, 5)[1].cob_id & COB_ID_NO_RTR
    scene = Scene(SCHUNK, ours)
    assert scene.exchange() == []
    assert scene.written == []


def test_a_device_that_has_others_is_set_up() -> None:
    ours = configured(SCHUNK, {(0x1A00, 0): 2, (0x1A00, 2): 0x60640020, (0x1800, 2): 255, (0x1400, 2): 255})
    scene = Scene(SCHUNK, ours)
    assert scene.exchange() == []
    assert scene.written
    values = scene.device.values
    assert [values.store[0x1A0000 | subindex] for subindex in range(3)] == [2, 0x60410010, 0x60640020]
    assert (values.store[0x180002], values.store[0x140002]) == (255, 255)
    assert not cyclic_objects(scene.pdos)
    assert scene.node.rpdos[1].transmission_type == 1  # we send it at each SYNC, whenever the device acts


def test_what_no_pdo_carries_is_said() -> None:
    ours = configured(SCHUNK, {(0x1600, 0): 1})
    assert Scene(SCHUNK, ours).exchange() == [INTERPOLATION_SET_POINT]
