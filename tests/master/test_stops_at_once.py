"""Halts and shut downs that come at the same time, or between the steps of another command: they count, and nothing breaks."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import pytest

from canopen_master import Chain, ChainError, ChainHaltedError, ChainState
from tests.loops import loop
from tests.master.path_world import arms, swing
from tests.master.world import virtual_time


@pytest.mark.thorough(3)
@pytest.mark.parametrize("name", ["home", "initialise", "recover"])
@virtual_time
async def test_a_halt_while_a_command_waits_for_the_stop_before_it_ends_that_command(name: str) -> None:
    commands: dict[str, Callable[[Chain], Awaitable[None]]] = {
        "home": Chain.home, "initialise": Chain.initialise, "recover": Chain.recover,
    }  # fmt: skip
    async with arms(2) as (_, [arm], record):
        ended: list[str] = []
        async with loop.open_nursery() as nursery:

            async def follow() -> None:
                with pytest.raises(ChainHaltedError):
                    await arm.follow(swing(0.5, -0.3))

            async def command() -> None:
                with pytest.raises(ChainHaltedError, match="before it could"):
                    await commands[name](arm)
                ended.append(name)

            nursery.start_soon(follow)
            await loop.sleep(1.5)
            nursery.start_soon(command)
            await loop.sleep(0.05)  # it brakes along the path
            await arm.halt()
        assert ended == [name]
        assert arm.state is ChainState.HALTED
        before = record.rows[-1]
        await loop.sleep(1)
        assert record.rows[-1] == before


@virtual_time
async def test_nothing_begins_beside_a_shut_down() -> None:
    async with arms(2) as (_, [arm], _record):
        async with loop.open_nursery() as nursery:

            async def follow() -> None:
                with pytest.raises(ChainHaltedError):
                    await arm.follow(swing(0.5, -0.3))

            nursery.start_soon(follow)
            await loop.sleep(1.5)
            nursery.start_soon(arm.shut_down)
            await loop.sleep(0.05)  # it brakes along the path
            with pytest.raises(ChainError, match="it is busy: shut down"):
                await arm.initialise()
        assert arm.state is ChainState.OFF


@virtual_time
async def test_two_shut_downs_at_once() -> None:
    async with arms(2) as (_, [arm], _record):
        async with loop.open_nursery() as nursery:
            results: list[Exception | None] = []

            async def shut_down() -> None:
                try:
                    await arm.shut_down()
                except ChainHaltedError as halted:  # it was taken over by the other one
                    results.append(halted)
                else:
                    results.append(None)

            nursery.start_soon(shut_down)
            nursery.start_soon(shut_down)
        assert None in results
        assert arm.state is ChainState.OFF
