"""virtual:NAME, the bus inside this process. All in virtual time."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import trio
import trio.testing

from canopen_proto.frame import Frame
from canopen_transports import ReceiveOverrun, Transport, VirtualTransport, open_transport
from canopen_transports.conformance.frames import number_of, numbered
from canopen_transports.virtual import MAX_PUSHED
from tests.transports.support import reported, run, trio_test


async def _numbers(member: Transport, count: int) -> list[int]:
    return [number_of((await member.receive())[0]) for _ in range(count)]


@trio_test()
async def test_an_overrun_is_reported_where_it_happened() -> None:
    sender, slow = VirtualTransport("a"), VirtualTransport("a", queue_size=3)
    for number in range(8):
        await sender.send(numbered(number))
    assert await _numbers(slow, 1) == [0]
    await sender.send(numbered(8))  # one frame was taken, but the queue with its mark is still full
    assert await _numbers(slow, 2) == [1, 2]
    await sender.send(numbered(9))
    caught = await reported(slow, ReceiveOverrun, match="6 received frames lost on virtual:a")
    assert caught.lost == 6
    assert "queue of 3 frames was full" in caught.seen
    assert await _numbers(slow, 1) == [9]


@trio_test()
async def test_each_overrun_has_its_own_place() -> None:
    sender, slow = VirtualTransport("a"), VirtualTransport("a", queue_size=1)
    for number in range(2):
        await sender.send(numbered(number))
    assert await _numbers(slow, 1) == [0]
    await reported(slow, ReceiveOverrun, match="1 received frame lost")
    await sender.send(numbered(2))
    assert await _numbers(slow, 1) == [2]


@trio_test()
async def test_one_slow_member_costs_the_others_nothing() -> None:
    sender, slow, quick = VirtualTransport("a"), VirtualTransport("a", queue_size=1), VirtualTransport("a")
    for number in range(5):
        await sender.send(numbered(number))
    assert await _numbers(quick, 5) == [0, 1, 2, 3, 4]
    assert await _numbers(slow, 1) == [0]


def test_a_queue_needs_room() -> None:
    async def body() -> None:
        with pytest.raises(ValueError, match="0 frames"):
            VirtualTransport("a", queue_size=0)

    run(body)


@trio_test()
async def test_names_are_separate_buses_and_an_empty_one_is_taken_down() -> None:
    async with VirtualTransport("a") as one, VirtualTransport("b") as other, VirtualTransport("a") as third:
        await one.send(numbered(1))
        await third.send(numbered(2))
        await VirtualTransport("b").send(numbered(3))
        assert await _numbers(other, 1) == [3]
        assert await _numbers(third, 1) == [1]
    async with VirtualTransport("a") as again:
        with trio.move_on_after(1) as scope:
            await again.receive()
        assert scope.cancelled_caught


def test_runs_do_not_share_buses() -> None:
    async def join_and_forget() -> None:
        await VirtualTransport("a").send(numbered(1))
        await trio.to_thread.run_sync(run, another_run)  # a run beside it, in another thread

    async def another_run() -> None:
        member = VirtualTransport("a")
        assert len(member._line.members) == 1

    trio.run(join_and_forget)
    run(another_run)


@trio_test()
async def test_time_stamps_are_trios_clock_and_the_same_for_all() -> None:
    one, two, three = (VirtualTransport("a") for _ in range(3))
    start = trio.current_time()
    await one.send(Frame.parse("080#"))
    await trio.sleep(0.25)
    await one.send(Frame.parse("080#"))
    first = [await member.receive() for member in (two, three)]
    second = await two.receive()
    assert first[0] == first[1] == (Frame.parse("080#"), round(start * 1e9))
    assert second[1] == first[0][1] + 250_000_000


@trio_test()
async def test_what_is_pushed_may_be_answered_at_once_and_all_hear_one_order() -> None:
    asking, answering, spy = (VirtualTransport("a") for _ in range(3))
    heard: list[int] = []

    def answer(frame: Frame, now: int) -> None:
        number = number_of(frame)
        if number < 10:
            assert answering.send_nowait(numbered(number + 10))

    answering.push_to(answer)
    asking.push_to(lambda frame, now: heard.append(number_of(frame)))
    for number in (1, 2):
        assert asking.send_nowait(numbered(number))
    assert heard == [11, 12]
    assert await _numbers(spy, 4) == [1, 11, 2, 12]


@trio_test()
async def test_an_endless_talk_lets_other_tasks_run() -> None:
    one, other = VirtualTransport("a"), VirtualTransport("a")
    pushed: list[int] = []

    def answer_to(member: VirtualTransport) -> Callable[[Frame, int], None]:
        def answer(frame: Frame, now: int) -> None:
            pushed.append(number_of(frame))
            member.send_nowait(numbered(len(pushed)))

        return answer

    one.push_to(answer_to(one))
    other.push_to(answer_to(other))
    one.send_nowait(numbered(0))
    assert pushed == list(range(MAX_PUSHED))
    assert await _numbers(other, 1) == [MAX_PUSHED]


@trio_test()
async def test_the_name_may_be_left_out() -> None:
    one, two, three = [await open_transport(locator) for locator in ("virtual", "virtual:", "virtual:default")]
    await one.send(numbered(1))
    assert await _numbers(two, 1) == await _numbers(three, 1) == [1]


@trio_test()
async def test_all_waiting_receivers_of_a_member_are_served() -> None:
    sender, member = VirtualTransport("a"), VirtualTransport("a")
    heard: list[int] = []

    async def receive() -> None:
        heard.extend(await _numbers(member, 1))

    async with trio.open_nursery() as nursery:
        nursery.start_soon(receive)
        nursery.start_soon(receive)
        await trio.testing.wait_all_tasks_blocked()
        await sender.send(numbered(1))
        await sender.send(numbered(2))
    assert sorted(heard) == [1, 2]
