"""The ROS 1 node with simulated joints, as docs/ros.md has it: its commands as printed there, and an action client."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs_build import DOCS
from tests.ros1.ros_world import Client, Ros, needs_ros, until

pytestmark = needs_ros

PAGE = (DOCS / "ros.md").read_text(encoding="utf-8")
NOISE = 0.002
"""Radians that a joint may be off: how long a simulated drive is behind its set-point, at the speeds of these tests."""

MOVED = 0.01
"""Radians: more than any noise."""

GOAL = {"joint1": 0.2, "joint2": 0.0, "joint3": -0.1, "joint4": 0.0, "joint5": 0.0, "joint6": 0.0}
"""Of the page's trajectory."""


def commands_of(heading: str) -> list[str]:
    """The commands of the first shell block behind a text of the page."""
    block = PAGE.partition(heading)[2].partition("```sh\n")[2].partition("```")[0]
    return block.replace("\\\n", " ").strip().splitlines()


@pytest.fixture(scope="module")
def ros(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros]:
    """A node with six simulated joints, for all tests of this file."""
    with Ros(tmp_path_factory.mktemp("ros")) as ros:
        ros.launch(commands_of("in three commands")[-1])
        yield ros


@pytest.fixture(autouse=True)
def what_the_node_printed(ros: Ros) -> Iterator[None]:
    """For the report of a test that fails."""
    before = len(ros.printed)
    yield
    print(ros.printed[before:])


@pytest.fixture(scope="module")
def client(ros: Ros) -> Client:
    return ros.client()


@pytest.fixture
def arm(client: Client) -> Client:
    """The same, with joints that stand at 0 and are enabled."""
    if client.state in ("off", "fault"):
        client.call("/arm/init")
        client.call("/arm/home")
    else:
        client.goals({"points": [[2.0, dict.fromkeys(client.positions, 0.0)]]})
    return client


def test_the_commands_of_the_page_as_printed(ros: Ros, client: Client) -> None:
    commands = commands_of("In a second terminal:")
    assert [line.split()[-1] for line in commands if line.startswith("rosservice")] == [
        f"/arm/{service}" for service in ("init", "home", "halt", "recover", "shutdown")
    ]
    for command in commands:
        printed = ros.run(command)
        if command.startswith("rosservice"):
            assert "success: True" in printed, command
        elif "joint_trajectory" in command:
            until(lambda: client.positions == pytest.approx(GOAL, abs=NOISE), "the arm is at the goal")
        elif command.endswith("/arm/state"):
            assert re.search('data: "(moving|following)"', printed)
        else:
            assert "joint6" in printed


def test_services_say_why_they_refuse(client: Client) -> None:
    client.call("/arm/shutdown")
    success, message = client("call", "/arm/recover")
    assert not success
    assert re.search(r"^CO[0-9]{3}: .*try: +arm/init", message, re.DOTALL)


def test_velocities_end_with_their_client(ros: Ros, arm: Client) -> None:
    """Killed, so that it can send no zeros: the watchdog brakes."""
    ros.run("rostopic pub -1 /arm/command_vel std_msgs/Float64MultiArray '{data: [0, 0, 0, 0, 0, 0]}'")
    sender = ros.start("exec rostopic pub -r 20 /arm/command_vel std_msgs/Float64MultiArray '{data: [0.1, 0, 0, 0, 0, -0.1]}'")
    until(lambda: arm.positions["joint1"] > MOVED, "joint 1 moves", sender.must_live)
    sender.kill()
    until(lambda: arm.state == "following", "the chain stands")
    there = arm.positions
    assert there["joint1"] > MOVED
    assert there["joint6"] == pytest.approx(-there["joint1"], abs=NOISE)
    assert arm.positions == pytest.approx(there, abs=1e-6)


def test_positions_of_ros2_control_in_any_order(ros: Ros, arm: Client) -> None:
    """Taken only from a controller that begins where the joints are."""
    command = "rostopic pub -1 /arm/joint_commands sensor_msgs/JointState '{name: [joint6, joint1], position: [%s]}'"
    before = arm.positions
    ros.run(command % "0.1, 0.05")
    until(lambda: "they begin 0.1 away from joint6" in ros.printed, "the log tells of it")
    assert arm.positions == pytest.approx(before, abs=1e-6)
    ros.run(command % "0.0, 0.0")
    ros.run(command % "0.1, 0.05")
    goal = {**dict.fromkeys(arm.positions, 0.0), "joint6": 0.1, "joint1": 0.05}
    until(lambda: arm.positions == pytest.approx(goal, abs=NOISE), "they are there")


def test_an_action_goal_and_its_feedback(arm: Client) -> None:
    (goal,), _ = arm.goals({"points": [[1.5, {"joint2": 0.05, "joint1": 0.1}], [3.0, {"joint2": 0.1, "joint1": 0.2}]]})
    assert (goal["outcome"], goal["code"]) == ("succeeded", 0), goal["text"]
    assert len(goal["seen"]) > 50
    last = goal["seen"][-1]
    assert (last["desired"]["joint1"], last["desired"]["joint2"]) == pytest.approx((0.2, 0.1), abs=1e-4)
    errors = [each["error"]["joint1"] for each in goal["seen"]]
    assert max(map(abs, errors)) > 0.0, "the following error is told"
    for each in goal["seen"]:
        for name in ("joint1", "joint2"):
            assert each["error"][name] == pytest.approx(each["desired"][name] - each["actual"][name], abs=1e-9)
    assert errors[-1] == pytest.approx(0.0, abs=NOISE)


def test_a_goal_that_is_cancelled_brakes_on_its_path(arm: Client) -> None:
    (goal,), states = arm.goals({"points": [[4.0, {"joint1": 0.8, "joint2": 0.4}]], "cancel": True})
    assert goal["outcome"] == "preempted"
    there = arm.positions
    assert MOVED < there["joint1"] < 0.8 - MOVED
    assert arm.positions == pytest.approx(there, abs=1e-6), "it stands"
    for state in [*states, there]:
        assert state["joint2"] == pytest.approx(state["joint1"] / 2, abs=NOISE)


def test_a_second_goal_takes_over_from_the_first_one(arm: Client) -> None:
    (first, second), _ = arm.goals({"points": [[5.0, {"joint1": 1.0}]]}, {"points": [[2.0, {"joint1": 0.1, "joint2": 0.1}]]})
    assert (first["outcome"], second["outcome"]) == ("preempted", "succeeded")
    assert (arm.positions["joint1"], arm.positions["joint2"]) == pytest.approx((0.1, 0.1), abs=NOISE)


def test_a_goal_beyond_a_limit_is_refused_with_joint_time_and_value(arm: Client) -> None:
    before = arm.positions
    (goal,), _ = arm.goals({"points": [[0.1, {"joint1": 0.0, "joint4": 2.0}]]})
    assert (goal["outcome"], goal["code"]) == ("rejected", -1)
    assert goal["seen"] == []
    assert re.search(r"joint4.* 0\.\d+ s", goal["text"], re.DOTALL), goal["text"]
    assert arm.positions == pytest.approx(before, abs=1e-6)


def test_a_goal_for_an_unknown_joint_is_refused(arm: Client) -> None:
    (goal,), _ = arm.goals({"points": [[1.0, {"elbow": 0.1}]]})
    assert (goal["outcome"], goal["code"]) == ("rejected", -2)
    assert "joint1" in goal["text"]


def test_a_path_tolerance_that_is_left_ends_the_goal(arm: Client) -> None:
    (goal,), _ = arm.goals({"points": [[3.0, {"joint1": 0.4}]], "path_tolerance": {"joint1": 1e-6}})
    assert (goal["outcome"], goal["code"]) == ("aborted", -4), goal["text"]
    assert "joint1" in goal["text"]


def test_objects_by_the_classes_that_the_page_writes(ros: Ros, arm: Client, tmp_path: Path) -> None:
    write, export, get = commands_of("for example for `rosservice call /get_object`")
    printed = ros.run(f"cd {tmp_path} && {write} && {export} && {get}")
    (value,) = re.findall(r'success: True.*value: "(\d+)"', printed, re.DOTALL)
    assert int(value) & 0x6F == 0x27, "operation enabled"
    written = "{node: joint1, object: 1017sub0, value: '500', cached: false}"
    assert "success: True" in ros.run(f'cd {tmp_path} && {export} && rosservice call /set_object "{written}"')


def test_diagnostics_name_the_state_and_the_bits_of_the_statusword(ros: Ros, arm: Client) -> None:
    printed = ros.run("rostopic echo -n 1 /diagnostics")
    assert '"ros_canopen: arm: joint1"' in printed
    assert "voltage enabled" in printed
    assert "missed cycles" in printed


def test_joint_states_are_in_order_and_have_one_stamp_each(ros: Ros, arm: Client) -> None:
    printed = ros.run("rostopic echo -n 100 -p /joint_states")
    rows = [line.split(",") for line in printed.splitlines() if line[:1].isdigit()]
    sequence, stamps = [int(row[1]) for row in rows], [int(row[2]) for row in rows]
    assert sequence == list(range(sequence[0], sequence[0] + 100)), "none is lost"
    assert stamps == sorted(set(stamps))
