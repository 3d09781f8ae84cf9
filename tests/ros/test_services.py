"""Services: each of them in each state of the chain; what becomes of one that is interrupted, at every step of it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import pytest
import trio

from canopen_ros.goals import TrajectoryGoal, TrajectoryPoint
from tests.master.world import virtual_time
from tests.ros.ros_world import Cell, cell

FAR = TrajectoryGoal(["joint1", "joint2"], [TrajectoryPoint([0.8, -0.5], time_from_start=4.0)])
Begin = Callable[[Cell], Awaitable[None]]


async def off(world: Cell) -> None:
    return


async def ready(world: Cell) -> None:
    await world.ask("init")


async def following(world: Cell) -> None:
    await world.ask("init")
    await world.ask("IPmode")


async def moving(world: Cell) -> None:
    await world.ask("init")
    world.nursery.start_soon(world.arm.follow, FAR)
    await trio.sleep(1.0)
    assert world.is_moving


async def jogging(world: Cell) -> None:
    await world.ask("init")
    world.nursery.start_soon(world.keep_jogging)
    await trio.sleep(1.0)
    assert world.is_moving


async def streaming(world: Cell) -> None:
    await world.ask("init")
    world.hold()
    world.arm.command_positions(["joint1"], [0.8])
    await trio.sleep(0.8)
    assert world.is_moving


async def stopping(world: Cell) -> None:
    await moving(world)
    world.nursery.start_soon(world.arm.call, "halt")
    await trio.sleep(0.05)


async def halted(world: Cell) -> None:
    await world.ask("init")
    await world.ask("halt")


async def fault(world: Cell) -> None:
    await moving(world)
    world.break_down(4)
    await trio.sleep(0.5)


async def homing(world: Cell) -> None:
    await world.ask("init")
    world.nursery.start_soon(world.arm.call, "home")
    await trio.sleep(0.3)


async def initialising(world: Cell) -> None:
    world.nursery.start_soon(world.arm.call, "init")
    await trio.sleep(0.05)


STATES: dict[str, Begin] = {
    "off": off,
    "ready": ready,
    "following": following,
    "moving": moving,
    "jogging": jogging,
    "streaming": streaming,
    "stopping": stopping,
    "halted": halted,
    "fault": fault,
    "homing": homing,
    "initialising": initialising,
}
SHOWN = {"jogging": "moving", "streaming": "moving", "homing": "ready", "initialising": "off"}
"""The word for each, where it is another one."""

AFTER = {
    # what the chain is after each service, by the state before; a text: refused with it
    "init": dict.fromkeys(STATES, "ready") | {"homing": "CO404", "initialising": "CO404"},
    "home": dict.fromkeys(STATES, "ready") | {"off": "CO404", "fault": "CO402", "homing": "CO404", "initialising": "CO404"},
    "recover": {
        "off": "CO404", "ready": "ready", "following": "following", "moving": "following", "jogging": "following",
        "streaming": "following", "stopping": "following", "halted": "ready", "fault": "following", "homing": "CO404",
        "initialising": "CO404",
    },
    "halt": dict.fromkeys(STATES, "halted") | {"off": "off", "initialising": "off", "fault": "fault"},
    "shutdown": dict.fromkeys(STATES, "off"),
    "IPmode": dict.fromkeys(STATES, "following") | {
        "off": "CO404", "moving": "moving", "jogging": "moving", "streaming": "moving", "fault": "CO402", "homing": "CO404",
        "initialising": "CO404",
    },
}  # fmt: skip


@pytest.mark.thorough(8)
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("service", AFTER)
@virtual_time
async def test_each_service_in_each_state(service: str, state: str) -> None:
    async with cell() as world:
        await STATES[state](world)
        assert world.arm.state == SHOWN.get(state, state)
        reply = await world.arm.call(service)
        expected = AFTER[service][state]
        if expected.startswith("CO"):
            assert not reply.success
            assert reply.message.startswith(expected)
            assert "chain." not in reply.message  # it names services, not the calls of a program
        else:
            assert reply.success, reply.message
            assert world.arm.state == expected
        world.stop_feeding()
        if service in ("init", "home", "recover", "halt", "shutdown") and reply.success:
            await world.assert_all_stand()
