"""The web door over a fleet: two sites over Zenoh on loopback; what goes only if both allow it; and what is refused, in words."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import pytest
import trio

from canopen_data.descriptions import load_description
from canopen_gateway import FleetError, GatewayService, open_gateway, parse_permissions
from canopen_gateway.errors import GatewayFullError, LeaseError, NoSuchPlaceError, NotAllowedError
from canopen_gateway.fleet import Fleet, FleetDoor, FleetPlace, bind_fleet_door, open_fleet
from canopen_gateway.fleet.bridge import _refusal
from canopen_gateway.fleet.fleet import _refused
from canopen_gateway.fleet.joining import close_zenoh, open_zenoh
from canopen_gateway.fleet.keys import HALT, ROOT
from canopen_gateway.web.api import status_of
from canopen_gateway.web.fleet_subject import ABSENT, FleetSubject
from canopen_master import DeviceModel, open_master
from canopen_master.errors import sdo_error
from canopen_master.simulation.serving import SimulatedDevices, drive_maker, simulated_drives
from canopen_proto import LocalProtocolError, Network, Outbox, RemoteNode, SdoAborted
from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.machine import RequestId
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.procedures import ProcedureError, SdoTransferError
from tests.gateway.fleet_world import BUS, SITE, Bridge, bridge, free_endpoint, real_time, seen
from tests.gateway.web_world import Described, WebClients, body_of, page_over
from tests.master.world import drives

pytest.importorskip("zenoh", reason="the extra fleet is not installed")
NET = f"{SITE}:{BUS}"
SITE_BUS = f"{SITE}/{BUS}"


def aborted(code: int, origin: AbortOrigin, not_confirmed: bool = False) -> SdoAborted:
    return SdoAborted(3, RequestId(1), 0x1017, 0, code, origin, not_confirmed)


def errors_of(abort: SdoAborted) -> list[Exception]:
    """What becomes of an abort in a procedure, and in the master."""
    node = RemoteNode(Outbox(), 3, load_description("sample_io.eds").dictionary)
    return [SdoTransferError(abort, "writing"), sdo_error(Network(), node, "can0", abort, "writing", 0)]


ERRORS = [
    *errors_of(aborted(AbortCode.DEVICE_STATE, AbortOrigin.PEER)),
    *errors_of(aborted(AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT)),
    *errors_of(aborted(AbortCode.NO_SDO_CONNECTION, AbortOrigin.LOCAL, not_confirmed=True)),
    *errors_of(aborted(AbortCode.GENERAL_ERROR, AbortOrigin.CANCELLED)),
    ProcedureError("a drive did not do it"),
    NotAllowedError("nmt", "NMT stop"),
    GatewayFullError("requests at a time", 32),
    NoSuchPlaceError("there is no net 9"),
    LeaseError("somebody else moves the machine"),
    LocalProtocolError("a value that does not fit"),
]
"""What a request may end with, at a bridge as at the web door."""


@dataclass
class FleetPage(WebClients):
    """subject: what the page shows."""

    subject: FleetSubject
    fleet: Fleet

    async def net(self, **fields: Any) -> dict[str, Any]:
        """The one bus, once it is shown with these fields."""
        while True:
            found = await self.get("/buses")
            if found and all(found[0][name] == value for name, value in fields.items()):
                return dict(found[0])
            await trio.sleep(0.02)

    async def node(self, place: str, *, is_lost: bool = False) -> dict[str, Any]:
        """A node, once it is shown as lost, or as there."""
        net, _, node_id = place.rpartition("/")
        while True:
            nets = await self.get("/buses")
            for node in next((each["nodes"] for each in nets if each["name"] == net), ()):
                if node["node"] == int(node_id) and (node["state"] == "lost") is is_lost:
                    return dict(node)
            await trio.sleep(0.02)


@asynccontextmanager
async def page(*endpoints: str, allow: str = "") -> AsyncIterator[FleetPage]:
    async with open_fleet(connect=endpoints, patience=3) as fleet:
        subject = FleetSubject(fleet, parse_permissions(allow))
        async with page_over(subject) as (_, app, http, _):
            yield FleetPage(http, app, subject, fleet)


@asynccontextmanager
async def one_site(
    *node_ids: int, allow: str = "", bridge_allows: str = "", **options: Any
) -> AsyncIterator[tuple[FleetPage, Bridge]]:
    """A page over a bridge with these drives, all of which it has seen."""
    async with bridge(*node_ids, allow=bridge_allows, **options) as served, page(served.endpoint, allow=allow) as shown:
        await seen(lambda: [each.node_id for each in shown.fleet.nodes] == sorted(node_ids))
        await shown.net(allow=sorted(set(allow.split(",")) & set(bridge_allows.split(",")) - {""}), state="there")
        yield shown, served


@real_time
async def test_the_paths_over_a_fleet_answer_what_the_description_says() -> None:
    async with one_site(3, allow="write,nmt", bridge_allows="write,nmt") as (shown, _):
        described = Described(await shown.get("/openapi.json"))
        statuses: set[int] = set()
        for path, methods in described.about["paths"].items():
            for method in (each.upper() for each in methods if not path.endswith("/events")):  # which never ends
                statuses.add(await described.ask(shown, method, path, json=body_of(method, path)))
        assert statuses == {200, 501}


@real_time
async def test_objects_are_searched_and_read_with_their_words() -> None:
    async with one_site(3) as (shown, _):
        found = await shown.get(f"/{NET}/3/objects?search=statusword")
        assert [(each["path"], each["name"], each["type"]) for each in found] == [("6041:00", "statusword", "UNSIGNED16")]
        value = await shown.get("/1/3/objects/statusword")
        assert (value["path"], value["value"], value["hex"], value["late"]) == ("6041:00", 0x0240, "40 02", 0.0)
        about = await shown.get("/1/3/about")
        assert about["name"] == "Simulated Schunk Powerball joint"
        assert (about["drive"]["state"], about["problem"]) == ("switch on disabled", "")
        assert "it is not enabled" in str(about["drive"]["reasons"])
        missing = await shown.http.get("/api/v1/1/3/objects/2FFF")
        assert (missing.status_code, missing.json()["error"]["abort"]) == (409, "0x06020000")
        assert (await shown.get("/1/3/objects/Manufacturer Device Name"))["path"] == "1008:00"  # as in the web door
        for path in (f"/{NET}x/nodes", "/9/nodes", "/1/99", "/1/3/objects/no such thing", "/1/3/objects/Ger%C3%A4t"):
            assert (await shown.http.get(f"/api/v1{path}")).status_code == 404


@pytest.mark.parametrize(
    ("allow", "bridge_allows", "written"),
    [("", "write", False), ("write", "", False), ("nmt", "write", False), ("write", "write", True)],
)
@real_time
async def test_a_setting_is_written_only_if_the_page_and_the_bridge_both_allow_it(
    allow: str, bridge_allows: str, written: bool
) -> None:
    heard: list[str] = []
    async with one_site(3, allow=allow, bridge_allows=bridge_allows, heard=heard) as (shown, _):
        heard.clear()
        for name in ("1017:00", "producer_heartbeat_time", "Producer Heartbeat Time"):
            status, answer = await shown.put(f"/1/3/objects/{name}", value=1234)
            assert (status, written or answer["error"]["code"]) == ((200, True) if written else (403, answer["error"]["code"]))
            assert written or answer["error"]["code"] in ("CO150", "CO161")
        assert any(frame.startswith("603#2B1710") for frame in heard) is written
        assert (await shown.get("/1/3/objects/1017"))["value"] == (1234 if written else 0)


@real_time
async def test_a_value_that_fits_no_object_is_the_fault_of_who_asks_as_in_the_web_door() -> None:
    async with one_site(3, allow="write", bridge_allows="write") as (shown, _):
        for value in ("500", "soon", 70_000, 1.5, [1], None):
            status, answer = await shown.put("/1/3/objects/1017", value=value)
            assert status == 400, (value, answer)
        assert (await shown.put("/1/3/objects/1017", value="500"))[1]["error"]["text"].endswith("is 500 meant?")
        assert (await shown.put("/1/3/objects/1008", value="x"))[0] == 400  # read-only
        assert (await shown.put("/1/3/objects/2FFF", value=1))[0] == 404
        assert (await shown.http.get("/api/v1/1/3/objects/no_such_thing")).status_code == 404


@pytest.mark.parametrize("error", ERRORS, ids=repr)
def test_an_error_has_one_status_over_a_fleet_and_in_the_web_door(error: Exception) -> None:
    _, said, _ = _refusal(error, FleetPlace(SITE, BUS, 3))
    assert status_of(_refused(FleetPlace(SITE, BUS, 3), said)) == status_of(error)


@real_time
async def test_what_moves_is_never_written_whatever_the_bridge_allows() -> None:
    heard: list[str] = []
    async with one_site(3, allow="write", bridge_allows="write,motion", heard=heard) as (shown, _):
        heard.clear()
        for name in ("6040:00", "controlword"):
            status, answer = await shown.put(f"/1/3/objects/{name}", value=6)
            assert (status, answer["error"]["code"]) == (403, "CO150")
        assert not [frame for frame in heard if frame.startswith("603#2B40")]
    for never in ("motion", "lss", "write,motion"):
        with pytest.raises(ValueError, match="not over a fleet"):
            FleetSubject(None, parse_permissions(never))  # type: ignore[arg-type]


@real_time
async def test_nmt_commands_go_to_one_node_if_both_allow_them() -> None:
    async with one_site(3, allow="nmt", bridge_allows="nmt,write") as (shown, served):
        assert await shown.put("/1/3/nmt", command="start") == (200, {"sent": "start"})
        await seen(lambda: drives(served.host)[0].nmt.state is NmtState.OPERATIONAL)
        status, answer = await shown.put("/1/nmt", command="stop")
        assert (status, answer["error"]["code"]) == (501, "CO165")
        assert drives(served.host)[0].nmt.state is NmtState.OPERATIONAL


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", "/1/network"),
        ("GET", "/trace"),
        ("GET", "/1/trace"),
        ("GET", "/1/3/pdos"),
        ("GET", "/1/3/drive"),
        ("POST", "/1/scan"),
    ],
)
@real_time
async def test_what_needs_the_computer_with_the_bus_is_refused_with_a_code(method: str, path: str) -> None:
    async with one_site(3) as (shown, _):
        answer = await shown.http.request(method, f"/api/v1{path}")
        assert (answer.status_code, answer.json()["error"]["code"]) == (501, "CO165")
        assert "canopen serve web" in str(answer.json()["error"]["details"])
        assert (await shown.http.get("/metrics")).status_code == 501


@real_time
async def test_a_page_hears_what_is_absent_and_moves_nothing() -> None:
    async with one_site(3) as (shown, _), shown.page() as client:
        hello = await client.heard("hello")
        assert hello["absent"] == dict(ABSENT)
        assert (hello["mode"], hello["chains"], hello["lease"]["owner"]) == ("read-only", [], None)
        for kind in ("take", "enable", "jog", "move", "commission", "monitor"):
            client.move(kind, chain="arm", velocities=[1.0], net=1, node=3)
            error = await client.heard("error")
            assert (error["about"], error["code"]) == (kind, "CO165")
        client.say("dance")
        assert "no message of the kind" in (await client.heard("error"))["text"]


@real_time
async def test_values_come_by_their_pdo_and_all_others_are_read() -> None:
    device = DeviceModel(load_description("sample_io.eds").dictionary, node_id=5)
    async with bridge(makers=[device]) as served, page(served.endpoint) as shown, shown.page() as client:
        await shown.node(f"{SITE_BUS}/5")
        node = served.service.master.node(5, "sample_io.eds")
        await node.start()
        client.say("watch", objects=[[1, 5, "6000:01"], [NET, 5, "1001"], ["1", 5, "2FFF"]], period=0.01)
        found: dict[int, list[Any]] = {}
        while len(found) < 3:
            found |= {row[0]: row for row in (await client.heard("values"))["values"]}
        assert found[1][2:] == [0, "", 0.0]
        assert found[2][2] is None
        assert "refused reading 2FFF:00" in found[2][3]
        # From now on by its PDO: the bridge is asked no more
        reads: list[str] = []
        ask = shown.fleet.ask

        async def counted(place: FleetPlace, *rest: str, **more: Any) -> Any:
            reads.append("/".join(rest))
            return await ask(place, *rest, **more)

        shown.fleet.ask = counted  # type: ignore[method-assign]
        for number in range(1, 200):
            served.host.nodes[0].values[0x6000_01] = number % 100
            served.host.pump()
            rows = (await client.heard("values"))["values"]
            if any(row[0] == 0 and row[2] == number % 100 for row in rows) and "pdos" in reads:
                break
        assert "pdos" in reads
        # Of the nodes that are watched, and of no others
        assert set(shown.fleet._listening) == {"canopen/v1/*/*/status", f"canopen/v1/{SITE}/{BUS}/5/pdo/*"}
        client.say("watch", objects=[])
        await seen(lambda: set(shown.fleet._listening) == {"canopen/v1/*/*/status"})
        client.say("watch", objects=[[1, 5, "statusword"]])
        assert "is a number" in (await client.heard("error"))["text"]


class Site(NamedTuple):
    """A bridge over a bus of its own."""

    door: FleetDoor
    service: GatewayService
    drives: SimulatedDevices
    endpoint: str


@asynccontextmanager
async def site(
    name: str, node_id: int, *, endpoint: str = "", allow: str = "", make: Callable[[int, int], Any] = drive_maker
) -> AsyncIterator[Site]:
    """A site with one drive on one bus, virtual-NAME. make: makes it."""
    locator, endpoint = f"virtual:{name}", endpoint or free_endpoint()
    door = await bind_fleet_door(name, listen=[endpoint])
    async with (
        door,
        simulated_drives([(locator, node_id)], make=make) as simulated,
        open_master(locator) as master,
        open_gateway(master, allow=parse_permissions(allow)) as service,
        trio.open_nursery() as nursery,
    ):
        nursery.start_soon(door.serve, service)
        yield Site(door, service, simulated, endpoint)
        nursery.cancel_scope.cancel()


async def run_site(name: str, node_id: int, endpoint: str, task_status: trio.TaskStatus[trio.CancelScope]) -> None:
    """Run a site until the scope that it hands over is cancelled."""
    with trio.CancelScope() as scope:
        async with site(name, node_id, endpoint=endpoint):
            task_status.started(scope)
            await trio.sleep_forever()


THREE, FOUR = "hall/virtual-hall/3", "yard/virtual-yard/4"


@real_time
async def test_emergencies_of_all_sites_are_one_stream() -> None:
    async with (
        site("hall", 3) as hall,
        site("yard", 4) as yard,
        page(hall.endpoint, yard.endpoint) as shown,
        shown.page() as client,
    ):
        await shown.node(THREE, is_lost=False)
        await shown.node(FOUR, is_lost=False)
        hall.drives.raise_fault(3, 0x2310)
        yard.drives.raise_fault(4, 0x4310)
        told = [await client.heard("event", lambda event: event["kind"] == "emergency") for _ in range(2)]
        assert {(each["place"], each["code"]) for each in told} == {(THREE, "0x2310"), (FOUR, "0x4310")}
        assert (await shown.node(THREE))["emergency"]["code"] == "0x2310"


@real_time
async def test_a_site_that_is_lost_is_shown_as_lost_since_when_and_comes_back_under_its_number() -> None:
    endpoint = free_endpoint()
    async with site("yard", 4) as yard, trio.open_nursery() as nursery:
        end = await nursery.start(run_site, "hall", 3, endpoint)
        async with page(yard.endpoint, endpoint) as shown, shown.page() as client:
            await shown.node(THREE, is_lost=False)
            await shown.node(FOUR, is_lost=False)
            numbers = {each["name"]: each["net"] for each in await shown.get("/buses")}
            end.cancel()
            lost = await client.heard("event", lambda event: event["kind"] == "lost")
            assert (lost["place"], lost["node"]) == ("hall/virtual-hall", 0)
            node = await shown.node(THREE, is_lost=True)
            net = next(each for each in await shown.get("/buses") if each["name"] == "hall/virtual-hall")
            assert (net["state"], net["age"] >= 0, node["age"] >= 0) == ("lost", True, True)
            assert (await shown.node(FOUR))["state"] != "lost"
            refused = await shown.http.get("/api/v1/hall:virtual-hall/3/objects/1001")
            assert (refused.status_code, refused.json()["error"]["code"]) == (504, "CO160")
            assert await shown.post("/halt") == (200, {"problems": ["hall/virtual-hall is lost: nobody knows whether it stands"]})
            await nursery.start(run_site, "hall", 3, endpoint)
            await shown.node(THREE, is_lost=False)
            assert {each["name"]: each["net"] for each in await shown.get("/buses")} == numbers
            assert (await shown.get("/hall:virtual-hall/3/objects/1001"))["value"] == 0
            assert await shown.post("/halt") == (200, {"problems": []})
        nursery.cancel_scope.cancel()


@real_time
async def test_a_bridge_that_tells_nonsense_ends_no_page() -> None:
    """Keys of any shape, and bytes of any kind and length, from a program that may speak in the fleet."""
    async with site("hall", 3) as hall, page(hall.endpoint) as shown, shown.page() as client:
        await shown.node(THREE)
        client.say("watch", objects=[[1, 3, "1001"]])
        liar = await open_zenoh(connect=[hall.endpoint], mode="router")  # as a bridge
        try:
            places = "evil/b", "evil/b/5", "evil/b/200", "<b>/x/1", "EVIL/b/1", "evil/b/5/6/7"
            tokens = [liar.liveliness().declare_token(f"{ROOT}/{place}/alive") for place in places]
            await seen(lambda: "evil/b" in shown.subject.nets)
            deep, wrong = b'{"nodes":' * 5000, b'{"nodes": {"5": []}, "names": 7, "allow": "write"}'
            keys = (
                "evil/b/status",
                "evil/b/5/nmt",
                "evil/b/5/emcy",
                "evil/b/5/pdo/1",
                "evil/b/5/pdo/0",
                "hall/virtual-hall/99/nmt",
            )
            for data in (b"", b"\xff" * 7, b"null", b"[1]", deep, wrong, bytes(1 << 20)):
                for key in keys:
                    liar.put(f"{ROOT}/{key}", data, attachment=data[:100])
            status = json.dumps(
                {"nodes": {"5": "OPERATIONAL"}, "names": {"5": "<b>elbow\x1b</b>"}, "allow": ["write", 7], "outage": ""}
            )
            names = []
            while "<b>elbow\\x1b</b>" not in names:
                liar.put(f"{ROOT}/evil/b/status", status)
                await trio.sleep(0.05)
                names = [node["name"] for net in await shown.get("/buses") for node in net["nodes"]]
            silent = await shown.http.get("/api/v1/evil:b/5/objects/1001")
            assert (silent.status_code, silent.json()["error"]["code"]) == (504, "CO160")
            assert (await shown.get("/hall:virtual-hall/3/objects/1001"))["value"] == 0
            await client.heard("values")
            hall.drives.raise_fault(3, 0x2310)
            await client.heard("event", lambda event: event.get("code") == "0x2310" and event["place"] == THREE)
            assert {each["name"] for each in await shown.get("/buses")} == {"hall/virtual-hall", "evil/b"}
            assert len(tokens) == len(places)
        finally:
            await close_zenoh(liar)


@real_time
async def test_a_page_that_hangs_holds_up_neither_another_page_nor_a_halt() -> None:
    async with site("hall", 3) as hall, page(hall.endpoint) as shown, shown.page(reads=False), shown.page() as client:
        await shown.node(THREE)
        client.say("watch", objects=[[1, 3, "1001"]])
        for code in (0x2310, 0x4310):
            hall.drives.raise_fault(3, code)
            await client.heard("event", lambda event, code=code: event.get("code") == f"0x{code:04X}")
        await client.heard("values")
        client.say("halt")
        assert (await client.heard("halted"))["problems"] == []


@real_time
async def test_a_halt_names_who_did_not_answer() -> None:
    async with site("hall", 3) as hall, site("yard", 4) as yard, page(hall.endpoint, yard.endpoint) as shown:
        await seen(lambda: len(shown.fleet.nodes) == 2)

        async def hangs(*_: Any) -> list[str]:
            await trio.sleep_forever()
            raise AssertionError

        yard.service.halt = hangs  # type: ignore[method-assign]
        assert await shown.post("/halt") == (200, {"problems": ["yard/virtual-yard did not answer"]})
        assert await shown.post("/hall:virtual-hall/halt") == (200, {"problems": []})


@real_time
async def test_a_viewer_takes_no_answer_of_two_sites_of_one_name_for_that_of_one() -> None:
    async with (
        site("hall", 3, allow="write,nmt,motion") as one,
        site("hall", 3, allow="write,nmt,motion") as other,
        open_fleet(connect=(one.endpoint, other.endpoint)) as viewer,
    ):
        bus, node = FleetPlace("hall", "virtual-hall"), FleetPlace("hall", "virtual-hall", 3)
        while len(await viewer.ask(bus, HALT)) != 2:  # both are there
            await trio.sleep(0.05)
        for ask, changes in (
            (lambda: viewer.read(node, 0x1000), False),
            (lambda: viewer.status(bus), False),
            (lambda: viewer.objects(node), False),
            (lambda: viewer.write(node, 0x1017, 1), True),
            (lambda: viewer.nmt(node, NmtCommand.STOP), True),
        ):
            with pytest.raises(FleetError, match="several bridges have the name hall/virtual-hall") as told:
                await ask()
            assert ("each of them may have done it" in told.value.failed) is changes
        assert set(await viewer.halt(bus)) == {bus}


@real_time
async def test_two_sites_of_one_name_are_told_and_a_halt_says_that_one_answer_is_not_enough() -> None:
    async with (
        site("hall", 3, allow="write,nmt") as one,
        site("hall", 4, allow="write,nmt") as other,
        page(one.endpoint, other.endpoint, allow="write,nmt") as shown,
    ):
        await seen(lambda: bool(shown.subject.picture.twins(shown.subject.now())))
        assert "several bridges have this name" in (await shown.net())["outage"]
        for status, answer in (await shown.put("/1/3/objects/1017", value=1), await shown.put("/1/3/nmt", command="stop")):
            assert (status, "nothing was sent" in answer["error"]["text"]) == (409, True)

        async def hangs(*_: Any) -> list[str]:
            await trio.sleep_forever()
            raise AssertionError

        other.service.halt = hangs  # type: ignore[method-assign]
        (problem,) = (await shown.post("/halt"))[1]["problems"]
        assert problem.startswith("hall/virtual-hall: several bridges have this name")
