"""`canopen ros init`: the ROS package for a machine."""

from __future__ import annotations

import os
import sys
import xml.etree.ElementTree
from pathlib import Path

import pytest

from canopen_cli.problem import ExitCode
from canopen_master.machine_file import read_machine
from tests.cli.cli_support import Run

CELL = """
[buses.can0]
[nodes]
lift = { id = 3, file = "files/drive.eds", overlay = "units.toml" }
lamp = { id = 9, file = "sample_io.eds" }
[joints.lift]
unit = "millimetre"
[chains.lifts]
joints = ["lift"]
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "drive.eds").write_bytes(b"drive")
    (tmp_path / "units.toml").write_text("")
    (tmp_path / "cell.toml").write_text(CELL)
    return tmp_path


def names(package: Path) -> set[str]:
    return {each.relative_to(package).as_posix() for each in package.rglob("*") if each.is_file()}


def test_the_package_of_the_manuals_arm(run: Run, folder: Path) -> None:
    done = run("ros", "init", "ros")
    assert done.status == ExitCode.OK, done.err
    package = folder / "ros" / "ros_canopen"
    assert names(package) >= {
        "package.xml",
        "launch/canopen.launch",
        "launch/single_device.launch",
        "config/six_joints.yaml",
        "scripts/ros_canopenmasternode",
    }
    assert xml.etree.ElementTree.parse(package / "package.xml").findtext("name") == "ros_canopen"
    script = package / "scripts" / "ros_canopenmasternode"
    assert os.access(script, os.X_OK)
    assert script.read_text().startswith(f"#!{sys.executable}\n")
    compile(script.read_text(), str(script), "exec")
    assert f"ROS_PACKAGE_PATH={folder / 'ros'}:$ROS_PACKAGE_PATH roslaunch ros_canopen canopen.launch simulate:=true" in done.err
    assert "ros2 launch" in done.err


def test_the_package_of_a_machine_has_its_files(run: Run, folder: Path) -> None:
    done = run("ros", "init", "ros", "-m", "cell.toml", "--json")
    assert done.status == ExitCode.OK, done.err
    package = folder / "ros" / "ros_canopen"
    assert names(package) == set(done.json["files"])
    assert read_machine(package / "config" / "machine.toml").chains["lifts"].joints == ("lift",)  # each file is beside it
    assert "config/sample_io.eds" not in names(package)
    assert not any("single_device" in name for name in names(package))
    launch = xml.etree.ElementTree.parse(package / "launch" / "canopen.launch")
    (machine,) = [each for each in launch.iter("arg") if each.get("name") == "machine"]
    assert machine.get("default") == "$(find ros_canopen)/config/machine.toml"
    second = package / "launch" / "canopen.launch.py"
    if second.exists():
        compile(second.read_text(), str(second), "exec")
        assert '"machine": (str(PACKAGE / "config" / "machine.toml"),' in second.read_text()


def test_nothing_is_overwritten(run: Run, folder: Path) -> None:
    package = folder / "ros" / "ros_canopen"
    package.mkdir(parents=True)
    for options in ((), ("--force",)):
        done = run("ros", "init", "ros", *options)
        assert (done.status, "CO135" in done.err) == (ExitCode.USAGE, True)
    assert names(package) == set()


@pytest.mark.parametrize("name", ["../drive.eds", "{folder}/files/drive.eds"])
def test_a_file_elsewhere_would_be_missing(run: Run, folder: Path, name: str) -> None:
    (folder / "drive.eds").write_bytes(b"drive")
    inner = folder / "inner"
    inner.mkdir()
    (inner / "cell.toml").write_text(f"[buses.can0]\n[nodes]\na = {{ id = 3, file = '{name.format(folder=folder)}' }}\n")
    done = run("ros", "init", "ros", "-m", "inner/cell.toml")
    assert (done.status, "CO123" in done.err) == (ExitCode.USAGE, True)
    assert not (folder / "ros").exists()


def test_a_wrong_machine_or_folder(run: Run, folder: Path) -> None:
    assert run("ros", "init", "ros", "-m", "none.toml").status == ExitCode.BAD_FILE
    assert not (folder / "ros").exists()
    (folder / "file").write_text("")
    assert run("ros", "init", "file/ros").status == ExitCode.BAD_FILE
