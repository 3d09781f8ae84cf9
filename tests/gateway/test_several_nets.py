"""A gateway of two buses: net 1 and net 2."""

from __future__ import annotations

import trio

from canopen_gateway import open_gateway, parse_permissions
from canopen_gateway.service import GatewaySession
from canopen_master import open_master
from canopen_proto import NmtState
from canopen_proto.drives.cia402.states import State
from tests.gateway.gateway_world import TextClient
from tests.master.world import drives, simulated, value, virtual_time

FRONT, REAR = "virtual:front", "virtual:rear"


async def enabled(client: TextClient, place: str) -> None:
    for word in ("0x80", "6", "7", "0xF"):
        assert await client.say(f"[1] {place} w 0x6040 0 u16 {word}") == "[1] OK"
        await trio.sleep(0.6)


@virtual_time
async def test_each_net_has_its_own_nodes_and_defaults() -> None:
    async with (
        simulated(3, bus=FRONT) as front,
        simulated(3, 4, bus=REAR) as rear,
        open_master(FRONT, REAR) as master,
        open_gateway(master, allow=parse_permissions("nmt,motion")) as service,
    ):
        with service.open_session("a test") as session:
            client = TextClient(session)
            assert service.nets == (FRONT, REAR)
            assert await client.say("[1] 3 r 0x1000 0 u32") == "[1] ERROR:104 #No default net set."
            assert await client.say("[2] 2 4 r 0x1000 0 u32") == "[2] 131474"
            assert "0x05040000" in await client.say("[3] 1 4 r 0x1000 0 u32")
            assert await client.say("[4] 2 set node 4") == "[4] OK"
            assert await client.say("[5] set network 1") == "[5] OK"
            assert await client.say("[6] r 0x1000 0 u32") == "[6] ERROR:105 #No default node set."
            assert await client.say("[7] set network 2") == "[7] OK"
            assert await client.say("[8] r 0x1000 0 u32") == "[8] 131474"
            assert await client.say("[9] 1 0 start") == "[9] OK"
            await trio.sleep(0.01)
            assert [node.nmt.state for node in front.nodes] == [NmtState.OPERATIONAL]
            assert {node.nmt.state for node in rear.nodes} == {NmtState.PRE_OPERATIONAL}
            await events_name_their_net(session, client)


async def events_name_their_net(session: GatewaySession, client: TextClient) -> None:
    assert await client.say("[1] 1 boot_up_indication enable") == "[1] OK"
    assert await client.say("[2] 2 boot_up_indication enable") == "[2] OK"
    assert await client.say("[3] 2 3 reset comm") == "[3] OK"
    assert await client.event() == "2 3 BOOT_UP"
    assert await client.say("[4] 1 3 reset comm") == "[4] OK"
    assert await client.event() == "1 3 BOOT_UP"
    assert session.dropped == 0


@virtual_time
async def test_halt_is_for_all_nets_unless_one_is_named() -> None:
    async with (
        simulated(3, bus=FRONT) as front,
        simulated(3, bus=REAR) as rear,
        open_master(FRONT, REAR) as master,
        open_gateway(master, allow=parse_permissions("motion")) as service,
    ):
        with service.open_session("a test") as session:
            client = TextClient(session)
            ours, theirs = drives(front)[0], drives(rear)[0]
            for place in ("1 3", "2 3"):
                await enabled(client, place)
            assert [each.drive.state for each in (ours, theirs)] == [State.OPERATION_ENABLED] * 2
            assert await client.say("[2] 1 3 _halt") == "[2] OK"
            assert [bool(value(each, 0x6040_00) & 0x100) for each in (ours, theirs)] == [True, False]
            assert await client.say("[3] 3 _halt") == "[3] OK"  # no net is known, so all are meant
            assert [bool(value(each, 0x6040_00) & 0x100) for each in (ours, theirs)] == [True, True]
