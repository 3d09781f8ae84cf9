"""The layer setting services of the text door, with devices that have no node-ID."""

from __future__ import annotations

import trio

from canopen_master.simulation.serving import drive_maker
from canopen_proto.frame import frame_for_key
from canopen_proto.gateway import LELY
from canopen_proto.lss.messages import FROM_MASTER, UNCONFIGURED, LssService, LssState
from canopen_proto.lss.scan import NOTHING_KNOWN
from canopen_proto.machine import MILLISECOND
from tests.gateway.gateway_world import gateway, text_client
from tests.master.world import virtual_time

ADDRESS = "0x332 0x43 0x10000"
SHOWN = "0x00000332 0x00000043 0x00010000"


def devices(count: int) -> list[object]:
    return [drive_maker(number, UNCONFIGURED) for number in range(count)]


@virtual_time
async def test_a_question_to_the_selected_device_when_none_is_selected() -> None:
    async with text_client(allow="lss", makers=devices(1)) as (_, client):
        for line in ("lss_get_node", "lss_inquire_addr", "lss_set_node 5", "lss_store", "lss_conf_bitrate 0 2"):
            assert (await client.say(f"[1] {line}")).startswith("[1] ERROR:102 #no device is selected"), line


@virtual_time
async def test_a_device_is_found_named_and_asked() -> None:
    async with text_client(allow="lss", makers=devices(2)) as (host, client):
        assert await client.say("[1] lss_ident_nonconf") == "[1] OK"
        assert await client.say("[2] lss_identity 0x332 0x43 0 0xFFFFFFFF 0 0xFFFFFFFF") == "[2] OK"
        assert await client.say("[3] lss_identity 0x999 1 0 1 0 1") == "[3] ERROR:103 #Time-out."
        assert await client.say("[4] _lss_fastscan 20") == f"[4] {SHOWN} 0x00000001"
        assert await client.say("[5] lss_inquire_addr") == f"[5] {SHOWN} 0x00000001"
        assert await client.say("[6] lss_inquire_addr 3") == "[6] 0x00000001"
        assert await client.say("[7] lss_inquire_addr 0x5A") == "[7] 0x00000332"
        assert await client.say("[8] lss_inquire_addr 4") == (
            "[8] ERROR:101 #Syntax error. 4 is out of range: 0 to 3, 0x5A to 0x5D"
        )
        assert await client.say("[9] lss_get_node") == "[9] 0xFF"
        assert await client.say("[10] lss_set_node 5") == "[10] OK"
        answer = await client.say("[11] lss_set_node 0")
        assert answer == "[11] ERROR:101 #Syntax error. 0 is out of range: 1 to 127, or 255"
        answer = await client.say("[12] lss_set_node 200")
        assert answer == "[12] ERROR:101 #Syntax error. 200 is out of range: 1 to 127, or 255"
        assert await client.say("[13] lss_conf_bitrate 0 5") == "[13] ERROR:503 #LSS bit rate not supported."
        assert await client.say("[14] lss_switch_glob 0") == "[14] OK"
        assert (await client.say("[15] lss_get_node")).startswith("[15] ERROR:102 #")
        assert host.nodes[0].node_id == 5
        assert await client.say("[16] 5 r 0x1000 0 u32") == "[16] 131474"


@virtual_time
async def test_a_device_is_selected_by_its_address() -> None:
    async with text_client(allow="lss", makers=devices(2)) as (_, client):
        assert await client.say(f"[1] lss_switch_sel {ADDRESS} 2") == "[1] OK"
        assert await client.say("[2] lss_inquire_addr 3") == "[2] 0x00000002"
        assert await client.say("[3] lss_switch_glob 0") == "[3] OK"
        assert await client.say(f"[4] lss_switch_sel {ADDRESS} 9") == "[4] ERROR:103 #Time-out."
        assert (await client.say("[5] lss_get_node")).startswith("[5] ERROR:102 #")


@virtual_time
async def test_a_node_id_is_for_the_device_that_was_selected_last_alone() -> None:
    async with text_client(allow="lss", makers=devices(2)) as (host, client):
        assert await client.say(f"[1] lss_switch_sel {ADDRESS} 1") == "[1] OK"
        assert await client.say(f"[2] lss_switch_sel {ADDRESS} 2") == "[2] OK"
        assert await client.say("[3] lss_set_node 5") == "[3] OK"
        assert [node.lss.pending.node_id for node in host.nodes] == [UNCONFIGURED, 5]


@virtual_time
async def test_a_device_whose_answer_to_its_selection_was_lost_can_be_selected_again() -> None:
    async with text_client(allow="lss", makers=devices(1)) as (host, client):
        host.nodes[0].lss.state = LssState.CONFIGURATION
        assert await client.say(f"[1] lss_switch_sel {ADDRESS} 1") == "[1] OK"


@virtual_time
async def test_a_node_id_that_several_devices_take_is_not_answered_by_ok() -> None:
    async with text_client(allow="lss", makers=devices(2)) as (host, client):
        assert await client.say("[1] lss_switch_glob 1") == "[1] OK"
        answer = await client.say("[2] lss_set_node 5")
        assert answer.startswith("[2] ERROR:102 #"), answer
        assert "2 devices have taken it" in answer
        assert await client.say("[3] lss_set_node 255") == "[3] OK"
        assert [node.lss.pending.node_id for node in host.nodes] == [UNCONFIGURED, UNCONFIGURED]


@virtual_time
async def test_a_search_that_ends_early_leaves_no_device_selected() -> None:
    async with gateway(allow="lss", makers=devices(1)) as (host, service):
        settings, begun = service.layer_settings(service.master.bus().name), trio.current_time()
        assert await settings.fastscan(NOTHING_KNOWN, 20 * MILLISECOND) is not None
        whole = trio.current_time() - begun
        for early in range(1, 100, 7):
            with trio.move_on_after(whole - early / 1000) as limit:
                await settings.fastscan(NOTHING_KNOWN, 20 * MILLISECOND)
            assert limit.cancelled_caught
            await trio.sleep(0.01)
            assert (settings.is_selected, host.nodes[0].lss.state) == (False, LssState.WAITING), early


@virtual_time
async def test_all_devices_get_their_node_ids() -> None:
    async with text_client(allow="lss", makers=devices(3)) as (host, client):
        answer = await client.say("[1] lss_allnodes 20 10 0 2 0x332 2 0x43 2 0x10000 0 0")
        assert answer.splitlines() == [
            *(f"# Node-ID {10 + number} assigned to: {SHOWN} 0x{number + 1:08X}" for number in range(3)),
            "# Found 3 nodes, search finished.",
            "[1] OK",
        ]
        assert sorted(node.node_id for node in host.nodes) == [10, 11, 12]
        assert (await client.say("[2] lss_allnodes 20 10 0 2 0x332 2 0x43 2 0x10000 0 0")).splitlines() == [
            "# Found 0 nodes, search finished.",
            "[2] OK",
        ]


@virtual_time
async def test_one_device_is_told_in_the_words_of_canopennode() -> None:
    async with text_client(allow="lss", makers=devices(1)) as (_, client):
        answer = await client.say("[1] lss_allnodes 20 10 0 2 0x332 2 0x43 2 0x10000 0 0")
        assert answer.splitlines()[1:] == ["# Found 1 nodes, search finished.", "[1] OK"]


@virtual_time
async def test_searches_as_lely_has_them() -> None:
    async with text_client(allow="lss", makers=devices(2), dialect=LELY) as (_, client):
        await client.say("[1] set network 1")
        known = "0x332 0xFFFFFFFF 0x43 0xFFFFFFFF 0x10000 0xFFFFFFFF 0 0"
        assert await client.say(f"[2] _lss_fastscan {known}") == "[2] 0x00000332 0x00000043 0x00010000 0x00000001"
        assert await client.say("[3] lss_get_node") == "[3] 255"
        assert await client.say("[4] _lss_fastscan 0 1 0 0 0 0 0 0") == "[4] ERROR: 100 (a mask is 0, or 0xFFFFFFFF)"
        assert await client.say("[5] lss_switch_glob 0") == "[5] OK"
        found = await client.say("[6] _lss_slowscan 0x332 0x43 0x10000 0x10000 0 7")
        assert found == "[6] 0x00000332 0x00000043 0x00010000 0x00000001"
        assert await client.say("[7] _lss_slowscan 0x999 0x43 0 0 0 7") == "[7] ERROR: 103 (Time-out.)"


@virtual_time
async def test_nobody_to_be_found() -> None:
    async with text_client(3, allow="lss") as (_, client):
        assert await client.say("[1] _lss_fastscan 50") == "[1] ERROR:103 #Time-out."
        assert (await client.say("[2] _lss_fastscan 70000")) == ("[2] ERROR:101 #Syntax error. 70000 is out of range: 0 to 65535")
        assert await client.say("[3] lss_ident_nonconf") == "[3] ERROR:103 #Time-out."
        assert await client.say("[4] lss_activate_bitrate 100") == "[4] OK"
        assert await client.say("[5] lss_switch_glob 1") == "[5] OK"
        assert await client.say("[6] lss_get_node") == "[6] 0x03"
        assert await client.say("[7] lss_switch_glob 0") == "[7] OK"


@virtual_time
async def test_while_another_lss_master_is_at_work_nothing_is_sent_that_its_devices_would_take() -> None:
    """With all devices in "configuration", what the other one writes to one of them would go to each."""
    async with text_client(allow="lss", makers=devices(2)) as (host, client):
        assert await client.say("[1] lss_switch_glob 0") == "[1] OK"
        host.nodes[0].out.frames.append(frame_for_key(FROM_MASTER, bytes((LssService.INQUIRE_NODE_ID,)).ljust(8, b"\x00")))
        host.pump()
        await trio.sleep(0.1)
        for line in ("lss_switch_glob 1", "lss_activate_bitrate 100", "lss_ident_nonconf"):
            answer = await client.say(f"[2] {line}")
            assert answer.startswith("[2] ERROR:103 #another LSS master is at work on this bus: it sent 7E5#5E"), (line, answer)
        assert {node.lss.state for node in host.nodes} == {LssState.WAITING}
        assert not any(node.lss.is_silent for node in host.nodes)
        assert await client.say("[3] lss_switch_glob 0") == "[3] OK"
        await trio.sleep(5.0)
        assert await client.say("[4] lss_switch_glob 1") == "[4] OK"
