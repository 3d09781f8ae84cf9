"""Random lives of devices that get a new program: how they lie, fail, and lose their power.

The model and the oracle are those of tests/manager/test_program_identity.py. A life is known by its number: the same number gives
the same life, so one that fails is repeated by `python -m fuzz flash_lives NUMBER 1`.
"""

from __future__ import annotations

import random

from fuzz.cases import run_cases
from tests.manager.test_program_identity import FALLS, IDENTITIES, LONGEST, VERSIONS, Ways, judge


def life(number: int) -> tuple[Ways, bool, bool, bool]:
    """Return a device, whether the identity of the program is known, and whether "not verified" and "confirm" are wanted."""
    chance = random.Random(number)
    ways = Ways(
        identity=chance.choice(IDENTITIES),
        version=chance.choice(VERSIONS),
        has_status=chance.random() < 0.5,
        falls=chance.choice(FALLS),
        drops=chance.random() < 0.5,
        trial=chance.random() < 0.5,
        cut=chance.choice([None, chance.randrange(LONGEST)]),
    )
    return ways, chance.random() < 0.5, chance.random() < 0.5, chance.random() < 0.5


def main(arguments: list[str]) -> int:
    """Live so many lives; see run_cases."""
    return run_cases("life", "lives", life, lambda lived: judge(*lived), arguments)
