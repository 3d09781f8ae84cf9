"""A fleet on one computer: what a bridge costs, and what a viewer that hangs does to it.

    python benchmarks/fleet.py [--buses 50] [--nodes 20] [--seconds 10]

One process has the buses, all simulated nodes (a heartbeat once a second each) and the bridge; another one is the viewer. Told
are: the bridge's process without and with the door, in CPU time a second; a read of one object of all nodes, side by side; a read
alone; a PDO that is published, with a viewer that takes it, and with one that was stopped (SIGSTOP): there also the longest that
one took.
"""

from __future__ import annotations

import argparse
import os
import signal
import socket
import subprocess
import sys
import time

import trio

from canopen_data.descriptions import load_description
from canopen_gateway import open_gateway
from canopen_gateway.fleet import FleetPdo, bind_fleet_door, open_fleet
from canopen_gateway.fleet.keys import FleetPlace, key_of
from canopen_master import DeviceModel, open_master
from canopen_master.simulation import simulated_devices

PDOS = 20_000


async def serve(endpoint: str, buses: int, nodes: int, seconds: float) -> None:
    """The process of the bridge; it says what it costs, one line each."""
    dictionary = load_description("sample_io.eds").dictionary
    names = [f"virtual:bus{number}" for number in range(buses)]
    devices = {name: [DeviceModel(dictionary, node_id=node_id) for node_id in range(1, nodes + 1)] for name in names}
    door = await bind_fleet_door("hall", listen=[endpoint])
    async with door, simulated_devices(devices), open_master(*names) as master, open_gateway(master) as service:
        for name in names:
            for node_id in range(1, nodes + 1):
                await master.node(node_id, bus=name).write_bytes(0x1017, 0, (1000).to_bytes(2, "little"))
        await trio.sleep(3)
        say("without the door", await cpu_share(seconds))
        async with trio.open_nursery() as nursery:
            nursery.start_soon(door.serve, service)
            while len(door.alive) < buses * nodes:
                await trio.sleep(0.1)
            await trio.sleep(3)
            say("with the door", await cpu_share(seconds))
            print("ready", flush=True)
            await trio.to_thread.run_sync(sys.stdin.readline)  # the viewer takes PDOs now
            publish(door, "a PDO, taken")
            await trio.to_thread.run_sync(sys.stdin.readline)  # the viewer hangs now
            publish(door, "a PDO, the viewer hangs")
            await trio.to_thread.run_sync(sys.stdin.readline)
            nursery.cancel_scope.cancel()


async def cpu_share(seconds: float) -> str:
    began, cpu = time.monotonic(), time.process_time()
    await trio.sleep(seconds)
    return f"{100 * (time.process_time() - cpu) / (time.monotonic() - began):.1f} % of a core"


def publish(door: object, what: str) -> None:
    key, data = key_of(FleetPlace("hall", "virtual-bus0", 1), "pdo", "1"), bytes(16)
    longest, began, cpu = 0.0, time.monotonic(), time.process_time()
    for _ in range(PDOS):
        each = time.monotonic()
        door._put(key, data)  # type: ignore[attr-defined]
        longest = max(longest, time.monotonic() - each)
    spent, wall = time.process_time() - cpu, time.monotonic() - began
    say(
        what,
        f"{spent / PDOS * 1e6:.1f} us of CPU time each ({wall / PDOS * 1e6:.1f} us of time), the longest {longest * 1e3:.2f} ms",
    )


def say(what: str, text: str) -> None:
    print(f"{what}: {text}", flush=True)


async def view(endpoint: str, served: subprocess.Popen[str], nodes: int) -> None:
    """The process of the viewer, and what it sees."""
    assert served.stdin is not None
    async with open_fleet(connect=[endpoint]) as fleet:
        while len(fleet.nodes) < nodes:
            await trio.sleep(0.05)
        began = time.monotonic()
        found = await fleet.read_all("*/*/*", 0x1000)
        say(
            f"{len(found)} nodes read side by side",
            f"{time.monotonic() - began:.2f} s, {sum(bool(each.problem) for each in found)} failed",
        )
        began = time.monotonic()
        for _ in range(500):
            await fleet.read(fleet.nodes[0], 0x1000)
        say("a read alone", f"{(time.monotonic() - began) / 500 * 1e3:.2f} ms")
    watcher = subprocess.Popen([sys.executable, __file__, "--watch", endpoint], stdout=subprocess.PIPE, text=True)
    assert watcher.stdout is not None
    watcher.stdout.readline()
    tell(served)
    await trio.sleep(3)
    os.kill(watcher.pid, signal.SIGSTOP)
    tell(served)
    await trio.sleep(3)
    os.kill(watcher.pid, signal.SIGCONT)
    watcher.kill()
    tell(served)


def tell(served: subprocess.Popen[str]) -> None:
    assert served.stdin is not None
    served.stdin.write("\n")
    served.stdin.flush()


async def watch(endpoint: str) -> None:
    """Take PDOs, for ever."""
    async with open_fleet(connect=[endpoint]) as fleet:
        await fleet.settled()
        with fleet.news(FleetPdo) as pdos:
            await trio.sleep(0.5)
            print("watching", flush=True)
            async for _ in pdos:
                pass


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--buses", type=int, default=50)
    parser.add_argument("--nodes", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    parser.add_argument("--watch", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        trio.run(serve, options.serve, options.buses, options.nodes, options.seconds)
        return
    if options.watch:
        trio.run(watch, options.watch)
        return
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{found.getsockname()[1]}"
    words = [sys.executable, __file__, "--serve", endpoint, "--buses", str(options.buses), "--nodes", str(options.nodes)]
    words += ["--seconds", str(options.seconds)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as served:
        assert served.stdout is not None
        for line in served.stdout:
            if line == "ready\n":
                break
            print(line, end="")
        trio.run(view, endpoint, served, options.buses * options.nodes)
        for line in served.stdout:
            print(line, end="")


if __name__ == "__main__":
    main()
