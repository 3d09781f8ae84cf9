"""A set-point of `direct` that waits in the drive for a SYNC undoes nothing: no halt, no brake, and not the master's way out.

tests/core/test_held_rpdos.py has the property for each command; here it is what a script can do.
"""

from __future__ import annotations

import random

import pytest
import trio

from canopen_master import open_master
from canopen_master.direct.drive import COUNTS, DirectDrive
from canopen_proto.drives.cia402.objects import CONTROLWORD
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import Frame
from canopen_proto.nmt import NmtCommand
from canopen_transports import VirtualTransport
from tests.master.world import BUS, drives, position_of, simulated, value, virtual_time

pytestmark = pytest.mark.trio_only("`direct` has a trio loop of its own")

ENDS = {
    "halt": (State.OPERATION_ENABLED, 0x11F),
    "brake": (State.READY_TO_SWITCH_ON, 0x06),
    "shut down": (State.SWITCH_ON_DISABLED, 0x00),
    "by hand": (State.READY_TO_SWITCH_ON, 0x06),
    "leave": (State.OPERATION_ENABLED, 0x11F),
    "does not follow": (State.OPERATION_ENABLED, 0x11F),
}


@pytest.mark.thorough(4)
@pytest.mark.parametrize("way", ENDS)
@virtual_time
async def test_a_sync_that_comes_late_undoes_nothing(way: str) -> None:
    chosen = random.Random(way)
    for moment in (None, 0.0, *(chosen.uniform(0, 0.02) for _ in range(3))):
        await run(way, moment, is_ours=chosen.random() < 0.5)


async def run(way: str, moment: float | None, is_ours: bool) -> None:
    """moment: seconds from the command to a SYNC, of the script's other thread or of somebody else; None: there is none."""
    stranger = VirtualTransport("test")
    async with simulated(12) as host, trio.open_nursery() as nursery:
        (node,) = drives(host)

        async def assert_commanded() -> None:
            await trio.sleep(0.5)
            stood = position_of(host, node)
            for _ in range(3):
                assert (node.drive.state, value(node, CONTROLWORD), position_of(host, node)) == (*ENDS[way], stood)
                await stranger.send(Frame(0x080))
                await trio.sleep(0.1)

        async with open_master(BUS) as master:
            device = master.device(master.node(12), settings=COUNTS)
            drive = DirectDrive(master, device, "schunk_default_rPDO", "schunk_default_tPDO")
            await master.nmt(NmtCommand.START)
            await drive.change_state(State.OPERATION_ENABLED)
            await drive.follow()
            start = drive.axis.set_points.counts
            for step in range(3):
                await drive.send_position(start + 100 * step)
                await master.send_sync()
                await trio.sleep(0.01)
            await drive.send_position(start + 400)

            async def sync() -> None:
                if moment is not None:
                    await trio.sleep(moment)
                    await (master.send_sync() if is_ours and way != "leave" else stranger.send(Frame(0x080)))

            nursery.start_soon(sync)
            match way:
                case "halt":
                    await drive.halt()
                case "brake":
                    await drive.change_state(State.READY_TO_SWITCH_ON)
                case "shut down":
                    await drive.shut_down()
                case "by hand":
                    await drive.node.write("controlword", "sm_shutdown")
                case "does not follow":
                    device.following.lose("is lost, as this test says")
                    master.pump.pump()
            if way != "leave":
                await assert_commanded()
        await assert_commanded()
    await stranger.aclose()
