"""Accesses that only the host can serve: the server holds its answer (design: the host answers, it is not called back)."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.machine import NEVER, FrameIgnored, LocalProtocolError
from canopen_proto.sdo.server import ACCESS_TIMEOUT, TIMEOUT, ObjectAccessPending, ObjectWritten, SdoServerAborted
from tests.core.test_sdo_server import Bench, response


@pytest.fixture
def bench() -> Bench:
    return Bench()


def pending(bench: Bench) -> ObjectAccessPending:
    report = bench.outcome()
    assert isinstance(report, ObjectAccessPending)
    return report


def test_a_read_that_the_host_serves(bench: Bench) -> None:
    assert bench.ask("40 10 10 01") == []
    access = pending(bench)
    assert access == ObjectAccessPending(12, access.access_id, 0x1010, 1, None)
    assert bench.server.deadline == bench.now + ACCESS_TIMEOUT
    assert bench.server.complete(access.access_id, b"\x01\x00\x00\x00", bench.now)
    assert bench.ask() == response("43 10 10 01 01 00 00 00")
    assert bench.server.deadline == NEVER
    assert not bench.server.busy
    assert not bench.server.complete(access.access_id, b"\x01\x00\x00\x00", bench.now)


def test_a_long_read_that_the_host_serves(bench: Bench) -> None:
    bench.ask("40 04 20 00")
    assert bench.server.complete(pending(bench).access_id, b"Hello", bench.now)
    assert bench.server.deadline == bench.now + TIMEOUT
    assert bench.ask("60") == [*response("41 04 20 00 05 00 00 00"), *response("05 48 65 6C 6C 6F 00 00")]


def test_the_host_has_its_own_time_for_each_piece(bench: Bench) -> None:
    bench.ask("40 04 20 00")
    bench.server.complete(pending(bench).access_id, b"0123456", bench.now, more=True, size=9)
    assert bench.server.deadline == bench.now + TIMEOUT
    assert bench.ask("60") == response("41 04 20 00 09 00 00 00")  # the segment has to wait: it may be the last one
    access = pending(bench)
    assert bench.server.deadline == bench.now + ACCESS_TIMEOUT
    bench.server.complete(access.access_id, b"78", bench.now)
    assert bench.ask("70") == [*response("00 30 31 32 33 34 35 36"), *response("1B 37 38 00 00 00 00 00")]


def test_a_write_that_the_host_serves(bench: Bench) -> None:
    assert bench.ask("23 10 10 01 73 61 76 65") == []
    access = pending(bench)
    assert access.data == b"save"
    assert bench.server.complete(access.access_id, None, bench.now)
    assert bench.ask() == response("60 10 10 01 00 00 00 00")
    assert bench.outcome() == ObjectWritten(12, 0x1010, 1)
    assert bench.server.deadline == NEVER


def test_a_long_write_that_the_host_serves_holds_back_the_last_acknowledgement(bench: Bench) -> None:
    assert bench.ask("21 04 20 00 09 00 00 00", "00 30 31 32 33 34 35 36")[-1:] == response("20" + "00" * 7)
    assert bench.ask("1B 37 38 00 00 00 00 00") == []
    access = pending(bench)
    assert access.data == b"012345678"
    assert bench.ask("1B 37 38 00 00 00 00 00") == []  # its copy
    assert isinstance(bench.outcome(), FrameIgnored)
    assert bench.server.complete(access.access_id, None, bench.now)
    assert bench.ask() == response("30 00 00 00 00 00 00 00")


def test_the_host_may_refuse(bench: Bench) -> None:
    bench.ask("23 10 10 01 73 61 76 65")
    assert bench.server.complete(pending(bench).access_id, AbortCode.LOCAL_CONTROL, bench.now)
    assert bench.ask() == response("80 10 10 01 21 00 00 08")
    assert bench.aborted() == (0x08000021, AbortOrigin.LOCAL)


def test_a_host_that_stays_silent_costs_the_transfer(bench: Bench) -> None:
    bench.ask("23 10 10 01 73 61 76 65")
    access = pending(bench)
    bench.server.handle_timeout(bench.server.deadline)
    assert bench.ask() == response("80 10 10 01 20 00 00 08")
    assert bench.aborted() == (0x08000020, AbortOrigin.TIMEOUT)
    assert not bench.server.complete(access.access_id, None, bench.now)
    assert bench.ask() == []


@pytest.mark.parametrize("end", ["80 10 10 01 00 00 04 05", "40 00 10 00", "60"])
def test_a_client_that_does_not_wait_makes_the_answer_stale(bench: Bench, end: str) -> None:
    bench.ask("23 10 10 01 73 61 76 65")
    access = pending(bench)
    bench.ask(end)
    assert isinstance(bench.outcome(), SdoServerAborted)
    assert not bench.server.complete(access.access_id, None, bench.now)


def test_two_copies_of_a_command_are_one_command(bench: Bench) -> None:
    bench.ask("23 10 10 01 73 61 76 65")
    access = pending(bench)
    assert bench.ask("23 10 10 01 73 61 76 65") == []
    assert isinstance(bench.outcome(), FrameIgnored)
    assert bench.server.complete(access.access_id, None, bench.now)


def test_an_answer_of_the_wrong_kind_is_the_hosts_fault_and_changes_nothing(bench: Bench) -> None:
    bench.ask("40 10 10 01")
    reading = pending(bench)
    with pytest.raises(LocalProtocolError, match="0x1010:01, node 12: bytes or an AbortCode expected, not None"):
        bench.server.complete(reading.access_id, None, bench.now)
    assert bench.server.complete(reading.access_id, b"", bench.now)
    bench.ask("23 10 10 01 73 61 76 65")
    *_, writing = bench.events()
    assert isinstance(writing, ObjectAccessPending)
    with pytest.raises(LocalProtocolError, match="None or an AbortCode expected"):
        bench.server.complete(writing.access_id, b"", bench.now)
    assert bench.server.busy
