"""The PDOs that a master exchanges with the nodes of a bus, as settings. Nothing is sent, and no node is made."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from canopen_master import Master, Node
from canopen_proto.dictionary import Direction
from canopen_proto.frame import COB_ID_EXTENDED, KEY_EXTENDED, RoutingKey, can_id_of
from canopen_proto.multiplexer import mapping_entry
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.pdo.settings import PdoSettings

_EVENT_DRIVEN: Final = 255
"""What stands for the type of a TPDO: our end takes it at once, whatever the device's is."""


def nodes_of(master: Master, net: str) -> dict[int, Node]:
    """Return the nodes of a bus that are of the machine, or drives, by node-ID."""
    nodes = (*master.nodes.values(), *(device.node for device in master.devices.values()))
    return {node.node_id: node for node in nodes if node.bus == net}


def exchanged_pdos(node: Node) -> Iterator[PdoSettings]:
    """Yield the PDOs of a node that its master takes and sends."""
    for number, tpdo in node.remote.tpdos.items():
        for key in tpdo.can_ids():
            yield _settings_of(Direction.TPDO, number, key, tpdo.mapping, _EVENT_DRIVEN)
    for number, rpdo in node.remote.rpdos.items():
        if rpdo.key is not None:
            yield _settings_of(Direction.RPDO, number, rpdo.key, rpdo.mapping, rpdo.transmission_type)


def _settings_of(direction: Direction, number: int, key: RoutingKey, mapping: Mapping, kind: int) -> PdoSettings:
    cob_id = can_id_of(key) | (COB_ID_EXTENDED if key & KEY_EXTENDED else 0)
    entries = tuple(mapping_entry(each.mux, each.bit_length) for each in mapping.entries)
    return PdoSettings(number, direction, cob_id, kind, entries)
