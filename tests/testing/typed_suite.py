"""What a user of mypy writes: the fixtures with their types. test_fixtures.py runs it, and mypy looks at it (test_front.py)."""

from __future__ import annotations

import asyncio

import pytest
import trio

from canopen_master import Master
from canopen_proto import MILLISECOND, SECOND, LocalNode
from canopen_proto.testing import Delay, Lose, World, WorldBus, WorldMaster, heartbeat, nmt, sdo_answer, sdo_write
from canopen_testing import ProgramWorld, RunCase, SimDrive, SimNode


@pytest.fixture
def canopen_device(sim_node: SimNode) -> LocalNode:
    return sim_node("sample_io.eds", node_id=5)


def test_a_case(canopen_check: RunCase) -> None:
    assert not canopen_check().failures


@pytest.mark.canopen_faults(Lose(heartbeat(5), nth=1), seed=3)
def test_plain(canopen_world: ProgramWorld, canopen_bus: WorldBus, sim_node: SimNode, canopen_master: WorldMaster) -> None:
    node: LocalNode = sim_node("sample_io.eds", node_id=5)
    canopen_master.write(5, "producer_heartbeat_time", 100)
    canopen_world.advance(SECOND)
    seen = canopen_bus.saw(sdo_write(5, "producer_heartbeat_time", 100)).within(MILLISECOND).then(heartbeat(5))
    assert seen.time < SECOND
    assert node.values.store
    canopen_bus.observer.clean()


async def test_trio(canopen_bus: WorldBus, sim_drive: SimDrive, canopen_master: Master) -> None:
    drive = sim_drive(3)
    await canopen_master.node(3).start()
    await trio.sleep(0.001)
    canopen_bus.saw(nmt("start", 3)).times(1)
    assert drive.drive.state.name == "SWITCH_ON_DISABLED"


@pytest.mark.asyncio
async def test_asyncio(sim_drive: SimDrive, canopen_master: Master) -> None:
    sim_drive(3)
    await asyncio.sleep(10)
    assert await canopen_master.node(3).read("device_type")


def test_the_core_alone() -> None:
    world = World(seed=3, faults=[Delay(sdo_answer(5), by=100 * MILLISECOND, chance=0.5)])
    world.drive(5)
    value = world.master().read(5, "device_type")
    assert isinstance(value, int)
