"""Times as people write them: "500ms", "2s", "100us". Inside, a time is a whole number of nanoseconds."""

from __future__ import annotations

import re
from typing import Final

from canopen_proto.machine import Time

_UNITS: Final = {"us": 1_000, "ms": 1_000_000, "s": 1_000_000_000, "min": 60_000_000_000}
_TIME: Final = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*(us|ms|s|min|)\s*")


def parse_duration(text: str) -> Time:
    """Return the ns in a text such as "500ms"; only 0 needs no unit. Raises ValueError with the reason."""
    match = _TIME.fullmatch(text)
    if match is None or len(text) > 40:
        raise ValueError(f"{text[:40]!r} is not a time such as 500ms or 2s")
    if not match[2] and float(match[1]):
        raise ValueError(f"{text!r} has no unit: {match[1]}ms or {match[1]}s")
    return round(float(match[1]) * _UNITS.get(match[2], 0))


def duration_text(time: Time) -> str:
    """Return a time so that `parse_duration` gives it back: "500ms", "2s", "0.5us"."""
    for unit in ("s", "ms", "us"):
        if time % _UNITS[unit] == 0:
            return f"{time // _UNITS[unit]}{unit}"
    return f"{time // 1000}.{time % 1000:03d}us"
