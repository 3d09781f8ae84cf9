"""The peer without a bus and without threads: two of its Networks, coupled by a function call.

`canopen` sends by `network.bus.send(message)` and receives by its listener,
`network.listeners[0].on_message_received(message)`. So a "bus" whose `send` calls the other side's listener is all that is
needed: the answer is in the client's queue before `send` returns, and its blocking `get` finds it there. Making the
`can.Message` is part of what is measured, because `canopen` makes it itself; what python-can's drivers would cost on top is
in neither side.
"""

from __future__ import annotations

import logging
from typing import Any

import canopen

from canopen_proto.datatypes import DataType

VERSION = canopen.__version__


class DirectBus:
    """Stands where a python-can bus stands; hands each message straight to the other network."""

    channel_info = "direct"

    def __init__(self, other: canopen.Network) -> None:
        self._receive = other.listeners[0].on_message_received

    def send(self, message: Any, timeout: float | None = None) -> None:
        self._receive(message)


def coupled_networks() -> tuple[canopen.Network, canopen.Network]:
    """Two networks of the peer; what one sends, the other receives before `send` returns."""
    logging.getLogger("canopen").setLevel(logging.WARNING)
    first, second = canopen.Network(), canopen.Network()
    first.bus, second.bus = DirectBus(second), DirectBus(first)
    return first, second


def variable(name: str, index: int, subindex: int, data_type: int, access: str = "rw") -> canopen.objectdictionary.ODVariable:
    """One variable of the peer's object dictionary."""
    described = canopen.objectdictionary.ODVariable(name, index, subindex)
    described.data_type = data_type
    described.access_type = access
    return described


def record(name: str, index: int, *members: canopen.objectdictionary.ODVariable) -> canopen.objectdictionary.ODRecord:
    """One record of the peer's object dictionary."""
    described = canopen.objectdictionary.ODRecord(name, index)
    for member in members:
        described.add_member(member)
    return described


def add_tpdo(network: canopen.Network, node_id: int, objects: list[tuple[str, int, DataType, int]]) -> Any:
    """Add a node whose TPDO 1 has these objects: name, index, type, bits. Return the TPDO, which the network decodes."""
    dictionary = canopen.ObjectDictionary()
    for name, index, kind, _ in objects:
        dictionary.add_object(variable(name, index, 0, int(kind)))
    communication = [variable("count", 0x1800, 0, DataType.UNSIGNED8), variable("cob_id", 0x1800, 1, DataType.UNSIGNED32)]
    dictionary.add_object(record("tpdo_1_communication", 0x1800, *communication))
    dictionary.add_object(record("tpdo_1_mapping", 0x1A00, variable("count", 0x1A00, 0, DataType.UNSIGNED8)))
    tpdo = network.add_node(node_id, dictionary).tpdo[1]
    tpdo.cob_id, tpdo.enabled = 0x180 + node_id, True
    for _, index, _, bits in objects:
        tpdo.add_variable(index, 0, bits)
    tpdo.subscribe()
    return tpdo
