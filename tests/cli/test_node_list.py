"""`canopen node list`: what a machine file names, and which of it is there."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from tests.cli.cli_support import Run, runner_in_folder

CELL = """
[buses.can0]
locator = "virtual:nobody"
[nodes.lift]
id = 5
boot = {}
[nodes.door]
id = 33
[joints.up]
node = "lift"
"""


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    made = runner_in_folder(capsys, monkeypatch, tmp_path)
    Path("cell.toml").write_text(CELL)
    return made


def test_the_nodes_of_a_file(run: Run) -> None:
    outcome = run("node", "list", "cell.toml")
    assert outcome.status == ExitCode.OK
    assert "5 (0x05)" in outcome.out
    assert "there" not in outcome.out
    lift, door = run("node", "list", "-m", "cell.toml", "--json").json["nodes"]
    assert (lift["name"], lift["node"], lift["joints"], lift["boot"], lift["there"]) == ("lift", 5, ["up"], True, None)
    assert (door["node"], door["boot"]) == (33, False)


def test_which_of_them_are_there_and_which_others(run: Run) -> None:
    outcome = run("node", "list", "cell.toml", "-b", "demo")
    assert outcome.status == ExitCode.DIFFERENT
    assert "yes, pre-operational" in outcome.out
    assert "not in the file: node 3" in " ".join(outcome.out.split())
    assert "2 nodes, 1 not there" in outcome.err
    document = run("node", "list", "cell.toml", "-b", "demo", "--json").json
    assert [each["there"] for each in document["nodes"]] == [True, False]
    assert {each["node"] for each in document["others"]} == {3, 4, 6, 7, 8}


def test_nobody_is_there(run: Run) -> None:
    outcome = run("node", "list", "cell.toml", "--look")
    assert outcome.status == ExitCode.DIFFERENT
    assert "2 not there" in outcome.err


def test_no_file_was_named(run: Run) -> None:
    assert run("node", "list").status == ExitCode.USAGE
