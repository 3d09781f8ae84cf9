"""Remote requests of TPDOs, the synchronous window, lengths, 29 bits, 512 PDOs (CiA 301 v4.2.0, 7.2.2, 7.5.2.7)."""

from __future__ import annotations

import pytest

from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import KEY_EXTENDED, KEY_REMOTE, Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MICROSECOND, MILLISECOND, Machine, Outbox, Time
from canopen_proto.pdo.consumer import PdoConsumer, PdoReceived, PdoTooLate
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_proto.pdo.producer import PdoNotSent, PdoProducer
from tests.core.bus import take_events, take_frames
from tests.core.device_bench import PRE_OPERATIONAL, START, SYNC, DeviceBench
from tests.core.devices import INPUT, OUTPUT, Pair, io_device

MS = MILLISECOND
U16 = DataType.UNSIGNED16
MAPPING = Mapping([MappedEntry(0x6041, 0, 16, U16, "statusword")])
STATUS = 0x604100
ASK = Frame.parse("18C#R2")


def producer(transmission_type: int, *, inhibit_time: int = 0, event_time: int = 0, answers: bool = True) -> PdoProducer:
    store: dict[int, Value] = {STATUS: 0x1234}
    made = PdoProducer(Outbox(), 12, 1, None, MAPPING, store)
    made.configure(0x18C, MAPPING, 0, transmission_type, inhibit_time, event_time, answers_requests=answers)
    made.set_enabled(True, 0)
    return made


def ask(machine: PdoProducer, now: int = 0) -> list[str]:
    machine.receive(ASK, now)
    return take_frames(machine.out)


# ---- the producer ----


@pytest.mark.parametrize("transmission_type", [0, 1, 240, 253, 254, 255])
def test_a_request_is_answered_at_once_with_the_present_values(transmission_type: int) -> None:
    machine = producer(transmission_type)
    assert list(machine.can_ids()) == [ASK.key]
    assert ask(machine) == ["18C#3412"]
    machine.store[STATUS] = 0x5678
    assert ask(machine, MS) == ["18C#7856"]


def test_type_252_sends_what_it_sampled_at_the_last_sync() -> None:
    machine = producer(252)
    assert machine.is_synchronous
    assert ask(machine) == ["18C#3412"]  # no SYNC yet: the present values
    machine.on_sync(None, 0)
    machine.store[STATUS] = 0x5678
    assert take_frames(machine.out) == []
    assert ask(machine) == ["18C#3412"]
    assert ask(machine) == ["18C#3412"]
    machine.on_sync(7, 0)
    assert ask(machine) == ["18C#7856"]
    machine.trigger(0)
    assert take_frames(machine.out) == []


def test_type_253_goes_by_nothing_else() -> None:
    machine = producer(253, event_time=10 * MS)
    machine.on_sync(None, 0)
    machine.trigger(0)
    machine.handle_timeout(100 * MS)
    assert take_frames(machine.out) == []


def test_a_request_does_not_count_as_a_cycle() -> None:
    machine = producer(2)
    machine.on_sync(None, 0)
    assert ask(machine) == ["18C#3412"]
    machine.on_sync(None, 0)
    assert take_frames(machine.out) == ["18C#3412"]
    machine = producer(0)
    machine.trigger(0)
    assert ask(machine) == ["18C#3412"]
    machine.on_sync(None, 0)  # its trigger still waits
    assert take_frames(machine.out) == ["18C#3412"]


def test_a_request_of_an_event_driven_pdo_keeps_the_inhibit_time() -> None:
    machine = producer(255, inhibit_time=10 * MS)
    assert ask(machine, 0) == ["18C#3412"]
    assert ask(machine, 5 * MS) == []
    assert ask(machine, 6 * MS) == []
    machine.handle_timeout(10 * MS)
    assert take_frames(machine.out) == ["18C#3412"]


def test_no_answer_where_bit_30_forbids_it_or_the_pdo_does_not_live() -> None:
    machine = producer(253, answers=False)
    assert list(machine.can_ids()) == []
    machine = producer(253)
    machine.set_enabled(False, 0)
    assert ask(machine) == []
    machine.configure(None, MAPPING, 0, 253, answers_requests=True)
    machine.set_enabled(True, 0)
    assert list(machine.can_ids()) == []
    assert ask(machine) == []


def test_a_value_that_cannot_be_sent_is_an_event() -> None:
    machine = producer(252)
    machine.on_sync(None, 0)
    machine.store[STATUS] = 1.5
    assert ask(machine) == ["18C#3412"]
    machine.on_sync(None, 0)
    assert ask(machine) == []
    reports = take_events(machine.out)
    assert [type(each) for each in reports] == [PdoNotSent, PdoNotSent]  # at the SYNC, and at the request


def test_a_changed_can_id_or_permission_is_announced() -> None:
    machine = producer(253)
    machine.out.rerouted.clear()
    machine._in_rerouted = False
    machine.configure(0x18C, MAPPING, 0, 252, answers_requests=True)
    assert machine.out.rerouted == []
    machine.configure(0x18C, MAPPING, 0, 252, answers_requests=False)
    assert machine.out.rerouted == [machine]


# ---- the consumer ----


def test_a_consumer_asks_with_a_remote_frame_of_the_pdos_length() -> None:
    consumer = PdoConsumer(Outbox(), 12, 1, 0x18C, MAPPING, {})
    assert not consumer.request(0)
    consumer.set_enabled(True, 0)
    assert consumer.request(0)
    assert consumer.out.frames == [ASK]
    take_frames(consumer.out)
    consumer.configure(0x18FF0001 | KEY_EXTENDED, MAPPING)
    assert consumer.request(0)
    assert take_frames(consumer.out) == ["18FF0001#R2"]
    consumer.configure(None, MAPPING)
    assert not consumer.request(0)


def test_a_synchronous_pdo_behind_the_window_is_dropped_until_the_next_sync() -> None:
    consumer = PdoConsumer(Outbox(), 12, 1, 0x20C, MAPPING, {}, 1)
    consumer.set_window(500 * MICROSECOND)
    consumer.set_enabled(True, 0)
    frame = Frame(0x20C, b"\x34\x12")
    consumer.receive(frame, 50 * MS)  # no SYNC yet, no window
    consumer.on_sync(None, 100 * MS)
    assert [type(each) for each in take_events(consumer.out)] == [PdoReceived]
    consumer.receive(frame, 100 * MS + 500 * MICROSECOND)
    assert take_events(consumer.out) == []
    consumer.out.timestamp = 7
    consumer.receive(Frame(0x20C, b"\x78\x56"), 100 * MS + 501 * MICROSECOND)
    assert take_events(consumer.out) == [PdoTooLate(12, 1, 0x20C, 1000, 7)]
    consumer.on_sync(None, 110 * MS)
    assert consumer.store == {STATUS: 0x1234}
    consumer.receive(frame, 110 * MS)
    consumer.set_enabled(False, 111 * MS)
    consumer.set_enabled(True, 112 * MS)
    consumer.receive(frame, 119 * MS)  # the window of a SYNC from before does not count
    assert [type(each) for each in take_events(consumer.out)] == [PdoReceived]


def test_a_synchronous_pdo_is_not_late_because_this_process_was() -> None:
    consumer = PdoConsumer(Outbox(), 12, 1, 0x20C, MAPPING, {}, 1)
    consumer.set_window(MS)
    consumer.set_enabled(True, 0)

    def pass_by(sync: int | None, pdo: int | None, sync_at: int, pdo_at: int) -> list[int]:
        """SYNC and PDO with the transport's timestamps, handled at other times; return how late the PDO was."""
        consumer.out.timestamp = sync
        consumer.on_sync(None, sync_at)
        take_events(consumer.out)
        consumer.out.timestamp = pdo
        consumer.receive(Frame(0x20C, b"\x34\x12"), pdo_at)
        return [event.late for event in take_events(consumer.out) if isinstance(event, PdoTooLate)]

    assert pass_by(5000 * MS, 5001 * MS, 100 * MS, 150 * MS) == [], "we looked 50 ms after it"
    assert pass_by(5010 * MS, 5013 * MS, 170 * MS, 170 * MS) == [2 * MS], "both were handled at once, and it was late"
    assert pass_by(None, 5021 * MS, 180 * MS, 184 * MS) == [3 * MS], "our own SYNC: only our times are known"
    assert pass_by(5030 * MS, None, 190 * MS, 194 * MS) == [3 * MS]


def test_the_window_does_not_concern_event_driven_pdos() -> None:
    consumer = PdoConsumer(Outbox(), 12, 1, 0x20C, MAPPING, {})
    consumer.set_window(MS)
    consumer.set_enabled(True, 0)
    consumer.on_sync(None, 0)
    consumer.receive(Frame(0x20C, b"\x34\x12"), 5 * MS)
    assert [type(each) for each in consumer.out.events] == [PdoReceived]


# ---- in a device ----


def test_a_device_answers_requests_where_the_cob_id_allows_them() -> None:
    bench = DeviceBench()
    bench.node.set_value(INPUT, 0, 5, bench.now)
    assert bench.tell("185#R2") == []  # PDOs do not live
    assert bench.tell(START, "185#R2", "285#R2") == ["185#0500", "285#0500"]
    assert bench.write(0x1800, 1, 0x40000185, 4) is None  # bit 30 may change while the PDO is valid
    assert bench.tell("185#R2") == []
    assert bench.write(0x1800, 1, 0x185, 4) is None
    assert bench.tell("185#R2", PRE_OPERATIONAL, "185#R2") == ["185#0500"]


def test_types_252_and_253_of_a_device() -> None:
    bench = DeviceBench()
    assert bench.write(0x1800, 2, 252, 1) is None
    assert bench.write(0x1801, 2, 253, 1) is None
    bench.tell(START)
    bench.node.set_value(INPUT, 0, 5, bench.now)
    assert bench.tell(SYNC) == []
    bench.node.set_value(INPUT, 0, 6, bench.now)
    assert bench.take() == []
    assert bench.tell("185#R2", "285#R2") == ["185#0500", "285#0600"]
    assert bench.tell(SYNC, "185#R2") == ["185#0600"]


def test_whoever_writes_the_settings_of_a_running_pdo_loses_none_of_its_values() -> None:
    bench = DeviceBench()
    for index, subindex, value, size in [
        (0x1800, 1, 0x80000185, 4),
        (0x1800, 3, 1000, 2),  # 100 ms between two
        (0x1800, 1, 0x185, 4),
        (0x1400, 5, 50, 2),
    ]:
        assert bench.write(index, subindex, value, size) is None
    bench.tell(START)
    for value in (1, 2):
        bench.node.set_value(INPUT, 0, value, bench.now)
    assert bench.take() == ["185#0100"]
    assert bench.tell("305#0900", "205#0700") == []
    for index, subindex, value, size in [(0x1800, 5, 70, 2), (0x1800, 2, 255, 1), (0x1401, 5, 0, 2), (0x1400, 2, 255, 1)]:
        assert (bench.write(index, subindex, value, size), bench.others) == (None, [])
    assert bench.wait(60) == ["50 085#5082110100000000"]  # RPDO 1 is overdue
    assert bench.wait(60) == ["100 185#0200"]
    bench.tell(SYNC)
    assert bench.number(OUTPUT) == 9


class Clock(Machine):
    """An application that shows what time it is, in ms."""

    def __init__(self, out: Outbox, node: LocalNode) -> None:
        super().__init__(out)
        self.node = node

    def refresh(self, now: Time, index: int | None = None, subindex: int = 0) -> None:
        self.node.values.store[INPUT << 8] = now // MS

    def check_write(self, index: int, subindex: int, value: Value) -> None:
        return None

    def written(self, index: int, subindex: int, now: Time) -> None: ...

    def on_sync(self, now: Time) -> None: ...

    def connection_lost(self, now: Time, error_code: int) -> None: ...

    def reset(self, now: Time) -> None: ...


def test_an_application_is_up_to_date_when_it_is_asked() -> None:
    bench = DeviceBench()
    bench.node.application = Clock(bench.node.inner, bench.node)
    bench.tell(START)
    bench.wait(7)
    assert bench.tell("185#R2") == ["185#0700"]


def test_a_remote_node_asks_for_a_tpdo() -> None:
    pair = Pair()
    pair.local.set_value(INPUT, 0, 0x1234, pair.bus.now)
    pair.bus.sent.clear()
    consumer = pair.remote.add_tpdo(1, 0x185, Mapping([MappedEntry(INPUT, 0, 16, DataType.INTEGER16, "input")]), pair.bus.now)
    pair.device.receive(Frame.parse(START), pair.bus.now)
    assert consumer.request(pair.bus.now)
    pair.bus.run(MS)
    assert pair.bus.trace() == ["185#R2", "185#3412"]
    assert pair.remote.values.read("input") == 0x1234


def test_the_synchronous_window_of_a_device() -> None:
    bench = DeviceBench(io_device().with_objects([standard_object(0x1007, 2000)]))
    bench.tell(START, SYNC, "305#0100")
    bench.wait(2)
    bench.tell("305#0200")
    bench.wait(1)
    bench.tell("305#0300")
    assert [(each.number, each.late) for each in bench.seen(PdoTooLate)] == [(2, MS)]
    bench.tell(SYNC)
    assert bench.node.values.store[OUTPUT << 8] == 2
    assert bench.write(0x1007, 0, 0, 4) is None
    bench.wait(50)
    bench.tell("305#0400", SYNC)
    assert bench.node.values.store[OUTPUT << 8] == 4


def test_a_pdo_that_is_too_long_is_an_emcy_where_that_is_wished() -> None:
    bench = DeviceBench()
    bench.node.optional_emcy.add(0x8220)
    bench.tell(START)
    assert bench.tell("205#0700AA") == ["085#2082110100000000"]
    assert bench.node.values.store[OUTPUT << 8] == 7  # it is used all the same
    assert bench.tell("205#0800AA") == []  # told once
    assert bench.tell("205#08") == ["085#1082110100000000"]
    assert bench.tell("205#0800AA") == []  # not too short any more, but the other error lasts
    assert bench.number(0x1001) == 0x11
    assert bench.tell("205#0900") == ["085#0000000000000000"]
    assert bench.number(0x1001) == 0


def test_a_sync_of_another_length_is_an_emcy_where_that_is_wished() -> None:
    bench = DeviceBench()
    assert bench.tell("080#01") == []
    bench.node.optional_emcy.add(0x8240)
    assert bench.tell("080#01", "080#01") == ["085#4082110000000000"]
    assert bench.tell(SYNC) == ["085#0000000000000000"]
    assert bench.tell("000#0205", "080#01") == []  # SYNC does not live in STOPPED


def test_pdos_with_29_bit_can_ids() -> None:
    bench = DeviceBench()
    for index, cob_id in ((0x1400, 0x38000205), (0x1800, 0x38FF0001)):
        assert bench.write(index, 1, 0x80000000, 4) is None
        assert bench.write(index, 1, cob_id, 4) is None
    bench.tell(START)
    assert bench.tell("18000205#0700", "205#0800") == []
    assert bench.node.values.store[OUTPUT << 8] == 7
    bench.node.set_value(INPUT, 0, 9, bench.now)
    assert bench.take() == ["18FF0001#0900"]
    assert bench.tell("18FF0001#R2") == ["18FF0001#0900"]
    assert (0x18FF0001 | KEY_EXTENDED | KEY_REMOTE) in bench.network.can_ids()


# ---- 512 PDOs each way ----


def test_512_pdos_each_way() -> None:
    objects = []
    for number in range(512):
        objects += [
            standard_object(0x1400 + number, highest=2, defaults={1: 0x2000_1000 + number, 2: 1 if number % 2 else 255}),
            standard_object(0x1600 + number, highest=1, defaults={0: 1, 1: 0x20010010}),
            standard_object(0x1800 + number, highest=2, defaults={1: 0x2000_2000 + number, 2: 1 if number % 2 else 255}),
            standard_object(0x1A00 + number, highest=1, defaults={0: 1, 1: 0x20000010}),
        ]
    bench = DeviceBench(io_device().with_objects(objects))
    assert len(bench.node.pdos.consumers) == len(bench.node.pdos.producers) == 512
    bench.tell(START)
    bench.node.set_value(INPUT, 0, 1, bench.now)
    assert bench.take() == [f"{0x2000 + number:08X}#0100" for number in range(0, 512, 2)]
    assert bench.tell(SYNC) == [f"{0x2000 + number:08X}#0100" for number in range(1, 512, 2)]
    bench.tell(*(f"{0x1000 + number:08X}#{number:04X}" for number in range(512)))
    bench.tell(SYNC)
    received = bench.seen(PdoReceived)
    assert sorted(each.number for each in received) == list(range(1, 513))
    assert bench.write(0x19FF, 1, 0x80000000, 4) is None
    assert len(bench.tell(SYNC)) == 255
    assert bench.node.pdos.producers[512].key is None
