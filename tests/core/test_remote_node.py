"""What a master knows of a node and exchanges with it: frames in, frames out."""

from __future__ import annotations

from collections.abc import Collection
from typing import TypeVar

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.datatypes import DataType, Value, ValueRangeError
from canopen_proto.dictionary import Constant, Direction, Filler, NotInDictionaryError, ObjectDictionary, PdoDescription, Variable
from canopen_proto.emcy import EmcyReceived
from canopen_proto.follower import Follower
from canopen_proto.frame import KEY_EXTENDED
from canopen_proto.heartbeat import HeartbeatLost, NodeBooted
from canopen_proto.machine import MILLISECOND, SECOND, Event, LocalProtocolError, Outbox, Time
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import NmtCommand, NmtMaster, NmtState
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.pdo.producer import PdoNotSent
from canopen_proto.remote_node import FRESH, NMT_REACTION_TIME, RemoteNode
from canopen_proto.sdo.client import SdoAborted, SdoDownloaded, SdoUploaded
from canopen_proto.sync import SyncConsumer, SyncProducer
from tests.core.device_bench import Bench
from tests.core.devices import INPUT, LIMITED, OUTPUT, TEXT, io_device

E = TypeVar("E", bound=Event)

INPUT_KEY, OUTPUT_KEY, LIMITED_KEY = INPUT << 8, OUTPUT << 8, LIMITED << 8


def described() -> ObjectDictionary:
    """The I/O device with constants and descriptions of its PDOs."""
    device = io_device()
    constants = {OUTPUT_KEY: [Constant("all_off", 0xFFFF, 0), Constant("lamp", 0x0001, 0x0001), Constant("low", 0xFFFF, 0xFFFE)]}
    input_, output, limited = (device.variable(index) for index in (INPUT, OUTPUT, LIMITED))
    pdos = [
        PdoDescription("inputs", 0x180, Direction.TPDO, 1, (input_,)),
        PdoDescription("outputs", 0x200, Direction.RPDO, 1, (output, Filler("gap", 8), limited)),
        PdoDescription("outputs_by_event", 0x300, Direction.RPDO, 2, (output,)),
        PdoDescription("anywhere", 0x790, Direction.TPDO, None, (input_,)),
    ]
    return ObjectDictionary(device.objects.values(), constants=constants, pdos=pdos)


class MasterBench(Bench):
    """A Network with a RemoteNode for node 5, and an NMT master beside it."""

    def __init__(self, dictionary: ObjectDictionary | None = None, heartbeat_timeout: Time = 0) -> None:
        super().__init__(SECOND)
        dictionary = described() if dictionary is None else dictionary
        self.node = RemoteNode(self.network.out, 5, dictionary, heartbeat_timeout=heartbeat_timeout)
        self.nmt = NmtMaster(self.network.out)
        self.sync = SyncProducer(self.network.out)
        for machine in (self.node, self.nmt, self.sync):
            self.network.attach(machine)

    def wait(self, duration: Time) -> list[str]:
        end = self.now + duration
        sent: list[str] = []
        while (deadline := self.network.next_deadline()) <= end:
            self.now = max(self.now, deadline)
            self.network.handle_timeout(self.now)
            sent += self.take()
        self.now = end
        return sent

    def seen(self, kind: type[E]) -> list[E]:
        found = [event for event in self.events if isinstance(event, kind)]
        self.events = [event for event in self.events if not isinstance(event, kind)]
        return found

    def operational(self) -> MasterBench:
        self.nmt.start(5, self.now)
        assert self.take() == ["000#0105"]
        return self

    @property
    def output(self) -> Value:
        return self.node.values.store[OUTPUT_KEY]

    @output.setter
    def output(self, value: Value) -> None:
        self.node.values.store[OUTPUT_KEY] = value


@pytest.mark.parametrize("node_id", [0, 128])
def test_node_ids(node_id: int) -> None:
    with pytest.raises(LocalProtocolError, match="outside 1..127"):
        RemoteNode(Outbox(), node_id, io_device())


def test_a_remote_node_follows_its_network() -> None:
    assert isinstance(MasterBench().node, Follower)


# ---- SDO ----


@pytest.mark.parametrize("key", ["output", "2001", "0x2001", "2001:00", OUTPUT, (OUTPUT, 0), "OUTPUT"])
def test_an_object_is_read_by_any_of_its_names(key: str | int | tuple[int, int]) -> None:
    bench = MasterBench()
    request_id = bench.node.read(key, bench.now)
    assert bench.take() == ["605#4001200000000000"]
    assert bench.tell("585#4B012000FEFF0000") == []
    assert bench.seen(SdoUploaded) == [SdoUploaded(5, request_id, OUTPUT, 0, b"\xfe\xff")]
    assert bench.output == -2


def test_what_is_read_does_not_change_what_we_command() -> None:
    bench = MasterBench()
    bench.node.add_pdo(bench.node.dictionary.pdo("outputs"), bench.now)
    bench.output = 5  # to go out with the next SYNC
    bench.node.read(OUTPUT, bench.now)
    bench.tell("585#4B01200004000000")  # the device has the value of before
    assert bench.seen(SdoUploaded)
    assert bench.output == 5
    bench.node.remove_pdo(Direction.RPDO, 1)
    bench.node.commanded.add(OUTPUT << 8)
    bench.node.read(OUTPUT, bench.now)
    bench.tell("585#4B01200004000000")
    assert bench.output == 5


@pytest.mark.parametrize(
    ("value", "data"), [(7, "0700"), (-2, "FEFF"), ("all_off", "0000"), ("lamp", "0100"), ("low", "FEFF"), (True, "0100")]
)
def test_a_value_or_a_constant_is_written_and_the_image_has_it_once_confirmed(value: Value, data: str) -> None:
    bench = MasterBench()
    bench.output = 99
    request_id = bench.node.write("output", value, bench.now)
    assert bench.take() == [f"605#2B012000{data}0000"]
    assert bench.output == 99
    bench.tell("585#6001200000000000")
    assert bench.seen(SdoDownloaded) == [SdoDownloaded(5, request_id, OUTPUT, 0)]
    assert bench.output == int.from_bytes(bytes.fromhex(data), "little", signed=True)
    assert bench.node.fresh(OUTPUT_KEY, bench.now) is None  # written is not heard


@pytest.mark.parametrize(
    ("key", "value", "error", "text"),
    [
        ("outputt", 1, NotInDictionaryError, "did you mean output"),
        ("output", "lampp", NotInDictionaryError, "did you mean lamp"),
        (0x2FFF, 1, NotInDictionaryError, "0x2FFF:00 is not in the dictionary"),
        ("input", 1, LocalProtocolError, r"input \(0x2000:00\) of node 5 is ro: it cannot be written"),
        ("output", 40_000, ValueRangeError, "output"),
        ("output", 1.5, ValueRangeError, "output"),
        ("limited", 21, ValueRangeError, "outside 10..20"),
        ("limited", 9, ValueRangeError, "outside 10..20"),
    ],
)
def test_what_the_dictionary_forbids_is_not_sent(key: str, value: Value, error: type[Exception], text: str) -> None:
    bench = MasterBench()
    with pytest.raises(error, match=text):
        bench.node.write(key, value, bench.now)
    assert bench.take() == []
    assert not bench.node.sdo.busy


def test_a_refused_write_leaves_the_image_alone() -> None:
    bench = MasterBench()
    request_id = bench.node.write("output", 7, bench.now)
    bench.tell("585#8001200022000008")
    assert bench.seen(SdoAborted) == [SdoAborted(5, request_id, OUTPUT, 0, AbortCode.DEVICE_STATE, AbortOrigin.PEER)]
    assert bench.output == 0


def test_writes_that_wait_are_dropped_by_their_object_unless_they_are_urgent() -> None:
    bench = MasterBench()
    bench.node.write("output", 7, bench.now)
    dropped = [bench.node.write("output", value, bench.now) for value in (8, 9)]
    bench.node.write("limited", 15, bench.now)
    bench.node.read("output", bench.now)
    bench.node.write("output", 10, bench.now, urgent=True)
    bench.take()
    bench.node.drop_waiting(mux(OUTPUT), bench.now)
    assert bench.take() == []
    assert [(event.request_id, event.origin, event.not_confirmed) for event in bench.seen(SdoAborted)] == [
        (each, AbortOrigin.CANCELLED, False) for each in dropped
    ]
    assert bench.node.sdo.waiting == 3
    assert len(bench.node._writes) == 3


def test_a_write_that_is_taken_back_leaves_nothing_behind() -> None:
    bench = MasterBench()
    running, waiting = (bench.node.write("output", value, bench.now) for value in (7, 8))
    bench.take()
    assert bench.node.cancel(waiting, bench.now)
    assert bench.take() == []
    assert bench.node.cancel(running, bench.now)
    assert bench.take() == ["605#8001200000000008"]
    assert not bench.node.cancel(running, bench.now)
    assert [event.request_id for event in bench.seen(SdoAborted)] == [waiting, running]
    assert bench.node._writes == {}


def test_an_urgent_request_goes_before_those_that_wait() -> None:
    bench = MasterBench()
    bench.node.read("input", bench.now)
    bench.node.read("limited", bench.now)
    bench.node.write("output", 0, bench.now, urgent=True)
    assert bench.take() == ["605#4000200000000000"]
    assert bench.tell("585#4B00200000000000") == ["605#2B01200000000000"]


def test_a_node_that_does_not_answer() -> None:
    bench = MasterBench()
    bench.node.write("output", 7, bench.now)
    bench.take()
    assert bench.wait(SECOND) == ["605#8001200000000405"]
    assert [event.origin for event in bench.seen(SdoAborted)] == [AbortOrigin.TIMEOUT]
    assert bench.output == 0


def test_a_length_that_is_not_the_objects_does_not_reach_the_image() -> None:
    bench = MasterBench()
    bench.node.read("output", bench.now)
    bench.tell("585#4301200001000000")  # four bytes for two
    (uploaded,) = bench.seen(SdoUploaded)
    assert uploaded.data == b"\x01\x00\x00\x00"
    assert bench.output == 0
    assert bench.node.fresh(OUTPUT_KEY, bench.now) is None
    with pytest.raises(ValueRangeError, match="output"):
        bench.node.message_of(uploaded)


def test_what_was_read_is_decoded_once_and_each_answer_keeps_its_own_value() -> None:
    bench = MasterBench()
    answers = []
    for value in (30_000, 20_000):  # above the small integers, of which Python has one of each
        bench.node.read("output", bench.now)
        bench.tell(f"585#4B012000{value.to_bytes(2, 'little').hex()}0000")
        answers += bench.seen(SdoUploaded)
    first, second = answers
    assert bench.node.value_of(second) is bench.output
    assert bench.node.message_of(second).value is bench.output
    assert (bench.node.value_of(first), bench.node.value_of(second)) == (30_000, 20_000)


def test_an_answer_is_decoded_by_the_type_that_the_caller_asked_with() -> None:
    bench = MasterBench()
    unsigned = Variable(OUTPUT, 0, "as a count", DataType.UNSIGNED16)
    bench.node.read(unsigned, bench.now)
    bench.tell("585#4B012000FEFF0000")
    (uploaded,) = bench.seen(SdoUploaded)
    assert bench.output == bench.node.value_of(uploaded) == -2
    assert bench.node.value_of(uploaded, unsigned) == 0xFFFE
    assert bench.node.value_of(uploaded, bench.node.dictionary.variable("output")) == -2


def test_an_object_that_the_dictionary_lacks_is_read_as_bytes() -> None:
    bench = MasterBench()
    bench.node.sdo.upload(0x2FFF, 1, bench.now)
    bench.tell("585#4FFF2F0107000000")
    (uploaded,) = bench.seen(SdoUploaded)
    assert uploaded.data == b"\x07"
    assert 0x2FFF01 not in bench.node.values.store
    with pytest.raises(NotInDictionaryError):
        bench.node.message_of(uploaded)


def test_message_of_an_upload() -> None:
    bench = MasterBench()
    message = bench.node.message_of(SdoUploaded(5, 1, OUTPUT, 0, b"\xfe\xff"))
    assert (message.node_id, message.name, message.value, message.constants) == (5, "output", -2, ("low",))
    message = bench.node.message_of(SdoUploaded(5, 1, TEXT, 0, b"abc"))
    assert (message.name, message.value, message.constants) == ("text", "abc", ())


# ---- what is fresh ----


def test_a_value_is_fresh_for_a_while() -> None:
    bench = MasterBench()
    assert bench.node.fresh(OUTPUT_KEY, bench.now) is None  # never heard: the default is not news
    bench.node.read("output", bench.now)
    bench.tell("585#4B01200007000000")
    assert bench.node.fresh(OUTPUT_KEY, bench.now) == 7
    assert bench.node.fresh(OUTPUT_KEY, bench.now + FRESH) == 7
    assert bench.node.fresh(OUTPUT_KEY, bench.now + FRESH + 1) is None
    assert bench.node.fresh(OUTPUT_KEY, bench.now + SECOND, max_age=SECOND) == 7
    bench.tell("705#00")
    assert bench.node.fresh(OUTPUT_KEY, bench.now) is None  # it booted since


def test_listeners_hear_of_what_was_heard() -> None:
    bench = MasterBench()
    heard: list[tuple[tuple[int, ...], Value, Time]] = []

    def listener(muxes: Collection[int], now: Time) -> None:
        heard.append((tuple(muxes), bench.node.values.store[INPUT_KEY], now))

    bench.node.add_listener(listener)
    bench.node.add_pdo(bench.node.dictionary.pdo("inputs"), bench.now)
    bench.tell("185#0300")
    bench.node.read("input", bench.now)
    bench.tell("585#4B00200004000000")
    bench.node.write("output", 4, bench.now)
    bench.tell("585#6001200000000000")
    assert heard == [((INPUT_KEY,), 3, bench.now), ((INPUT_KEY,), 4, bench.now)]


# ---- NMT state ----


def test_the_state_is_what_was_commanded_where_there_is_no_heartbeat() -> None:
    bench = MasterBench()
    assert bench.node.nmt_state is None
    for command, state in [
        (NmtCommand.START, NmtState.OPERATIONAL),
        (NmtCommand.STOP, NmtState.STOPPED),
        (NmtCommand.ENTER_PRE_OPERATIONAL, NmtState.PRE_OPERATIONAL),
        (NmtCommand.RESET_NODE, NmtState.INITIALISING),
        (NmtCommand.RESET_COMMUNICATION, NmtState.INITIALISING),
    ]:
        bench.nmt.send(command, 5, bench.now)
        bench.take()
        assert bench.node.nmt_state is state
    bench.tell("705#00")
    assert bench.node.nmt_state is NmtState.PRE_OPERATIONAL


def test_a_command_to_all_is_for_this_node_too_and_one_to_another_is_not() -> None:
    bench = MasterBench()
    bench.nmt.start(6, bench.now)
    bench.take()
    assert bench.node.nmt_state is None
    bench.nmt.start(0, bench.now)
    bench.take()
    assert bench.node.is_operational


def test_a_heartbeat_says_what_the_node_really_did() -> None:
    """The command was lost, or refused: the heartbeat has not changed, and all the same it is news."""
    bench = MasterBench()
    bench.tell("705#7F")
    bench.operational()
    assert bench.node.is_operational
    bench.tell("705#7F")  # waited in a queue perhaps
    assert bench.node.is_operational
    bench.wait(NMT_REACTION_TIME)
    bench.tell("705#7F")
    assert bench.node.nmt_state is NmtState.PRE_OPERATIONAL


def test_a_node_that_boots_is_pre_operational_and_its_open_requests_are_aborted() -> None:
    bench = MasterBench()
    first = bench.node.read("input", bench.now)
    second = bench.node.write("output", 1, bench.now)
    bench.take()
    assert bench.tell("705#00") == ["605#8000200023000A06"]
    assert [(each.request_id, each.abort_code, each.origin) for each in bench.seen(SdoAborted)] == [
        (first, AbortCode.NO_SDO_CONNECTION, AbortOrigin.LOCAL),
        (second, AbortCode.NO_SDO_CONNECTION, AbortOrigin.LOCAL),
    ]
    assert len(bench.seen(NodeBooted)) == 1
    assert bench.node._writes == {}
    assert bench.wait(10 * SECOND) == []


def test_a_lost_heartbeat_aborts_open_requests_and_the_state_last_known_stays() -> None:
    bench = MasterBench(heartbeat_timeout=100 * MILLISECOND)
    bench.tell("705#05")
    bench.wait(50 * MILLISECOND)
    bench.node.read("input", bench.now)
    bench.take()
    assert bench.wait(60 * MILLISECOND) == ["605#8000200023000A06"]
    assert len(bench.seen(HeartbeatLost)) == len(bench.seen(SdoAborted)) == 1
    assert bench.node.is_operational  # it may still hear: a halt by PDO must go out
    bench.tell("705#7F")
    assert bench.node.nmt_state is NmtState.PRE_OPERATIONAL


def test_emergencies_are_reported() -> None:
    bench = MasterBench()
    bench.tell("085#1023030102000000")
    (emcy,) = bench.seen(EmcyReceived)
    assert (emcy.node_id, emcy.code, emcy.error_register, emcy.vendor_data) == (5, 0x2310, 3, b"\x01\x02\x00\x00\x00")
    assert bench.node.emcy.last == emcy


# ---- PDOs ----


def test_a_tpdo_brings_the_image_up_to_date_in_whatever_state_the_node_is_thought_to_be() -> None:
    bench = MasterBench()
    consumer = bench.node.add_pdo(bench.node.dictionary.pdo("inputs"), bench.now)
    assert bench.node.tpdos == {1: consumer}
    bench.tell("185#FEFF")
    assert bench.node.values.store[INPUT_KEY] == -2
    assert bench.node.fresh(INPUT_KEY, bench.now) == -2
    (received,) = bench.seen(PdoReceived)
    assert (received.number, received.key, received.components) == (1, 0x185, (-2,))


def test_an_rpdo_goes_by_sync_once_it_is_enabled_and_the_node_operational() -> None:
    bench = MasterBench()
    producer = bench.node.add_pdo(bench.node.dictionary.pdo("outputs"), bench.now)
    assert bench.node.rpdos == {1: producer}

    def sync() -> list[str]:
        bench.sync.send(bench.now)
        return bench.take()

    bench.output = 0x1234
    assert sync() == ["080#"]
    bench.operational()
    assert sync() == ["080#"]
    bench.node.enable_rpdo(1, bench.now)
    assert bench.node.rpdo_of(OUTPUT) is producer
    assert bench.node.rpdo_of(LIMITED) is producer
    assert bench.node.rpdo_of(INPUT) is None
    assert sync() == ["080#", "205#3412000A"]
    bench.node.enable_rpdo(1, bench.now, False)
    assert bench.node.rpdo_of(OUTPUT) is None
    assert sync() == ["080#"]
    bench.node.enable_rpdo(1, bench.now)
    bench.nmt.enter_pre_operational(5, bench.now)
    assert sync() == ["000#8005", "080#"]
    bench.nmt.start(0, bench.now)
    assert sync() == ["000#0100", "080#", "205#3412000A"]
    assert bench.node.last_sync == bench.now


def test_a_sync_of_another_participant_releases_rpdos_too() -> None:
    bench = MasterBench()
    bench.network.attach(SyncConsumer(bench.network.out))
    bench.node.add_pdo(bench.node.dictionary.pdo("outputs"), bench.now, transmission_type=2)
    bench.node.enable_rpdo(1, bench.now)
    bench.operational()
    assert [bench.tell("080#") for _ in range(4)] == [[], ["205#0000000A"], [], ["205#0000000A"]]


def test_an_rpdo_of_type_255_goes_when_triggered() -> None:
    bench = MasterBench().operational()
    bench.node.add_pdo(bench.node.dictionary.pdo("outputs_by_event"), bench.now, transmission_type=255)
    bench.node.enable_rpdo(2, bench.now)
    bench.output = 5
    bench.node.rpdos[2].trigger(bench.now)
    assert bench.take() == ["305#0500"]
    bench.sync.send(bench.now)
    assert bench.take() == ["080#"]


def test_a_node_that_boots_gets_no_rpdo_until_it_is_enabled_again() -> None:
    """Its mapping is the default one again: the bytes of ours would mean something else."""
    bench = MasterBench().operational()
    bench.node.add_pdo(bench.node.dictionary.pdo("outputs"), bench.now)
    bench.node.enable_rpdo(1, bench.now)
    bench.tell("705#00")
    bench.operational()
    bench.sync.send(bench.now)
    assert bench.take() == ["080#"]
    bench.node.enable_rpdo(1, bench.now)
    bench.sync.send(bench.now)
    assert bench.take() == ["080#", "205#0000000A"]


def test_a_pdo_takes_the_place_of_the_one_of_its_number() -> None:
    bench = MasterBench().operational()
    dictionary = bench.node.dictionary
    bench.node.add_pdo(dictionary.pdo("outputs"), bench.now)
    bench.node.enable_rpdo(1, bench.now)
    bench.node.add_pdo(dictionary.pdo("outputs_by_event"), bench.now, number=1)
    bench.sync.send(bench.now)
    assert bench.take() == ["080#"]  # to be enabled anew
    assert set(bench.node.rpdos) == {1}

    bench.node.add_pdo(dictionary.pdo("inputs"), bench.now)
    bench.node.add_pdo(dictionary.pdo("anywhere"), bench.now, number=1)
    assert 0x185 not in bench.network.can_ids()
    bench.tell("185#0100", "795#0200")
    assert bench.node.values.store[INPUT_KEY] == 2


def test_pdos_are_removed() -> None:
    bench = MasterBench().operational()
    bench.node.add_pdo(bench.node.dictionary.pdo("inputs"), bench.now)
    bench.node.add_pdo(bench.node.dictionary.pdo("outputs"), bench.now)
    bench.node.enable_rpdo(1, bench.now)
    bench.node.remove_pdo(Direction.TPDO, 1)
    bench.node.remove_pdo(Direction.RPDO, 1)
    bench.node.remove_pdo(Direction.RPDO, 1)  # none: ignored
    bench.tell("185#0100")
    bench.sync.send(bench.now)
    assert bench.take() == ["080#"]
    assert bench.node.values.store[INPUT_KEY] == 0
    assert bench.tell("705#05") == []  # nothing wanted is left over


@pytest.mark.parametrize("number", [None, 0, 513, -1])
def test_pdo_numbers(number: int | None) -> None:
    bench = MasterBench()
    with pytest.raises(LocalProtocolError, match=r"give one|1\.\.512"):
        bench.node.add_pdo(bench.node.dictionary.pdo("anywhere"), bench.now, number=number)
    with pytest.raises(LocalProtocolError, match=r"no RPDO 7 that we send"):
        bench.node.enable_rpdo(7, bench.now)
    assert not bench.node.tpdos


def test_a_can_id_of_more_than_11_bits_needs_the_frame_bit() -> None:
    bench = MasterBench()
    with pytest.raises(LocalProtocolError, match="0x800 has more than 11 bits"):
        bench.node.add_rpdo(1, 0x800, Mapping())
    with pytest.raises(LocalProtocolError, match="0x800 has more than 11 bits"):
        bench.node.add_tpdo(1, 0x800, Mapping(), bench.now)
    bench.node.add_tpdo(1, 0x800 | KEY_EXTENDED, Mapping.from_description(bench.node.dictionary.pdo("inputs")), bench.now)
    bench.tell("00000800#0700")
    assert bench.node.values.store[INPUT_KEY] == 7


def test_a_value_that_no_pdo_can_carry_is_reported_and_does_not_raise() -> None:
    bench = MasterBench().operational()
    bench.node.add_pdo(bench.node.dictionary.pdo("outputs"), bench.now)
    bench.node.enable_rpdo(1, bench.now)
    bench.output = 1 << 20
    bench.sync.send(bench.now)
    assert bench.take() == ["080#"]
    assert [(event.node_id, event.number) for event in bench.seen(PdoNotSent)] == [(5, 1)]
