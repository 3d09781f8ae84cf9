"""127 drives and a master on one bus in virtual time: boot, configuration by SDO, supervision by heartbeat, NMT start.

python benchmarks/plant.py          what a simulated second costs, and what a frame costs a master of 127 nodes against one
"""

from __future__ import annotations

import statistics
import time

from copper import Copper

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.network import Network
from canopen_proto.nmt import NmtMaster
from canopen_proto.procedures.objects import read_int, write
from canopen_proto.procedures.runner import ProcedureFinished
from canopen_proto.procedures.steps import Procedure, all_of
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape

HEARTBEAT = 250 * MILLISECOND
SETTINGS = DriveSettings(shape=Shape.SCHUNK_POWERBALL)


def configure(node: RemoteNode) -> Procedure[int]:
    """What a master does with a node that it met: who is it, and let it be heard."""
    product = yield from read_int(node, (0x1018, 2))
    yield from write(node, 0x1017, HEARTBEAT // MILLISECOND)
    return product


class Plant:
    """One participant for each drive, and a master; nodes: how many drives."""

    def __init__(self, seed: int, nodes: int = 127) -> None:
        self.bus = Copper(seed)
        self.master = self.bus.listener = Network()
        self.bus.networks.append(self.master)
        description = drive_dictionary(SETTINGS.shape)  # one serves all: what differs is in each device's values
        self.nmt = NmtMaster(self.master.out)
        self.master.attach(self.nmt)
        self.remote: dict[int, RemoteNode] = {}
        self.devices: dict[int, Network] = {}
        for number in range(1, nodes + 1):
            remote = self.remote[number] = RemoteNode(self.master.out, number, description)
            self.master.attach(remote)
            network = self.devices[number] = Network()
            self.bus.networks.append(network)
            device = DriveNode(network.out, number, SETTINGS, description)
            network.attach(device)
            device.boot(self.bus.now)

    def start(self) -> list[int]:
        """Boot, configure, supervise, start; the product codes of all nodes."""
        bus = self.bus
        bus.run(100 * MILLISECOND)
        self.master.run(all_of(*(configure(node) for node in self.remote.values())), bus.now)
        finished: list[ProcedureFinished] = []
        while not finished:
            bus.run(10 * MILLISECOND)
            finished = [event for event in bus.events if isinstance(event, ProcedureFinished)]
        for node in self.remote.values():
            node.heartbeat.set_timeout(2 * HEARTBEAT, bus.now)
        self.nmt.start(0, bus.now)
        result: list[int] = finished[0].result
        return result


def cost_of_frames(nodes: int, frames: int = 20_000) -> float:
    """Seconds for one frame at a master with so many RemoteNodes: heartbeats, drained one by one."""
    network, description = Network(), drive_dictionary(SETTINGS.shape)
    for number in range(1, nodes + 1):
        remote = RemoteNode(network.out, number, description, heartbeat_timeout=HEARTBEAT)
        network.attach(remote)
    traffic = [Frame(0x700 + 1 + number % nodes, b"\x05") for number in range(frames)]
    now = 0
    begin = time.process_time()
    for frame in traffic:
        now += 100_000
        network.receive(frame, now)
        network.drain(now)
        network.next_deadline()
    return (time.process_time() - begin) / frames


def main() -> None:
    """Print the figures."""
    begin = time.process_time()
    plant = Plant(seed=1)
    plant.start()
    booted = time.process_time()
    simulated = plant.bus.now / SECOND
    plant.bus.run(2 * SECOND)
    ran = time.process_time()
    print(f"127 drives booted and configured: {booted - begin:.2f} s of CPU for {simulated:.2f} simulated s")
    print(f"supervised: {(ran - booted) / 2:.3f} s of CPU per simulated s, {len(plant.bus.sent)} frames in all")
    ratios = [cost_of_frames(127) / cost_of_frames(1) for _ in range(9)]
    print(f"a frame at a master of 127 nodes costs {statistics.median(ratios):.2f} times that at a master of one")


if __name__ == "__main__":
    main()
