"""Bridges of simulated machines in virtual time, for the tests of the ROS layer without ROS."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import trio

from canopen_ros.bridge import Bridge, open_bridge
from canopen_ros.chain_bridge import ChainBridge
from canopen_ros.parameters import NodeParameters

START = 1_000_000_000_000_000_000
"""The wall clock when trio's clock shows 0, in ns since 1970."""


def wall() -> int:
    return START + round(trio.current_time() * 1e9)


def chain_text(joints: int) -> str:
    return "arm " + " ".join(f"joint{number} can0 {number + 2}" for number in range(1, joints + 1))


@asynccontextmanager
async def bridge_of(joints: int = 2, **parameters: object) -> AsyncIterator[tuple[Bridge, ChainBridge]]:
    """A bridge of one simulated arm of Schunk's joints, in radians."""
    given = NodeParameters.from_mapping({"chains": chain_text(joints), "simulate": True, **parameters})
    async with open_bridge(given, wall=wall) as bridge:
        yield bridge, bridge.chains["arm"]


@asynccontextmanager
async def ready_arm(joints: int = 2, **parameters: object) -> AsyncIterator[tuple[Bridge, ChainBridge]]:
    """... that is initialised and homed."""
    async with bridge_of(joints, **parameters) as (bridge, arm):
        for service in ("init", "home"):
            reply = await arm.call(service)
            assert reply.success, reply.message
        yield bridge, arm
