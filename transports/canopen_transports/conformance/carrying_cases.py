"""Frames from one member to the others."""

from __future__ import annotations

from typing import Final

import trio

from canopen_proto.frame import Frame
from canopen_transports.conformance.bench import Bench
from canopen_transports.conformance.case import Case, case
from canopen_transports.conformance.expectations import expect, expect_numbers
from canopen_transports.conformance.frames import END, EVERY_KIND, IMPOSSIBLE, number_of, numbered
from canopen_transports.transport import Transport

PAUSE: Final = 0.05
"""Seconds between two frames, by our clock."""
MUCH_LATER: Final = 600.0
"""Seconds that nothing here takes: what is more is no time in ns."""


@case
async def every_kind_of_frame(bench: Bench) -> None:
    """Data and remote frames, 11 and 29 bits, 0 to 8 bytes arrive as they were sent."""
    member = await bench.told(EVERY_KIND)
    for frame in EVERY_KIND:
        received, stamp = await bench.hear(member)
        expect(type(received) is Frame and type(received.data) is bytes, f"{received!r} is no Frame with bytes")
        expect(received == frame, f"{frame} was sent, and {received} came")
        expect(received.key == frame.key, f"{received} has another key than {frame}")
        expect(stamp is None or (type(stamp) is int and stamp >= 0), f"the time stamp {stamp!r} is neither ns nor None")


@case
async def impossible_frames(bench: Bench) -> None:
    """What classical CAN cannot carry is refused by ValueError, and not sent."""
    one, other = await bench.members(2)
    for reason, frame in IMPOSSIBLE.items():
        try:
            await one.send(frame)
        except ValueError:
            continue
        expect(False, f"{frame!r} was taken ({reason})")
    await one.send(END)
    received, _ = await bench.hear(other)
    expect(received == END, f"{received!r} came of what was refused")


@case
async def order(bench: Bench) -> None:
    """What one task sends arrives in that order, in both directions at once."""
    count = 200
    one, other = await bench.members(2)
    async with trio.open_nursery() as nursery:  # apart by their numbers: two frames of one identifier at one time are an error
        for first, sender, hearer in ((0, one, other), (count, other, one)):
            numbers = list(range(first, first + count))
            nursery.start_soon(_expect_numbers, bench, hearer, numbers)
            bench.say(sender, [numbered(number) for number in numbers])


async def _expect_numbers(bench: Bench, member: Transport, numbers: list[int]) -> None:
    expect_numbers(await bench.numbers(member, len(numbers)), numbers, "order")


@case
async def order_of_each_task(bench: Bench) -> None:
    """Several tasks may send on one member: the frames of each arrive in its order."""
    one, other = await bench.members(2)
    tasks, count = 5, 40

    async def send(task: int) -> None:
        for number in range(task, tasks * count, tasks):
            await one.send(numbered(number))

    for task in range(tasks):
        bench.nursery.start_soon(send, task)
    heard = await bench.numbers(other, tasks * count)
    for task in range(tasks):
        of_one = [number for number in heard if number % tasks == task]
        expect_numbers(of_one, list(range(task, tasks * count, tasks)), f"the frames of task {task}")


@case
async def no_echo(bench: Bench) -> None:
    """Our own frames do not come back."""
    one, other = await bench.members(2)
    for number in range(5):
        await one.send(numbered(number))
    expect_numbers(await bench.numbers(other, 5), list(range(5)), "what was sent")
    await other.send(END)  # had they come back, they would stand before it
    received, _ = await bench.hear(one)
    expect(received == END, f"{received}, which this member sent, came back to it")


@case
async def three_members(bench: Bench) -> None:
    """Each of three members hears the two others, each once and in order."""
    members = await bench.members(3)
    for number in range(30):
        await members[number % 3].send(numbered(number))
    for place, member in enumerate(members):
        heard = await bench.numbers(member, 20)
        for sender in {0, 1, 2} - {place}:
            of_one = [number for number in heard if number % 3 == sender]
            expect_numbers(of_one, list(range(sender, 30, 3)), f"what {place} hears of {sender}")


@case
async def one_member_alone(bench: Bench) -> None:
    """One member alone can send; who comes later misses what was said before, but nothing in between."""
    one = await bench.join(0)
    for number in range(3):
        await one.send(numbered(number))
    late = await bench.join(1)
    await one.send(END)
    heard = await bench.numbers_until_end(late)
    expect(heard == [0, 1, 2][3 - len(heard) :], f"frames 0, 1, 2 were sent before and while it came, and it heard {heard}")


@case
async def who_leaves(bench: Bench) -> None:
    """A member that leaves, even one that has just sent, does not disturb the others."""
    one, other, leaver = await bench.members(3)
    await leaver.send(numbered(1))
    expect_numbers(await bench.numbers(other, 1), [1], "what was sent by who is about to leave")
    await leaver.send(numbered(2))
    await leaver.aclose()
    await one.send(END)
    heard = await bench.numbers_until_end(other)
    expect(heard in ([2], []), f"frame 2 was sent by who left at once, and {heard} came")


@case
async def who_comes_and_goes(bench: Bench) -> None:
    """Members come and go while others talk, who miss nothing."""
    one, other = await bench.members(2)
    count, comings = 100, 5
    bench.say(one, [numbered(number) for number in range(count)])
    heard: list[int] = []
    for guest_number in range(count, count + comings):
        guest = await bench.join(2)
        await guest.send(numbered(guest_number))
        while guest_number not in heard:
            heard += await bench.numbers(other, 1)
        await guest.aclose()
    heard += await bench.numbers(other, count + comings - len(heard))
    expect_numbers([number for number in heard if number < count], list(range(count)), "what the one sent that stayed")
    expect_numbers([number for number in heard if number >= count], list(range(count, count + comings)), "what the guests sent")


@case
async def time_stamps(bench: Bench) -> None:
    """Time stamps are ns on a clock that goes on as ours does; or there is none."""
    one, other = await bench.members(2)
    stamps = []
    for number in range(2):
        await one.send(numbered(number))
        frame, stamp = await bench.hear(other)
        expect(number_of(frame) == number, f"frame {number} was sent, and {number_of(frame)} came")
        stamps.append(stamp)
        await trio.sleep(PAUSE)
    first, second = stamps
    if first is None or second is None:
        expect(first is second, f"one frame has a time stamp and one has none: {stamps}")
        return
    least, most = 0.9 * PAUSE * 1e9, MUCH_LATER * 1e9
    expect(least <= second - first <= most, f"two frames {PAUSE:g} s apart have stamps {second - first} ns apart")


CASES: Final[tuple[Case, ...]] = (
    every_kind_of_frame,
    impossible_frames,
    order,
    order_of_each_task,
    no_echo,
    three_members,
    one_member_alone,
    who_leaves,
    who_comes_and_goes,
    time_stamps,
)
