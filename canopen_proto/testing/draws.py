"""`Draws`: numbers drawn from a seed, the same in every process and every version of Python.

SplitMix64 (G. L. Steele, D. Lea, C. H. Flood: "Fast splittable pseudorandom number generators", OOPSLA 2014). The core cannot
import `random`, which asks the operating system for a seed, and whose methods may draw otherwise in another version.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, TypeVar

T = TypeVar("T")

_MASK: Final = (1 << 64) - 1
_GOLDEN: Final = 0x9E3779B97F4A7C15


class Draws:
    """See this module's text. name: what the numbers are for; with the seed it says which numbers they are."""

    def __init__(self, name: str, seed: int) -> None:
        state = seed & _MASK
        for byte in name.encode():
            state = _mixed(state + byte * _GOLDEN & _MASK)
        self._state = state

    def between(self, least: int, most: int) -> int:
        """Return a number from `least` to `most`, both included."""
        self._state = self._state + _GOLDEN & _MASK
        return least + (_mixed(self._state) * (most - least + 1) >> 64)

    def happens(self, chance: float) -> bool:
        """Return True with this chance, 0 to 1."""
        return chance >= 1 or self.between(0, (1 << 53) - 1) < chance * (1 << 53)

    def choice(self, of: Sequence[T]) -> T:
        """Return one of these; there is at least one."""
        return of[self.between(0, len(of) - 1)]


def _mixed(state: int) -> int:
    state = (state ^ state >> 30) * 0xBF58476D1CE4E5B9 & _MASK
    state = (state ^ state >> 27) * 0x94D049BB133111EB & _MASK
    return state ^ state >> 31
