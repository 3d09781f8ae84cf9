"""`Finding`: something on a bus that is against the standard, or that will not work."""

from __future__ import annotations

from typing import Final, NamedTuple

from canopen_proto.machine import MICROSECOND, MILLISECOND, Time

INHIBIT_UNIT: Final = 100 * MICROSECOND
"""The unit of inhibit times: of PDOs, and of emergencies (0x1015)."""


class Finding(NamedTuple):
    """A fault. rule: one of RULES (observer.py). node_id: of the device that it concerns; 0 for none. text: for people.

    is_certain: no frames that are missing from the recording, or that came late, can look like this. Else it is likely only.
    """

    rule: str
    node_id: int
    text: str
    is_certain: bool = True


def ms_text(time: Time) -> str:
    """Return a duration for people: "9.5 ms"."""
    return f"{round(time / MILLISECOND, 1):g} ms"
