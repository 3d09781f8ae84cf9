"""A typed view of a device: Python text with a key for each object of its file (`canopen_proto.dictionary.typed`).

An object with one value is an attribute of the view, a record or an array is a class in it. All names are made in one way: that
of the object in the dictionary ("record:field" is split), in small letters, and every run of other characters than letters and
digits becomes one underscore: "Position actual value" -> position_actual_value. A name that begins with a digit gets an n before
it, and one that Python or this text needs itself an underscore behind it.

If several objects would have the same name, each gets its index behind it (position_6064), or in a record its subindex. An
object of the first logical device keeps its name, though, if only those of further ones (0x6800 and on) share it.
"""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

from canopen_data.description import DeviceDescription
from canopen_data.eds.writer_values import one_line
from canopen_proto import indices
from canopen_proto.datatypes import DataType, is_integer
from canopen_proto.dictionary.objects import Access, Object, ObjectType, Variable
from canopen_proto.multiplexer import mux, mux_text

_OTHER: Final = re.compile(r"[\W_]+")
_RESERVED: Final = {*keyword.kwlist, "bool", "bytes", "datetime", "float", "int", "mro", "str"}
_TYPES: Final = {
    DataType.BOOLEAN: "bool",
    DataType.REAL32: "float",
    DataType.REAL64: "float",
    DataType.VISIBLE_STRING: "str",
    DataType.UNICODE_STRING: "str",
    DataType.TIME_OF_DAY: "datetime.datetime",
    DataType.TIME_DIFFERENCE: "datetime.timedelta",
}
_KEYS: Final = {Access.RO: "ReadOnly", Access.CONST: "ReadOnly", Access.WO: "WriteOnly"}
_SINGLE: Final = (ObjectType.VAR, ObjectType.DOMAIN)

T = TypeVar("T", Object, Variable)


@dataclass(frozen=True)
class Collision:
    """Objects of one name. names: what each is called now, by its place ("0x6064:00")."""

    name: str
    names: dict[str, str]


@dataclass(frozen=True)
class Stubs:
    """The text of a typed view, how many keys it has, and the names that were shared."""

    text: str
    count: int
    collisions: tuple[Collision, ...]


def stubs_of(description: DeviceDescription, class_name: str) -> Stubs:
    """Return the typed view of a device. class_name: of the view, a Python name."""
    collisions: list[Collision] = []
    body: list[str] = []
    count = 0
    objects = [each for each in description.dictionary.objects.values() if each.variables]
    for name, each in _named(objects, [_record_name(each) for each in objects], collisions, "", lambda one: f"{one.index:04X}"):
        variables = list(each.variables.values())
        count += len(variables)
        if len(variables) == 1 and each.object_type in _SINGLE:
            body += ["", *_key(name, variables[0], "    ")]
            continue
        body += ["", f"    class {name}:", f"        {_quoted(f'0x{each.index:04X} {each.name}')}"]
        fields = [variable.name.rpartition(":")[2] for variable in variables]
        for field, variable in _named(variables, fields, collisions, f"{name}.", lambda one: f"{one.subindex:02X}"):
            body += ["", *_key(field, variable, "        ")]
    info = description.device_info
    device = " ".join(filter(None, (info.vendor_name, info.product_name))) or "a device"
    source = re.split(r"[/\\]", description.source)[-1]
    title = f"Made by `canopen eds stubs` of {source or device}: keys for `node.read` and `node.write`."
    text = "\n".join([f"class {class_name}:", f"    {_quoted(device)}", *body, ""])
    head = [_quoted(title), ""]
    head += ["import datetime", ""] if "datetime." in text else []
    kinds = [kind for kind in ("ReadOnly", "ReadWrite", "WriteOnly") if f" = {kind}[" in text]
    head += [f"from canopen_proto.dictionary import {', '.join(kinds)}"] if kinds else []
    return Stubs("\n".join([*head, "", "", text]), count, tuple(collisions))


def identifier(name: str) -> str:
    """Return a name as Python can have it; see this module's text."""
    text = _OTHER.sub("_", unicodedata.normalize("NFKC", name)).strip("_").lower()
    if not text.isidentifier():
        text = f"n{text}" if text and f"n{text}".isidentifier() else "unnamed"
    return f"{text}_" if text in _RESERVED else text


def _record_name(each: Object) -> str:
    """Return the name of an object: for a record with whole names of its fields, what these begin with."""
    if each.object_type in _SINGLE and len(each.variables) == 1:
        return next(iter(each.variables.values())).name
    records = {variable.name.partition(":")[0] for variable in each.variables.values() if ":" in variable.name}
    return records.pop() if len(records) == 1 else each.name


def _named(
    parts: Sequence[T], names: Iterable[str], collisions: list[Collision], within: str, number_of: Callable[[T], str]
) -> list[tuple[str, T]]:
    """Return the parts with their names in Python, no two of which are the same. within: for the names in a collision."""
    groups: dict[str, list[T]] = defaultdict(list)
    for part, name in zip(parts, names, strict=True):
        groups[identifier(name)].append(part)
    taken = set(groups)
    chosen: dict[tuple[int, int], str] = {}
    for name, group in groups.items():
        first = [part for part in group if part.index not in indices.FURTHER_DEVICES]
        keeper = first[0] if len(first) == 1 else None
        for part in group:
            own = name if len(group) == 1 or part is keeper else f"{name.rstrip('_')}_{number_of(part)}".lower()
            while own != name and own in taken:
                own += "_"
            taken.add(own)
            chosen[_place(part)] = own
        if len(group) > 1:
            named = {mux_text(mux(*_place(part))): within + chosen[_place(part)] for part in group}
            collisions.append(Collision(within + name, named))
    return [(chosen[_place(part)], part) for part in parts]


def _place(part: Object | Variable) -> tuple[int, int]:
    return part.index, part.subindex if isinstance(part, Variable) else 0


def _key(name: str, variable: Variable, indent: str) -> list[str]:
    """Return the lines of one key."""
    kind = _KEYS.get(variable.access, "ReadWrite")
    value = _TYPES.get(variable.data_type, "int" if is_integer(variable.data_type) else "bytes")
    place = f"0x{variable.index:04X}_{variable.subindex:02X}"
    return [f"{indent}{name} = {kind}[{value}]({place})", f"{indent}{_quoted(_about(variable))}"]


def _about(variable: Variable) -> str:
    """Return what an IDE shows: place, name, type, unit, range, default."""
    parts = [f"{mux_text(variable.mux)} {variable.name}", variable.data_type.name]
    if variable.unit or variable.factor != 1:
        parts.append(f"{variable.factor:g} {variable.unit}".removeprefix("1 ").strip())
    if variable.low_limit is not None or variable.high_limit is not None:
        low, high = ("" if limit is None else f"{limit}" for limit in (variable.low_limit, variable.high_limit))
        parts.append(f"{low}..{high}")
    if variable.default is not None and not isinstance(variable.default, bytes):
        parts.append(f"default {'node-ID + ' if variable.adds_node_id else ''}{variable.default}")
    if variable.pdo_mappable:
        parts.append("PDO")
    return ", ".join(parts) + (f". {variable.description}" if variable.description else "")


def _quoted(text: str) -> str:
    """Return a text as a docstring of one line, whatever is in it."""
    shown = "".join(each if each.isprintable() else " " for each in one_line(text))
    escaped = shown.replace("\\", "\\\\").replace('"', '\\"')
    return f'"""{escaped}"""'
