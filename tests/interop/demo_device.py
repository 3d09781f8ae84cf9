"""The device of the recorded sessions: the dictionary of CANopenNode's demo, as far as the recordings show it.

Lely's slave was run with the same description.
"""

from __future__ import annotations

from collections.abc import Mapping

from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.model import ObjectType
from canopen_proto.dictionary.standard import standard_object

TEXT = ("Example string with 1000 bytes capacity. It may contain UTF-8 characters, like '€', tabs '\t', newlines, etc.").encode()
NUMBERS, STRINGS, DOMAIN, INPUTS, OUTPUTS, ANALOG_INPUTS, ANALOG_OUTPUTS = 0x2110, 0x2121, 0x2122, 0x6000, 0x6200, 0x6401, 0x6411


def demo_device(node_id: int, changes: Mapping[tuple[int, int], Value] | None = None) -> ObjectDictionary:
    """Its description. changes: other values than the defaults, by (index, subindex): what the device has stored."""

    def pdo(number: int, cob_base: int, direction: int, entries: list[int]) -> list[Object]:
        unused = 0x80000000 if number > 2 else 0
        no_rtr = 0x40000000 if direction == 0x1800 else 0
        parameters: dict[int, Value] = {
            1: cob_base + 0x100 * (number - 1) + node_id | unused | no_rtr,
            2: 254 if unused else 255,
        }
        mapped: dict[int, Value] = {0: len(entries)} | dict(enumerate(entries, start=1))
        return [
            standard_object(direction + number - 1, highest=6 if direction == 0x1800 else 5, defaults=parameters),
            standard_object(direction + number - 1 + 0x200, highest=8, defaults=mapped),
        ]

    def fields(index: int, name: str, data_type: DataType, count: int, access: Access) -> Object:
        highest = Variable(index, 0, f"{name}:highest", DataType.UNSIGNED8, Access.RO, count)
        numbered = [Variable(index, n, f"{name}:{n}", data_type, access, pdo_mappable=True) for n in range(1, count + 1)]
        return Object.of(name, [highest, *numbered], ObjectType.ARRAY)

    strings = [
        Variable(STRINGS, 0, "strings:highest", DataType.UNSIGNED8, Access.RO, 3),
        Variable(STRINGS, 1, "strings:short", DataType.VISIBLE_STRING, Access.RW, "str"),
        Variable(STRINGS, 2, "strings:long", DataType.VISIBLE_STRING, Access.RW, TEXT.decode("latin-1")),
        Variable(STRINGS, 3, "strings:octets", DataType.OCTET_STRING, Access.RW, bytes.fromhex("C83DBB").ljust(10, b"\0")),
    ]
    objects = [
        standard_object(0x1000, 0x000F0191),
        standard_object(0x1001),
        standard_object(0x1003, highest=16),
        standard_object(0x1005),
        standard_object(0x1006),
        standard_object(0x1008, "CANopenDemoLinux"),
        standard_object(0x1009, "---"),
        standard_object(0x100A, ""),
        standard_object(0x1012),
        standard_object(0x1014),
        standard_object(0x1015),
        standard_object(0x1016, highest=8),
        standard_object(0x1017),
        standard_object(0x1018, highest=4, defaults={1: 0, 2: 1, 3: 0, 4: 3}),
        standard_object(0x1019),
        standard_object(0x1029, highest=1),
        standard_object(0x1200, highest=2),
        *pdo(1, 0x200, 0x1400, [0x62000108, 0x62000208]),
        *pdo(2, 0x200, 0x1400, [0x64110110, 0x64110210, 0x64110310, 0x64110410]),
        *pdo(3, 0x200, 0x1400, []),
        *pdo(4, 0x200, 0x1400, []),
        *pdo(1, 0x180, 0x1800, [0x60000108, 0x60000208]),
        *pdo(2, 0x180, 0x1800, [0x64010110, 0x64010210, 0x64010310, 0x64010410]),
        *pdo(3, 0x180, 0x1800, []),
        *pdo(4, 0x180, 0x1800, []),
        fields(NUMBERS, "numbers", DataType.INTEGER32, 16, Access.RW),
        Object.of("strings", strings),
        Object.of("domain", [Variable(DOMAIN, 0, "domain", DataType.DOMAIN, Access.RW)], ObjectType.DOMAIN),
        fields(INPUTS, "inputs", DataType.UNSIGNED8, 8, Access.RO),
        fields(OUTPUTS, "outputs", DataType.UNSIGNED8, 8, Access.RW),
        fields(ANALOG_INPUTS, "analog_inputs", DataType.INTEGER16, 16, Access.RO),
        fields(ANALOG_OUTPUTS, "analog_outputs", DataType.INTEGER16, 8, Access.RW),
    ]
    return _changed(ObjectDictionary(objects), changes or {})


def _changed(dictionary: ObjectDictionary, changes: Mapping[tuple[int, int], Value]) -> ObjectDictionary:
    objects = []
    for each in dictionary.objects.values():
        variables = [
            Variable(
                variable.index,
                variable.subindex,
                variable.name,
                variable.data_type,
                variable.access,
                changes[variable.index, variable.subindex],
                pdo_mappable=variable.pdo_mappable,
            )
            if (variable.index, variable.subindex) in changes
            else variable
            for variable in each.variables.values()
        ]
        objects.append(Object.of(each.name, variables, each.object_type))
    return ObjectDictionary(objects)
