"""docs/move-an-arm.md: each of its blocks moves a simulated arm, in virtual time; its picture is there."""

from __future__ import annotations

import itertools
import math
import re
from functools import partial
from pathlib import Path
from types import ModuleType

import pytest
import trio
from trio.testing import MockClock

from canopen_master import read_record
from tests.docs_build import DOCS, load_build

PAGE = DOCS / "move-an-arm.md"
NAMES = re.findall(r"^async def (\w+)\(arm", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
LIMITS = (90.0, 360.0, 3600.0)
"""Per second, second² and second³."""


@pytest.fixture(scope="module")
def build() -> ModuleType:
    return load_build()


@pytest.mark.thorough(12)
@pytest.mark.parametrize("name", [name for name in NAMES if name != "begin"])
def test_each_block_runs_within_the_limits(build: ModuleType, name: str, tmp_path: Path) -> None:
    pytest.importorskip("ruckig")
    file = tmp_path / "run.csv"
    build.run_on_arms(build.arm_examples()[name], file)
    record = read_record(file)
    for joint in ("joint1", "joint2"):
        points = [each for each in record.of(joint, "set_point") if not math.isnan(each)]
        if name == "refused":
            assert set(points) <= {0.0}
            continue
        assert max(points) - min(points) > 3.0, "it moves"
        rates = points
        for limit in LIMITS:
            rates = [(after - before) / 0.01 for before, after in itertools.pairwise(rates)]
            assert max(map(abs, rates)) <= 1.001 * limit


def test_the_whole_program(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("ruckig")
    (program,) = re.findall(r"```python\n((?:(?!```).)*__main__.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.setattr(trio, "run", partial(trio.run, clock=MockClock(autojump_threshold=0)))
    exec(compile(program, PAGE.name, "exec"), {"__name__": "__main__"})
    told = capsys.readouterr().out
    assert told.startswith("at [20, 20, 20, 20, 20, 20]\nCO402: chain arm was stopped: joint3 (node 5 on can0) fell into fault\n")
    assert "cause: it is in fault: 0x2310" in told
    assert told.endswith("back at [0, 0, 0, 0, 0, 0]\n")


@pytest.mark.thorough
def test_the_picture_is_drawn_and_shown(build: ModuleType, tmp_path: Path) -> None:
    pytest.importorskip("ruckig")
    assert "](move-an-arm.png)" in PAGE.read_text(encoding="utf-8")
    assert (DOCS / "move-an-arm.png").stat().st_size > 10_000
    assert "joint1 up to 90" in build.draw_arm(tmp_path / "arm.png")
    assert (tmp_path / "arm.png").read_bytes().startswith(b"\x89PNG")
