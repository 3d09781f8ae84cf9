"""A bridge whose site and bus another one serves already: it waits, and refuses; halts are served all the while."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
import trio

from canopen_gateway import DoorError, FleetError
from canopen_gateway.fleet import Fleet, FleetDoor, FleetPlace, bind_fleet_door, open_fleet
from canopen_gateway.fleet import bridge as bridge_module
from canopen_gateway.fleet.joining import close_zenoh, open_zenoh
from canopen_gateway.fleet.keys import ALIVE, HALT, key_of
from tests.gateway.fleet_world import BUS, NODE, SITE, bridge, free_endpoint, real_time, seen
from tests.gateway.gateway_world import gateway

pytest.importorskip("zenoh", reason="the extra fleet is not installed")

PLACE = FleetPlace(SITE, BUS)
KEY = key_of(PLACE, ALIVE)


@asynccontextmanager
async def token_of_another() -> AsyncIterator[tuple[str, Any]]:
    """A router, and the token of a bridge that does not answer: it is hung, or has crashed. Yields its endpoint, and it."""
    endpoint = free_endpoint()
    session = await open_zenoh(listen=[endpoint], mode="router")
    try:
        token = session.liveliness().declare_token(KEY)  # kept here: it ends when nobody has it
        yield endpoint, token
    finally:
        await close_zenoh(session)


@asynccontextmanager
async def waiting(endpoint: str) -> AsyncIterator[tuple[FleetDoor, Any, Fleet, trio.Nursery]]:
    """A bridge that waits for another one's token to end, with its service and a viewer."""
    door = await bind_fleet_door(SITE, connect=[endpoint])
    async with (
        door,
        gateway(3) as (_, service),
        open_fleet(connect=[endpoint], patience=2) as viewer,
        trio.open_nursery() as nursery,
    ):
        nursery.start_soon(door.serve, service)
        while not await viewer.ask(PLACE, HALT):
            await trio.sleep(0.02)
        yield door, service, viewer, nursery
        nursery.cancel_scope.cancel()


@real_time
async def test_a_bridge_of_a_name_that_is_served_refuses_in_words_that_name_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge_module, "TWIN_WAIT", 0.3)
    async with bridge(3) as served:
        async with await bind_fleet_door(SITE, connect=[served.endpoint]) as second:
            with pytest.raises(DoorError) as told:
                await second.serve(served.service)
        text = str(told.value)
        assert KEY in text
        assert "--site" in text
        assert "--twin" in text
        async with open_fleet(connect=[served.endpoint]) as viewer:  # the first one is as it was
            await seen(lambda: len(viewer.nodes) == 1)
            assert (await viewer.read(NODE, 0x1001)).value == 0


@real_time
async def test_a_bridge_that_is_said_to_be_a_twin_serves() -> None:
    async with token_of_another() as (endpoint, _):
        door = await bind_fleet_door(SITE, connect=[endpoint], twin=True)
        async with door, gateway(3) as (_, service), trio.open_nursery() as nursery:
            nursery.start_soon(door.serve, service)
            async with open_fleet(connect=[endpoint]) as viewer:
                await seen(lambda: len(viewer.nodes) == 1)
                assert (await viewer.read(NODE, 0x1001)).value == 0
            nursery.cancel_scope.cancel()


@real_time
async def test_a_bridge_waits_until_the_token_of_a_crashed_one_is_over_and_serves_halts_meanwhile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(bridge_module, "TWIN_WAIT", 60)
    async with token_of_another() as (endpoint, token), waiting(endpoint) as (_, _, viewer, _):
        assert await viewer.halt(PLACE) == {PLACE: []}
        with pytest.raises(FleetError):  # nothing else
            await viewer.read(NODE, 0x1001)
        token.undeclare()
        await seen(lambda: len(viewer.nodes) == 1)
        assert (await viewer.read(NODE, 0x1001)).value == 0


@real_time
async def test_a_bridge_that_refuses_first_ends_the_halt_that_is_under_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge_module, "TWIN_WAIT", 0.5)
    begun, may_end, refused, ended = (trio.Event() for _ in range(4))
    async with (
        token_of_another() as (endpoint, _),
        gateway(3) as (_, service),
        await bind_fleet_door(SITE, connect=[endpoint]) as door,
        open_fleet(connect=[endpoint]) as viewer,
        trio.open_nursery() as nursery,
    ):

        async def halt(*_: Any) -> list[str]:
            begun.set()
            await may_end.wait()
            ended.set()
            return []

        service.halt = halt  # type: ignore[method-assign]

        async def serve() -> None:
            with pytest.raises(DoorError):
                await door.serve(service)
            assert ended.is_set()
            refused.set()

        async def ask() -> None:
            while not begun.is_set():
                await viewer.ask(PLACE, HALT)
                await trio.sleep(0.02)

        nursery.start_soon(serve)
        nursery.start_soon(ask)
        await begun.wait()
        await seen(lambda: door._taking is bridge_module.Taking.NOTHING)
        assert not refused.is_set()
        may_end.set()
        await refused.wait()
        nursery.cancel_scope.cancel()


@real_time
async def test_a_query_that_comes_when_a_bridge_has_ended_ends_nothing_else() -> None:
    class LateQuery:
        key_expr = key_of(PLACE, HALT)
        attachment = None
        dropped = False

        def drop(self) -> None:
            self.dropped = True

    query = LateQuery()
    async with bridge(3) as served:
        await seen(lambda: len(served.door.alive) == 1)
    async with trio.open_nursery() as nursery:
        pass
    served.door._take(query, nursery)  # type: ignore[arg-type]  # as Zenoh's thread has asked for
    assert query.dropped
