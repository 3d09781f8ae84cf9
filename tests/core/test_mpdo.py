"""Multiplexed PDOs in both address modes: rules, lists, frames (CiA 301 v4.2.0, 7.2.3 and 7.5.2.36 to 7.5.2.40)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, FrameIgnored, LocalProtocolError
from canopen_proto.pdo.consumer import PdoLengthUnexpected
from canopen_proto.pdo.multiplexed import MpdoMode, MpdoNotProcessed, MpdoReceived
from canopen_proto.pdo.producer import PdoNotSent
from tests.core.device_bench import PRE_OPERATIONAL, RESET_COMMUNICATION, START, SYNC, DeviceBench
from tests.core.devices import INPUT, LIMITED, OUTPUT, io_device

MS = MILLISECOND
TABLE, LONG, REAL, FLAG, SECRET = 0x2100, 0x2101, 0x2102, 0x2103, 0x2104
SAM, DAM = int(MpdoMode.SOURCE), int(MpdoMode.DESTINATION)


def array(index: int, data_type: DataType, access: Access, count: int) -> Object:
    fields = [Variable(index, 0, f"{index:X}:count", DataType.UNSIGNED8, Access.CONST, count)]
    fields += [Variable(index, each, f"{index:X}:{each}", data_type, access, pdo_mappable=True) for each in range(1, count + 1)]
    return Object.of(f"{index:X}", fields)


def single(index: int, data_type: DataType, access: Access = Access.RW, mappable: bool = True) -> Object:
    return Object.of(f"o{index:X}", [Variable(index, 0, f"o{index:X}", data_type, access, pdo_mappable=mappable)])


def mpdo_device(*more: Object) -> ObjectDictionary:
    """RPDO3 and TPDO3 in source address mode, RPDO4 and TPDO4 in destination address mode; the lists are empty."""
    objects = [
        standard_object(0x1402, highest=5, defaults={1: 0x1C0, 2: 255}),
        standard_object(0x1602, highest=1, defaults={0: SAM}),
        standard_object(0x1403, highest=5, defaults={1: 0x1C1, 2: 255}),
        standard_object(0x1603, highest=1, defaults={0: DAM}),
        standard_object(0x1802, highest=6, defaults={1: 0x400001C5, 2: 254}),
        standard_object(0x1A02, highest=1, defaults={0: SAM}),
        standard_object(0x1803, highest=6, defaults={1: 0x400001C6, 2: 255}),
        standard_object(0x1A03, highest=1, defaults={0: DAM}),
        standard_object(0x1FA0, highest=3),
        standard_object(0x1FA1, highest=1),
        standard_object(0x1FD0, highest=3),
        standard_object(0x1FFF, highest=1),
        array(TABLE, DataType.INTEGER16, Access.RW, 4),
        single(LONG, DataType.UNSIGNED64),
        single(REAL, DataType.REAL32),
        single(FLAG, DataType.BOOLEAN),
        single(SECRET, DataType.UNSIGNED8, mappable=False),
        *more,
    ]
    return io_device().with_objects(objects)


def scan(block: int, index: int, subindex: int) -> int:
    return block << 24 | index << 8 | subindex


def dispatch(block: int, local: int, local_subindex: int, index: int, subindex: int, producer: int) -> int:
    return block << 56 | local << 40 | local_subindex << 32 | index << 16 | subindex << 8 | producer


def bench_with(*lists: tuple[int, int, int]) -> DeviceBench:
    """An Operational device. lists: index, subindex and value of list entries."""
    bench = DeviceBench(mpdo_device())
    for index, subindex, value in lists:
        bench.node.set_value(index, subindex, value, bench.now)
    bench.tell(START)
    bench.events.clear()
    return bench


# ---- source address mode, consumer ----


def test_the_dispatching_list_says_where_a_producers_object_goes() -> None:
    bench = bench_with(
        (0x1FD0, 1, dispatch(1, OUTPUT, 0, 0x6401, 2, 9)),
        (0x1FD0, 2, dispatch(3, TABLE, 2, 0x6411, 5, 10)),
        (0x1FFF, 1, dispatch(1, LIMITED, 0, 0x6401, 2, 9)),  # one value to two objects
    )
    assert bench.tell("1C0#09016402FEFF0000") == []
    assert bench.node.values.store[OUTPUT << 8] == -2
    assert bench.node.values.store[LIMITED << 8] == 0xFE
    assert bench.seen(MpdoReceived) == [
        MpdoReceived(5, 3, 0x1C0, 9, OUTPUT, 0, -2, None),
        MpdoReceived(5, 3, 0x1C0, 9, LIMITED, 0, 0xFE, None),  # limits are not for PDOs
    ]
    assert bench.tell("1C0#0A11640600010000", "1C0#0A11640700020000") == []
    assert [bench.node.values.store[TABLE << 8 | subindex] for subindex in range(1, 5)] == [0, 0, 0x100, 0x200]


@pytest.mark.parametrize(
    "frame",
    [
        "1C0#0A01640207000000",  # another producer
        "1C0#0902640207000000",  # another object
        "1C0#0901640107000000",  # the subindex before
        "1C0#0901640307000000",  # the one behind
        "1C0#0001640207000000",  # no node has that ID
    ],
)
def test_what_is_not_listed_is_not_for_us(frame: str) -> None:
    bench = bench_with((0x1FD0, 1, dispatch(1, OUTPUT, 0, 0x6401, 2, 9)))
    assert bench.tell(frame) == []
    assert bench.events == []
    assert bench.node.values.store[OUTPUT << 8] == 0


def test_what_a_list_says_that_makes_no_sense_is_not_obeyed() -> None:
    described = standard_object(0x1FD0, highest=3, defaults={1: dispatch(2, 0x2FFF, 0, 0x6401, 2, 9)})
    bench = DeviceBench(mpdo_device(described))
    assert bench.tell(START, "1C0#0901640207000000") == []
    assert bench.seen(MpdoReceived) == []


# ---- destination address mode, consumer ----


def test_an_mpdo_writes_the_object_that_it_names() -> None:
    bench = bench_with()
    assert bench.tell("1C1#8501200007000000") == []  # node 5, 0x2001:00
    assert bench.node.values.store[OUTPUT << 8] == 7
    assert bench.tell("1C1#8000210308000000") == []  # all nodes, 0x2100:03
    assert bench.node.values.store[TABLE << 8 | 3] == 8
    assert bench.tell("1C1#8502210000000040", "1C1#850321000F000000") == []
    assert bench.node.values.store[REAL << 8] == 2.0
    assert bench.node.values.store[FLAG << 8] is True
    assert [(each.number, each.producer, each.index) for each in bench.seen(MpdoReceived)] == [
        (4, 0, OUTPUT),
        (4, 0, TABLE),
        (4, 0, REAL),
        (4, 0, FLAG),
    ]


def test_an_mpdo_for_another_node_is_not_for_us() -> None:
    bench = bench_with()
    assert bench.tell("1C1#8601200007000000", "1C1#FF01200007000000") == []
    assert bench.node.values.store[OUTPUT << 8] == 0
    assert bench.events == []


@pytest.mark.parametrize(
    "frame",
    [
        "1C1#8500300007000000",  # 0x3000 does not exist
        "1C1#8501200107000000",  # nor does subindex 1 of 0x2001
        "1C1#8000200007000000",  # INPUT is read only; to all nodes
        "1C1#8504210007000000",  # not mappable
        "1C1#8501210007000000",  # eight bytes have no room
        "1C1#8503200041000000",  # text neither
        "1C1#8517100007000000",  # nothing else writes communication objects
    ],
)
def test_an_object_that_is_not_there_is_an_emcy(frame: str) -> None:
    bench = bench_with()
    assert bench.tell(frame) == ["085#3082110400000000"]
    (report,) = bench.seen(MpdoNotProcessed)
    assert (report.number, report.key, report.emcy_code) == (4, 0x1C1, 0x8230)
    assert bench.tell(frame) == []  # told once
    assert bench.number(0x1003, 1) == 0x0004_8230
    assert bench.tell("1C1#8501200007000000") == ["085#0000000000000000"]


# ---- both consumers ----


@pytest.mark.parametrize("can_id", ["1C0", "1C1"])
def test_a_short_mpdo_is_not_processed(can_id: str) -> None:
    bench = bench_with()
    assert bench.tell(f"{can_id}#85012000070000") == [f"085#108211{3 if can_id == '1C0' else 4:02X}00000000"]
    (report,) = bench.seen(PdoLengthUnexpected)
    assert (report.expected, report.received, report.emcy_code) == (8, 7, 0x8210)
    assert bench.node.values.store[OUTPUT << 8] == 0


def test_the_other_address_mode_is_ignored() -> None:
    bench = bench_with((0x1FD0, 1, dispatch(1, OUTPUT, 0, OUTPUT, 0, 5)))
    assert bench.tell("1C0#8501200007000000", "1C1#0501200007000000") == []
    assert [each.reason for each in bench.seen(FrameIgnored)] == [
        "not the address mode of RPDO 3, SOURCE",
        "not the address mode of RPDO 4, DESTINATION",
    ]
    assert bench.node.values.store[OUTPUT << 8] == 0


def test_mpdos_live_in_operational_only() -> None:
    bench = bench_with((0x1FA0, 1, scan(1, INPUT, 0)))
    bench.tell(PRE_OPERATIONAL)
    assert bench.tell("1C1#8501200007000000") == []
    bench.node.set_value(INPUT, 0, 1, bench.now)
    assert bench.take() == []
    assert not bench.node.send_mpdo(4, 9, 0x6200, 1, b"\x01", bench.now)
    assert bench.node.values.store[OUTPUT << 8] == 0


def test_two_rpdos_on_one_can_id() -> None:
    bench = bench_with((0x1FD0, 1, dispatch(1, OUTPUT, 0, 0x6401, 2, 9)))
    bench.node.set_value(0x1402, 1, 0x80000000, bench.now)
    bench.node.set_value(0x1402, 1, 0x1C1, bench.now)
    bench.tell("1C1#0901640207000000", "1C1#8001200008000000", "1C0#0901640209000000")
    assert [each.value for each in bench.seen(MpdoReceived)] == [7, 8]


def test_a_value_that_an_mpdo_brought_is_told_like_any_other() -> None:
    described = standard_object(0x1A00, highest=2, defaults={0: 1, 1: OUTPUT << 16 | 0x10})
    bench = DeviceBench(mpdo_device(described))
    assert bench.tell(START, "1C1#8501200007000000") == ["185#0700"]


# ---- source address mode, producer ----


def test_what_is_scanned_is_sent_when_it_changes() -> None:
    bench = bench_with((0x1FA0, 1, scan(1, INPUT, 0)), (0x1FA1, 1, scan(2, TABLE, 2)))
    bench.node.set_value(INPUT, 0, -2, bench.now)
    assert bench.take() == ["185#FEFF", "1C5#05002000FEFF0000"]  # TPDO1 carries it too
    for subindex in range(1, 5):
        bench.node.set_value(TABLE, subindex, subindex, bench.now)
    assert bench.take() == ["1C5#0500210202000000", "1C5#0500210303000000"]
    assert bench.write(TABLE, 2, 9, 2) is None  # by SDO
    assert bench.others == ["1C5#0500210209000000"]


def test_the_inhibit_time_lies_between_any_two_and_each_waits_once() -> None:
    bench = bench_with((0x1FA0, 1, scan(4, TABLE, 1)))
    bench.node.set_value(0x1802, 1, 0xC00001C5, bench.now)
    bench.node.set_value(0x1802, 3, 100, bench.now)  # 10 ms
    bench.node.set_value(0x1802, 1, 0x400001C5, bench.now)
    for subindex, value in [(3, 3), (1, 1), (2, 2), (1, 4), (1, 5)]:
        bench.node.set_value(TABLE, subindex, value, bench.now)
    assert bench.take() == ["1C5#0500210303000000"]
    assert bench.wait(100) == ["10 1C5#0500210105000000", "20 1C5#0500210202000000"]
    bench.node.set_value(TABLE, 1, 6, bench.now)
    assert bench.take() == ["1C5#0500210106000000"]
    bench.node.set_value(TABLE, 1, 7, bench.now)
    bench.tell(PRE_OPERATIONAL, START)
    assert bench.wait(100) == []  # what waited is forgotten


def test_another_event_time_loses_no_object_that_waits() -> None:
    bench = bench_with((0x1FA0, 1, scan(4, TABLE, 1)))
    for subindex, value in [(1, 0xC00001C5), (3, 100), (1, 0x400001C5)]:  # 10 ms between two
        bench.node.set_value(0x1802, subindex, value, bench.now)
    for subindex in (1, 2, 3):
        bench.node.set_value(TABLE, subindex, 1, bench.now)
    assert bench.take() == ["1C5#0500210101000000"]
    assert bench.write(0x1802, 2, 254, 1) is None  # as it is
    assert bench.write(0x1802, 5, 25, 2) is None
    assert bench.wait(30) == ["10 1C5#0500210201000000", "20 1C5#0500210301000000"]
    assert bench.wait(16) == ["45 1C5#0500210101000000"]


def test_the_event_time_sends_one_object_after_the_other() -> None:
    bench = bench_with((0x1FA0, 1, scan(1, INPUT, 0)), (0x1FA0, 3, scan(2, TABLE, 1)))
    bench.node.set_value(0x1802, 5, 20, bench.now)
    assert bench.wait(85) == [
        "20 1C5#0500200000000000",
        "40 1C5#0500210100000000",
        "60 1C5#0500210200000000",
        "80 1C5#0500200000000000",
    ]
    bench.node.set_value(TABLE, 2, 7, bench.now)
    assert bench.take() == ["1C5#0500210207000000"]
    assert bench.wait(20) == ["105 1C5#0500210100000000"]  # the event time counts from the last one
    bench.node.set_value(0x1FA0, 1, 0, bench.now)
    bench.node.set_value(0x1FA0, 3, 0, bench.now)
    assert bench.wait(100) == []  # nothing is scanned any more
    bench.node.set_value(0x1FA0, 1, scan(1, INPUT, 0), bench.now)
    assert bench.wait(20) == ["225 1C5#0500200000000000"]


def test_a_list_that_changes_while_objects_wait() -> None:
    bench = bench_with((0x1FA0, 1, scan(4, TABLE, 1)))
    bench.node.set_value(0x1802, 1, 0xC00001C5, bench.now)
    bench.node.set_value(0x1802, 3, 100, bench.now)
    bench.node.set_value(0x1802, 1, 0x400001C5, bench.now)
    for subindex in (1, 2, 3):
        bench.node.set_value(TABLE, subindex, 1, bench.now)
    bench.take()
    bench.node.set_value(0x1FA0, 1, scan(1, TABLE, 3), bench.now)
    assert bench.wait(100) == ["10 1C5#0500210301000000"]
    for subindex in (3, 3):
        bench.node.set_value(TABLE, subindex, 2, bench.now)
    bench.take()
    bench.node.set_value(0x1FA0, 1, 0, bench.now)
    assert bench.wait(100) == []


def test_a_value_that_cannot_be_sent_is_an_event() -> None:
    bench = bench_with((0x1FA0, 1, scan(4, TABLE, 1)))
    bench.node.values.store[TABLE << 8 | 1] = 1.5
    bench.node.pdos.trigger(TABLE << 8 | 1, bench.now)
    assert bench.take() == []
    assert [each.number for each in bench.seen(PdoNotSent)] == [3]
    bench.node.set_value(TABLE, 2, 1, bench.now)
    assert bench.take() == ["1C5#0500210201000000"]


def test_a_pdo_that_is_no_mpdo_any_more() -> None:
    bench = bench_with((0x1FA0, 1, scan(1, TABLE, 1)))
    bench.node.set_value(0x1802, 5, 20, bench.now)
    bench.node.set_value(0x1802, 1, 0xC00001C5, bench.now)
    bench.node.set_value(TABLE, 1, 1, bench.now)
    assert bench.take() == []
    assert bench.wait(100) == []
    for index, subindex, value in [(0x1A02, 0, 0), (0x1A02, 1, TABLE << 16 | 0x0110), (0x1A02, 0, 1), (0x1802, 1, 0x400001C5)]:
        bench.node.set_value(index, subindex, value, bench.now)
    bench.node.set_value(TABLE, 1, 2, bench.now)
    assert bench.take() == ["1C5#0200"]
    assert bench.tell(RESET_COMMUNICATION, START) == ["705#00"]
    bench.node.set_value(0x1FA0, 1, scan(1, TABLE, 1), bench.now)
    bench.node.set_value(TABLE, 1, 3, bench.now)
    assert bench.take() == ["1C5#0500210103000000"]


def test_a_default_list_is_used_from_the_start() -> None:
    bench = DeviceBench(mpdo_device(standard_object(0x1FA0, highest=1, defaults={1: scan(9, TABLE, 0)})))
    bench.tell(START)
    bench.node.set_value(TABLE, 4, 1, bench.now)
    assert bench.take() == ["1C5#0500210401000000"]
    described = standard_object(0x1FA0, highest=2, defaults={1: scan(1, 0x2FFF, 0), 2: scan(1, LONG, 0)})
    assert DeviceBench(mpdo_device(described)).node.pdos.mpdo_producer._scanned == {}


# ---- destination address mode, producer ----


def test_an_application_writes_objects_of_other_nodes() -> None:
    bench = bench_with()
    assert bench.node.send_mpdo(4, 9, 0x6200, 1, b"\x55", bench.now)
    assert bench.node.send_mpdo(4, 0, 0x6411, 2, b"\x01\x02\x03\x04", bench.now)
    assert bench.take() == ["1C6#8900620155000000", "1C6#8011640201020304"]


@pytest.mark.parametrize(
    ("number", "node_id", "index", "subindex", "data"),
    [
        (3, 9, 0x6200, 1, b"1"),  # source address mode
        (1, 9, 0x6200, 1, b"1"),
        (4, 128, 0x6200, 1, b"1"),
        (4, -1, 0x6200, 1, b"1"),
        (4, 9, 0x10000, 1, b"1"),
        (4, 9, 0x6200, 256, b"1"),
        (4, 9, 0x6200, 1, b""),
        (4, 9, 0x6200, 1, b"12345"),
    ],
)
def test_what_cannot_be_sent(number: int, node_id: int, index: int, subindex: int, data: bytes) -> None:
    bench = bench_with()
    with pytest.raises(LocalProtocolError):
        bench.node.send_mpdo(number, node_id, index, subindex, data, bench.now)
    assert bench.take() == []


def test_a_destroyed_mpdo_sends_nothing() -> None:
    bench = bench_with()
    bench.node.set_value(0x1803, 1, 0xC00001C6, bench.now)
    with pytest.raises(LocalProtocolError, match="TPDO 4 of node 5 is not a valid MPDO"):
        bench.node.send_mpdo(4, 9, 0x6200, 1, b"\x55", bench.now)


# ---- the rules ----


@pytest.mark.parametrize(
    ("steps", "abort_code"),
    [
        ([(0x1A01, 0, DAM, 1)], None),
        ([(0x1A01, 0, SAM, 1)], AbortCode.PARAMETER_INCOMPATIBLE),  # TPDO2 goes by SYNC
        ([(0x1801, 2, 255, 1), (0x1A01, 0, SAM, 1)], AbortCode.PARAMETER_INCOMPATIBLE),  # there is one already
        ([(0x1802, 1, 0x800001C5, 4), (0x1A02, 0, 0, 1), (0x1801, 2, 255, 1), (0x1A01, 0, SAM, 1)], None),
        ([(0x1601, 0, SAM, 1)], None),
        ([(0x1601, 0, DAM, 1)], None),
        ([(0x1601, 0, 0xFD, 1)], AbortCode.PDO_LENGTH_EXCEEDED),
        ([(0x1802, 2, 1, 1)], AbortCode.PARAMETER_INCOMPATIBLE),  # in source address mode it is event-driven
        ([(0x1802, 2, 253, 1)], AbortCode.PARAMETER_INCOMPATIBLE),
        ([(0x1802, 2, 255, 1)], None),
        ([(0x1803, 2, 1, 1)], None),
        ([(0x1A03, 0, 0, 1)], AbortCode.DEVICE_STATE),  # it is valid
    ],
)
def test_which_pdo_may_be_an_mpdo(steps: list[tuple[int, int, int, int]], abort_code: AbortCode | None) -> None:
    bench = DeviceBench(mpdo_device())
    assert bench.write(0x1801, 1, 0x80000000, 4) is None
    assert bench.write(0x1401, 1, 0x80000000, 4) is None
    *before, last = steps
    for step in before:
        assert bench.write(*step) is None
    assert bench.write(*last) == abort_code


def test_source_address_mode_needs_its_list() -> None:
    bench = DeviceBench()
    for index in (0x1400, 0x1800):
        bench.write(index, 1, 0x80000000, 4)
    assert bench.write(0x1600, 0, SAM, 1) == AbortCode.PDO_LENGTH_EXCEEDED
    assert bench.write(0x1A00, 0, SAM, 1) == AbortCode.PDO_LENGTH_EXCEEDED
    assert bench.write(0x1600, 0, DAM, 1) is None


@pytest.mark.parametrize(
    ("entry", "abort_code"),
    [
        (0, None),
        (scan(1, INPUT, 0), None),
        (scan(4, TABLE, 1), None),
        (scan(0, INPUT, 0), AbortCode.INVALID_VALUE),
        (scan(5, TABLE, 1), AbortCode.NO_SUCH_OBJECT),
        (scan(2, TABLE, 255), AbortCode.NO_SUCH_OBJECT),
        (scan(1, 0x2FFF, 0), AbortCode.NO_SUCH_OBJECT),
        (scan(1, LONG, 0), AbortCode.CANNOT_BE_MAPPED),
        (scan(1, SECRET, 0), AbortCode.CANNOT_BE_MAPPED),
    ],
)
def test_entries_of_a_scanner_list(entry: int, abort_code: AbortCode | None) -> None:
    assert DeviceBench(mpdo_device()).write(0x1FA0, 1, entry, 4) == abort_code


@pytest.mark.parametrize(
    ("entry", "abort_code"),
    [
        (0, None),
        (dispatch(1, OUTPUT, 0, 0x6401, 1, 127), None),
        (dispatch(1, OUTPUT, 0, 0x6401, 1, 0), AbortCode.INVALID_VALUE),
        (dispatch(1, OUTPUT, 0, 0x6401, 1, 128), AbortCode.INVALID_VALUE),
        (dispatch(0, OUTPUT, 0, 0x6401, 1, 9), AbortCode.INVALID_VALUE),
        (dispatch(2, OUTPUT, 0, 0x6401, 1, 9), AbortCode.NO_SUCH_OBJECT),
        (dispatch(1, INPUT, 0, 0x6401, 1, 9), AbortCode.CANNOT_BE_MAPPED),
    ],
)
def test_entries_of_a_dispatching_list(entry: int, abort_code: AbortCode | None) -> None:
    bench = DeviceBench(mpdo_device())
    assert bench.node.pdos.check_write(0x1FD0, 1, entry) == abort_code
    assert bench.node.pdos.check_write(0x1FC0, 0, entry) is None  # no such list: the dictionary says so before
    assert bench.node.pdos.check_write(0x1007, 0, entry) is None


# ---- anything ----


@given(
    st.lists(st.integers(0, 2**32 - 1), max_size=3),
    st.lists(st.integers(0, 2**64 - 1) | st.builds(dispatch, *[st.sampled_from(each) for each in (
        (0, 1, 3, 255), (OUTPUT, TABLE, INPUT, 0x1017), (0, 1, 3, 255), (0x6401,), (0, 1), (9,))]), max_size=3),
    st.lists(st.tuples(st.sampled_from(["1C0", "1C1"]), st.binary(max_size=8)), max_size=10),
)  # fmt: skip
def test_no_list_and_no_frame_raises(scans: list[int], dispatches: list[int], frames: list[tuple[str, bytes]]) -> None:
    lists = [
        standard_object(0x1FA0, highest=3, defaults=dict(enumerate(scans, start=1))),
        standard_object(0x1FD0, highest=3, defaults=dict(enumerate(dispatches, start=1))),
    ]
    bench = DeviceBench(mpdo_device(*lists))
    bench.node.set_value(0x1802, 5, 10, bench.now)
    bench.tell(START)
    for can_id, data in frames:
        bench.tell(str(Frame(int(can_id, 16), data)), SYNC)
        bench.wait(15)
    bench.tell("1C0#0901640107000000", "1C0#0901640007000000")
    for variable in bench.node.dictionary:
        assert isinstance(bench.node.values.raw(variable.index, variable.subindex), bytes)
    assert bench.network.next_deadline() < NEVER
