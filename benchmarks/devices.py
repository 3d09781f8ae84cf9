"""A device that is read, against one of durand 0.5: a request comes in, the answer goes out. The client is not counted.

Ours is a LocalNode in a Network, which is drained and asked for its deadline behind each frame, as a driver does. durand's is a
`MinimalNode` on a network of the least code: a dictionary of callbacks. Both serve the same UNSIGNED32, and send the same bytes.
durand has no client, no master, and no block transfer.
"""

from __future__ import annotations

from collections.abc import Callable

import durand
from durand.services.nmt import StateEnum
from measure import Case

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.network import Network

NODE_ID = 12
NUMBER, VALUE = 0x2000, 0x12345678
REQUEST = Frame(0x600 + NODE_ID, bytes.fromhex("4000200000000000"))

ANSWERED = "device: SDO expedited upload answered; the peer is durand 0.5"


def our_device() -> Callable[[int], bytes]:
    """Answers so many requests; the last answer."""
    network = Network()
    node = LocalNode(
        network.out, NODE_ID, ObjectDictionary([Object.of("number", [Variable(NUMBER, 0, "number", DataType.UNSIGNED32)])])
    )
    network.attach(node)
    node.boot(0)
    node.values.write(NUMBER, VALUE)
    network.drain(0)
    now = 0

    def answer(count: int) -> bytes:
        nonlocal now
        data = b""
        for _ in range(count):
            now += 1000
            network.receive(REQUEST, now)
            frames, _ = network.drain(now)
            network.next_deadline()
            data = frames[0].data
        return data

    return answer


class Callbacks(durand.network.NetworkABC):  # type: ignore[misc]
    """All that a node of durand needs of a bus. sent: the last frame's data."""

    def __init__(self) -> None:
        self.callbacks: dict[int, Callable[[int, bytes], None]] = {}
        self.sent = b""

    def add_subscription(self, cob_id: int, callback: Callable[[int, bytes], None]) -> None:
        self.callbacks[cob_id] = callback

    def remove_subscription(self, cob_id: int) -> None:
        del self.callbacks[cob_id]

    def send(self, cob_id: int, msg: bytes) -> None:
        self.sent = msg


def their_device() -> Callable[[int], bytes]:
    """The same with durand."""
    bus = Callbacks()
    node = durand.MinimalNode(bus, node_id=NODE_ID)
    node.object_dictionary[NUMBER] = durand.Variable(durand.DatatypeEnum.UNSIGNED32, access="rw", value=VALUE, name="number")
    node.nmt.set_state(StateEnum.PRE_OPERATIONAL)

    def answer(count: int) -> bytes:
        for _ in range(count):
            bus.callbacks[REQUEST.can_id](REQUEST.can_id, REQUEST.data)
        return bytes(bus.sent)

    return answer


def cases() -> list[Case]:
    """See this module's text."""
    ours, theirs = our_device(), their_device()

    def check() -> None:
        assert ours(3) == theirs(3) == bytes.fromhex("4300200078563412")

    return [Case(ANSWERED, ours, theirs, check)]
