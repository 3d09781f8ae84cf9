"""Every command: its help, its JSON, a wrong argument, a silent bus, Ctrl-C, a closed pipe, 60 columns of a dumb terminal in C.

The test walks the tree of commands, so that none is left out. Every day each command takes its help, its JSON, a wrong argument,
and one of the others in turn; with all examples (CONTRIBUTING.md) it takes all of them.
"""

from __future__ import annotations

import io
import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from canopen_cli import app
from canopen_cli.shared.problem import ExitCode
from canopen_master.simulation.serving import SimulatedDevices
from tests.cli.cli_support import Alarm, Outcome, Run, runner_in_folder
from tests.cli.command_examples import (
    EXAMPLES,
    FURTHER,
    SCHEMAS,
    described,
    descriptions,
    documents_of,
    merged,
    schema_of,
    strict,
    validator_of,
    write_schema,
)
from tests.cli.test_clean import paths
from tests.examples import takes_all

jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed: the extra `test` has it")

COMMANDS = [*EXAMPLES]
"""All: a test compares. To walk the tree would read in every command, and the libraries of each, in all workers."""
FILES = Path(__file__).parents[1] / "files"
LOG = """\
(1700000000.000000) can0 705#05 R
(1700000000.100000) can0 605#4041600000000000 T
(1700000000.101000) can0 585#4B41600037020000 R
(1700000001.000000) can0 085#1023010000000000 R
"""
SIMULATED = '[nodes.io]\nid = 5\nfile = "sample_io.eds"\nboot = {}\n'
TEXTS = {
    "bus.log": LOG,
    "other.log": LOG.replace("37020000", "33020000"),
    "path.csv": "time,joint1\n0,0\n1,5\n2,0\n",
    "cell.toml": '[buses.can0]\nlocator = "virtual:x"\n[nodes.a]\nid = 5\n',
    "net.toml": f'[buses.can0]\nlocator = "virtual:x"\n{SIMULATED}',
    "bus.yaml": "bus:\n  device: can0\nnodes:\n  joint1:\n    id: 5\n",
    "lamp.toml": f'[buses.can0]\nlocator = "virtual:x"\n{SIMULATED.replace("{}", "{ serial = 7, mandatory = false }")}',
    "arm.toml": '[buses.demo]\nlocator = "virtual:demo"\n[nodes.joint1]\nid = 3\n[joints.joint1]\nunit = "degree"\n'
    'counts_per_turn = 360000\n[chains.arm]\njoints = ["joint1"]\n',
    "empty.log": "",
    "script.py": "print(await nodes[3].read_int('1000'))\n",
    "image.bin": "no program",
}
SAME = (0, 1, 2, 3, 6, 7, 11, 12)
"""Statuses of commands that are done, or say why they cannot."""


_MADE: dict[str, str] = {}
"""Files that commands make: once."""


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    made = runner_in_folder(capsys, monkeypatch, tmp_path)
    for name, text in TEXTS.items():
        Path(name).write_text(text)
    Path("two.csv").write_text((FILES / "two_joints.csv").read_text())
    Path("faulty.eds").write_text((FILES / "faulty.eds").read_text(encoding="latin-1"), encoding="utf-8")
    if not _MADE:
        for command in (("eds", "to-dcf", "sample_io.eds", "--id", "5", "-o", "device.dcf"), ("device", "new", "own.py")):
            assert made(*command).status == ExitCode.OK
        _MADE.update({"device.dcf": Path("device.dcf").read_text(), "own.py": Path("own.py").read_text()})
    for name, text in (_MADE | {"device.eds": _MADE["device.dcf"]}).items():
        Path(name).write_text(text)
    return made


def example(command: str) -> tuple[str, ...]:
    return (*command.split(), *EXAMPLES[command])


def is_in_turn(command: str, number: int, count: int = 4) -> bool:
    """Whether a command takes this check today."""
    return takes_all() or COMMANDS.index(command) % count == number


def is_told(outcome: Outcome) -> bool:
    """Whether a command that failed says so in the way of all commands, and none has a traceback."""
    text = outcome.out + outcome.err
    return "Traceback" not in text and "CO900" not in text and outcome.status != ExitCode.INTERNAL


def test_every_command_has_an_example() -> None:
    assert [" ".join(path) for path in paths(app.cli)] == COMMANDS
    assert set(json.loads(SCHEMAS.read_text(encoding="utf-8"))["commands"]) <= set(COMMANDS)


def test_every_command_answers_json_but_those_that_say_why_not() -> None:
    known = json.loads(SCHEMAS.read_text(encoding="utf-8"))["commands"]
    assert [each for each in COMMANDS if each not in known] == ["tui", "jog", "shell", "completion"]
    page = (FILES.parents[1] / "docs" / "json.md").read_text(encoding="utf-8")
    assert "`tui` and `jog` have none" in page
    assert "`shell` and `run` print what their Python prints" in page
    assert "`completion` writes the script" in page


@pytest.mark.parametrize("command", COMMANDS)
def test_help(run: Run, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    outcome = run(*command.split(), "--help")
    assert outcome.status == ExitCode.OK
    assert outcome.out.startswith(f"Usage: canopen {command}")
    assert max(map(len, outcome.out.splitlines())) <= 140
    monkeypatch.setenv("COLUMNS", "60")
    assert run(*command.split(), "--help").status == ExitCode.OK


@pytest.mark.parametrize("command", COMMANDS)
def test_a_wrong_argument(run: Run, command: str) -> None:
    outcome = run(*command.split(), "--no-such-option", "--json")
    assert outcome.status == ExitCode.USAGE
    assert outcome.error["code"] in ("CO001", "CO120")  # `drive mode -3` is a mode of the maker's
    assert outcome.out == ""


SLOW = ("plot", "log plot", "move", "drive commission", "backup", "ros init")
"""They draw, plan or read for a second: their other checks, which take as long, are enough of every day."""


@pytest.mark.parametrize("command", [each for each in COMMANDS if takes_all() or each not in SLOW])
def test_the_json_of_each_command_is_that_of_its_schema(
    run: Run, alarm: Alarm, simulations: list[SimulatedDevices], command: str
) -> None:
    alarm.set((8.0, signal.SIGINT))  # for those that have no end
    answers_its_schema(run, command, example(command))


@pytest.mark.parametrize(
    "line",
    [(command, each) for command, lines in FURTHER.items() for each in lines],
    ids=lambda line: f"{line[0]} {' '.join(line[1])}",
)
@pytest.mark.thorough(3)
def test_the_json_of_further_examples(
    run: Run, alarm: Alarm, simulations: list[SimulatedDevices], line: tuple[str, tuple[str, ...]]
) -> None:
    alarm.set((8.0, signal.SIGINT))
    command, arguments = line
    answers_its_schema(run, command, (*command.split(), *arguments))


def answers_its_schema(run: Run, command: str, words: tuple[str, ...]) -> None:
    outcome = run(*words, "--json")
    assert is_told(outcome), outcome.err
    documents = documents_of(outcome.out)
    if os.environ.get("CANOPEN_WRITE_SCHEMAS") and documents:
        write_schema(command, documents, COMMANDS)
    for document in documents:
        validator_of(command).validate(document)
    for line in documents_of(outcome.err):
        validator_of(None).validate(line)


OF_A_BUS = [command for command in COMMANDS if EXAMPLES[command][-2:] == ("-b", "demo")]


@pytest.mark.parametrize("command", [each for each in OF_A_BUS if is_in_turn(each, 0)])
def test_a_silent_bus(run: Run, command: str) -> None:
    line = (*example(command)[:-2], "-b", "virtual:nobody")
    endless = command in ("jog", "net watch", "drive commission")
    outcome = run(*line) if not endless else run(*line, "--no-such-option")
    assert is_told(outcome), outcome.err
    assert outcome.status in (ExitCode.NO_ANSWER, *SAME)


@pytest.mark.parametrize("command", [each for each in OF_A_BUS if is_in_turn(each, 1)])
def test_ctrl_c(run: Run, alarm: Alarm, simulations: list[SimulatedDevices], command: str) -> None:
    alarm.set((0.02, signal.SIGINT))
    outcome = run(*example(command))
    assert is_told(outcome), outcome.err
    assert outcome.status in (ExitCode.INTERRUPTED, ExitCode.NO_ANSWER, *SAME)
    assert outcome.status != ExitCode.INTERRUPTED or "interrupted" in outcome.err


class Closed:
    """A stream whose reader has gone."""

    encoding, errors = "utf-8", "strict"

    def write(self, text: str) -> int:
        raise BrokenPipeError(32, "Broken pipe")

    def flush(self) -> None:
        """Nothing is held."""

    def fileno(self) -> int:
        raise io.UnsupportedOperation("fileno")

    def isatty(self) -> bool:
        return False


@pytest.mark.parametrize("command", [each for each in COMMANDS if is_in_turn(each, 2)])
def test_a_pipe_whose_reader_has_gone(
    run: Run, alarm: Alarm, simulations: list[SimulatedDevices], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setattr(app, "put_closed_pipes_to_rest", lambda: None)  # it would close those of the tests
    monkeypatch.setattr(sys, "stdout", Closed())
    alarm.set((8.0, signal.SIGINT))
    outcome = run(*example(command))
    assert is_told(outcome), outcome.err
    assert outcome.status in (app.CLOSED_PIPE, ExitCode.INTERRUPTED, ExitCode.NO_ANSWER, *SAME)


@pytest.mark.parametrize("command", [each for each in COMMANDS if is_in_turn(each, 3)])
def test_60_columns_of_a_dumb_terminal_in_c(
    run: Run, alarm: Alarm, simulations: list[SimulatedDevices], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    for name, value in {"COLUMNS": "60", "LANG": "C", "TERM": "dumb"}.items():
        monkeypatch.setenv(name, value)
    alarm.set((8.0, signal.SIGINT))
    outcome = run(*example(command))
    assert is_told(outcome), outcome.err
    assert "\x1b" not in outcome.out + outcome.err


def fields_of(schema: dict[str, Any]) -> Iterator[str]:
    for name, each in schema.get("properties", {}).items():
        yield name
        yield from fields_of(each)
    for part in ("items", "additionalProperties"):
        if isinstance(schema.get(part), dict):
            yield from fields_of(schema[part])


def test_each_field_is_described() -> None:
    whole = json.loads(SCHEMAS.read_text(encoding="utf-8"))
    named = {name for schema in (whole["stderr"], *whole["commands"].values()) for name in fields_of(schema)}
    assert named == descriptions().keys()
    assert described(whole, descriptions()) == whole, "CANOPEN_WRITE_SCHEMAS=1: see command_examples.py"


def test_the_page_is_that_of_the_schemas() -> None:
    source = FILES.parents[1] / "docs" / "json_page.py"
    module: dict[str, Any] = {"__name__": "json_page", "__file__": str(source)}
    exec(compile(source.read_text(encoding="utf-8"), str(source), "exec"), module)
    whole = json.loads(SCHEMAS.read_text(encoding="utf-8"))
    assert module["PAGE"].read_text(encoding="utf-8") == module["page_of"](whole), "python docs/json_page.py"
    for schema in (whole["stderr"], *whole["commands"].values()):
        jsonschema.validators.validator_for(schema).check_schema(schema)


def test_a_schema_notices_what_does_not_fit() -> None:
    answers = ({"node": 5, "rows": [{"name": "a"}, {"name": None}]}, {"node": None, "rows": []})
    schema = strict(merged([schema_of(each) for each in answers]))
    jsonschema.validate({"node": None, "rows": [{"name": "b"}]}, schema)
    for wrong in ({"node": "5", "rows": []}, {"node": 5}, {"node": 5, "rows": [{}]}, {"node": 5, "rows": [], "more": 1}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(wrong, schema)
