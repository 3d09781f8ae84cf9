"""A device with every communication service that there is, for the conformance cases."""

from __future__ import annotations

from typing import Any

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, ObjectType, Variable
from canopen_proto.dictionary.standard import standard_object

NODE_ID = 5

INPUT_16, INPUT_32, OUTPUT_16, OUTPUT_32 = 0x6401, 0x6404, 0x6411, 0x6414
SETTING, LIMITED, SECRET, PRIVATE, TYPED, SLOT = 0x2000, 0x2001, 0x2002, 0x2003, 0x2004, 0x2005


def _own(index: int, name: str, data_type: DataType, access: Access, **more: Any) -> Object:
    return Object.of(name, [Variable(index, 0, name, data_type, access, **more)])


def _typed() -> Object:
    """An array that tells its structure at subindex 255: data type UNSIGNED16, object type ARRAY."""
    return Object.of(
        "typed",
        [
            Variable(TYPED, 0, "typed:highest_subindex", DataType.UNSIGNED8, Access.CONST, 1),
            Variable(TYPED, 1, "typed:value", DataType.UNSIGNED16, Access.RW),
            Variable(TYPED, 0xFF, "typed:structure", DataType.UNSIGNED32, Access.CONST, 0x0000_0608),
        ],
        ObjectType.ARRAY,
    )


def full_device(*changed: Object, node_id: int = NODE_ID, without: tuple[int, ...] = ()) -> ObjectDictionary:
    """Three SDO servers, two of them valid, and two clients; four RPDOs and four TPDOs of eight entries, two of each valid.

    changed: objects that take the place of others.
    """
    rpdos = [0x200 + node_id, 0x300 + node_id, 0x8000_0400 + node_id, 0x8000_0500 + node_id]
    tpdos = [0x4000_0180 + node_id, 0x4000_0280 + node_id, 0xC000_0380 + node_id, 0xC000_0480 + node_id]
    objects = [
        standard_object(0x1000, 0x0004_0191),
        standard_object(0x1001),
        standard_object(0x1003, highest=4),
        *(standard_object(index) for index in (0x1005, 0x1007)),
        standard_object(0x1008, "conformant device"),
        standard_object(0x1009, "1.0"),
        *(standard_object(index, 0) for index in (0x1006, 0x100C, 0x100D, 0x1015, 0x1017, 0x1019)),
        *(standard_object(index) for index in (0x1012, 0x1014)),
        *(standard_object(index, highest=3) for index in (0x1010, 0x1011)),
        standard_object(0x1016, highest=4),
        standard_object(0x1018, highest=4, defaults={1: 0x29C, 2: 7, 3: 0x1_0002, 4: 1234}),
        standard_object(0x1020, highest=2),
        standard_object(0x1029, highest=1),
        *(standard_object(index) for index in (0x1200, 0x1201)),
        standard_object(0x1202, defaults={1: 0x6D8, 2: 0x6D9}),
        *(standard_object(index) for index in (0x1280, 0x1281)),
        _own(SETTING, "setting", DataType.UNSIGNED32, Access.RW, default=77, pdo_mappable=False),
        _own(LIMITED, "limited", DataType.UNSIGNED8, Access.RW, low_limit=10, high_limit=20, default=15),
        _own(SECRET, "secret", DataType.UNSIGNED16, Access.WO, pdo_mappable=False),
        _own(PRIVATE, "private", DataType.UNSIGNED16, Access.RO, pdo_mappable=False),
        _typed(),
        _own(SLOT, "slot", DataType.INTEGER16, Access.RWR, pdo_mappable=True),
        _own(INPUT_16, "input_16", DataType.INTEGER16, Access.RO, pdo_mappable=True),
        _own(INPUT_32, "input_32", DataType.INTEGER32, Access.RO, pdo_mappable=True),
        _own(OUTPUT_16, "output_16", DataType.INTEGER16, Access.RWW, pdo_mappable=True),
        _own(OUTPUT_32, "output_32", DataType.INTEGER32, Access.RWW, pdo_mappable=True),
    ]
    outputs, inputs = {0: 1, 1: OUTPUT_16 << 16 | 16}, {0: 1, 1: INPUT_16 << 16 | 16}
    for number in range(4):
        rpdo_type, tpdo_type = (255, 255) if number % 2 == 0 else (1, 1)
        objects += [
            standard_object(0x1400 + number, highest=5, defaults={1: rpdos[number], 2: rpdo_type}),
            standard_object(0x1600 + number, highest=8, defaults=outputs),
            standard_object(0x1800 + number, highest=6, defaults={1: tpdos[number], 2: tpdo_type}),
            standard_object(0x1A00 + number, highest=8, defaults=inputs),
        ]
    replaced = {each.index: each for each in (*objects, *changed)}
    return ObjectDictionary(each for index, each in replaced.items() if index not in without)
