"""SocketCAN: our transport and master against python-can's `Notifier` and `canopen`, in one run; and three ways to keep a SYNC.

    python benchmarks/socketcan.py                       # where there is a vcan0; about two minutes
    tests/vcan/run python benchmarks/socketcan.py        # elsewhere, in a kernel that is booted for it

- Receiving: can-utils' `cangen` floods vcan0 as fast as it can. One receiver at a time counts what it gets for some seconds: ours
  by `await transport.receive()`, python-can's by a listener of its `Notifier`. Rounds are interleaved. CPU time is that of the
  receiving process only; the one that sends is another. Both hand out one object per frame, with the kernel's time stamp.
- SDO: a bare server (a blocking socket that answers each expedited upload with the same 4 bytes, for all nodes) in a process of
  its own; the same object is read from it over and over by our master and by `canopen`, each with its own transport, from one
  node and from twelve at the same time; and by our core alone, in the driver loop of a script that does nothing else.
- SYNC: each producer sends it for a thousand cycles; what counts are the kernel's time stamps, by how much the distance of two
  differs from the period.

A User-Mode Linux kernel spends 15 to 80 us on each system call, and reading the clock is one there. Figures from one are marked.
"""

from __future__ import annotations

import argparse
import itertools
import platform
import shutil
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, contextmanager
from pathlib import Path
from typing import Any

import can
import canopen
import trio

from canopen_master import open_master
from canopen_master.node import Node
from canopen_master.participant.alarm import FineAlarm
from canopen_proto.frame import Frame
from canopen_proto.machine import Event
from canopen_proto.network import Network
from canopen_proto.sdo.client import SdoClient, SdoUploaded
from canopen_transports import open_transport
from canopen_transports.socketcan import SocketCanTransport
from canopen_transports.socketcan.kernel import CAN_FRAME, pack

BUS = "vcan0"
NODE = 5
AXES = 12
SYNC = Frame(0x80)
SERVER = """
import socket, struct
sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, struct.pack("=II", 0x600, 0xC0000780))
sock.bind(("vcan0",))
print("ready", flush=True)
answers = [struct.pack("=IB3x8s", 0x580 + node, 8, bytes.fromhex("4300100092010200")) for node in range(128)]
while True:
    sock.send(answers[sock.recv(16)[0] & 0x7F])
"""


@contextmanager
def process(*command: str, wait: bool = False) -> Any:
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as running:
        try:
            if wait:
                running.stdout.readline()
            yield running
        finally:
            running.kill()


# ---- receiving ----


def receive_ours(seconds: float) -> tuple[int, float, float]:
    """Frames, wall time, CPU time."""

    async def main() -> tuple[int, float, float]:
        async with await open_transport(BUS) as transport:
            count = 0
            wall, cpu = time.perf_counter(), time.process_time()
            with trio.move_on_after(seconds):
                while True:
                    if isinstance(await transport.receive(), tuple):
                        count += 1
            return count, time.perf_counter() - wall, time.process_time() - cpu

    return trio.run(main)


def receive_theirs(seconds: float) -> tuple[int, float, float]:
    count = 0

    class Count(can.Listener):
        def on_message_received(self, msg: can.Message) -> None:
            nonlocal count
            count += 1

    with can.Bus(BUS, interface="socketcan") as bus:
        wall, cpu = time.perf_counter(), time.process_time()
        notifier = can.Notifier(bus, [Count()])
        time.sleep(seconds)
        result = count, time.perf_counter() - wall, time.process_time() - cpu
        notifier.stop()
    return result


def compare_receiving(rounds: int, seconds: float) -> None:
    cangen = shutil.which("cangen")
    if cangen is None:
        print("\n(no cangen here: apt-get install can-utils)")
        return
    rates: dict[str, list[float]] = {"ours": [], "theirs": []}
    costs: dict[str, list[float]] = {"ours": [], "theirs": []}
    for number in range(rounds):
        for name, receive in sorted((("ours", receive_ours), ("theirs", receive_theirs)), reverse=bool(number % 2)):
            with process(cangen, BUS, "-g", "0", "-i", "-L", "8"):
                time.sleep(0.3)
                count, wall, cpu = receive(seconds)
            rates[name].append(count / wall)
            costs[name].append(cpu / count * 1e6)
    row("frames received per second under cangen flood", rates, "1/s", higher_is_better=True)
    row("CPU time per received frame", costs, "us", higher_is_better=False)


# ---- SDO ----

Reader = Callable[[float, int], tuple[int, float, float]]


def read_ours(seconds: float, nodes: int) -> tuple[int, float, float]:
    """One task for each node."""

    async def main() -> tuple[int, float, float]:
        count = 0

        async def read_on(node: Node) -> None:
            nonlocal count
            while time.perf_counter() - wall < seconds:
                await node.read(0x1000)
                count += 1

        async with open_master(f"socketcan:{BUS}") as master:
            remotes = [master.node(node_id) for node_id in range(NODE, NODE + nodes)]
            assert [await node.read(0x1000) for node in remotes] == [0x20192] * nodes
            wall, cpu = time.perf_counter(), time.process_time()
            async with trio.open_nursery() as nursery:
                for node in remotes:
                    nursery.start_soon(read_on, node)
            return count, time.perf_counter() - wall, time.process_time() - cpu

    return trio.run(main)


def read_theirs(seconds: float, nodes: int) -> tuple[int, float, float]:
    """One thread for each node, as its calls block; a single one needs none."""
    dictionary = canopen.ObjectDictionary()
    variable = canopen.objectdictionary.ODVariable("device type", 0x1000)
    variable.data_type = canopen.objectdictionary.UNSIGNED32
    dictionary.add_object(variable)
    network = canopen.Network()
    network.connect(interface="socketcan", channel=BUS)

    def read_on(node: Any) -> int:
        count = 0
        while time.perf_counter() - wall < seconds:
            _ = node.sdo[0x1000].raw
            count += 1
        return count

    try:
        remotes = [network.add_node(node_id, dictionary) for node_id in range(NODE, NODE + nodes)]
        assert [node.sdo[0x1000].raw for node in remotes] == [0x20192] * nodes
        with ThreadPoolExecutor(nodes) as threads:
            wall, cpu = time.perf_counter(), time.process_time()
            count = read_on(remotes[0]) if nodes == 1 else sum(threads.map(read_on, remotes))
            return count, time.perf_counter() - wall, time.process_time() - cpu
    finally:
        network.disconnect()


def read_by_the_core(seconds: float, nodes: int) -> tuple[int, float, float]:
    """The core alone, as in a script that does one thing at a time: its driver loop around a blocking socket."""
    assert nodes == 1
    network = Network()
    client = SdoClient(network.out, NODE)
    network.attach(client)
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sock:
        sock.bind((BUS,))
        count = 0
        wall, cpu = time.perf_counter(), time.process_time()
        while time.perf_counter() - wall < seconds:
            client.upload(0x1000, 0, time.monotonic_ns())
            outcome: Event | None = None
            while outcome is None:
                frames, events = network.drain(time.monotonic_ns())
                for frame in frames:
                    sock.send(pack(frame))
                if events:
                    outcome = events[0]
                    continue
                can_id, length, data = CAN_FRAME.unpack(sock.recv(16))
                network.receive(Frame(can_id, data[:length]), time.monotonic_ns())
            assert isinstance(outcome, SdoUploaded)
            assert outcome.data == b"\x92\x01\x02\x00"
            count += 1
        return count, time.perf_counter() - wall, time.process_time() - cpu


def compare_sdo(rounds: int, seconds: float) -> None:
    with process(sys.executable, "-c", SERVER, wait=True):
        measure_sdo(rounds, seconds, 1, {"the master": read_ours, "the core around a blocking socket": read_by_the_core})
        measure_sdo(rounds, seconds, AXES, {f"the master, {AXES} nodes at a time": read_ours})


def measure_sdo(rounds: int, seconds: float, nodes: int, ours: dict[str, Reader]) -> None:
    sides = {"theirs": read_theirs, **ours}
    rates: dict[str, list[float]] = {name: [] for name in sides}
    costs: dict[str, list[float]] = {name: [] for name in sides}
    for number in range(rounds):
        for name in sorted(sides, reverse=bool(number % 2)):
            count, wall, cpu = sides[name](seconds, nodes)
            rates[name].append(count / wall)
            costs[name].append(cpu / count * 1e6)
    for name in ours:
        row(f"SDO round trips per second, by {name}", {**rates, "ours": rates[name]}, "1/s", higher_is_better=True)
        row(f"CPU time per SDO round trip, by {name}", {**costs, "ours": costs[name]}, "us", higher_is_better=False)


def row(title: str, figures: dict[str, list[float]], unit: str, higher_is_better: bool) -> None:
    ours, theirs = statistics.median(figures["ours"]), statistics.median(figures["theirs"])
    ratio = ours / theirs if higher_is_better else theirs / ours
    print(f"| {title}, {unit} | {ours:.0f} | {theirs:.0f} | **{ratio:.1f}** |", flush=True)


# ---- SYNC ----

Producer = Callable[[SocketCanTransport, float, int], Awaitable[None]]


async def by_trio(transport: SocketCanTransport, period: float, cycles: int) -> None:
    start = trio.current_time()
    for number in range(cycles):
        await trio.sleep_until(start + number * period)
        await transport.send(SYNC)


async def by_timerfd(transport: SocketCanTransport, period: float, cycles: int) -> None:
    alarm = FineAlarm()
    start = trio.current_time()
    for number in range(cycles):
        alarm.set(start + number * period)
        await alarm.wait()
        await transport.send(SYNC)
    alarm.close()


async def by_kernel(transport: SocketCanTransport, period: float, cycles: int) -> None:
    transport.start_cyclic([SYNC], round(period * 1e9))
    await trio.sleep(cycles * period)
    transport.stop_cyclic()


PRODUCERS: dict[str, Producer] = {
    "trio.sleep_until": by_trio,
    "timerfd, awaited with trio": by_timerfd,
    "the kernel's broadcast manager": by_kernel,
}


async def jitter(produce: Producer, period: float, cycles: int) -> list[float]:
    """By how many us the distance of two SYNCs differs from the period, sorted."""
    async with AsyncExitStack() as stack:
        sender, listener = [await stack.enter_async_context(await open_transport(BUS)) for _ in range(2)]
        await produce(sender, period, cycles)  # meanwhile the kernel stamps what it receives; nobody needs to wake for it
        stamps = []
        with trio.move_on_after(0.5):
            while True:
                received = await listener.receive()
                if isinstance(received, tuple) and received[0] == SYNC:
                    stamps.append(received[1])
    return sorted(abs(later - earlier - period * 1e9) / 1e3 for earlier, later in itertools.pairwise(stamps))


def compare_sync(cycles: int) -> None:
    print("\n| SYNC, deviation of the period in us: | period, ms | median | 99.9 % | worst |\n|---|---:|---:|---:|---:|")
    for name, produce in PRODUCERS.items():
        for milliseconds in (1, 4, 10):
            found = trio.run(jitter, produce, milliseconds / 1000, cycles)
            tail = found[int(0.999 * (len(found) - 1))]
            print(f"| {name} | {milliseconds} | {statistics.median(found):.0f} | {tail:.0f} | {found[-1]:.0f} |", flush=True)


def main() -> None:
    """Read the arguments, measure, print."""
    parser = argparse.ArgumentParser(description="compare our SocketCAN with python-can's and canopen's, in one run")
    parser.add_argument("--rounds", type=int, default=5, help="rounds per side (default: 5)")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each round (default: 3)")
    parser.add_argument("--cycles", type=int, default=1000, help="of each SYNC (default: 1000)")
    arguments = parser.parse_args()
    if not Path(f"/sys/class/net/{BUS}").exists():
        parser.error(f"this kernel has no {BUS}: tests/vcan/run python benchmarks/socketcan.py")
    model = Path("/proc/cpuinfo").read_text()
    kernel = "USER-MODE LINUX, whose system calls are slow," if "User Mode Linux" in model else "Linux"
    start = time.perf_counter()
    for _ in range(1000):
        time.clock_gettime(time.CLOCK_PROCESS_CPUTIME_ID)
    call = (time.perf_counter() - start) * 1e3
    print(f"{platform.python_implementation()} {platform.python_version()}, {kernel} {platform.release()}")
    print(f"(here a system call takes {call:.1f} us); canopen {canopen.__version__}, python-can {can.__version__}; medians\n")
    print("| once | ours | python-can, canopen | ratio |\n|---|---:|---:|---:|")
    compare_receiving(arguments.rounds, arguments.seconds)
    compare_sdo(arguments.rounds, arguments.seconds)
    compare_sync(arguments.cycles)


if __name__ == "__main__":
    main()
