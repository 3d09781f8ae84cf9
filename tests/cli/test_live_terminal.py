"""`canopen monitor`, `watch` and `top` in a terminal: see terminal.py."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.cli.terminal import Terminal, canopen, needs_tmux, terminals

pytestmark = needs_tmux


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Callable[..., Terminal]]:
    with terminals(tmp_path) as open_one:
        yield open_one


def test_a_command_that_serves_until_ctrl_c(opened: Callable[..., Terminal]) -> None:
    terminal = opened(canopen("sim", "--id", "5", "-b", "virtual:x"))
    terminal.wait_for("1 simulated drive on virtual:x, until Ctrl-C")
    terminal.resize(100, 30)
    assert len(terminal.screen()) >= 30
    terminal.press("C-c")
    assert terminal.wait_for_end() == 0
    assert "^Cended" in terminal.screen()  # the terminal shows the key
    assert terminal.history()[0].startswith("1 simulated drive")
