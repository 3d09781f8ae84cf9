"""The HTTP interface of the web door: paths below /api/v1, as openapi.py describes them.

In the spirit of CiA 309-5, without a claim to it.

Each request asks the service like any other client: its guard, its limits and its lease decide. An error is a JSON object,
{"error": {"code", "text", "details", ...}}, with a status that says whose it is: 400 the request, 403 not allowed, 404 not there,
409 refused by the device or by who moves the machine, 501 not over a fleet, 503 the gateway is full, 504 the device is silent.
"""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, TypeAlias

import trio
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket

from canopen_gateway.errors import (
    BRIDGE_REFUSED,
    GATEWAY_FULL,
    NO_SUCH_PLACE,
    NOT_ALLOWED,
    BridgeRefusedError,
    FleetError,
    GatewayError,
    GatewayFullError,
    LeaseError,
    NoSuchPlaceError,
    NotAllowedError,
    NotOverFleetError,
    first_line,
)
from canopen_gateway.nmt_words import nmt_command
from canopen_gateway.places import find_axis, find_node, json_said
from canopen_gateway.plain_data import Plain, error_data, view_data
from canopen_gateway.traffic.network_views import NetworkViews
from canopen_gateway.traffic.ring import CAPACITY
from canopen_gateway.traffic.trace import LONGEST, TrafficTrace, number_asked_for, whole_number_asked_for
from canopen_gateway.web.live import LiveClient, LiveHub
from canopen_gateway.web.metrics import METRICS_TYPE, metrics_text
from canopen_gateway.web.openapi import description
from canopen_gateway.web.page import page_files
from canopen_master import BusError, MasterClosedError, MasterError, SdoTimeoutError
from canopen_master.errors import NodeIsNoDriveError, UnknownChainError
from canopen_master.plain_text import clean, json_text
from canopen_proto import LocalProtocolError
from canopen_proto.abort import AbortCode
from canopen_proto.dictionary.model import ConstantNotFoundError, NotInDictionaryError
from canopen_proto.procedures import ProcedureError, SdoTransferError, StepTimeoutError

API: Final = "/api/v1"
OCTETS: Final = "application/octet-stream"
EVENTS_WAITING: Final = 64
"""Events that wait for one reader of the event stream; a slow one misses the rest."""
MOST_TRACES: Final = 2
"""Traces that are sent at a time: each holds a copy of its frames meanwhile."""
LOGGER: Final = logging.getLogger("canopen_gateway")
Handler: TypeAlias = "Callable[[WebApi, Request], Awaitable[Response]]"

_STATUS: Final[Sequence[tuple[type[Exception], int]]] = (
    (NotAllowedError, 403),
    (LeaseError, 409),
    (GatewayFullError, 503),
    (NoSuchPlaceError, 404),
    (NotOverFleetError, 501),
    (FleetError, 504),
    (NodeIsNoDriveError, 404),
    (UnknownChainError, 404),
    (BusError, 503),
    (MasterClosedError, 503),
    (MasterError, 409),
    (ProcedureError, 409),
    (ConstantNotFoundError, 400),  # the value, and not the path
    (NotInDictionaryError, 404),
    (LocalProtocolError, 400),
    (ValueError, 400),
    (GatewayError, 409),
)
_OF_BRIDGES: Final = {BRIDGE_REFUSED: 400, NOT_ALLOWED: 403, GATEWAY_FULL: 503, NO_SUCH_PLACE: 404}
"""Statuses of what a bridge refuses, by its code; 409 for any other."""


def status_of(error: Exception) -> int:
    """Return the HTTP status of an error; 500 for one that nobody foresaw."""
    if _is_silence(error):
        return 504
    if isinstance(error, BridgeRefusedError):
        return _OF_BRIDGES.get(error.bridge_code, 409)
    return next((status for kind, status in _STATUS if isinstance(error, kind)), 500)


def _is_silence(error: Exception) -> bool:
    """Return whether the device said nothing, or nobody knows what it did. A bridge, and a procedure, tell that by the abort
    code."""
    if isinstance(error, BridgeRefusedError | SdoTransferError):
        return error.abort_code == AbortCode.TIMED_OUT or error.not_confirmed
    return isinstance(error, SdoTimeoutError | StepTimeoutError)


class WebApi:
    """The handlers of the paths; see this module's text. hub: tells what is shown. site: the name of the place, for files."""

    def __init__(self, hub: LiveHub, site: str = "canopen") -> None:
        self.subject = hub.subject
        self.hub = hub
        self.site = site
        self._networks: NetworkViews | None = None  # made when it is asked for
        self._traces = 0  # that are being sent

    # ---- the machine ----

    async def state(self, request: Request) -> Response:
        """What is allowed, the chains, and who moves them."""
        return _json({"nets": list(self.subject.nets), "absent": self.subject.absent, **self.subject.state()})

    async def buses(self, request: Request) -> Response:
        """All nets, with their nodes."""
        return _json(self.hub.nets())

    async def nodes(self, request: Request) -> Response:
        """The nodes of a net."""
        return _json(self.subject.net_data(self._net(request))["nodes"])

    async def node(self, request: Request) -> Response:
        """One node."""
        return _json(self.subject.node_data(*self._node(request)))

    async def drive(self, request: Request) -> Response:
        """A drive: read, with the reasons why it does not move."""
        service = self.subject.machine("the view of an axis")
        axis = find_axis(request.query_params.get("axis", "0"))
        return _json(view_data(await service.look_at_drive(*self._node(request), axis)))

    async def about(self, request: Request) -> Response:
        """What a node says of itself: its device name (0x1008), and its drive, null if it is none. Silence is no error here."""
        return _json(await self.subject.about(*self._node(request)))

    async def scan(self, request: Request) -> Response:
        """Ask all node-IDs of a net for their device type: reading, which is open to all."""
        net = self._net(request)
        await self.subject.search(net)
        return _json(self.subject.net_data(net)["nodes"])

    async def chains(self, request: Request) -> Response:
        """The chains, and where their joints are."""
        return _json(self.subject.state()["chains"])

    async def lease(self, request: Request) -> Response:
        """Who moves the machine."""
        return _json(self.subject.state()["lease"])

    # ---- what passes on the bus ----

    async def network(self, request: Request) -> Response:
        """Who sends which PDO to whom on a net, how often it came, and how much of the bus each node takes. Nothing is sent."""
        service = self.subject.machine("who sends which PDO to whom")
        net = self._net(request)
        names = {each["node"]: clean(each["name"]) for each in self.subject.net_data(net)["nodes"]}
        number = service.nets.index(net) + 1
        self._networks = self._networks or NetworkViews(service.master)
        return _json(await self._networks.of(service.traffic(net), net, number, names))

    async def pdos(self, request: Request) -> Response:
        """The PDOs of a node, as the device itself tells them: it is asked, which everybody may."""
        service = self.subject.machine("the PDOs of a node, as the device tells them")
        net, node_id = self._node(request)
        found = await service.read_pdos(net, node_id)
        return _json([each.as_json(service.node(net, node_id).dictionary) for each in found.pdos])

    async def trace(self, request: Request) -> Response:
        """The last frames of a net, or of all nets, as a log of candump."""
        service = self.subject.machine("a trace of frames")
        nets = [self._net(request)] if "net" in request.path_params else service.nets
        seconds = number_asked_for(request.query_params.get("seconds", str(LONGEST)), 0.0, LONGEST, "seconds")
        frames = whole_number_asked_for(request.query_params.get("frames", "0"), 0, CAPACITY, "frames")
        if self._traces >= MOST_TRACES:
            raise GatewayFullError("traces at a time", MOST_TRACES)
        self._traces += 1
        try:
            traffic = {net: service.traffic(net) for net in nets}
            trace = await TrafficTrace.take(self.site, traffic, seconds=seconds, frames=frames)
        except BaseException:
            self._traces -= 1
            raise
        headers = {"content-disposition": f'attachment; filename="{trace.name}"'}
        return self._sent_trace(_chunks(trace), headers)

    def _sent_trace(self, chunks: AsyncIterator[bytes], headers: Mapping[str, str]) -> Response:
        """Return the answer that sends a trace, which counts until it has ended, in whatever way; it is counted already."""
        api = self

        class TraceResponse(StreamingResponse):
            async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
                try:
                    await super().__call__(scope, receive, send)
                finally:
                    api._traces -= 1

        return TraceResponse(chunks, media_type="text/plain; charset=us-ascii", headers=headers)

    # ---- objects ----

    async def objects(self, request: Request) -> Response:
        """The objects that a node has by its dictionary. ?search=: only those whose name or place has this text."""
        wanted = request.query_params.get("search", "").lower()
        rows = await self.subject.objects(*self._node(request))
        return _json([row for row in rows if wanted in f"{row['path']} {row['name']}".lower()])

    async def read(self, request: Request) -> Response:
        """The value of an object; its bytes alone for `Accept: application/octet-stream`."""
        data, shown = await self.subject.read(*self._node(request), request.path_params["object"])
        if request.headers.get("accept") == OCTETS:
            return Response(data, media_type=OCTETS)
        return _json(shown)

    async def write(self, request: Request) -> Response:
        """Write an object: {"value": ...}, a number, a text, a constant by its name; or its bytes as application/octet-stream."""
        node = self._node(request)
        place = await self.subject.may_write(*node, request.path_params["object"])
        is_bytes = request.headers.get("content-type", "").partition(";")[0] == OCTETS
        given = await request.body() if is_bytes else (await _body(request)).get("value")
        return _json({"written": await self.subject.write(*node, place, given)})

    # ---- commands ----

    async def nmt(self, request: Request) -> Response:
        """An NMT command to a node, or to all of a net: {"command": "start"}."""
        net = self._net(request)
        node_id = find_node(request.path_params["node"]) if "node" in request.path_params else 0
        word = (await _body(request)).get("command")
        await self.subject.nmt(net, nmt_command(word), node_id)
        return _json({"sent": word})

    async def halt(self, request: Request) -> Response:
        """Stop what moves: all, or a net. Everybody may, always."""
        net = self._net(request) if "net" in request.path_params else None
        return _json({"problems": await self.subject.halt(net)})

    # ---- streams, and about this interface ----

    async def events(self, request: Request) -> Response:
        """Events as they come, for scripts that only read (server-sent events). First come the last ones, marked by "past": all
        that are kept, or those after `Last-Event-ID`."""
        seen = self._number_of(request.headers.get("last-event-id", ""))
        return StreamingResponse(self._event_lines(seen), media_type="text/event-stream")

    def _number_of(self, event_id: str) -> int:
        """Return the number of an event by its id; 0 for one of another start of the door, or nonsense."""
        run, _, number = event_id.rpartition("-")
        if run != self.hub.run_name or not (number.isascii() and number.isdecimal() and len(number) < 16):
            return 0
        return int(number)

    async def _event_lines(self, seen: int) -> AsyncIterator[str]:
        """Yield the events after a number: those that are kept, then those that come. The numbers have no gap but what was
        dropped."""
        put, get = trio.open_memory_channel[tuple[int, str]](EVENTS_WAITING)

        def tell(text: str) -> None:
            if text.startswith('{"k": "event"'):
                try:
                    put.send_nowait((self.hub.told, text))
                except trio.WouldBlock:
                    LOGGER.debug("a reader of events is slow, and misses one")

        def lines(number: int, text: str) -> str:
            return f"id: {self.hub.run_name}-{number}\ndata: {text}\n\n"

        last = list(enumerate(self.hub.events, self.hub.told - len(self.hub.events) + 1))
        end = self.hub.listen(tell)
        try:
            for number, event in last:
                if number > seen:
                    yield lines(number, json_text({"k": "event", "past": True, **event}))
            yield ": now\n\n"
            async for number, text in get:
                yield lines(number, text)
        finally:
            end()

    async def openapi(self, request: Request) -> Response:
        """The description of all this."""
        return _json(description((method, path, handler.__doc__ or "") for method, path, handler in ROUTES))

    async def metrics(self, request: Request) -> Response:
        """Numbers for Prometheus."""
        return Response(metrics_text(self.subject.machine("numbers for Prometheus"), self.hub.counts), media_type=METRICS_TYPE)

    async def live(self, websocket: WebSocket) -> None:
        """Pulses, values and events; and the hand on the machine."""
        client = websocket.client
        name = "a page" if client is None else f"the page at {client.host}:{client.port}"
        try:
            with self.subject.open_client(name) as opened:
                await LiveClient(self.hub, opened, websocket).run()
        except GatewayFullError as error:
            await websocket.close(1013, first_line(error))

    def _net(self, request: Request) -> str:
        return self.subject.find_net(request.path_params["net"])

    def _node(self, request: Request) -> tuple[str, int]:
        return self._net(request), find_node(request.path_params["node"])


ROUTES: Final[Sequence[tuple[str, str, Handler]]] = (
    ("GET", f"{API}/state", WebApi.state),
    ("GET", f"{API}/buses", WebApi.buses),
    ("GET", f"{API}/chains", WebApi.chains),
    ("GET", f"{API}/lease", WebApi.lease),
    ("GET", f"{API}/events", WebApi.events),
    ("GET", f"{API}/trace", WebApi.trace),
    ("GET", f"{API}/openapi.json", WebApi.openapi),
    ("POST", f"{API}/halt", WebApi.halt),
    ("GET", f"{API}/{{net}}/nodes", WebApi.nodes),
    ("GET", f"{API}/{{net}}/network", WebApi.network),
    ("GET", f"{API}/{{net}}/trace", WebApi.trace),
    ("PUT", f"{API}/{{net}}/nmt", WebApi.nmt),
    ("POST", f"{API}/{{net}}/halt", WebApi.halt),
    ("POST", f"{API}/{{net}}/scan", WebApi.scan),
    ("GET", f"{API}/{{net}}/{{node}}", WebApi.node),
    ("GET", f"{API}/{{net}}/{{node}}/about", WebApi.about),
    ("GET", f"{API}/{{net}}/{{node}}/drive", WebApi.drive),
    ("GET", f"{API}/{{net}}/{{node}}/pdos", WebApi.pdos),
    ("GET", f"{API}/{{net}}/{{node}}/objects", WebApi.objects),
    ("PUT", f"{API}/{{net}}/{{node}}/nmt", WebApi.nmt),
    ("GET", f"{API}/{{net}}/{{node}}/objects/{{object}}", WebApi.read),
    ("PUT", f"{API}/{{net}}/{{node}}/objects/{{object}}", WebApi.write),
    ("GET", "/metrics", WebApi.metrics),
)
"""Method, path, handler. The first that fits serves."""


def web_app(api: WebApi) -> Starlette:
    """Return the application, without the guard that has to stand in front of it."""
    paths: dict[str, dict[str, Callable[[Request], Awaitable[Response]]]] = {}
    for method, path, handler in ROUTES:
        paths.setdefault(path, {})[method] = partial(handler, api)
    routes: list[Route | WebSocketRoute] = [
        Route(path, partial(_handled, handlers), methods=[*handlers]) for path, handlers in paths.items()
    ]
    routes.append(WebSocketRoute(f"{API}/live", api.live))
    for name, (content, kind) in page_files().items():
        routes.append(Route(f"/{name}", partial(_file, content, kind), methods=["GET"]))
    return Starlette(routes=routes, exception_handlers={HTTPException: _not_served})


async def _handled(handlers: Mapping[str, Callable[[Request], Awaitable[Response]]], request: Request) -> Response:
    """Serve a request; an error becomes an answer. The gateway and its master go on, whatever it is. handlers: by method."""
    try:
        return await handlers["GET" if request.method == "HEAD" else request.method](request)
    except Exception as error:
        status = status_of(error)
        if status == 500:
            LOGGER.exception("a request has failed: %s %s", request.method, request.url.path)
            return _json({"error": {"code": "", "text": "the gateway has failed at this request", "details": []}}, 500)
        return _json({"error": error_data(error)}, status)


async def _not_served(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 500
    text = {404: "there is no such path", 405: "this path has no such method"}.get(status, "it cannot be served")
    answer = _json({"error": {"code": "", "text": text, "details": [f"see: {API}/openapi.json"]}}, status)
    answer.headers.update((isinstance(error, HTTPException) and error.headers) or {})  # `Allow`
    return answer


async def _file(content: bytes, kind: str, request: Request) -> Response:
    return Response(content, media_type=kind)


def _json(data: Any, status: int = 200) -> Response:
    return Response(json_text(data), status, media_type="application/json")


async def _chunks(trace: TrafficTrace) -> AsyncIterator[bytes]:
    for chunk in trace.chunks():
        yield chunk
        await trio.lowlevel.checkpoint()


async def _body(request: Request) -> Plain:
    try:
        body = json_said(await request.body())
    except ValueError as error:
        raise ValueError(f"the body is no JSON that is understood: {error}") from None
    if not isinstance(body, dict):
        raise ValueError("the body has to be a JSON object")
    return body
