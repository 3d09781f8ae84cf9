"""What a server can do wrong, and what the bus can: the client checks everything and raises nothing (CiA 301 v4.2.0, 7.2.4.3)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortOrigin
from canopen_proto.frame import REMOTE, Frame
from canopen_proto.machine import MILLISECOND, NEVER, FrameIgnored
from canopen_proto.sdo.client import TIMEOUT, SdoAborted, SdoClient, SdoDownloaded, SdoUploaded
from tests.core.bus import Bus, take_events
from tests.core.test_sdo_client import Bench

LOCAL = AbortOrigin.LOCAL


def uploading(**limits: int) -> Bench:
    """Waits for the first segment of 16 bytes of 0x1008:00."""
    bench = Bench(**limits)
    bench.client.upload(0x1008, 0, 0)
    bench.hear("41 08 10 00 10 00 00 00")
    bench.frames()
    return bench


def downloading() -> Bench:
    """Waits for the response to the first of three segments to 0x2000:03."""
    bench = Bench()
    bench.client.download(0x2000, 3, b"0123456789abcdef", 0)
    bench.hear("60 00 20 03 00 00 00 00")
    bench.frames()
    return bench


def ignored(bench: Bench) -> str:
    report = bench.outcome()
    assert isinstance(report, FrameIgnored)
    assert bench.frames() == []
    return report.reason


# ---- aborts of the server ----


def test_an_abort_of_the_server_ends_the_transfer_unanswered() -> None:
    bench = Bench()
    request = bench.client.upload(0x1018, 9, 0)
    bench.frames()
    bench.hear("80 18 10 09 11 00 09 06")
    report = bench.outcome()
    assert report == SdoAborted(12, request, 0x1018, 9, 0x06090011, AbortOrigin.PEER)
    assert isinstance(report, SdoAborted)
    assert report.text == "subindex does not exist"
    assert bench.frames() == []


def test_trap_11_an_abort_of_another_transfer_is_ignored() -> None:
    bench = Bench()
    bench.client.upload(0x1018, 9, 0)
    bench.frames()
    for other in ("80 18 10 08 11 00 09 06", "80 19 10 09 11 00 09 06", "80 00 00 00 11 00 09 06"):
        bench.hear(other)
        assert ignored(bench) == "abort of another object's transfer"
    assert bench.client.busy


def test_a_server_that_lost_its_transfer_cannot_name_it() -> None:
    bench = uploading()
    bench.hear("80 00 00 00 01 00 04 05")
    assert bench.aborted() == (0x05040001, AbortOrigin.PEER)


def test_an_abort_in_the_middle_of_segments() -> None:
    bench = downloading()
    bench.hear("80 00 20 03 20 00 00 08")
    assert bench.aborted() == (0x08000020, AbortOrigin.PEER)


# ---- wrong answers ----


def test_trap_8_the_toggle_is_checked_in_download_responses() -> None:
    bench = downloading()
    bench.hear("30 00 00 00 00 00 00 00")
    assert bench.frames() == ["60C#8000200300000305"]
    assert bench.aborted() == (0x05030000, LOCAL)


def test_the_toggle_is_checked_in_upload_responses() -> None:
    bench = uploading()
    bench.hear("10 48 65 6C 6C 6F 20 77")
    assert bench.frames() == ["60C#8008100000000305"]
    assert bench.aborted() == (0x05030000, LOCAL)


def test_a_segment_with_the_old_toggle_and_other_data_is_no_copy() -> None:
    bench = uploading()
    bench.hear("00 48 65 6C 6C 6F 20 77", "00 6F 72 6C 64 20 31 32")
    assert bench.aborted() == (0x05030000, LOCAL)


def test_a_server_that_never_alternates_is_found_out_at_the_latest_by_the_timeout() -> None:
    bench = downloading()
    bench.hear("20 00 00 00 00 00 00 00")
    bench.frames()
    bench.hear("20 00 00 00 00 00 00 00")
    assert ignored(bench) == "second copy of the last response"
    bench.client.handle_timeout(bench.client.deadline)
    assert bench.aborted() == (0x05030000, AbortOrigin.TIMEOUT)
    bench = downloading()
    bench.hear(*["20 00 00 00 00 00 00 00"] * 3)
    assert bench.frames()[-1] == "60C#8000200300000305"


@pytest.mark.parametrize("response", ["60 00 20 04 00 00 00 00", "60 FF FF 07 00 00 00 00", "60 01 20 03 00 00 00 00"])
@pytest.mark.parametrize("content", [b"\x01", bytes(10)])
def test_trap_9_the_multiplexer_of_a_download_response_is_checked(response: str, content: bytes) -> None:
    bench = Bench()
    request = bench.client.download(0x2000, 3, content, 0)
    bench.frames()
    bench.hear(response)
    assert ignored(bench) == "response about another object"
    bench.client.handle_timeout(TIMEOUT)
    assert bench.outcome() == SdoAborted(12, request, 0x2000, 3, 0x05040000, AbortOrigin.TIMEOUT, len(content) == 1, TIMEOUT)


def test_the_multiplexer_of_an_upload_response_is_checked() -> None:
    bench = Bench()
    bench.client.upload(0x1018, 1, 0)
    bench.frames()
    bench.hear("43 18 10 02 92 01 00 00")
    assert ignored(bench) == "response about another object"


@pytest.mark.parametrize(
    ("segments", "abort"),
    [
        (["00 30 31 32 33 34 35 36", "10 30 31 32 33 34 35 36", "00 30 31 32 33 34 35 36"], 0x06070012),  # 21 for 16
        (["00 30 31 32 33 34 35 36", "10 30 31 32 33 34 35 36", "09 30 31 32 00 00 00 00"], 0x06070012),  # 17
        (["00 30 31 32 33 34 35 36", "10 30 31 32 33 34 35 36", "0D 30 00 00 00 00 00 00"], 0x06070013),  # 15
        (["01 30 31 32 33 34 35 36"], 0x06070013),
        (["0F 00 00 00 00 00 00 00"], 0x06070013),
    ],
)
def test_trap_10_the_announced_size_is_checked(segments: list[str], abort: int) -> None:
    bench = uploading()
    bench.hear(*segments)
    assert bench.aborted() == (abort, LOCAL)
    assert bench.frames()[-1] == f"60C#80081000{abort.to_bytes(4, 'little').hex().upper()}"


def test_what_is_larger_than_allowed_is_refused_as_soon_as_it_is_known() -> None:
    bench = Bench(max_upload=16)
    bench.client.upload(0x1008, 0, 0)
    bench.hear("41 08 10 00 11 00 00 00")
    assert bench.frames()[-1] == "60C#8008100005000405"
    assert bench.aborted() == (0x05040005, LOCAL)
    bench.client.upload(0x1008, 0, 0)
    bench.hear("40 08 10 00 00 00 00 00", "00 30 31 32 33 34 35 36", "10 30 31 32 33 34 35 36", "09 30 31 32 00 00 00 00")
    assert bench.frames()[-1] == "60C#8008100005000405"
    assert bench.aborted() == (0x05040005, LOCAL)
    bench.client.upload(0x1008, 0, 0)
    bench.hear("41 08 10 00 10 00 00 00")
    assert bench.frames()[-1] == "60C#6000000000000000"  # not one too many


def test_empty_segments_without_end_are_no_transfer() -> None:
    bench = uploading()
    bench.hear("0E 00 00 00 00 00 00 00")
    assert bench.aborted() == (0x05040001, LOCAL)


@pytest.mark.parametrize(
    "response",
    [
        "60 18 10 01 00 00 00 00",  # a download's
        "20 00 00 00 00 00 00 00",
        "00 00 00 00 00 00 00 00",
        "A0 18 10 01 00 00 00 00",  # block
        "C0 18 10 01 00 00 00 00",
        "E0 18 10 01 00 00 00 00",  # not in the standard
    ],
)
def test_a_wrong_command_specifier_is_an_abort_with_the_right_multiplexer(response: str) -> None:
    bench = Bench()
    request = bench.client.upload(0x1018, 1, 0)
    bench.frames()
    bench.hear(response)
    assert bench.frames() == ["60C#8018100101000405"]
    assert bench.outcome() == SdoAborted(12, request, 0x1018, 1, 0x05040001, LOCAL)


def test_so_it_is_in_a_download_and_among_segments() -> None:
    bench = Bench()
    bench.client.download(0x1018, 1, b"\x00", 0)
    bench.hear("43 18 10 01 00 00 00 00")
    assert bench.aborted() == (0x05040001, LOCAL)
    for bench in (uploading(), downloading()):
        bench.hear("C1 00 00 00 00 00 00 00")
        assert bench.aborted() == (0x05040001, LOCAL)
    bench = downloading()
    bench.hear("00 00 00 00 00 00 00 00")
    assert bench.aborted() == (0x05040001, LOCAL)
    bench = uploading()
    bench.hear("20 00 00 00 00 00 00 00")
    assert bench.aborted() == (0x05040001, LOCAL)
    bench = uploading()
    bench.hear("43 08 10 00 00 00 00 00")  # this object again, but expedited
    assert bench.aborted() == (0x05040001, LOCAL)


@pytest.mark.parametrize("response", ["", "43 18 10", "43 18 10 01 92", "41 18 10", "80 18 10"])
def test_responses_too_short_to_be_one_are_ignored(response: str) -> None:
    bench = Bench()
    bench.client.upload(0x1018, 1, 0)
    bench.frames()
    bench.hear(response)
    assert ignored(bench) == "too short for an SDO response"
    assert bench.client.busy


def test_segments_that_are_shorter_than_they_say_are_ignored() -> None:
    bench = uploading()
    bench.hear("00 30 31 32 33 34 35")
    assert ignored(bench) == "too short for an SDO response"


def test_a_remote_frame_is_no_response() -> None:
    bench = Bench()
    bench.client.upload(0x1018, 1, 0)
    bench.frames()
    bench.client.receive(Frame(0x58C, b"", REMOTE, 8), 0)
    assert ignored(bench) == "too short for an SDO response"


def test_a_response_that_nobody_asked_for() -> None:
    bench = Bench()
    bench.hear("43 18 10 01 92 01 00 00")
    assert ignored(bench) == "no transfer is under way"
    bench.hear("80 18 10 01 92 01 00 00")
    assert ignored(bench) == "no transfer is under way"
    assert bench.client.deadline == NEVER


# ---- second copies, late ones ----


def test_the_second_copy_of_each_response_is_survived() -> None:
    bench = Bench()
    request = bench.client.upload(0x1008, 0, 0)
    responses = ["41 08 10 00 10 00 00 00", "00 48 65 6C 6C 6F 20 77", "10 6F 72 6C 64 20 31 32", "0B 33 34 00 00 00 00 00"]
    for response in responses:
        bench.hear(response, response)
    reports = [report for report in take_events(bench.out) if not isinstance(report, FrameIgnored)]
    assert reports == [SdoUploaded(12, request, 0x1008, 0, b"Hello world 1234")]
    assert len(bench.frames()) == 4


def test_the_second_copy_of_each_response_to_a_download_is_survived() -> None:
    bench = Bench()
    request = bench.client.download(0x2000, 3, b"0123456789abcdef", 0)
    for response in ("60 00 20 03", "20", "30", "20"):
        bench.hear(response, response)
    reports = [report for report in take_events(bench.out) if not isinstance(report, FrameIgnored)]
    assert reports == [SdoDownloaded(12, request, 0x2000, 3)]
    assert len(bench.frames()) == 4


def test_the_second_copy_of_a_last_response_does_not_hurt_the_next_transfer() -> None:
    bench = Bench()
    bench.client.download(0x2000, 3, b"0123456", 0)
    bench.client.upload(0x2000, 3, 0)
    bench.client.download(0x2000, 3, b"0123", 0)
    bench.hear("60 00 20 03", "20", "20", "4F 00 20 03 01", "4F 00 20 03 02", "60 00 20 03")
    reports = take_events(bench.out)
    assert [type(report) for report in reports] == [SdoDownloaded, FrameIgnored, SdoUploaded, FrameIgnored, SdoDownloaded]


def test_an_initiate_request_that_was_copied_may_be_answered_by_two_values() -> None:
    bench = uploading()
    bench.hear("41 08 10 00 11 00 00 00")  # it has grown meanwhile; the segments will be of this one
    assert ignored(bench) == "second copy of the last response"
    bench.hear("00 48 65 6C 6C 6F 20 77", "10 6F 72 6C 64 20 31 32", "09 33 34 35 00 00 00 00")
    assert bench.aborted() == (0x06070012, LOCAL)


def test_late_answers_after_a_timeout_do_not_hurt_the_next_transfer() -> None:
    bench = uploading()
    bench.client.handle_timeout(bench.client.deadline)
    following = bench.client.upload(0x1008, 0, bench.now)
    take_events(bench.out)
    bench.frames()
    bench.hear("00 48 65 6C 6C 6F 20 77")
    assert ignored(bench) == "late response of a transfer that was given up"
    bench.hear("20 00 00 00 00 00 00 00")
    assert ignored(bench) == "late response of a transfer that was given up"
    bench.hear("43 08 10 00 41 42 43 44")
    assert bench.outcome() == SdoUploaded(12, following, 0x1008, 0, b"ABCD")


def test_trap_12_a_silent_server_is_not_asked_again() -> None:
    bus = Bus()
    client = bus.attach(SdoClient(Bench().out, 12))
    client.upload(0x1018, 1, bus.now)
    bus.settle()
    assert bus.trace() == ["60C#4018100100000000", "60C#8018100100000405"]
    assert bus.now == TIMEOUT


# ---- anything at all ----

REQUESTS = st.sampled_from(["upload", "expedited", "segmented", "empty", "cancel", "wait"])
HEADS = st.sampled_from([bytes((command,)) for command in (0x00, 0x01, 0x0F, 0x10, 0x20, 0x30, 0x40, 0x41, 0x43, 0x60, 0x80)])
TAILS = st.sampled_from([bytes.fromhex("00200300000000"), bytes.fromhex("00200307000000")])
BYTES = st.one_of(st.binary(max_size=8), st.builds(lambda head, tail: head + tail, HEADS, TAILS))


@given(st.lists(st.one_of(REQUESTS, BYTES), max_size=60))
def test_no_bytes_make_it_raise_and_every_request_ends_once(steps: list[str | bytes]) -> None:
    bench = Bench(max_upload=50)
    requests: list[int] = []
    for step in steps:
        bench.now += MILLISECOND
        match step:
            case bytes():
                bench.client.receive(Frame(0x58C, step), bench.now)
            case "upload" if bench.client.waiting < 8:
                requests.append(bench.client.upload(0x2000, 3, bench.now))
            case "cancel" if requests:
                bench.client.cancel(requests[-1], bench.now)
            case "wait":
                bench.now = max(bench.now, min(bench.client.deadline, bench.now + 2 * TIMEOUT))
                bench.client.handle_timeout(bench.now)
            case "expedited" | "segmented" | "empty" if bench.client.waiting < 8:
                content = {"expedited": b"\x01", "segmented": bytes(10), "empty": b""}[step]
                requests.append(bench.client.download(0x2000, 3, content, bench.now))
        assert (bench.client.deadline == NEVER) == (not bench.client.busy)
    while bench.client.busy:
        bench.client.handle_timeout(bench.client.deadline)
    outcomes = [report.request_id for report in bench.out.events if isinstance(report, SdoUploaded | SdoDownloaded | SdoAborted)]
    assert sorted(outcomes) == requests
    assert all(len(frame.data) == 8 for frame in bench.out.frames)
