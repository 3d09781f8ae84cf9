"""`canopen ros init`: the ROS package for a machine."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from canopen_cli.shared.problem import ExitCode
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


ROBOT = """
[buses.can0]
[nodes]
lift = { id = 3 }
"pan&tilt" = { id = 4 }
wheel = { id = 5 }
[joints.lift]
unit = "millimetre"
min_position = -100
max_position = 900.5
max_speed = 250
max_acceleration = 1000
[joints."pan&tilt"]
unit = "degree"
min_position = -90
max_position = 45
max_speed = 30
[joints.wheel]
unit = "turn"
max_jerk = 2
[chains.arm]
joints = ["lift", "pan&tilt"]
[chains."base-1"]
joints = ["wheel"]
"""


@pytest.fixture
def robot(run: Run, folder: Path) -> Path:
    (folder / "robot.toml").write_text(ROBOT)
    done = run("ros", "init", "ros", "-m", "robot.toml")
    assert done.status == ExitCode.OK, done.err
    return folder / "ros" / "ros_canopen"


def yaml_of(path: Path) -> Any:
    return YAML(typ="safe", pure=True).load(path.read_text())


def test_the_urdf_has_the_joints_and_limits_of_the_machine_in_si_units(robot: Path) -> None:
    urdf = xml.etree.ElementTree.parse(robot / "urdf" / "machine.urdf").getroot()
    kinds = {each.get("name"): each.get("type") for each in urdf.findall("joint")}
    assert kinds == {"lift": "prismatic", "pan&tilt": "revolute", "wheel": "revolute"}
    limits = {
        each.get("name"): [float(limit.get(key, "nan")) for key in ("lower", "upper", "velocity", "effort")]
        for each in urdf.findall("joint")
        for limit in each.findall("limit")
    }
    degree = math.pi / 180
    assert limits["lift"] == pytest.approx([-0.1, 0.9005, 0.25, 0])
    assert limits["pan&tilt"] == pytest.approx([-90 * degree, 45 * degree, 30 * degree, 0])
    assert limits["wheel"] == [0, 0, 0, 0]  # what is not known keeps a planner from moving it
    assert not list(urdf.iter("origin"))  # no geometry is made up
    topics = [each.text for each in urdf.iter("param") if each.get("name") == "joint_commands_topic"]
    assert topics == ["/arm/joint_commands", "/base-1/joint_commands"]


def test_the_files_for_controllers_and_moveit_have_the_names_and_limits_of_the_machine(robot: Path) -> None:
    controllers = yaml_of(robot / "config" / "controllers.yaml")
    assert set(controllers["controller_manager"]["ros__parameters"]) == {"update_rate", "arm_controller", "base_1_controller"}
    assert controllers["arm_controller"]["ros__parameters"]["joints"] == ["lift", "pan&tilt"]
    assert controllers["base_1_controller"]["ros__parameters"]["joints"] == ["wheel"]
    for controller in ("arm_controller", "base_1_controller"):  # begins where the joints are; true is the default
        assert controllers[controller]["ros__parameters"]["set_last_command_interface_value_as_state_on_activation"] is False
    moveit = robot / "config" / "moveit"
    limits = yaml_of(moveit / "joint_limits.yaml")["joint_limits"]
    assert limits["lift"] == {
        "has_velocity_limits": True, "max_velocity": 0.25, "has_acceleration_limits": True, "max_acceleration": 1.0,
        "has_jerk_limits": False,
    }  # fmt: skip
    assert limits["wheel"]["max_jerk"] == pytest.approx(4 * math.pi)
    assert limits["wheel"]["has_velocity_limits"] is False
    used = yaml_of(moveit / "moveit_controllers.yaml")["moveit_simple_controller_manager"]
    assert used["controller_names"] == ["arm_controller", "base_1_controller"]
    assert used["arm_controller"]["joints"] == ["lift", "pan&tilt"]
    srdf = xml.etree.ElementTree.parse(moveit / "machine.srdf").getroot()
    groups = {group.get("name"): [each.get("name") for each in group] for group in srdf.findall("group")}
    assert groups == {"arm": ["lift", "pan&tilt"], "base-1": ["wheel"]}
    assert not (moveit / "kinematics.yaml").exists()


def test_what_no_machine_file_tells_is_to_be_filled_in(run: Run, robot: Path, folder: Path) -> None:
    told = run("ros", "init", "again", "-m", "robot.toml", "--json").json["to_fill_in"]
    assert any("origin and axis of each joint" in each for each in told)
    assert any("effort" in each for each in told)
    assert any("lower, upper, velocity of the joint wheel" in each for each in told)
    assert any("kinematics.yaml" in each for each in told)
    assert not any("velocity of the joint lift" in each for each in told)
    (folder / "plain.toml").write_text("[buses.can0]\n[nodes]\na = { id = 3 }\n[joints.a]\n[chains.c]\njoints = ['a']\n")
    told = run("ros", "init", "plain", "-m", "plain.toml", "--json").json
    assert [each for each in told["to_fill_in"] if "unit of the joint a" in each]
    assert "urdf/machine.urdf" not in told["files"]
    launch = folder / "plain" / "ros_canopen" / "launch" / "canopen.launch.py"
    compile(launch.read_text(), str(launch), "exec")


def test_the_launch_file_starts_the_controllers_of_the_machine(robot: Path) -> None:
    text = (robot / "launch" / "canopen.launch.py").read_text()
    compile(text, "canopen.launch.py", "exec")
    assert 'arguments=["arm_controller", "base_1_controller", "--param-file", controllers]' in text
    assert '"urdf" / "machine.urdf"' in text


def test_the_package_is_one_for_catkin_and_for_ament(robot: Path) -> None:
    package = xml.etree.ElementTree.parse(robot / "package.xml").getroot()
    types = {each.get("condition"): each.text for each in package.iter("build_type")}
    assert (package.get("format"), types) == ("3", {"$ROS_VERSION == 1": "catkin", "$ROS_VERSION == 2": "ament_cmake"})
    assert "project(ros_canopen" in (robot / "CMakeLists.txt").read_text()


@pytest.mark.skipif(shutil.which("check_urdf") is None, reason="no check_urdf: apt-get install liburdfdom-tools")
def test_urdfdom_reads_the_urdf(robot: Path) -> None:
    done = subprocess.run(["check_urdf", str(robot / "urdf" / "machine.urdf")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Successfully Parsed XML" in done.stdout
    assert "child(1):  pan&tilt_link" in done.stdout


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
