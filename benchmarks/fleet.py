"""A fleet on one computer: what bridges, a router, a viewer and a recorder cost, and what a viewer that hangs does to a bridge.

    python benchmarks/fleet.py [--buses 50] [--nodes 20] [--processes 5] [--seconds 10]

The buses are shared out to processes; each has its simulated nodes (a heartbeat once a second each) and a bridge, which connects
to a router, a process too. The viewer is this process. It connects through a relay, which counts the bytes on the wire. Told are
CPU times, since the computer may have other work; messages and bytes; reads of one object of all nodes, side by side; PDOs, as a
viewer and as a recorder takes them; and what one costs a bridge while the viewer hangs (SIGSTOP).
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import trio

from canopen_data.descriptions import load_description
from canopen_gateway import open_gateway
from canopen_gateway.fleet import FleetPdo, FleetPlace, bind_fleet_door, open_fleet
from canopen_gateway.fleet.bridge import FleetDoor
from canopen_gateway.fleet.joining import close_zenoh, open_zenoh
from canopen_gateway.fleet.keys import ROOT, count_bytes, key_of
from canopen_gateway.history import Recorded, record_fleet
from canopen_master import DeviceModel, open_master
from canopen_master.simulation import simulated_devices

PDOS = 20_000
RATE = 1000
"""PDOs a second that the viewer and the recorder are given."""
READY = "ready\n"


# ---- the processes of bridges ----


async def serve(endpoint: str, site: str, buses: int, nodes: int, seconds: float) -> None:
    """A process of bridges. It says what it costs, and then does what it is told, a word a line."""
    dictionary = load_description("sample_io.eds").dictionary
    names = [f"virtual:{site}-{number}" for number in range(buses)]
    devices = {name: [DeviceModel(dictionary, node_id=node_id) for node_id in range(1, nodes + 1)] for name in names}
    door = await bind_fleet_door(site, connect=[endpoint])
    async with door, simulated_devices(devices), open_master(*names) as master, open_gateway(master) as service:
        node = master.node(1, "sample_io.eds", bus=names[0])
        for name in names:
            for node_id in range(1, nodes + 1):
                await master.node(node_id, bus=name).write_bytes(0x1017, 0, (1000).to_bytes(2, "little"))
        await trio.sleep(3)
        without = await cpu_share(seconds)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(door.serve, service)
            while len(door.alive) < buses * nodes:
                await trio.sleep(0.1)
            await trio.sleep(3)
            print(f"{without} {await cpu_share(seconds)}", flush=True)
            print(READY, end="", flush=True)
            place = FleetPlace(site, next(iter(door.buses)), 1)
            size = sum(each.bit_length for each in node.remote.tpdos[1].mapping.components) // 8
            while True:
                word = (await trio.to_thread.run_sync(sys.stdin.readline)).strip()
                began = time.process_time()
                if word == "burst":
                    print(burst(door, place, size), flush=True)
                elif word == "pdos":
                    for number in range(int(RATE * seconds)):
                        put(door, place, number, size)
                        if number % 20 == 19:
                            await trio.sleep(20 / RATE)
                elif not word:
                    break
                print(f"{time.process_time() - began}", flush=True)
            nursery.cancel_scope.cancel()


async def cpu_share(seconds: float) -> float:
    """Return the share of a core that this process takes."""
    began, cpu = time.monotonic(), time.process_time()
    await trio.sleep(seconds)
    return (time.process_time() - cpu) / (time.monotonic() - began)


def put(door: FleetDoor, place: FleetPlace, number: int, size: int) -> None:
    """Publish a PDO as the bridge does."""
    data = time.time_ns().to_bytes(8, "little") + bytes(size)
    door._put(key_of(place, "pdo", "1"), data, count_bytes(door._run, number + 1, 0))


def burst(door: FleetDoor, place: FleetPlace, size: int) -> str:
    """Publish as fast as it goes; say what one took: CPU time, the longest."""
    longest, cpu = 0.0, time.process_time()
    for number in range(PDOS):
        each = time.monotonic()
        put(door, place, number, size)
        longest = max(longest, time.monotonic() - each)
    spent = time.process_time() - cpu
    return f"{spent / PDOS * 1e6:.1f} us of CPU time each, the longest {longest * 1e3:.2f} ms"


class Server:
    """A process of bridges, from outside. site: its name. without, with_door: its share of a core."""

    def __init__(self, number: int, endpoint: str, buses: int, options: argparse.Namespace) -> None:
        self.site = f"hall-{number}"
        words = [sys.executable, __file__, "--serve", endpoint, "--site", self.site, "--buses", str(buses)]
        words += ["--nodes", str(options.nodes), "--seconds", str(options.seconds)]
        self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.without = self.with_door = 0.0

    def wait(self) -> None:
        """Wait until it serves."""
        self.without, self.with_door = map(float, self.line().split())
        assert self.line() == READY

    def line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def tell(self, word: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{word}\n")
        self.process.stdin.flush()

    def end(self) -> None:
        with contextlib.suppress(OSError):
            self.tell("")
        self.process.wait()


async def route(endpoint: str) -> None:
    """The process of the router."""
    session = await open_zenoh(listen=[endpoint], mode="router")
    print(READY, end="", flush=True)
    await trio.to_thread.run_sync(sys.stdin.readline)
    await close_zenoh(session)


async def watch(endpoint: str) -> None:
    """A viewer of its own, which takes PDOs, for ever."""
    async with open_fleet(connect=[endpoint]) as fleet:
        await fleet.settled()
        with fleet.news(FleetPdo) as pdos:
            await trio.sleep(0.5)
            print("watching", flush=True)
            async for _ in pdos:
                pass


# ---- the viewer ----


class Relay:
    """Passes on the bytes between a viewer and the router, and counts those to the viewer; in a thread, with CPU time of
    its own. endpoint: where it listens. count: bytes."""

    def __init__(self, port: int) -> None:
        self.count = 0
        self.endpoint = ""
        self._port = port
        self._over = trio.Event()
        self._listens = threading.Event()
        self._thread = threading.Thread(target=trio.run, args=(self._run,))

    def __enter__(self) -> Relay:
        self._thread.start()
        self._listens.wait()
        return self

    def __exit__(self, *exc: object) -> None:
        self._token.run_sync_soon(self._over.set)
        self._thread.join()

    @property
    def cpu(self) -> float:
        """CPU seconds of its thread so far."""
        return time.clock_gettime(time.pthread_getcpuclockid(self._thread.ident or 0))

    async def _run(self) -> None:
        self._token = trio.lowlevel.current_trio_token()
        async with trio.open_nursery() as nursery:
            listeners = await nursery.start(trio.serve_tcp, self._pass_on, 0)
            self.endpoint = f"tcp/127.0.0.1:{listeners[0].socket.getsockname()[1]}"
            self._listens.set()
            await self._over.wait()
            nursery.cancel_scope.cancel()

    async def _pass_on(self, stream: trio.SocketStream) -> None:
        async with stream, await trio.open_tcp_stream("127.0.0.1", self._port) as other, trio.open_nursery() as nursery:
            nursery.start_soon(self._copy, stream, other, False)
            nursery.start_soon(self._copy, other, stream, True)

    async def _copy(self, source: trio.SocketStream, target: trio.SocketStream, counted: bool) -> None:
        with contextlib.suppress(trio.BrokenResourceError, trio.ClosedResourceError):
            async for chunk in source:
                self.count += len(chunk) if counted else 0
                await target.send_all(chunk)


def own_cpu(relay: Relay) -> float:
    """Return the CPU seconds of this process without its relay."""
    return time.process_time() - relay.cpu


def cpu_of(process: subprocess.Popen[str]) -> float:
    """Return the CPU seconds that a process has used so far."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def view(options: argparse.Namespace, port: int, router: subprocess.Popen[str], servers: list[Server]) -> None:
    count = options.buses * options.nodes
    with Relay(port) as relay:
        async with open_fleet(connect=[relay.endpoint]) as fleet:
            began = time.monotonic()
            while len(fleet.nodes) < count:
                await trio.sleep(0.05)
            say(f"{count} nodes seen", f"{time.monotonic() - began:.1f} s, {relay.count / count:.0f} bytes each")
            await quiet(fleet, relay, router, options.seconds)
            await reads(fleet, relay, count)
            await pdos(fleet, relay, router, servers[0], options.seconds)
            await recorded(fleet, relay, servers[0], options.seconds)


async def quiet(fleet: object, relay: Relay, router: subprocess.Popen[str], seconds: float) -> None:
    """Measure the messages that a viewer of the whole fleet gets while no value changes."""
    messages = size = 0

    def take(sample: object) -> None:
        nonlocal messages, size
        messages += 1
        size += len(bytes(sample.payload))  # type: ignore[attr-defined]

    listening = fleet._zenoh.declare_subscriber(f"{ROOT}/**", take)  # type: ignore[attr-defined]
    await trio.sleep(1)
    messages = size = 0
    before, cpu, began = relay.count, cpu_of(router), time.monotonic()
    await trio.sleep(seconds)
    took = time.monotonic() - began
    say(
        "nothing happens",
        f"{messages / took:.1f} messages a second, {size / max(messages, 1):.0f} bytes each, "
        f"{(relay.count - before) / took / 1e3:.1f} kB/s on the wire; "
        f"the router {100 * (cpu_of(router) - cpu) / took:.1f} % of a core",
    )
    listening.undeclare()


async def reads(fleet: object, relay: Relay, count: int) -> None:
    began, cpu, before = time.monotonic(), own_cpu(relay), relay.count
    found = await fleet.read_all("*/*/*", 0x1000)  # type: ignore[attr-defined]
    failed = sum(bool(each.problem) for each in found)
    say(
        f"{count} nodes read side by side",
        f"{time.monotonic() - began:.2f} s, {failed} failed; {(own_cpu(relay) - cpu) / count * 1e6:.0f} us of CPU time of "
        f"the viewer and {(relay.count - before) / count:.0f} bytes each",
    )
    began = time.monotonic()
    for _ in range(500):
        await fleet.read(fleet.nodes[0], 0x1000)  # type: ignore[attr-defined]
    say("a read alone", f"{(time.monotonic() - began) / 500 * 1e3:.2f} ms")


async def pdos(fleet: object, relay: Relay, router: subprocess.Popen[str], server: Server, seconds: float) -> None:
    """PDOs, as a viewer takes them."""
    with fleet.news(FleetPdo) as news:  # type: ignore[attr-defined]
        await trio.sleep(1)
        before, cpu, routed, taken = relay.count, own_cpu(relay), cpu_of(router), 0
        server.tell("pdos")
        with trio.move_on_after(seconds + 5):
            async for _ in news:
                taken += 1
                if taken >= int(RATE * seconds):
                    break
        spent, passed = own_cpu(relay) - cpu, cpu_of(router) - routed
    published = float(await trio.to_thread.run_sync(server.line))
    sent = int(RATE * seconds)
    say(
        f"{sent} PDOs at {RATE} a second",
        f"{taken} came; {(relay.count - before) / taken:.0f} bytes on the wire each; CPU time each: bridge "
        f"{published / sent * 1e6:.0f} us, router {passed / taken * 1e6:.0f} us, "
        f"viewer {spent / taken * 1e6:.0f} us",
    )


async def recorded(fleet: object, relay: Relay, server: Server, seconds: float) -> None:
    """The same, as a recorder takes them."""
    with tempfile.TemporaryDirectory() as folder:
        told, cpu = Recorded(), own_cpu(relay)

        async def record() -> None:
            await record_fleet(fleet, Path(folder), flush=5.0, told=told, started=lambda _: server.tell("pdos"))  # type: ignore[arg-type]

        async with trio.open_nursery() as nursery:
            nursery.start_soon(record)
            await trio.to_thread.run_sync(server.line)
            await trio.sleep(1)
            nursery.cancel_scope.cancel()
        sent, spent = int(RATE * seconds), own_cpu(relay) - cpu
        size = sum(each.stat().st_size for each in Path(folder).rglob("*.parquet"))
        say(
            "the same, recorded",
            f"{told.rows} rows, {told.lost} lost; {spent / sent * 1e6:.0f} us of CPU time a PDO, "
            f"{size / told.rows:.1f} bytes a row",
        )


def hung(endpoint: str, server: Server) -> None:
    """Measure what a PDO costs a bridge: while a viewer takes it, and while the viewer hangs."""
    watcher = subprocess.Popen([sys.executable, __file__, "--watch", endpoint], stdout=subprocess.PIPE, text=True)
    assert watcher.stdout is not None
    watcher.stdout.readline()
    server.tell("burst")
    say("a PDO, the viewer takes it", server.line().strip())
    server.line()
    time.sleep(3)
    os.kill(watcher.pid, signal.SIGSTOP)
    server.tell("burst")
    say("a PDO, the viewer hangs", server.line().strip())
    server.line()
    os.kill(watcher.pid, signal.SIGCONT)
    watcher.kill()
    watcher.wait()


def say(what: str, text: str) -> None:
    print(f"{what}: {text}", flush=True)


@contextlib.contextmanager
def running(options: argparse.Namespace) -> Iterator[tuple[int, subprocess.Popen[str], list[Server]]]:
    """The router and the bridges, while the block runs."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    words = [sys.executable, __file__, "--route", f"tcp/127.0.0.1:{port}"]
    router = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert router.stdout is not None
    router.stdout.readline()
    shares = [
        options.buses // options.processes + (each < options.buses % options.processes) for each in range(options.processes)
    ]
    servers = [Server(number, f"tcp/127.0.0.1:{port}", share, options) for number, share in enumerate(shares)]
    try:
        yield port, router, servers
    finally:
        for each in servers:
            each.end()
        router.kill()
        router.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--buses", type=int, default=50)
    parser.add_argument("--nodes", type=int, default=20)
    parser.add_argument("--processes", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=10.0)
    for name in ("--serve", "--site", "--watch", "--route"):
        parser.add_argument(name, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        trio.run(serve, options.serve, options.site, options.buses, options.nodes, options.seconds)
        return
    if options.watch or options.route:
        trio.run(*((watch, options.watch) if options.watch else (route, options.route)))
        return
    with running(options) as (port, router, servers):
        for each in servers:
            each.wait()
        count = options.buses * options.nodes
        without, with_door = (sum(getattr(each, name) for each in servers) for name in ("without", "with_door"))
        say(
            f"{options.buses} buses, {count} nodes with a heartbeat a second, in {options.processes} processes",
            f"{100 * without:.0f} % of a core; with the bridges {100 * with_door:.0f} %: "
            f"{(with_door - without) / count * 1e6:.0f} us more a node and second",
        )
        trio.run(functools.partial(view, options, port, router, servers))
        hung(f"tcp/127.0.0.1:{port}", servers[0])


if __name__ == "__main__":
    main()
