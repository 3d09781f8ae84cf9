"""The configuration file: options before variables before the file, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_cli.completion.words import known_words
from canopen_cli.shared.configuration import configuration_path
from canopen_cli.shared.problem import ExitCode
from tests.cli.cli_support import Run, runner_in_folder

CELL = '[buses.line]\nlocator = "virtual:cell"\n[nodes.lift]\nid = 5\n'


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


def write(text: str) -> Path:
    path = configuration_path()
    assert path is not None
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_its_bus_is_the_last_one_that_is_asked(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run("read", "3", "1000", "--json").error["code"] == "CO121"
    write('bus = "demo"\n')
    assert run("read", "3", "1000").status == ExitCode.OK
    monkeypatch.setenv("CANOPEN_BUS", "virtual:nobody")
    assert run("read", "3", "1000").status == ExitCode.NO_ANSWER
    assert run("read", "3", "1000", "-b", "demo").status == ExitCode.OK


def test_its_machine_stands_beside_it_and_gives_way(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write('machine = "cell.toml"\n')
    (path.parent / "cell.toml").write_text(CELL)
    assert "lift" in run("node", "list").out
    assert [each.value for each in known_words(["read"], "") or ()] == ["lift"]
    monkeypatch.setenv("CANOPEN_BUS", "demo")
    assert run("read", "3", "1000").status == ExitCode.OK
    assert [each.value for each in known_words(["read"], "") or ()] == ["3", "4", "5", "6", "7", "8"]


def test_doctor_says_who_names_the_bus(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    path = configuration_path()
    told = {each["subject"]: each["seen"] for each in run("doctor", "--json").json}
    assert told["bus of commands"] == f"none. The first of these counts: -b: nothing; $CANOPEN_BUS: nothing; {path}: nothing"
    write('bus = "demo"\n')
    heard = run("doctor", "--for", "100ms", "-v").err
    assert f"bus of commands: demo, by {path}" in heard
    monkeypatch.setenv("CANOPEN_BUS", "virtual:x")
    assert f"virtual:x, by $CANOPEN_BUS. The first of these counts: -b: nothing; $CANOPEN_BUS: virtual:x; {path}: demo" in (
        run("doctor", "--for", "100ms", "-v").err
    )


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("bus = \n", "is no TOML"),
        (f"bus = {'[' * 5000}", "is no TOML"),
        ("buss = 'demo'\n", "no key 'buss'"),
        ("bus = 5\n", "is no text"),
        ("bus = ''\n", "is no text"),
        ("bus = '\\xff'", "is no TOML"),
    ],
)
def test_a_file_that_cannot_be_used_is_told_and_nothing_is_guessed(run: Run, text: str, told: str) -> None:
    path = write(text if "xff" not in text else "bus = \x01")
    outcome = run("read", "3", "1000")
    assert outcome.status == ExitCode.BAD_FILE
    assert told in outcome.err
    assert str(path) in "".join(outcome.err.split("\n"))
    assert run("read", "3", "1000", "-b", "demo").status == ExitCode.BAD_FILE


def test_a_folder_that_is_not_absolute_is_ignored(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", "here")
    assert configuration_path() == tmp_path / ".config" / "canopen" / "config.toml"


def test_a_bus_that_cannot_be_opened_says_who_named_it(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write('bus = "nonsense"\n')
    assert f"{path} named this bus" in run("scan").err
    monkeypatch.setenv("CANOPEN_BUS", "udp_multicats")
    told = run("scan", "--json").error
    assert (told["code"], told["also"]) == ("CO100", ["CANOPEN_BUS=udp_multicats named this bus"])
    assert run("scan", "-b", "nonsense", "--json").error["also"] == []
