"""Capture files, ours and Wireshark's: each reads what the other has written."""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from canopen_proto.frame import REMOTE
from canopen_transports.conformance.frames import EVERY_KIND
from canopen_transports.log_files import LogReader, log_writer
from canopen_transports.record import Record
from tests.interop.pcap import LIMIT, TSHARK

pytestmark = pytest.mark.skipif(TSHARK is None, reason="there is no tshark")

NOW = 1_795_225_377_712_132_345
RECORDS = [
    Record(NOW + number * 1_234_567, f"lab{number % 2}", frame, number % 3 == 0) for number, frame in enumerate(EVERY_KIND)
]


def written(path: Path) -> Path:
    writer = log_writer(path)
    for record in RECORDS:
        writer.write(record)
    writer.close()
    return path


def tshark(*arguments: str) -> str:
    assert TSHARK is not None
    return subprocess.run([TSHARK, *arguments], capture_output=True, text=True, timeout=LIMIT, check=True).stdout


def test_wireshark_reads_ours(tmp_path: Path) -> None:
    fields = ("frame.time_epoch", "frame.interface_name", "frame.packet_flags_direction", "can.id", "can.len", "can.flags.rtr")
    asked = [part for field in fields for part in ("-e", field)]
    lines = tshark("-r", str(written(tmp_path / "a.pcapng")), "-T", "fields", *asked).splitlines()
    for record, line in zip(RECORDS, lines, strict=True):
        time, channel, direction, can_id, length, remote = line.split("\t")
        assert time == f"{record.time // 10**9}.{record.time % 10**9:09d}"
        assert (channel, int(direction, 0)) == (record.channel, 2 if record.sent else 1)
        assert (int(can_id), int(length)) == (record.frame.can_id, record.frame.dlc)
        assert int(remote) == bool(record.frame.flags & REMOTE)


@pytest.mark.thorough(5)
@pytest.mark.parametrize(("kind", "unit"), [("pcap", 1000), ("nsecpcap", 1), ("pcapng", 1)])
def test_we_read_wiresharks(kind: str, unit: int, tmp_path: Path) -> None:
    target = tmp_path / f"b.{kind.removeprefix('nsec')}"
    tshark("-r", str(written(tmp_path / "a.pcapng")), "-F", kind, "-w", str(target))
    back = list(LogReader(target))
    if kind == "pcapng":
        assert back == RECORDS
    else:
        assert back == [Record(each.time // unit * unit, "can0", each.frame) for each in RECORDS]


@pytest.mark.thorough(5)
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("link_type", [113, 276])
def test_wireshark_sees_a_cooked_capture_as_we_do(link_type: int, order: str, tmp_path: Path) -> None:
    head = {113: "0004 0118 0000 0000000000000000 000c", 276: "000c 0000 00000003 0118 04 00 0000000000000000"}[link_type]
    packet = bytes.fromhex(head) + struct.pack(order + "IB3x", 0x605, 8) + bytes.fromhex("4041600000000000")
    path = tmp_path / "a.pcap"
    path.write_bytes(
        struct.pack(order + "IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link_type)
        + struct.pack(order + "IIII", 5, 0, len(packet), len(packet))
        + packet
    )
    (record,) = LogReader(path)
    can_id, length = tshark("-r", str(path), "-T", "fields", "-e", "can.id", "-e", "can.len").split()
    assert (int(can_id), int(length)) == (record.frame.can_id, record.frame.dlc) == (0x605, 8)


def test_a_capture_comes_through_a_pipe_too(tmp_path: Path) -> None:
    canopen = shutil.which("canopen")
    if canopen is None:
        pytest.skip("the command is not on the path")
    assert TSHARK is not None
    with subprocess.Popen([TSHARK, "-r", str(written(tmp_path / "a.pcapng")), "-w", "-"], stdout=subprocess.PIPE) as source:
        outcome = subprocess.run(
            [canopen, "log", "stats", "-"], stdin=source.stdout, capture_output=True, text=True, timeout=LIMIT
        )
    assert f"{len(RECORDS)} frames in" in outcome.stdout
