"""Numbers and values as EDS files write them."""

from __future__ import annotations

import datetime
import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.eds.ini import quoted
from canopen_data.eds.numbers import read_number, read_value
from canopen_proto.datatypes import EPOCH, DataType, Value, encode, range_of

OCTAL = "a leading 0 means octal"


@pytest.mark.parametrize(
    ("text", "number", "remark"),
    [
        ("0", 0, ""),
        ("10", 10, ""),
        ("-5", -5, ""),
        ("+5", 5, ""),
        ("0x1A", 26, ""),
        ("0X1a", 26, ""),
        ("-0x10", -16, ""),
        ("07", 7, ""),
        ("001", 1, ""),
        ("00", 0, ""),
        ("010", 8, f"{OCTAL}; read as 8"),
        ("08", 8, f"{OCTAL}, which it cannot be; read as decimal 8"),
        ("0099", 99, f"{OCTAL}, which it cannot be; read as decimal 99"),
        ("0x7 # VAR", 7, "the comment after it was left out; a comment has a line of its own"),
        ("7;x", 7, "the comment after it was left out; a comment has a line of its own"),
        ("80h", 128, "a hexadecimal number begins with 0x"),
        ("0000 0080H", 128, "a hexadecimal number begins with 0x"),
        ("0x" + "F" * 32, (1 << 128) - 1, ""),
    ],
)
def test_numbers(text: str, number: int, remark: str) -> None:
    assert read_number(text) == (number, remark)


@pytest.mark.parametrize(
    "text",
    ["", " ", "x", "1.0", "0x", "1_0", "0b1", "0o7", "1 2", "--1", "FF", "٣", "9" * 41, "0x" + "F" * 33, "#", "# 1", "x # y"],
)
def test_what_is_no_number(text: str) -> None:
    assert read_number(text) == (None, "is not a number")


@pytest.mark.parametrize(
    ("text", "data_type", "value"),
    [
        ("255", DataType.UNSIGNED8, 255),
        ("0xFFFFFFFFFFFFFFFF", DataType.UNSIGNED64, (1 << 64) - 1),
        ("-128", DataType.INTEGER8, -128),
        ("0xFF", DataType.INTEGER8, -1),
        ("0x800000", DataType.INTEGER24, -(1 << 23)),
        ("0x8000000000", DataType.INTEGER40, -(1 << 39)),
        ("0xFFFFFFFFFFFE", DataType.INTEGER48, -2),
        ("0x7FFFFFFFFFFFFF", DataType.INTEGER56, (1 << 55) - 1),
        ("0x8000000000000000", DataType.INTEGER64, -(1 << 63)),
        ("1", DataType.BOOLEAN, True),
        ("0x0", DataType.BOOLEAN, False),
        ("0.5", DataType.REAL32, 0.5),
        ("-1e3", DataType.REAL64, -1000.0),
        (".5", DataType.REAL32, 0.5),
        ("3", DataType.REAL64, 3.0),
        ("-inf", DataType.REAL32, -math.inf),
        ("any; text # at all", DataType.VISIBLE_STRING, "any; text # at all"),
        ("$NODEID", DataType.VISIBLE_STRING, "$NODEID"),
        ("ÄΩ", DataType.UNICODE_STRING, "ÄΩ"),
        ("00 fF 10", DataType.OCTET_STRING, b"\x00\xff\x10"),
        ("00FF", DataType.OCTET_STRING, b"\x00\xff"),
        ("0x00FF", DataType.DOMAIN, b"\x00\xff"),
        ("0x000100000001", DataType.TIME_DIFFERENCE, datetime.timedelta(days=1, milliseconds=1)),
        ("00 00 00 00 02 00", DataType.TIME_OF_DAY, EPOCH + datetime.timedelta(days=2)),
        ("", DataType.UNSIGNED8, None),
        ("", DataType.VISIBLE_STRING, None),
    ],
)
def test_values(text: str, data_type: DataType, value: Value | None) -> None:
    assert read_value(text, data_type) == (value, False, "", False)
    assert type(read_value(text, data_type)[0]) is type(value)


@pytest.mark.parametrize(
    ("text", "base"),
    [
        ("$NODEID", 0),
        ("$NODEID+0x180", 0x180),
        ("0x180+$NODEID", 0x180),
        ("$nodeid + 0x180", 0x180),
        ("384 +$NodeId", 0x180),
        ("$NODEID+0600", 0o600),
        ("$NODEID+0x80000180", 0x8000_0180),
        ("$NODEID+0xFFFFFFFE", 0xFFFF_FFFE),
        ("$NODEID-1", -1),
        ("$NODEID-127", -127),
    ],
)
def test_values_that_depend_on_the_node_id(text: str, base: int) -> None:
    assert read_value(text, DataType.UNSIGNED32) == (base, True, read_value(text, DataType.INTEGER64)[2], False)
    if base < 0:
        assert read_value(text, DataType.INTEGER32) == (base, True, "", False)


@pytest.mark.parametrize(
    ("text", "data_type", "value", "remark"),
    [
        ("255", DataType.INTEGER8, -1, "'255': read as -1, its two's complement"),
        ("-1", DataType.UNSIGNED16, 0xFFFF, "'-1': an UNSIGNED16 is not negative; read as 0xFFFF"),
        ("TRUE", DataType.BOOLEAN, True, "'TRUE': a BOOLEAN is 0 or 1"),
        ("0x3F800000", DataType.REAL32, 1.0, "'0x3F800000': read as the bits of 1.0"),
        ("0x3FF0000000000000", DataType.REAL64, 1.0, "'0x3FF0000000000000': read as the bits of 1.0"),
        ("0x10", DataType.REAL32, 16.0, "'0x10': read as 16.0"),
        ("10h", DataType.REAL32, 16.0, "'10h': a hexadecimal number begins with 0x"),
        ("010", DataType.UNSIGNED8, 8, f"'010': {OCTAL}; read as 8"),
        ("$NODEID+0x180 # COB-ID", DataType.UNSIGNED32, 0x180, None),
        ("0x180+$NODEID ; COB-ID", DataType.UNSIGNED32, 0x180, None),
    ],
)
def test_values_with_a_remark(text: str, data_type: DataType, value: Value, remark: str | None) -> None:
    found, _, said, lost = read_value(text, data_type)
    assert (found, lost) == (value, False)
    assert remark is None or said == remark


@pytest.mark.parametrize(
    ("text", "data_type", "reason"),
    [
        ("256", DataType.UNSIGNED8, "is outside 0..255 (UNSIGNED8)"),
        ("-129", DataType.INTEGER8, "is outside -128..127 (INTEGER8)"),
        ("256", DataType.INTEGER8, "is outside -128..127 (INTEGER8)"),
        ("-129", DataType.UNSIGNED8, "is outside 0..255 (UNSIGNED8)"),
        ("$NODEID+0xFFFFFFFF", DataType.UNSIGNED32, "is outside 0..4294967295 (UNSIGNED32), whatever the node-ID"),
        ("$NODEID+127", DataType.INTEGER8, "is outside -128..127 (INTEGER8), whatever the node-ID"),
        ("$NODEID-128", DataType.UNSIGNED16, "is outside 0..65535 (UNSIGNED16), whatever the node-ID"),
        ("2", DataType.BOOLEAN, "is outside 0..1 (BOOLEAN)"),
        ("yes", DataType.BOOLEAN, "is not a number"),
        ("$NODEID", DataType.BOOLEAN, "depends on the node-ID"),
        ("No", DataType.UNSIGNED32, "is not a number"),
        ("$NODEID*2", DataType.UNSIGNED32, "is neither $NODEID plus a number nor a number plus $NODEID"),
        ("2$NODEID", DataType.UNSIGNED32, "is neither $NODEID plus a number nor a number plus $NODEID"),
        ("1+$NODEID+2", DataType.UNSIGNED32, "is not a number"),
        ("$NODEID+$NODEID", DataType.UNSIGNED32, "is not a number"),
        ("$NODEID+x", DataType.UNSIGNED32, "is not a number"),
        ("$OTHER+1", DataType.UNSIGNED32, "is not a number"),
        ("1,5", DataType.REAL32, "is no REAL32"),
        ("nan", DataType.REAL64, "is no REAL64"),
        ("0x7FC00000", DataType.REAL32, "is not a number (NaN)"),
        ("1e39", DataType.REAL32, "is too large for REAL32"),
        ("1e-46", DataType.REAL32, "is too small for REAL32"),
        ("-.001e-400", DataType.REAL64, "is too small for REAL64"),
        ("1e400", DataType.REAL32, "is too large for REAL32"),
        ("-1.e400", DataType.REAL64, "is too large for REAL64"),
        ("9" * 320, DataType.REAL64, "is too large for REAL64"),
        ("0 1", DataType.OCTET_STRING, "is no OCTET_STRING in pairs of hexadecimal digits"),
        ("file.bin", DataType.DOMAIN, "is no DOMAIN in pairs of hexadecimal digits"),
        ("12:00", DataType.TIME_OF_DAY, "is no TIME_OF_DAY"),
        ("0x0001FFFFFFFF", DataType.TIME_DIFFERENCE, "is no TIME_DIFFERENCE"),
        ("00 11", DataType.TIME_DIFFERENCE, "is no TIME_DIFFERENCE"),
    ],
)
def test_values_that_are_lost(text: str, data_type: DataType, reason: str) -> None:
    assert read_value(text, data_type) == (None, False, f"{quoted(text)!r} {reason}; left out", True)


@given(st.sampled_from([each for each in DataType if range_of(each)]), st.data())
def test_any_integer_in_any_form(data_type: DataType, data: st.DataObject) -> None:
    low, high = range_of(data_type) or (0, 0)
    number = data.draw(st.integers(low, high))
    raw = int.from_bytes(encode(number, data_type), "little")
    for text in (
        str(number),
        f"0x{raw:X}",
        f"{'-' if number < 0 else ''}0x{abs(number):x}",
        f"0{number:o}" if number > 7 else "x",
    ):
        if text != "x":
            assert read_value(text, data_type)[0] == number


@given(st.floats(allow_nan=False))
def test_any_real(number: float) -> None:
    assert read_value(repr(number), DataType.REAL64)[:1] == (number,)
    assert read_value(f"0x{struct.pack('>d', number).hex()}", DataType.REAL64)[0] == number


@given(st.text(max_size=30) | st.from_regex(r"[ $NODEIDnodeid+\-0-9xXa-fh#;.]{0,20}", fullmatch=True), st.sampled_from(DataType))
def test_any_text(text: str, data_type: DataType) -> None:
    """Whatever is read can be encoded, but for characters that no string has."""
    value, adds_node_id, remark, lost = read_value(text, data_type)
    assert not lost or (value is None and remark)
    assert not adds_node_id or isinstance(value, int)
    if value is not None and not isinstance(value, str):
        encode(value, data_type)


COMMENTED = (
    [(f"{sign}{text}", each) for each in DataType if range_of(each) for text in ("0", "1", "0x1") for sign in ("", "$NODEID+")]
    + [(f"{text}+$NODEID", DataType.UNSIGNED32) for text in ("0x180", "384")]
    + [("$NODEID", DataType.UNSIGNED32), ("180h", DataType.UNSIGNED32), ("true", DataType.BOOLEAN), ("1.5", DataType.REAL32)]
    + [("0x3F800000", DataType.REAL32), ("01 02", DataType.OCTET_STRING), ("0102", DataType.DOMAIN)]
    + [("0x000000000001", DataType.TIME_OF_DAY)]
)


@given(
    st.sampled_from(COMMENTED),
    st.sampled_from([" ; ", ";", "\t; ", " # "]),
    st.text("a1 ;#$+.x", max_size=8) | st.sampled_from(["$NODEID+0x180", "0x80", "COB-ID (hex)"]),
)
def test_a_value_before_a_comment_is_the_value(case: tuple[str, DataType], mark: str, comment: str) -> None:
    text, data_type = case
    value, adds_node_id, _, lost = read_value(text, data_type)
    told = read_value(text + mark + comment, data_type)
    assert (told[0], told[1], told[3]) == (value, adds_node_id, lost)
    assert lost or "the comment after it was left out" in told[2]


def test_a_text_may_have_a_semicolon() -> None:
    assert read_value("a ; b # c", DataType.VISIBLE_STRING) == ("a ; b # c", False, "", False)


@pytest.mark.parametrize("data_type", [each for each in DataType if range_of(each) and each is not DataType.BOOLEAN])
def test_the_first_number_beyond_the_bits_of_a_type_is_lost(data_type: DataType) -> None:
    """256 is no two's complement of eight bits, and would be 0; a COB-ID of 0 is that of NMT."""
    limits = range_of(data_type)
    assert limits is not None
    size = limits[1] - limits[0] + 1
    for text in (str(size), f"0x{size:X}", str(-size)):
        assert read_value(text, data_type)[0] is None
        assert read_value(text, data_type)[3]
