"""`canopen monitor`, `watch` and `top` in a terminal: see terminal.py."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.cli.terminal import Terminal, canopen, needs_tmux, terminals
from tests.cli.test_monitor import LOG

pytestmark = needs_tmux


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Callable[..., Terminal]]:
    with terminals(tmp_path) as open_one:
        yield open_one


Open = Callable[..., Terminal]


def test_monitor_on_80_columns(opened: Open, tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(LOG)
    terminal = opened(canopen("monitor", "--log", "a.log"), lines=30)
    assert terminal.wait_for_end() == 0
    lines = terminal.screen()
    assert lines[:4] == [
        "    0.0000 705 boot-up     5",
        "    0.1000 605 SDO         5  read 6041:00 statusword",
        "    0.1010 585 SDO         5  read 6041:00 statusword = 592 (0x250,",
        "                              switch_on_disabled, voltage_enabled, remote)",
    ]
    (wrong,) = [number for number, line in enumerate(lines) if line.startswith("! ")]
    assert lines[wrong] == "! missing (likely): node 5: frames are missing here: an SDO answer whose request"
    assert lines[wrong + 1] == "  is not there"
    assert "15 frames in 1.0 s, 1 finding" in lines
    coloured = terminal.screen(colours=True)
    assert coloured[wrong].startswith("\x1b[1m\x1b[31m! missing (likely)")
    assert coloured[0].startswith("\x1b[1m\x1b[32m    0.0000 705 boot-up")


@pytest.mark.thorough
def test_monitor_on_a_wide_terminal_shows_the_bytes(opened: Open, tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(LOG)
    terminal = opened(canopen("monitor", "--log", "a.log", "--no-color", "--node", "5"), columns=120)
    assert terminal.wait_for_end() == 0
    assert not re.search("\x1b\\[[0-9;]*3[1-7]m", "\n".join(terminal.screen(colours=True)))
    assert terminal.screen()[1] == "    0.100000 605#4041600000000000      SDO         5  read 6041:00 statusword"


def test_monitor_of_a_bus_until_ctrl_c(opened: Open) -> None:
    terminal = opened(canopen("monitor", "-b", "demo"))
    lines = terminal.wait_for("705 heartbeat   5  pre-operational")
    assert lines[0] == "demo, until Ctrl-C; nothing is sent"
    assert "705 boot-up     5" in lines[3]
    terminal.resize(60, 24)
    terminal.press("C-c")
    assert terminal.wait_for_end() == 0
    counts, ended = [line for line in terminal.screen() if line][-2:]
    assert re.fullmatch(r"(\^C)?[0-9]+ frames in [0-9.]+ s, no findings", counts)
    assert ended == "ended"


def test_monitor_in_a_pipe_is_plain_and_ends_with_its_reader(opened: Open) -> None:
    terminal = opened(f"{canopen('monitor', '-b', 'demo', '-q')} | head -n 2 | cat -v")
    assert terminal.wait_for_end() == 0
    first, second = [line for line in terminal.screen() if line]
    assert first == "    0.000000 703#00                    boot-up     3"
    assert second.endswith("boot-up     4")


def test_monitor_shows_what_comes_by_a_pipe_at_once(opened: Open, tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(LOG)
    terminal = opened(f"(cat a.log; exec sleep 1000) | {canopen('monitor', '--log', '-', '--service', 'emcy,?')}")
    terminal.wait_for("0x8110 CAN overrun")
    terminal.press("C-c")
    assert terminal.wait_for_end() == 0
    assert "15 frames in 1.0 s, 1 shown, 1 finding" in "\n".join(terminal.screen())
