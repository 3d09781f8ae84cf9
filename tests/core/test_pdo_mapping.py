"""Mapping: bits to values and back, by literal cases, by what peers get wrong, and against a bit-by-bit reference model."""

from __future__ import annotations

import datetime
import math
import struct
from dataclasses import replace
from itertools import product

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from canopen_proto.datatypes import DataType, Value, ValueRangeError, bit_length_of, is_integer, is_signed
from canopen_proto.dictionary import Access, Direction, Filler, Object, ObjectDictionary, PdoDescription, Values, Variable
from canopen_proto.machine import LocalProtocolError
from canopen_proto.pdo.mapping import _MOST_KNOWN, MappedEntry, Mapping, MappingError, _known, may_have_width
from canopen_testing.strategies import pdo_mappings

U8, U16, U32, U64 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32, DataType.UNSIGNED64
I8, I16, I24, I32 = DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER24, DataType.INTEGER32
BOOLEAN, REAL32, REAL64 = DataType.BOOLEAN, DataType.REAL32, DataType.REAL64
TEXT, OCTETS, UNICODE = DataType.VISIBLE_STRING, DataType.OCTET_STRING, DataType.UNICODE_STRING

STATUS_WORD = Variable(0x6041, 0, "statusword", U16, Access.RO, pdo_mappable=True, aliases=("status",))
TORQUE = Variable(0x6077, 0, "torque_actual_value", I16, Access.RO, pdo_mappable=True)
POSITION = Variable(0x6064, 0, "position_actual_value", I32, Access.RO, pdo_mappable=True)


def entry(index: int, subindex: int, bits: int, data_type: DataType, *names: str) -> MappedEntry:
    return MappedEntry(index, subindex, bits, data_type, *names)


def mapping(*fields: tuple[DataType, int]) -> Mapping:
    """Entries 0x2000:00, 0x2001:00 ... of these types and widths."""
    return Mapping(entry(0x2000 + n, 0, bits, data_type, f"v{n}") for n, (data_type, bits) in enumerate(fields))


def hex_of(text: str) -> bytes:
    return bytes.fromhex(text)


# ---- literal cases


def test_the_drives_default_tpdo() -> None:
    # 1A00 of the manual's drive: 60410010 60770010 60640020
    tpdo = Mapping(MappedEntry.of(each) for each in (STATUS_WORD, TORQUE, POSITION))
    data = hex_of("3712 FEFF 10270000")
    assert tpdo.parameters == (0x60410010, 0x60770010, 0x60640020)
    assert tpdo.unpack(data) == (0x1237, -2, 10000)
    assert tpdo.pack((0x1237, -2, 10000)) == data
    assert tpdo.labels == ("statusword", "torque_actual_value", "position_actual_value")
    assert [tpdo.position_of(key) for key in ("status", "6077", "0x6064:00")] == [0, 1, 2]
    store: dict[int, Value] = {}
    assert tpdo.unpack_into(store, data) == (0x1237, -2, 10000)
    assert store == {0x604100: 0x1237, 0x607700: -2, 0x606400: 10000}
    assert tpdo.pack_from(store) == data


def test_the_manuals_rpdo_with_its_filler() -> None:
    control_word = Variable(0x6040, 0, "controlword", U16)
    ip_data = Variable(0x60C1, 1, "interpolation_data_record:ip_data_position", I32)
    entries = (control_word, Filler("notused16", 16), ip_data)
    rpdo = Mapping.from_description(PdoDescription("schunk_default_rPDO", 0x200, Direction.RPDO, 1, entries))
    assert rpdo.parameters == (0x60400010, 0x00060010, 0x60C10120)
    assert rpdo.pack((0x1F, -1000)) == hex_of("1F00 0000 18FCFFFF")
    assert rpdo.unpack(hex_of("1F00 FFFF 18FCFFFF")) == (0x1F, -1000)  # what stands in the filler is nobody's business
    assert [each.name for each in rpdo.components] == ["controlword", "interpolation_data_record:ip_data_position"]
    assert [each.is_dummy for each in rpdo.entries] == [False, True, False]


def test_fields_that_cross_bytes() -> None:
    # a byte at bit 4: peers fail where a field leaves the window of its own type
    pdo = mapping((U8, 4), (U8, 8), (U8, 4))
    assert pdo.unpack(hex_of("A55A")) == (5, 0xAA, 5)
    assert pdo.pack((5, 0xAA, 5)) == hex_of("A55A")
    pdo = mapping((U16, 12), (U16, 12))
    assert pdo.unpack(hex_of("BC3A12")) == (0xABC, 0x123)
    assert pdo.byte_length == 3


def test_a_signed_field_narrower_than_its_type() -> None:
    pdo = mapping((I8, 4), (I8, 4))
    assert pdo.unpack(hex_of("78")) == (-8, 7)
    assert pdo.pack((-8, 7)) == hex_of("78")
    assert mapping((I32, 16)).unpack(hex_of("0080")) == (-32768,)


def test_a_number_gives_and_takes_just_the_mapped_bits() -> None:
    # peers read the neighbour too: 0x56781234 in place of 0x1234
    pdo = mapping((U32, 16), (U16, 16))
    assert pdo.unpack(hex_of("3412 7856")) == (0x1234, 0x5678)
    assert pdo.pack((0xABCD1234, 0x5678)) == hex_of("3412 7856")
    assert mapping((I32, 16)).pack((-2,)) == hex_of("FEFF")
    assert mapping((I32, 16)).pack((0x12348000,)) == hex_of("0080")


def test_booleans_are_single_bits() -> None:
    pdo = mapping((BOOLEAN, 1), (BOOLEAN, 1), (BOOLEAN, 1), (U8, 5))
    assert pdo.unpack(hex_of("AD")) == (True, False, True, 21)
    assert pdo.pack((True, False, True, 21)) == hex_of("AD")
    values = pdo.unpack(hex_of("01"))
    assert values[0] is True
    assert values[1] is False
    # devices that know only bytes: any bit makes it true
    assert mapping((BOOLEAN, 8)).unpack(b"\xff") == (True,)
    assert mapping((BOOLEAN, 8)).pack((True,)) == b"\x01"


def test_sixty_four_booleans() -> None:
    pdo = Mapping(entry(0x2000, n, 1, BOOLEAN) for n in range(64))
    assert pdo.unpack(hex_of("0100000000000080")) == (True, *[False] * 62, True)


def test_reals() -> None:
    pdo = mapping((REAL32, 32), (U8, 8))
    assert pdo.unpack(hex_of("0000C03F 07")) == (1.5, 7)
    assert pdo.pack((1.5, 7)) == hex_of("0000C03F 07")
    assert mapping((REAL64, 64)).unpack(struct.pack("<d", 1e300)) == (1e300,)
    shifted = mapping((U8, 3), (REAL32, 32))
    assert shifted.unpack(shifted.pack((5, -2.25))) == (5, -2.25)
    with pytest.raises(ValueRangeError, match="v0.*too large for REAL32"):
        mapping((REAL32, 32)).pack((1e300,))


def test_text_and_bytes_by_whole_bytes() -> None:
    pdo = mapping((TEXT, 32), (OCTETS, 16), (UNICODE, 16))
    assert pdo.unpack(b"AB\0\0\x01\x02\xac\x20") == ("AB\0\0", b"\x01\x02", "\u20ac")
    assert pdo.pack(("AB", b"\x01", "\u20ac")) == b"AB\0\0\x01\x00\xac\x20"
    with pytest.raises(ValueRangeError, match="v0: the value has 5 bytes, but only 4 are mapped"):
        pdo.pack(("ABCDE", b"", ""))


def test_times() -> None:
    pdo = mapping((DataType.TIME_OF_DAY, 48), (U16, 16))
    assert pdo.unpack(hex_of("E8030000 0100 3412")) == (datetime.datetime(1984, 1, 2, 0, 0, 1, tzinfo=datetime.UTC), 0x1234)
    with pytest.raises(ValueRangeError, match="more than a day"):
        pdo.unpack(hex_of("FFFFFF0F 0000 0000"))


def test_dummies_are_space() -> None:
    pdo = Mapping([entry(5, 0, 4, U8), entry(0x2000, 0, 8, U8, "v"), entry(1, 0, 1, BOOLEAN)])
    assert pdo.unpack(hex_of("FF1F")) == (0xFF,)
    assert pdo.pack((0xAB,)) == hex_of("B00A")
    assert pdo.find_component(0x0005) is None
    assert Mapping([entry(7, 0, 32, U32)]).pack(()) == bytes(4)


@pytest.mark.parametrize(("bits", "index"), [(1, 1), (8, 5), (16, 6), (32, 7), (64, 0x1B), (24, 0x16), (12, 6), (3, 5)])
def test_fillers_become_dummies(bits: int, index: int) -> None:
    filler = MappedEntry.of(Filler("gap", bits))
    assert (filler.index, filler.bit_length, filler.is_dummy, filler.name) == (index, bits, True, "gap")


@pytest.mark.parametrize("bits", [0, 65, 72])
def test_impossible_fillers(bits: int) -> None:
    with pytest.raises(MappingError, match="gap"):
        MappedEntry.of(Filler("gap", bits))


def test_an_empty_mapping() -> None:
    assert Mapping().byte_length == 0
    assert Mapping().unpack(b"\1\2") == ()
    assert Mapping().pack(()) == b""


# ---- lengths, limits, errors


def test_longer_data_are_cut_and_shorter_refused() -> None:
    for pdo in (mapping((U16, 16)), mapping((U16, 12))):
        assert pdo.unpack(hex_of("34021111")) == (0x234,)
        with pytest.raises(ValueRangeError, match="this PDO has 2 bytes, but only 1 were received"):
            pdo.unpack(b"\x34")


def test_more_than_64_bits_are_refused() -> None:
    with pytest.raises(MappingError, match="64 bits at most, not 72"):
        mapping((U64, 64), (U8, 8))


@pytest.mark.parametrize(
    ("data_type", "bits", "possible"),
    [
        *[(U8, bits, 1 <= bits <= 8) for bits in range(11)],
        *[(I24, bits, 1 <= bits <= 24) for bits in (1, 23, 24, 25, 32)],
        *[(BOOLEAN, bits, 1 <= bits <= 8) for bits in range(10)],
        *[(REAL32, bits, bits == 32) for bits in (1, 16, 31, 32, 33, 64)],
        *[(REAL64, bits, bits == 64) for bits in (32, 63, 64, 65)],
        *[(DataType.TIME_DIFFERENCE, bits, bits == 48) for bits in (47, 48, 64)],
        *[(TEXT, bits, bits in (8, 64)) for bits in (0, 4, 8, 12, 64, 72)],
        *[(UNICODE, bits, bits == 16) for bits in (8, 16, 24)],
    ],
)
def test_widths(data_type: DataType, bits: int, possible: bool) -> None:
    assert may_have_width(data_type, bits) is possible
    if not possible:
        with pytest.raises(MappingError, match=f"0x2000:01: {data_type.name} cannot be mapped to a PDO with {bits} bits"):
            entry(0x2000, 1, bits, data_type)


@pytest.mark.parametrize("value", [-1, 0x10000, 1.5, "7", b"7"])
def test_values_outside_their_type_are_refused_by_name(value: Value) -> None:
    for pdo in (mapping((U16, 16)), mapping((U16, 12))):
        with pytest.raises(ValueRangeError, match="v0"):
            pdo.pack((value,))


@pytest.mark.parametrize("values", [(), (1,), (1, 2, 3)])
def test_the_number_of_values_counts(values: tuple[int, ...]) -> None:
    for pdo in (mapping((U16, 16), (U8, 8)), mapping((U16, 12), (U8, 8))):
        with pytest.raises(ValueRangeError, match=f"this PDO has 2 components, but {len(values)} values"):
            pdo.pack(values)


def test_what_a_store_lacks_is_sent_as_zero() -> None:
    pdo = mapping((U16, 15), (BOOLEAN, 1), (TEXT, 16), (REAL32, 32))
    assert pdo.pack_from({}) == bytes(8)
    assert pdo.pack_from({0x200300: 1.5}) == hex_of("00000000 0000C03F")
    assert mapping((U16, 16), (U8, 8)).pack_from({0x200000: 0x1234}) == hex_of("341200")


def test_an_object_mapped_twice() -> None:
    pdo = Mapping([entry(0x2000, 0, 8, U8, "v"), entry(0x2000, 0, 8, U8, "v")])
    store: dict[int, Value] = {}
    assert pdo.unpack_into(store, b"\1\2") == (1, 2)
    assert store == {0x200000: 2}
    assert pdo.position_of("v") == 0
    assert pdo.labels == ("2000:00", "2000:00#2")
    assert pdo.position_of("2000:00#2") == 1
    assert pdo.pack_from({0x200000: 7}) == b"\7\7"


def test_entries_of_an_array_that_share_a_name() -> None:
    pdo = Mapping([entry(0x6401, 1, 16, I16, "analogue_input"), entry(0x6401, 2, 16, I16, "analogue_input")])
    assert pdo.labels == ("6401:01", "6401:02")
    assert pdo.position_of("6401:02") == 1
    with pytest.raises(LocalProtocolError, match=r"'analogue_input': name one, as '6401:01' \(6401:01, 6401:02\)"):
        pdo.position_of("analogue_input")


# ---- find_component (R55)


def test_find_component() -> None:
    pdo = Mapping(
        [
            MappedEntry.of(STATUS_WORD),
            entry(0x60C1, 1, 8, U8, "a:1"),
            entry(0x6000, 1, 4, U8),
            entry(0x6000, 2, 4, U8),
            entry(0x6001, 0, 4, U8),
            entry(0x6001, 1, 4, U8),
        ]
    )
    status = pdo.entries[0]
    for key in (
        "statusword",
        "status",
        0x6041,
        (0x6041, 0),
        "6041",
        "0x6041",
        "6041:00",
        "6041.0",
        " 0x6041:0x00 ",
        0x604100,
        STATUS_WORD,
    ):
        assert pdo.find_component(key) is status
    assert pdo.find_component(0x60C1) is pdo.entries[1]  # the only subindex that is mapped
    assert pdo.find_component("60C1:01") is pdo.entries[1]
    assert pdo.find_component(0x60C101) is pdo.entries[1]
    assert pdo.find_component(0x60C102) is None
    assert pdo.find_component((0x60C1, 2)) is None  # peers ignore the subindex
    assert pdo.find_component(0x6001) is pdo.entries[4]  # subindex 0 is meant where it is mapped
    assert pdo.find_component((0x6000, 2)) is pdo.entries[3]
    assert pdo.position_of((0x6000, 2)) == 3
    with pytest.raises(LocalProtocolError, match="subindex 1, 2 of 0x6000: name one"):
        pdo.find_component(0x6000)
    for absent in ("torque", "6077", 0x6077, (0x6077, 0), "6041:01", TORQUE, 3, 0):
        assert pdo.find_component(absent) is None


# ---- from parameters and values


def dictionary() -> ObjectDictionary:
    count = Variable(0x1A00, 0, "tpdo1:count", U8, default=2)
    slots = [Variable(0x1A00, n, f"tpdo1:{n}", U32, default=value) for n, value in ((1, 0x60410010), (2, 0x00050008), (3, 0))]
    objects = [Object.of("tpdo1", [count, *slots]), Object.of("statusword", [STATUS_WORD]), Object.of("position", [POSITION])]
    return ObjectDictionary(objects)


def test_from_values() -> None:
    values = Values(dictionary(), 5)
    tpdo = Mapping.from_values(values, 0x1A00)
    assert tpdo == Mapping([MappedEntry.of(STATUS_WORD), entry(5, 0, 8, U8)])
    assert hash(tpdo) == hash(Mapping(tpdo.entries))
    assert repr(tpdo) == "<Mapping statusword/16 0x0005:00/8>"
    assert repr(tpdo.entries[0]) == "<statusword 60410010>"
    assert len({*tpdo.entries, *Mapping.from_values(values, 0x1A00).entries}) == 2
    assert tpdo != Mapping()
    assert tpdo != 7
    values.store[0x1A0003] = 0x60640020
    values.store[0x1A0000] = 3
    assert Mapping.from_values(values, 0x1A00).parameters == (0x60410010, 0x00050008, 0x60640020)
    assert Mapping.from_values(values, 0x1A01) == Mapping()


@pytest.mark.parametrize(
    ("parameter", "text"),
    [
        (0x00000000, "0x0000:00 is no data type"),
        (0x00090008, "0x0009:00 is no data type"),
        (0x00050108, "0x0005:01 is no data type"),
        (0x000E0008, "0x000E:00 is no data type"),
        (0x20000008, "object 0x2000:00 is not in the dictionary"),
        (0x60410110, "object 0x6041:01 is not in the dictionary"),
        (0x60410020, "statusword: UNSIGNED16 cannot be mapped to a PDO with 32 bits"),
        (0x60410000, "statusword: UNSIGNED16 cannot be mapped to a PDO with 0 bits"),
    ],
)
def test_parameters_without_sense(parameter: int, text: str) -> None:
    with pytest.raises(MappingError, match=text):
        Mapping.from_parameters([parameter], dictionary())


@pytest.mark.parametrize("count", [65, 0xFE, 0xFF])
def test_more_entries_than_a_pdo_has_and_multiplexed_pdos_are_no_mapping(count: int) -> None:
    values = Values(dictionary(), 5)
    values.store[0x1A0000] = count
    with pytest.raises(MappingError, match="64 entries at most"):
        Mapping.from_values(values, 0x1A00)


def test_a_mapping_is_made_once_for_all_devices_of_a_dictionary() -> None:
    mine, other = dictionary(), ObjectDictionary([Object.of("status", [replace(STATUS_WORD, name="status")])])
    assert Mapping.from_parameters([0x60410010], mine) is Mapping.from_parameters((0x60410010,), mine)
    assert Mapping.from_parameters([0x60410010], mine).labels == ("statusword",)
    assert Mapping.from_parameters([0x60410010], other).labels == ("status",)


def test_of_all_that_a_peer_maps_little_is_kept() -> None:
    described = dictionary()
    for entries in product((0x00010001, 0x00050002), repeat=11):  # 2048 of them
        assert Mapping.from_parameters(entries, described).parameters == entries
    assert 0 < len(_known(described)) <= _MOST_KNOWN


# ---- against a reference model that goes bit by bit


def bits_of(data: bytes) -> list[int]:
    """First bit first."""
    return [byte >> n & 1 for byte in data for n in range(8)]


def bytes_of(bits: list[int]) -> bytes:
    padded = bits + [0] * (-len(bits) % 8)
    return bytes(sum(padded[8 * n + m] << m for m in range(8)) for n in range(len(padded) // 8))


def model_value(data_type: DataType, bits: list[int]) -> object:
    number = sum(bit << n for n, bit in enumerate(bits))
    if data_type == BOOLEAN:
        return any(bits)
    if is_integer(data_type):
        return number - (1 << len(bits)) if is_signed(data_type) and bits[-1] else number
    if data_type in (REAL32, REAL64):
        return struct.unpack("<f" if data_type == REAL32 else "<d", bytes_of(bits))[0]
    if data_type == TEXT:
        return "".join(chr(byte) for byte in bytes_of(bits))
    if data_type == UNICODE:
        raw = bytes_of(bits)
        units = "".join(chr(raw[n] | raw[n + 1] << 8) for n in range(0, len(raw), 2))
        return units.encode("utf-16-le", "surrogatepass").decode("utf-16-le", "surrogatepass")
    return bytes_of(bits)


def same(left: object, right: object) -> bool:
    if isinstance(left, float) and isinstance(right, float):
        return left == right or (math.isnan(left) and math.isnan(right))
    return type(left) is type(right) and left == right


@given(pdo_mappings(), st.binary(min_size=8, max_size=8))
def test_unpack_is_what_the_model_says(pdo: Mapping, data: bytes) -> None:
    bits = bits_of(data)
    expected = []
    for each in pdo.entries:
        field, bits = bits[: each.bit_length], bits[each.bit_length :]
        if not each.is_dummy:
            expected.append(model_value(each.data_type, field))
    values = pdo.unpack(data)
    assert len(values) == len(expected)
    assert all(same(left, right) for left, right in zip(values, expected, strict=True))
    assert pdo.unpack(data[: pdo.byte_length]) == values or any(value != value for value in values)


@given(pdo_mappings(), st.binary(min_size=8, max_size=8))
def test_pack_gives_back_what_was_unpacked(pdo: Mapping, data: bytes) -> None:
    values = pdo.unpack(data)
    assume(all(value == value for value in values))  # a NaN may change its payload on the way
    bits = bits_of(data)
    kept = []
    for each in pdo.entries:
        field, bits = bits[: each.bit_length], bits[each.bit_length :]
        if each.is_dummy:
            field = [0] * each.bit_length
        elif each.data_type == BOOLEAN:
            field = [int(any(field)), *[0] * (each.bit_length - 1)]
        kept += field
    assert pdo.pack(values) == bytes_of(kept)
    store: dict[int, Value] = {}
    pdo.unpack_into(store, data)
    assert pdo.pack_from(store) == bytes_of(kept)


@st.composite
def mappings_of_like_names(draw: st.DrawFn) -> Mapping:
    """Few objects, mapped again and again, under few names, some of which look like labels."""
    names = st.sampled_from(["a", "b", "2000:00", "2000:01", "2000:00#2", "2001:00#2", ""])
    places = st.tuples(st.sampled_from([0x2000, 0x2001]), st.integers(0, 1))
    several = st.lists(st.tuples(places, names, names), min_size=1, max_size=8)
    return Mapping(entry(index, sub, 8, U8, name, alias) for (index, sub), name, alias in draw(several))


@given(mappings_of_like_names())
def test_whatever_the_names_no_two_components_collide(pdo: Mapping) -> None:
    assert [pdo.position_of(label) for label in pdo.labels] == list(range(len(pdo.components)))


@given(pdo_mappings(), st.data())
def test_pack_takes_the_lowest_bits(pdo: Mapping, draw: st.DataObject) -> None:
    assume(all(is_integer(each.data_type) for each in pdo.components))
    values = []
    for each in pdo.components:
        full = bit_length_of(each.data_type) or 0
        low, high = (-(1 << full - 1), (1 << full - 1) - 1) if is_signed(each.data_type) else (0, (1 << full) - 1)
        values.append(draw.draw(st.integers(low, high)))
    given_values = iter(values)
    expected: list[int] = []
    for each in pdo.entries:
        value = 0 if each.is_dummy else next(given_values)
        expected += [value >> n & 1 for n in range(each.bit_length)]
    assert pdo.pack(values) == bytes_of(expected)
