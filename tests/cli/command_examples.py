"""An example of each command, for the table of test_command_table.py; and JSON schemas, made of what commands answer.

The schemas stand in master/canopen_cli/schemas.json, one for each command. After a change of what a command answers, write them
again, and look at what git shows:

    CANOPEN_WRITE_SCHEMAS=1 pytest -n0 tests/cli/test_command_table.py -k json && python docs/json_page.py
"""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

import pytest

import canopen_cli
from tests.cli.cli_support import Outcome

SCHEMAS: Final = Path(canopen_cli.__file__).with_name("schemas.json")
VERSION: Final = 1

DEMO: Final = ("-b", "demo")
NOBODY: Final = ("--connect", "tcp/127.0.0.1:9")
"""A fleet without a bridge; tests/gateway/test_serve_zenoh.py has one with a bridge, and looks at the schemas too."""
EXAMPLES: Final[dict[str, tuple[str, ...]]] = {
    "demo": ("--for", "0.5", "--cycle", "20ms", "--chains", "two.csv"),
    "plot": ("path.csv", "-o", "new.png"),
    "doctor": (),
    "scan": ("--ids", "3-4", *DEMO),
    "node list": ("cell.toml", *DEMO),
    "info": ("3", *DEMO),
    "read": ("3", "statusword", *DEMO),
    "write": ("3", "6081", "20000", *DEMO),
    "nmt": ("start", "3", *DEMO),
    "pdo show": ("3", "tpdo1", *DEMO),
    "pdo map": ("3", "tpdo2", "statusword", "--yes", *DEMO),
    "pdo check": ("--ids", "3", *DEMO),
    "emcy watch": ("--for", "0.2s", *DEMO),
    "emcy history": ("3", *DEMO),
    "emcy clear": ("3", *DEMO),
    "sync": ("--yes", *DEMO),
    "time": DEMO,
    "lss scan": DEMO,
    "lss identify": ("--vendor", "1", *DEMO),
    "lss inquire": ("5", *DEMO),
    "lss set-id": ("5", "12", "--yes", *DEMO),
    "lss store": ("5", "--yes", *DEMO),
    "lss assign": ("--ids", "10", "--yes", *DEMO),
    "lss set-bitrate": ("250k", "--present", "500k", "--window", "10ms", "--delay", "10ms", "--yes", *DEMO),
    "listen": ("--for", "0.5s", *DEMO),
    "monitor": ("--for", "1.5s", *DEMO),
    "top": ("--once", *DEMO),
    "tui": DEMO,
    "watch": ("3", "statusword", "--for", "0.5s", *DEMO),
    "net init": ("-o", "new.toml", *DEMO),
    "net check": ("net.toml", *DEMO),
    "net boot": ("net.toml", "--yes", *DEMO),
    "net watch": ("cell.toml", "--yes", *DEMO),
    "net links": ("cell.toml",),
    "drive state": ("3", *DEMO),
    "drive units": ("3", *DEMO),
    "drive fault-reset": ("3", *DEMO),
    "drive plan": ("3", "-e", "sample_drive.eds", *DEMO),
    "drive mode": ("3", *DEMO),
    "drive enable": ("3", "--for", "0.2s", *DEMO),
    "drive home": ("3", *DEMO),
    "drive move": ("3", "2000", *DEMO),
    "drive velocity": ("3", "100", "--for", "0.2s", *DEMO),
    "drive torque": ("3", "5", "--for", "0.2s", *DEMO),
    "drive commission": ("3", "--yes", *DEMO),
    "drive inputs": ("3", *DEMO),
    "drive outputs": ("3", *DEMO),
    "drive probe": ("3", "--limit", "0.2s", *DEMO),
    "drive stop": ("3", *DEMO),
    "drive disable": ("3", *DEMO),
    "move": ("--to", "1,0,0,0,0,0", "--dry-run", *DEMO),
    "jog": DEMO,
    "home": ("3", *DEMO),
    "backup": ("3", "-o", "new.dcf", *DEMO),
    "restore": ("5", "device.dcf", "--any-device", "--dry-run", *DEMO),
    "store": ("3", "--yes", *DEMO),
    "reset-defaults": ("3", "--yes", *DEMO),
    "flash": ("3", "image.bin", "--yes", *DEMO),
    "compare": ("device.eds", "device.dcf"),
    "dump": ("3", "--walk", "1000-1018", *DEMO),
    "check": ("sample_io.eds",),
    "bus serve": ("--port", "0", "--for", "0"),
    "serve ascii": ("--port", "0", "--for", "0.1s", *DEMO),
    "serve mcp": ("--http", "0", "--for", "0.1s", *DEMO),
    "serve mqtt": ("--site", "hall", "--broker", "mqtt://127.0.0.1:9", "--for", "0.1s", *DEMO),
    "serve web": ("--port", "0", "--for", "0.1s", *DEMO),
    "serve zenoh": ("--site", "hall", "--listen", "tcp/127.0.0.1:0", "--for", "0.1s", *DEMO),
    "fleet ls": NOBODY,
    "fleet read": ("hall/arm/3", "statusword", *NOBODY),
    "fleet watch": ("--for", "0.1s", *NOBODY),
    "fleet halt": NOBODY,
    "fleet web": ("--port", "0", "--for", "0.1s", *NOBODY),
    "fleet record": ("history", "--for", "0.1s", *NOBODY),
    "fleet query": ("no_history",),
    "fleet router": ("--listen", "tcp/127.0.0.1:0", "--for", "0.1s"),
    "log check": ("bus.log",),
    "log convert": ("bus.log", "new.asc"),
    "log decode": ("bus.log",),
    "log diff": ("bus.log", "other.log"),
    "log export": ("bus.log", "-o", "new.csv"),
    "log plot": ("bus.log", "statusword", "-o", "new.png"),
    "log record": ("new.log", "--for", "0.5s", *DEMO),
    "log replay": ("bus.log", "-b", "virtual:x", "--speed", "max"),
    "log stats": ("bus.log",),
    "sim": ("sample_io.eds", "--id", "9", "--for", "0.1s", "-b", "virtual:x"),
    "device new": ("made.py",),
    "device describe": ("own.py", "-o", "own.eds"),
    "plan": ("--chains", "two.csv", "--cycle", "10ms", "--bitrate", "1M"),
    "eds lint": ("sample_io.eds",),
    "eds show": ("sample_io.eds", "1000"),
    "eds diff": ("device.eds", "device.dcf"),
    "eds fix": ("faulty.eds", "--dry-run"),
    "eds doc": ("sample_io.eds", "-o", "new.html"),
    "eds stubs": ("sample_io.eds", "-o", "stubs.py"),
    "eds to-dcf": ("sample_io.eds", "--id", "5", "-o", "new.dcf"),
    "eds to-cdcf": ("device.dcf", "-o", "new.bin"),
    "eds to-dbc": ("sample_drive.eds", "--id", "5", "-o", "new.dbc"),
    "machine check": ("cell.toml",),
    "machine from-chains": ("two.csv", "-o", "new.toml"),
    "machine import": ("bus.yaml", "-o", "new.toml"),
    "ros init": ("new_package", "-m", "arm.toml"),
    "data init": ("-o", "new_data"),
    "run": ("script.py", *DEMO),
    "shell": ("200", *DEMO),
    "completion": ("bash",),
}
"""By the words of a command: arguments with which it does something, or says why it cannot."""


SILENT: Final = ("-b", "virtual:nobody")
FURTHER: Final[dict[str, tuple[tuple[str, ...], ...]]] = {
    "doctor": (DEMO,),
    "scan": (SILENT,),
    "node list": (("net.toml", *DEMO),),
    "info": (("3", "-e", "sample_drive.eds", *DEMO), ("9", *DEMO)),
    "read": (("3", "statusword", "6064", "1008", *DEMO), ("3", "5FFF", "--type", "u16", *DEMO)),
    "write": (("3", "6081", "20000", "--verify", *DEMO)),
    "nmt": (("stop", "3", "--wait", *DEMO),),
    "pdo show": (("3", "--all", *DEMO),),
    "pdo check": (DEMO,),
    "emcy watch": (("5", "--log", "bus.log"),),
    "emcy history": (("9", *DEMO),),
    "lss set-bitrate": (("250k", "--present", "500k", "--window", "10ms", "--dry-run", *DEMO),),
    "lss store": (("only", "--yes", "--window", "20ms", *SILENT),),
    "listen": (("--for", "0.2s", *SILENT),),
    "monitor": (("--log", "bus.log"), ("--log", "bus.log", "--object", "statusword")),
    "top": (("--log", "bus.log"), ("--log", "bus.log", "--bitrate", "1M")),
    "watch": (("5", "statusword", "--log", "bus.log"), ("3", "statusword", "6064", "1008", "--for", "0.5s", *DEMO)),
    "net init": (("-o", "newer.toml", *SILENT),),
    "net check": (("cell.toml", *SILENT),),
    "net boot": (("net.toml", "--yes", *SILENT), ("lamp.toml", "--yes", *DEMO)),
    "drive state": (("joint1", "-m", "arm.toml", *DEMO), ("9", *DEMO)),
    "drive units": (("3", "-m", "arm.toml", *DEMO),),
    "drive mode": (("3", "ip", *DEMO),),
    "drive move": (("joint1", "5", "-m", "arm.toml", *DEMO),),
    "plot": (("run.csv", "-o", "run.png"),),
    "demo": (("--for", "0.5", "--fault", "4@0.2", "--chains", "two.csv"),),
    "compare": (("3", "device.dcf", *DEMO), ("device.eds", "device.eds")),
    "log check": (("other.log", "--bitrate", "1M"), ("empty.log",)),
    "log stats": (("bus.log", "--bitrate", "1M"), ("bus.log", "--until", "0.5s"), ("empty.log",)),
    "log diff": (("bus.log", "bus.log"),),
    "eds lint": (("faulty.eds",),),
    "eds show": (("sample_io.eds",), ("device.dcf", "1000")),
    "machine check": (("net.toml",), ("arm.toml",)),
    "plan": (("arm.toml", "--bitrate", "125k", "--cycle", "1ms"),),
}
"""Further examples of a command, where one does not show all that it answers: nobody there, a refusal, everything at once."""

OF_DATA: Final = frozenset({"writes", "can_ids", "buses", "nodes", "chains", "joints", "limits", "origins"})
"""Fields that hold an object whose names are data, if they hold one."""


OR_NULL: Final[dict[str, list[str]]] = {
    **{key: ["integer", "null"] for key in ("bit_rate", "bitrate", "node", "abort", "sync_counter", "sync_at")},
    **{
        key: ["null", "number"]
        for key in ("counts_per_metre", "counts_per_motor_turn", "rated_torque", "load", "mean_load", "peak")
    },
    **{key: ["null", "number"] for key in ("physical", "period", "largest_following_error", "negative", "positive", "measured")},
    **{key: ["null", "string"] for key in ("hex", "other_client", "nmt_state", "state", "output", "bus_state", "remark", "file")},
    **{key: ["integer", "null", "number", "string"] for key in ("value", "configured", "high", "low")},
}
"""What a field holds that is null in every example: no bus here brings it."""


def schema_of(value: Any, name: str = "") -> dict[str, Any]:
    """Return a schema that a value fits. name: of its field."""
    if isinstance(value, dict):
        is_data = not all(isinstance(key, str) and key.replace("_", "").isalnum() and key == key.lower() for key in value)
        if is_data or name in OF_DATA:
            return {"type": "object", "additionalProperties": merged([schema_of(each) for each in value.values()])}
        properties = {key: schema_of(value[key], key) for key in sorted(value)}
        return {"type": "object", "properties": properties, "required": sorted(value)}
    if isinstance(value, list):
        return {"type": "array", "items": merged([schema_of(each) for each in value])}
    kinds = {bool: "boolean", int: "integer", float: "number", str: "string", type(None): "null"}
    return {"type": OR_NULL[name] if value is None and name in OR_NULL else kinds[type(value)]}


def described(schema: Any, texts: dict[str, str]) -> Any:
    """Return a schema in which each field has its description, by its name."""
    if isinstance(schema, list):
        return [described(each, texts) for each in schema]
    if not isinstance(schema, dict):
        return schema
    made = {key: described(part, texts) for key, part in schema.items() if key not in ("properties", "description")}
    if isinstance(schema.get("properties"), dict):
        fields = {key: described(each, texts) for key, each in schema["properties"].items()}
        made["properties"] = {key: {"description": _text_for(each, texts.get(key, ""))} | each for key, each in fields.items()}
    return made


def _text_for(schema: dict[str, Any], text: str) -> str:
    """What null means is left out where it cannot be."""
    return (
        text
        if not schema.get("type") or "null" in _types(schema)
        else re.sub(r"(; (0 or )?null\b.*|, or null\b.*| or null\b)", "", text)
    )


def merged(schemas: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a schema that fits whatever fits one of these."""
    found: dict[str, Any] = {}
    for each in schemas:
        found = _both(found, each) if found else each
    return found


def _both(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    if not one or not other:
        return one or other
    types = sorted({*_types(one), *_types(other)})
    if {"integer", "number"} <= set(types):
        types.remove("integer")
    both: dict[str, Any] = {"type": types[0] if len(types) == 1 else types}
    objects = [each for each in (one, other) if "object" in _types(each)]
    if objects:
        properties = [each.get("properties", {}) for each in objects]
        names = sorted({name for each in properties for name in each})
        both["properties"] = {name: merged([each[name] for each in properties if name in each]) for name in names}
        both["required"] = sorted(set.intersection(*(set(each.get("required", ())) for each in objects)))
        others = [each["additionalProperties"] for each in objects if "additionalProperties" in each]
        both |= {"additionalProperties": merged(others)} if others else {}
    items = [each["items"] for each in (one, other) if "items" in each]
    return both | ({"items": merged(items)} if items else {})


def _types(schema: dict[str, Any]) -> list[str]:
    kind = schema.get("type", [])
    return [kind] if isinstance(kind, str) else list(kind)


def strict(schema: Any) -> Any:
    """Return the schema as the tests take it: a field that it does not have is a fault. Readers leave such fields alone."""
    if isinstance(schema, list):
        return [strict(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    made = {name: strict(part) for name, part in schema.items() if name != "properties"}
    if "properties" in schema:
        made["properties"] = {key: strict(each) for key, each in schema["properties"].items()}
    if "properties" in made and "additionalProperties" not in made:
        made["additionalProperties"] = False
    return made


def documents_of(text: str) -> list[Any]:
    """Return the JSON documents of a command: one, or one in each line."""
    if not text.strip():
        return []
    try:
        return [json.loads(text)]
    except ValueError:
        return [json.loads(line) for line in text.splitlines()]


def write_schema(command: str, documents: list[Any], commands: Sequence[str] = tuple(EXAMPLES)) -> None:
    """Let the schema of a command fit these documents, too. commands: the order in which the schemas stand."""
    whole = json.loads(SCHEMAS.read_text(encoding="utf-8"))
    known = [whole["commands"][command]] if command in whole["commands"] else []
    whole["commands"][command] = merged([*known, *map(schema_of, documents)])
    whole["commands"] = {each: whole["commands"][each] for each in commands if each in whole["commands"]}
    text = json.dumps(described({**whole, "version": VERSION}, descriptions()), indent=1, ensure_ascii=False)
    SCHEMAS.write_text(f"{text}\n", encoding="utf-8")
    validator_of.cache_clear()


@cache
def validator_of(command: str | None) -> Any:
    """What holds a document against the schema of a command; None: a line of stderr. test_command_table.py looks at
    the schemas themselves: `jsonschema.validate` would do so for each document."""
    jsonschema = pytest.importorskip("jsonschema")
    whole = json.loads(SCHEMAS.read_text(encoding="utf-8"))
    assert command is None or command in whole["commands"], "CANOPEN_WRITE_SCHEMAS=1: see this file's text"
    schema = strict(whole["stderr"] if command is None else whole["commands"][command])
    return jsonschema.validators.validator_for(schema)(schema)


def descriptions() -> dict[str, str]:
    """What each field means, by its name: one place for the schemas and the page."""
    texts: dict[str, str] = tomllib.loads(SCHEMAS.with_name("json_fields.toml").read_text(encoding="utf-8"))
    return texts


def json_that_fits(command: str, outcome: Outcome) -> Any:
    """Return what a command has answered as JSON, which fits its schema."""
    fit_their_schema(command, outcome.out)
    return outcome.json


def fit_their_schema(command: str, text: str) -> None:
    """Hold what a command has answered against its schema, for a command that does it only in a test of its own."""
    documents = documents_of(text)
    assert documents
    if os.environ.get("CANOPEN_WRITE_SCHEMAS"):
        write_schema(command, documents)
    for document in documents:
        validator_of(command).validate(document)
