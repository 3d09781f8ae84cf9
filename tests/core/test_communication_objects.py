"""Each communication object that has an effect: what may be written there, and what follows."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.machine import MILLISECOND
from tests.core.device_bench import PRE_OPERATIONAL, RESET_COMMUNICATION, START, STOP, DeviceBench
from tests.core.devices import io_device

# ---- 0x1001, 0x1003 ----


def test_error_register_and_history_newest_first() -> None:
    bench = DeviceBench()
    assert bench.number(0x1001) == 0
    assert bench.number(0x1003) == 0
    for code in (0x1000, 0x2310, 0x3210, 0x4210):
        bench.node.raise_error(code, 0, b"", bench.now)
    bench.take()
    assert bench.number(0x1001) == 1
    assert [bench.number(0x1003, subindex) for subindex in range(4)] == [3, 0x4210, 0x3210, 0x2310]
    assert bench.read(0x1003, 4) == AbortCode.NO_SUCH_SUBINDEX


def test_an_entry_of_the_history_that_is_empty_has_no_data() -> None:
    bench = DeviceBench()
    assert bench.tell("605#4003100100000000") == ["585#8003100124000008"]
    bench.node.raise_error(0x1000, 0, b"", bench.now)
    bench.take()
    assert bench.number(0x1003, 1) == 0x1000
    assert bench.read(0x1003, 2) == AbortCode.NO_DATA


@pytest.mark.parametrize(
    ("subindex", "value", "size", "abort_code"),
    [(0, 0, 1, None), (0, 1, 1, AbortCode.INVALID_VALUE), (0, 255, 1, AbortCode.INVALID_VALUE), (1, 0, 4, AbortCode.READ_ONLY)],
)
def test_the_history_is_cleared_by_zero_and_nothing_else(
    subindex: int, value: int, size: int, abort_code: AbortCode | None
) -> None:
    bench = DeviceBench()
    bench.node.raise_error(0x1000, 0, b"", bench.now)
    bench.take()
    assert bench.write(0x1003, subindex, value, size) == abort_code
    assert bench.number(0x1003) == (1 if abort_code else 0)
    assert bench.number(0x1001) == 1  # the error is still there


def test_a_history_without_entries() -> None:
    dictionary = io_device()
    count = dictionary.variable((0x1003, 0))
    bench = DeviceBench(dictionary.with_objects([type(dictionary.objects[0x1000]).of("history", [count])]))
    bench.node.raise_error(0x1000, 0, b"", bench.now)
    bench.take()
    known = set(bench.node.values.store)
    assert bench.number(0x1003) == 0
    assert bench.read(0x1003, 1) == AbortCode.NO_SUCH_SUBINDEX
    assert set(bench.node.values.store) == known


# ---- 0x1005, 0x1006, 0x1019: SYNC ----

PRODUCE = (0x1005, 0, 0x40000080, 4)


def producing(period_us: int = 10_000) -> DeviceBench:
    bench = DeviceBench()
    assert bench.write(0x1006, 0, period_us, 4) is None
    assert bench.wait(100) == []
    assert bench.write(*PRODUCE) is None
    assert bench.others == ["080#"]
    return bench


def test_a_sync_producer_begins_at_once_and_keeps_its_phase() -> None:
    bench = producing()
    assert bench.wait(20) == ["110 080#", "120 080#"]
    assert bench.write(*PRODUCE) is None  # the same again: nothing happens
    assert bench.others == []
    assert bench.write(0x1006, 0, 10_000, 4) is None
    assert bench.others == []
    assert bench.write(0x1006, 0, 0, 4) is None
    assert bench.wait(100) == []
    assert bench.write(0x1006, 0, 500, 4) is None
    assert bench.others == ["080#"]
    assert bench.wait(1) == ["220.5 080#", "221 080#"]
    assert bench.write(0x1005, 0, 0x80, 4) is None
    assert bench.wait(100) == []


def test_sync_is_produced_only_where_sync_lives_and_its_counter_begins_anew() -> None:
    bench = DeviceBench()
    assert bench.write(0x1019, 0, 3, 1) is None
    assert bench.write(0x1006, 0, 10_000, 4) is None
    assert bench.write(*PRODUCE) is None
    assert bench.others == ["080#01"]
    assert bench.wait(30) == ["10 080#02", "20 080#03", "30 080#01"]
    assert bench.tell(STOP) == []
    assert bench.wait(100) == []
    assert bench.tell(PRE_OPERATIONAL) == ["080#01"]
    assert bench.tell(RESET_COMMUNICATION) == ["705#00"]  # the default is not to produce
    assert bench.wait(100) == []


def test_the_producers_own_pdos_go_by_its_sync() -> None:
    bench = producing()
    assert bench.tell(START) == []
    assert bench.tell("305#0500") == []
    assert bench.wait(10) == ["110 080#", "110 285#0000"]
    assert bench.node.values.store[0x200100] == 5


@pytest.mark.parametrize(
    ("standing", "value", "abort_code"),
    [
        (0x80, 0x81, None),
        (0x80, 0x40000081, None),  # not in use before
        (0x40000080, 0x40000080, None),
        (0x40000080, 0x40000081, AbortCode.DEVICE_STATE),
        (0x40000080, 0x60000080, AbortCode.DEVICE_STATE),  # the frame bit
        (0x40000080, 0x80, None),
        (0x40000080, 0x82, None),  # ends the production
        (0x80, 0x800, AbortCode.INVALID_VALUE),
        (0x80, 0x1000_0080, AbortCode.INVALID_VALUE),
        (0x80, 0x2001_0080, None),
        (0x80, 0, AbortCode.INVALID_VALUE),  # NMT
        (0x80, 0x605, AbortCode.INVALID_VALUE),  # SDO
        (0x80, 0x701, AbortCode.INVALID_VALUE),  # heartbeat
    ],
)
def test_cob_id_of_sync(standing: int, value: int, abort_code: AbortCode | None) -> None:
    bench = DeviceBench()
    if standing != 0x80:
        assert bench.write(0x1005, 0, standing, 4) is None
    assert bench.write(0x1005, 0, value, 4) == abort_code
    assert bench.number(0x1005) == (standing if abort_code else value)


def test_sync_is_heard_at_its_new_can_id_only() -> None:
    bench = DeviceBench()
    bench.write(0x1005, 0, 0x90, 4)
    bench.tell(START)
    assert bench.tell("080#") == []
    assert bench.tell("090#") == ["285#0000"]
    bench.write(0x1005, 0, 0x2001_0080, 4)
    assert bench.tell("090#", "080#") == []
    assert bench.tell("00010080#") == ["285#0000"]


@pytest.mark.parametrize(
    ("value", "abort_code"),
    [
        (0, None),
        (1, AbortCode.INVALID_VALUE),
        (2, None),
        (240, None),
        (241, AbortCode.INVALID_VALUE),
        (255, AbortCode.INVALID_VALUE),
    ],
)
def test_counter_overflow(value: int, abort_code: AbortCode | None) -> None:
    assert DeviceBench().write(0x1019, 0, value, 1) == abort_code


def test_counter_overflow_while_there_is_a_period() -> None:
    bench = DeviceBench()
    bench.write(0x1006, 0, 10_000, 4)
    assert bench.tell("605#2F19100005000000") == ["585#8019100022000008"]
    assert bench.write(0x1019, 0, 0, 1) is None  # no change


def test_a_sync_with_a_counter_where_one_is_expected_and_none_where_not() -> None:
    bench = DeviceBench()
    bench.tell(START)
    assert bench.tell("080#01") == []
    bench.write(0x1019, 0, 10, 1)
    assert bench.tell("080#") == []
    assert bench.tell("080#01") == ["285#0000"]


# ---- 0x1014, 0x1015: EMCY ----


@pytest.mark.parametrize(
    ("standing", "value", "abort_code"),
    [
        (0x85, 0x85, None),
        (0x85, 0x86, AbortCode.DEVICE_STATE),
        (0x85, 0x80000085, None),
        (0x85, 0x80000000, None),  # many masters destroy it like this
        (0x80000085, 0x95, None),
        (0x80000085, 0x20010000, None),
        (0x80000085, 0x585, AbortCode.INVALID_VALUE),
        (0x80000085, 0x885, AbortCode.INVALID_VALUE),
    ],
)
def test_cob_id_of_emcy(standing: int, value: int, abort_code: AbortCode | None) -> None:
    bench = DeviceBench()
    assert bench.number(0x1014) == 0x85
    bench.write(0x1014, 0, standing, 4)
    assert bench.write(0x1014, 0, value, 4) == abort_code
    bench.node.raise_error(0x1000, 0, b"", bench.now)
    sent = [frame.partition("#")[0] for frame in bench.take()]
    valid = standing if abort_code else value
    assert sent == ([] if valid & 0x80000000 else [f"{valid & 0x1FFFFFFF:08X}" if valid >> 29 else f"{valid:03X}"])


def test_emcy_inhibit_time() -> None:
    bench = DeviceBench()
    assert bench.write(0x1015, 0, 500, 2) is None  # 50 ms
    bench.node.raise_error(0x1000, 0, b"", bench.now)
    bench.node.raise_error(0x2310, 2, b"", bench.now)
    assert bench.take() == ["085#0010010000000000"]
    assert bench.wait(100) == ["50 085#1023030000000000"]


# ---- 0x1016, 0x1017: heartbeat ----


@pytest.mark.parametrize(
    ("subindex", "value", "abort_code"),
    [
        (1, 0x0009_0064, None),  # the same again
        (1, 0x000A_0064, None),
        (2, 0x0009_0064, AbortCode.PARAMETER_INCOMPATIBLE),  # each node once
        (2, 0x0009_0000, None),  # no time: not used
        (2, 0x0000_0064, None),  # no node: not used
        (2, 0x0080_0064, None),
        (2, 0x000A_0064, None),
        (3, 0x000B_0064, AbortCode.NO_SUCH_SUBINDEX),
    ],
)
def test_consumer_heartbeat_time(subindex: int, value: int, abort_code: AbortCode | None) -> None:
    bench = DeviceBench()
    assert bench.write(0x1016, 1, 0x0009_0064, 4) is None
    assert bench.write(0x1016, subindex, value, 4) == abort_code


def test_monitors_come_change_and_go() -> None:
    bench = DeviceBench()
    bench.write(0x1029, 1, 1, 1)
    bench.write(0x1016, 1, 0x0009_0064, 4)
    bench.tell("709#05")
    assert bench.write(0x1016, 1, 0x0009_0032, 4) is None  # a node that was heard: watched from now on
    assert bench.wait(60) == ["50 085#3081110900000000"]
    bench.tell("709#05")
    assert bench.write(0x1016, 1, 0x000A_0032, 4) is None
    assert bench.wait(1000) == []
    assert set(bench.node.communication.monitors) == {10}
    assert 0x709 not in bench.network.can_ids()


def test_a_dictionary_with_one_node_twice_monitors_it_by_the_first_entry() -> None:
    dictionary = io_device().with_objects([standard_object(0x1016, highest=2, defaults={1: 0x0009_0064, 2: 0x0009_0032})])
    bench = DeviceBench(dictionary)
    assert {node: monitor.timeout for node, monitor in bench.node.communication.monitors.items()} == {9: 100 * MILLISECOND}


def test_producer_heartbeat_time() -> None:
    bench = DeviceBench()
    assert bench.tell("605#2B17100032000000") == ["705#7F", "585#6017100000000000"]
    assert bench.wait(100) == ["50 705#7F", "100 705#7F"]
    assert bench.tell("605#2B17100000000000") == ["585#6017100000000000"]
    assert bench.wait(1000) == []


# ---- the rest ----


def test_objects_without_an_effect_are_kept() -> None:
    bench = DeviceBench(io_device().with_objects([standard_object(0x1012), standard_object(0x1028, highest=1)]))
    assert bench.write(0x1012, 0, 0x100, 4) is None
    assert bench.write(0x1028, 1, 0x85, 4) is None
    assert bench.number(0x1012) == 0x100
    assert bench.number(0x1028, 1) == 0x85


def test_a_communication_object_of_another_type_is_as_if_it_were_not_there() -> None:
    """EDS files describe 0x1008 and the like by text; nothing keeps one from describing 0x1005 so."""
    dictionary = io_device()
    text = dictionary.variable((0x2003, 0))
    odd = type(dictionary.objects[0x1000]).of("odd", [type(text)(0x1005, 0, "odd", text.data_type, default="abc")])
    bench = DeviceBench(dictionary.with_objects([odd]))
    bench.tell(START)
    assert bench.tell("080#") == ["285#0000"]
    assert bench.tell("605#2305100041424344") == ["585#6005100000000000"]
    assert bench.tell("080#") == ["285#0000"]
