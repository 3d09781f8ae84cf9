"""The master in each style and its two peers, in one run: a read by name, and a full frame that comes in.

    python benchmarks/hosts.py                  # uvloop and `canopen-asyncio` too, where they are installed
    python benchmarks/hosts.py --loops          # what the loops' own parts cost here, and by anyio where that is installed

master_edge.py says what is done once, and for whom it is fair. On asyncio and uvloop the same master runs. The blocking master's
reads and frames go through its thread, and a subscriber is a function in one more thread (blocking.py). `canopen-asyncio` has
`canopen`'s two Networks with a thread of a Notifier each, and its callers await `aget_raw`; its frames come in a thread too, and
are decoded when a value is read; a subscriber is a function that this thread calls. The clock is CPU time of the whole process:
threads count, and waiting does not. Rounds are interleaved, and each begins with another one; the figures are ratios to trio, of
medians, and of the least.
"""

from __future__ import annotations

import argparse
import asyncio
import importlib
import importlib.util
import statistics
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

import can
import trio
from blocking import edge_dictionary, map_tpdo, our_node, our_pdos
from direct import VERSION
from master_edge import (
    BURST,
    HIGH,
    LOW,
    NODE_ID,
    NUMBER,
    TPDO1,
    VALUE,
    Source,
    TheirSource,
    our_frames,
    our_reads,
    their_frames,
    their_reads,
)
from measure import Repeat, calibrate, cpu_time

from canopen_master.blocking import open_master as open_blocking
from canopen_proto.datatypes import DataType
from canopen_transports import Received, Report
from canopen_transports.loop import current_loop

Main = Callable[[], Awaitable[object]]


def on_asyncio(main: Main) -> object:
    """Run it in asyncio's own loop."""

    async def run() -> object:
        return await main()

    return asyncio.run(run())


def on_uvloop(main: Main) -> object:
    """Run it in uvloop."""

    async def run() -> object:
        return await main()

    with asyncio.Runner(loop_factory=importlib.import_module("uvloop").new_event_loop) as runner:
        return runner.run(run())


LOOPS: dict[str, Callable[[Main], object]] = {"trio": trio.run, "asyncio": on_asyncio, "uvloop": on_uvloop}


def has(module: str) -> bool:
    """Whether a package is installed."""
    return importlib.util.find_spec(module) is not None


# ---- the blocking master ----


def blocking_reads(count: int) -> object:
    """Read so often; the last value."""
    with our_node() as node:
        value: object = None
        for _ in range(count):
            value = node["number"]
        return value


class _Opened(Source):
    """Frames that begin to come when the mapping is known."""

    is_open = False

    async def receive_many(self, limit: int) -> list[Received | Report]:
        while not self.is_open:
            await trio.sleep(0.0005)
        return await super().receive_many(limit)


def blocking_frames(count: int) -> object:
    """Take so many bursts in; the values of the last frame."""
    source = _Opened(count)
    with open_blocking(source, dictionary=edge_dictionary()) as master:
        master.in_loop(map_tpdo)
        node = master.node(NODE_ID)
        source.is_open = True
        master.in_loop(lambda _: source.taken.wait())
        return master.in_loop(lambda _: [node.remote.values[index << 8] for index in (LOW, HIGH)])


# ---- canopen-asyncio ----


def _variable(peer: Any, name: str, index: int, subindex: int, data_type: DataType) -> Any:
    found = peer.objectdictionary.ODVariable(name, index, subindex)
    found.data_type = int(data_type)
    return found


def asyncio_peers_reads(count: int) -> object:
    """Read so often; the last value."""
    peer = importlib.import_module("canopen_asyncio")
    dictionary = peer.ObjectDictionary()
    dictionary.add_object(_variable(peer, "number", NUMBER, 0, DataType.UNSIGNED32))

    async def main() -> object:
        loop = asyncio.get_running_loop()
        master, device = peer.Network(loop=loop), peer.Network(loop=loop)
        for network in (master, device):
            network.connect(interface="virtual", channel="benchmark asyncio")
        try:
            await device.create_node(NODE_ID, dictionary).sdo["number"].aset_raw(VALUE)
            node = await master.aadd_node(NODE_ID, dictionary)
            value: object = None
            for _ in range(count):
                value = await node.sdo["number"].aget_raw()
            return value
        finally:
            master.disconnect()
            device.disconnect()

    return asyncio.run(main())


def asyncio_peers_frames(count: int, subscribed: bool = False) -> object:
    """Take so many bursts in; the values of the last frame."""
    peer = importlib.import_module("canopen_asyncio")
    dictionary = peer.ObjectDictionary()
    for name, index in (("low", LOW), ("high", HIGH)):
        dictionary.add_object(_variable(peer, name, index, 0, DataType.UNSIGNED32))
    for name, index, fields in (("communication", 0x1800, (DataType.UNSIGNED8, DataType.UNSIGNED32)), ("mapping", 0x1A00, ())):
        record = peer.objectdictionary.ODRecord(name, index)
        for subindex, data_type in enumerate(fields or (DataType.UNSIGNED8,)):
            record.add_member(_variable(peer, f"{name} {subindex}", index, subindex, data_type))
        dictionary.add_object(record)

    async def main() -> object:
        source = TheirSource(count)
        network = peer.Network(loop=asyncio.get_running_loop())
        tpdo = (await network.aadd_node(NODE_ID, dictionary)).tpdo[1]
        tpdo.cob_id, tpdo.enabled = TPDO1, True
        for index in (LOW, HIGH):
            tpdo.add_variable(index, 0, 32)
        network.bus = source
        tpdo.subscribe()
        heard = 0

        def on_pdo(_: Any) -> None:
            nonlocal heard
            heard += 1

        if subscribed:
            tpdo.add_callback(on_pdo)
        notifier = can.Notifier(source, network.listeners, 1)
        await asyncio.to_thread(source.taken.wait)
        notifier.stop()
        source.shutdown()
        assert heard == (BURST * count if subscribed else 0)
        return [mapped.raw for mapped in tpdo.map]

    return asyncio.run(main())


# ---- the parts of a loop ----


async def _our_checkpoints(count: int) -> None:
    checkpoint = current_loop().checkpoint
    for _ in range(count):
        await checkpoint()


async def _our_scopes(count: int) -> None:
    loop = current_loop()
    for _ in range(count):
        with loop.move_on_after(10):
            pass


async def _our_wakes(count: int) -> None:
    """Two tasks wake each other in turn."""
    loop = current_loop()
    here, there = loop.parking_lot(), loop.parking_lot()

    async def answer() -> None:
        while True:
            await there.park()
            here.unpark()

    async with loop.open_nursery() as nursery:
        nursery.start_soon(answer)
        await loop.checkpoint()
        await loop.checkpoint()
        for _ in range(count):
            there.unpark()
            await here.park()
        nursery.cancel_scope.cancel()


async def _anyio_checkpoints(count: int) -> None:
    checkpoint = importlib.import_module("anyio.lowlevel").checkpoint
    for _ in range(count):
        await checkpoint()


async def _anyio_scopes(count: int) -> None:
    anyio = importlib.import_module("anyio")
    for _ in range(count):
        with anyio.move_on_after(10):
            pass


async def _anyio_wakes(count: int) -> None:
    """The same by events, as anyio has no parking lots."""
    anyio = importlib.import_module("anyio")
    events = [anyio.Event(), anyio.Event()]

    async def answer() -> None:
        while True:
            await events[1].wait()
            events[1] = anyio.Event()
            events[0].set()

    async with anyio.create_task_group() as group:
        group.start_soon(answer)
        await anyio.sleep(0)
        await anyio.sleep(0)
        for _ in range(count):
            events[1].set()
            await events[0].wait()
            events[0] = anyio.Event()
        group.cancel_scope.cancel()


PARTS: dict[str, tuple[Callable[[int], Awaitable[None]], Callable[[int], Awaitable[None]]]] = {
    "checkpoint": (_our_checkpoints, _anyio_checkpoints),
    "move_on_after": (_our_scopes, _anyio_scopes),
    "two tasks wake each other": (_our_wakes, _anyio_wakes),
}


# ---- figures ----


def compare(sides: dict[str, Repeat], rounds: int, seconds: float) -> dict[str, list[float]]:
    """ns of CPU time for doing it once, round by round, for each side."""
    for repeat in sides.values():
        repeat(1)  # what is imported for the first one is not counted
    counts = {name: calibrate(repeat, seconds) for name, repeat in sides.items()}
    found: dict[str, list[float]] = {name: [] for name in sides}
    names = [*sides]
    for number in range(rounds):
        for name in names[number % len(names) :] + names[: number % len(names)]:
            found[name].append(cpu_time(sides[name], counts[name]) / counts[name])
    return found


def row(title: str, found: dict[str, list[float]], divisor: int = 1) -> str:
    """One row of a table: the first side in us, and all as ratios to it."""
    first, *_ = found.values()
    least, median = min(first), statistics.median(first)
    ratios = [f"{statistics.median(each) / median:.2f} ({min(each) / least:.2f})" for each in found.values()]
    return f"| {title} | {median / divisor / 1000:.2f} | {' | '.join(ratios)} |"


def head(title: str, names: list[str]) -> str:
    """The first two lines of a table."""
    return f"| {title} | {names[0]}, us | {' | '.join(names)} |\n|---|{'---:|' * (len(names) + 1)}"


def masters(rounds: int, seconds: float) -> None:
    """Print what a read and a frame cost on each loop, and with the peers."""
    loops = {name: run for name, run in LOOPS.items() if name != "uvloop" or has("uvloop")}
    reads: dict[str, Repeat] = {name: partial(our_reads, run=run) for name, run in loops.items()}
    frames: dict[str, Repeat] = {name: our_frames(False, run) for name, run in loops.items()}
    heard: dict[str, Repeat] = {name: our_frames(True, run) for name, run in loops.items()}
    reads["blocking"], frames["blocking"], heard["blocking"] = blocking_reads, blocking_frames, our_pdos
    reads[f"canopen {VERSION}"], frames[f"canopen {VERSION}"] = their_reads(), their_frames(False)
    heard[f"canopen {VERSION}"] = their_frames(True)
    if has("canopen_asyncio"):
        reads["canopen-asyncio"] = asyncio_peers_reads
        frames["canopen-asyncio"] = asyncio_peers_frames
        heard["canopen-asyncio"] = partial(asyncio_peers_frames, subscribed=True)
    for sides in (reads, frames, heard):
        assert len({repr(repeat(20)) for repeat in sides.values()}) == 1
    print(head("once", [*reads]))
    print(row("read by name, virtual bus", compare(reads, rounds, seconds)))
    print(row("full frame comes in", compare(frames, rounds, seconds), BURST))
    print(row("full frame comes in, with a subscriber", compare(heard, rounds, seconds), BURST))


def parts(rounds: int, seconds: float) -> None:
    """Print what the parts of the loops cost."""
    for name, run in LOOPS.items():
        if name == "uvloop" and not has("uvloop"):
            continue
        print(head(name, ["canopen_transports.loop", *(["anyio"] if has("anyio") else [])]))
        for title, (ours, anyios) in PARTS.items():
            sides: dict[str, Repeat] = {"ours": lambda count, f=ours, run=run: run(partial(f, count))}  # type: ignore[misc]
            if has("anyio"):
                sides["anyio"] = lambda count, f=anyios, run=run: run(partial(f, count))  # type: ignore[misc]
            print(row(title, compare(sides, rounds, seconds)))
        print()


def main() -> None:
    """Read the arguments, measure, print."""
    parser = argparse.ArgumentParser(description="compare the loops, and the peers")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--seconds", type=float, default=0.2, help="CPU time of a round (default: 0.2)")
    parser.add_argument("--loops", action="store_true", help="the parts of the loops")
    arguments: Any = parser.parse_args()
    (parts if arguments.loops else masters)(arguments.rounds, arguments.seconds)


if __name__ == "__main__":
    main()
