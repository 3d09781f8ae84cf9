"""Which cases of a test run every day, and in which order workers take the files: see examples.py and workers.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.examples import of_every_day


class Item:
    """What is read of pytest's."""

    def __init__(self, name: str, *marks: Any) -> None:
        self.path, self.nodeid, self._marks = Path("test_it.py"), f"test_it.py::test_{name}", marks

    def get_closest_marker(self, name: str) -> Any:
        return next((mark.mark for mark in self._marks if mark.mark.name == name), None)


def chosen(items: list[Any]) -> list[str]:
    return [item.nodeid.removeprefix("test_it.py::test_") for item in of_every_day(items)]


def test_of_a_thorough_test_an_nth_of_the_cases_runs_every_day_and_of_one_without_a_number_none() -> None:
    items: list[Any] = [Item(f"some[{number}]", pytest.mark.thorough(3)) for number in range(300)]
    items.insert(3, Item("never", pytest.mark.thorough))
    names = chosen(items)
    assert names[0] == "some[0]"
    assert 99 <= len(names) <= 101
    assert chosen([Item("each[0]"), Item("each[1]")]) == ["each[0]", "each[1]"]


@pytest.mark.parametrize("part", [2, 3, 4])
def test_each_value_of_a_parameter_comes_with_each_of_another(part: int) -> None:
    for count in (2, 3, 4, 6, 12):
        cases = [(number, value) for number in range(10 * part) for value in range(count)]
        names = chosen([Item(f"some[{number}-{value}]", pytest.mark.thorough(part)) for number, value in cases])
        taken = [int(name.partition("-")[2][:-1]) for name in names]
        assert min(map(taken.count, range(count))) >= 5


def test_workers_take_each_test_once_and_between_files_that_wait_two_that_compute() -> None:
    pytest.importorskip("xdist", reason="pytest-xdist is not installed: the extra `test` has it")
    from tests.workers import FEW_BUT_LONG, WAITING, longest_first

    class Named:
        def __init__(self, nodeid: str) -> None:
            self.nodeid = nodeid

    files = [f"core/test_{size}.py" for size in range(9)]
    files += [FEW_BUT_LONG[0], WAITING[1], WAITING[0]]
    items: list[Any] = [Named(f"tests/{file}::test[{number}]") for file in files for number in range(1 + files.index(file) % 9)]
    ordered = longest_first(items)
    assert {*ordered} == {*items}
    assert len(ordered) == len(items)
    taken = list(dict.fromkeys(item.nodeid.partition("::")[0].removeprefix("tests/") for item in ordered))
    assert taken[:6] == [WAITING[0], FEW_BUT_LONG[0], "core/test_8.py", WAITING[1], "core/test_7.py", "core/test_6.py"]
    assert taken[-1] == "core/test_0.py"
    assert [item.nodeid for item in ordered if "test_3" in item.nodeid] == [f"tests/core/test_3.py::test[{n}]" for n in range(4)]
