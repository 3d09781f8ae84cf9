"""A web door over simulated drives, in virtual time and without a socket: a client of its HTTP, and one of its WebSocket."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

import httpx
import jsonschema
import trio

from canopen_gateway import GatewayService, Limits
from canopen_gateway.web.api import WebApi, web_app
from canopen_gateway.web.guard import WebGuard
from canopen_gateway.web.live import LiveHub
from canopen_gateway.web.machine_subject import MachineSubject
from canopen_gateway.web.subject import WebSubject
from canopen_master import Host
from tests.gateway.gateway_world import gateway

TOKEN = "a-token-for-these-tests"
ORIGIN = "http://localhost:8402"
BEARER = {"authorization": f"Bearer {TOKEN}"}
COOKIE = {"cookie": f"canopen-8402={TOKEN}"}
BODIES = {"/nmt": {"command": "preoperational"}, "/{object}": {"value": 300}}
NAMES = ("127.0.0.1", "localhost", "[::1]")


@dataclass
class WebClients:
    """Clients of a web door. http: shows the token as a program does."""

    http: httpx.AsyncClient
    app: WebGuard

    async def get(self, path: str, **headers: str) -> Any:
        """The answer of a path below /api/v1, which has to be good."""
        answer = await self.http.get(f"/api/v1{path}", headers=headers)
        assert answer.status_code == 200, answer.text
        return answer.json()

    async def put(self, path: str, **body: Any) -> tuple[int, Any]:
        answer = await self.http.put(f"/api/v1{path}", json=body)
        return answer.status_code, answer.json()

    async def post(self, path: str) -> tuple[int, Any]:
        answer = await self.http.post(f"/api/v1{path}")
        return answer.status_code, answer.json()

    async def raw(
        self,
        method: str,
        path: str,
        receive: Callable[[], Any],
        took: Callable[[Any], None],
        hangs: bool = False,
        more: Iterable[tuple[bytes, bytes]] = (),
    ) -> None:
        """A request whose body comes as `receive` gives it. took: is given what the door sends. hangs: the client takes
        nothing of it. more: headers."""
        headers = [(b"host", b"localhost:8402"), (b"authorization", BEARER["authorization"].encode()), *more]
        scope = {
            "type": "http", "method": method, "path": path, "raw_path": path.encode(), "root_path": "", "query_string": b"",
            "headers": headers, "client": ("127.0.0.1", 5), "server": ("127.0.0.1", 8402), "scheme": "http",
            "asgi": {"version": "3.0"}, "http_version": "1.1",
        }  # fmt: skip

        async def take(message: Any) -> None:
            took(message)
            await (trio.sleep_forever() if hangs else trio.lowlevel.checkpoint())

        await self.app(scope, receive, take)

    @asynccontextmanager
    async def page(self, headers: dict[str, str] | None = None, *, reads: bool = True) -> AsyncIterator[PageClient]:
        """A client of the live channel. reads: it takes what is sent; else it hangs from its first message on."""
        client = PageClient(reads)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(client.serve, self.app, BEARER if headers is None else headers)
            await client.begun.wait()
            yield client
            client.leave()
            await client.ended.wait()


class PageClient:
    """The other end of a WebSocket. closed: the code with which the door closed it. messages: all that came, but pulses. delay:
    seconds that each message takes."""

    def __init__(self, reads: bool) -> None:
        self.begun, self.ended = trio.Event(), trio.Event()
        self.closed: int | None = None
        self.messages: list[dict[str, Any]] = []
        self.pulse: dict[str, Any] = {}
        self.delay = 0.0
        self._reads = reads
        self._came = trio.Condition()
        self._number = 0
        self._put, self._get = trio.open_memory_channel[dict[str, Any]](1000)
        self._put.send_nowait({"type": "websocket.connect"})

    async def serve(self, app: WebGuard, headers: dict[str, str]) -> None:
        pairs = [(name.encode(), value.encode()) for name, value in {"host": "localhost:8402", **headers}.items()]
        scope = {
            "type": "websocket", "path": "/api/v1/live", "raw_path": b"/api/v1/live", "root_path": "", "query_string": b"",
            "headers": pairs, "client": ("127.0.0.1", 5), "server": ("127.0.0.1", 8402), "subprotocols": [], "scheme": "ws",
            "asgi": {"version": "3.0"}, "http_version": "1.1", "extensions": {},
        }  # fmt: skip
        try:
            await app(scope, self._get.receive, self._take)  # type: ignore[arg-type]
        finally:
            self.begun.set()
            self.ended.set()

    async def _take(self, message: Any) -> None:
        if message["type"] == "websocket.close":
            self.closed = message.get("code", 1000)
        elif message["type"] == "websocket.send":
            if not self._reads:
                await trio.sleep_forever()
            if self.delay:
                await trio.sleep(self.delay)
            found = json.loads(message["text"])
            async with self._came:
                if found["k"] == "pulse":
                    self.pulse = found
                elif found["k"] != "nets":
                    self.messages.append(found)
                self._came.notify_all()
        else:
            self.begun.set()

    def say(self, kind: str, **fields: Any) -> None:
        self._put.send_nowait({"type": "websocket.receive", "text": json.dumps({"k": kind, **fields})})

    def say_bytes(self, data: bytes) -> None:
        self._put.send_nowait({"type": "websocket.receive", "bytes": data})

    def say_text(self, text: str) -> None:
        self._put.send_nowait({"type": "websocket.receive", "text": text})

    def move(self, kind: str, **fields: Any) -> None:
        """A message with the next number."""
        self._number += 1
        self.say(kind, n=self._number, **fields)

    def leave(self) -> None:
        self._put.send_nowait({"type": "websocket.disconnect", "code": 1001})

    async def heard(self, kind: str, fits: Callable[[dict[str, Any]], bool] = lambda message: True) -> dict[str, Any]:
        """The next message of a kind that was not taken yet."""
        with trio.fail_after(60):
            async with self._came:
                while True:
                    for message in self.messages:
                        if message["k"] == kind and fits(message):
                            self.messages.remove(message)
                            return message
                    await self._came.wait()

    async def until(self, fits: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """The next pulse that fits."""
        with trio.fail_after(60):
            async with self._came:
                self.pulse = {}
                while not self.pulse or not fits(self.pulse):
                    await self._came.wait()
                return self.pulse


@dataclass
class WebWorld(WebClients):
    """host: of the drives."""

    host: Host
    service: GatewayService
    hub: LiveHub
    nursery: trio.Nursery


@asynccontextmanager
async def web(
    *node_ids: int, allow: str = "", limits: Limits | None = None, beats: bool = True, **options: Any
) -> AsyncIterator[WebWorld]:
    """A web door over drives on a virtual bus. beats: the drives send heartbeats."""
    async with gateway(*node_ids, allow=allow, limits=limits, **options) as (host, service):
        with service.open_session("the web door") as session:
            async with page_over(MachineSubject(service, session)) as (hub, app, http, nursery):
                for node_id in node_ids if beats else ():
                    await service.node(service.nets[0], node_id).write("producer_heartbeat_time", 500)
                await trio.sleep(1.1)  # between two heartbeats: what is told is told, in whatever order tasks run
                yield WebWorld(http, app, host, service, hub, nursery)


@asynccontextmanager
async def page_over(subject: WebSubject) -> AsyncIterator[tuple[LiveHub, WebGuard, httpx.AsyncClient, trio.Nursery]]:
    """A web door over anything that it may show."""
    hub = LiveHub(subject, clock=lambda: 1000.0)
    app = WebGuard(web_app(WebApi(hub, "cell 7")), token=TOKEN, names=NAMES, port=8402)
    transport = httpx.ASGITransport(app)  # type: ignore[arg-type]
    async with httpx.AsyncClient(transport=transport, base_url=ORIGIN, headers=BEARER) as http, trio.open_nursery() as nursery:
        nursery.start_soon(hub.run)
        yield hub, app, http, nursery
        nursery.cancel_scope.cancel()


def real(path: str) -> str:
    """A path of the description, with a net, a node and an object."""
    return path.replace("{net}", "1").replace("{node}", "3").replace("{object}", "1017")


def body_of(method: str, path: str) -> dict[str, Any] | None:
    return BODIES[path[path.rindex("/") :]] if method == "PUT" else None


class Described:
    """A description in OpenAPI; it keeps which statuses of it have been seen. seen: by method and path."""

    def __init__(self, about: dict[str, Any]) -> None:
        self.about = about
        self.seen: dict[tuple[str, str], set[str]] = defaultdict(set)

    def statuses(self, method: str, path: str) -> set[str]:
        return set(self.about["paths"][path][method.lower()]["responses"])

    def check(self, method: str, path: str, status: int, kind: str, text: str) -> None:
        where = f"{method} {path}: {status} {kind} {text[:80]}"
        responses = self.about["paths"][path][method.lower()]["responses"]
        assert str(status) in responses, where
        content = responses[str(status)]["content"]
        kind = kind.partition(";")[0]
        assert kind in content, where
        if kind == "application/json":
            schema = {**content[kind]["schema"], "components": self.about["components"]}
            jsonschema.Draft202012Validator(schema).validate(json.loads(text))
        self.seen[method, path].add(str(status))

    async def ask(self, clients: WebClients, method: str, path: str, *, at: str = "", sent: str = "", **given: Any) -> int:
        """Ask for a path, and check the answer. at: the real path. sent: the method that is really sent."""
        answer = await clients.http.request(sent or method, at or real(path), **given)
        self.check(method, path, answer.status_code, answer.headers["content-type"], answer.text)
        return answer.status_code
