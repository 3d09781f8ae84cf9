"""Frames, candump notation, and the three numbers: CAN-ID, COB-ID, key."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import (
    COB_ID_INVALID,
    COB_ID_NO_RTR,
    EXTENDED,
    KEY_EXTENDED,
    KEY_REMOTE,
    REMOTE,
    Frame,
    frame_for_key,
    key_of_cob_id,
)
from canopen_testing.strategies import random_frames


@pytest.mark.parametrize(
    ("text", "can_id", "data", "flags", "dlc"),
    [
        ("60C#4041600000000000", 0x60C, "4041600000000000", 0, 8),
        ("080#", 0x80, "", 0, 0),
        ("000#010C", 0, "010C", 0, 2),
        ("705#R", 0x705, "", REMOTE, 0),
        ("705#R1", 0x705, "", REMOTE, 1),
        ("18FF0001#AA", 0x18FF0001, "AA", EXTENDED, 1),
        ("00000705#", 0x705, "", EXTENDED, 0),
        ("1FFFFFFF#R8", 0x1FFFFFFF, "", EXTENDED | REMOTE, 8),
    ],
)
def test_candump_notation_both_ways(text: str, can_id: int, data: str, flags: int, dlc: int) -> None:
    frame = Frame.parse(text)
    assert (frame.can_id, frame.data, frame.flags, frame.dlc) == (can_id, bytes.fromhex(data), flags, dlc)
    assert str(frame) == text
    assert repr(frame) == f"<Frame {text}>"


@pytest.mark.parametrize(
    ("text", "plain"),
    [("123#11.22.33", "123#112233"), ("7ff#aB", "7FF#AB"), (" 080# \n", "080#"), ("705#r2", "705#R2"), ("705#R0", "705#R")],
)
def test_other_spellings_that_candump_reads(text: str, plain: str) -> None:
    assert str(Frame.parse(text)) == plain


@pytest.mark.parametrize(
    "text",
    [
        "",
        "60C",
        "#00",
        "60#00",
        "0060C#00",
        "800#",
        "FFF#00",
        "20000000#",
        "123#1",
        "123#11.",
        "123#.11",
        "123#1..1",
        "123#R9",
        "12G#",
        "123#112233445566778899",
        "123#1122 33",
        "123#R1 2",
    ],
)
def test_what_is_no_frame_is_refused_by_name(text: str) -> None:
    with pytest.raises(ValueError, match="not a classical CAN frame") as refused:
        Frame.parse(text)
    assert repr(text) in str(refused.value)


def test_can_fd_is_refused_as_such() -> None:
    with pytest.raises(ValueError, match="CAN FD"):
        Frame.parse("123##100112233")


@given(random_frames())
def test_every_frame_survives_its_text(frame: Frame) -> None:
    again = Frame.parse(str(frame))
    assert again == frame
    assert hash(again) == hash(frame)
    assert again.key == frame.key


@given(st.text(max_size=40))
def test_no_text_raises_anything_but_value_error(text: str) -> None:
    with contextlib.suppress(ValueError):
        Frame.parse(text)


@given(random_frames(), random_frames())
def test_frames_with_one_key_have_one_identifier_and_kind(first: Frame, second: Frame) -> None:
    same = (first.can_id, first.flags) == (second.can_id, second.flags)
    assert (first.key == second.key) == same


def test_equality_counts_every_field() -> None:
    frame = Frame(0x123, b"\x01")
    different = [Frame(0x124, b"\x01"), Frame(0x123, b"\x02"), Frame(0x123, b"\x01", EXTENDED), Frame(0x123, b"", REMOTE, 1)]
    assert all(frame != other for other in different)
    assert Frame(0x123, b"", REMOTE, 1) != Frame(0x123, b"", REMOTE, 2)
    assert frame != "123#01"


def test_a_frame_has_no_room_for_more() -> None:
    with pytest.raises(AttributeError):
        Frame(1).colour = "red"  # type: ignore[attr-defined]


def test_keys() -> None:
    assert Frame(0x705).key == 0x705
    assert Frame(0x705, b"", REMOTE, 1).key == 0x705 | KEY_REMOTE
    assert Frame(0x705, b"", EXTENDED).key == 0x705 | KEY_EXTENDED
    assert Frame(0x1FFFFFFF, b"", EXTENDED | REMOTE).key < 1 << 31  # an unboxed integer, if ever compiled


@pytest.mark.parametrize(
    ("cob_id", "key"),
    [
        (0x185, 0x185),
        (COB_ID_INVALID | COB_ID_NO_RTR | 0x185, 0x185),
        (0x2000_0185, 0x185 | KEY_EXTENDED),
        (0x3FFF_FFFF, 0x1FFF_FFFF | KEY_EXTENDED),
        (0x0001_F985, 0x185),  # bits 11 to 28 mean nothing in a base frame
    ],
)
def test_key_of_cob_id(cob_id: int, key: int) -> None:
    assert key_of_cob_id(cob_id) == key


@given(st.integers(0, 0xFFFF_FFFF), st.binary(max_size=8))
def test_a_frame_for_a_cob_ids_key_has_that_key(cob_id: int, data: bytes) -> None:
    key = key_of_cob_id(cob_id)
    frame = frame_for_key(key, data)
    assert (frame.key, frame.data, frame.dlc) == (key, data, len(data))
