"""The benchmarks run, and both libraries come to the same results in each case (no word about how fast)."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

from canopen_proto import COMPILED

RUN = Path(__file__).resolve().parents[2] / "benchmarks" / "run.py"


@pytest.mark.thorough
def test_each_kind_of_case_runs_and_both_sides_agree() -> None:
    large = (  # 1 MiB is 64 KiB again, sixteen times as long
        "SDO upload of 64 KiB (machines)",
        "SDO download of 64 KiB (Networks)",
        "SDO block upload of 64 KiB (Networks)",
        "SDO block download of 64 KiB (machines)",
    )
    things = ("SDO expedited upload", *large, "PDO decode", "heartbeat", "in their place")
    command = [sys.executable, str(RUN), *things, "--rounds", "1", "--seconds", "0.001"]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert finished.returncode == 0, finished.stderr
    rows = [line for line in finished.stdout.splitlines() if line.startswith("| ")]
    for thing in things:
        assert any(thing in row for row in rows)


def test_a_word_that_is_in_no_title_is_an_error(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.syspath_prepend(str(RUN.parent))
    monkeypatch.setattr(sys, "argv", [str(RUN), "nosuchcase"])
    with pytest.raises(SystemExit) as caught:
        importlib.import_module("run").main()
    assert caught.value.code == 2
    assert "no case has one of these words" in capsys.readouterr().err


def test_each_goal_names_cases_that_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(RUN.parent))
    goals, measure, run = (importlib.import_module(name) for name in ("goals", "measure", "run"))
    monkeypatch.setattr(goals.imports, "over_bare", lambda program: 42.0)
    monkeypatch.setattr(goals.chain_cycle, "cycle", lambda joints, cycle_time: 250_000.0)
    monkeypatch.setattr(run.motions, "tables", lambda rounds: "| what motions cost |")
    monkeypatch.setattr(run.memory, "table", lambda: "| memory |")
    results = [measure.Result(case.title, [2.0], [4.6]) for module in run.MODULES for case in module.cases()]
    text = run.report(results, 1, 0.1, with_goals=True)
    rows = [line for line in text.splitlines() if any(goal.work in line for goal in goals.GOALS)]
    assert len(rows) == len(goals.GOALS)
    assert "| read by name, decoded, RemoteNode | 2.3 " in rows[0]
    assert f"| 42 ms (missed) | {12 if COMPILED else 20} ms | 10 ms |" in text
    assert "the master's process alone, share of a core | 25 % " in text
    page = (RUN.parents[1] / "docs" / "speed.md").read_text(encoding="utf-8")
    assert text in run.paste(page, text)
    assert run.paste(run.paste(page, "old"), text) == run.paste(page, text)
    with pytest.raises(SystemExit, match="0 places"):
        run.paste("no marks", text)


@pytest.mark.skipif(sys.platform == "win32", reason="asks POSIX for the CPU time of a child")
def test_what_a_start_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(RUN.parent))
    imports = importlib.import_module("imports")
    assert imports.over_bare("import can", rounds=1) > 0


def test_a_case_that_fails_is_told_in_its_row_and_ends_no_other(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(RUN.parent))
    goals, measure, motions, run = (importlib.import_module(name) for name in ("goals", "measure", "motions", "run"))

    def over(*arguments: object, **options: object) -> float:
        raise AssertionError("the path was over\nat 3 s | of 4")

    def cycle(joints: int, *arguments: object, **options: object) -> float:
        return over() if joints == 30 else 250_000.0

    monkeypatch.setattr(goals.imports, "over_bare", over)
    monkeypatch.setattr(motions.chain_cycle, "cycle", cycle)
    monkeypatch.setattr(motions, "once", lambda joints, rounds: ("1", "2", "3") if joints == 6 else over())
    monkeypatch.setattr(run.memory, "of_a_node", over)
    monkeypatch.setattr(run.memory, "of_an_object", lambda read: 100.0)
    cases = [case for module in run.MODULES for case in module.cases()]
    broken = next(case for case in cases if case.title == "PDO decode, 4 objects (RemoteNode)")
    results = [measure.Result(case.title, [2.0], [4.6]) for case in cases if case is not broken]
    failed = measure.measure(measure.Case(broken.title, broken.ours, broken.theirs, over), 1, 0.001)
    rows = run.report([*results, failed], 1, 0.1, with_goals=True).splitlines()
    said = "failed: AssertionError: the path was over"
    assert f"| {broken.title} | {said} | | | |" in rows
    assert [row for row in rows if row.startswith("| PDO in, four values, RemoteNode |") and broken.title in row]
    assert [row for row in rows if row.startswith("| `canopen --help`") and said in row]
    assert f"| 30 joints along a path | {said} | {said} | {said} |" in rows
    assert f"| a re-plan while the joints move | 1 | {said} | {said} |" in rows
    assert [row for row in rows if row.startswith("| 12 joints along a path | 25.0 % |")]
    assert f"| a node with a TPDO (RemoteNode) | {said} | | |" in rows
    assert "| an object of an EDS, of 2000 | 100 bytes | 100 bytes | **1.0** |" in rows
    assert "the path was over\nat 3 s" in capsys.readouterr().err
    monkeypatch.setattr(
        run, "MODULES", (type("Module", (), {"cases": staticmethod(lambda: [measure.Case("bad", over, over, over)])}),)
    )
    monkeypatch.setattr(sys, "argv", ["run.py", "bad", "--rounds", "1"])
    with pytest.raises(SystemExit, match="a case failed"):
        run.main()
