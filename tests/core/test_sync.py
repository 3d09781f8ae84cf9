"""SYNC producer and consumer: periods, phase, the counter of 0x1019, lengths."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import EXTENDED, KEY_EXTENDED, Frame, key_of_cob_id
from canopen_proto.machine import MICROSECOND, NEVER, Event, FrameIgnored, LocalProtocolError, Outbox
from canopen_proto.machine import MILLISECOND as MS
from canopen_proto.sync import SyncConsumer, SyncLengthUnexpected, SyncProducer, SyncReceived, SyncSent


def take(out: Outbox) -> tuple[list[str], list[Event]]:
    frames, events = [str(frame) for frame in out.frames], list(out.events)
    out.frames.clear()
    out.events.clear()
    return frames, events


# producer


def test_first_sync_at_once_and_then_one_a_period() -> None:
    producer = SyncProducer(Outbox())
    producer.start(10 * MS, 3 * MS)
    assert take(producer.out) == (["080#"], [SyncSent(0, None, 0)])
    for due in (13 * MS, 23 * MS, 33 * MS):
        assert producer.deadline == due
        producer.handle_timeout(due - 1)  # early
        assert take(producer.out) == ([], [])
        producer.handle_timeout(due)
        assert take(producer.out) == (["080#"], [SyncSent(0, None, 0)])
    assert list(producer.can_ids()) == []


@pytest.mark.parametrize(("late", "skipped"), [(0, 0), (9_999, 0), (10_000, 1), (25_000, 2), (1_000_000, 100)])
def test_late_producer_skips_keeps_phase_and_reports(late: int, skipped: int) -> None:
    producer = SyncProducer(Outbox())
    producer.start(10 * MS, 0, counter_overflow=4)
    take(producer.out)
    producer.handle_timeout(10 * MS + late * MICROSECOND)
    assert take(producer.out) == (["080#02"], [SyncSent(0, 2, skipped)])  # the counter has no gap
    assert producer.deadline == (20 + 10 * skipped) * MS


def test_a_sync_that_is_put_off_is_sent_later_in_the_same_phase() -> None:
    producer = SyncProducer(Outbox())
    producer.put_off()
    producer.catch_up(0)  # nothing runs
    assert take(producer.out) == ([], [])
    producer.start(10 * MS, 0)
    take(producer.out)
    producer.put_off()
    assert producer.deadline == NEVER
    producer.handle_timeout(47 * MS)
    assert take(producer.out) == ([], [])
    producer.catch_up(48 * MS)
    assert take(producer.out) == (["080#"], [SyncSent(0, None, 3)])
    assert producer.deadline == 50 * MS
    producer.catch_up(49 * MS)  # once is enough
    assert take(producer.out) == ([], [])


@pytest.mark.parametrize("again", [False, True])
def test_a_producer_that_is_stopped_or_started_again_has_put_nothing_off(again: bool) -> None:
    producer = SyncProducer(Outbox())
    producer.start(10 * MS, 0)
    producer.put_off()
    if again:
        producer.start(20 * MS, 5 * MS)
    else:
        producer.stop()
    take(producer.out)
    producer.catch_up(6 * MS)
    assert take(producer.out) == ([], [])
    assert producer.deadline == (25 * MS if again else NEVER)


def test_counter_runs_from_1_to_the_overflow_value() -> None:
    producer = SyncProducer(Outbox())
    producer.start(1 * MS, 0, counter_overflow=5)
    for _ in range(6):
        producer.handle_timeout(producer.deadline)
    frames, events = take(producer.out)
    assert frames == ["080#01", "080#02", "080#03", "080#04", "080#05", "080#01", "080#02"]
    assert [sent.counter for sent in events if isinstance(sent, SyncSent)] == [1, 2, 3, 4, 5, 1, 2]


def test_largest_counter() -> None:
    producer = SyncProducer(Outbox(), counter_overflow=240)
    for _ in range(241):
        producer.send(0)
    frames, _ = take(producer.out)
    assert (frames[238:], producer.deadline) == (["080#EF", "080#F0", "080#01"], NEVER)


def test_single_shot_keeps_the_phase_of_a_running_period() -> None:
    producer = SyncProducer(Outbox(), counter_overflow=10)
    producer.send(0)
    assert (take(producer.out)[0], producer.deadline) == (["080#01"], NEVER)
    producer.start(10 * MS, 1 * MS)
    producer.send(6 * MS)
    assert (take(producer.out)[0], producer.deadline) == (["080#01", "080#02"], 11 * MS)


def test_stop_and_start_begin_anew() -> None:
    producer = SyncProducer(Outbox())
    producer.start(10 * MS, 0, counter_overflow=3)
    producer.handle_timeout(10 * MS)
    producer.stop()
    assert (producer.deadline, producer.period) == (NEVER, 0)
    take(producer.out)
    producer.handle_timeout(1000 * MS)
    assert take(producer.out) == ([], [])
    producer.start(5 * MS, 1003 * MS)
    assert (take(producer.out)[0], producer.deadline) == (["080#01"], 1008 * MS)
    producer.start(20 * MS, 1004 * MS, counter_overflow=0)
    assert (take(producer.out)[0], producer.deadline) == (["080#"], 1024 * MS)


def test_configure_stops_the_producer() -> None:
    producer = SyncProducer(Outbox())
    producer.start(10 * MS, 0)
    take(producer.out)
    with pytest.raises(LocalProtocolError, match="overflow value 1 "):
        producer.configure(0x90, 1)
    assert (producer.key, producer.deadline) == (0x80, 10 * MS)
    producer.configure(0x90, 4)
    assert (producer.period, producer.deadline) == (0, NEVER)
    producer.start(10 * MS, 50 * MS)
    assert take(producer.out)[0] == ["090#01"]


@pytest.mark.parametrize("reserved", [-1, 1, 241, 255, 256])
def test_reserved_overflow_values_are_refused_and_change_nothing(reserved: int) -> None:
    with pytest.raises(LocalProtocolError, match=f"overflow value {reserved} "):
        SyncProducer(Outbox(), counter_overflow=reserved)
    with pytest.raises(LocalProtocolError, match=f"overflow value {reserved} "):
        SyncConsumer(Outbox(), counter_overflow=reserved)
    producer = SyncProducer(Outbox(), counter_overflow=7)
    with pytest.raises(LocalProtocolError, match=f"overflow value {reserved} "):
        producer.start(MS, 0, counter_overflow=reserved)
    assert (take(producer.out), producer.counter_overflow, producer.deadline) == (([], []), 7, NEVER)
    consumer = SyncConsumer(Outbox(), counter_overflow=7)
    with pytest.raises(LocalProtocolError, match=f"overflow value {reserved} "):
        consumer.configure(0x90, reserved)
    assert (consumer.key, consumer.counter_overflow, consumer.out.rerouted) == (0x80, 7, [])


@pytest.mark.parametrize("period", [0, -1, 999])
def test_periods_below_the_unit_are_refused(period: int) -> None:
    producer = SyncProducer(Outbox())
    with pytest.raises(LocalProtocolError, match="SYNC period is 1 us or more"):
        producer.start(period, 0, counter_overflow=5)
    assert (take(producer.out), producer.counter_overflow, producer.deadline) == (([], []), 0, NEVER)


def test_producer_on_a_29_bit_identifier() -> None:
    producer = SyncProducer(Outbox(), key_of_cob_id(0x2000_0080))
    producer.send(0)
    assert producer.out.frames == [Frame(0x80, b"", EXTENDED)]


@given(st.integers(1000, 10**9), st.lists(st.integers(0, 10**10), max_size=30))
def test_any_lateness_gives_one_frame_a_wake_in_phase(period: int, waits: list[int]) -> None:
    producer = SyncProducer(Outbox())
    producer.start(period, 0)
    take(producer.out)
    now, cycles = 0, 0
    for wait in waits:
        now += wait
        producer.handle_timeout(now)
        _, events = take(producer.out)
        for sent in events:
            assert isinstance(sent, SyncSent)
            cycles += 1 + sent.skipped
        assert len(events) <= 1
        assert cycles == now // period  # every cycle is either sent or counted
        assert producer.deadline == (cycles + 1) * period


# consumer


def test_consumer_without_a_counter() -> None:
    consumer = SyncConsumer(Outbox())
    assert list(consumer.can_ids()) == [0x80]
    consumer.out.timestamp = 12345
    consumer.receive(Frame.parse("080#"), 0)
    assert take(consumer.out) == ([], [SyncReceived(0, None, 12345)])


def test_consumer_with_a_counter_hands_on_what_came() -> None:
    consumer = SyncConsumer(Outbox(), counter_overflow=4)
    for text in ("080#01", "080#04", "080#F0", "080#00"):
        consumer.receive(Frame.parse(text), 0)
    assert take(consumer.out)[1] == [SyncReceived(0, counter, None) for counter in (1, 4, 240, 0)]


@pytest.mark.parametrize(
    ("overflow", "text", "expected"), [(0, "080#01", 0), (0, "080#0102030405060708", 0), (4, "080#", 1), (4, "080#0102", 1)]
)
def test_unexpected_length_is_said_and_not_acted_on(overflow: int, text: str, expected: int) -> None:
    consumer = SyncConsumer(Outbox(), counter_overflow=overflow)
    consumer.receive(Frame.parse(text), 0)
    (unexpected,) = take(consumer.out)[1]
    assert isinstance(unexpected, SyncLengthUnexpected)
    assert isinstance(unexpected, FrameIgnored)  # who doesn't care for EMCY 0x8240 matches this
    assert (unexpected.node_id, str(unexpected.frame), unexpected.expected) == (0, text, expected)
    assert f"has {expected} data bytes" in unexpected.reason


def test_configure_reroutes_only_if_the_identifier_changed() -> None:
    consumer = SyncConsumer(Outbox())
    consumer.configure(0x80, 10)
    assert consumer.out.rerouted == []
    consumer.receive(Frame.parse("080#07"), 0)
    assert take(consumer.out)[1] == [SyncReceived(0, 7, None)]
    consumer.configure(0x80 | KEY_EXTENDED, 10)
    consumer.configure(0x81, 10)
    assert (consumer.out.rerouted, list(consumer.can_ids())) == ([consumer], [0x81])


@given(st.sampled_from([0, 2, 240]), st.lists(st.binary(max_size=8)))
def test_no_bytes_make_the_consumer_raise(overflow: int, payloads: list[bytes]) -> None:
    consumer = SyncConsumer(Outbox(), counter_overflow=overflow)
    for data in payloads:
        consumer.receive(Frame(0x80, data), 0)
        assert len(take(consumer.out)[1]) == 1
