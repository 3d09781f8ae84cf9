"""`canopen watch` and `canopen top` as their user sees them: see terminal.py."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.cli.terminal import Terminal, canopen, needs_tmux, terminals

pytestmark = needs_tmux

MODES = "; s=$?; stty -a | tr ' ;' '\\n\\n' | grep -x -e -icanon -e icanon -e -echo -e echo; (exit $s)"
"""Shows behind a command whether the terminal gives whole lines, and shows what is typed."""


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Callable[..., Terminal]]:
    with terminals(tmp_path) as open_one:
        yield open_one


def is_whole(lines: list[str]) -> bool:
    """Whether the terminal is as it was before."""
    return lines.count("icanon") == lines.count("echo") == 1 and "-icanon" not in lines and "-echo" not in lines


def test_watch_fills_the_screen_until_q(opened: Callable[..., Terminal]) -> None:
    terminal = opened(canopen("watch", "3", "--402", "-b", "demo") + MODES)
    shown = terminal.wait_for("6041:00 statusword", "switch on disabled  0000 0010 0100 0000", "-14000", "reads a second")
    assert shown[0].startswith("node 3 (0x03)  ")
    assert shown[0].endswith("  demo")
    assert shown[23] == "q end   p pause   r begin min and max again"
    terminal.press("p")
    terminal.wait_for("PAUSED")
    terminal.press("p")
    terminal.wait_for(lambda lines: "PAUSED" not in lines[0])
    terminal.resize(100, 30)
    terminal.wait_for(lambda lines: lines[29] == "q end   p pause   r begin min and max again")
    terminal.press("q")
    assert terminal.wait_for_end() == 0
    after = terminal.history()
    assert any(line.startswith("6064:00 position_actual_value") for line in after)
    assert sum(line.startswith("node 3 (0x03)") for line in after) == 1, "the last table only"
    assert is_whole(after)


def test_ctrl_c_gives_the_terminal_back(opened: Callable[..., Terminal]) -> None:
    terminal = opened("echo before; " + canopen("top", "-b", "demo") + MODES)
    shown = terminal.wait_for("3 (0x03)", "8 (0x08)", "pre-operational", "q end   p pause   s sort")
    assert "before" not in shown
    terminal.press("s", "s")
    terminal.press("C-c")
    assert terminal.wait_for_end() == 0
    after = terminal.history()
    assert after[0] == "before"
    assert "ended" in after
    assert "q end   p pause   s sort" not in after
    assert is_whole(after)


@pytest.mark.thorough
def test_what_a_device_no_longer_sends_is_stale_and_a_dead_bus_is_an_error(opened: Callable[..., Terminal]) -> None:
    bus = opened(canopen("bus", "serve", "--port", "0"))
    where = re.search(r"tcp:\S*[0-9]", "\n".join(bus.wait_for("Join it")))
    assert where is not None
    device = opened(canopen("sim", "--id", "5", "-b", where[0]))
    device.wait_for("1 simulated drive")
    watch = opened(canopen("watch", "5", "6064", "-b", where[0]) + MODES)
    top = opened(canopen("top", "-b", where[0]) + MODES)
    watch.wait_for("6064:00 position_actual_value", lambda lines: "STALE" not in "".join(lines))
    top.wait_for("5 (0x05)")
    device.press("C-c")
    assert device.wait_for_end() == 0
    watch.wait_for("STALE: the node does not answer SDO requests")
    top.wait_for("SILENT")
    bus.press("C-c")
    assert bus.wait_for_end() == 0
    for terminal in (watch, top):
        assert terminal.wait_for_end() == 4
        after = terminal.history()
        assert any(line.startswith("error CO111: ") for line in after)
        assert is_whole(after)


@pytest.mark.thorough
def test_keys_come_from_the_terminal_though_the_frames_come_by_a_pipe(opened: Callable[..., Terminal], tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "frames")
    terminal = opened(canopen("top", "--log", "-", "--bitrate", "500k") + " < frames" + MODES)
    with (tmp_path / "frames").open("w") as frames:
        frames.write("(1.0) can0 705#05\n(1.1) can0 085#3081110000000000\n(1.2) can1 706#7F\n(1.3) can0 705#05\n")
        frames.flush()
        terminal.wait_for("5 (0x05) operational", "EMCY 0x8130", "b next bus", "(1 of 2)")
        terminal.press("b")
        terminal.wait_for("6 (0x06) pre-operational", "(2 of 2)")
        terminal.wait_for("NOTHING HEARD")  # the pipe is open and silent
        terminal.press("q")
        assert terminal.wait_for_end() == 0
    after = terminal.history()
    assert is_whole(after)
    assert any("5 (0x05)" in line for line in after)


@pytest.mark.thorough
def test_a_recording_that_ends_leaves_its_last_values(opened: Callable[..., Terminal], tmp_path: Path) -> None:
    (tmp_path / "t.log").write_text("(1.0) can0 185#3706000001000000\n(1.1) can0 705#05\n")
    terminal = opened(canopen("watch", "5", "6041", "6064", "--log", "t.log") + MODES)
    assert terminal.wait_for_end() == 0
    after = terminal.history()
    assert after[0].startswith("node 5 (0x05)  operational")
    assert "        operation enabled  0000 0110 0011 0111" in after
    assert is_whole(after)
