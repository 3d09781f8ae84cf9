"""A chain begins where its joints stand: whatever they were doing, and whoever else commands the chain meanwhile."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import pytest

from canopen_master import Chain, ChainError, ChainHaltedError, Host, open_master, standard_drives
from canopen_proto.application import PlainMemory
from canopen_proto.drives.axis.axis import MILLIDEGREES_PER_RADIAN, AxisSettings
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from tests.loops import loop
from tests.master.world import BUS, arm_of, drives, simulated, virtual_time

RAMP = 40_000
"""Of the halt, in counts per second squared."""
SPEED = 25_000
SETTINGS = AxisSettings(MILLIDEGREES_PER_RADIAN, homing_method=35)


@asynccontextmanager
async def moving_arm() -> AsyncIterator[tuple[Host, Chain]]:
    """A standard drive that follows set-points at SPEED; the next set-point is due."""
    async with simulated(makers=standard_drives(3)) as host, open_master(BUS) as master:
        drives(host)[0].values.store[objects.PROFILE_DECELERATION] = RAMP
        arm = arm_of(master, 3, axes=SETTINGS, define_pdos=True)
        await arm.initialise()
        await arm.enable_interpolated_position()
        await move(arm, 50)
        yield host, arm


async def move(arm: Chain, cycles: int) -> None:
    (start,) = arm.positions
    step = 0
    async for cycle in arm.cycles():
        step += min(cycle.number, 25) * 10
        arm.set_positions([start + step / MILLIDEGREES_PER_RADIAN])
        if cycle.number == cycles:
            break


def velocity_of(host: Host) -> float:
    drive = drives(host)[0].drive
    drive.refresh(host.now())
    return drive._servo.demand_velocity


@asynccontextmanager
async def watched(host: Host) -> AsyncIterator[list[float]]:
    """The largest change of velocity in 2 ms, in counts per second, while the block runs and for 50 ms after it."""
    worst = [0.0]

    async def watch() -> None:
        before = velocity_of(host)
        while True:
            await loop.sleep(0.002)
            now = velocity_of(host)
            worst[0], before = max(worst[0], abs(now - before)), now

    async with loop.open_nursery() as nursery:
        nursery.start_soon(watch)
        yield worst
        await loop.sleep(0.05)
        nursery.cancel_scope.cancel()


COMMANDS: dict[str, Callable[[Chain], Awaitable[None]]] = {
    "enable_interpolated_position": lambda arm: arm.enable_interpolated_position(),
    "recover": lambda arm: arm.recover(),
    "initialise": lambda arm: arm.initialise(),
    "home": lambda arm: arm.home(),
}
A_COUNT = 110
"""On its way for one cycle; in counts per second."""


@pytest.mark.thorough(2)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_halts_the_joints_that_follow_and_begins_where_they_stand(command: str) -> None:
    @virtual_time
    async def test() -> None:
        async with moving_arm() as (host, arm):
            assert velocity_of(host) == pytest.approx(SPEED)
            async with watched(host) as worst:
                await COMMANDS[command](arm)
            assert worst[0] <= RAMP / 500 + A_COUNT
            assert velocity_of(host) == pytest.approx(0, abs=A_COUNT)

    test()


@pytest.mark.parametrize("command", ["enable_interpolated_position", "recover", "home"])
def test_a_command_waits_for_a_halt_that_somebody_else_has_ordered(command: str) -> None:
    @virtual_time
    async def test() -> None:
        async with moving_arm() as (host, arm):

            async def go_on() -> None:
                with pytest.raises(ChainHaltedError):
                    await move(arm, 50)
                await COMMANDS[command](arm)

            async with watched(host) as worst, loop.open_nursery() as nursery:
                nursery.start_soon(go_on)
                await arm.halt()
                assert velocity_of(host) == 0
            assert worst[0] <= RAMP / 500 + A_COUNT

    test()


LEFT_OVER = {
    Mode.PROFILE_VELOCITY: (objects.TARGET_VELOCITY, 30_000),
    Mode.CYCLIC_SYNCHRONOUS_POSITION: (objects.TARGET_POSITION, -50_000),
}
"""Mode -> what makes a drive move in it as soon as it has power."""


def write(host: Host, key: int, value: int) -> None:
    """Another tool writes an object of the drive."""
    (node,) = drives(host)
    node.values.store[key] = value
    node.drive.written(key >> 8, key & 0xFF, host.now())
    host.pump()


@pytest.mark.parametrize("runs", [False, True])
@pytest.mark.parametrize("mode", LEFT_OVER)
def test_a_chain_that_was_initialised_stands(mode: Mode, runs: bool) -> None:
    """Whatever mode and target another tool has left, and whether it left the drive running."""

    @virtual_time
    async def test() -> None:
        async with simulated(makers=standard_drives(3)) as host, open_master(BUS) as master:
            (node,) = drives(host)
            node.values.store[objects.PROFILE_DECELERATION] = RAMP
            master.sync_start(0.01)
            write(host, objects.MODES_OF_OPERATION, mode)
            write(host, *LEFT_OVER[mode])
            if runs:
                for word in (6, 7, 15):
                    write(host, objects.CONTROLWORD, word)
                await loop.sleep(0.3)
            arm = arm_of(master, 3, axes=SETTINGS, define_pdos=True)
            positions = node.drive._servo.demand_position
            await arm.initialise()
            assert node.drive.state is State.OPERATION_ENABLED
            stood = node.drive._servo.demand_position
            assert runs or stood == positions
            await loop.sleep(1)
            assert node.drive._servo.demand_position == stood
            await arm.enable_interpolated_position()

    test()


@virtual_time
async def test_a_drive_that_would_move_with_power_alone_is_not_enabled() -> None:
    async with simulated(makers=standard_drives(3)) as host, open_master(BUS) as master:
        (node,) = drives(host)
        node.values.store[objects.SUPPORTED_DRIVE_MODES] = 0x04  # pv
        write(host, objects.MODES_OF_OPERATION, Mode.PROFILE_VELOCITY)
        arm = arm_of(master, 3, axes=SETTINGS, define_pdos=True)
        with pytest.raises(ChainError, match=r"joint1.*in profile velocity \(pv\), in which power alone"):
            await arm.initialise()
        assert node.drive.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize("command", ["recover", "home"])
def test_no_command_begins_with_a_joint_that_still_moves(command: str) -> None:
    """It was told to halt, and does not obey."""

    @virtual_time
    async def test() -> None:
        async with simulated(makers=standard_drives(3)) as host, open_master(BUS) as master:
            arm = arm_of(master, 3, axes=SETTINGS, define_pdos=True)
            await arm.initialise()
            write(host, objects.MODES_OF_OPERATION, Mode.PROFILE_VELOCITY)
            write(host, objects.TARGET_VELOCITY, SPEED)
            await loop.sleep(1)
            (node,) = drives(host)
            node.application = PlainMemory()
            for do in (arm.halt, lambda: COMMANDS[command](arm)):
                with pytest.raises(ChainError, match=r"joint1.*standstill after a halt"):
                    await do()
                assert velocity_of(host) == SPEED
            node.application = node.drive

    test()
