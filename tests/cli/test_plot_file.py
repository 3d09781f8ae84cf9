"""`--record` and `canopen plot`: what a chain did, as a file and as a picture. In virtual time."""

from __future__ import annotations

import math
import signal
import sys
from pathlib import Path

import pytest

from canopen_cli.plot.curves import JointCurves, MotionCurves, accelerations, curves_of_record, velocities
from canopen_cli.plot.motion import write_motion_plot
from canopen_cli.shared.problem import ExitCode
from canopen_master import read_record
from canopen_master.motion.record_files import CsvFile
from canopen_master.simulation.serving import SimulatedDevices
from tests.cli.cli_support import TWO, Alarm, Run
from tests.master.test_recording import pyarrow, wait_for_file


def test_a_demo_is_recorded_and_drawn(run: Run, tmp_path: Path) -> None:
    file, picture = tmp_path / "run.csv", tmp_path / "run.png"
    outcome = run("demo", *TWO, "--record", str(file))
    assert outcome.status == 0
    record = read_record(file)
    assert f"{len(record)} cycles recorded: {file}" in outcome.err
    assert [joint.name for joint in record.head.joints] == ["joint1", "joint2"]
    assert (record.head.chain, record.head.cycle_time) == ("arm1", 0.02)
    assert int(record["joint1.statusword"][-1]) & 0x6F == 0x27  # to the end, which is the shutdown
    document = run("plot", str(file), "--json").json
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert document["picture"] == str(picture)
    assert [joint["joint"] for joint in document["joints"]] == ["joint1", "joint2"]
    for joint in document["joints"]:
        assert joint["unit"] == "radian"
        # the demonstration's own limits, see path.py
        assert 0 < joint["largest_speed"] <= math.radians(60)
        assert 0 < joint["largest_acceleration"] <= math.radians(300)
        assert 0 < joint["largest_following_error"] < math.radians(2)
    assert "largest" in run("plot", str(file), "-o", str(tmp_path / "other.svg")).out
    assert ">acceleration<" in (tmp_path / "other.svg").read_text(encoding="utf-8").replace("<!-- ", ">").replace(" -->", "<")


@pytest.mark.thorough
def test_parquet_is_drawn_too(run: Run, tmp_path: Path) -> None:
    pyarrow()
    file = tmp_path / "run.parquet"
    assert run("demo", *TWO, "--record", str(file)).status == 0
    assert run("plot", str(file)).status == 0


def test_ctrl_c_leaves_a_recording_that_can_be_read(
    run: Run, simulations: list[SimulatedDevices], alarm: Alarm, tmp_path: Path
) -> None:
    file = tmp_path / "run.csv"
    alarm.set((1.0, signal.SIGINT))
    assert run("demo", *TWO, "--record", str(file)).status == ExitCode.INTERRUPTED
    wait_for_file()
    assert len(read_record(file)) > 20


def test_a_recording_that_is_not_complete_is_told_after_the_results(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(file: CsvFile, rows: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(CsvFile, "write", full)
    outcome = run("demo", *TWO, "--record", str(tmp_path / "run.csv"))
    assert outcome.status == ExitCode.BAD_FILE
    assert "CO343" in outcome.err
    assert "joint1" in outcome.out


def test_what_is_there_is_not_overwritten(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    file.write_text("mine")
    assert "CO135" in run("demo", *TWO, "--record", str(file)).err
    assert file.read_text() == "mine"
    assert run("demo", *TWO, "--record", str(file), "--force").status == 0
    (tmp_path / "run.png").write_text("mine")
    assert "CO135" in run("plot", str(file)).err


def test_a_path_is_drawn_before_it_is_followed(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "path.csv"
    file.write_text("time;elbow;shoulder\n0;0;0\n1;10;5\n2;0;5\n")
    (tmp_path / "cell.toml").write_text('[buses.can0]\n[nodes]\nelbow = { id = 3 }\n[joints]\nelbow = { unit = "degree" }\n')
    document = run("plot", str(file), "--json", "-m", str(tmp_path / "cell.toml")).json
    elbow, shoulder = document["joints"]
    assert (elbow["unit"], elbow["to"], shoulder["unit"]) == ("degree", pytest.approx(10), "")
    assert elbow["largest_following_error"] is None
    assert elbow["largest_speed"] == pytest.approx(15, rel=0.01)  # a spline at rest at both ends
    file.write_text("time;elbow\n0;0\n0;x\n")
    assert "CO301" in run("plot", str(file), "--force").err


def test_what_cannot_be_drawn(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "run.csv"
    assert run("plot", str(file)).status == ExitCode.BAD_FILE
    assert run("plot", str(tmp_path)).status == ExitCode.USAGE  # a folder
    file.write_text("a,b\n")
    outcome = run("plot", str(file))
    assert outcome.status == ExitCode.BAD_FILE
    assert "CO344" in outcome.err
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    outcome = run("demo", *TWO, "--record", str(tmp_path / "run.parquet"))
    assert outcome.status == ExitCode.USAGE
    assert "CO141" in outcome.err
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    assert "CO140" in run("plot", str(file)).err


def test_a_line_that_was_cut_off_is_told(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    run("demo", *TWO, "--record", str(file))
    file.write_bytes(file.read_bytes()[:-9])
    outcome = run("plot", str(file))
    assert outcome.status == 0
    assert "the last line is not whole" in outcome.err


def test_slopes_are_those_of_the_positions() -> None:
    times = [0.0, 0.1, 0.2, 0.4, 0.5]  # one period was skipped
    positions = [time**2 for time in times]
    assert velocities(times, positions)[1:-1] == pytest.approx([0.2, 0.5, 0.7])
    assert accelerations(times, positions)[1:-1] == pytest.approx([2.0, 2.0, 2.0])
    positions[0] = math.nan
    assert [math.isnan(value) for value in velocities(times, positions)] == [True, True, False, False, True]
    for count in range(3):
        assert [len(each(times[:count], positions[:count])) for each in (velocities, accelerations)] == [count, count]


def test_a_skipped_period_is_a_longer_step_and_not_a_faster_one(tmp_path: Path) -> None:
    head = '{"version": 1, "chain": "a", "cycle_time": 0.1, "begun": "", "joints": [{"name": "j", "unit": "turn", "node": ""}]}'
    rows = "".join(f"{n},{n / 10},{int(n == 4)},{n}\n" for n in (0, 1, 2, 4, 5))
    file = tmp_path / "run.csv"
    file.write_text(f"# canopen recording\n# {head}\ncycle,time,skipped,j.set_point\n{rows}")
    curves = curves_of_record(read_record(file))
    (joint,) = curves.joints
    assert joint.velocities[1:-1] == pytest.approx([10.0] * 3)
    assert list(curves.late) == [0.4]


def test_what_a_skipped_cycle_made_is_marked_in_each_row(tmp_path: Path) -> None:
    times = [0.0, 0.5, 1.0]
    sizes = []
    for late in ([], [0.5]):
        file = tmp_path / "run.svg"
        write_motion_plot(file, MotionCurves("a", "", times, [JointCurves("j", "turn", times, times, times)], late))
        text = file.read_text(encoding="utf-8")
        assert text.count("late or skipped cycle") == len(late)
        sizes.append(text.count("#ba2525"))
    assert sizes[1] - sizes[0] >= 4  # position, velocity, acceleration, and the legend


@pytest.mark.thorough
def test_many_joints_of_several_units_fit_on_a_picture(tmp_path: Path) -> None:
    times = [0.0, 0.5, 1.0]
    joints = [
        JointCurves(f"joint{number}", ("degree", "millimetre", "")[number % 3], times, times, times) for number in range(24)
    ]
    write_motion_plot(tmp_path / "path.svg", MotionCurves("24 joints", "as planned", times, joints))
    text = (tmp_path / "path.svg").read_text(encoding="utf-8")
    assert "joint23" in text
    assert "following error" not in text
