"""The ROS 2 node with a real rclpy, end to end: names, services, states, motion, objects, diagnostics. The drives are in it."""

from __future__ import annotations

import itertools
import math
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from canopen_ros import names
from tests.ros2.client import Client, NodeProcess, parameters, running, six_velocities

NODE = "ros_canopen"
JOINTS = [f"joint{number}" for number in range(1, 7)]
CHAINS = "arm " + " ".join(f"{joint} can0 {node}" for node, joint in enumerate(JOINTS, 3))


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeProcess]:
    """One node for all tests of this file, with simulated drives; each test takes it as the one before left it."""
    with running(tmp_path_factory.mktemp("node"), *parameters(chains=f'"{CHAINS}"', simulate="true")) as made:
        yield made


@pytest.fixture
def client(node: NodeProcess) -> Iterator[Client]:
    with Client() as made:
        made.listen_to_joints()
        made.listen_to_state("arm")
        yield made


@pytest.fixture
def ready(client: Client) -> Client:
    """The client of an arm that is ready to move, and homed."""
    services = ["init"] if is_homed(client) else ["init", "home"]
    for service in services:
        answer = client.trigger(f"/arm/{service}")
        assert answer.success, answer.message
    return client


def is_homed(client: Client) -> bool:
    client.listen_to_diagnostics()
    chain = next(status for status in client.next("/diagnostics").status if status.name == f"{NODE}: chain: arm")
    return "yes" in {each.value for each in chain.values if each.key == "homed"}


def position(client: Client, joint: int) -> float:
    return client.joints().position[joint]


def trajectory(points: list[tuple[float, list[float]]], joints: list[str] = JOINTS) -> JointTrajectory:
    made = JointTrajectory(joint_names=joints)
    for seconds, positions in points:
        time = Duration(sec=int(seconds), nanosec=round(seconds % 1 * 1e9))
        made.points.append(JointTrajectoryPoint(positions=positions, time_from_start=time))
    return made


def stands_at(client: Client, positions: list[float]) -> bool:
    heard = client.heard["/joint_states"]
    return bool(heard) and all(
        math.isclose(is_at, wanted, abs_tol=1e-3) for is_at, wanted in zip(heard[-1].position, positions, strict=True)
    )


def test_the_graph_has_the_names_of_the_table(client: Client, node: NodeProcess) -> None:
    topics = {
        name.of("arm") if name.name.startswith("/") else f"/{name.of('arm')}": [name.type.replace("/", "/msg/")]
        for name in (names.JOINT_STATES, names.DIAGNOSTICS, *names.OF_CHAIN)
        if name.in_ros2 and name.kind is not names.Kind.SERVICE
    }
    services = {f"/arm/{command}": ["std_srvs/srv/Trigger"] for command in names.COMMANDS}
    services |= {
        "/get_object": ["rcl_interfaces/srv/GetParameters"],
        "/set_object": ["rcl_interfaces/srv/SetParameters"],
    }
    # A graph is discovered name by name
    client.until(lambda: topics.keys() <= dict(client.node.get_topic_names_and_types()).keys(), f"all of {list(topics)}")
    client.until(lambda: services.keys() <= dict(client.node.get_service_names_and_types()).keys(), f"all of {list(services)}")
    found = dict(client.node.get_topic_names_and_types())
    assert {topic: found[topic] for topic in topics} == topics
    found = dict(client.node.get_service_names_and_types())
    assert {service: found[service] for service in services} == services


def test_a_service_that_is_refused_says_why(client: Client) -> None:
    assert client.trigger("/arm/shutdown").success
    answer = client.trigger("/arm/home")
    assert not answer.success
    assert "CO404" in answer.message
    assert "arm/init" in answer.message


def test_states_are_latched(ready: Client) -> None:
    with Client() as late:
        late.listen_to_state("arm")
        assert late.next("/arm/state").data == "ready"


def test_joint_states_are_those_of_the_drives_in_order(ready: Client) -> None:
    ready.until(lambda: len(ready.heard["/joint_states"]) > 20, "joint states")
    heard = ready.heard["/joint_states"]
    assert {tuple(each.name) for each in heard} == {tuple(JOINTS)}
    stamps = [each.header.stamp.sec * 10**9 + each.header.stamp.nanosec for each in heard]
    assert stamps == sorted(stamps)


def test_a_trajectory_by_names_in_any_order(ready: Client) -> None:
    goal = [0.02, -0.03, 0.04, 0.0, 0.05, -0.06]
    ready.publish(JointTrajectory, "/arm/joint_trajectory", trajectory([(1.0, goal[::-1])], JOINTS[::-1]))
    ready.until(lambda: stands_at(ready, goal), "the goal")


def test_a_trajectory_with_an_unknown_joint_is_refused_and_logged(ready: Client, node: NodeProcess) -> None:
    before = list(ready.joints().position)
    ready.publish(JointTrajectory, "/arm/joint_trajectory", trajectory([(1.0, [0.1])], ["elbow"]))
    ready.until(lambda: "elbow" in node.output(), "the log")
    assert stands_at(ready, before)


def test_velocities_move_until_they_stop_coming(ready: Client) -> None:
    before = position(ready, 0)
    velocities = itertools.chain([0.0] * 10, itertools.repeat(0.05))  # they are taken once they were 0

    def send_and_look() -> bool:
        ready.publish(Float64MultiArray, "/arm/command_vel", Float64MultiArray(data=[next(velocities), 0.0, 0.0, 0.0, 0.0, 0.0]))
        return position(ready, 0) > before + 0.02

    ready.until(send_and_look, "joint1 moves")
    ready.until(lambda: abs(position(ready, 0) - position(ready, 0)) < 1e-9, "joint1 stands, without a further command")


def test_a_single_zero_lets_velocities_be_taken_also_if_the_node_is_late(ready: Client, node: NodeProcess) -> None:
    """A zero, and what follows it at once: the node finds all of them when it comes to look."""
    assert ready.trigger("/arm/init").success  # nobody has the joints
    before = position(ready, 0)
    six_velocities(ready, 0.0)
    ready.until(lambda: position(ready, 0) == before, "it has heard of the publisher")
    assert ready.trigger("/arm/init").success
    node.process.send_signal(signal.SIGSTOP)
    for velocity in (0.0, 0.05, 0.05):
        six_velocities(ready, velocity)
    node.process.send_signal(signal.SIGCONT)

    def send_and_look() -> bool:
        six_velocities(ready, 0.05)
        return position(ready, 0) > before + 0.001

    ready.until(send_and_look, "joint1 moves")


def test_too_few_velocities_are_refused_and_logged(ready: Client, node: NodeProcess) -> None:
    before = list(ready.joints().position)
    ready.publish(Float64MultiArray, "/arm/command_vel", Float64MultiArray(data=[0.1, 0.1]))
    ready.until(lambda: "2 values of velocity were given, not 6" in node.output(), "the log")
    assert stands_at(ready, before)


def test_joint_commands_as_ros2_control_sends_them(ready: Client, node: NodeProcess) -> None:
    """All joints by name; sent until the arm is there, and then no more: it holds its place.

    Taken only from where the joints are.
    """
    before = list(ready.joints().position)
    goal = [position + 0.02 for position in before]
    ready.publish(JointState, "/arm/joint_commands", JointState(name=JOINTS, position=goal))
    ready.until(lambda: "they begin 0.02 away from joint" in node.output(), "the log")
    assert stands_at(ready, before)
    positions = itertools.chain([before] * 10, itertools.repeat(goal))

    def send_and_look() -> bool:
        if sum(abs(is_at - wanted) for is_at, wanted in zip(ready.joints().position, goal, strict=True)) < 1e-5:
            return True
        ready.publish(JointState, "/arm/joint_commands", JointState(name=JOINTS, position=next(positions)))
        return stands_at(ready, goal)

    ready.until(send_and_look, "the arm is there")
    count = len(ready.heard["/joint_states"])
    ready.until(lambda: len(ready.heard["/joint_states"]) > count + 100, "a second of silence")
    ready.until(lambda: stands_at(ready, goal), "it holds its place")


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (JointState(name=JOINTS, position=[math.nan] * 6), "no finite number"),
        (JointState(name=JOINTS, position=[0.1] * 3), "3 values were given for 6 joints"),
    ],
    ids=["NaN", "short"],
)
def test_joint_commands_that_are_refused(ready: Client, node: NodeProcess, command: JointState, reason: str) -> None:
    before = list(ready.joints().position)
    ready.publish(JointState, "/arm/joint_commands", command)
    ready.until(lambda: reason in node.output(), "the log")
    assert stands_at(ready, before)


def test_a_halt_stops_a_trajectory_and_stays_in_force(ready: Client, node: NodeProcess) -> None:
    before = position(ready, 0)
    far = [before + 1.0, *ready.joints().position[1:]]
    ready.publish(JointTrajectory, "/arm/joint_trajectory", trajectory([(20.0, far)]))
    ready.until(lambda: position(ready, 0) > before + 0.005, "it moves")
    assert ready.trigger("/arm/halt").success
    stopped = position(ready, 0)
    assert stopped < before + 0.9
    ready.publish(JointTrajectory, "/arm/joint_trajectory", trajectory([(1.0, far)]))
    ready.until(lambda: "the halt is in force" in node.output(), "the log")
    assert ready.trigger("/arm/recover").success


# ---- objects ----


def read(client: Client, *wanted: str) -> list[Any]:
    return list(client.call(GetParameters, "/get_object", GetParameters.Request(names=wanted)).values)


def write(client: Client, wanted: str, value: ParameterValue) -> Any:
    request = SetParameters.Request(parameters=[Parameter(name=wanted, value=value)])
    return client.call(SetParameters, "/set_object", request).results[0]


def test_objects_are_read_by_name_and_by_number(ready: Client) -> None:
    by_name, by_number, other = read(ready, "joint1/device_type", "joint1/1000sub0", "joint1/nonsense")
    assert by_name.type == by_number.type == ParameterType.PARAMETER_STRING
    assert by_name.string_value == by_number.string_value == str(0x00020192)
    assert other.type == ParameterType.PARAMETER_NOT_SET
    assert "nonsense" in other.string_value


def test_an_object_is_written_and_read_back(ready: Client) -> None:
    result = write(ready, "joint1/1017sub0", ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=250))
    assert result.successful, result.reason
    assert read(ready, "joint1/1017sub0")[0].string_value == "250"
    result = write(ready, "joint1/1017sub0", ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="many"))
    assert not result.successful
    assert result.reason


# ---- diagnostics ----


def test_diagnostics_tell_of_bus_chain_and_joints(ready: Client) -> None:
    ready.listen_to_diagnostics()
    statuses = {status.name: status for status in ready.next("/diagnostics").status}
    assert set(statuses) == {f"{NODE}: {name}" for name in ("bus: can0", "chain: arm", *(f"arm: {joint}" for joint in JOINTS))}
    assert {status.level for status in statuses.values()} == {b"\0"}
    values = {each.key: each.value for each in statuses[f"{NODE}: arm: joint1"].values}
    assert {"state", "statusword", "error code (603F)", "emergency"} <= set(values)


# ---- ends ----


def test_ctrl_c_ends_it_with_status_0(tmp_path: Path) -> None:
    """In a namespace, which its diagnostics name. The drives are looked at in test_ends.py."""
    given = [*parameters(chains=f'"{CHAINS}"', simulate="true"), "-r", "__ns:=/second"]
    with running(tmp_path, *given) as second, Client() as client:
        assert client.trigger("/second/arm/init").success
        client.listen_to_diagnostics()
        client.until(
            lambda: any(
                status.name == f"second/{NODE}: arm: joint1" for each in client.heard["/diagnostics"] for status in each.status
            ),
            "its diagnostics",
        )
        second.interrupt()
        assert second.ended() == 0, second.output()


def test_without_arguments_and_parameters_it_says_what_it_needs(tmp_path: Path) -> None:
    node = NodeProcess(tmp_path)
    assert node.ended() == 1
    assert names.NO_FILE in node.output()


def test_controllers_wait_for_the_states_of_all_their_joints(tmp_path: Path) -> None:
    """As the launch file lets them: the one that misses a joint goes on waiting. In a namespace without another node."""
    module, space = "canopen_ros.ros2.await_joints", ["-r", "__ns:=/third"]
    with Client() as client:
        waiting = NodeProcess(tmp_path, "joint1", "joint2", "--ros-args", *space, module=module)
        short = NodeProcess(tmp_path, "joint1", "joint9", "--ros-args", *space, module=module)
        try:
            client.until(lambda: "waiting for the joint states of joint1" in waiting.output(), "it waits")
            client.until(lambda: "waiting for the joint states of joint1" in short.output(), "the other one waits")
            assert waiting.process.poll() is None
            with running(tmp_path, *parameters(chains='"arm joint1 can0 3 joint2 can0 4"', simulate="true"), *space):
                assert waiting.ended() == 0, waiting.output()
                client.until(lambda: "no joint states of joint9 yet" in short.output(), "what is missing")
            short.interrupt()
            assert short.ended() == 1
        finally:
            for each in (waiting, short):
                each.process.kill()
