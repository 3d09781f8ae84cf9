"""`canopen compare`: compare the values of a node and of a file, or of two files.

`canopen eds diff` compares two files about a type of device; this compares the values of two devices.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from canopen_cli.node.backup_reading import both_notations, shown, tell_unread
from canopen_cli.shared.options import NodeId, Settings, TextKind, command
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape, node_text
from canopen_cli.shared.session import open_session
from canopen_cli.shared.values import as_json, hex_text, object_json, place_text
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.dictionary.roles import Role, roles_in
from canopen_proto.manager.parameters.backup import Backup, ObjectRead, back_up, same_value
from canopen_proto.multiplexer import Mux, split_mux

if TYPE_CHECKING:
    from canopen_data.description import DeviceDescription

MAX_NAMED: Final = 5
"""Settings of the files that are named because they could not be read."""
HIDDEN: Final = (Role.PROCESS, Role.COMMAND)
"""Roles of objects that change by themselves, or say nothing about how a device is set up."""


class DifferenceKind(StrEnum):
    """In what way an object differs."""

    CHANGED = "changed"
    LEFT = "only left"
    RIGHT = "only right"


@dataclass(frozen=True)
class ComparedObject:
    """One difference. left, right: the values, None if that side does not have the object."""

    variable: Variable
    change: DifferenceKind
    role: Role
    left: Value | None
    right: Value | None


@dataclass(frozen=True)
class Side:
    """One side of the comparison. missing: objects that should have a value and could not be read. defaults_left_out: how many
    objects have a default in the file that is not among the values."""

    name: str
    dictionary: ObjectDictionary
    values: Mapping[Mux, Value]
    missing: frozenset[Mux] = frozenset()
    defaults_left_out: int = 0


@dataclass(frozen=True)
class ValueTolerance:
    """How far apart two numbers may be and still count as equal: `absolute`, or `relative` to the larger one."""

    absolute: float = 0.0
    relative: float = 0.0

    def allows(self, one: Value | None, other: Value | None) -> bool:
        if not isinstance(one, int | float) or not isinstance(other, int | float):
            return False
        return abs(one - other) <= max(self.absolute, self.relative * max(abs(one), abs(other)))


class ToleranceKind(TextKind):
    """A number, or a percentage: "5", "0.1", "1%"."""

    name = "tolerance"

    def read(self, text: str) -> ValueTolerance:
        number, percent, rest = text.partition("%")
        try:
            size = float(number)
        except ValueError:
            size = -1.0
        if rest or not 0 <= size < 1e30:
            raise ValueError(f"{text!r} is not a number such as 5, or a percentage such as 1%")
        return ValueTolerance(relative=size / 100) if percent else ValueTolerance(absolute=size)


@command()
@click.argument("left", metavar="NODE|FILE")
@click.argument("right", metavar="FILE")
@click.option("--only", type=click.Choice(["changed", "missing"]), help="Only what both have, or only what one of them lacks.")
@click.option("--tolerance", type=ToleranceKind(), default="0", help="Numbers this far apart are equal: 5, 0.1, 1%.")
@click.option("--process-data", is_flag=True, help="Also what changes by itself: actual values, set-points, error states.")
@click.option("--defaults", is_flag=True, help="Also the defaults of objects that a file does not configure.")
@click.option(
    "--id", "node_id", metavar="N", type=NodeId(), help="For defaults that depend on the node-ID, of files without one."
)
def compare(
    settings: Settings,
    screen: Screen,
    left: str,
    right: str,
    only: str | None,
    tolerance: ValueTolerance,
    process_data: bool,
    defaults: bool,
    node_id: int | None,
) -> int:
    """Compare the values of a node, or of a file, with those of another file.

    The values of a file are those that it configures (ParameterValue, actualValue), as a DCF does. Of one that configures none,
    as an EDS is, they are its defaults. Exit status: 0 the same, 1 not the same, 7 the same except for what could not be read, in
    the node or in a file.

    \b
    canopen compare 5 before.dcf
    canopen compare before.dcf after.dcf --only changed --tolerance 1%
    """
    from canopen_data.named_files import open_description

    live = settings.node_id(left) if settings.is_node(left) else None
    if settings.is_node(right) and not Path(right).exists():
        saved = f"node{settings.node_id(right)}.dcf"
        tries = (f"canopen backup {right} -o {saved}", f"canopen compare {left} {saved}")
        raise usage("CO123", f"a node is compared with a file, and {right} is a node", tries=tries)
    descriptions = [
        open_description(path, settings.encoding).description for path in ([right] if live is not None else [left, right])
    ]
    whose = live or node_id or next((each.node_id for each in descriptions if each.node_id), None)
    second = _side(right, descriptions[-1], whose, defaults)
    if live is not None:
        found = run(settings, screen, lambda: _read(settings, screen, live, second))
        missing = frozenset(each.variable.mux for each in found.readings if each.result.is_missing)
        first = Side(node_text(live), second.dictionary, found.values, missing)
    else:
        first = _side(left, descriptions[0], whose, defaults)
    rows = [row for row in differences(first, second, tolerance) if process_data or row.role not in HIDDEN]
    if only is not None:
        rows = [row for row in rows if (row.change is DifferenceKind.CHANGED) == (only == "changed")]
    lost = [finding for each in descriptions for finding in each.lost_settings]
    if settings.json:
        screen.json([_as_json(row) for row in rows])
    else:
        columns = ("object", "name", first.name, second.name)
        if rows:
            screen.table([escape(each) for each in columns], [_cells(row) for row in rows])
        if live is not None:
            tell_unread(screen, found)
        for each in lost[:MAX_NAMED]:
            screen.say(f"[yellow]not compared:[/] {escape(str(each))}")
        for side in (first, second):
            if side.defaults_left_out:
                screen.say(
                    f"[yellow]not compared:[/] {counted(side.defaults_left_out, 'default')} of {escape(side.name)}: "
                    f"it configures {counted(len(side.values), 'value')}, and these were compared. Try: --defaults"
                )
        screen.say(f"{counted(len(rows), 'difference')} between {escape(first.name)} and {escape(second.name)}")
    if rows:
        return ExitCode.DIFFERENT
    return ExitCode.PARTIAL if first.missing or lost else ExitCode.OK


def differences(left: Side, right: Side, tolerance: ValueTolerance) -> list[ComparedObject]:
    """Return the differences by index and subindex. An object that could not be read is no difference."""
    roles = roles_in(left.dictionary, left.values) | roles_in(right.dictionary, right.values)
    rows: list[ComparedObject] = []
    for key in sorted(left.values.keys() | right.values.keys()):
        one, other = left.values.get(key), right.values.get(key)
        variable = (left if other is None else right).dictionary.variable(split_mux(key))
        if key in left.missing or same_value(variable, one, other) or tolerance.allows(one, other):
            continue
        change = DifferenceKind.RIGHT if one is None else DifferenceKind.LEFT if other is None else DifferenceKind.CHANGED
        rows.append(ComparedObject(variable, change, roles[key], one, other))
    return rows


async def _read(settings: Settings, screen: Screen, node_id: int, file: Side) -> Backup:
    """Read the objects of the file from the node."""
    only = [file.dictionary.variable(split_mux(key)) for key in sorted(file.values)]
    async with open_session(settings, screen) as session, session.claim(node_id, file.dictionary):
        node = session.node(node_id).remote
        reading = back_up(node, file.dictionary, only=only, domains=True)
        return await shown(session, screen, f"reading {node_text(node_id)}", reading, ObjectRead)


def _side(path: str, description: DeviceDescription, whose: int | None, defaults: bool) -> Side:
    """Return the values of a file. whose: the node-ID, for a file that names none."""
    from canopen_proto.dictionary.download_order import settings_of

    dictionary = description.dictionary
    node_id = description.node_id or whose
    if node_id is None:
        depends = next((each for each in dictionary if each.adds_node_id or each.configured_adds_node_id), None)
        if depends is not None:
            raise usage("CO120", f"{path} names no node-ID, and {depends.label} depends on that", tries=("--id 5",))
    values = settings_of(dictionary, node_id or 0)
    with_defaults = settings_of(dictionary, node_id or 0, defaults=True)
    if defaults or not values:
        values = with_defaults
    return Side(path, dictionary, values, defaults_left_out=len(with_defaults) - len(values))


def _cells(row: ComparedObject) -> tuple[str, ...]:
    shown_values = ("-" if each is None else both_notations(row.variable, each) for each in (row.left, row.right))
    return place_text(row.variable), *(escape(text) for text in (row.variable.name, *shown_values))


def _as_json(row: ComparedObject) -> dict[str, Any]:
    return object_json(row.variable) | {
        "change": str(row.change),
        "role": str(row.role),
        "left": None if row.left is None else as_json(row.variable, row.left),
        "right": None if row.right is None else as_json(row.variable, row.right),
        "left_hex": (hex_text(row.variable, row.left) if row.left is not None else "") or None,
        "right_hex": (hex_text(row.variable, row.right) if row.right is not None else "") or None,
    }
