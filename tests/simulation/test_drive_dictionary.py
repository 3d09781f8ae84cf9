"""The dictionaries of the simulated drives."""

from __future__ import annotations

import pytest

from canopen_proto.dictionary.model import Object, ObjectDictionary
from canopen_proto.dictionary.standard import standard_variable
from canopen_proto.dictionary.values import Values
from canopen_proto.machine import NEVER
from canopen_proto.multiplexer import mapped
from canopen_proto.simulation.drive.dictionary import ALLOWED_VALUES, drive_dictionary
from canopen_proto.simulation.drive.fallbacks import FALLBACKS
from canopen_proto.simulation.drive.servo import Servo
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.simulation.drive_bench import Bench

SHAPES = list(Shape)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_default_fits_its_object(shape: Shape) -> None:
    dictionary = drive_dictionary(shape)
    values = Values(dictionary, 127)
    for variable in dictionary:
        value = values.store[variable.mux]
        variable.encode(value)
        variable.check_limits(value)
        if variable.mux in ALLOWED_VALUES and variable.access.writable:
            assert value in ALLOWED_VALUES[variable.mux] or variable.index == 0x60C4


@pytest.mark.parametrize("shape", SHAPES)
def test_cob_ids_follow_the_node_id_of_each_device(shape: Shape) -> None:
    dictionary = drive_dictionary(shape)
    for node_id in (3, 12):
        values = Values(dictionary, node_id)
        assert values.read((0x1400, 1)) == 0x200 + node_id
        assert values.read((0x1800, 1)) == 0x4000_0180 + node_id
        assert values.read((0x1803, 1)) in (0x4000_0480 + node_id, 0xC000_0480 + node_id)
        assert values.read(0x1014) == 0x80 + node_id
        assert values.read((0x1200, 2)) == 0x580 + node_id


@pytest.mark.parametrize("shape", SHAPES)
def test_each_pdo_maps_objects_that_it_may_carry(shape: Shape) -> None:
    dictionary = drive_dictionary(shape)
    values = Values(dictionary, 1)
    for index in (*range(0x1600, 0x1604), *range(0x1A00, 0x1A04)):
        bits = 0
        for place in range(1, int(values.read((index, 0))) + 1):  # type: ignore[arg-type]
            entry = values.read((index, place))
            assert isinstance(entry, int)
            *place_of_object, bit_length = mapped(entry)
            variable = dictionary.get(*place_of_object)
            assert variable is not None
            assert variable.pdo_mappable
            assert variable.access.writable is (index < 0x1A00)
            assert variable.bit_length == bit_length
            bits += bit_length
        assert bits <= 64


def test_the_powerball_has_the_manuals_pdos() -> None:
    values = Values(drive_dictionary(Shape.SCHUNK_POWERBALL), 12)
    assert [values.read((0x1600, place)) for place in range(4)] == [3, 0x60400010, 0x60420010, 0x60C10120]
    assert [values.read((0x1A00, place)) for place in range(4)] == [3, 0x60410010, 0x60770010, 0x60640020]
    assert values.read((0x1400, 2)) == values.read((0x1800, 2)) == 1
    assert values.read((0x1401, 1)) == 0x8000_030C


def test_the_powerball_has_what_its_file_has_for_a_lost_master() -> None:
    """Its DCF: three heartbeat consumers, guarding; no abort connection option code, no event time of an RPDO, no SYNC period."""
    dictionary = drive_dictionary(Shape.SCHUNK_POWERBALL)
    assert sorted(dictionary.objects[0x1016].variables) == [0, 1, 2, 3]
    assert {0x100C, 0x100D} <= dictionary.objects.keys()
    assert not {0x1006, 0x6007, 0x6085} & dictionary.objects.keys()
    assert sorted(dictionary.objects[0x1400].variables) == [0, 1, 2]


def test_a_drive_with_nothing_but_the_manuals_objects_works_on_fallbacks() -> None:
    keys = ((0x6040, 0), (0x6041, 0), (0x6060, 0), (0x6061, 0), (0x6064, 0), (0x60C1, 1), (0x6502, 0))
    objects = [Object.of(f"object_{index:04X}", [standard_variable(index, subindex)]) for index, subindex in keys]
    bench = Bench(DriveSettings(position=0), ObjectDictionary(objects))
    bench.preset(0x6502, 0x40)
    bench.enable(7)
    bench.put(0x60C1, 0, 1)
    bench.control(0x1F)
    for target in (*range(0, 1_000, 50), 950, 950):
        bench.put(0x60C1, target, 1)
        bench.sync(8)
    bench.run(200)
    assert bench.position == 950
    assert bench.drive.deadline == NEVER


def test_fallbacks_are_the_defaults_of_the_standard_shape() -> None:
    values = Values(drive_dictionary(), 1)
    servo = Servo(values.store, DriveSettings())
    empty = Servo({}, DriveSettings())
    differ = {key for key in FALLBACKS if servo.parameter(key) != empty.parameter(key)}
    assert {f"{key >> 8:04X}:{key & 0xFF}" for key in differ} == {"605B:0", "60C2:1", "60C4:1"}
