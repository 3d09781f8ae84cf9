"""The analysis: against the example of its paper, and against the machine."""

from __future__ import annotations

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, SECOND, LocalProtocolError, Time
from canopen_transports.wire import (
    Message,
    QueueOrder,
    Wire,
    WireMember,
    WireSettings,
    duration,
    frame_bits,
    response_times,
    worst_bits,
)
from canopen_transports.wire.response_time import utilisation

BITRATE = 125_000

# The paper's table 2: 7 bytes and 11-bit identifiers, at most 125 bits, on 125 kbit/s.
FRAME_TIME = duration(worst_bits(7), BITRATE)
EXAMPLE = [
    Message("A", 1, FRAME_TIME, 2_500 * MICROSECOND, deadline=2_500 * MICROSECOND),
    Message("B", 2, FRAME_TIME, 3_500 * MICROSECOND, deadline=3_250 * MICROSECOND),
    Message("C", 3, FRAME_TIME, 3_500 * MICROSECOND, deadline=3_250 * MICROSECOND),
]


def test_the_example_of_the_paper() -> None:
    assert FRAME_TIME == MILLISECOND
    assert round(utilisation(EXAMPLE), 2) == 0.97
    a, b, c = response_times(EXAMPLE, BITRATE)
    assert (a.worst, b.worst) == (2 * MILLISECOND, 3 * MILLISECOND)
    # The older analysis looks at the first instance only, and finds 3.0 ms: C would meet its deadline.
    assert (c.worst, c.instance, c.instances) == (3_500 * MICROSECOND, 1, 2)
    assert [each.fits for each in (a, b, c)] == [True, True, False]
    assert (a.blocking, c.blocking) == (MILLISECOND, 0)


def test_jitter_and_errors_make_it_longer() -> None:
    plain = [Message("A", 1, 1000, 10_000), Message("B", 2, 1000, 20_000)]
    late = [Message("A", 1, 1000, 10_000, jitter=9_500), Message("B", 2, 1000, 20_000, jitter=300)]
    assert [each.worst for each in response_times(plain, 1_000_000)] == [2_000, 2_000]
    # Two of A come at once before B.
    assert [each.worst for each in response_times(late, 1_000_000)] == [9_500 + 2_000, 300 + 3_000]
    with_errors = response_times([Message("A", 1, 100_000, SECOND)], 1_000_000, error_interval=SECOND)
    assert with_errors[0].worst == 100_000 + 31_000 + 100_000


def test_a_network_that_needs_more_than_there_is() -> None:
    fast, slow = response_times([Message("fast", 1, 400, 1_000), Message("slow", 2, 700, 1_000)], 1_000_000)
    assert fast.worst == 1_100
    assert slow.worst == NEVER
    assert not slow.fits


def test_a_busy_period_that_is_too_long_is_given_up() -> None:
    nearly = Message("nearly all", 1, 999, 1_000)
    found = response_times([nearly, Message("rest", 2, 1_000, 10**8)], 1_000_000)
    assert found[1].worst == 1_000 * 1_000  # one of 10**8, in which the other is sent a thousand times
    assert response_times([Message("rest", 0, 2_000, 10**8), nearly], 1_000_000)[1].worst == NEVER


def test_a_queue_lets_the_urgent_wait_for_the_others() -> None:
    messages = [
        Message("SYNC", 0x80, 55, 10_000, queue="master"),
        Message("SDO", 0x601, 135, 10_000, queue="master"),
        Message("TPDO", 0x181, 100, 10_000),
        Message("heartbeat", 0x701, 65, 10_000),
    ]
    sync, sdo, tpdo, _ = response_times(messages, 1_000_000_000)
    # SYNC: behind the SDO, which lets the TPDO go first, and the heartbeat may have begun.
    assert sync.worst == 65 + 100 + 135 + 55
    assert sdo.worst == sync.worst
    free = response_times([Message(each.name, each.priority, each.time, each.period) for each in messages], 1_000_000_000)
    assert free[0].worst == 135 + 55
    assert free[2].worst <= tpdo.worst


def test_queues_that_hold_each_other_up() -> None:
    crowd = [Message(f"{number}", number, 1_000, 10_500, queue=str(number % 3)) for number in range(10)]
    found = response_times([Message("first", -1, 10, 10_000), *crowd], 1_000_000_000)
    assert found[0].worst == 1_010
    assert all(each.worst == NEVER for each in found[1:])
    assert not any(each.instances for each in found[1:])


@pytest.mark.parametrize("wrong", [{"time": 0}, {"period": 0}, {"jitter": -1}])
def test_nonsense_is_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(LocalProtocolError, match="message A"):
        Message(**({"name": "A", "priority": 1, "time": 10, "period": 10} | wrong))


# ---- against the machine ----


def latencies(wire: Wire, plan: list[tuple[WireMember, Frame, Time, Time]], end: Time) -> dict[int, Time]:
    """Send each frame of (member, frame, period, offset) until then; the longest time from the queue to the end of the
    intermission, by CAN-ID."""
    queued = sorted(
        (time, member.number, frame.can_id, member, frame)
        for member, frame, period, offset in plan
        for time in range(offset, end, period)
    )
    worst: dict[int, Time] = {}
    place = 0
    while place < len(queued) or wire.next_deadline() < NEVER:
        due = wire.next_deadline()
        if place < len(queued) and queued[place][0] <= due:
            time, _, _, member, frame = queued[place]
            wire.send(member, frame, time)
            place += 1
            continue
        wire.handle_timeout(due)
        for delivery in wire.drain()[0]:
            latency = delivery.at - delivery.queued + wire.time_of(3)
            worst[delivery.frame.can_id] = max(worst.get(delivery.frame.can_id, 0), latency)
    return worst


def longest(can_id: int, size: int) -> Frame:
    """A frame of many bits."""
    return Frame(can_id, bytes((0x3C,)) * size)


def test_the_machine_reaches_the_paper_s_worst_case() -> None:
    """All three frames with the same exact length; the critical instant is one at which all are queued."""
    wire = Wire(WireSettings(bitrate=BITRATE))
    frames = [frame for can_id in range(0x100, 0x400) if frame_bits(frame := Frame(can_id, bytes(7))) == 115][:3]
    times = [wire.time_of(frame_bits(frame)) for frame in frames]
    unit = times[0]
    first, second, third = [frame.can_id for frame in frames]
    messages = [
        Message(each.name, each.priority, time, each.period * unit // MILLISECOND)
        for each, time in zip(EXAMPLE, times, strict=True)
    ]
    assert times == [unit] * 3
    a, b, c = response_times(messages, BITRATE)
    plan = [(wire.join(0), frame, message.period, 0) for frame, message in zip(frames, messages, strict=True)]
    worst = latencies(wire, plan, 40 * unit)
    assert worst[third] == c.worst == 3.5 * unit
    # A waits at worst for a C that has just begun: here one bit before it.
    wire = Wire(WireSettings(bitrate=BITRATE))
    bit = wire.time_of(1)
    offsets = (bit, bit, 0)
    plan = [
        (wire.join(0), frame, message.period, offset) for frame, message, offset in zip(frames, messages, offsets, strict=True)
    ]
    worst = latencies(wire, plan, 3 * unit)
    assert worst[first] == a.worst - bit
    assert worst[second] == b.worst - bit


@st.composite
def networks(draw: st.DrawFn) -> list[tuple[int, int, int, int, int]]:
    """Of each message: CAN-ID, bytes, period and offset in 100 us, member."""
    count = draw(st.integers(1, 6))
    ids = draw(st.lists(st.integers(1, 0x7FE), min_size=count, max_size=count, unique=True))
    return [
        (can_id, draw(st.integers(0, 8)), draw(st.integers(4, 40)), draw(st.integers(0, 40)), draw(st.integers(0, 2)))
        for can_id in ids
    ]


@settings(max_examples=60)
@given(networks(), st.sampled_from(QueueOrder))
def test_no_latency_is_above_the_analysis(network: list[tuple[int, int, int, int, int]], order: QueueOrder) -> None:
    bitrate = 500_000
    wire = Wire(WireSettings(bitrate=bitrate))
    members = [wire.join(0, order=order) for _ in range(3)]
    wire.join(0)
    frames = [longest(can_id, size) for can_id, size, *_ in network]
    messages = [
        Message(
            f"{can_id:X}",
            can_id,
            wire.time_of(frame_bits(frame)),
            period * 100 * MICROSECOND,
            queue=str(member) if order is QueueOrder.FIFO else None,
        )
        for frame, (can_id, _, period, _, member) in zip(frames, network, strict=True)
    ]
    found = response_times(messages, bitrate)
    assume(all(each.worst < NEVER for each in found))
    plan = [
        (members[member], frame, period * 100 * MICROSECOND, offset * 100 * MICROSECOND)
        for frame, (_, _, period, offset, member) in zip(frames, network, strict=True)
    ]
    worst = latencies(wire, plan, 40 * MILLISECOND)
    for each in found:
        assert worst[each.message.priority] <= each.worst
