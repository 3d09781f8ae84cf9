"""The machine against the analysis: no frame comes later than its bound, with jitter, queues, errors; and some come as late."""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass
from random import Random

from hypothesis import assume, given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, Time
from canopen_transports.wire import (
    FaultHappened,
    FaultRates,
    PeriodicMessage,
    QueueOrder,
    Wire,
    WireMember,
    WireSettings,
    frame_bits,
    response_times,
)
from tests.examples import examples
from tests.transports.test_wire_response_time import EXAMPLE

MAX_ERRORS = 5
"""In one run: an error-passive member waits before it sends, which the analysis leaves out."""


@dataclass
class Source:
    """A frame that a member sends again and again, queued up to `jitter` behind each beginning of a period."""

    member: WireMember
    frame: Frame
    period: Time
    offset: Time = 0
    jitter: Time = 0


def latencies(wire: Wire, sources: list[Source], end: Time, *, seed: int = 0, error_interval: Time = NEVER) -> list[Time]:
    """The longest time of each source from the beginning of a period to the end of the intermission.

    error_interval: as soon as this is over, the next frame is hit.
    """
    random = Random(seed)
    plan = [
        (begin + random.choice((0, source.jitter, random.randint(0, source.jitter))), number, begin)
        for number, source in enumerate(sources)
        for begin in range(source.offset, end, source.period)
    ]
    heapq.heapify(plan)
    begun: list[list[Time]] = [[] for _ in sources]
    numbers = {source.frame.can_id: number for number, source in enumerate(sources)}
    worst = [0] * len(sources)
    error_due, errors = (random.randrange(error_interval) if error_interval < NEVER else NEVER), 0
    while plan or wire.next_deadline() < NEVER:
        due = wire.next_deadline()
        if plan and plan[0][0] <= due:
            time, number, begin = heapq.heappop(plan)
            wire.send(sources[number].member, sources[number].frame, time)
            begun[number].append(begin)
            continue
        hit = due >= error_due and errors < MAX_ERRORS
        wire.rates = FaultRates(corruption=1.0) if hit else FaultRates()
        wire.handle_timeout(due)
        deliveries, events = wire.drain()
        for event in events:
            if isinstance(event, FaultHappened):
                error_due, errors = event.at + error_interval, errors + 1
        for delivery in deliveries:
            number = numbers[delivery.frame.can_id]
            worst[number] = max(worst[number], delivery.at + wire.time_of(3) - begun[number].pop(0))
    assert errors > 0 or error_interval >= end
    return worst


def test_the_example_of_the_paper_in_every_phasing() -> None:
    """Frames of 115 bits on 115 kbit/s take 1 ms, as the paper's. Phases are in quarters of a millisecond, and a bit earlier: so
    late does a frame that blocks begin."""
    bitrate = 115_000
    first, second, third = [frame for can_id in range(0x100, 0x400) if frame_bits(frame := Frame(can_id, bytes(7))) == 115][:3]
    quarter = MILLISECOND // 4
    worst = [0] * 3
    for phases in itertools.product(range(14), range(14)):
        for early in (0, 1):
            wire = Wire(WireSettings(bitrate=bitrate))
            bit = wire.time_of(1)
            sources = [
                Source(wire.join(0), frame, message.period, phase * quarter + bit * (early and place < 2))
                for place, (frame, message, phase) in enumerate(zip((first, second, third), EXAMPLE, (0, *phases), strict=True))
            ]
            worst = [max(pair) for pair in zip(worst, latencies(wire, sources, 18 * MILLISECOND), strict=True)]
    bounds = [each.worst for each in response_times(EXAMPLE, bitrate)]
    assert [limit - longest for limit, longest in zip(bounds, worst, strict=True)] == [bit, bit, 0]


def test_the_machine_reaches_the_bound_with_jitter() -> None:
    """A's first one comes 9.5 ms late, its second one in time: B has to wait for both."""
    wire = Wire(WireSettings(bitrate=115_000))
    first, second = [frame for can_id in range(0x100, 0x400) if frame_bits(frame := Frame(can_id, bytes(7))) == 115][:2]
    period = 10 * MILLISECOND
    found = response_times(
        [
            PeriodicMessage("A", 1, MILLISECOND, period, jitter=9_500 * MICROSECOND),
            PeriodicMessage("B", 2, MILLISECOND, 2 * period),
        ],
        115_000,
    )
    one, two = wire.join(0), wire.join(0)
    for time in (9_500 * MICROSECOND, period):
        wire.handle_timeout(time)
        wire.send(one, first, time)
        if time < period:
            wire.send(two, second, time)
    wire.handle_timeout(2 * period)
    ends = {str(each.frame): each.at + wire.time_of(3) for each in wire.drain()[0]}
    assert ends[str(second)] - 9_500 * MICROSECOND == found[1].worst == 3 * MILLISECOND


def longest(can_id: int, size: int) -> Frame:
    """A frame of many bits."""
    return Frame(can_id, bytes((0x3C,)) * size)


@dataclass
class Network:
    """Messages on 500 kbit/s: CAN-ID, bytes, period, offset and jitter in 100 us, member."""

    messages: list[tuple[int, int, int, int, int, int]]
    order: QueueOrder
    error_interval: Time
    seed: int


@st.composite
def networks(draw: st.DrawFn) -> Network:
    count = draw(st.integers(1, 6))
    ids = draw(st.lists(st.integers(1, 0x7FE), min_size=count, max_size=count, unique=True))
    messages = []
    for can_id in ids:
        period = draw(st.integers(4, 40))
        jitter = draw(st.one_of(st.just(0), st.integers(0, period)))
        messages.append((can_id, draw(st.integers(0, 8)), period, draw(st.integers(0, 40)), jitter, draw(st.integers(0, 2))))
    interval = draw(st.one_of(st.just(NEVER), st.integers(1_000, 10_000).map(lambda us: us * MICROSECOND)))
    return Network(messages, draw(st.sampled_from(QueueOrder)), interval, draw(st.integers(0, 1_000)))


@examples(150)
@given(networks())
def test_no_latency_is_above_the_analysis(network: Network) -> None:
    wire = Wire(WireSettings(bitrate=500_000, seed=network.seed))
    members = [wire.join(0, order=network.order) for _ in range(3)]
    wire.join(0)
    sources, messages = [], []
    for can_id, size, period, offset, jitter, member in network.messages:
        frame = longest(can_id, size)
        times = [each * 100 * MICROSECOND for each in (period, offset, jitter)]
        sources.append(Source(members[member], frame, *times))
        queue = str(member) if network.order is QueueOrder.FIFO else None
        time = wire.time_of(frame_bits(frame))
        messages.append(PeriodicMessage(f"{can_id:X}", can_id, time, times[0], jitter=times[2], queue=queue))
    found = response_times(messages, wire.settings.bitrate, error_interval=network.error_interval)
    assume(all(each.worst < NEVER for each in found))
    worst = latencies(wire, sources, 40 * MILLISECOND, seed=network.seed, error_interval=network.error_interval)
    for seen, each in zip(worst, found, strict=True):
        assert seen <= each.worst
