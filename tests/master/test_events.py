"""Subscriptions, network management, SYNC, heartbeat supervision."""

from itertools import pairwise

import pytest

from canopen_master import BusError, MasterClosedError, NodeSilentError, Subscription, open_master, powerballs
from canopen_master.participant.subscription import HANDED_OVER, QUEUE_SIZE
from canopen_proto.emcy import EmcyReceived
from canopen_proto.frame import Frame
from canopen_proto.heartbeat import HeartbeatLost, HeartbeatReceived, NodeBooted
from canopen_proto.machine import Event, LocalProtocolError
from canopen_proto.nmt import NmtState
from canopen_proto.sync import SyncReceived, SyncSent
from canopen_transports import VirtualTransport, open_transport
from tests.loops import jump, loop, settled
from tests.master.world import BUS, Breakable, simulated, virtual_time


@virtual_time
async def test_events_are_there_from_the_call_on() -> None:
    async with simulated(3, 4) as host, open_master(BUS) as master:
        node = master.node(3)
        master.node(4)
        async with master.events(EmcyReceived, NodeBooted) as events, node.events(EmcyReceived) as of_one:
            for device in host.nodes:
                device.raise_error(0x3220, 0x04, b"\x01", host.now())
            host.pump()
            await node.reset()  # whatever came before is still there
            first, second = await events.receive(), await events.receive()
            assert isinstance(first, EmcyReceived)
            assert (first.node_id, first.code, second.node_id) == (3, 0x3220, 4)
            async for event in events:
                assert isinstance(event, NodeBooted)
                break
            assert [event.node_id for event in of_one.take()] == [3]
        assert len(master._subscriptions) == 0


@pytest.mark.parametrize("one_by_one", [False, True])
@virtual_time
async def test_a_slow_reader_loses_the_oldest_and_is_told_how_many(one_by_one: bool) -> None:
    async with open_master(BUS) as master:
        if one_by_one:
            master.watch((SyncSent,), lambda event: None)  # a call for each event: then no list is handed over
        with master.events(SyncSent) as events:
            master.sync_start(0.001)
            await loop.sleep((QUEUE_SIZE + 9) * 0.001 + 0.0005)
            assert events.dropped == 10
            assert len(events.take()) == QUEUE_SIZE


@virtual_time
async def test_a_subscription_that_was_closed_gets_nothing() -> None:
    async with open_master(BUS) as master:
        events = master.events(SyncSent)
        events.close()
        events.close()
        await master.send_sync()
        assert events.take() == []
        with pytest.raises(LocalProtocolError, match="Event means all"):
            master.events()


@virtual_time
async def test_waiting_for_events_can_be_cancelled() -> None:
    async with open_master(BUS) as master:
        with master.events(SyncSent) as events:
            with loop.move_on_after(1) as scope:
                await events.receive()
            assert scope.cancelled_caught
            await master.send_sync()
            assert await events.receive() == SyncSent(0, None, 0)


@virtual_time
async def test_each_of_two_tasks_that_share_a_subscription_gets_an_event() -> None:
    async with open_master(BUS) as master, VirtualTransport("test") as device, loop.open_nursery() as nursery:
        heard: list[int] = []

        async def listen() -> None:
            heard.append((await events.receive()).node_id)

        with master.events(HeartbeatReceived) as events:
            for node_id in (3, 4):
                master.node(node_id)
                nursery.start_soon(listen)
            await settled()
            for node_id in (3, 4):  # both before one of the tasks has run
                device.send_nowait(Frame(0x700 + node_id, b"\x05"))
            await settled()
            assert sorted(heard) == [3, 4]


@virtual_time
async def test_subscriptions_end_with_the_master() -> None:
    async with open_master(BUS) as master:
        events, other = master.events(SyncSent, bus=BUS), master.events(SyncSent)
        await master.send_sync()
    assert await events.receive() == SyncSent(0, None, 0)
    with pytest.raises(MasterClosedError):
        await events.receive()
    assert await other.receive_batch() == [SyncSent(0, None, 0)]
    with pytest.raises(MasterClosedError):
        await other.receive_batch()


@virtual_time
async def test_batches_have_all_that_came_in_order_and_a_cancelled_wait_takes_none() -> None:
    async with open_master(BUS) as master, VirtualTransport("test") as device, loop.open_nursery() as nursery:
        heard: list[list[int]] = []

        async def listen() -> None:
            async for batch in events.batches():
                heard.append([each.node_id for each in batch])
                if len(heard) == 3:
                    break

        def send(*node_ids: int) -> None:
            for node_id in node_ids:
                device.send_nowait(Frame(0x700 + node_id, b"\x05"))

        with master.events(HeartbeatReceived) as events:
            for node_id in range(1, 8):
                master.node(node_id)
            with loop.move_on_after(1) as scope:
                await events.receive_batch()
            assert scope.cancelled_caught
            send(1, 2)
            nursery.start_soon(listen)  # these two are there when it begins
            await settled()
            send(3, 4, 5)  # it waits for these
            await settled()
            send(6)
            await settled()
            send(7)
            await settled()
            assert heard == [[1, 2], [3, 4, 5], [6]]
            assert [each.node_id for each in events.take()] == [7]


@virtual_time
async def test_a_reader_that_always_finds_events_lets_others_run_and_can_be_cancelled() -> None:
    async with open_master(BUS) as master, VirtualTransport("test") as device:
        master.node(3)
        for is_batched in (False, True):
            heard = turns = 0

            async def count() -> None:
                nonlocal turns
                while True:
                    turns += 1
                    await loop.checkpoint()

            with master.events(HeartbeatReceived) as events:
                device.send_nowait(Frame(0x703, b"\x05"))
                async with loop.open_nursery() as nursery:
                    nursery.start_soon(count)
                    async for _ in events.batches() if is_batched else events:
                        heard += 1
                        device.send_nowait(Frame(0x703, b"\x05"))  # so that there is always one more
                        if heard == 1000:
                            nursery.cancel_scope.cancel()
            assert 1000 <= heard <= 1000 + HANDED_OVER
            assert turns >= 1000 // HANDED_OVER


@virtual_time
async def test_of_tasks_that_wait_one_that_is_cancelled_is_not_woken_and_the_others_are_in_order() -> None:
    lot, woken = loop.parking_lot(), list[int]()
    scopes = [loop.cancel_scope() for _ in range(4)]

    async def park(number: int) -> None:
        with scopes[number]:
            await lot.park()
            woken.append(number)

    assert not lot
    lot.unpark()
    lot.unpark_all()  # nobody is there
    async with loop.open_nursery() as nursery:
        for number in range(4):
            nursery.start_soon(park, number)
            await settled()
        scopes[0].cancel()
        await settled()
        lot.unpark()
        await settled()
        assert woken == [1]
        lot.unpark_all()
        await settled()
        assert sorted(woken) == [1, 2, 3]
        assert not lot


@virtual_time
async def test_subscriptions_end_with_the_bus() -> None:
    cable = Breakable()
    ended: list[BaseException] = []

    async def listen(events: Subscription[Event]) -> None:
        with loop.cancel_scope(shield=True):
            try:
                await events.receive()
            except BusError as error:
                ended.append(error)

    with pytest.raises(BusError) as caught:
        async with open_master(cable) as master, loop.open_nursery() as nursery:
            nursery.start_soon(listen, master.events(Event))
            await settled()
            cable.cut()
    assert ended == [caught.value]


# ---- network management ----


@virtual_time
async def test_nmt_commands_to_all_and_to_one() -> None:
    async with simulated(3, 4) as host, open_master(BUS) as master:
        first, second = master.node(3), master.node(4)

        def states() -> list[str]:
            assert [first.nmt_state, second.nmt_state] == [node.state for node in host.nodes]
            return [node.state.name for node in host.nodes]

        await master.nmt_start()
        await loop.sleep(0.001)
        assert states() == ["OPERATIONAL", "OPERATIONAL"]
        await master.nmt_stop(3)
        await loop.sleep(0.001)
        assert states() == ["STOPPED", "OPERATIONAL"]
        await master.nmt_enter_pre_operational(4, bus=BUS)
        await loop.sleep(0.001)
        assert states() == ["STOPPED", "PRE_OPERATIONAL"]
        with master.events(NodeBooted) as boots:
            await master.nmt_reset_node()
            await master.nmt_reset_communication(4)
            await loop.sleep(0.001)
            assert [boot.node_id for boot in boots.take()] == [3, 4, 4]
        await first.reset(communication_only=True)
        await loop.sleep(0.001)
        assert states() == ["PRE_OPERATIONAL", "PRE_OPERATIONAL"]


@virtual_time
async def test_whoever_has_sent_the_reset_is_never_told_that_a_boot_up_wants_one() -> None:
    slow = "it needs longer to start, or did not get the reset"
    async with open_master(BUS) as master:
        with pytest.raises(NodeSilentError, match="did not boot after a reset within 0.5 s") as caught:
            await master.node(9).reset(0.5)
        assert caught.value.cause.startswith("no other node is on it; or wrong bit rate, no power")
        assert caught.value.cause.endswith(f"; or {slow}")
        async with simulated(3):
            await master.node(3).read("statusword")
            with pytest.raises(NodeSilentError) as caught:
                await master.node(9).reset(0.5)
            assert caught.value.cause == f"no device has this node-ID, or its power is off; or {slow}"
            assert caught.value.tries[-1] == "a longer timeout"
        with pytest.raises(NodeSilentError) as caught:
            await master.node(3).reset(0.5)  # it was heard before
        assert caught.value.cause == slow


@virtual_time
async def test_waiting_for_a_boot_up_or_a_heartbeat() -> None:
    async with simulated(3), open_master(BUS) as master:
        node = master.node(3)
        with pytest.raises(NodeSilentError, match="node 3 did not boot within 2 s") as caught:
            await node.wait_for_boot(2)
        assert isinstance(caught.value, TimeoutError)
        assert caught.value.cause.startswith("it has no reason to: a boot-up wants a reset")
        with pytest.raises(NodeSilentError, match="sent no heartbeat within 1 s") as caught:
            await node.wait_for_heartbeat(1)
        assert caught.value.cause.startswith("it has no reason to: a heartbeat wants a time in 0x1017")
        async with loop.open_nursery() as nursery:
            nursery.start_soon(node.wait_for_boot)
            await settled()
            await master.nmt_reset_node()
        await node.write("producer_heartbeat_time", 200)
        assert await node.wait_for_heartbeat(1) is NmtState.PRE_OPERATIONAL
        with loop.move_on_after(0.05) as scope:
            await node.wait_for_heartbeat(1)
        assert scope.cancelled_caught


@virtual_time
async def test_a_lost_heartbeat_is_reported() -> None:
    async with simulated(3) as host, open_master(BUS, heartbeat_timeout=0.5) as master:
        node = master.node(3)
        await node.write("producer_heartbeat_time", 100)
        await node.wait_for_heartbeat(1)
        with node.events(HeartbeatLost) as lost:
            await loop.sleep(10)
            assert lost.take() == []
            host.nodes[0].communication.heartbeat.set_period(0, host.now())
            host.pump()
            stopped = loop.current_time()
            assert (await lost.receive()).timeout == 500_000_000
            assert 0.4 <= loop.current_time() - stopped <= 0.5


@virtual_time
async def test_heartbeats_of_one_node_can_be_supervised_later() -> None:
    async with simulated(3) as host, open_master(BUS) as master:
        node = master.node(3)
        await node.write("producer_heartbeat_time", 100)
        await node.wait_for_heartbeat(1)
        node.supervise_heartbeat(0.3)
        with node.events(HeartbeatLost) as lost:
            host.nodes[0].communication.heartbeat.set_period(0, host.now())
            await lost.receive()


@virtual_time
async def test_a_stalled_process_finds_the_heartbeats_that_came_meanwhile() -> None:
    """Frames that are there already are taken before a due timeout, however late both are."""
    peer = VirtualTransport("test")
    async with open_master(BUS) as master:
        node = master.node(3)
        node.supervise_heartbeat(0.1)
        with master.events(HeartbeatReceived, HeartbeatLost) as events:
            for _ in range(5):
                await peer.send(Frame(0x703, b"\x05"))
                await loop.sleep(0.09)
            # The process stalls: the clock goes on, and so does the node, but none of our tasks runs.
            for _ in range(20):
                for member in peer._line.members:
                    if member is not peer:
                        member._queue.put((Frame(0x703, b"\x05"), None))
                        member._queue.wake()
                jump(0.09)
            await loop.sleep(0.05)
            assert {type(event) for event in events.take()} == {HeartbeatReceived}
            assert isinstance(await events.receive(), HeartbeatLost)
    await peer.aclose()


# ---- SYNC ----


@virtual_time
async def test_sync_runs_by_the_clock_and_stops() -> None:
    async with open_master(BUS) as master, await open_transport(BUS) as spy:
        assert master.sync_period == 0
        master.sync_start(0.02)
        assert master.sync_period == 20_000_000
        stamps = []
        for _ in range(4):
            frame, stamp = await spy.receive()
            assert str(frame) == "080#"
            assert stamp is not None
            stamps.append(stamp)
        assert [later - earlier for earlier, later in pairwise(stamps)] == [20_000_000] * 3
        master.sync_stop()
        with loop.move_on_after(1) as scope:
            await spy.receive()
        assert scope.cancelled_caught
        await master.send_sync()
        assert str((await spy.receive())[0]) == "080#"


@virtual_time
async def test_a_foreign_sync_is_reported() -> None:
    async with open_master(BUS) as master, await open_transport(BUS) as other:
        with master.events(SyncReceived) as events:
            await other.send(Frame(0x80, b""))
            assert (await events.receive()).counter is None


@virtual_time
async def test_powerballs_are_made_by_node_id() -> None:
    async with simulated(makers=powerballs(5)) as host:
        assert [node.node_id for node in host.nodes] == [5]
