"""A master and its simulated devices in one process: a stall of it makes none of them take another for lost."""

from __future__ import annotations

import pytest

from canopen_master import open_master
from canopen_proto.machine import SECOND
from canopen_proto.nmt import NmtState
from tests.loops import loop
from tests.master.test_stalls import stall
from tests.master.world import BUS, arm_of, drives, simulated, virtual_time


@pytest.mark.thorough(5)
@pytest.mark.parametrize("late", [0.0, 0.001, 0.0049, 0.0051, 3.0])
@virtual_time
async def test_whenever_a_stall_ends_no_drive_takes_its_master_for_lost(late: float) -> None:
    """Drives watch for 0.5 s over a master that sends a heartbeat each 0.1 s, and the stall ends when that time is just over."""
    async with simulated(3, 4) as host, open_master(BUS) as master:
        await arm_of(master, 3, 4).initialise()
        network = host._pump.buses[0].network
        for _ in range(20):
            over = network.next_deadline()
            while network.next_deadline() == over:  # once it comes, the drives wait for what follows the last heartbeat
                await loop.sleep(0.001)
            stall((network.next_deadline() - host.now()) / SECOND + late)
            await loop.sleep(0.2)
            assert [node.state for node in drives(host)] == [NmtState.OPERATIONAL] * 2
