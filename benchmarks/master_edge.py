"""The master as users meet it: on a bus inside the process, with tasks or threads between the two ends.

- A read by name: a device on the other end of the bus answers, and the value is decoded. Ours is `open_master` on `virtual:` with
  a simulated device, two trio tasks and their pumps; the peer's two Networks stand on python-can's `virtual` bus with a Notifier's
  thread each, which is what `connect` gives its users. Second row: the same against a bare ping-pong of two trio tasks over memory
  channels, the least that anything built on trio can cost: a ratio of 0.5 means that a read costs two of them.
- Full frames into a master: TPDOs with 8 bytes come in bursts of 9, as in each millisecond of a bus that carries 9,000 a second,
  and end as the node's values; the sender is counted, too. With a subscriber (the peer: a callback), each is also handed to a task
  that iterates over them. At 9,000 frames a second 1 us for each is 0.9 % of a core.

The clock is CPU time of the whole process: threads count, and waiting does not.
"""

from __future__ import annotations

import threading
from collections.abc import Awaitable, Callable
from typing import Any

import can
import trio
from canopen import Network as TheirNetwork
from canopen import ObjectDictionary as TheirDictionary
from direct import record, variable
from measure import Case

from canopen_master import Master, open_master, simulate
from canopen_master.simulation import DeviceModel
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.frame import Frame
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_transports import VirtualTransport, open_transport

NODE_ID = 12
NUMBER, VALUE = 0x2000, 0x12345678
LOW, HIGH = 0x2001, 0x2002
TPDO1 = 0x180 + NODE_ID
BURST = 9
BUS = "virtual:benchmark"


def _dictionary() -> ObjectDictionary:
    names = {NUMBER: "number", LOW: "low", HIGH: "high"}
    return ObjectDictionary(
        [Object.of(name, [Variable(index, 0, name, DataType.UNSIGNED32)]) for index, name in names.items()]
    )


def _payload(number: int) -> bytes:
    return number.to_bytes(8, "little")


# ---- ours ----


def our_reads(count: int) -> object:
    """Read so often; the last value."""

    async def main() -> object:
        value: object = None
        async with trio.open_nursery() as nursery:
            model = DeviceModel(_dictionary(), NODE_ID)
            host = await nursery.start(simulate, await open_transport(BUS), [model])
            host.nodes[0].values[NUMBER << 8] = VALUE
            async with open_master(BUS, dictionary=model.dictionary) as master:
                node = master.node(NODE_ID)
                for _ in range(count):
                    value = await node.read("number")
            nursery.cancel_scope.cancel()
        return value

    return trio.run(main)


def our_frames(subscribed: bool) -> Callable[[int], object]:
    """Takes so many bursts in; the values of the last frame."""

    async def main(count: int) -> object:
        async with VirtualTransport("benchmark") as sender, open_master(BUS, dictionary=_dictionary()) as master:
            remote = master.node(NODE_ID).remote
            entries = (MappedEntry(index, 0, 32, DataType.UNSIGNED32, "") for index in (LOW, HIGH))
            remote.add_tpdo(1, TPDO1, Mapping(entries), master.now())
            if subscribed:
                async with trio.open_nursery() as nursery:
                    nursery.start_soon(_send, sender, count)
                    await _hear(master, BURST * count)
            else:
                await _send(sender, count)
            await trio.testing.wait_all_tasks_blocked()
            return [remote.values[index << 8] for index in (LOW, HIGH)]

    return lambda count: trio.run(main, count)


async def _send(sender: VirtualTransport, count: int) -> None:
    for number in range(count):
        for place in range(BURST):
            sender.send_nowait(Frame(TPDO1, _payload(BURST * number + place)))
        await trio.lowlevel.checkpoint()  # the receiver's round
        await trio.lowlevel.checkpoint()  # a subscriber's


async def _hear(master: Master, count: int) -> None:
    heard = 0
    with master.events(PdoReceived) as events:
        async for _ in events:
            heard += 1
            if heard == count:
                return


def ping_pong(count: int) -> object:
    """Two tasks hand each other a value, over memory channels; what comes back."""

    async def main() -> object:
        ping, pinged = trio.open_memory_channel[int](1)
        pong, ponged = trio.open_memory_channel[int](1)

        async def answer() -> None:
            async for value in pinged:
                await pong.send(value)

        value = 0
        async with trio.open_nursery() as nursery:
            nursery.start_soon(answer)
            for _ in range(count):
                await ping.send(VALUE)
                value = await ponged.receive()
            nursery.cancel_scope.cancel()
        return value

    return trio.run(main)


# ---- theirs ----


def _their_network() -> TheirNetwork:
    network = TheirNetwork()
    network.connect(interface="virtual", channel="benchmark")
    return network


def their_reads() -> Callable[[int], object]:
    """The same with the peer."""
    dictionary = TheirDictionary()
    dictionary.add_object(variable("number", NUMBER, 0, int(DataType.UNSIGNED32)))

    def read(count: int) -> object:
        master, device = _their_network(), _their_network()
        try:
            device.create_node(NODE_ID, dictionary).sdo["number"].raw = VALUE
            node = master.add_node(NODE_ID, dictionary)
            value: object = None
            for _ in range(count):
                value = node.sdo["number"].raw
            return value
        finally:
            master.disconnect()
            device.disconnect()

    return read


def their_frames(subscribed: bool) -> Callable[[int], object]:
    """The same with the peer; it waits for each burst, as ours does."""
    dictionary = TheirDictionary()
    for name, index in (("low", LOW), ("high", HIGH)):
        dictionary.add_object(variable(name, index, 0, int(DataType.UNSIGNED32)))
    unsigned8, unsigned32 = int(DataType.UNSIGNED8), int(DataType.UNSIGNED32)
    communication = [variable("count", 0x1800, 0, unsigned8), variable("cob_id", 0x1800, 1, unsigned32)]
    dictionary.add_object(record("tpdo_1_communication", 0x1800, *communication))
    dictionary.add_object(record("tpdo_1_mapping", 0x1A00, variable("count", 0x1A00, 0, unsigned8)))

    def take(count: int) -> object:
        network = _their_network()
        done = threading.Semaphore(0)
        heard = 0
        try:
            tpdo = network.add_node(NODE_ID, dictionary).tpdo[1]
            tpdo.cob_id, tpdo.enabled = TPDO1, True
            for index in (LOW, HIGH):
                tpdo.add_variable(index, 0, 32)
            tpdo.subscribe()

            def on_pdo(_: Any) -> None:
                nonlocal heard
                heard += 1

            if subscribed:
                tpdo.add_callback(on_pdo)
            network.subscribe(0x80, lambda *_: done.release())
            with can.Bus(interface="virtual", channel="benchmark") as sender:
                for number in range(count):
                    for place in range(BURST):
                        data = _payload(BURST * number + place)
                        sender.send(can.Message(arbitration_id=TPDO1, data=data, is_extended_id=False))
                    sender.send(can.Message(arbitration_id=0x80, is_extended_id=False))
                    done.acquire()
            assert heard == (BURST * count if subscribed else 0)
            return [mapped.raw for mapped in tpdo.map]
        finally:
            network.disconnect()

    return take


def _case(title: str, ours: Callable[[int], object], theirs: Callable[[int], object]) -> Case:
    def check() -> None:
        assert ours(20) == theirs(20)

    return Case(title, ours, theirs, check)


def cases() -> list[Case]:
    """See this module's text."""
    return [
        _case("master: read by name, virtual bus", our_reads, their_reads()),
        _case("master: read by name, virtual bus; in their place a bare trio ping-pong", our_reads, ping_pong),
        _case(f"master: {BURST} full frames come in", our_frames(False), their_frames(False)),
        _case(f"master: {BURST} full frames come in, with a subscriber", our_frames(True), their_frames(True)),
    ]
