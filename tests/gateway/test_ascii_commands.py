"""What the commands of CiA 309-3 do on a bus of simulated drives, and what they answer."""

from __future__ import annotations

import pytest
import trio

from canopen_gateway import Limits
from canopen_gateway.ascii.connection import _ARGUMENTS, HELP, HELP_LSS
from canopen_proto import NmtState
from canopen_proto.frame import Frame
from canopen_proto.gateway import LELY, GatewayCommand
from canopen_proto.machine import MILLISECOND
from canopen_proto.simulation.drive.answers import Answer
from canopen_transports import open_transport
from tests.gateway.gateway_world import EVERYTHING, TextClient, gateway, text_client
from tests.master.world import BUS, drives, virtual_time


@virtual_time
async def test_reading_needs_no_permission() -> None:
    async with text_client(3) as (_, client):
        assert await client.say("[1] 3 r 0x1018 1 u32") == "[1] 818"
        assert await client.say("[2] 3 r 0x1018 1") == "[2] 32 03 00 00"
        assert await client.say("[3] set node 3") == "[3] OK"
        assert await client.say("[4] r 0x6041 0 x16") == "[4] 0x0240"
        assert await client.say("[5] r 0x1000 0 u8") == "[5] 92 01 02 00"
        assert (await client.say("[6] r 0x2FFF 0 u8")).startswith("[6] ERROR:0x06020000 #")
        assert (await client.say("[7] 99 r 0x1000 0")).startswith("[7] ERROR:0x05040000 #")
        assert await client.say("[8] 1 3 r 0x1018 1 u32") == "[8] 818"
        assert await client.say("# comment") == ""


@virtual_time
async def test_the_same_in_the_dialect_of_lely() -> None:
    async with text_client(3, dialect=LELY) as (_, client):
        assert await client.say("[1] 3 r 0x1018 1 u32") == "[1] ERROR: 104 (No default net set.)"
        assert await client.say("[2] set network 1") == "[2] OK"
        assert await client.say("[3] 3 r 0x1018 1 u32") == "[3] 0x00000332"
        assert await client.say("[4] 3 r 0x1018 1") == "[4] ERROR: 101 (Syntax error. A read needs a type)"
        assert (await client.say("[5] 3 r 0x1000 0 u8")).startswith("[5] ERROR: 06070010 (")
        assert await client.say("[6] 3 r 0x6064 0 i32") == "[6] 3000"


@pytest.mark.parametrize(
    ("line", "needs"),
    [
        ("3 w 0x1017 0 u16 200", "write"),
        ("3 w 0x6040 0 u16 6", "motion"),
        ("3 w 0x60FF 0 i32 0", "motion"),
        ("3 w 0x1010 1 u32 0x65766173", "store"),
        ("3 w 0x1F51 1 u8 1", "program"),
        ("3 w 0x1F82 3 u8 4", "nmt"),
        ("3 start", "nmt"),
        ("0 stop", "nmt"),
        ("3 preop", "nmt"),
        ("3 reset node", "nmt"),
        ("3 reset comm", "nmt"),
        ("3 enable guarding 100 3", "nmt"),
        ("3 disable guarding", "nmt"),
        ("set id 1", "nmt"),
        ("set heartbeat 100", "nmt"),
        ("set tpdo 1 0x203 event 1 u16", "motion"),
        ("w pdo 1 1 6", "motion"),
        ("lss_switch_glob 1", "lss"),
        ("lss_switch_sel 1 2 3 4", "lss"),
        ("lss_set_node 5", "lss"),
        ("lss_conf_bitrate 0 2", "lss"),
        ("lss_activate_bitrate 100", "lss"),
        ("lss_store", "lss"),
        ("lss_inquire_addr", "lss"),
        ("lss_get_node", "lss"),
        ("lss_identity 1 2 3 4 5 6", "lss"),
        ("lss_ident_nonconf", "lss"),
        ("_lss_slowscan 1 2 3 4 5 6", "lss"),
        ("_lss_fastscan", "lss"),
        ("lss_allnodes", "lss"),
    ],
)
def test_what_changes_something_is_refused_without_its_permission_and_sends_nothing(line: str, needs: str) -> None:
    others = ",".join(word for word in EVERYTHING.split(",") if word != needs)

    @virtual_time
    async def refused() -> None:
        heard: list[str] = []
        async with gateway(3, allow=others, heard=heard) as (_, service):
            heard.clear()
            with service.open_session("a test") as session:
                answer = await TextClient(session).say(f"[7] {line}")
            assert answer.startswith("[7] ERROR:100 #")
            assert f"without --allow {needs}" in answer
            assert heard == []

    refused()


@virtual_time
async def test_what_is_allowed_is_done() -> None:
    async with text_client(3, allow="write,nmt") as (host, client):
        assert await client.say("[1] 3 w 0x1017 0 u16 200") == "[1] OK"
        assert host.nodes[0].values[0x1017_00] == 200
        assert await client.say("[2] 0 start") == "[2] OK"
        await trio.sleep(0.01)
        assert host.nodes[0].nmt.state is NmtState.OPERATIONAL
        assert (await client.say("[3] 3 w 0x1000 0 u32 1")).startswith("[3] ERROR:0x06010002 #")
        assert await client.say("[4] 3 w 0x1017 0 u16 70000") == (
            "[4] ERROR:101 #Syntax error. 70000 is out of range for u16: 0 to 65535"
        )


@virtual_time
async def test_each_client_has_its_own_defaults() -> None:
    async with gateway(3, 4) as (_, service):
        with service.open_session("one") as one, service.open_session("other") as other:
            first, second = TextClient(one), TextClient(other)
            assert await first.say("[1] set node 4") == "[1] OK"
            assert await second.say("[1] r 0x1000 0") == "[1] ERROR:105 #No default node set."
            assert await first.say("[2] r 0x1018 4 u32") == await first.say("[2] 4 r 0x1018 4 u32")
            assert await first.say("[3] set node 0") == "[3] OK"
            assert await first.say("[4] r 0x1000 0") == "[4] ERROR:105 #No default node set."
            assert await first.say("[5] set network 2") == "[5] ERROR:106 #Unsupported net."
            assert await first.say("[6] 5 3 r 0x1000 0") == "[6] ERROR:106 #Unsupported net."
            assert await first.say("[7] 0 r 0x1000 0") == "[7] ERROR:107 #Unsupported node."
            assert await first.say("[8] set network 0") == "[8] OK"
            assert await first.say("[9] 3 r 0x1000 0") == "[9] ERROR:104 #No default net set."


@virtual_time
async def test_a_time_out_counts_for_its_client_alone_and_the_master_keeps_its_own() -> None:
    async with gateway(3) as (_, service):
        with service.open_session("one") as one, service.open_session("other") as other:
            quick, slow = TextClient(one), TextClient(other)
            await quick.say("[1] set sdo_timeout 20")
            await slow.say("[1] set sdo_timeout 2000")
            for client, seconds in ((quick, 0.02), (slow, 2.0), (quick, 0.02)):
                began = trio.current_time()
                assert "0x05040000" in await client.say("[2] 99 r 0x1000 0")
                assert trio.current_time() - began == pytest.approx(seconds, abs=0.001)
                await trio.sleep(1)  # after a time-out the same object is not asked for at once
            assert service.node(service.nets[0], 99).remote.sdo.timeout == 500_000_000


@virtual_time
async def test_a_silent_node_does_not_hold_up_another_client() -> None:
    async with gateway(3) as (_, service):
        with service.open_session("one") as one, service.open_session("other") as other:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(TextClient(one).say, "[1] 99 r 0x1000 0")
                await trio.sleep(0.001)
                began = trio.current_time()
                assert await TextClient(other).say("[1] 3 r 0x1000 0 u32") == "[1] 131474"
                assert trio.current_time() - began < 0.01


@virtual_time
async def test_a_command_time_out_ends_what_takes_longer() -> None:
    async with text_client() as (_, client):
        assert await client.say("[1] set command_timeout 50") == "[1] OK"
        began = trio.current_time()
        assert await client.say("[2] 99 r 0x1000 0") == "[2] ERROR:103 #Time-out."
        assert trio.current_time() - began == pytest.approx(0.05, abs=0.001)


@virtual_time
async def test_a_value_that_is_too_long_is_refused() -> None:
    async with gateway(3, limits=Limits(value_bytes=16)) as (_, service):
        with service.open_session("one") as session:
            client = TextClient(session)
            assert (await client.say("[1] 3 r 0x1008 0 vs")).startswith("[1] ERROR:0x05040005 #")
            assert await client.say("[2] 3 r 0x1000 0 u32") == "[2] 131474"


@virtual_time
async def test_what_a_client_may_read_bounds_no_program_beside_the_gateway() -> None:
    async with gateway(3, limits=Limits(value_bytes=16)) as (host, service), trio.open_nursery() as nursery:
        drives(host)[0].answer(0x1018, 4, Answer(delay=300 * MILLISECOND))
        with service.open_session("one") as session:
            nursery.start_soon(TextClient(session).say, "[1] 3 r 0x1018 4 u32")
            await trio.sleep(0.1)
            assert len(await service.master.node(3).read_bytes(0x1008)) > 16


@virtual_time
async def test_the_gateway_itself() -> None:
    async with text_client(allow="nmt") as (_, client):
        assert await client.say("[1] info version") == "[1] 0 0 0.1 0 0 3.0 0.1"
        assert await client.say("[2] init 2") == "[2] OK"
        assert await client.say("[3] set command_size 65536") == "[3] OK"
        assert await client.say("[4] set command_size 65537") == "[4] ERROR:600 #Running out of memory."
        assert await client.say("[5] led") == "[5] ERROR:100 #this gateway has no LEDs"
        assert await client.say("[6] set sdo_block 1") == "[6] OK"
        assert await client.say("[7] set heartbeat 100") == "[7] ERROR:102 #this gateway has no node-ID there yet"
        assert "which its drives watch" in await client.say("[8] set id 127")
        answer = await client.say("[9] set id 200")
        assert answer == "[9] ERROR:101 #Syntax error. 200 is out of range: 1 to 127, or 255"


def test_the_help_names_every_command() -> None:
    lines = [*HELP.splitlines(), *HELP_LSS.splitlines()]
    for command in GatewayCommand:
        words = " ".join("|".join(each) for each in command.syntax.words)
        assert any(line.startswith("[seq] ") and f"] {words}" in line for line in lines), command
        takes = bool(command.syntax.numbers or command.syntax.tail.value != "nothing")
        assert (command in _ARGUMENTS) is takes, command


@virtual_time
async def test_a_heartbeat_of_the_gateway() -> None:
    heard: list[str] = []
    async with gateway(allow="nmt", heard=heard) as (_, service):
        with service.open_session("one") as session:
            client = TextClient(session)
            assert await client.say("[1] set id 1") == "[1] OK"
            assert await client.say("[2] set heartbeat 100") == "[2] OK"
            await trio.sleep(0.35)
            assert heard == ["701#05"] * 4
            assert await client.say("[3] set id 255") == "[3] OK"
            await trio.sleep(1)
            assert heard == ["701#05"] * 4


# ---- events ----


@virtual_time
async def test_boot_ups_states_and_emergencies_on_request_only() -> None:
    async with gateway(3, 4, allow=EVERYTHING) as (host, service):
        with service.open_session("one") as one, service.open_session("other") as other:
            client, stranger = TextClient(one), TextClient(other)
            await stranger.say("[1] 3 w 0x1017 0 u16 100")
            assert await client.say("[1] 1 boot_up_indication enable") == "[1] OK"
            assert await client.say("[2] 3 enable heartbeat 300") == "[2] OK"
            assert await client.event() == "1 3 ERROR 202 (Heartbeat started.)"
            assert await client.event() == "1 3 ERRORx PREO"
            await stranger.say("[2] 3 start")
            assert await client.event() == "1 3 ERRORx OPER"
            await stranger.say("[3] 4 reset node")
            assert await client.event() == "1 4 BOOT_UP"
            drives(host)[0].raise_fault(0x2310, host.now())
            host.pump()
            assert (await client.event()).startswith("1 3 EMCY 2310 ")
            await stranger.say("[4] 3 w 0x1017 0 u16 0")
            assert await client.event() == "1 3 ERROR 203 (Heartbeat lost.)"
            with trio.move_on_after(10) as nothing:
                await stranger.event()
            assert nothing.cancelled_caught
            log = await client.say("[3] log")
            assert log.splitlines()[0] == "# 1 3 ERROR 202 (Heartbeat started.)"
            assert log.endswith("[3] OK")
            assert await client.say("[4] boot_up_indication disable") == "[4] OK"
            assert await client.say("[5] 3 disable heartbeat") == "[5] OK"
            await stranger.say("[5] 0 reset node")
            with trio.move_on_after(10) as nothing:
                await client.event()
            assert nothing.cancelled_caught


@virtual_time
async def test_guarding_that_is_lost_is_told() -> None:
    async with text_client(allow="nmt") as (_, client):
        assert await client.say("[1] 9 enable guarding 100 3") == "[1] OK"
        assert await client.event() == "1 9 ERROR 200 (Lost guarding message.)"
        assert await client.say("[2] 9 disable guarding") == "[2] OK"


@virtual_time
async def test_an_impatient_client_stops_nobody_elses_watch() -> None:
    """Its heartbeat time is its own: no HeartbeatLost of the core follows, which would stop a chain."""
    from canopen_proto import HeartbeatLost

    async with text_client(3, allow="write") as (_, client):
        with client.session.service.master.events(HeartbeatLost) as lost:
            await client.say("[1] 3 w 0x1017 0 u16 1000")
            await client.say("[2] 3 enable heartbeat 10")
            assert await client.event() == "1 3 ERROR 202 (Heartbeat started.)"
            assert await client.event() == "1 3 ERRORx PREO"
            assert await client.event() == "1 3 ERROR 203 (Heartbeat lost.)"
            assert lost.take() == []


@virtual_time
async def test_events_that_are_not_taken_are_dropped_and_counted() -> None:
    from canopen_gateway.service import EVENTS_WAITING

    async with text_client(3, allow="nmt") as (_, client):
        await client.say("[1] boot_up_indication enable")
        for _ in range(EVENTS_WAITING + 5):
            await client.say("[2] 3 reset comm")
            await trio.sleep(0.1)
        assert client.session.dropped == 5
        assert await client.event() == "1 3 BOOT_UP"


# ---- PDOs ----


@virtual_time
async def test_a_pdo_that_the_gateway_receives() -> None:
    async with gateway(3, allow="nmt") as (host, service):
        with service.open_session("one") as one, service.open_session("other") as other:
            client, stranger = TextClient(one), TextClient(other)
            assert await client.say("[1] r pdo 1") == "[1] ERROR:102 #this client has set up no PDO 1 of that direction"
            assert await client.say("[2] set rpdo 1 0x3A5 event 2 0x2000 1 u16 u8") == "[2] OK"
            assert await stranger.say("[2] set rpdo 1 0x3A6 event 1 u8") == "[2] ERROR:400 #PDO 1 is another client's"
            assert await client.say("[3] r pdo 1") == "[3] ERROR:102 #it has not come yet"
            await _sent(host, "3A5#370205")
            assert await client.event() == "1 pdo 1 2 0x237 0x5"
            assert await client.say("[4] r p 1") == "[4] 1 pdo 2 0x237 0x5"
            assert (
                await client.say("[5] set rpdo 1 0x3A5 event 9 u64 u8 u8 u8 u8 u8 u8 u8 u8")
                == "[5] ERROR:401 #PDO length exceeded."
            )
            assert (await client.say("[6] set rpdo 2 0x603 event 1 u8")).startswith("[6] ERROR:102 #PDO 2 cannot have the COB-ID")
            assert (await client.say("[7] set rpdo 2 0x3A6 rtr 1 u8")).startswith("[7] ERROR:100 #")
            assert await client.say("[8] set rpdo 1 0x800003A5 event 0") == "[8] OK"
            assert await client.say("[9] r pdo 1") == "[9] ERROR:102 #this client has set up no PDO 1 of that direction"
            assert await stranger.say("[3] set rpdo 1 0x3A6 event 1 u8") == "[3] OK"


@virtual_time
async def test_a_pdo_that_the_gateway_sends() -> None:
    heard: list[str] = []
    async with gateway(allow="motion", heard=heard) as (_, service):
        with service.open_session("one") as session:
            client = TextClient(session)
            assert await client.say("[1] set tpdo 1 0x3A5 event 2 u16 u8") == "[1] OK"
            assert await client.say("[2] w pdo 1 2 0x237 5") == "[2] OK"
            assert heard == ["3A5#370205"]
            assert (await client.say("[3] w pdo 1 1 0x237")).startswith("[3] ERROR:102 #PDO 1 has 2 values")
            assert (await client.say("[4] set tpdo 2 0x3A6 sync1 1 u8")).startswith("[4] ERROR:100 #only event-driven PDOs")
            assert (await client.say("[5] set tpdo 2 0x080 event 1 u8")).startswith("[5] ERROR:102 #")  # it would be a SYNC
            assert heard == ["3A5#370205"]


async def _sent(host: object, text: str) -> None:
    """Somebody on the bus sends a frame."""
    transport = await open_transport(BUS)
    await transport.send(Frame.parse(text))
    await transport.aclose()
