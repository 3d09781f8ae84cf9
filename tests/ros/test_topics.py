"""Velocities with their watchdog, and positions as ros2_control sends them; what is refused is reported, and nothing moves."""

from __future__ import annotations

import math
from typing import Any

import pytest
import trio

from canopen_ros.goals import GoalOutcome, TrajectoryGoal, TrajectoryPoint
from canopen_ros.topic_motions import QUIET
from tests.examples import takes_all
from tests.master.world import virtual_time
from tests.ros.ros_world import Cell, cell

MILLIDEGREES = 180_000 / math.pi
EXACT = 3e-5


async def feed(world: Cell, velocities: list[float], seconds: float, period: float = 0.05) -> None:
    end = trio.current_time() + seconds
    while trio.current_time() < end:
        world.arm.command_velocities(velocities)
        await trio.sleep(period)


async def reports(world: Cell) -> list[str]:
    """The reports so far."""
    found: list[str] = []
    with trio.move_on_after(0.001):
        async for report in world.bridge.reports():
            assert report.chain == "arm"
            found.append(report.text)
    return found


@virtual_time
async def test_velocities_move_the_joints_and_silence_brakes_them() -> None:
    async with cell(sync_interval=10) as world:
        await world.ask("init")
        world.let_go()
        await feed(world, [0.2, -0.1], 1.5)
        assert world.arm.state == "moving"
        assert world.bridge.sample().velocities == pytest.approx((0.2, -0.1), abs=0.01)
        before = world.positions
        await trio.sleep(1.0)
        way = [abs(after - begin) / MILLIDEGREES for after, begin in zip(world.positions, before, strict=True)]
        assert way[0] < 0.2 * (0.1 + 0.05 + 0.6)  # the watchdog, a cycle or two, and the ramp
        await world.assert_all_stand()
        assert world.arm.state == "following"
        await feed(world, [-0.2, 0.1], 0.5)  # and the next ones move them again
        assert world.is_moving


@virtual_time
async def test_the_watchdog_is_a_parameter() -> None:
    async with cell(velocity_watchdog=0.5) as world:
        await world.ask("init")
        world.let_go()
        await feed(world, [0.2, -0.1], 1.5, period=0.4)
        assert world.bridge.sample().velocities[0] == pytest.approx(0.2, abs=0.01)


@virtual_time
async def test_zeros_begin_no_motion_and_end_none_of_a_goal() -> None:
    async with cell() as world:
        await world.ask("init")
        await feed(world, [0.0, 0.0], 0.5)
        assert world.arm.state == "ready"
        results = []

        async def follow() -> None:
            results.append(await world.arm.follow(TrajectoryGoal(["joint1"], [TrajectoryPoint([0.2], time_from_start=1.5)])))

        world.nursery.start_soon(follow)
        await trio.sleep(0.7)
        await feed(world, [0.0, 0.0], 1.5)
        assert [each.outcome for each in results] == [GoalOutcome.SUCCEEDED]


@virtual_time
async def test_a_joystick_takes_over_from_a_goal() -> None:
    async with cell() as world:
        await world.ask("init")
        results = []

        async def follow() -> None:
            results.append(await world.arm.follow(TrajectoryGoal(["joint1"], [TrajectoryPoint([0.8], time_from_start=4.0)])))

        world.nursery.start_soon(follow)
        await trio.sleep(1.5)
        world.let_go()
        await feed(world, [-0.2, 0.0], 2.0)
        assert [each.outcome for each in results] == [GoalOutcome.PREEMPTED]
        assert world.bridge.sample().velocities[0] == pytest.approx(-0.2, abs=0.01)


@virtual_time
async def test_a_halt_stays_in_force_whatever_the_joystick_says() -> None:
    async with cell() as world:
        await world.ask("init")
        world.nursery.start_soon(world.keep_jogging)
        await trio.sleep(1.0)
        await world.ask("halt")
        await world.assert_all_stand()
        assert world.arm.state == "halted"
        world.arm.command_positions(["joint1"], [0.3])
        await world.assert_all_stand()
        told = await reports(world)
        assert any("the halt is in force" in text and "arm/recover" in text for text in told)
        assert len(told) <= 4  # and not one for each message
        await world.ask("recover")
        await world.assert_all_stand()
        world.let_go()
        await trio.sleep(1.0)
        assert world.is_moving


@virtual_time
async def test_a_halt_that_comes_with_a_message_wins() -> None:
    async with cell() as world:
        await world.ask("init")
        world.arm.command_velocities([0.2, 0.0])
        await world.ask("halt")
        world.arm.command_velocities([0.2, 0.0])
        world.arm.command_positions(["joint1"], [0.2])
        await world.assert_all_stand()
        assert world.arm.state == "halted"


WRONG_VELOCITIES = {
    "too few": ([0.1], "1 values of velocity were given, not 2"),
    "too many": ([0.1] * 3, "3 values of velocity were given, not 2"),
    "no number": ([0.1, math.nan], "the velocity of joint2 is no finite number"),
    "infinite": ([-math.inf, 0.0], "the velocity of joint1 is no finite number"),
}
WRONG_POSITIONS = {
    "a short array": ((["joint1", "joint2"], [0.1]), "1 values were given for 2 joints"),
    "an unknown joint": ((["joint1", "arm2_joint1"], [0.1, 0.1]), "there is no joint 'arm2_joint1'"),
    "a joint twice": ((["joint1", "joint1"], [0.1, 0.1]), "'joint1' is named twice"),
    "no number": ((["joint1"], [math.nan]), "the value of joint1 is no finite number"),
    "a wrong velocity": ((["joint1"], [0.1], [0.1, 0.2]), "2 values were given for 1 joints"),
    "an infinite velocity": ((["joint2"], [0.1], [math.inf]), "the value of joint2 is no finite number"),
}


@virtual_time
async def test_what_is_wrong_is_refused_as_a_whole_and_reported() -> None:
    async with cell() as world:
        world.arm.command_velocities([0.1, 0.1])
        world.arm.command_positions(["joint1"], [0.1])
        assert [text.splitlines()[0] for text in await reports(world)] == [
            "CO404: chain arm cannot take velocities now",
            "CO404: chain arm cannot take positions now",
        ]
        await world.ask("init")
        for what, (values, text) in WRONG_VELOCITIES.items():
            world.arm.command_velocities(values)
            assert [text in told for told in await reports(world)] == [True], what
        for what, (given, text) in WRONG_POSITIONS.items():
            arguments: Any = given
            world.arm.command_positions(*arguments)
            assert [text in told for told in await reports(world)] == [True], what
        assert world.arm.state == "ready"


@virtual_time
async def test_a_wrong_message_among_good_ones_changes_nothing() -> None:
    async with cell() as world:
        await world.ask("init")
        world.let_go()
        await feed(world, [0.2, 0.0], 1.0)
        world.arm.command_velocities([math.nan, 0.0])
        await feed(world, [0.2, 0.0], 0.5)
        assert world.bridge.sample().velocities == pytest.approx((0.2, 0.0), abs=0.01)


@virtual_time
async def test_positions_are_held_in_silence_and_joints_that_are_not_named_stay() -> None:
    async with cell() as world:
        await world.ask("init")
        await world.ask("home")
        world.hold()
        for step in range(1, 41):  # a controller at 50 Hz
            world.arm.command_positions(["joint2"], [0.01 * step])
            await trio.sleep(0.02)
        await trio.sleep(3.0)
        assert world.bridge.sample().positions == pytest.approx((0.0, 0.4), abs=EXACT)
        await trio.sleep(60.0 if takes_all() else 5.0)  # ros2_control sends nothing once the arm is there
        assert world.bridge.sample().positions == pytest.approx((0.0, 0.4), abs=EXACT)
        assert world.arm.state == "following"
        world.arm.command_positions(["joint1", "joint2"], [0.1, 0.3])
        await trio.sleep(4.0)
        assert world.bridge.sample().positions == pytest.approx((0.1, 0.3), abs=EXACT)


@pytest.mark.thorough(2)
@pytest.mark.parametrize(("with_velocities", "lag"), [(True, 0.07), (False, 0.24)])
@virtual_time
async def test_a_controller_that_tells_its_velocities_is_followed_closely(with_velocities: bool, lag: float) -> None:
    """lag: seconds, at most, at the peak of 0.24 rad/s. Behind the last message the joint rests at its position."""
    async with cell(1, sync_interval=10) as world:
        await world.ask("init")
        await world.ask("home")
        await world.ask("IPmode")
        worst, turn = 0.0, 2 * math.pi / 4
        for number in range(300):
            time = number * 0.01
            position, velocity = 0.15 * (1 - math.cos(turn * time)), 0.15 * turn * math.sin(turn * time)
            world.arm.command_positions(["joint1"], [position], [velocity] if with_velocities else ())
            await trio.sleep(0.01)
            worst = max(worst, abs(position - world.bridge.sample().positions[0]))
        assert worst < lag * 0.15 * turn
        await trio.sleep(3.0)
        assert world.bridge.sample().positions[0] == pytest.approx(position, abs=EXACT)


@virtual_time
async def test_positions_are_refused_while_a_trajectory_runs() -> None:
    async with cell() as world:
        await world.ask("init")
        await world.ask("home")
        results = []

        async def follow() -> None:
            results.append(await world.arm.follow(TrajectoryGoal(["joint1"], [TrajectoryPoint([0.2], time_from_start=1.5)])))

        world.nursery.start_soon(follow)
        await trio.sleep(0.7)
        world.arm.command_positions(["joint1"], [0.5])
        await trio.sleep(3.0)
        assert [each.outcome for each in results] == [GoalOutcome.SUCCEEDED]
        assert world.bridge.sample().positions[0] == pytest.approx(0.2, abs=EXACT)
        assert "it follows a trajectory" in (await reports(world))[0]


@virtual_time
async def test_a_position_beyond_a_limit_counts_as_the_limit() -> None:
    async with cell(joints={"joint1": {"unit": "radian", "max_position": 0.3}}) as world:
        await world.ask("init")
        await world.ask("home")
        world.hold()
        world.arm.command_positions(["joint1"], [0.5])
        await trio.sleep(5.0)
        assert world.bridge.sample().positions[0] == pytest.approx(0.3, abs=EXACT)


@virtual_time
async def test_velocities_end_when_sync_does() -> None:
    """The watchdog counts SYNCs: without one it would wait for ever, and the joints would be said to move."""
    async with cell(sync_interval=10) as world:
        await world.ask("init")
        world.let_go()
        await feed(world, [0.2, -0.1], 0.5)
        world.bridge.master.sync_stop()
        await trio.sleep(3.0)
        assert world.arm.state == "halted"
        await world.assert_all_stand()
        await world.ask("recover")
        world.let_go()
        await feed(world, [0.2, -0.1], 0.5)
        assert world.is_moving


@virtual_time
async def test_positions_end_when_sync_does() -> None:
    async with cell(sync_interval=10) as world:
        await world.ask("init")
        world.hold()
        world.arm.command_positions(["joint1"], [0.3])
        await trio.sleep(0.3)
        assert world.arm.state == "moving"
        world.bridge.master.sync_stop()
        await trio.sleep(5.0)
        assert world.arm.state == "halted"
        await world.assert_all_stand()


@virtual_time
async def test_a_position_counts_at_any_moment_about_the_end_of_the_one_before() -> None:
    """Joints that stand are no longer led a while behind their last position; one that comes just then is not lost."""
    async with cell(sync_interval=10) as world:
        await world.ask("init")
        world.hold()
        for number in range(0, 12, 1 if takes_all() else 3):
            world.arm.command_positions(["joint1"], [0.0001 * (number % 2)])
            await trio.sleep(QUIET + 0.005 * number)
            world.arm.command_positions(["joint1"], [0.01])
            await trio.sleep(1.0)
            assert world.bridge.sample().positions[0] == pytest.approx(0.01, abs=EXACT), number
        assert await reports(world) == []


@virtual_time
async def test_a_velocity_beyond_the_limit_is_refused_and_reported() -> None:
    async with cell(joints={"joint1": {"unit": "radian", "max_speed": 0.25}}) as world:
        await world.ask("init")
        world.let_go()
        before = world.positions
        await feed(world, [0.26, 0.0], 0.5)
        assert world.positions == before
        assert "the velocity of joint1 is beyond its limit of 0.25" in (await reports(world))[0]
        await feed(world, [-0.25, 0.0], 0.5)
        assert world.is_moving
