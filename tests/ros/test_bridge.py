"""The bridge as a whole: services, a trajectory, samples and diagnostics of one arm."""

from __future__ import annotations

from dataclasses import replace

import pytest
import trio

from canopen_ros.bridge import open_bridge
from canopen_ros.diagnostics import Level, named
from canopen_ros.goals import Feedback, GoalOutcome, TrajectoryGoal, TrajectoryPoint
from canopen_ros.parameters import NodeParameters
from canopen_ros.simulated import on_virtual_buses, simulated_machine
from tests.master.world import virtual_time
from tests.ros.ros_world import bridge_of, chain_text, ready_arm


@virtual_time
async def test_a_session_from_init_to_shutdown() -> None:
    async with bridge_of() as (bridge, arm):
        assert arm.state == "off"
        assert arm.services == (
            "init", "home", "homing", "recover", "halt", "shutdown", "IPmode", "interpolated_position_mode",
        )  # fmt: skip
        refused = await arm.call("home")
        assert not refused.success
        assert refused.message == "CO404: chain arm cannot home now\n  seen:  it is off\n  try:   arm/init"
        for service, state in (
            ("init", "ready"),
            ("home", "ready"),
            ("IPmode", "following"),
            ("halt", "halted"),
            ("recover", "following"),
        ):
            assert (await arm.call(service)).success
            assert arm.state == state
        assert {each.level for each in bridge.diagnostics()} == {Level.OK}
        for message in ("chain arm is off", "chain arm is off already"):
            assert await arm.call("shutdown") == (True, message, "")
            assert arm.state == "off"


@virtual_time
async def test_a_trajectory_by_names_in_any_order() -> None:
    async with ready_arm() as (bridge, arm):
        seen: list[Feedback] = []
        begun: list[str] = []
        goal = TrajectoryGoal(["joint2", "joint1"], [TrajectoryPoint([0.3, 0.2], time_from_start=2.0)])
        result = await arm.follow(goal, seen.append, lambda: begun.append(arm.state))
        assert result.outcome is GoalOutcome.SUCCEEDED
        assert begun == ["moving"]
        assert len(seen) > 200
        assert bridge.sample().names == ("joint1", "joint2")
        assert bridge.sample().positions == pytest.approx((0.2, 0.3), abs=2e-5)


@virtual_time
async def test_positions_are_told_without_power_too() -> None:
    """A controller and a planner have to know where the joints are before anything moves."""
    async with bridge_of() as (bridge, arm):
        samples = bridge.samples()
        async for sample in samples:
            if len(sample.names) == 2:  # the first one may come before both drives have answered
                break

        async def count(seconds: float) -> int:
            found = 0
            with trio.move_on_after(seconds):
                async for sample in samples:
                    assert sample.names == ("joint1", "joint2")
                    found += 1
            return found

        assert 4 <= await count(1.0) <= 6
        before = bridge.sample().positions
        assert (await arm.call("init")).success
        assert await count(1.0) >= 90
        assert (await arm.call("shutdown")).success
        await count(1.0)  # of the time before
        assert 4 <= await count(1.0) <= 6
        assert bridge.sample().positions == before
        assert (await arm.call("init")).success


@virtual_time
async def test_a_joint_that_is_not_there_holds_up_no_other_one() -> None:
    given = NodeParameters.from_mapping({"chains": chain_text(2)})
    machine = on_virtual_buses(given.machine)
    nodes = {name: node for name, node in machine.nodes.items() if node.node_id == 3}
    async with simulated_machine(replace(machine, nodes=nodes)), open_bridge(replace(given, machine=machine)) as bridge:
        await trio.sleep(3.0)
        assert bridge.sample().names == ("joint1",)


@virtual_time
async def test_the_names_of_diagnostics_begin_with_namespace_and_node() -> None:
    async with bridge_of(1) as (bridge, _):
        names = [each.name for each in named(bridge.diagnostics(), "/left/ros_canopen")]
    assert names == [f"left/ros_canopen: {name}" for name in ("bus: can0", "chain: arm", "arm: joint1")]
