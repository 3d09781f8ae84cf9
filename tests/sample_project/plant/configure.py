"""Gets an I/O module ready: it is the right one, it has a heartbeat, it sends its temperature by TPDO 1. Then it starts."""

from __future__ import annotations

from canopen_master import Node

VENDOR = 0xFFFFFF01
HEARTBEAT = 200  # ms
OFF = 1 << 31
TEMPERATURE = 0x6401_01_10


class WrongDeviceError(Exception):
    pass


async def configure(node: Node) -> None:
    vendor = await node.read_int((0x1018, 1))
    if vendor != VENDOR:
        raise WrongDeviceError(f"node {node.node_id} is of vendor 0x{vendor:X}")
    await node.write((0x1017, 0), HEARTBEAT)
    await map_temperature(node)
    await node.start()


async def map_temperature(node: Node) -> None:
    cob_id = 0x180 + node.node_id
    await node.write((0x1800, 1), cob_id | OFF)
    await node.write((0x1A00, 0), 0)
    await node.write((0x1A00, 1), TEMPERATURE)
    await node.write((0x1A00, 0), 1)
    await node.write((0x1800, 1), cob_id)
