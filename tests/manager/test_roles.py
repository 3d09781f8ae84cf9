"""What the objects of a device are to a backup: settings, process data, fixed, commands."""

from __future__ import annotations

import pytest

from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.roles import Role, carried_in, profile_in, roles_in
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import Shape
from tests.core.devices import LIMITED, OUTPUT, io_device
from tests.core.full_device import OUTPUT_16, full_device
from tests.manager.restore_bench import FACTORY, SECRET, device


def roles(dictionary: ObjectDictionary, values: dict[int, Value] | None = None) -> dict[int, Role]:
    return roles_in(dictionary, values or {})


def test_the_objects_of_an_io_device() -> None:
    found = roles(device())
    expected = {
        0x1000_00: Role.FIXED,
        0x1001_00: Role.PROCESS,
        0x1003_00: Role.PROCESS,
        0x1003_01: Role.PROCESS,
        0x1010_01: Role.COMMAND,
        0x1017_00: Role.COMMUNICATION,
        0x1018_01: Role.FIXED,
        0x1018_00: Role.FIXED,
        0x1400_01: Role.COMMUNICATION,
        0x1800_04: Role.COMMAND,
        0x1A00_01: Role.COMMUNICATION,
        0x2000_00: Role.PROCESS,  # read-only, and a TPDO carries it
        OUTPUT << 8: Role.PROCESS,  # an RPDO carries it
        LIMITED << 8: Role.APPLICATION,  # one may
        SECRET << 8: Role.APPLICATION,
        FACTORY << 8: Role.COMMAND,
    }
    assert {key: found[key] for key in expected} == expected


def test_what_an_rpdo_carries_is_process_data_only_while_it_is_valid() -> None:
    off = {0x1400_01: 0x8000_0205, 0x1401_01: 0x8000_0305}
    assert roles(io_device(), dict(off))[OUTPUT << 8] is Role.APPLICATION
    assert roles(io_device(), {0x1400_01: 0x8000_0205})[OUTPUT << 8] is Role.PROCESS
    assert carried_in({0x1600_00: 2, 0x1600_01: 0x2001_0010, 0x1600_02: "no number"}) == {0x2001_00}
    assert carried_in({0x1600_00: 0xFF, 0x1600_01: 0x2001_0010}) == {0x2001_00}
    assert carried_in({0x1600_01: 0x2001_0010}) == frozenset()


@pytest.mark.parametrize("shape", list(Shape))
def test_the_set_points_of_a_drive(shape: Shape) -> None:
    dictionary = drive_dictionary(shape)
    found = {
        key >> 8
        for key, role in roles(dictionary).items()
        if role is Role.PROCESS and dictionary.variable((key >> 8, key & 0xFF)).access.writable
    }
    assert found & {0x6042, 0x607A, 0x60C1, 0x60FF} == found & set(dictionary.objects) & {0x6042, 0x607A, 0x60C1, 0x60FF} != set()
    settings = {key >> 8 for key, role in roles(dictionary).items() if role is Role.APPLICATION}
    assert {0x6081, 0x6083} & set(dictionary.objects) <= settings
    assert roles(dictionary)[0x6040_00] is Role.COMMAND


def own(*indices: int) -> list[Object]:
    return [Object.of("own", [Variable(index, 0, "own", DataType.INTEGER32, Access.RWW)]) for index in indices]


@pytest.mark.parametrize(
    ("device_type", "expected"),
    [
        (0x0002_0192, {0x607A: Role.PROCESS, 0x6200: Role.APPLICATION, 0x687A: Role.PROCESS}),
        (0x0002_0191, {0x607A: Role.APPLICATION, 0x6200: Role.PROCESS, 0x687A: Role.APPLICATION}),
        (0x0000_0194, {0x607A: Role.APPLICATION, 0x6200: Role.APPLICATION, 0x687A: Role.APPLICATION}),
        (0, {0x607A: Role.PROCESS, 0x6200: Role.PROCESS, 0x687A: Role.PROCESS}),
        (None, {0x607A: Role.PROCESS, 0x6200: Role.PROCESS, 0x687A: Role.PROCESS}),
    ],
)
def test_the_profile_decides_what_an_index_means(device_type: int | None, expected: dict[int, Role]) -> None:
    dictionary = ObjectDictionary(own(*expected))
    found = roles(dictionary, {} if device_type is None else {0x1000_00: device_type})
    assert {key >> 8: role for key, role in found.items()} == expected


def test_the_profile_by_the_dictionary_where_no_value_tells_it() -> None:
    dictionary = full_device()  # CiA 401
    found = roles(dictionary.with_objects(own(0x607A)))
    assert found[0x607A_00] is Role.APPLICATION
    assert found[OUTPUT_16 << 8] is Role.PROCESS
    assert profile_in({0x1000_00: 0x0004_0191}) == 401
    assert profile_in({0x1000_00: "no number"}) is None
