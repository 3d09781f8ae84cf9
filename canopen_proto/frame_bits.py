"""The length of a classical CAN frame in bits: exact, least and most (ISO 11898-1; Bosch CAN specification 2.0).

A frame on the wire, in bits:

    11-bit   SOF 1 | ID 11 | RTR 1 | IDE 1 | r0 1 | DLC 4 | data 8n | CRC 15             34 + 8n
    29-bit   SOF 1 | ID 11 | SRR 1 | IDE 1 | ID 18 | RTR 1 | r1 r0 2 | DLC 4 | data 8n | CRC 15     54 + 8n
    then     CRC delimiter 1 | ACK slot 1 | ACK delimiter 1 | EOF 7 | intermission 3          13

The first part is stuffed: after five equal bits the transmitter inserts one of the other value, which counts as the first of the
next five. So at worst there is one stuff bit after the first five bits and one after each four that follow. Their number depends
on identifier, length, data and CRC; this module counts them on the bits of the wire.

The intermission is part of the length: no other frame begins before it is over. The CRC has the generator polynomial 0x4599 and
starts with 0, so zeros before the frame do not change it; therefore the bits can be taken a byte at a time from the end.
"""

from __future__ import annotations

from functools import cache
from typing import Final

from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.machine import SECOND, Time

CRC_BITS: Final = 15
CRC_POLYNOMIAL: Final = 0x4599
INTERMISSION: Final = 3
FRAME_TAIL: Final = 10 + INTERMISSION
"""CRC delimiter, ACK slot, ACK delimiter, EOF, intermission: never stuffed."""
STUFFED_STANDARD: Final = 34
"""Stuffed bits of a frame without data, before stuffing."""
STUFFED_EXTENDED: Final = 54
MAX_RUN: Final = 5
"""After so many equal bits comes a stuff bit."""


def duration(bits: int, bitrate: int) -> Time:
    """Return the time of so many bits, in ns, rounded. bitrate: bit/s."""
    return (bits * SECOND + bitrate // 2) // bitrate


def least_bits(data_length: int, *, extended: bool = False) -> int:
    """Return the length of a frame without any stuff bit: 8n + 47, or 8n + 67 with a 29-bit identifier. data_length: 0 to 8
    bytes."""
    return (STUFFED_EXTENDED if extended else STUFFED_STANDARD) + 8 * data_length + FRAME_TAIL


def worst_bits(data_length: int, *, extended: bool = False) -> int:
    """Return the length of a frame with the most stuff bits possible. data_length: 0 to 8 bytes. extended: with a 29-bit
    identifier."""
    stuffed = (STUFFED_EXTENDED if extended else STUFFED_STANDARD) + 8 * data_length
    return stuffed + FRAME_TAIL + (stuffed - 1) // (MAX_RUN - 1)


def frame_bits(frame: Frame) -> int:
    """Return the exact length of this frame, from SOF to the end of the intermission."""
    # The header is filled up to whole bytes by bits in turn, the last one unlike SOF: they take no stuff bit and lengthen no run.
    # The CRC begins with the same bits, so that they leave nothing of it.
    if frame.flags & EXTENDED:
        head, high, total = (1 << 39 | _header(frame)).to_bytes(5, "big"), 0x80, STUFFED_EXTENDED
    else:
        head, high, total = (0b10101 << 19 | _header(frame)).to_bytes(3, "big"), 0b10101 << 3, STUFFED_STANDARD
    (highs, lows), (counts, states) = _crc_tables(), _stuff_tables()
    low = state = 0
    for byte in head + frame.data:
        place = high ^ byte
        high, low = low ^ highs[place], lows[place]
        state |= byte
        total += counts[state]
        state = states[state]
    state |= high
    last = states[state] | low | low >> 1 & 1 ^ 1  # one bit more than the CRC has, unlike the one before it
    return total + counts[state] + counts[last] + 8 * len(frame.data) + FRAME_TAIL


def _header(frame: Frame) -> int:
    """Return the bits from SOF to the DLC as a number: 19 of them, or 39 of an extended frame."""
    remote = frame.flags & REMOTE
    if frame.flags & EXTENDED:
        # SOF 0, base ID, SRR 1, IDE 1, the other 18 bits, RTR, r1 0, r0 0
        identifier = ((frame.can_id >> 18) << 2 | 0b11) << 18 | frame.can_id & 0x3FFFF
        return (identifier << 1 | remote) << 6 | frame.dlc
    return (frame.can_id << 1 | remote) << 6 | frame.dlc  # IDE 0, r0 0


def stuffed_part(frame: Frame) -> tuple[int, int]:
    """Return the bits from SOF to the end of the CRC, before stuffing, as a number with SOF first; and their count."""
    bits, count = _header(frame), STUFFED_EXTENDED if frame.flags & EXTENDED else STUFFED_STANDARD
    length = len(frame.data)
    if length:
        bits = bits << 8 * length | int.from_bytes(frame.data, "big")
        count += 8 * length
    return bits << CRC_BITS | crc15(bits), count


def crc15(bits: int) -> int:
    """Return the CRC of a bit string, given as a number with the first bit the highest."""
    highs, lows = _crc_tables()
    high = low = 0
    for byte in bits.to_bytes((bits.bit_length() + 7) // 8, "big"):
        place = high ^ byte
        high, low = low ^ highs[place], lows[place]
    return high << 7 | low >> 1


def stuff_bits(bits: int, count: int) -> int:
    """Return how many stuff bits a string of `count` bits takes, given as a number with the first bit the highest."""
    counts, states = _stuff_tables()
    rest = -count & 7  # filled up as in `frame_bits`
    filling = (0xAA if bits << 1 >> count else 0x55) & (1 << rest) - 1
    total = state = 0
    for byte in (filling << count | bits).to_bytes((count + rest) // 8, "big"):
        state |= byte
        total += counts[state]
        state = states[state]
    return total


@cache
def _crc_tables() -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return, for each byte, its CRC: the 8 higher bits, and the 7 lower ones, which stand where the next byte has them."""
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = crc << 1 ^ (CRC_POLYNOMIAL if crc & 0x4000 else 0)
        table.append(crc & 0x7FFF)
    return tuple(crc >> 7 for crc in table), tuple((crc & 0x7F) << 1 for crc in table)


def _after_bit(bit: int, last: int, run: int) -> tuple[int, int, int]:
    """Return the stuff bits (0 or 1) that a bit causes, and the last bit and its run after it. run: 0 before the first bit."""
    run = run + 1 if bit == last else 1
    return (1, bit ^ 1, 1) if run == MAX_RUN else (0, bit, run)


@cache
def _stuff_tables() -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return, for each state and byte behind it, the stuff bits, and the state after it.

    A state is the value of the last bit (0 or 1), plus twice its run (0 at first, else 1 to 4; five equal bits become one of the
    other value). It stands where a byte can be added to it.
    """
    counts, states = [], []
    for start in range(2 * MAX_RUN):
        for byte in range(256):
            total, last, run = 0, start & 1, start >> 1
            for place in range(7, -1, -1):
                stuffed, last, run = _after_bit(byte >> place & 1, last, run)
                total += stuffed
            counts.append(total)
            states.append((run << 1 | last) << 8)
    return tuple(counts), tuple(states)


MAX_DATA: Final = 64
"""Bytes: a transport of somebody else's may hand over CAN FD, which we cannot use; it must not end the driver."""
FRAME_BITS: Final = tuple((least_bits(length) + worst_bits(length)) // 2 for length in range(MAX_DATA + 1))
"""By the bytes of a frame: its bits, between the least and the most stuffing. Exact counting would cost more than receiving."""
