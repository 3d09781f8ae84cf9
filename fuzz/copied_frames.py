"""Frames that come twice, get lost or are held up: what an SDO client says of its requests is true.

The model and the oracle are those of tests/core/test_sdo_copies.py. A case is known by its number, so one that fails is repeated
by `python -m fuzz copied_frames NUMBER 1`.
"""

from __future__ import annotations

import random

from fuzz.cases import run_cases
from tests.core.test_sdo_copies import Case, case_of, judge


def case(number: int) -> Case:
    """Return the requests and the fates of the frames."""
    return case_of(random.Random(number))


def main(arguments: list[str]) -> int:
    """Play so many cases; see run_cases."""
    return run_cases("case", "cases", case, judge, arguments)
