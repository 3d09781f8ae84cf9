"""`send` and `receive` either do all their work or nothing."""

from __future__ import annotations

import itertools
from random import Random
from typing import Final

from canopen_proto.verdict import expect
from canopen_transports.conformance.bench import TransportBench, turns
from canopen_transports.conformance.case import case
from canopen_transports.conformance.frames import END, expect_numbers, number_of, numbered
from canopen_transports.loop import CancelScope, current_loop

SEEDS: Final = (1, 2, 3)
STORM: Final = 200  # frames


@case
async def cancelled_receive(bench: TransportBench) -> None:
    """A cancelled receive has taken no frame."""
    one, other = await bench.members(2)
    count = 50
    heard: list[int] = []

    async def receive_once(scope: CancelScope) -> None:
        with scope:
            heard.append(number_of((await bench.hear(other))[0]))

    for number in range(count):
        async with current_loop().open_nursery() as nursery:
            scope = current_loop().cancel_scope()
            nursery.start_soon(receive_once, scope)
            if number % 2:
                await current_loop().wait_all_tasks_blocked()
            await one.send(numbered(number))
            await turns(number // 2 % 3)
            scope.cancel()
        heard += await bench.numbers(other, number + 1 - len(heard))  # else the next receive finds this frame, and does not wait
    expect_numbers(heard, list(range(count)), "with each receive cancelled about when its frame came")


@case
async def cancelled_send(bench: TransportBench) -> None:
    """A cancelled send has sent nothing; a send that returned has sent, even if it was cancelled meanwhile."""
    one, other = await bench.members(2)
    sent: list[int] = []

    async def send_once(number: int, scope: CancelScope) -> None:
        with scope:
            await one.send(numbered(number))
            sent.append(number)

    for number in range(30):
        async with current_loop().open_nursery() as nursery:
            scope = current_loop().cancel_scope()
            if number % 3 == 0:
                scope.cancel()
            nursery.start_soon(send_once, number, scope)
            if number % 3 == 1:
                await current_loop().checkpoint()
                scope.cancel()
    await one.send(END)
    expect_numbers(await bench.numbers_until_end(other), sent, "frames that arrived, against the sends that returned")
    expect(set(range(2, 30, 3)) <= set(sent), "a send that was not cancelled did not return")
    expect(not set(range(0, 30, 3)) & set(sent), "a send that was cancelled before it began sent its frame")


@case
async def storm_on_receive(bench: TransportBench) -> None:
    """Receives that are cancelled at random moments lose no frame and take none twice."""
    count = STORM * len(SEEDS)
    member = await bench.hearer([numbered(number) for number in range(count)])
    for place, seed in enumerate(SEEDS):
        random = Random(seed)
        heard: list[int] = []
        while len(heard) < STORM:
            with current_loop().cancel_scope() as scope:
                bench.disturb(scope, random)
                heard += await bench.numbers(member, 1)
        expect_numbers(heard, list(range(place * STORM, (place + 1) * STORM)), f"with seed {seed}")


@case
async def storm_on_send(bench: TransportBench) -> None:
    """Sends of several tasks, cancelled at random moments, have sent or not; the frames of each task keep their order."""
    one, other = await bench.members(2)
    tasks = 4
    sent: list[list[int]] = [[] for _ in range(tasks)]
    numbers = itertools.count()

    async def send(task: int, random: Random) -> None:
        for _ in range(STORM // tasks):
            number = next(numbers)
            with current_loop().cancel_scope() as scope:
                bench.disturb(scope, random)
                await one.send(numbered(number))
                sent[task].append(number)

    async def send_all() -> None:
        for seed in SEEDS:
            async with current_loop().open_nursery() as nursery:
                for task in range(tasks):
                    nursery.start_soon(send, task, Random(seed * tasks + task))
        await one.send(END)

    bench.nursery.start_soon(send_all)
    heard = await bench.numbers_until_end(other)
    for task, expected in enumerate(sent):
        of_one = [number for number in heard if number in set(expected)]
        expect_numbers(of_one, expected, f"frames of task {task}, against its sends that returned")
    expect_numbers(sorted(heard), sorted(itertools.chain(*sent)), "frames of all tasks, against the sends that returned")
