"""A master that is killed, as a process of its own, on a bus of real sockets. In real time: it waits for what has to come."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import trio

from canopen_master import Host, simulate, standard_drives
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.simulation.drive.node import DriveNode
from canopen_transports import open_transport
from canopen_transports.tcp import BusServer, serve_bus
from tests.master.motions import FAR, NODES
from tests.master.world import drives, value

LIMIT = 100
"""Seconds, for a machine that is busy with other things."""


def velocity_of(host: Host, node: DriveNode) -> int:
    node.drive.refresh(host.now())
    return value(node, objects.VELOCITY_DEMAND_VALUE)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no kill -9")
def test_drives_of_a_master_that_is_killed_stand() -> None:
    async def main() -> None:
        async with trio.open_nursery() as nursery:
            with trio.fail_after(LIMIT):
                (locator,) = await nursery.start(serve_bus, "127.0.0.1", 0, BusServer())
                devices = standard_drives(*NODES.values(), settings=FAR)
                host: Host = await nursery.start(simulate, await open_transport(locator), devices)
                program = f"from tests.master.motions import move_all; move_all({locator!r})"
                environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
                master = await trio.lowlevel.open_process(
                    [sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment
                )
                assert master.stdout is not None
                try:
                    assert (await master.stdout.receive_some()).strip() == b"all move"
                    while not all(velocity_of(host, node) for node in drives(host)):  # behind a late SYNC one may stand
                        await trio.sleep(0.01)
                finally:
                    master.kill()
                    await master.wait()
                    await master.stdout.aclose()
                while any(velocity_of(host, node) for node in drives(host)):
                    await trio.sleep(0.01)
            assert {node.drive.state for node in drives(host)} == {State.SWITCH_ON_DISABLED}
            nursery.cancel_scope.cancel()

    trio.run(main)
