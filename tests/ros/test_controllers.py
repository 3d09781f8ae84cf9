"""Models of ros2_control's controllers and of MoveIt drive a bridge: see ros2_control.py for what they are written after."""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st

from canopen_ros.goals import START, GoalOutcome, GoalResult, TrajectoryGoal
from canopen_ros.names import MODE_SERVICES
from tests.examples import examples
from tests.master.world import virtual_time
from tests.ros.ros2_control import (
    PLUG_INS,
    Controllers,
    ForwardCommandController,
    JointTrajectoryController,
    MoveIt,
    TopicSystem,
)
from tests.ros.ros_world import Cell, cell

COUNTS = 180_000 / 3.141592653589793
"""Counts in a radian: a count is a millidegree."""
SETTLE = 0.8
"""Seconds until joints stand that brake."""


class Node:
    """An Executor: the action of the node itself, as in ROS 1."""

    def __init__(self, world: Cell) -> None:
        self.results: list[GoalResult] = []
        self._world = world
        self._goal: TrajectoryGoal | None = None

    async def execute(self, goal: TrajectoryGoal) -> GoalOutcome:
        self._goal = goal
        self.results.append(await self._world.arm.follow(goal, accepted=self.accepted))
        return self.results[-1].outcome

    def accepted(self) -> None:
        """The joints begin to follow the goal."""

    def cancel(self) -> None:
        if self._goal is not None:
            self._world.arm.cancel(self._goal)


class Robot:
    """A cell with ros2_control on its position topic, and its velocity topic; and MoveIt on each action."""

    def __init__(self, world: Cell, plug_in: str, rate: float, *, from_commands: bool) -> None:
        self.world = world
        self.system = TopicSystem(world, PLUG_INS[plug_in], self.command_positions, rate)
        self.trajectories = JointTrajectoryController(self.system, from_commands=from_commands)
        self.forward = ForwardCommandController(self.system)
        # JointState cannot carry velocities alone to the node, so something makes arrays of them; silence would end the motion
        self.wheels = TopicSystem(world, PLUG_INS[plug_in], self.command_velocities, rate, of_velocities=True, threshold=-1.0)
        self.stick = ForwardCommandController(self.wheels)
        self.node = Node(world)
        self.sent: list[Sequence[float]] = []  # on the topic of positions
        self.moveit = MoveIt(world, Controllers(self.trajectories))
        self.moveit_at_node = MoveIt(world, self.node)

    def command_positions(self, names: Sequence[str], positions: Sequence[float]) -> None:
        self.sent.append(positions)
        self.world.arm.command_positions(names, positions)

    def command_velocities(self, names: Sequence[str], velocities: Sequence[float]) -> None:
        self.world.arm.command_velocities(velocities)

    @property
    def positions(self) -> list[float]:
        """In rad, as the drives have them."""
        return [count / COUNTS for count in self.world.positions]

    async def reports(self) -> list[str]:
        """What was told since the last call."""
        found: list[str] = []
        with trio.move_on_after(0.001):
            async for report in self.world.bridge.reports():
                found.append(report.text)  # noqa: PERF401 - the loop does not end
        return found


@asynccontextmanager
async def robot(plug_in: str = "NaN", *, from_commands: bool = False) -> AsyncIterator[Robot]:
    """A robot that is homed, whose joints are at 0.3 and -0.2 rad. Nothing runs yet."""
    async with cell() as world:
        for service in ("init", "home"):
            await world.ask(service)
        found = Robot(world, plug_in, 50.0, from_commands=from_commands)
        assert await found.moveit_at_node.execute(found.moveit_at_node.plan((0.3, -0.2), 3.0)) == "SUCCEEDED"
        yield found


@pytest.mark.thorough(5)
@pytest.mark.parametrize("plug_in", PLUG_INS)
@virtual_time
async def test_no_plug_in_moves_the_arm_before_a_controller_is_active(plug_in: str) -> None:
    """The zeros that one sends, or NaN, are no place to go to."""
    async with robot(plug_in) as here:
        here.world.nursery.start_soon(here.system.run)
        await here.world.assert_all_stand()
        told = await here.reports()
        expected = {"zeros": "they begin 0.3 away from joint1", "NaN": "the value of joint1 is no finite number"}
        said = expected.get(plug_in, "they begin 0.3 away from joint1")  # it copies before the first state came
        assert [said in text for text in told] == [True], told
        here.system.switch(here.trajectories)
        await here.world.assert_all_stand()
        assert await here.moveit.execute(here.moveit.plan((-0.1, 0.2), 2.0)) == "SUCCEEDED"
        await trio.sleep(1.0)
        assert here.positions == pytest.approx([0.2, 0.0], abs=1e-3)
        assert not await here.reports()


@virtual_time
async def test_a_controller_that_holds_its_last_commands_is_told_of_once_and_moves_nothing() -> None:
    """As joint_trajectory_controller does by default behind zeros of the plug-in. The next goal begins at the joints."""
    async with robot("zeros", from_commands=True) as here:
        here.world.nursery.start_soon(here.system.run)
        here.system.switch(here.trajectories)
        await here.world.assert_all_stand()
        await trio.sleep(10.0)
        (told,) = await here.reports()
        assert "joint_commands over: they begin 0.3 away from joint1" in told
        assert await here.moveit.execute(here.moveit.plan((0.1, 0.1), 2.0)) == "SUCCEEDED"
        await trio.sleep(1.0)
        assert here.positions == pytest.approx([0.4, -0.1], abs=1e-3)


@pytest.mark.thorough(2)
@pytest.mark.parametrize("from_commands", [False, True])
@virtual_time
async def test_behind_a_halt_and_recover_nothing_moves_until_a_controller_begins_at_the_joints(from_commands: bool) -> None:
    """The trajectory runs on to its end, and to success, while the arm stands halted; then the controller holds its last point.
    Activated again, it holds the states, or by default its last point. A goal begins at the states in any case.
    """
    async with robot(from_commands=from_commands) as here:
        here.world.nursery.start_soon(here.system.run)
        here.system.switch(here.trajectories)
        outcomes: list[str] = []

        async def move() -> None:
            outcomes.append(await here.moveit.execute(here.moveit.plan((0.4, 0.0), 3.0)))

        here.world.nursery.start_soon(move)
        await trio.sleep(1.5)
        await here.world.ask("halt")
        stopped = here.positions
        assert 0.35 < stopped[0] < 0.65
        await trio.sleep(3.0)
        assert outcomes == ["SUCCEEDED"]  # it has no `constraints`
        await here.reports()
        await here.world.ask("recover")
        await here.world.assert_all_stand()
        await trio.sleep(10.0)
        (told,) = await here.reports()
        assert f"they begin {0.7 - stopped[0]:.3g} away from joint1" in told
        here.system.switch(None)  # the plug-in sends on what was commanded last
        await here.world.assert_all_stand()
        here.system.switch(here.trajectories)
        await trio.sleep(0.1)
        here.sent.clear()
        await here.world.assert_all_stand()
        assert here.positions == stopped
        assert bool(here.sent) == from_commands  # it is silent where commands are states
        assert not await here.reports()
        assert await here.moveit.execute(here.moveit.plan((0.1, 0.1), 2.0)) == "SUCCEEDED"
        await trio.sleep(1.0)
        assert here.positions == pytest.approx([each + 0.1 for each in stopped], abs=1e-3)
        assert not await here.reports()


@virtual_time
async def test_a_velocity_controller_is_taken_once_it_is_neutral() -> None:
    async with robot("NaN") as here:
        here.world.nursery.start_soon(here.wheels.run)
        here.wheels.switch(here.stick)
        here.stick.take([0.1, -0.1])
        await here.world.assert_all_stand()
        here.stick.take([0.0, 0.0])
        await trio.sleep(0.1)
        here.stick.take([0.1, -0.1])
        await trio.sleep(1.0)
        assert here.world.is_moving
        await here.world.ask("halt")
        await here.reports()
        await here.world.ask("recover")
        await here.world.assert_all_stand()
        await trio.sleep(10.0)
        (told,) = await here.reports()
        assert "command_vel over: they have to be 0 once" in told
        here.wheels.switch(None)  # it writes zeros
        await trio.sleep(0.1)
        here.wheels.switch(here.stick)
        here.stick.take([-0.1, 0.1])
        await trio.sleep(1.0)
        assert here.world.is_moving
        here.wheels.switch(None)
        await trio.sleep(SETTLE)
        await here.world.assert_all_stand()


@virtual_time
async def test_velocities_alone_in_a_joint_state_are_refused() -> None:
    """As JointStateTopicSystem sends them, if velocity is the only command interface."""
    async with robot() as here:
        here.world.arm.command_positions(here.world.arm.joints, (), (0.1, 0.1))
        await here.world.assert_all_stand()
        (told,) = await here.reports()
        assert "0 values were given for 2 joints" in told


@virtual_time
async def test_a_plan_of_before_is_refused_by_moveit_or_by_the_node() -> None:
    """MoveIt can be told to check nothing: `allowed_start_tolerance` 0."""
    async with robot() as here:
        plan = here.moveit_at_node.plan((0.2, 0.2), 2.0)
        assert await here.moveit_at_node.execute(here.moveit_at_node.plan((-0.1, 0.0), 2.0)) == "SUCCEEDED"
        assert await here.moveit_at_node.execute(plan) == "INVALID"
        before = here.positions
        assert await MoveIt(here.world, here.node, tolerance=0.0).execute(plan) == "REJECTED"
        assert "0.1 away, 0.01 are allowed. Try: a trajectory from where the joints are" in here.node.results[-1].text
        await here.world.assert_all_stand()
        assert here.positions == before


@pytest.mark.thorough(2)
@pytest.mark.parametrize("at", ["controllers", "node"])
@virtual_time
async def test_moveit_cancels_and_plans_again_from_where_the_joints_are(at: str) -> None:
    async with robot() as here:
        here.world.nursery.start_soon(here.system.run)
        here.system.switch(here.trajectories if at == "controllers" else None)
        moveit = here.moveit if at == "controllers" else here.moveit_at_node
        outcomes: list[str] = []

        async def move() -> None:
            outcomes.append(await moveit.execute(moveit.plan((0.3, 0.3), 3.0)))

        here.world.nursery.start_soon(move)
        await trio.sleep(1.2)
        moveit.stop()
        await trio.sleep(SETTLE)
        assert outcomes == ["PREEMPTED"]
        await here.world.assert_all_stand()
        before = here.positions
        assert 0.3 < before[0] < 0.55
        assert await moveit.execute(moveit.plan((-0.1, -0.1), 2.0)) == "SUCCEEDED"
        await trio.sleep(1.0)
        assert here.positions == pytest.approx([each - 0.1 for each in before], abs=1e-3)


# ---- any order ----

SERVICES = ("init", "home", "recover", "halt", "shutdown", "IPmode", *MODE_SERVICES)
STEPS = st.one_of(
    st.tuples(st.just("call"), st.sampled_from(SERVICES)),
    st.tuples(st.just("switch"), st.sampled_from(["trajectories", "forward", "none"])),
    st.tuples(st.just("wheels"), st.booleans()),
    st.tuples(st.just("forward"), st.sampled_from([-0.8, 0.0, 0.8])),
    st.tuples(st.just("stick"), st.sampled_from([-0.2, 0.0, 0.2])),
    st.tuples(st.just("plan"), st.sampled_from([-0.2, 0.2])),  # and send it to the controller
    st.tuples(st.just("plan at node"), st.sampled_from([-0.2, 0.2])),
    st.tuples(st.just("stop"), st.none()),
    st.tuples(st.just("fault"), st.sampled_from([3, 4])),
    st.tuples(st.just("sleep"), st.sampled_from([0.0, 0.1, 1.0, 3.0])),
)


class Watched(Robot):
    """A robot whose joints have to stand until a source has begun where they are: by what is sent, and where the drives are.

    faults: each time that they did not. homes: services and goals under way that move them.
    """

    def __init__(self, world: Cell, plug_in: str, *, from_commands: bool) -> None:
        super().__init__(world, plug_in, 25.0, from_commands=from_commands)
        self.faults: list[str] = []
        self.last = "the beginning"
        self._may_move: set[str] = set()
        self.homes = 0
        self._stands: list[float] | None = None
        self._moved_at = trio.current_time()
        self.node.accepted = self.interrupt  # type: ignore[method-assign]

    def interrupt(self) -> None:
        """From now on each source has to begin where the joints are."""
        self._may_move.clear()
        self._moved_at = trio.current_time()

    def command_positions(self, names: Sequence[str], positions: Sequence[float]) -> None:
        slack = 0.05 if self.world.is_moving else 1e-4  # the bridge has the positions of the last SYNC
        if all(abs(position - here) <= START + slack for position, here in zip(positions, self.positions, strict=True)):
            self._may_move.add("positions")
        super().command_positions(names, positions)

    def command_velocities(self, names: Sequence[str], velocities: Sequence[float]) -> None:
        if not any(velocities):
            self._may_move.add("velocities")
        super().command_velocities(names, velocities)

    async def call(self, service: str) -> None:
        changes_nothing = service in ("IPmode", *MODE_SERVICES) and self.world.arm.state in ("following", "moving")
        if not changes_nothing:
            self.interrupt()
        self.homes += service == "home"
        await self.world.arm.call(service)
        self.homes -= service == "home"
        if service == "home":
            self.interrupt()

    async def plan_at_node(self, by: float) -> None:
        self.homes += 1  # a goal moves the joints, too
        await self.moveit_at_node.execute(self.moveit_at_node.plan((by, -by), 2.0))
        self.homes -= 1

    async def watch(self) -> None:
        while True:
            if self.homes or self._may_move:
                self._moved_at, self._stands = trio.current_time(), None
            elif trio.current_time() - self._moved_at > SETTLE:
                self._stands = self._stands or self.positions
                off = max(abs(now - then) for now, then in zip(self.positions, self._stands, strict=True))
                if off > 1e-3:
                    self.faults.append(f"moved by {off:.3g} rad, behind {self.last}")
                    self._stands = None
            await trio.sleep(0.1)


@examples(40)
@given(plug_in=st.sampled_from(list(PLUG_INS)), from_commands=st.booleans(), steps=st.lists(STEPS, min_size=3, max_size=10))
def test_controllers_services_and_goals_in_any_order_move_nothing_to_what_was_right_before(
    plug_in: str, from_commands: bool, steps: list[tuple[str, object]]
) -> None:
    """At the end a controller that begins where the joints are is taken without more ado."""
    logging.disable(logging.WARNING)
    try:
        run(plug_in, from_commands, steps)
    finally:
        logging.disable(logging.NOTSET)


@virtual_time
async def run(plug_in: str, from_commands: bool, steps: list[tuple[str, object]]) -> None:
    async with cell(sync_interval=40) as world:
        here = Watched(world, plug_in, from_commands=from_commands)
        for task in (here.system.run, here.wheels.run, here.watch):
            world.nursery.start_soon(task)
        if steps[0][0] != "call":
            await here.call("init")
        for step in steps:
            here.last = f"{step}"
            await take(here, *step)
            await trio.sleep(0.2)
        await end(here)
        assert not here.faults, here.faults


async def take(here: Watched, kind: str, what: object) -> None:
    nursery = here.world.nursery
    match kind, what:
        case "call", str(service):
            await here.call(service)
            await trio.sleep(SETTLE + 0.4)
        case "switch", str(name):
            here.system.switch({"trajectories": here.trajectories, "forward": here.forward}.get(name))
        case "wheels", bool(is_on):
            here.wheels.switch(here.stick if is_on else None)
        case "forward", float(position):
            here.forward.take([position, -position])
        case "stick", float(velocity):
            here.stick.take([velocity, -velocity])
        case "plan", float(by) if here.trajectories.is_active:
            nursery.start_soon(here.moveit.execute, here.moveit.plan((by, -by), 2.0))
        case "plan at node", float(by):
            nursery.start_soon(here.plan_at_node, by)
        case "stop", None:
            here.moveit.stop()
            here.moveit_at_node.stop()
        case "fault", int(node_id):
            here.world.break_down(node_id)
        case "sleep", float(seconds):
            await trio.sleep(seconds)


async def end(here: Watched) -> None:
    """Deactivate all, make the arm ready, and activate a controller that begins at the states: it is taken, and moves the arm."""
    here.wheels.switch(None)
    here.system.switch(None)
    here.moveit_at_node.stop()
    while here.homes:
        await trio.sleep(0.5)
    await trio.sleep(SETTLE)
    here.last = "the end"
    reply = await here.world.arm.call("halt")
    await here.call("init")
    controller = JointTrajectoryController(here.system, from_commands=False)
    here.system.switch(controller)
    await trio.sleep(2.0)
    before = here.positions
    way = -0.1 if before[0] > 0 else 0.1
    moveit = MoveIt(here.world, Controllers(controller))
    assert await moveit.execute(moveit.plan((way, 0.0), 2.0)) == "SUCCEEDED", reply
    await trio.sleep(1.0)
    assert here.positions == pytest.approx([before[0] + way, before[1]], abs=2e-3)
