"""Commands of another master to a drive, heard on the bus: its controlword and its mode of operation."""

from __future__ import annotations

from typing import Final

from canopen_proto.dictionary import Direction
from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.axis.view import RECENT, ForeignCommand, command_text
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import mode_name
from canopen_proto.drives.cia402.states import COMMAND_BITS, ControlBit
from canopen_proto.foreign_writes import ForeignWrite
from canopen_proto.frame import SDO_CLIENT_TO_SERVER, RoutingKey, routing_key
from canopen_proto.machine import NEVER, Time
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.pdo.slots import described_pdos
from canopen_proto.remote_node import RemoteNode

COMMANDS: Final = (objects.CONTROLWORD, objects.MODES_OF_OPERATION)
"""The objects whose writes by another master are heard."""
COMPARED: Final = COMMAND_BITS & ~ControlBit.FAULT_RESET | ControlBit.HALT
"""The bits in which two controlwords contradict each other; a drive may clear the others by itself."""


def _described(node: RemoteNode) -> dict[RoutingKey, Mapping]:
    """Return the RPDOs that the node's dictionary knows: those of its file, else those of PDOs.csv."""
    dictionary, node_id = node.dictionary, node.node_id
    found = {
        routing_key(each.can_id(node_id)): Mapping.from_description(each)
        for each in dictionary.pdos
        if each.direction is Direction.RPDO
    }
    for pdo in described_pdos(dictionary, node_id):
        if pdo.direction is Direction.RPDO:
            found[pdo.key] = Mapping.from_parameters(pdo.entries, dictionary)
    return found


def foreign_command(
    node: AxisNode,
    remote: RemoteNode,
    controlword: int | None,
    commanded_at: Time | None,
    mode: int | None,
    selected_at: Time | None,
) -> ForeignCommand | None:
    """Return the last command of another master that came after ours, contradicts it, and is not older than RECENT; else None.

    remote: the node itself, whose file describes its PDOs.
    controlword, mode: as we sent them last, and when; None: we sent none, and nothing can contradict it.
    """
    now = max(node.heard_at.values(), default=-NEVER)
    others = _described(remote) if node.foreign_writes.unknown else {}
    found: list[tuple[ForeignWrite, str]] = []
    word = node.foreign_writes.last(objects.CONTROLWORD, others)
    if word is not None and controlword is not None and commanded_at is not None and word.time >= commanded_at:
        if not isinstance(word.value, int):
            found.append((word, "sent it a controlword"))
        elif (word.value ^ controlword) & COMPARED:
            found.append((word, f"commanded {command_text(word.value)}"))
    selected = node.foreign_writes.last(objects.MODES_OF_OPERATION, others)
    if selected is not None and selected_at is not None and selected.time >= selected_at and selected.value != mode:
        name = mode_name(selected.value) if isinstance(selected.value, int) else "a mode"
        found.append((selected, f"selected {name}"))
    recent = [(heard, words) for heard, words in found if now - heard.time <= RECENT]
    if not recent:
        return None
    (time, key, _), words = max(recent, key=lambda each: each[0].time)
    source = "SDO" if key == SDO_CLIENT_TO_SERVER + node.node_id else f"RPDO 0x{key:03X}"
    return ForeignCommand(words, max(0, now - time), source)
