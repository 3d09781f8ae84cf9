"""TIME: both roles alone, on one bus, and in a device (CiA 301 v4.2.0, 7.2.6 and 7.5.2.15)."""

from __future__ import annotations

import datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import ValueRangeError
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import EXTENDED, KEY_EXTENDED, Frame
from canopen_proto.machine import FrameIgnored, LocalProtocolError, Outbox
from canopen_proto.time_stamp import TimeConsumer, TimeProducer, TimeReceived, TimeSent
from tests.core.bus import Bus, take_events, take_frames
from tests.core.device_bench import PRE_OPERATIONAL, RESET_COMMUNICATION, START, STOP, DeviceBench
from tests.core.devices import io_device

EPOCH = datetime.datetime(1984, 1, 1, tzinfo=datetime.UTC)
DAY = datetime.timedelta(days=1)
MS = datetime.timedelta(milliseconds=1)

KNOWN = [
    ("100#000000000000", EPOCH),
    ("100#010000000100", EPOCH + DAY + MS),
    ("100#FF5B26050000", EPOCH + DAY - MS),  # the last millisecond of a day: 86 399 999
    ("100#00000000FFFF", datetime.datetime(2163, 6, 6, tzinfo=datetime.UTC)),
    ("100#0046A002053C", datetime.datetime(2026, 1, 25, 12, 14, 18, 112000, tzinfo=datetime.UTC)),
]


@pytest.mark.parametrize(("frame", "time"), KNOWN)
def test_frames_and_times(frame: str, time: datetime.datetime) -> None:
    producer = TimeProducer(Outbox())
    producer.send(time, 0)
    assert take_frames(producer.out) == [frame]
    assert take_events(producer.out) == [TimeSent(0, time)]
    consumer = TimeConsumer(Outbox())
    consumer.out.timestamp = 7
    consumer.receive(Frame.parse(frame), 0)
    assert take_events(consumer.out) == [TimeReceived(0, time, 7)]


def test_the_four_unused_bits_say_nothing() -> None:
    consumer = TimeConsumer(Outbox())
    consumer.receive(Frame.parse("100#010000F00100"), 0)
    assert take_events(consumer.out) == [TimeReceived(0, EPOCH + DAY + MS, None)]


@pytest.mark.parametrize("frame", ["100#", "100#0000000000", "100#00000000000000", "100#005C26050000", "100#FFFFFF0F0000"])
def test_what_is_no_time(frame: str) -> None:
    consumer = TimeConsumer(Outbox())
    consumer.receive(Frame.parse(frame), 0)
    (report,) = take_events(consumer.out)
    assert isinstance(report, FrameIgnored)
    assert report.node_id == 0


@pytest.mark.parametrize(
    "time",
    [
        EPOCH - MS,
        datetime.datetime(2163, 6, 7, tzinfo=datetime.UTC),
        datetime.datetime(2026, 1, 1),  # no zone: nobody knows what is meant
    ],
)
def test_times_that_cannot_be_told(time: datetime.datetime) -> None:
    producer = TimeProducer(Outbox())
    with pytest.raises(ValueRangeError, match="TIME"):
        producer.send(time, 0)
    assert producer.out.frames == producer.out.events == []


def test_local_time_is_told_in_utc_and_cut_to_milliseconds() -> None:
    zone = datetime.timezone(datetime.timedelta(hours=2))
    producer = TimeProducer(Outbox())
    producer.send(datetime.datetime(1984, 1, 1, 2, 0, 0, 1999, zone), 0)
    assert take_frames(producer.out) == ["100#010000000000"]
    assert take_events(producer.out) == [TimeSent(0, EPOCH + MS)]


@given(st.datetimes(datetime.datetime(1984, 1, 1), datetime.datetime(2163, 6, 6), timezones=st.just(datetime.UTC)))
def test_every_time_arrives(time: datetime.datetime) -> None:
    bus = Bus()
    producer, consumer = bus.attach(TimeProducer(Outbox())), bus.attach(TimeConsumer(Outbox()))
    producer.send(time, 0)
    bus.settle()
    sent, received = bus.events
    assert isinstance(sent, TimeSent)
    assert isinstance(received, TimeReceived)
    assert sent.time == received.time
    assert received.time <= time < received.time + MS
    assert consumer.out.events == []


def test_other_can_ids() -> None:
    key = 0x18FF0001 | KEY_EXTENDED
    producer = TimeProducer(Outbox(), key)
    producer.send(EPOCH, 0)
    assert take_frames(producer.out) == ["18FF0001#000000000000"]
    consumer = TimeConsumer(Outbox())
    consumer.set_key(0x100)
    assert consumer.out.rerouted == []
    consumer.set_key(key)
    assert consumer.out.rerouted == [consumer]
    assert list(consumer.can_ids()) == [Frame(0x18FF0001, b"", EXTENDED).key]
    consumer.set_key(None)
    assert list(consumer.can_ids()) == []


# ---- in a device ----

CONSUME, PRODUCE = 0x80000100, 0x40000100
NOW = "100#010000000100"


def device(cob_id: int | None = None) -> DeviceBench:
    return DeviceBench(io_device().with_objects([standard_object(0x1012, cob_id)]))


def heard(bench: DeviceBench) -> list[datetime.datetime]:
    return [each.time for each in bench.seen(TimeReceived)]


def test_a_device_hears_time_while_bit_31_says_so() -> None:
    bench = device()
    assert bench.number(0x1012) == 0x100
    bench.tell(NOW)
    assert heard(bench) == []
    assert bench.write(0x1012, 0, CONSUME, 4) is None
    bench.tell(NOW)
    assert heard(bench) == [EPOCH + DAY + MS]
    assert bench.write(0x1012, 0, 0x100, 4) is None
    bench.tell(NOW)
    assert heard(bench) == []


def test_time_lives_in_pre_operational_and_operational() -> None:
    bench = device(CONSUME)
    for command, count in ((START, 1), (STOP, 0), (PRE_OPERATIONAL, 1), (RESET_COMMUNICATION, 1)):
        bench.tell(command, NOW)
        assert len(heard(bench)) == count, command


def test_a_device_hears_time_at_its_new_can_id() -> None:
    bench = device(CONSUME)
    assert bench.write(0x1012, 0, CONSUME + 0xC0, 4) == AbortCode.DEVICE_STATE
    assert bench.write(0x1012, 0, 0x90, 4) is None  # neither bit is set
    assert bench.write(0x1012, 0, 0x80000091, 4) is None
    bench.tell(NOW, "091#010000000100")
    assert len(heard(bench)) == 1
    assert bench.write(0x1012, 0, 0xC0000091, 4) is None  # the other bit may change
    assert bench.write(0x1012, 0, 0xE0000091, 4) == AbortCode.DEVICE_STATE  # the frame bit


@pytest.mark.parametrize("cob_id", [0x80000000, 0x80000585, 0x80000800])
def test_can_ids_that_time_may_not_have(cob_id: int) -> None:
    assert device().write(0x1012, 0, cob_id, 4) == AbortCode.INVALID_VALUE


def test_a_device_sends_time_while_bit_30_says_so() -> None:
    bench = device(PRODUCE)
    bench.node.send_time(EPOCH + DAY + MS, bench.now)
    assert bench.take() == [NOW]
    assert [each.time for each in bench.seen(TimeSent)] == [EPOCH + DAY + MS]
    with pytest.raises(ValueRangeError):
        bench.node.send_time(EPOCH - DAY, bench.now)
    bench.tell(STOP)
    with pytest.raises(LocalProtocolError, match="node 5 cannot send TIME: it is STOPPED"):
        bench.node.send_time(EPOCH, bench.now)
    bench = device(CONSUME)
    with pytest.raises(LocalProtocolError, match="its 0x1012 is 2147483904"):
        bench.node.send_time(EPOCH, bench.now)
    with pytest.raises(LocalProtocolError, match="not there"):
        DeviceBench().node.send_time(EPOCH, 0)
    assert bench.take() == []


def test_time_is_sent_with_the_can_id_of_the_object() -> None:
    bench = device()
    bench.write(0x1012, 0, 0x40000091, 4)
    bench.node.send_time(EPOCH, bench.now)
    assert bench.take() == ["091#000000000000"]
