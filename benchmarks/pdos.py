"""PDO decode: a TPDO with four mapped objects comes in (16 + 8 + 32 + 8 bits), and four Python values are read.

Both sides begin with CAN-ID and data, as in heartbeats.py, and end with the same four ints. Ours reads them from the
PdoReceived event's `components` and also keeps them by object in the node's values; the peer decodes when `raw` is read,
which is what its user does. For both, all four are mapped on whole bytes, the common case; the second case has fields that
are not (12 + 4 + 20 + 28 bits of UNSIGNED32 objects), where the peer, too, gets all four right.
"""

from __future__ import annotations

from collections.abc import Callable

from canopen import ObjectDictionary as TheirDictionary
from canopen import RemoteNode as TheirNode
from canopen.objectdictionary import datatypes
from direct import coupled_networks, record, variable
from measure import Case

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND
from canopen_proto.network import Network
from canopen_proto.pdo.consumer import PdoConsumer, PdoReceived
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_proto.remote_node import RemoteNode

NODE_ID = 12
TPDO1 = 0x180 + NODE_ID
PAYLOADS = [bytes.fromhex(text) for text in ("370207FFFFFFFF00", "2714F8785634123F", "4002017F00008005", "3702070000000000")]

Field = tuple[str, int, DataType, int]
WHOLE_BYTES: list[Field] = [
    ("statusword", 0x6041, DataType.UNSIGNED16, 16),
    ("modes_of_operation_display", 0x6061, DataType.INTEGER8, 8),
    ("position_actual_value", 0x6064, DataType.INTEGER32, 32),
    ("error_register", 0x1001, DataType.UNSIGNED8, 8),
]
PARTS: list[Field] = [(f"part_{bits}", 0x2000 + bits, DataType.UNSIGNED32, bits) for bits in (12, 4, 20, 28)]


def _theirs(fields: list[Field]) -> Callable[[int], object]:
    dictionary = TheirDictionary()
    for name, index, data_type, _ in fields:
        dictionary.add_object(variable(name, index, 0, int(data_type)))
    communication = [variable("count", 0x1800, 0, datatypes.UNSIGNED8), variable("cob_id", 0x1800, 1, datatypes.UNSIGNED32)]
    dictionary.add_object(record("tpdo_1_communication", 0x1800, *communication))
    dictionary.add_object(record("tpdo_1_mapping", 0x1A00, variable("count", 0x1A00, 0, datatypes.UNSIGNED8)))
    network, _ = coupled_networks()
    node = TheirNode(NODE_ID, dictionary)
    network[NODE_ID] = node
    tpdo = node.tpdo[1]
    tpdo.cob_id, tpdo.enabled = TPDO1, True
    for _, index, _, bits in fields:
        tpdo.add_variable(index, 0, bits)
    tpdo.subscribe()

    def decode(count: int) -> object:
        values: list[object] = []
        for number in range(count):
            network.notify(TPDO1, bytearray(PAYLOADS[number & 3]), 0.0)
            values = [mapped.raw for mapped in tpdo.map]
        return values

    return decode


def _decoder(network: Network) -> Callable[[int], object]:
    def decode(count: int) -> object:
        values: tuple[object, ...] = ()
        now = 0
        for number in range(count):
            now += MILLISECOND
            network.receive(Frame(TPDO1, PAYLOADS[number & 3]), now)
            _, events = network.drain(now)
            for report in events:
                if isinstance(report, PdoReceived):
                    values = report.components
            if network.next_deadline() <= now:
                network.handle_timeout(now)
        return list(values)

    return decode


def _mapping(fields: list[Field]) -> Mapping:
    return Mapping(MappedEntry(index, 0, bits, data_type, name) for name, index, data_type, bits in fields)


def _our_consumer(fields: list[Field]) -> Callable[[int], object]:
    network = Network()
    consumer = PdoConsumer(network.out, NODE_ID, 1, TPDO1, _mapping(fields), {})
    consumer.set_enabled(True, 0)
    network.attach(consumer)
    return _decoder(network)


def _our_node(fields: list[Field]) -> Callable[[int], object]:
    network = Network()
    objects = [Object.of(name, [Variable(index, 0, name, data_type)]) for name, index, data_type, _ in fields]
    node = RemoteNode(network.out, NODE_ID, ObjectDictionary(objects))
    network.attach(node)
    node.add_tpdo(1, TPDO1, _mapping(fields), 0)
    return _decoder(network)


def _case(title: str, ours: Callable[[int], object], theirs: Callable[[int], object]) -> Case:
    def check() -> None:
        for count in range(1, len(PAYLOADS) + 1):
            assert ours(count) == theirs(count), (ours(count), theirs(count))

    return Case(title, ours, theirs, check)


def cases() -> list[Case]:
    """The common case by a consumer alone and by the whole view of a node, then fields across bytes."""
    whole_bytes = _theirs(WHOLE_BYTES)
    return [
        _case("PDO decode, 4 objects (PdoConsumer)", _our_consumer(WHOLE_BYTES), whole_bytes),
        _case("PDO decode, 4 objects (RemoteNode)", _our_node(WHOLE_BYTES), whole_bytes),
        _case("PDO decode, 4 objects across bytes (PdoConsumer)", _our_consumer(PARTS), _theirs(PARTS)),
    ]
