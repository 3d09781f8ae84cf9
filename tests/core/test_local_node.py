"""A device as its peers see it: frames in, frames out."""

from __future__ import annotations

import dataclasses

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.datatypes import DataType, Value, ValueRangeError
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, SECOND, FrameIgnored, LocalProtocolError, Outbox
from canopen_proto.network import Network
from canopen_proto.nmt import SERVICES, NmtCommand, NmtState, NmtStateChanged, Service
from canopen_proto.sdo.server import SdoServerAborted
from tests.core.device_bench import (
    PRE_OPERATIONAL,
    RESET_COMMUNICATION,
    RESET_NODE,
    START,
    STOP,
    SYNC,
    DeviceBench,
)
from tests.core.devices import INPUT, LIMITED, OUTPUT, TEXT, io_device

READ_INPUT = "605#4000200000000000"


def with_object(dictionary: ObjectDictionary, index: int, data_type: DataType, access: Access) -> ObjectDictionary:
    variable = Variable(index, 0, f"object_{index:04x}", data_type, access)
    return dictionary.with_objects([Object.of(variable.name, [variable])])


def with_default(dictionary: ObjectDictionary, index: int, subindex: int, default: Value) -> ObjectDictionary:
    """The dictionary with another value at power-on."""
    found = dictionary.objects[index]
    variables = {**found.variables, subindex: dataclasses.replace(found.variables[subindex], default=default)}
    return dictionary.with_objects([Object.of(found.name, variables.values(), found.object_type)])


# ---- power on, NMT ----


def test_a_device_is_mute_until_it_boots() -> None:
    bench = DeviceBench(boot=False)
    assert bench.tell(READ_INPUT, START, SYNC) == []
    assert bench.wait(10_000) == []
    assert bench.node.state is NmtState.INITIALISING
    bench.node.boot(bench.now)
    assert bench.take() == ["705#00"]
    assert bench.node.state is NmtState.PRE_OPERATIONAL


def test_a_device_that_is_on_can_not_be_switched_on_and_nothing_changes() -> None:
    bench = DeviceBench()
    bench.tell(START)
    bench.write(0x1800, 5, 20, 2)
    bench.wait(15)
    with pytest.raises(LocalProtocolError, match="boots from INITIALISING only"):
        bench.node.boot(bench.now)
    assert bench.take() == []
    assert bench.wait(10) == ["20 185#0000"]  # the event timer was not started anew


@pytest.mark.parametrize("node_id", [0, 128, -1])
def test_node_ids(node_id: int) -> None:
    with pytest.raises(LocalProtocolError, match="outside 1..127"):
        LocalNode(Outbox(), node_id, io_device())


@pytest.mark.parametrize(
    ("command", "state"),
    [(START, NmtState.OPERATIONAL), (STOP, NmtState.STOPPED), (PRE_OPERATIONAL, NmtState.PRE_OPERATIONAL)],
)
def test_which_service_lives_in_which_state(command: str, state: NmtState) -> None:
    bench = DeviceBench()
    bench.write(0x1017, 0, 100, 2)
    bench.tell(START if command != START else STOP, command)
    assert bench.node.state is state

    answered = bool(bench.tell(READ_INPUT))
    bench.node.set_value(INPUT, 0, 0x1234, bench.now)
    sent_pdo = "185#3412" in bench.take()
    bench.node.raise_error(0x4210, 0x08, b"", bench.now)
    sent_emcy = "085#1042090000000000" in bench.take()
    beats = bench.wait(100)

    assert answered == (Service.SDO in SERVICES[state])
    assert sent_pdo == (Service.PDO in SERVICES[state])
    assert sent_emcy == (Service.EMCY in SERVICES[state])
    assert beats == [f"100 705#{int(state):02X}"]
    assert bool(bench.tell(SYNC)) == (state is NmtState.OPERATIONAL)  # TPDO2 goes by SYNC


def test_a_request_behind_nmt_stop_is_not_answered_and_a_pdo_behind_nmt_start_is_taken() -> None:
    bench = DeviceBench()
    assert bench.tell(START, "205#0700") == []
    assert bench.node.values.store[OUTPUT << 8] == 7
    assert bench.tell(STOP, READ_INPUT, "205#0900") == []
    assert bench.node.values.store[OUTPUT << 8] == 7


def test_a_transfer_under_way_is_forgotten_when_the_node_stops() -> None:
    bench = DeviceBench()
    assert bench.tell("605#4003200000000000") == ["585#410320001E000000"]
    assert bench.tell(STOP) == []
    assert [event.origin for event in bench.seen(SdoServerAborted)] == [AbortOrigin.CANCELLED]
    assert bench.wait(2000) == []
    assert bench.tell(PRE_OPERATIONAL, "605#6000000000000000") == ["585#8000000001000405"]


def test_reset_node_puts_all_values_back() -> None:
    bench = DeviceBench(io_device(heartbeat_ms=100))
    assert bench.write(LIMITED, 0, 15, 1) is None
    assert bench.write(0x1017, 0, 50, 2) is None
    bench.tell(START)
    bench.events.clear()
    assert bench.tell(RESET_NODE) == ["705#00"]
    assert [(event.previous.name, event.state.name) for event in bench.seen(NmtStateChanged)] == [
        ("OPERATIONAL", "INITIALISING"),
        ("INITIALISING", "PRE_OPERATIONAL"),
    ]
    assert bench.number(LIMITED) == 10
    assert bench.number(0x1017) == 100
    assert bench.wait(200) == ["100 705#7F", "200 705#7F"]


def test_reset_communication_puts_back_0x1000_to_0x1fff_only() -> None:
    dictionary = with_object(io_device(heartbeat_ms=100), 0x1FFF, DataType.UNSIGNED8, Access.RW)
    bench = DeviceBench(dictionary)
    for index, value, size in [(LIMITED, 15, 1), (0x1017, 50, 2), (0x1FFF, 3, 1), (OUTPUT, 7, 2)]:
        assert bench.write(index, 0, value, size) is None
    assert bench.tell(RESET_COMMUNICATION) == ["705#00"]
    assert [bench.number(index) for index in (LIMITED, 0x1017, 0x1FFF, OUTPUT)] == [15, 100, 0, 7]


def test_a_reset_puts_a_remapped_pdo_back() -> None:
    bench = DeviceBench()
    assert bench.write(0x1800, 1, 0x80000185, 4) is None
    assert bench.write(0x1800, 1, 0x40000190, 4) is None
    bench.tell(START)
    bench.node.set_value(INPUT, 0, 1, bench.now)
    assert bench.take() == ["190#0100"]
    bench.tell(RESET_COMMUNICATION, START)
    bench.node.set_value(INPUT, 0, 2, bench.now)
    assert bench.take() == ["185#0200"]


def test_reset_node_ends_errors_and_reset_communication_those_of_communication() -> None:
    bench = DeviceBench()
    bench.tell(START, "205#01")
    bench.node.raise_error(0x4210, 0x08, b"", bench.now)
    assert bench.take() == ["085#1042190000000000"]
    bench.tell(RESET_COMMUNICATION)
    assert bench.number(0x1001) == 0x09  # the temperature; 0x8210 is gone
    assert bench.number(0x1003) == 0
    bench.tell(RESET_NODE)
    assert bench.number(0x1001) == 0


def test_the_heartbeat_bears_the_state_and_begins_with_the_boot_up_frame() -> None:
    bench = DeviceBench(io_device(heartbeat_ms=100), boot=False)
    bench.node.boot(0)
    assert bench.take() == ["705#00"]
    assert bench.wait(100) == ["100 705#7F"]
    assert bench.tell(START) == []
    assert bench.wait(100) == ["200 705#05"]
    assert bench.tell(STOP) == []
    assert bench.wait(100) == ["300 705#04"]


def test_a_device_may_start_itself() -> None:
    bench = DeviceBench(boot=False)
    bench.node.boot(0)
    bench.node.execute(NmtCommand.START, 0)
    assert bench.take() == ["705#00"]
    assert bench.tell("205#0500", SYNC) == ["285#0000"]


# ---- SDO ----


@pytest.mark.parametrize(
    ("request_frame", "answer"),
    [
        ("605#4000100000000000", "585#4300100091010000"),  # 0x1000: 0x191
        ("605#4018100200000000", "585#4318100207000000"),
        ("605#2B01200034120000", "585#6001200000000000"),
        ("605#2300100000000000", "585#8000100002000106"),  # read only
        ("605#4000100100000000", "585#8000100111000906"),  # no such subindex
        ("605#4004100000000000", "585#8004100000000206"),  # no such object
        ("605#2F02200015000000", "585#8002200031000906"),  # 21 > 20
        ("605#2F02200009000000", "585#8002200032000906"),  # 9 < 10
        ("605#2B0220000A000000", "585#8002200012000706"),  # two bytes for one
        ("605#2F01200001000000", "585#8001200013000706"),  # one byte for two
    ],
)
def test_sdo_in_frames(request_frame: str, answer: str) -> None:
    assert DeviceBench().tell(request_frame) == [answer]


def test_text_goes_in_segments() -> None:
    bench = DeviceBench()
    content = b""
    assert bench.tell("605#4003200000000000") == ["585#410320001E000000"]
    for toggle in (0x60, 0x70, 0x60, 0x70, 0x60):
        (answer,) = bench.tell(f"605#{toggle:02X}00000000000000")
        content += bytes.fromhex(answer[6:])
    assert content.rstrip(b"\x00") == b"an I/O device with a long name"
    assert bench.tell("605#2103200000000000") == ["585#6003200000000000"]
    assert bench.tell("605#0F00000000000000") == ["585#2000000000000000"]
    assert bench.node.values.store[TEXT << 8] == ""


def test_a_value_that_the_device_itself_spoiled_is_an_abort_and_not_an_exception() -> None:
    bench = DeviceBench()
    bench.node.values.store[INPUT << 8] = 1 << 20
    assert bench.read(INPUT) == AbortCode.INTERNAL_INCOMPATIBILITY


# ---- PDO ----


def test_a_value_that_changes_sends_its_event_driven_pdo_and_the_synchronous_one_goes_by_sync() -> None:
    bench = DeviceBench()
    bench.tell(START)
    bench.node.set_value(INPUT, 0, -2, bench.now)
    assert bench.take() == ["185#FEFF"]
    assert bench.tell(SYNC, SYNC) == ["285#FEFF", "285#FEFF"]


def test_a_write_by_sdo_or_pdo_sends_the_pdo_that_carries_the_object() -> None:
    dictionary = io_device().with_objects([standard_object(0x1A00, highest=2, defaults={0: 1, 1: 0x20010010})])
    bench = DeviceBench(dictionary)
    bench.tell(START)
    assert bench.tell("605#2B01200007000000") == ["185#0700", "585#6001200000000000"]
    assert bench.tell("205#0800") == ["185#0800"]


@pytest.mark.parametrize(("key", "value"), [((0x2FFF, 0), 1), ((INPUT, 1), 1)])
def test_set_value_of_no_object(key: tuple[int, int], value: int) -> None:
    bench = DeviceBench()
    with pytest.raises(LocalProtocolError, match="is not in the dictionary"):
        bench.node.set_value(*key, value, 0)


def test_set_value_that_does_not_fit_changes_nothing() -> None:
    bench = DeviceBench()
    bench.tell(START)
    with pytest.raises(ValueRangeError):
        bench.node.set_value(INPUT, 0, 40_000, 0)
    assert bench.node.values.store[INPUT << 8] == 0
    assert bench.take() == []


def test_set_value_of_a_communication_object_takes_effect() -> None:
    bench = DeviceBench()
    bench.node.set_value(0x1017, 0, 20, bench.now)
    assert bench.take() == ["705#7F"]
    assert bench.wait(20) == ["20 705#7F"]
    bench.tell(START)
    bench.node.set_value(0x1800, 1, 0x80000185, bench.now)
    bench.node.set_value(INPUT, 0, 1, bench.now)
    assert bench.take() == []
    with pytest.raises(LocalProtocolError, match=r"cob_id_sync .* = 128000: .*value"):
        bench.node.set_value(0x1005, 0, 128_000, bench.now)
    assert bench.number(0x1005) == 0x80


def test_an_rpdo_of_type_1_acts_at_the_sync_and_the_last_one_before_it_counts() -> None:
    bench = DeviceBench()
    bench.tell(START, "305#0100", "305#0200")
    assert bench.node.values.store[OUTPUT << 8] == 0
    bench.tell(SYNC)
    assert bench.node.values.store[OUTPUT << 8] == 2
    bench.node.values.store[OUTPUT << 8] = 9
    bench.tell(SYNC)
    assert bench.node.values.store[OUTPUT << 8] == 9


def test_what_was_held_for_a_sync_is_dropped_when_the_node_leaves_operational() -> None:
    bench = DeviceBench()
    bench.tell(START, "305#0100", PRE_OPERATIONAL, START, SYNC)
    assert bench.node.values.store[OUTPUT << 8] == 0


def test_a_short_pdo_is_an_emcy_until_a_good_one_comes() -> None:
    bench = DeviceBench()
    bench.tell(START)
    assert bench.tell("205#07") == ["085#1082110100000000"]
    assert bench.tell("205#", "205#08") == []  # told once
    assert bench.node.values.store[OUTPUT << 8] == 0
    assert bench.number(0x1003, 1) == 0x0001_8210  # of RPDO 1
    assert bench.tell("205#0800") == ["085#0000000000000000"]
    assert bench.number(0x1001) == 0


def test_short_pdos_of_several_rpdos_are_several_errors() -> None:
    bench = DeviceBench()
    bench.tell(START)
    assert bench.tell("205#07", "305#07") == ["085#1082110100000000", "085#1082110200000000"]
    assert bench.tell("205#0700") == []
    assert bench.tell("305#0700") == []  # held for the SYNC
    assert bench.tell(SYNC) == ["285#0000", "085#0000000000000000"]


def test_a_pdo_that_is_too_long_is_used_and_no_error() -> None:
    bench = DeviceBench()
    bench.tell(START)
    assert bench.tell("205#0700AABB") == []
    assert bench.node.values.store[OUTPUT << 8] == 7


def test_an_overdue_rpdo_is_an_emcy_until_it_comes() -> None:
    bench = DeviceBench()
    bench.write(0x1400, 5, 50, 2)
    bench.tell(START)
    assert bench.wait(200) == []  # it has not begun
    bench.tell("205#0100")
    assert bench.wait(100) == ["250 085#5082110100000000"]
    assert bench.tell("205#0100") == ["085#0000000000000000"]


def test_the_error_of_an_rpdo_ends_when_it_is_set_up_anew() -> None:
    bench = DeviceBench()
    bench.tell(START, "205#07")
    assert bench.write(0x1400, 1, 0x80000205, 4) is None
    assert bench.others == ["085#0000000000000000"]


def test_a_remote_frame_is_no_pdo_and_no_request() -> None:
    bench = DeviceBench()
    bench.tell(START)
    assert bench.tell("205#R2", "605#R8", "000#R2", "080#R", "705#R1") == []
    assert bench.node.state is NmtState.OPERATIONAL


REMAP_RPDO1_TO_LIMITED = (
    (0x1400, 1, 0x80000205, 4),
    (0x1600, 0, 0, 1),
    (0x1600, 1, 0x20020008, 4),
    (0x1600, 0, 1, 1),
    (0x1400, 2, 254, 1),
    (0x1400, 1, 0x00000205, 4),
)


def test_a_pdo_is_remapped_by_sdo() -> None:
    bench = DeviceBench()
    bench.tell(START)
    for step in REMAP_RPDO1_TO_LIMITED:
        assert bench.write(*step) is None
    bench.tell("205#0C")
    assert bench.node.values.store[LIMITED << 8] == 12
    assert bench.node.values.store[OUTPUT << 8] == 0


@pytest.mark.parametrize(
    ("step", "abort_code"),
    [
        ((0x1600, 0, 0, 1), AbortCode.DEVICE_STATE),  # the PDO is valid
        ((0x1600, 1, 0x20020008, 4), AbortCode.UNSUPPORTED_ACCESS),  # the mapping is enabled
        ((0x1400, 1, 0x206, 4), AbortCode.DEVICE_STATE),
        ((0x1400, 2, 250, 1), AbortCode.INVALID_VALUE),
        ((0x1400, 0, 1, 1), AbortCode.READ_ONLY),
    ],
)
def test_a_pdo_is_not_remapped_against_the_rules(step: tuple[int, int, int, int], abort_code: AbortCode) -> None:
    bench = DeviceBench()
    bench.tell(START)
    assert bench.write(*step) == abort_code
    bench.tell("205#0700")
    assert bench.node.values.store[OUTPUT << 8] == 7


# ---- dictionaries of all kinds ----


def minimal() -> ObjectDictionary:
    return ObjectDictionary([standard_object(0x1000)])


def test_a_device_with_nothing_but_0x1000() -> None:
    bench = DeviceBench(minimal(), boot=False)
    bench.node.boot(0)
    assert bench.take() == ["705#00"]
    assert bench.number(0x1000) == 0
    for index in (0x1001, 0x1003, 0x1017, 0x1400, 0x1600, 0x1800, 0x2000):
        assert bench.read(index) == AbortCode.NO_SUCH_OBJECT
        assert bench.write(index, 0, 0, 1) == AbortCode.NO_SUCH_OBJECT
    assert bench.tell(START, SYNC, "205#0000", "705#05", RESET_COMMUNICATION, RESET_NODE, STOP) == ["705#00", "705#00"]
    bench.tell(PRE_OPERATIONAL)
    bench.node.raise_error(0x1000, 0, b"", bench.now)
    assert bench.take() == ["085#0010010000000000"]
    assert bench.wait(60_000) == []
    assert set(bench.node.values.store) == {0x100000}


def test_two_nodes_of_one_dictionary_share_no_value() -> None:
    dictionary = io_device()
    out = Outbox()
    one, other = LocalNode(out, 5, dictionary), LocalNode(out, 6, dictionary)
    one.boot(0)
    one.set_value(INPUT, 0, 7, 0)
    one.set_value(0x1017, 0, 100, 0)
    assert other.values.store[INPUT << 8] == 0
    assert other.values.store[0x1017 << 8] == 0
    assert one.dictionary is other.dictionary
    assert one.values.store[0x1014 << 8] == 0x85
    assert other.values.store[0x1014 << 8] == 0x86


def test_a_default_that_no_client_could_write_does_not_keep_a_device_from_starting() -> None:
    bench = DeviceBench(with_default(io_device(), 0x1019, 0, 241))
    assert bench.tell(START, SYNC) == ["285#0000"]
    dictionary = io_device().with_objects([standard_object(0x1600, highest=2, defaults={0: 1, 1: 0x2FFF0010})])
    bench = DeviceBench(dictionary)
    assert bench.tell(START, "205#0700") == []
    assert bench.node.pdos.faults == {0x1600: "object 0x2FFF:00 is not in the dictionary"}


# ---- the rest ----


def test_time_that_comes_early_does_nothing() -> None:
    bench = DeviceBench(io_device(heartbeat_ms=100))
    bench.node.handle_timeout(99 * MILLISECOND)
    assert bench.take() == []
    bench.now = 10 * SECOND  # late: one heartbeat, not a hundred
    bench.network.handle_timeout(bench.now)
    assert bench.take() == ["705#7F"]


def test_bytes_that_are_no_value_are_refused_by_sdo_and_ignored_by_pdo() -> None:
    """A time of day with 25 hours: the length is right, and yet it is none."""
    dictionary = with_object(io_device(), 0x2100, DataType.TIME_OF_DAY, Access.RW)
    variable = dataclasses.replace(dictionary.objects[0x2100].variables[0], pdo_mappable=True)
    mapping = standard_object(0x1601, highest=2, defaults={0: 1, 1: 0x21000030})
    bench = DeviceBench(dictionary.with_objects([Object.of("time", [variable]), mapping]))
    noon = bench.node.values.store[0x210000]

    assert bench.tell("605#2100210006000000") == ["585#6000210000000000"]
    assert bench.tell("605#03FFFFFF0F010000") == ["585#8000210030000906"]
    bench.tell(START, "305#FFFFFF0F0100", SYNC)
    assert [event.reason for event in bench.seen(FrameIgnored)] != []
    assert bench.node.values.store[0x210000] == noon


def test_two_devices_in_one_process_on_one_network() -> None:
    network = Network()
    nodes = [LocalNode(network.out, node_id, io_device(node_id)) for node_id in (5, 6)]
    for node in nodes:
        network.attach(node)
        node.boot(0)
    for frame in ("000#0100", "206#0700", "605#4001200000000000", "606#4001200000000000", "080#", "000#8106"):
        network.receive(Frame.parse(frame), 0)
    frames, _ = network.drain(0)
    assert [str(frame) for frame in frames] == [
        "705#00",
        "706#00",
        "585#4B01200000000000",
        "586#4B01200007000000",
        "285#0000",
        "286#0000",
        "706#00",
    ]
    assert [node.state for node in nodes] == [NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL]
