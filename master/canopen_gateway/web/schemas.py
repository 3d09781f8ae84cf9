"""JSON schemas of answers, made from the TypedDicts that they are: what OpenAPI tells of an answer is its type."""

from __future__ import annotations

from types import NoneType, UnionType
from typing import Any, Final, get_args, get_origin, get_type_hints, is_typeddict

_PLAIN: Final[dict[Any, str]] = {str: "string", int: "integer", float: "number", bool: "boolean", NoneType: "null"}


def schema_of(kind: Any, schemas: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a type: a plain one, a list, a dict with names, a union, a TypedDict.

    schemas: gets those of TypedDicts, by name.
    """
    if kind in _PLAIN:
        return {"type": _PLAIN[kind]}
    if get_origin(kind) is list:
        return {"type": "array", "items": schema_of(get_args(kind)[0], schemas)}
    if get_origin(kind) is dict:
        value = get_args(kind)[1]
        return {"type": "object", "additionalProperties": True if value is Any else schema_of(value, schemas)}
    if isinstance(kind, UnionType):
        return {"anyOf": [schema_of(each, schemas) for each in get_args(kind)]}
    if not is_typeddict(kind):
        raise TypeError(f"{kind} has no schema")
    name = kind.__name__.removesuffix("Data")
    if name not in schemas:
        schemas[name] = {}  # for one that holds itself
        hints = get_type_hints(kind)
        schemas[name] |= {
            "type": "object",
            "description": " ".join((kind.__doc__ or "").split()),
            "properties": {field: schema_of(each, schemas) for field, each in hints.items()},
            "required": sorted(kind.__required_keys__),
            "additionalProperties": False,
        }
    return {"$ref": f"#/components/schemas/{name}"}
