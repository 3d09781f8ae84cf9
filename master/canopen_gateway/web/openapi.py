"""The description of the HTTP interface, in OpenAPI 3.1: for people, and for programs that make clients of it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, Final

from canopen_gateway.nmt_words import NMT_COMMANDS
from canopen_gateway.traffic.network import NetworkData
from canopen_gateway.traffic.ring import CAPACITY
from canopen_gateway.web.answers import (
    AboutData,
    BusData,
    ChainData,
    DevicePdoData,
    ErrorData,
    HaltedData,
    LeaseData,
    NodeData,
    ObjectData,
    SentData,
    StateData,
    ValueData,
    ViewData,
    WrittenData,
)
from canopen_gateway.web.schemas import schema_of
from canopen_proto.drives.cia402.axes import MAX_AXES

_PARAMETERS: Final = {
    "net": "A bus: its number, from 1, or its name; over a fleet SITE:BUS.",
    "node": "A node-ID, 1 to 127.",
    "object": "An object: a name (statusword), or index and subindex (6041:00).",
}
_QUERIES: Final[dict[str, tuple[tuple[str, str, dict[str, Any]], ...]]] = {
    "/objects": (("search", "Only objects whose name or place has this text.", {"type": "string"}),),
    "/drive": (("axis", "The number of the axis, from 0.", {"type": "integer", "minimum": 0, "maximum": MAX_AXES - 1}),),
    "/trace": (
        ("seconds", "How far back from now. By default all that is there.", {"type": "number", "minimum": 0}),
        ("frames", "How many frames of each bus at most, the last ones.", {"type": "integer", "minimum": 0, "maximum": CAPACITY}),
    ),
}
_ANSWERS: Final[dict[str, Any]] = {
    "/state": StateData,
    "/buses": list[BusData],
    "/chains": list[ChainData],
    "/lease": LeaseData,
    "/openapi.json": dict[str, Any],
    "/halt": HaltedData,
    "/nodes": list[NodeData],
    "/scan": list[NodeData],
    "/network": NetworkData,
    "/nmt": SentData,
    "/{node}": NodeData,
    "/about": AboutData,
    "/drive": ViewData,
    "/pdos": list[DevicePdoData],
    "/objects": list[ObjectData],
}
"""Types of the answers in JSON, by the last part of the path. Those of an object differ by method."""
_TEXTS: Final = {"/events": "text/event-stream", "/trace": "text/plain", "/metrics": "text/plain"}
"""Media types of the answers that are no JSON."""
_BODIES: Final = {
    "/nmt": {"application/json": {"schema": {"type": "object", "properties": {"command": {"enum": list(NMT_COMMANDS)}}}}},
    "/{object}": {
        "application/json": {
            "schema": {
                "type": "object",
                "properties": {"value": {"description": "A number, a text, a constant by its name, or bytes in hexadecimal."}},
                "required": ["value"],
            }
        },
        "application/octet-stream": {"schema": {"type": "string", "format": "binary"}},
    },
}
_ERRORS: Final = {
    "400": "The request is wrong; nothing was sent.",
    "401": "The token is missing.",
    "403": "Not allowed: by --allow, or the request came from a foreign page.",
    "404": "There is no such net, node, object or path.",
    "405": "The path has no such method.",
    "408": "The body did not come in time.",
    "409": "The device refused, or somebody else moves the machine.",
    "413": "The body is too long.",
    "421": "The door has not the name that was asked for.",
    "500": "The gateway has failed at this request.",
    "501": "It needs the computer that has the bus, and this is a page over a fleet.",
    "503": "The gateway is full, or the bus is away.",
    "504": "The device is silent.",
}
_OF_ALL: Final = frozenset({"401", "403", "405", "408", "413", "421", "500", "503"})
_ON_THE_BUS: Final = frozenset({"/network", "/trace", "/drive", "/pdos", "/scan", "/metrics", "/nmt"})
"""What a page over a fleet has not, or not all of it."""


def description(routes: Iterable[tuple[str, str, str]]) -> dict[str, Any]:
    """Return the description of an interface. routes: method, path and what it does, of each."""
    paths: dict[str, Any] = {}
    schemas: dict[str, Any] = {}
    for method, path, text in routes:
        paths.setdefault(path, {})[method.lower()] = _operation(method, path, text, schemas)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "A CANopen machine",
            "version": "1",
            "description": "Read-only unless the gateway was started with --allow. A change that shows only the cookie needs the "
            "header x-canopen: 1. Live values and motion go over the WebSocket /api/v1/live.",
        },
        "components": {
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
            "schemas": schemas,
        },
        "security": [{"token": []}],
        "paths": paths,
    }


def _operation(method: str, path: str, text: str, schemas: dict[str, Any]) -> dict[str, Any]:
    names = re.findall(r"\{(\w+)\}", path)
    parameters = [
        {"name": name, "in": "path", "required": True, "description": _PARAMETERS[name], "schema": {"type": "string"}}
        for name in names
    ]
    ending = path[path.rindex("/") :]
    for query, about, schema in _QUERIES.get(ending, ()) if method == "GET" else ():
        parameters.append({"name": query, "in": "query", "required": False, "description": about, "schema": schema})
    if ending == "/events":
        about = "The id of the last event that was heard: only those after it are told."
        parameters.append(
            {"name": "Last-Event-ID", "in": "header", "required": False, "description": about, "schema": {"type": "string"}}
        )
    failed = {"content": {"application/json": {"schema": schema_of(ErrorData, schemas)}}}
    responses: dict[str, Any] = {"200": {"description": "Done.", "content": _answer(method, ending, schemas)}}
    responses |= {status: {"description": _ERRORS[status], **failed} for status in sorted(_statuses(method, path, ending))}
    operation: dict[str, Any] = {"summary": " ".join(text.split()), "parameters": parameters, "responses": responses}
    if method == "PUT":
        operation["requestBody"] = {"required": True, "content": _BODIES[ending]}
    return operation


def _answer(method: str, ending: str, schemas: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a good answer, by its media types."""
    if ending in _TEXTS:
        return {_TEXTS[ending]: {"schema": {"type": "string"}}}
    if ending != "/{object}":
        return {"application/json": {"schema": schema_of(_ANSWERS[ending], schemas)}}
    if method == "PUT":
        return {"application/json": {"schema": schema_of(WrittenData, schemas)}}
    octets = {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
    return {"application/json": {"schema": schema_of(ValueData, schemas)}} | octets


def _statuses(method: str, path: str, ending: str) -> set[str]:
    """Return the statuses of the errors that an operation may end with."""
    found = set(_OF_ALL)
    if "{net}" in path:
        found |= {"404", "409", "504"}
    if ending == "/halt":
        found |= {"409", "504"}
    if method == "PUT" or ending in _QUERIES:
        found.add("400")
    if ending in _ON_THE_BUS:
        found.add("501")
    return found
