"""What a device does about errors: EMCY, 0x1001, 0x1003, the NMT state by 0x1029; and whose errors it hears of (0x1028)."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.emcy import EmcyReceived, EmcySent
from canopen_proto.frame import Frame
from canopen_proto.heartbeat import HeartbeatLost
from canopen_proto.nmt import NmtState, NmtStateChanged
from tests.core.device_bench import PRE_OPERATIONAL, RESET_COMMUNICATION, RESET_NODE, START, STOP, DeviceBench
from tests.core.devices import io_device

# ---- lost heartbeats ----


def monitoring(milliseconds: int = 100) -> DeviceBench:
    """A device that monitors node 9 and has heard it."""
    bench = DeviceBench()
    assert bench.write(0x1016, 1, 9 << 16 | milliseconds, 4) is None
    bench.tell(START, "709#05")
    return bench


def test_a_lost_heartbeat_is_an_emcy_and_leads_to_pre_operational() -> None:
    bench = monitoring()
    assert bench.wait(150) == ["100 085#3081110900000000"]
    assert [event.node_id for event in bench.seen(HeartbeatLost)] == [9]
    assert bench.node.state is NmtState.PRE_OPERATIONAL
    assert bench.number(0x1001) == 0x11
    assert bench.number(0x1003, 1) == 0x0009_8130
    assert bench.tell("709#05") == ["085#0000000000000000"]
    assert bench.number(0x1001) == 0
    assert bench.node.state is NmtState.PRE_OPERATIONAL  # back only by NMT


@pytest.mark.parametrize(
    ("behaviour", "from_state", "state"),
    [
        (0, START, NmtState.PRE_OPERATIONAL),
        (0, STOP, NmtState.STOPPED),
        (1, START, NmtState.OPERATIONAL),
        (2, START, NmtState.STOPPED),
        (2, PRE_OPERATIONAL, NmtState.STOPPED),
    ],
)
def test_error_behaviour(behaviour: int, from_state: str, state: NmtState) -> None:
    bench = monitoring()
    assert bench.write(0x1029, 1, behaviour, 1) is None
    bench.tell(from_state)
    bench.wait(150)
    assert bench.node.state is state


def test_without_0x1029_a_lost_heartbeat_leads_to_pre_operational() -> None:
    dictionary = ObjectDictionary(each for index, each in io_device().objects.items() if index != 0x1029)
    bench = DeviceBench(dictionary)
    bench.write(0x1016, 1, 9 << 16 | 100, 4)
    bench.tell(START, "709#05")
    bench.wait(150)
    assert bench.node.state is NmtState.PRE_OPERATIONAL


def test_each_lost_node_is_told_of_and_the_error_ends_with_the_last_one() -> None:
    bench = monitoring()
    bench.write(0x1016, 2, 10 << 16 | 200, 4)
    bench.tell("70A#05")
    assert bench.wait(300) == ["100 085#3081110900000000", "200 085#3081110A00000000"]
    assert bench.tell("709#05") == []
    assert bench.tell("70A#7F") == ["085#0000000000000000"]


def test_a_lost_node_that_is_no_longer_monitored_is_no_error() -> None:
    bench = monitoring()
    bench.wait(150)
    assert bench.write(0x1016, 1, 0, 4) is None
    assert bench.others == ["085#0000000000000000"]
    assert bench.wait(1000) == []


def test_monitoring_begins_anew_after_a_reset() -> None:
    dictionary = io_device().with_objects([standard_object(0x1016, highest=2, defaults={1: 9 << 16 | 100})])
    bench = DeviceBench(dictionary)
    bench.tell("709#05")
    bench.wait(150)
    assert bench.number(0x1001) == 0x11
    assert bench.tell(RESET_COMMUNICATION) == ["705#00", "085#0000000000000000"]
    assert bench.number(0x1001) == 0
    assert bench.wait(1000) == []  # until it is heard
    bench.tell("709#05")
    assert bench.wait(200) == [f"{150 + 1000 + 100} 085#3081110900000000"]


def test_an_error_that_a_reset_has_ended_is_not_told_behind_the_boot_up() -> None:
    bench = monitoring()
    assert bench.write(0x1015, 0, 10_000, 2) is None  # a second between two EMCY
    bench.node.raise_error(0x2310, 0x02, b"", bench.now)
    assert bench.take() == ["085#1023030000000000"]
    assert bench.wait(150) == []  # node 9 is lost, and the EMCY for that waits
    assert bench.number(0x1001) == 0x13
    assert bench.tell(RESET_COMMUNICATION)[0] == "705#00"
    assert bench.number(0x1001) == 0x03
    assert bench.wait(2000) == []


def test_errors_reported_by_the_device_itself() -> None:
    bench = DeviceBench()
    bench.node.raise_error(0x2310, 0x02, b"\x01\x02", 0)
    bench.node.raise_error(0x4210, 0x08, b"", 0)
    assert bench.take() == ["085#1023030102000000", "085#10420B0000000000"]
    bench.node.clear_error(0x2310, 0)
    assert bench.take() == []
    bench.node.clear_error(0x4210, 0)
    assert bench.take() == ["085#0000000000000000"]
    assert [event.code for event in bench.seen(EmcySent)] == [0x2310, 0x4210, 0]


def test_127_nodes_are_monitored() -> None:
    dictionary = io_device().with_objects([standard_object(0x1016, highest=127)])
    bench = DeviceBench(dictionary)
    for node_id in range(1, 128):
        assert bench.write(0x1016, node_id, node_id << 16 | 100 + node_id, 4) is None
    assert bench.write(0x1016, 1, 127 << 16 | 100, 4) == AbortCode.PARAMETER_INCOMPATIBLE
    bench.tell(*(f"{0x700 + node_id:03X}#05" for node_id in range(1, 128)))
    bench.tell(START)
    sent = bench.wait(1000)
    assert sent[:2] == ["101 085#3081110100000000", "102 085#3081110200000000"]
    assert len(sent) == 127
    assert [each.node_id for each in bench.seen(HeartbeatLost)] == list(range(1, 128))
    assert bench.node.state is NmtState.PRE_OPERATIONAL
    assert bench.number(0x1003) == 3  # it has no more entries
    assert bench.tell(*(f"{0x700 + node_id:03X}#05" for node_id in range(1, 128))) == ["085#0000000000000000"]


def test_the_same_value_twice_is_no_second_entry() -> None:
    bench = DeviceBench()
    assert bench.write(0x1016, 1, 0x0009_0064, 4) is None
    bench.tell("709#05")
    bench.wait(60)
    assert bench.write(0x1016, 1, 0x0009_0064, 4) is None  # nothing changes: the time runs on
    assert bench.wait(40) == ["100 085#3081110900000000"]


# ---- 0x1029 ----


@pytest.mark.parametrize(
    ("value", "abort_code"),
    [
        (0, None),
        (1, None),
        (2, None),
        (3, AbortCode.INVALID_VALUE),
        (0x80, AbortCode.INVALID_VALUE),
        (255, AbortCode.INVALID_VALUE),
    ],
)
def test_what_0x1029_takes(value: int, abort_code: AbortCode | None) -> None:
    assert DeviceBench().write(0x1029, 1, value, 1) == abort_code


def classes() -> DeviceBench:
    """0x1029: communication errors stop, output errors (2) change nothing, input errors (3) lead to pre-operational."""
    defaults = {1: 2, 2: 1, 3: 0}
    bench = DeviceBench(io_device().with_objects([standard_object(0x1029, highest=3, defaults=defaults)]))
    bench.tell(START)
    bench.events.clear()
    return bench


@pytest.mark.parametrize(
    ("error_class", "state"),
    [
        (None, NmtState.OPERATIONAL),
        (1, NmtState.STOPPED),
        (2, NmtState.OPERATIONAL),
        (3, NmtState.PRE_OPERATIONAL),
        (4, NmtState.PRE_OPERATIONAL),  # 0x1029 has no such subindex
    ],
)
def test_each_class_of_errors_has_its_behaviour(error_class: int | None, state: NmtState) -> None:
    bench = classes()
    bench.node.raise_error(0x2310, 0x02, b"", bench.now, error_class=error_class)
    assert bench.take() == ["085#1023030000000000"]
    assert bench.node.state is state
    assert len(bench.seen(NmtStateChanged)) == (state is not NmtState.OPERATIONAL)
    assert bench.tell("080#") == (["285#0000"] if state is NmtState.OPERATIONAL else [])


def test_a_bus_that_was_off() -> None:
    bench = classes()
    bench.node.bus_off(bench.now)
    assert bench.node.state is NmtState.STOPPED
    bench.tell(START)
    bench.node.bus_recovered(bench.now)
    assert bench.take() == ["085#4081110000000000", "085#0000000000000000"]
    assert bench.number(0x1003, 1) == 0x8140
    assert bench.number(0x1001) == 0


def test_a_bus_that_is_off_before_the_device_is_on() -> None:
    bench = DeviceBench(boot=False)
    bench.node.bus_off(0)
    bench.node.bus_recovered(0)
    assert bench.take() == []
    assert bench.node.state is NmtState.INITIALISING


# ---- 0x1028 ----


def consumers(*cob_ids: int, boot: bool = True) -> DeviceBench:
    defaults = dict(enumerate(cob_ids, start=1))
    return DeviceBench(io_device().with_objects([standard_object(0x1028, highest=127, defaults=defaults)]), boot=boot)


EMCY_OF_1 = "081#1023030102030405"


def heard(bench: DeviceBench) -> list[tuple[int, int]]:
    return [(each.node_id, each.code) for each in bench.seen(EmcyReceived)]


def test_a_device_hears_the_emcy_of_the_nodes_in_0x1028() -> None:
    bench = consumers()
    assert bench.number(0x1028, 1) == 0x80000000
    bench.tell(EMCY_OF_1)
    assert heard(bench) == []
    assert bench.write(0x1028, 1, 0x81, 4) is None
    assert bench.write(0x1028, 127, 0x20010000, 4) is None
    bench.tell(EMCY_OF_1, "082#1023030102030405", "00010000#0000")
    assert heard(bench) == [(1, 0x2310), (127, 0)]  # the subindex is the node-ID, whatever the CAN-ID; a short frame too
    assert bench.write(0x1028, 1, 0x80000081, 4) is None
    bench.tell(EMCY_OF_1)
    assert heard(bench) == []
    assert bench.write(0x1028, 1, 0x91, 4) is None
    bench.tell(EMCY_OF_1, "091#1023030102030405")
    assert heard(bench) == [(1, 0x2310)]


def test_emcy_is_heard_where_it_lives() -> None:
    bench = consumers(0x81)
    for command, count in ((START, 1), (STOP, 0), (PRE_OPERATIONAL, 1), (RESET_COMMUNICATION, 1), (RESET_NODE, 1)):
        bench.tell(command, EMCY_OF_1)
        assert len(heard(bench)) == count, command
    mute = consumers(0x81, boot=False)
    mute.tell(EMCY_OF_1)
    assert heard(mute) == []


@pytest.mark.parametrize(
    ("standing", "value", "abort_code"),
    [
        (0x81, 0x82, AbortCode.DEVICE_STATE),
        (0x81, 0x80000000, None),
        (0x81, 0x81, None),
        (0x80000000, 0x82, None),
        (0x80000000, 0x585, AbortCode.INVALID_VALUE),
        (0x80000000, 0, AbortCode.INVALID_VALUE),
        (0x80000000, 0x800, AbortCode.INVALID_VALUE),
        (0, 0x82, None),  # a default that no EMCY can have
    ],
)
def test_cob_ids_of_0x1028(standing: int, value: int, abort_code: AbortCode | None) -> None:
    assert consumers(standing).write(0x1028, 1, value, 4) == abort_code


def test_a_default_of_0_in_0x1028_hears_nothing() -> None:
    bench = consumers(0)
    assert bench.node.communication.emcy_consumers == {}
    assert Frame(0x081).key not in bench.network.can_ids()
