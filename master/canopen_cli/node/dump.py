"""`canopen dump`: show all values of a node, or write them into a file for other programs."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any, Final

import click

from canopen_cli.node.backup import bit_rate_of, read_node, write_dcf
from canopen_cli.node.backup_reading import check_indices, reading_as_json, reading_options, tell_unread
from canopen_cli.shared.new_files import check_new_file, write_file
from canopen_cli.shared.options import NodeId, Settings, command
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, escape, node_text
from canopen_cli.shared.values import hex_text, place_text, value_text
from canopen_master.plain_text import clean, json_text
from canopen_master.way_back import counts_text
from canopen_proto.manager.parameters.backup import Backup, Reading

FORMATS: Final = (".json", ".csv", ".dcf")
COLUMNS: Final = ("object", "name", "type", "access", "value", "hex")


@command()
@click.argument("node_id", metavar="NODE", type=NodeId())
@click.option("-o", "--output", metavar="FILE", help="A file instead: .json, .csv or .dcf.")
@reading_options
def dump(
    settings: Settings, screen: Screen, node_id: int, output: str | None, indices: tuple[range, ...] | None, domains: bool
) -> int:
    """Read all objects of a node, and show them.

    Its objects are those of its own file (-e). Without one, the communication objects and PDOs are looked for one by one, and
    those of the data files are read; --walk looks for others. Exit status: 0 complete, 7 an object that should exist could not be
    read.

    \b
    canopen dump 3 -b demo
    canopen dump 5 --walk 1000-1FFF,2000-20FF -o found.csv
    """
    check_indices(indices, settings.eds)
    suffix = Path(output).suffix.lower() if output is not None else ""
    if output is not None:
        if suffix not in FORMATS:
            raise usage(
                "CO001", f"{output} has an ending of no known format", tries=[f"-o node{node_id}{each}" for each in FORMATS]
            )
        check_new_file(settings, screen, output)
    found, description = run(settings, screen, lambda: read_node(settings, screen, node_id, indices, domains))
    lost: tuple[Reading, ...] = ()
    if output is None:
        _show(settings, screen, found)
    elif suffix == ".dcf":
        lost = write_dcf(output, found, description if indices is None else None, bit_rate_of(settings))
    else:
        _write(output, suffix, found)
    tell_unread(screen, found, lost)
    screen.say((f"{escape(output)}: " if output is not None else "") + f"{node_text(node_id)}, {counts_text(found)}")
    return ExitCode.OK if found.is_complete and not lost else ExitCode.PARTIAL


def _show(settings: Settings, screen: Screen, found: Backup) -> None:
    if settings.json:
        screen.json(_document(found))
    else:
        rows = [tuple(escape(cell) for cell in _row(each)) for each in found.readings if each.value is not None]
        screen.table(COLUMNS, rows, right=("hex",))


def _row(reading: Reading) -> tuple[str, ...]:
    variable, value = reading.variable, reading.value
    assert value is not None
    place, number = place_text(variable), hex_text(variable, value)
    return place, variable.name, variable.data_type.name, str(variable.access), value_text(variable, value), number


def _document(found: Backup) -> dict[str, Any]:
    return {"node": found.node_id, "objects": [reading_as_json(each) for each in found.readings]}


def _write(output: str, suffix: str, found: Backup) -> None:
    if suffix == ".json":
        text = json_text(_document(found), 2) + "\n"
    else:
        table = io.StringIO()
        rows = [reading_as_json(each) for each in found.readings]
        for row in rows:
            row.update(index=f"{row['index']:04X}", sub=f"{row['sub']:02X}", name=clean(row["name"]))
            if isinstance(row["value"], str):
                row["value"] = clean(row["value"], len(row["value"]))
        names = ("index", "sub", "name", "type", "access", "result", "value", "hex", "abort")
        writer = csv.DictWriter(table, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        text = table.getvalue()
    write_file(output, text.encode("utf-8"))
