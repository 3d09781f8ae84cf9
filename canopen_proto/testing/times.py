"""`nanoseconds`: a time of a test, checked at once: in a world, seconds that were meant are the mistake that shows late."""

from __future__ import annotations

from operator import index
from typing import Final, SupportsIndex

from canopen_proto.machine import MICROSECOND, LocalProtocolError, Time

SHORTEST: Final = 1 * MICROSECOND
"""The shortest time that is no mistake, but for 0: that of a bit at 1 Mbit/s."""


def nanoseconds(value: SupportsIndex | float, what: str) -> Time:
    """Return a time or a duration as whole ns. value: ns, 0 or more; a float is what `0.5 * SECOND` makes. what: for the text.

    Raises LocalProtocolError for what is no time, or must be one in seconds.
    """
    __tracebackhide__ = True
    if isinstance(value, bool) or not isinstance(value, SupportsIndex | float):
        raise LocalProtocolError(f"{what} is {value!r}: it takes nanoseconds, such as 100 * MILLISECOND or 2 * SECOND")
    if not isinstance(value, float):
        value = index(value)
    if value < 0:
        raise LocalProtocolError(f"{what} is {value}: a time is never negative")
    if 0 < value < SHORTEST:
        seen = f"{value:g}"
        raise LocalProtocolError(f"{what} is {seen}: times are nanoseconds here; {seen} seconds are {seen} * SECOND")
    try:
        return round(value)
    except (ValueError, OverflowError):
        raise LocalProtocolError(f"{what} is {value}: use NEVER for what has no end") from None
