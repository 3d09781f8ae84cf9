"""Moves the gate of the cold store by its drive, in profile position mode."""

from __future__ import annotations

from collections.abc import Sequence

import trio

from canopen_master import Node

READY, SWITCHED_ON, ENABLED = 0x21, 0x23, 0x27
STATE = 0x6F
FAULT = 0x08
ACKNOWLEDGED = 1 << 12
REACHED = 1 << 10


class DriveFaultError(Exception):
    pass


async def wait_for(node: Node, mask: int, value: int, timeout: float) -> None:
    with trio.fail_after(timeout):
        while (status := await node.read_int("statusword")) & mask != value:
            if status & FAULT:
                raise DriveFaultError(f"the drive has a fault: statusword 0x{status:04X}")
            await trio.sleep(0.01)


async def enable(node: Node) -> None:
    await node.write("modes_of_operation", 1)
    for word, state in ((0x06, READY), (0x07, SWITCHED_ON), (0x0F, ENABLED)):
        await node.write("controlword", word)
        await wait_for(node, STATE, state, 2)


async def move(node: Node, target: int) -> None:
    await node.write("target_position", target)
    await node.write("controlword", 0x1F)
    await wait_for(node, ACKNOWLEDGED, ACKNOWLEDGED, 2)
    await node.write("controlword", 0x0F)
    await wait_for(node, ACKNOWLEDGED, 0, 2)
    await wait_for(node, REACHED, REACHED, 10)


async def run(node: Node, targets: Sequence[int]) -> None:
    """Move to each target in turn, then take the power away."""
    try:
        await enable(node)
        for target in targets:
            await move(node, target)
    finally:
        with trio.CancelScope(shield=True):
            await node.write("controlword", 0x00)
