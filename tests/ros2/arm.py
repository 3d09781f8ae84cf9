"""Six simulated drives on a bus of real sockets, in a process of their own: they go on if a node ends or is killed.

Run as a program, this file is that process: it prints the locator of the bus, then for each line that it reads a line about the
drives, as JSON: velocity demand (0x606B) and state of each one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import TracebackType

import trio

from canopen_master import Host, powerballs, simulate
from canopen_proto.drives.cia402 import objects
from canopen_transports import open_transport
from canopen_transports.tcp import BusServer, serve_bus
from tests.master.world import drives, value

NODE_IDS = (3, 4, 5, 6, 7, 8)


MACHINE = """
[master]
cycle = "50ms" # and long times: this computer may be busy with other things
timeout = "3s"
watchdog = {{ timeout = "5s" }}

[buses.can0]
locator = "{locator}"

[chains.arm]
joints = ["joint1", "joint2", "joint3", "joint4", "joint5", "joint6"]
"""
NODE = """
[nodes.joint{number}]
bus = "can0"
id = {node_id}

[joints.joint{number}]
"""


class Arm:
    """`locator`: of the bus. `moving`, `states`: the truth about the drives, not what anybody reports.

    `machine`: arguments of the node, which name the machine file of this arm.
    """

    def __init__(self, folder: Path) -> None:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.ros2.arm"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
        )
        self.locator = self._line()
        nodes = "".join(NODE.format(number=number, node_id=node_id) for number, node_id in enumerate(NODE_IDS, 1))
        file = folder / "cell.toml"
        file.write_text(MACHINE.format(locator=self.locator) + nodes, encoding="utf-8")
        self.machine = ["--ros-args", "-p", f"machine:={file}"]

    def __enter__(self) -> Arm:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    def close(self) -> None:
        """Take bus and drives away."""
        self._process.kill()
        self._process.communicate()

    def look(self) -> list[tuple[int, str]]:
        """Velocity demand and state of each drive."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return [(velocity, state) for velocity, state in json.loads(self._line())]

    @property
    def moving(self) -> int:
        """How many drives move."""
        return sum(bool(velocity) for velocity, _ in self.look())

    @property
    def states(self) -> set[str]:
        """The states of the drives."""
        return {state for _, state in self.look()}


def look(host: Host) -> list[tuple[int, str]]:
    found = []
    for node in drives(host):
        node.drive.refresh(host.now())
        found.append((value(node, objects.VELOCITY_DEMAND_VALUE), node.drive.state.name))
    return found


async def be_an_arm() -> None:
    async with trio.open_nursery() as nursery:
        (locator,) = await nursery.start(serve_bus, "127.0.0.1", 0, BusServer())
        host = await nursery.start(simulate, await open_transport(locator), powerballs(*NODE_IDS))
        print(locator, flush=True)
        async with trio.lowlevel.FdStream(os.dup(0)) as questions:
            async for _ in questions:
                print(json.dumps(look(host)), flush=True)


if __name__ == "__main__":
    trio.run(be_an_arm)
