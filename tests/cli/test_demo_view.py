"""The picture of joints that move: what a terminal of 80 columns shows."""

from __future__ import annotations

import pytest
from rich.console import Console

from canopen_cli.motion.view import DemoView, JointView
from canopen_cli.shared.screen import Screen


@pytest.mark.parametrize("columns", [80, 120])
def test_names_and_positions_are_whole(columns: int) -> None:
    screen = Screen()
    screen.err = Console(width=columns)
    joints = [JointView(f"joint{number}", number + 98, "not ready to switch on", -123.45) for number in range(1, 7)]
    view = DemoView(screen, "a title", 180.0, joints)
    with screen.err.capture() as shown:
        screen.err.print(view._picture())
    lines = [line for line in shown.get().splitlines() if "node" in line]
    assert [line.split()[0] for line in lines] == [joint.name for joint in joints]
    assert all("(0x6" in line and line.rstrip().endswith("-123.45°") and "…" not in line for line in lines)
