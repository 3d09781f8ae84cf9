"""A cell: joints with a cable and a power switch each, and a chain of them that is homed and follows."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial

import pytest

from canopen_master import (
    Chain,
    ChainFaultError,
    ChainState,
    Host,
    Master,
    open_master,
    simulate,
)
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives.axis.axis import MILLIDEGREES_PER_RADIAN, AxisSettings
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings
from canopen_transports.loop import Nursery, TaskStatus
from tests.master.loops import loop
from tests.master.world import Link, arm_of, drives, position_of

TENTH = 100 * MILLISECOND
STO = DriveBit(objects.DIGITAL_INPUTS, 31)
SETTINGS = AxisSettings(
    counts_per_unit=MILLIDEGREES_PER_RADIAN,
    homing_method=35,
    state_timeout=5 * TENTH,
    reaction_time=TENTH,
    halt_time=TENTH,
    sto_input=STO,
)
DRIVE = DriveSettings()
CYCLES = 12
RADIANS_PER_CYCLE = 0.002
WATCHDOG = 0.5
"""Seconds until a drive misses the heartbeat of its master."""


class Joint:
    """A drive with a cable and a power switch of its own."""

    def __init__(self, nursery: Nursery, make: partial[DriveNode], node_id: int) -> None:
        self._nursery = nursery
        self._make = partial(make, node_id=node_id)
        self._power = loop.cancel_scope()
        self.node_id = node_id
        self.cable = Link()
        self.host: Host

    async def switch_on(self, *, is_plugged: bool = True) -> None:
        """It boots, and knows nothing of before."""
        self.cable, self._power = Link(), loop.cancel_scope()
        if not is_plugged:
            self.pull_cable()

        async def live(task_status: TaskStatus[Host]) -> None:
            with self._power:
                await simulate(self.cable, [self._make], task_status=task_status)

        self.host = await self._nursery.start(live)

    async def switch_off(self) -> None:
        self._power.cancel()
        await loop.sleep(0.001)

    def pull_cable(self) -> None:
        self.cable.copies = lambda frame, is_sent: 0

    def plug_cable(self) -> None:
        self.cable.copies = lambda frame, is_sent: 1

    def press_emergency_stop(self) -> None:
        self.node.set_safe_torque_off(True, self.host.now())
        self.host.pump()

    def release_emergency_stop(self) -> None:
        self.node.set_safe_torque_off(False, self.host.now())
        self.host.pump()

    @property
    def node(self) -> DriveNode:
        return drives(self.host)[0]

    @property
    def state(self) -> State:
        self.node.drive.refresh(self.host.now())
        return self.node.drive.state

    async def stands(self) -> bool:
        before = position_of(self.host, self.node)
        await loop.sleep(0.2)
        return position_of(self.host, self.node) == before


@asynccontextmanager
async def joints(
    *node_ids: int, drive: DriveSettings = DRIVE, dictionary: ObjectDictionary | None = None
) -> AsyncIterator[list[Joint]]:
    async with loop.open_nursery() as nursery:
        make = partial(DriveNode, settings=drive, dictionary=dictionary)
        made = [Joint(nursery, make, node_id) for node_id in node_ids]
        for joint in made:
            await joint.switch_on()
        yield made
        nursery.cancel_scope.cancel()


def chain_of(master: Master, *node_ids: int) -> Chain:
    return arm_of(master, *node_ids, axes=SETTINGS, define_pdos=True, cycle_time=0.04)


@asynccontextmanager
async def homed_arm(
    *node_ids: int, cable: Link | None = None, drive: DriveSettings = DRIVE, dictionary: ObjectDictionary | None = None
) -> AsyncIterator[tuple[list[Joint], Chain]]:
    """A chain that is homed and follows set-points. dictionary: of each joint, by which the chain chooses mode and PDOs."""
    line = cable or Link()
    async with joints(*node_ids, drive=drive, dictionary=dictionary) as made, open_master(line, heartbeat_timeout=0.3) as master:
        if dictionary is None:
            arm = chain_of(master, *node_ids)
        else:
            for node_id in node_ids:
                master.node(node_id, dictionary)
            arm = arm_of(master, *node_ids, axes=SETTINGS, mode=None, cycle_time=0.04)
        await arm.initialise()
        await arm.home()
        await arm.follow()
        yield made, arm


async def move(arm: Chain, cycles: int = CYCLES, do: Callable[[], object] = lambda: None) -> None:
    """Move along; after four cycles, do something."""
    start = arm.positions
    async for cycle in arm.cycles():
        arm.set_positions([position + RADIANS_PER_CYCLE * cycle.number for position in start])
        if cycle.number == 4:
            do()
        if cycle.number >= cycles:
            break


async def assert_moves(arm: Chain) -> None:
    """It follows, all joints, without a jump."""
    assert arm.state is ChainState.FOLLOWING
    before = arm.positions
    await move(arm)
    await loop.sleep(0.2)
    assert arm.positions == pytest.approx([position + CYCLES * RADIANS_PER_CYCLE for position in before], abs=1e-3)


async def assert_moves_back(arm: Chain) -> None:
    """It follows the other way."""
    start = arm.positions
    async for cycle in arm.cycles():
        arm.set_positions([position - RADIANS_PER_CYCLE * cycle.number for position in start])
        if cycle.number >= CYCLES:
            break
    await loop.sleep(0.2)
    assert arm.positions[0] == pytest.approx(start[0] - CYCLES * RADIANS_PER_CYCLE, abs=1e-3)


async def fails(arm: Chain, do: Callable[[], object]) -> ChainFaultError:
    with pytest.raises(ChainFaultError) as caught:
        await move(arm, 1000, do)
    return caught.value
