"""Write a device description as one HTML page that needs nothing else: no script, no font, no other file.

Every text of the file is escaped on its way into the page (`_e`): a description may come from anybody.
"""

from __future__ import annotations

import html
from collections.abc import Iterator
from typing import Final

from canopen_cli.eds.page import ObjectGroup, ObjectRow, Page
from canopen_cli.eds.text import PdoText
from canopen_master.plain_text import clean
from canopen_proto.explained import counted

_STYLE: Final = """
:root{--ink:#1b1f24;--dim:#667085;--line:#e3e7ec;--page:#fff;--soft:#f6f8fa;--mark:#0b6bcb;--rpdo:#dcecfb;--tpdo:#ddf3e4}
@media(prefers-color-scheme:dark){:root{--ink:#e6e9ee;--dim:#98a2b3;--line:#2c333d;--page:#14181d;--soft:#1b2027;--mark:#6cb6ff;
--rpdo:#17344f;--tpdo:#173d2a}}
*{box-sizing:border-box}html{scroll-padding-top:3rem}
body{margin:0 auto;max-width:80rem;padding:2rem 1.5rem 4rem;background:var(--page);color:var(--ink);
font:15px/1.5 system-ui,-apple-system,"Segoe UI",sans-serif}
h1{font-size:1.7rem;margin:0 0 1rem}h2{font-size:1.2rem;margin:2.5rem 0 .6rem}a{color:var(--mark);text-decoration:none}
a:hover{text-decoration:underline}nav{margin:1rem 0;display:flex;flex-wrap:wrap;gap:.3rem 1.2rem}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.15rem 1.2rem;margin:0}dt{color:var(--dim)}dd{margin:0}
.comment{color:var(--dim);white-space:pre-wrap;margin-top:1rem}
.bits{overflow:hidden}table{border-collapse:collapse;width:100%}
th{position:sticky;top:0;background:var(--page);text-align:left;color:var(--dim);font-weight:600;font-size:.85rem}
th,td{padding:.25rem .7rem .25rem 0;border-bottom:1px solid var(--line);vertical-align:top}
td.n,.place{font-family:ui-monospace,SFMono-Regular,Menlo,Consolas,monospace;font-size:.87rem;white-space:nowrap}
td.v{font-family:ui-monospace,SFMono-Regular,Menlo,Consolas,monospace;font-size:.87rem;overflow-wrap:anywhere}
tr.whole td{font-weight:600}tr.part td:nth-child(-n+2){padding-left:1.2rem}tr.part td:nth-child(2){font-weight:400}
tr:target td{background:var(--soft)}.about{color:var(--dim);font-size:.9rem;font-weight:400}
.pdo{margin:.8rem 0 1.2rem}.pdo p{margin:0 0 .3rem}.pdo .dim{color:var(--dim)}.off{opacity:.6}
.bits{display:flex;gap:2px;max-width:64rem}.bits span{min-width:0;padding:.3rem .45rem;border-radius:4px;font-size:.85rem;
overflow:hidden;text-overflow:ellipsis;white-space:nowrap;flex:1 1 0}
.rpdo span{background:var(--rpdo)}.tpdo span{background:var(--tpdo)}.bits .gap{background:none;border:1px dashed var(--line)}
.names{columns:20rem;column-gap:2rem;padding:0;list-style:none}.names li{break-inside:avoid}
footer{margin-top:3rem;color:var(--dim);font-size:.85rem}
@media print{nav{display:none}th{position:static}body{max-width:none;padding:0}a{color:inherit}tr{break-inside:avoid}}
"""

_COLUMNS: Final = ("object", "name", "type", "access", "PDO", "default", "limits")


def html_of(page: Page) -> str:
    """Return the whole page."""
    return "\n".join(_lines(page)) + "\n"


def _e(text: str) -> str:
    return html.escape(clean(text), quote=True)


def _lines(page: Page) -> Iterator[str]:
    yield '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield f"<title>{_e(page.title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>"
    yield f"<h1>{_e(page.title)}</h1>"
    yield "<dl>"
    for label, text in page.facts:
        yield f"<dt>{_e(label)}</dt><dd>{_e(text)}</dd>"
    yield "</dl>"
    if any(line.strip() for line in page.comments):
        yield f'<p class="comment">{_e(chr(10).join(page.comments))}</p>'
    yield "<nav>"
    if page.pdos:
        yield '<a href="#pdos">PDOs</a>'
    for number, group in enumerate(page.groups):
        yield f'<a href="#g{number}">{_e(group.title)}</a>'
    yield '<a href="#names">Names</a>\n</nav>'
    if page.pdos:
        yield '<h2 id="pdos">PDOs after start-up</h2>'
        for pdo in page.pdos:
            yield from _pdo(pdo)
    for number, group in enumerate(page.groups):
        yield from _group(group, number, page.has_configured)
    yield '<h2 id="names">Names in order</h2>\n<ul class="names">'
    for name, place, anchor in page.names:
        yield f'<li><a href="#{anchor}"><span class="place">{_e(place)}</span></a> {_e(name)}</li>'
    yield "</ul>\n<footer>Made by canopen eds doc.</footer>\n</body>\n</html>"


def _pdo(pdo: PdoText) -> Iterator[str]:
    details = ", ".join(each for each in (pdo.transmission, pdo.times, pdo.note, counted(pdo.bits, "bit")) if each)
    off = "" if pdo.exists else " (does not exist until its COB-ID is set)"
    yield f'<div class="pdo{"" if pdo.exists else " off"}">'
    yield f'<p><b>{_e(pdo.name)}</b> <span class="place">{_e(pdo.cob_id)}</span> <span class="dim">{_e(details + off)}</span></p>'
    if pdo.entries:
        yield f'<div class="bits {pdo.direction.lower()}">'
        for entry in pdo.entries:
            text = "unused" if entry.is_dummy else entry.name or entry.place
            title = f"{entry.place} {entry.name}, {counted(entry.bits, 'bit')}"
            gap = ' class="gap"' if entry.is_dummy else ""
            yield f'<span{gap} style="flex-grow:{max(entry.bits, 1)}" title="{_e(title)}">{_e(text)} · {entry.bits}</span>'
        yield "</div>"
    yield "</div>"


def _group(group: ObjectGroup, number: int, has_configured: bool) -> Iterator[str]:
    columns = (*_COLUMNS, "configured") if has_configured else _COLUMNS
    yield f'<h2 id="g{number}">{_e(group.title)}</h2>'
    yield f"<table>\n<thead><tr>{''.join(f'<th>{each}</th>' for each in columns)}</tr></thead>\n<tbody>"
    for row in group.rows:
        yield _row(row, has_configured)
    yield "</tbody>\n</table>"


def _row(row: ObjectRow, has_configured: bool) -> str:
    about = f'<div class="about">{_e(row.description)}</div>' if row.description else ""
    cells = [
        f'<td class="n">{_e(row.place)}</td>',
        f"<td>{_e(row.name)}{about}</td>",
        *(f"<td>{_e(text)}</td>" for text in (row.type, row.access, row.pdo)),
        f'<td class="v">{_e(row.default)}</td>',
        f'<td class="v">{_e(row.limits)}</td>',
    ]
    if has_configured:
        cells.append(f'<td class="v">{_e(row.configured)}</td>')
    return f'<tr id="{row.anchor}" class="{"part" if row.is_part else "whole"}">{"".join(cells)}</tr>'
