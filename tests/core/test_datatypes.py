"""Data types: literal bytes from the standard's rules, properties of the codec, errors that name the object."""

from __future__ import annotations

import datetime
import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.datatypes import (
    EPOCH,
    DataType,
    Value,
    ValueRangeError,
    bit_length_of,
    decode,
    encode,
    integer_type,
    is_integer,
    is_number,
    is_signed,
    range_of,
    real_of,
    size_of,
    vanishes,
    zero_of,
)
from canopen_proto.machine import LocalProtocolError
from canopen_testing.strategies import data_types, values
from tests.builds import takes_any_type
from tests.examples import examples

UTC = datetime.UTC
DAY = datetime.timedelta(days=1)
MS = datetime.timedelta(milliseconds=1)
INTEGERS = [each for each in DataType if is_integer(each)]


@pytest.mark.parametrize(
    ("data_type", "value", "wire"),
    [
        (DataType.BOOLEAN, True, "01"),
        (DataType.BOOLEAN, False, "00"),
        (DataType.INTEGER8, -1, "FF"),
        (DataType.INTEGER8, -128, "80"),
        (DataType.INTEGER16, -2, "FE FF"),
        (DataType.UNSIGNED16, 0x1234, "34 12"),
        (DataType.INTEGER24, -3, "FD FF FF"),
        (DataType.UNSIGNED24, 0x010203, "03 02 01"),
        (DataType.INTEGER32, -90_000, "70 A0 FE FF"),
        (DataType.UNSIGNED32, 0x65766173, "73 61 76 65"),  # "save"
        (DataType.UNSIGNED40, 0x0102030405, "05 04 03 02 01"),
        (DataType.INTEGER40, -1, "FF FF FF FF FF"),
        (DataType.UNSIGNED48, 1, "01 00 00 00 00 00"),
        (DataType.INTEGER56, -(1 << 55), "00 00 00 00 00 00 80"),
        (DataType.UNSIGNED64, (1 << 64) - 1, "FF FF FF FF FF FF FF FF"),
        (DataType.REAL32, 1.5, "00 00 C0 3F"),
        (DataType.REAL64, -2.0, "00 00 00 00 00 00 00 C0"),
        (DataType.VISIBLE_STRING, "CANopen", "43 41 4E 6F 70 65 6E"),
        (DataType.VISIBLE_STRING, "5 °C", "35 20 B0 43"),
        (DataType.OCTET_STRING, b"\x01\x00", "01 00"),
        (DataType.UNICODE_STRING, "aß", "61 00 DF 00"),
        (DataType.DOMAIN, b"", ""),
        (DataType.TIME_OF_DAY, EPOCH, "00 00 00 00 00 00"),
        (DataType.TIME_OF_DAY, datetime.datetime(1984, 1, 2, 0, 0, 1, tzinfo=UTC), "E8 03 00 00 01 00"),
        (DataType.TIME_OF_DAY, EPOCH + 0xFFFF * DAY + 86_399_999 * MS, "FF 5B 26 05 FF FF"),
        (DataType.TIME_DIFFERENCE, datetime.timedelta(days=2, milliseconds=5), "05 00 00 00 02 00"),
    ],
)
def test_literal_values(data_type: DataType, value: Value, wire: str) -> None:
    assert encode(value, data_type) == bytes.fromhex(wire)
    decoded = decode(bytes.fromhex(wire), data_type)
    assert decoded == value
    assert type(decoded) is type(value)


@given(data_types(), st.data())
@examples(100, least=50)
def test_what_was_encoded_is_decoded(data_type: DataType, drawn: st.DataObject) -> None:
    value = drawn.draw(values(data_type))
    data = encode(value, data_type)
    assert decode(data, data_type) == value or value != value
    assert size_of(data_type) in (None, len(data))


@given(st.sampled_from(DataType), st.binary(max_size=12))
def test_any_bytes_give_a_value_that_can_be_encoded_again_or_a_range_error(data_type: DataType, data: bytes) -> None:
    try:
        value = decode(data, data_type)
    except ValueRangeError:
        assert size_of(data_type) is not None or len(data) % 2
        return
    again = encode(value, data_type)
    if data_type is DataType.BOOLEAN:
        assert again == (b"\x01" if data[0] else b"\x00")
    elif data_type in (DataType.TIME_OF_DAY, DataType.TIME_DIFFERENCE):
        assert again[:3] == data[:3]
        assert again[3] == data[3] & 0x0F
        assert again[4:] == data[4:]
    elif isinstance(value, float) and math.isnan(value):
        assert math.isnan(struct.unpack("<f" if data_type is DataType.REAL32 else "<d", again)[0])
    else:
        assert again == data


ANYTHING = st.one_of(
    st.sampled_from([None, True, 10**400, -(10**5000)]),
    st.integers(),
    st.floats(),
    st.text(),
    st.binary(),
    st.datetimes(),
    st.timedeltas(),
)


@given(st.sampled_from(DataType), ANYTHING)
def test_any_value_gives_bytes_or_a_range_error_that_names_the_object(data_type: DataType, value: Value) -> None:
    text = ""
    try:
        encode(value, data_type, "target_position (0x607A:00)")
    except ValueRangeError as error:
        text = str(error)
    assert text == "" or text.startswith("target_position (0x607A:00): ")
    assert len(text) < 250


@pytest.mark.parametrize("data_type", INTEGERS)
def test_integers_know_their_range(data_type: DataType) -> None:
    span = range_of(data_type)
    size = size_of(data_type)
    assert span is not None
    assert size is not None
    low, high = span
    assert high - low + 1 == 1 << 8 * size
    assert (low < 0) == is_signed(data_type) == data_type.name.startswith("INTEGER")
    assert data_type.name.endswith(str(8 * size))
    assert integer_type(size, signed=is_signed(data_type)) is data_type
    for value in (low - 1, high + 1):
        with pytest.raises(ValueRangeError, match=rf"^x: {value} is outside {low}\.\.{high} \({data_type.name}\)$"):
            encode(value, data_type, "x")
    with pytest.raises(ValueRangeError, match=f"x: {data_type.name} has {size} bytes, not {size + 1}"):
        decode(bytes(size + 1), data_type, "x")


def test_codes_are_those_of_the_standard() -> None:
    assert [DataType.INTEGER24, DataType.REAL64, DataType.INTEGER40, DataType.INTEGER64] == [0x10, 0x11, 0x12, 0x15]
    assert [DataType.UNSIGNED24, DataType.UNSIGNED40, DataType.UNSIGNED48, DataType.UNSIGNED56, DataType.UNSIGNED64] == [
        0x16, 0x18, 0x19, 0x1A, 0x1B,
    ]  # fmt: skip
    assert [DataType.TIME_OF_DAY, DataType.TIME_DIFFERENCE, DataType.DOMAIN] == [0x0C, 0x0D, 0x0F]


def test_kinds_and_lengths() -> None:
    assert bit_length_of(DataType.BOOLEAN) == 1
    assert size_of(DataType.BOOLEAN) == 1
    assert range_of(DataType.BOOLEAN) == (0, 1)
    assert bit_length_of(DataType.INTEGER24) == 24
    assert bit_length_of(DataType.TIME_OF_DAY) == 48
    assert bit_length_of(DataType.DOMAIN) is None
    assert range_of(DataType.REAL32) is None
    assert is_number(DataType.REAL32)
    assert not is_integer(DataType.REAL32)
    assert not is_signed(DataType.REAL64)
    assert not is_number(DataType.BOOLEAN)
    assert not is_number(DataType.VISIBLE_STRING)


@pytest.mark.parametrize("data_type", DataType)
def test_zero_is_a_value_of_its_type(data_type: DataType) -> None:
    data = encode(zero_of(data_type), data_type)
    assert data == bytes(size_of(data_type) or 0)


def test_booleans_take_0_and_1_and_read_any_byte() -> None:
    assert encode(1, DataType.BOOLEAN) == b"\x01"
    assert decode(b"\xff", DataType.BOOLEAN) is True
    with pytest.raises(ValueRangeError, match="BOOLEAN takes True or False, not 2"):
        encode(2, DataType.BOOLEAN)
    with pytest.raises(ValueRangeError, match="BOOLEAN has 1 bytes, not 0"):
        decode(b"", DataType.BOOLEAN)


def test_reals_take_integers_and_special_values() -> None:
    assert encode(2, DataType.REAL32) == bytes.fromhex("00000040")
    assert decode(encode(math.inf, DataType.REAL32), DataType.REAL32) == math.inf
    assert math.isnan(decode(encode(math.nan, DataType.REAL64), DataType.REAL64))  # type: ignore[arg-type]
    for value, data_type in ((1e39, DataType.REAL32), (10**400, DataType.REAL64)):
        with pytest.raises(ValueRangeError, match=f"is too large for {data_type.name}"):
            encode(value, data_type)


@pytest.mark.parametrize(
    ("data_type", "value", "expected"),
    [
        (DataType.UNSIGNED8, 1.0, "an integer"),
        (DataType.REAL32, "1", "a number"),
        (DataType.VISIBLE_STRING, b"x", "text"),
        (DataType.UNICODE_STRING, 1, "text"),
        (DataType.DOMAIN, "x", "bytes"),
        (DataType.TIME_DIFFERENCE, 5, "a timedelta"),
        (DataType.TIME_OF_DAY, DAY, "a datetime with its time zone"),
        (DataType.TIME_OF_DAY, datetime.datetime(2024, 1, 1), "a datetime with its time zone"),
    ],
)
def test_a_value_of_the_wrong_kind(data_type: DataType, value: Value, expected: str) -> None:
    with pytest.raises(ValueRangeError, match=f"^x: {data_type.name} takes {expected}, not "):
        encode(value, data_type, "x")


def test_texts() -> None:
    with pytest.raises(ValueRangeError, match=r"a VISIBLE_STRING has no character '\\u20ac'"):
        encode("5 €", DataType.VISIBLE_STRING)
    with pytest.raises(ValueRangeError, match="UNICODE_STRING has an even number of bytes, not 3"):
        decode(b"abc", DataType.UNICODE_STRING)
    assert decode(b"EPOS2\x00\x00", DataType.VISIBLE_STRING) == "EPOS2\0\0"  # nothing is lost; people strip it


@takes_any_type
def test_bytes_of_any_kind_are_copied() -> None:
    assert encode(memoryview(b"xy"), DataType.OCTET_STRING) == b"xy"  # type: ignore[arg-type]
    data = bytearray(b"xy")
    kept = decode(data, DataType.DOMAIN)  # type: ignore[arg-type]
    data[0] = 0
    assert kept == b"xy"


def test_times() -> None:
    berlin = datetime.timezone(datetime.timedelta(hours=1))
    assert encode(datetime.datetime(1984, 1, 1, 1, tzinfo=berlin), DataType.TIME_OF_DAY) == bytes(6)
    assert encode(EPOCH + datetime.timedelta(microseconds=1999), DataType.TIME_OF_DAY) == bytes([1, 0, 0, 0, 0, 0])
    assert decode(bytes.fromhex("010000F00000"), DataType.TIME_DIFFERENCE) == MS  # the four unused bits
    for early_or_late in (EPOCH - MS, EPOCH + 0x10000 * DAY):
        with pytest.raises(ValueRangeError, match=r"is outside 1984-01-01\.\.2163-06-06 \(TIME_OF_DAY\)"):
            encode(early_or_late, DataType.TIME_OF_DAY)
    for span in (-MS, 0x10000 * DAY):
        with pytest.raises(ValueRangeError, match="is outside 0..65535 days"):
            encode(span, DataType.TIME_DIFFERENCE)
    with pytest.raises(ValueRangeError, match="t: 86400000 ms is more than a day"):
        decode(bytes.fromhex("005C26050000"), DataType.TIME_OF_DAY, "t")
    with pytest.raises(ValueRangeError, match="TIME_OF_DAY has 6 bytes, not 5"):
        decode(bytes(5), DataType.TIME_OF_DAY)


def test_a_range_error_is_a_fault_of_our_caller() -> None:
    assert issubclass(ValueRangeError, LocalProtocolError)
    assert issubclass(ValueRangeError, ValueError)


@pytest.mark.parametrize("text", ["1e-400", "-0.01e-330", "1e400", "-1e999", "0." + "0" * 400 + "1"])
def test_a_text_whose_number_a_float_cannot_hold_is_none(text: str) -> None:
    with pytest.raises(ValueError, match=f"{text[:40]} is too (large|small): it would become"):
        real_of(text)


@pytest.mark.parametrize(
    "text", ["0", "-0.0", "0e-999", "0.000", "5e-324", "1.7976931348623157e308", "-inf", "Infinity", "1_0.5"]
)
def test_a_text_whose_number_a_float_can_hold_is_that_number(text: str) -> None:
    assert real_of(text) == float(text)


@given(st.floats(-1e38, 1e38))
@examples(50)
def test_a_number_vanishes_if_its_bytes_are_those_of_0(number: float) -> None:
    for value in (number, number * 2.0**-200, 2.0**-150, 2.0**-149, 0.0):
        becomes_0 = value != 0.0 and decode(encode(value, DataType.REAL32), DataType.REAL32) == 0.0
        assert (vanishes(value, DataType.REAL32), vanishes(value, DataType.REAL64)) == (becomes_0, False)
