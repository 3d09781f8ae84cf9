"""`canopen move`: to a target, along a path of a file, as a rehearsal; and its ends. In virtual time, with simulated joints."""

from __future__ import annotations

import itertools
import math
import os
import re
import signal
import sys
from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.streams import put_lost_terminal_to_rest
from canopen_master import read_record
from canopen_master.errors import PlanRefusedError
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE
from canopen_proto.drives.cia402.states import State
from tests.cli.cli_support import Alarm, Run, stands
from tests.master.test_recording import wait_for_file

pytest.importorskip("ruckig", reason="a planned motion needs the extra `motion`")

DEMO = ("move", "-b", "demo")
START = [-14, 9, 21, -7, 16, -22]
CELL = """
[buses.left]
locator = "virtual:left"
[buses.right]
locator = "virtual:right"
[nodes]
shoulder = { bus = "left", id = 3 }
elbow = { bus = "right", id = 3 }
[defaults.joints]
unit = "degree"
max_speed = 20
[joints]
shoulder = { max_position = 40 }
elbow = {}
[chains.arm]
joints = ["shoulder", "elbow"]
"""


@pytest.fixture
def cell(tmp_path: Path) -> str:
    path = tmp_path / "cell.toml"
    path.write_text(CELL)
    return str(path)


def degrees(simulation: SimulatedDevices) -> list[float]:
    return [float(drive.values[POSITION_ACTUAL_VALUE]) / 1000 for drive in simulation.drives.values()]  # type: ignore[arg-type]


def test_to_a_target(run: Run, simulations: list[SimulatedDevices], tmp_path: Path) -> None:
    file, picture = tmp_path / "run.csv", tmp_path / "run.png"
    outcome = run(*DEMO, "--to", "10,-20,30,0,0,5", "--record", str(file), "--plot", str(picture))
    assert outcome.status == 0, outcome.err
    assert degrees(simulations[0]) == pytest.approx([10, -20, 30, 0, 0, 5], abs=0.02)
    assert all(drive.drive.state is State.SWITCH_ON_DISABLED for drive in simulations[0].drives.values())
    assert "to the target: 1.69 s, within all limits" in outcome.out
    (off,) = re.findall(r"which no window of a drive decides: joint\d is farthest, (\S+) off", " ".join(outcome.err.split()))
    assert float(off) <= 0.02
    assert picture.read_bytes().startswith(b"\x89PNG")
    record = read_record(file)
    assert {rate for rate in record["rate"] if rate == rate} <= {0.0, 1.0}
    assert record["joint2.set_point"][-1] == pytest.approx(-20)


def test_some_joints_and_json(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run(*DEMO, "--to", "joint3=25, joint1=-10", "--json", "-q")
    assert degrees(simulations[0]) == pytest.approx([-10, 9, 25, -7, 16, -22], abs=0.02)
    assert [joint["joint"] for joint in outcome.json] == [f"joint{number}" for number in range(1, 7)]
    assert outcome.json[2]["position"] == pytest.approx(25, abs=0.02)


def test_a_path_of_a_file_from_its_start_on(run: Run, simulations: list[SimulatedDevices], cell: str, tmp_path: Path) -> None:
    path, file = tmp_path / "path.csv", tmp_path / "run.csv"
    path.write_text("time,elbow,shoulder\n0,10,0\n2,0,5\n4,10,-5\n")
    outcome = run("move", cell, str(path), "-b", "demo", "--override", "0.5", "--record", str(file))
    assert outcome.status == 0, outcome.err
    assert "to the start of the path: " in outcome.out
    assert "along the path: 4 s" in outcome.out
    record = read_record(file)
    assert [joint.unit for joint in record.head.joints] == ["degree", "degree"]
    assert (record["shoulder.set_point"][-1], record["elbow.set_point"][-1]) == pytest.approx((-5, 10))
    assert max(rate for rate in record["rate"] if rate == rate) == pytest.approx(0.5)
    assert record["time"][-1] > 8  # at half its speed


def test_a_rehearsal_moves_nothing_and_shows_the_first_cycle(run: Run, simulations: list[SimulatedDevices], cell: str) -> None:
    outcome = run("move", cell, "-b", "demo", "--to", "30,20", "--dry-run")
    assert outcome.status == 0, outcome.err
    assert "within all limits" in outcome.out
    frames = [line.split() for line in outcome.out.splitlines() if "ms" not in line and ("080#" in line or "203#" in line)]
    assert len(frames) == 4  # a SYNC and an RPDO on each bus
    assert "nothing of this was sent" in outcome.err
    assert [float(drive.values[POSITION_ACTUAL_VALUE]) for drive in simulations[0].drives.values()] == [-14_000]  # type: ignore[arg-type]
    refused = run("move", cell, "-b", "demo", "--to", "50,20", "--dry-run")
    assert refused.status == ExitCode.USAGE


@pytest.mark.parametrize("arguments", [("--to", "50,20"), ("PATH",)])
def test_what_is_beyond_a_limit_is_refused_before_it_moves(
    run: Run, simulations: list[SimulatedDevices], cell: str, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    path = tmp_path / "path.csv"
    path.write_text("time,shoulder,elbow\n0,0,0\n4,50,0\n")
    trace = tmp_path / "trace.log"
    chosen = [str(path) if each == "PATH" else each for each in arguments]
    outcome = run("move", cell, "-b", "demo", "--trace", str(trace), *chosen)
    assert outcome.status == ExitCode.USAGE, outcome.err
    requests = [word for word in trace.read_text().split() if word.startswith(("603#", "60D#", "000#", "203#", "20D#"))]
    assert requests
    assert all(request.startswith(("603#4", "60D#4", "603#6", "60D#6", "603#7", "60D#7")) for request in requests), "reads only"
    assert "40" in outcome.err
    assert "shoulder" in outcome.err
    (drive, *_) = simulations[0].drives.values()
    assert drive.values[POSITION_ACTUAL_VALUE] == -14_000
    assert drive.drive.state is State.SWITCH_ON_DISABLED


def test_a_path_on_which_the_arm_could_not_stop_is_refused_before_it_moves(
    run: Run, simulations: list[SimulatedDevices], tmp_path: Path
) -> None:
    """It takes the whole acceleration, so a stop along it would need more: nobody goes to its start first."""
    cell, path = tmp_path / "two.toml", tmp_path / "path.csv"
    joint = "{ max_speed = 60, max_acceleration = 120, unit = 'degree' }"
    cell.write_text(
        "[buses.can0]\n[nodes]\na = { id = 3 }\nb = { id = 4 }\n"
        f"[joints]\na = {joint}\nb = {joint}\n[chains.arm]\njoints = ['a', 'b']\n"
    )
    path.write_text("time,a,b\n0,0,0\n1.5,45,20\n3,0,0\n")
    outcome = run("move", str(cell), str(path), "-b", "demo")
    assert outcome.status == ExitCode.USAGE, outcome.err
    assert "The path leaves nothing free for a stop along it. a needs the acceleration 120" in outcome.err
    for drive in simulations[0].drives.values():
        assert drive.drive.state is State.SWITCH_ON_DISABLED
    path.write_text("time,a,b\n0,0,0\n2,45,20\n4,0,0\n")
    assert run("move", str(cell), str(path), "-b", "demo", "--dry-run").status == 0


def test_what_is_refused_when_the_drives_have_power_has_another_status(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    async def refuse(*_: object) -> None:
        raise PlanRefusedError("it cannot be planned", seen="nothing")

    monkeypatch.setattr("canopen_cli.motion.move.legs_of", refuse)
    assert run(*DEMO, "--to", "1,1,1,1,1,1").status == ExitCode.DRIVE_FAULT


@pytest.mark.thorough
def test_a_path_of_few_decimals_moves_and_a_refusal_tells_what_rounding_has_to_do_with_it(run: Run, tmp_path: Path) -> None:
    names = [f"joint{number}" for number in range(1, 7)]
    slow, fast, given = tmp_path / "slow.csv", tmp_path / "fast.csv", tmp_path / "given.csv"
    for file, count, rest in ((slow, 400, ""), (fast, 40, ""), (given, 400, ",0" * 6)):
        header = ",".join(["time", *names, *(f"{name}.velocity" for name in names if rest)])
        positions = [10 * (1 - math.cos(2 * math.pi * number / count)) for number in range(count + 1)]
        rows = [f"{number / 100},{position:.2f},0,0,0,0,0{rest}" for number, position in enumerate(positions)]
        file.write_text("\n".join([header, *rows]))
    tried = run(*DEMO, str(slow), "--dry-run")
    assert tried.status == 0
    assert re.search(r"smoothed within the rounding of the file: joint1: 3\d\d rows by up to 0.005\n", tried.out + tried.err)
    assert "the smoothest path within half a step of all of them, so it needs more time" in run(*DEMO, str(fast)).err
    assert "write 5 decimals, or fewer rows" in run(*DEMO, str(given)).err


@pytest.mark.thorough(5)
@pytest.mark.parametrize("at", [0.5, 1.2, 1.9])
def test_ctrl_c_brakes_on_the_path(
    run: Run, simulations: list[SimulatedDevices], alarm: Alarm, tmp_path: Path, at: float
) -> None:
    file = tmp_path / "run.csv"
    alarm.set((at, signal.SIGINT))
    outcome = run(*DEMO, "--to", "80,9,21,-7,16,-22", "--record", str(file))
    assert outcome.status == ExitCode.INTERRUPTED
    assert "stands on its path" in outcome.err
    assert "the joints were halted" in outcome.err
    assert all(stands(drive) for drive in simulations[0].drives.values())
    wait_for_file()
    record = read_record(file)
    points = [point for point in record["joint1.set_point"] if point == point]
    steps = [100 * (b - a) for a, b in itertools.pairwise(points)]
    assert -14 < points[-1] < 80
    assert steps[-1] == pytest.approx(0, abs=0.2)  # it came to rest by its set-points, not by a halt
    assert max(abs(b - a) for a, b in itertools.pairwise(steps)) * 100 <= 60 * 1.01
    assert degrees(simulations[0])[0] == pytest.approx(points[-1], abs=0.1)


@pytest.mark.parametrize("is_ignored", [False, True])
def test_a_terminal_that_goes_away_is_a_ctrl_c(
    run: Run, simulations: list[SimulatedDevices], alarm: Alarm, is_ignored: bool
) -> None:
    """But for `nohup canopen move`, which goes on."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN if is_ignored else signal.SIG_DFL)
    try:
        alarm.set((1.2, signal.SIGHUP))
        outcome = run(*DEMO, "--to", "80,9,21,-7,16,-22")
    finally:
        signal.signal(signal.SIGHUP, before)
    assert outcome.status == (ExitCode.OK if is_ignored else ExitCode.INTERRUPTED), outcome.err
    assert ("interrupted by the end of its terminal" in outcome.err) is not is_ignored
    assert ("stands on its path" in outcome.err) is not is_ignored
    assert all(stands(drive) for drive in simulations[0].drives.values())


def test_a_terminal_that_is_gone_takes_what_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = os.openpty()
    with os.fdopen(theirs, "w") as stream:
        monkeypatch.setattr("sys.stderr", stream)
        put_lost_terminal_to_rest()
        assert os.isatty(theirs)  # it is there yet
        os.close(ours)
        with pytest.raises(OSError):
            print("drawn", file=stream, flush=True)
        put_lost_terminal_to_rest()
        print("not drawn", file=stream, flush=True)


def test_home_first(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run(*DEMO, "--home", "--to", "1,2,3,4,5,6")
    assert outcome.status == 0
    assert "all joints have their reference" in outcome.err
    assert degrees(simulations[0]) == pytest.approx([1, 2, 3, 4, 5, 6], abs=0.02)


def two_chains(cell: str) -> str:
    path = Path(cell)
    path.write_text(CELL.replace('joints = ["shoulder", "elbow"]', 'joints = ["shoulder"]\n[chains.leg]\njoints = ["elbow"]'))
    return cell


def test_two_chains_on_two_buses_are_one_motion(run: Run, simulations: list[SimulatedDevices], cell: str, tmp_path: Path) -> None:
    machine, path = two_chains(cell), tmp_path / "path.csv"
    path.write_text("time,elbow,shoulder\n0,10,0\n2,0,5\n4,10,-5\n")
    outcome = run("move", machine, str(path), "-b", "demo", "--chain", "arm", "--chain", "leg", "--json")
    assert outcome.status == 0, outcome.err
    positions = {joint["joint"]: joint["position"] for joint in outcome.json}
    assert positions == pytest.approx({"shoulder": -5, "elbow": 10}, abs=0.02)
    outcome = run("move", machine, "-b", "demo", "--chain", "leg", "--chain", "arm", "--to", "3,-2", "--dry-run")
    assert (outcome.status, "within all limits" in outcome.out) == (0, True), outcome.err
    refused = run("move", machine, "-b", "demo", "--chain", "leg", "--chain", "arm", "--to", "1,50", "--dry-run")
    assert (refused.status, "shoulder" in refused.err) == (ExitCode.USAGE, True)
    refused = run("move", machine, "-b", "demo", "--chain", "leg", "--chain", "arm", "--to", "1,5", "--record", "x.csv")
    assert (refused.status, "of one chain" in refused.err) == (ExitCode.USAGE, True)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((), "where to?"),
        (("--to", "1,2"), "--to '1,2' is 2 values, and there are 6 joints"),
        (("--to", "1,2,3,4,5,x"), "'x' is not a finite number"),
        (("--to", "joint9=1"), "'joint9=1' is not JOINT=POSITION"),
        (("--to", "joint1=1,joint1=2"), "joint1 has two positions"),
        (("a.csv", "b.csv"), "one machine file and one path"),
        (("--to", "1", "path.csv"), "a target and a path at once"),
        (("--chain", "x", "--to", "1"), "has no chain 'x'"),
        (("--to", "1,2,3,4,5,6", "--override", "0"), "0"),
    ],
)
def test_wrong_words(run: Run, simulations: list[SimulatedDevices], arguments: tuple[str, ...], text: str) -> None:
    outcome = run(*DEMO, *arguments)
    assert outcome.status == ExitCode.USAGE
    assert text in outcome.err
    assert not simulations


@pytest.mark.parametrize("option", ["--record", "--plot"])
def test_a_file_that_cannot_be_written_is_told_before_anything_has_power(
    run: Run, simulations: list[SimulatedDevices], option: str
) -> None:
    if not Path("/proc/self").is_dir():
        pytest.skip("needs a folder in which nobody, not even root, may write")
    outcome = run(*DEMO, "--to", "joint1=5", option, f"/proc/run.{'csv' if option == '--record' else 'png'}")
    assert (outcome.status, "CO341: cannot write /proc/run." in outcome.err) == (ExitCode.BAD_FILE, True)
    assert not simulations


def test_what_is_not_installed_is_told_before_anything_has_power(
    run: Run, simulations: list[SimulatedDevices], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ruckig", None)
    outcome = run(*DEMO, "--to", "joint1=5")
    assert (outcome.status, "CO141" in outcome.err) == (ExitCode.USAGE, True)
    assert not simulations


def test_the_advice_at_a_limit_switch_is_for_the_command_line(run: Run, simulations: list[SimulatedDevices]) -> None:
    outcome = run(*DEMO, "--to", "joint1=500")
    assert outcome.status == ExitCode.DRIVE_FAULT
    assert "try:   move it the other way" in outcome.err
    assert "await" not in outcome.err


def test_files_that_cannot_be_used(run: Run, tmp_path: Path, cell: str) -> None:
    assert run(*DEMO, "none.csv").status == ExitCode.BAD_FILE
    (tmp_path / "path.csv").write_text("time,joint1\n0,0\n0,x\n")
    outcome = run(*DEMO, str(tmp_path / "path.csv"))
    assert outcome.status == ExitCode.BAD_FILE
    assert "CO301" in outcome.err
    assert "CO121" in run("move", "--to", "1").err
    assert "on the buses left, right" in run("move", cell, "-b", "virtual:x", "--to", "1,2").err
