"""What clients of the web door cost, and what one that hangs does to the cycle of an arm.

    python benchmarks/web_clients.py [--joints 6] [--seconds 10] [--realtime]

One process has the simulated drives, the master, an arm that follows a SYNC of 10 ms, and the doors. Each client is a process of
its own: it takes the live channel, watches the position of each joint, and has a monitor. "hung": it was stopped (SIGSTOP).
Told are, for each situation: the CPU time of the first process, as a share of one core; the SYNCs that went out, and those that
should have; set-points that were missing at a SYNC (`missed`), and periods without one (`skipped`). On a computer that does much
else periods are skipped without any client, too: compare with the first line.

    python benchmarks/web_clients.py --browser

opens the page in headless Chromium in place of them, with 12 joints at 100 Hz, each position as a curve, and tells the frames
that it drew in a second, and the samples that arrived. It needs chromium, chromium-driver and selenium.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager

import trio

from canopen_gateway import open_gateway, parse_permissions
from canopen_gateway.fleet import FleetPdo, bind_fleet_door, open_fleet
from canopen_gateway.web import bind_web_door
from canopen_master import Chain, open_master
from canopen_master.motion.chain_file import ChainDescription, JointDescription
from canopen_master.simulation.serving import simulated_drives
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.axis.units import Unit

LOCATOR = "virtual:behind the doors"
DEGREES = AxisSettings(unit=Unit.DEGREE, counts_per_unit=1000.0, max_speed=30.0)
FIRST = 3
"""The node-ID of the first joint."""


async def serve(joints: int, endpoint: str, realtime: bool) -> None:
    """The process of the doors: a line of figures for each line that it is told."""
    node_ids = range(FIRST, FIRST + joints)
    door = await bind_web_door(port=0)
    fleet = await bind_fleet_door("hall", listen=[endpoint])
    async with (
        door,
        fleet,
        simulated_drives((LOCATOR, node_id) for node_id in node_ids),
        open_master(LOCATOR, realtime=realtime or None) as master,
        open_gateway(master, allow=parse_permissions("motion")) as service,
        trio.open_nursery() as nursery,
    ):
        arm = master.chain(_description(node_ids), axes=DEGREES)
        await arm.initialise()
        await arm.follow()
        gc.freeze()  # as `canopen serve` does
        gc.callbacks.append(PAUSES.note)
        nursery.start_soon(door.serve, service)
        nursery.start_soon(fleet.serve, service)
        granted = [f"{measure.name}: {measure.refusal or 'given'}" for measure in master.realtime]
        print(json.dumps({"url": door.url, "realtime": granted}), flush=True)
        while line := await trio.to_thread.run_sync(sys.stdin.readline):
            print(json.dumps(await _figures(arm, float(line))), flush=True)
        nursery.cancel_scope.cancel()


def _description(node_ids: Sequence[int]) -> ChainDescription:
    joints = (JointDescription(f"joint{node_id - FIRST + 1}", LOCATOR, node_id) for node_id in node_ids)
    return ChainDescription("arm", tuple(joints))


class Pauses:
    """The longest pause of the garbage collector."""

    longest = 0.0
    _began = 0.0

    def note(self, phase: str, info: dict[str, int]) -> None:
        if phase == "start":
            self._began = time.perf_counter()
        else:
            self.longest = max(self.longest, time.perf_counter() - self._began)


PAUSES = Pauses()


async def _figures(arm: Chain, seconds: float) -> dict[str, float]:
    before = arm.sync_cycles, arm.missed_cycles, arm.skipped_cycles
    began, cpu = time.monotonic(), time.process_time()
    PAUSES.longest = 0.0
    await trio.sleep(seconds)
    took = time.monotonic() - began
    return {
        "cpu": 100 * (time.process_time() - cpu) / took,
        "due": took / 0.01,
        "sent": arm.sync_cycles - before[0],
        "missed": arm.missed_cycles - before[1],
        "skipped": arm.skipped_cycles - before[2],
        "pause": 1000 * PAUSES.longest,
    }


async def be_client(url: str, joints: int) -> None:
    """A client of the live channel, for ever; it says when it has begun."""
    from trio_websocket import open_websocket_url

    address, _, token = url.partition("/?token=")
    headers = [("authorization", f"Bearer {token}")]
    async with open_websocket_url(address.replace("http", "ws", 1) + "/api/v1/live", extra_headers=headers) as channel:
        objects = [[1, node_id, "6064:00"] for node_id in range(FIRST, FIRST + joints)]
        await channel.send_message(json.dumps({"k": "watch", "objects": objects, "period": 0.1}))
        await channel.send_message(json.dumps({"k": "monitor", "net": 1}))
        await channel.get_message()
        print("begun", flush=True)
        while True:
            await channel.get_message()


async def be_viewer(endpoint: str) -> None:
    """A viewer of the fleet, for ever; it says when it has begun."""
    async with open_fleet(connect=[endpoint]) as fleet:
        await fleet.settled()
        with fleet.news(FleetPdo) as pdos:
            await pdos.__anext__()
            print("begun", flush=True)
            async for _ in pdos:
                pass


@contextmanager
def another(*words: str) -> Iterator[subprocess.Popen[str]]:
    """A process of this file, once it has begun."""
    command = [sys.executable, __file__, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "begun\n"
            yield process
        finally:
            os.kill(process.pid, signal.SIGCONT)
            process.kill()


@contextmanager
def served(joints: int, realtime: bool) -> Iterator[tuple[subprocess.Popen[str], str, str]]:
    """The process of the doors, the address of its page, and that of its bridge."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{found.getsockname()[1]}"
    words = [sys.executable, __file__, "--serve", endpoint, "--joints", str(joints), *(["--realtime"] if realtime else [])]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            begun = json.loads(process.stdout.readline())
            for measure in begun["realtime"]:
                print(measure)
            yield process, begun["url"], endpoint
        finally:
            assert process.stdin is not None
            process.stdin.close()


def tell(process: subprocess.Popen[str], what: str, seconds: float) -> None:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{seconds}\n")
    process.stdin.flush()
    found = json.loads(process.stdout.readline())
    syncs = f"{found['sent']} of {found['due']:.0f}"
    print(
        f"| {what} | {found['cpu']:.1f} % | {syncs} | {found['missed']} | {found['skipped']} | {found['pause']:.0f} ms |",
        flush=True,
    )


def measure(joints: int, seconds: float, realtime: bool) -> None:
    with served(joints, realtime) as (process, url, endpoint), ExitStack() as stack:
        print(f"| {joints} joints at 100 Hz | CPU | SYNCs | missed | skipped | longest pause of the collector |", flush=True)
        print("|---|---|---|---|---|---|", flush=True)
        time.sleep(2)
        tell(process, "both doors, no client", seconds)
        clients = [stack.enter_context(another("--client", url, "--joints", str(joints))) for _ in range(5)]
        tell(process, "five web clients", seconds)
        os.kill(clients[0].pid, signal.SIGSTOP)
        tell(process, "five web clients, one of them hung", seconds)
        viewer = stack.enter_context(another("--viewer", endpoint))
        tell(process, "these, and a Zenoh viewer", seconds)
        os.kill(viewer.pid, signal.SIGSTOP)
        tell(process, "these, and the Zenoh viewer hangs", seconds)


def measure_browser(joints: int, seconds: float, realtime: bool) -> None:
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    options = Options()
    options.binary_location = shutil.which("chromium") or ""
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1400,1600", "--disable-gpu"):
        options.add_argument(argument)
    with served(joints, realtime) as (process, url, _):
        driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver") or ""))
        try:
            driver.set_script_timeout(10 * seconds + 60)
            driver.get(url)
            driver.execute_async_script("setTimeout(arguments[0], 2000)")
            for node_id in range(FIRST, FIRST + joints):
                driver.execute_script(
                    "canopenPage.watch({net: 1, node: arguments[0], path: '6064:00', name: 'position'})", node_id
                )
            driver.execute_async_script("setTimeout(arguments[0], 3000)")
            found = driver.execute_async_script(
                """const [seconds, done] = arguments; let asked = 0; const begun = performance.now();
                const [samples, drawn] = [canopenPage.samples, canopenPage.frames];
                const count = () => {
                  asked += 1;
                  const took = (performance.now() - begun) / 1000;
                  if (took < seconds) requestAnimationFrame(count);
                  else done([asked / took, (canopenPage.frames - drawn) / took, (canopenPage.samples - samples) / took]);
                };
                requestAnimationFrame(count);""",
                seconds,
            )
            asked, drawn, samples = found
            print(f"{joints} curves: {asked:.1f} animation frames a second, {drawn:.1f} drawn; {samples:.0f} samples a second")
            tell(process, "with the browser", seconds)
        finally:
            driver.quit()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--joints", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--browser", action="store_true")
    parser.add_argument("--realtime", action="store_true")
    for hidden in ("--serve", "--client", "--viewer"):
        parser.add_argument(hidden, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        trio.run(serve, options.joints, options.serve, options.realtime)
    elif options.client:
        trio.run(be_client, options.client, options.joints)
    elif options.viewer:
        trio.run(be_viewer, options.viewer)
    elif options.browser:
        measure_browser(options.joints or 12, options.seconds, options.realtime)
    else:
        measure(options.joints or 6, options.seconds, options.realtime)


if __name__ == "__main__":
    main()
