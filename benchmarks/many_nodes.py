"""Measure the cost of a frame in a participant that watches many nodes: 127 and 32 against 6, and each against the peer.

Every node sends TPDOs with four objects, and after each nine of them a heartbeat; the nodes take turns, 4000 frames a second.
Each frame is given to the network, which is then drained and asked for its deadline, as a driver does it on a quiet bus. Our
nodes are RemoteNodes that supervise the heartbeat with 1 s (the peer supervises nothing).

python benchmarks/many_nodes.py     how many times the cost among 6 nodes a frame costs among 127
"""

from __future__ import annotations

from collections.abc import Callable

from direct import add_tpdo, coupled_networks
from measure import Case, measure

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, SECOND
from canopen_proto.network import Network
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_proto.remote_node import RemoteNode

FEW, SOME, MANY = 6, 32, 127
INTERVAL = 250 * MICROSECOND
TIMEOUT = 1 * SECOND
PDOS_PER_HEARTBEAT = 9
OBJECTS = [
    ("statusword", 0x6041, DataType.UNSIGNED16, 16),
    ("modes_of_operation_display", 0x6061, DataType.INTEGER8, 8),
    ("position_actual_value", 0x6064, DataType.INTEGER32, 32),
    ("error_register", 0x1001, DataType.UNSIGNED8, 8),
]

Handle = Callable[[int], object]
"""Handle so many frames; the last state and position of node 1."""


def _traffic(nodes: int) -> list[tuple[int, bytes]]:
    pdos = [
        (0x180 + node, bytes((0x37, 2, 7, node, turn, 0, 0, 0)))
        for turn in range(PDOS_PER_HEARTBEAT)
        for node in range(1, nodes + 1)
    ]
    return pdos + [(0x700 + node, b"\x05") for node in range(1, nodes + 1)]


def ours(nodes: int) -> Handle:
    """A Network with so many RemoteNodes."""
    network = Network()
    dictionary = ObjectDictionary([Object.of(name, [Variable(index, 0, name, kind)]) for name, index, kind, _ in OBJECTS])
    mapping = Mapping(MappedEntry(index, 0, bits, kind, name) for name, index, kind, bits in OBJECTS)
    remotes = [RemoteNode(network.out, node, dictionary, heartbeat_timeout=TIMEOUT) for node in range(1, nodes + 1)]
    for remote in remotes:
        network.attach(remote)
        remote.add_tpdo(1, 0x180 + remote.node_id, mapping, 0)
    traffic = _traffic(nodes)
    now = 0

    def handle(count: int) -> object:
        nonlocal now
        for number in range(count):
            can_id, data = traffic[number % len(traffic)]
            now += INTERVAL
            network.receive(Frame(can_id, data), now)
            network.drain(now)
            if network.next_deadline() <= now:
                network.handle_timeout(now)
        return remotes[0].values.read("position_actual_value")

    return handle


def theirs(nodes: int) -> Handle:
    """The peer's Network with as many nodes."""
    network, _ = coupled_networks()
    tpdos = {}
    for node in range(1, nodes + 1):
        tpdos[0x180 + node] = add_tpdo(network, node, OBJECTS)
    traffic = _traffic(nodes)
    first = tpdos[0x181]

    def handle(count: int) -> object:
        for number in range(count):
            can_id, data = traffic[number % len(traffic)]
            network.notify(can_id, bytearray(data), 0.0)
            if can_id in tpdos:
                for mapped in tpdos[can_id].map:
                    mapped.raw  # noqa: B018 - the peer decodes when it is asked
        return first.map[2].raw

    return handle


def cases() -> list[Case]:
    """Few nodes and more, each against the peer."""
    found = []
    for nodes in (FEW, SOME, MANY):
        mine, peers = ours(nodes), theirs(nodes)

        def check(mine: Handle = mine, peers: Handle = peers) -> None:
            assert mine(2000) == peers(2000)

        found.append(Case(f"a frame among {nodes} nodes (RemoteNode)", mine, peers, check))
    return found


def main() -> None:
    """Print the ratio: median, and least against least."""
    many = measure(Case("many against few", ours(FEW), ours(MANY), lambda: None), rounds=15, seconds=0.2)
    print(f"a frame among {MANY} nodes costs {many.ratio:.2f} ({many.least_ratio:.2f}) times what it costs among {FEW}")


if __name__ == "__main__":
    main()
