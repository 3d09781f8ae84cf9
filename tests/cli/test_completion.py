"""`canopen completion`, and the words that a shell gets."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from canopen_cli.app import main
from canopen_cli.completion import words
from tests.cli.cli_support import Run

MACHINE = """\
[buses.left]
locator = "virtual:left"
[nodes.elbow]
bus = "left"
id = 4
[nodes.lamp]
bus = "left"
id = 9
file = "sample_io.eds"
[joints.elbow]
[joints.lift]
node = "lamp"
"""


@pytest.fixture
def complete(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path):  # type: ignore[no-untyped-def]
    """A function that takes a line, as far as it is typed, and returns the words that bash gets."""
    (tmp_path / "own").mkdir()
    monkeypatch.setenv("CANOPEN_DATA", str(tmp_path / "own"))
    monkeypatch.setenv("_CANOPEN_COMPLETE", "bash_complete")
    for name in ("CANOPEN_BUS", "CANOPEN_MACHINE"):
        monkeypatch.delenv(name, raising=False)

    def words_for(line: str) -> list[str]:
        typed = line.split()
        monkeypatch.setenv("COMP_WORDS", line)
        monkeypatch.setenv("COMP_CWORD", str(len(typed) - (not line.endswith(" "))))
        capsys.readouterr()
        assert main() == 0
        return [row.partition(",")[2] for row in capsys.readouterr().out.split()]

    return words_for


def test_commands_subcommands_and_options_are_those_of_the_commands(complete) -> None:  # type: ignore[no-untyped-def]
    assert complete("canopen com") == ["compare", "completion"]
    assert complete("canopen drive fau") == ["fault-reset"]
    assert complete("canopen read 3 --js") == ["--json"]
    assert complete("canopen nmt rese") == ["reset", "reset-comm"]


def test_buses_are_examples_those_of_the_machine_file_and_this_computers(
    complete, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "cell.toml").write_text(MACHINE, encoding="utf-8")
    assert complete("canopen scan -b de") == ["demo"]
    assert "left" in complete(f"canopen scan -m {tmp_path}/cell.toml -b ")
    for name, kind in (("can7", "280\n"), ("lan0", "1\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(kind, encoding="ascii")
    monkeypatch.setattr(words, "INTERFACES", tmp_path)
    assert complete("canopen scan -b can") == ["can7"]
    assert complete("canopen scan -b lan") == []


def test_nodes_are_those_that_the_files_name(complete, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "cell.toml").write_text(MACHINE, encoding="utf-8")
    assert complete("canopen read ") == []
    assert complete("canopen info -b demo ") == ["3", "4", "5", "6", "7", "8"]
    assert complete("canopen read -e 12=sample_io.eds ") == ["12"]
    assert complete(f"canopen drive state -m {tmp_path}/cell.toml ") == ["elbow", "lift", "lamp"]
    assert complete("canopen drive move -m nowhere.toml ") == []
    assert complete("canopen pdo show -b demo ") == ["3", "4", "5", "6", "7", "8"]


def test_objects_are_those_of_the_nodes_file_and_constants_those_of_the_object(complete, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "cell.toml").write_text(MACHINE, encoding="utf-8")
    assert complete("canopen read 3 statu") == ["statusword"]
    assert complete("canopen read 3 statusword identity_object:v") == ["identity_object:vendor_id"]
    assert complete("canopen watch -e sample_io.eds 5 statu") == []
    assert complete("canopen watch -e sample_io.eds 5 PROD") == ["producer_heartbeat_time"]
    assert complete(f"canopen read -m {tmp_path}/cell.toml lift prod") == ["producer_heartbeat_time"]
    assert complete("canopen read -e nowhere.eds 5 statu") == []
    assert "sm_shutdown" in complete("canopen write 3 controlword ")
    assert complete("canopen write 3 no_such_object ") == []
    assert complete("canopen read 3:statu") == ["3:statusword"]
    subindices = ["1018:00", "1018:01", "1018:02", "1018:03", "1018:04"]
    assert complete("canopen read -e sample_io.eds 3 1018:") == subindices
    assert complete("canopen read -e sample_io.eds 3 6041 0x1018:") == [f"0x{each}" for each in subindices]
    assert complete("canopen read -e sample_io.eds 3:1018:") == [f"3:{each}" for each in subindices]
    assert complete("canopen eds show sample_io.eds 1018:") == subindices
    assert complete("canopen monitor -e sample_io.eds --object 1018:") == subindices
    assert complete("canopen write 3 604")[:2] == ["6040:00", "6041:00"]
    assert "sm_shutdown" in complete("canopen write 3 6040:00 ")
    assert complete("canopen drive mode 3 cs") == ["csp", "csv", "cst"]
    assert complete("canopen drive mode -b demo 3 p") == ["pp", "pv"]
    assert complete(f"canopen watch -m {tmp_path}/cell.toml lift:PROD") == ["lift:producer_heartbeat_time"]
    assert "sm_shutdown" in complete("canopen write 3:controlword ")
    assert complete("canopen log decode a.log --object statu") == ["statusword"]
    assert complete("canopen monitor --object 5:statu") == ["5:statusword"]
    assert complete("canopen log plot a.log statu") == ["statusword"]
    assert complete("canopen eds show sample_io.eds prod") == ["producer_heartbeat_time"]
    assert complete("canopen read 3 -o ") == [""]  # a file: the shell's own completion
    shutil.rmtree(tmp_path / "own")
    assert complete("canopen read 3 statu") == []  # $CANOPEN_DATA is wrong: the command will tell


@pytest.mark.parametrize(
    "line", ["monitor --log ", "log decode ", "log convert a.log ", "eds show ", "net boot ", "machine check ", "plan ", "move "]
)
def test_files_are_completed_by_the_shell(complete, line: str) -> None:  # type: ignore[no-untyped-def]
    assert complete(f"canopen {line}") == [""]
    assert complete("canopen log decode --service ") == []
    assert complete("canopen read --json -b demo ") == ["3", "4", "5", "6", "7", "8"]


def test_no_command_is_imported_for_a_word_that_depends_on_files() -> None:
    """Or a word would take half a second of processor time."""
    program = (
        f"import sys; sys.path[:] = {sys.path!r}; from canopen_cli.app import main; main(); print(*sys.modules, file=sys.stderr)"
    )
    environment = {
        **os.environ,
        "_CANOPEN_COMPLETE": "zsh_complete",
        "COMP_WORDS": "canopen write 3 controlword ",
        "COMP_CWORD": "4",
    }
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=60, check=True
    )
    assert "sm_shutdown" in done.stdout
    loaded = set(done.stderr.split())
    assert {"canopen_master", "canopen_cli.node.objects", "trio", "rich.console", "can"}.isdisjoint(loaded)


@pytest.mark.parametrize(
    ("shell", "text"), [("bash", "complete -o nosort"), ("zsh", "#compdef canopen"), ("fish", "complete --no-files")]
)
def test_the_script_of_a_shell(run: Run, shell: str, text: str) -> None:
    outcome = run("completion", shell)
    assert outcome.status == 0
    assert text in outcome.out
    assert "_CANOPEN_COMPLETE" in outcome.out


def test_a_click_without_powershell_is_named(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    import canopen_cli.completion.completion as command

    monkeypatch.setattr(command, "get_completion_class", lambda name: None)
    outcome = run("completion", "pwsh")
    assert outcome.status == 2
    assert "CO141" in outcome.err


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash here")
def test_bash_takes_the_script_and_completes_a_name_with_a_colon(tmp_path: Path) -> None:
    start = tmp_path / "canopen"
    start.write_text(
        f"#!{sys.executable}\nimport sys; sys.path[:] = {sys.path!r}; from canopen_cli.app import main; sys.exit(main())\n",
        encoding="utf-8",
    )
    start.chmod(0o755)
    lines = (
        "source <(canopen completion bash)",
        "COMP_WORDS=(canopen read 3 identity_object:v)",
        "COMP_CWORD=3",
        "_canopen_completion canopen",
        'echo "${COMPREPLY[@]}" "$COMP_WORDBREAKS"',
    )
    environment = {**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        ["bash", "-c", "\n".join(lines)], env=environment, capture_output=True, text=True, timeout=60, check=True
    )
    reply, _, breaks = done.stdout.partition(" ")
    assert reply == "identity_object:vendor_id"
    assert ":" not in breaks
