"""Write docs/json.md of the schemas in master/canopen_cli/schemas.json. A test compares the two.

python docs/json_page.py
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PAGE = Path(__file__).with_name("json.md")
SCHEMAS = Path(__file__).parents[1] / "master" / "canopen_cli" / "schemas.json"

HEAD = """\
# What `--json` answers

`docs/json_page.py` writes this page of `master/canopen_cli/schemas.json`: JSON Schema, one for each command, made of several of
its answers. The tests hold them against what each command answers. Their version is **{version}**. A field may be added at any
time: leave alone what you do not know. A field that is taken away, or becomes another type, makes a new version.

A command writes one document on stdout. `monitor`, `watch`, `emcy watch`, `net watch` and `log decode` write one in each line.
`shell` and `run` print what their Python prints, and errors as documents. `tui` and `jog` have none: a person looks and holds
keys; `completion` writes the script of a shell. With `--dry-run` it is the list of the frames that would be sent: `ms`, `frame`,
`service`, `text`, and from `net boot` and `move` the `bus`. An error is one document on stderr
([errors](errors.md)): `code`, `kind`, `message`, `seen`, `cause`, `also`, `try`, `node`, `index`, `sub`, `abort`, `notes`.

`[]` stands for each element of a list, `*` for each name in an object whose names are data. A field with a `?` may be missing.
"""


def rows_of(schema: dict[str, Any], place: str = "", mark: str = "") -> Iterator[tuple[str, str, str]]:
    """Yield each field of a schema, with its type and meaning. place: where the schema stands. mark: ? if it may be missing."""
    kinds = schema.get("type", [])
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if place and (kinds != ["object"] or not schema.get("properties") or schema.get("description")):
        yield place + mark, " or ".join(kinds) or "any", schema.get("description", "")
    required = schema.get("required", ())
    for name, each in schema.get("properties", {}).items():
        yield from rows_of(each, f"{place}.{name}" if place else name, "" if name in required else "?")
    if isinstance(each := schema.get("items"), dict) and each:
        yield from rows_of(each, f"{place}[]")
    if isinstance(each := schema.get("additionalProperties"), dict) and each:
        yield from rows_of(each, f"{place}.*" if place else "*")


def page_of(whole: dict[str, Any]) -> str:
    """Return the text of the page. whole: what schemas.json holds."""
    lines = [HEAD.format(version=whole["version"])]
    for command, schema in whole["commands"].items():
        lines += [f"## {command}", "", "| field | type | meaning |", "|---|---|---|"]
        lines += [f"| `{field}` | {kind} | {meaning} |" for field, kind, meaning in rows_of(schema)]
        lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page_of(json.loads(SCHEMAS.read_text(encoding="utf-8"))), encoding="utf-8")
