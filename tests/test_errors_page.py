"""docs/errors.md has each code that the sources have, and the exit statuses that the command line gives for it."""

from __future__ import annotations

import ast
import builtins
import importlib
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from canopen_cli.app import CLOSED_PIPE
from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.problem import ExitCode
from canopen_master import errors
from canopen_master.direct.connection import AlreadyConnectedError, NotConnectedError
from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.sdo.client import SdoAborted
from tests.cli.test_problem import test_each_error_has_its_status as table_of_errors

PATH = Path(__file__).parent.parent / "docs" / "errors.md"
PACKAGES = (
    "canopen_proto",
    "canopen_data",
    "canopen_transports",
    "canopen_master",
    "canopen_check",
    "canopen_ros",
    "canopen_gateway",
    "canopen_cli",
)
CODE = re.compile(r"\bCO[0-9]{3}\b")
NO_END = {"CO112", "CO113"}
"""Codes of reports after which receiving goes on: no command ends by them."""
OF_THE_NODE = {"CO324", "CO325"}
"""Codes of the ROS node only."""
OF_A_CLIENT = {"CO162", "CO165"}
"""Codes that only a client of a gateway is told."""


def sources() -> Iterator[tuple[Path, str]]:
    """The modules of our packages, wherever they are installed."""
    for name in PACKAGES:
        origin = importlib.import_module(name).__file__
        assert origin is not None
        for path in sorted(Path(origin).parent.rglob("*.py")):
            yield path, path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page() -> str:
    if not PATH.is_file():
        pytest.skip("docs/errors.md is not beside these tests")
    return PATH.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def rows(page: str) -> list[list[str]]:
    """The rows of all tables of codes: code, exception, what it means, likely causes, next step, status."""
    return [[cell.strip() for cell in line[1:-1].split("|")] for line in page.splitlines() if re.match(r"\| CO[0-9]{3} ", line)]


def test_each_code_of_the_sources_has_one_row_and_no_other_has(page: str, rows: list[list[str]]) -> None:
    used = {code for _, text in sources() for code in CODE.findall(text)}
    codes = [row[0] for row in rows]
    assert codes == sorted(used)
    assert set(CODE.findall(page)) == used


def test_each_row_is_whole_and_stands_in_its_table(page: str, rows: list[list[str]]) -> None:
    for row in rows:
        assert len(row) == 6, row[0]
        assert row[2], row[0]
        assert row[3] or row[4], f"{row[0]}: neither a cause nor a next step"
    for hundred, section in re.findall(r"^## CO([0-9])xx(.*?)(?=^## )", page, re.DOTALL | re.MULTILINE):
        assert {code[2] for code in re.findall(r"^\| (CO[0-9]{3}) ", section, re.MULTILINE)} == {hundred}


def statuses_of_codes() -> dict[str, set[int]]:
    """By code: each exit status that the command line gives with it."""
    found: defaultdict[str, set[int]] = defaultdict(set)
    for _, text in sources():
        if "usage(" not in text and "CommandError(" not in text:
            continue
        for call in ast.walk(ast.parse(text)):
            match call:
                case ast.Call(ast.Name("usage"), [ast.Constant(str(code)), *_]):
                    found[code].add(ExitCode.USAGE)
                case ast.Call(ast.Name("CommandError"), [ast.Attribute(ast.Name("ExitCode"), name), ast.Constant(str(code)), *_]):
                    found[code].add(ExitCode[name])
    (examples,) = table_of_errors.pytestmark  # type: ignore[attr-defined]
    for _, status, code in examples.args[1]:
        found[code].add(status)
    aborted = SdoAborted(5, 1, 0x6041, 0, AbortCode.NO_SDO_CONNECTION, AbortOrigin.LOCAL)
    given_up = errors.GIVEN_UP, aborted, "x", "it was given up", "", "", ()
    others = [
        errors.SdoNotConfirmedError(*given_up),
        errors.SdoGivenUpError(*given_up),
        errors.SdoNotConfirmedError(errors.CONTESTED, *given_up[1:]),
        errors.RealtimeRefusedError(errors.REALTIME_REFUSED, "x"),
        errors.MasterClosedError(),
        NotConnectedError(),
        AlreadyConnectedError("x"),
        errors.SetPointRefusedError("set-point nan was refused", "joint1", "it is not a finite number"),
    ]
    for problem in map(problem_of, others):
        found[problem.code].add(problem.exit_code)
    return found


def test_the_statuses_of_each_code_are_those_of_the_command_line(rows: list[list[str]]) -> None:
    found = statuses_of_codes()
    assert {row[0] for row in rows} - set(found) == NO_END | OF_THE_NODE | OF_A_CLIENT
    for code, *_, text in rows:
        shown = {int(status) for status in re.findall("[0-9]+", text)}
        if code in NO_END | OF_THE_NODE | OF_A_CLIENT:
            assert not shown, code
        else:
            assert shown == found[code], code


def test_the_exit_statuses_are_all_there(page: str) -> None:
    shown = {int(status): kind for status, kind in re.findall(r"^\| ([0-9]+) \| (?:`(\w+)`)? ?\|", page, re.MULTILINE)}
    expected = {int(status): status.kind for status in ExitCode}
    assert shown == expected | {ExitCode.OK: "", CLOSED_PIPE: ""}


def test_each_exception_on_the_page_exists(page: str, rows: list[list[str]]) -> None:
    known = {name for _, text in sources() for name in re.findall(r"^class (\w+)\(", text, re.MULTILINE)} | set(dir(builtins))
    named = {name for row in rows for name in re.findall(r"`(\w+)`", row[1])}
    block = re.search(r"```text\n(.*?)```", page, re.DOTALL)
    assert block is not None
    named |= set(re.findall(r"\b[A-Z][a-z]+[A-Z]\w+", block[1]))
    assert len(named) > 30
    assert named <= known
