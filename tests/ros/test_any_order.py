"""Services, topics, goals, faults and silence in any order: a halt always holds, and silence always ends in rest."""

from __future__ import annotations

import logging

import trio
from hypothesis import given
from hypothesis import strategies as st

from canopen_ros.goals import TrajectoryGoal, TrajectoryPoint
from canopen_ros.reply import Reply
from tests.examples import examples
from tests.master.world import virtual_time
from tests.ros.ros_world import Cell, cell

ENDS_A_HALT = ("init", "home", "recover", "IPmode")
GOALS = [
    TrajectoryGoal(["joint1", "joint2"], [TrajectoryPoint([0.4, -0.3], time_from_start=2.0)]),
    TrajectoryGoal(["joint2"], [TrajectoryPoint([0.3], time_from_start=1.5)]),
    TrajectoryGoal(["joint1", "joint2"], [TrajectoryPoint([9.0, 0.0], time_from_start=0.1)]),
    TrajectoryGoal([], []),
]

SERVICES = st.sampled_from(["init", "home", "recover", "halt", "shutdown", "IPmode"])
STEPS = st.one_of(
    st.tuples(st.just("call"), SERVICES),  # and wait for the reply
    st.tuples(st.just("begin"), SERVICES),  # and go on at once
    st.tuples(st.just("follow"), st.integers(0, len(GOALS) - 1)),
    st.tuples(st.just("cancel"), st.integers(0, len(GOALS) - 1)),
    st.tuples(st.just("jog"), st.sampled_from([-0.3, 0.0, 0.2])),
    st.tuples(st.just("aim"), st.sampled_from([-0.2, 0.0, 0.3])),
    st.tuples(st.just("fault"), st.sampled_from([3, 4])),
    st.tuples(st.just("sleep"), st.sampled_from([0.0, 0.02, 0.1, 0.5, 1.5])),
)


@examples(30)
@given(steps=st.lists(STEPS, min_size=4, max_size=14))
def test_a_halt_holds_and_silence_ends_in_rest(steps: list[tuple[str, object]]) -> None:
    logging.disable(logging.WARNING)
    try:
        run(steps)
    finally:
        logging.disable(logging.NOTSET)


@virtual_time
async def run(steps: list[tuple[str, object]]) -> None:
    async with cell(sync_interval=40) as world:
        if steps[0][0] != "call":
            await world.ask("init")
        for number, step in enumerate(steps):
            await take(world, *step)
            later = [what for kind, what in steps[:number] if kind == "begin"]
            if step == ("call", "halt") and not any(what in ENDS_A_HALT for what in later):
                before = world.positions
                world.arm.command_velocities([0.3, 0.3])
                world.arm.command_positions(["joint1"], [0.5])
                await trio.sleep(0.6)
                assert world.positions == before, "it moved behind a halt"
        await trio.sleep(20.0)  # homing and paths are over by then
        await world.assert_all_stand()
        halted = await world.arm.call("halt")
        assert halted.success, halted.message
        assert world.arm.state in ("halted", "off", "fault")
        ready = await world.arm.call("init")
        assert ready.success, ready.message
        world.leave()
        await world.over.wait()
        await world.assert_all_stand()


async def take(world: Cell, kind: str, what: object) -> None:
    arm = world.arm
    match kind, what:
        case "call", str(service):
            assert isinstance(await arm.call(service), Reply)
        case "begin", str(service):
            world.nursery.start_soon(arm.call, service)
        case "follow", int(number):
            world.nursery.start_soon(arm.follow, GOALS[number])
        case "cancel", int(number):
            arm.cancel(GOALS[number])
        case "jog", float(velocity):
            arm.command_velocities([velocity, -velocity])
        case "aim", float(position):
            arm.command_positions(["joint2"], [position])
        case "fault", int(node_id):
            world.break_down(node_id)
        case "sleep", float(seconds):
            await trio.sleep(seconds)
