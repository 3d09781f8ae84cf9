"""Small devices for tests: a dictionary with every communication object that has an effect, and a few objects of its own."""

from __future__ import annotations

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.local_node import LocalNode
from canopen_proto.network import Network
from canopen_proto.remote_node import RemoteNode
from tests.core.bus import Bus

INPUT, OUTPUT, LIMITED, TEXT, TABLE = 0x2000, 0x2001, 0x2002, 0x2003, 0x2100


def io_device(node_id: int = 5, heartbeat_ms: int = 0) -> ObjectDictionary:
    """An I/O device: RPDO1 writes OUTPUT (type 255), RPDO2 too (type 1); TPDO1 sends INPUT (type 255), TPDO2 too (type 1)."""

    def own(index: int, name: str, data_type: DataType, access: Access, **more: object) -> Object:
        return Object.of(name, [Variable(index, 0, name, data_type, access, pdo_mappable=True, **more)])  # type: ignore[arg-type]

    return ObjectDictionary(
        [
            standard_object(0x1000, 0x191),
            standard_object(0x1001),
            standard_object(0x1003, highest=3),
            standard_object(0x1005),
            standard_object(0x1006),
            standard_object(0x1014),
            standard_object(0x1015),
            standard_object(0x1016, highest=2),
            standard_object(0x1017, heartbeat_ms),
            standard_object(0x1018, highest=4, defaults={1: 0x29C, 2: 7}),
            standard_object(0x1019),
            standard_object(0x1029, highest=1),
            standard_object(0x1400, highest=5, defaults={1: 0x200 + node_id, 2: 255}),
            standard_object(0x1401, highest=5, defaults={1: 0x300 + node_id, 2: 1}),
            standard_object(0x1600, highest=2, defaults={0: 1, 1: 0x20010010}),
            standard_object(0x1601, highest=2, defaults={0: 1, 1: 0x20010010}),
            standard_object(0x1800, highest=6, defaults={1: 0x180 + node_id, 2: 255}),
            standard_object(0x1801, highest=6, defaults={1: 0x280 + node_id, 2: 1}),
            standard_object(0x1A00, highest=2, defaults={0: 1, 1: 0x20000010}),
            standard_object(0x1A01, highest=2, defaults={0: 1, 1: 0x20000010}),
            own(INPUT, "input", DataType.INTEGER16, Access.RO),
            own(OUTPUT, "output", DataType.INTEGER16, Access.RW),
            own(LIMITED, "limited", DataType.UNSIGNED8, Access.RW, low_limit=10, high_limit=20, default=10),
            own(TEXT, "text", DataType.VISIBLE_STRING, Access.RW, default="an I/O device with a long name"),
        ]
    )


def whole_device() -> ObjectDictionary:
    """An I/O device with every communication object that has an effect, short lists of each."""
    fields = [Variable(TABLE, 0, "table:count", DataType.UNSIGNED8, Access.CONST, 3)]
    fields += [Variable(TABLE, each, f"table:{each}", DataType.INTEGER16, pdo_mappable=True) for each in (1, 2, 3)]
    objects = [Object.of("table", fields)]
    objects += [standard_object(index) for index in (0x1007, 0x100C, 0x100D, 0x1012, 0x1280)]
    objects += [standard_object(0x1201, defaults={1: 0x6A1, 2: 0x6A2})]
    objects += [standard_object(index, highest=2) for index in (0x1010, 0x1011, 0x1028, 0x1029, 0x1FA0, 0x1FD0)]
    for number in (2, 3):
        objects += [
            standard_object(0x1400 + number, highest=6, defaults={1: 0x80000000}),
            standard_object(0x1600 + number, highest=2),
            standard_object(0x1800 + number, highest=6, defaults={1: 0x80000000}),
            standard_object(0x1A00 + number, highest=2),
        ]
    return io_device().with_objects(objects)


class Pair:
    """A master's Network with a RemoteNode, and a LocalNode with another, on a bus in virtual time."""

    def __init__(self, dictionary: ObjectDictionary | None = None, *, boot: bool = True) -> None:
        self.bus = Bus()
        dictionary = dictionary or io_device()
        self.master = self.bus.attach(Network())
        self.remote = RemoteNode(self.master.out, 5, dictionary)
        self.master.attach(self.remote)
        self.device = self.bus.attach(Network())
        self.local = LocalNode(self.device.out, 5, dictionary)
        self.device.attach(self.local)
        if boot:
            self.local.boot(self.bus.now)
            self.bus.run(1_000_000)
            self.bus.events.clear()
            self.bus.sent.clear()
