"""Heartbeat producer and consumer: literal frames, time early and late, and the peer's known failures."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import Frame
from canopen_proto.heartbeat import (
    HeartbeatConsumer,
    HeartbeatLost,
    HeartbeatProducer,
    HeartbeatReceived,
    HeartbeatRecovered,
    HeartbeatsSkipped,
    NmtStateReported,
    NodeBooted,
)
from canopen_proto.machine import MILLISECOND as MS
from canopen_proto.machine import NEVER, Event, FrameIgnored, LocalProtocolError, Outbox
from canopen_proto.network import Network
from canopen_proto.nmt import NmtState
from canopen_proto.remote_node import RemoteNode
from tests.builds import replaces_what_is_compiled
from tests.core.test_bursts_and_single_frames import long_way
from tests.examples import examples

STOPPED, OPERATIONAL, PRE_OPERATIONAL = NmtState.STOPPED, NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL


def take(out: Outbox) -> tuple[list[str], list[Event]]:
    frames, events = [str(frame) for frame in out.frames], list(out.events)
    out.frames.clear()
    out.events.clear()
    return frames, events


def running_producer(period: int = 0, state: NmtState = PRE_OPERATIONAL) -> HeartbeatProducer:
    producer = HeartbeatProducer(Outbox(), 5)
    producer.set_state(state, 0)
    producer.set_period(period, 0)
    take(producer.out)
    return producer


def hear(consumer: HeartbeatConsumer, text: str, now: int) -> list[Event]:
    consumer.receive(Frame.parse(text), now)
    return take(consumer.out)[1]


def wake(consumer: HeartbeatConsumer, now: int) -> list[Event]:
    consumer.handle_timeout(now)
    return take(consumer.out)[1]


# producer


def test_a_time_that_is_set_while_running_begins_at_once() -> None:
    producer = running_producer()
    assert producer.deadline == NEVER
    producer.set_period(100 * MS, 7 * MS)
    assert take(producer.out) == (["705#7F"], [])
    assert producer.deadline == 107 * MS


def test_the_boot_up_counts_as_the_first_heartbeat() -> None:
    producer = HeartbeatProducer(Outbox(), 5)
    producer.set_period(100 * MS, 0)
    assert (take(producer.out)[0], producer.deadline) == ([], NEVER)  # still initialising
    producer.set_state(PRE_OPERATIONAL, 30 * MS)
    assert (take(producer.out)[0], producer.deadline) == ([], 130 * MS)
    producer.handle_timeout(130 * MS)
    assert take(producer.out)[0] == ["705#7F"]


def test_producer_without_a_time_stays_silent_through_a_boot() -> None:
    producer = HeartbeatProducer(Outbox(), 5)
    producer.set_state(PRE_OPERATIONAL, 0)
    producer.handle_timeout(10_000 * MS)
    assert (take(producer.out), producer.deadline) == (([], []), NEVER)


def test_producer_sends_the_present_state_and_keeps_its_phase_through_changes() -> None:
    producer = running_producer(100 * MS)
    sent = []
    for state in (OPERATIONAL, STOPPED, PRE_OPERATIONAL):
        producer.set_state(state, producer.deadline - 1)
        assert take(producer.out)[0] == []
        sent.append(producer.deadline)
        producer.handle_timeout(producer.deadline)
        assert take(producer.out)[0] == [f"705#{state:02X}"]
    assert sent == [100 * MS, 200 * MS, 300 * MS]


def test_producer_stops_with_time_0_and_while_initialising() -> None:
    producer = running_producer(100 * MS)
    producer.set_state(NmtState.INITIALISING, 50 * MS)
    producer.handle_timeout(500 * MS)
    assert (take(producer.out), producer.deadline) == (([], []), NEVER)
    producer.set_state(PRE_OPERATIONAL, 500 * MS)
    assert producer.deadline == 600 * MS
    producer.set_period(0, 550 * MS)
    producer.handle_timeout(700 * MS)
    assert (take(producer.out), producer.deadline) == (([], []), NEVER)


def test_producer_early_does_nothing() -> None:
    producer = running_producer(100 * MS)
    producer.handle_timeout(100 * MS - 1)
    assert (take(producer.out), producer.deadline) == (([], []), 100 * MS)


@pytest.mark.parametrize(("late", "skipped"), [(0, 0), (99, 0), (100, 1), (199, 1), (1234, 12)])
def test_producer_late_sends_one_keeps_phase_and_reports(late: int, skipped: int) -> None:
    producer = running_producer(100 * MS)
    producer.handle_timeout((100 + late) * MS)
    expected: list[Event] = [HeartbeatsSkipped(5, skipped)] if skipped else []
    assert take(producer.out) == (["705#7F"], expected)
    assert producer.deadline == (200 + 100 * skipped) * MS


@pytest.mark.parametrize("period", [-1, 1, MS - 1])
def test_producer_refuses_times_below_its_unit(period: int) -> None:
    producer = running_producer(100 * MS)
    with pytest.raises(LocalProtocolError, match=f"producer heartbeat time is {period} ns"):
        producer.set_period(period, 0)
    assert (producer.period, producer.deadline, take(producer.out)) == (100 * MS, 100 * MS, ([], []))


# consumer


def test_consumer_only_listens_with_timeout_0() -> None:
    consumer = HeartbeatConsumer(Outbox(), 5)
    assert list(consumer.can_ids()) == [0x705]
    assert (consumer.state, consumer.last_heard, consumer.lost) == (None, None, False)
    assert hear(consumer, "705#05", 3) == [HeartbeatReceived(5, OPERATIONAL, None), NmtStateReported(5, None, OPERATIONAL)]
    assert (consumer.state, consumer.last_heard, consumer.deadline) == (OPERATIONAL, 3, NEVER)
    assert wake(consumer, 10**15) == []


def test_state_is_reported_on_change_only() -> None:
    consumer = HeartbeatConsumer(Outbox(), 5)
    hear(consumer, "705#7F", 0)
    assert hear(consumer, "705#7F", 1) == [HeartbeatReceived(5, PRE_OPERATIONAL, None)]
    assert hear(consumer, "705#04", 2) == [
        HeartbeatReceived(5, STOPPED, None),
        NmtStateReported(5, PRE_OPERATIONAL, STOPPED),
    ]


def test_heartbeat_right_behind_a_boot_up_loses_neither() -> None:
    """The peer's wait_for_bootup misses the boot-up here (its issue 560)."""
    consumer = HeartbeatConsumer(Outbox(), 5, 500 * MS)
    consumer.receive(Frame.parse("705#00"), 0)
    consumer.receive(Frame.parse("705#05"), 0)
    assert take(consumer.out)[1] == [
        NodeBooted(5, None),
        NmtStateReported(5, None, PRE_OPERATIONAL),
        HeartbeatReceived(5, OPERATIONAL, None),
        NmtStateReported(5, PRE_OPERATIONAL, OPERATIONAL),
    ]
    assert consumer.deadline == 500 * MS


def test_the_same_heartbeat_as_before_a_boot_up_reports_the_state_anew() -> None:
    consumer = HeartbeatConsumer(Outbox(), 5, 500 * MS)
    for text in ("705#05", "705#00"):
        hear(consumer, text, 0)
    told = [HeartbeatReceived(5, OPERATIONAL, None), NmtStateReported(5, PRE_OPERATIONAL, OPERATIONAL)]
    assert hear(consumer, "705#05", 1) == told
    assert consumer.state is OPERATIONAL


@pytest.mark.parametrize("text", ["705#", "705#0505", "705#01"])
def test_a_frame_that_is_no_heartbeat_changes_nothing_before_the_first_one_or_behind_it(text: str) -> None:
    consumer = HeartbeatConsumer(Outbox(), 5, 500 * MS)
    for _ in range(2):
        (ignored,) = hear(consumer, text, 10 * MS)
        assert isinstance(ignored, FrameIgnored)
        hear(consumer, "705#05", 0)
        assert (consumer.state, consumer.last_heard, consumer.deadline) == (OPERATIONAL, 0, 500 * MS)


def test_toggle_bit_of_a_guarding_answer_is_masked() -> None:
    consumer = HeartbeatConsumer(Outbox(), 5)
    hear(consumer, "705#05", 0)
    assert hear(consumer, "705#85", 1) == [HeartbeatReceived(5, OPERATIONAL, None)]


def test_boot_up_does_not_begin_monitoring() -> None:
    consumer = HeartbeatConsumer(Outbox(), 5, 500 * MS)
    hear(consumer, "705#00", 0)
    assert consumer.deadline == NEVER
    hear(consumer, "705#7F", 100 * MS)
    assert consumer.deadline == 600 * MS


def test_lost_once_then_recovered() -> None:
    consumer = HeartbeatConsumer(Outbox(), 5, 500 * MS)
    hear(consumer, "705#05", 10 * MS)
    assert wake(consumer, 510 * MS - 1) == []  # early
    assert wake(consumer, 510 * MS) == [HeartbeatLost(5, OPERATIONAL, 10 * MS, 500 * MS)]
    assert (consumer.lost, consumer.state, consumer.deadline) == (True, None, NEVER)
    assert wake(consumer, 5000 * MS) == []
    assert hear(consumer, "705#05", 6000 * MS) == [
        HeartbeatReceived(5, OPERATIONAL, None),
        HeartbeatRecovered(5, OPERATIONAL),
        NmtStateReported(5, None, OPERATIONAL),
    ]
    assert (consumer.lost, consumer.deadline) == (False, 6500 * MS)


def test_boot_up_of_a_lost_node_is_reported_and_recovers_it_with_its_heartbeat_only() -> None:
    consumer = HeartbeatConsumer(Outbox(), 5, 500 * MS)
    hear(consumer, "705#05", 0)
    wake(consumer, 500 * MS)
    assert hear(consumer, "705#00", 600 * MS) == [NodeBooted(5, None), NmtStateReported(5, None, PRE_OPERATIONAL)]
    assert (consumer.lost, consumer.deadline) == (True, NEVER)
    assert hear(consumer, "705#7F", 700 * MS) == [
        HeartbeatReceived(5, PRE_OPERATIONAL, None),
        HeartbeatRecovered(5, PRE_OPERATIONAL),
    ]


def test_boot_up_of_a_watched_node_gives_it_its_time_anew_and_no_more() -> None:
    """A node that forgot its heartbeat time in a reset does not pass unnoticed."""
    consumer = HeartbeatConsumer(Outbox(), 5, 500 * MS)
    hear(consumer, "705#05", 0)
    assert hear(consumer, "705#00", 400 * MS) == [NodeBooted(5, None), NmtStateReported(5, OPERATIONAL, PRE_OPERATIONAL)]
    assert consumer.deadline == 900 * MS
    assert wake(consumer, 900 * MS) == [HeartbeatLost(5, PRE_OPERATIONAL, 400 * MS, 500 * MS)]


def test_a_frame_handled_before_its_time_out_counts_as_in_time() -> None:
    consumer = HeartbeatConsumer(Outbox(), 5, 500 * MS)
    hear(consumer, "705#05", 0)
    assert hear(consumer, "705#05", 2000 * MS) == [HeartbeatReceived(5, OPERATIONAL, None)]
    assert wake(consumer, 2000 * MS) == []
    assert consumer.deadline == 2500 * MS


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("705#", "1 byte, not 0"),
        ("705#R1", "1 byte, not 0"),
        ("705#0505", "1 byte, not 2"),
        ("705#01", "0x01 is not an NMT state"),
        ("705#D0", "0xD0 is not an NMT state"),
    ],
)
def test_odd_frames_are_reported_and_no_sign_of_life(text: str, reason: str) -> None:
    consumer = HeartbeatConsumer(Outbox(), 5, 500 * MS)
    hear(consumer, "705#05", 0)
    (ignored,) = hear(consumer, text, 400 * MS)
    assert isinstance(ignored, FrameIgnored)
    assert reason in ignored.reason
    assert (consumer.state, consumer.last_heard, consumer.deadline) == (OPERATIONAL, 0, 500 * MS)


def test_set_timeout_watches_a_node_that_was_heard_and_waits_for_one_that_was_not() -> None:
    consumer = HeartbeatConsumer(Outbox(), 5)
    consumer.set_timeout(300 * MS, 0)
    assert consumer.deadline == NEVER
    hear(consumer, "705#00", 1 * MS)
    consumer.set_timeout(400 * MS, 2 * MS)
    assert consumer.deadline == NEVER  # a boot-up is no heartbeat
    hear(consumer, "705#05", 10 * MS)
    consumer.set_timeout(200 * MS, 20 * MS)
    assert consumer.deadline == 220 * MS
    consumer.set_timeout(0, 30 * MS)
    assert consumer.deadline == NEVER


def test_set_timeout_of_a_lost_node() -> None:
    consumer = HeartbeatConsumer(Outbox(), 5, 100 * MS)
    hear(consumer, "705#05", 0)
    wake(consumer, 100 * MS)
    consumer.set_timeout(200 * MS, 150 * MS)
    assert (consumer.lost, consumer.deadline) == (True, NEVER)  # it is not lost twice
    consumer.set_timeout(0, 160 * MS)
    assert not consumer.lost


@pytest.mark.parametrize("timeout", [-5, 1, MS - 1])
def test_consumer_refuses_times_below_its_unit(timeout: int) -> None:
    with pytest.raises(LocalProtocolError, match="consumer heartbeat time"):
        HeartbeatConsumer(Outbox(), 5, timeout)
    consumer = HeartbeatConsumer(Outbox(), 5, 100 * MS)
    with pytest.raises(LocalProtocolError, match="consumer heartbeat time"):
        consumer.set_timeout(timeout, 0)
    assert consumer.timeout == 100 * MS


def test_events_carry_the_transports_time() -> None:
    consumer = HeartbeatConsumer(Outbox(), 5)
    consumer.out.timestamp = 1_700_000_000_000_000_123
    assert hear(consumer, "705#00", 5)[0] == NodeBooted(5, 1_700_000_000_000_000_123)
    assert hear(consumer, "705#05", 6)[0] == HeartbeatReceived(5, OPERATIONAL, 1_700_000_000_000_000_123)


def test_a_recorded_session_is_understood() -> None:
    """CANopenNode's demo device: boot-up, NMT start, stop, enter pre-operational, as candump saw its error control frames."""
    consumer = HeartbeatConsumer(Outbox(), 4, 1500 * MS)
    reported: list[Event] = []
    for at, text in [(0, "704#00"), (1, "704#7F"), (1000, "704#05"), (1002, "704#04"), (2002, "704#04"), (2003, "704#7F")]:
        reported += hear(consumer, text, at * MS)
    assert [happened for happened in reported if not isinstance(happened, HeartbeatReceived)] == [
        NodeBooted(4, None),
        NmtStateReported(4, None, PRE_OPERATIONAL),
        NmtStateReported(4, PRE_OPERATIONAL, OPERATIONAL),
        NmtStateReported(4, OPERATIONAL, STOPPED),
        NmtStateReported(4, STOPPED, PRE_OPERATIONAL),
    ]


@given(st.lists(st.tuples(st.binary(max_size=8), st.integers(0, 10**10))), st.sampled_from([0, MS, 500 * MS]))
def test_no_bytes_at_no_time_make_the_consumer_raise(steps: list[tuple[bytes, int]], timeout: int) -> None:
    consumer = HeartbeatConsumer(Outbox(), 5, timeout)
    now = 0
    for data, passed in steps:
        now += passed
        consumer.receive(Frame(0x705, data), now)
        consumer.handle_timeout(now)
        assert len(take(consumer.out)[1]) <= 3
        assert consumer.deadline in (NEVER, now + timeout) or consumer.deadline > now


bytes_sent = st.sampled_from([b"\x7f", b"\x00", b"\x7f", b"\x00", b"\x05", b"\xff", b"\x05\x05"])
pauses = st.sampled_from([5, 20, 60, 100])  # ms: the consumer heartbeat time is 50 ms


@replaces_what_is_compiled
@examples(1000, least=250)
@given(st.lists(st.tuples(bytes_sent, st.none() | st.integers(0, 9), pauses, st.booleans()), min_size=4, max_size=12))
def test_however_a_node_falls_silent_boots_and_comes_back_each_heartbeat_is_told_as_by_the_long_way(
    script: list[tuple[bytes, int | None, int, bool]],
) -> None:
    told: list[list[str]] = []
    for kind in (long_way(), RemoteNode):
        network = Network()
        node = kind(network.out, 5, ObjectDictionary([]), heartbeat_timeout=50 * MS)
        network.attach(node)
        now, heard = 0, []
        for byte, stamp, pause, forgets in script:
            if kind is not RemoteNode:
                node.heartbeat.usual = bytes(9)  # of no frame: each goes the long way
            network.receive(Frame(0x705, byte), now, stamp)
            heard.append(f"{network.drain(now)} {node.nmt_state} {node.heartbeat.state} {network.next_deadline()}")
            now += pause * MS
            network.handle_timeout(now)
            if forgets and node.heartbeat.lost:
                node.heartbeat.set_timeout(0, now)  # it is no longer lost, and its state stays unknown
                node.heartbeat.set_timeout(50 * MS, now)
            heard.append(f"{network.drain(now)} {node.heartbeat.lost} {network.next_deadline()}")
        told.append(heard)
    assert told[0] == told[1]
