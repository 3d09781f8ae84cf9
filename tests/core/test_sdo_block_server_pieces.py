"""An object that the host of a device serves in pieces: by block transfer and by segments (CiA 301, 7.2.4.3.3 to .16)."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.machine import LocalProtocolError
from canopen_proto.sdo.server import ACCESS_TIMEOUT, ObjectAccessPending, ObjectWritten, SdoServerAborted
from tests.core.block_bench import ServerBench, crc_bytes, frames, segments
from tests.core.block_pair import pattern


def pending(bench: ServerBench) -> ObjectAccessPending:
    report = bench.outcome()
    assert isinstance(report, ObjectAccessPending)
    return report


def test_a_block_download_in_pieces() -> None:
    """max_download is for what is held whole."""
    bench, content = ServerBench(block_size=3, max_download=30), pattern(45)
    bench.tell("C4 01 20 00")
    assert bench.tell(*segments(content, 3, final=False)) == []
    access = pending(bench)
    assert access == ObjectAccessPending(12, access.access_id, 0x2001, 0, content[:21], True, 0)
    assert bench.server.deadline == bench.now + ACCESS_TIMEOUT
    assert bench.tell(segments(content, 3, final=False)[-1]) == []  # its copy
    bench.events()
    with pytest.raises(LocalProtocolError, match="0x2001:00, node 12: None or an AbortCode expected"):
        bench.server.complete(access.access_id, b"", bench.now)
    assert bench.server.complete(access.access_id, None, bench.now)
    assert bench.said() == frames("A2 03 03")
    first, _, third = segments(content[21:], 3, final=False)
    bench.tell(first, third)  # the second is lost
    access = pending(bench)
    assert (access.data, access.more, access.offset) == (content[21:28], True, 21)
    bench.server.complete(access.access_id, None, bench.now)
    assert bench.said() == frames("A2 01 03")
    assert bench.tell(*segments(content[28:])) == frames("A2 03 03")
    assert bench.tell("D1" + crc_bytes(content)) == []
    access = pending(bench)
    assert (access.data, access.more, access.offset) == (content[28:], False, 28)
    assert bench.server.complete(access.access_id, None, bench.now)
    assert bench.said() == frames("A1")
    assert bench.outcome() == ObjectWritten(12, 0x2001, 0)


def test_the_host_refuses_a_piece_or_stays_silent() -> None:
    for silent in (False, True):
        bench = ServerBench(block_size=3)
        bench.tell("C4 01 20 00", *segments(pattern(45), 3, final=False))
        access = pending(bench)
        if silent:
            assert bench.wait() == frames("80 01 20 00 20 00 00 08")
            assert not bench.server.complete(access.access_id, None, bench.now)
        else:
            assert bench.server.complete(access.access_id, AbortCode.HARDWARE_ERROR, bench.now)
            assert bench.said() == frames("80 01 20 00 00 00 06 06")
        assert isinstance(bench.outcome(), SdoServerAborted)


def test_a_block_upload_in_pieces() -> None:
    bench, content = ServerBench(), pattern(40)
    assert bench.tell("A4 01 20 00 02 FF") == []  # the threshold does not matter: the size is not known
    access = pending(bench)
    assert (access.data, access.more, access.offset) == (None, False, 0)
    assert bench.tell("A4 01 20 00 02 FF") == []  # its copy
    bench.events()
    bench.server.complete(access.access_id, content[:10], bench.now, more=True)
    assert bench.said() == frames("C4 01 20 00")
    assert bench.tell("A3") == []  # not all of the first sub-block is there
    access = pending(bench)
    assert (access.more, access.offset) == (True, 10)
    bench.server.complete(access.access_id, content[10:27], bench.now, more=True)
    bench.turn()
    assert bench.said() == segments(content, 2, final=False)
    access = pending(bench)
    assert access.offset == 27
    assert bench.tell("A2 02 02") == []
    assert bench.events() == []  # it has been asked
    bench.server.complete(access.access_id, content[27:], bench.now)
    bench.turn()
    assert bench.said() == segments(content[14:], 2, final=False)
    assert bench.tell("A2 02 02") == segments(content[28:])
    assert bench.tell("A2 02 02") == frames("C9" + crc_bytes(content))
    bench.tell("A1")
    assert not bench.server.busy


def test_a_host_that_gives_no_more() -> None:
    bench = ServerBench()
    bench.tell("A4 01 20 00 7F")
    bench.server.complete(pending(bench).access_id, b"12345678", bench.now, more=True, size=1000)
    assert bench.said() == frames("C6 01 20 00 E8 03")
    bench.tell("A3")
    assert bench.wait() == frames("80 01 20 00 20 00 00 08")


def test_a_segmented_upload_in_pieces() -> None:
    bench, content = ServerBench(), pattern(20)
    bench.tell("40 01 20 00")
    bench.server.complete(pending(bench).access_id, content[:3], bench.now, more=True, size=20)
    assert bench.said() == frames("41 01 20 00 14")
    assert bench.tell("60") == []
    access = pending(bench)
    assert (access.more, access.offset) == (True, 3)
    assert bench.tell("60") == []  # its copy
    bench.events()
    bench.server.complete(access.access_id, content[3:16], bench.now, more=True)
    assert bench.said() == frames("00" + content[:7].hex())
    assert bench.tell("70") == frames("10" + content[7:14].hex())
    assert bench.tell("60") == []
    bench.server.complete(pending(bench).access_id, content[16:], bench.now)
    assert bench.said() == frames("03" + content[14:].hex())
    assert not bench.server.busy


@pytest.mark.parametrize("size", [None, 1000])
def test_a_segmented_download_in_pieces(size: int | None) -> None:
    """max_download is for what is held whole."""
    bench, content = ServerBench(max_download=900), pattern(1000)
    assert bench.tell("20 01 20 00" if size is None else "21 01 20 00 E8 03") == frames("60 01 20 00")
    toggle, taken = 0, b""
    for offset in range(0, 1000, 7):
        piece = content[offset : offset + 7]
        command = toggle | (7 - len(piece)) << 1 | (1 if offset + 7 >= 1000 else 0)
        said = bench.tell(bytes((command,)).hex() + piece.hex())
        if not said:
            access = pending(bench)
            assert access.data is not None
            assert access.offset == len(taken)
            taken += access.data
            assert access.more == (offset + 7 < 1000)
            bench.server.complete(access.access_id, None, bench.now)
            said = bench.said()
        assert said == frames("30" if toggle else "20")
        toggle ^= 0x10
    assert taken == content
    assert isinstance(bench.outcome(), ObjectWritten)
    assert not bench.server.busy


def test_a_segmented_download_in_pieces_that_nobody_takes() -> None:
    bench = ServerBench()
    bench.tell("20 01 20 00", *[f"{number % 2 << 4:02X}01020304050607" for number in range(127)])
    assert isinstance(bench.events()[-1], ObjectAccessPending)
    assert bench.wait() == frames("80 01 20 00 20 00 00 08")


def test_expedited_downloads_of_such_an_object() -> None:
    bench = ServerBench()
    assert bench.tell("22 01 20 00 01 02 03 04") == []
    access = pending(bench)
    assert (access.data, access.more) == (b"\x01\x02\x03\x04", False)
    bench.server.complete(access.access_id, None, bench.now)
    assert bench.said() == frames("60 01 20 00")
