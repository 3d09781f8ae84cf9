"""A master on a real kernel's bus: error frames, an adapter that is pulled and plugged in, SYNC by the kernel."""

from __future__ import annotations

import pytest
import trio

from canopen_master import BusChanged, FramesNotSent, Master, SdoTimeoutError, open_master, powerballs, simulate
from canopen_proto.sync import SyncSent
from canopen_transports import BusState, open_transport
from tests.transports.support import trio_test
from tests.vcan.support import interface, ip, needs_vcan, tool

pytestmark = needs_vcan
NODE = 5
NAME = "manufacturer_device_name"


async def reads_again(master: Master) -> None:
    """Wait until the device, which has its own view of the bus, answers."""
    while True:
        try:
            assert await master.node(NODE).read(NAME)
        except SdoTimeoutError:
            continue
        return


@trio_test(real_time=True)
async def test_error_frames_reach_the_user() -> None:
    with interface() as name:

        async def inject(text: str) -> None:
            await trio.run_process([tool("cansend"), name, text])

        async with trio.open_nursery() as nursery:
            await nursery.start(simulate, await open_transport(f"socketcan:{name}"), powerballs(NODE))
            async with open_master(f"socketcan:{name}", sdo_timeout=0.5) as master:
                await reads_again(master)
                with master.events(BusChanged) as changes, master.events(FramesNotSent) as dropped:
                    for text, state, reason in (
                        ("20000020#0000000000000000", BusState.NO_ACKNOWLEDGE, "no acknowledge"),
                        ("20000004#0020000000000000", BusState.PASSIVE, "controller is error-passive"),
                        ("20000040#0000000000000000", BusState.BUS_OFF, "controller is bus-off"),
                    ):
                        await inject(text)
                        report = await changes.receive()
                        assert (report.state, report.reason) == (state, reason)
                    with pytest.raises(SdoTimeoutError):
                        await master.node(NODE).read(NAME)
                    assert (await dropped.receive()).reason == "controller is bus-off"
                    await inject("20000100#0000000000000000")
                    assert (await changes.receive()).state is BusState.ACTIVE
                    await reads_again(master)
            nursery.cancel_scope.cancel()


@trio_test(real_time=True)
async def test_an_adapter_that_is_pulled_and_plugged_in_while_the_kernel_sends_sync() -> None:
    with interface() as name:
        async with trio.open_nursery() as nursery:
            await nursery.start(simulate, await open_transport(f"socketcan:{name}"), powerballs(NODE))
            async with open_master(f"socketcan:{name}?sync=bcm&filter=ids", sdo_timeout=0.5) as master:

                async def sync_runs() -> None:
                    with master.events(SyncSent) as syncs:
                        for _ in range(5):
                            await syncs.receive()

                master.sync_start(0.02)
                await sync_runs()
                await reads_again(master)
                with master.events(BusChanged) as changes:
                    ip("link", "del", name)
                    with pytest.raises(SdoTimeoutError):
                        await master.node(NODE).read(NAME)
                    assert (await changes.receive()).reason == f"{name} is gone"
                    ip("link", "add", "dev", name, "type", "vcan")
                    ip("link", "set", name, "up")
                    assert (await changes.receive()).state is BusState.UP
                await reads_again(master)
                await sync_runs()
            nursery.cancel_scope.cancel()
