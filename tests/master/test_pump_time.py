"""The pump's timekeeper: what is already there counts before a timeout does."""

from __future__ import annotations

import trio
import trio.testing

from canopen_master import open_master
from canopen_proto.frame import Frame
from canopen_proto.heartbeat import HeartbeatLost
from canopen_transports import open_transport
from tests.master.world import BUS


def test_a_heartbeat_that_came_while_the_process_was_stalled_counts() -> None:
    clock = trio.testing.MockClock()  # time goes on only where we say so

    async def main() -> None:
        async with open_master(BUS) as master, await open_transport(BUS) as device:
            node = master.node(5)
            node.supervise_heartbeat(0.5)
            with master.events(HeartbeatLost) as lost:
                await device.send(Frame(0x705, b"\x05"))
                await trio.testing.wait_all_tasks_blocked()
                clock.jump(2.0)  # and meanwhile came:
                for _ in range(500):
                    await device.send(Frame(0x184, b"\x00\x00"))
                await device.send(Frame(0x705, b"\x05"))
                await trio.testing.wait_all_tasks_blocked()
                clock.jump(0.4)
                await trio.testing.wait_all_tasks_blocked()
                assert lost.take() == []
                clock.jump(0.2)
                assert (await lost.receive()).node_id == 5

    trio.run(main, clock=clock)
