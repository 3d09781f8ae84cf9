"""`canopen eds show`: show a device description as tables."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import click

from canopen_cli.eds import text as eds_text
from canopen_cli.shared.eds_files import finding_as_json, tell_faults
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.values import as_json, object_json, place_text
from canopen_data.checks.structure import field_name
from canopen_data.description import DeviceDescription
from canopen_data.named_files import open_description
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.model import Object, ObjectDictionary, ObjectNotFoundError, Variable

COLUMNS = ("object", "name", "type", "access", "PDO", "default", "limits")


@command()
@click.argument("path", metavar="FILE")
@click.argument("keys", metavar="[OBJECT]...", nargs=-1)
def show(settings: Settings, screen: Screen, path: str, keys: tuple[str, ...]) -> None:
    """Show what a device description says: EDS, DCF, XDD, XDC.

    Without OBJECT: the device, its PDOs and all objects. An OBJECT is a name or a number in hexadecimal (6041, 1018:01).

    \b
    canopen eds show drive.eds
    canopen eds show drive.eds statusword 1018
    """
    file = open_description(path, settings.encoding)
    description = file.description
    chosen = [each for key in keys for each in _find(description.dictionary, key)] if keys else _all(description.dictionary)
    if settings.json:
        objects = [_object_as_json(each, variables) for each, variables in chosen]
        screen.json(objects if keys else _as_json(description, objects))
        return
    tell_faults(screen, file)
    if not keys:
        _show_head(screen, description)
        _show_pdos(screen, description)
    has_configured = any(variable.configured is not None for _, variables in chosen for variable in variables)
    columns = (*COLUMNS, "configured") if has_configured else COLUMNS
    rows = [row[: len(columns)] for each, variables in chosen for row in _rows(each, variables)]
    screen.table(columns, [tuple(escape(cell) for cell in row) for row in rows])
    if not keys:
        screen.say(f"{counted(len(chosen), 'object')} in {escape(path)}")


Chosen = tuple[Object, list[Variable]]


def _all(dictionary: ObjectDictionary) -> list[Chosen]:
    return [(each, list(each.variables.values())) for each in dictionary.objects.values()]


def _find(dictionary: ObjectDictionary, key: str) -> Iterator[Chosen]:
    """Return the objects that a key names. A number without subindex, or an object's own name, stands for all its sub-objects.

    Raises ObjectNotFoundError.
    """
    folded = key.strip().casefold()
    digits = folded.removeprefix("0x")
    for each in dictionary.objects.values():
        if each.name.casefold() == folded or f"{each.index:04x}" == digits:
            yield each, list(each.variables.values())
            return
    try:
        variable = dictionary.variable(key)
    except ObjectNotFoundError:
        inside = [
            (each, variable)
            for each in dictionary.objects.values()
            for variable in each.variables.values()
            if field_name(each, variable.name).casefold() == folded
        ]
        if not inside:
            raise
        yield from ((each, [variable]) for each, variable in inside)
        return
    yield dictionary.objects[variable.index], [variable]


# ---- tables ----


def _rows(each: Object, variables: list[Variable]) -> Iterator[tuple[str, ...]]:
    if eds_text.is_one(each):
        yield _row(each.variables[0], f"{each.index:04X}", each.name)
        return
    if len(variables) == len(each.variables):
        yield (f"{each.index:04X}", each.name, eds_text.kind_text(each), "", "", "", "", "")
    for variable in variables:
        yield (
            _row(variable, f"  :{variable.subindex:02X}", f"  {field_name(each, variable.name)}")
            if len(variables) == len(each.variables)
            else _row(variable, place_text(variable), variable.name)
        )


def _row(variable: Variable, place: str, name: str) -> tuple[str, ...]:
    return (place, name, *eds_text.cells_of(variable))


def _show_head(screen: Screen, description: DeviceDescription) -> None:
    width = max(len(label) for label, _ in eds_text.head_of(description))
    for label, text in eds_text.head_of(description):
        screen.out.print(f"[dim]{label:<{width}}[/]  {escape(text)}", soft_wrap=True, highlight=False)
    screen.out.print()


def _show_pdos(screen: Screen, description: DeviceDescription) -> None:
    pdos = eds_text.pdos_of(description)
    if not pdos:
        return
    rows = []
    for pdo in pdos:
        entries = ", ".join(_entry_text(entry) for entry in pdo.entries) or pdo.note or "nothing"
        when = pdo.transmission + (f", {pdo.times}" if pdo.times else "")
        off = "" if pdo.exists else " (off)"
        rows.append((pdo.name, pdo.cob_id + off, when, str(pdo.bits), escape(entries)))
    screen.table(("PDO", "CAN-ID", "sent", "bits", "carries"), rows, right=("bits",))
    screen.out.print()


def _entry_text(entry: eds_text.PdoEntry) -> str:
    if entry.is_dummy:
        return f"({entry.bits} unused bits)"
    return f"{entry.name or entry.place} ({entry.bits})"


# ---- JSON ----


def _as_json(description: DeviceDescription, objects: list[dict[str, Any]]) -> dict[str, Any]:
    info, commissioning = description.device_info, description.commissioning
    return {
        "file": description.source,
        "kind": str(description.kind),
        "encoding": description.encoding,
        "device": {
            "vendor": info.vendor_name,
            "vendor_number": info.vendor_number,
            "product": info.product_name,
            "product_number": info.product_number,
            "revision_number": info.revision_number,
            "order_code": info.order_code,
            "bit_rates": sorted(info.bit_rates),
            "lss": info.lss_supported,
        },
        "commissioning": None
        if commissioning is None
        else {"node": commissioning.node_id, "name": commissioning.node_name, "bit_rate": commissioning.bit_rate},
        "pdos": [_pdo_as_json(pdo) for pdo in eds_text.pdos_of(description)],
        "objects": objects,
        "findings": [finding_as_json(each) for each in description.findings],
    }


def _pdo_as_json(pdo: eds_text.PdoText) -> dict[str, Any]:
    return {
        "name": pdo.name,
        "can_id": pdo.cob_id,
        "exists": pdo.exists,
        "sent": pdo.transmission,
        "bits": pdo.bits,
        "entries": [{"object": each.place, "name": each.name, "bits": each.bits, "dummy": each.is_dummy} for each in pdo.entries],
    }


def _object_as_json(each: Object, variables: list[Variable]) -> dict[str, Any]:
    return {
        "index": each.index,
        "name": each.name,
        "object_type": each.object_type.name,
        "variables": [_variable_as_json(variable) for variable in variables],
    }


def _variable_as_json(variable: Variable) -> dict[str, Any]:
    return object_json(variable) | {
        "type": variable.data_type.name,
        "access": str(variable.access),
        "pdo": variable.pdo_mappable,
        "default": _value(variable, variable.default),
        "adds_node_id": variable.adds_node_id,
        "configured": _value(variable, variable.configured),
        "configured_adds_node_id": variable.configured_adds_node_id,
        "low": variable.low_limit,
        "high": variable.high_limit,
    }


def _value(variable: Variable, value: Value | None) -> Any:
    return None if value is None else as_json(variable, value)
