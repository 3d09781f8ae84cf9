"""SDO transfers overheard, in words."""

from __future__ import annotations

from canopen_proto.observer.sdo import MAX_KEPT
from tests.observer.test_decoding import meanings, shown


def sdo(*frames: str) -> list[str]:
    """Client's frames begin with >, server's with <."""
    ids = {">": "605#", "<": "585#"}
    return [text.removeprefix("SDO 5 ") for text in meanings(*(ids[frame[0]] + frame[1:].replace(" ", "") for frame in frames))]


def test_expedited_transfers() -> None:
    assert sdo(">40 41 60 00 00 00 00 00", "<4B 41 60 00 6F 00 00 00") == [
        "read 6041:00 statusword",
        "read 6041:00 statusword = 111 (ready)",
    ]
    assert sdo(">23 64 60 00 FF FF FF FF", "<60 64 60 00 00 00 00 00") == [
        "write 6064:00 position = -1",
        "written 6064:00 position",
    ]
    assert sdo(">2F 41 60 00 01 00 00 00")[0].endswith("= 01 (not of its type, UNSIGNED16)")
    assert sdo(">22 00 30 01 01 02 03 04")[0] == "write 3000:01 = 0x04030201"


def test_segmented_transfers() -> None:
    assert sdo(
        ">40 08 10 00 00 00 00 00",
        "<41 08 10 00 08 00 00 00",
        ">60 00 00 00 00 00 00 00",
        "<00 41 42 43 44 45 46 47",
        ">70 00 00 00 00 00 00 00",
        "<1D 48 00 00 00 00 00 00",
    ) == [
        "read 1008:00 name",
        "read 1008:00 name: in segments, 8 bytes",
        "read 1008:00 name: next segment",
        "read 1008:00 name: segment, 7 bytes so far",
        "read 1008:00 name: next segment",
        "read 1008:00 name = 'ABCDEFGH'",
    ]
    assert sdo(
        ">20 00 20 00 00 00 00 00",
        "<60 00 20 00 00 00 00 00",
        ">00 01 02 03 04 05 06 07",
        "<20 00 00 00 00 00 00 00",
        ">1D 08 00 00 00 00 00 00",
        "<30 00 00 00 00 00 00 00",
    ) == [
        "write 2000:00 blob: in segments",
        "write 2000:00 blob: go on",
        "write 2000:00 blob: segment, 7 bytes so far",
        "write 2000:00 blob: segment confirmed",
        "write 2000:00 blob = 0x0807060504030201",
        "written 2000:00 blob",
    ]


def test_block_upload_with_a_segment_lost() -> None:
    assert sdo(
        ">A0 08 10 00 7F 00 00 00",
        "<C2 08 10 00 09 00 00 00",
        ">A3 00 00 00 00 00 00 00",
        "<01 41 42 43 44 45 46 47",
        "<83 48 49 00 00 00 00 00",
        ">A2 01 7F 00 00 00 00 00",
        "<81 48 49 00 00 00 00 00",
        ">A2 01 7F 00 00 00 00 00",
        "<D5 00 00 00 00 00 00 00",
        ">A1 00 00 00 00 00 00 00",
    ) == [
        "read 1008:00 name: in blocks of 127 segments",
        "read 1008:00 name: in blocks, 9 bytes",
        "read 1008:00 name: start",
        "read 1008:00 name: block segment 1",
        "read 1008:00 name: block segment 3, the last",
        "read 1008:00 name: 1 segment taken, the others must be sent again",
        "read 1008:00 name: block segment 1, the last",
        "read 1008:00 name: 1 segment taken",
        "read 1008:00 name = 'ABCDEFGHI'",
        "read 1008:00 name: block transfer ended",
    ]


def test_a_value_of_which_a_part_was_not_heard_is_not_shown() -> None:
    begin = (">C2 00 20 00 0A 00 00 00", "<A0 00 20 00 7F 00 00 00", ">01" + " 00" * 7, ">83" + " 00" * 7)
    assert sdo(*begin, "<A2 03 7F 00 00 00 00 00", ">D1" + " 00" * 7, "<A1" + " 00" * 7)[-2:] == [
        "write 2000:00 blob: not all of it was heard",
        "written 2000:00 blob",
    ]


def test_a_value_with_a_wrong_crc_is_not_held() -> None:
    frames = ("605#C600200007000000", "585#A40020007F000000", "605#8101020304050607", "585#A2017F0000000000")
    *_, right = shown(*frames, "605#C1B3260000000000", "585#A100000000000000")
    *_, wrong = shown(*frames, "605#C1FFFF0000000000", "585#A100000000000000")
    assert [each.value for each in (*right, *wrong)] == [bytes(range(1, 8))] * 2
    assert [each.is_held for each in (*right, *wrong)] == [True, False]


def test_block_download() -> None:
    assert sdo(
        ">C2 00 20 00 0A 00 00 00",
        "<A0 00 20 00 01 00 00 00",
        ">01 01 02 03 04 05 06 07",
        "<A2 01 02 00 00 00 00 00",
        ">81 08 09 0A 00 00 00 00",
        "<A2 01 02 00 00 00 00 00",
        ">D1 00 00 00 00 00 00 00",
        "<A1 00 00 00 00 00 00 00",
    ) == [
        "write 2000:00 blob: in blocks, 10 bytes",
        "write 2000:00 blob: go on, 1 segment a block",
        "write 2000:00 blob: block segment 1",
        "write 2000:00 blob: 1 segment taken",
        "write 2000:00 blob: block segment 1, the last",
        "write 2000:00 blob: 1 segment taken",
        "write 2000:00 blob = 01 02 03 04 05 06 07 08 09 0a",
        "written 2000:00 blob",
    ]
    again = sdo(
        ">C0 00 20 00 00 00 00 00", "<A0 00 20 00 02 00 00 00", ">01" + " 00" * 7, ">82" + " 00" * 7, "<A2 01 02 00 00 00 00 00"
    )
    assert again[-1] == "write 2000:00 blob: 1 segment taken, the others must be sent again"


def test_aborts() -> None:
    assert sdo("<80 41 60 00 00 00 00 08", "<80 41 60 00 00 00 00 12")[1].endswith(
        "statusword: error outside of CiA 301 (0x12000000)"
    )
    assert sdo("<80 41 60 00 11 00 09 06") == ["aborted by the server, 6041:00 statusword: subindex does not exist (0x06090011)"]
    assert sdo(">80 41 60 00 00 00 04 05")[0].startswith("aborted by the client, 6041:00 statusword: ")
    within = sdo(">A0 08 10 00 7F 00 00 00", "<C2 08 10 00 09 00 00 00", ">A3" + " 00" * 7, "<80 08 10 00 00 00 04 05")
    assert within[-1].startswith("aborted by the server, 1008:00 name")


def test_what_begins_in_the_middle() -> None:
    lone = "part of a transfer whose beginning was not heard: "
    for frame in (">60", ">00", "<00", ">A3", ">D1", "<C1"):
        assert sdo(frame + " 00" * 7)[0].startswith(lone)
    assert sdo(">40 08 10 00 00 00 00 00", ">00" + " 00" * 7)[1].startswith(lone)
    assert sdo(">20 08 10 00 00 00 00 00", "<00" + " 00" * 7)[1].startswith(lone)
    assert sdo("<20" + " 00" * 7) == ["a segment is confirmed"]
    assert sdo("<A1" + " 00" * 7) == ["a block transfer is confirmed"]
    assert sdo("<60 41 60 00 00 00 00 00") == ["write 6041:00 statusword: go on"]
    assert sdo("<4B 41 60 00 6F 00 00 00") == ["read 6041:00 statusword = 111 (ready)"]
    assert sdo("<C0 08 10 00 00 00 00 00") == ["read 1008:00 name: in blocks"]
    assert sdo("<A0 00 20 00 02 00 00 00", ">01" + " 00" * 7, ">82" + " 00" * 7, "<A2 02 02 00 00 00 00 00") == [
        "write 2000:00 blob: go on, 2 segments a block",
        "write 2000:00 blob: block segment 1",
        "write 2000:00 blob: block segment 2, the last",
        "write 2000:00 blob: 2 segments taken",
    ]


def test_reserved_bits_of_block_frames_are_not_looked_at() -> None:
    usual = (
        ">A4 08 10 00 7F 00 00 00",
        "<C2 08 10 00 07 00 00 00",
        ">A3" + " 00" * 7,
        "<81" + " 41" * 7,
        ">A2 01 7F 00 00 00 00 00",
    )
    end = ("<C1" + " 00" * 7, ">A1" + " 00" * 7)
    odd = tuple(frame.replace(">A3", ">B3").replace(">A2", ">AE").replace(">A1", ">BD") for frame in (*usual, *end))
    assert sdo(*odd) == sdo(*usual, *end)
    assert sdo(*odd)[-1] == "read 1008:00 name: block transfer ended"


def test_a_long_value_is_only_counted() -> None:
    segments = [
        frame
        for _ in range(MAX_KEPT // 14 + 1)
        for frame in (">00" + " 00" * 7, "<20" + " 00" * 7, ">10" + " 00" * 7, "<30" + " 00" * 7)
    ]
    whole = sdo(">20 00 20 00 00 00 00 00", "<60 00 20 00 00 00 00 00", *segments, ">01" + " 00" * 7)
    assert whole[-1] == f"write 2000:00 blob: {(MAX_KEPT // 14 + 1) * 14 + 7} bytes"
