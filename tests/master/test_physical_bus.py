"""A master and six simulated drives on a virtual bus with the physics of copper, with and without faults."""

from __future__ import annotations

from canopen_master import open_master
from canopen_master.simulation.host import powerballs, simulate
from canopen_proto.heartbeat import HeartbeatLost
from canopen_transports import open_transport
from canopen_transports.virtual_wire import WireTransport
from canopen_transports.wire import FaultKind
from tests.master.loops import loop
from tests.transports.support import trio_test


async def _opened(locator: str) -> WireTransport:
    transport = await open_transport(locator)
    assert isinstance(transport, WireTransport)
    return transport


@trio_test()
async def test_who_opens_a_bus_may_ask_at_once() -> None:
    """The boot-ups, which nobody was there to acknowledge, are over when the bus is open: no drive seems to have been reset."""
    for count, locator in ((1, "virtual:one?bitrate=1M"), (6, "virtual:six?bitrate=50k"), (3, "virtual:three?ack=false")):
        drives = await _opened(locator)
        async with loop.open_nursery() as nursery:
            await nursery.start(simulate, drives, powerballs(*range(1, count + 1)))
            async with open_master(locator) as master:
                for number in range(1, count + 1):
                    assert await master.node(number).read("position_actual_value") == 3000
            nursery.cancel_scope.cancel()


@trio_test()
async def test_values_are_read_over_a_disturbed_bus() -> None:
    """Frames that are corrupted are sent again by the controllers: nobody above them notices."""
    locator = "virtual:arm?bitrate=1M&corrupt=0.002&seed=3"
    drives = await _opened(locator)
    async with loop.open_nursery() as nursery:
        await nursery.start(simulate, drives, powerballs(*range(1, 7)))
        async with open_master(locator) as master:
            for number in range(1, 7):
                node = master.node(number)
                position = await node.read("position_actual_value")
                for _ in range(50):
                    assert await node.read("position_actual_value") == position
        nursery.cancel_scope.cancel()
    assert drives.bus.counts[FaultKind.CORRUPTION] > 0
    assert set(drives.bus.counts) == {FaultKind.CORRUPTION}


@trio_test()
async def test_a_cut_cable_is_a_lost_heartbeat() -> None:
    drives = await _opened("virtual:arm?bitrate=500k")
    async with loop.open_nursery() as nursery:
        await nursery.start(simulate, drives, powerballs(1, 2))
        async with open_master("virtual:arm", heartbeat_timeout=0.3) as master:
            for number in (1, 2):
                await master.node(number).write("0x1017", 100)
            await loop.sleep(1)
            async with master.events(HeartbeatLost) as lost:
                drives.bus.cut([drives])
                async for event in lost:
                    assert event.node_id in (1, 2)
                    break
            drives.bus.mend()
        nursery.cancel_scope.cancel()
