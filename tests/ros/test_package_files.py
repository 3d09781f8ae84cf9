"""The files of the ROS package agree with each other and with the node. They are read without ROS; nothing is launched."""

from __future__ import annotations

import sys
import xml.etree.ElementTree
from collections.abc import Callable
from importlib import resources
from itertools import pairwise
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import pytest

from canopen_cli.shared.problem import ExitCode
from canopen_master.ros_configurations.yaml_text import Value, read_yaml
from canopen_ros import names
from canopen_ros.parameters import NodeParameters
from tests.cli.cli_support import runner

PACKAGE = Path(str(resources.files("canopen_ros"))) / "package"
FILES = {
    each.relative_to(PACKAGE).as_posix()
    for each in PACKAGE.rglob("*")
    if each.is_file() and each.suffix != ".pyc" and each.name != "__init__.py"
}


def text_of(name: str) -> str:
    return (PACKAGE / name).read_text(encoding="utf-8")


def plain(value: Value) -> object:
    """A value as ROS reads it, as far as these files need it."""
    if value.kind == "map":
        return {key: plain(each) for key, each in value.entries.items()}
    if value.kind == "list":
        return [plain(each) for each in value.items]
    return int(value.text) if value.kind == "int" else value.text


def ros2_parameters(name: str, node: str) -> Value:
    return read_yaml(text_of(name).encode(), name).entries[node].entries["ros__parameters"]


def parameters(name: str) -> NodeParameters:
    whole = read_yaml(text_of(name).encode(), name)
    if "ros_canopen" in whole.entries:
        whole = ros2_parameters(name, "ros_canopen")
    given = plain(whole)
    assert isinstance(given, dict)
    return NodeParameters.from_mapping(given)


def texts(value: Value) -> list[str]:
    return [each.text for each in value.items]


def interfaces(joint: Element, kind: str) -> list[str | None]:
    return [each.get("name") for each in joint.findall(f"{kind}_interface")]


@pytest.fixture
def robot() -> Element:
    return xml.etree.ElementTree.fromstring(text_of("urdf/six_joints.urdf"))


@pytest.fixture
def control(robot: Element) -> Element:
    (found,) = robot.findall("ros2_control")
    return found


@pytest.mark.parametrize("config", ["config/six_joints.yaml", "config/six_joints.ros2.yaml"])
def test_the_robots_joints_are_those_of_the_parameters(robot: Element, control: Element, config: str) -> None:
    joints = [f"joint{number}" for number in range(1, 7)]
    assert list(parameters(config).machine.chains["arm"].joints) == joints
    assert [joint.get("name") for joint in robot.findall("joint")] == joints
    assert [joint.get("name") for joint in control.findall("joint")] == joints


def test_the_parameters_of_ros_1_and_ros_2_are_the_same() -> None:
    assert parameters("config/six_joints.yaml") == parameters("config/six_joints.ros2.yaml")


def test_the_robot_is_one_row_of_links(robot: Element) -> None:
    row = [link.get("name") for link in robot.findall("link")]
    ways = [(joint.find("parent"), joint.find("child")) for joint in robot.findall("joint")]
    found = [(None if a is None else a.get("link"), None if b is None else b.get("link")) for a, b in ways]
    assert found == list(pairwise(row))


def test_both_topics_are_those_of_the_node(control: Element) -> None:
    """The names of the node are relative, and it has no namespace in the launch file."""
    given = {each.get("name"): each.text for each in control.findall("hardware/param")}
    assert given == {
        "joint_commands_topic": "/" + names.JOINT_COMMANDS.of("arm"),
        "joint_states_topic": "/" + parameters("config/six_joints.ros2.yaml").joint_states,
    }
    assert parameters("config/six_joints.ros2.yaml").joint_states == names.JOINT_STATES.name


def test_the_controller_has_the_joints_and_interfaces_of_the_robot(control: Element) -> None:
    manager = ros2_parameters("config/controllers.yaml", "controller_manager").entries
    (controller,) = [name for name, each in manager.items() if each.kind == "map"]
    entries = ros2_parameters("config/controllers.yaml", controller).entries
    joints = control.findall("joint")
    assert texts(entries["joints"]) == [joint.get("name") for joint in joints]
    for joint in joints:
        assert texts(entries["command_interfaces"]) == interfaces(joint, "command")
        assert texts(entries["state_interfaces"]) == interfaces(joint, "state")
    assert entries["set_last_command_interface_value_as_state_on_activation"].text == "false"  # true is the default
    assert f'"{controller}"' in text_of("launch/canopen.launch.py")  # the one that is spawned


@pytest.mark.parametrize("name", sorted(name for name in FILES if name.endswith(".py") or name.startswith("scripts/")))
def test_programs_compile(name: str) -> None:
    compile(text_of(name), name, "exec")


class Started(NamedTuple):
    """A stand-in for an action, an event or a handler of ROS 2's launch: what it was made with."""

    kind: str
    given: tuple[object, ...]
    named: dict[str, Any]


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[Started]]:
    """Run the launch file with stand-ins for launch, which is not here; returns what it starts."""
    needed = {
        "launch": ("LaunchContext", "LaunchDescription"),
        "launch.action": ("Action",),
        "launch.actions": ("DeclareLaunchArgument", "ExecuteProcess", "LogInfo", "OpaqueFunction", "RegisterEventHandler"),
        "launch.event_handlers": ("OnProcessExit",),
        "launch.events": (),
        "launch.events.process": ("ProcessExited",),
        "launch_ros": (),
        "launch_ros.actions": ("LifecycleNode", "Node"),
    }
    for module, kinds in needed.items():
        made = ModuleType(module)
        for kind in kinds:
            setattr(made, kind, lambda *given, kind=kind, **named: Started(kind, given, named))
        monkeypatch.setitem(sys.modules, module, made)
    path = PACKAGE / "launch" / "canopen.launch.py"
    space: dict[str, Any] = {"__file__": str(path), "__name__": "launched"}
    exec(compile(path.read_text(encoding="utf-8"), str(path), "exec"), space)

    def launch(**given: str) -> list[Started]:
        configurations = {name: default for name, (default, _) in space["ARGUMENTS"].items()} | given
        started: list[Started] = space["node_and_controllers"](SimpleNamespace(launch_configurations=configurations))
        return started

    return launch


def executables(started: list[Started]) -> set[str]:
    return {each.named["executable"] for each in started if "executable" in each.named}


def test_controllers_start_once_all_joint_states_are_there(launched: Callable[..., list[Started]], control: Element) -> None:
    assert executables(launched()) == {"python3"}
    started = launched(control="true")
    assert executables(started) == {"python3", "robot_state_publisher"}
    (waiting,) = [each for each in started if each.kind == "ExecuteProcess"]
    joints = [joint.get("name") for joint in control.findall("joint")]
    assert waiting.named["cmd"] == ["python3", "-m", "canopen_ros.ros2.await_joints", *joints]
    (handler,) = [each for each in started if each.kind == "RegisterEventHandler"]
    (exit_handler,) = handler.given
    assert isinstance(exit_handler, Started)
    assert exit_handler.named["target_action"] is waiting
    assert started.index(handler) < started.index(waiting)  # so that no end is missed
    ended = exit_handler.named["on_exit"]
    assert executables(ended(SimpleNamespace(returncode=0), None)) == {"ros2_control_node", "spawner"}
    assert executables(ended(SimpleNamespace(returncode=1), None)) == set()


@pytest.mark.parametrize("name", sorted(name for name in FILES if name.endswith((".launch", ".xml", ".urdf"))))
def test_xml_is_well_formed(name: str) -> None:
    xml.etree.ElementTree.fromstring(text_of(name))


@pytest.mark.parametrize("name", sorted(name for name in FILES if name.endswith(".launch")))
def test_the_files_that_a_launch_file_names_are_there(name: str) -> None:
    launch = xml.etree.ElementTree.fromstring(text_of(name))
    named = [value for each in launch.iter() for value in each.attrib.values() if value.startswith("$(find ros_canopen)/")]
    assert named
    assert {value.removeprefix("$(find ros_canopen)/") for value in named} <= FILES


def test_init_writes_every_file(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    done = runner(capsys, monkeypatch, tmp_path)("ros", "init", str(tmp_path / "ros"))
    assert done.status == ExitCode.OK, done.err
    written = tmp_path / "ros" / "ros_canopen"
    assert {each.relative_to(written).as_posix() for each in written.rglob("*") if each.is_file()} == FILES
    assert {
        name for name in FILES if not name.startswith("scripts/") and (written / name).read_text("utf-8") != text_of(name)
    } == set()
