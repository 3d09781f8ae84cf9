"""Every property can be searched further: none sets its number of examples in a way that a profile cannot change."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.examples import FULL, SAME, examples


@pytest.fixture
def profile() -> Iterator[None]:
    name = settings.get_current_profile_name()
    yield
    settings.load_profile(name)


@pytest.mark.usefixtures("profile")
def test_the_number_is_that_of_the_test_or_of_the_profile() -> None:
    settings.load_profile(FULL)
    assert (examples(7).max_examples, examples(7).derandomize) == (7, True)
    settings.load_profile(SAME)
    assert [examples(count).max_examples for count in (3, 7, 200)] == [3, 5, 20]
    assert examples(200, least=60).max_examples == 60
    assert examples(7).derandomize
    settings.load_profile("search")
    assert (examples(7).max_examples, examples(7).derandomize) == (2000, False)
    assert examples(7, steps=20).stateful_step_count == 20


def test_so_it_is_on_a_build_server_too() -> None:
    """There hypothesis has other defaults, which it chooses when it is imported."""
    line = "from tests import conftest; from hypothesis import settings; print(settings.get_profile('search').derandomize)"
    command = [sys.executable, "-c", line]
    server = {**os.environ, "CI": "true"}
    run = subprocess.run(command, env=server, cwd=Path(__file__).parents[1], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"


def test_no_test_sets_another_number() -> None:
    here = Path(__file__).parent
    files = {path.relative_to(here).as_posix(): path.read_text(encoding="utf-8") for path in here.rglob("*.py")}
    assert len(files) > 200
    own = re.compile(r"max_examples|from hypothesis import .*\bsettings\b|derandomize")
    assert {name for name, text in files.items() if own.search(text)} == {"conftest.py", "examples.py", "test_examples.py"}
