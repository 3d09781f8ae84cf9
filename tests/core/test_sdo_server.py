"""The SDO server: frames as in the standard, refusals, copies, time, NMT (CiA 301 v4.2.0, 7.2.4.3)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary.model import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.values import Values
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, FrameIgnored, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.sdo.server import (
    PENDING,
    TIMEOUT,
    ObjectStore,
    ObjectWritten,
    Pending,
    SdoServer,
    SdoServerAborted,
)
from canopen_proto.sdo.store import ValuesStore
from tests.core.bus import take_events, take_frames

DICTIONARY = ObjectDictionary(
    [
        Object.of("device_type", [Variable(0x1000, 0, "device_type", DataType.UNSIGNED32, Access.RO, 0x20192)]),
        Object.of("name", [Variable(0x1008, 0, "name", DataType.VISIBLE_STRING, Access.RO, "Hello world 1234")]),
        Object.of("heartbeat", [Variable(0x1017, 0, "heartbeat", DataType.UNSIGNED16)]),
        Object.of("blob", [Variable(0x2000, 3, "blob", DataType.DOMAIN)]),
        Object.of("third", [Variable(0x2001, 0, "third", DataType.UNSIGNED24)]),
        Object.of("mode", [Variable(0x6060, 0, "mode", DataType.INTEGER8, low_limit=-1, high_limit=10)]),
        Object.of("position", [Variable(0x607A, 0, "position", DataType.INTEGER64)]),
    ]
)


SERVED_BY_HOST = (0x1010, 0x2004)


class HostStore:
    """A ValuesStore, but two objects are the host's."""

    def __init__(self, values: Values) -> None:
        self.plain = ValuesStore(values)

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        return PENDING if index in SERVED_BY_HOST else self.plain.read(index, subindex, now)

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | None:
        return None if index in SERVED_BY_HOST else self.plain.check_write(index, subindex, size)

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        return PENDING if index in SERVED_BY_HOST else self.plain.write(index, subindex, data, now)


class Bench:
    """A server of node 12 that stands alone."""

    def __init__(self) -> None:
        self.out = Outbox()
        self.values = Values(DICTIONARY, 12)
        store: ObjectStore = HostStore(self.values)
        self.server = SdoServer(self.out, 12, store, max_download=100)
        self.now: Time = 0

    def ask(self, *requests: str) -> list[str]:
        """The responses to requests that come one millisecond after another."""
        for request in requests:
            self.now += MILLISECOND
            self.server.receive(Frame(0x60C, bytes.fromhex(request)), self.now)
        return take_frames(self.out)

    def events(self) -> list[Event]:
        return take_events(self.out)

    def outcome(self) -> Event:
        (report,) = self.events()
        return report

    def aborted(self) -> tuple[int, AbortOrigin]:
        report = self.outcome()
        assert isinstance(report, SdoServerAborted)
        assert self.server.deadline == NEVER
        assert not self.server.busy
        return report.abort_code, report.origin


def response(text: str) -> list[str]:
    return [f"58C#{text.replace(' ', '')}"]


@pytest.fixture
def bench() -> Bench:
    return Bench()


# ---- transfers ----


def test_expedited_upload(bench: Bench) -> None:
    assert bench.ask("40 00 10 00 00 00 00 00") == response("43 00 10 00 92 01 02 00")
    assert bench.ask("40 17 10 00") == response("4B 17 10 00 00 00 00 00")
    assert bench.ask("40 01 20 00") == response("47 01 20 00 00 00 00 00")
    assert bench.ask("40 60 60 00") == response("4F 60 60 00 00 00 00 00")
    assert bench.events() == []
    assert bench.server.deadline == NEVER
    assert bench.server.can_ids() == (0x60C,)


def test_segmented_upload(bench: Bench) -> None:
    assert bench.ask("40 08 10 00 00 00 00 00") == response("41 08 10 00 10 00 00 00")
    assert bench.server.busy
    assert bench.server.deadline == bench.now + TIMEOUT
    assert bench.ask("60 00 00 00 00 00 00 00") == response("00 48 65 6C 6C 6F 20 77")
    assert bench.ask("70 00 00 00 00 00 00 00") == response("10 6F 72 6C 64 20 31 32")
    assert bench.server.deadline == bench.now + TIMEOUT
    assert bench.ask("60 00 00 00 00 00 00 00") == response("0B 33 34 00 00 00 00 00")
    assert not bench.server.busy
    assert bench.server.deadline == NEVER


def test_an_upload_is_of_one_value_even_if_the_object_changes_meanwhile(bench: Bench) -> None:
    bench.ask("40 08 10 00 00 00 00 00", "60 00 00 00 00 00 00 00")
    bench.values.write(0x1008, "other")
    assert bench.ask("70 00 00 00 00 00 00 00") == response("10 6F 72 6C 64 20 31 32")


def test_nothing_at_all_goes_in_one_empty_segment(bench: Bench) -> None:
    assert bench.ask("40 00 20 03 00 00 00 00") == response("41 00 20 03 00 00 00 00")
    assert bench.ask("60 00 00 00 00 00 00 00") == response("0F 00 00 00 00 00 00 00")
    bench.values.store[0x200003] = b"old"
    assert bench.ask("21 00 20 03 00 00 00 00") == response("60 00 20 03 00 00 00 00")
    assert bench.ask("0F 00 00 00 00 00 00 00") == response("20 00 00 00 00 00 00 00")
    assert bench.values.store[0x200003] == b""
    assert bench.outcome() == ObjectWritten(12, 0x2000, 3)


@pytest.mark.parametrize(
    ("request_", "mux", "value"),
    [
        ("2F 60 60 00 06 00 00 00", 0x606000, 6),
        ("2B 17 10 00 E8 03 00 00", 0x101700, 1000),
        ("27 01 20 00 01 02 03 00", 0x200100, 0x030201),
        ("23 00 20 03 01 02 03 04", 0x200003, b"\x01\x02\x03\x04"),
        ("27 00 20 03 01 02 03 04", 0x200003, b"\x01\x02\x03"),
        ("2B 17 10 00 E8 03", 0x101700, 1000),  # short
        ("22 17 10 00 E8 03 00 00", 0x101700, 1000),  # size not indicated: as many as the object takes
        ("22 60 60 00 06 00 00 00", 0x606000, 6),
        ("22 01 20 00 01 02 03 00", 0x200100, 0x030201),
        ("22 00 20 03 01 02 03 04", 0x200003, b"\x01\x02\x03\x04"),
    ],
)
def test_expedited_download(bench: Bench, request_: str, mux: int, value: object) -> None:
    assert bench.ask(request_) == [f"58C#60{bytes.fromhex(request_)[1:4].hex().upper()}00000000"]
    assert bench.values.store[mux] == value
    assert bench.outcome() == ObjectWritten(12, mux >> 8, mux & 0xFF)
    assert bench.server.deadline == NEVER


@pytest.mark.parametrize("first", ["21 00 20 03 10 00 00 00", "20 00 20 03 00 00 00 00"])
def test_segmented_download(bench: Bench, first: str) -> None:
    assert bench.ask(first) == response("60 00 20 03 00 00 00 00")
    assert bench.ask("00 30 31 32 33 34 35 36") == response("20 00 00 00 00 00 00 00")
    assert bench.ask("10 37 38 39 61 62 63 64") == response("30 00 00 00 00 00 00 00")
    assert bench.server.deadline == bench.now + TIMEOUT
    assert bench.values.store[0x200003] == b""
    assert bench.ask("0B 65 66 00 00 00 00 00") == response("20 00 00 00 00 00 00 00")
    assert bench.values.store[0x200003] == b"0123456789abcdef"
    assert bench.outcome() == ObjectWritten(12, 0x2000, 3)
    assert bench.server.deadline == NEVER


def test_small_objects_may_be_written_in_segments_too(bench: Bench) -> None:
    assert bench.ask("21 17 10 00 02 00 00 00", "0B E8 03 00 00 00 00 00")[-1:] == response("20 00 00 00 00 00 00 00")
    assert bench.values.store[0x101700] == 1000
    bench.ask("21 17 10 00 02 00 00 00")
    assert bench.ask("0C E8 00 00 00 00 00 00") == response("20 00 00 00 00 00 00 00")
    assert bench.ask("1D 07 00 00 00 00 00 00") == response("30 00 00 00 00 00 00 00")
    assert bench.values.store[0x101700] == 0x07E8


# ---- refusals ----


@pytest.mark.parametrize(
    ("request_", "abort"),
    [
        ("40 01 10 00 00 00 00 00", 0x06020000),
        ("40 00 10 01 00 00 00 00", 0x06090011),
        ("23 00 10 00 00 00 00 00", 0x06010002),
        ("21 00 10 00 04 00 00 00", 0x06010002),  # trap 17: at the initiate already
        ("20 08 10 00 00 00 00 00", 0x06010002),
        ("23 17 10 00 01 00 00 00", 0x06070012),
        ("2F 17 10 00 01 00 00 00", 0x06070013),
        ("21 17 10 00 10 00 00 00", 0x06070012),
        ("21 7A 60 00 04 00 00 00", 0x06070013),
        ("22 7A 60 00 04 00 00 00", 0x06070013),
        ("22 00 10 00 04 00 00 00", 0x06010002),
        ("2F 60 60 00 0B 00 00 00", 0x06090031),  # trap 18
        ("2F 60 60 00 FE 00 00 00", 0x06090032),
        ("21 00 20 03 65 00 00 00", 0x05040005),
        ("A4 00 10 00 00 00 00 00", 0x05040002),
        ("A0 08 10 00 80 15 00 00", 0x05040002),
    ],
)
def test_refused_at_the_initiate_with_the_right_multiplexer(bench: Bench, request_: str, abort: int) -> None:
    code = abort.to_bytes(4, "little").hex().upper()
    before = dict(bench.values.store)
    assert bench.ask(request_) == [f"58C#80{bytes.fromhex(request_)[1:4].hex().upper()}{code}"]
    assert bench.aborted() == (abort, AbortOrigin.LOCAL)
    assert bench.values.store == before


@pytest.mark.parametrize("request_", ["60", "70", "00 00 00 00 00 00 00 00", "0F", "A1", "A2 01 7F", "A3", "C1", "E0 00 10 00"])
def test_trap_16_without_a_transfer_a_segment_is_an_abort_for_no_object(bench: Bench, request_: str) -> None:
    expected = response("80 00 00 00 01 00 04 05")
    assert bench.ask(request_) == expected
    assert bench.outcome() == SdoServerAborted(12, 0, 0, 0x05040001, AbortOrigin.LOCAL)
    bench.ask("40 00 20 03", "60")
    assert bench.ask(request_) == expected  # after the end as well
    assert bench.aborted() == (0x05040001, AbortOrigin.LOCAL)


@pytest.mark.parametrize(
    ("segments", "abort"),
    [
        (["0F 00 00 00 00 00 00 00"], 0x06070013),
        (["01 30 31 32 33 34 35 36"], 0x06070013),
        (["00 30 31 32 33 34 35 36", "10 30 31 32 33 34 35 36", "09 30 31 32 00 00 00 00"], 0x06070012),
        (["00 30 31 32 33 34 35 36", "10 30 31 32 33 34 35 36", "00 30 31 32 33 34 35 36"], 0x06070012),
        (["10 30 31 32 33 34 35 36"], 0x05030000),
        (["00 30 31 32 33 34 35 36", "00 37 38 39 30 31 32 33"], 0x05030000),
        (["0E 00 00 00 00 00 00 00"], 0x05040001),
        (["60 00 00 00 00 00 00 00"], 0x05040001),
        (["A1 00 00 00 00 00 00 00"], 0x05040001),
        (["E0 00 00 00 00 00 00 00"], 0x05040001),
    ],
)
def test_trap_17_faults_among_download_segments(bench: Bench, segments: list[str], abort: int) -> None:
    bench.ask("21 00 20 03 10 00 00 00")
    code = abort.to_bytes(4, "little").hex().upper()
    assert bench.ask(*segments)[-1] == f"58C#80002003{code}"
    assert bench.aborted() == (abort, AbortOrigin.LOCAL)
    assert bench.values.store[0x200003] == b""


@pytest.mark.parametrize(
    ("requests", "abort"),
    [
        (["70"], 0x05030000),
        (["60", "60 00 00 00 00 00 00 01"], 0x05030000),
        (["00 30 31 32 33 34 35 36"], 0x05040001),
        (["A3"], 0x05040001),
    ],
)
def test_faults_among_upload_segments(bench: Bench, requests: list[str], abort: int) -> None:
    bench.ask("40 08 10 00")
    code = abort.to_bytes(4, "little").hex().upper()
    assert bench.ask(*requests)[-1] == f"58C#80081000{code}"
    assert bench.aborted() == (abort, AbortOrigin.LOCAL)


def test_the_size_that_was_not_announced_is_checked_at_the_end(bench: Bench) -> None:
    assert bench.ask("20 17 10 00", "01 30 31 32 33 34 35 36")[-1] == "58C#8017100012000706"
    assert bench.ask("20 17 10 00", "0D 30 00 00 00 00 00 00")[-1] == "58C#8017100013000706"
    assert bench.values.store[0x101700] == 0


def test_no_download_fills_the_memory(bench: Bench) -> None:
    bench.ask("20 00 20 03")
    toggle = 0
    for _ in range(14):
        bench.ask(f"{toggle:02X} 30 31 32 33 34 35 36")
        toggle ^= 0x10
    assert bench.ask(f"{toggle:02X} 30 31 32 33 34 35 36") == response("80 00 20 03 05 00 04 05")


@pytest.mark.parametrize("request_", ["", "40", "40 00 10", "2F 60 60 00", "00 30 31", "80 00 10"])
def test_requests_too_short_to_be_one_are_ignored(bench: Bench, request_: str) -> None:
    bench.ask("21 00 20 03 10 00 00 00")
    assert bench.ask(request_) == []
    assert isinstance(bench.outcome(), FrameIgnored)
    assert bench.server.busy


# ---- aborts, restarts, copies, time ----


@pytest.mark.parametrize("abort", ["80 08 10 00 00 00 04 05", "80 00 00 00 00 00 04 05"])
def test_trap_17_an_abort_ends_the_transfer(bench: Bench, abort: str) -> None:
    bench.ask("40 08 10 00")
    assert bench.ask(abort) == []
    assert bench.outcome() == SdoServerAborted(12, 0x1008, 0, 0x05040000, AbortOrigin.PEER)
    assert bench.server.deadline == NEVER
    assert bench.ask(abort) == []
    assert bench.events() == []
    assert bench.ask("60") == response("80 00 00 00 01 00 04 05")


@pytest.mark.parametrize("first", ["40 08 10 00", "21 00 20 03 10 00 00 00"])
def test_a_new_initiate_takes_the_place_of_a_running_transfer(bench: Bench, first: str) -> None:
    index, subindex = int.from_bytes(bytes.fromhex(first)[1:3], "little"), bytes.fromhex(first)[3]
    bench.ask(first)
    assert bench.ask("40 00 10 00") == response("43 00 10 00 92 01 02 00")
    assert bench.outcome() == SdoServerAborted(12, index, subindex, 0x08000000, AbortOrigin.REPLACED)
    assert bench.server.deadline == NEVER
    bench.ask(first)
    assert bench.ask("2B 17 10 00 01 00 00 00") == response("60 17 10 00 00 00 00 00")
    bench.ask(first)
    assert bench.ask("A4 00 10 00 7F") == response("C6 00 10 00 04 00 00 00")


def test_a_repeated_initiate_is_answered_again(bench: Bench) -> None:
    assert bench.ask("40 08 10 00", "40 08 10 00") == response("41 08 10 00 10 00 00 00") * 2
    assert bench.events() == []
    assert bench.ask("60") == response("00 48 65 6C 6C 6F 20 77")
    assert bench.ask("40 08 10 00") == response("41 08 10 00 10 00 00 00")
    assert bench.ask("60") == response("00 48 65 6C 6C 6F 20 77")


def test_the_second_copy_of_a_segment_is_ignored_and_a_third_is_not(bench: Bench) -> None:
    bench.ask("40 08 10 00", "60")
    bench.events()
    assert bench.ask("60") == []
    assert isinstance(bench.outcome(), FrameIgnored)
    assert bench.ask("70", "70") == response("10 6F 72 6C 64 20 31 32")
    assert bench.ask("70") == response("80 08 10 00 00 00 03 05")
    bench.ask("21 00 20 03 10 00 00 00")
    assert len(bench.ask("00 30 31 32 33 34 35 36", "00 30 31 32 33 34 35 36", "10 37 38 39 61 62 63 64")) == 2
    bench.ask("0B 65 66 00 00 00 00 00")
    assert bench.values.store[0x200003] == b"0123456789abcdef"


def test_a_client_that_falls_silent_costs_its_transfer_only(bench: Bench) -> None:
    bench.ask("40 08 10 00", "60")
    bench.server.handle_timeout(bench.now + TIMEOUT - 1)
    assert bench.ask() == []
    bench.server.handle_timeout(bench.now + TIMEOUT)
    assert bench.ask() == response("80 08 10 00 00 00 04 05")
    assert bench.aborted() == (0x05040000, AbortOrigin.TIMEOUT)
    assert bench.ask("40 00 10 00") == response("43 00 10 00 92 01 02 00")
    bench.server.handle_timeout(bench.now + 100 * SECOND)
    assert bench.ask() == []


def test_a_client_that_never_alternates_is_found_out_at_the_latest_by_the_timeout(bench: Bench) -> None:
    bench.ask("40 08 10 00", "60", "60")
    bench.events()
    bench.server.handle_timeout(bench.server.deadline)
    assert bench.aborted() == (0x05030000, AbortOrigin.TIMEOUT)


# ---- NMT ----


def test_trap_19_a_disabled_server_is_silent(bench: Bench) -> None:
    bench.ask("40 08 10 00")
    bench.server.disable()
    bench.server.disable()
    assert bench.server.can_ids() == ()
    assert bench.out.rerouted == [bench.server]
    assert bench.outcome() == SdoServerAborted(12, 0x1008, 0, 0x08000022, AbortOrigin.CANCELLED)
    assert bench.ask("40 00 10 00", "60") == []
    assert bench.events() == []
    assert bench.server.deadline == NEVER
    bench.server.enable()
    bench.server.enable()
    assert bench.server.can_ids() == (0x60C,)
    assert bench.ask("60") == response("80 00 00 00 01 00 04 05")
    assert bench.ask("40 00 10 00") == response("43 00 10 00 92 01 02 00")


def test_reset_forgets_the_transfer(bench: Bench) -> None:
    bench.server.reset()
    assert bench.events() == []
    bench.ask("21 00 20 03 10 00 00 00", "00 30 31 32 33 34 35 36")
    bench.server.reset()
    assert bench.aborted() == (0x08000022, AbortOrigin.CANCELLED)
    assert bench.server.enabled


# ---- anything at all ----


@given(st.lists(st.one_of(st.binary(max_size=8), st.integers(0, 2 * TIMEOUT)), max_size=60))
def test_no_bytes_make_it_raise(steps: list[bytes | int]) -> None:
    bench = Bench()
    for step in steps:
        if isinstance(step, bytes):
            bench.server.receive(Frame(0x60C, step), bench.now)
        else:
            bench.now += step
            bench.server.handle_timeout(bench.now)
        assert (bench.server.deadline == NEVER) == (not bench.server.busy)
    assert all(len(frame.data) == 8 and frame.can_id == 0x58C for frame in bench.out.frames)
    assert len(bench.out.frames) <= len(steps)


def test_a_timeout_that_was_made_shorter_meanwhile_wakes_the_driver_in_time() -> None:
    """In a network: it must never wake later than the server's deadline."""
    network = Network()
    server = SdoServer(network.out, 12, HostStore(Values(DICTIONARY, 12)))
    network.attach(server)
    for now, request in enumerate(["40 08 10 00", "60", "70", "60", "21 00 20 03 0A 00 00 00", "00 30 31 32 33 34 35 36"]):
        server.timeout //= 2
        network.receive(Frame(0x60C, bytes.fromhex(request)), now)
        assert not server.busy or network.next_deadline() == server.deadline == now + server.timeout
    assert server.busy
