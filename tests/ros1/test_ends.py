"""The drives when the node, its master, or its computer ends: seen by the drives themselves, which the test serves."""

from __future__ import annotations

import math
import os
import re
import signal
import sys
from pathlib import Path

import pytest

from canopen_master.simulation.serving import DEMO_NODES
from canopen_proto.drives.cia402.states import POWERED, State
from tests.ros1.ros_world import Client, Drives, Process, Ros, needs_ros, until

pytestmark = needs_ros

JOINTS = {f"joint{number}": node_id for number, node_id in enumerate(DEMO_NODES, start=1)}
FAR = {"points": [[20.0, dict.fromkeys(JOINTS, 2.0)]]}
"""A goal under way for a long time: all six joints move."""
TARGET = 2.0 * 180_000 / math.pi
"""The same in counts."""

PATIENT = """
[master]
cycle = "100ms"
timeout = "20s"
watchdog = { timeout = "5s" }

[defaults.joints]
unit = "degree"
counts_per_turn = 360000
max_speed = 30
homing_method = 37
state_timeout = "20s"
reaction_time = "2s"
halt_time = "20s"

[defaults.chains]
define_pdos = true
"""
"""For a machine that is busy with other things: each process may have to wait."""


def machine_file(drives: Drives, folder: Path) -> Path:
    """A machine of the six drives: in degrees, homed where they stand."""
    nodes = "".join(f'[nodes.{name}]\nbus = "can0"\nid = {node_id}\n' for name, node_id in JOINTS.items())
    joints = "".join(f"[joints.{name}]\n" for name in JOINTS)
    chains = f"[chains.arm]\njoints = {list(JOINTS)}\n"
    path = folder / "cell.toml"
    path.write_text(f'{PATIENT}[buses.can0]\nlocator = "{drives.locator}"\n{nodes}{joints}{chains}')
    return path


@pytest.fixture
def launched(ros: Ros, drives: Drives, tmp_path: Path) -> Process:
    """roslaunch with the node of these drives."""
    return ros.launch(f"roslaunch ros_canopen canopen.launch machine:={machine_file(drives, tmp_path)}")


def set_in_motion(client: Client, drives: Drives) -> None:
    """Initialise and home the arm, and let all six joints move."""
    client.call("/arm/init")
    client.call("/arm/home")
    assert client("begin", FAR) == [1, ""], "it is active"
    until(drives.all_move, "all six joints move")


def they_were_halted(drives: Drives) -> bool:
    """Whether all six stand, and none has come to its target."""
    return drives.all_stand() and max(drives.positions.values()) < TARGET - 1000


def test_ctrl_c_in_motion_halts_all_six_joints(ros: Ros, drives: Drives, launched: Process) -> None:
    set_in_motion(ros.client(), drives)
    launched.interrupt()
    launched.wait()
    assert they_were_halted(drives)
    assert not {*POWERED} & {*drives.states.values()}, "they have no power"


def test_a_node_that_is_killed_and_one_that_takes_its_drives_up_again(ros: Ros, drives: Drives, tmp_path: Path) -> None:
    first = ros.launch(f"roslaunch ros_canopen canopen.launch machine:={machine_file(drives, tmp_path)}")
    client = ros.client()
    set_in_motion(client, drives)
    os.kill(ros.node_process(), signal.SIGKILL)
    until(drives.all_stand, "all six joints stand")
    assert they_were_halted(drives)
    until(lambda: set(drives.states.values()) == {State.SWITCH_ON_DISABLED}, "their own watch took their power")
    first.wait()  # the node is required: roslaunch ends with it

    ros.launch(f"roslaunch ros_canopen canopen.launch machine:={tmp_path / 'cell.toml'}")
    set_in_motion(ros.client(), drives)


def test_a_lost_ros_master_halts_all_six_joints(ros: Ros, drives: Drives, tmp_path: Path) -> None:
    master = ros.start(f"exec roscore -p {ros.port}")
    until(ros.has_master, "the ROS master answers", master.must_live)
    node = ros.start(f"rosrun ros_canopen ros_canopenmasternode {machine_file(drives, tmp_path)}")
    until(ros.has_services, "the node offers its services", node.must_live)
    set_in_motion(ros.client(), drives)
    os.kill(ros.master_process(), signal.SIGKILL)
    assert node.wait() == 1
    assert they_were_halted(drives)
    assert "the ROS master at" in node.text


def test_sigterm_and_rosnode_kill_halt_all_six_joints(ros: Ros, drives: Drives, launched: Process) -> None:
    set_in_motion(ros.client(), drives)
    ros.run("rosnode kill /ros_canopen")
    launched.wait()
    assert they_were_halted(drives)


def test_a_node_without_arguments_and_parameters_asks_for_a_description(ros: Ros) -> None:
    """R22. With a ROS master, and without."""
    sentence = "File not found. Please provide a description file as command line argument\n"
    assert ros.run("rosrun ros_canopen ros_canopenmasternode", status=1) == sentence
    master = ros.start(f"exec roscore -p {ros.port}")
    until(ros.has_master, "the ROS master answers", master.must_live)
    assert ros.run("rosrun ros_canopen ros_canopenmasternode", status=1).endswith(sentence)


def test_simulated_time_and_best_effort_are_refused(ros: Ros) -> None:
    master = ros.start(f"exec roscore -p {ros.port}")
    until(ros.has_master, "the ROS master answers", master.must_live)
    node = "rosrun ros_canopen ros_canopenmasternode single_device.csv"
    printed = ros.run(f"{node} _joint_states_reliability:=best_effort", status=1)
    assert "joint_states_reliability is best_effort, which ROS 1 does not have" in printed
    ros.run([sys.executable, "-c", "import rospy; rospy.set_param('/use_sim_time', True)"])
    assert "/use_sim_time is true, but this node cannot follow /clock" in ros.run(node, status=1)


def test_the_manuals_launch_file_as_printed(ros: Ros) -> None:
    """R75: by a simulated drive in place of the adapter."""
    launched = ros.launch("roslaunch ros_canopen single_device.launch", CANOPEN_SIMULATE="true")
    client = ros.client()
    client.call("/chain1/init")
    client.call("/chain1/home")
    assert list(client.positions) == ["joint1"]
    launched.interrupt()
    assert launched.wait() == 0


def test_the_manuals_launch_file_without_the_adapter_says_what_is_missing(ros: Ros) -> None:
    printed = ros.start("roslaunch ros_canopen single_device.launch")
    printed.wait()
    assert re.search(r"^CO[0-9]{3}: .*/dev/pcan32", printed.text, re.MULTILINE)


def test_a_python_without_the_package_says_what_to_do(ros: Ros) -> None:
    printed = ros.run("/usr/bin/python3 -I $(rospack find ros_canopen)/scripts/ros_canopenmasternode", status=1)
    assert "python:=" in printed
