"""`canopen` 2.4.1 over python-can's SocketCAN, our side over our own: two stacks, two sockets, one kernel between them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import canopen
import pytest
import trio

from canopen_master import (
    BusChanged,
    FramesNotSent,
    SdoRefusedError,
    SdoTimeoutError,
    open_master,
    powerballs,
    simulate,
    standard_drives,
)
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, Variable
from canopen_proto.heartbeat import HeartbeatReceived, NodeBooted
from canopen_proto.nmt import NmtState
from canopen_proto.sync import SyncSent
from canopen_transports import BusState, open_transport
from tests.interop.peer import peer_dictionary
from tests.interop.test_our_master import DOMAIN, WIDE, described
from tests.transports.support import trio_test
from tests.vcan.support import interface, ip, needs_vcan
from tests.vcan.test_master import reads_again

pytestmark = needs_vcan
NODE = 5
LIMIT = 20.0
"""Seconds for an answer, for a computer that is busy with other things."""


@contextmanager
def peer(name: str) -> Iterator[canopen.Network]:
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.01
    network.connect(interface="socketcan", channel=name)
    try:
        yield network
    finally:
        for node in network.nodes.values():
            if isinstance(node, canopen.LocalNode):
                node.nmt.stop_heartbeat()
        network.sync.stop()
        network.disconnect()


@trio_test(real_time=True)
async def test_our_master_reads_and_writes_their_node() -> None:
    dictionary = described()
    with peer("vcan0") as network:
        device = network.create_node(NODE, peer_dictionary(dictionary, NODE))
        ours = dictionary.with_objects([Object.of("absent", [Variable(0x2FFF, 0, "absent", DataType.UNSIGNED8, Access.RW)])])
        async with open_master("socketcan:vcan0", dictionary=ours, sdo_timeout=LIMIT) as master:
            node = master.node(NODE)
            for value in (0, 1, 2**63):
                await node.write(WIDE, value)
                assert await node.read(WIDE) == value
            data = bytes(range(256)) * 8
            await node.write(DOMAIN, data)
            assert device.sdo[DOMAIN].raw == data
            assert await node.read(DOMAIN) == data
            with pytest.raises(SdoRefusedError):
                await node.read(0x2FFF)
            with master.events(NodeBooted, HeartbeatReceived) as events:
                device.nmt.state = "PRE-OPERATIONAL"
                device.nmt.start_heartbeat(20)
                report = await events.receive()
                while not isinstance(report, HeartbeatReceived):
                    report = await events.receive()
                assert report.state in (NmtState.PRE_OPERATIONAL, NmtState.INITIALISING)


@trio_test(real_time=True)
async def test_their_master_reads_writes_and_starts_our_drive() -> None:
    async with trio.open_nursery() as nursery:
        host = await nursery.start(simulate, await open_transport("socketcan:vcan0"), standard_drives(NODE))
        (drive,) = host.nodes
        with peer("vcan0") as network:
            remote = network.add_node(canopen.RemoteNode(NODE, peer_dictionary(drive.dictionary, NODE)))
            remote.sdo.RESPONSE_TIMEOUT = LIMIT

            def use_it() -> None:
                assert remote.sdo.upload(0x1008, 0) == drive.values.raw(0x1008)
                remote.sdo.download(0x6083, 0, (12345).to_bytes(4, "little"))
                assert int.from_bytes(remote.sdo.upload(0x6083, 0), "little") == 12345
                with pytest.raises(canopen.SdoAbortedError):
                    remote.sdo.upload(0x2FFF, 0)
                remote.sdo.download(0x1017, 0, (20).to_bytes(2, "little"))
                remote.nmt.state = "OPERATIONAL"
                while remote.nmt.wait_for_heartbeat(timeout=LIMIT) != "OPERATIONAL":
                    pass  # a heartbeat that was under way

            await trio.to_thread.run_sync(use_it)
            assert drive.state is NmtState.OPERATIONAL
        nursery.cancel_scope.cancel()


@trio_test(real_time=True)
async def test_kernel_filters_let_through_what_the_master_needs() -> None:
    dictionary = described()
    with peer("vcan0") as network:
        network.create_node(NODE, peer_dictionary(dictionary, NODE))
        async with open_master("socketcan:vcan0?filter=ids", dictionary=dictionary, sdo_timeout=LIMIT) as master:
            node = master.node(NODE)
            await node.write(WIDE, 77)
            assert await node.read(WIDE) == 77
            network.send_message(0x701, b"\x05")  # a node that nobody here asks for
            assert await node.read(WIDE) == 77
            assert 1 not in master.bus().network.heard_nodes()
        async with open_master("socketcan:vcan0?filter=ids", dictionary=dictionary, sdo_timeout=0.1) as master:
            with pytest.raises(SdoTimeoutError, match="frames are filtered: other nodes may be there"):
                await master.node(9).read(0x1000)


@trio_test(real_time=True)
async def test_an_interface_down_amid_a_transfer_and_up_again() -> None:
    with interface() as name:
        async with trio.open_nursery() as nursery:
            await nursery.start(simulate, await open_transport(f"socketcan:{name}"), powerballs(NODE))
            async with open_master(f"socketcan:{name}", sdo_timeout=3.0) as master:
                node = master.node(NODE)
                count = 0
                with master.events(BusChanged, FramesNotSent) as events:

                    async def transfer() -> None:
                        nonlocal count
                        with pytest.raises(SdoTimeoutError):
                            while True:
                                await node.read("manufacturer_device_name")
                                count += 1

                    async with trio.open_nursery() as transfers:
                        transfers.start_soon(transfer)
                        while count < 5:
                            await trio.sleep(0.01)
                        await trio.to_thread.run_sync(ip, "link", "set", name, "down")
                        report = await events.receive()
                        while isinstance(report, FramesNotSent):
                            report = await events.receive()
                        assert (report.state, report.reason) == (BusState.DOWN, f"{name} is DOWN")
                    await trio.to_thread.run_sync(ip, "link", "set", name, "up")
                    while not (isinstance(report, BusChanged) and report.state is BusState.UP):
                        report = await events.receive()
                    await reads_again(master)
            nursery.cancel_scope.cancel()


@trio_test(real_time=True)
async def test_sync_of_the_kernel_reaches_them_and_is_reported_here() -> None:
    with peer("vcan0") as network:
        heard: list[bytes] = []
        network.subscribe(0x80, lambda _id, data, _time: heard.append(bytes(data)))
        async with open_master("socketcan:vcan0?sync=bcm") as master:
            with master.events(SyncSent) as events:
                master.sync_start(0.01)
                for _ in range(20):
                    await events.receive()
                master.sync_stop()
            while len(heard) < 20:  # their thread takes its time
                await trio.sleep(0.01)
            assert set(heard) == {b""}
