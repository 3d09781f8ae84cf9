"""Write a device description as one page of Markdown, with GitHub's form of tables.

Every text of the file is escaped on its way into the page (`_e`): Markdown or HTML in it is shown as text.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Final

from canopen_cli.eds.page import ObjectGroup, ObjectRow, Page
from canopen_cli.eds.text import PdoEntry
from canopen_master.plain_text import clean

_SPECIAL: Final = re.compile(r"([\\`*_\[\]<>#|~&])")
_COLUMNS: Final = ("object", "name", "type", "access", "PDO", "default", "limits")


def markdown_of(page: Page) -> str:
    """Return the whole page."""
    return "\n".join(_lines(page)) + "\n"


def _e(text: str) -> str:
    """Return the text on one line, with all characters escaped that mean something to Markdown."""
    return _SPECIAL.sub(r"\\\1", clean(" ".join(text.split())))


def _lines(page: Page) -> Iterator[str]:
    yield f"# {_e(page.title)}\n"
    yield from _table(("", ""), [(_e(label), _e(text)) for label, text in page.facts])
    for line in page.comments:
        if line.strip():
            yield f"> {_e(line)}  "
    if page.pdos:
        yield "\n## PDOs after start-up\n"
        rows = [
            (
                pdo.name,
                _e(pdo.cob_id) + ("" if pdo.exists else " (off)"),
                _e(", ".join(each for each in (pdo.transmission, pdo.times) if each)),
                str(pdo.bits),
                ", ".join(_entry(entry) for entry in pdo.entries) or pdo.note or "nothing",
            )
            for pdo in page.pdos
        ]
        yield from _table(("PDO", "CAN-ID", "sent", "bits", "carries"), rows)
    for group in page.groups:
        yield from _group(group, page.has_configured)
    yield "\n## Names in order\n"
    yield from _table(("name", "object"), [(_e(name), place) for name, place, _ in page.names])


def _entry(entry: PdoEntry) -> str:
    if entry.is_dummy:
        return f"{entry.bits} unused bits"
    return f"{_e(entry.name)} {entry.place} ({entry.bits})".strip()


def _group(group: ObjectGroup, has_configured: bool) -> Iterator[str]:
    yield f"\n## {_e(group.title)}\n"
    yield from _table(
        (*_COLUMNS, "configured") if has_configured else _COLUMNS, [_row(each, has_configured) for each in group.rows]
    )


def _row(row: ObjectRow, has_configured: bool) -> tuple[str, ...]:
    name = _e(row.name) + (f"<br>{_e(row.description)}" if row.description else "")
    cells = (row.place, name if row.is_part else f"**{name}**" if name else "", *map(_e, (row.type, row.access, row.pdo)))
    more = (row.default, row.limits, row.configured) if has_configured else (row.default, row.limits)
    return (*cells, *map(_e, more))


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(columns)} |"
    yield f"|{'---|' * len(columns)}"
    for row in rows:
        yield f"| {' | '.join(row)} |"
    yield ""
