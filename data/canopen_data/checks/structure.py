"""Check the objects as a whole: their existence, their lists, their sub-objects, their names.

Source: CiA 306-1 v1.4.0, the lists of objects and the sections of objects; CiA 301 v4.2.0, 7.4.1 (areas) and 7.5.1 (mandatory).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from canopen_data.checks.subject import ERROR, NOTICE, WARNING, Rule, Subject
from canopen_data.describing import MANDATORY
from canopen_data.findings import Finding, first_of
from canopen_proto import indices
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary.model import Object, ObjectType, Variable
from canopen_proto.explained import counted

MAX_NAME: Final = 241
"""Characters of a ParameterName (CiA 306-1)."""


OBJECT_AREA: Final = range(0x1000, 0xC000)
TYPE_AREA: Final = range(0x0001, 0x1000)
STRUCTURE: Final = 0xFF
"""The subindex that describes an object's type; it is not an entry (CiA 301 v4.2.0, 7.4.1)."""

RULES: Final = (
    Rule("mandatory-missing", ERROR, "an object that every CANopen device has is missing"),
    Rule("list-unknown", ERROR, "a list names an object that has no section"),
    Rule("list-missing", WARNING, "an object is in none of the three lists, so that many tools overlook it"),
    Rule("list-twice", WARNING, "an object is listed twice"),
    Rule("list-other", NOTICE, "an object is in a list where its area does not belong"),
    Rule("reserved-index", WARNING, "an index at which no device may have an object"),
    Rule("no-entries", ERROR, "an ARRAY or RECORD without sub-objects"),
    Rule("count-missing", ERROR, "an ARRAY or RECORD without sub 0, which gives its highest subindex"),
    Rule("count-type", WARNING, "sub 0 of an ARRAY or RECORD is not an UNSIGNED8"),
    Rule("count-default", WARNING, "sub 0 is not the highest subindex that the object has"),
    Rule("var-with-entries", WARNING, "a VAR with sub-objects"),
    Rule("array-mixed", WARNING, "an ARRAY whose entries are of different types"),
    Rule("name-empty", WARNING, "an object without a name"),
    Rule("name-long", NOTICE, f"a name of more than {MAX_NAME} characters"),
    Rule("name-twice", NOTICE, "two sub-objects of a RECORD, or two objects, have one name, which then names neither"),
)


def check_lists(subject: Subject) -> Iterator[Finding]:
    """Check mandatory objects, and [MandatoryObjects], [OptionalObjects], [ManufacturerObjects] against the sections."""
    objects = subject.dictionary.objects
    for index, name in zip(MANDATORY, ("device type", "error register", "identity object"), strict=True):
        if index not in objects:
            yield subject.of_entry("mandatory-missing", "MandatoryObjects", "", f"there is no {name} (0x{index:04X})")
    if not subject.has_lists:
        return
    seen: dict[int, str] = {}
    description = subject.description
    for section, listed in (
        ("MandatoryObjects", description.mandatory),
        ("OptionalObjects", description.optional),
        ("ManufacturerObjects", description.manufacturer),
    ):
        for number, index in enumerate(listed, 1):
            where = f"0x{index:04X}"
            if index in seen:
                text = f"{where} is listed twice" if seen[index] == section else f"{where} is in [{seen[index]}] already"
                yield subject.of_entry("list-twice", section, str(number), text)
            elif index not in objects:
                yield subject.of_entry("list-unknown", section, str(number), f"{where} is listed, but has no section")
            elif section != _list_of(index) and not (index in MANDATORY and section == "OptionalObjects"):
                text = f"{where} belongs into [{_list_of(index)}]"
                yield subject.of_entry("list-other", section, str(number), text)
            seen.setdefault(index, section)
    for index in objects:
        if index not in seen and index in OBJECT_AREA and not _is_made(subject, index):
            yield subject.of_object("list-missing", index, f"it is not in [{_list_of(index)}], nor in another list")


def _is_made(subject: Subject, index: int) -> bool:
    """Return whether an object has no section: CompactPDO or a module stands for it, and other tools find it there."""
    return subject.description.document is not None and subject.description.place_of(index) == (0, 0)


def _list_of(index: int) -> str:
    if index in MANDATORY:
        return "MandatoryObjects"
    return "ManufacturerObjects" if index in indices.MANUFACTURER_AREA else "OptionalObjects"


def check_objects(subject: Subject) -> Iterator[Finding]:
    """Check each object by itself: its index, its sub-objects, and its sub 0."""
    for each in subject.dictionary.objects.values():
        is_type = each.object_type in (ObjectType.DEFTYPE, ObjectType.DEFSTRUCT)
        if each.index not in (TYPE_AREA if is_type else OBJECT_AREA):
            place = "data types are at 0x0001 to 0x0FFF" if is_type else "objects are at 0x1000 to 0xBFFF"
            yield subject.of_object("reserved-index", each.index, place)
        if each.object_type in (ObjectType.ARRAY, ObjectType.RECORD):
            yield from _check_entries(subject, each)
        elif each.object_type is ObjectType.VAR and any(subindex not in (0, STRUCTURE) for subindex in each.variables):
            yield subject.of_object(
                "var-with-entries", each.index, f"it is a VAR, but has {counted(len(each.variables), 'sub-object')}", "ObjectType"
            )


def _check_entries(subject: Subject, each: Object) -> Iterator[Finding]:
    kind = "an ARRAY" if each.object_type is ObjectType.ARRAY else "a RECORD"
    entries = [variable for subindex, variable in each.variables.items() if subindex not in (0, STRUCTURE)]
    count = each.variables.get(0)
    if not each.variables:
        yield subject.of_object("no-entries", each.index, f"it is {kind} without any sub-object")
        return
    if count is None:
        yield subject.of_object("count-missing", each.index, "it has no sub 0, which gives its highest subindex")
    elif count.data_type is not DataType.UNSIGNED8:
        text = f"sub 0 is of type {count.data_type.name}; it is an UNSIGNED8 in every device"
        yield subject.of_variable("count-type", count, text, "DataType")
    elif entries and not count.access.writable and not _counts_used(each.index):
        highest = max(variable.subindex for variable in entries)
        told = subject.number(each.index)
        if told is not None and told.value != highest:
            text = f"sub 0 says that {told.value} is the highest subindex; the file has entries up to {highest}"
            yield subject.of_value("count-default", count, text)
    if each.object_type is ObjectType.ARRAY:
        types = {variable.data_type: variable for variable in entries}
        if len(types) > 1:
            first, second, *_ = types.values()
            text = f"it is an ARRAY, but sub {first.subindex} is {first.data_type.name}, sub {second.subindex} is"
            yield subject.of_object("array-mixed", each.index, f"{text} {second.data_type.name}", "ObjectType")


def _counts_used(index: int) -> bool:
    """Return whether sub 0 counts the entries in use, not those that exist: in the error history and in PDO mappings."""
    return index == indices.PREDEFINED_ERROR_FIELD or index in indices.RPDO_MAPPINGS or index in indices.TPDO_MAPPINGS


def check_names(subject: Subject) -> Iterator[Finding]:
    """Check that names exist, are not too long, and occur once. Exceptions: the standard itself gives the records of all PDOs one
    name, and the entries of an ARRAY differ by their number."""
    by_name: dict[str, list[int]] = {}
    for each in subject.dictionary.objects.values():
        if not each.name.strip():
            yield subject.of_object("name-empty", each.index, "the object has no name", "ParameterName")
        elif each.index not in indices.COMMUNICATION_AREA:
            by_name.setdefault(each.name.casefold(), []).append(each.index)
        if len(each.name) > MAX_NAME:
            text = f"its name has {len(each.name)} characters; {MAX_NAME} is the most"
            yield subject.of_object("name-long", each.index, text, "ParameterName")
        if each.object_type in (ObjectType.ARRAY, ObjectType.RECORD):
            yield from _check_field_names(subject, each)
    for first, *others in by_name.values():
        if others:
            text = f"{first_of([f'0x{index:04X}' for index in others])} too"
            yield subject.of_object("name-twice", first, f"this is the name of {text}", "ParameterName")


def _check_field_names(subject: Subject, each: Object) -> Iterator[Finding]:
    by_name: dict[str, list[Variable]] = {}
    for _, variable in sorted(each.variables.items()):
        name = field_name(each, variable.name)
        if name.strip() and each.object_type is ObjectType.RECORD and each.index not in indices.COMMUNICATION_AREA:
            by_name.setdefault(name.casefold(), []).append(variable)
        elif not name.strip():
            yield subject.of_variable("name-empty", variable, "the sub-object has no name", "ParameterName")
    for first, *others in by_name.values():
        if others:
            text = f"{first_of([f'sub {variable.subindex}' for variable in others])} too"
            yield subject.of_variable("name-twice", first, f"this is the name of {text}", "ParameterName")


def field_name(each: Object, name: str) -> str:
    """Return a sub-object's own name, without its object's."""
    return name.removeprefix(f"{each.name}:")


CHECKS: Final[tuple[Callable[[Subject], Iterator[Finding]], ...]] = (check_lists, check_objects, check_names)
