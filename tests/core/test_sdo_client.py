"""The SDO client: frames as in the standard, queue, cancel, timeouts (CiA 301 v4.2.0, 7.2.4.3)."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import EXTENDED, KEY_EXTENDED, Frame
from canopen_proto.machine import MILLISECOND, NEVER, FrameIgnored, LocalProtocolError, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.sdo.client import TIMEOUT, Block, SdoAborted, SdoClient, SdoDownloaded, SdoUploaded
from tests.core.bus import take_events, take_frames


class Bench:
    """A client of node 12 that stands alone."""

    def __init__(self, *, max_upload: int = 1000, max_queue: int = 8, copy_guard: Time = 0) -> None:
        self.out = Outbox()
        self.client = SdoClient(self.out, 12, max_upload=max_upload, max_queue=max_queue, copy_guard=copy_guard)
        self.now: Time = 0

    def hear(self, *responses: str) -> None:
        """Responses of the server, one millisecond after another."""
        for response in responses:
            self.now += MILLISECOND
            self.client.receive(Frame(0x58C, bytes.fromhex(response)), self.now)

    def frames(self) -> list[str]:
        return take_frames(self.out)

    def outcome(self) -> object:
        """The one event that there is."""
        (report,) = take_events(self.out)
        return report

    def aborted(self) -> tuple[int, AbortOrigin]:
        report = self.outcome()
        assert isinstance(report, SdoAborted)
        assert self.client.deadline == NEVER
        return report.abort_code, report.origin


# ---- expedited ----


@pytest.mark.parametrize(
    ("response", "data"),
    [
        ("4F 18 10 01 92 00 00 00", "92"),
        ("4B 18 10 01 92 01 00 00", "9201"),
        ("47 18 10 01 92 01 02 00", "920102"),
        ("43 18 10 01 92 01 02 03", "92010203"),
        ("42 18 10 01 92 01 00 00", "92010000"),  # size not indicated: all four bytes
        ("4E 18 10 01 92 01 00 00", "92010000"),  # n counts only if the size is indicated
        ("4B 18 10 01 92 01", "9201"),  # a server that sends no unused bytes
    ],
)
def test_expedited_upload(response: str, data: str) -> None:
    bench = Bench()
    request = bench.client.upload(0x1018, 1, 0)
    assert bench.client.deadline == TIMEOUT
    assert bench.frames() == ["60C#4018100100000000"]
    bench.hear(response)
    assert bench.outcome() == SdoUploaded(12, request, 0x1018, 1, bytes.fromhex(data))
    assert bench.frames() == []
    assert bench.client.deadline == NEVER
    assert not bench.client.busy


@pytest.mark.parametrize(
    ("data", "frame"),
    [
        ("0F", "60C#2F4060000F000000"),
        ("0F01", "60C#2B4060000F010000"),
        ("0F0102", "60C#274060000F010200"),
        ("0F010203", "60C#234060000F010203"),
    ],
)
def test_expedited_download(data: str, frame: str) -> None:
    bench = Bench()
    request = bench.client.download(0x6040, 0, bytes.fromhex(data), 0)
    assert bench.frames() == [frame]
    bench.hear("60 40 60 00 00 00 00 00")
    assert bench.outcome() == SdoDownloaded(12, request, 0x6040, 0)
    assert not bench.client.busy


# ---- segmented ----


def test_segmented_upload() -> None:
    bench = Bench()
    request = bench.client.upload(0x1008, 0, 0)
    bench.hear("41 08 10 00 10 00 00 00", "00 48 65 6C 6C 6F 20 77", "10 6F 72 6C 64 20 31 32", "0B 33 34 00 00 00 00 00")
    assert bench.frames() == ["60C#4008100000000000", "60C#6000000000000000", "60C#7000000000000000", "60C#6000000000000000"]
    assert bench.outcome() == SdoUploaded(12, request, 0x1008, 0, b"Hello world 1234")


def test_segmented_upload_of_unannounced_size() -> None:
    bench = Bench()
    bench.client.upload(0x1008, 0, 0)
    bench.hear("40 08 10 00 00 00 00 00", "02 48 65 6C 6C 6F 20 00", "1D 21 00 00 00 00 00 00")
    report = bench.outcome()
    assert isinstance(report, SdoUploaded)
    assert report.data == b"Hello !"


def test_full_and_shorter_segments_may_follow_each_other() -> None:
    bench = Bench()
    bench.client.upload(0x1008, 0, 0)
    bench.hear("41 08 10 00 17 00 00 00", "00 61 62 63 64 65 66 67", "18 68 69 6A 00 00 00 00", "00 6B 6C 6D 6E 6F 70 71")
    bench.hear("1C 72 00 00 00 00 00 00", "0B 73 74 00 00 00 00 00")
    report = bench.outcome()
    assert isinstance(report, SdoAborted)  # 20 bytes came, 23 were announced
    bench.frames()
    bench.client.upload(0x1008, 0, bench.now)
    bench.hear("41 08 10 00 14 00 00 00", "00 61 62 63 64 65 66 67", "18 68 69 6A 00 00 00 00", "00 6B 6C 6D 6E 6F 70 71")
    bench.hear("1C 72 00 00 00 00 00 00", "0B 73 74 00 00 00 00 00")
    report = bench.outcome()
    assert isinstance(report, SdoUploaded)
    assert report.data == b"abcdefghijklmnopqrst"


def test_segmented_download() -> None:
    bench = Bench()
    request = bench.client.download(0x2000, 3, b"0123456789abcdef", 0)
    bench.hear("60 00 20 03 00 00 00 00", "20 00 00 00 00 00 00 00", "30 00 00 00 00 00 00 00", "20 00 00 00 00 00 00 00")
    assert bench.frames() == [
        "60C#2100200310000000",
        "60C#0030313233343536",
        "60C#1037383961626364",
        "60C#0B65660000000000",
    ]
    assert bench.outcome() == SdoDownloaded(12, request, 0x2000, 3)


def test_nothing_at_all_goes_in_one_empty_segment() -> None:
    bench = Bench()
    down = bench.client.download(0x2000, 0, b"", 0)
    bench.hear("60 00 20 00", "20")
    assert bench.frames() == ["60C#2100200000000000", "60C#0F00000000000000"]
    assert bench.outcome() == SdoDownloaded(12, down, 0x2000, 0)
    up = bench.client.upload(0x2000, 0, 0)
    bench.hear("41 00 20 00 00 00 00 00", "0F 00 00 00 00 00 00 00")
    assert bench.outcome() == SdoUploaded(12, up, 0x2000, 0, b"")


def test_a_last_segment_may_be_full() -> None:
    bench = Bench()
    bench.client.download(0x2000, 0, b"0123456", 0)
    bench.hear("60 00 20 00")
    assert bench.frames()[-1] == "60C#0130313233343536"


def test_another_channel() -> None:
    out = Outbox()
    client = SdoClient(out, 12, request_key=0x18FF0001 | KEY_EXTENDED, response_key=0x18FF0002 | KEY_EXTENDED)
    client.download(0x2000, 0, bytes(5), 0)
    assert client.can_ids() == (0x18FF0002 | KEY_EXTENDED, 0x18FF0001 | KEY_EXTENDED)
    client.receive(Frame(0x18FF0002, bytes.fromhex("6000200000000000"), EXTENDED), 0)
    assert take_frames(out) == ["18FF0001#2100200005000000", "18FF0001#0500000000000000"]
    client.abort_all(AbortCode.GENERAL_ERROR, 0)
    assert take_frames(out) == ["18FF0001#8000200000000008"]


# ---- queue ----


def test_requests_wait_their_turn_and_urgent_ones_go_first() -> None:
    bench = Bench()
    bench.client.upload(0x1000, 0, 0)
    bench.client.upload(0x1001, 0, 0)
    bench.client.upload(0x1002, 0, 0, urgent=True)
    bench.client.download(0x1003, 0, b"\x00", 0, urgent=True)
    assert bench.client.waiting == 3
    bench.hear("43 00 10 00", "4F 00 10 00 01", "4F 02 10 00 01", "60 03 10 00", "4F 01 10 00 01")
    assert bench.frames() == [
        "60C#4000100000000000",
        "60C#4002100000000000",
        "60C#2F03100000000000",
        "60C#4001100000000000",
    ]
    reports = take_events(bench.out)
    assert isinstance(reports.pop(0), FrameIgnored)  # the first response was too short
    assert [(report.index, report.request_id) for report in reports if isinstance(report, SdoUploaded | SdoDownloaded)] == [
        (0x1000, 1),
        (0x1002, 3),
        (0x1003, 4),
        (0x1001, 2),
    ]


def test_a_full_queue_refuses_and_changes_nothing() -> None:
    bench = Bench(max_queue=2)
    for _ in range(3):  # one runs, two wait
        bench.client.upload(0x1000, 0, 0)
    with pytest.raises(LocalProtocolError, match=r"download 0x6040:00, node 12: 2 requests are waiting"):
        bench.client.download(0x6040, 0, b"\x00\x00", 0)
    bench.client.download(0x6040, 0, b"\x00\x00", 0, urgent=True)
    bench.client.upload(0x1000, 0, 0, urgent=True)
    with pytest.raises(LocalProtocolError, match="upload 0x1000:00"):
        bench.client.upload(0x1000, 0, 0, urgent=True)
    assert bench.frames() == ["60C#4000100000000000"]
    assert bench.client.waiting == 4


@pytest.mark.parametrize(("index", "subindex"), [(-1, 0), (0x10000, 0), (0, -1), (0, 256)])
def test_impossible_requests_raise(index: int, subindex: int) -> None:
    bench = Bench()
    for content in (b"\x00", bytes(5)):
        with pytest.raises(LocalProtocolError, match="index"):
            bench.client.download(index, subindex, content, 0)
    with pytest.raises(LocalProtocolError, match="index"):
        bench.client.upload(index, subindex, 0)
    with pytest.raises(LocalProtocolError, match="bytes expected"):
        bench.client.download(0x6040, 0, 6, 0)  # type: ignore[arg-type]
    with pytest.raises(LocalProtocolError, match="node-ID"):
        SdoClient(bench.out, 200)
    with pytest.raises(LocalProtocolError, match="abort code"):
        bench.client.abort_all(-1, 0)
    assert not bench.client.busy
    assert bench.frames() == []


def test_any_bytes_like_content_is_taken_over() -> None:
    bench = Bench()
    content = bytearray(b"\x01\x02")
    bench.client.download(0x6040, 0, content, 0)
    content[0] = 9
    assert bench.frames() == ["60C#2B40600001020000"]


# ---- cancel ----


def test_a_request_that_waits_is_cancelled_without_a_frame() -> None:
    bench = Bench()
    bench.client.upload(0x1000, 0, 0)
    waiting = bench.client.upload(0x1001, 0, 0)
    bench.frames()
    assert bench.client.cancel(waiting, 0)
    assert bench.outcome() == SdoAborted(12, waiting, 0x1001, 0, 0x08000000, AbortOrigin.CANCELLED)
    assert bench.frames() == []
    assert not bench.client.cancel(waiting, 0)
    assert not bench.client.cancel(99, 0)


def test_a_running_transfer_is_cancelled_on_the_bus_and_the_next_request_works_at_once() -> None:
    bench = Bench()
    running = bench.client.upload(0x1008, 0, 0)
    bench.hear("41 08 10 00 10 00 00 00")
    following = bench.client.upload(0x1000, 0, 0)
    bench.frames()
    assert bench.client.cancel(running, 0)
    assert bench.frames() == ["60C#8008100000000008", "60C#4000100000000000"]
    assert bench.outcome() == SdoAborted(12, running, 0x1008, 0, 0x08000000, AbortOrigin.CANCELLED)
    bench.hear("00 48 65 6C 6C 6F 20 77")  # the segment that was on its way
    assert isinstance(bench.outcome(), FrameIgnored)
    bench.hear("43 00 10 00 92 01 02 00")
    assert bench.outcome() == SdoUploaded(12, following, 0x1000, 0, bytes.fromhex("92010200"))
    assert bench.frames() == []


def test_abort_all_ends_every_request_and_sends_one_abort() -> None:
    bench = Bench()
    requests = [bench.client.upload(0x1000 + n, 0, 0, urgent=n == 3) for n in range(4)]
    bench.frames()
    bench.client.abort_all(AbortCode.GENERAL_ERROR, 0)
    assert bench.frames() == ["60C#8000100000000008"]
    reports = take_events(bench.out)
    assert {report.request_id for report in reports if isinstance(report, SdoAborted)} == set(requests)
    assert all(isinstance(report, SdoAborted) and report.origin is AbortOrigin.LOCAL for report in reports)
    assert bench.client.deadline == NEVER
    bench.client.abort_all(AbortCode.GENERAL_ERROR, 0)
    assert not bench.out.frames


# ---- time ----


def test_a_server_that_does_not_answer_is_told_so_in_case_it_lives() -> None:
    bench = Bench()
    request = bench.client.upload(0x1000, 0, 0)
    following = bench.client.upload(0x1001, 0, 0)
    bench.client.handle_timeout(TIMEOUT - 1)
    assert bench.frames() == ["60C#4000100000000000"]
    bench.client.handle_timeout(TIMEOUT)
    assert bench.frames() == ["60C#8000100000000405", "60C#4001100000000000"]
    report = bench.outcome()
    assert report == SdoAborted(12, request, 0x1000, 0, 0x05040000, AbortOrigin.TIMEOUT, waited=TIMEOUT)
    assert isinstance(report, SdoAborted)
    assert report.text == "SDO protocol timed out"
    assert bench.client.deadline == 2 * TIMEOUT
    bench.now = TIMEOUT
    bench.hear("43 00 10 00 92 01 02 00")  # late
    assert isinstance(bench.outcome(), FrameIgnored)
    bench.hear("43 01 10 00 92 01 02 00")
    assert bench.outcome() == SdoUploaded(12, following, 0x1001, 0, bytes.fromhex("92010200"))


def test_each_response_starts_the_timeout_anew() -> None:
    bench = Bench()
    bench.client.upload(0x1008, 0, 0)
    for response in ("41 08 10 00 10 00 00 00", "00 48 65 6C 6C 6F 20 77", "10 6F 72 6C 64 20 31 32"):
        bench.now += TIMEOUT - 2 * MILLISECOND
        bench.hear(response)
        assert bench.client.deadline == bench.now + TIMEOUT
    bench.client.handle_timeout(bench.client.deadline)
    assert bench.aborted() == (0x05040000, AbortOrigin.TIMEOUT)
    assert bench.frames()[-1] == "60C#8008100000000405"


def test_handle_timeout_of_an_idle_client_does_nothing() -> None:
    bench = Bench()
    bench.client.handle_timeout(NEVER)
    bench.client.handle_timeout(0)
    assert (bench.frames(), take_events(bench.out)) == ([], [])


def test_copy_guard_keeps_requests_apart_whose_answers_look_alike() -> None:
    bench = Bench(copy_guard=2 * MILLISECOND)
    bench.client.upload(0x6041, 0, 0)
    again = bench.client.upload(0x6041, 0, 0)
    assert bench.frames() == ["60C#4041600000000000"]
    bench.hear("4B 41 60 00 37 02 00 00")
    assert bench.frames() == []
    assert bench.client.busy
    assert bench.client.deadline == 3 * MILLISECOND
    bench.hear("4B 41 60 00 37 02 00 00")  # the copy
    assert [type(report) for report in take_events(bench.out)] == [SdoUploaded, FrameIgnored]
    other = bench.client.upload(0x1001, 0, bench.now, urgent=True)  # not alike: needs no guard
    assert bench.frames() == ["60C#4001100000000000"]
    bench.hear("4F 01 10 00 00 00 00 00")
    assert bench.outcome() == SdoUploaded(12, other, 0x1001, 0, b"\x00")
    assert bench.frames() == ["60C#4041600000000000"]  # the one before was another object
    bench.hear("4B 41 60 00 37 06 00 00")
    assert bench.outcome() == SdoUploaded(12, again, 0x6041, 0, b"\x37\x06")


def test_a_request_that_the_guard_holds_goes_at_its_deadline_or_is_cancelled() -> None:
    bench = Bench(copy_guard=2 * MILLISECOND)
    bench.client.upload(0x6041, 0, 0)
    bench.hear("4B 41 60 00 37 02 00 00")
    first = bench.client.upload(0x6041, 0, bench.now)
    bench.client.upload(0x6041, 0, bench.now)
    take_events(bench.out)
    bench.frames()
    assert bench.client.cancel(first, bench.now)
    assert bench.client.deadline == 3 * MILLISECOND
    bench.client.handle_timeout(3 * MILLISECOND - 1)
    assert bench.frames() == []
    bench.client.handle_timeout(3 * MILLISECOND)
    assert bench.frames() == ["60C#4041600000000000"]
    bench.now = 4 * MILLISECOND
    bench.hear("4B 41 60 00 37 02 00 00")
    last = bench.client.upload(0x6041, 0, bench.now)
    assert bench.client.cancel(last, bench.now)
    assert bench.client.deadline == NEVER
    bench.client.upload(0x1001, 0, bench.now)
    assert bench.frames() == ["60C#4001100000000000"]


def test_a_timeout_that_was_made_shorter_meanwhile_wakes_the_driver_in_time() -> None:
    """In a network: it must never wake later than the client's deadline."""
    network = Network()
    client = SdoClient(network.out, 12)
    network.attach(client)

    def hear(response: str, now: Time) -> None:
        client.timeout //= 2
        network.receive(Frame(0x58C, bytes.fromhex(response)), now)
        assert network.next_deadline() == client.deadline == now + client.timeout

    client.upload(0x2000, 0, 0)
    client.download(0x2000, 0, bytes(10), 0)
    assert network.next_deadline() == TIMEOUT
    hear("41 00 20 00 08 00 00 00", 1)
    hear("00 00 00 00 00 00 00 00", 2)
    hear("1D 00 00 00 00 00 00 00", 3)
    hear("60 00 20 00 00 00 00 00", 4)
    hear("20 00 00 00 00 00 00 00", 5)
    network.handle_timeout(client.deadline)
    assert not client.busy


@pytest.mark.parametrize("block", [False, True, "auto"])
def test_the_time_out_of_a_request_is_its_own(block: Block) -> None:
    """Those beside it, on their way or waiting, keep the client's."""
    bench = Bench()
    patient = bench.client.upload(0x2000, 0, bench.now)
    quick = bench.client.upload(0x2001, 0, bench.now, block=block, timeout=3 * MILLISECOND)
    written = bench.client.download(0x2002, 0, bytes(10), bench.now, block=block, timeout=4 * MILLISECOND)
    after = bench.client.upload(0x2003, 0, bench.now)
    ends = []
    while len(ends) < 4:
        bench.now = bench.client.deadline
        bench.client.handle_timeout(bench.now)
        ends += [(event.request_id, bench.now) for event in take_events(bench.out) if isinstance(event, SdoAborted)]
    first, second, third = TIMEOUT, TIMEOUT + 3 * MILLISECOND, TIMEOUT + 7 * MILLISECOND
    assert ends == [(patient, first), (quick, second), (written, third), (after, third + TIMEOUT)]


def test_a_read_that_falls_back_on_segments_keeps_its_time_out() -> None:
    bench = Bench()
    bench.client.upload(0x2000, 0, bench.now, block="auto", timeout=3 * MILLISECOND)
    bench.hear("41 00 20 00 08 00 00 00")  # the server sends it in segments
    assert bench.client.deadline == bench.now + 3 * MILLISECOND
    other = Bench()
    other.client.upload(0x2000, 0, other.now, block="auto", timeout=3 * MILLISECOND)
    other.hear("80 00 20 00 01 00 04 05")  # it has no blocks
    assert other.client.deadline == other.now + 3 * MILLISECOND
