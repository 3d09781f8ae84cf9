"""Features of some transports: see `EagerTransport`, `BatchTransport`, `PromptTransport`, `PushingTransport`,
`FilteringTransport` and `CyclicTransport`."""

from __future__ import annotations

from contextlib import suppress
from random import Random
from typing import Final

from canopen_proto.frame import Frame, RoutingKey
from canopen_proto.machine import MILLISECOND
from canopen_proto.verdict import ViolationError, does_not_apply, expect
from canopen_transports.conformance.bench import HEAR_TIME, TransportBench
from canopen_transports.conformance.case import case
from canopen_transports.conformance.frames import END, IMPOSSIBLE, expect_numbers, number_of, numbered
from canopen_transports.loop import current_loop
from canopen_transports.transport import (
    BatchTransport,
    CyclicTransport,
    EagerTransport,
    FilteringTransport,
    PromptTransport,
    PushingTransport,
    Transport,
)

EAGER: Final = 500
"""Frames: more than any transmit queue holds."""
PERIOD: Final = 5 * MILLISECOND
KINDS: Final = tuple(Frame.parse(text) for text in ("123#01", "00000123#02", "123#R1", "124#03", "1FFFFFFF#04"))
"""Frames that a filter has to tell apart."""


@case
async def eager_send(bench: TransportBench) -> None:
    """send_nowait sends at once or says that it did not; it keeps the order, also together with send."""
    one, other = await bench.members(2)
    if not isinstance(one, EagerTransport):
        does_not_apply("it has no send_nowait")

    async def send() -> None:
        for number in range(EAGER):
            if number % 10 == 9 or not one.send_nowait(numbered(number)):
                await one.send(numbered(number))

    bench.nursery.start_soon(send)
    expect_numbers(await bench.numbers(other, EAGER), list(range(EAGER)), "the frames sent by send_nowait and send in turn")
    for reason, frame in IMPOSSIBLE.items():
        with suppress(ValueError):
            expect(not one.send_nowait(frame), f"send_nowait accepted {frame!r} ({reason})")
    await one.aclose()
    with suppress(current_loop().ClosedResourceError):
        expect(not one.send_nowait(END), "send_nowait on a closed transport says that it sent the frame")


@case
async def many_at_once(bench: TransportBench) -> None:
    """receive_many returns what waits, in order, never more than asked for; cancelled, it takes nothing."""
    one, other = await bench.members(2)
    if not isinstance(other, BatchTransport):
        does_not_apply("it has no receive_many")
    bench.say(one, [numbered(number) for number in range(EAGER)])
    heard: list[int] = []
    calls = 0
    with current_loop().move_on_after(HEAR_TIME):
        while len(heard) < EAGER:
            calls += 1
            limit = 1 + calls % 7
            with current_loop().cancel_scope() as scope:
                if calls % 3 and len(heard) < EAGER // 2:
                    bench.disturb(scope, Random(calls))
                items = await other.receive_many(limit)
                expect(0 < len(items) <= limit, f"receive_many({limit}) returned {len(items)} items")
                heard += [number_of(item[0]) for item in items if isinstance(item, tuple)]
    expect_numbers(heard, list(range(EAGER)), "the frames that receive_many returned")
    await other.aclose()
    with suppress(current_loop().ClosedResourceError):
        await other.receive_many(1)
        raise ViolationError("receive_many on a closed transport returned, instead of raising ClosedResourceError")


@case
async def what_has_come(bench: TransportBench) -> None:
    """receive_nowait returns what has come, in order, never more than asked for, also in turn with receive."""
    one, other = await bench.members(2)
    if not isinstance(other, PromptTransport):
        does_not_apply("it has no receive_nowait")
    expect(not other.receive_nowait(1), "receive_nowait returned something before anything was sent")
    heard: list[int] = []
    for number in range(100):
        await one.send(numbered(number))
        while number % 10 == 9 and len(heard) <= number:
            items = other.receive_nowait(3) or ()
            expect(len(items) <= 3, f"receive_nowait(3) returned {len(items)} items")
            heard += [number_of(item[0]) for item in items if isinstance(item, tuple)]
            if not items:
                heard += await bench.numbers(other, 1)
    expect_numbers(heard, list(range(100)), "the frames that receive_nowait and receive returned")
    await other.aclose()
    with suppress(current_loop().ClosedResourceError):
        other.receive_nowait(1)
        raise ViolationError("receive_nowait on a closed transport returned, instead of raising ClosedResourceError")


@case
async def pushed_frames(bench: TransportBench) -> None:
    """push_to hands over each frame once and in order, after the waiting frames, which come by receive, until it is ended."""
    one, other = await bench.members(2)
    if not isinstance(other, PushingTransport):
        does_not_apply("it has no push_to")
    pushed: list[int] = []

    async def send(numbers: range) -> None:
        for number in numbers:
            await one.send(numbered(number))

    await send(range(10))
    other.push_to(lambda frame, now: pushed.append(number_of(frame)))
    await send(range(10, 20))
    expect_numbers(pushed, [], "frames that were pushed past others")
    expect_numbers(await bench.numbers(other, 20), list(range(20)), "the frames that waited")
    await send(range(20, EAGER))
    left = EAGER - 20 - len(pushed)
    heard = pushed + (await bench.numbers(other, left) if left else [])
    expect_numbers(heard, list(range(20, EAGER)), "the frames that were pushed, and those that came by receive after them")
    other.push_to(None)
    await send(range(10))
    expect_numbers(await bench.numbers(other, 10), list(range(10)), "the frames that came after pushing had ended")


@case
async def filters(bench: TransportBench) -> None:
    """A filter lets through the frames that it names, by 11 or 29 bits and data or remote, until it is changed or removed."""
    one, other = await bench.members(2)
    if not (isinstance(other, FilteringTransport) and other.filtered):
        does_not_apply("it does not filter")
    for wanted in ({0}, {1, 4}, {2, 3}, set(), {0, 1, 2, 3, 4}):
        filtered = other.set_filters([END.key, *(KINDS[place].key for place in wanted)])
        expected = [frame for place, frame in enumerate(KINDS) if place in wanted or not filtered]
        await _expect_heard(bench, one, other, expected, f"filtered for {[str(KINDS[place]) for place in wanted]}")
    filtered = other.set_filters([END.key, *map(RoutingKey, range(0x700))])  # more than Linux can filter
    await _expect_heard(bench, one, other, [frame for frame in KINDS if not filtered or frame.key < 0x700], "with many filters")
    expect(not other.set_filters(None), "set_filters(None) says that it leaves frames out")
    await _expect_heard(bench, one, other, list(KINDS), "without filters")


async def _expect_heard(bench: TransportBench, one: Transport, other: Transport, expected: list[Frame], when: str) -> None:
    for frame in (*KINDS, END):
        await one.send(frame)
    heard = []
    while (frame := (await bench.hear(other))[0]) != END:
        heard.append(frame)
    expect(heard == expected, f"{when}: {', '.join(map(str, heard))} came instead of {', '.join(map(str, expected))}")


@case
async def cyclic_frames(bench: TransportBench) -> None:
    """Cyclic frames are sent in turn, to us as to the others, until they are stopped; they may be started again."""
    one, other = await bench.members(2)
    if not (isinstance(one, CyclicTransport) and one.sends_sync):
        does_not_apply("it sends no cyclic frames")
    for round_ in range(2):
        frames = [numbered(10 * round_ + each) for each in range(3)]
        expected = [10 * round_ + each for each in (0, 1, 2, 0, 1, 2, 0)]
        one.start_cyclic(frames, PERIOD)
        for member, who in ((other, "others"), (one, "the sender")):
            expect_numbers(await bench.numbers(member, len(expected)), expected, f"cyclic frames as {who} hear them")
        one.stop_cyclic()
        await one.send(END)
        await bench.numbers_until_end(other)
        await current_loop().sleep(3 * PERIOD / 1e9)
        await one.send(END)
        expect_numbers(await bench.numbers_until_end(other), [], "cyclic frames after they were stopped")
        await other.send(END)
        await bench.numbers_until_end(one)
