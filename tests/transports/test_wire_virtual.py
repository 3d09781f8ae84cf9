"""virtual:NAME?bitrate=...: the bus machine in trio's time."""

from __future__ import annotations

import pytest
import trio
import trio.testing

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_transports import BusState, BusStateChanged, FrameNotSentError, TransportError, open_transport
from canopen_transports.conformance.frames import END, number_of, numbered
from canopen_transports.virtual_wire import WireTransport
from canopen_transports.wire import FaultKind, FaultRates, frame_bits
from tests.transports.support import reported, trio_test

SYNC = Frame.parse("080#")


async def opened(text: str, count: int = 2) -> list[WireTransport]:
    members = [await open_transport(text) for _ in range(count)]
    assert all(isinstance(member, WireTransport) for member in members)
    return members  # type: ignore[return-value]


@trio_test()
async def test_frames_take_their_time() -> None:
    one, other = await opened("virtual:a?bitrate=500k")
    start = round(trio.current_time() * SECOND)
    for _ in range(3):
        await one.send(SYNC)
    stamps = [(await other.receive())[1] for _ in range(3)]
    length = frame_bits(SYNC) * 2_000
    assert stamps == [start + (number + 1) * length - 6_000 for number in range(3)]
    assert one.bus.load() == pytest.approx(1.0, abs=0.05)


@trio_test()
async def test_who_sends_at_one_time_takes_part_in_one_arbitration() -> None:
    members = await opened("virtual:a?bitrate=1M", 6)
    async with trio.open_nursery() as nursery:
        for number, member in enumerate(members[:5]):
            nursery.start_soon(member.send, Frame(0x500 - number))
    assert [(await members[5].receive())[0].can_id for _ in range(5)] == [0x4FC, 0x4FD, 0x4FE, 0x4FF, 0x500]


@trio_test()
async def test_the_order_of_a_queue() -> None:
    for order, first in (("fifo", 0x601), ("priority", 0x080)):
        sender, other = await opened(f"virtual:{order}?queue={order}")
        for can_id in (0x601, 0x080):
            await sender.send(Frame(can_id))
        assert (await other.receive())[0].can_id == first


@trio_test()
async def test_a_full_queue_is_waited_for() -> None:
    sender, other = await opened("virtual:a?bitrate=125k&queue_size=2")
    start = trio.current_time()
    for number in range(10):
        await sender.send(numbered(number))
    assert trio.current_time() - start > 6 * 100 * 8e-6
    assert [number_of((await other.receive())[0]) for _ in range(10)] == list(range(10))


@trio_test()
async def test_no_room_says_why() -> None:
    (alone,) = await opened("virtual:a?queue_size=1", 1)
    await alone.send(SYNC)
    with pytest.raises(TransportError, match="CO110: 201# was not sent") as caught:
        await alone.send(Frame(0x201))
    assert "no room in the transmit queue of 1 frames for 1 s; the controller is error-passive" in caught.value.seen
    assert "nobody else" in caught.value.cause
    one, other = await opened("virtual:b?bitrate=50k&queue_size=1")
    one.bus.babble(SYNC, 1.5)
    await one.send(Frame(0x201))
    with pytest.raises(TransportError, match="lower identifiers take the whole bus"):
        await one.send(Frame(0x201))
    await trio.sleep(1)
    while (frame := (await other.receive())[0]) == SYNC:
        pass
    assert frame.can_id == 0x201


@trio_test()
async def test_a_lone_member_hears_that_nobody_acknowledges() -> None:
    (alone,) = await opened("virtual:a?bitrate=1M", 1)
    await alone.send(SYNC)
    states = []
    for _ in range(3):
        caught = await reported(alone, BusStateChanged)
        states.append(caught.state)
    assert states == [BusState.NO_ACKNOWLEDGE, BusState.WARNING, BusState.PASSIVE]
    assert "transmit error counter 128" in caught.seen


@trio_test()
async def test_bus_off_is_reported_and_frames_are_refused_until_it_is_over() -> None:
    one, other = await opened("virtual:a?recover=false")
    for number in range(5):
        await one.send(numbered(number))
    one.bus.bus_off(one)
    caught = await reported(one, BusStateChanged, match="bus-off")
    assert caught.tries
    with pytest.raises(FrameNotSentError, match="bus-off"):
        await one.send(SYNC)
    assert one.bus.counts[FaultKind.NOT_SENT] == 5
    one.bus.restart(one)
    await reported(one, BusStateChanged, match="error-active")
    await one.send(END)
    assert (await other.receive())[0] == END


@trio_test()
async def test_a_sender_that_waits_for_room_is_told_of_bus_off_and_of_the_end() -> None:
    one, two = await opened("virtual:a?queue_size=1")
    one.bus.babble(SYNC, 100)

    async def send(member: WireTransport, error: type[Exception]) -> None:
        with pytest.raises(error):
            for _ in range(3):
                await member.send(Frame(0x201))

    async with trio.open_nursery() as nursery:
        nursery.start_soon(send, one, FrameNotSentError)
        nursery.start_soon(send, two, trio.ClosedResourceError)
        await trio.sleep(0.01)
        one.bus.bus_off(one)
        await two.aclose()


@trio_test()
async def test_faults_by_the_seed() -> None:
    heard = []
    for name in ("a", "b"):
        one, other = await opened(f"virtual:{name}?bitrate=1M&loss=0.2&repeat=0.04&corrupt=0.04&delay=0.1&delay_ms=1&seed=7")
        for number in range(200):
            await one.send(numbered(number))
        await trio.sleep(1)
        bus = one.bus
        bus.rates = FaultRates()
        assert bus.rates.total == 0
        await one.send(END)
        numbers = []
        while (frame := (await other.receive())[0]) != END:
            numbers.append(number_of(frame))
        heard.append(numbers)
        assert len(numbers) == 200 - bus.counts[FaultKind.LOSS] + bus.counts[FaultKind.REPETITION]
        assert numbers == sorted(numbers)
        assert bus.counts[FaultKind.CORRUPTION] > 2
        assert bus.counts[FaultKind.DELAY] > 5
        assert len(bus.faults) == bus.counts.total()
    assert heard[0] == heard[1]


@trio_test()
async def test_a_cut_cable() -> None:
    one, two, three, four = await opened("virtual:a?bitrate=1M", 4)
    one.bus.cut([one, two])
    await one.send(numbered(1))
    await three.send(numbered(3))
    assert number_of((await two.receive())[0]) == 1
    assert number_of((await four.receive())[0]) == 3
    with pytest.raises(LocalProtocolError):
        one.bus.cut([one])
    await trio.sleep(1)
    one.bus.mend()
    await one.send(numbered(5))
    assert [number_of((await member.receive())[0]) for member in (two, three, four)] == [5, 5, 5]


@trio_test()
async def test_opening_takes_as_long_as_what_was_queued_before() -> None:
    """Who was alone gets its frames out as soon as somebody is there to acknowledge them; who opens hears what comes next."""
    (alone,) = await opened("virtual:a?bitrate=125k", 1)
    for _ in range(3):
        await alone.send(SYNC)
    await trio.sleep(1)
    start = round(trio.current_time() * SECOND)
    (late,) = await opened("virtual:a", 1)
    last = start + 3 * frame_bits(SYNC) * 8_000 - 3 * 8_000
    assert alone.member.sent == 3
    assert last <= round(trio.current_time() * SECOND) <= last + 8_000  # the bus lets things happen a bit time later
    await alone.send(END)
    assert (await late.receive())[0] == END


@trio_test()
async def test_what_is_queued_behind_an_opening_is_heard_though_the_process_stalls() -> None:
    clock = trio.lowlevel.current_clock()
    assert isinstance(clock, trio.testing.MockClock)
    (alone,) = await opened("virtual:a?bitrate=125k", 1)
    await alone.send(SYNC)
    await trio.sleep(1)

    async def stall() -> None:
        await trio.sleep(0.0001)
        await alone.send(END)
        clock.jump(0.1)

    async with trio.open_nursery() as nursery:
        nursery.start_soon(stall)
        (late,) = await opened("virtual:a", 1)
    with trio.fail_after(1):
        assert (await late.receive())[0] == END


@trio_test()
async def test_opening_does_not_wait_for_what_never_gets_out() -> None:
    one, _ = await opened("virtual:a?bitrate=50k")
    one.bus.babble(SYNC, 100)
    await one.send(Frame(0x201))
    start = trio.current_time()
    (late,) = await opened("virtual:a", 1)
    assert trio.current_time() - start == pytest.approx(1.0)
    assert (await late.receive())[0] == SYNC


@trio_test()
async def test_an_opening_that_is_cancelled_leaves_the_bus() -> None:
    (alone,) = await opened("virtual:a?bitrate=50k", 1)
    await alone.send(SYNC)
    with trio.move_on_after(0.0005) as scope:
        await opened("virtual:a", 1)
    assert scope.cancelled_caught
    assert alone.bus.wire.members == (alone.member,)


@trio_test()
async def test_the_first_member_says_how_the_bus_is() -> None:
    first = await open_transport("virtual:a?bitrate=250k&seed=3")
    second = await open_transport("virtual:a")
    third = await open_transport("virtual:a?queue=priority&queue_size=8")
    assert isinstance(second, WireTransport)
    assert isinstance(third, WireTransport)
    assert second.bus.wire.settings.bitrate == third.bus.wire.settings.bitrate == 250_000
    assert third.member.size == 8
    with pytest.raises(TransportError, match="with other options"):
        await open_transport("virtual:a?bitrate=500k")
    for member in (first, second, third):
        await member.aclose()
    assert isinstance(await open_transport("virtual:a?bitrate=500k"), WireTransport)
    await open_transport("virtual:instant")
    with pytest.raises(TransportError, match="without options is open already"):
        await open_transport("virtual:instant?bitrate=500k")


@trio_test()
async def test_nothing_goes_on_when_nothing_is_sent() -> None:
    """The bus has no beat of its own: the clock of a test jumps over it."""
    one, other = await opened("virtual:a?bitrate=1M")
    await trio.sleep(20)
    await one.send(SYNC)
    assert (await other.receive())[1] == 20 * SECOND + (frame_bits(SYNC) - 3) * 1000
    assert one.bus.wire.next_deadline() > 10**6 * SECOND


@trio_test(real_time=True)
async def test_in_real_time_it_paces_itself() -> None:
    one, other = await opened("virtual:a?bitrate=50k")
    start = round(trio.current_time() * SECOND)
    for _ in range(5):
        await one.send(SYNC)
    stamps = [(await other.receive())[1] for _ in range(5)]
    assert round(trio.current_time() * SECOND) >= stamps[-1]
    assert stamps[-1] - start >= 5 * frame_bits(SYNC) * 20_000 - MILLISECOND
