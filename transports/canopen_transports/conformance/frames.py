"""The frames that the cases send, and those that they expect."""

from __future__ import annotations

from typing import Final

from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.verdict import ViolationError

EVERY_KIND: Final = (
    *(Frame(0x580 + length, bytes(range(length))) for length in range(9)),
    *(Frame.parse(text) for text in ("000#8000", "7FF#", "00000000#01", "1FFFFFFF#0102030405060708", "000007FF#AA")),
    *(Frame(0x701, b"", REMOTE, dlc) for dlc in range(9)),
    *(Frame.parse(text) for text in ("12345678#R4", "1FFFFFFF#R")),
)
"""Data and remote frames, with 11 and 29 bits, of each length, with the lowest and the highest identifiers."""
IMPOSSIBLE: Final = {
    "identifier too high": Frame(0x800),
    "29-bit identifier too high": Frame(0x20000000, b"", EXTENDED),
    "negative identifier": Frame(-1),
    "nine bytes": Frame(0x601, bytes(9)),
    "remote frame with data": Frame(0x701, b"\1", REMOTE),
    "remote frame with length 9": Frame(0x701, b"", REMOTE, 9),
    "unknown flag": Frame(0x601, b"", 4),
}
"""Frames that classical CAN cannot carry, by the reason."""
END: Final = Frame.parse("7E5#0E")
"""The frame that is sent last."""


def numbered(number: int) -> Frame:
    """Return a frame that carries its number."""
    return Frame(0x100 + number % 0x400, number.to_bytes(4, "little"))


def number_of(frame: Frame) -> int:
    """Return the number that a frame carries."""
    return int.from_bytes(frame.data, "little")


def expect_numbers(seen: list[int], expected: list[int], what: str) -> None:
    """Raise ViolationError unless the lists are equal. Its text shows where they differ, and which numbers are missing or
    surplus. seen: what came. expected: what should have come. what: for the text."""
    if seen == expected:
        return
    place = next(
        (at for at, pair in enumerate(zip(seen, expected, strict=False)) if pair[0] != pair[1]), min(len(seen), len(expected))
    )
    missing, surplus = sorted(set(expected) - set(seen)), sorted(set(seen) - set(expected))
    twice = len(seen) - len(set(seen))
    raise ViolationError(
        f"{what}: {len(seen)} frames instead of {len(expected)}; from place {place} on {seen[place : place + 5]} instead of "
        f"{expected[place : place + 5]}; missing {missing[:5]}, surplus {surplus[:5]}, {twice} more than once"
    )
