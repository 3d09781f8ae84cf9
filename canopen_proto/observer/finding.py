"""`Finding`: something on a bus that is against the standard, or that will not work."""

from __future__ import annotations

from typing import NamedTuple


class Finding(NamedTuple):
    """A fault. rule: one of RULES (observer.py). node_id: of the device that it concerns; 0 for none. text: for people."""

    rule: str
    node_id: int
    text: str
