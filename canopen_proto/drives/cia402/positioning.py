"""The positioning option code 60F2h of profile position mode, as a table of bits.

    bits 0, 1   relative option: what a relative target counts from
    bits 2, 3   change immediately option: no drive is known that has it, and its values are not told in public
    bits 4, 5   request-response option: whether the drive itself clears bit 4 of the controlword
    bits 6, 7   rotary axis direction option: the way to an absolute target of an axis without end (607Bh)

Source: IEC 61800-7-201 (CiA 402-2), 60F2h; ETG.6010, table 78 (directions); the manuals of Nanotec and Novanta.
"""

from __future__ import annotations

import enum
from typing import Final

RELATIVE_OPTION: Final = 0b11
REQUEST_RESPONSE_OPTION: Final = 0b11 << 4
DIRECTION_SHIFT: Final = 6
DIRECTION_OPTION: Final = 0b11 << DIRECTION_SHIFT


class RelativeTo(enum.IntEnum):
    """The position from which a relative target counts: bits 0 and 1 of 0x60F2."""

    PREVIOUS = 0
    """The target before; for the first one, the demand."""
    DEMAND = 1
    """The demand (0x6062) when the target is given."""
    ACTUAL = 2
    """The actual position (0x6064) when the target is given."""


class RequestResponse(enum.IntEnum):
    """When the drive clears bit 4 of the controlword (and bit 12 of the statusword with it): bits 4 and 5 of 0x60F2."""

    BY_MASTER = 0
    """The drive leaves it to the master, as the handshake of the standard has it."""
    WHEN_REACHED = 1
    AT_ONCE = 2


class RotaryDirection(enum.IntEnum):
    """The way to an absolute target of an axis without end, whose positions begin again at the ends of 0x607B: bits 6 and 7 of
    0x60F2."""

    LINEAR = 0
    """As of an axis with ends."""
    NEGATIVE = 1
    POSITIVE = 2
    SHORTEST = 3
    """The shorter way; if both are equal, the positive one."""


OPTION_CODES: Final = frozenset(
    relative | response << 4 | direction << DIRECTION_SHIFT
    for relative in RelativeTo
    for response in RequestResponse
    for direction in RotaryDirection
)
"""The values with a known meaning."""
