"""Receiving the multiplexed PDOs of another node in source address mode, as a master, a service tool or a bus monitor does.

A device needs an object dispatching list to find the object of its own that takes a producer's value (multiplexed.py). A listener
needs none: the frame names the producer's object, and the listener updates its image of that object. It ignores frames in
destination address mode, which are for their consumer; `destination_frame` of multiplexed.py makes such frames.

Source: CiA 301 v4.2.0, 7.2.3.
"""

from __future__ import annotations

from collections.abc import Iterable

from canopen_proto.dictionary import Direction, Values
from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.machine import FrameIgnored, Machine, Outbox, Time, check_node_id
from canopen_proto.pdo.consumer import EMCY_PDO_NOT_PROCESSED, PdoLengthError
from canopen_proto.pdo.multiplexed import DESTINATION_MODE, MPDO, MpdoReceived, suits_mpdo


class MpdoListener(Machine):
    """Receives the TPDOs of one node that are MPDOs in source address mode; see this module's text."""

    __slots__ = ("_keys", "_values", "node_id")

    def __init__(self, out: Outbox, node_id: int, values: Values) -> None:
        """node_id: of the producer, 1..127. values: our image of its objects, which received values update."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self._values = values
        self._keys: dict[int, RoutingKey] = {}  # TPDO number -> key

    def can_ids(self) -> Iterable[RoutingKey]:
        return tuple(self._keys.values())

    def set_pdo(self, number: int, key: RoutingKey | None) -> None:
        """Receive the node's TPDO `number` by this key; None = stop."""
        self._keys.pop(number, None)
        if key is not None:
            self._keys[number] = key
        self._reroute()

    def receive(self, frame: Frame, now: Time) -> None:
        """Take the value of an MPDO of this node. An MPDO of another producer on the same CAN-ID is ignored.

        Events: MpdoReceived; PdoLengthError for less than eight bytes; FrameIgnored for the other address mode, and for an object
        that is not in the node's dictionary or that no TPDO can carry.
        """
        key, data = frame.key, frame.data
        number = next(each for each, its_key in self._keys.items() if its_key == key)
        if len(data) < MPDO.size:
            stamp = self.out.timestamp
            error = PdoLengthError(self.node_id, number, key, MPDO.size, len(data), EMCY_PDO_NOT_PROCESSED, stamp)
            self.out.events.append(error)
            return
        address, index, subindex, content = MPDO.unpack_from(data)
        if address & DESTINATION_MODE:
            self.out.events.append(FrameIgnored(self.node_id, frame, f"TPDO {number} is an MPDO in source address mode"))
            return
        if address != self.node_id:
            return
        variable = self._values.dictionary.get(index, subindex)
        if variable is None or not suits_mpdo(variable, Direction.TPDO):
            reason = f"an MPDO with object 0x{index:04X}:{subindex:02X}, which no TPDO can carry"
            self.out.events.append(FrameIgnored(self.node_id, frame, reason))
            return
        value = variable.decode(content[: variable.size])
        self._values.store[variable.mux] = value
        report = MpdoReceived(self.node_id, number, key, address, index, subindex, value, self.out.timestamp)
        self.out.events.append(report)
