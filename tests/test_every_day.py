"""Which cases of a test run every day: see examples.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.examples import of_every_day

NAMES = ["some[0-a]", "some[1-b]", "some[3-a]", "each[0]", "each[1]"]


class Item:
    """What is read of pytest's."""

    def __init__(self, name: str, *marks: Any) -> None:
        self.path, self.nodeid, self._marks = Path("test_it.py"), f"test_it.py::test_{name}", marks

    def get_closest_marker(self, name: str) -> Any:
        return next((mark.mark for mark in self._marks if mark.mark.name == name), None)


def test_of_a_thorough_test_each_nth_case_runs_every_day_and_of_one_without_a_number_none() -> None:
    third = pytest.mark.thorough(3)
    items: list[Any] = [Item(f"some[{number}-{other}]", third) for number in range(4) for other in "ab"]
    items.insert(3, Item("never", pytest.mark.thorough))
    items += [Item("each[0]"), Item("each[1]")]
    assert [item.nodeid.partition("test_it.py::test_")[2] for item in of_every_day(items)] == NAMES
