"""Trajectories as ROS gives them: their joints, points, times, tolerances; how they blend, are replaced, refused."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
import trio

from canopen_ros.goals import Feedback, GoalCode, GoalOutcome, GoalResult, Tolerance, TrajectoryGoal, TrajectoryPoint
from canopen_ros.threads import open_portal
from tests.master.world import virtual_time
from tests.ros.ros_world import START, Cell, cell, wall

BOTH = ["joint1", "joint2"]
P = TrajectoryPoint
NOW = 100.0
"""Seconds on the clock of trio at the test of what is refused."""
EXACT = 3e-5
"""A count is a millidegree."""


def goal(*points: TrajectoryPoint, names: Any = BOTH, **more: Any) -> TrajectoryGoal:
    return TrajectoryGoal(names, list(points), **more)


SIMPLE = goal(P([0.3, -0.2], time_from_start=1.5))

REFUSED = {
    "an unknown joint": (goal(P([0.0, 0.0], time_from_start=1), names=["joint1", "joint9"]), -2, "no joint 'joint9'"),
    "a joint twice": (goal(P([0.0, 0.0], time_from_start=1), names=["joint1", "joint1"]), -2, "twice"),
    "no joints": (goal(P([], time_from_start=1), names=[]), -2, "names no joints"),
    "too few positions": (goal(P([0.1], time_from_start=1)), -1, "point 0 .* has 1 positions for 2 joints"),
    "too many velocities": (goal(P([0.1, 0.1], [0.0] * 3, time_from_start=1)), -1, "3 velocities for 2 joints"),
    "not a number": (goal(P([0.1, math.nan], time_from_start=1)), -1, "joint2 has no finite number in the positions .* at 1 s"),
    "infinite velocity": (
        goal(P([0.1, 0.1], [math.inf, 0.0], time_from_start=1)), -1, "joint1 has no finite number in the velocities",
    ),
    "times that fall": (
        goal(P([0.1, 0.1], time_from_start=1), P([0.2, 0.2], time_from_start=1)), -1, "later than 1 s",
    ),
    "a time before 0": (goal(P([0.1, 0.1], time_from_start=-0.1)), -1, "0 s or later"),
    "a time that is no number": (goal(P([0.1, 0.1], time_from_start=math.nan)), -1, "at nan s"),
    "velocities here and there": (
        goal(P([0.1, 0.1], [0.0, 0.0], time_from_start=1), P([0.2, 0.2], time_from_start=2)), -1, "unlike point 0",
    ),
    "accelerations alone": (goal(P([0.1, 0.1], (), [0.0, 0.0], time_from_start=1)), -1, "no velocities"),
    "an end that moves": (goal(P([0.1, 0.1], [0.0, 0.2], time_from_start=1)), -1, "joint2 does not rest at the end, at 1 s"),
    "another start": (
        goal(P([0.0, 0.5], time_from_start=0), P([0.1, 0.5], time_from_start=2)), -1, "joint2 is at 0 at 0 s",
    ),
    "too fast": (goal(P([0.1, 2.0], time_from_start=0.1)), -1, "joint2 beyond its limit of .* at 0.0"),
    "a tolerance of another joint": (
        goal(P([0.1, 0.1], time_from_start=1), path_tolerance=[Tolerance("joint9", 0.1)]), -2, "joint9",
    ),
    "a negative tolerance": (
        goal(P([0.1, 0.1], time_from_start=1), path_tolerance=[Tolerance("joint1", -0.1)]), -1, "joint1 in position",
    ),
    "a tolerance of acceleration": (
        goal(P([0.1, 0.1], time_from_start=1), goal_tolerance=[Tolerance("joint1", 0, 0, 1)]), -1, "which no drive tells",
    ),
    "a negative time": (goal(P([0.1, 0.1], time_from_start=1), goal_time_tolerance=-1.0), -1, "goal_time_tolerance"),
    "a start long ago": (
        goal(P([0.1, 0.1], time_from_start=1), start=START + round((NOW - 60.0) * 1e9)), -3, r"ended 59\.?\d* s ago",
    ),
}  # fmt: skip


@virtual_time
async def test_goals_that_are_refused_say_why_and_move_nothing() -> None:
    async with cell() as world:
        await world.ask("init")
        await world.ask("home")
        await trio.sleep(NOW - trio.current_time())
        before = world.positions
        for what, (refused, code, text) in REFUSED.items():
            begun: list[int] = []
            result = await world.arm.follow(refused, None, lambda begun=begun: begun.append(1))  # type: ignore[misc]
            assert (result.code, result.outcome) == (code, GoalOutcome.REJECTED), what
            assert re.search(text, result.text), (what, result.text)
            assert not begun
        assert world.positions == before
        assert (await world.arm.follow(SIMPLE)).outcome is GoalOutcome.SUCCEEDED


@virtual_time
async def test_a_subset_of_the_joints_moves_and_the_others_hold() -> None:
    async with cell(3) as world:
        await world.ask("init")
        await world.ask("home")
        result = await world.arm.follow(goal(P([0.2, 0.1], time_from_start=1.5), names=["joint3", "joint1"]))
        assert result == GoalResult(GoalCode.SUCCESSFUL, "the joints are there", GoalOutcome.SUCCEEDED)
        assert world.bridge.sample().positions == pytest.approx((0.1, 0.0, 0.2), abs=EXACT)


@virtual_time
async def test_a_joint_that_moves_has_to_be_in_a_goal_that_takes_over() -> None:
    async with cell() as world:
        await world.ask("init")
        results = await two_goals(world, goal(P([0.1], time_from_start=2.0), names=["joint2"]))
        assert [result.outcome for result in results] == [GoalOutcome.REJECTED, GoalOutcome.SUCCEEDED]
        assert results[0].text.startswith("joint1 moves, and is not in the trajectory")


@pytest.mark.thorough(5)
@pytest.mark.parametrize("kinds", ["positions", "velocities", "accelerations"])
@virtual_time
async def test_a_trajectory_goes_through_its_points_at_their_times(kinds: str) -> None:
    times = [0.0, 1.0, 2.0, 3.0]
    # a polynomial of degree 5 from rest to rest: its own values at 1 and 2 s
    x = [0.3 * (10 * (t / 3) ** 3 - 15 * (t / 3) ** 4 + 6 * (t / 3) ** 5) for t in times]
    v = [0.3 * (30 * (t / 3) ** 2 - 60 * (t / 3) ** 3 + 30 * (t / 3) ** 4) / 3 for t in times]
    a = [0.3 * (60 * (t / 3) - 180 * (t / 3) ** 2 + 120 * (t / 3) ** 3) / 9 for t in times]
    points = [
        P([x[n], -x[n]], [v[n], -v[n]] if kinds != "positions" else (), [a[n], -a[n]] if kinds == "accelerations" else (), t)
        for n, t in enumerate(times)
    ]
    async with cell(sync_interval=10) as world:
        await world.ask("init")
        await world.ask("home")
        seen: list[Feedback] = []
        assert (await world.arm.follow(goal(*points), seen.append)).outcome is GoalOutcome.SUCCEEDED
        for n in (1, 2):
            at = [
                each for each in seen if each.actual.time_from_start == pytest.approx(times[n] + 0.03)
            ]  # reached three SYNCs later
            assert at[0].actual.positions == pytest.approx([x[n], -x[n]], abs=0.004)
        assert max(abs(each.error.positions[0]) for each in seen) < 0.01


@virtual_time
async def test_a_new_goal_blends_and_the_one_before_is_preempted() -> None:
    async with cell(sync_interval=10) as world:
        await world.ask("init")
        await world.ask("home")
        results = await two_goals(world, goal(P([-0.1, 0.3], time_from_start=2.2)))
        assert [result.outcome for result in results] == [GoalOutcome.PREEMPTED, GoalOutcome.SUCCEEDED]
        assert world.bridge.sample().positions == pytest.approx((-0.1, 0.3), abs=EXACT)


@virtual_time
async def test_a_goal_that_is_refused_leaves_the_present_one_alone() -> None:
    async with cell() as world:
        await world.ask("init")
        await world.ask("home")
        results = await two_goals(world, goal(P([0.1, 2.5], time_from_start=0.3)))
        assert [result.outcome for result in results] == [GoalOutcome.REJECTED, GoalOutcome.SUCCEEDED]
        assert world.bridge.sample().positions == pytest.approx((0.5, -0.3), abs=EXACT)


@virtual_time
async def test_an_empty_trajectory_stops_on_the_path() -> None:
    async with cell() as world:
        await world.ask("init")
        results = await two_goals(world, goal())
        assert [result.outcome for result in results] == [GoalOutcome.PREEMPTED, GoalOutcome.SUCCEEDED]
        assert 1_000 < world.positions[0] < 28_000
        await world.assert_all_stand()
        assert world.arm.state == "following"


@virtual_time
async def test_a_stop_that_comes_behind_a_goal_stops_it_though_both_come_in_one_turn() -> None:
    """A busy computer hands several messages over at once. Trio begins tasks of one turn in any order."""
    async with cell() as world, open_portal() as portal:
        for each in ("init", "home"):
            await world.ask(each)
        for _ in range(8):
            going = portal.submit(world.arm.follow, goal(P([0.5, -0.3], time_from_start=3.0)))
            stopping = portal.submit(world.arm.follow, goal())
            await trio.sleep(1.0)
            assert (going.result(0).outcome, stopping.result(0).outcome) == (GoalOutcome.PREEMPTED, GoalOutcome.SUCCEEDED)
            await world.assert_all_stand()


@virtual_time
async def test_of_goals_that_come_in_one_turn_the_last_one_moves_the_joints() -> None:
    async with cell() as world, open_portal() as portal:
        for each in ("init", "home", "IPmode"):
            await world.ask(each)
        for sign in (1.0, -1.0) * 3:
            places = [sign * 0.1 * number for number in (1, 3, 2)]
            goals = [portal.submit(world.arm.follow, goal(P([place, 0.0], time_from_start=3.0))) for place in places]
            await trio.sleep(4.5)
            outcomes = [each.result(0).outcome for each in goals]
            assert outcomes == [GoalOutcome.PREEMPTED, GoalOutcome.PREEMPTED, GoalOutcome.SUCCEEDED]
            assert world.bridge.sample().positions[0] == pytest.approx(places[-1], abs=EXACT)


@virtual_time
async def test_a_goal_that_begins_leaves_a_later_one_alone_that_waits_for_its_start() -> None:
    async with cell() as world:
        await world.ask("init")
        results: list[GoalOutcome] = []

        async def follow(place: float, after: int) -> None:
            given = goal(P([place, 0.0], time_from_start=2.0), start=wall() + after * 1_000_000_000)
            results.append((await world.arm.follow(given)).outcome)

        world.nursery.start_soon(follow, 0.2, 1)
        await trio.sleep(0.1)
        world.nursery.start_soon(follow, 0.1, 4)
        await trio.sleep(8.0)
        assert results == [GoalOutcome.SUCCEEDED] * 2
        assert world.bridge.sample().positions[0] == pytest.approx(0.1, abs=EXACT)


async def two_goals(world: Cell, second: TrajectoryGoal) -> list[GoalResult]:
    """Give a goal, and another one while the joints move; return the results in the order of their ends."""
    results: list[GoalResult] = []

    async def follow(each: TrajectoryGoal) -> None:
        results.append(await world.arm.follow(each))

    async with trio.open_nursery() as nursery:
        nursery.start_soon(follow, goal(P([0.5, -0.3], time_from_start=3.0)))
        await trio.sleep(1.5)
        assert world.is_moving
        nursery.start_soon(follow, second)
    return results


@pytest.mark.thorough(2)
@pytest.mark.parametrize("how", ["cancel", "scope"])
@virtual_time
async def test_a_cancelled_goal_brakes_on_its_path(how: str) -> None:
    async with cell() as world:
        await world.ask("init")
        await world.ask("home")
        asked = goal(P([0.5, -0.25], time_from_start=3.0))
        results: list[GoalResult] = []
        scope = trio.CancelScope()

        async def follow() -> None:
            with scope:
                results.append(await world.arm.follow(asked))

        world.nursery.start_soon(follow)
        await trio.sleep(1.5)
        if how == "cancel":
            world.arm.cancel(asked)
        else:
            scope.cancel()
        await trio.sleep(2.0)
        assert [result.outcome for result in results] == ([GoalOutcome.PREEMPTED] if how == "cancel" else [])
        first, second = world.positions
        assert second == pytest.approx(-first / 2, abs=3)  # on the path, on which both move at one rate
        await world.assert_all_stand()


@virtual_time
async def test_a_joint_that_leaves_its_tolerance_ends_the_goal() -> None:
    async with cell(sync_interval=10) as world:
        await world.ask("init")
        await world.ask("home")
        tight = goal(P([0.5, -0.3], time_from_start=2.0), path_tolerance=[Tolerance("joint2", 1e-5)])
        result = await world.arm.follow(tight)
        assert (result.code, result.outcome) == (GoalCode.PATH_TOLERANCE_VIOLATED, GoalOutcome.ABORTED)
        assert re.match(r"joint2 is off by \S+ in position, 1e-05 are allowed, at \d\.\d+ s: the joints brake", result.text)
        await world.assert_all_stand()


@virtual_time
async def test_the_tolerance_of_the_goal_is_waited_for() -> None:
    async with cell() as world:
        await world.ask("init")
        await world.ask("home")
        exact = goal(P([0.3, 0.1], time_from_start=1.5), goal_tolerance=[Tolerance("joint1", 1e-9)], goal_time_tolerance=0.3)
        result = await world.arm.follow(exact)
        assert (result.code, result.outcome) == (GoalCode.GOAL_TOLERANCE_VIOLATED, GoalOutcome.ABORTED)
        assert "joint1 is off by" in result.text
        assert "0.3 s behind the end" in result.text


@virtual_time
async def test_a_start_in_the_future_is_waited_for_and_a_halt_drops_it() -> None:
    async with cell() as world:
        await world.ask("init")
        begun: list[float] = []
        later = goal(P([0.3, 0.1], time_from_start=1.5), start=wall() + 2_000_000_000)
        now = trio.current_time()
        assert (await world.arm.follow(later, None, lambda: begun.append(trio.current_time()))).outcome is GoalOutcome.SUCCEEDED
        assert begun[0] == pytest.approx(now + 2.0, abs=0.5)
        results: list[GoalResult] = []

        async def follow() -> None:
            results.append(await world.arm.follow(goal(P([0.0, 0.0], time_from_start=1), start=wall() + 2_000_000_000)))

        world.nursery.start_soon(follow)
        await trio.sleep(0.5)
        await world.ask("halt")
        await world.ask("recover")
        await trio.sleep(3.0)
        assert [each.outcome for each in results] == [GoalOutcome.PREEMPTED]
        assert not world.is_moving


@virtual_time
async def test_a_start_in_the_past_leaves_out_what_is_over() -> None:
    async with cell() as world:
        await world.ask("init")
        late = goal(P([0.01, 0.0], time_from_start=1), P([0.3, 0.1], time_from_start=4.0), start=wall() - 2_000_000_000)
        now = trio.current_time()
        assert (await world.arm.follow(late)).outcome is GoalOutcome.SUCCEEDED
        assert 2.0 <= trio.current_time() - now < 2.9


@virtual_time
async def test_a_trajectory_that_ends_just_now_is_over_and_is_no_empty_one() -> None:
    """Its joints never went along it, so it has not succeeded; and it stops nothing."""
    async with cell() as world:
        await world.ask("init")
        over = goal(P([0.5, 0.5], time_from_start=1.0), start=wall() - 1_000_000_000)
        result = await world.arm.follow(over)
        assert (result.code, result.outcome) == (GoalCode.OLD_HEADER_TIMESTAMP, GoalOutcome.REJECTED)


@pytest.mark.thorough(2)
@pytest.mark.parametrize(("service", "code"), [("halt", -4), ("shutdown", -4), ("home", -4), ("init", -4)])
@virtual_time
async def test_a_service_ends_a_goal(service: str, code: int) -> None:
    async with cell() as world:
        await world.ask("init")
        results: list[GoalResult] = []

        async def follow() -> None:
            results.append(await world.arm.follow(goal(P([0.5, -0.3], time_from_start=3.0))))

        world.nursery.start_soon(follow)
        await trio.sleep(1.5)
        await world.ask(service)
        await trio.sleep(0.1)
        assert [(each.outcome, each.code) for each in results] == [(GoalOutcome.ABORTED, code)]
        assert "CO403" in results[0].text


@virtual_time
async def test_a_fault_ends_a_goal_and_the_next_one_is_refused() -> None:
    async with cell() as world:
        await world.ask("init")
        results: list[GoalResult] = []

        async def follow() -> None:
            results.append(await world.arm.follow(goal(P([0.5, -0.3], time_from_start=3.0))))

        world.nursery.start_soon(follow)
        await trio.sleep(1.5)
        world.break_down(4)
        await trio.sleep(1.0)
        assert (results[0].outcome, results[0].code) == (GoalOutcome.ABORTED, GoalCode.PATH_TOLERANCE_VIOLATED)
        assert "joint2" in results[0].text
        refused = await world.arm.follow(SIMPLE)
        assert refused.outcome is GoalOutcome.REJECTED
        assert refused.text.startswith("CO402")
        assert "arm/recover" in refused.text
        await world.assert_all_stand()
