"""The life cycle of the ROS 2 node: each transition, seen by a manager of life cycles and at the drives."""

from __future__ import annotations

from pathlib import Path

from lifecycle_msgs.msg import Transition
from std_srvs.srv import Trigger

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


def test_a_deactivate_that_cannot_stop_the_drives_is_an_error_and_the_node_can_begin_again(
    tmp_path: Path, client: Client
) -> None:
    with Arm(tmp_path) as arm, running(tmp_path, *arm.machine) as node:
        client.listen_to_state("arm")
        assert client.trigger("/arm/init").success
        arm.close()
        client.until(lambda: client.heard["/arm/state"][-1].data == "failed", "the state")
        assert not client.change_state(DEACTIVATE)
        assert client.state() == "unconfigured"
        assert "CO111" in node.output()
