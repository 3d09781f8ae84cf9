"""Restores while frames get lost and come twice: one that is told as done is done, and of no other one anything half done lives.

The oracle is that of tests/manager/test_restore.py. A restore is known by its number, so one that fails is repeated by
`python -m fuzz lossy_restores NUMBER 1`.
"""

from __future__ import annotations

import random

from canopen_proto.datatypes import Value
from fuzz.cases import run_cases
from tests.core.bus import CAN_FATES, Fate
from tests.manager.restore_bench import CHANGES
from tests.manager.test_restore import judge

MOST_FATES = 60


def case(number: int) -> tuple[dict[int, Value], list[Fate], bool, int]:
    """Return the values, the fates of the frames, whether each write is read back, and how many frames go well before.

    Half of the cases have copies alone: most restores get to their end then.
    """
    chance = random.Random(number)
    values = {key: value for key, value in CHANGES.items() if chance.random() < 0.3}
    kinds = chance.choice(([*CAN_FATES, *[Fate.DELIVERED] * 3], [Fate.DELIVERED, Fate.COPIED]))
    fates = [chance.choice(kinds) for _ in range(chance.randint(0, MOST_FATES))]
    return values, fates, chance.random() < 0.3, chance.choice((0, chance.randrange(40)))


def main(arguments: list[str]) -> int:
    """Carry so many restores out; see run_cases."""
    return run_cases("restore", "restores", case, lambda each: judge(*each), arguments)
