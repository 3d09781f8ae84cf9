"""docs/start-script.md: its shell blocks as a shell runs them, its program as Python runs it, and their exit statuses."""

from __future__ import annotations

import csv
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs_build import DOCS

PAGE = (DOCS / "start-script.md").read_text(encoding="utf-8")
SHELL = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
(PROGRAM,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def environment(folder: Path) -> dict[str, str]:
    """This Python's packages, and `canopen` on the path: as an installed one, from wherever the tests take it."""
    command = folder / "canopen"
    start = "import sys; from canopen_cli.entry import main; sys.exit(main())"
    command.write_text(f"#!/bin/sh\nexec {sys.executable} -c '{start}' \"$@\"\n", encoding="ascii")
    command.chmod(0o755)
    own = {
        "CANOPEN_DATA": str(folder),
        "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    return {**os.environ, **own}


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_the_shell_blocks(tmp_path: Path) -> None:
    script = "\n".join(SHELL).replace("--every 1s --for 3s", "--every 100ms --for 600ms")
    work = tmp_path / "work"
    work.mkdir()
    done = subprocess.run(
        ["bash", "-eu", "-c", script], cwd=work, env=environment(tmp_path), capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-3:] == ["node 3: read", "node 4: read", "node 9: status 5"]
    with (work / "values.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["name"] for row in rows} == {"statusword", "position_actual_value", "torque_actual_value"}
    assert set(rows[0]) == set(re.findall(r"`(\w+)`", PAGE.partition("for each value that came:")[2].partition(". A file")[0]))
    assert "CO201" in (work / "node9.err").read_text(encoding="utf-8")


@pytest.mark.parametrize(("arguments", "status"), [((), 0), (("9",), 5)])
def test_the_program(tmp_path: Path, arguments: tuple[str, ...], status: int) -> None:
    program = tmp_path / "values.py"
    program.write_text(PROGRAM.replace("time.sleep(1)", "time.sleep(0)"), encoding="utf-8")
    command = [sys.executable, "-W", "error", str(program), *arguments]
    done = subprocess.run(command, cwd=tmp_path, env=environment(tmp_path), capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr
    rows = (tmp_path / "samples.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == (1 if status else 4)
    assert ("CO201: node 9 did not answer" in done.stderr) is bool(status)
