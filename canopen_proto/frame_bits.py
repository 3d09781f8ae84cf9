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
    bits, count = stuffed_part(frame)
    return count + stuff_bits(bits, count) + FRAME_TAIL


def stuffed_part(frame: Frame) -> tuple[int, int]:
    """Return the bits from SOF to the end of the CRC, before stuffing, as a number with SOF first; and their count."""
    remote = frame.flags & REMOTE
    if frame.flags & EXTENDED:
        # SOF 0, base ID, SRR 1, IDE 1, the other 18 bits, RTR, r1 0, r0 0
        header = ((frame.can_id >> 18) << 2 | 0b11) << 18 | frame.can_id & 0x3FFFF
        bits = (header << 1 | remote) << 6 | frame.dlc
        count = STUFFED_EXTENDED
    else:
        bits = (frame.can_id << 1 | remote) << 6 | frame.dlc  # IDE 0, r0 0
        count = STUFFED_STANDARD
    length = len(frame.data)
    if length:
        bits = bits << 8 * length | int.from_bytes(frame.data, "big")
        count += 8 * length
    return bits << CRC_BITS | crc15(bits), count


def crc15(bits: int) -> int:
    """Return the CRC of a bit string, given as a number with the first bit the highest."""
    table = _crc_table()
    crc = 0
    for byte in bits.to_bytes((bits.bit_length() + 7) // 8, "big"):
        crc = (crc << 8 & 0x7FFF) ^ table[crc >> 7 ^ byte]
    return crc


def stuff_bits(bits: int, count: int) -> int:
    """Return how many stuff bits a string of `count` bits takes, given as a number with the first bit the highest."""
    rest = count & 7
    total, state = _NOTHING_YET
    for place in range(count - 1, count - 1 - rest, -1):
        stuffed, state = _after_bit(state, bits >> place & 1)
        total += stuffed
    table = _stuff_table()
    for byte in (bits & (1 << count - rest) - 1).to_bytes(count // 8, "big"):
        stuffed, state = table[state << 8 | byte]
        total += stuffed
    return total


@cache
def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = crc << 1 ^ (CRC_POLYNOMIAL if crc & 0x4000 else 0)
        table.append(crc & 0x7FFF)
    return tuple(table)


# The state of stuffing: the value of the last bit (0 or 1), and how many equal bits there were (0 at first, else 1 to 4; five
# equal bits become one of the other value). As a number: the value, plus twice the count.
_NOTHING_YET: Final = (0, 0)


def _after_bit(state: int, bit: int) -> tuple[int, int]:
    """Return the stuff bits (0 or 1) that a bit causes, and the state after it."""
    run = (state >> 1) + 1 if state & 1 == bit else 1
    if run == MAX_RUN:
        return 1, 1 << 1 | bit ^ 1
    return 0, run << 1 | bit


@cache
def _stuff_table() -> tuple[tuple[int, int], ...]:
    """Return, for each state and byte, the stuff bits and the state after it."""
    table = []
    for start in range(2 * MAX_RUN):
        for byte in range(256):
            total, state = 0, start
            for place in range(7, -1, -1):
                stuffed, state = _after_bit(state, byte >> place & 1)
                total += stuffed
            table.append((total, state))
    return tuple(table)


MAX_DATA: Final = 64
"""Bytes: a transport of somebody else's may hand over CAN FD, which we cannot use; it must not end the driver."""
FRAME_BITS: Final = tuple((least_bits(length) + worst_bits(length)) // 2 for length in range(MAX_DATA + 1))
"""By the bytes of a frame: its bits, between the least and the most stuffing. Exact counting would cost more than receiving."""
