"""How the node ends while six drives of another process move: SIGINT, kill -9, a bus that goes away; and a node after it."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from std_srvs.srv import Trigger

from tests.ros2.arm import Arm
from tests.ros2.client import Client, NodeProcess, running, six_velocities


def all_move(client: Client, arm: Arm) -> None:
    """Let six drives move by a velocity that is sent again and again, and return while they move."""
    for service in ("init", "home"):
        answer = client.trigger(f"/arm/{service}")
        assert answer.success, answer.message
    keep_moving(client, arm)


def keep_moving(client: Client, arm: Arm) -> None:
    velocities = itertools.chain([0.0] * 10, itertools.repeat(0.05))  # they are taken once they were 0

    def moving() -> bool:
        six_velocities(client, next(velocities))
        return arm.moving == 6

    client.until(moving, "six drives move")


def test_a_halt_gets_through_while_home_runs(tmp_path: Path, arm: Arm, client: Client) -> None:
    with running(tmp_path, *arm.machine):
        assert client.trigger("/arm/init").success
        homing = client.begin(Trigger, "/arm/home")
        client.until(lambda: arm.moving == 6, "six drives that home")
        halted = client.trigger("/arm/halt")
        assert halted.success, halted.message
        assert arm.moving == 0
        client.until(homing.done, "the end of home")
        assert not homing.result().success
        assert "CO403" in homing.result().message


@pytest.mark.parametrize("signal", ["SIGINT", "SIGTERM"])
def test_a_signal_in_motion_halts_all_six(tmp_path: Path, arm: Arm, client: Client, signal: str) -> None:
    with running(tmp_path, *arm.machine) as node:
        all_move(client, arm)
        if signal == "SIGINT":
            node.interrupt()
        else:
            node.process.terminate()
        assert node.ended() == 0
        assert arm.moving == 0
        assert arm.states == {"SWITCH_ON_DISABLED"}


def test_kill_stops_all_six_and_a_new_node_takes_them_up_again(tmp_path: Path, arm: Arm, client: Client) -> None:
    """Drives in ip brake when SYNC ends; they stay enabled, since this arm has no 0x6007: docs/limits.md."""
    with running(tmp_path, *arm.machine) as node:
        all_move(client, arm)
        node.process.kill()
        node.process.wait()
        client.until(lambda: arm.moving == 0, "six drives stand")
    with running(tmp_path, *arm.machine), Client() as other:
        all_move(other, arm)


def test_a_home_that_runs_ends_with_the_node(tmp_path: Path, arm: Arm, client: Client) -> None:
    with running(tmp_path, *arm.machine) as node:
        assert client.trigger("/arm/init").success
        client.begin(Trigger, "/arm/home")
        client.until(lambda: arm.moving > 0, "drives that home")
        node.interrupt()
        assert node.ended() == 0, node.output()
        assert arm.moving == 0


def test_a_bus_that_goes_away_is_told_and_refuses_services(tmp_path: Path, client: Client) -> None:
    with Arm(tmp_path) as arm, running(tmp_path, *arm.machine):
        client.listen_to_state("arm")
        client.listen_to_diagnostics()
        assert client.trigger("/arm/init").success
        arm.close()
        client.until(lambda: client.last("/arm/state").data == "failed", "the state")
        client.until(lambda: client.last("/diagnostics").status[0].level == b"\2", "the diagnostics")
        answer = client.trigger("/arm/home")
        assert not answer.success
        assert "CO111" in answer.message


def test_a_bus_that_is_not_there_ends_the_node_with_its_reason(tmp_path: Path) -> None:
    with Arm(tmp_path) as arm:
        locator = arm.locator
    node = NodeProcess(tmp_path, *arm.machine)
    assert node.ended() == 1
    assert "CO1" in node.output()
    assert locator in node.output()
