"""Wireshark's pcap and pcapng: what is in them, what is passed over, and what a damaged one says."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_transports.capture_files import read_capture
from canopen_transports.conformance.frames import EVERY_KIND
from canopen_transports.log_files import LogFileError, LogReader, log_writer
from canopen_transports.record import LogDamagedError, Record
from tests.examples import examples

SDO = bytes.fromhex("00000605 08 000000 4041600000000000")
"""605#4041600000000000 as SocketCAN's link type has it."""
FRAME = Frame.parse("605#4041600000000000")


def pcap(*packets: bytes, link_type: int = 227, order: str = "<", magic: int = 0xA1B2C3D4) -> bytes:
    """A file with a packet a second, beginning at 5.000007 (in the unit of the magic number)."""
    head = struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link_type)
    entries = [struct.pack(order + "IIII", 5 + number, 7, len(each), len(each)) + each for number, each in enumerate(packets)]
    return head + b"".join(entries)


def read(content: bytes) -> tuple[list[Record], list[str]]:
    skipped: list[str] = []

    def skip(reason: str, *, is_overrun: bool = False) -> None:
        skipped.append(reason)

    return list(read_capture(io.BytesIO(content), skip, "can0")), skipped


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("magic", "unit"), [(0xA1B2C3D4, 1000), (0xA1B23C4D, 1)])
def test_both_byte_orders_and_units_of_time(order: str, magic: int, unit: int) -> None:
    records, skipped = read(pcap(SDO, SDO, order=order, magic=magic))
    assert records == [Record((5 + number) * 10**9 + 7 * unit, "can0", FRAME) for number in range(2)]
    assert skipped == []


@pytest.mark.parametrize(
    ("packet", "reason"),
    [
        ("00000605 40 000000" + "00" * 64, "a CAN FD frame"),
        ("00000605 08 040000 0000000000000000", "a CAN FD frame"),
        ("00000605 80 000000 0000000000000000", "a CAN XL frame"),
        ("20000080 08 000000 0000000000000000", "an error frame"),
        ("00000605 08 000000 404160", "a packet that was cut to 11 bytes when it was captured"),
        ("00000605", "a packet of 4 bytes"),
        ("", "a packet of 0 bytes"),
    ],
)
def test_other_packets_are_passed_over(packet: str, reason: str) -> None:
    records, skipped = read(pcap(bytes.fromhex(packet), SDO))
    assert [record.frame for record in records] == [FRAME]
    assert skipped == [reason]


OVERRUN = bytes.fromhex("20000004 08 000000 0001000000000000")
WARNING = bytes.fromhex("20000004 08 000000 0004000000000000")


def losses(content: bytes) -> list[str]:
    """Why frames are missing, as the recorder says."""
    found: list[str] = []

    def skip(reason: str, *, is_overrun: bool = False) -> None:
        if is_overrun:
            found.append(reason)

    assert [record.frame for record in read_capture(io.BytesIO(content), skip)] == [FRAME, FRAME]
    return found


def test_a_recorder_that_lost_frames_says_so() -> None:
    """SocketCAN's error frame, and in pcapng the recorder's own numbers: before a packet, and of all of them."""
    assert losses(pcap(SDO, OVERRUN, WARNING, SDO)) == ["an error frame"]
    begin = section() + interface() + packet(1)
    assert losses(begin + packet(2, OVERRUN) + packet(3)) == ["an error frame"]
    dropped = bytes.fromhex("0400 0800 1100000000000000 00000000")
    assert losses(begin + packet(2, options=dropped)) == ["the recorder has lost 17 packets here"]
    head, numbers = struct.pack("<III", 0, 0, 9), bytes.fromhex("0500 0800 0200000000000000 0700 0800 0100000000000000 00000000")
    assert losses(begin + packet(2) + block(5, head + numbers)) == ["the recorder has lost 3 packets somewhere before"]
    unknown = bytes.fromhex("0500 0800 FFFFFFFFFFFFFFFF 0400 0800 2000000000000000")
    assert losses(begin + packet(2) + block(5, head + unknown)) == []
    none = bytes.fromhex("0400 0800 0000000000000000 00000000")
    assert losses(begin + packet(2, options=none)) == []


def test_flags_of_the_identifier() -> None:
    remote = bytes.fromhex("40000701 01 000000")
    extended = bytes.fromhex("98FF0001 02 000000 AABB")
    records, _ = read(pcap(remote, extended))
    assert [str(record.frame) for record in records] == ["701#R1", "18FF0001#AABB"]


@pytest.mark.parametrize(
    ("link_type", "head"),
    [
        (113, "{type:04x} 0118 0000 0000000000000000 {protocol:04x}"),
        (276, "{protocol:04x} 0000 00000003 0118 {type:02x} 00 0000000000000000"),
    ],
)
@pytest.mark.parametrize("order", ["<", ">"])
def test_a_capture_of_all_interfaces_says_which_frames_were_sent(order: str, link_type: int, head: str) -> None:
    packets = [
        bytes.fromhex(head.format(type=kind, protocol=protocol)) + (SDO if order == ">" else SDO[3::-1] + SDO[4:])
        for kind, protocol in ((1, 0x000C), (4, 0x000C), (4, 0x000D), (4, 0x0800))
    ]
    records, skipped = read(pcap(*packets, link_type=link_type, order=order))
    assert [(record.frame, record.sent) for record in records] == [(FRAME, False), (FRAME, True)]
    assert skipped == ["a packet of protocol 0x000D: 0x000C is CAN's", "a packet of protocol 0x0800: 0x000C is CAN's"]


def test_other_link_types_are_passed_over() -> None:
    assert read(pcap(SDO, link_type=1)) == ([], ["a packet of link type 1: 227 is SocketCAN's"])


# ---- pcapng ----


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    length = struct.pack(order + "I", len(body) + 12)
    return struct.pack(order + "I", kind) + length + body + length


def section(order: str = "<") -> bytes:
    return block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1), order)


def interface(options: bytes = b"", order: str = "<") -> bytes:
    return block(1, struct.pack(order + "HHI", 227, 0, 0) + options, order)


def packet(ticks: int, content: bytes = SDO, number: int = 0, options: bytes = b"", order: str = "<") -> bytes:
    head = struct.pack(order + "5I", number, ticks >> 32, ticks & 0xFFFFFFFF, len(content), len(content))
    return block(6, head + content + bytes(-len(content) % 4) + options, order)


@pytest.mark.parametrize(
    ("options", "time"),
    [
        (b"", 3_000_000),  # microseconds, if nothing is said
        (bytes.fromhex("0900 0100 09 000000"), 3000),
        (bytes.fromhex("0900 0100 03 000000"), 3_000_000_000),
        (bytes.fromhex("0900 0100 8A 000000"), 3000 * 10**9 // 1024),
        (bytes.fromhex("0E00 0800 0A00000000000000 00000000"), 10 * 10**9 + 3_000_000),
        (bytes.fromhex("0E00 0800 FFFFFFFFFFFFFFFF"), -(10**9) + 3_000_000),
    ],
)
def test_units_and_offsets_of_times(options: bytes, time: int) -> None:
    assert read(section() + interface(options) + packet(3000)) == ([Record(time, "can0", FRAME)], [])


def test_names_directions_and_blocks_that_are_not_known() -> None:
    name = bytes.fromhex("0200 0300") + b"lab\0"
    content = section() + interface() + interface(name) + block(5, b"statistics..") + block(3, struct.pack("<I", 16) + SDO)
    content += packet(0, number=1, options=bytes.fromhex("0200 0400 02000000 00000000")) + packet(1000)
    content += section(">") + interface(order=">") + packet(2000, order=">")
    records, skipped = read(content)
    assert records == [
        Record(0, "lab", FRAME, sent=True),
        Record(1_000_000, "can0", FRAME),
        Record(2_000_000, "can0", FRAME),
    ]
    assert skipped == ["a packet without a time"]


@pytest.mark.parametrize(
    ("content", "seen"),
    [
        (b"", "begins neither like pcap nor like pcapng"),
        (b"(1.5) can0 601#40", "begins neither like pcap nor like pcapng"),
        (pcap()[:10], "ends in the middle of its head"),
        (pcap(SDO)[:-1], "ends in the middle of a packet"),
        (pcap(SDO, SDO)[: -len(SDO) - 1], "ends in the middle of the head of a packet"),
        (pcap() + struct.pack("<IIII", 0, 0, 1 << 31, 0), "says that it has 2147483648 bytes"),
        (section()[:9], "ends in the middle of the head of a section"),
        (section()[:-2], "ends in the middle of a block"),
        (section().replace(b"\x4d\x3c\x2b\x1a", b"abcd"), "no byte order"),
        (section() + interface()[:5], "ends in the middle of the head of a block"),
        (section() + block(1, b"1234"), "the description of an interface is too short"),
        (section() + packet(0), "on interface 0 does not fit"),
        (section() + interface() + block(6, b"1234"), "the head of a packet is too short"),
        (section() + interface() + block(6, struct.pack("<5I", 0, 0, 0, 99, 99)), "a packet of 99 bytes"),
        (section() + struct.pack("<II", 5, 13), "says that it has 13 bytes"),
        (section() + struct.pack("<II", 5, 8), "says that it has 8 bytes"),
        (section() + block(5, b"")[:-4] + b"1234", "says something else at its end"),
    ],
)
def test_a_damaged_file_says_what_was_seen(content: bytes, seen: str, tmp_path: Path) -> None:
    with pytest.raises(LogDamagedError, match=seen):
        read(content)
    path = tmp_path / "a.pcapng"
    path.write_bytes(content)
    with pytest.raises(LogFileError, match="is not understood") as caught:
        list(LogReader(path))
    assert seen in caught.value.seen


@pytest.mark.parametrize("kind", [".pcap", ".pcapng"])
def test_a_file_that_is_cut_anywhere_gives_the_records_before(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{kind}"
    writer = log_writer(path)
    for frame in EVERY_KIND[:4]:
        writer.write(Record(0, "can0", frame))
        assert list(LogReader(path))[-1].frame == frame  # each one is in the file at once
    writer.close()
    whole = path.read_bytes()
    ends = set()
    for size in range(len(whole)):
        found: list[Frame] = []
        try:
            for record in read_capture(io.BytesIO(whole[:size]), pytest.fail, "can0"):
                found += [record.frame]
            ends.add(len(found))
        except LogDamagedError:
            pass
        assert found == list(EVERY_KIND[: len(found)])
    assert ends >= {0, 1, 2, 3}


@given(st.binary(max_size=200), st.sampled_from([b"", pcap(), pcap(SDO), section(), section() + interface() + packet(0)]))
@examples(100)
def test_any_bytes_are_a_capture_or_a_clear_error(content: bytes, begin: bytes) -> None:
    try:
        read(begin + content)
    except LogDamagedError as error:
        assert str(error).startswith(("the file", "a ", "the "))


def test_frames_of_a_far_future_are_left_out_and_counted(tmp_path: Path) -> None:
    for kind, last in ((".pcap", (1 << 32) * 10**9 - 1), (".pcapng", (1 << 64) - 1)):
        writer = log_writer(tmp_path / f"a{kind}")
        writer.write(Record(last, "can0", FRAME))
        writer.write(Record(last + 1, "can0", FRAME))
        writer.close()
        assert writer.left_out == 1
        assert list(LogReader(tmp_path / f"a{kind}")) == [Record(last, "can0", FRAME)]
