"""The life cycle of the ROS 2 node: each transition, seen by a manager of life cycles and at the drives."""

from __future__ import annotations

from pathlib import Path

from lifecycle_msgs.msg import Transition
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.qos import ReliabilityPolicy
from std_srvs.srv import Trigger

from canopen_ros.parameters import PARAMETERS
from tests.ros2.arm import Arm
from tests.ros2.client import Client, parameters, running
from tests.ros2.test_ends import all_move, keep_moving

CONFIGURE, CLEANUP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE
SHUT_DOWN_ACTIVE, SHUT_DOWN_INACTIVE = Transition.TRANSITION_ACTIVE_SHUTDOWN, Transition.TRANSITION_INACTIVE_SHUTDOWN


def test_once_around(tmp_path: Path, arm: Arm, client: Client) -> None:
    with running(tmp_path, *arm.machine, "-p", "autostart:=false"):
        assert client.state() == "unconfigured"
        assert client.change_state(CONFIGURE)
        assert client.state() == "inactive"
        refused = client.trigger("/arm/init")
        assert not refused.success
        assert "not active" in refused.message
        assert arm.states == {"SWITCH_ON_DISABLED"}

        assert client.change_state(ACTIVATE)
        assert arm.states == {"SWITCH_ON_DISABLED"}  # init powers them, not this
        all_move(client, arm)

        assert client.change_state(DEACTIVATE)
        assert arm.moving == 0
        assert arm.states == {"SWITCH_ON_DISABLED"}
        assert client.state() == "inactive"

        assert client.change_state(ACTIVATE)
        assert client.trigger("/arm/init").success
        keep_moving(client, arm)
        assert client.change_state(DEACTIVATE)
        assert client.change_state(CLEANUP)
        assert client.state() == "unconfigured"
        client.until(lambda: not client.node.get_publishers_info_by_topic("/joint_states"), "the topics are gone")

        assert client.change_state(CONFIGURE)
        assert client.change_state(ACTIVATE)
        assert client.trigger("/arm/init").success


def test_deactivate_halts_what_homes(tmp_path: Path, arm: Arm, client: Client) -> None:
    with running(tmp_path, *arm.machine):
        assert client.trigger("/arm/init").success
        homing = client.begin(Trigger, "/arm/home")
        client.until(lambda: arm.moving > 0, "drives that home")
        assert client.change_state(DEACTIVATE)
        assert arm.moving == 0
        client.until(homing.done, "the end of home")
        assert not homing.result().success


def test_shut_down_in_motion_stops_the_drives(tmp_path: Path, arm: Arm, client: Client) -> None:
    with running(tmp_path, *arm.machine):
        all_move(client, arm)
        assert client.change_state(SHUT_DOWN_ACTIVE)
        assert arm.moving == 0
        assert arm.states == {"SWITCH_ON_DISABLED"}
        assert client.state() == "finalized"


def test_a_failed_configure_says_why_and_can_be_repeated(tmp_path: Path, client: Client) -> None:
    with running(tmp_path, *parameters(chains='"arm joint1 can0 3"', simulat="true", autostart="false")) as node:
        assert not client.change_state(CONFIGURE)
        assert client.state() == "unconfigured"
        client.until(lambda: "simulat" in node.output() and "simulate" in node.output(), "the log")


def put(client: Client, name: str, value: ParameterValue) -> str:
    """Set a parameter; return why it is refused."""
    request = SetParameters.Request(parameters=[Parameter(name=name, value=value)])
    result = client.call(SetParameters, "/ros_canopen/set_parameters", request).results[0]
    assert result.successful == (not result.reason)
    return str(result.reason)


def text(value: str) -> ParameterValue:
    return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)


def number(value: float) -> ParameterValue:
    return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)


YES, NO = (ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=each) for each in (True, False))


def test_a_parameter_is_refused_unless_it_has_an_effect(tmp_path: Path, client: Client) -> None:
    def topic() -> str:
        request = GetParameters.Request(names=["joint_states"])
        return str(client.call(GetParameters, "/ros_canopen/get_parameters", request).values[0].string_value)

    arguments = parameters(chains='"arm joint1 can0 3"', simulate="true", autostart="false", joint_states="here")
    with running(tmp_path, *arguments):
        assert client.change_state(CONFIGURE)
        for _ in ("inactive", "active"):
            assert "cleanup" in put(client, "joint_states", text("there"))
            assert "nonsense is read-only" in put(client, "nonsense", text("there"))
            assert topic() == "here"
            client.change_state(ACTIVATE)
        assert "read-only" in put(client, "autostart", YES)
        assert client.change_state(DEACTIVATE)
        assert client.change_state(CLEANUP)
        assert "clock" in put(client, "use_sim_time", YES)
        assert put(client, "joint_states", text("there")) == ""
        assert "read-only" in put(client, "autostart", YES)
        assert client.change_state(CONFIGURE)
        client.until(lambda: client.node.get_publishers_info_by_topic("/there"), "the topic of the new parameter")
        assert "cleanup" in put(client, "joint_states", text("here"))


def test_parameters_have_types_ranges_and_descriptions_and_are_checked(tmp_path: Path, client: Client) -> None:
    """An integer at the start is the double that it means."""
    with running(tmp_path, *parameters(chains='"arm joint1 can0 3"', simulate="true", autostart="false", goal_time="2")):
        request = DescribeParameters.Request(names=[*PARAMETERS, "autostart"])
        described = client.call(DescribeParameters, "/ros_canopen/describe_parameters", request).descriptors
        assert all(each.description for each in described)
        found = {each.name: each for each in described}
        assert {name for name, each in found.items() if each.read_only} == {"autostart"}
        for name, parameter in PARAMETERS.items():
            ranges = [(each.from_value, each.to_value) for each in found[name].floating_point_range]
            is_number = isinstance(parameter.default, float)
            assert ranges == ([(parameter.least, parameter.most)] if is_number else []), name
            assert found[name].dynamic_typing == (parameter.default is None), name
            if is_number:
                assert found[name].type == ParameterType.PARAMETER_DOUBLE, name
        assert "range" in put(client, "velocity_watchdog", number(60.0))
        assert "type" in put(client, "simulate", text("yes"))
        assert "reliable or best_effort" in put(client, "joint_states_reliability", text("mostly"))
        assert "did you mean goal_time" in put(client, "goaltime", number(1.0))
        assert "from 0.1 to 10000" in put(client, "sync_interval", number(-1.0))
        assert put(client, "joints.joint1.unit", text("degree")) == ""
        assert put(client, "joint_states_reliability", text("best_effort")) == ""
        assert client.change_state(CONFIGURE)
        (publisher,) = client.node.get_publishers_info_by_topic("/joint_states")
        assert publisher.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT


def test_values_that_were_wrong_at_the_start_are_all_told_by_configure_and_can_be_mended(tmp_path: Path, client: Client) -> None:
    arguments = parameters(chains='"arm joint1 can0 3"', simulate="maybe", autostart="false", goal_time="-1.0")
    with running(tmp_path, *arguments) as node:
        assert not client.change_state(CONFIGURE)
        client.until(lambda: "goal_time is -1.0" in node.output() and "simulate is 'maybe'" in node.output(), "the log")
        assert put(client, "goal_time", number(1.0)) == ""
        assert put(client, "simulate", YES) == ""
        assert client.change_state(CONFIGURE)


def test_simulated_time_is_refused_at_the_start(tmp_path: Path, client: Client) -> None:
    arguments = parameters(chains='"arm joint1 can0 3"', simulate="true", use_sim_time="true")
    with running(tmp_path, *arguments) as node:
        assert node.ended() == 1
        assert "use_sim_time is true, but this node cannot follow /clock" in node.output()
    with running(tmp_path, *arguments, "-p", "autostart:=false"):
        assert not client.change_state(CONFIGURE)
        assert put(client, "use_sim_time", NO) == ""
        assert client.change_state(CONFIGURE)


def test_a_deactivate_that_cannot_stop_the_drives_is_an_error_and_the_node_can_begin_again(
    tmp_path: Path, client: Client
) -> None:
    with Arm(tmp_path) as arm, running(tmp_path, *arm.machine) as node:
        client.listen_to_state("arm")
        assert client.trigger("/arm/init").success
        arm.close()
        client.until(lambda: client.last("/arm/state").data == "failed", "the state")
        assert not client.change_state(DEACTIVATE)
        assert client.state() == "unconfigured"
        assert "CO111" in node.output()
