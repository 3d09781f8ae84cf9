"""DBC files of devices, read back by cantools: it decodes a frame to what the device's own mapping decodes it to."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.dbc import ENCODING, DbcFile, dbc_of
from canopen_data.descriptions import load_description
from canopen_data.overlay import lay_over
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.model import Constant
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.pdo.slots import described_pdos
from tests.examples import examples

cantools = pytest.importorskip("cantools", reason="cantools is not installed: the extra `test` has it")

NODE = 5


def read(made: DbcFile) -> Any:
    """Return the file as cantools reads it, in the encoding in which it is written."""
    return cantools.database.load_string(made.text.encode(ENCODING).decode(ENCODING), database_format="dbc")


def number(index: int, subindex: int, value: int, bits: int = 32) -> Variable:
    return Variable(index, subindex, f"sub{subindex}", DataType[f"UNSIGNED{bits}"], default=value)


def device(entries: list[int], *objects: Object, cob_id: int = 0x185, kind: int = 255, timer: int = 0) -> ObjectDictionary:
    """A device with TPDO 1 of these entries, and these objects."""
    settings = [number(0x1800, 0, 5, 8), number(0x1800, 1, cob_id), number(0x1800, 2, kind, 8), number(0x1800, 5, timer, 16)]
    mapping = [number(0x1A00, 0, len(entries), 8), *(number(0x1A00, place, each) for place, each in enumerate(entries, 1))]
    return ObjectDictionary([Object.of("tpdo", settings), Object.of("mapping", mapping), *objects], source="a test")


def one(index: int, name: str, kind: DataType, **more: Any) -> Object:
    return Object.of(name, [Variable(index, 0, name, kind, Access.RO, pdo_mappable=True, **more)])


def test_each_pdo_of_a_drive_decodes_as_its_mapping_does() -> None:
    dictionary = load_description("sample_drive.eds").dictionary
    read_back = read(dbc_of(dictionary, NODE))
    pdos = described_pdos(dictionary, NODE)
    assert pdos
    for pdo in pdos:
        message = read_back.get_message_by_frame_id(pdo.cob_id & 0x1FFFFFFF)
        mapping = Mapping.from_parameters(pdo.entries, dictionary)
        data = bytes(0x81 + 13 * place & 0xFF for place in range(mapping.byte_length))
        assert list(message.decode(data, decode_choices=False, scaling=False).values()) == list(mapping.unpack(data))
        assert message.comment == f"{pdo.name} of node {NODE}, transmission type {pdo.transmission_type}"
    assert read_back.get_message_by_name("heartbeat_5").decode(b"\x05") == {"state": "operational"}
    assert read_back.get_message_by_frame_id(0x85).decode(bytes.fromhex("2032050102030405"))["error_code"] == 0x3220


TYPES = [
    *(DataType[f"{sign}{bits}"] for sign in ("INTEGER", "UNSIGNED") for bits in (8, 16, 24, 32, 40, 48, 56, 64)),
    DataType.BOOLEAN,
    DataType.REAL32,
    DataType.REAL64,
]


@given(st.lists(st.sampled_from(TYPES), min_size=1, max_size=12), st.randoms(use_true_random=False))
@examples(100)
def test_any_mapping_decodes_to_the_same_values(types: list[DataType], chance: Any) -> None:
    entries, objects, bits = [], [], 0
    for place, kind in enumerate(types):
        each = one(0x2000 + place, f"value {place}", kind)
        width = each.variables[0].bit_length or 1
        if bits + width > 64:
            continue
        bits += width
        objects.append(each)
        entries.append((0x2000 + place) << 16 | width)
    dictionary = device(entries, *objects)
    message = read(dbc_of(dictionary, NODE)).get_message_by_frame_id(0x185)
    mapping = Mapping.from_parameters(entries, dictionary)
    data = bytes(chance.randrange(256) for _ in range(mapping.byte_length))
    decoded = list(message.decode(data, decode_choices=False, scaling=False).values())
    assert [repr(float(each)) for each in decoded] == [repr(float(each)) for each in mapping.unpack(data)]


def test_units_factors_limits_and_times_are_those_of_the_objects() -> None:
    speed = one(0x2000, "speed", DataType.INTEGER16, low_limit=-100, high_limit=300)
    dictionary, _ = lay_over(device([0x20000010], speed, timer=50), '[objects.2000]\nunit = "°/s"\nfactor = 0.1\n', "units.toml")
    message = read(dbc_of(dictionary, NODE, "axis 5")).get_message_by_frame_id(0x185)
    (signal,) = message.signals
    assert (signal.unit, signal.scale, signal.minimum, signal.maximum) == ("°/s", 0.1, -10.0, 30.0)
    assert message.decode((-50).to_bytes(2, "little", signed=True)) == {"speed": pytest.approx(-5.0)}
    assert (message.cycle_time, message.senders) == (50, ["axis_5"])


def test_named_values_are_values_and_named_bits_are_told() -> None:
    mode, word = one(0x2000, "mode", DataType.INTEGER8), one(0x2001, "word", DataType.UNSIGNED16)
    plain = device([0x20000008, 0x20010010], mode, word)
    names = {0x2000_00: (Constant("back", 0xFF, 0xFF), Constant("off", 0xFF, 0)), 0x2001_00: (Constant("fault", 8, 8),)}
    made = dbc_of(ObjectDictionary(plain.objects.values(), constants=names), NODE)
    message = read(made).get_message_by_frame_id(0x185)
    assert message.decode(b"\xff\x08\x00") == {"mode": "back", "word": 8}
    assert "fault (0x8)" in (message.get_signal_by_name("word").comment or "")
    assert any("named bits" in each.reason for each in made.left_out)


@pytest.mark.parametrize(
    ("dictionary", "reason"),
    [
        (device([0x20000008], one(0x2000, "a", DataType.UNSIGNED8), cob_id=0x80000185), "not valid"),
        (device([], one(0x2000, "a", DataType.UNSIGNED8)), "empty"),
        (device([0x20000040], one(0x2000, "a", DataType.VISIBLE_STRING)), "VISIBLE_STRING"),
    ],
)
def test_what_a_dbc_cannot_say_is_told(dictionary: ObjectDictionary, reason: str) -> None:
    made = dbc_of(dictionary, NODE)
    assert any(reason in each.reason for each in made.left_out), made.left_out
    assert any("SDO" in each.what for each in made.left_out)
    read(made)


def test_odd_names_are_made_fit_and_long_ones_are_kept_beside() -> None:
    long = "a name that is much longer than what a DBC takes, you see"
    objects = [one(0x2000 + place, name, DataType.UNSIGNED8) for place, name in enumerate([long, long + "!", '4"\\x', "BO_"])]
    message = read(dbc_of(device([0x20000008 | place << 16 for place in range(4)], *objects), NODE, '"; BU_')).messages[0]
    names = [signal.name for signal in message.signals]
    assert len(set(names)) == 4
    assert names[0].startswith("a_name_that_is_much_longer")
    assert names[2:] == ["_4__x", "_BO_"]


def test_a_cob_id_of_29_bits_is_extended() -> None:
    made = dbc_of(device([0x20000008], one(0x2000, "a", DataType.UNSIGNED8), cob_id=0x20012345), NODE)
    assert [(each.frame_id, each.is_extended_frame) for each in read(made).messages] == [(0x12345, True)]
