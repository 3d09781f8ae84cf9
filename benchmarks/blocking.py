"""The blocking master against the async one and against `canopen` 2.4.1: reads, writes and PDOs, in one run.

    python benchmarks/blocking.py [--rounds 9] [--seconds 0.2]

The bus is inside the process: `virtual:` with a simulated device for ours, python-can's `virtual` for the peer, whose Networks
have a Notifier's thread each, as `connect` makes them. The device's work counts on both sides. The blocking master hands each
call to the thread of its loop and waits for the answer: that is what a read costs more than in a trio task. The last row is a
look at what is known already (`node.nmt_state`), in place of a read: nothing but the two changes between threads.

PDOs come as in master_edge.py, in bursts of 9 full frames, and each is handed to a function of the user: ours is called in the
thread of the callbacks, the peer's in that of its Notifier.

The clock is the CPU time of the process (measure.py): it counts the threads of both sides, and no waiting.
"""

from __future__ import annotations

import argparse
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import trio
from canopen import Network as TheirNetwork
from canopen import ObjectDictionary as TheirDictionary
from direct import VERSION, variable
from master_edge import BURST, HIGH, LOW, TPDO1, Source, their_frames
from master_edge import dictionary as edge_dictionary
from measure import Case, measure, table

from canopen_master import DeviceModel, Master, Node, blocking, open_master
from canopen_master.simulation import simulated_devices
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.pdo import mapping
from canopen_proto.pdo.consumer import PdoReceived
from canopen_transports import Received, Report

NODE_ID, NUMBER, VALUE = 12, 0x2000, 0x12345678
BUS = "virtual:blocking"
DICTIONARY = ObjectDictionary([Object.of("number", [Variable(NUMBER, 0, "number", DataType.UNSIGNED32, default=VALUE)])])
DEVICES = {BUS: [DeviceModel(DICTIONARY, NODE_ID)]}


@contextmanager
def our_node() -> Iterator[blocking.BlockingNode]:
    """A node of an open blocking master."""
    with blocking.simulated_devices(DEVICES), blocking.open_master(BUS) as master:
        yield master.node(NODE_ID, DICTIONARY)


@contextmanager
def their_node() -> Iterator[Any]:
    """A node of the peer's open network."""
    dictionary = TheirDictionary()
    dictionary.add_object(variable("number", NUMBER, 0, int(DataType.UNSIGNED32)))
    networks = [TheirNetwork(), TheirNetwork()]
    for network in networks:
        network.connect(interface="virtual", channel="blocking")
    try:
        networks[1].create_node(NODE_ID, dictionary).sdo["number"].raw = VALUE
        yield networks[0].add_node(NODE_ID, dictionary)
    finally:
        for network in networks:
            network.disconnect()


def in_trio(step: Callable[[Node], Any]) -> Callable[[int], object]:
    """Do a step with a node of the async master, so often; what the last one gave."""

    async def main(count: int) -> object:
        value: object = None
        async with simulated_devices(DEVICES), open_master(BUS) as master:
            node = master.node(NODE_ID, DICTIONARY)
            for _ in range(count):
                value = await step(node)
        return value

    return lambda count: trio.run(main, count)


def repeated(step: Callable[[], object]) -> Callable[[int], object]:
    """Do a step so often; what the last one gave."""

    def repeat(count: int) -> object:
        value: object = None
        for _ in range(count):
            value = step()
        return value

    return repeat


class GatedSource(Source):
    """Frames that begin to come when the user's function listens, and wait while it is behind. heard: PDOs that it was given."""

    def __init__(self, bursts: int) -> None:
        super().__init__(bursts)
        self.sent = self.heard = 0
        self.is_open = False

    async def receive_many(self, limit: int) -> list[Received | Report]:
        while not self.is_open or self.sent - self.heard > 2000:
            await trio.sleep(0.0005)
        self.sent += BURST
        return await super().receive_many(limit)


def map_tpdo(master: Master) -> None:
    """Let the master know what the frames carry."""
    entries = (mapping.MappedEntry(index, 0, 32, DataType.UNSIGNED32, "") for index in (LOW, HIGH))
    master.node(NODE_ID).remote.add_tpdo(1, TPDO1, mapping.Mapping(entries), master.now())


def our_pdos(count: int) -> object:
    """So many bursts to a function; the node's values at the end."""
    source, done = GatedSource(count), threading.Event()

    def on_pdo(_: PdoReceived) -> None:
        source.heard += 1
        if source.heard == BURST * count:
            done.set()

    with blocking.open_master(source, dictionary=edge_dictionary()) as master:
        master.in_loop(map_tpdo)
        node = master.node(NODE_ID)
        with node.on(PdoReceived, on_pdo):
            source.is_open = True
            done.wait()
        return master.in_loop(lambda _: [node.remote.values[index << 8] for index in (LOW, HIGH)])


def case(title: str, ours: Callable[[int], object], theirs: Callable[[int], object]) -> Case:
    def check() -> None:
        assert ours(20) == theirs(20)

    return Case(title, ours, theirs, check)


def cases(ours: blocking.BlockingNode, theirs: Any) -> list[Case]:
    """See this module's text."""

    def write() -> None:
        ours["number"] = VALUE

    def their_write() -> None:
        theirs.sdo["number"].raw = VALUE

    read, their_read = repeated(lambda: ours["number"]), repeated(lambda: theirs.sdo["number"].raw)
    return [
        case("read", read, their_read),
        case("write", repeated(write), repeated(their_write)),
        case("read; in their place our async master", read, in_trio(lambda node: node.read("number"))),
        case("write; in their place our async master", repeated(write), in_trio(lambda node: node.write("number", VALUE))),
        case(f"{BURST} PDOs, each to a function", our_pdos, their_frames(subscribed=True)),
        Case("`nmt_state`; in their place our read", repeated(lambda: ours.nmt_state), read, lambda: None),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description="the blocking master against the async one and canopen, in one run")
    parser.add_argument("--rounds", type=int, default=9, help="rounds per case and side (default: 9)")
    parser.add_argument("--seconds", type=float, default=0.2, help="CPU time of a round (default: 0.2)")
    arguments = parser.parse_args()
    with our_node() as ours, their_node() as theirs:
        results = [measure(each, arguments.rounds, arguments.seconds) for each in cases(ours, theirs)]
    print(table(results, f"canopen {VERSION}"))


if __name__ == "__main__":
    main()
