"""What a read costs on a kernel's bus: system calls and rounds of the scheduler, counted. Time is not measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
import trio

from canopen_master import open_master, powerballs, simulate
from canopen_transports import open_transport
from canopen_transports.socketcan import SocketCanTransport
from tests.transports.support import trio_test
from tests.vcan.support import interface, needs_vcan

pytestmark = needs_vcan
NODE = 5
READS = 50


class Rounds(trio.abc.Instrument):
    """Counts how often trio asks its selector."""

    def __init__(self) -> None:
        self.count = 0

    def before_io_wait(self, timeout: float) -> None:
        self.count += 1


@trio_test(real_time=True)
async def test_a_read_costs_two_rounds_and_three_calls_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: Counter[str] = Counter()

    def count(owner: Any, name: str) -> None:
        function: Callable[..., Any] = getattr(owner, name)

        def counted(*arguments: Any) -> Any:
            calls[name] += 1
            return function(*arguments)

        monkeypatch.setattr(owner, name, counted)

    with interface() as name:
        async with trio.open_nursery() as nursery:
            # The device answers by a transport of its own, which is not counted
            await nursery.start(simulate, await open_transport(f"socketcan:{name}"), powerballs(NODE))
            transport = await open_transport(f"socketcan:{name}")
            assert isinstance(transport, SocketCanTransport)
            async with open_master(transport) as master:
                node = master.node(NODE)
                await node.read(0x1000)
                count(transport, "_try_to_send")
                count(transport, "_read")
                count(transport, "_wait")
                rounds = Rounds()
                trio.lowlevel.add_instrument(rounds)
                for _ in range(READS):
                    await node.read(0x1000)
                trio.lowlevel.remove_instrument(rounds)
                monkeypatch.undo()
            nursery.cancel_scope.cancel()
    assert calls["_try_to_send"] == READS  # at once, without a task that sends
    assert calls["_read"] <= READS + 1  # each takes all that waits; none asks in vain
    assert calls["_wait"] <= READS + 1
    assert rounds.count <= 4 * READS + 4  # two of ours; the device in this process takes part in them, and has two at most
