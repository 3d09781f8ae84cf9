"""`canopen eds fix`: repairs told, shown as a diff, and written where they may be."""

from __future__ import annotations

from pathlib import Path

import pytest

from canopen_data.description import FileKind
from canopen_data.eds.writer import write_eds
from tests.check.checked_device import clean
from tests.cli.cli_support import Run, runner

TEXT = write_eds(clean())
FAULTY = TEXT.replace("SupportedObjects=4\n", "SupportedObjects=9\n").replace("DefaultValue=5\n", "DefaultValue=101\n")


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Run:
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    Path("drive.eds").write_text(FAULTY, newline="")
    return runner(capsys, monkeypatch, tmp_path)


def test_a_dry_run_shows_a_diff_and_writes_nothing(run: Run) -> None:
    outcome = run("eds", "fix", "drive.eds", "--dry-run")
    assert outcome.status == 1
    lines = outcome.out.split("\n")
    assert lines[:2] == ["--- drive.eds", "+++ drive.eds (repaired)"]
    assert [line for line in lines[2:] if line[:1] in ("+", "-")] == ["-SupportedObjects=9", "+SupportedObjects=4"]
    number = FAULTY.split("\n").index("SupportedObjects=9") + 1
    assert f"drive.eds:{number}: [ManufacturerObjects]: SupportedObjects=9 is 4 [count]" in outcome.err
    assert "1 repair; 1 finding left for you: canopen eds lint drive.eds" in outcome.err
    assert Path("drive.eds").read_text() == FAULTY


def test_the_linter_says_that_there_are_repairs(run: Run) -> None:
    assert "1 repair without guessing: canopen eds fix drive.eds --dry-run" in run("eds", "lint", "drive.eds").err
    run("eds", "fix", "drive.eds", "--in-place")
    assert "canopen eds fix" not in run("eds", "lint", "drive.eds").err


def test_the_repaired_file_is_written_elsewhere(run: Run) -> None:
    outcome = run("eds", "fix", "drive.eds", "-o", "fixed.eds")
    assert (outcome.status, outcome.out) == (0, "")
    assert "1 repair, written to fixed.eds; 1 finding left" in outcome.err
    assert Path("fixed.eds").read_text() == FAULTY.replace("SupportedObjects=9", "SupportedObjects=4")
    assert Path("drive.eds").read_text() == FAULTY


def test_the_file_itself_is_written_only_when_asked(run: Run) -> None:
    assert run("eds", "fix", "drive.eds", "-o", "drive.eds").status == 2
    assert Path("drive.eds").read_text() == FAULTY
    assert run("eds", "fix", "drive.eds", "--in-place").status == 0
    assert "SupportedObjects=4" in Path("drive.eds").read_text()
    again = run("eds", "fix", "drive.eds", "--dry-run")
    assert (again.status, again.out) == (0, "")


def test_line_ends_stay(run: Run) -> None:
    Path("drive.eds").write_text(FAULTY, newline="\r\n")
    run("eds", "fix", "drive.eds", "--in-place")
    data = Path("drive.eds").read_bytes()
    assert data.count(b"\r\n") == data.count(b"\n") == FAULTY.count("\n")


def test_repairs_as_json(run: Run) -> None:
    told = run("eds", "fix", "drive.eds", "--dry-run", "--json").json
    assert [each["code"] for each in told["repairs"]] == ["count"]
    assert [each["code"] for each in told["left"]] == ["default-limits"]
    assert "+SupportedObjects=4" in told["diff"]
    assert run("eds", "fix", "drive.eds", "-o", "fixed.eds", "--json").json["output"] == "fixed.eds"


@pytest.mark.parametrize("arguments", [[], ["--in-place", "--dry-run"], ["-o", "a.eds", "--dry-run"]])
def test_where_it_goes_is_said_once(run: Run, arguments: list[str]) -> None:
    outcome = run("eds", "fix", "drive.eds", *arguments)
    assert outcome.status == 2
    assert "name the place of the repaired file" in outcome.err


def test_only_eds_and_dcf_are_repaired(run: Run) -> None:
    Path("drive.dcf").write_text(write_eds(clean(FileKind.DCF)))
    assert run("eds", "fix", "drive.dcf", "--dry-run").status == 0
    objects = '<CANopenObject index="1000" name="type" objectType="7" dataType="0007" accessType="ro" defaultValue="0"/>'
    body = f'<ProfileBody xsi:type="ProfileBody_CommunicationNetwork_CANopen"><ApplicationLayers><CANopenObjectList>{objects}'
    Path("drive.xdd").write_text(
        '<ISO15745ProfileContainer xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"><ISO15745Profile>'
        f"{body}</CANopenObjectList></ApplicationLayers></ProfileBody></ISO15745Profile></ISO15745ProfileContainer>"
    )
    outcome = run("eds", "fix", "drive.xdd", "--dry-run")
    assert outcome.status == 2
    assert "only EDS and DCF can be repaired" in outcome.err
