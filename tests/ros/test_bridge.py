"""The bridge as a whole: services, a trajectory, samples and diagnostics of one arm."""

from __future__ import annotations

import pytest

from canopen_ros.diagnostics import Level
from canopen_ros.goals import Feedback, Outcome, TrajectoryGoal, TrajectoryPoint
from tests.master.world import virtual_time
from tests.ros.ros_world import bridge_of, ready_arm


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
        assert result.outcome is Outcome.SUCCEEDED
        assert begun == ["moving"]
        assert len(seen) > 200
        assert bridge.sample().names == ("joint1", "joint2")
        assert bridge.sample().positions == pytest.approx((0.2, 0.3), abs=2e-5)
