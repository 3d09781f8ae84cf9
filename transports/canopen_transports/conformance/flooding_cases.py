"""Many frames at once: none is lost silently, and other tasks can run."""

from __future__ import annotations

import itertools
from typing import Final

from canopen_proto.verdict import expect
from canopen_transports.conformance.bench import TransportBench, turns
from canopen_transports.conformance.case import case
from canopen_transports.conformance.frames import END, expect_numbers, number_of, numbered
from canopen_transports.loop import CancelScope, current_loop

WAITING: Final = 200
"""Frames that any receive buffer holds."""
SETTLING: Final = 0.05
"""Seconds. Linux begins to stamp frames some time after it was asked to; earlier frames have the time at which they were read."""


@case
async def burst_that_nobody_takes(bench: TransportBench) -> None:
    """A burst that is taken only when it is over loses nothing silently; afterwards frames arrive as before."""
    one, other = await bench.members(2)
    for number in range(bench.site.burst):
        await one.send(numbered(number))
    await bench.expect_no_silent_loss(other, bench.site.burst)
    await one.send(END)
    received, _ = await bench.hear(other)
    expect(received == END, f"{received} came instead of {END}, after all frames were accounted for")


@case
async def stream(bench: TransportBench) -> None:
    """A stream that is taken as it comes arrives in order and loses nothing silently."""
    member = await bench.hearer([numbered(number) for number in range(bench.site.stream)])
    await bench.expect_no_silent_loss(member, bench.site.stream)


@case
async def time_stamps_in_a_stream(bench: TransportBench) -> None:
    """Time stamps do not run back, and either all frames have one or none has."""
    one, other = await bench.members(2)
    await current_loop().sleep(SETTLING)
    bench.say(one, [numbered(number) for number in range(WAITING)])
    stamps = [(await bench.hear(other))[1] for _ in range(WAITING)]
    known = [stamp for stamp in stamps if stamp is not None]
    expect(not known or len(known) == len(stamps), f"of {len(stamps)} frames {len(known)} have a time stamp")
    for place, (earlier, later) in enumerate(itertools.pairwise(known)):
        expect(earlier <= later, f"time stamps run back: frame {place + 1} is {earlier - later} ns before the frame before it")


@case
async def others_run(bench: TransportBench) -> None:
    """Taking frames that are already there lets other tasks run, and can be cancelled."""
    one, other = await bench.members(2)
    for number in range(WAITING):
        await one.send(numbered(number))
    heard: list[int] = []

    async def hear(scope: CancelScope) -> None:
        with scope:
            while True:
                heard.append(number_of((await bench.hear(other))[0]))

    async with current_loop().open_nursery() as nursery:
        scope = current_loop().cancel_scope()
        nursery.start_soon(hear, scope)
        await turns(3)
        scope.cancel()
    expect(len(heard) < WAITING, f"{WAITING} frames were taken without letting another task run")
    expect_numbers(heard + await bench.numbers(other, WAITING - len(heard)), list(range(WAITING)), "before and after the cancel")


@case
async def two_receivers(bench: TransportBench) -> None:
    """When two tasks receive at once, each frame goes to one of them, or one task is refused with BusyResourceError."""
    count = 100
    member = await bench.hearer([numbered(number) for number in range(count)])
    heard: list[int] = []
    refused = 0

    async def hear() -> None:
        nonlocal refused
        own: list[int] = []
        while len(heard) < count:
            try:
                own += await bench.numbers(member, 1)
            except current_loop().BusyResourceError:
                refused += 1
                expect(refused == 1, "both receivers were refused")
                return
            heard.append(own[-1])
        nursery.cancel_scope.cancel()
        expect(own == sorted(own), "one of the receivers had its frames out of order")

    async with current_loop().open_nursery() as nursery:
        nursery.start_soon(hear)
        nursery.start_soon(hear)
    expect_numbers(sorted(heard), list(range(count)), "the frames that the two receivers took")
