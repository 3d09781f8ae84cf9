"""The content of the page that `eds doc` makes of a device description, before it becomes HTML or Markdown.

The page consists of plain texts. html.py and markdown.py escape them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from canopen_cli.eds import text as eds_text
from canopen_cli.eds.text import PdoText
from canopen_cli.shared.values import place_text
from canopen_data.checks.structure import field_name
from canopen_data.description import DeviceDescription
from canopen_proto.dictionary.model import Object, Variable


@dataclass(frozen=True)
class ObjectRow:
    """One line of a table of objects. anchor: of links to it. is_part: a sub-object. A cell without content is ""."""

    anchor: str
    place: str
    name: str
    type: str
    access: str
    pdo: str
    default: str
    limits: str
    configured: str
    description: str
    is_part: bool = False


@dataclass(frozen=True)
class ObjectGroup:
    """The objects of one area of the dictionary."""

    title: str
    rows: list[ObjectRow]


@dataclass(frozen=True)
class Page:
    """The whole page. names: every object and sub-object by name, with place and anchor."""

    title: str
    facts: list[tuple[str, str]]
    comments: tuple[str, ...]
    pdos: list[PdoText]
    groups: list[ObjectGroup]
    names: list[tuple[str, str, str]]
    has_configured: bool


def page_of(description: DeviceDescription) -> Page:
    """Make the page of a description."""
    groups = []
    for title, area in eds_text.AREAS:
        rows = [row for each in description.dictionary.objects.values() if each.index in area for row in _rows(each)]
        if rows:
            groups.append(ObjectGroup(title, rows))
    info = description.device_info
    title = " ".join(each for each in (info.vendor_name, info.product_name) if each) or description.source or "CANopen device"
    return Page(
        title,
        eds_text.head_of(description),
        description.comments,
        eds_text.pdos_of(description),
        groups,
        sorted(_names(description), key=lambda each: (each[0].casefold(), each[1])),
        any(variable.configured is not None for variable in description.dictionary),
    )


def _rows(each: Object) -> Iterator[ObjectRow]:
    if eds_text.is_one(each):
        yield _row(each.variables[0], f"o{each.index:04X}", f"{each.index:04X}", each.name)
        return
    yield ObjectRow(f"o{each.index:04X}", f"{each.index:04X}", each.name, eds_text.kind_text(each), "", "", "", "", "", "")
    for variable in each.variables.values():
        yield _row(variable, anchor_of(variable), f":{variable.subindex:02X}", field_name(each, variable.name), is_part=True)


def anchor_of(variable: Variable) -> str:
    """Return the anchor of a sub-object."""
    return f"o{variable.index:04X}s{variable.subindex:02X}"


def _row(variable: Variable, anchor: str, place: str, name: str, is_part: bool = False) -> ObjectRow:
    unit = f" {variable.unit}" if variable.unit else ""
    kind, access, pdo, default, limits, configured = eds_text.cells_of(variable)
    return ObjectRow(anchor, place, name, kind, access, pdo, default, limits + unit, configured, variable.description, is_part)


def _names(description: DeviceDescription) -> Iterator[tuple[str, str, str]]:
    for each in description.dictionary.objects.values():
        if each.name:
            yield each.name, f"{each.index:04X}", f"o{each.index:04X}"
        if not eds_text.is_one(each):
            for variable in each.variables.values():
                if variable.subindex and (name := field_name(each, variable.name)):
                    yield name, place_text(variable), anchor_of(variable)
