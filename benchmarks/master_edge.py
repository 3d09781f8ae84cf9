"""The master as users meet it, with tasks or threads between the wire and the caller.

- A read by name on a bus inside the process: a device answers at the other end, and the value is decoded. Ours is `open_master`
  on `virtual:` with a simulated device, each with its pump; the peer's two Networks stand on python-can's `virtual` bus with a
  Notifier's thread each, which is what `connect` gives its users. The second row has a bare ping-pong of two trio tasks over
  memory channels in the peer's place: 0.5 means that a read costs as much as two of these.
- Full frames into a master: TPDOs with 8 bytes come in bursts of 9, as in each millisecond of a bus that carries 9,000 a second,
  and end as the node's two values. The transport is a stand-in on both sides: it has the frames ready, so that nothing but the
  master counts, its wake for each burst included. Ours decodes each frame as it comes, the peer when a value is read: once, at
  the end. With a subscriber, each is also handed to a task that iterates over `master.events`, one by one, as the docs show it;
  the peer's user has a callback. "in batches": the task takes lists (`events.batches()`) and goes over each. "with a callback":
  ours is called too, by `master.watch`, which is the peer's way.
  Two more rows have other things in the peer's place. The floor is python-can alone: its Notifier hands each message to a
  listener that counts it. The limit is a bare loop: a trio task takes the bursts and does nothing with them.

The clock is CPU time of the whole process: threads count, and waiting does not.
"""

from __future__ import annotations

import statistics
import threading
from collections.abc import Awaitable, Callable, Mapping
from functools import cached_property, partial
from typing import Any, TypeAlias

import can
import trio
from canopen import Network as TheirNetwork
from canopen import ObjectDictionary as TheirDictionary
from direct import record, variable
from measure import Case, Result

from canopen_master import Master, open_master, simulate
from canopen_master.simulation.host import DeviceModel
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.frame import Frame
from canopen_proto.pdo import mapping
from canopen_proto.pdo.consumer import PdoReceived
from canopen_transports import Received, Report, open_transport
from canopen_transports.loop import OneTimeEvent, current_loop

Run: TypeAlias = Callable[[Callable[[], Awaitable[object]]], object]
"""Runs an async function in an event loop, as trio.run does."""

NODE_ID = 12
NUMBER, VALUE = 0x2000, 0x12345678
LOW, HIGH = 0x2001, 0x2002
TPDO1 = 0x180 + NODE_ID
BURST = 9
KEPT = 16
"""Bursts that are made beforehand."""
BUS = "virtual:benchmark"

READ = "master: read by name, virtual bus"
PING_PONG = f"{READ}; in their place a bare trio ping-pong"
FRAMES = f"master: {BURST} full frames come in"
SUBSCRIBED = f"{FRAMES}, with a subscriber"
BATCHED = f"{FRAMES}, with a subscriber in batches"
CALLED = f"{FRAMES}, with a callback"
FLOOR = f"{FRAMES}; in their place python-can alone"
LIMIT = f"{FRAMES}; in their place a bare loop"


def dictionary() -> ObjectDictionary:
    names = {NUMBER: "number", LOW: "low", HIGH: "high"}
    return ObjectDictionary([Object.of(name, [Variable(index, 0, name, DataType.UNSIGNED32)]) for index, name in names.items()])


def _payloads(number: int) -> list[bytes]:
    """Of one burst."""
    return [(number << 32 | place).to_bytes(8, "little") for place in range(BURST)]


# ---- ours ----


def our_reads(count: int, run: Run = trio.run) -> object:
    """Read so often; the last value. run: the event loop."""

    async def main() -> object:
        value: object = None
        async with current_loop().open_nursery() as nursery:
            model = DeviceModel(dictionary(), NODE_ID)
            host = await nursery.start(simulate, await open_transport(BUS), [model])
            host.nodes[0].values[NUMBER << 8] = VALUE
            async with open_master(BUS, dictionary=model.dictionary) as master:
                node = master.node(NODE_ID)
                for _ in range(count):
                    value = await node.read("number")
            nursery.cancel_scope.cancel()
        return value

    return run(main)


class Source:
    """A transport that has a burst of frames ready in each round of the scheduler."""

    def __init__(self, bursts: int) -> None:
        self.left = bursts
        self.bursts = [[(Frame(TPDO1, payload), None) for payload in _payloads(number)] for number in range(KEPT)]

    @cached_property
    def taken(self) -> OneTimeEvent:
        """All bursts were taken. For the loop: it makes this event."""
        return current_loop().event()

    async def receive_many(self, limit: int) -> list[Received | Report]:
        assert limit >= BURST
        if not self.left:
            self.taken.set()
            await current_loop().sleep_forever()
        await current_loop().checkpoint()
        self.left -= 1
        return self.bursts[self.left % KEPT]

    async def receive(self) -> Received:
        raise NotImplementedError

    async def send(self, frame: Frame) -> None:
        raise NotImplementedError

    async def aclose(self) -> None:
        await current_loop().checkpoint()


async def _hear(master: Master, count: int) -> None:
    heard = 0
    with master.events(PdoReceived) as events:
        async for _ in events:
            heard += 1
            if heard == count:
                return


async def _hear_batches(master: Master, count: int) -> None:
    heard = 0
    with master.events(PdoReceived) as events:
        async for batch in events.batches():
            for _ in batch:
                heard += 1
            if heard == count:
                return


async def _be_called(master: Master, count: int) -> None:
    heard, done = 0, current_loop().event()

    def on_pdo(_: PdoReceived) -> None:
        nonlocal heard
        heard += 1
        if heard == count:
            done.set()

    watcher = master.watch((PdoReceived,), on_pdo)
    await done.wait()
    master.unwatch(watcher)


Hear: TypeAlias = Callable[[Master, int], Awaitable[None]]
"""Take so many PDOs, one after the other."""


def our_frames(subscribed: bool, run: Run = trio.run, hear: Hear = _hear) -> Callable[[int], object]:
    """Takes so many bursts in; the values of the last frame. run: the event loop. hear: how a subscriber does."""

    async def main(count: int) -> object:
        source = Source(count)
        async with open_master(source, dictionary=dictionary()) as master:
            remote = master.node(NODE_ID).remote
            entries = (mapping.MappedEntry(index, 0, 32, DataType.UNSIGNED32, "") for index in (LOW, HIGH))
            remote.add_tpdo(1, TPDO1, mapping.Mapping(entries), master.now())
            if subscribed:
                await hear(master, BURST * count)
            await source.taken.wait()
            return [remote.values[index << 8] for index in (LOW, HIGH)]

    return lambda count: run(partial(main, count))


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


def bare_loop(count: int) -> object:
    """A task takes so many bursts and does nothing with them; how many frames there were."""

    async def main() -> object:
        source, taken = Source(count), 0
        for _ in range(count):
            taken += len(await source.receive_many(BURST))
        return taken

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
    """The same with the peer."""
    dictionary = TheirDictionary()
    for name, index in (("low", LOW), ("high", HIGH)):
        dictionary.add_object(variable(name, index, 0, int(DataType.UNSIGNED32)))
    unsigned8, unsigned32 = int(DataType.UNSIGNED8), int(DataType.UNSIGNED32)
    communication = [variable("count", 0x1800, 0, unsigned8), variable("cob_id", 0x1800, 1, unsigned32)]
    dictionary.add_object(record("tpdo_1_communication", 0x1800, *communication))
    dictionary.add_object(record("tpdo_1_mapping", 0x1A00, variable("count", 0x1A00, 0, unsigned8)))

    def take(count: int) -> object:
        source = TheirSource(count)
        network = TheirNetwork()
        heard = 0
        tpdo = network.add_node(NODE_ID, dictionary).tpdo[1]
        tpdo.cob_id, tpdo.enabled = TPDO1, True
        for index in (LOW, HIGH):
            tpdo.add_variable(index, 0, 32)
        network.bus = source
        tpdo.subscribe()

        def on_pdo(_: Any) -> None:
            nonlocal heard
            heard += 1

        if subscribed:
            tpdo.add_callback(on_pdo)
        notifier = can.Notifier(source, network.listeners, 1)
        source.taken.wait()
        notifier.stop()
        source.shutdown()
        assert heard == (BURST * count if subscribed else 0)
        return [mapped.raw for mapped in tpdo.map]

    return take


class Counter(can.Listener):
    """Counts messages."""

    def __init__(self) -> None:
        self.count = 0

    def on_message_received(self, msg: can.Message) -> None:
        self.count += 1


def python_can(count: int) -> object:
    """Its Notifier hands so many bursts to a listener; how many messages there were."""
    source, counter = TheirSource(count), Counter()
    notifier = can.Notifier(source, [counter], 1)
    source.taken.wait()
    notifier.stop()
    source.shutdown()
    return counter.count


class TheirSource(can.BusABC):
    """A bus of python-can that has the frames ready."""

    channel_info = "source"

    def __init__(self, bursts: int) -> None:
        super().__init__("source")
        self.left = bursts * BURST
        self.messages = [
            can.Message(arbitration_id=TPDO1, data=payload, is_extended_id=False)
            for number in range(KEPT)
            for payload in reversed(_payloads(number))
        ]
        self.taken = threading.Event()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self.left:
            self.taken.set()
            threading.Event().wait(0.01)
            return None, True
        self.left -= 1
        return self.messages[self.left % len(self.messages)], True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError


def share(title: str) -> Callable[[Mapping[str, Result]], float]:
    """Per cent of a core that 9,000 frames a second take: 1,000 bursts."""
    return lambda results: statistics.median(results[title].ours) * 1000 / 1e9 * 100


def _case(title: str, ours: Callable[[int], object], theirs: Callable[[int], object], result: object = None) -> Case:
    """result: of theirs, for 20 times, where it does another thing than ours."""

    def check() -> None:
        assert theirs(20) == (ours(20) if result is None else result)

    return Case(title, ours, theirs, check)


def cases() -> list[Case]:
    """See this module's text."""
    return [
        _case(READ, our_reads, their_reads()),
        _case(PING_PONG, our_reads, ping_pong),
        _case(FRAMES, our_frames(False), their_frames(False)),
        _case(SUBSCRIBED, our_frames(True), their_frames(True)),
        _case(BATCHED, our_frames(True, hear=_hear_batches), their_frames(True)),
        _case(CALLED, our_frames(True, hear=_be_called), their_frames(True)),
        _case(FLOOR, our_frames(False), python_can, 20 * BURST),
        _case(LIMIT, our_frames(False), bare_loop, 20 * BURST),
    ]
