"""The server's side of block transfers: frames as in the standard, and what a client may do (CiA 301, 7.2.4.3.8 to .16)."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, FrameIgnored
from canopen_proto.sdo.block import COPY_TIME, LEAST_SILENCE, MAX_BLOCK_SIZE
from canopen_proto.sdo.server import ObjectAccessPending, ObjectWritten, SdoServerAborted
from tests.core.block_bench import ServerBench, crc_bytes, frames, segments
from tests.core.block_pair import pattern

TEXT = b"Hello, blocks"
UPLOAD = "A4 00 20 00 7F 00"
DOWNLOAD = "C6 00 20 00 0D 00 00 00"


# ---- upload ----


def test_an_upload() -> None:
    bench = ServerBench(TEXT)
    assert bench.tell(UPLOAD) == frames("C6 00 20 00 0D 00 00 00")
    assert bench.tell("A3") == frames("01 48 65 6C 6C 6F 2C 20", "82 62 6C 6F 63 6B 73 00")
    assert bench.tell("A2 02 7F") == frames("C5" + crc_bytes(TEXT))
    assert bench.tell("A1") == []
    assert bench.events() == []
    assert not bench.server.busy
    assert bench.server.deadline == NEVER


@pytest.mark.parametrize(
    ("server_crc", "request_", "answer"), [(False, UPLOAD, "C2 00 20 00 0D"), (True, "A0 00 20 00 7F", "C6 00 20 00 0D")]
)
def test_an_upload_without_crc(server_crc: bool, request_: str, answer: str) -> None:
    """The server says what it can (sc), whatever the client can (cc); the CRC counts where both can. 7.2.4.3.13"""
    bench = ServerBench(TEXT, crc=server_crc)
    assert bench.tell(request_) == frames(answer)
    bench.tell("A3")
    assert bench.tell("A2 02 7F") == frames("C5")


@pytest.mark.parametrize(
    ("size", "threshold", "answer"),
    [
        (2, 0, "C6 00 20 00 02"),  # trap 15: 0 forbids the change
        (2, 1, "C6 00 20 00 02"),
        (2, 2, "4B 00 20 00 01 01"),
        (5, 4, "C6 00 20 00 05"),
        (5, 5, "41 00 20 00 05"),
        (255, 255, "41 00 20 00 FF"),
        (256, 255, "C6 00 20 00 00 01"),
        (0, 0, "C6 00 20 00"),
        (0, 1, "41 00 20 00"),
    ],
)
def test_a_normal_upload_where_the_threshold_allows_it(size: int, threshold: int, answer: str) -> None:
    bench = ServerBench(bytes([1]) * size)
    assert bench.tell(f"A4 00 20 00 7F {threshold:02X}") == frames(answer)
    if answer.startswith("41"):
        assert len(bench.tell("60")) == 1


@pytest.mark.parametrize("block_size", [0, 128, 255])
def test_bad_block_sizes(block_size: int) -> None:
    bench = ServerBench(pattern(60))
    assert bench.tell(f"A4 00 20 00 {block_size:02X}") == frames("80 00 20 00 02 00 04 05")
    assert bench.aborted() == (0x05040002, AbortOrigin.LOCAL)
    bench.tell("A4 00 20 00 04", "A3")
    assert bench.tell(f"A2 04 {block_size:02X}") == frames("80 00 20 00 02 00 04 05")
    assert bench.aborted() == (0x05040002, AbortOrigin.LOCAL)


@pytest.mark.parametrize("acknowledged", [5, 127, 128, 255])
def test_bad_sequence_numbers(acknowledged: int) -> None:
    bench = ServerBench(pattern(60))
    bench.tell("A4 00 20 00 04", "A3")
    assert bench.tell(f"A2 {acknowledged:02X} 04") == frames("80 00 20 00 03 00 04 05")
    assert bench.aborted() == (0x05040003, AbortOrigin.LOCAL)


def test_the_start_may_be_lost() -> None:
    """A client that asks for the first sub-block gets it."""
    bench = ServerBench(TEXT)
    bench.tell(UPLOAD)
    assert bench.tell("A2 00 01") == segments(TEXT, 1, final=False)


@pytest.mark.parametrize("heard", [[], ["A3"], ["A3", "A2 02 7F"]], ids=len)
@pytest.mark.parametrize("wrong", ["60", "00", "C1", "E0", "A1", "A2 03 04"])
def test_other_frames_in_an_upload(heard: list[str], wrong: str) -> None:
    bench = ServerBench(TEXT)
    bench.tell(UPLOAD, *heard)
    if (len(heard), wrong) == (2, "A1"):
        return
    code = "03" if (len(heard), wrong) == (1, "A2 03 04") else "01"
    assert bench.tell(wrong) == frames(f"80 00 20 00 {code} 00 04 05")


@pytest.mark.parametrize("heard", [[], ["A3"], ["A3", "A2 02 7F"]], ids=len)
def test_silence_aborts_and_a_new_request_in_an_upload(heard: list[str]) -> None:
    bench = ServerBench(TEXT)
    bench.tell(UPLOAD, *heard)
    assert bench.server.deadline == bench.now + 2 * LEAST_SILENCE
    assert bench.wait() == frames("80 00 20 00 00 00 04 05")
    assert bench.aborted() == (0x05040000, AbortOrigin.TIMEOUT)
    bench.tell(UPLOAD, *heard)
    assert bench.tell("80 00 00 00 00 00 00 08") == []
    assert bench.aborted() == (0x08000000, AbortOrigin.PEER)
    bench.tell(UPLOAD, *heard)
    assert bench.tell("A4 00 20 00 05") == frames("C6 00 20 00 0D")
    assert bench.outcome() == SdoServerAborted(12, 0x2000, 0, 0x08000000, AbortOrigin.REPLACED)


def test_second_copies_in_an_upload() -> None:
    bench = ServerBench(pattern(60))
    assert bench.tell_at_once(*["A4 00 20 00 04"] * 2) == frames("C6 00 20 00 3C") * 2
    assert bench.tell_at_once("A3", "A3") == segments(pattern(60), 4, final=False)
    assert bench.tell_at_once("A2 04 05", "A2 04 05") == segments(pattern(60)[28:], 5)
    assert bench.tell_at_once("A2 05 05", "A2 05 05") == frames("CD" + crc_bytes(pattern(60)))
    assert bench.tell_at_once("A1", "A1") == []
    assert {type(report) for report in bench.events()} == {FrameIgnored}
    assert bench.tell("A1") == frames("80 00 00 00 01 00 04 05")  # a third one is none


# ---- download ----


def test_a_download() -> None:
    bench = ServerBench()
    assert bench.tell(DOWNLOAD) == frames("A4 00 20 00 7F")
    assert bench.tell(*segments(TEXT)) == frames("A2 02 7F")
    assert bench.tell("C5" + crc_bytes(TEXT)) == frames("A1")
    assert bench.outcome() == ObjectWritten(12, 0x2000, 0)
    assert bench.store.written == [TEXT]
    assert bench.server.deadline == NEVER


@pytest.mark.parametrize(
    ("server_crc", "request_", "answer"),
    [
        (False, DOWNLOAD, "A0 00 20 00 7F"),
        (True, "C2 00 20 00 0D", "A4 00 20 00 7F"),
        (True, "C4 00 20 00", "A4 00 20 00 7F"),
        (True, "C0 00 20 00", "A4 00 20 00 7F"),
    ],
)
def test_downloads_without_crc_and_of_unknown_size(server_crc: bool, request_: str, answer: str) -> None:
    bench = ServerBench(crc=server_crc)
    assert bench.tell(request_) == frames(answer)
    bench.tell(*segments(TEXT))
    has_crc = server_crc and request_.startswith("C4")
    assert bench.tell("C5" + (crc_bytes(TEXT) if has_crc else "")) == frames("A1")
    assert bench.store.written == [TEXT]


@pytest.mark.parametrize("sent", [["81", "DD"], ["81", "C1"], ["DD"], ["C1"]], ids=str)
def test_a_download_of_nothing(sent: list[str]) -> None:
    """Some clients send an empty segment, others the end at once."""
    bench = ServerBench()
    bench.tell("C6 00 20 00")
    if sent == ["81", "C1"]:  # seven bytes, where none were announced
        assert bench.tell(*sent)[-1:] == frames("80 00 20 00 12 00 07 06")
        return
    assert bench.tell(*sent)[-1:] == frames("A1")
    assert bench.store.written == [b""]


def test_an_upload_of_nothing_is_one_segment_without_data() -> None:
    bench = ServerBench()
    assert bench.tell(UPLOAD) == frames("C6 00 20 00")
    assert bench.tell("A3") == frames("81")
    assert bench.tell("A2 01 7F") == frames("DD")


def test_the_block_size_is_the_servers_and_may_change() -> None:
    bench = ServerBench(block_size=3)
    content = pattern(70)
    assert bench.tell("C6 00 20 00 46") == frames("A4 00 20 00 03")
    bench.server.block_size = 200
    assert bench.tell(*segments(content, 3, final=False)) == frames("A2 03 7F")
    bench.tell(*segments(content[21:]))
    assert bench.tell("C1" + crc_bytes(content)) == frames("A1")


@pytest.mark.parametrize(("asked", "chosen"), [(0, 2), (1, 2), (2, 2), (127, 127), (128, 127)])
def test_a_block_size_of_1_is_never_asked_for_because_of_copies(asked: int, chosen: int) -> None:
    assert ServerBench(block_size=asked).tell("C6 00 20 00 0D") == frames(f"A4 00 20 00 {chosen:02X}")


@pytest.mark.parametrize("lost", [0, 1, 2, 3])
def test_a_segment_is_lost(lost: int) -> None:
    bench, content = ServerBench(block_size=4), pattern(60)
    bench.tell("C6 00 20 00 3C")
    block = segments(content, 4, final=False)
    said = bench.tell(*block[:lost], *block[lost + 1 :])
    if lost == 3:
        assert said == []
        assert bench.server.deadline == bench.now + LEAST_SILENCE
        said = bench.wait()
    assert said == frames(f"A2 {lost:02X} 04")
    assert bench.tell(*segments(content[lost * 7 :], 4, final=False)) == frames("A2 04 04")


def test_a_last_segment_that_is_alone_is_asked_for_where_crc_and_size_guard_the_whole() -> None:
    for request_, says in [("C6 00 20 00 0F", frames("A2 00 02")), ("C2 00 20 00 0F", []), ("C4 00 20 00", [])]:
        bench = ServerBench(block_size=2)
        bench.tell(request_)
        bench.tell(*segments(pattern(15), 2, final=False))
        assert bench.server.deadline == bench.now + LEAST_SILENCE
        assert bench.wait() == says


@pytest.mark.parametrize("count", [2, 4])
def test_an_acknowledgement_that_is_lost_is_repeated_once(count: int) -> None:
    """count: sub-blocks that come: the last one's acknowledgement is repeated too, while the end is due."""
    bench, content = ServerBench(block_size=2), pattern(56)
    bench.tell("C6 00 20 00 38")
    for offset in range(0, count * 14, 14):
        said = bench.tell(*segments(content[offset:], 2, final=offset == 42))
    assert bench.wait() == said == frames("A2 02 02")
    assert bench.wait() == frames("80 00 20 00 00 00 04 05")
    assert bench.aborted() == (AbortCode.TIMED_OUT, AbortOrigin.TIMEOUT)


@pytest.mark.parametrize("request_", ["C2 00 20 00 38", "C4 00 20 00"], ids=["no crc", "no size"])
def test_it_is_not_repeated_where_crc_or_size_is_missing(request_: str) -> None:
    bench = ServerBench(block_size=2)
    bench.tell(request_, *segments(pattern(56), 2, final=False))
    assert [bench.wait(), bench.wait()] == [[], frames("80 00 20 00 00 00 04 05")]


def test_an_acknowledgement_that_is_lost_before_a_last_segment_shows_in_the_size() -> None:
    """It may have been that segment; the client repeats what the server has already, when it is asked."""
    bench, content = ServerBench(block_size=2), pattern(20)
    bench.tell("C6 00 20 00 14")
    bench.tell(*segments(content, 2, final=False))
    assert bench.wait() == frames("A2 00 02")
    bench.tell(*segments(content, 2, final=False))
    assert bench.aborted() == (AbortCode.LENGTH_TOO_HIGH, AbortOrigin.LOCAL)
    assert bench.store.written == []


@pytest.mark.parametrize(
    ("end", "code"),
    [
        ("C5 12 34", AbortCode.CRC_ERROR),
        ("C1" + crc_bytes(TEXT + b"\x00"), AbortCode.LENGTH_TOO_HIGH),
        ("C9" + crc_bytes(TEXT[:-1]), AbortCode.LENGTH_TOO_LOW),
    ],
)
def test_what_is_not_right_is_not_written(end: str, code: AbortCode) -> None:
    bench = ServerBench()
    bench.tell(DOWNLOAD, *segments(TEXT))
    assert bench.tell(end) == frames("80 00 20 00" + code.to_bytes(4, "little").hex())
    assert bench.aborted() == (code, AbortOrigin.LOCAL)
    assert bench.store.written == []


def test_too_much() -> None:
    bench = ServerBench(max_download=20)
    assert bench.tell("C6 00 20 00 15") == frames("80 00 20 00 05 00 04 05")
    bench.tell("C6 00 20 00 07")
    assert bench.tell(*segments(pattern(21))) == frames("80 00 20 00 12 00 07 06")
    bench.tell("C4 00 20 00")
    assert bench.tell(*segments(pattern(35))) == frames("80 00 20 00 05 00 04 05")
    assert bench.tell("C6 01 30 00 07") == frames("80 01 30 00 00 00 02 06")
    assert bench.store.written == []


@pytest.mark.parametrize("sequence", ["00", "05", "7F", "FF"])
def test_bad_sequence_numbers_in_a_download(sequence: str) -> None:
    bench = ServerBench(block_size=4)
    bench.tell("C6 00 20 00 3C")
    assert bench.tell(sequence) == frames("80 00 20 00 03 00 04 05")
    assert bench.aborted() == (0x05040003, AbortOrigin.LOCAL)


def test_silence_in_a_download() -> None:
    bench = ServerBench()
    bench.tell("C2 00 20 00 0D")
    start = bench.now
    assert [bench.wait(), bench.wait()] == [[], frames("80 00 20 00 00 00 04 05")]
    assert bench.now == start + 2 * LEAST_SILENCE
    assert bench.aborted() == (0x05040000, AbortOrigin.TIMEOUT)
    bench.tell("C2 00 20 00 0D", *segments(TEXT))
    assert [bench.wait(), bench.wait()] == [[], frames("80 00 20 00 00 00 04 05")]
    assert bench.aborted() == (0x05040000, AbortOrigin.TIMEOUT)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_the_client_aborts(count: int) -> None:
    bench = ServerBench()
    bench.tell(DOWNLOAD, *segments(TEXT)[:count])
    assert bench.tell("80 00 20 00 00 00 00 08") == []
    assert bench.aborted() == (0x08000000, AbortOrigin.PEER)
    assert bench.tell("4F 00 20 00") == frames("41 00 20 00")  # at once


def test_a_new_request_where_the_end_is_due() -> None:
    bench = ServerBench(b"\x01")
    bench.tell(DOWNLOAD, *segments(TEXT))
    assert bench.tell("40 00 20 00") == frames("4F 00 20 00 01")
    assert bench.outcome() == SdoServerAborted(12, 0x2000, 0, 0x08000000, AbortOrigin.REPLACED)
    bench.tell(DOWNLOAD, *segments(TEXT))
    assert bench.tell("60") == frames("80 00 20 00 01 00 04 05")


def test_second_copies_in_a_download() -> None:
    bench, content = ServerBench(block_size=4), pattern(33)
    assert bench.tell_at_once(*["C6 00 20 00 21"] * 2) == frames("A4 00 20 00 04")
    assert bench.tell_at_once(*[frame for frame in segments(content, 4, final=False) for _ in range(2)]) == frames("A2 04 04")
    assert bench.tell_at_once(*segments(content[28:]) * 2) == frames("A2 01 04")
    assert bench.tell_at_once(*["C9" + crc_bytes(content)] * 2) == frames("A1")
    assert bench.store.written == [content]


@pytest.mark.parametrize("count", [0x20, 0x24, 0x40, 0x44])
def test_the_second_copy_of_a_last_segment_is_no_request_though_its_number_is_one(count: int) -> None:
    bench, content = ServerBench(), pattern(count * 7)
    bench.tell("C6 00 20 00" + len(content).to_bytes(4, "little").hex())
    sent = segments(content)
    assert bench.tell_at_once(*sent, sent[-1]) == frames(f"A2 {count:02X} 7F")
    assert bench.tell("C1" + crc_bytes(content)) == frames("A1")
    assert bench.store.written == [content]


@pytest.mark.parametrize("request_", ["40 00 20 00", "21 00 20 00 0D", "2F 00 20 00 01", UPLOAD, "C6 00 20 00 0E", DOWNLOAD])
def test_a_client_that_did_not_get_the_answer_begins_anew(request_: str) -> None:
    """Before the first segment an initiate is none, though it bears the number of one; its immediate copy is a copy."""
    bench = ServerBench()
    assert bench.tell_at_once(DOWNLOAD, DOWNLOAD) == frames("A4 00 20 00 7F")
    bench.now += COPY_TIME
    assert bench.tell(request_)[0][2:] != "80"
    assert request_ == DOWNLOAD or isinstance(bench.events()[1], SdoServerAborted)
    bench = ServerBench()
    bench.tell(DOWNLOAD, segments(TEXT)[0])
    bench.tell(request_)  # behind a segment it is one, out of its order
    assert bench.server.busy
    assert bench.events() == []


def test_behind_the_clients_own_abort_nothing_is_on_the_way() -> None:
    bench = ServerBench(bytes(4))
    bench.tell("C6 00 20 00 00 02", *segments(pattern(512), 0x3F, final=False))
    bench.tell("80 00 20 00 00 00 00 08")
    assert bench.tell("40 00 20 00") == frames("43 00 20 00")  # though it bears number 64


def test_segments_still_on_the_way_are_no_requests() -> None:
    """Number 0x23 looks like an expedited download of whatever object its data name. A queue may stand still for any time."""
    bench = ServerBench(bytes(4), block_size=60)
    content = bytes.fromhex("00 20 00 01 02 03 04") * 60
    bench.tell("C6 00 20 00" + len(content).to_bytes(4, "little").hex(), *segments(content, 0x21, final=False))
    bench.server.reset()  # by NMT
    on_the_way = segments(content, 60, final=False)
    bench.now += 60 * SECOND
    assert bench.tell(*on_the_way[0x21:0x24], *on_the_way[0x26:0x2A]) == []  # two of them are lost, too
    bench.now += 60 * SECOND
    assert bench.tell(*on_the_way[0x2A:0x30], *on_the_way) == []  # and another sub-block
    assert bench.store.written == []
    assert bench.tell("40 00 20 00") == frames("43 00 20 00")  # whatever does not go on where it stopped is a request
    assert bench.tell("23 00 20 00 01 02 03 04") == frames("60 00 20 00")


def test_a_request_that_looks_like_a_segment_is_heard_when_it_comes_again() -> None:
    bench = ServerBench(bytes(4))
    bench.tell("C6 00 20 00 00 02", *segments(pattern(512), 0x3F, final=False))
    bench.server.reset()
    assert bench.tell("40 00 20 00") == []  # number 64 is due
    assert bench.tell("40 00 20 00") == frames("43 00 20 00")
    assert bench.tell("40 00 20 00") == frames("43 00 20 00")


@pytest.mark.parametrize("is_full", [False, True])
def test_a_piece_that_the_host_refuses_while_the_client_goes_on(is_full: bool) -> None:
    """is_full: all of the sub-block came. Else it ended by a silence, and the rest of it comes when the transfer is over."""
    bench, content = ServerBench(bytes(4), block_size=0x21), bytes.fromhex("00 20 00 01 02 03 04") * MAX_BLOCK_SIZE
    bench.tell("C4 01 20 00", *segments(content, 0x21 if is_full else 0x1F, final=False))
    if not is_full:
        assert bench.wait() == []
    (access,) = bench.events()
    assert isinstance(access, ObjectAccessPending)
    bench.server.complete(access.access_id, AbortCode.HARDWARE_ERROR, bench.now)
    assert bench.said() == frames("80 01 20 00 00 00 06 06")
    if is_full:  # nothing more of it is on the way: this is a request, though the next number is 0x22
        assert bench.tell("23 00 20 00 01 02 03 04") == frames("60 00 20 00")
    else:
        assert bench.tell(*segments(content, 0x21, final=False)[0x1F:]) == []
        assert bench.store.written == []


@pytest.mark.parametrize("in_pieces", [True, False])
@pytest.mark.parametrize("ends_by", ["abort", "host"])
def test_a_client_that_is_a_sub_block_ahead_says_no_request(in_pieces: bool, ends_by: str) -> None:
    """A silence, our repeated acknowledgement, and its queue goes on: it takes that for the acknowledgement of what is in it."""
    bench, content = ServerBench(bytes(4)), bytes.fromhex("00 20 00 01 02 03 04") * MAX_BLOCK_SIZE
    whole = segments(content, final=not in_pieces)
    assert len(bench.tell("C4 01 20 00" if in_pieces else "C4 00 20 00", *whole)) == (1 if in_pieces else 2)
    reports = bench.events()
    said = bench.tell(*whole[:0x30])  # in the place of the end, or while the host has the piece
    if ends_by == "abort":
        bench.server.reset()
    elif in_pieces:
        assert isinstance(reports[0], ObjectAccessPending)
        bench.server.complete(reports[0].access_id, AbortCode.HARDWARE_ERROR, bench.now)
    else:
        bench.wait()
        bench.wait()
    bench.said()
    assert bench.tell(*whole[0x30:], *whole) == said == []
    assert bench.store.written == []


def test_a_client_that_goes_on_while_the_host_takes_a_piece_has_paused() -> None:
    bench, content = ServerBench(bytes(4)), bytes.fromhex("00 20 00 01 02 03 04") * MAX_BLOCK_SIZE
    bench.tell("C4 01 20 00", *segments(content, 0x22, final=False))
    bench.wait()
    bench.events()
    assert bench.tell(*segments(content)[0x22:]) == frames("80 01 20 00 03 00 04 05")
    assert bench.store.written == []


def test_short_segments_are_lost() -> None:
    bench = ServerBench()
    bench.tell(DOWNLOAD)
    first, last = segments(TEXT)
    bench.server.receive(Frame(0x60C, bytes.fromhex(first)[:7]), bench.now)
    assert bench.said() == []
    assert bench.tell(last) == frames("A2 00 7F")


def test_copy_guard_of_a_server() -> None:
    bench = ServerBench(pattern(60), copy_guard=MILLISECOND)
    bench.tell("A4 00 20 00 04")
    assert bench.tell("A3") == []
    assert bench.wait() == segments(pattern(60), 4, final=False)
