"""The Python examples of the README and of some pages run as they stand: what runs in trio in virtual time."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import trio
from trio.testing import MockClock

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
NAMES = (
    "devices.md",
    "own-device.md",
    "machine.md",
    "first-move.md",
    "recording.md",
    "lss.md",
    "flash.md",
    "network.md",
    "gateway.md",
    "web.md",
    "master.md",
    "core.md",
    "start-no-hardware.md",
)
PAGES = "".join((ROOT / "docs" / name).read_text(encoding="utf-8") for name in NAMES)
EXAMPLES = re.findall(r"```python\n(.*?)```", TEXT + PAGES, re.DOTALL)
THREADED = [number for number, example in enumerate(EXAMPLES) if "import direct" in example]
"""Their connection is a thread, so the end of its process counts too."""
LIMIT = 60  # seconds, for a machine that is busy with other things


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 5
    assert THREADED


@pytest.mark.parametrize("number", [number for number in range(len(EXAMPLES)) if number not in THREADED])
def test_example(number: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run = trio.run

    def run_in_virtual_time(main: Any) -> Any:
        return run(main, clock=MockClock(autojump_threshold=0))

    monkeypatch.setattr(trio, "run", run_in_virtual_time)
    exec(compile(EXAMPLES[number], f"example {number}", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out.strip(), "an example shows something"


@pytest.mark.parametrize("number", THREADED)
def test_an_example_with_a_thread_is_a_script_that_ends(number: int) -> None:
    path = os.pathsep.join(sys.path)
    script = [sys.executable, "-W", "error", "-c", EXAMPLES[number]]
    ran = subprocess.run(
        script, capture_output=True, text=True, timeout=LIMIT, env={**os.environ, "PYTHONPATH": path}, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.strip(), "an example shows something"


def test_the_two_commands() -> None:
    assert "python3 -m venv .venv && .venv/bin/pip install -q '.[all]' && .venv/bin/canopen demo" in TEXT
    assert ".venv/bin/pip install -q '.[all,test]' && .venv/bin/pytest -q" in TEXT


def test_links_lead_somewhere() -> None:
    for document in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        for target in re.findall(r"\]\(([^)#]+)\)", document.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (document.parent / target).exists(), f"{document.name}: {target}"
