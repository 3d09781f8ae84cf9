"""A source of motion is taken only from where the joints are: no service moves the arm to what somebody goes on sending."""

from __future__ import annotations

import logging
from collections.abc import Callable

import pytest
import trio
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_ros.goals import START, GoalOutcome, TrajectoryGoal, TrajectoryPoint
from canopen_ros.names import MODE_SERVICES
from canopen_ros.take_over import PAUSE
from tests.examples import examples
from tests.master.world import virtual_time
from tests.ros.ros_world import Cell, cell, wall

COUNTS = 180_000 / 3.141592653589793
"""Counts in a radian: a count is a millidegree."""
HARMLESS = round(START * COUNTS) + 5
"""Counts that a source may move a joint as it is taken over."""
PERIOD = 0.04


class Streamer:
    """A program that sends on and on: always the same, unless it is told. Joints of a chain of two."""

    def __init__(self, world: Cell, positions: tuple[float, float]) -> None:
        self.world = world
        self.positions = positions
        self.is_on = False

    async def run(self) -> None:
        while True:
            if self.is_on:
                self.send()
            await trio.sleep(PERIOD)

    def send(self) -> None:
        raise NotImplementedError

    async def take(self) -> None:
        """Do what lets a source be taken over, and then go on as before."""
        raise NotImplementedError


class Controller(Streamer):
    """As ros2_control's joint_trajectory_controller over the topic interface: it holds its last command."""

    def send(self) -> None:
        self.world.arm.command_positions(["joint2", "joint1"], self.positions[::-1])

    async def take(self) -> None:
        self.is_on = False
        self.world.hold()
        self.is_on = True


class Joystick(Streamer):
    """A stick that is held."""

    def send(self) -> None:
        self.world.arm.command_velocities(self.positions)

    async def take(self) -> None:
        self.is_on = False
        self.world.let_go()
        self.is_on = True


class Servo(Streamer):
    """As MoveIt Servo: a short trajectory to each set-point."""

    def send(self) -> None:
        point = TrajectoryPoint(self.positions, time_from_start=4.0)
        self.world.nursery.start_soon(self.world.arm.command_trajectory, TrajectoryGoal(["joint1", "joint2"], [point]))

    async def take(self) -> None:
        self.is_on = False
        await trio.sleep(PAUSE + 2 * PERIOD)
        self.is_on = True
        await trio.sleep(2 * PERIOD)  # the first one is on its way: it is taken also behind a service that comes before it


SOURCES = (Controller, Joystick, Servo)
PLACES = ((0.9, -0.9), (-0.1, 0.0), (-0.9, 0.9))
"""What each source sends; of the joystick rad/s."""
SERVICES = ("init", "home", "recover", "halt", "shutdown", "IPmode", *MODE_SERVICES)
STEPS = st.one_of(
    st.tuples(st.just("call"), st.sampled_from(SERVICES)),
    st.tuples(st.just("switch"), st.integers(0, 2)),  # a source on or off
    st.tuples(st.just("take"), st.integers(0, 2)),
    st.tuples(st.just("goal"), st.sampled_from([-0.05, 0.05])),  # of an action: so far from where joint1 is
    st.tuples(st.just("fault"), st.sampled_from([3, 4])),
    st.tuples(st.just("sleep"), st.sampled_from([0.0, 0.05, 0.7])),
)
DRIVES: dict[str, dict[str, object]] = {
    "Schunk's, in ip": {},
    "a file's, whose drives choose": {"eds": "sample_drive.eds", "defaults": {"unit": "degree", "counts_per_turn": 360_000.0}},
}


def is_near(world: Cell, before: list[int]) -> bool:
    return all(abs(now - then) <= HARMLESS for now, then in zip(world.positions, before, strict=True))


@examples(25)
@example("Schunk's, in ip", 0, [("call", "position_mode"), ("call", "init")], set())  # a mode that these drives do not have
@example("a file's, whose drives choose", 2, [("call", "cyclic_position_mode"), ("call", "init")], set())
@example("Schunk's, in ip", 0, [("switch", 2), ("call", "IPmode")], set())
@given(
    drives=st.sampled_from(list(DRIVES)),
    first=st.integers(0, 2),
    steps=st.lists(STEPS, min_size=2, max_size=8),
    on=st.sets(st.integers(0, 2)),
)
def test_no_service_moves_the_arm_to_what_somebody_goes_on_sending(
    drives: str, first: int, steps: list[tuple[str, object]], on: set[int]
) -> None:
    """Sources in any number send something far away; services, goals, faults and sources that are taken over come in any order.
    Behind each service, goal and fault the joints stand, until a source has been taken over since. One that was does move them.

    first: the source that moves the joints before that.
    """
    logging.disable(logging.WARNING)
    try:
        run(drives, first, steps, on)
    finally:
        logging.disable(logging.NOTSET)


@virtual_time
async def run(drives: str, first: int, steps: list[tuple[str, object]], on: set[int]) -> None:
    async with cell(sync_interval=40, **DRIVES[drives]) as world:
        sources = [kind(world, where) for kind, where in zip(SOURCES, PLACES, strict=True)]
        for number, source in enumerate(sources):
            source.is_on = number in on
            world.nursery.start_soon(source.run)
        await world.ask("init")
        sources[first].is_on = False
        await sources[first].take()
        is_taken = True  # whether a source may have been taken over since the last interruption
        for kind, what in steps:
            match kind, what:
                case "call", str(service):
                    followed = world.arm.state in ("following", "moving")
                    reply = await world.arm.call(service)
                    is_refused = not reply.success and any(why in reply.message for why in ("it is busy", "its mode is"))
                    changes_nothing = is_refused or (followed and service in ("IPmode", *MODE_SERVICES))
                    is_taken = is_taken and changes_nothing
                case "switch", int(number):
                    sources[number].is_on = not sources[number].is_on
                    if number == 2:  # behind a pause a trajectory is a new one
                        is_taken = True
                        await trio.sleep(2 * PERIOD)
                case "take", int(number):
                    for source in sources:
                        source.is_on = False
                    await trio.sleep(4.5)  # all stands
                    may_move = world.arm.state in ("ready", "following")
                    before = world.positions
                    await sources[number].take()
                    await trio.sleep(1.5)
                    if may_move and max(abs(now) for now in before) < 0.7 * COUNTS:
                        assert not is_near(world, before), "a source that was taken over moves nothing"
                    is_taken = True
                case "goal", float(way):
                    to = [position + way for position in world.bridge.sample().positions[:1]]
                    ends = await world.arm.follow(TrajectoryGoal(["joint1"], [TrajectoryPoint(to, time_from_start=2.0)]))
                    is_taken = is_taken and ends.outcome is not GoalOutcome.SUCCEEDED
                case "fault", int(node_id):
                    world.break_down(node_id)
                    await trio.sleep(0.1)
                    is_taken = False
                case "sleep", float(seconds):
                    await trio.sleep(seconds)
            if not is_taken:
                await trio.sleep(0.4)  # a ramp
                before = world.positions
                await trio.sleep(0.8)
                assert is_near(world, before), f"it moved by {kind} {what}"


@pytest.mark.thorough(5)
@pytest.mark.parametrize("service", ["init", "home", "recover"])
@virtual_time
async def test_a_controller_that_goes_on_sending_is_refused_once_with_its_distance(service: str) -> None:
    async with cell() as world:
        for each in ("init", "home"):
            await world.ask(each)
        controller = Controller(world, (0.3, -0.1))
        world.nursery.start_soon(controller.run)
        await world.ask("halt")
        controller.is_on = True
        await trio.sleep(0.5)
        await world.ask("init")
        await world.ask(service)
        await world.assert_all_stand()
        await trio.sleep(10.0)
        told = [text for text in await reports(world) if "not take" in text]
        if service == "recover":  # what was told behind init holds
            assert len(told) == 2
        assert "joint_commands over: they begin 0.3 away from joint1" in told[-1]
        assert "joint1 is at 0, and they begin at 0.3; 0.01 are allowed (start_tolerance)" in told[-1]
        await controller.take()
        await trio.sleep(4.0)
        assert world.bridge.sample().positions == pytest.approx((0.3, -0.1), abs=1e-4)


@virtual_time
async def test_a_zero_for_one_joint_alone_takes_no_velocities_over() -> None:
    async with cell() as world:
        await world.ask("init")
        joystick = Joystick(world, (0.0, 0.2))
        world.nursery.start_soon(joystick.run)
        joystick.is_on = True
        await world.assert_all_stand()


@virtual_time
async def test_a_refusal_behind_a_service_is_told_though_the_same_was_told_a_moment_ago() -> None:
    async with cell() as world:
        await world.ask("init")
        joystick = Joystick(world, (0.2, 0.2))
        world.nursery.start_soon(joystick.run)
        joystick.is_on = True
        for _ in range(3):
            await trio.sleep(0.5)
            assert [text for text in await reports(world) if "have to be 0 once" in text]
            joystick.is_on = False
            await world.ask("halt")
            await world.ask("recover")
            joystick.is_on = True


@virtual_time
async def test_a_controller_is_not_taken_over_where_homing_passes_it() -> None:
    async with cell(start_tolerance=0.05) as world:
        for each in ("init", "home"):
            await world.ask(each)
        world.hold()
        world.arm.command_positions(["joint1"], [0.3])
        await trio.sleep(3.0)
        controller = Controller(world, (0.15, 0.0))
        world.nursery.start_soon(controller.run)
        controller.is_on = True
        world.nursery.start_soon(world.arm.call, "home")
        await trio.sleep(15.0)
        assert world.bridge.sample().positions == pytest.approx((0.0, 0.0), abs=1e-4)


async def reports(world: Cell) -> list[str]:
    found: list[str] = []
    with trio.move_on_after(0.001):
        async for report in world.bridge.reports():
            found.append(report.text)  # noqa: PERF401 - the loop does not end
    return found


@virtual_time
async def test_the_tolerance_is_a_parameter_and_counts_for_the_place_of_rest() -> None:
    async with cell(start_tolerance=0.05) as world:
        for each in ("init", "home"):
            await world.ask(each)
        world.arm.command_positions(["joint1", "joint2"], [0.04, 0.051])
        await world.assert_all_stand()
        for _ in range(20):  # it would come to rest far away; one alone counts as silence before the chain follows
            world.arm.command_positions(["joint1"], [0.0], [0.9])
            await trio.sleep(PERIOD)
            assert not world.is_moving
        await world.assert_all_stand()
        assert len(await reports(world)) == 1  # the second one is the same source, and was told of already
        world.arm.command_positions(["joint1", "joint2"], [0.04, 0.049])
        await trio.sleep(2.0)
        assert world.bridge.sample().positions == pytest.approx((0.04, 0.049), abs=1e-4)


@virtual_time
async def test_a_joint_is_taken_over_by_the_first_message_that_names_it() -> None:
    async with cell() as world:
        for each in ("init", "home"):
            await world.ask(each)
        world.arm.command_positions(["joint1"], [0.0])
        world.arm.command_positions(["joint1"], [0.2])
        await trio.sleep(2.0)
        world.arm.command_positions(["joint2"], [0.2])
        await trio.sleep(2.0)
        assert world.bridge.sample().positions == pytest.approx((0.2, 0.0), abs=1e-4)


MOVES: dict[str, Callable[[Cell], object]] = {
    "a goal": lambda world: world.nursery.start_soon(
        world.arm.follow, TrajectoryGoal(["joint1"], [TrajectoryPoint([0.4], time_from_start=3.0)])
    ),
    "a joystick": lambda world: world.nursery.start_soon(world.keep_jogging),
}


@pytest.mark.parametrize("move", MOVES.values(), ids=MOVES)
@virtual_time
async def test_a_controller_does_not_move_the_arm_back_from_where_something_else_took_it(move: Callable[[Cell], object]) -> None:
    async with cell() as world:
        for each in ("init", "home"):
            await world.ask(each)
        controller = Controller(world, (0.0, 0.0))
        world.nursery.start_soon(controller.run)
        controller.is_on = True
        await trio.sleep(1.0)
        move(world)
        await trio.sleep(2.0)
        world.stop_feeding()
        await trio.sleep(2.0)
        assert world.bridge.sample().positions[0] > 0.1
        await world.assert_all_stand()


@virtual_time
async def test_a_trajectory_stamped_before_an_interruption_is_refused() -> None:
    async with cell() as world:
        await world.ask("init")
        before = world.positions
        stamped = TrajectoryGoal(["joint1"], [TrajectoryPoint([0.4], time_from_start=3.0)], start=wall() - 10**8)
        world.break_down(4)
        await trio.sleep(0.1)
        await world.ask("recover")
        await world.arm.command_trajectory(stamped)
        await trio.sleep(4.0)
        assert world.positions == before
        told = await reports(world)
        assert any("it is older than that" in text for text in told)


@virtual_time
async def test_velocities_are_not_taken_from_a_bus_that_was_silent() -> None:
    """SYNC stops while the chain is ready, and comes back: whoever held the stick through it has to let it go."""
    async with cell() as world:
        await world.ask("init")
        world.let_go()
        world.bridge.master.sync_stop()
        await trio.sleep(2.0)
        world.arm.command_velocities([0.2, 0.2])
        world.bridge.master.sync_start(0.02)
        await trio.sleep(0.2)
        joystick = Joystick(world, (0.2, 0.2))
        world.nursery.start_soon(joystick.run)
        joystick.is_on = True
        await world.assert_all_stand()
        await joystick.take()
        await trio.sleep(0.5)
        assert world.is_moving


@virtual_time
async def test_what_comes_while_a_mode_service_runs_is_refused_as_what_comes_behind_it() -> None:
    """Else a message that comes as the chain begins to follow set-points would move it."""
    async with cell() as world:
        await world.ask("init")

        async def send() -> None:
            await trio.sleep(0.001)
            assert world.arm.state == "ready"
            Controller(world, (0.9, -0.9)).send()

        world.nursery.start_soon(send)
        world.hold()
        await world.ask("IPmode")
        assert "they begin 0.952 away from joint2" in (await reports(world))[-1]
        await world.assert_all_stand()


@pytest.mark.parametrize("kind", SOURCES)
@virtual_time
async def test_an_empty_trajectory_stops_an_arm_that_somebody_goes_on_to_move(kind: type[Streamer]) -> None:
    """What is sent on and on undoes no stop: it has to be taken over again."""
    async with cell() as world:
        for each in ("init", "home"):
            await world.ask(each)
        source = kind(world, (0.1, -0.1) if kind is Joystick else (0.9, -0.9))
        world.nursery.start_soon(source.run)
        await source.take()
        await trio.sleep(1.0)
        assert world.is_moving
        with trio.fail_after(1.0):
            result = await world.arm.follow(TrajectoryGoal([], []))
        assert (result.outcome, result.text) == (GoalOutcome.SUCCEEDED, "the joints stand")
        await world.assert_all_stand()
        before = world.positions
        await source.take()
        await trio.sleep(1.0)
        assert not is_near(world, before)


@virtual_time
async def test_a_goal_that_comes_as_an_empty_trajectory_stops_the_joints_is_no_standstill() -> None:
    async with cell() as world:
        for each in ("init", "home"):
            await world.ask(each)
        results: list[GoalOutcome] = []

        async def follow(*points: TrajectoryPoint) -> None:
            results.append((await world.arm.follow(TrajectoryGoal(["joint1", "joint2"] if points else [], points))).outcome)

        world.nursery.start_soon(follow, TrajectoryPoint([0.5, -0.5], time_from_start=3.0))
        await trio.sleep(1.5)
        world.nursery.start_soon(follow)
        await trio.sleep(0.04)
        world.nursery.start_soon(follow, TrajectoryPoint([0.3, -0.3], time_from_start=4.0))
        await trio.sleep(0.5)
        assert world.is_moving
        assert results == [GoalOutcome.PREEMPTED] * 2
        await trio.sleep(5.0)
        assert results[2:] == [GoalOutcome.SUCCEEDED]


@virtual_time
async def test_a_joint_that_fails_as_an_empty_trajectory_stops_it_is_told() -> None:
    async with cell() as world:
        for each in ("init", "home"):
            await world.ask(each)
        world.nursery.start_soon(
            world.arm.follow, TrajectoryGoal(["joint1", "joint2"], [TrajectoryPoint([0.5, -0.5], time_from_start=3.0)])
        )
        await trio.sleep(1.5)

        async def fail() -> None:
            await trio.sleep(0.05)
            world.break_down(3)

        world.nursery.start_soon(fail)
        result = await world.arm.follow(TrajectoryGoal([], []))
        assert result.outcome is GoalOutcome.ABORTED
        assert "joint1" in result.text
