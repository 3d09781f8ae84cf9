"""The benchmarks run, and both libraries come to the same results in each case (no word about how fast)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

RUN = Path(__file__).resolve().parents[2] / "benchmarks" / "run.py"


def test_each_kind_of_case_runs_and_both_sides_agree() -> None:
    large = (  # 1 MiB is 64 KiB again, sixteen times as long
        "SDO upload of 64 KiB (machines)",
        "SDO download of 64 KiB (Networks)",
        "SDO block upload of 64 KiB (Networks)",
        "SDO block download of 64 KiB (machines)",
    )
    things = ("SDO expedited upload", *large, "PDO decode", "heartbeat")
    command = [sys.executable, str(RUN), *things, "--rounds", "1", "--seconds", "0.001"]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert finished.returncode == 0, finished.stderr
    rows = [line for line in finished.stdout.splitlines() if line.startswith("| ")]
    for thing in things:
        assert any(thing in row for row in rows)


def test_a_word_that_is_in_no_title_is_an_error() -> None:
    finished = subprocess.run([sys.executable, str(RUN), "nosuchcase"], capture_output=True, text=True, timeout=100, check=False)
    assert finished.returncode == 2
    assert "no case has one of these words" in finished.stderr
