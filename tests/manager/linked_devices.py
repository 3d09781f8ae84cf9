"""Devices for tests of PDO linking: their dictionaries, and simulated ones that get the writes of a plan."""

from __future__ import annotations

from dataclasses import replace

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Direction, Object, ObjectDictionary, Variable
from canopen_proto.frame import COB_ID_NO_RTR, RPDO1, TPDO1
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND
from canopen_proto.manager.linking import KnownNode, LinkPlan
from canopen_proto.pdo.settings import communication_index, mapping_index
from canopen_proto.testing import World
from tests.core.pdo_device import OFF, U8, U32, communication, mapping

UNSIGNED = frozenset({0x05, 0x06, 0x07})
"""The dummy entries that most devices take: UNSIGNED8, 16 and 32."""
I16, I32, U16, REAL = DataType.INTEGER16, DataType.INTEGER32, DataType.UNSIGNED16, DataType.REAL32
OBJECTS = {0x2000: U8, 0x2002: U16, 0x2004: U32, 0x2006: I16, 0x2008: I32, 0x200A: REAL, 0x200C: DataType.UNSIGNED64}
"""Data type by index: sources there, and the targets of these types one index above."""


def dictionary_with(
    rpdos: int = 4, tpdos: int = 4, *, valid: bool = False, room: int = 8, sync: bool = True, more: tuple[Object, ...] = ()
) -> ObjectDictionary:
    """Sources and targets of many types, and so many PDOs without objects. valid: they are, as many files have them."""
    objects = [Object.of("device type", [Variable(0x1000, 0, "device type", U32, Access.RO)])]
    if sync:
        objects.append(Object.of("cob-id sync", [Variable(0x1005, 0, "cob-id sync", U32, default=0x80)]))
    for direction, count, base in ((Direction.RPDO, rpdos, RPDO1), (Direction.TPDO, tpdos, TPDO1 | COB_ID_NO_RTR)):
        for number in range(1, count + 1):
            cob_base = base + 0x100 * (number - 1) if valid and number < 5 else OFF
            objects.append(communication(communication_index(direction, number), cob_base, 255))
            objects.append(mapping(mapping_index(direction, number), room=room))
    for index, data_type in OBJECTS.items():
        source = Variable(index, 0, f"from {data_type.name.lower()}", data_type, Access.RO, pdo_mappable=True)
        target = Variable(index + 1, 0, f"to {data_type.name.lower()}", data_type, Access.RWW, pdo_mappable=True)
        objects += [Object.of(source.name, [source]), Object.of(target.name, [target])]
    return ObjectDictionary([*objects, *more])


DEVICE = dictionary_with()


def member(name: str, node_id: int, dictionary: ObjectDictionary = DEVICE, dummies: frozenset[int] = UNSIGNED) -> KnownNode:
    return KnownNode(name, node_id, dictionary, 8, dummies)


def with_object(dictionary: ObjectDictionary, index: int, subindex: int, **changes: object) -> ObjectDictionary:
    """The dictionary with another description of one variable."""
    old = dictionary.objects[index]
    variables = {**old.variables, subindex: replace(old.variables[subindex], **changes)}  # type: ignore[arg-type]
    return dictionary.with_objects([Object.of(old.name, variables.values(), old.object_type)])


def with_pdo(dictionary: ObjectDictionary, direction: Direction, number: int, cob_id: int, *entries: int) -> ObjectDictionary:
    """The dictionary with other defaults of one PDO. cob_id: without the node-ID."""
    places = communication_index(direction, number), mapping_index(direction, number)
    return dictionary.with_objects([communication(places[0], cob_id, 1), mapping(places[1], *entries)])


class Linked:
    """Simulated devices on a bus that have taken the writes of a plan while Pre-operational, and are Operational now."""

    def __init__(self, plan: LinkPlan) -> None:
        self.world = World()
        self.plan = plan
        self.nodes: dict[str, LocalNode] = {}
        for each in plan.members:
            node = self.nodes[each.name] = self.world.device(each.dictionary, each.node_id)
            for index, subindex, data in plan.writes_of(each.name):
                refusal = node.write(index, subindex, data, self.world.now)
                assert refusal is None, f"{each.name} 0x{index:04X}:{subindex:02X}={data.hex()}: {refusal!r}"
        self.run()
        self.world.bus().send("000#0100")
        self.run()

    def sync(self) -> None:
        self.world.bus().send("080#")
        self.run()

    def run(self) -> None:
        """Let the frames arrive: event timers run for ever."""
        self.world.advance(MILLISECOND)
