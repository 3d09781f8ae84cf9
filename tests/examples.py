"""How many examples a property gets, and which cases of a test run every day.

A test that is marked `thorough(3)` takes every day the first of its cases and a third of the others; marked `thorough` alone, it
takes none. Under another profile than SAME, or named on the command line (`tests/core/test_emcy.py::test_x`), it takes all.
Mark so what costs much and whose cases are much alike, and only if the planted bugs that name its file are still found.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from hypothesis import Phase, settings

SAME = "same"
"""The profile of tests/conftest.py for every day: the same examples each time, and few of them."""
FULL = "full"
"""The same with all examples that the tests name; by hand."""
PART = 10
"""Every day the number of examples is divided by this, down to `least` of them."""
LEAST = 5
"""So few are not divided."""

GOLDEN = (5**0.5 - 1) / 2
"""Steps of this size around a circle meet each of its parts equally often. At each n-th case of a test with several parameters,
some values would never come together."""


def examples(count: int, *, steps: int = 50, least: int = LEAST, part: int = PART, explain: bool = True) -> settings:
    """Settings for so many examples (of so many steps, where each is a run of a state machine); see SAME and FULL.

    least: every day too, where fewer would miss a planted bug (fuzz/). part: in place of PART, where one example takes a second.
    explain: False where a test fails on purpose: Hypothesis then does not look for the lines that explain it.

    Under another profile, such as `search`, the number is that of the profile: nothing here keeps a search small.
    """
    profile = settings.get_current_profile_name()
    if profile == SAME:
        count = min(count, max(count // part, least))
    phases = [phase for phase in Phase if explain or phase is not Phase.explain]
    if profile in (SAME, FULL):
        return settings(max_examples=count, stateful_step_count=steps, phases=phases)
    return settings(stateful_step_count=steps, phases=phases)


def takes_all() -> bool:
    """Whether all examples are wanted: what takes minutes runs whole then, and in part every day."""
    return settings.get_current_profile_name() == FULL


def of_every_day(items: Iterable[pytest.Item]) -> Iterator[pytest.Item]:
    """Leave out, of tests that are marked `thorough`, the cases that are not for every day."""
    seen: Counter[tuple[Path, str]] = Counter()
    for item in items:
        mark = item.get_closest_marker("thorough")
        if mark is None:
            yield item
        elif mark.args:
            test = item.path, item.nodeid.partition("[")[0]
            if seen[test] * GOLDEN % 1 < 1 / mark.args[0]:
                yield item
            seen[test] += 1
