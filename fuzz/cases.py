"""Run as many random cases of a property as one likes, each known by its number."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

COUNT = 1000

Case = TypeVar("Case")


def run_cases(
    name: str, plural: str, case_of: Callable[[int], Case], judge: Callable[[Case], object], arguments: list[str]
) -> int:
    """Judge so many cases from a number on: [FIRST [COUNT]]. The exit status: 0, or 1 if one has failed, which is printed."""
    first, count = [*map(int, arguments), *(0, COUNT)[len(arguments) :]]
    failed = 0
    for number in range(first, first + count):
        case = case_of(number)
        try:
            judge(case)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is told and counted
            failed += 1
            print(f"{name} {number} has failed: {case}\n    {type(error).__name__}: {error}", flush=True)
    print(f"{count} {plural} from {first} on: {failed} failed, {time.process_time():.0f} s of CPU time")
    return int(failed > 0)
