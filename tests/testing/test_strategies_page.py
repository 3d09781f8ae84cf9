"""docs/strategies.md: each of its examples runs, and it has each strategy, in a table and in an example."""

from __future__ import annotations

import inspect
import re
from unittest import TestCase

import pytest

from canopen_testing import strategies
from tests.docs_build import DOCS
from tests.examples import examples

PAGE = (DOCS / "strategies.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
NAMES = [name for name in strategies.__all__ if not inspect.isclass(getattr(strategies, name))]


@pytest.mark.thorough(12)
@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_each_example_runs(number: int) -> None:
    names: dict[str, object] = {"__name__": f"example_{number}"}
    exec(compile(BLOCKS[number], f"strategies.md, block {number}", "exec"), names)
    tests = [each for name, each in names.items() if name.startswith(("test_", "Test")) and callable(each)]
    assert tests
    for each in tests:
        if isinstance(each, type) and issubclass(each, TestCase):
            each.settings = examples(10, steps=20)  # type: ignore[attr-defined]
            each("runTest").debug()
        else:
            each()


@pytest.mark.parametrize("name", NAMES)
def test_each_strategy_is_in_the_table_and_in_an_example(name: str) -> None:
    assert re.search(rf"^\| `{name}` \|", PAGE, re.MULTILINE)
    assert any(re.search(rf"\b{name}\(", block) for block in BLOCKS)
