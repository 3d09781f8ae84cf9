"""`./check` itself: which commands it runs, in which order, what it says of a wrong word. The tools here only say their names."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LINT = ["ruff check .", "ruff format --check ."]
TYPES = ["mypy", "mypy --strict --config-file= user_example.py testing/typed_suite.py"]
pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """A virtual environment whose tools say how they were called; the one that FAILS names fails."""
    (tmp_path / "bin").mkdir()
    for tool in ("python", "ruff", "mypy", "pytest"):
        script = tmp_path / "bin" / tool
        script.write_text('#!/bin/sh\ncalled="$(basename "$0") $*"\necho "$called"\n[ "$called" != "$FAILS" ]\n')
        script.chmod(0o755)
    return {**os.environ, "VIRTUAL_ENV": str(tmp_path), "FAILS": ""}


def check(environment: dict[str, str], *words: str) -> tuple[int, list[str], str]:
    """Exit status, lines of the output, errors."""
    ran = subprocess.run(["bash", str(ROOT / "check"), *words], capture_output=True, text=True, env=environment, timeout=60)
    return ran.returncode, [line.strip() for line in ran.stdout.splitlines()], ran.stderr


def test_without_a_word_it_is_lint_types_and_tests(environment: dict[str, str]) -> None:
    assert check(environment) == (0, [*LINT, *TYPES, "pytest -q -rs"], "")


@pytest.mark.parametrize(("word", "commands"), [("lint", LINT), ("types", TYPES), ("tests", ["pytest -q -rs"])])
def test_each_part_alone(environment: dict[str, str], word: str, commands: list[str]) -> None:
    assert check(environment, word) == (0, commands, "")


def test_a_room_runs_its_tests_and_nothing_else(environment: dict[str, str]) -> None:
    assert check(environment, "core", "cli") == (0, ["pytest -q -rs tests/core tests/cli"], "")


@pytest.mark.parametrize("number", range(5))
def test_what_fails_ends_it(environment: dict[str, str], number: int) -> None:
    commands = [*LINT, *TYPES, "pytest -q -rs"]
    fails = commands[number] if " " in commands[number] else f"{commands[number]} "  # as the tool itself puts it together
    status, lines, _ = check({**environment, "FAILS": fails})
    assert (status, lines) == (1, commands[: number + 1])


@pytest.mark.parametrize("word", ["nonsense", "files", "../tests", ""])
def test_a_room_that_is_not_there(environment: dict[str, str], word: str) -> None:
    """tests/files holds no tests: a run of it would pass and prove nothing."""
    status, lines, errors = check(environment, "core", word)
    assert (status, lines) == (2, [])
    assert f"check: there is no room {word}\n" in errors
    rooms = {path.parent.name for path in (ROOT / "tests").glob("*/test_*.py")}
    (told,) = re.findall("^Rooms: (.*)$", errors, re.MULTILINE)
    assert told.split() == sorted(rooms)


@pytest.mark.parametrize("words", [("lint", "core"), ("core", "lint"), ("full", "cli"), ("lint", "types")])
def test_a_part_stands_alone(environment: dict[str, str], words: tuple[str, str]) -> None:
    status, lines, errors = check(environment, *words)
    assert (status, lines) == (2, [])
    assert "stands alone" in errors


def test_a_tool_that_is_missing_is_named_before_anything_runs(environment: dict[str, str]) -> None:
    (Path(environment["VIRTUAL_ENV"]) / "bin" / "mypy").unlink()
    status, lines, errors = check(environment, "lint")
    assert (status, lines) == (2, [])
    assert "/bin/mypy: " in errors
    assert "pip install -e '.[dev]'" in errors


def test_help_tells_each_word(environment: dict[str, str]) -> None:
    status, lines, _ = check(environment, "--help")
    assert status == 0
    assert all(f"./check {word}".strip() in "\n".join(lines) for word in ("", "lint", "core cli", "full"))
    assert any(line.startswith("Rooms: ") and " core " in line for line in lines)


def test_full_tells_at_its_end_what_it_could_not_run(tmp_path: Path) -> None:
    """Its parts need minutes each: here are only the words that they use for it, and the end."""
    assert "exec bash .ci/full" in (ROOT / "check").read_text(encoding="utf-8")
    script = (ROOT / ".ci" / "full").read_text(encoding="utf-8")
    begin = 'set -eu; work=.; step() { echo "$*"; }; : >"$work/not-run.txt"'
    (not_run,) = re.findall(r"^not_run\(\) .*$", script, re.MULTILINE)
    end = script[script.index('step "done.') :]
    for calls, told in ((["not_run a part"], "NOT RUN: a part\n"), ([], "nothing\n")):
        program = "\n".join([begin, not_run, *calls, end])
        shown = subprocess.run(["bash", "-c", program], capture_output=True, text=True, cwd=tmp_path, timeout=60)
        assert (shown.returncode, shown.stderr) == (0, "")
        assert shown.stdout.endswith(told)
    lacking = ("tests with $tool", "bus sessions", "makers' files", "ROS stacks", "ROS 1", "ROS 2", "SocketCAN", "compiled")
    assert [each for each in lacking if not re.search(f"not_run .*{re.escape(each)}", script)] == []


def test_each_hook_of_conftest_is_one_that_pytest_calls(request: pytest.FixtureRequest) -> None:
    """pytest passes over a hook whose name does not begin with `pytest_`: once no test's measuring ended in time by that."""
    plugins = request.config.pluginmanager
    place = str(Path(__file__).with_name("conftest.py"))
    conftest = next(each for each in plugins.get_plugins() if getattr(each, "__file__", None) == place)
    marked = {value for value in vars(conftest).values() if hasattr(value, "pytest_impl")}
    called = {each.function for caller in plugins.get_hookcallers(conftest) or () for each in caller.get_hookimpls()}
    assert marked
    assert marked <= called
