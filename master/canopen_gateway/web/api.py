"""The HTTP interface of the web door: paths below /api/v1, as openapi.py describes them.

In the spirit of CiA 309-5, without a claim to it.

Each request asks the service like any other client: its guard, its limits and its lease decide. An error is a JSON object,
{"error": {"code", "text", "details", ...}}, with a status that says whose it is: 400 the request, 403 not allowed, 404 not there,
409 refused by the device or by who moves the machine, 503 the gateway is full, 504 the device is silent.
"""

from __future__ import annotations

import json
import logging
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from functools import partial
from typing import Any, Final, TypeAlias

import trio
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from canopen_gateway.errors import GatewayError, GatewayFullError, LeaseError, NoSuchPlaceError, NotAllowedError
from canopen_gateway.nmt_words import nmt_command
from canopen_gateway.places import find_net, find_node, find_object
from canopen_gateway.plain_data import (
    Plain,
    chain_data,
    error_data,
    first_line,
    lease_data,
    net_data,
    node_data,
    object_data,
    value_data,
    view_data,
)
from canopen_gateway.service import GatewayService, GatewaySession
from canopen_gateway.values_given import bytes_of
from canopen_gateway.web.live import LiveClient, LiveHub
from canopen_gateway.web.metrics import METRICS_TYPE, metrics_text
from canopen_gateway.web.openapi import description
from canopen_gateway.web.page import page_files
from canopen_master import BusError, MasterClosedError, MasterError, Node, SdoTimeoutError
from canopen_master.errors import NodeIsNoDriveError, UnknownChainError
from canopen_master.plain_text import clean, json_text
from canopen_proto import LocalProtocolError, indices
from canopen_proto.dictionary.model import NotInDictionaryError
from canopen_proto.procedures import ProcedureError

API: Final = "/api/v1"
OCTETS: Final = "application/octet-stream"
DEVICE_NAME: Final = indices.MANUFACTURER_DEVICE_NAME, 0
EVENTS_WAITING: Final = 64
"""Events that wait for one reader of the event stream; a slow one misses the rest."""
LOGGER: Final = logging.getLogger("canopen_gateway")
Handler: TypeAlias = "Callable[[WebApi, Request], Awaitable[Response]]"

_STATUS: Final[Sequence[tuple[type[Exception], int]]] = (
    (NotAllowedError, 403),
    (LeaseError, 409),
    (GatewayFullError, 503),
    (NoSuchPlaceError, 404),
    (SdoTimeoutError, 504),
    (NodeIsNoDriveError, 404),
    (UnknownChainError, 404),
    (BusError, 503),
    (MasterClosedError, 503),
    (MasterError, 409),
    (ProcedureError, 504),
    (NotInDictionaryError, 404),
    (LocalProtocolError, 400),
    (ValueError, 400),
    (GatewayError, 409),
)


def status_of(error: Exception) -> int:
    """Return the HTTP status of an error; 500 for one that nobody foresaw."""
    return next((status for kind, status in _STATUS if isinstance(error, kind)), 500)


class WebApi:
    """The handlers of the paths; see this module's text. session: the client that all requests are to the service."""

    def __init__(self, service: GatewayService, hub: LiveHub, session: GatewaySession) -> None:
        self.service = service
        self.hub = hub
        self.session = session

    # ---- the machine ----

    async def state(self, request: Request) -> Response:
        """What is allowed, the chains, and who moves them."""
        return _json({"nets": list(self.service.nets), **self.hub.state()})

    async def buses(self, request: Request) -> Response:
        """All nets, with their nodes."""
        return _json(self.hub.nets())

    async def nodes(self, request: Request) -> Response:
        """The nodes of a net."""
        net = find_net(self.service, request.path_params["net"])
        return _json(net_data(self.service, net)["nodes"])

    async def node(self, request: Request) -> Response:
        """One node."""
        node = self._node(request)
        return _json(node_data(self.service.master, node.bus, node.node_id))

    async def drive(self, request: Request) -> Response:
        """A drive: read, with the reasons why it does not move."""
        node = self._node(request)
        axis = find_node(request.query_params.get("axis", "0"), least=0)
        return _json(view_data(await self.service.look_at_drive(node.bus, node.node_id, axis)))

    async def about(self, request: Request) -> Response:
        """What a node says of itself: its device name (0x1008), and its drive, null if it is none. Silence is no error here."""
        node = self._node(request)
        name, drive, problem = "", None, ""
        try:
            drive = view_data(await self.service.look_at_drive(node.bus, node.node_id))
        except NodeIsNoDriveError:
            LOGGER.debug("%s is no drive", node.where)
        except (MasterError, ProcedureError) as error:
            problem = first_line(error)
        if not problem:
            try:
                data = await self.session.read(node.bus, node.node_id, *DEVICE_NAME)
                name = clean(data.decode("latin-1"))
            except MasterError as error:
                LOGGER.debug("%s has no name: %s", node.where, first_line(error))
        return _json({"name": name, "drive": drive, "problem": problem})

    async def scan(self, request: Request) -> Response:
        """Ask all node-IDs of a net for their device type: reading, which is open to all."""
        net = find_net(self.service, request.path_params["net"])
        await self.service.find_nodes(net)
        return _json(net_data(self.service, net)["nodes"])

    async def chains(self, request: Request) -> Response:
        """The chains, and where their joints are."""
        return _json([chain_data(chain) for chain in self.service.master.chains.values()])

    async def lease(self, request: Request) -> Response:
        """Who moves the machine."""
        return _json(lease_data(self.service))

    # ---- objects ----

    async def objects(self, request: Request) -> Response:
        """The objects that a node has by its dictionary. ?search=: only those whose name or place has this text."""
        node = self._node(request)
        wanted = request.query_params.get("search", "").lower()
        rows = [object_data(node.dictionary, variable) for variable in node.dictionary]
        return _json([row for row in rows if wanted in f"{row['path']} {row['name']}".lower()])

    async def read(self, request: Request) -> Response:
        """The value of an object; its bytes alone for `Accept: application/octet-stream`."""
        node = self._node(request)
        index, subindex = find_object(node.dictionary, request.path_params["object"])
        data = await self.session.read(node.bus, node.node_id, index, subindex)
        if request.headers.get("accept") == OCTETS:
            return Response(data, media_type=OCTETS)
        return _json(value_data(node.dictionary, index, subindex, data))

    async def write(self, request: Request) -> Response:
        """Write an object: {"value": ...}, a number, a text, a constant by its name; or its bytes as application/octet-stream."""
        node = self._node(request)
        index, subindex = find_object(node.dictionary, request.path_params["object"])
        self.service.guard.require_write(index, subindex)  # before the value is looked at: nothing else would help
        if request.headers.get("content-type", "").partition(";")[0] == OCTETS:
            data = await request.body()
        else:
            data = bytes_of(node, index, subindex, (await _body(request)).get("value"))
        await self.session.write(node.bus, node.node_id, index, subindex, data)
        return _json({"written": data.hex(" ")})

    # ---- commands ----

    async def nmt(self, request: Request) -> Response:
        """An NMT command to a node, or to all of a net: {"command": "start"}."""
        net = find_net(self.service, request.path_params["net"])
        node_id = find_node(request.path_params["node"]) if "node" in request.path_params else 0
        word = (await _body(request)).get("command")
        await self.session.nmt(net, nmt_command(word), node_id)
        return _json({"sent": word})

    async def halt(self, request: Request) -> Response:
        """Stop what moves: all, or a net. Everybody may, always."""
        net = find_net(self.service, request.path_params["net"]) if "net" in request.path_params else None
        return _json({"problems": await self.service.halt(net)})

    # ---- streams, and about this interface ----

    async def events(self, request: Request) -> Response:
        """Events as they come, for scripts that only read (server-sent events); the last ones first."""
        return StreamingResponse(self._event_lines(), media_type="text/event-stream")

    async def _event_lines(self) -> AsyncIterator[str]:
        put, get = trio.open_memory_channel[str](EVENTS_WAITING)

        def tell(text: str) -> None:
            if text.startswith('{"k": "event"'):
                try:
                    put.send_nowait(text)
                except trio.WouldBlock:
                    LOGGER.debug("a reader of events is slow, and misses one")

        last = list(self.hub.events)
        end = self.hub.listen(tell)
        try:
            for event in last:
                yield f"data: {json_text({'k': 'event', **event})}\n\n"
            yield ": now\n\n"
            async for text in get:
                yield f"data: {text}\n\n"
        finally:
            end()

    async def openapi(self, request: Request) -> Response:
        """The description of all this."""
        return _json(description((method, path, handler.__doc__ or "") for method, path, handler in ROUTES))

    async def metrics(self, request: Request) -> Response:
        """Numbers for Prometheus."""
        return Response(metrics_text(self.service, self.hub.counts), media_type=METRICS_TYPE)

    async def live(self, websocket: WebSocket) -> None:
        """Pulses, values and events; and the hand on the machine."""
        client = websocket.client
        name = "a page" if client is None else f"the page at {client.host}:{client.port}"
        try:
            with self.service.open_session(name) as session:
                await LiveClient(self.hub, session, websocket).run()
        except GatewayFullError as error:
            await websocket.close(1013, first_line(error))

    def _node(self, request: Request) -> Node:
        net = find_net(self.service, request.path_params["net"])
        return self.service.node(net, find_node(request.path_params["node"]))


ROUTES: Final[Sequence[tuple[str, str, Handler]]] = (
    ("GET", f"{API}/state", WebApi.state),
    ("GET", f"{API}/buses", WebApi.buses),
    ("GET", f"{API}/chains", WebApi.chains),
    ("GET", f"{API}/lease", WebApi.lease),
    ("GET", f"{API}/events", WebApi.events),
    ("GET", f"{API}/openapi.json", WebApi.openapi),
    ("POST", f"{API}/halt", WebApi.halt),
    ("GET", f"{API}/{{net}}/nodes", WebApi.nodes),
    ("PUT", f"{API}/{{net}}/nmt", WebApi.nmt),
    ("POST", f"{API}/{{net}}/halt", WebApi.halt),
    ("POST", f"{API}/{{net}}/scan", WebApi.scan),
    ("GET", f"{API}/{{net}}/{{node}}", WebApi.node),
    ("GET", f"{API}/{{net}}/{{node}}/about", WebApi.about),
    ("GET", f"{API}/{{net}}/{{node}}/drive", WebApi.drive),
    ("GET", f"{API}/{{net}}/{{node}}/objects", WebApi.objects),
    ("PUT", f"{API}/{{net}}/{{node}}/nmt", WebApi.nmt),
    ("GET", f"{API}/{{net}}/{{node}}/objects/{{object}}", WebApi.read),
    ("PUT", f"{API}/{{net}}/{{node}}/objects/{{object}}", WebApi.write),
    ("GET", "/metrics", WebApi.metrics),
)
"""Method, path, handler. The first that fits serves."""


def web_app(api: WebApi) -> Starlette:
    """Return the application, without the guard that has to stand in front of it."""
    routes: list[Route | WebSocketRoute] = [
        Route(path, partial(_handled, partial(handler, api)), methods=[method]) for method, path, handler in ROUTES
    ]
    routes.append(WebSocketRoute(f"{API}/live", api.live))
    for name, (content, kind) in page_files().items():
        routes.append(Route(f"/{name}", partial(_file, content, kind), methods=["GET"]))
    return Starlette(routes=routes, exception_handlers={HTTPException: _not_served})


async def _handled(handler: Callable[[Request], Awaitable[Response]], request: Request) -> Response:
    """Serve a request; an error becomes an answer. The gateway and its master go on, whatever it is."""
    try:
        return await handler(request)
    except Exception as error:
        status = status_of(error)
        if status == 500:
            LOGGER.exception("a request has failed: %s %s", request.method, request.url.path)
            return _json({"error": {"code": "", "text": "the gateway has failed at this request", "details": []}}, 500)
        return _json({"error": error_data(error)}, status)


async def _not_served(request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 500
    text = {404: "there is no such path", 405: "this path has no such method"}.get(status, "it cannot be served")
    return _json({"error": {"code": "", "text": text, "details": [f"see: {API}/openapi.json"]}}, status)


async def _file(content: bytes, kind: str, request: Request) -> Response:
    return Response(content, media_type=kind)


def _json(data: Any, status: int = 200) -> Response:
    return Response(json_text(data), status, media_type="application/json")


async def _body(request: Request) -> Plain:
    try:
        body = json.loads(await request.body())
    except (ValueError, RecursionError):
        raise ValueError("the body is no JSON") from None
    if not isinstance(body, dict):
        raise ValueError("the body has to be a JSON object")
    return body
