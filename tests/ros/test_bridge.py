"""The bridge as a whole: services, a trajectory, samples and diagnostics of one arm."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
import trio

from canopen_data.named_files import open_description
from canopen_master.machine_file import read_machine
from canopen_ros.bridge import open_bridge
from canopen_ros.diagnostics import Level, named
from canopen_ros.goals import Feedback, GoalOutcome, TrajectoryGoal, TrajectoryPoint
from canopen_ros.parameters import NodeParameters
from canopen_ros.reply import FILE_ERRORS
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


CELL = """
[buses.can0]
[nodes.own]
id = 5
file = "own.dcf"
values = { 1017 = 350 }
script = "own.py"
[nodes.default]
id = 6
file = "own.dcf"
defaults = true
profile = "none"
[nodes.joint1]
id = 3
[joints.joint1]
[chains.arm]
joints = ["joint1"]
"""
SCRIPT = """
def setup(device):
    device[0x6081] = 4711
    raise ValueError("so is an error told")
"""


@virtual_time
async def test_simulated_devices_are_what_the_machine_file_says(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """As with `canopen sim`: values at power-on, a script, the defaults of a DCF, memory in the place of a drive."""
    eds = open_description("sample_drive.eds").data.decode()
    dcf = re.sub(r"(?s)(\[1018sub4\].*?)(\[|$)", r"\1ParameterValue=99\n\2", eds, count=1)
    (tmp_path / "own.dcf").write_text(dcf)
    (tmp_path / "own.py").write_text(SCRIPT)
    (tmp_path / "cell.toml").write_text(CELL)
    machine = on_virtual_buses(read_machine(tmp_path / "cell.toml"))
    async with simulated_machine(machine) as simulation:
        (own, default) = (node for host in simulation.hosts for node in host.nodes if node.node_id != 3)
        assert own.values.read(0x1017) == 350
        assert own.values.read(0x6081) == 4711
        assert own.values.read((0x1018, 4)) == 99
        assert default.values.read((0x1018, 4)) != 99
        assert sorted(simulation.drives) == [3, 5]
    assert "own.py:4: in setup: ValueError: so is an error told" in caplog.text


@pytest.mark.parametrize(("script", "said"), [("def setup(:\n", "CO331"), (None, "there is no file 'own.py'")])
def test_a_script_that_cannot_be_used_is_no_traceback_of_the_node(script: str | None, said: str, tmp_path: Path) -> None:
    (tmp_path / "own.dcf").write_bytes(open_description("sample_drive.eds").data)
    (tmp_path / "own.py").write_text(script or "")
    (tmp_path / "cell.toml").write_text(CELL)
    machine = on_virtual_buses(read_machine(tmp_path / "cell.toml"))
    if script is None:
        (tmp_path / "own.py").unlink()
    with pytest.raises(FILE_ERRORS, match=said):
        simulated_machine(machine)


@virtual_time
async def test_the_names_of_diagnostics_begin_with_namespace_and_node() -> None:
    async with bridge_of(1) as (bridge, _):
        names = [each.name for each in named(bridge.diagnostics(), "/left/ros_canopen")]
    assert names == [f"left/ros_canopen: {name}" for name in ("bus: can0", "chain: arm", "arm: joint1")]
