"""The description of the HTTP interface, in OpenAPI 3.1: for people, and for programs that make clients of it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, Final

from canopen_gateway.nmt_words import NMT_COMMANDS
from canopen_gateway.traffic.network import NetworkData
from canopen_gateway.web.schemas import schema_of

_PARAMETERS: Final = {
    "net": "A bus: its number, from 1, or its name; over a fleet SITE:BUS.",
    "node": "A node-ID, 1 to 127.",
    "object": "An object: a name (statusword), or index and subindex (6041:00).",
}
_QUERIES: Final = {
    "/objects": (("search", "Only objects whose name or place has this text."),),
    "/drive": (("axis", "The number of the axis, from 0."),),
    "/trace": (
        ("seconds", "How far back from now. By default all that is there."),
        ("frames", "How many frames of each bus at most, the last ones."),
    ),
}
_ANSWERS: Final = {"/network": NetworkData}
"""Answers with a type, by the last part of the path."""
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
    "409": "The device refused, or somebody else moves the machine.",
    "413": "The body is too long.",
    "421": "The door has not the name that was asked for.",
    "501": "It needs the computer that has the bus, and this is a page over a fleet.",
    "503": "The gateway is full, or the bus is away.",
    "504": "The device is silent.",
}


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
            "schemas": {
                **schemas,
                "Error": {
                    "type": "object",
                    "properties": {
                        "error": {
                            "type": "object",
                            "properties": {
                                "code": {"type": "string", "description": "Such as CO202: docs/errors.md."},
                                "text": {"type": "string"},
                                "details": {"type": "array", "items": {"type": "string"}},
                                "abort": {"type": "string", "description": "The abort code of the device, in hexadecimal."},
                            },
                        }
                    },
                },
            },
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
    for query, about in _QUERIES.get(ending, ()) if method == "GET" else ():
        parameters.append({"name": query, "in": "query", "required": False, "description": about, "schema": {"type": "string"}})
    failed = {"content": {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}}
    responses: dict[str, Any] = {"200": {"description": "Done."}}
    if ending in _ANSWERS:
        responses["200"]["content"] = {"application/json": {"schema": schema_of(_ANSWERS[ending], schemas)}}
    if ending == "/trace":
        responses["200"]["content"] = {"text/plain": {"schema": {"type": "string"}}}
    responses |= {status: {"description": about, **failed} for status, about in _ERRORS.items()}
    operation: dict[str, Any] = {"summary": text.strip(), "parameters": parameters, "responses": responses}
    if method == "PUT":
        operation["requestBody"] = {"required": True, "content": _BODIES[ending]}
    return operation
