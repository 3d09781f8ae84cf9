"""Compare two descriptions by meaning: two files that say the same in another form do not differ.

`compare` goes through the objects of both by index, then through their variables by subindex, then field by field. It also
compares the facts about the device as a whole. A `Difference` is plain data: the place, the field, and both values as they are in
the description (numbers as numbers). A value of None means that the file does not have it.

These are no differences: the order of objects and sections, the form of a number, the spelling of access rights, comments, the
file's own dates and names (`FileInfo`), and the file's origin.

A value that depends on the node-ID is a `Relative`: $NODEID+0x180 differs from 0x180.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from enum import IntEnum, StrEnum
from typing import Any, Final, NamedTuple

from canopen_data.description import DeviceDescription
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.model import Object, ObjectDictionary, Variable

__all__ = ["Change", "Difference", "compare", "compare_dictionaries"]


class Change(StrEnum):
    """How the second description differs from the first in one thing."""

    ADDED = "added"
    REMOVED = "removed"
    CHANGED = "changed"


class Relative(NamedTuple):
    """A value that the node-ID is added to."""

    value: int

    def __str__(self) -> str:
        return f"$NODEID+0x{self.value:X}"


@dataclass(frozen=True, slots=True)
class Difference:
    """One difference.

    index, subindex: of the object; None: the device as a whole, or an object as a whole. name: of the object. field: its name in
    an EDS ("DefaultValue"), "" if the whole thing was added or removed. before, after: both values.
    """

    change: Change
    index: int | None
    subindex: int | None
    name: str
    field: str = ""
    before: Any = None
    after: Any = None

    @property
    def place(self) -> str:
        """ "6041:00", "6041" for an object as a whole, "" for the device."""
        if self.index is None:
            return ""
        return f"{self.index:04X}" if self.subindex is None else f"{self.index:04X}:{self.subindex:02X}"

    def __str__(self) -> str:
        where = " ".join(each for each in (self.place, self.name) if each)
        if not self.field:
            return f"{where}: {self.change}"
        return f"{where + ': ' if where else ''}{self.field} {shown(self.before)} -> {shown(self.after)}"


_OF_VARIABLES: Final = {
    "name": "ParameterName",
    "data_type": "DataType",
    "access": "AccessType",
    "low_limit": "LowLimit",
    "high_limit": "HighLimit",
    "pdo_mappable": "PDOMapping",
    "object_flags": "ObjFlags",
    "unit": "unit",
    "factor": "factor",
    "denotation": "Denotation",
    "upload_file": "UploadFile",
    "download_file": "DownloadFile",
}
_OF_OBJECTS: Final = {
    "name": "ParameterName",
    "object_type": "ObjectType",
    "object_flags": "ObjFlags",
    "denotation": "Denotation",
}
_OF_HEAD: Final = ("dummies", "modules", "connected_modules", "dynamic_channels")


def compare(before: DeviceDescription, after: DeviceDescription) -> list[Difference]:
    """Return all differences: first of the device as a whole, then by index and subindex. Empty if both say the same."""
    return [*_of_device(before, after), *compare_dictionaries(before.dictionary, after.dictionary)]


def compare_dictionaries(before: ObjectDictionary, after: ObjectDictionary) -> list[Difference]:
    """Compare the objects alone; see `compare`."""
    found: list[Difference] = []
    for index in sorted(before.objects.keys() | after.objects.keys()):
        old, new = before.objects.get(index), after.objects.get(index)
        if old is None or new is None:
            known = old or new
            assert known is not None
            change = Change.ADDED if old is None else Change.REMOVED
            found.append(Difference(change, index, None, known.name))
        else:
            found += _of_object(old, new)
    return found


def _of_object(old: Object, new: Object) -> Iterator[Difference]:
    is_one = list(old.variables) == list(new.variables) == [0] and old.object_type == new.object_type
    if not is_one:  # a VAR's own fields are those of its variable
        says_type = old.data_type is not None and new.data_type is not None
        names = _OF_OBJECTS | ({"data_type": "DataType"} if says_type else {})
        yield from _fields(old, new, names, old.index, None, old.name)
    for subindex in sorted(old.variables.keys() | new.variables.keys()):
        before, after = old.variables.get(subindex), new.variables.get(subindex)
        if before is None or after is None:
            known = before or after
            assert known is not None
            change = Change.ADDED if before is None else Change.REMOVED
            yield Difference(change, old.index, subindex, known.name)
            continue
        yield from _fields(before, after, _of_variable(old, new), old.index, subindex, before.name)
        for field, was, now in (
            ("DefaultValue", _default_of(before), _default_of(after)),
            ("ParameterValue", _configured_of(before), _configured_of(after)),
        ):
            if not _same(was, now):
                yield Difference(Change.CHANGED, old.index, subindex, before.name, field, was, now)


def _of_variable(old: Object, new: Object) -> Mapping[str, str]:
    """Return the fields to compare. If a renamed object's name is part of its sub-objects' names, only the object's is
    reported."""
    if old.name == new.name or list(old.variables) == [0]:
        return _OF_VARIABLES
    before = [_own_name(old, each) for each in old.variables.values()]
    after = [_own_name(new, each) for each in new.variables.values()]
    if before != after:
        return _OF_VARIABLES
    return {field: name for field, name in _OF_VARIABLES.items() if field != "name"}


def _own_name(each: Object, variable: Variable) -> str:
    return variable.name.removeprefix(f"{each.name}:")


def _fields(
    old: object, new: object, names: Mapping[str, str], index: int | None, subindex: int | None, name: str
) -> Iterator[Difference]:
    for field, shown_as in names.items():
        was, now = getattr(old, field), getattr(new, field)
        if not _same(was, now):
            yield Difference(Change.CHANGED, index, subindex, name, shown_as, was, now)


def _same(was: object, now: object) -> bool:
    """Return whether both are equal; two NaN count as equal here."""
    return was == now or (was != was and now != now)


def _default_of(variable: Variable) -> Value | Relative | None:
    value = variable.default
    return Relative(value) if variable.adds_node_id and isinstance(value, int) else value


def _configured_of(variable: Variable) -> Value | Relative | None:
    value = variable.configured
    return Relative(value) if variable.configured_adds_node_id and isinstance(value, int) else value


def _of_device(before: DeviceDescription, after: DeviceDescription) -> Iterator[Difference]:
    old, new = before.device_info, after.device_info
    yield from _fields(old, new, {each.name: each.name for each in fields(old)}, None, None, "device")
    was, now = before.commissioning, after.commissioning
    if was is not None and now is not None:
        yield from _fields(was, now, {each.name: each.name for each in fields(was)}, None, None, "commissioning")
    elif was is not now:
        yield Difference(Change.ADDED if was is None else Change.REMOVED, None, None, "commissioning", "", was, now)
    for field in _OF_HEAD:
        yield from _fields(before, after, {field: field}, None, None, "")


def shown(value: Any) -> str:
    """Return a value for people: data types and access by name, whole numbers also in hexadecimal, "-" for none."""
    match value:
        case None:
            return "-"
        case bool():
            return "yes" if value else "no"
        case IntEnum():
            return value.name
        case Relative() | StrEnum():
            return str(value)
        case int():
            return str(value) if -10 < value < 10 else f"{value} (0x{value:X})" if value > 0 else str(value)
        case bytes():
            return value.hex() or "empty"
        case str():
            return repr(value)
        case frozenset():
            return ", ".join(str(each) for each in sorted(value)) or "none"
    return str(value)
