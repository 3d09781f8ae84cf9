"""A terminal in which a command runs, seen and used as its user does: by tmux, without a window.

    terminal = opened(canopen("monitor", "-b", "demo"))
    terminal.wait_for("heartbeat")
    terminal.press("C-c")
    assert terminal.wait_for_end() == 130

Mark such tests with `needs_tmux`. Nothing sleeps: a wait looks at the screen each time the command has written, and fails with a
picture of the screen if nothing it waits for comes within LIMIT.
"""

from __future__ import annotations

import contextlib
import os
import select
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

LIMIT = 60.0
"""Seconds after which a wait fails. It is long because the computer may be busy; no passing test waits for it."""
LOOK = 0.2
"""Seconds after which the screen is looked at again in any case: the end of a command writes nothing."""

needs_tmux = pytest.mark.skipif(shutil.which("tmux") is None, reason="tmux is not installed: apt-get install tmux")

_SETTINGS = """\
set -g status off
set -g remain-on-exit on
set -g remain-on-exit-format ""
set -g default-terminal tmux-256color
set -g escape-time 0
set -g history-limit 2000
"""
_TELLING_STATUS = "trap : INT; {}; printf '\\033]2;status %s\\007' $?"
"""The title of the terminal tells the exit status, once all before it is on the screen. The trap keeps the shell from ending
by Ctrl-C itself."""
_PROGRAM = "import sys; from canopen_cli.entry import main; sys.exit(main())"


def canopen(*arguments: str) -> str:
    """Return the words of a shell that run the command of this tree."""
    return shlex.join([sys.executable, "-c", _PROGRAM, *arguments])


class Terminal:
    """A terminal of this size. command: a line of a shell, which runs at once, in this folder."""

    def __init__(self, command: str, folder: Path, columns: int = 80, lines: int = 24) -> None:
        self._own = Path(tempfile.mkdtemp(prefix="tmux"))  # the path of a socket must be short
        (self._own / "settings").write_text(_SETTINGS)
        self._written = self._own / "written"
        os.mkfifo(self._written)
        self._pipe = os.open(self._written, os.O_RDWR | os.O_NONBLOCK)
        size = ("-x", str(columns), "-y", str(lines))
        begin = ("-f", str(self._own / "settings"), "new-session", "-d", *size, "-c", str(folder))
        self._tmux(*begin, _TELLING_STATUS.format(command))
        self._tmux("pipe-pane", "-O", f"exec cat > {shlex.quote(str(self._written))}")

    def screen(self, *, colours: bool = False) -> list[str]:
        """Return the lines that are to be seen, without blanks at their ends. colours: with their escape sequences."""
        shown = self._tmux("capture-pane", "-p", *(["-e"] if colours else []))
        return [line.rstrip() for line in shown.split("\n")]

    def history(self) -> list[str]:
        """Return all lines since the beginning, also those that have left the screen at its top."""
        return [line.rstrip() for line in self._tmux("capture-pane", "-p", "-S", "-").rstrip("\n").split("\n")]

    def wait_for(self, *wanted: str | Callable[[list[str]], object]) -> list[str]:
        """Wait until the screen shows each of these texts, and each of these conditions holds; return the screen."""

        def is_shown(lines: list[str]) -> bool:
            text = "\n".join(lines)
            return all(each in text if isinstance(each, str) else each(lines) for each in wanted)

        self._wait(lambda: is_shown(self.screen()), " and ".join(map(str, wanted)))
        return self.screen()

    def wait_for_end(self) -> int:
        """Wait until the command has ended; return its exit status."""
        self._wait(lambda: self._title().startswith("status "), "the end of the command")
        return int(self._title().removeprefix("status "))

    def press(self, *keys: str) -> None:
        """Press keys, by tmux's names: q, Enter, C-c, Left."""
        self._tmux("send-keys", *keys)

    def resize(self, columns: int, lines: int) -> None:
        """Give the window another size."""
        self._tmux("resize-window", "-x", str(columns), "-y", str(lines))

    def close(self) -> None:
        """End what runs in it."""
        self._tmux("kill-server")
        os.close(self._pipe)
        shutil.rmtree(self._own, ignore_errors=True)

    def _wait(self, is_so: Callable[[], bool], what: str) -> None:
        end = time.monotonic() + LIMIT
        while not is_so():
            if time.monotonic() > end:
                pytest.fail(f"not seen: {what}\n" + "\n".join(f"| {line}" for line in self.screen()))
            select.select([self._pipe], [], [], LOOK)
            with contextlib.suppress(BlockingIOError):
                while os.read(self._pipe, 1 << 16):
                    pass

    def _title(self) -> str:
        return self._tmux("display-message", "-p", "#{pane_title}").strip()

    def _tmux(self, *words: str) -> str:
        command = ["tmux", "-u", "-S", str(self._own / "socket"), *words]
        ended = subprocess.run(command, capture_output=True, text=True, env=self._environment(), timeout=LIMIT)
        assert ended.returncode == 0, (words, ended.stderr)
        return ended.stdout

    def _environment(self) -> dict[str, str]:
        """The environment of a user without files and settings of his own, in which Python finds this tree."""
        kept = {name: os.environ[name] for name in ("PATH", "TMPDIR") if name in os.environ}
        path = os.pathsep.join(each for each in sys.path if each)
        return {**kept, "HOME": str(self._own), "PYTHONPATH": path, "LC_ALL": "C.UTF-8", "SHELL": "/bin/sh"}


@contextmanager
def terminals(folder: Path) -> Iterator[Callable[..., Terminal]]:
    """Give a function that opens terminals in this folder; close them at the end of the block."""
    opened: list[Terminal] = []

    def open_one(command: str, columns: int = 80, lines: int = 24) -> Terminal:
        opened.append(Terminal(command, folder, columns, lines))
        return opened[-1]

    try:
        yield open_one
    finally:
        for each in opened:
            each.close()
