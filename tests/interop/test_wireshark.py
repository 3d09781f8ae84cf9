"""A second opinion from Wireshark: what our machines sent is decoded by its CANopen dissector as what we meant.

Each session below makes frames by commands to our machines; one run of `tshark` reads them all; each test compares what Wireshark
says with the commands, never with our own decoding. SDO has a module of its own, test_wireshark_sdo.

What Wireshark 4.0 itself does not decode as CANopen, and so has no opinion of: remote frames, and frames with a 29-bit CAN-ID.
"""

from __future__ import annotations

import datetime

import pytest

from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.emcy import EmcyProducer
from canopen_proto.frame import ERROR_CONTROL, Frame
from canopen_proto.machine import MILLISECOND, Outbox
from canopen_proto.nmt import NmtCommand, NmtMaster, NmtState
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_proto.pdo.producer import PdoProducer
from canopen_proto.sync import SyncProducer
from canopen_proto.time_stamp import TimeProducer
from tests.core.device_bench import DeviceBench
from tests.core.devices import io_device
from tests.interop.pcap import TSHARK, Reading, Session, Sessions, check_whole

pytestmark = pytest.mark.skipif(TSHARK is None, reason="tshark is not installed (apt-get install tshark)")

NODE = 5
SESSIONS = Sessions()
session = SESSIONS.add


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> Reading:
    """What Wireshark says of a session's frames."""
    return SESSIONS.read(tmp_path_factory.mktemp("wireshark") / "ours.pcap")


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
    producer = TimeProducer(Outbox())
    for moment in MOMENTS:
        producer.send(moment, 0)
    return producer.out.frames


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


# ---- all of them ----


@pytest.mark.parametrize("make", SESSIONS)
def test_nothing_is_malformed(read: Reading, make: Session) -> None:
    check_whole(read(make))
