"""The HTTP interface of the web door, in virtual time."""

from __future__ import annotations

import json
import re
from typing import Any

import trio

from canopen_gateway import Limits
from canopen_gateway.traffic.ring import CAPACITY
from canopen_gateway.web.api import MOST_TRACES, ROUTES
from canopen_gateway.web.guard import LEFT_SECONDS, SEND_SECONDS
from canopen_gateway.web.live import LOG_LENGTH
from canopen_proto.abort import AbortCode
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND
from canopen_proto.simulation.drive.answers import Answer
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.servo import DriveSettings
from canopen_transports import open_transport
from tests.gateway.web_world import WebWorld, web
from tests.master.world import BUS, arm_of, drives, virtual_time


@virtual_time
async def test_nodes_with_their_states_in_words() -> None:
    async with web(3, 4, allow="nmt") as world:
        assert [each["node"] for each in await world.get("/1/nodes")] == [3, 4]
        assert await world.put("/1/3/nmt", command="start") == (200, {"sent": "start"})
        await trio.sleep(1)
        three, four = (await world.get("/buses"))[0]["nodes"]
        assert (three["state"], four["state"]) == ("operational", "pre-operational")
        assert three["heard"] == "heartbeat"
        assert 0 <= three["age"] < 1
        arm_of(world.service.master, 3, 4)
        assert (await world.get(f"/{BUS}/4"))["name"] == "joint2"
        assert (await world.get("/chains"))[0]["joints"][1]["name"] == "joint2"
        assert (await world.get("/lease"))["owner"] is None


@virtual_time
async def test_a_search_finds_nodes_that_say_nothing_by_themselves() -> None:
    async with web(3, 77, beats=False) as world:
        assert await world.get("/1/nodes") == []
        status, found = await world.post("/1/scan")
        assert (status, [each["node"] for each in found]) == (200, [3, 77])
        assert found[0]["state"] == "not heard"
        assert [each["node"] for each in await world.get("/1/nodes")] == [3, 77]


@virtual_time
async def test_objects_are_found_read_and_written() -> None:
    async with web(3, allow="write") as world:
        found = await world.get("/1/3/objects?search=HEARTBEAT")
        assert {"1017:00", "1016:01"} <= {each["path"] for each in found}
        assert len(await world.get("/1/3/objects")) > 50
        word = await world.get("/1/3/objects/statusword")
        assert (word["value"], word["constants"], word["hex"]) == (576, ["switch_on_disabled", "remote"], "40 02")
        assert await world.put("/1/3/objects/0x1017", value=300) == (200, {"written": "2c 01"})
        assert (await world.get("/1/3/objects/1017:00"))["value"] == 300
        raw = await world.http.get("/api/v1/1/3/objects/1017", headers={"accept": "application/octet-stream"})
        assert raw.content == b"\x2c\x01"
        path = "/api/v1/1/3/objects/1017"
        written = await world.http.put(path, content=b"\xc8\x00", headers={"content-type": "application/octet-stream"})
        assert written.status_code == 200
        assert (await world.get("/1/3/objects/1017"))["value"] == 200


async def ask_and_leave(world: WebWorld, method: str, path: str, body: bytes = b"") -> list[dict[str, object]]:
    """A client that closes its end after 0.1 s. Returns what was sent to it."""
    sent: list[dict[str, object]] = []
    messages = [{"type": "http.request", "body": body, "more_body": False}]

    async def receive() -> dict[str, object]:
        if not messages:
            await trio.sleep(0.1)
            return {"type": "http.disconnect"}
        return messages.pop()

    await world.raw(method, path, receive, sent.append)
    return sent


@virtual_time
async def test_a_client_that_half_closes_has_its_answer() -> None:
    async with web(3) as world:
        drives(world.host)[0].answer(0x1000, 0, Answer(delay=300 * MILLISECOND))
        start, _ = await ask_and_leave(world, "GET", "/api/v1/1/3/objects/1000")
        assert start["status"] == 200


@virtual_time
async def test_what_nobody_waits_for_any_more_is_not_asked_of_a_silent_node() -> None:
    async with web(3) as world, trio.open_nursery() as nursery:
        for _ in range(30):  # a program that gives up before the gateway does, and tries again
            nursery.start_soon(ask_and_leave, world, "GET", "/api/v1/1/99/objects/1000")
        await trio.sleep(0.2 + LEFT_SECONDS)
        many = Limits().requests
        found: list[int] = []

        async def ask() -> None:
            found.append((await world.http.get("/api/v1/1/3/objects/1000")).status_code)

        async with trio.open_nursery() as clients:
            for _ in range(many):
                clients.start_soon(ask)
        assert found == [200] * many


@virtual_time
async def test_a_write_is_done_though_its_client_is_gone() -> None:
    async with web(3, allow="write") as world:
        drives(world.host)[0].answer(0x1017, 0, Answer(delay=300 * MILLISECOND))
        await ask_and_leave(world, "PUT", "/api/v1/1/3/objects/1017", b'{"value": 700}')
        assert drives(world.host)[0].values[0x1017_00] == 700


class BusyDrive(DriveNode):
    """A drive that refuses to tell its first PDO."""

    def read(self, index: int, subindex: int, now: int) -> Any:
        return AbortCode.DEVICE_STATE if index == 0x1400 else super().read(index, subindex, now)


@virtual_time
async def test_a_node_that_refuses_is_not_told_as_silent() -> None:
    async with web(makers=[lambda out: BusyDrive(out, 4, DriveSettings())]) as world:
        answer = await world.http.get("/api/v1/1/4/pdos")
        assert (answer.status_code, answer.json()["error"]["abort"]) == (409, "0x08000022")
        assert (await world.http.get("/api/v1/1/99/pdos")).status_code == 504


@virtual_time
async def test_what_is_wrong_silent_or_refused_says_so() -> None:
    async with web(3, allow="write") as world:

        async def refused(path: str) -> tuple[int, str]:
            answer = await world.http.get(f"/api/v1{path}")
            return answer.status_code, answer.json()["error"]["code"]

        assert await refused("/7/nodes") == (404, "CO162")
        assert await refused("/1/128/objects/1000") == (404, "CO162")
        assert await refused("/1/3/objects/no_such_thing") == (404, "")
        assert await refused("/1/3/objects/2FFF:00") == (409, "CO202")
        assert (await world.http.get("/api/v1/1/3/objects/2FFF")).json()["error"]["abort"] == "0x06020000"
        assert (await refused("/1/99/objects/1000"))[0] == 504
        assert await refused("/1/99/drive") == (504, "")
        assert await refused("/nothing") == (404, "")
        for body in ({"value": 70_000}, {"value": None}, {"value": "no_constant"}, {}, {"value": [1]}, {"value": 1.5}):
            status, answer = await world.put("/1/3/objects/1017", **body)
            assert status in (400, 404), (body, answer)
        assert (await world.put("/1/3/objects/1008", value="x"))[0] == 400  # read-only
        for text in ("", "[]", "{", "[" * 40_000, "nul"):
            assert (await world.http.put("/api/v1/1/3/objects/1017", content=text)).status_code == 400
        assert (await world.http.delete("/api/v1/1/3/objects/1017")).status_code == 405
        assert (await world.put("/1/3/nmt", command="start"))[0] == 403


@virtual_time
async def test_a_number_given_as_text_is_refused_with_the_number_that_may_be_meant() -> None:
    async with web(3, allow="write") as world:
        before = (await world.get("/1/3/objects/1017"))["value"]
        for text in ("500", "0x1F4"):
            status, answer = await world.put("/1/3/objects/1017", value=text)
            assert status == 400
            assert answer["error"]["text"].endswith("a number is expected; is 500 meant?")
        assert (await world.put("/1/3/objects/1017", value="soon"))[0] == 400
        for text, said in {
            '{"value": 1e999}': "1e999 is too large",
            '{"value": 1e-999}': "1e-999 is too small",
            '{"value": 1, "value": 2}': "'value' stands twice",
            '{"value": Infinity}': "finite number",
            '{"value": NaN}': "finite number",
        }.items():
            answer = await world.http.put("/api/v1/1/3/objects/1017", content=text, headers={"x-canopen": "1"})
            assert (answer.status_code, said in answer.json()["error"]["text"]) == (400, True), answer.text
        assert (await world.get("/1/3/objects/1017"))["value"] == before


@virtual_time
async def test_a_drive_and_why_it_does_not_move() -> None:
    async with web(3) as world:
        drive = await world.get("/1/3/drive")
        assert drive["state"] == "switch on disabled"
        assert drive["reasons"][0] == {"what": "it is not enabled: switch on disabled", "remedy": "enable it"}


@virtual_time
async def test_an_axis_that_no_node_has_is_refused_by_the_axes_that_there_are() -> None:
    async with web(3) as world:
        for text in ("x", "-1", "8", "300", "", "1.0", "%C2%B2"):
            answer = await world.http.get(f"/api/v1/1/3/drive?axis={text}")
            assert answer.status_code == 400, text
            assert "a node has the axes 0 to 7" in answer.json()["error"]["text"]
        axis = (await world.get("/openapi.json"))["paths"]["/api/v1/{net}/{node}/drive"]["get"]["parameters"][-1]
        assert axis["schema"] == {"type": "integer", "minimum": 0, "maximum": 7}


@virtual_time
async def test_a_gateway_that_is_full_says_503() -> None:
    async with web(3, limits=Limits(requests=1)) as world, trio.open_nursery() as nursery:
        nursery.start_soon(world.http.get, "/api/v1/1/99/objects/1000")
        await trio.sleep(0.01)
        answer = await world.http.get("/api/v1/1/3/objects/1000")
        assert (answer.status_code, answer.json()["error"]["code"]) == (503, "CO151")


@virtual_time
async def test_an_error_that_nobody_foresaw_ends_one_request_alone() -> None:
    async with web(3) as world:

        def broken() -> None:
            raise ZeroDivisionError("secret")

        world.hub.subject.state = broken  # type: ignore[assignment,method-assign]
        answer = await world.http.get("/api/v1/state")
        assert answer.status_code == 500
        assert "secret" not in answer.text
        assert await world.get("/1/nodes")


@virtual_time
async def test_the_description_has_all_paths_and_each_is_served() -> None:
    async with web(3, allow="write,nmt") as world:
        about = await world.get("/openapi.json")
        assert about["openapi"].startswith("3.1")
        described = {(method.upper(), path) for path, methods in about["paths"].items() for method in methods}
        assert described == {(method, path) for method, path, _ in ROUTES}
        for path, methods in about["paths"].items():
            for method, operation in methods.items():
                assert operation["summary"]
                names = {each["name"] for each in operation["parameters"] if each["in"] == "path"}
                assert names == set(re.findall(r"{(\w+)}", path))
                if "events" in path:
                    continue  # it never ends
                real = path.replace("{net}", "1").replace("{node}", "3").replace("{object}", "1017")
                body = {"value": 300, "command": "start"} if method == "put" else None
                answer = await world.http.request(method, real, json=body)
                assert answer.status_code == 200, (path, answer.text)


class EventReader:
    """A reader of the event stream, as a browser's EventSource is one. events: id and data of each. heads: the answer's."""

    def __init__(self, text: str = "") -> None:
        self.events: list[tuple[str, dict[str, Any]]] = []
        self._asked = False
        self._last = [(b"last-event-id", text.encode())] if text else []

    async def run(self, world: WebWorld) -> None:
        await world.raw("GET", "/api/v1/events", self._ask, self._took, more=self._last)

    async def _ask(self) -> dict[str, object]:
        if self._asked:
            await trio.sleep_forever()
        self._asked = True
        return {"type": "http.request", "body": b"", "more_body": False}

    def _took(self, message: Any) -> None:
        for block in bytes(message.get("body", b"")).decode().split("\n\n"):
            fields = dict(line.split(": ", 1) for line in block.splitlines() if not line.startswith(":"))
            if fields:
                assert fields.keys() == {"id", "data"}
                self.events.append((fields["id"], json.loads(fields["data"])))

    def codes(self) -> list[str]:
        return [data["code"] for _, data in self.events if "code" in data]


async def emergency(code: int) -> None:
    """An emergency of node 3, which is told."""
    async with await open_transport(BUS) as wire:
        await wire.send(Frame(0x83, code.to_bytes(2, "little") + bytes(6)))
    await trio.sleep(0.1)


@virtual_time
async def test_events_as_a_stream_tell_the_last_ones_first_and_mark_them_as_past() -> None:
    """Server-sent events: `curl -N`."""
    async with web(3) as world, trio.open_nursery() as nursery:
        world.hub.events.clear()
        await emergency(0x2310)
        reader = EventReader()
        nursery.start_soon(reader.run, world)
        await trio.sleep(0.1)
        await emergency(0x3210)
        told = [(each, data["code"], data.get("past", False)) for each, data in reader.events if "code" in data]
        assert [each[1:] for each in told] == [("0x2310", True), ("0x3210", False)]
        assert len({each for each, _, _ in told}) == 2
        nursery.cancel_scope.cancel()


@virtual_time
async def test_a_reader_that_comes_again_is_told_what_it_has_missed_and_nothing_twice() -> None:
    async with web(3) as world, trio.open_nursery() as nursery:
        world.hub.events.clear()
        first = EventReader()
        nursery.start_soon(first.run, world)
        await trio.sleep(0.1)
        for code in (0x2310, 0x2311, 0x2312):
            await emergency(code)
        assert first.codes() == ["0x2310", "0x2311", "0x2312"]
        seen = first.events[1][0]
        for text, expected in (
            (seen, ["0x2312"]),
            (first.events[-1][0], []),
            ("", first.codes()),
            (f"another-run-{seen}", first.codes()),  # of an earlier start of the door, or nonsense
            ("2", first.codes()),
            (seen + "9" * 5000, first.codes()),
        ):
            again = EventReader(text)
            nursery.start_soon(again.run, world)
            await trio.sleep(0.1)
            assert again.codes() == expected, text[:40]
        await emergency(0x2313)
        assert again.codes()[-1] == "0x2313"
        nursery.cancel_scope.cancel()


@virtual_time
async def test_events_that_are_kept_no_longer_leave_a_gap_in_the_ids() -> None:
    async with web(3) as world, trio.open_nursery() as nursery:
        world.hub.events.clear()
        for code in range(LOG_LENGTH + 7):
            world.hub._tell_event(BUS, {"node": 3, "kind": "emergency", "code": str(code)})
        oldest = EventReader()
        nursery.start_soon(oldest.run, world)
        await trio.sleep(0.1)
        numbers = [int(each.rpartition("-")[2]) for each, _ in oldest.events]
        assert len(numbers) == LOG_LENGTH
        assert numbers == list(range(numbers[0], numbers[0] + LOG_LENGTH))
        run = oldest.events[0][0].rpartition("-")[0]
        again = EventReader(f"{run}-{numbers[0] - 3}")
        nursery.start_soon(again.run, world)
        await trio.sleep(0.1)
        assert again.events == oldest.events
        nursery.cancel_scope.cancel()


@virtual_time
async def test_metrics_for_prometheus() -> None:
    from prometheus_client.parser import text_string_to_metric_families

    async with web(3, 4, allow="write") as world:
        arm_of(world.service.master, 3, 4)
        await world.get("/1/3/objects/1000")
        await world.http.get("/api/v1/1/99/objects/1000")
        wire = await open_transport(BUS)
        await wire.send(Frame(0x83, b"\x10\x23\x03\0\0\0\0\0"))
        await wire.aclose()
        await trio.sleep(0.1)
        answer = await world.http.get("/metrics")
        assert answer.headers["content-type"].startswith("text/plain")
        found = {}
        for family in text_string_to_metric_families(answer.text):
            for sample in family.samples:
                found[sample.name, *(value for _, value in sorted(sample.labels.items()))] = sample.value
        assert found["canopen_bus_bits_total", BUS] > 0
        assert found["canopen_bus_state", BUS, "error-active"] == 1
        assert found["canopen_node_state", BUS, "3", "pre-operational"] == 1
        assert found["canopen_node_emergency", BUS, "3"] == 0x2310
        assert found["canopen_events_total", "emergency", BUS, "3"] == 1
        assert found["canopen_request_failures_total", BUS] == 1
        assert found["canopen_request_seconds_count", BUS] == 2
        assert found["canopen_request_seconds_bucket", "0.5", BUS] <= found["canopen_request_seconds_bucket", "+Inf", BUS]
        assert found["canopen_chain_missed_cycles_total", "arm"] == 0
        assert (await world.http.get("/metrics", headers={"authorization": ""})).status_code == 401


def misfits(value: Any, schema: dict[str, Any], schemas: dict[str, Any], where: str = "") -> list[str]:
    """Where a value is not what its JSON schema says, as far as ours go."""
    if "$ref" in schema:
        return misfits(value, schemas[schema["$ref"].rpartition("/")[2]], schemas, where)
    if "anyOf" in schema:
        return [] if any(not misfits(value, each, schemas) for each in schema["anyOf"]) else [where]
    kinds = {"string": str, "integer": int, "number": (int, float), "null": type(None), "array": list, "object": dict}
    if not isinstance(value, kinds[schema["type"]]):
        return [f"{where}: {value!r} is no {schema['type']}"]
    if schema["type"] == "array":
        parts = [(f"{where}/{number}", each, schema["items"]) for number, each in enumerate(value)]
    elif schema["type"] == "object":
        if not set(value) == set(schema["properties"]) == set(schema["required"]):
            return [f"{where}: {sorted(value)}"]
        parts = [(f"{where}/{name}", each, schema["properties"][name]) for name, each in value.items()]
    else:
        parts = []
    return [wrong for part, each, its in parts for wrong in misfits(each, its, schemas, part)]


@virtual_time
async def test_the_network_is_what_its_description_says() -> None:
    async with web(3, 4) as world:
        arm = arm_of(world.service.master, 3, 4)
        await arm.initialise()
        await arm.follow()
        await trio.sleep(2)
        described = await world.get("/openapi.json")
        answer = described["paths"]["/api/v1/{net}/network"]["get"]["responses"]["200"]["content"]["application/json"]["schema"]
        found = await world.get("/1/network")
        schemas = described["components"]["schemas"]
        assert misfits(found, answer, schemas) == []
        assert misfits({**found, "net": "1"}, answer, schemas)  # the check itself finds what is wrong
        assert misfits({**found, "pdos": [{}]}, answer, schemas)
        assert [each["node"] for each in found["nodes"]] == [3, 4, 127, 0]  # 127: the master's own heartbeat
        assert found["nodes"][2]["name"] == "this master"
        assert found["pdos"]
        assert (await world.http.get("/api/v1/9/network")).status_code == 404
        pdos = await world.get("/1/3/pdos")
        assert {each["pdo"] for each in pdos} >= {"TPDO 1", "RPDO 1"}
        assert (await world.get("/1/network"))["nodes"][0]["pdos"] == "the device"
        assert (await world.http.get("/api/v1/1/99/pdos")).status_code == 504


@virtual_time
async def test_a_search_adds_to_the_network_only_nodes_that_are_there() -> None:
    async with web(3, 77, beats=False) as world:
        await world.post("/1/scan")
        assert [each["node"] for each in (await world.get("/1/network"))["nodes"] if each["name"] != "this master"] == [3, 77, 0]
        await trio.sleep(5)
        assert [each["node"] for each in (await world.get("/1/network"))["nodes"] if each["name"] != "this master"] == [3, 77, 0]


@virtual_time
async def test_a_node_that_only_ever_sent_one_frame_stays_in_the_network() -> None:
    async with web(3) as world:
        async with await open_transport(BUS) as wire:
            await wire.send(Frame(0x1D5, b"\x01"))  # a TPDO of node 0x55
        await trio.sleep(5)
        nodes = {each["node"]: each for each in (await world.get("/1/network"))["nodes"]}
        assert nodes[0x55]["frames_per_second"] == 0


@virtual_time
async def test_a_trace_is_taken_away_and_odd_numbers_are_refused() -> None:
    async with web(3) as world:
        await world.get("/1/3/objects/1000")
        for path in ("/api/v1/1/trace", "/api/v1/trace?seconds=3600&frames=5"):
            answer = await world.http.get(path)
            assert answer.status_code == 200
            name = answer.headers["content-disposition"]
            assert re.fullmatch(r'attachment; filename="cell-7-[\w.-]+-\d{8}T\d{6}Z\.log"', name), name
            assert " 603#4000100000000000 T\n" in answer.text
            assert answer.headers["content-type"].startswith("text/plain")
            assert answer.headers["content-security-policy"]
        assert answer.text.count("\n") == 5
        await trio.sleep(0.1)
        assert (await world.http.get("/api/v1/trace?seconds=0")).text == ""
        odd = ["seconds=-1", "seconds=nan", "seconds=inf", "seconds=1e400", "seconds=", f"seconds={'1' * 900}"]
        for query in (*odd, "frames=-1", f"frames={CAPACITY + 1}", "frames=x", "frames=1.5", "frames=1e2"):
            assert (await world.http.get(f"/api/v1/trace?{query}")).status_code == 400, query


@virtual_time
async def test_so_many_traces_at_a_time_and_a_client_that_takes_none_is_cut_off() -> None:
    async with web(3) as world, trio.open_nursery() as nursery:
        await world.get("/1/3/objects/1000")
        cut: list[BaseException] = []

        async def hang() -> None:
            async def ask() -> dict[str, object]:
                await trio.sleep_forever()
                return {}

            asked = [{"type": "http.request", "body": b"", "more_body": False}]

            async def receive() -> dict[str, object]:
                return asked.pop() if asked else await ask()

            try:
                await world.raw("GET", "/api/v1/1/trace", receive, lambda message: None, hangs=True)
            except* trio.TooSlowError as group:
                cut.extend(group.exceptions)

        for _ in range(MOST_TRACES):
            nursery.start_soon(hang)
        await trio.sleep(1)
        refused = await world.http.get("/api/v1/1/trace")
        assert (refused.status_code, refused.json()["error"]["code"]) == (503, "CO151")
        await trio.sleep(SEND_SECONDS)
        assert len(cut) == MOST_TRACES
        assert (await world.http.get("/api/v1/1/trace")).status_code == 200
