"""docs/embedding.md: each host runs as it stands there, behind the block that all share."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[1] / "docs" / "embedding.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^## ([^\n]+)\n(?:(?!^## ).)*?```python\n(.*?)```", PAGE, re.DOTALL | re.MULTILINE)
SHARED = BLOCKS[0][1]
HOSTS = {title: code for title, code in BLOCKS[1:] if title != "Qt"}
TOLD = {
    "A plain loop": r"statusword 0x[0-9A-F]{4}",
    "Threads with a queue": r"statusword 0x[0-9A-F]{4}\nthe device has [0-9]+ CAN-IDs",
    "Qt": r"statusword 0x[0-9A-F]{4}",
    "selectors": r"statusword 0x[0-9A-F]{4}",
    "asyncio": r"statusword 0x[0-9A-F]{4}",
    "trio": r"statusword 0x[0-9A-F]{4}",
    "A simulator's clock": r"statusword 0x[0-9A-F]{4}; the other procedure ended at 600 s",
    "A gateway between two buses": r"statusword 0x[0-9A-F]{4}",
}
"""What each host prints."""


def test_all_hosts_are_known() -> None:
    assert [title for title, _ in BLOCKS[1:]] == [*TOLD]


@pytest.mark.parametrize("title", HOSTS)
def test_host(title: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(SHARED + HOSTS[title], title, "exec"), {"__name__": "host"})
    assert re.fullmatch(TOLD[title], capsys.readouterr().out.strip())


def test_qt() -> None:
    """In a process of its own: an application of Qt ends with it."""
    if importlib.util.find_spec("PySide6") is None:
        pytest.skip("PySide6 is not installed: pip install PySide6-Essentials")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "QT_QPA_PLATFORM": "offscreen"}
    script = [sys.executable, "-W", "error", "-c", SHARED + dict(BLOCKS)["Qt"]]
    done = subprocess.run(script, capture_output=True, text=True, timeout=60, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(TOLD["Qt"], done.stdout.strip())
