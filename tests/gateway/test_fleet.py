"""A fleet over Zenoh, on loopback: what a viewer sees of a bridge and its nodes, and what he may do."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import trio

from canopen_data.descriptions import load_description
from canopen_gateway import BridgeRefusedError, DoorError, FleetError, Limits
from canopen_gateway.fleet import (
    FleetEmcy,
    FleetLease,
    FleetPdo,
    FleetPlace,
    FleetState,
    PlaceAppeared,
    PlaceGone,
    bind_fleet_door,
    open_fleet,
    parse_place,
)
from canopen_gateway.fleet.joining import close_zenoh, open_zenoh
from canopen_gateway.fleet.keys import ROOT
from canopen_master import DeviceModel
from canopen_proto import NmtCommand
from canopen_proto.abort import AbortCode
from canopen_proto.frame import Frame
from canopen_proto.nmt import NmtState
from canopen_transports import open_transport
from tests.gateway.fleet_world import BUS, NODE, SITE, bridge, fleet, free_endpoint, real_time, seen
from tests.gateway.gateway_world import gateway
from tests.master.world import BUS as VIRTUAL
from tests.master.world import drives

zenoh = pytest.importorskip("zenoh", reason="the extra fleet is not installed")
PLACE = parse_place(NODE)


@real_time
async def test_objects_are_read_by_name_and_by_number_with_type_and_unit() -> None:
    async with fleet(3) as (viewer, _):
        read = await viewer.read(NODE, "statusword")
        assert (read.place, read.value, read.name, read.data) == (PLACE, 0x0240, "statusword", b"\x40\x02")
        assert (await viewer.read(NODE, 0x6041)).value == 0x0240
        assert (await viewer.read(NODE, "6041:00")).value == 0x0240
        assert (await viewer.read(NODE, 0x101801)).name == "identity_object:vendor_id"
        assert (await viewer.read(NODE, 0x1008)).value == "Simulated Schunk Powerball joint"


@real_time
async def test_a_fleet_that_was_left_says_so() -> None:
    async with fleet(3) as (viewer, _):
        pass
    for ask in (viewer.read(NODE, "statusword"), viewer.write(NODE, 0x1017, 5), viewer.halt(), viewer.nmt(NODE, NmtCommand.STOP)):
        with pytest.raises(FleetError, match="cannot be asked"):
            await ask


@real_time
async def test_an_object_of_all_nodes_is_read_side_by_side_and_a_silent_one_has_its_problem() -> None:
    async with fleet(3, 4) as (viewer, served):
        assert [each.value for each in await viewer.read_all("*/*/*", 0x1001)] == [0, 0]
        await served.service.master.nmt(NmtCommand.STOP, 4)  # stopped, it answers no SDO
        three, four = await viewer.read_all(f"{SITE}/*/*", 0x1001)
        assert (three.value, three.problem) == (0, "")
        assert four.value is None
        assert "did not answer" in four.problem


@real_time
async def test_more_nodes_than_a_bridge_serves_at_a_time_are_all_read() -> None:
    dictionary = load_description("sample_io.eds").dictionary
    count = Limits().requests + 8
    devices = [DeviceModel(dictionary, node_id=node_id) for node_id in range(1, count + 1)]
    async with fleet(*range(1, count + 1), makers=devices, without_drives=True) as (viewer, _):
        found = await viewer.read_all("*/*/*", 0x1001)
        assert [(each.place.node_id, each.value, each.problem) for each in found] == [(at + 1, 0, "") for at in range(count)]


@real_time
async def test_settings_are_written_as_values_and_as_bytes_if_that_is_allowed() -> None:
    async with fleet(3, allow="write") as (viewer, _):
        await viewer.write(NODE, "producer_heartbeat_time", 1234)
        assert (await viewer.read(NODE, 0x1017)).value == 1234
        await viewer.write(NODE, 0x1017, b"\x05\x00")
        assert (await viewer.read(NODE, 0x1017)).value == 5
        with pytest.raises(BridgeRefusedError, match="70000"):
            await viewer.write(NODE, "producer_heartbeat_time", 70_000)
        with pytest.raises(BridgeRefusedError) as refused:
            await viewer.write(NODE, 0x1000, b"\0\0\0\0")
        assert refused.value.abort_code == AbortCode.READ_ONLY
        assert not refused.value.not_confirmed


@pytest.mark.parametrize("allow", ["", "write", "nmt,lss,store,program"])
@real_time
async def test_what_was_not_allowed_sends_nothing(allow: str) -> None:
    heard: list[str] = []
    async with fleet(3, allow=allow, heard=heard) as (viewer, _):
        heard.clear()
        with pytest.raises(BridgeRefusedError, match="not allowed") as refused:
            await viewer.write(NODE, "controlword", 6)
        assert (refused.value.bridge_code, "--allow motion" in refused.value.seen) == ("CO150", True)
        if "nmt" not in allow:
            with pytest.raises(BridgeRefusedError, match="NMT stop is not allowed"):
                await viewer.nmt(NODE, NmtCommand.STOP)
        if "write" not in allow:
            with pytest.raises(BridgeRefusedError, match="not allowed"):
                await viewer.write(NODE, 0x1017, 1)
        with pytest.raises(BridgeRefusedError, match="moving the machine is not allowed"):
            async with viewer.lead(f"{SITE}/{BUS}"):
                raise AssertionError
        assert not [each for each in heard if each.startswith(("603", "000", "203"))]


@real_time
async def test_nodes_come_and_go_with_their_states() -> None:
    async with fleet(3, allow="write,nmt") as (viewer, _):
        with viewer.news(PlaceGone, PlaceAppeared, FleetState) as news:
            await viewer.write(NODE, 0x1017, 100)
            await viewer.nmt(NODE, NmtCommand.START)
            while True:
                event = await news.receive()
                if isinstance(event, FleetState) and event.state is NmtState.OPERATIONAL:
                    break
            await viewer.write(NODE, 0x1017, 0)  # silent from now on
            assert await news.receive() == PlaceGone(PLACE)
            assert viewer.nodes == []
            await viewer.read(NODE, 0x1001)  # it answers, so it is there
            assert await news.receive() == PlaceAppeared(PLACE)
            assert viewer.nodes == [PLACE]


@real_time
async def test_more_news_than_a_bridge_takes_leave_no_wrong_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two hundred nodes that come back at once are more events than wait for a client: those that were dropped are looked up."""
    monkeypatch.setattr("canopen_gateway.service.EVENTS_WAITING", 1)
    async with fleet(3) as (viewer, served), await open_transport(VIRTUAL) as wire:
        for node_id in range(20, 40):
            await wire.send(Frame(0x700 + node_id, b"\x05"))
        await seen(lambda: served.door.dropped > 0)
        await seen(lambda: {each.node_id for each in viewer.nodes} >= {*range(20, 40)})
        assert set((await viewer.status(f"{SITE}/{BUS}"))["nodes"].values()) >= {"OPERATIONAL"}
        await seen(lambda: [each.node_id for each in viewer.nodes] == [3])  # no further heartbeat: all of them are gone again


@real_time
async def test_emergencies_come_and_are_remembered_for_those_who_come_later() -> None:
    async with fleet(3) as (viewer, served):
        with viewer.news(FleetEmcy) as news:
            drives(served.host)[0].raise_fault(0x2310, served.host.now())
            served.host.pump()
            event = await news.receive()
        assert (event.place, event.code) == (PLACE, 0x2310)
        async with open_fleet(connect=[served.endpoint]) as later:
            assert [each.code for each in await later.emergencies(NODE)] == [0x2310]


@real_time
async def test_pdos_come_by_name_once_somebody_asks_for_them() -> None:
    device = DeviceModel(load_description("sample_io.eds").dictionary, node_id=5)
    async with fleet(5, makers=[device], without_drives=True) as (viewer, served):
        node = served.service.master.node(5, "sample_io.eds")
        with viewer.news(FleetPdo) as news:
            await node.start()
            async for pdo in news:
                if pdo.values:  # what it carries is asked for at the first one
                    break
                await node.write(0x6200_01, 1)
        mapping = node.remote.tpdos[pdo.number].mapping
        assert pdo.place == FleetPlace(SITE, BUS, 5)
        assert pdo.values == dict(zip(mapping.labels, mapping.unpack(pdo.data), strict=True))


@real_time
async def test_by_two_routers_each_thing_is_done_and_told_once_and_one_of_them_may_end() -> None:
    """So routers are brought up to date, one after the other: both sides are connected to both, and everything comes twice."""
    ends = [free_endpoint(), free_endpoint()]
    first, second = [await open_zenoh(listen=[each], mode="router") for each in ends]
    heard: list[str] = []
    door = await bind_fleet_door(SITE, connect=ends)
    async with door, gateway(3, allow="write,nmt", heard=heard) as (_, service), trio.open_nursery() as nursery:
        nursery.start_soon(door.serve, service)
        async with open_fleet(connect=ends) as viewer:
            await seen(lambda: viewer.nodes == [PLACE])
            copies = []
            viewer._zenoh.declare_subscriber(f"{ROOT}/*/*/*/nmt", copies.append)
            with viewer.news(FleetState) as news:
                await viewer.write(NODE, 0x1017, 100)
                await viewer.nmt(NODE, NmtCommand.START)
                while (await news.receive()).state is not NmtState.OPERATIONAL:
                    pass
                await viewer.nmt(NODE, NmtCommand.ENTER_PRE_OPERATIONAL)
                assert (await news.receive()).state is NmtState.PRE_OPERATIONAL
                await seen(lambda: len(copies) >= 4)  # else there are no two ways
            assert sum(each.startswith("603#2B1710") for each in heard) == 1
            assert sum(each.startswith("000#01") for each in heard) == 1
            await close_zenoh(first)
            await viewer.write(NODE, 0x1017, 200)
            assert (await viewer.read(NODE, 0x1017)).value == 200
            assert sum(each.startswith("603#2B1710") for each in heard) == 2
            await close_zenoh(second)
            await seen(lambda: not viewer.nodes)
            with pytest.raises(FleetError):
                await viewer.read(NODE, 0x1017)
        nursery.cancel_scope.cancel()


@real_time
async def test_who_is_away_gives_no_answer_and_that_is_told() -> None:
    async with fleet(3) as (viewer, _):
        for ask in (
            lambda: viewer.read("other/bus/3", 0x1001),
            lambda: viewer.halt("other/bus"),
            lambda: viewer.status("other/bus"),
        ):
            with pytest.raises(FleetError, match="nobody"):
                await ask()
        with pytest.raises(FleetError, match="it may have been written"):
            await viewer.write("other/bus/3", 0x1017, 1)


@real_time
async def test_what_names_no_object_and_many_nodes_is_refused() -> None:
    async with fleet(3) as (viewer, _):
        with pytest.raises(BridgeRefusedError, match="not in the dictionary"):
            await viewer.read(NODE, "no_such_object")
        with pytest.raises(ValueError, match="no object"):
            await viewer.read(NODE, "a/b")
        with pytest.raises(ValueError, match="read_all"):
            await viewer.read("*/*/*", 0x1001)
        with pytest.raises(ValueError, match="many nodes"):
            await viewer.write("*/*/*", 0x1017, 1)


@real_time
async def test_another_program_of_zenoh_is_answered_for_each_node_and_nonsense_is_refused() -> None:
    """Keys, payloads and encodings of anybody: each ends with an answer or an error, and the door goes on."""
    async with fleet(3, 4, allow="write,nmt,motion") as (viewer, served):
        session = viewer._zenoh

        async def get(key: str, payload: bytes | None = None, encoding: str | None = None) -> list[Any]:
            def ask() -> list[Any]:
                return list(
                    session.get(key, payload=payload, encoding=encoding, timeout=30, consolidation=zenoh.ConsolidationMode.NONE)
                )

            return await trio.to_thread.run_sync(ask)

        answers = await get(f"{ROOT}/*/*/*/get/6041:00")
        assert sorted(str(each.ok.key_expr) for each in answers) == [f"{ROOT}/{SITE}/{BUS}/{each}/get/6041:00" for each in (3, 4)]
        for key, payload, encoding in (
            (f"{ROOT}/{SITE}/{BUS}/3/get", None, None),
            (f"{ROOT}/{SITE}/{BUS}/0/get/1000", None, None),
            (f"{ROOT}/{SITE}/{BUS}/3/get/{'a' * 300}", None, None),
            (f"{ROOT}/{SITE}/{BUS}/3/set/1017", b"[1]", "application/json"),
            (f"{ROOT}/{SITE}/{BUS}/3/set/1017", b"{", "application/json"),
            (f"{ROOT}/{SITE}/{BUS}/3/set/1017", b"[" * 100_000, "application/json"),
            (f"{ROOT}/{SITE}/{BUS}/3/set/2fff", b"1", "application/json"),
            (f"{ROOT}/{SITE}/{BUS}/3/set/1017", bytes(2_000_000), None),
            (f"{ROOT}/{SITE}/{BUS}/3/command", b"explode", None),
            (f"{ROOT}/{SITE}/{BUS}/3/command", b"\xff" * 100, None),
            (f"{ROOT}/{SITE}/{BUS}/lease", b"null", None),
            (f"{ROOT}/{SITE}/{BUS}/lease", json.dumps({"client": "x" * 20, "do": "fly"}).encode(), None),
            (f"{ROOT}/{SITE}/{BUS}/no_such_thing", None, None),
        ):
            answers = await get(key, payload, encoding)
            assert answers, key
            assert all(each.ok is None and "message" in json.loads(bytes(each.err.payload)) for each in answers), key
        assert (await viewer.read(NODE, 0x1017)).value != 1
        assert served.door.failure is None


@real_time
async def test_anybody_may_halt_everything_in_a_read_only_fleet() -> None:
    async with fleet(3) as (viewer, _):
        assert await viewer.halt() == {FleetPlace(SITE, BUS): []}
        assert await viewer.halt(NODE) == {PLACE: []}


@real_time
async def test_a_halt_is_served_however_much_is_asked() -> None:
    """As many reads of a node that is silent as the door takes, and more: a halt, and the lease, have room of their own."""
    async with (
        fleet(3, allow="motion", sdo_timeout=60.0) as (viewer, served),
        open_fleet(connect=[served.endpoint]) as eager,
        trio.open_nursery() as nursery,
    ):
        for _ in range(served.service.limits.requests + 8):
            nursery.start_soon(ignored, eager.read, f"{SITE}/{BUS}/99", 0x1000)
        await seen(lambda: served.door._answering >= served.service.limits.requests)
        assert await viewer.halt() == {FleetPlace(SITE, BUS): []}
        async with viewer.lead(f"{SITE}/{BUS}"):
            assert served.service.lease.owner is not None
        nursery.cancel_scope.cancel()


async def ignored(ask: Callable[..., Awaitable[object]], *arguments: object) -> None:
    with contextlib.suppress(FleetError, BridgeRefusedError):
        await ask(*arguments)


@real_time
async def test_a_write_to_many_nodes_writes_none() -> None:
    """Another program of Zenoh may ask so; `Fleet.write` refuses it itself."""
    async with fleet(3, 4, allow="write,nmt,motion") as (viewer, _):
        before = [each.value for each in await viewer.read_all("*/*/*", 0x1017)]
        for pattern in (f"{SITE}/{BUS}/*", f"{SITE}/*/3", f"*/{BUS}/3"):
            place = parse_place(pattern)
            with pytest.raises(BridgeRefusedError, match="is for one place"):
                await viewer.ask(place, "set", "1017:00", payload=b"\x07\x00")
            with pytest.raises(BridgeRefusedError, match="is for one place"):
                await viewer.ask(place, "command", payload=b"stop")
        assert [each.value for each in await viewer.read_all("*/*/*", 0x1017)] == before


@real_time
async def test_one_moves_a_machine_and_the_other_is_told_who_does() -> None:
    async with fleet(3, allow="motion") as (viewer, served), open_fleet(connect=[served.endpoint]) as other:
        lease = served.service.lease
        async with viewer.lead(f"{SITE}/{BUS}"):
            assert lease.owner is not None
            assert (await other.status(f"{SITE}/{BUS}"))["moved_by"] == "a viewer of the fleet"
            with pytest.raises(BridgeRefusedError, match="a viewer of the fleet moves this machine"):
                async with other.lead(f"{SITE}/{BUS}"):
                    raise AssertionError
        await seen(lambda: lease.owner is None)


@real_time
async def test_a_bridge_that_ends_takes_its_nodes_along_and_comes_back_by_itself() -> None:
    async with bridge(3) as served:
        endpoint = served.endpoint
        async with open_fleet(connect=[endpoint]) as viewer:
            await seen(lambda: len(viewer.nodes) == 1)
            with viewer.news(PlaceGone) as news:
                await served.door.aclose()
                gone = {(await news.receive()).place for _ in range(2)}
                assert gone == {PLACE, PLACE.bus_place}
                with pytest.raises(FleetError, match="nobody answers"):
                    await viewer.read(NODE, 0x1001)
                again = await bind_fleet_door(SITE, listen=[endpoint])
                async with again, trio.open_nursery() as nursery:
                    nursery.start_soon(again.serve, served.service)
                    await seen(lambda: PLACE in viewer.nodes)
                    assert (await viewer.read(NODE, 0x1001)).value == 0
                    nursery.cancel_scope.cancel()


@real_time
async def test_a_router_passes_on_what_peers_do_not() -> None:
    middle = free_endpoint()
    router = await open_zenoh(listen=[middle], mode="router")
    try:
        door = await bind_fleet_door(SITE, connect=[middle])
        async with door, gateway(3) as (_, service), trio.open_nursery() as nursery:
            nursery.start_soon(door.serve, service)
            async with open_fleet(connect=[middle]) as viewer:
                await seen(lambda: PLACE in viewer.nodes)
                assert (await viewer.read(NODE, 0x1001)).value == 0
            nursery.cancel_scope.cancel()
    finally:
        await close_zenoh(router)


@real_time
async def test_a_port_in_use_is_told_before_a_bus_is_opened() -> None:
    endpoint = free_endpoint()
    async with await bind_fleet_door(SITE, listen=[endpoint]):
        with pytest.raises(DoorError, match="cannot listen"):
            await bind_fleet_door("other", listen=[endpoint])


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:0", "tcp/[::]:0", "tcp/192.0.2.1:7447", "tls/0.0.0.0:0", "udp/example.org:7"])
@real_time
async def test_where_nobody_proves_who_he_is_other_computers_stay_out(endpoint: str) -> None:
    with pytest.raises(DoorError, match="reachable from other computers"):
        await bind_fleet_door(SITE, listen=[endpoint])


@real_time
async def test_a_configuration_without_endpoints_listens_nowhere(tmp_path: Path) -> None:
    """Zenoh alone would listen on every interface."""
    file = tmp_path / "plain.json5"
    file.write_text("{}")
    async with await bind_fleet_door(SITE, config=file) as door:
        assert door._zenoh.is_closed() is False


@real_time
async def test_two_buses_of_one_name_are_refused() -> None:
    async with await bind_fleet_door(SITE) as door:
        with pytest.raises(ValueError, match="would both be called 'a-b'"):
            door.names_of(["a:b", "a/b"])


@real_time
async def test_however_many_messages_wait_for_a_bridge_none_overtakes_another() -> None:
    """A stop that its client's next sign of life has overtaken would be refused as old, and the motion would go on."""
    refused: list[str] = []
    has_led = False
    async with fleet(3, allow="motion") as (viewer, served):
        lease = FleetLease(viewer, FleetPlace(SITE, BUS))

        async def say(do: str) -> None:
            try:
                await lease.say(do)
            except BridgeRefusedError as error:
                refused.append(error.failed)

        for _ in range(8):
            await say("take")
            has_led = has_led or served.service.lease.owner is not None
            async with trio.open_nursery() as nursery:
                for _ in range(3):
                    nursery.start_soon(say, "renew")
                await trio.lowlevel.checkpoint()  # they are sent
                time.sleep(0.1)
    assert has_led
    assert not [each for each in refused if "old message" in each]
