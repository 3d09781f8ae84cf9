"""`canopen run` and `canopen shell`: Python on an open bus. Whatever is typed, the prompt goes on."""

from __future__ import annotations

import io
import os
import random
import select
import signal
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st

from canopen_cli.scripting import shell as shell_module
from canopen_cli.scripting.namespace import names_for
from canopen_cli.scripting.shell import Prompt, TerminalLines
from canopen_cli.scripting.text_plot import statement_of
from canopen_cli.scripting.words import words_for
from canopen_cli.shared.options import Settings
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.session import open_session
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.drives.cia402.objects import PROFILE_VELOCITY
from tests.cli.cli_support import Alarm, Run, runner_in_folder, stands
from tests.cli.terminal import canopen
from tests.examples import examples

DEMO = ("-b", "demo")


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    return runner_in_folder(capsys, monkeypatch, tmp_path)


def script(text: str) -> str:
    Path("script.py").write_text(text)
    return "script.py"


# ---- run ----


def test_a_script_finds_an_open_bus(run: Run) -> None:
    text = "print(args, bus)\nvalue = await nodes['3'].read_int('statusword')\nprint(value == await nodes[3].read_int('6041'))\n"
    outcome = run("run", script(text), "one", "two", *DEMO)
    assert outcome.status == ExitCode.OK, outcome.err
    assert outcome.out == "['one', 'two'] virtual:demo\nTrue\n"


def test_its_main_is_called_with_the_master_and_the_arguments(run: Run) -> None:
    text = "async def main(master, name):\n    print(name, await master.node(4).read_int('1000'))\n"
    assert run("run", script(text), "x", *DEMO).out == "x 131474\n"


@pytest.mark.parametrize(
    ("text", "seen", "code"),
    [
        ("pass\n1 / 0\n", "script.py:2: ZeroDivisionError: division by zero", "CO157"),
        ("def f():\n    return nothing\nf()\n", "script.py:2: NameError", "CO157"),
        ("if\n", "script.py:1: SyntaxError", "CO157"),
        ("read 3 statusword\n", "print(await nodes[5].read('statusword'))", "CO157"),
        ("await nodes[3].read('no_such_object')\n", "at script.py:1", "CO302"),
        ("await nodes[3].read(0x5000)\n", "at script.py:1", "CO302"),
    ],
)
def test_a_failure_names_the_line(run: Run, text: str, seen: str, code: str) -> None:
    outcome = run("run", script(text), *DEMO)
    assert seen in outcome.err
    assert code in outcome.err
    assert outcome.status not in (ExitCode.OK, ExitCode.INTERNAL)
    assert "Traceback" not in outcome.err


def test_a_script_that_is_not_there(run: Run) -> None:
    assert run("run", "nothing.py", *DEMO).status == ExitCode.BAD_FILE


def test_ctrl_c_halts_what_a_script_moves(run: Run, alarm: Alarm, simulations: list[SimulatedDevices]) -> None:
    text = "import trio\nfor word in (6, 7, 15):\n    await nodes[3].write('controlword', word)\nawait trio.sleep_forever()\n"
    alarm.set((1.0, signal.SIGINT))
    outcome = run("run", script(text), *DEMO)
    assert outcome.status == ExitCode.INTERRUPTED
    assert "interrupted" in outcome.err
    assert stands(simulations[0].drives[3])


def test_a_dry_run_of_a_script_sends_nothing_but_what_reads(run: Run, simulations: list[SimulatedDevices]) -> None:
    text = "await nodes[3].write('6081', 123)\nprint(await nodes[3].read_int('6081'))\n"
    outcome = run("run", script(text), "--dry-run", *DEMO)
    assert "123" in outcome.out
    assert "profile_velocity = 123" in outcome.out
    assert simulations[0].drives[3].values[PROFILE_VELOCITY] != 123


# ---- shell ----


def typed(run: Run, monkeypatch: pytest.MonkeyPatch, text: str, *options: str) -> Any:
    async def whole() -> str:
        return text

    monkeypatch.setattr(shell_module, "_input", whole)
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    return run("shell", "3", *options, *DEMO)


def test_statements_of_a_pipe_show_what_they_are_worth(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "x = 1\nx + 1\n'[bold]'\nawait node.read_int('1000')\nfor each in range(2):\n    each\nNone\n"
    outcome = typed(run, monkeypatch, text)
    assert outcome.status == ExitCode.OK, outcome.err
    assert outcome.out.split() == ["2", "'[bold]'", "131474", "0", "1"]


def test_the_first_failure_of_a_pipe_ends_it(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = typed(run, monkeypatch, "1\n2 / 0\n3\n")
    assert (outcome.status, outcome.out) == (ExitCode.DIFFERENT, "1\n")
    assert "<shell>:2: ZeroDivisionError" in outcome.err
    assert typed(run, monkeypatch, "x = (\n").status == ExitCode.DIFFERENT
    assert typed(run, monkeypatch, "raise SystemExit\nprint('on')\n").out == ""


class Typed:
    """Lines as a user types them; a Ctrl-C where it says so."""

    def __init__(self, *lines: str) -> None:
        self._lines = list(lines)
        self.prompts: list[str] = []

    async def next(self, prompt: str) -> str | None:
        await trio.lowlevel.checkpoint()
        self.prompts.append(prompt)
        if not self._lines:
            return None
        line = self._lines.pop(0)
        if line == "^C":
            raise KeyboardInterrupt
        return line


def served(lines: Typed, names: dict[str, Any] | None = None) -> None:
    prompt = Prompt(Settings(json=False, no_color=True).screen(), {} if names is None else names)
    trio.run(prompt.serve, lines)


def test_a_prompt_goes_on_after_whatever_fails(capsys: pytest.CaptureFixture[str]) -> None:
    first = ("1 / 0", "if", "x = (", "^C", "def f():", "    return 5", "", "f()")
    lines = Typed(*first, "\0", "import trio; await trio.sleep(0)", "_ + 1")
    served(lines)
    out, err = capsys.readouterr()
    assert out.split() == ["5", "6"]
    assert "ZeroDivisionError" in err
    assert err.count("CO157") == 3
    assert lines.prompts[3] == "... "
    served(Typed("raise SystemExit", "print('on')"))
    assert capsys.readouterr().out == ""


def test_ctrl_c_ends_a_statement_and_not_the_prompt(capsys: pytest.CaptureFixture[str]) -> None:
    def later() -> None:
        signal.raise_signal(signal.SIGINT)

    served(Typed("import trio", "later(); await trio.sleep_forever()", "'on'"), {"later": later})
    out, err = capsys.readouterr()
    assert out == "'on'\n"
    assert "interrupted" in err


@examples(60)
@given(st.lists(st.text(st.characters(codec="utf-8"), max_size=12), max_size=6))
def test_whatever_lines_are_typed_the_prompt_ends_with_its_input(lines: list[str]) -> None:
    safe = [each for each in lines if "(" not in each]  # nothing is called
    served(Typed(*safe), {"__builtins__": {}})


@pytest.mark.parametrize(
    ("line", "statement"),
    [
        ("plot 5:velocity_actual_value", "await plot('5:velocity_actual_value')"),
        ("plot statusword 5:6064 10s", "await plot('statusword', '5:6064', seconds=10.0)"),
        ("plot statusword for 500ms", "await plot('statusword', seconds=0.5)"),
        ("plot is None", "plot is None"),
        ("plot = 5", "plot = 5"),
        ("plot", "plot"),
        ("plot + 5", "plot + 5"),
        ("await plot('x')", "await plot('x')"),
        ("  plot x", "  plot x"),
    ],
)
def test_a_line_that_plots_is_a_call(line: str, statement: str) -> None:
    assert statement_of(line) == statement


def test_a_plot_draws_what_was_read(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    async def typed() -> str:
        return "await node.write('6081', 7)\nplot 6081 4:statusword 1s\nplot 1008 1s\n"

    monkeypatch.setattr(shell_module, "_input", typed)
    outcome = run("shell", "3", "-b", "demo")
    assert "node 3 (0x03): profile_velocity = 7" in outcome.out
    assert "node 4 (0x04): statusword = 576" in outcome.out
    assert any(0x2801 <= ord(each) <= 0x28FF for each in outcome.out)
    assert outcome.status == ExitCode.USAGE  # a name is no number
    assert "is no number" in outcome.err


def test_what_is_completed() -> None:
    async def look() -> None:
        async with open_session(settings, settings.screen()) as session:
            names = names_for(session, 3)

            def words(text: str) -> list[str]:
                return words_for(text, names)[1]

            assert "master" in words("ma")
            assert words("await nod") == ["node", "nodes"]
            assert "read_int" in words("await node.read_")
            assert words("nodes[") == ["3"]
            assert "statusword" in words("await node.read('statusw")
            assert "statusword" in words('await nodes[3].read("statusw')
            assert "sm_shutdown" in words("await node.write('controlword', 'sm_sh")
            assert "velocity_actual_value" in words("plot velocity")
            assert "4:velocity_actual_value" in words("plot statusword 4:velocity")
            assert words("1 + ") == words("node.read('no_such_") == words("nothing.x") == words("nodes['") == []

    settings = Settings(bus="demo")
    trio.run(look, clock=trio.testing.MockClock(autojump_threshold=0))


@examples(100)
@given(st.text(st.sampled_from("node.s[]'\"(), 3_ra\\\n\0ü"), max_size=24))
def test_completion_never_fails(text: str) -> None:
    begun, found = words_for(text, {"node": object(), "nodes": 5, "s": {"a": 1}})
    assert text.endswith(begun) or begun == ""
    assert found == sorted(found)


KEYS = [*"abx=1()[]'\". :#\\ü", "\t", "\r", "\x1b", "\x7f", *"\x01\x05\x0b\x12\x18", *("\x1b[" + each for each in "ABCD")]
"""Letters, signs, Tab, Enter, Escape, the Backspace, some with Ctrl, arrows."""


@examples(20, part=4)
@given(st.lists(st.sampled_from(KEYS), max_size=30))
def test_random_keys_never_end_a_prompt_with_a_traceback(keys: list[str]) -> None:
    """Keys of a terminal, in this process: Ctrl-C and Ctrl-D behind them end it."""
    pytest.importorskip("prompt_toolkit", reason="prompt_toolkit is not installed")
    from prompt_toolkit.input import create_pipe_input
    from prompt_toolkit.output import DummyOutput

    async def serve() -> None:
        prompt = Prompt(Settings(no_color=True).screen(), {"__builtins__": {}})
        lines.complete_from(prompt.names)
        await prompt.serve(lines)

    with create_pipe_input() as pipe:
        lines = TerminalLines(input=pipe, output=DummyOutput())
        pipe.send_text("".join(keys) + "\x1b\x1b\x07\x03\x03\x04\x03\x04\x03\x04")
        pipe.close()
        trio.run(serve)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no pty")
@pytest.mark.thorough(2)
@pytest.mark.parametrize("end", ["Ctrl-D", signal.SIGTERM])
def test_the_terminal_is_given_back(tmp_path: Path, end: str | signal.Signals) -> None:
    """A real terminal: its settings are the same as before, whatever was typed, and however the prompt ended."""
    pytest.importorskip("prompt_toolkit", reason="prompt_toolkit is not installed")
    import pty
    import termios

    draw = random.Random(7)
    keys = "".join(draw.choice("abc=1 .'\t\r\x1b\x7f\x01") for _ in range(200)).encode()
    child, terminal = pty.fork()
    if not child:
        os.environ.update(CANOPEN_DATA=str(tmp_path), TERM="xterm", PYTHONPATH=os.pathsep.join(each for each in sys.path if each))
        os.execvp("/bin/sh", ["sh", "-c", f"exec {canopen('shell', '3', '-b', 'demo', '-q')}"])
    before = termios.tcgetattr(terminal)
    seen = b""

    def read_until(done: Any) -> None:
        nonlocal seen
        limit = time.monotonic() + 90
        while not done():
            assert time.monotonic() < limit, seen
            if select.select([terminal], [], [], 0.2)[0]:
                try:
                    seen += os.read(terminal, 65536)
                except OSError:  # the other end is closed
                    return

    read_until(lambda: b">>>" in seen)
    os.write(terminal, keys)
    read_until(lambda: len(seen) > 100)
    os.write(terminal, b"\x03")  # empties the line, in which a Ctrl-D would delete
    if isinstance(end, signal.Signals):
        os.kill(child, end)

    def is_over() -> bool:
        if isinstance(end, str):
            os.write(terminal, b"\x04")
        return False

    read_until(is_over)  # until the other end is closed
    _, status = os.waitpid(child, 0)
    after = termios.tcgetattr(terminal)
    os.close(terminal)
    assert b"Traceback" not in seen
    assert os.waitstatus_to_exitcode(status) == (ExitCode.OK if isinstance(end, str) else ExitCode.INTERRUPTED)
    assert after[3] & (termios.ICANON | termios.ECHO) == before[3] & (termios.ICANON | termios.ECHO)
