"""The description of the HTTP interface, in OpenAPI 3.1: for people, and for programs that make clients of it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, Final

from canopen_gateway.nmt_words import NMT_COMMANDS

_PARAMETERS: Final = {
    "net": "A bus: its number, from 1, or its name.",
    "node": "A node-ID, 1 to 127.",
    "object": "An object: a name (statusword), or index and subindex (6041:00).",
}
_QUERIES: Final = {
    "/objects": ("search", "Only objects whose name or place has this text."),
    "/drive": ("axis", "The number of the axis, from 0."),
}
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
    "503": "The gateway is full, or the bus is away.",
    "504": "The device is silent.",
}


def description(routes: Iterable[tuple[str, str, str]]) -> dict[str, Any]:
    """Return the description of an interface. routes: method, path and what it does, of each."""
    paths: dict[str, Any] = {}
    for method, path, text in routes:
        paths.setdefault(path, {})[method.lower()] = _operation(method, path, text)
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
                }
            },
        },
        "security": [{"token": []}],
        "paths": paths,
    }


def _operation(method: str, path: str, text: str) -> dict[str, Any]:
    names = re.findall(r"\{(\w+)\}", path)
    parameters = [
        {"name": name, "in": "path", "required": True, "description": _PARAMETERS[name], "schema": {"type": "string"}}
        for name in names
    ]
    ending = path[path.rindex("/") :]
    if method == "GET" and ending in _QUERIES:
        query, about = _QUERIES[ending]
        parameters.append({"name": query, "in": "query", "required": False, "description": about, "schema": {"type": "string"}})
    failed = {"content": {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}}
    responses: dict[str, Any] = {"200": {"description": "Done."}}
    responses |= {status: {"description": about, **failed} for status, about in _ERRORS.items()}
    operation: dict[str, Any] = {"summary": text.strip(), "parameters": parameters, "responses": responses}
    if method == "PUT":
        operation["requestBody"] = {"required": True, "content": _BODIES[ending]}
    return operation
