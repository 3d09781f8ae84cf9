"""A second opinion from Wireshark: what our machines sent is decoded by its CANopen dissector as what we meant.

Each session below makes frames by commands to our machines; one run of `tshark` reads them all; each test compares what Wireshark
says with the commands, never with our own decoding.

What Wireshark 4.0 itself does not decode, and so has no opinion of: the data segments of a block transfer (it takes them by their
first byte for other commands), the initiate frames of one with CRC (bit 2 is taken for a sign of a segment), remote frames, and
frames with a 29-bit CAN-ID.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path

import pytest

from canopen_proto.datatypes import DataType, Value, encode
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.emcy import EmcyProducer
from canopen_proto.frame import ERROR_CONTROL, TIME, Frame
from canopen_proto.machine import MILLISECOND, Outbox, Time
from canopen_proto.nmt import NmtCommand, NmtMaster, NmtState
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_proto.pdo.producer import PdoProducer
from canopen_proto.sdo.abort import AbortCode
from canopen_proto.sdo.client import SdoAborted, SdoClient, SdoUploaded
from canopen_proto.sdo.server import SdoServer
from canopen_proto.sync import SyncProducer
from tests.interop.pcap import TSHARK, Packet, read_by_wireshark
from tests.proto.bus import Bus
from tests.proto.device_bench import DeviceBench
from tests.proto.devices import io_device

pytestmark = pytest.mark.skipif(TSHARK is None, reason="tshark is not installed (apt-get install tshark)")

NODE = 5
Session = Callable[[], list[Frame]]
Reading = Callable[[Session], list[Packet]]

_SESSIONS: list[Session] = []


def session(make: Session) -> Session:
    """A function that makes frames for Wireshark to read."""
    _SESSIONS.append(make)
    return make


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Reading:
    """What Wireshark says of a session's frames; all are read in one run."""
    made = {make: make() for make in _SESSIONS}
    packets = iter(
        read_by_wireshark(
            Path(tmp_path_factory.mktemp("wireshark")) / "ours.pcap",
            [frame for frames in made.values() for frame in frames],
        )
    )
    readings = {make: [next(packets) for _ in frames] for make, frames in made.items()}
    return readings.__getitem__


@pytest.mark.parametrize("make", _SESSIONS)
def test_nothing_is_malformed(read: Reading, make: Session) -> None:
    packets = read(make)
    assert packets
    for packet in packets:
        assert not packet.complaint, packet
        assert packet["can.len"] == packet.frame.dlc
        assert packet["can.id"] == packet.frame.can_id


# ---- NMT ----

NMT_COMMANDS = [(command, node_id) for command in NmtCommand for node_id in (0, 1, 127)]


@session
def nmt_commands() -> list[Frame]:
    master = NmtMaster(Outbox())
    for command, node_id in NMT_COMMANDS:
        master.send(command, node_id, 0)
    return master.out.frames


def test_nmt_commands(read: Reading) -> None:
    seen = [(packet.kind, packet["nmt_ctrl.cd"], packet["nmt_ctrl.node_id"]) for packet in read(nmt_commands)]
    assert seen == [("NMT", command, node_id) for command, node_id in NMT_COMMANDS]


STATES = [
    NmtState.INITIALISING,  # boot-up
    NmtState.PRE_OPERATIONAL,
    NmtState.OPERATIONAL,
    NmtState.STOPPED,
    NmtState.INITIALISING,  # reset
    NmtState.PRE_OPERATIONAL,
]


@session
def error_control() -> list[Frame]:
    """A device boots, and is led through all states; a heartbeat each."""
    bench = DeviceBench(io_device(NODE, heartbeat_ms=10), boot=False)
    bench.node.boot(0)
    sent = [*bench.take(), *bench.wait(10)]
    for command in (NmtCommand.START, NmtCommand.STOP, NmtCommand.RESET_NODE):
        sent += [*bench.tell(f"000#{command:02X}{NODE:02X}"), *bench.wait(10)]
    return [Frame.parse(text.split()[-1]) for text in sent]


def test_boot_up_and_heartbeats(read: Reading) -> None:
    packets = read(error_control)
    assert [packet["nmt_guard.state"] for packet in packets] == STATES
    for packet in packets:
        assert (packet.kind, packet["node_id"], packet["nmt_guard.toggle"]) == ("NMT Error Control", NODE, 0)


@session
def guarding() -> list[Frame]:
    """A guarded device: three requests, and the answers."""
    device = io_device(NODE).with_objects([standard_object(0x100C, 100), standard_object(0x100D, 3)])
    bench = DeviceBench(device)
    request = f"{ERROR_CONTROL + NODE:03X}#R1"
    return [Frame.parse(text) for _ in range(3) for text in (request, *bench.tell(request))]


def test_guarding(read: Reading) -> None:
    packets = read(guarding)
    if len(packets) == 3:
        pytest.skip("node guarding does not exist yet: a remote request is not answered")
    for request in packets[::2]:
        assert (request.kind, request["can.flags.rtr"], request["can.id"]) == ("", 1, ERROR_CONTROL + NODE)
    answers = [(packet.kind, packet["node_id"], packet["nmt_guard.state"]) for packet in packets[1::2]]
    assert answers == [("NMT Error Control", NODE, NmtState.PRE_OPERATIONAL)] * 3
    assert [packet["nmt_guard.toggle"] for packet in packets[1::2]] == [0, 1, 0]


# ---- SYNC, TIME, EMCY ----


@session
def sync() -> list[Frame]:
    producer = SyncProducer(Outbox())
    producer.start(10 * MILLISECOND, 0)
    producer.send(0)
    producer.start(10 * MILLISECOND, 0, counter_overflow=3)
    for cycle in range(1, 5):
        producer.handle_timeout(cycle * 10 * MILLISECOND)
    return producer.out.frames


def test_sync(read: Reading) -> None:
    packets = read(sync)
    assert {packet.kind for packet in packets} == {"SYNC"}
    assert [packet["sync.counter"] for packet in packets] == [None, None, 1, 2, 3, 1, 2]


MOMENTS = [
    datetime.datetime(1984, 1, 1, tzinfo=datetime.UTC),
    datetime.datetime(2023, 11, 14, 22, 13, 20, 5000, tzinfo=datetime.UTC),
    datetime.datetime(2100, 3, 1, 23, 59, 59, 999000, tzinfo=datetime.UTC),
]


@session
def time() -> list[Frame]:
    return [Frame(TIME, encode(moment, DataType.TIME_OF_DAY)) for moment in MOMENTS]


def test_time(read: Reading) -> None:
    for packet, moment in zip(read(time), MOMENTS, strict=True):
        since = moment - MOMENTS[0]
        assert packet.kind == "TIME STAMP"
        assert packet["time_stamp_days"] == since.days
        assert packet["time_stamp_ms"] == since.seconds * 1000 + since.microseconds // 1000
        assert packet["time_stamp"] == f"{moment:%b} {moment.day:2d}, {moment:%Y %H:%M:%S}.{moment.microsecond:06d}000 UTC"


ERRORS = [(0x8130, 0x10, b"\x0a"), (0x4210, 0x08, b"\x01\x02\x03\x04\x05"), (0xFF01, 0x80, b""), (0x2310, 0x02, b"\xff")]
REGISTER_BITS = ["ge", "cu", "vo", "te", "co", "de", "re", "ma"]  # 0x1001 from bit 0 on, in Wireshark's names


@session
def emergencies() -> list[Frame]:
    producer = EmcyProducer(Outbox(), NODE)
    for code, bits, vendor_data in ERRORS:
        producer.raise_error(code, bits, vendor_data, 0)
    for code, _, _ in ERRORS:
        producer.clear(code, 0)
    return producer.out.frames


def test_emergencies(read: Reading) -> None:
    *packets, last = read(emergencies)
    register = 0x01
    for packet, (code, bits, vendor_data) in zip(packets, ERRORS, strict=True):
        register |= bits  # the errors before last on
        assert (packet.kind, packet["node_id"], packet["em.err_code"]) == ("EMCY", NODE, code)
        assert packet["em.err_reg"] == register
        assert [packet[f"em.err_reg_{name}"] for name in REGISTER_BITS] == [register >> bit & 1 for bit in range(8)]
        assert packet["em.err_field"] == vendor_data.ljust(5, b"\0")
    assert (last.kind, last["em.err_code"], last["em.err_reg"], last["em.err_field"]) == ("EMCY", 0, 0, bytes(5))


# ---- PDO ----

PDO_CAN_IDS = {
    f"PDO{number} ({side})": base + (number - 1) * 0x100
    for number in range(1, 5)
    for side, base in (("tx", 0x180), ("rx", 0x200))
}
PDO_VALUES: dict[int, Value] = {0x6041_00: 0x1234, 0x6064_00: -2, 0x6061_00: 7}


@session
def pdos() -> list[Frame]:
    out = Outbox()
    mapping = Mapping(
        [
            MappedEntry(0x6041, 0, 16, DataType.UNSIGNED16),
            MappedEntry(0x6064, 0, 32, DataType.INTEGER32),
            MappedEntry(0x6061, 0, 8, DataType.INTEGER8),
        ]
    )
    for can_id in PDO_CAN_IDS.values():
        producer = PdoProducer(out, NODE, 1, can_id + NODE, mapping, PDO_VALUES)
        producer.set_enabled(True, 0)
        producer.send(0)
    return out.frames


def test_pdos(read: Reading) -> None:
    packets = read(pdos)
    assert [packet.kind for packet in packets] == list(PDO_CAN_IDS)
    for packet in packets:
        assert packet["node_id"] == NODE
        assert packet["pdo.data.bytes"] == b"\x34\x12" + b"\xfe\xff\xff\xff" + b"\x07"


# ---- SDO ----

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

    def __init__(self, *, server: bool = True) -> None:
        self.bus = Bus()
        self.client = self.bus.attach(SdoClient(Outbox(), NODE))
        self.shelf = Shelf()
        if server:
            self.bus.attach(SdoServer(Outbox(), NODE, self.shelf))

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


def _of_size(make: Callable[[int], list[Frame]], size: int) -> Session:
    return session(lambda: make(size))


DOWNLOADS = {size: _of_size(download_of, size) for size in SIZES}
UPLOADS = {size: _of_size(upload_of, size) for size in SIZES}

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
    channel = Channel(server=False)
    request_id = channel.client.download(INDEX, SUBINDEX, b"too late", 0)
    channel.client.cancel(request_id, 0)
    channel.client.upload(INDEX, SUBINDEX, 0)
    frames = channel.settle()
    aborted = [event.abort_code for event in channel.bus.take_events(SdoAborted)]
    assert aborted == [AbortCode.GENERAL_ERROR, AbortCode.TIMED_OUT]
    return frames


def test_aborts_of_the_client(read: Reading) -> None:
    packets = read(client_aborts)
    assert {packet.kind for packet in packets} == {"Default-SDO (rx)"}
    assert [packet["sdo.ccs"] for packet in packets] == [CCS_INITIATE_DOWNLOAD, ABORT, CCS_INITIATE_UPLOAD, ABORT]
    assert all(names_the_object(packet) for packet in packets)
    assert [packet["sdo.abort_code"] for packet in packets[1::2]] == [AbortCode.GENERAL_ERROR, AbortCode.TIMED_OUT]
