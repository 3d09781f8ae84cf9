"""How long frames are: against frames that were counted by hand, and against the published bounds."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.frame_bits import crc15, stuff_bits, stuffed_part
from canopen_transports.wire import duration, frame_bits, least_bits, worst_bits


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    flags = draw(st.sampled_from([0, REMOTE, EXTENDED, EXTENDED | REMOTE]))
    can_id = draw(st.integers(0, 0x1FFFFFFF if flags & EXTENDED else 0x7FF))
    if flags & REMOTE:
        return Frame(can_id, b"", flags, draw(st.integers(0, 8)))
    byte = st.one_of(st.sampled_from([0x00, 0xFF, 0x0F, 0xF0, 0xC3, 0x3C]), st.integers(0, 255))
    return Frame(can_id, bytes(draw(st.lists(byte, max_size=8))), flags)


def on_paper(frame: Frame) -> str:
    """The bits of a frame before stuffing, field by field as the standard has them, the CRC bit by bit."""
    remote = "1" if frame.flags & REMOTE else "0"
    length = f"{frame.dlc:04b}"
    if frame.flags & EXTENDED:
        identifier = f"{frame.can_id:029b}"
        bits = "0" + identifier[:11] + "1" + "1" + identifier[11:] + remote + "0" + "0" + length
    else:
        bits = "0" + f"{frame.can_id:011b}" + remote + "0" + "0" + length
    bits += "".join(f"{byte:08b}" for byte in frame.data)
    register = [0] * 15
    for bit in bits:
        feedback = int(bit) ^ register[0]
        register = [*register[1:], 0]
        if feedback:
            register = [a ^ b for a, b in zip(register, map(int, f"{0x4599:015b}"), strict=True)]
    return bits + "".join(map(str, register))


def stuffed(bits: str) -> str:
    out = ""
    for bit in bits:
        out += bit
        if len(out) >= 5 and len(set(out[-5:])) == 1:
            out += "0" if bit == "1" else "1"
    return out


@given(frames())
def test_the_bits_are_those_of_the_standard(frame: Frame) -> None:
    bits, count = stuffed_part(frame)
    assert f"{bits:0{count}b}" == on_paper(frame)
    assert frame_bits(frame) == len(stuffed(on_paper(frame))) + 13


@given(frames())
def test_the_length_lies_between_the_bounds(frame: Frame) -> None:
    extended = bool(frame.flags & EXTENDED)
    length = len(frame.data)
    assert least_bits(length, extended=extended) <= frame_bits(frame) <= worst_bits(length, extended=extended)


def test_the_bounds_are_the_published_ones() -> None:
    for length in range(9):
        assert least_bits(length) == 8 * length + 47
        assert least_bits(length, extended=True) == 8 * length + 67
        # C = g + 8s + 13 + floor((g + 8s - 1) / 4) with g = 34 or 54: Davis, Burns, Bril, Lukkien 2007, equation 1
        assert worst_bits(length) == 34 + 8 * length + 13 + (34 + 8 * length - 1) // 4 == 55 + 10 * length
        assert worst_bits(length, extended=True) == 54 + 8 * length + 13 + (54 + 8 * length - 1) // 4 == 80 + 10 * length


def test_a_frame_of_zeros() -> None:
    """ID, RTR, IDE, r0, DLC and CRC are 0: 34 zeros. A stuff bit breaks each run of five: after 5, 10, 15, 20, 25 and 30."""
    frame = Frame.parse("000#")
    assert stuffed_part(frame) == (0, 34)
    assert frame_bits(frame) == 47 + 6


def test_a_sync() -> None:
    """0000, 1, then 16 zeros with three stuff bits (after 5, 10 and 15), 111, 7 zeros with one, 101."""
    frame = Frame.parse("080#")
    bits, count = stuffed_part(frame)
    sof, identifier, rtr_ide_r0, dlc, crc = "0", "00010000000", "000", "0000", "001110000000101"
    assert f"{bits:0{count}b}" == sof + identifier + rtr_ide_r0 + dlc + crc
    assert frame_bits(frame) == 47 + 4


def test_a_frame_without_any_stuff_bit() -> None:
    """RTR, IDE and r0 are 0 and so may be the first bits of the DLC: below 4 bytes there is a run of five always."""
    frame = Frame.parse("555#A65A5A6A")
    bits, count = stuffed_part(frame)
    sof, identifier, rtr_ide_r0, dlc, crc = "0", "10101010101", "000", "0100", "001001010110000"
    assert f"{bits:0{count}b}" == sof + identifier + rtr_ide_r0 + dlc + f"{0xA65A5A6A:032b}" + crc
    assert frame_bits(frame) == least_bits(4) == 79


def test_nearly_as_many_stuff_bits_as_there_can_be() -> None:
    """Its data are runs of four, each of which takes a stuff bit. No real frame reaches the bound itself: the zeros of RTR, IDE
    and r0 stand where it would need ones."""
    frame = Frame.parse("7FE#3C3C3C3C3C3C2E04")
    assert frame_bits(frame) == 131
    assert worst_bits(8) == 135


@pytest.mark.parametrize(
    ("frame", "bits"),
    [
        ("000#", 53),
        ("080#", 51),
        ("555#A65A5A6A", 79),
        ("7FE#3C3C3C3C3C3C2E04", 131),
        ("705#7F", 58),
        ("705#R", 49),
        ("603#4000100000000000", 124),
        ("1FFFFFFF#", 74),
        ("00000000#0000000000000000", 150),
        ("1ABCDEF0#R", 70),
    ],
)
def test_as_can_utils_counts_them(frame: str, bits: int) -> None:
    """What `canbusload -e` of can-utils (exact calculation of stuffed bits) said of these frames on a vcan."""
    assert frame_bits(Frame.parse(frame)) == bits


def test_runs_of_four_reach_the_bound() -> None:
    """0 and then 0000 1111 0000 ...: the bits that the bound is about."""
    for count in range(1, 99):
        bits = ("0" + "00001111" * 13)[:count]
        assert stuff_bits(int(bits, 2), count) == (count - 1) // 4


@pytest.mark.parametrize(
    ("bits", "expected"),
    [
        ("00000", 1),  # also after the last bit: the receiver expects it
        ("0000", 0),
        ("000001111", 2),  # the stuff bit 1 is the first of the next five
        ("0000011110000", 3),
        ("1111100001111", 3),
        ("0000000000", 2),  # after 5 zeros, then after 5 more: a stuff bit 1 between them breaks the run
        ("01" * 20, 0),
    ],
)
def test_stuff_bits_by_hand(bits: str, expected: int) -> None:
    assert stuff_bits(int(bits, 2), len(bits)) == expected == len(stuffed(bits)) - len(bits)


def test_a_run_of_zeros_takes_one_stuff_bit_for_each_five() -> None:
    assert [stuff_bits(0, count) for count in (4, 5, 9, 10, 15)] == [0, 1, 1, 2, 3]


def test_the_crc_is_the_register_of_the_standard() -> None:
    assert crc15(0) == 0
    assert crc15(1) == 0x4599
    assert crc15(0b10) == 0x4599 << 1 & 0x7FFF ^ 0x4599  # shifted once more, with a 1 that falls out


def test_durations_are_rounded_to_the_nearest_nanosecond() -> None:
    assert duration(125, 125_000) == 1_000_000
    assert duration(1, 1_000_000) == 1_000
    assert duration(1, 83_333) == 12_000
    assert duration(3, 800_000) == 3_750
