"""Clean recordings with frames dropped, copied, delayed and held back: the observer says nothing but that frames are missing.

The model and the oracle are those of tests/observer/test_observer_gaps.py. A recording is known by its number, so one that fails
is repeated by `python -m fuzz damaged_recordings NUMBER 1`.
"""

from __future__ import annotations

import random

from fuzz.cases import run_cases
from tests.observer.observer_sessions import CLEAN
from tests.observer.test_observer_gaps import judge


def recording(number: int) -> tuple[int, int]:
    """Return the number of a clean recording, and the seed of its damage."""
    chance = random.Random(number)
    return chance.randrange(CLEAN), chance.randrange(10**9)


def main(arguments: list[str]) -> int:
    """Damage so many recordings; see run_cases."""
    return run_cases("recording", "recordings", recording, lambda each: judge(*each), arguments)
