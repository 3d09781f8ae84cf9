"""Devices of odd descriptions, as EDS files in the field have them: they boot, answer, and say what does not work."""

from __future__ import annotations

import datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.device_notices import MAX_NOTICES, notices_of
from canopen_data.eds.reader import read_eds
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, Value, encode, is_integer, range_of
from canopen_proto.dictionary import Access, Object, ObjectDictionary, ObjectType, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import EXTENDED, REMOTE, Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Outbox
from canopen_proto.nmt import NmtState
from canopen_proto.sdo.server import ObjectAccessPending
from tests.core.device_bench import RESET_NODE, START, SYNC, DeviceBench
from tests.examples import examples


def var(index: int, data_type: DataType = DataType.UNSIGNED32, default: Value | None = None, **more: Any) -> Object:
    return Object.of(f"o{index:04X}", [Variable(index, 0, f"o{index:04X}", data_type, default=default, **more)])


def record(index: int, *fields: tuple[int, DataType, Value | None], **more: Any) -> Object:
    return Object.of(
        f"o{index:04X}", [Variable(index, sub, f"s{sub}", kind, default=value, **more) for sub, kind, value in fields]
    )


U8, U16, U32, TEXT = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32, DataType.VISIBLE_STRING
INPUT = var(0x6000, U8, 7, access=Access.RO, pdo_mappable=True)


def tpdo(cob_id: Value | None = 0x185, entry: int = 0x60000008, kind: DataType = U32, transmission: int = 255) -> list[Object]:
    return [
        record(0x1800, (0, U8, 2), (1, kind, cob_id), (2, U8, transmission)),
        record(0x1A00, (0, U8, 1), (1, U32, entry)),
        INPUT,
    ]


def bench_of(*objects: Object) -> DeviceBench:
    return DeviceBench(ObjectDictionary(objects))


def told(*objects: Object) -> list[str]:
    return [str(notice) for notice in notices_of(bench_of(*objects).node)]


# ---- one oddity each: what it does, and what is said


def test_a_description_of_nothing_is_a_device() -> None:
    bench = bench_of()
    assert bench.node.state is NmtState.PRE_OPERATIONAL
    assert notices_of(bench.node) == ()
    assert bench.read(0x1000) == AbortCode.NO_SUCH_OBJECT
    bench.node.raise_error(0x1000, 1, b"", 0)
    assert bench.take() == ["085#0010010000000000"]


def test_nothing_is_said_of_a_device_that_is_right() -> None:
    sixteen = [standard_object(index) for index in (0x1000, 0x1001, 0x1005, 0x1014, 0x1017)]
    assert told(*sixteen, *tpdo(), standard_object(0x1010), standard_object(0x1003, highest=8)) == []


@pytest.mark.parametrize(
    ("objects", "notice"),
    [
        (tpdo(0), "0x1800: TPDO 1 is off: COB-ID 0x0 has a CAN-ID that no PDO may have"),
        (tpdo(0x605), "0x1800: TPDO 1 is off: COB-ID 0x605 has a CAN-ID that no PDO may have"),
        (tpdo(0x12345), "0x1800: TPDO 1 is off: COB-ID 0x12345 has a CAN-ID that no PDO may have"),
        (tpdo(entry=0x60010008), "0x1A00: TPDO 1 is off: object 0x6001:00 is not in the dictionary"),
        (tpdo(entry=0x60000010), "0x1A00: TPDO 1 is off: o6000: UNSIGNED8 cannot be mapped to a PDO with 16 bits"),
        (tpdo(entry=0x60000000), "0x1A00: TPDO 1 is off: o6000: UNSIGNED8 cannot be mapped to a PDO with 0 bits"),
        (tpdo("185h", kind=TEXT), "0x1800:01: s1: VISIBLE_STRING, not UNSIGNED32 as in CiA 301: it has no effect"),
        ([tpdo()[0]], "0x1800: TPDO 1 is off: nothing is mapped to it"),
        ([record(0x1800, (0, U8, 2))], "0x1800: TPDO 1 is off: it has no COB-ID (subindex 1)"),
        (tpdo(transmission=245), "0x1800:02: transmission type 245 of TPDO 1 is reserved: it sends nothing"),
        ([record(0x1A00, (0, U8, 65)), tpdo()[0]], "0x1A00: TPDO 1 is off: 0x1A00:00 = 65: a PDO has 64 entries at most"),
    ],
)
def test_a_pdo_that_cannot_be(objects: list[Object], notice: str) -> None:
    assert told(*objects) == [notice]
    bench = bench_of(*objects, var(0x1005, default=0x80))
    assert bench.tell(START, SYNC) == []
    assert not isinstance(bench.read(0x1800), int)


def test_a_pdo_of_sixteen_bits_works_as_far_as_it_goes() -> None:
    bench = bench_of(*tpdo(kind=U16))
    assert [str(each) for each in notices_of(bench.node)] == [
        "0x1800:01: s1: UNSIGNED16, not UNSIGNED32 as in CiA 301: it has no room for every value"
    ]
    bench.tell(START)
    bench.node.set_value(0x6000, 0, 9, 0)
    assert bench.take() == ["185#09"]


def test_a_negative_cob_id_is_its_twos_complement() -> None:
    bench = bench_of(*tpdo(0x185 - (1 << 31), kind=DataType.INTEGER32))
    assert bench.node.pdos.producers[1].key is None
    assert bench.read(0x1800, 1) == bytes.fromhex("85010080")


@pytest.mark.parametrize("index", [0x1005, 0x1014])
@pytest.mark.parametrize("cob_id", [0, 0x605, 0x2000])
def test_sync_and_emcy_fall_back(index: int, cob_id: int) -> None:
    bench = bench_of(*tpdo(transmission=1), var(index, default=cob_id))
    name, default = ("SYNC", 0x80) if index == 0x1005 else ("EMCY", 0x85)
    assert [str(each) for each in notices_of(bench.node)] == [
        f"0x{index:04X}:00: COB-ID 0x{cob_id:X} has a CAN-ID that {name} may not have: it goes by 0x{default:X}"
    ]
    bench.tell(START)
    assert bench.tell(SYNC) == ["185#07"]
    bench.node.raise_error(0x1000, 1, b"", 0)
    assert bench.take() == ["085#0010010000000000"]


def test_time_with_a_can_id_of_others_is_off() -> None:
    device = var(0x1012, default=0xC0000000)
    assert told(device) == ["0x1012:00: COB-ID 0xC0000000 has a CAN-ID that TIME may not have: it is off"]
    assert told(var(0x1012, default=0)) == []  # it neither sends nor hears any
    bench = bench_of(device)
    bench.tell(START)
    assert not bench.node.communication.may_send_time


def test_an_emcy_that_is_not_valid_stays_so() -> None:
    bench = bench_of(var(0x1014, default=0x80000000))
    bench.node.raise_error(0x1000, 1, b"", 0)
    assert bench.take() == []
    assert notices_of(bench.node) == ()


def test_services_that_share_a_can_id() -> None:
    second = [record(0x1801, (0, U8, 2), (1, U32, 0x185)), record(0x1A01, (0, U8, 1), (1, U32, 0x60000008))]
    rpdo = [record(0x1400, (0, U8, 2), (1, U32, 0x80)), record(0x1600, (0, U8, 1), (1, U32, 0x00050008))]
    rpdo += [record(0x1401, (0, U8, 2), (1, U32, 0x285)), record(0x1601, (0, U8, 1), (1, U32, 0x00050008))]
    rpdo += [record(0x1402, (0, U8, 2), (1, U32, 0x285)), record(0x1602, (0, U8, 1), (1, U32, 0x00050008))]
    assert told(*tpdo(), *second, *rpdo, var(0x1014, default=0x80)) == [
        "0x1014: EMCY and SYNC share the CAN-ID 0x80: their frames cannot be told apart",
        "0x1801: TPDO 2 and TPDO 1 share the CAN-ID 0x185: their frames cannot be told apart",
    ]  # what is only heard may be heard twice


def test_sync_periods_that_would_flood_the_bus() -> None:
    bench = bench_of(var(0x1005, default=0x40000080), var(0x1006, default=1))
    assert bench.node.communication.sync_producer.period == 100_000


@pytest.mark.parametrize("default", [-1, 1 << 40, 0.5])
def test_times_beyond_their_type(default: Value) -> None:
    kind = DataType.REAL32 if isinstance(default, float) else DataType.INTEGER64
    times = [var(index, kind, default) for index in (0x1006, 0x1007, 0x100C, 0x100D, 0x1015, 0x1017)]
    pdo = record(0x1800, (1, U32, 0x185), (2, U8, 255), (3, kind, default), (5, kind, default), (6, kind, default))
    bench = bench_of(*times, *tpdo(), pdo)
    bench.tell(START)
    bench.wait(100)
    assert bench.node.read(0x1017, 0, bench.now) == encode(default, kind)


def test_history_and_register_of_other_types_are_plain_memory() -> None:
    history = record(0x1003, (0, TEXT, "n"), (1, U8, 1), (2, U32, 2))
    bench = bench_of(history, var(0x1001, TEXT, "ok"))
    bench.node.raise_error(0x1000, 1, b"", 0)
    bench.take()
    assert (bench.read(0x1001), bench.read(0x1003), bench.read(0x1003, 1)) == (b"ok", b"n", b"\x01")
    narrow = bench_of(record(0x1003, (0, U8, 0), (1, U16, 0), (2, U32, 0)))
    narrow.node.raise_error(0x1000, 1, b"", 0)
    narrow.take()
    assert narrow.read(0x1003) == b"\x00"
    assert narrow.write(0x1003, 0, 0, 1) is None
    assert narrow.read(0x1003, 1) == AbortCode.NO_DATA
    assert bench_of(record(0x1003, *((sub, U32, 0) for sub in range(256)))).node.communication.emcy.history.maxlen == 254


def test_storage_without_a_subindex_that_stores() -> None:
    assert told(var(0x1010), var(0x1011)) == [
        "0x1010: it has no subindex 1: nothing can be stored",
        "0x1011: it has no subindex 1: nothing can be restored",
    ]
    assert bench_of(var(0x1010)).write(0x1010, 0, 0x65766173, 4) == AbortCode.CANNOT_TRANSFER


def test_a_heartbeat_that_is_constant() -> None:
    bench = bench_of(var(0x1017, U16, 100, access=Access.CONST))
    assert bench.wait(100) == ["100 705#7F"]
    assert bench.write(0x1017, 0, 0, 2) == AbortCode.READ_ONLY


def test_a_further_server_with_the_can_ids_of_the_first() -> None:
    copied = [record(index, (1, U32, 0x605), (2, U32, 0x585)) for index in (0x1200, 0x1201)]
    assert told(*copied) == ["0x1201: this SDO channel is off: COB-IDs 0x605, 0x585 have a CAN-ID that it may not have"]
    assert bench_of(*copied).read(0x1201, 1) == bytes.fromhex("05060000")  # one answer
    assert told(record(0x1280, (1, U32, 0x609), (2, U32, 0x589))) == []  # the client of another node's


def test_a_default_beyond_its_type_is_told_shortly() -> None:
    bench = bench_of(var(0x2000, U8, 300), var(0x2001, U8, 1 << 9999), var(0x2002, TEXT, b"x" * 1000))
    assert [str(each) for each in notices_of(bench.node)] == [
        "0x2000:00: o2000: UNSIGNED8 cannot hold 0x12c, its value at power-on: it is zero instead",
        "0x2001:00: o2001: UNSIGNED8 cannot hold an integer of 10000 bits, its value at power-on: it is zero instead",
        f"0x2002:00: o2002: VISIBLE_STRING cannot hold b'{'x' * 38}, its value at power-on: it is zero instead",
    ]
    assert bench.read(0x2000) == b"\x00"
    bench = bench_of(var(0x2000, TEXT, "€"))
    assert told(var(0x2000, TEXT, "€")) == [
        "0x2000:00: o2000: VISIBLE_STRING cannot hold '€', its value at power-on: its UTF-8 bytes are used instead"
    ]
    assert bench.read(0x2000) == "€".encode()


def test_notices_are_bounded() -> None:
    bench = bench_of(*(var(index, U8, 300) for index in range(0x2000, 0x2200)))
    assert len(notices_of(bench.node)) == MAX_NOTICES


# ---- what the host does


def test_the_host_may_have_a_deferred_write_stored() -> None:
    bench = bench_of(*tpdo(), var(0x2000, U8, 0, high_limit=10, pdo_mappable=True), standard_object(0x1010))
    node = bench.node
    node.deferred |= {0x2000, 0x6000, 0x1010}
    assert bench.tell("605#2F00200005000000") == []
    (access,) = bench.seen(ObjectAccessPending)
    assert access.data is not None
    assert node.take_write(access.index, access.subindex, access.data, 0) is None
    node.complete(access.access_id, None, 0)
    assert bench.take() == ["585#6000200000000000"]
    assert node.values[0x200000] == 5
    assert node.take_write(0x2000, 0, b"\x0b", 0) == AbortCode.VALUE_TOO_HIGH
    assert node.take_write(0x2000, 0, b"", 0) == AbortCode.LENGTH_TOO_LOW
    assert node.take_write(0x1010, 1, b"save", 0) == AbortCode.CANNOT_TRANSFER
    bench.tell(START)
    assert node.take_write(0x6000, 0, b"\x08", 0) is None
    assert bench.take() == ["185#08"]


# ---- any description whatever

INDICES = [
    0x0001, 0x1000, 0x1001, 0x1003, 0x1005, 0x1006, 0x1007, 0x1008, 0x100C, 0x100D, 0x1010, 0x1011, 0x1012, 0x1014, 0x1015,
    0x1016, 0x1017, 0x1018, 0x1019, 0x1020, 0x1028, 0x1029, 0x1200, 0x1201, 0x1280, 0x1400, 0x1401, 0x15FF, 0x1600, 0x1601,
    0x1800, 0x1801, 0x19FF, 0x1A00, 0x1A01, 0x1FA0, 0x1FD0, 0x1F80, 0x2000, 0x6000, 0x6040, 0x6041, 0xFFFF,
]  # fmt: skip
USUAL = (
    0, 1, 2, 3, 5, 64, 65, 80, 100, 127, 128, 240, 245, 252, 253, 254, 255, 0x80, 0x85, 0x100, 0x180, 0x185, 0x205, 0x585,
    0x605, 0x705, 0x4000_0080, 0x4000_0185, 0x8000_0000, 0x8000_0185, 0xC000_0100, 0x2000_0010, 0x6000_0008, 0x6000_0010,
    0x6040_0010, 0x6041_0010, 0x1017_0010, 0x0005_0008, 0x0001_0001, 0x2000_00FF, 0x0005_0064, 0x0109_0064, 0x0120_0000,
    0x6576_6173, -1, -0x7FFF_FE7B, 1 << 40, 1 << 70,
)  # fmt: skip
NUMBERS = st.one_of(st.sampled_from(USUAL), st.integers(-(1 << 33), 1 << 66))
OTHERS = st.one_of(
    st.none(), st.floats(), st.text(max_size=9), st.binary(max_size=9), st.booleans(), st.just(datetime.timedelta(days=70_000))
)


@st.composite
def variables(draw: st.DrawFn, index: int, subindex: int) -> Variable:
    data_type = draw(st.sampled_from([U8, U16, U32, U32, U32, *DataType]))
    limits = st.one_of(st.none(), st.integers(-9, 300), st.floats())
    return Variable(
        index,
        subindex,
        draw(st.sampled_from(["", "name", f"o{index:X}:{subindex}"])),
        data_type,
        draw(st.sampled_from([Access.RW, Access.RW, *Access])),
        draw(NUMBERS if is_integer(data_type) or draw(st.booleans()) else OTHERS),
        draw(limits),
        draw(limits),
        draw(st.booleans()),
        adds_node_id=draw(st.booleans()),
        configured=draw(st.one_of(st.none(), st.none(), NUMBERS, OTHERS)),
        configured_adds_node_id=draw(st.booleans()),
    )


@st.composite
def dictionaries(draw: st.DrawFn) -> ObjectDictionary:
    objects = []
    for index in draw(st.lists(st.sampled_from(INDICES), unique=True, min_size=1, max_size=14)):
        subindices = draw(st.sampled_from([[0], [0, 1], [0, 1, 2], [0, 1, 2, 3, 5, 6], [1], [0, 2], [0, 0xFF], []]))
        members = {subindex: draw(variables(index, subindex)) for subindex in subindices}
        objects.append(Object(index, "o", draw(st.sampled_from(list(ObjectType))), members))
    return ObjectDictionary(objects)


STIMULI = [
    START, SYNC, "185#R", "205#0102030405060708", "080#05", "705#R", "100#0000000000000000", "085#", "685#", "205#01", SYNC,
    "605#2F00180100000000", "605#2310100173617665", "605#2B17100064000000", "605#2305100080000040", RESET_NODE, START,
]  # fmt: skip


@examples(30)
@given(dictionaries(), st.integers(1, 127))
def test_any_description_makes_a_device_that_boots_and_answers(dictionary: ObjectDictionary, node_id: int) -> None:
    bench = DeviceBench(dictionary, make=lambda out, _, described: LocalNode(out, 5, described))
    assert bench.node.state is NmtState.PRE_OPERATIONAL
    assert all(str(notice) for notice in notices_of(bench.node))
    LocalNode(Outbox(), node_id, dictionary)
    readable(bench)
    for frame in STIMULI:
        bench.network.receive(Frame.parse(frame), bench.now)
        for _ in range(4):
            legal(bench)
            bench.now = min(max(bench.now, bench.network.next_deadline()), bench.now + 20 * MILLISECOND)
            bench.network.handle_timeout(bench.now)
            legal(bench)
    readable(bench)
    assert all(str(notice) for notice in notices_of(bench.node))


FIELDS = {
    "ObjectType": ("0x7", "0x8", "0x9", "2", "99", ""),
    "DataType": ("0x0007", "5", "6", "4", "0x9", "0xF", "0x8", "0xC", "1", "0x21", "zz", ""),
    "AccessType": ("rw", "ro", "wo", "const", "rwr", "x", ""),
    "PDOMapping": ("0", "1", "x"),
    "SubNumber": ("0", "2", "7", "0xFF", "4294967295", "-1"),
    "CompactSubObj": ("0", "3", "254"),
    "DefaultValue": (
        "", "0", "1", "255", "0x80", "$NODEID+0x180", "0x40000180+$NODEID", "0x80000200+$NODEID", "0x605", "-1", "0x60000008",
        "0x60410010", "text", "1e9", "99999999999999999999", "65536", "0x0005000A",
    ),
    "ParameterValue": ("0", "$NODEID+0x80", "0x185", "7", "x"),
    "LowLimit": ("0", "-5", "0xFFFFFFFF"),
    "HighLimit": ("1", "0", "x"),
}  # fmt: skip


@st.composite
def eds_texts(draw: st.DrawFn) -> str:
    """Files that describe communication objects in some odd way."""
    indices = draw(st.lists(st.sampled_from(INDICES), unique=True, min_size=1, max_size=9))
    lines = ["[OptionalObjects]", f"SupportedObjects={len(indices)}"]
    lines += [f"{number}=0x{index:04X}" for number, index in enumerate(indices, start=1)]
    for index in indices:
        places = [f"{index:04X}"] + [
            f"{index:04X}sub{subindex:X}" for subindex in draw(st.sampled_from([(), (0, 1), (0, 1, 2, 5)]))
        ]
        for place in places:
            lines += [f"[{place}]", "ParameterName=o"]
            for key in draw(st.lists(st.sampled_from(sorted(FIELDS)), unique=True, max_size=6)):
                lines.append(f"{key}={draw(st.sampled_from(FIELDS[key]))}")
            lines.append(f"DataType={draw(st.sampled_from(FIELDS['DataType'][:4]))}")
    return "\n".join(lines)


@examples(30)
@given(eds_texts(), st.integers(1, 127))
def test_whatever_a_reader_makes_of_a_file_is_a_device(text: str, node_id: int) -> None:
    dictionary = read_eds(text).dictionary
    LocalNode(Outbox(), node_id, dictionary)
    bench = DeviceBench(dictionary)
    for frame in STIMULI:
        bench.network.receive(Frame.parse(frame), bench.now)
        legal(bench)
    readable(bench)
    assert all(str(notice) for notice in notices_of(bench.node))


def legal(bench: DeviceBench) -> None:
    """What it sends is a frame, and none that commands other nodes or answers for them; storage is with its host."""
    frames, events = bench.network.drain(bench.now)
    for frame in frames:
        assert len(frame.data) <= 8
        assert not frame.flags & REMOTE
        assert frame.flags & EXTENDED or 0x80 <= frame.can_id < 0x800
    for access in events:
        if isinstance(access, ObjectAccessPending):
            bench.node.complete(access.access_id, None, bench.now)


def readable(bench: DeviceBench) -> None:
    """Each object can be read by SDO, but for what has no data yet."""
    node = bench.node
    for variable in node.dictionary:
        if variable.access.readable:
            data = node.read(variable.index, variable.subindex, bench.now)
            if data != AbortCode.NO_DATA:
                assert isinstance(data, bytes), f"{variable}: {data}"
                variable.decode(data)


def test_the_widest_numbers_are_those_of_the_types() -> None:
    """Of the generator above: it reaches beyond every integer type."""
    for data_type in DataType:
        limits = range_of(data_type)
        assert limits is None or limits[1] < 1 << 70
