"""A write whose fate nobody knows: said so, and never sent again (CiA 301 v4.2.0, 7.2.4)."""

from __future__ import annotations

import pytest

from canopen_proto.machine import NEVER
from canopen_proto.sdo.abort import AbortCode, AbortOrigin
from canopen_proto.sdo.client import SdoAborted
from tests.proto.block_bench import ClientBench
from tests.proto.bus import take_events
from tests.proto.test_sdo_client import Bench

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
