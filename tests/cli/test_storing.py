"""`canopen store` and `canopen reset-defaults`: the signature is written once, behind a yes, to a device that acts on it."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from canopen_proto.abort import AbortCode
from canopen_proto.nmt import NmtState
from tests.cli.backup_world import NODE, Lasting, answering, lasting_device
from tests.cli.cli_support import Run, runner_in_folder
from tests.cli.command_examples import json_that_fits

STORE, RESTORE = 0x1010, 0x1011


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch, run: Run) -> Lasting:
    return lasting_device(monkeypatch)


def test_a_device_stores_its_parameters(run: Run, world: Lasting) -> None:
    outcome = run("store", *NODE, "--yes")
    assert outcome.status == ExitCode.OK
    assert "node 5 (0x05): stored (0x1010:01)" in outcome.err
    assert world.writes == [(STORE, 1)]


def test_a_group_by_its_name_and_by_its_number(run: Run, world: Lasting) -> None:
    outcome = run("store", *NODE, "--group", "communication", "--yes", "--json")
    assert json_that_fits("store", outcome) == {"node": 5, "index": STORE, "subindex": 2, "stored": True}
    assert world.writes == [(STORE, 2)]
    for wrong in ("3x", "0", "128", "nothing", "²"):
        assert run("store", *NODE, "--group", wrong, "--yes").status == ExitCode.USAGE
    assert run("store", *NODE, "--group", "7", "--yes").status == ExitCode.SDO_ABORT  # this device has no such group


@pytest.mark.parametrize("command", ["store", "reset-defaults"])
def test_nothing_is_sent_without_a_yes(run: Run, world: Lasting, command: str) -> None:
    outcome = run(command, *NODE)
    assert outcome.status == ExitCode.USAGE
    assert "CO122" in outcome.err
    assert world.writes == []


@pytest.mark.parametrize(
    ("command", "index", "words"), [("store", STORE, "store its parameters"), ("reset-defaults", RESTORE, "restore its")]
)
def test_a_device_that_does_not_act_on_it_is_not_written(run: Run, world: Lasting, command: str, index: int, words: str) -> None:
    world.prepare = lambda node: answering(node, {index: (2).to_bytes(4, "little")})  # bit 1: by itself
    outcome = run(command, *NODE, "--yes", "--json")
    assert (outcome.status, outcome.error["code"]) == (ExitCode.DRIVE_FAULT, "CO218")
    assert words in outcome.error["message"]
    assert (outcome.error["node"], outcome.error["index"]) == (5, index)
    assert world.writes == []


def test_the_defaults_count_from_the_next_reset_on(run: Run, world: Lasting) -> None:
    outcome = run("reset-defaults", *NODE, "--yes", "--json")
    assert json_that_fits("reset-defaults", outcome)["reset"] is False
    outcome = run("reset-defaults", *NODE, "--yes")
    assert outcome.status == ExitCode.OK
    assert "canopen nmt reset 5" in outcome.err
    assert world.writes == [(RESTORE, 1)]
    assert world.state is NmtState.OPERATIONAL


def test_or_at_once_by_a_reset(run: Run, world: Lasting) -> None:
    outcome = run("reset-defaults", *NODE, "--reset", "--yes")
    assert "it has its defaults, and has booted" in outcome.err
    assert world.state is NmtState.PRE_OPERATIONAL


def test_a_device_that_fails_to_store_is_asked_once(run: Run, world: Lasting) -> None:
    world.prepare = lambda node: setattr(node, "refuse", lambda count: AbortCode.HARDWARE_ERROR)
    outcome = run("store", *NODE, "--yes")
    assert outcome.status == ExitCode.SDO_ABORT
    assert world.writes == [(STORE, 1)]


def test_a_lost_answer_is_not_taken_for_a_refusal(run: Run, world: Lasting) -> None:
    lost = b"\x23\x10\x10\x01"
    world.prepare = lambda node: setattr(node, "takes", lambda frame: frame.data[:4] != lost)
    outcome = run("store", *NODE, "--yes")
    assert outcome.status == ExitCode.NO_ANSWER
    assert "may have been executed" in outcome.err
