"""A process that is copied by `os.fork` in the block of a master: the bus, and the loop, stay the parent's."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system copies no processes")

BUS = """
import trio
from canopen_master.simulation.serving import simulated_drives
from canopen_transports.tcp.server import BusServer, serve_bus

async def main():
    async with trio.open_nursery() as nursery:
        (address,) = await nursery.start(serve_bus, "127.0.0.1", 0, BusServer())
        async with simulated_drives([(address, 3)]):
            print(address, flush=True)
            await trio.sleep_forever()

trio.run(main)
"""
SCRIPT = """
import asyncio, os, sys
import trio
from canopen_master import open_master
from canopen_proto import LocalProtocolError
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_transports.loop import current_loop

host, address, way = sys.argv[1:]

async def go_on(master):
    if way == "exit":
        sys.exit()
    if way == "raise":
        raise ValueError
    if way == "command":
        try:
            master.node(3).start_guarding(0.1)
        except LocalProtocolError as error:
            os.write(2, f"refused: {error}\\n".encode())
        for command in (lambda: master.nmt(NmtCommand.STOP), lambda: master.node(3).read("device_type")):
            try:
                await command()
            except LocalProtocolError as error:
                os.write(2, f"refused: {error}\\n".encode())
        os._exit(0)
    while True:
        await current_loop().sleep(0.01)

async def main():
    async with open_master(address) as master, current_loop().open_nursery():
        node = master.node(3)
        await node.nmt(NmtCommand.START)
        child = os.fork()
        if not child:
            await go_on(master)
        os.waitpid(child, 0)
        assert await node.read("device_type") == 0x20192
        await node.write("producer_heartbeat_time", 100)
        assert await node.wait_for_heartbeat(60) is NmtState.OPERATIONAL
        print("the parent goes on", flush=True)

(trio if host == "trio" else asyncio).run(*([main] if host == "trio" else [main()]))
"""


@pytest.fixture(scope="module")
def bus() -> Iterator[str]:
    with subprocess.Popen([sys.executable, "-c", BUS], stdout=subprocess.PIPE, text=True, env=environment()) as serving:
        try:
            assert serving.stdout is not None
            yield serving.stdout.readline().strip()
        finally:
            serving.kill()


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}


@pytest.mark.parametrize("host", ["trio", "asyncio"])
@pytest.mark.parametrize("way", ["exit", "raise", "sleep", "command"])
def test_a_child_neither_sends_nor_makes_its_parent_deaf(bus: str, host: str, way: str) -> None:
    script = [sys.executable, "-c", SCRIPT, host, bus, way]
    done = subprocess.run(script, capture_output=True, text=True, timeout=100, check=False, env=environment())
    assert (done.returncode, done.stdout) == (0, "the parent goes on\n"), done.stderr
    assert done.stderr.count("the process that this one was forked from") == (3 if way == "command" else 1)
