"""Wrong arguments of the master's calls: each is refused at the call, in words, and nothing is registered or sent."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import pytest

from canopen_master import open_master
from canopen_master.blocking import open_master as open_blocking
from canopen_proto.heartbeat import NodeBooted
from canopen_proto.machine import Event, LocalProtocolError
from tests.master.world import BUS, simulated, virtual_time

WRONG_KINDS: list[Any] = ["PdoReceived", None, [NodeBooted], int, (NodeBooted,)]


async def coroutine(event: Event) -> None: ...


class Asynchronous:
    async def __call__(self, event: Event) -> None: ...


WRONG_CALLBACKS: list[Any] = [None, "print", coroutine, functools.partial(coroutine), Asynchronous()]


@virtual_time
async def test_whatever_is_given_as_a_kind_of_event_the_call_refuses_what_is_none_and_the_master_lives() -> None:
    async with simulated(3), open_master(BUS) as master:
        node = master.node(3)
        watchers = list(master._dispatcher._watchers)
        for wrong in WRONG_KINDS:
            for call in (master.events, node.events):
                with pytest.raises(LocalProtocolError, match="is no kind of event; give classes derived from Event"):
                    call(wrong)
                with pytest.raises(LocalProtocolError, match="is no kind of event"):
                    call(NodeBooted, wrong)
            for watch in (master.watch, node.watch):
                with pytest.raises(LocalProtocolError, match="is no kind of event"):
                    watch((wrong,), print)
        for watch in (master.watch, node.watch):
            with pytest.raises(LocalProtocolError, match="events of which kinds"):
                watch((), print)
        assert master._dispatcher._watchers == watchers
        assert not master._subscriptions
        await node.reset()


@pytest.mark.parametrize("wrong", WRONG_CALLBACKS)
@virtual_time
async def test_a_callback_that_nobody_could_call_or_await_is_refused_at_the_call(wrong: Any) -> None:
    async with simulated(3), open_master(BUS) as master:
        node = master.node(3)
        watchers = list(master._dispatcher._watchers)
        for watch in (master.watch, node.watch):
            with pytest.raises(LocalProtocolError, match="callback .* (cannot be called|is a coroutine function)"):
                watch((NodeBooted,), wrong)
        assert master._dispatcher._watchers == watchers
        await node.reset()


def test_on_of_a_blocking_master_and_node_refuses_the_same() -> None:
    with open_blocking("virtual:wrong") as master:
        ons: list[Callable[..., Any]] = [master.on, master.node(3).on]
        for on in ons:
            for kind in (*WRONG_KINDS[:4], ("x", NodeBooted), ()):
                with pytest.raises(LocalProtocolError, match="kind"):
                    on(kind, print)
            for callback in WRONG_CALLBACKS:
                with pytest.raises(LocalProtocolError, match="callback"):
                    on(NodeBooted, callback)
