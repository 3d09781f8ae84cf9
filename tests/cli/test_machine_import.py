"""`canopen machine import`: from a configuration of ROS packages to a machine that moves, with simulated drives."""

from __future__ import annotations

import shutil
import tomllib
from importlib import resources
from pathlib import Path

import pytest

from canopen_cli.shared.problem import ExitCode
from canopen_master.simulation.serving import SimulatedDevices
from canopen_proto.drives.cia402.objects import POSITION_ACTUAL_VALUE
from tests.cli.cli_support import Run
from tests.ros_configurations import FOLDER, SETS, needs_configurations

ROS1 = """
name: arm
sync: {interval_ms: 20}
defaults: {eds_file: drive.eds, dcf_overlay: {"6081": "30000"}, pos_to_device: "pos*1000", pos_from_device: "obj6064/1000"}
nodes: {shoulder: {id: 3}, elbow: {id: 4}}
"""
ROS2 = """
master: {node_id: 1, sync_period: 20000}
nodes: {lift: {node_id: 5, dcf: drive.eds, driver: "ros2_canopen::Cia402Driver", scale_eff_from_dev: 1.0}}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    with resources.as_file(resources.files("canopen_data") / "samples" / "sample_drive.eds") as sample:
        shutil.copy(sample, tmp_path / "drive.eds")
    (tmp_path / "ros1.yaml").write_text(ROS1)
    (tmp_path / "bus.yml").write_text(ROS2)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.thorough(2)
@pytest.mark.parametrize(("file", "joint"), [("ros1.yaml", "shoulder"), ("bus.yml", "lift")])
def test_an_imported_machine_is_checked_and_moves(
    run: Run, folder: Path, simulations: list[SimulatedDevices], file: str, joint: str
) -> None:
    done = run("machine", "import", file, "-o", "cell.toml", "--chain", "arm")
    assert done.status == ExitCode.PARTIAL, done.err
    assert f"nothing says how fast {joint} may go" in done.out
    assert f'file = "{joint}.dcf"' in done.out or 'file = "drive.eds"' in done.out
    assert "next: canopen machine check cell.toml" in done.err
    assert run("machine", "check", "cell.toml").status == ExitCode.OK
    moved = run("move", "cell.toml", "-b", "demo", "--to", f"{joint}=0.25")
    assert moved.status == ExitCode.OK, moved.err
    drive = next(iter(simulations[-1].drives.values()))
    assert drive.values[POSITION_ACTUAL_VALUE] == pytest.approx(250, abs=3)


def test_the_settings_of_a_node_are_what_restore_would_write(run: Run, folder: Path) -> None:
    assert run("machine", "import", "ros1.yaml", "-o", "cell.toml").status == ExitCode.PARTIAL  # it has no limits
    compared = run("eds", "diff", "drive.eds", "elbow.dcf")
    assert compared.status == ExitCode.DIFFERENT
    assert "6081" in compared.out
    assert "30000" in compared.out


def test_the_report_as_json(run: Run, folder: Path) -> None:
    report = run("machine", "import", "bus.yml", "-o", "cell.toml", "--json").json
    assert (report["kind"], report["beside"], report["file"]) == ("ros2_canopen", [], "cell.toml")
    left_out = [each["key"] for each in report["report"] if each["outcome"] == "left out"]
    assert left_out == ["nodes.lift.scale_eff_from_dev", "joint_limits.lift"]
    assert "[joints.lift]" in run("machine", "import", "bus.yml", "--json").json["text"]


def test_without_an_output_the_file_goes_to_stdout(run: Run, folder: Path) -> None:
    done = run("machine", "import", "bus.yml", "--locator", "virtual:x")
    assert 'locator = "virtual:x"' in done.out
    assert "left out: bus.yml:3: nodes.lift.scale_eff_from_dev" in done.err
    assert not (folder / "cell.toml").exists()


def test_nothing_is_overwritten(run: Run, folder: Path) -> None:
    (folder / "elbow.dcf").write_text("mine")
    done = run("machine", "import", "ros1.yaml", "-o", "cell.toml")
    assert (done.status, "CO135: elbow.dcf is there already" in done.err) == (ExitCode.USAGE, True)
    assert (folder / "elbow.dcf").read_text() == "mine"
    assert not (folder / "cell.toml").exists()
    assert run("machine", "import", "bus.yml", "-o", "bus.yml", "--force").status == ExitCode.USAGE
    assert (folder / "bus.yml").read_text() == ROS2


@pytest.mark.parametrize(
    ("text", "status", "said"),
    [
        ("a: [", ExitCode.BAD_FILE, "CO301: wrong.yaml:1:1: error: this is no YAML"),
        ("a: 1\na: 2", ExitCode.BAD_FILE, "CO301: wrong.yaml:2:1"),
        ("a: 1", ExitCode.BAD_FILE, "this is no configuration of ros_canopen"),
    ],
)
def test_a_wrong_file(run: Run, folder: Path, text: str, status: int, said: str) -> None:
    (folder / "wrong.yaml").write_text(text)
    done = run("machine", "import", "wrong.yaml")
    assert done.status == status
    assert said in done.err


def test_wrong_options(run: Run, folder: Path) -> None:
    assert "CO330: there is no file 'none.yaml'" in run("machine", "import", "none.yaml").err
    assert "not of the form NAME=FOLDER" in run("machine", "import", "bus.yml", "--package", "x").err
    assert "there is no folder 'none'" in run("machine", "import", "bus.yml", "--package", "x=none").err
    assert run("machine", "import").status == ExitCode.USAGE


@needs_configurations
@pytest.mark.parametrize("names", SETS)
def test_machines_of_others_are_checked(run: Run, folder: Path, names: tuple[str, ...]) -> None:
    run("machine", "import", *(str(FOLDER / name) for name in names), "-o", "cell.toml")
    assert run("machine", "check", "cell.toml").status == ExitCode.OK
    moves = [joint for joint in run("machine", "check", "cell.toml", "--json").json["joints"] if "joint_1" not in joint]
    if moves and "multichannel" not in names[0]:  # its second axis needs the device's file
        done = run("move", "cell.toml", "-b", "demo", "--to", f"{moves[0]}=0.1")
        assert done.status == ExitCode.OK, done.err


def test_what_goes_to_stdout_is_the_machine_file(run: Run, folder: Path) -> None:
    done = run(
        "machine", "import", "ros1.yaml", "--locator", "virtual:x?bitrate=1M&loss=0.001&seed=7&a_long_name_for=a_narrow_terminal"
    )
    joints = tomllib.loads(done.out)["joints"]
    assert set(joints) == {"shoulder", "elbow"}
    assert len(done.out.splitlines()) > 10


def test_what_is_wrong_with_an_option_is_not_the_files_fault(run: Run, folder: Path) -> None:
    done = run("machine", "import", "bus.yml", "-o", "cell.toml", "--locator", "zork:foo")
    assert (done.status, "CO100" in done.err, "correct the file" in done.err) == (ExitCode.CANNOT_OPEN, True, False), done.err
    done = run("machine", "import", "bus.yml", "-o", "cell.toml", "--linear", "left")
    assert (done.status, "--linear left: the files have no joint of this name" in done.err) == (ExitCode.USAGE, True), done.err
    assert "joints: lift" in done.err
    assert not (folder / "cell.toml").exists()
