"""Answers that come after their request was given up: told from those to the next one (CiA 301 v4.2.0, 7.2.4)."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.machine import MILLISECOND, NEVER, FrameIgnored, Outbox, Time
from canopen_proto.sdo.client import LATE_GUARD, TIMEOUT, SdoAborted, SdoClient, SdoDownloaded, SdoUploaded
from canopen_proto.sdo.request_queue import MAX_OVERDUE
from tests.core.bus import take_events
from tests.core.test_sdo_client import Bench
from tests.core.test_sdo_client_faults import ignored

LATE = "late response to a request that timed out"


def timed_out(index: int = 0x6041, content: bytes = b"") -> Bench:
    """A client whose upload of an object, or download of `content`, has just timed out."""
    bench = Bench()
    if content:
        bench.client.download(index, 0, content, bench.now)
    else:
        bench.client.upload(index, 0, bench.now)
    wait(bench, TIMEOUT)
    report = bench.outcome()
    assert isinstance(report, SdoAborted)
    assert report.origin is AbortOrigin.TIMEOUT
    bench.frames()
    return bench


def wait(bench: Bench, duration: Time) -> None:
    bench.now += duration
    bench.client.handle_timeout(bench.now)


# ---- another object: its address tells ----


@pytest.mark.parametrize("late", ["4B 41 60 00 37 02 00 00", "60 41 60 00 00 00 00 00", "80 41 60 00 22 00 00 08"])
def test_a_late_answer_about_another_object_is_ignored_and_told(late: str) -> None:
    bench = timed_out(content=b"\x06" if late.startswith("60") else b"")
    request = bench.client.upload(0x1001, 0, bench.now)
    assert bench.frames() == ["60C#4001100000000000"]
    bench.hear(late)
    assert ignored(bench) == LATE
    bench.hear("4F 01 10 00 05 00 00 00")
    assert bench.outcome() == SdoUploaded(12, request, 0x1001, 0, b"\x05")


def test_a_late_abort_among_the_segments_of_another_object() -> None:
    bench = timed_out()
    request = bench.client.upload(0x1008, 0, bench.now)
    bench.hear("41 08 10 00 08 00 00 00")
    bench.frames()
    bench.hear("80 41 60 00 22 00 00 08")
    assert ignored(bench) == "abort of another object's transfer"  # the answer before has settled it
    bench.hear("00 31 32 33 34 35 36 37", "1D 38 00 00 00 00 00 00")
    assert bench.outcome() == SdoUploaded(12, request, 0x1008, 0, b"12345678")


# ---- the same object: nothing but time tells ----


@pytest.mark.parametrize(
    ("late", "content", "again"),
    [
        ("4B 41 60 00 37 02 00 00", b"", "60C#4041600000000000"),
        ("41 41 60 00 08 00 00 00", b"", "60C#4041600000000000"),
        ("60 41 60 00 00 00 00 00", b"\x06\x00", "60C#2B41600006000000"),
        ("80 41 60 00 22 00 00 08", b"\x06\x00", "60C#2B41600006000000"),
        ("80 41 60 00 22 00 00 08", b"", "60C#4041600000000000"),
    ],
)
def test_the_same_request_waits_until_the_late_answer_has_come(late: str, content: bytes, again: str) -> None:
    bench = timed_out(content=content)
    if content:
        request = bench.client.download(0x6041, 0, content, bench.now)
    else:
        request = bench.client.upload(0x6041, 0, bench.now)
    assert bench.frames() == []
    assert bench.client.deadline == TIMEOUT + LATE_GUARD
    bench.hear(late)
    (report,) = take_events(bench.out)
    assert isinstance(report, FrameIgnored)
    assert report.reason == LATE
    assert bench.frames() == [again]
    bench.hear("60 41 60 00 00 00 00 00" if content else "4B 41 60 00 37 06 00 00")
    assert bench.outcome() == (
        SdoDownloaded(12, request, 0x6041, 0) if content else SdoUploaded(12, request, 0x6041, 0, b"\x37\x06")
    )
    assert bench.client.deadline == NEVER


def test_a_dead_server_costs_no_more_than_the_guard() -> None:
    bench = timed_out()
    bench.client.upload(0x6041, 0, bench.now)
    wait(bench, LATE_GUARD - 1)
    assert bench.frames() == []
    wait(bench, 1)
    assert bench.frames() == ["60C#4041600000000000"]
    wait(bench, TIMEOUT)
    assert bench.aborted() == (AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT)


def test_a_slow_server_is_understood() -> None:
    """Answers take 1.5 time-outs: each read fails, but never brings the value of the one before. Without the guard each would."""
    for guard, brought in ((LATE_GUARD, []), (0, [b"\x00", b"\x01"])):
        out = Outbox()
        client = SdoClient(out, 12, late_guard=guard)
        bench = Bench()
        bench.out, bench.client = out, client
        answers: list[tuple[Time, str]] = []
        values: list[bytes] = []
        client.upload(0x6041, 0, 0)
        asked = 0
        while bench.now < 20 * TIMEOUT and asked < 6:
            for frame in bench.frames():
                if frame.startswith("60C#40"):
                    answers.append((bench.now + TIMEOUT * 3 // 2, f"4F 41 60 00 {asked:02X} 00 00 00"))
                    asked += 1
            bench.now = min([client.deadline, *(time for time, _ in answers)])
            if answers and answers[0][0] == bench.now:
                bench.now -= MILLISECOND
                bench.hear(answers.pop(0)[1])
            client.handle_timeout(bench.now)
            for report in take_events(out):
                if isinstance(report, SdoUploaded):
                    values.append(report.data)
                if isinstance(report, SdoUploaded | SdoAborted):
                    client.upload(0x6041, 0, bench.now)
        assert values[:2] == brought


def test_the_other_direction_waits_too_for_an_abort_does_not_say_which_it_means() -> None:
    bench = timed_out(0x6040, b"\x0f\x00")
    request = bench.client.upload(0x6040, 0, bench.now)
    assert bench.frames() == []
    bench.hear("80 40 60 00 22 00 00 08")
    (report,) = take_events(bench.out)
    assert isinstance(report, FrameIgnored)
    assert bench.frames() == ["60C#4040600000000000"]
    bench.hear("4B 40 60 00 06 00 00 00")
    assert bench.outcome() == SdoUploaded(12, request, 0x6040, 0, b"\x06\x00")


def test_urgent_requests_do_not_wait() -> None:
    bench = timed_out(0x6040, b"\x0f\x00")
    bench.client.download(0x6040, 0, b"\x07\x00", bench.now)
    bench.client.download(0x6040, 0, b"\x0f\x01", bench.now, urgent=True)
    assert bench.frames() == ["60C#2B4060000F010000"]


def test_a_request_that_waits_for_a_late_answer_may_be_cancelled() -> None:
    bench = timed_out()
    request = bench.client.upload(0x6041, 0, bench.now)
    bench.client.upload(0x1001, 0, bench.now)  # first in, first out
    assert bench.frames() == []
    assert bench.client.cancel(request, bench.now)
    assert bench.frames() == ["60C#4001100000000000"]


def test_whoever_answers_something_else_has_nothing_more_to_say() -> None:
    bench = timed_out()
    bench.client.upload(0x1001, 0, bench.now)
    bench.client.upload(0x6041, 0, bench.now)
    bench.frames()
    bench.hear("4F 01 10 00 05 00 00 00")
    assert bench.frames() == ["60C#4041600000000000"]


def test_each_object_has_a_guard_of_its_own() -> None:
    bench = timed_out(0x6041)
    bench.client.upload(0x6064, 0, bench.now)
    wait(bench, TIMEOUT - MILLISECOND)
    bench.client.upload(0x6041, 0, bench.now)
    bench.frames()
    wait(bench, MILLISECOND)  # 6064 has timed out; the time of 6041 is just over
    assert bench.frames() == ["60C#8064600000000405", "60C#4041600000000000"]


def test_a_server_that_is_gone_owes_nothing() -> None:
    bench = timed_out()
    bench.client.abort_all(AbortCode.NO_SDO_CONNECTION, bench.now)
    bench.client.upload(0x6041, 0, bench.now)
    assert bench.frames() == ["60C#4041600000000000"]


def test_what_is_remembered_is_bounded() -> None:
    bench = Bench()
    for index in range(0x2000, 0x2000 + MAX_OVERDUE + 3):
        bench.client.timeout = MILLISECOND
        bench.client.upload(index, 0, bench.now)
        wait(bench, MILLISECOND)
    bench.frames()
    bench.client.upload(0x2002, 0, bench.now)  # forgotten
    assert bench.frames() == ["60C#4002200000000000"]
    bench.client.cancel(MAX_OVERDUE + 4, bench.now)
    bench.frames()
    bench.client.upload(0x2003, 0, bench.now)
    assert bench.frames() == []


# ---- where the answer cannot be mistaken, nobody waits ----


def test_late_segments_need_no_guard() -> None:
    bench = Bench()
    bench.client.download(0x2000, 0, b"0123456789", 0)
    bench.hear("60 00 20 00 00 00 00 00")
    wait(bench, TIMEOUT)
    assert bench.aborted() == (AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT)
    bench.frames()
    request = bench.client.download(0x2000, 0, b"0123456789", bench.now)
    assert bench.frames() == ["60C#210020000A000000"]
    bench.hear("20 00 00 00 00 00 00 00")
    assert ignored(bench) == "late response of a transfer that was given up"
    bench.hear("60 00 20 00 00 00 00 00", "20 00 00 00 00 00 00 00", "30 00 00 00 00 00 00 00")
    assert bench.outcome() == SdoDownloaded(12, request, 0x2000, 0)


def test_a_late_response_to_the_initiation_of_the_same_segmented_download() -> None:
    bench = Bench()
    bench.client.download(0x2000, 0, b"0123456789", 0)
    wait(bench, TIMEOUT)
    take_events(bench.out)
    bench.frames()
    request = bench.client.download(0x2000, 0, b"0123456789", bench.now)
    assert bench.frames() == ["60C#210020000A000000"]
    bench.hear("60 00 20 00 00 00 00 00")  # the late one
    assert bench.frames() == ["60C#0030313233343536"]
    bench.hear("60 00 20 00 00 00 00 00")  # the server has taken the second request, and then the segment
    assert ignored(bench) == "second copy of the last response"
    bench.hear("20 00 00 00 00 00 00 00", "30 00 00 00 00 00 00 00")
    assert bench.outcome() == SdoDownloaded(12, request, 0x2000, 0)


def test_after_a_cancel_the_same_request_waits_for_the_answer_to_a_question() -> None:
    bench = Bench()
    bench.client.cancel(bench.client.upload(0x6041, 0, 0), 0)
    again = bench.client.upload(0x6041, 0, 0)
    assert bench.frames() == ["60C#4041600000000000", "60C#8041600000000008", "60C#4000100000000000"]
    take_events(bench.out)
    bench.hear("4B 41 60 00 37 02 00 00")  # meant for the first
    assert ignored(bench) == "response about another object"
    bench.hear("43 00 10 00 92 01 02 00")
    assert bench.frames() == ["60C#4041600000000000"]
    bench.hear("4B 41 60 00 37 06 00 00")
    assert bench.outcome() == SdoUploaded(12, again, 0x6041, 0, b"\x37\x06")
