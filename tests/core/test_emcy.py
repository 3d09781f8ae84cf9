"""EMCY producer and consumer, the error register and history, and the texts of the error codes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from canopen_proto.emcy import MAX_ACTIVE, MAX_PENDING, EmcyConsumer, EmcyDropped, EmcyProducer, EmcyReceived, EmcySent
from canopen_proto.error_codes import ERROR_TEXTS, ErrorRegister, error_text, register_bits_of, register_names
from canopen_proto.frame import EXTENDED, Frame
from canopen_proto.machine import MILLISECOND as MS
from canopen_proto.machine import NEVER, Event, FrameIgnored, LocalProtocolError, Outbox


def take(out: Outbox) -> tuple[list[str], list[Event]]:
    frames, events = [str(frame) for frame in out.frames], list(out.events)
    out.frames.clear()
    out.events.clear()
    return frames, events


def sent(out: Outbox) -> list[str]:
    return take(out)[0]


# producer


def test_one_error_comes_and_goes() -> None:
    """The exchange that CANopenNode's demo device (node 4) had when it lost the heartbeat of node 10."""
    producer = EmcyProducer(Outbox(), 4)
    producer.raise_error(0x8130, 0x10, bytes.fromhex("1B00000000"), 0, additional_info=0x1B10)
    assert take(producer.out) == (["084#3081111B00000000"], [EmcySent(4, 0x8130, 0x11, b"\x1b\0\0\0\0")])
    assert (producer.error_register, list(producer.history)) == (0x11, [0x1B10_8130])
    producer.clear(0x8130, 1, additional_info=0x1B10)
    assert take(producer.out) == (["084#0000000000000000"], [EmcySent(4, 0, 0, bytes(5))])
    assert (producer.error_register, list(producer.history), producer.active) == (0, [0x1B10_8130], ())


def test_concurrent_errors_share_the_register_and_reset_with_the_last() -> None:
    producer = EmcyProducer(Outbox(), 5)
    producer.raise_error(0x3220, 0x04, b"", 0)
    producer.raise_error(0x8611, 0x20, b"\x01", 0)
    assert sent(producer.out) == ["085#2032050000000000", "085#1186250100000000"]
    assert producer.active == (0x3220, 0x8611)
    producer.clear(0x3220, 1)
    assert (sent(producer.out), producer.error_register) == ([], 0x21)
    producer.clear(0x8611, 2)
    assert (sent(producer.out), producer.error_register) == (["085#0000000000000000"], 0)
    assert list(producer.history) == [0x8611, 0x3220]  # newest first


def test_an_error_is_told_once_while_it_lasts() -> None:
    producer = EmcyProducer(Outbox(), 5)
    for _ in range(3):
        producer.raise_error(0x4210, 0x08, b"", 0)
    assert sent(producer.out) == ["085#1042090000000000"]
    producer.clear(0x4210, 1)
    producer.clear(0x4210, 2)
    producer.clear(0x1000, 3)
    assert sent(producer.out) == ["085#0000000000000000"]
    producer.raise_error(0x4210, 0x08, b"", 4)
    assert sent(producer.out) == ["085#1042090000000000"]
    assert list(producer.history) == [0x4210, 0x4210]


def test_errors_of_one_code_are_told_apart_by_their_additional_information() -> None:
    producer = EmcyProducer(Outbox(), 5)
    producer.raise_error(0x8130, 0x10, b"\x0a", 0, additional_info=10)
    producer.raise_error(0x8130, 0x10, b"\x0b", 0, additional_info=11)
    assert sent(producer.out) == ["085#3081110A00000000", "085#3081110B00000000"]
    producer.clear(0x8130, 1, additional_info=10)
    assert (sent(producer.out), producer.active, producer.error_register) == ([], (11 << 16 | 0x8130,), 0x11)


def clear_all(producer: EmcyProducer, now: int) -> None:
    for entry in producer.active:
        producer.clear(entry & 0xFFFF, now, entry >> 16)


def test_the_end_of_the_last_error_is_one_frame() -> None:
    producer = EmcyProducer(Outbox(), 5)
    clear_all(producer, 0)
    assert sent(producer.out) == []
    producer.raise_error(0x2310, 0x02, b"", 0)
    producer.raise_error(0x3210, 0x04, b"", 0)
    sent(producer.out)
    clear_all(producer, 1)
    assert (sent(producer.out), producer.error_register, producer.active) == (["085#0000000000000000"], 0, ())


def test_history_is_bounded_newest_first_and_can_be_cleared() -> None:
    producer = EmcyProducer(Outbox(), 5, history_length=3)
    for code in (0x1001, 0x1002, 0x1003, 0x1004):
        producer.raise_error(code, 0, b"", 0)
    assert list(producer.history) == [0x1004, 0x1003, 0x1002]
    producer.clear_history()
    assert (list(producer.history), len(producer.active)) == ([], 4)


def test_inhibit_time_spaces_the_frames_in_order() -> None:
    producer = EmcyProducer(Outbox(), 5)
    producer.set_inhibit_time(10 * MS, 0)
    producer.raise_error(0x1001, 0, b"", 0)
    producer.raise_error(0x1002, 0, b"", 1 * MS)
    clear_all(producer, 2 * MS)
    assert sent(producer.out) == ["085#0110010000000000"]
    producer.handle_timeout(10 * MS - 1)  # early
    assert (sent(producer.out), producer.deadline) == ([], 10 * MS)
    producer.handle_timeout(10 * MS)
    assert (sent(producer.out), producer.deadline) == (["085#0210010000000000"], 20 * MS)
    producer.raise_error(0x1003, 0, b"", 25 * MS)  # the driver is late: what waits goes first
    assert sent(producer.out) == []
    producer.handle_timeout(26 * MS)
    assert (sent(producer.out), producer.deadline) == (["085#0000000000000000"], 36 * MS)
    producer.handle_timeout(36 * MS)
    assert (sent(producer.out), producer.deadline) == (["085#0310010000000000"], NEVER)
    clear_all(producer, 100 * MS)
    assert (sent(producer.out), producer.deadline) == (["085#0000000000000000"], NEVER)


def test_queue_is_bounded_and_says_what_it_dropped() -> None:
    producer = EmcyProducer(Outbox(), 5, history_length=254)
    producer.set_inhibit_time(10 * MS, 0)
    for number in range(MAX_PENDING + 3):
        producer.raise_error(0x2000 + number, 0x02, b"", 0)
    _, events = take(producer.out)
    assert [dropped for dropped in events if isinstance(dropped, EmcyDropped)] == [EmcyDropped(5, 0x2001), EmcyDropped(5, 0x2002)]
    assert len(producer.history) == MAX_PENDING + 3
    told = 0
    while producer.deadline < NEVER:
        producer.handle_timeout(producer.deadline)
        told += len(sent(producer.out))
    assert told == MAX_PENDING


def test_errors_are_bounded() -> None:
    producer = EmcyProducer(Outbox(), 5)
    for number in range(MAX_ACTIVE):
        producer.raise_error(0x8210, 0x10, b"", 0, additional_info=number)
    take(producer.out)
    producer.raise_error(0x8220, 0x10, b"", 0)
    assert take(producer.out) == ([], [EmcyDropped(5, 0x8220)])
    assert len(producer.active) == MAX_ACTIVE


def test_in_stopped_nothing_is_sent_and_afterwards_the_most_recent() -> None:
    producer = EmcyProducer(Outbox(), 5)
    producer.set_enabled(False, 0)
    producer.raise_error(0x3210, 0x04, b"", 0)
    producer.raise_error(0x4210, 0x08, b"", 0)
    assert (sent(producer.out), producer.deadline, producer.error_register) == ([], NEVER, 0x0D)
    producer.set_enabled(True, 1)
    assert sent(producer.out) == ["085#10420D0000000000"]
    producer.set_enabled(True, 2)
    producer.set_enabled(False, 3)
    producer.set_enabled(True, 4)
    assert sent(producer.out) == []


def test_an_error_that_is_gone_again_in_stopped_is_not_told_as_the_present_one() -> None:
    producer = EmcyProducer(Outbox(), 5)
    producer.raise_error(0x3210, 0x04, b"", 0)
    assert sent(producer.out) == ["085#1032050000000000"]
    producer.set_enabled(False, 1)
    producer.raise_error(0x4210, 0x08, b"\x07", 2)
    producer.raise_error(0x8130, 0x10, b"\x05", 3, additional_info=5)
    producer.raise_error(0x8130, 0x10, b"\x06", 3, additional_info=6)
    producer.clear(0x8130, 4, additional_info=6)
    producer.clear(0x8130, 4, additional_info=5)
    producer.set_enabled(True, 5)
    assert sent(producer.out) == ["085#10420D0700000000"]
    producer.set_enabled(False, 6)
    producer.raise_error(0x8130, 0x10, b"\x05", 7, additional_info=5)
    producer.clear(0x8130, 8, additional_info=5)
    producer.set_enabled(True, 9)
    assert sent(producer.out) == []  # what is still present was told before
    producer.set_enabled(False, 10)
    for _ in range(MAX_PENDING + 1):
        clear_all(producer, 11)
        producer.raise_error(0x1001, 0, b"", 12)
    clear_all(producer, 13)
    producer.set_enabled(True, 14)
    assert take(producer.out) == (["085#0000000000000000"], [EmcySent(5, 0, 0, bytes(5))])  # and none was dropped


def test_inhibited_frames_wait_through_stopped() -> None:
    producer = EmcyProducer(Outbox(), 5)
    producer.set_inhibit_time(10 * MS, 0)
    producer.raise_error(0x1001, 0, b"", 0)
    producer.raise_error(0x1002, 0, b"", 0)
    take(producer.out)
    producer.set_enabled(False, 1 * MS)
    producer.handle_timeout(50 * MS)
    assert sent(producer.out) == []
    producer.set_enabled(True, 2 * MS)
    assert (sent(producer.out), producer.deadline) == ([], 10 * MS)
    producer.handle_timeout(10 * MS)
    assert sent(producer.out) == ["085#0210010000000000"]


def test_cob_id_valid_bit_and_29_bits() -> None:
    producer = EmcyProducer(Outbox(), 5)
    producer.set_inhibit_time(10 * MS, 0)
    producer.raise_error(0x1001, 0, b"", 0)
    producer.raise_error(0x1002, 0, b"", 0)
    take(producer.out)
    producer.set_cob_id(0x8000_0085, 1 * MS)
    assert (producer.key, producer.deadline) == (None, NEVER)
    producer.raise_error(0x1003, 0, b"", 20 * MS)
    assert (take(producer.out), producer.error_register) == (([], []), 0x01)
    producer.set_cob_id(0x2001_2345, 30 * MS)
    producer.raise_error(0x1004, 0, b"", 40 * MS)
    assert producer.out.frames == [Frame(0x12345, bytes.fromhex("0410010000000000"), EXTENDED)]
    other = EmcyProducer(Outbox(), 5, key=0xA5)
    other.raise_error(0x1000, 0, b"", 0)
    assert sent(other.out) == ["0A5#0010010000000000"]


def test_reset_is_as_after_power_on() -> None:
    producer = EmcyProducer(Outbox(), 5)
    producer.set_inhibit_time(10 * MS, 0)
    producer.raise_error(0x1001, 0, b"", 0)
    producer.raise_error(0x1002, 0, b"", 0)
    take(producer.out)
    producer.reset()
    producer.handle_timeout(100 * MS)
    assert take(producer.out) == ([], [])
    assert (producer.active, list(producer.history), producer.error_register, producer.deadline) == ((), [], 0, NEVER)
    assert (producer.inhibit_time, producer.key) == (10 * MS, 0x85)


@pytest.mark.parametrize(
    ("code", "bits", "vendor_data", "info", "message"),
    [
        (0x0000, 0, b"", 0, "error code 0x0000"),
        (0x00FF, 0, b"", 0, "error code 0x00FF"),
        (0x10000, 0, b"", 0, "error code 0x10000"),
        (0x1000, 0x40, b"", 0, "bit 6 is reserved"),
        (0x1000, 0x100, b"", 0, "only bits 0 to 7 exist"),
        (0x1000, -1, b"", 0, "only bits 0 to 7 exist"),
        (0x1000, 0, bytes(6), 0, "5 bytes for the manufacturer, not 6"),
        (0x1000, 0, b"", 0x10000, "more than 16 bits"),
    ],
)
def test_our_callers_faults_change_nothing(code: int, bits: int, vendor_data: bytes, info: int, message: str) -> None:
    producer = EmcyProducer(Outbox(), 5)
    with pytest.raises(LocalProtocolError, match=message):
        producer.raise_error(code, bits, vendor_data, 0, additional_info=info)
    assert (take(producer.out), producer.error_register, list(producer.history)) == (([], []), 0, [])


def test_other_faults_of_our_caller() -> None:
    producer = EmcyProducer(Outbox(), 5)
    with pytest.raises(LocalProtocolError, match="less than 0"):
        producer.set_inhibit_time(-1, 0)
    with pytest.raises(LocalProtocolError, match="error code 0x0000"):
        producer.clear(0, 0)
    for length in (0, 255):
        with pytest.raises(LocalProtocolError, match="1 to 254 entries"):
            EmcyProducer(Outbox(), 5, history_length=length)
    for make in (EmcyProducer, EmcyConsumer):
        with pytest.raises(LocalProtocolError, match="node-ID 128"):
            make(Outbox(), 128)


CODES = st.sampled_from([0x1000, 0x2310, 0x3220, 0x8130])


class EmcyOverTime(RuleBasedStateMachine):
    """Producer -> consumer against a set of errors. Whatever the order and the lateness, the last frame told the last truth."""

    @initialize(inhibit=st.sampled_from([0, 10 * MS]))
    def begin(self, inhibit: int) -> None:
        self.now, self.last_sent = 0, -NEVER
        self.inhibit = inhibit
        self.producer = EmcyProducer(Outbox(), 5, history_length=4)
        self.producer.set_inhibit_time(inhibit, 0)
        self.consumer = EmcyConsumer(Outbox(), 5)
        self.errors: list[int] = []
        self.history: list[int] = []

    def carry(self) -> None:
        for frame in self.producer.out.frames:
            assert self.now - self.last_sent >= self.inhibit
            self.last_sent = self.now
            self.consumer.receive(frame, self.now)
            (received,) = take(self.consumer.out)[1]
            assert isinstance(received, EmcyReceived)
        take(self.producer.out)

    @rule(code=CODES, info=st.integers(0, 1))
    def raise_error(self, code: int, info: int) -> None:
        self.producer.raise_error(code, register_bits_of(code), b"", self.now, additional_info=info)
        if info << 16 | code not in self.errors:
            self.errors.append(info << 16 | code)
            self.history.insert(0, info << 16 | code)
        self.carry()

    @rule(code=CODES, info=st.integers(0, 1))
    def clear(self, code: int, info: int) -> None:
        self.producer.clear(code, self.now, additional_info=info)
        if info << 16 | code in self.errors:
            self.errors.remove(info << 16 | code)
        self.carry()

    @rule()
    def clear_all(self) -> None:
        clear_all(self.producer, self.now)
        self.errors.clear()
        self.carry()

    @rule(enabled=st.booleans())
    def nmt_state(self, enabled: bool) -> None:
        """Behind Stopped "the most recent active EMCY reason" is sent (CiA 301 v4.2.0, 7.3.2.2.4), and no other."""
        was_stopped = not self.producer.enabled
        self.producer.set_enabled(enabled, self.now)
        for frame in self.producer.out.frames if was_stopped else ():
            code, register = int.from_bytes(frame.data[:2], "little"), frame.data[2]
            present = [error & 0xFFFF for error in self.errors]
            assert code in present if present else code == 0, f"{code:04X} is told, present are {present}"
            assert register == self.producer.error_register
        self.carry()

    @rule(step=st.integers(0, 30))
    def time_passes(self, step: int) -> None:
        self.now += step * MS
        self.producer.handle_timeout(self.now)
        self.carry()

    @invariant()
    def agrees(self) -> None:
        if not hasattr(self, "now"):
            return
        assert list(self.producer.active) == self.errors
        register = 0
        for error in self.errors:
            register |= register_bits_of(error & 0xFFFF)
        assert self.producer.error_register == register
        assert list(self.producer.history) == self.history[:4]
        idle = self.producer.enabled and self.producer.deadline == NEVER
        if idle and self.consumer.last is not None:
            assert (self.consumer.last.code == 0) == (not self.errors)


TestEmcyOverTime = EmcyOverTime.TestCase


# consumer


def test_consumer_reports_code_register_data_and_text() -> None:
    consumer = EmcyConsumer(Outbox(), 5)
    assert list(consumer.can_ids()) == [0x85]
    consumer.out.timestamp = 99
    consumer.receive(Frame.parse("085#1186210102030405"), 0)
    expected = EmcyReceived(5, 0x8611, 0x21, b"\1\2\3\4\5", "following error", 8, 99)
    assert take(consumer.out) == ([], [expected])
    assert consumer.last == expected


@pytest.mark.parametrize(
    ("text", "code", "register", "vendor_data"),
    [
        ("085#2032", 0x3220, 0, "0000000000"),
        ("085#203205", 0x3220, 5, "0000000000"),
        ("085#203205AABB", 0x3220, 5, "AABB000000"),
        ("085#203205AABBCCDD", 0x3220, 5, "AABBCCDD00"),
    ],
)
def test_short_frames_are_filled_up_and_not_lost(text: str, code: int, register: int, vendor_data: str) -> None:
    """The peer's struct refuses them, and the emergency is lost."""
    consumer = EmcyConsumer(Outbox(), 5)
    frame = Frame.parse(text)
    consumer.receive(frame, 0)
    expected = EmcyReceived(5, code, register, bytes.fromhex(vendor_data), "DC link under-voltage", frame.dlc, None)
    assert take(consumer.out)[1] == [expected]


@pytest.mark.parametrize("text", ["085#", "085#20", "085#R8"])
def test_frames_without_a_code_are_reported(text: str) -> None:
    consumer = EmcyConsumer(Outbox(), 5, key=0x85)
    consumer.receive(Frame.parse(text), 0)
    (ignored,) = take(consumer.out)[1]
    assert isinstance(ignored, FrameIgnored)
    assert (ignored.node_id, consumer.last) == (5, None)


def test_error_reset_is_an_emergency_with_its_own_text() -> None:
    consumer = EmcyConsumer(Outbox(), 5)
    consumer.receive(Frame.parse("085#0000000000000000"), 0)
    assert take(consumer.out)[1] == [EmcyReceived(5, 0, 0, bytes(5), "error reset or no error", 8, None)]


@given(st.lists(st.binary(max_size=9)))
def test_no_bytes_make_the_consumer_raise(payloads: list[bytes]) -> None:
    consumer = EmcyConsumer(Outbox(), 5)
    for data in payloads:
        consumer.receive(Frame(0x85, data), 0)
        assert len(take(consumer.out)[1]) == 1


# meanings


@pytest.mark.parametrize(
    ("code", "text"),
    [
        (0x0000, "error reset or no error"),
        (0x0010, "error reset or no error"),
        (0x0100, "unknown error"),
        (0x0FFF, "unknown error"),
        (0x10AB, "generic error"),
        (0x2310, "continuous over-current, output side"),
        (0x2315, "continuous over-current, output side"),
        (0x2399, "current, device output side"),
        (0x2999, "current"),
        (0x3220, "DC link under-voltage"),
        (0x3221, "under-voltage inside the device, no. 1"),
        (0x4310, "drive temperature too high"),
        (0x6010, "software reset by watchdog"),
        (0x630F, "data set no. 15"),
        (0x7305, "incremental sensor 1 fault"),
        (0x8110, "CAN overrun, objects lost"),
        (0x8120, "CAN in error passive mode"),
        (0x8130, "life guard error or heartbeat error"),
        (0x8140, "recovered from bus off"),
        (0x8210, "PDO not processed because of its length"),
        (0x8220, "PDO length exceeded"),
        (0x8240, "unexpected SYNC data length"),
        (0x8250, "RPDO timeout"),
        (0x8611, "following error"),
        (0x8613, "positioning controller"),
        (0x9001, "external error"),
        (0xA000, "unknown error"),
        (0xF001, "deceleration"),
        (0xFF42, "device-specific"),
        (-1, "unknown error"),
        (0x1_3220, "unknown error"),
    ],
)
def test_error_texts(code: int, text: str) -> None:
    assert error_text(code) == text


def test_every_code_has_a_text_and_bits() -> None:
    for code in range(0x10000):
        assert error_text(code)
        bits = register_bits_of(code)
        assert bits & ErrorRegister.GENERIC
        assert not bits & ~0xBF
    assert all(text == text.strip() for text in ERROR_TEXTS.values())


@pytest.mark.parametrize(
    ("code", "bits"),
    [
        (0x1000, 0x01),
        (0x2310, 0x03),
        (0x3220, 0x05),
        (0x4210, 0x09),
        (0x5530, 0x01),
        (0x8130, 0x11),
        (0x8210, 0x11),
        (0x8611, 0x21),
        (0xFF01, 0x81),
    ],
)
def test_register_bits_of_a_code(code: int, bits: int) -> None:
    assert register_bits_of(code) == bits


def test_register_names() -> None:
    assert register_names(0) == ()
    assert register_names(0x11) == ("generic", "communication")
    all_names = ("generic", "current", "voltage", "temperature", "communication", "device profile", "reserved", "manufacturer")
    assert register_names(0xFF) == all_names
