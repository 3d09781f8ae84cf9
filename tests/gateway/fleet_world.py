"""A fleet on loopback: bridges over simulated drives, and viewers, each with a Zenoh session of its own. Time is real here."""

from __future__ import annotations

import functools
import inspect
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any, NamedTuple

import trio

from canopen_gateway import GatewayService
from canopen_gateway.fleet import Fleet, FleetDoor, bind_fleet_door, open_fleet
from canopen_master import Host
from tests.gateway.gateway_world import gateway

SITE, BUS = "hall", "virtual-test"
NODE = f"{SITE}/{BUS}/3"


class Bridge(NamedTuple):
    """A bridge that serves. endpoint: where it listens."""

    host: Host
    service: GatewayService
    door: FleetDoor
    endpoint: str


def real_time(test: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    """Run an async test in real time. Each wait in it is one for something, and nothing in it depends on how long that takes."""

    @functools.wraps(test)
    def run(*args: Any, **kwargs: Any) -> None:
        async def limited() -> None:
            with trio.fail_after(25):
                await test(*args, **kwargs)

        trio.run(limited)

    del run.__wrapped__  # type: ignore[attr-defined]  # else pytest would see a coroutine function
    run.__signature__ = inspect.signature(test)  # type: ignore[attr-defined]
    return run


def free_endpoint() -> str:
    """An endpoint on this computer that nobody has."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{found.getsockname()[1]}"


@asynccontextmanager
async def bridge(*node_ids: int, allow: str = "", site: str = SITE, **options: Any) -> AsyncIterator[Bridge]:
    """A bridge over simulated drives."""
    endpoint = free_endpoint()
    door = await bind_fleet_door(site, listen=[endpoint])
    async with door, gateway(*node_ids, allow=allow, **options) as (host, service), trio.open_nursery() as nursery:
        nursery.start_soon(door.serve, service)
        yield Bridge(host, service, door, endpoint)
        nursery.cancel_scope.cancel()


@asynccontextmanager
async def fleet(
    *node_ids: int, allow: str = "", without_drives: bool = False, **options: Any
) -> AsyncIterator[tuple[Fleet, Bridge]]:
    """The same with one viewer, who sees all of the nodes. without_drives: what has these node-IDs is made by `makers`."""
    simulated = () if without_drives else node_ids
    async with bridge(*simulated, allow=allow, **options) as served, open_fleet(connect=[served.endpoint]) as viewer:
        await seen(lambda: [each.node_id for each in viewer.nodes] == sorted(node_ids))
        yield viewer, served


async def seen(condition: Callable[[], bool]) -> None:
    """Wait until something is so."""
    while not condition():
        await trio.sleep(0.01)
