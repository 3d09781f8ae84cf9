"""A description with which nothing is wrong, and ways to put one thing wrong in it: for the tests of the checks."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, TypeAlias

from canopen_data.description import Commissioning, DeviceDescription, DeviceInfo, FileInfo, FileKind
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, ObjectType, Variable
from canopen_proto.dictionary.standard import standard_object, standard_variable

Change: TypeAlias = Callable[[DeviceDescription], DeviceDescription]

GAIN = Variable(0x2000, 0, "Gain", DataType.UNSIGNED16, default=5, low_limit=0, high_limit=100, pdo_mappable=True)
OFFSET = Variable(0x2001, 0, "Offset", DataType.INTEGER32, default=-5)
LABEL = Variable(0x2002, 0, "Label", DataType.VISIBLE_STRING, Access.CONST, default="A")
TABLE = Object.of(
    "Table",
    [
        Variable(0x2003, 0, "Table:Highest", DataType.UNSIGNED8, Access.CONST, default=2),
        Variable(0x2003, 1, "Table:First", DataType.UNSIGNED16),
        Variable(0x2003, 2, "Table:Second", DataType.UNSIGNED16),
    ],
    ObjectType.ARRAY,
)
RPDO = (0x60400010, 0x00050008)
TPDO = (0x60410010, 0x20000010)


def pdo(communication: int, base: int, entries: Iterable[int]) -> list[Object]:
    """Both records of PDO 1 of a direction."""
    mapped = dict(enumerate(entries, 1))
    record = standard_object(communication, highest=2, defaults={0: 2, 2: 255})
    cob_id = replace(record.variables[1], default=base, adds_node_id=True)
    record = replace(record, variables={**record.variables, 1: cob_id})
    return [record, standard_object(communication + 0x200, highest=4, defaults={0: len(mapped), **mapped})]


def objects() -> list[Object]:
    """Of a small drive."""
    return [
        standard_object(0x1000, 0x0002_0192),
        standard_object(0x1001),
        standard_object(0x1005),
        standard_object(0x1014),
        standard_object(0x1016, highest=2, defaults={1: 0x0005_00C8, 2: 0x0006_00C8}),
        standard_object(0x1017, 100),
        standard_object(0x1018, highest=4, defaults={1: 0x77, 2: 0x10, 3: 0x20}),
        *pdo(0x1400, 0x200, RPDO),
        *pdo(0x1800, 0x180, TPDO),
        standard_object(0x6040),
        standard_object(0x6041),
        *(Object.of(each.name, [each]) for each in (GAIN, OFFSET, LABEL)),
        TABLE,
    ]


def clean(kind: FileKind = FileKind.EDS) -> DeviceDescription:
    """Nothing is wrong with this one. A DCF is of node 3."""
    of_device = objects()
    indices = [each.index for each in of_device]
    return DeviceDescription(
        ObjectDictionary(of_device, source="drive.eds"),
        kind,
        "folder/drive.eds",
        FileInfo("drive.eds", 1, 1, "4.0", "A drive", "01:33PM", "05-23-2013", "me", "01:33PM", "05-23-2013", "me"),
        DeviceInfo("Acme", 0x77, "Drive", 0x10, 0x20, bit_rates=frozenset({500}), granularity=8, rpdo_count=1, tpdo_count=1),
        Commissioning(3, "axis", 500) if kind in (FileKind.DCF, FileKind.XDC) else None,
        dummies={int(DataType.UNSIGNED8): True},
        mandatory=(0x1000, 0x1001, 0x1018),
        optional=tuple(each for each in indices if each not in (0x1000, 0x1001, 0x1018) and not 0x2000 <= each < 0x6000),
        manufacturer=(0x2000, 0x2001, 0x2002, 0x2003),
    )


def without(*indices: int) -> Change:
    """Without some objects, which are not listed either."""

    def change(description: DeviceDescription) -> DeviceDescription:
        kept = [each for each in description.dictionary.objects.values() if each.index not in indices]
        lists = {
            name: tuple(each for each in getattr(description, name) if each not in indices)
            for name in ("mandatory", "optional", "manufacturer")
        }
        return replace(description, dictionary=ObjectDictionary(kept), **lists)

    return change


def with_object(added: Object, listed: bool = True) -> Change:
    """With an object more, or another one in its place."""

    def change(description: DeviceDescription) -> DeviceDescription:
        is_new = added.index not in description.dictionary.objects
        changed = replace(description, dictionary=description.dictionary.with_objects([added]))
        if not (listed and is_new):
            return changed
        name = "manufacturer" if 0x2000 <= added.index < 0x6000 else "optional"
        return replace(changed, **{name: (*getattr(changed, name), added.index)})

    return change


def with_variable(variable: Variable) -> Change:
    """With a VAR more, or another one in its place."""
    return with_object(Object.of(variable.name, [variable]))


def field(index: int, subindex: int, **changes: Any) -> Change:
    """With changes in one variable; a subindex that the object does not have is taken from the standard."""

    def change(description: DeviceDescription) -> DeviceDescription:
        old = description.dictionary.objects[index]
        variable = old.variables.get(subindex) or standard_variable(index, subindex)
        variables = dict(sorted({**old.variables, subindex: replace(variable, **changes)}.items()))
        return replace(description, dictionary=description.dictionary.with_objects([replace(old, variables=variables)]))

    return change


def whole(index: int, **changes: Any) -> Change:
    """With changes in one object."""

    def change(description: DeviceDescription) -> DeviceDescription:
        return with_object(replace(description.dictionary.objects[index], **changes))(description)

    return change


def info(**changes: Any) -> Change:
    """With changes in [DeviceInfo]."""
    return lambda description: replace(description, device_info=replace(description.device_info, **changes))


def file(**changes: Any) -> Change:
    """With changes in [FileInfo]."""
    return lambda description: replace(description, file_info=replace(description.file_info, **changes))


def head(**changes: Any) -> Change:
    """With changes in the description itself."""
    return lambda description: replace(description, **changes)


def several(*changes: Change) -> Change:
    """One after the other."""

    def change(description: DeviceDescription) -> DeviceDescription:
        for each in changes:
            description = each(description)
        return description

    return change
