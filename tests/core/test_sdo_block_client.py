"""The client's side of block transfers: frames as in the standard, what a server may do, and falling back on plain transfer.

CiA 301 v4.2.0, 7.2.4.3.8 to 7.2.4.3.16
"""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, FrameIgnored, Time
from canopen_proto.sdo.block import LEAST_SILENCE
from canopen_proto.sdo.client import SdoAborted, SdoDownloaded, SdoUploaded
from tests.core.block_bench import ClientBench, crc_bytes, frames, segments
from tests.core.block_pair import pattern

TEXT = b"Hello, blocks"
"""13 bytes: two segments, of the second of which one byte is unused."""


# ---- download ----


def test_a_download() -> None:
    bench = ClientBench()
    assert bench.download(TEXT) == frames("C6 00 20 00 0D 00 00 00")
    assert bench.tell("A4 00 20 00 7F") == frames("01 48 65 6C 6C 6F 2C 20", "82 62 6C 6F 63 6B 73 00")
    assert bench.tell("A2 02 7F") == frames("C5" + crc_bytes(TEXT))
    assert bench.tell("A1") == []
    assert bench.outcome() == SdoDownloaded(12, 1, 0x2000, 0)
    assert not bench.client.busy


def test_a_download_in_several_sub_blocks_of_changing_size() -> None:
    bench, content = ClientBench(), pattern(70)
    bench.download(content)
    assert bench.tell("A4 00 20 00 03") == segments(content, 3, final=False)
    assert bench.tell("A2 03 05") == segments(content[21:], 5, final=False)
    assert bench.tell("A2 05 01") == segments(content[56:], 1, final=False)
    assert bench.tell("A2 01 02") == segments(content[63:], 1)
    assert bench.tell("A2 01 00") == frames("C1" + crc_bytes(content))  # what follows the last one does not matter
    bench.tell("A1")
    assert isinstance(bench.outcome(), SdoDownloaded)


@pytest.mark.parametrize(("client_crc", "answer"), [(False, "A4"), (False, "A0"), (True, "A0")])
def test_a_download_without_crc(client_crc: bool, answer: str) -> None:
    bench = ClientBench(crc=client_crc)
    assert bench.download(TEXT)[0].startswith("C6" if client_crc else "C2")
    bench.tell(f"{answer} 00 20 00 7F")
    assert bench.tell("A2 02 7F") == frames("C5")


def test_nothing_at_all_is_one_segment_of_which_nothing_is_used() -> None:
    bench = ClientBench()
    assert bench.download(b"") == frames("C6 00 20 00")
    assert bench.tell("A4 00 20 00 7F") == frames("81")
    assert bench.tell("A2 01 7F") == frames("DD")
    bench.tell("A1")
    assert isinstance(bench.outcome(), SdoDownloaded)


@pytest.mark.parametrize("received", [0, 1, 2])
def test_what_the_server_did_not_get_is_sent_again_with_numbers_from_1(received: int) -> None:
    bench, content = ClientBench(), pattern(60)
    bench.download(content)
    bench.tell("A4 00 20 00 03")
    assert bench.tell(f"A2 0{received} 04") == segments(content[received * 7 :], 4, final=False)


@pytest.mark.parametrize("received", [0, 1, 4])
def test_in_the_last_sub_block_too(received: int) -> None:
    """Trap 3: a loss in the last sub-block."""
    bench, content = ClientBench(), pattern(33)
    bench.download(content)
    assert bench.tell("A4 00 20 00 7F") == segments(content)
    assert bench.tell(f"A2 0{received} 7F") == segments(content[received * 7 :])
    assert bench.tell(f"A2 0{5 - received} 7F") == frames("C9" + crc_bytes(content))


def test_a_server_may_complain_of_a_gap_before_the_sub_block_is_over() -> None:
    bench, content = ClientBench(burst_interval=10 * MILLISECOND), pattern(889)
    bench.download(content)
    assert bench.tell("A4 00 20 00 7F") == segments(content, 8, final=False)
    assert bench.tell("A2 03 7F") == segments(content[21:], 8, final=False)


@pytest.mark.parametrize("block_size", [0, 128, 255])
def test_bad_block_sizes(block_size: int) -> None:
    """Trap 7."""
    bench = ClientBench()
    bench.download(TEXT)
    assert bench.tell(f"A4 00 20 00 {block_size:02X}") == frames("80 00 20 00 02 00 04 05")
    assert bench.aborted() == (0x05040002, AbortOrigin.LOCAL)
    bench.download(TEXT)
    bench.tell("A4 00 20 00 01")
    assert bench.tell(f"A2 01 {block_size:02X}") == frames("80 00 20 00 02 00 04 05")
    assert bench.aborted() == (0x05040002, AbortOrigin.LOCAL)


@pytest.mark.parametrize("acknowledged", [3, 127, 128, 255])
def test_acknowledgements_of_what_was_not_sent(acknowledged: int) -> None:
    bench = ClientBench()
    bench.download(TEXT)
    bench.tell("A4 00 20 00 7F")
    assert bench.tell(f"A2 {acknowledged:02X} 7F") == frames("80 00 20 00 03 00 04 05")
    assert bench.aborted() == (0x05040003, AbortOrigin.LOCAL)


def test_a_server_that_never_gets_anything_is_given_up() -> None:
    bench = ClientBench()
    bench.download(TEXT)
    bench.tell("A4 00 20 00 7F")
    for _ in range(10):
        assert bench.tell("A2 00 7F") == segments(TEXT)
    assert bench.tell("A2 00 7F") == frames("80 00 20 00 00 00 04 05")
    assert bench.aborted() == (0x05040000, AbortOrigin.LOCAL)


@pytest.mark.parametrize("wrong", ["60 00 20 00", "20", "30", "A1", "A0 00 20 00 7F", "C1", "FF", "A3", "00"])
@pytest.mark.parametrize("heard", [0, 1, 2])
def test_other_frames_are_faults(heard: int, wrong: str) -> None:
    bench = ClientBench()
    bench.download(TEXT)
    bench.tell(*["A4 00 20 00 7F", "A2 02 7F"][:heard])
    if heard and wrong == "A1" and heard == 2:
        bench.tell(wrong)
        assert isinstance(bench.outcome(), SdoDownloaded)
        return
    if heard == 0 and wrong.startswith("A0"):
        return  # an answer that is right
    assert bench.tell(wrong) == frames("80 00 20 00 01 00 04 05")
    assert bench.aborted() == (0x05040001, AbortOrigin.LOCAL)


@pytest.mark.parametrize("heard", [0, 1, 2])
def test_silence_is_an_abort_wherever_it_begins(heard: int) -> None:
    bench = ClientBench()
    bench.download(TEXT)
    bench.tell(*["A4 00 20 00 7F", "A2 02 7F"][:heard])
    assert bench.wait() == frames("80 00 20 00 00 00 04 05")
    assert bench.aborted() == (0x05040000, AbortOrigin.TIMEOUT)


SERVERS = {
    ("upload", False): ["41 08 10 00 0D", "00 48 65 6C 6C 6F 2C 20"],
    ("upload", True): ["C6 08 10 00 0D", "01 48 65 6C 6C 6F 2C 20", "82 62 6C 6F 63 6B 73 00"],
    ("download", False): ["60 00 20 00", "20"],
    ("download", True): ["A4 00 20 00 01", "A2 01 7F", "A2 01 7F"],
}


@pytest.mark.parametrize("timeout", [500 * MILLISECOND, 3 * SECOND])
@pytest.mark.parametrize(("direction", "block"), SERVERS)
def test_a_time_out_tells_how_long_the_server_was_silent(direction: str, block: bool, timeout: Time) -> None:
    """Inside a block transfer that is two silences: the end of a sub-block may be lost, or its acknowledgement."""
    answers = SERVERS[direction, block]
    for heard in range(len(answers) + 1):
        bench = ClientBench(timeout=timeout)
        if direction == "upload":
            bench.upload(block)
        else:
            bench.download(TEXT, block)
        bench.tell(*answers[:heard])
        last = bench.now
        while bench.client.busy:
            bench.wait()
        report = bench.outcome()
        assert isinstance(report, SdoAborted)
        assert report.waited == bench.now - last
        assert report.waited == (2 * max(timeout, LEAST_SILENCE) if block and heard else timeout)


@pytest.mark.parametrize("heard", [0, 1, 2])
@pytest.mark.parametrize("multiplexer", ["00 20 00", "00 00 00"])
def test_the_server_aborts(heard: int, multiplexer: str) -> None:
    bench = ClientBench()
    bench.download(TEXT)
    bench.tell(*["A4 00 20 00 7F", "A2 02 7F"][:heard])
    assert bench.tell(f"80 {multiplexer} 00 00 06 06") == []
    if not heard and multiplexer == "00 00 00":  # or it is about the transfer before: what follows will tell
        assert [type(report) for report in bench.events()] == [FrameIgnored]
        assert bench.wait() == frames("80 00 20 00 00 00 04 05")
    assert bench.aborted() == (0x06060000, AbortOrigin.PEER)


@pytest.mark.parametrize("heard", [0, 1, 2])
def test_the_abort_of_another_object_is_not_ours(heard: int) -> None:
    bench = ClientBench()
    bench.download(TEXT)
    bench.tell(*["A4 00 20 00 7F", "A2 02 7F"][:heard])
    bench.events()
    bench.tell("80 01 20 00 00 00 06 06")
    assert bench.client.busy


@pytest.mark.parametrize("heard", [0, 1, 2])
def test_a_download_is_cancelled_anywhere_and_the_next_request_works_at_once(heard: int) -> None:
    """Trap 6: an abort, and not the end of the transfer."""
    bench = ClientBench()
    request_id = bench.client.download(0x2000, 0, pattern(900), bench.now, block=True)
    bench.client.upload(0x1000, 0, bench.now)
    bench.said()
    bench.tell(*["A4 00 20 00 7F", "A2 7F 7F"][:heard])
    bench.events()
    assert bench.client.cancel(request_id, bench.now)
    assert bench.said() == frames("80 00 20 00 00 00 00 08", "40 00 10 00")
    bench.tell("A2 7F 7F", "A1", "43 00 10 00 92 01 02 00")  # late ones, then the answer
    assert isinstance(bench.events()[-1], SdoUploaded)


def test_second_copies_of_what_the_server_says() -> None:
    bench, content = ClientBench(), pattern(60)
    bench.download(content)
    assert bench.tell_at_once(*["A4 00 20 00 03"] * 2) == segments(content, 3, final=False)
    assert bench.tell_at_once(*["A2 03 03"] * 2) == segments(content[21:], 3, final=False)
    assert bench.tell_at_once(*["A2 02 03"] * 2) == segments(content[35:], 3, final=False)
    assert bench.tell_at_once(*["A2 03 03"] * 2) == segments(content[56:], 3)
    assert bench.tell_at_once(*["A2 01 03"] * 2) == frames("CD" + crc_bytes(content))
    assert bench.tell_at_once("A1", "A1") == []
    assert sum(isinstance(report, SdoDownloaded) for report in bench.events()) == 1


def test_copy_guard_holds_the_next_sub_block_back_until_copies_have_come() -> None:
    bench, content = ClientBench(copy_guard=MILLISECOND), pattern(60)
    bench.download(content)
    assert bench.tell("A4 00 20 00 03", "A4 00 20 00 03") == segments(content, 3, final=False)
    assert bench.tell("A2 03 03") == []
    assert bench.client.deadline == bench.now + MILLISECOND
    assert bench.tell_at_once("A2 03 03") == []
    assert bench.wait() == segments(content[21:], 3, final=False)


# ---- upload ----


def test_an_upload() -> None:
    bench = ClientBench()
    assert bench.upload() == frames("A4 08 10 00 7F 00")
    assert bench.tell("C6 08 10 00 0D 00 00 00") == frames("A3")
    assert bench.tell(*segments(TEXT)) == frames("A2 02 7F")
    assert bench.tell("C5" + crc_bytes(TEXT)) == frames("A1")
    assert bench.outcome() == SdoUploaded(12, 1, 0x1008, 0, TEXT)


@pytest.mark.parametrize("answer", ["C4 08 10 00", "C0 08 10 00"], ids=["crc", "no crc"])
def test_an_upload_of_unknown_size(answer: str) -> None:
    bench = ClientBench()
    bench.upload()
    assert bench.tell(answer) == frames("A3")
    bench.tell(*segments(TEXT))
    assert bench.tell("C5" + (crc_bytes(TEXT) if answer.startswith("C4") else "")) == frames("A1")
    report = bench.outcome()
    assert isinstance(report, SdoUploaded)
    assert report.data == TEXT


def test_an_upload_of_nothing() -> None:
    bench = ClientBench()
    bench.upload()
    bench.tell("C6 08 10 00 00 00 00 00")
    assert bench.tell("81") == frames("A2 01 7F")
    assert bench.tell("DD") == frames("A1")
    assert bench.outcome() == SdoUploaded(12, 1, 0x1008, 0, b"")


@pytest.mark.parametrize("end", ["DD", "C1"])
def test_an_upload_of_nothing_without_a_segment(end: str) -> None:
    bench = ClientBench()
    bench.upload()
    bench.tell("C6 08 10 00 00 00 00 00")
    assert bench.tell(end) == frames("A1")
    assert bench.outcome() == SdoUploaded(12, 1, 0x1008, 0, b"")
    bench.upload()
    bench.tell("C6 08 10 00 00 00 00 00")
    assert bench.tell(end + "0001") == frames("80 08 10 00 04 00 04 05")  # the CRC of nothing is 0


def test_gaps_are_acknowledged_at_the_end_of_the_sub_block() -> None:
    """Trap 2: not in the middle of it."""
    bench, content = ClientBench(block_size=4), pattern(70)
    bench.upload()
    bench.tell("C6 08 10 00 46 00 00 00")
    first, second, third, fourth = segments(content, 4, final=False)
    assert bench.tell(first, third) == []
    assert bench.tell(fourth) == frames("A2 01 04")
    assert bench.tell(second.replace("02", "05", 1)) == frames("80 08 10 00 03 00 04 05")
    assert bench.aborted() == (0x05040003, AbortOrigin.LOCAL)


@pytest.mark.parametrize("crc", [True, False], ids=["crc", "no crc"])
def test_a_loss_at_the_end_of_a_sub_block(crc: bool) -> None:
    """Trap 1: the time-out path; 2993 of 3000 bytes without a word."""
    bench, content = ClientBench(crc=crc), pattern(1500)
    bench.upload()
    bench.tell(f"{'C6' if crc else 'C2'} 08 10 00 DC 05 00 00")
    assert bench.tell(*segments(content, 126, final=False)) == []
    assert bench.client.deadline == bench.now + LEAST_SILENCE
    assert bench.wait() == frames("A2 7E 7F")
    rest = content[126 * 7 :]
    assert bench.tell(*segments(rest)[:-1]) == []  # the last one is lost as well
    assert bench.wait() == frames(f"A2 {len(segments(rest)) - 1:02X} 7F")
    last = rest[(len(segments(rest)) - 1) * 7 :]
    assert bench.tell(*segments(last)) == frames("A2 01 7F")
    bench.tell(f"{0xC1 | 7 - len(last) << 2:02X}" + (crc_bytes(content) if crc else ""))
    report = bench.outcome()
    assert isinstance(report, SdoUploaded)
    assert report.data == content


def test_a_last_segment_that_is_alone_is_asked_for_if_there_is_a_crc() -> None:
    bench = ClientBench(block_size=2)
    bench.upload()
    bench.tell("C6 08 10 00 0F 00 00 00")
    content = pattern(15)
    bench.tell(*segments(content, 2, final=False))
    assert bench.client.deadline == bench.now + LEAST_SILENCE
    assert bench.wait() == frames("A2 00 02")
    assert bench.tell(*segments(content[14:])) == frames("A2 01 02")
    bench.tell("D9" + crc_bytes(content))
    assert isinstance(bench.outcome(), SdoUploaded)


def test_without_a_crc_it_is_not_asked_for() -> None:
    """An acknowledgement that was lost looks the same: the server would repeat what we have, and nothing would tell."""
    bench = ClientBench(block_size=2)
    bench.upload()
    bench.tell("C2 08 10 00 0F 00 00 00", *segments(pattern(15), 2, final=False))
    assert bench.wait() == []
    assert bench.wait() == frames("80 08 10 00 00 00 04 05")
    assert bench.aborted() == (0x05040000, AbortOrigin.TIMEOUT)


def test_a_server_that_stays_silent_is_asked_and_then_given_up() -> None:
    bench = ClientBench(timeout=3 * SECOND)
    bench.upload()
    bench.tell("C6 08 10 00 0F 00 00 00")
    start = bench.now
    assert bench.wait() == frames("A3")
    assert bench.wait() == frames("80 08 10 00 00 00 04 05")
    assert bench.now == start + 6 * SECOND
    assert bench.aborted() == (0x05040000, AbortOrigin.TIMEOUT)


def test_a_sender_that_only_paused_is_told_by_its_numbers() -> None:
    """Without CRC and size nothing else would tell."""
    bench, content = ClientBench(crc=False), pattern(70)
    bench.upload()
    bench.tell("C0 08 10 00")
    sent = segments(content)
    bench.tell(*sent[:4])
    assert bench.wait() == frames("A2 04 7F")
    assert bench.tell(sent[4]) == frames("80 08 10 00 03 00 04 05")
    assert bench.aborted() == (0x05040003, AbortOrigin.LOCAL)


def test_silence_at_the_beginning_and_at_the_end() -> None:
    bench = ClientBench()
    bench.upload()
    assert bench.wait() == frames("80 08 10 00 00 00 04 05")
    assert bench.aborted() == (0x05040000, AbortOrigin.TIMEOUT)
    bench.upload()
    assert bench.tell("C6 08 10 00 0D 00 00 00", *segments(TEXT)) == frames("A3", "A2 02 7F")
    assert bench.wait() == frames("A2 02 7F")  # it may have been lost
    assert bench.wait() == frames("80 08 10 00 00 00 04 05")
    assert bench.aborted() == (0x05040000, AbortOrigin.TIMEOUT)


@pytest.mark.parametrize(
    ("end", "code"),
    [
        ("C5 00 00", AbortCode.CRC_ERROR),
        ("C1" + crc_bytes(TEXT + b"\x00"), AbortCode.LENGTH_TOO_HIGH),
        ("C9" + crc_bytes(TEXT[:-1]), AbortCode.LENGTH_TOO_LOW),
    ],
)
def test_a_transfer_that_is_not_right_is_an_abort(end: str, code: AbortCode) -> None:
    bench = ClientBench()
    bench.upload()
    bench.tell("C6 08 10 00 0D 00 00 00", *segments(TEXT))
    assert bench.tell(end) == frames("80 08 10 00" + code.to_bytes(4, "little").hex())
    assert bench.aborted() == (code, AbortOrigin.LOCAL)


def test_more_than_was_announced_or_can_be_taken() -> None:
    bench = ClientBench(max_upload=20)
    bench.upload()
    assert bench.tell("C6 08 10 00 14 00 00 00") == frames("A3")  # not one too many
    bench.tell("80 08 10 00 00 00 00 08")
    bench.events()
    bench.upload()
    assert bench.tell("C6 08 10 00 15 00 00 00") == frames("80 08 10 00 05 00 04 05")
    assert bench.aborted() == (0x05040005, AbortOrigin.LOCAL)
    bench.upload()
    bench.tell("C6 08 10 00 07 00 00 00")
    assert bench.tell(*segments(pattern(22))) == frames("80 08 10 00 12 00 07 06")
    assert bench.aborted() == (0x06070012, AbortOrigin.LOCAL)
    bench.upload()
    bench.tell("C4 08 10 00")
    assert bench.tell(*segments(pattern(35))) == frames("80 08 10 00 05 00 04 05")
    assert bench.aborted() == (0x05040005, AbortOrigin.LOCAL)
    bench.upload()
    bench.tell("C4 08 10 00")
    bench.tell(*segments(pattern(21)))
    assert bench.tell("C1" + crc_bytes(pattern(21))) == frames("80 08 10 00 05 00 04 05")


@pytest.mark.parametrize("sequence", ["00", "05", "7F"])
def test_bad_sequence_numbers(sequence: str) -> None:
    bench = ClientBench(block_size=4)
    bench.upload()
    bench.tell("C6 08 10 00 46 00 00 00")
    assert bench.tell(sequence) == frames("80 08 10 00 03 00 04 05")
    assert bench.aborted() == (0x05040003, AbortOrigin.LOCAL)


def test_second_copies_in_an_upload() -> None:
    bench, content = ClientBench(block_size=4), pattern(33)
    bench.upload()
    assert bench.tell_at_once(*["C6 08 10 00 21 00 00 00"] * 2) == frames("A3")
    doubled = [frame for frame in segments(content, 4, final=False) for _ in range(2)]
    assert bench.tell_at_once(*doubled) == frames("A2 04 04")
    assert bench.tell_at_once(*segments(content[28:]) * 2) == frames("A2 01 04")
    assert bench.tell_at_once(*["C9" + crc_bytes(content)] * 2) == frames("A1")
    reports = [report for report in bench.events() if isinstance(report, SdoUploaded)]
    assert [report.data for report in reports] == [content]


@pytest.mark.parametrize(("size", "crc"), [(65 * 7, True), (65 * 7, False), (69 * 7 - 1, True), (73 * 7 - 2, False)])
def test_the_final_segment_may_look_like_the_end(size: int, crc: bool) -> None:
    """Number 65 of 455 zeros is C1 00 00 ..., and so is the end, with a CRC too: that of zeros is 0."""
    bench, content = ClientBench(), bytes(size)
    bench.upload()
    bench.tell(f"{'C6' if crc else 'C2'} 08 10 00" + size.to_bytes(4, "little").hex())
    final = segments(content)[-1]
    end = f"{0xC1 | -size % 7 << 2:02X}".ljust(16, "0")
    assert final == end
    assert bench.tell(*segments(content)) == frames(f"A2 {-(-size // 7):02X} 7F")
    assert bench.tell(end) == frames("A1")
    report = bench.outcome()
    assert isinstance(report, SdoUploaded)
    assert report.data == content


def test_a_copy_of_the_final_segment_is_not_taken_for_the_end() -> None:
    bench, content = ClientBench(), pattern(65 * 7)
    bench.upload()
    bench.tell("C6 08 10 00 C7 01 00 00", *segments(content))
    assert bench.tell(segments(content)[-1]) == []
    assert bench.tell("C1" + crc_bytes(content)) == frames("A1")
    assert isinstance(bench.events()[-1], SdoUploaded)
    # and where neither size nor CRC could tell, it is not taken for the end either
    bench.upload()
    bench.tell("C0 08 10 00", *segments(bytes(65 * 7)))
    assert bench.tell("C1") == []
    assert bench.client.busy


def test_segments_of_odd_length() -> None:
    bench = ClientBench()
    bench.upload()
    bench.tell("C6 08 10 00 0D 00 00 00")
    first, last = segments(TEXT)
    bench.tell(first + "55")  # nine bytes: the first eight count
    bench.client.receive(Frame(0x58C, bytes.fromhex(last)[:7]), bench.now)  # seven: lost
    assert bench.said() == []
    assert bench.wait() == frames("A2 01 7F")
    assert bench.tell("81" + last[2:]) == frames("A2 01 7F")
