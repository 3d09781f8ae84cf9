"""A device with two PDOs each way and objects of every access right, for tests of PDO parameters."""

from __future__ import annotations

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Values, Variable
from canopen_proto.machine import Outbox
from canopen_proto.pdo.parameters import DevicePdos

U8, U16, U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
NODE_ID = 12
OFF = 0x80000000


def communication(index: int, cob_base: int, transmission_type: int) -> Object:
    names = {1: U32, 2: U8, 3: U16, 5: U16, 6: U8}
    fields = [Variable(index, 0, f"{index:X}:count", U8, Access.CONST, 6)]
    for subindex, data_type in names.items():
        default = {1: cob_base, 2: transmission_type}.get(subindex)
        adds = subindex == 1 and not cob_base & OFF
        fields.append(Variable(index, subindex, f"{index:X}:{subindex}", data_type, default=default, adds_node_id=adds))
    return Object.of(f"{index:X}", fields)


def mapping(index: int, *entries: int, room: int = 8) -> Object:
    fields = [Variable(index, 0, f"{index:X}:count", U8, default=len(entries))]
    for subindex in range(1, room + 1):
        default = entries[subindex - 1] if subindex <= len(entries) else 0
        fields.append(Variable(index, subindex, f"{index:X}:{subindex}", U32, default=default))
    return Object.of(f"{index:X}", fields)


def variable(index: int, data_type: DataType, access: Access, mappable: bool = True) -> Object:
    return Object.of(f"o{index:X}", [Variable(index, 0, f"o{index:X}", data_type, access, pdo_mappable=mappable)])


def dictionary() -> ObjectDictionary:
    return ObjectDictionary(
        [
            communication(0x1400, 0x200, 1),
            communication(0x1401, OFF | 0x300, 255),
            communication(0x1800, 0x40000180, 1),
            communication(0x1801, OFF | 0x280, 255),
            mapping(0x1600, 0x60400010, 0x00060010, 0x607A0020),
            mapping(0x1601),
            mapping(0x1A00, 0x60410010, 0x60640020),
            mapping(0x1A01, room=4),
            variable(0x6040, U16, Access.RWW),
            variable(0x607A, DataType.INTEGER32, Access.RW),
            variable(0x6041, U16, Access.RO),
            variable(0x6064, DataType.INTEGER32, Access.RO),
            variable(0x2000, U8, Access.RW),
            variable(0x2001, U8, Access.RWR),
            variable(0x2002, U8, Access.WO),
            variable(0x2003, U8, Access.CONST),
            variable(0x2004, U8, Access.RW, mappable=False),
            variable(0x2005, DataType.DOMAIN, Access.RW),
            variable(0x2006, DataType.REAL32, Access.RW),
            variable(0x2007, DataType.VISIBLE_STRING, Access.RW),
            variable(0x2008, DataType.REAL64, Access.RW),
            Object.of("1000", [Variable(0x1000, 0, "device_type", U32, Access.RO)]),
        ]
    )


class Device:
    """What a LocalNode does with a write: check, store, apply."""

    def __init__(self) -> None:
        self.out = Outbox()
        self.values = Values(dictionary(), NODE_ID)
        self.pdos = DevicePdos(self.out, NODE_ID, self.values)
        self.pdos.set_enabled(True, 0)

    def write(self, index: int, subindex: int, value: Value, now: int = 0) -> AbortCode | None:
        refusal = self.pdos.check_write(index, subindex, value)
        if refusal is None:
            self.values[index << 8 | subindex] = value
            self.pdos.apply(index, subindex, now)
        return refusal

    def write_all(self, *writes: tuple[int, int, int]) -> None:
        for index, subindex, value in writes:
            assert self.write(index, subindex, value) is None, f"{index:04X}:{subindex:02X} = {value:X}"

    def sent(self) -> list[str]:
        frames = [str(frame) for frame in self.out.frames]
        self.out.frames.clear()
        return frames
