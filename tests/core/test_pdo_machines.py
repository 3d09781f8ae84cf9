"""PdoConsumer and PdoProducer: transmission types, times, lengths, NMT state; all in virtual time."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.datatypes import DataType, Value, ValueRangeError
from canopen_proto.dictionary import Direction, Filler, PdoDescription, Variable
from canopen_proto.frame import EXTENDED, KEY_EXTENDED, Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, FrameIgnored, LocalProtocolError, Outbox
from canopen_proto.pdo.consumer import PdoConsumer, PdoLengthUnexpected, PdoOverdue, PdoReceived
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_proto.pdo.producer import PdoNotSent, PdoPeriodsSkipped, PdoProducer
from tests.builds import takes_any_type

U16, I16, I32 = DataType.UNSIGNED16, DataType.INTEGER16, DataType.INTEGER32
MS = MILLISECOND

MAPPING = Mapping(
    [
        MappedEntry(0x6041, 0, 16, U16, "statusword"),
        MappedEntry(0x6077, 0, 16, I16, "torque"),
        MappedEntry(0x6064, 0, 32, I32, "position"),
    ]
)
KEY = 0x18C
DATA = bytes.fromhex("3712FEFF10270000")
STORED: dict[int, Value] = {0x604100: 0x1237, 0x607700: -2, 0x606400: 10000}


def consumer(transmission_type: int = 255, event_time: int = 0, mapping: Mapping = MAPPING, key: int | None = KEY) -> PdoConsumer:
    made = PdoConsumer(Outbox(), 12, 1, key, mapping, {}, transmission_type, event_time)
    made.set_enabled(True, 0)
    return made


def producer(transmission_type: int = 255, inhibit_time: int = 0, event_time: int = 0, sync_start: int = 0) -> PdoProducer:
    made = PdoProducer(Outbox(), 12, 1, KEY, MAPPING, dict(STORED), transmission_type, inhibit_time, event_time, sync_start)
    made.set_enabled(True, 0)
    return made


def received(data: bytes = DATA, timestamp: int | None = None, key: int = KEY) -> PdoReceived:
    return PdoReceived(12, 1, key, MAPPING, data, MAPPING.unpack(data), timestamp)


def take(machine: PdoConsumer | PdoProducer) -> list[str]:
    """The frames that came out since the last call."""
    frames = [str(frame) for frame in machine.out.frames]
    machine.out.frames.clear()
    return frames


def run(machine: PdoProducer, until: int, step: int = MS) -> list[int]:
    """When it sends, in ms, if it is woken at its deadlines up to `until`."""
    sent = []
    while machine.deadline <= until:
        now = machine.deadline
        machine.handle_timeout(now)
        sent += [now // step] * len(take(machine))
    return sent


# ---- consumer


def test_an_event_driven_pdo_acts_at_once() -> None:
    pdo = consumer()
    pdo.out.timestamp = 77
    pdo.receive(Frame.parse("18C#3712FEFF10270000"), 5)
    assert pdo.store == STORED
    (report,) = pdo.out.events
    assert report == received(timestamp=77)
    assert isinstance(report, PdoReceived)
    assert report.values == {"statusword": 0x1237, "torque": -2, "position": 10000}
    assert [report.get(key) for key in ("torque", 0x6064, (0x6041, 0), "6041:00")] == [-2, 10000, 0x1237, 0x1237]
    assert report.get("velocity") is None
    assert list(pdo.can_ids()) == [KEY]


@pytest.mark.parametrize("transmission_type", [0, 1, 7, 240])
def test_a_synchronous_pdo_waits_for_the_sync(transmission_type: int) -> None:
    pdo = consumer(transmission_type)
    pdo.on_sync(None, 0)
    pdo.out.timestamp = 1
    pdo.receive(Frame(KEY, bytes(8)), 1)
    pdo.out.timestamp = 2
    pdo.receive(Frame(KEY, DATA), 2)  # the last one counts
    pdo.out.timestamp = 3
    assert pdo.store == {}
    assert pdo.out.events == []
    pdo.on_sync(9, 3)
    assert pdo.store == STORED
    assert pdo.out.events == [received(timestamp=2)]
    pdo.on_sync(10, 4)
    assert len(pdo.out.events) == 1


@pytest.mark.parametrize("transmission_type", [1, 255])
def test_a_short_frame_is_not_processed(transmission_type: int) -> None:
    pdo = consumer(transmission_type)
    pdo.receive(Frame(KEY, DATA[:7]), 0)
    pdo.on_sync(None, 1)
    assert pdo.store == {}
    assert pdo.out.events == [PdoLengthUnexpected(12, 1, KEY, 8, 7, 0x8210, None)]


@pytest.mark.parametrize("transmission_type", [1, 255])
def test_of_a_long_frame_the_mapped_bytes_are_used(transmission_type: int) -> None:
    pdo = consumer(transmission_type, mapping=Mapping(MAPPING.entries[:2]))
    pdo.receive(Frame(KEY, DATA), 0)
    pdo.on_sync(None, 1)
    assert pdo.store == {0x604100: 0x1237, 0x607700: -2}
    assert pdo.out.events[0] == PdoLengthUnexpected(12, 1, KEY, 4, 8, 0x8220, None)
    assert isinstance(pdo.out.events[1], PdoReceived)


@takes_any_type
def test_the_callers_buffer_may_change_afterwards() -> None:
    pdo = consumer()
    buffer = bytearray(DATA)
    pdo.receive(Frame(KEY, buffer), 0)  # type: ignore[arg-type]
    buffer[:] = bytes(8)
    assert pdo.store == STORED


def test_pdos_live_in_operational_only() -> None:
    pdo = consumer(1)
    pdo.receive(Frame(KEY, DATA), 0)
    pdo.set_enabled(False, 1)
    assert not pdo.is_live
    pdo.on_sync(None, 2)  # what was held is gone
    pdo.receive(Frame(KEY, DATA), 3)
    pdo.set_enabled(True, 4)
    pdo.on_sync(None, 5)
    assert pdo.store == {}
    assert pdo.out.events == []


def test_a_pdo_that_is_not_valid_asks_for_nothing() -> None:
    for pdo in (consumer(key=None), consumer(mapping=Mapping())):
        assert list(pdo.can_ids()) == []
        assert not pdo.is_live
        pdo.receive(Frame(KEY, DATA), 0)
        assert pdo.out.events == []


def test_other_parameters_are_announced_only_where_the_can_id_changes() -> None:
    pdo = consumer(1)
    pdo.out.rerouted.clear()
    pdo._in_rerouted = False
    pdo.receive(Frame(KEY, DATA), 0)
    pdo.configure(KEY, MAPPING, 255)
    assert pdo.out.rerouted == []
    pdo.on_sync(None, 1)  # what was held was meant for the other parameters
    assert pdo.out.events == []
    pdo.configure(0x12345678 | KEY_EXTENDED, MAPPING)
    assert pdo.out.rerouted == [pdo]
    assert list(pdo.can_ids()) == [0x12345678 | KEY_EXTENDED]
    pdo.receive(Frame(0x12345678, DATA, EXTENDED), 2)
    assert pdo.out.events == [received(key=0x12345678 | KEY_EXTENDED)]


def test_bytes_that_are_no_value_are_ignored() -> None:
    times = Mapping([MappedEntry(0x2000, 0, 48, DataType.TIME_OF_DAY, "time"), MappedEntry(0x2001, 0, 16, U16, "rest")])
    pdo = consumer(mapping=times)
    frame = Frame.parse("18C#FFFFFF0F00003412")
    pdo.receive(frame, 0)
    assert pdo.store == {}
    assert pdo.out.events == [FrameIgnored(12, frame, "time: 268435455 ms is more than a day (TIME_OF_DAY)")]


def test_an_overdue_pdo_is_reported_once_after_the_last_one() -> None:
    pdo = consumer(255, 20 * MS)
    assert pdo.deadline == NEVER  # not watched before the first one
    pdo.receive(Frame(KEY, DATA), 0)
    pdo.receive(Frame(KEY, DATA), 15 * MS)
    pdo.out.events.clear()
    pdo.handle_timeout(20 * MS)
    assert pdo.out.events == []
    assert pdo.deadline == 35 * MS
    pdo.receive(Frame(KEY, b""), 30 * MS)  # a wrong one is none
    pdo.out.events.clear()
    pdo.handle_timeout(36 * MS)
    assert pdo.out.events == [PdoOverdue(12, 1, KEY, 0x8250)]
    assert pdo.deadline == NEVER
    pdo.receive(Frame(KEY, DATA), 100 * MS)
    assert pdo.deadline == 120 * MS
    pdo.set_enabled(False, 101 * MS)
    assert pdo.deadline == NEVER


def test_from_description() -> None:
    entries = (Variable(0x6041, 0, "statusword", U16), Filler("notused16", 16))
    tpdo = PdoConsumer.from_description(Outbox(), 12, PdoDescription("t", 0x180, Direction.TPDO, 1, entries), {})
    assert (tpdo.number, tpdo.key, tpdo.synchronous) == (1, 0x18C, False)
    store: dict[int, Value] = {0x604100: 7}
    rpdo = PdoProducer.from_description(Outbox(), 12, PdoDescription("r", 0x6A0, Direction.RPDO, None, entries), store)
    rpdo.set_enabled(True, 0)
    assert (rpdo.number, rpdo.send(0), take(rpdo)) == (0, True, ["6AC#07000000"])


def test_node_ids_are_checked() -> None:
    for made in (PdoConsumer, PdoProducer):
        with pytest.raises(LocalProtocolError, match="node-ID 128"):
            made(Outbox(), 128, 1, KEY, MAPPING, {})


@given(st.lists(st.binary(max_size=8) | st.none()), st.sampled_from([0, 1, 240, 254, 255]), st.sampled_from([0, 5 * MS]))
def test_no_frame_ever_raises(inputs: list[bytes | None], transmission_type: int, event_time: int) -> None:
    times = Mapping([MappedEntry(0x2000, 0, 48, DataType.TIME_OF_DAY), MappedEntry(0x2001, 0, 5, DataType.INTEGER8)])
    for mapping in (MAPPING, times):
        pdo = consumer(transmission_type, event_time, mapping)
        for now, data in enumerate(inputs):
            if data is None:
                pdo.on_sync(None, now * MS)
                pdo.handle_timeout(now * MS)
            else:
                pdo.receive(Frame(KEY, data), now * MS)
        assert len(pdo.out.events) <= 2 * len(inputs)


# ---- producer, synchronous


def test_type_0_goes_at_a_sync_only_if_triggered_since() -> None:
    pdo = producer(0)
    pdo.on_sync(None, 0)
    assert take(pdo) == []
    pdo.trigger(1)
    pdo.trigger(2)
    assert take(pdo) == []
    pdo.store[0x606400] = -1  # sampled when it is sent
    pdo.on_sync(None, 3)
    assert take(pdo) == ["18C#3712FEFFFFFFFFFF"]
    pdo.on_sync(None, 4)
    assert take(pdo) == []
    assert pdo.is_synchronous


@pytest.mark.parametrize("every", [1, 2, 3, 240])
def test_cyclic_types_go_at_every_nth_sync(every: int) -> None:
    pdo = producer(every)
    sent = []
    for sync in range(1, 3 * every + 1):
        pdo.trigger(sync)  # means nothing to them
        pdo.on_sync(None, sync)
        sent += [sync] * len(take(pdo))
    assert sent == [every, 2 * every, 3 * every]
    assert pdo.deadline == NEVER


def test_the_sync_start_value_sets_the_phase() -> None:
    pdo = producer(4, sync_start=3)
    sent = []
    for counter in [1, 2, 3, 4, 5, 6, 7, 8, 1, 2, 3]:
        pdo.on_sync(counter, 0)
        sent += [counter] * len(take(pdo))
    assert sent == [3, 7, 3]


def test_the_sync_start_value_is_not_used_without_a_counter() -> None:
    pdo = producer(2, sync_start=3)
    sent = []
    for sync in range(1, 5):
        pdo.on_sync(None, sync)
        sent += [sync] * len(take(pdo))
    assert sent == [2, 4]


def test_counting_starts_anew_with_operational() -> None:
    pdo = producer(2)
    pdo.on_sync(None, 0)
    pdo.set_enabled(False, 1)
    pdo.on_sync(None, 2)
    pdo.set_enabled(True, 3)
    pdo.set_enabled(True, 3)
    pdo.on_sync(None, 4)
    assert take(pdo) == []
    pdo.on_sync(None, 5)
    assert take(pdo) == ["18C#3712FEFF10270000"]


# ---- producer, event-driven


@pytest.mark.parametrize("transmission_type", [254, 255])
def test_an_event_driven_pdo_goes_when_triggered(transmission_type: int) -> None:
    pdo = producer(transmission_type)
    pdo.on_sync(None, 0)
    assert take(pdo) == []
    pdo.trigger(1)
    pdo.trigger(1)
    assert take(pdo) == ["18C#3712FEFF10270000"] * 2
    assert pdo.is_event_driven


def test_the_inhibit_time_delays_and_joins_triggers() -> None:
    pdo = producer(255, inhibit_time=10 * MS)
    pdo.trigger(0)
    assert len(take(pdo)) == 1
    for now in (1, 2, 9):
        pdo.trigger(now * MS)
    pdo.store[0x606400] = 1
    assert take(pdo) == []
    pdo.handle_timeout(9 * MS)
    assert take(pdo) == []
    pdo.handle_timeout(pdo.deadline)
    assert take(pdo) == ["18C#3712FEFF01000000"]
    assert pdo.deadline == NEVER
    pdo.trigger(19 * MS)  # the time runs from the transmission
    assert take(pdo) == []
    assert pdo.deadline == 20 * MS
    pdo.handle_timeout(30 * MS)
    pdo.trigger(40 * MS)
    assert len(take(pdo)) == 2


def test_the_event_timer_runs_from_the_last_transmission() -> None:
    pdo = producer(255, event_time=10 * MS)
    assert run(pdo, 35 * MS) == [10, 20, 30]
    pdo.trigger(36 * MS)
    assert len(take(pdo)) == 1
    assert run(pdo, 60 * MS) == [46, 56]
    pdo.set_enabled(False, 61 * MS)
    assert pdo.deadline == NEVER


def test_a_late_event_timer_skips_and_keeps_its_phase() -> None:
    pdo = producer(255, event_time=10 * MS)
    pdo.handle_timeout(47 * MS)
    assert len(take(pdo)) == 1
    assert pdo.out.events == [PdoPeriodsSkipped(12, 1, KEY, 3)]
    assert pdo.deadline == 50 * MS


def test_an_event_time_within_the_inhibit_time() -> None:
    pdo = producer(255, inhibit_time=25 * MS, event_time=10 * MS)
    assert run(pdo, 90 * MS) == [10, 35, 60, 85]


def test_a_trigger_before_the_event_timer_and_the_end_of_the_inhibit_time() -> None:
    pdo = producer(255, inhibit_time=25 * MS, event_time=10 * MS)
    pdo.trigger(0)
    pdo.trigger(MS)
    assert len(take(pdo)) == 1
    assert run(pdo, 30 * MS) == [25]


@given(st.lists(st.integers(0, 30), max_size=30), st.integers(0, 20), st.integers(0, 20))
def test_the_inhibit_time_is_never_broken_and_no_trigger_is_lost(gaps: list[int], inhibit: int, event_time: int) -> None:
    pdo = producer(255, inhibit * MS, event_time * MS)
    now, sent, triggers = 0, [], []
    for gap in gaps:
        now += gap * MS
        while pdo.deadline <= now:
            at = pdo.deadline
            pdo.handle_timeout(at)
            sent += [at] * len(take(pdo))
        pdo.trigger(now)
        triggers.append(now)
        sent += [now] * len(take(pdo))
    sent += [when * MS for when in run(pdo, now + 50 * MS)]
    assert all(later - earlier >= inhibit * MS for earlier, later in pairwise(sent))
    assert all(any(trigger <= when <= trigger + inhibit * MS for when in sent) for trigger in triggers)
    if event_time:
        longest = max(event_time, inhibit) * MS
        assert all(later - earlier <= longest for earlier, later in pairwise([0, *sent]))


# ---- producer, always


@pytest.mark.parametrize("transmission_type", [0, 1, 255])
def test_send_goes_at_once_whatever_the_type(transmission_type: int) -> None:
    pdo = producer(transmission_type, inhibit_time=10 * MS)
    assert pdo.is_live
    assert [pdo.send(0), pdo.send(MICROSECOND)] == [True, True]
    assert len(take(pdo)) == 2
    pdo.set_enabled(False, 1)
    assert not pdo.send(2)
    pdo.trigger(3)
    pdo.on_sync(None, 4)
    assert take(pdo) == []


def test_what_is_not_valid_or_mapped_is_not_sent() -> None:
    pdo = producer(1, event_time=MS)
    for key, mapping in ((None, MAPPING), (KEY, Mapping())):
        pdo.configure(key, mapping, 0, 255, 0, MS)
        assert not pdo.is_live
        assert not pdo.send(0)
        pdo.trigger(0)
        assert pdo.deadline == NEVER
    assert take(pdo) == []
    pdo.configure(0x18C | KEY_EXTENDED, MAPPING, 0)
    pdo.trigger(0)
    assert take(pdo) == ["0000018C#3712FEFF10270000"]


def test_a_value_that_cannot_be_sent_is_the_callers_fault_and_changes_nothing() -> None:
    pdo = producer(255, inhibit_time=10 * MS, event_time=20 * MS)
    pdo.store[0x606400] = 1.5
    with pytest.raises(ValueRangeError, match="position"):
        pdo.send(5 * MS)
    assert pdo.deadline == 20 * MS
    assert pdo.out.frames == []
    pdo.store[0x606400] = 1
    pdo.trigger(6 * MS)
    assert len(take(pdo)) == 1


def test_by_trigger_sync_or_timer_it_is_an_event() -> None:
    # a peer's SYNC or write must not make us raise, even where our own application wrote nonsense
    reason = "position: INTEGER32 takes an integer, not 1.5"
    for pdo in (producer(0), producer(1)):
        pdo.store[0x606400] = 1.5
        pdo.trigger(0)
        pdo.on_sync(None, 1)
        assert pdo.out.events == [PdoNotSent(12, 1, KEY, reason)]
        assert pdo.out.frames == []
    pdo = producer(255)
    pdo.store[0x606400] = 1.5
    pdo.trigger(0)
    assert pdo.out.events == [PdoNotSent(12, 1, KEY, reason)]
    pdo = producer(255, event_time=10 * MS)
    pdo.store[0x606400] = 1.5
    pdo.handle_timeout(10 * MS)
    assert pdo.out.events == [PdoNotSent(12, 1, KEY, reason)]
    assert pdo.deadline == 20 * MS
    pdo = producer(255, inhibit_time=10 * MS)
    pdo.trigger(0)
    pdo.trigger(MS)
    pdo.store[0x606400] = 1.5
    pdo.handle_timeout(10 * MS)
    assert pdo.out.events == [PdoNotSent(12, 1, KEY, reason)]
    assert pdo.deadline == NEVER


def test_types_for_remote_requests_are_silent() -> None:
    for transmission_type in (252, 253):
        pdo = producer(transmission_type, event_time=MS)
        pdo.trigger(0)
        pdo.on_sync(None, 0)
        assert take(pdo) == []
        assert pdo.deadline == NEVER
