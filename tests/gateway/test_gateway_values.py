"""The values of CiA 309-3 as text: what a text means, and what cannot be one."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.gateway import CANOPENNODE, LELY, VALUE_TYPES, Dialect, parse_value, print_value, typed_value
from canopen_proto.machine import LocalProtocolError
from tests.examples import examples
from tests.gateway.gateway_draws import TYPES, data_of

DIALECTS = pytest.mark.parametrize("dialect", [CANOPENNODE, LELY], ids=lambda each: each.name)


@pytest.mark.parametrize(
    ("word", "data", "canopennode", "lely"),
    [
        ("u16", "4002", "576", "0x0240"),
        ("u32", "92010200", "131474", "0x00020192"),
        ("u24", "010203", "197121", "0x030201"),
        ("x32", "00000000", "0x00000000", "0x00000000"),
        ("x16", "abcd", "0xCDAB", "0xCDAB"),
        ("i32", "50c9ffff", "-14000", "-14000"),
        ("b", "01", "1", "1"),
        ("b", "ff", "255", "1"),
        ("r32", "cdcccc3d", "0.1", "0.1"),
        ("r32", "0000803f", "1", "1"),
        ("r64", "9a9999999999b93f", "0.1", "0.1"),
        ("t", "e8030000 0200", "2 1000", "2 1000"),
        ("vs", "612262", '"a""b"', '"a""b"'),
        ("vs", "610a00", '"a"', '"a\\n\\000"'),
        ("d", "53636875", "U2NodQ==", "U2NodQ=="),
        ("hex", "0a00ff", "0A 00 FF", "0A 00 FF"),
        ("u8", "92010200", "92 01 02 00", "92 01 02 00"),  # not its length: as bytes
    ],
)
def test_a_value_as_both_gateways_write_it(word: str, data: str, canopennode: str, lely: str) -> None:
    value = bytes.fromhex(data)
    assert print_value(VALUE_TYPES[word], value, CANOPENNODE) == canopennode
    assert print_value(VALUE_TYPES[word], value, LELY) == lely


@pytest.mark.parametrize(
    ("word", "text"),
    [
        ("u8", "256"),
        ("u8", "-1"),
        ("i8", "300"),
        ("i8", "-129"),
        ("u16", "010"),  # C would read 8
        ("u16", "0x"),
        ("u16", "1_0"),
        ("u16", ""),
        ("u64", "99999999999999999999999999"),
        ("r32", "1e39"),
        ("r32", "1e99999"),  # Python reads inf
        ("r32", "-1e99999"),
        ("r64", "1e999"),
        ("r64", "1e-999"),  # Python reads 0
        ("r32", "1e-46"),
        ("r32", "1_0"),
        ("r64", "abc"),
        ("b", "2"),
        ("t", "1"),
        ("t", "0 86400000"),
        ("t", "65536 0"),
        ("vs", "two words"),
        ("vs", '"open'),
        ("vs", '"a"b"'),
        ("d", "!!!!"),
        ("us", "AAAA"),  # three bytes: half a character
        ("hex", "0"),
        ("hex", "xy"),
    ],
)
def test_what_is_no_value(word: str, text: str) -> None:
    assert parse_value(VALUE_TYPES[word], text) is None


def test_a_backslash_is_an_escape_for_lely_only() -> None:
    assert parse_value(VALUE_TYPES["vs"], r'"a\n\x41\101"', LELY) == b"a\nAA"
    assert parse_value(VALUE_TYPES["vs"], r'"a\n"', CANOPENNODE) == rb"a\n"
    assert parse_value(VALUE_TYPES["vs"], '"a\\', LELY) is None
    assert parse_value(VALUE_TYPES["vs"], r'"\q"', LELY) is None


@DIALECTS
@examples(400)
@given(data=st.data(), word=TYPES)
def test_a_value_is_read_as_it_was_written(dialect: Dialect, data: st.DataObject, word: str) -> None:
    value_type = VALUE_TYPES[word]
    value = data.draw(data_of(value_type, dialect))
    assert parse_value(value_type, typed_value(value_type, value, dialect), dialect) == value


@DIALECTS
@examples(400)
@given(value=st.binary(max_size=20), word=TYPES)
def test_any_bytes_have_a_text_of_one_line(dialect: Dialect, value: bytes, word: str) -> None:
    text = print_value(VALUE_TYPES[word], value, dialect)
    assert not set("\r\n\0") & set(text)
    text.encode("latin-1")


@DIALECTS
@examples(400)
@given(text=st.text(st.characters(max_codepoint=0x1FF), max_size=30), word=TYPES)
def test_any_text_is_a_value_or_none(dialect: Dialect, text: str, word: str) -> None:
    value = parse_value(VALUE_TYPES[word], text, dialect)
    assert value is None or VALUE_TYPES[word].size in (None, len(value))


@examples(200)
@given(st.floats(width=32, allow_nan=False))
def test_a_real_number_has_as_many_digits_as_it_needs(number: float) -> None:
    data = struct.pack("<f", number)
    text = print_value(VALUE_TYPES["r32"], data)
    assert struct.pack("<f", float(text)) == data
    assert len(text) <= 16


def test_what_a_type_cannot_carry_is_refused() -> None:
    with pytest.raises(LocalProtocolError, match="hex can carry them"):
        typed_value(VALUE_TYPES["vs"], b"a\nb")
    with pytest.raises(LocalProtocolError, match="cannot be typed as u8"):
        typed_value(VALUE_TYPES["u8"], b"ab")
