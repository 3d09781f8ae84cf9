"""A master that has a drive in motion, in each of the modes, for ever: for tests of what becomes of the drive.

`move_all(LOCATOR)` is a program: it moves one drive in each mode, from node 3 on, and says so when all of them move.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial

import trio

from canopen_master import Device, Master, Watchdog, open_master
from canopen_proto.dictionary import Direction
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import AxisSettings
from canopen_proto.drives.axis.controlword import put
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.nmt import NmtCommand
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.procedures.objects import read_int, write
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from tests.master.loops import loop

FAR = DriveSettings(position=0, track=Track(negative_limit=-1e9, positive_limit=1e9))
"""A drive for which the switch that homing looks for is far away, and the other one too."""
SPEED = 10_000
"""Counts per second, at least, of each motion; 30 000 at most."""
COUNTS = AxisSettings(counts_per_unit=1.0, homing_method=17)
CYCLE = 0.1  # seconds: a busy machine can keep it


async def drive_of(master: Master, node_id: int) -> Device:
    device = master.device(master.node(node_id), f"joint{node_id}", COUNTS)
    await device.node.nmt(NmtCommand.START)
    return device


async def homing(master: Master, node_id: int) -> None:
    await master.run(drive.home((await drive_of(master, node_id)).axis))


async def profile_position(master: Master, node_id: int) -> None:
    axis = (await drive_of(master, node_id)).axis
    await master.run(drive.move_to(axis, 10_000_000, timeout=1000 * SECOND))


async def profile_velocity(master: Master, node_id: int) -> None:
    device = await drive_of(master, node_id)
    await master.run(drive.set_mode(device.axis, 3))
    await master.run(drive.enable(device.axis))
    await master.run(write(device.node.remote, "0x60FF", 2 * SPEED))
    await loop.sleep_forever()


async def follow(master: Master, node_id: int, rpdo: int, start: Callable[..., object]) -> None:
    device = await drive_of(master, node_id)
    axis, remote = device.axis, device.node.remote
    await master.run(use_device_pdo(remote, Direction.RPDO, rpdo))
    if not master.sync_period:
        master.sync_start(CYCLE)
    position = await master.run(start(axis, round(CYCLE * 1000) * MILLISECOND))  # type: ignore[arg-type]
    step = 0
    while True:
        step += 1
        axis.set_points.set_position(position + 1.2 * SPEED * CYCLE * step)
        put(axis, objects.CONTROLWORD, axis.controlword, master.now())  # which triggers an event-driven RPDO
        master.pump.pump()
        await loop.sleep(CYCLE)


MOTIONS: dict[str, Callable[[Master, int], Awaitable[None]]] = {
    "homing": homing,
    "pp": profile_position,
    "pv": profile_velocity,
    "ip": partial(follow, rpdo=4, start=drive.start_interpolation),
    "csp": partial(follow, rpdo=3, start=drive.start_cyclic_position),
}
NODES = dict(zip(MOTIONS, range(3, 3 + len(MOTIONS)), strict=True))


def move_all(locator: str) -> None:
    """Never returns."""

    async def main() -> None:
        watchdog = Watchdog(timeout=3 * SECOND)  # and time for each answer: this is real time, on a machine that may be busy
        async with open_master(locator, sdo_timeout=10, watchdog=watchdog) as master, loop.open_nursery() as nursery:
            for name, node_id in NODES.items():
                await master.run(write(master.node(node_id).remote, "0x1006", 1_000_000))  # SYNC is lost after three seconds
                nursery.start_soon(MOTIONS[name], master, node_id)
            for node_id in NODES.values():
                remote = master.node(node_id).remote
                while abs(await master.run(read_int(remote, "0x606B"))) < SPEED // 2:
                    await loop.sleep(0.05)
            print("all move", flush=True)

    trio.run(main)
