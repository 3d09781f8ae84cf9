"""Frames travel from one member to the others."""

from __future__ import annotations

from typing import Final

from canopen_proto.frame import Frame
from canopen_proto.verdict import expect
from canopen_transports.conformance.bench import TransportBench
from canopen_transports.conformance.case import case
from canopen_transports.conformance.frames import END, EVERY_KIND, IMPOSSIBLE, expect_numbers, number_of, numbered
from canopen_transports.loop import current_loop
from canopen_transports.transport import Transport

PAUSE: Final = 0.05
"""Seconds between two frames, on our clock."""
MUCH_LATER: Final = 600.0
"""Seconds; no case takes so long. A larger difference shows that a time stamp is not in ns."""


@case
async def every_kind_of_frame(bench: TransportBench) -> None:
    """Data and remote frames, with 11 and 29 bits and 0 to 8 bytes, arrive as they were sent."""
    member = await bench.hearer(EVERY_KIND)
    for frame in EVERY_KIND:
        received, stamp = await bench.hear(member)
        expect(type(received) is Frame and type(received.data) is bytes, f"{received!r} is no Frame with bytes")
        expect(received == frame, f"{frame} was sent, and {received} came")
        expect(received.key == frame.key, f"{received} has another key than {frame}")
        expect(stamp is None or (type(stamp) is int and stamp >= 0), f"the time stamp {stamp!r} is neither ns nor None")


@case
async def impossible_frames(bench: TransportBench) -> None:
    """A frame that classical CAN cannot carry is refused with ValueError, and not sent."""
    one, other = await bench.members(2)
    for reason, frame in IMPOSSIBLE.items():
        try:
            await one.send(frame)
        except ValueError:
            continue
        expect(False, f"{frame!r} was accepted ({reason})")
    await one.send(END)
    received, _ = await bench.hear(other)
    expect(received == END, f"{received!r} came, though it was refused")


@case
async def order(bench: TransportBench) -> None:
    """The frames of one task arrive in order, in both directions at once."""
    count = 200
    one, other = await bench.members(2)
    async with current_loop().open_nursery() as nursery:  # different numbers: two nodes must not send one identifier
        for first, sender, hearer in ((0, one, other), (count, other, one)):
            numbers = list(range(first, first + count))
            nursery.start_soon(_expect_numbers, bench, hearer, numbers)
            bench.say(sender, [numbered(number) for number in numbers])


async def _expect_numbers(bench: TransportBench, member: Transport, numbers: list[int]) -> None:
    expect_numbers(await bench.numbers(member, len(numbers)), numbers, "order")


@case
async def order_of_each_task(bench: TransportBench) -> None:
    """Several tasks may send on one member: the frames of each task arrive in order."""
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
async def no_echo(bench: TransportBench) -> None:
    """A member does not receive its own frames."""
    one, other = await bench.members(2)
    for number in range(5):
        await one.send(numbered(number))
    expect_numbers(await bench.numbers(other, 5), list(range(5)), "what was sent")
    await other.send(END)  # an echo would come before it
    received, _ = await bench.hear(one)
    expect(received == END, f"{received}, which this member sent, came back to it")


@case
async def three_members(bench: TransportBench) -> None:
    """Each of three members hears the two others, every frame once and in order."""
    members = await bench.members(3)
    for number in range(30):
        await members[number % 3].send(numbered(number))
    for place, member in enumerate(members):
        heard = await bench.numbers(member, 20)
        for sender in {0, 1, 2} - {place}:
            of_one = [number for number in heard if number % 3 == sender]
            expect_numbers(of_one, list(range(sender, 30, 3)), f"what {place} hears of {sender}")


@case
async def one_member_alone(bench: TransportBench) -> None:
    """A lone member can send; a member that joins later misses what was sent before, but nothing in between."""
    one = await bench.join(0)
    for number in range(3):
        await one.send(numbered(number))
    late = await bench.join(1)
    await one.send(END)
    heard = await bench.numbers_until_end(late)
    expect(heard == [0, 1, 2][3 - len(heard) :], f"frames 0, 1, 2 were sent before and while it joined, and it heard {heard}")


@case
async def who_leaves(bench: TransportBench) -> None:
    """A member that leaves, even just after sending, does not disturb the others."""
    one, other, leaver = await bench.members(3)
    await leaver.send(numbered(1))
    expect_numbers(await bench.numbers(other, 1), [1], "the frames of the member that is about to leave")
    await leaver.send(numbered(2))
    await leaver.aclose()
    await one.send(END)
    heard = await bench.numbers_until_end(other)
    expect(heard in ([2], []), f"frame 2 was sent by a member that left at once, and {heard} came")


@case
async def who_comes_and_goes(bench: TransportBench) -> None:
    """While members join and leave, the others miss nothing."""
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
    expect_numbers([number for number in heard if number < count], list(range(count)), "the frames of the member that stayed")
    expect_numbers(
        [number for number in heard if number >= count], list(range(count, count + comings)), "the frames of the guests"
    )


@case
async def time_stamps(bench: TransportBench) -> None:
    """Time stamps are ns on a clock that runs as fast as ours; or there are none."""
    one, other = await bench.members(2)
    stamps = []
    for number in range(2):
        await one.send(numbered(number))
        frame, stamp = await bench.hear(other)
        expect(number_of(frame) == number, f"frame {number} was sent, and {number_of(frame)} came")
        stamps.append(stamp)
        await current_loop().sleep(PAUSE)
    first, second = stamps
    if first is None or second is None:
        expect(first is second, f"one frame has a time stamp and one has none: {stamps}")
        return
    least, most = 0.9 * PAUSE * 1e9, MUCH_LATER * 1e9
    expect(least <= second - first <= most, f"two frames {PAUSE:g} s apart have stamps {second - first} ns apart")
