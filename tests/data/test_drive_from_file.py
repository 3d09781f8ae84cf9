"""The simulated drive behind a dictionary that is none of ours: what it needs, what it fills in, and that it runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from canopen_data.drive_from_file import NEEDED, SHOWN, drive_dictionary_of, drive_obstacle
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary
from canopen_proto.dictionary.standard import find_standard, standard_object, standard_variable
from canopen_proto.drives.cia402 import objects
from canopen_proto.simulation.drive.fallbacks import FALLBACKS, UNSET_BY_ZERO
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.core.device_bench import START, DeviceBench

BASE = [standard_object(index) for index in (0x1000, 0x6040, 0x6041, 0x6060, 0x6061, 0x6064, 0x6081, 0x6065, 0x6502)]


def with_variable(index: int, **changes: Any) -> ObjectDictionary:
    return ObjectDictionary([*BASE, Object.of("changed", [standard_variable(index, **changes)])])


def test_what_it_needs() -> None:
    assert drive_obstacle(ObjectDictionary(BASE)) == ""
    for index, name in ((0x6040, "controlword"), (0x6041, "statusword")):
        without = ObjectDictionary(each for each in BASE if each.index != index)
        assert drive_obstacle(without) == f"it has no {name} (0x{index:04X}:00)"


@pytest.mark.parametrize("data_type", [DataType.UNSIGNED8, DataType.INTEGER16, DataType.VISIBLE_STRING, DataType.REAL32])
def test_types_that_cannot_show_its_state(data_type: DataType) -> None:
    dictionary = with_variable(0x6041, data_type=data_type)
    assert drive_obstacle(dictionary) == f"statusword (0x6041:00) is {data_type.name}; in CiA 402 it is UNSIGNED16"


def test_a_wider_type_does() -> None:
    assert drive_obstacle(with_variable(0x6041, data_type=DataType.UNSIGNED32)) == ""


def test_all_that_it_shows_is_of_the_standard() -> None:
    assert all(find_standard(key >> 8, key & 0xFF) is not None for key in (*SHOWN, *NEEDED, *UNSET_BY_ZERO, *FALLBACKS))


def test_what_the_file_does_not_say_is_filled_in() -> None:
    dictionary, filled = drive_dictionary_of(ObjectDictionary(BASE), Shape.STANDARD)
    assert {variable.mux: variable.default for variable in filled} == {
        0x1000_00: 0x0002_0192,
        objects.SUPPORTED_DRIVE_MODES: 0x3EF,
        objects.PROFILE_VELOCITY: 20_000,
        objects.FOLLOWING_ERROR_WINDOW: 10_000,
    }
    assert dictionary.variable(0x6081).default == 20_000
    again, none = drive_dictionary_of(dictionary, Shape.STANDARD)
    assert again is dictionary
    assert none == []


@pytest.mark.parametrize(
    ("changes", "value"),
    [
        ({"default": 5}, 5),
        ({"default": 0}, 0),
        ({"default": 0, "configured": 7}, 7),
        ({"default": 9, "configured": 0}, 0),
        ({"high_limit": 100}, 100),
        ({"low_limit": 100_000}, 100_000),
        ({"low_limit": 0.5, "high_limit": float("inf")}, 20_000),
        ({"low_limit": 9, "high_limit": 8}, 0),
        ({"data_type": DataType.INTEGER16}, 20_000),
        ({"data_type": DataType.UNSIGNED8}, 255),
        ({"data_type": DataType.VISIBLE_STRING}, ""),
    ],
)
def test_what_the_file_says_counts_and_limits_are_kept(changes: dict[str, Any], value: object) -> None:
    dictionary, _ = drive_dictionary_of(with_variable(0x6081, **changes), Shape.STANDARD)
    assert dictionary.variable(0x6081).initial_of(5) == value


def test_a_zero_that_means_zero_stays() -> None:
    dictionary, filled = drive_dictionary_of(ObjectDictionary([*BASE, standard_object(0x605C, 0)]), Shape.STANDARD)
    assert dictionary.variable(0x605C).default == 0
    assert 0x605C not in {variable.index for variable in filled}


def test_a_drive_shows_the_zeros_of_its_file_and_moves_all_the_same() -> None:
    zeros = [standard_object(index, 0) for index in (0x607A, 0x6081, 0x6083, 0x6084, 0x60C5)]
    dictionary, filled = drive_dictionary_of(ObjectDictionary([*BASE, *zeros]), Shape.STANDARD)
    assert {variable.index for variable in filled} == {0x1000, 0x6065, 0x6502}
    bench = DeviceBench(dictionary, make=lambda out, node_id, described: DriveNode(out, node_id, DriveSettings(), described))
    assert [bench.number(each.index) for each in zeros] == [0] * len(zeros)
    bench.tell(START)
    bench.write(0x6060, 0, 1, 1)
    bench.write(0x607A, 0, 5000, 4)
    for command in (6, 7, 15, 31):
        bench.write(0x6040, 0, command, 2)
    bench.wait(2000)
    assert bench.number(0x6064) == 5000
    assert bench.number(0x6081) == 0


def test_supported_modes_of_zero_are_filled_in() -> None:
    dictionary, filled = drive_dictionary_of(ObjectDictionary([*BASE[:-1], standard_object(0x6502, 0)]), Shape.STANDARD)
    assert 0x6502 in {variable.index for variable in filled}
    assert dictionary.variable(0x6502).default == 0x3EF


def test_the_modes_that_are_filled_in_are_those_whose_commands_the_file_has() -> None:
    dictionary, _ = drive_dictionary_of(
        ObjectDictionary([*BASE, standard_object(0x60FF), standard_object(0x6098)]), Shape.STANDARD
    )
    assert dictionary.variable(0x6502).default == 1 << 3 - 1 | 1 << 6 - 1 | 1 << 9 - 1  # pv, hm, csv


@pytest.mark.parametrize("base", [BASE, BASE[:-1]], ids=["", "without 6502h"])
def test_the_drive_runs_behind_it(base: list[Object]) -> None:
    dictionary, _ = drive_dictionary_of(ObjectDictionary(base), Shape.STANDARD)
    bench = DeviceBench(dictionary, make=lambda out, node_id, described: DriveNode(out, node_id, DriveSettings(), described))
    bench.tell(START)
    for command, state in ((6, 0x21), (7, 0x23), (15, 0x27)):
        assert bench.write(0x6040, 0, command, 2) is None
        assert bench.number(0x6041) & 0x6F == state
    assert bench.write(0x6060, 0, 1, 1) is None
    assert bench.number(0x6061) == 1


def test_the_shape_decides_what_is_filled_in() -> None:
    bare = ObjectDictionary([*BASE[:-1], replace(standard_object(0x6502), name="modes")])
    assert drive_dictionary_of(bare, Shape.SCHUNK_POWERBALL)[0].variable(0x6502).default == 0x43


def test_a_control_word_is_not_stored() -> None:
    stored = [*BASE, standard_object(0x1010, highest=1)]
    bench = DeviceBench(
        ObjectDictionary(stored), make=lambda out, node_id, described: DriveNode(out, node_id, DriveSettings(), described)
    )
    bench.write(0x6040, 0, 6, 2)
    bench.write(0x6081, 0, 5, 4)
    bench.tell("605#2310100173617665")
    kept = bench.node.storage.to_keep(0x1010, 1)
    assert objects.CONTROLWORD not in kept
    assert kept[objects.PROFILE_VELOCITY] == b"\x05\x00\x00\x00"
