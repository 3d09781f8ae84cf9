"""Long calculations in steps, for callers that must not stand still: a check of a path of thousands of segments takes a second.

A generator yields after each part of its work, and returns its result. `finished` runs one to its end; a caller that has other
work to do, such as the next SYNC, does it whenever the generator yields.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Final, TypeVar

T = TypeVar("T")

PART: Final = 32
"""Segments of one joint between two steps: some 0.5 ms in pure Python."""


def finished(steps: Generator[None, None, T]) -> T:
    """Do all steps at once, and return the result."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: T = end.value
            return result
