"""Times as users give them: seconds. Each function that takes some checks them here, before it does anything."""

from __future__ import annotations

import math
from numbers import Real

from canopen_proto.machine import SECOND, LocalProtocolError, Time


def check_seconds(name: str, seconds: object, *, above_zero: bool = False, finite: bool = True) -> float:
    """Return a time in seconds. Raises LocalProtocolError for what is no number, not a number, or negative.

    name: of the argument, for the text. above_zero: 0 is refused too. finite: so is infinity.
    """
    wanted = f"give {'a finite number of ' * finite}seconds, {'above 0' if above_zero else '0 or more'}"
    if isinstance(seconds, Real) and not isinstance(seconds, bool):
        try:
            found = float(seconds)
        except OverflowError:  # a whole number, perhaps too long to be shown
            raise LocalProtocolError(f"{name} is larger than any time; {wanted}") from None
        if (found > 0 or (found == 0 and not above_zero)) and not (finite and math.isinf(found)):
            return found
    raise LocalProtocolError(f"{name} is {seconds!r}; {wanted}")


def nanoseconds(name: str, seconds: object, *, above_zero: bool = False) -> Time:
    """Return a time in ns, as machines take it; see `check_seconds`."""
    return round(check_seconds(name, seconds, above_zero=above_zero) * SECOND)
