"""The examples of docs/testing.md are tests, and run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from canopen_check.catalogue import CASES
from canopen_proto import testing
from canopen_proto.observer.observer import RULES
from canopen_proto.testing import faults

pytest_plugins = "pytester"

PAGE = (Path(__file__).parents[2] / "docs" / "testing.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.thorough(2)
@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_example(suite: pytest.Pytester, number: int) -> None:
    suite.makepyfile(EXAMPLES[number])
    is_conformance = "canopen_check" in EXAMPLES[number]
    passed = suite.runpytest("-q", *(("-k", "2-") if is_conformance else ()))
    counts = passed.parseoutcomes()
    assert counts.keys() <= {"passed", "skipped", "deselected"}, passed.outlines
    assert counts["passed"] >= 1
    if is_conformance:
        assert sum(counts.values()) == len(CASES)


def test_there_are_examples() -> None:
    assert len(EXAMPLES) == 5


def test_the_page_has_each_fault_and_each_pattern() -> None:
    kinds = {name for name, kind in vars(faults).items() if isinstance(kind, type) and issubclass(kind, faults.Fault)}
    kinds &= {*testing.__all__} - {"Fault"}
    assert [kind for kind in sorted(kinds) if f"| `{kind}(" not in PAGE] == []
    patterns = {name for name in testing.__all__ if name.islower()}
    assert [name for name in sorted(patterns) if not re.search(rf"`{name}\b", PAGE)] == []
    assert "late heartbeat" in RULES


def test_the_faults_in_the_table_can_be_made() -> None:
    rows = re.findall(r"^\| (`(?:[A-Z]\w+\(.*?)`) \|", PAGE, re.MULTILINE)
    assert len(rows) == 12
    names = {name: getattr(testing, name) for name in testing.__all__} | {"SECOND": 10**9, "MILLISECOND": 10**6}
    for row in rows:
        for call in re.findall(r"`([^`]+)`", row):
            fault = eval(call.replace("...", "any_frame()"), names)
            assert isinstance(fault, testing.Fault)
