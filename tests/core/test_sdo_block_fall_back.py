"""What the client does where the server has no blocks, or does not want them."""

from __future__ import annotations

from typing import Any

import pytest

from canopen_proto.abort import AbortOrigin
from canopen_proto.machine import MILLISECOND, LocalProtocolError
from canopen_proto.sdo.client import TIMEOUT, SdoAborted, SdoDownloaded, SdoUploaded
from tests.core.block_bench import ClientBench, frames

TEXT = b"Hello, blocks"


# ---- falling back ----


def test_auto_goes_in_blocks_from_29_bytes_on() -> None:
    bench = ClientBench()
    assert bench.download(bytes(28), "auto") == frames("21 00 20 00 1C 00 00 00")
    bench = ClientBench()
    assert bench.download(bytes(29), "auto") == frames("C6 00 20 00 1D 00 00 00")
    bench = ClientBench()
    assert bench.upload("auto") == frames("A4 08 10 00 7F 00")  # servers trip over a protocol switch threshold


@pytest.mark.parametrize("code", [0x05040001, 0x06010000])
def test_auto_falls_back_on_segments_and_remembers(code: int) -> None:
    bench = ClientBench()
    bench.download(bytes(29), "auto")
    abort = code.to_bytes(4, "little").hex()
    assert bench.tell("80 00 20 00" + abort) == frames("21 00 20 00 1D 00 00 00")
    assert bench.events() == []
    answers = ["60 00 20 00"] + ["20", "30"] * 2 + ["20"]
    assert len(bench.tell(*answers)) == 5
    assert bench.outcome() == SdoDownloaded(12, 1, 0x2000, 0)
    assert bench.client.serves_blocks == (code != 0x05040001)
    again = "40 08 10 00" if code == 0x05040001 else "A4 08 10 00 7F"
    assert bench.upload("auto") == frames(again)


def test_auto_uploads_fall_back_too() -> None:
    bench = ClientBench()
    bench.upload("auto")
    assert bench.tell("80 08 10 00 01 00 04 05") == frames("40 08 10 00")
    bench.tell("4F 08 10 00 55")
    assert bench.outcome() == SdoUploaded(12, 1, 0x1008, 0, b"\x55")


def test_other_aborts_are_aborts() -> None:
    bench = ClientBench()
    bench.download(bytes(29), "auto")
    bench.tell("80 00 20 00 00 00 02 06")
    assert bench.aborted() == (0x06020000, AbortOrigin.PEER)
    bench.now += TIMEOUT  # right behind the first one it would be made again: test_sdo_copies.py
    bench.download(bytes(29), True)
    bench.tell("80 00 20 00 01 00 04 05")
    assert bench.aborted() == (0x05040001, AbortOrigin.PEER)
    bench.upload(True)
    bench.tell("80 08 10 00 01 00 04 05")
    assert bench.aborted() == (0x05040001, AbortOrigin.PEER)


def test_a_server_that_refuses_without_naming_the_object_is_believed_if_nothing_else_comes() -> None:
    """But not for good: it may be a stray abort, and the answer lost."""
    for content, given_up, answer in [
        (None, "80 08 10 00 00 00 04 05", "40 08 10 00"),
        (bytes(29), "80 00 20 00 00 00 04 05", "21 00 20 00 1D"),
    ]:
        bench = ClientBench()
        if content is None:
            bench.upload("auto")
        else:
            bench.download(content, "auto")
        assert bench.tell("80 00 00 00 01 00 04 05") == []
        assert bench.wait() == frames(given_up, answer)
        assert bench.client.serves_blocks


@pytest.mark.parametrize("block", [True, "auto"])
def test_an_answer_that_comes_later_than_that_breaks_no_other_transfer(block: Any) -> None:
    bench = ClientBench()
    bench.upload(block)
    assert bench.tell("80 00 00 00 01 00 04 05") == []
    assert bench.wait()[:1] == frames("80 08 10 00 00 00 04 05")
    if block is True:
        report = bench.events()[-1]
        assert isinstance(report, SdoAborted)
        assert (report.abort_code, report.origin) == (0x05040001, AbortOrigin.PEER)
        bench.client.upload(0x1008, 0, bench.now)
        bench.said()
    assert bench.tell("C6 08 10 00 0D") == []
    bench.tell("4F 08 10 00 55")
    report = bench.events()[-1]
    assert isinstance(report, SdoUploaded)
    assert report.data == b"\x55"


def test_a_fall_back_goes_before_all_that_wait() -> None:
    bench = ClientBench()
    bench.download(bytes(29), "auto")
    bench.client.upload(0x1000, 0, bench.now, urgent=True)
    assert bench.tell("80 00 20 00 01 00 04 05") == frames("21 00 20 00 1D 00 00 00")


def test_a_fall_back_waits_for_copies_of_the_abort() -> None:
    bench = ClientBench(copy_guard=MILLISECOND)
    bench.download(bytes(29), "auto")
    assert bench.tell_at_once(*["80 00 20 00 01 00 04 05"] * 2) == []
    assert bench.wait() == frames("21 00 20 00 1D 00 00 00")


@pytest.mark.parametrize("block", [True, "auto"])
def test_a_server_may_answer_with_a_normal_upload(block: object) -> None:
    """Traps 7 and 15: with a threshold of 0 that is against the rules; "auto" takes it, whatever the size."""
    bench = ClientBench()
    bench.upload(block)
    said = bench.tell("41 08 10 00 0D 00 00 00")
    if block is True:
        assert said == frames("80 08 10 00 00 00 01 06")
        assert bench.aborted() == (0x06010000, AbortOrigin.LOCAL)
        return
    assert said == frames("60")
    assert bench.tell("00" + TEXT[:7].hex()) == frames("70")
    assert bench.tell("13" + TEXT[7:].hex() + "00") == []
    assert bench.outcome() == SdoUploaded(12, 1, 0x1008, 0, TEXT)


def test_an_expedited_answer() -> None:
    bench = ClientBench()
    bench.upload("auto")
    bench.tell("4B 08 10 00 12 34")
    assert bench.outcome() == SdoUploaded(12, 1, 0x1008, 0, b"\x12\x34")


def test_impossible_requests() -> None:
    bench = ClientBench()
    with pytest.raises(LocalProtocolError, match="block upload"):
        bench.client.upload(0x10000, 0, 0, block=True)
    with pytest.raises(LocalProtocolError, match="block download"):
        bench.client.download(0x1000, 256, b"", 0, block=True)
    with pytest.raises(LocalProtocolError, match="bytes expected"):
        bench.client.download(0x1000, 0, "text", 0, block=True)  # type: ignore[arg-type]
    assert bench.said() == []
    assert not bench.client.busy
