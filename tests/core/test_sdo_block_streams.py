"""Transfers that nobody holds whole, bursts, and the least number of frames."""

from __future__ import annotations

import functools
from binascii import crc_hqx

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortOrigin
from canopen_proto.machine import MILLISECOND, LocalProtocolError
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, MAX_BURST, SEGMENT_SIZE, STREAM_TIMEOUT
from canopen_proto.sdo.block_client import MAX_FED
from canopen_proto.sdo.client import SdoChunk, SdoDataWanted, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from tests.core.block_bench import ClientBench, frames, segments
from tests.core.block_pair import BY_HOST, INDEX, BlockPair, pattern
from tests.core.bus import Bus
from tests.core.machines import held_data
from tests.examples import examples, takes_all

LONG = 1 << 20 if takes_all() else 1 << 17
"""Bytes of what is long: a mebibyte, every day an eighth of it."""
LIMITS = {"max_upload": 1 << 21}, {"max_download": 1 << 21}


def least_frames(size: int) -> tuple[int, int]:
    """The frames that a block download and a block upload of `size` bytes take at least, with sub-blocks of 127 segments.

    Initiate (2), segments, one acknowledgement per sub-block, end (2); an upload has a start besides.
    """
    segments = max(1, -(-size // SEGMENT_SIZE))
    download = 4 + segments + -(-segments // MAX_BLOCK_SIZE)
    return download, download + 1


@functools.cache
def long() -> bytes:
    return pattern(LONG)


def big_pair(content: bytes = b"") -> BlockPair:
    pair = BlockPair(None, content, client=LIMITS[0], server=LIMITS[1])
    pair.bus.on_event = pair.outcomes.append  # type: ignore[assignment]
    return pair


# ---- the least number of frames ----


def frames_by_the_standard(size: int) -> int:
    """Of a block download: initiate request and response, segments, an acknowledgement for each 127, end and its response."""
    segments_ = (size + 6) // 7
    acknowledgements = (segments_ + 126) // 127
    return 2 + segments_ + acknowledgements + 2


def test_what_is_long_takes_the_least_number_of_frames_down() -> None:
    pair = big_pair()
    pair.download(long())
    pair.bus.settle()
    assert isinstance(pair.outcomes[-1], SdoDownloaded)
    assert pair.store.written == [long()]
    assert len(pair.bus.sent) == frames_by_the_standard(LONG)
    assert frames_by_the_standard(1 << 20) == 150_981
    assert least_frames(1 << 20) == (150_981, 150_982)


def test_what_is_long_takes_the_least_number_of_frames_up() -> None:
    pair = big_pair(long())
    pair.upload()
    pair.bus.settle()
    (outcome,) = pair.outcomes
    assert isinstance(outcome, SdoUploaded)
    assert outcome.data == long()
    assert len(pair.bus.sent) == frames_by_the_standard(LONG) + 1  # and the start


@pytest.mark.parametrize("size", [1, 6, 7, 8, 888, 889, 890, 1778, 1779])
def test_the_least_number_of_frames_for_other_sizes(size: int) -> None:
    for kind, least in zip(("download", "upload"), least_frames(size), strict=True):
        pair = BlockPair(None, pattern(size))
        pair.download(pattern(size)) if kind == "download" else pair.upload()
        pair.settle()
        assert pair.is_right(pattern(size))
        assert len(pair.bus.sent) == least


# ---- bursts ----


@pytest.mark.parametrize("max_burst", [1, MAX_BURST, 126, 200])
@pytest.mark.parametrize("kind", ["download", "upload"])
def test_no_turn_says_more_than_a_burst(kind: str, max_burst: int) -> None:
    options = {"max_burst": max_burst, "burst_interval": MILLISECOND}
    pair = BlockPair(None, pattern(2000), client=options, server=options)
    longest = 0
    pair.download(pattern(2000)) if kind == "download" else pair.upload()
    while pair.bus.next_time() < 1 << 60:
        before = len(pair.bus.sent)
        pair.bus.step()
        longest = max(longest, len(pair.bus.sent) - before)
    assert pair.is_right(pattern(2000))
    assert longest == min(max_burst, 127)


def test_a_burst_waits_for_its_interval() -> None:
    bench = ClientBench(max_burst=3, burst_interval=2 * MILLISECOND)
    bench.download(pattern(60))
    assert bench.tell("A4 00 20 00 08") == segments(pattern(60), 3, final=False)
    assert bench.client.deadline == bench.now + 2 * MILLISECOND
    bench.client.handle_timeout(bench.now + MILLISECOND)
    assert bench.said() == []
    assert bench.wait() == segments(pattern(60)[21:], 3, final=False, first=4)
    assert bench.wait() == segments(pattern(60)[42:], 2, final=False, first=7)


# ---- streams, client ----


@examples(60)
@given(
    size=st.integers(0, 5000),
    feed_size=st.sampled_from([1, 7, 100, 889, 1024, 5000]),
    known=st.booleans(),
    by_host=st.booleans(),
    block_size=st.integers(1, 127),
)
def test_a_download_stream_of_pieces_of_any_size(size: int, feed_size: int, known: bool, by_host: bool, block_size: int) -> None:
    """Trap 5: pieces of 1024 bytes. Trap 4: what is repeated is what was given."""
    content = pattern(size)
    pair = BlockPair(None, client={"max_upload": 1 << 14}, server={"max_download": 1 << 14, "block_size": block_size})
    pair.to_feed, pair.feed_size = content, feed_size
    pair.client.download_stream(BY_HOST if by_host else INDEX, 0, 0, size=size if known else None)
    if size == 0 and not known:
        pair.feed(1)
    pair.settle()
    assert pair.is_right(content)


@examples(60)
@given(size=st.integers(0, 5000), piece=st.sampled_from([1, 7, 100, 1024, 5000]), announced=st.booleans(), plain=st.booleans())
def test_an_upload_of_what_the_host_gives_in_pieces(size: int, piece: int, announced: bool, plain: bool) -> None:
    content = pattern(size)
    pair = BlockPair(None, content, host_piece=piece, client={"max_upload": 1 << 14})
    pair.host_size = size if announced else None
    if plain:
        pair.upload(False, BY_HOST)
    else:
        pair.client.upload_stream(BY_HOST, 0, 0)
    pair.settle()
    assert pair.is_right(content)


def test_what_was_fed_may_be_changed_by_its_owner() -> None:
    """Trap 4: a reused buffer, and a loss in the second sub-block."""
    bench, buffer = ClientBench(), bytearray(b"\x11" * 21)
    request_id = bench.client.download_stream(0x2000, 0, 0)
    bench.tell("A4 00 20 00 02")
    bench.client.feed(request_id, buffer, bench.now)
    buffer[:] = b"\x22" * 21
    bench.client.feed(request_id, buffer, bench.now)
    buffer[:] = b"\x33" * 21
    content = b"\x11" * 21 + b"\x22" * 21
    bench.turn()
    bench.said()
    assert bench.tell("A2 02 02") == segments(content[14:], 2, final=False)
    assert bench.tell("A2 00 02") == segments(content[14:], 2, final=False)


def test_a_download_stream_asks_for_more_in_time() -> None:
    bench = ClientBench()
    request_id = bench.client.download_stream(0x2000, 0, 0, size=100)
    assert bench.said() == frames("C6 00 20 00 64")
    assert bench.events() == []
    assert bench.tell("A4 00 20 00 04") == []
    assert bench.outcome() == SdoDataWanted(12, request_id, 0x2000, 0, 100)
    assert bench.client.deadline == bench.now + STREAM_TIMEOUT
    assert bench.client.feed(request_id, pattern(28), bench.now)  # just a sub-block: the next byte tells whether it is the last
    bench.turn()
    assert bench.said() == []
    assert bench.outcome() == SdoDataWanted(12, request_id, 0x2000, 0, 72)
    bench.client.feed(request_id, pattern(100)[28:], bench.now)
    bench.turn()
    assert bench.said() == segments(pattern(100), 4, final=False)
    assert bench.events() == []


def test_a_stream_that_starves() -> None:
    bench = ClientBench()
    request_id = bench.client.download_stream(0x2000, 0, 0)
    bench.tell("A4 00 20 00 04")
    bench.events()
    assert bench.tell("A2 00 04") == []  # the server asks; nothing was sent
    bench.events()
    assert bench.wait() == frames("80 00 20 00 20 00 00 08")
    assert bench.aborted() == (0x08000020, AbortOrigin.TIMEOUT)
    assert not bench.client.feed(request_id, b"1", bench.now)


def test_what_may_be_fed_is_bounded_and_a_fault_changes_nothing() -> None:
    bench = ClientBench()
    request_id = bench.client.download_stream(0x2000, 0, 0, size=MAX_FED + 10)
    assert bench.client.feed(request_id, bytes(MAX_FED - 1), 0)  # before the server has answered
    with pytest.raises(LocalProtocolError, match="download 0x2000:00: 65535 bytes are waiting"):
        bench.client.feed(request_id, b"12", 0)
    with pytest.raises(LocalProtocolError, match="65536 bytes fed, 65546 announced"):
        bench.client.feed(request_id, b"1", 0, last=True)
    assert bench.client.feed(request_id, b"1", 0)
    bench.tell("A4 00 20 00 7F", "A2 7F 7F")
    with pytest.raises(LocalProtocolError, match="announced"):
        bench.client.feed(request_id, bytes(11), bench.now)
    assert bench.client.feed(request_id, memoryview(bytes(10)), bench.now)
    assert bench.client.feed(request_id, b"", bench.now, last=True)  # the end of the file
    with pytest.raises(LocalProtocolError, match="it is complete"):
        bench.client.feed(request_id, b"1", bench.now)


def test_only_streams_can_be_fed() -> None:
    bench = ClientBench()
    plain = bench.client.download(0x2000, 0, bytes(10), 0)
    block = bench.client.download(0x2000, 0, bytes(10), 0, block=True)
    upload = bench.client.upload_stream(0x2000, 0, 0)
    for request_id in (plain, block, upload):
        with pytest.raises(LocalProtocolError, match="stream"):
            bench.client.feed(request_id, b"1", 0)
        assert bench.client.room(request_id) == 0
    assert not bench.client.feed(999, b"1", 0)
    assert not bench.client.proceed(plain, 0)
    with pytest.raises(LocalProtocolError, match="size 0..0xFFFFFFFF"):
        bench.client.download_stream(0x2000, 0, 0, size=1 << 32)


def test_an_upload_stream_waits_for_its_reader() -> None:
    bench, content = ClientBench(block_size=3), pattern(30)
    request_id = bench.client.upload_stream(0x2000, 0, 0)
    bench.tell("C6 00 20 00 1E")
    assert not bench.client.proceed(request_id + 1, bench.now)
    assert bench.client.proceed(request_id, bench.now)  # nothing to proceed with
    assert bench.tell(*segments(content, 3, final=False)) == []
    assert bench.outcome() == SdoChunk(12, request_id, 0x2000, 0, 0, content[:21])
    assert bench.tell(segments(content, 3, final=False)[-1]) == []  # a copy meanwhile
    bench.events()
    bench.client.proceed(request_id, bench.now)
    assert bench.said() == frames("A2 03 03")
    assert bench.tell(*segments(content[21:])) == frames("A2 02 03")

    bench.tell("D5" + crc_hqx(content, 0).to_bytes(2, "little").hex())
    assert bench.events() == [
        SdoChunk(12, request_id, 0x2000, 0, 21, content[21:]),
        SdoStreamUploaded(12, request_id, 0x2000, 0, 30),
    ]


def test_a_server_that_only_paused_goes_on_while_the_reader_is_busy() -> None:
    bench = ClientBench()
    bench.client.upload_stream(0x2000, 0, 0)
    sent = segments(pattern(300))
    bench.tell("C6 00 20 00 2C 01", *sent[:5])
    assert bench.wait() == []
    assert isinstance(bench.outcome(), SdoChunk)
    assert bench.tell(sent[5]) == frames("80 00 20 00 03 00 04 05")
    assert bench.aborted() == (0x05040003, AbortOrigin.LOCAL)


def test_late_segments_while_the_reader_is_busy_cost_nothing() -> None:
    """Frames that others overtook, behind a gateway."""
    bench, content = ClientBench(block_size=3), pattern(30)
    request_id = bench.client.upload_stream(0x2000, 0, 0)
    sent = segments(content, 3, final=False)
    bench.tell("C6 00 20 00 1E", *sent)
    assert bench.tell(*sent[:2]) == []
    bench.client.proceed(request_id, bench.now)
    assert bench.said() == frames("A2 03 03")
    end = "D5" + crc_hqx(content, 0).to_bytes(2, "little").hex()
    assert bench.tell(*segments(content[21:]), sent[0], end) == frames("A2 02 03", "A1")


def test_a_reader_that_does_not_come_back() -> None:
    bench = ClientBench(block_size=3)
    bench.client.upload_stream(0x2000, 0, 0)
    bench.tell("C6 00 20 00 1E", *segments(pattern(30), 3, final=False))
    bench.events()
    assert bench.wait() == frames("80 00 20 00 20 00 00 08")
    assert bench.aborted() == (0x08000020, AbortOrigin.TIMEOUT)


def test_streams_wait_in_line_like_all_requests() -> None:
    bench = ClientBench()
    first = bench.client.upload(0x1000, 0, 0)
    stream = bench.client.download_stream(0x2000, 0, 0)
    bench.client.feed(stream, b"abc", 0, last=True)
    assert bench.said() == frames("40 00 10 00")
    assert bench.tell("4F 00 10 00 01") == frames("C4 00 20 00")
    assert bench.tell("A4 00 20 00 7F") == frames("81 61 62 63")
    assert isinstance(bench.outcome(), SdoUploaded)
    assert first < stream


def test_a_megabyte_in_streams_is_never_held() -> None:
    """Client, server and their host hold less than 70 kB of it at any time."""
    pair = BlockPair(Bus(), client={"max_burst": 127}, server={"max_burst": 127, "max_download": 1000})
    content = pattern(1 << 18)
    fed = received = 0
    most = 0

    def on_event(report: object) -> None:
        nonlocal fed, received, most
        if isinstance(report, SdoDataWanted):
            pair.client.feed(report.request_id, content[fed : fed + 4096], pair.bus.now)
            fed = min(fed + 4096, len(content))
        elif hasattr(report, "access_id"):
            assert report.data == content[received : received + len(report.data)]
            received += len(report.data)
            pair.server.complete(report.access_id, None, pair.bus.now)
        elif isinstance(report, SdoDownloaded):
            pair.outcomes.append(report)
        most = max(most, len(getattr(pair.client._transfer, "_content", b"")), held_data(pair.server._transfer))

    pair.bus.on_event = on_event
    pair.client.download_stream(BY_HOST, 0, 0, size=len(content))
    pair.settle()
    assert received == len(content)
    assert most <= 4096 + 2 * 889
