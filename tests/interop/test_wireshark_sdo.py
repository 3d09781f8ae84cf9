"""A second opinion from Wireshark on SDO transfers: see test_wireshark.

Wireshark 4.0 does not decode the segments of a block transfer (it takes them by their first byte for other commands), nor the
initiate frames of one with CRC (bit 2 is a sign of a segment to it). So the first are only counted here, and of the second those
without CRC are looked at.
"""

from __future__ import annotations

import binascii
from collections.abc import Callable

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.frame import Frame
from canopen_proto.machine import Outbox, Time
from canopen_proto.sdo.client import SdoAborted, SdoClient, SdoUploaded
from canopen_proto.sdo.server import SdoServer
from tests.core.bus import Bus
from tests.interop.pcap import TSHARK, Packet, Reading, Session, Sessions, check_whole

pytestmark = pytest.mark.skipif(TSHARK is None, reason="tshark is not installed (apt-get install tshark)")

NODE = 5
SESSIONS = Sessions()
session = SESSIONS.add


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Reading:
    """What Wireshark says of a session's frames."""
    return SESSIONS.read(tmp_path_factory.mktemp("wireshark") / "ours.pcap")


INDEX, SUBINDEX = 0x2345, 0x67
SIZES = [0, 1, 2, 3, 4, 5, 6, 7, 8, 13, 14, 15, 700]


class Shelf:
    """Objects of any size. Those at REFUSED and above refuse with the code of that place."""

    REFUSED = 0x3000
    CODES = list(AbortCode)

    def __init__(self) -> None:
        self.held: dict[tuple[int, int], bytes] = {}

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode:
        return self.check_write(index, subindex, None) or self.held[index, subindex]

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | None:
        return self.CODES[index - self.REFUSED] if index >= self.REFUSED else None

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | None:
        self.held[index, subindex] = data
        return self.check_write(index, subindex, None)


class Channel:
    """A client and a server on a bus."""

    def __init__(self, *, server: bool = True, crc: bool = True) -> None:
        self.bus = Bus()
        self.client = self.bus.attach(SdoClient(Outbox(), NODE, crc=crc))
        self.shelf = Shelf()
        if server:
            self.bus.attach(SdoServer(Outbox(), NODE, self.shelf, crc=crc))

    def settle(self) -> list[Frame]:
        """All frames since the last time."""
        self.bus.settle()
        frames = [frame for _, frame in self.bus.sent]
        self.bus.sent.clear()
        return frames


def content(size: int) -> bytes:
    return bytes((number * 7 + 1) % 256 for number in range(size))


def download_of(size: int) -> list[Frame]:
    channel = Channel()
    channel.client.download(INDEX, SUBINDEX, content(size), 0)
    frames = channel.settle()
    assert channel.shelf.held == {(INDEX, SUBINDEX): content(size)}
    return frames


def upload_of(size: int) -> list[Frame]:
    channel = Channel()
    channel.shelf.held[INDEX, SUBINDEX] = content(size)
    channel.client.upload(INDEX, SUBINDEX, 0)
    frames = channel.settle()
    assert [event.data for event in channel.bus.take_events(SdoUploaded)] == [content(size)]
    return frames


def block_download_of(size: int, crc: bool) -> list[Frame]:
    channel = Channel(crc=crc)
    channel.client.download(INDEX, SUBINDEX, content(size), 0, block=True)
    frames = channel.settle()
    assert channel.shelf.held == {(INDEX, SUBINDEX): content(size)}
    return frames


def block_upload_of(size: int, crc: bool) -> list[Frame]:
    channel = Channel(crc=crc)
    channel.shelf.held[INDEX, SUBINDEX] = content(size)
    channel.client.upload(INDEX, SUBINDEX, 0, block=True)
    frames = channel.settle()
    assert [event.data for event in channel.bus.take_events(SdoUploaded)] == [content(size)]
    return frames


def _of_size(make: Callable[..., list[Frame]], *arguments: object) -> Session:
    return session(lambda: make(*arguments))


DOWNLOADS = {size: _of_size(download_of, size) for size in SIZES}
UPLOADS = {size: _of_size(upload_of, size) for size in SIZES}
BLOCKS = [(size, crc) for size in (1, 7, 8, 889, 890, 2000) for crc in (False, True)]
BLOCK_DOWNLOADS = {case: _of_size(block_download_of, *case) for case in BLOCKS}
BLOCK_UPLOADS = {case: _of_size(block_upload_of, *case) for case in BLOCKS}

# Command specifiers, client's and server's. CiA 301 v4.2.0, 7.2.4.3.2 to 7.2.4.3.17
(
    CCS_DOWNLOAD_SEGMENT,
    CCS_INITIATE_DOWNLOAD,
    CCS_INITIATE_UPLOAD,
    CCS_UPLOAD_SEGMENT,
    ABORT,
    CCS_BLOCK_UPLOAD,
    CCS_BLOCK_DOWNLOAD,
) = range(7)
SCS_UPLOAD_SEGMENT, SCS_DOWNLOAD_SEGMENT, SCS_INITIATE_UPLOAD, SCS_INITIATE_DOWNLOAD, _, SCS_BLOCK_DOWNLOAD, SCS_BLOCK_UPLOAD = (
    range(7)
)


def split(packets: list[Packet]) -> tuple[list[Packet], list[Packet]]:
    """A transfer's requests and responses, one behind the other in turn."""
    for packet in packets:
        assert packet["node_id"] == NODE
    requests, responses = packets[::2], packets[1::2]
    assert {packet.kind for packet in requests} == {"Default-SDO (rx)"}
    assert {packet.kind for packet in responses} == {"Default-SDO (tx)"}
    return requests, responses


def names_the_object(packet: Packet) -> bool:
    return (packet["sdo.main_idx"], packet["sdo.sub_idx"]) == (INDEX, SUBINDEX)


def carries(packet: Packet, size: int) -> None:
    """That an initiate frame with data says: expedited, or in segments, and how much."""
    assert names_the_object(packet)
    assert packet["sdo.s"] == 1
    if 1 <= size <= 4:
        assert packet["sdo.e"] == 1
        assert packet["sdo.n"] == 4 - size
        assert packet["sdo.data.bytes"] == content(size).ljust(4, b"\0")
    else:
        assert packet["sdo.e"] == 0
        assert packet["sdo.data.bytes"] == size.to_bytes(4, "little")


def in_segments(packets: list[Packet]) -> bytes:
    """What segments carry together; the toggle bit alternates, only the last one is the last."""
    assert [packet["sdo.toggle"] for packet in packets] == [number % 2 for number in range(len(packets))]
    assert [packet["sdo.c"] for packet in packets] == [0] * (len(packets) - 1) + [1]
    return b"".join(packet["sdo.data.bytes"][: 7 - packet["sdo.n"]] for packet in packets)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("size", SIZES)
def test_downloads(read: Reading, size: int) -> None:
    (initiate, *segments), (confirmed, *acknowledged) = split(read(DOWNLOADS[size]))
    assert initiate["sdo.ccs"] == CCS_INITIATE_DOWNLOAD
    carries(initiate, size)
    assert confirmed["sdo.scs"] == SCS_INITIATE_DOWNLOAD
    assert names_the_object(confirmed)
    assert bool(segments) == (not 1 <= size <= 4)
    if segments:
        assert {packet["sdo.ccs"] for packet in segments} == {CCS_DOWNLOAD_SEGMENT}
        assert in_segments(segments) == content(size)
        assert {packet["sdo.scs"] for packet in acknowledged} == {SCS_DOWNLOAD_SEGMENT}
        assert [packet["sdo.toggle"] for packet in acknowledged] == [packet["sdo.toggle"] for packet in segments]


@pytest.mark.parametrize("size", SIZES)
def test_uploads(read: Reading, size: int) -> None:
    (initiate, *requests), (answer, *segments) = split(read(UPLOADS[size]))
    assert initiate["sdo.ccs"] == CCS_INITIATE_UPLOAD
    assert names_the_object(initiate)
    assert answer["sdo.scs"] == SCS_INITIATE_UPLOAD
    carries(answer, size)
    assert bool(segments) == (not 1 <= size <= 4)
    if segments:
        assert {packet["sdo.ccs"] for packet in requests} == {CCS_UPLOAD_SEGMENT}
        assert {packet["sdo.scs"] for packet in segments} == {SCS_UPLOAD_SEGMENT}
        assert in_segments(segments) == content(size)
        assert [packet["sdo.toggle"] for packet in requests] == [packet["sdo.toggle"] for packet in segments]


def last_segments_and_acknowledgements(size: int, acknowledged: list[Packet]) -> None:
    """Each sub-block of 127 segments of 7 bytes is acknowledged whole; blocks of 127 may follow."""
    segments = -(-size // 7)
    assert [packet["sdo.ackseq"] for packet in acknowledged] == [127] * (segments // 127) + [segments % 127] * bool(
        segments % 127
    )
    assert {packet["sdo.blksize"] for packet in acknowledged} == {127}


def ends_block(packet: Packet, size: int, crc: bool) -> None:
    """That an end frame says how much of the last segment is unused, and the CRC."""
    assert packet["sdo.n"] == -size % 7
    assert packet["sdo.data.bytes"] == (binascii.crc_hqx(content(size), 0) if crc else 0).to_bytes(2, "little")


@pytest.mark.parametrize(("size", "crc"), BLOCKS)
def test_block_downloads(read: Reading, size: int, crc: bool) -> None:
    packets = read(BLOCK_DOWNLOADS[size, crc])
    initiate, *segments, end = [packet for packet in packets if packet.kind == "Default-SDO (rx)"]
    answer, *acknowledged, confirmed = [packet for packet in packets if packet.kind == "Default-SDO (tx)"]
    assert len(segments) == -(-size // 7)
    if not crc:
        assert (initiate["sdo.ccs"], initiate["sdo.cs"], initiate["sdo.s"], initiate["sdo.crc_support"]) == (6, 0, 1, 0)
        assert names_the_object(initiate)
        assert initiate["sdo.data.bytes"] == size.to_bytes(4, "little")
        assert (answer["sdo.scs"], answer["sdo.ss"], answer["sdo.crc_support"], answer["sdo.blksize"]) == (5, 0, 0, 127)
        assert names_the_object(answer)
    assert {(packet["sdo.scs"], packet["sdo.ss"]) for packet in acknowledged} == {(5, 2)}
    last_segments_and_acknowledgements(size, acknowledged)
    assert (end["sdo.ccs"], end["sdo.cs"]) == (6, 1)
    ends_block(end, size, crc)
    assert (confirmed["sdo.scs"], confirmed["sdo.ss"]) == (5, 1)


@pytest.mark.parametrize(("size", "crc"), BLOCKS)
def test_block_uploads(read: Reading, size: int, crc: bool) -> None:
    packets = read(BLOCK_UPLOADS[size, crc])
    initiate, start, *acknowledged, confirmed = [packet for packet in packets if packet.kind == "Default-SDO (rx)"]
    answer, *segments, end = [packet for packet in packets if packet.kind == "Default-SDO (tx)"]
    assert len(segments) == -(-size // 7)
    if not crc:
        assert (initiate["sdo.ccs"], initiate["sdo.cs"], initiate["sdo.crc_support"]) == (5, 0, 0)
        assert names_the_object(initiate)
        assert (initiate["sdo.blksize"], initiate["sdo.pst"]) == (127, 0)
        assert (answer["sdo.scs"], answer["sdo.ss"], answer["sdo.s"], answer["sdo.crc_support"]) == (6, 0, 1, 0)
        assert names_the_object(answer)
        assert answer["sdo.data.bytes"] == size.to_bytes(4, "little")
    assert (start["sdo.ccs"], start["sdo.cs"]) == (5, 3)
    assert {(packet["sdo.ccs"], packet["sdo.cs"]) for packet in acknowledged} == {(5, 2)}
    last_segments_and_acknowledgements(size, acknowledged)
    assert (end["sdo.scs"], end["sdo.ss"]) == (6, 1)
    ends_block(end, size, crc)
    assert (confirmed["sdo.ccs"], confirmed["sdo.cs"]) == (5, 1)


@session
def refusals() -> list[Frame]:
    """The server refuses, once with each abort code."""
    channel = Channel()
    for number in range(len(AbortCode)):
        channel.client.upload(Shelf.REFUSED + number, 1, channel.bus.now)
    return channel.settle()


def test_every_abort_code_of_the_server(read: Reading) -> None:
    _, responses = split(read(refusals))
    for number, (packet, abort_code) in enumerate(zip(responses, AbortCode, strict=True)):
        assert packet["sdo.scs"] == ABORT
        assert (packet["sdo.main_idx"], packet["sdo.sub_idx"]) == (Shelf.REFUSED + number, 1)
        assert packet["sdo.abort_code"] == abort_code


@session
def client_aborts() -> list[Frame]:
    """The client gives up: one transfer is cancelled, the other gets no answer."""
    cancels, waits = Channel(server=False), Channel(server=False)  # one alone would ask for another object between the two
    request_id = cancels.client.download(INDEX, SUBINDEX, b"too late", 0)
    cancels.client.cancel(request_id, 0)
    waits.client.upload(INDEX, SUBINDEX, 0)
    frames = cancels.settle() + waits.settle()
    aborted = [event.abort_code for each in (cancels, waits) for event in each.bus.take_events(SdoAborted)]
    assert aborted == [AbortCode.GENERAL_ERROR, AbortCode.TIMED_OUT]
    return frames


def test_aborts_of_the_client(read: Reading) -> None:
    packets = read(client_aborts)
    assert {packet.kind for packet in packets} == {"Default-SDO (rx)"}
    assert [packet["sdo.ccs"] for packet in packets] == [CCS_INITIATE_DOWNLOAD, ABORT, CCS_INITIATE_UPLOAD, ABORT]
    assert all(names_the_object(packet) for packet in packets)
    assert [packet["sdo.abort_code"] for packet in packets[1::2]] == [AbortCode.GENERAL_ERROR, AbortCode.TIMED_OUT]


@pytest.mark.parametrize("make", SESSIONS)
def test_nothing_is_malformed(read: Reading, make: Session) -> None:
    check_whole(read(make))
