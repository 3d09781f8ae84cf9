"""Abort codes, command bytes, segments, short frames (CiA 301 v4.2.0, 7.2.4.3)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode, text_of
from canopen_proto.sdo.codec import (
    EXPEDITED_BITS,
    LEAST_REQUEST,
    LEAST_RESPONSE,
    REQUESTS,
    RESPONSES,
    SdoFrame,
    announced_size,
    complete,
    expedited_data,
    segment,
    segment_data,
)

TABLE_22 = """
    05030000 05040000 05040001 05040002 05040003 05040004 05040005 06010000 06010001 06010002 06020000 06040041 06040042 06040043
    06040047 06060000 06070010 06070012 06070013 06090011 06090030 06090031 06090032 06090036 060A0023 08000000 08000020 08000021
    08000022 08000023 08000024
"""


def test_every_abort_code_of_table_22_has_its_own_text() -> None:
    codes = [int(code, 16) for code in TABLE_22.split()]
    assert sorted(AbortCode) == codes
    assert len({text_of(code) for code in codes}) == len(codes)
    assert text_of(0x06090030) == "invalid value for parameter"


@given(st.integers(0, 0xFFFFFFFF))
def test_every_number_has_a_text(code: int) -> None:
    assert text_of(code)


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0x06010006, "access error outside of CiA 301 (0x06010006)"),
        (0x12345678, "error outside of CiA 301 (0x12345678)"),
    ],
)
def test_codes_beyond_the_table_are_told_as_far_as_known(code: int, text: str) -> None:
    assert text_of(code) == text


def test_expedited_bits_are_those_of_the_standard() -> None:
    assert [f"{0x20 | EXPEDITED_BITS[size]:02X}" for size in (1, 2, 3, 4)] == ["2F", "2B", "27", "23"]
    assert [f"{0x40 | EXPEDITED_BITS[size]:02X}" for size in (1, 2, 3, 4)] == ["4F", "4B", "47", "43"]


@given(st.binary(max_size=300))
def test_segments_put_together_are_the_content(content: bytes) -> None:
    joined = b""
    toggle = 0
    for offset in range(0, max(len(content), 1), 7):
        data = segment(toggle, content, offset)
        assert len(data) == 8
        assert data[0] & 0x10 == toggle
        unused = data[0] >> 1 & 7
        assert not any(data[8 - unused :])
        joined += data[1 : 8 - unused]
        assert bool(data[0] & 1) == (joined == content)
        toggle ^= 0x10
    assert joined == content


@pytest.mark.parametrize(
    ("request_", "whole"),
    [
        ("40181001", "4018100100000000"),
        ("60", "6000000000000000"),
        ("2B17100000 10", "2B17100000100000"),
        ("2B17100000", None),  # two bytes announced, one is there
        ("22171000 01", "2217100001000000"),  # size not indicated: at least one
        ("22171000", None),
        ("2117100005", "2117100005000000"),
        ("0D41", "0D41000000000000"),
        ("0D", None),
        ("80171000", "8017100000000000"),
        ("401810", None),
        ("A4", "A400000000000000"),
        ("", None),
    ],
)
def test_short_requests_are_filled_up_if_what_they_announce_is_there(request_: str, whole: str | None) -> None:
    assert complete(bytes.fromhex(request_), LEAST_REQUEST) == (None if whole is None else bytes.fromhex(whole))


@pytest.mark.parametrize(
    ("response", "whole"),
    [
        ("60171000", "6017100000000000"),
        ("601710", None),
        ("20", "2000000000000000"),
        ("4B411000 3702", "4B41100037020000"),
        ("4B411000 37", None),
        ("00414243", None),
        ("0741424344", "0741424344000000"),
    ],
)
def test_so_are_short_responses(response: str, whole: str | None) -> None:
    assert complete(bytes.fromhex(response), LEAST_RESPONSE) == (None if whole is None else bytes.fromhex(whole))


def test_what_is_longer_than_a_frame_is_cut() -> None:
    assert complete(bytes(9), LEAST_REQUEST) == bytes(8)


@pytest.mark.parametrize(
    ("what", "requests", "responses"),
    [
        (SdoFrame.DOWNLOAD, "20 2F 23 3C", "60 7F"),
        (SdoFrame.UPLOAD, "40 5F", "40 42 4F"),
        (SdoFrame.DOWNLOAD_SEGMENT, "00 0D 1F", "20 30 3F"),
        (SdoFrame.UPLOAD_SEGMENT, "60 70 7F", "00 0D 1F"),
        (SdoFrame.ABORT, "80 9F", "80 9F"),
        (SdoFrame.BLOCK_DOWNLOAD, "C0 C2 C6", "A0 A4"),
        (SdoFrame.BLOCK_UPLOAD, "A0 A4", "C0 C2 C6"),
        (SdoFrame.BLOCK_START, "A3 BF", ""),
        (SdoFrame.BLOCK_ACKNOWLEDGEMENT, "A2 BE", "A2 BE"),
        (SdoFrame.BLOCK_END, "C1 D9 DD", "C1 D9 DD"),
        (SdoFrame.BLOCK_END_RESPONSE, "A1 BD", "A1 BD"),
        (SdoFrame.UNKNOWN, "E0 FF C3", "E0 FF C3"),
    ],
)
def test_the_command_byte_names_the_frame(what: SdoFrame, requests: str, responses: str) -> None:
    assert {REQUESTS[command] for command in bytes.fromhex(requests)} == {what}
    assert all(RESPONSES[command] is what for command in bytes.fromhex(responses))


def test_frames_taken_apart() -> None:
    frames = [bytes.fromhex(text) for text in ("4F 00 20 00 01 02 03 04", "42 00 20 00 01 02 03 04", "41 00 20 00 01 02 00 00")]
    assert [expedited_data(frame) for frame in frames] == [b"\1", b"\1\2\3\4", None]
    assert announced_size(frames[2]) == 0x201
    assert announced_size(bytes.fromhex("40 00 20 00 01 00 00 00")) is None
    assert [announced_size(bytes.fromhex(f"{command} 00 20 00 07 00 00 00")) for command in ("C0", "C2", "C4")] == [None, 7, None]
    assert [segment_data(segment(0, b"abcdefghi", offset)) for offset in (0, 7)] == [b"abcdefg", b"hi"]
