"""What commands write where little room is, or nobody reads."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from canopen_cli.shared.screen import Screen
from tests.cli.cli_support import Run, runner


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return runner(capsys, monkeypatch, tmp_path_factory.mktemp("own"))


@pytest.mark.parametrize("width", ["40", "60", "72"])
def test_facts_hang_below_themselves(run: Run, monkeypatch: pytest.MonkeyPatch, width: str) -> None:
    monkeypatch.setenv("COLUMNS", width)
    lines = run("info", "3", "-b", "demo").out.splitlines()
    assert max(map(len, lines)) <= int(width)
    below = [line for line in lines if line.startswith(" ")]
    assert below
    assert all(line.startswith(" " * 18) and line[18] != " " for line in below)


def test_a_fact_without_a_text(capsys: pytest.CaptureFixture[str]) -> None:
    Screen(color=False).fact("name", "")
    assert capsys.readouterr().out == "name              \n"


@pytest.mark.thorough(2)
@pytest.mark.skipif(sys.platform == "win32", reason="no poll")
@pytest.mark.parametrize("moment", ["arm1 of", "✔ boot"])
def test_a_demonstration_ends_with_its_reader(tmp_path: Path, moment: str) -> None:
    program = "import sys; from canopen_cli.app import main; sys.exit(main(['demo', '--seconds', '60']))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(each for each in sys.path if each), "CANOPEN_DATA": str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        encoding="utf-8",
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        while moment not in process.stderr.readline():
            assert process.poll() is None
        process.stdout.close()
        rest = process.stderr.read()
        assert process.wait(30) == 141  # long before the 60 s are over
    assert "error" not in rest
    assert "Traceback" not in rest
