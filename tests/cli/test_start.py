"""How the command starts: what it imports before a command is named, and what it says of itself without importing that command.

Modules are counted, never time.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence

import click
import pytest
from click.shell_completion import ShellComplete

from canopen_cli import app, groups
from canopen_cli.drive import group as drive
from canopen_cli.shared.lazy import LazyGroup
from canopen_cli.shared.problem import ExitCode

GROUPS = [each for each in vars(groups).values() if isinstance(each, LazyGroup)]
ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join(each for each in sys.path if each)}


def python(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, env=ENVIRONMENT, timeout=60)


WHAT_IS_IMPORTED = """
import sys
before = set(sys.modules)
from canopen_cli.entry import main
status = main()
ours = {name for name in sys.modules if name.startswith("canopen")}
others = {name.partition(".")[0] for name in set(sys.modules) - before} - sys.stdlib_module_names - ours
others = {name for name in others if not name.endswith("__mypyc")}  # what all modules of a compiled build share
print(*sorted(name for name in ours if "." in name), "|", *sorted(others - {name.partition(".")[0] for name in ours}))
sys.exit(status)
"""


def test_only_the_view_imports_the_library_of_the_view() -> None:
    for words in (("read", "3", "1000", "-b", "demo"), ("tui", "--help")):
        ended = python("import sys; from canopen_cli.entry import main; main(); print('textual' in sys.modules)", *words)
        assert ended.stdout.splitlines()[-1] == "False", ended.stderr


@pytest.mark.parametrize("option", ["--version", "--help"])
def test_version_and_help_import_click_and_next_to_nothing_of_ours(option: str) -> None:
    ended = python(WHAT_IS_IMPORTED, option)
    assert ended.returncode == 0, ended.stderr
    ours, _, others = ended.stdout.splitlines()[-1].partition(" | ")
    shared = ("chosen_machine", "importing", "lazy", "options", "problem", "streams")
    command = {f"canopen_cli.{name}" for name in ("app", "entry", "shared", *(f"shared.{each}" for each in shared))}
    assert set(ours.split()) == command | {
        f"canopen_proto.{name}" for name in ("compiling", "explained", "frame", "lazy_names", "machine")
    }
    assert others == "click"


@pytest.mark.parametrize("option", ["--version", "--help"])
def test_version_and_help_need_no_library_but_click(option: str) -> None:
    missing = "import sys; sys.modules.update(dict.fromkeys(['trio', 'rich', 'can']))\n"
    ended = python(missing + WHAT_IS_IMPORTED, option)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.parametrize("group", [app.cli, drive.drive, *GROUPS], ids=lambda each: each.name)
def test_each_line_of_the_list_is_what_the_command_says_of_itself(group: click.Command) -> None:
    assert isinstance(group, LazyGroup)
    context = click.Context(group)
    for name, (_, line) in group.table.items():
        command = group.get_command(context, name)
        assert command is not None
        assert command.name == name
        assert line == command.get_short_help_str(limit=1000)


def completed(arguments: Sequence[str], incomplete: str) -> dict[str, str | None]:
    complete = ShellComplete(app.cli, {}, "canopen", "_CANOPEN_COMPLETE")
    return {each.value: each.help for each in complete.get_completions(list(arguments), incomplete)}


def test_a_shell_completes_commands_and_options() -> None:
    assert completed([], "re") == {name: app.COMMANDS[name][1] for name in ("read", "restore", "reset-defaults")}
    assert "--bus" in completed([], "--b")
    assert list(completed(["eds"], "to")) == ["to-dcf", "to-cdcf", "to-dbc"]
    assert "--master-id" in completed(["home"], "--m")


@pytest.mark.parametrize(
    ("words", "shown"), [("canopen sc", ["plain,scan"]), ("canopen eds to", ["plain,to-dcf", "plain,to-cdcf", "plain,to-dbc"])]
)
def test_a_shell_asks_for_completion(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: str, shown: list[str]
) -> None:
    for name, value in {"_CANOPEN_COMPLETE": "bash_complete", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}.items():
        monkeypatch.setenv(name, value)
    assert app.main([]) == ExitCode.OK
    assert capsys.readouterr().out.splitlines() == shown


A_READ = """
import sys
before = set(sys.modules)  # a measurement of coverage has imported some by now
from canopen_cli.entry import main
status = main()
print("|", *set(sys.modules) - before)
sys.exit(status)
"""

NOT_FOR_A_READ = (
    "can",  # a quarter of the start: only for the interfaces of python-can, and for its formats of logs
    "rich.progress",
    "canopen_cli.shared.failures",
    "canopen_cli.shared.text_gateway",
    "canopen_data.description",
    "canopen_data.eds.reader",
    "canopen_data.overlay",
    "canopen_data.xdd.reader",
    "canopen_master.assembly",
    "canopen_master.motion.chain",
    "canopen_proto.declared.device",
    "canopen_proto.manager.linking",
    "canopen_proto.observer.observer",
    "canopen_transports.log_files",
    "tomllib",
)
OURS_AT_MOST = 264
"""Modules of ours that a read imports; 261 when this was written."""


def test_a_read_on_a_bus_of_ours_imports_nothing_of_other_buses_of_chains_and_of_errors() -> None:
    ended = python(A_READ, "read", "5", "1000", "-b", "demo")
    assert ended.returncode == 0, ended.stderr
    imported = set(ended.stdout.rpartition("|")[2].split())
    assert "canopen_master.session" in imported
    assert not imported & set(NOT_FOR_A_READ)
    assert len({name for name in imported if name.startswith("canopen")}) <= OURS_AT_MOST


COLLECTED = """
import gc, sys
from canopen_cli.shared import screen
from canopen_cli.entry import main
before = gc.get_stats()[2]["collections"]
table, shown = screen.Screen.table, []
def seen(*arguments, **named):
    shown.append((gc.isenabled(), gc.get_freeze_count() > 10_000))
    return table(*arguments, **named)
screen.Screen.table = seen
status = main()
print("|", gc.get_stats()[2]["collections"] - before, *shown, gc.isenabled())
sys.exit(status)
"""


def test_the_garbage_collector_rests_while_a_command_is_imported_and_works_while_it_runs() -> None:
    ended = python(COLLECTED, "read", "5", "1000", "-b", "demo")
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.rpartition("| ")[2].strip() == "0 (True, True) True"


INTERRUPTED_COMMAND = """
import os, signal, sys
from canopen_cli.entry import main
class Finder:
    def find_spec(self, name, *rest):
        if name == "canopen_cli.bus.scan":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
sys.exit(main())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="SIGINT to one process")
def test_ctrl_c_while_a_command_is_imported() -> None:
    ended = python(INTERRUPTED_COMMAND, "scan", "-b", "demo")
    assert ended.returncode == -signal.SIGINT  # which a shell calls 130
    assert ended.stderr == ""


@pytest.mark.parametrize("arguments", [["scan", "--help"], ["--no-such-option"]], ids=" ".join)
def test_a_library_that_is_missing_is_named_when_it_is_needed(arguments: list[str]) -> None:
    missing = "import sys; sys.modules['rich'] = None; from canopen_cli.entry import main; sys.exit(main())"
    ended = python(missing, *arguments)
    assert ended.returncode == ExitCode.CANNOT_OPEN
    assert ended.stderr.startswith("canopen: the command line needs rich, which is not installed.\n")


def test_with_json_a_library_that_is_missing_is_named_in_a_document() -> None:
    missing = "import sys; sys.modules['rich'] = None; from canopen_cli.entry import main; sys.exit(main())"
    error = json.loads(python(missing, "no-such-command", "--json").stderr)
    assert (error["kind"], error["try"]) == ("cannot_open", ["pip install 'canopen-proto[master]'"])
