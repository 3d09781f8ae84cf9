"""What all doors share: limits, values by subscription, and what a client leaves behind."""

from __future__ import annotations

import pytest
import trio

from canopen_gateway import GatewayFullError, Limits, NotAllowedError, PdoTakenError, WatchedObject
from canopen_master import SdoError
from canopen_proto import LocalProtocolError, NmtCommand
from canopen_proto.machine import MILLISECOND
from canopen_proto.simulation.drive.answers import Answer
from tests.gateway.gateway_world import gateway
from tests.master.world import arm_of, drives, virtual_time


@virtual_time
async def test_clients_requests_and_ports_are_bounded() -> None:
    async with gateway(3, limits=Limits(sessions=2, requests=1, ports=1, subscriptions=2)) as (_, service):
        (net,) = service.nets
        with service.open_session("one") as one, service.open_session("two") as two:
            with pytest.raises(GatewayFullError, match="no room for more clients"), service.open_session("three"):
                pass
            async with trio.open_nursery() as nursery:
                nursery.start_soon(silent_read, one, net)
                await trio.sleep(0.001)
                with pytest.raises(GatewayFullError, match="requests at a time"):
                    await two.read(net, 3, 0x1000, 0)
            assert len(await two.read(net, 3, 0x1000, 0)) == 4
            one.set_pdo(net, 1, 0x3A5, (8,), listens=True)
            with pytest.raises(GatewayFullError, match="PDOs of one client"):
                one.set_pdo(net, 2, 0x3A6, (8,), listens=True)
            one.set_pdo(net, 1, 0x3A6, (16,), listens=True)  # in place of the one before
            with pytest.raises(PdoTakenError):
                two.set_pdo(net, 1, 0x3A5, (8,), listens=True)
            places = [WatchedObject(net, 3, 0x1000)] * 2
            async with one.watch_values(places, 1):
                with pytest.raises(GatewayFullError, match="watched objects"):
                    one.watch_values(places[:1], 1)
            async with one.watch_values(places, 1):
                pass
        assert service.sessions == ()
        with service.open_session("four") as four:
            four.set_pdo(net, 1, 0x3A5, (8,), listens=True)  # it went with its client


async def silent_read(session: object, net: str) -> None:
    with pytest.raises(SdoError):
        await session.read(net, 99, 0x1000, 0)  # type: ignore[attr-defined]


@virtual_time
async def test_values_come_again_and_again_and_one_that_cannot_be_read_says_why() -> None:
    async with gateway(3, allow="write") as (_, service):
        (net,) = service.nets
        with service.open_session("one") as session:
            places = [WatchedObject(net, 3, 0x1017), WatchedObject(net, 3, 0x2FFF), WatchedObject(net, 3, 0x1008)]
            async with session.watch_values(places, 0.1) as values:
                first = [await anext(values) for _ in places]
                assert [each.value for each in first] == [0, None, "Simulated Schunk Powerball joint"]
                assert "0x06020000" not in first[0].problem
                assert first[1].problem.startswith("CO202: node 3 refused reading")
                began = trio.current_time()
                await session.write(net, 3, 0x1017, 0, b"\xc8\0")
                again = await anext(values)
                assert (again.value, again.place) == (200, places[0])
                assert trio.current_time() - began == pytest.approx(0.1, abs=0.01)
                await trio.sleep(10.03)  # a slow reader gets no burst
                await anext(values)
                await anext(values)
                began = trio.current_time()
                await anext(values)
                assert trio.current_time() - began > 0.05


@virtual_time
async def test_a_value_that_a_pdo_brings_needs_no_request() -> None:
    heard: list[str] = []
    async with gateway(3, 4, heard=heard) as (_, service):
        arm = arm_of(service.master, 3, 4)
        await arm.initialise()
        await arm.follow()
        with service.open_session("one") as session:
            async with session.watch_values([WatchedObject(service.nets[0], 3, 0x6064)], 0.1) as values:
                heard.clear()
                for _ in range(5):
                    assert (await anext(values)).value == arm.devices[0].axis.position_counts
                assert [frame for frame in heard if frame.startswith("603#406460")] == []


@virtual_time
async def test_a_client_that_leaves_takes_what_it_had_set_up_with_it() -> None:
    async with gateway(3, allow="nmt") as (_, service):
        (net,) = service.nets
        network = service.master.bus().network
        keys = set(network.can_ids())
        with service.open_session("one") as session:
            session.hear_boot_ups(net, True)
            session.watch_heartbeat(net, 3, 10**9)
            session.set_pdo(net, 1, 0x3A5, (8,), listens=True)
            assert set(network.can_ids()) > keys
        assert set(network.can_ids()) == keys
        for _ in range(1000):
            with service.open_session("many") as session:
                session.hear_boot_ups(net, True)
        assert set(network.can_ids()) == keys


@virtual_time
async def test_a_time_out_of_a_client_never_counts_for_a_node_that_a_chain_moves() -> None:
    async with gateway(3, 4) as (host, service):
        drives(host)[0].answer(0x1018, 4, Answer(delay=20 * MILLISECOND))
        arm = arm_of(service.master, 3, 4)
        with service.open_session("quick") as session:
            await arm.initialise()
            assert len(await session.read(service.nets[0], 3, 0x1018, 4, timeout=0.001)) == 4
            await arm.shut_down()
            with pytest.raises(SdoError):
                await session.read(service.nets[0], 3, 0x1018, 4, timeout=0.001)


@virtual_time
async def test_nothing_is_sent_that_is_not_allowed() -> None:
    heard: list[str] = []
    async with gateway(3, heard=heard) as (_, service):
        (net,) = service.nets
        heard.clear()
        with service.open_session("one") as session:
            for refused in (
                lambda: session.write(net, 3, 0x6040, 0, b"\x06\0"),
                lambda: session.nmt(net, NmtCommand.START),
                lambda: session.send_pdo(net, 1, (1,)),
            ):
                with pytest.raises(NotAllowedError):
                    await refused()
            with pytest.raises(NotAllowedError):
                session.guard_node(net, 3, 0.1, 3)
            with pytest.raises(NotAllowedError):
                session.set_pdo(net, 1, 0x205, (8,), listens=False)
            with pytest.raises(NotAllowedError):
                service.set_own_heartbeat(net, 100)
        assert heard == []


@virtual_time
async def test_a_node_id_that_is_none() -> None:
    async with gateway() as (_, service):
        with service.open_session("one") as session, pytest.raises(LocalProtocolError):
            await session.read(service.nets[0], 200, 0x1000, 0)
