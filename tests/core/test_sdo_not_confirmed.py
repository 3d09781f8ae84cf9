"""A write whose fate nobody knows: said so, and never sent again (CiA 301 v4.2.0, 7.2.4)."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.machine import NEVER
from canopen_proto.sdo.client import SdoAborted
from tests.core.block_bench import ClientBench
from tests.core.block_pair import BlockPair, pattern
from tests.core.bus import Bus, Fate, take_events
from tests.core.test_sdo_client import Bench

WAYS = ["timeout", "cancel", "gone", "nonsense"]


def end(bench: Bench, way: str, request: int) -> SdoAborted:
    """End a request without its answer."""
    match way:
        case "timeout":
            bench.client.handle_timeout(bench.client.deadline)
        case "cancel":
            assert bench.client.cancel(request, bench.now)
        case "gone":
            bench.client.abort_all(AbortCode.NO_SDO_CONNECTION, bench.now)
        case "nonsense":
            bench.hear("E0 00 20 03 00 00 00 00")
    (report,) = (each for each in take_events(bench.out) if isinstance(each, SdoAborted))
    assert report.request_id == request
    return report


@pytest.mark.parametrize("way", WAYS)
def test_an_expedited_download_without_answer_may_have_been_executed(way: str) -> None:
    bench = Bench()
    assert end(bench, way, bench.client.download(0x2000, 3, b"\x01", 0)).not_confirmed
    frames = bench.frames()
    assert frames.pop(0) == "60C#2F00200301000000"
    assert [frame[:6] for frame in frames] == ["60C#80"], "it is aborted, and never sent again"
    assert bench.client.deadline == NEVER


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(("heard", "not_confirmed"), [(0, False), (1, False), (2, False), (3, True)])
def test_a_segmented_download_may_have_been_executed_once_its_last_segment_went_out(
    heard: int, not_confirmed: bool, way: str
) -> None:
    bench = Bench()
    request = bench.client.download(0x2000, 3, b"0123456789abcdef", 0)
    bench.hear(*["60 00 20 03 00 00 00 00", "20 00 00 00 00 00 00 00", "30 00 00 00 00 00 00 00"][:heard])
    assert end(bench, way, request).not_confirmed == not_confirmed


@pytest.mark.parametrize("way", WAYS)
def test_an_empty_download_too(way: str) -> None:
    bench = Bench()
    request = bench.client.download(0x2000, 3, b"", 0)
    assert not end(bench, way, request).not_confirmed
    request = bench.client.download(0x2000, 3, b"", bench.now)
    bench.hear("60 00 20 03 00 00 00 00")
    assert end(bench, way, request).not_confirmed


@pytest.mark.parametrize(("heard", "not_confirmed"), [(0, False), (1, False), (2, True), (3, True)])
def test_a_block_download_once_its_last_sub_block_went_out(heard: int, not_confirmed: bool) -> None:
    bench = ClientBench()
    request = bench.client.download(0x2000, 0, bytes(21), 0, block=True)
    bench.tell(*["A4 00 20 00 02", "A2 02 02", "A2 01 02"][:heard])
    bench.client.cancel(request, bench.now)
    (report,) = (each for each in take_events(bench.out) if isinstance(each, SdoAborted))
    assert report.not_confirmed == not_confirmed


def test_a_block_upload_is_no_write() -> None:
    bench = ClientBench()
    request = bench.client.upload(0x2000, 0, 0, block=True)
    bench.client.cancel(request, 0)
    (report,) = take_events(bench.out)
    assert isinstance(report, SdoAborted)
    assert not report.not_confirmed


def test_what_was_refused_read_or_never_sent_is_certain() -> None:
    bench = Bench()
    refused = bench.client.download(0x2000, 3, b"\x01", 0)
    bench.hear("80 00 20 03 22 00 00 08")
    read = bench.client.upload(0x2000, 3, 0)
    waiting = bench.client.download(0x2000, 3, b"\x02", 0)
    bench.client.cancel(waiting, 0)
    bench.client.download(0x2000, 3, b"\x02", 0)
    bench.client.abort_all(AbortCode.GENERAL_ERROR, 0)
    reports = [report for report in take_events(bench.out) if isinstance(report, SdoAborted)]
    assert [report.request_id for report in reports[:3]] == [refused, waiting, read]
    assert len(reports) == 4
    assert [report.not_confirmed for report in reports] == [False] * 4
    assert reports[0].origin is AbortOrigin.PEER


@pytest.mark.parametrize(
    ("abort", "not_confirmed"),
    [
        ("80 00 00 00 01 00 04 05", True),  # 0x0000:00: there is no transfer (any more)
        ("80 00 00 00 30 00 09 06", True),
        ("80 00 20 03 01 00 04 05", True),  # out of place
        ("80 00 20 03 00 00 03 05", True),  # toggle bit not alternated
        ("80 00 20 03 30 00 09 06", False),  # the value is refused
        ("80 00 20 03 04 00 04 05", False),
    ],
)
def test_an_abort_that_may_answer_a_second_copy_of_the_last_segment_is_no_refusal(abort: str, not_confirmed: bool) -> None:
    bench = Bench()
    bench.client.download(0x2000, 3, b"01234", 0)
    bench.hear("60 00 20 03 00 00 00 00", abort)
    (report,) = take_events(bench.out)
    assert isinstance(report, SdoAborted)
    assert (report.origin, report.not_confirmed) == (AbortOrigin.PEER, not_confirmed)
    bench.client.download(0x2000, 3, b"0123456789", 0)
    bench.hear("60 00 20 03 00 00 00 00", abort)  # the last segment has not been sent
    (report,) = take_events(bench.out)
    assert isinstance(report, SdoAborted)
    assert not report.not_confirmed


@pytest.mark.parametrize("block", [True, False])
def test_the_last_frame_comes_twice_and_its_answer_is_lost(block: bool) -> None:
    """What the server stored is never called refused, whatever it says of the second copy."""
    content = pattern(20)
    clean = BlockPair()
    clean.download(content, block)
    clean.settle()
    fates = [Fate.DELIVERED] * (len(clean.bus.sent) - 2) + [Fate.COPIED, Fate.LOST]
    pair = BlockPair(Bus(fates=fates))
    pair.download(content, block)
    outcome = pair.settle()
    assert pair.store.written == [content]
    assert isinstance(outcome, SdoAborted)
    assert outcome.origin is (AbortOrigin.TIMEOUT if block else AbortOrigin.PEER)
    assert outcome.not_confirmed
