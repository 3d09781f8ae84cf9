"""Leaving the bus, whatever the transport is doing."""

from __future__ import annotations

import functools
from collections.abc import Awaitable, Callable
from typing import Final

from canopen_proto.verdict import ViolationError
from canopen_transports.conformance.bench import TransportBench, turns
from canopen_transports.conformance.case import case
from canopen_transports.conformance.frames import END, expect_numbers, numbered
from canopen_transports.loop import OneTimeEvent, current_loop
from canopen_transports.transport import Transport

TRAFFIC: Final = 50
"""Frames; once so many have come, traffic flows."""
MANY: Final = 20_000
"""Frames; many more than can be sent while a transport closes."""


async def _expect_closed(call: Callable[[], Awaitable[object]], what: str) -> None:
    """Raise ViolationError unless the call raises ClosedResourceError."""
    try:
        await call()
    except current_loop().ClosedResourceError:
        return
    raise ViolationError(f"{what} returned, instead of raising ClosedResourceError")


async def _hear_on(member: Transport, on_frame: Callable[[], None]) -> None:
    while True:
        if isinstance(await member.receive(), tuple):
            on_frame()


async def _send_on(member: Transport, closes: OneTimeEvent, task: int = 0) -> None:
    """Send frames, and at most MANY from the time on when the member closes.

    All have one identifier for each task: on a real bus, two nodes must not send one identifier at the same time.
    """
    left = MANY
    while left:
        await member.send(numbered(task))
        left -= closes.is_set()


async def _close(member: Transport, closes: OneTimeEvent) -> None:
    closes.set()
    await member.aclose()


@case
async def closing_wakes_the_receiver(bench: TransportBench) -> None:
    """Closing a transport wakes its waiting receive with ClosedResourceError."""
    one = await bench.hearer(())
    async with current_loop().open_nursery() as nursery:
        nursery.start_soon(_expect_closed, functools.partial(_hear_on, one, lambda: None), "receive, while it was closed,")
        await current_loop().wait_all_tasks_blocked()
        await one.aclose()


@case
async def closing_wakes_the_senders(bench: TransportBench) -> None:
    """Closing a transport ends its sends with ClosedResourceError: those under way, and those that wait for room."""
    one, closes = await bench.join(0), current_loop().event()
    async with current_loop().open_nursery() as nursery:
        for _ in range(3):
            nursery.start_soon(_expect_closed, functools.partial(_send_on, one, closes), "send, while it was closed,")
        await turns(200)
        await _close(one, closes)


@case
async def closing_amid_traffic(bench: TransportBench) -> None:
    """Closing amid traffic wakes reader and sender, and the others continue."""
    one, other, third = await bench.members(3)
    flows, closes = current_loop().event(), [current_loop().event() for _ in range(3)]
    count = 0

    def on_frame() -> None:
        nonlocal count
        count += 1
        if count >= TRAFFIC:
            flows.set()

    async with current_loop().open_nursery() as nursery:
        nursery.start_soon(_expect_closed, functools.partial(_hear_on, third, lambda: None), "receive, while it was closed,")
        for task, member in ((1, one), (2, other)):
            nursery.start_soon(_expect_closed, functools.partial(_hear_on, member, on_frame), "receive, while it was closed,")
            sending = functools.partial(_send_on, member, closes[task], task)
            nursery.start_soon(_expect_closed, sending, "send, while it was closed,")
        await flows.wait()
        await _close(one, closes[1])
        count, flows = 0, current_loop().event()
        nursery.start_soon(_expect_closed, functools.partial(_send_on, third, closes[0]), "send, while it was closed,")
        await flows.wait()  # `other` hears only `third` now
        await _close(other, closes[2])
        await _close(third, closes[0])


@case
async def what_is_closed_stays_closed(bench: TransportBench) -> None:
    """After closing, even twice, each send and receive raises ClosedResourceError, even if frames were waiting."""
    one, other = await bench.members(2)
    await other.send(END)
    await one.aclose()
    await one.aclose()
    for _ in range(2):
        await _expect_closed(functools.partial(one.send, END), "send on a closed transport")
        await _expect_closed(one.receive, "receive on a closed transport")


@case
async def closing_by_two_tasks(bench: TransportBench) -> None:
    """Two tasks may close a transport at the same time."""
    one = await bench.hearer(())
    async with current_loop().open_nursery() as nursery:
        nursery.start_soon(one.aclose)
        nursery.start_soon(one.aclose)
    await _expect_closed(one.receive, "receive on a transport that two tasks closed")


@case
async def cancelled_close(bench: TransportBench) -> None:
    """A cancelled close still closes the transport."""
    one = await bench.hearer(())
    with current_loop().cancel_scope() as scope:
        scope.cancel()
        await one.aclose()
    await _expect_closed(one.receive, "receive after a cancelled close")


@case
async def opened_again(bench: TransportBench) -> None:
    """A member can leave a bus and join it again; it does not hear frames that it left untaken."""
    one, other, third = await bench.members(3)
    for number in range(3):
        await one.send(numbered(number))
    await bench.numbers(third, 3)  # so all three are over
    await other.aclose()
    other = await bench.join(1)
    await one.send(numbered(7))
    await one.send(END)
    expect_numbers(await bench.numbers_until_end(other), [7], "the frames after a member came back")
