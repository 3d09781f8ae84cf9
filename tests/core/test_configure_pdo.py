"""Setting a device's PDO up anew: the order of the steps, and what is left when a step fails or the procedure is cancelled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Access, Direction, Object, ObjectDictionary, PdoDescription, Variable
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outbox, Outcome, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand
from canopen_proto.pdo.configure import InvalidPdoError, PdoRefusedError, configure_pdo, define_pdo, read_pdo, use_device_pdo
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.procedures.objects import UnexpectedLengthError
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Procedure, SdoTransferError
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.server import PENDING, Pending
from tests.core.bus import Bus
from tests.core.devices import INPUT, LIMITED, OUTPUT, io_device

NEW = PdoSettings(1, Direction.RPDO, 0x00000215, 1, (0x20020008, 0x00050008))
OLD = PdoSettings(1, Direction.RPDO, 0x00000205, 255, (0x20010010,))

IN_ORDER = [
    "605#2300140105020080",  # destroy: 0x1400:01 with bit 31, the CAN-ID as it is
    "605#2F00160000000000",  # no mapping
    "605#2300160108000220",  # its entries
    "605#2300160208000500",
    "605#2F00160002000000",  # their number
    "605#2F00140201000000",  # transmission type
    "605#2300140115020000",  # create
]
BACK = [
    "605#2300140105020080",
    "605#2F00160000000000",
    "605#2300160110000120",
    "605#2F00160001000000",
    "605#2F001402FF000000",
    "605#2300140105020000",
]


class Device(LocalNode):
    """An I/O device that can be told how to take each write of a PDO parameter, by its count from 1 on."""

    def __init__(self, out: Outbox, node_id: int, dictionary: ObjectDictionary) -> None:
        super().__init__(out, node_id, dictionary)
        self.writes = 0
        self.refuse: Callable[[int], AbortCode | None] = lambda count: None
        self.forget_to_answer: Callable[[int], bool] = lambda count: False

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        self.writes += 1
        refusal = self.refuse(self.writes)
        if refusal is not None:
            return refusal
        if index in (0x1400, 0x1800) and subindex == 1:
            standing, wanted = self.values.store[index << 8 | 1], int.from_bytes(data, "little")
            assert isinstance(standing, int)
            if not standing & COB_ID_INVALID and (standing ^ wanted) & 0x7FF:
                return AbortCode.DEVICE_STATE  # a strict one: also in the step that destroys
        result = super().write(index, subindex, data, now)
        return PENDING if self.forget_to_answer(self.writes) else result


class Bench:
    """A master and such a device on a bus in virtual time."""

    def __init__(self, dictionary: ObjectDictionary | None = None) -> None:
        self.bus = Bus()
        dictionary = io_device() if dictionary is None else dictionary
        self.master = self.bus.attach(Network())
        self.remote = RemoteNode(self.master.out, 5, dictionary)
        self.master.attach(self.remote)
        network = self.bus.attach(Network())
        self.device = Device(network.out, 5, dictionary)
        network.attach(self.device)
        self.device.boot(0)
        self.bus.run(SECOND)
        self.bus.sent.clear()
        self.bus.events.clear()

    def start(self, procedure: Procedure[Any]) -> int:
        return self.master.run(procedure, self.bus.now)

    def outcome(self) -> Outcome:
        kinds = (ProcedureFinished, ProcedureFailed, ProcedureCancelled)
        self.bus.run_until(lambda: any(isinstance(each, kinds) for each in self.bus.events))
        (outcome,) = [each for each in self.bus.events if isinstance(each, kinds)]
        self.bus.settle()
        return outcome

    def result(self, procedure: Procedure[Any]) -> Any:
        self.start(procedure)
        outcome = self.outcome()
        assert isinstance(outcome, ProcedureFinished), outcome
        return outcome.result

    def error(self, procedure: Procedure[Any]) -> Exception:
        self.start(procedure)
        outcome = self.outcome()
        assert isinstance(outcome, ProcedureFailed), outcome
        return outcome.error

    def downloads(self) -> list[str]:
        return [frame for frame in self.bus.trace() if frame.startswith("605#2")]

    def parameters(self) -> dict[int, Value]:
        """What stands in the device of RPDO 1, as far as it counts."""
        store = self.device.values.store
        count = store[0x160000]
        assert isinstance(count, int)
        return {mux: store[mux] for mux in (0x140001, 0x140002, *range(0x160000, 0x160001 + count))}


def standing(settings: PdoSettings) -> dict[int, Value]:
    mapping = {0x160000 + subindex: entry for subindex, entry in enumerate(settings.entries, start=1)}
    return {0x140001: settings.cob_id, 0x140002: settings.transmission_type, 0x160000: len(settings.entries), **mapping}


# ---- the good case ----


def test_the_steps_are_in_the_standards_order_and_the_old_settings_come_back() -> None:
    bench = Bench()
    assert bench.result(configure_pdo(bench.remote, NEW)) == OLD
    assert bench.downloads() == IN_ORDER
    assert bench.parameters() == standing(NEW)
    bench.device.execute(NmtCommand.START, bench.bus.now)
    bench.bus.send("215#0C00")
    bench.bus.send("080#")
    bench.bus.settle()
    assert bench.device.values.store[LIMITED << 8] == 12


def test_an_old_pdo_that_was_not_valid() -> None:
    bench = Bench()
    bench.result(configure_pdo(bench.remote, PdoSettings(1, Direction.RPDO, 0x80000000, 255, ())))
    bench.bus.events.clear()
    before = bench.result(configure_pdo(bench.remote, NEW))
    assert before == PdoSettings(1, Direction.RPDO, 0x80000000, 255, ())
    assert bench.parameters() == standing(NEW)


def test_define_pdo_sets_up_both_sides() -> None:
    bench = Bench()
    device = bench.remote.dictionary
    outputs = PdoDescription("out", 0x200, Direction.RPDO, 1, (device.variable(LIMITED), device.variable(OUTPUT)))
    inputs = PdoDescription("in", 0x380, Direction.TPDO, None, (device.variable(INPUT),))
    bench.result(define_pdo(bench.remote, outputs))
    bench.bus.events.clear()
    bench.result(define_pdo(bench.remote, inputs, number=2, transmission_type=255))
    assert bench.device.values.store[0x180101] == 0x40000385  # no remote requests
    assert set(bench.remote.rpdos) == {1}
    assert set(bench.remote.tpdos) == {2}

    bench.device.execute(NmtCommand.START, bench.bus.now)
    bench.remote.on_nmt_command(NmtCommand.START, bench.bus.now)
    bench.remote.values.store[OUTPUT << 8] = -3
    bench.remote.enable_rpdo(1, bench.bus.now)
    bench.remote.rpdos[1].send(bench.bus.now)
    bench.bus.settle()
    bench.bus.send("080#")
    bench.bus.settle()
    assert bench.device.values.store[OUTPUT << 8] == -3
    bench.device.set_value(INPUT, 0, 9, bench.bus.now)
    bench.bus.settle()
    assert bench.remote.values.store[INPUT << 8] == 9


def test_a_description_without_a_number_needs_one() -> None:
    bench = Bench()
    description = PdoDescription("in", 0x790, Direction.TPDO, None, (bench.remote.dictionary.variable(INPUT),))
    error = bench.error(define_pdo(bench.remote, description))
    assert isinstance(error, LocalProtocolError)
    assert bench.bus.trace() == []


def test_use_device_pdo_takes_what_stands_there() -> None:
    bench = Bench()
    mapping = bench.result(use_device_pdo(bench.remote, Direction.TPDO, 1))
    assert mapping.parameters == (0x20000010,)
    bench.bus.events.clear()
    bench.result(use_device_pdo(bench.remote, Direction.RPDO, 2))
    assert bench.remote.tpdos[1].key == 0x185
    assert (bench.remote.rpdos[2].key, bench.remote.rpdos[2].transmission_type) == (0x305, 1)
    assert bench.downloads() == []


def test_use_device_pdo_of_one_that_is_not_valid_or_empty() -> None:
    bench = Bench()
    not_valid = PdoSettings(1, Direction.RPDO, 0x80000205, 255, (0x20010010,))
    empty = PdoSettings(2, Direction.RPDO, 0x305, 1, ())
    for settings in (not_valid, empty):
        bench.result(configure_pdo(bench.remote, settings))
        bench.bus.events.clear()
        assert bench.result(use_device_pdo(bench.remote, Direction.RPDO, settings.number)) is None
        bench.bus.events.clear()
    assert bench.remote.rpdos == {}


def test_use_device_pdo_that_maps_what_our_dictionary_lacks() -> None:
    bench = Bench()
    ours = ObjectDictionary(each for index, each in io_device().objects.items() if index != OUTPUT)
    remote = RemoteNode(bench.master.out, 5, ours)
    bench.master.detach(bench.remote)
    bench.master.attach(remote)
    error = bench.error(use_device_pdo(remote, Direction.RPDO, 1))
    assert isinstance(error, InvalidPdoError)
    assert "0x2001:00 is not in the dictionary" in str(error)


# ---- refused ----


@pytest.mark.parametrize("step", range(1, len(IN_ORDER) + 1))
def test_a_refusal_at_any_step_puts_the_old_settings_back(step: int) -> None:
    bench = Bench()
    bench.device.refuse = lambda count: AbortCode.LOCAL_CONTROL if count == step else None
    error = bench.error(configure_pdo(bench.remote, NEW))
    assert isinstance(error, PdoRefusedError)
    assert (error.step, error.restored) == (step, True)
    assert f"RPDO 1 of node 5 could not be set up: step {step} of 7 (0x" in str(error)
    assert "abort 0x08000021" in str(error)
    assert str(error).endswith("it has its old settings")
    assert bench.parameters() == standing(OLD)
    assert bench.downloads()[:step] == IN_ORDER[:step]
    put_back = bench.downloads()[step:]
    if step == 1:
        assert put_back == []  # nothing had changed
    else:
        assert put_back[1:] == BACK[1:]
    bench.device.execute(NmtCommand.START, bench.bus.now)
    bench.bus.send("205#0700")
    bench.bus.settle()
    assert bench.device.values.store[OUTPUT << 8] == 7


@pytest.mark.parametrize("step", range(1, len(IN_ORDER) + 1))
def test_a_step_that_was_executed_but_not_answered_is_undone_too(step: int) -> None:
    bench = Bench()
    bench.device.forget_to_answer = lambda count: count == step
    error = bench.error(configure_pdo(bench.remote, NEW))
    assert isinstance(error, PdoRefusedError)
    assert (error.step, error.restored) == (step, True)
    assert "did not answer" in str(error)
    assert bench.parameters() == standing(OLD)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("step", range(2, len(IN_ORDER) + 1))
@pytest.mark.parametrize("later", range(1, len(BACK) + 1))
def test_where_the_old_settings_can_not_be_put_back_it_is_told_and_the_pdo_is_not_valid(step: int, later: int) -> None:
    bench = Bench()
    bench.device.refuse = lambda count: AbortCode.HARDWARE_ERROR if count in (step, step + later) else None
    error = bench.error(configure_pdo(bench.remote, NEW))
    assert isinstance(error, PdoRefusedError)
    assert (error.step, error.restored) == (step, False)
    assert "and its old settings could not be put back: node 5 refused writing" in str(error)
    cob_id = bench.device.values.store[0x140001]
    assert isinstance(cob_id, int)
    assert cob_id & COB_ID_INVALID


def test_a_device_that_falls_silent_is_told_of() -> None:
    bench = Bench()
    bench.start(configure_pdo(bench.remote, NEW))
    bench.bus.run_until(lambda: len(bench.downloads()) == 3)
    bench.bus.detach(bench.bus.machines[1])
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureFailed)
    assert isinstance(outcome.error, PdoRefusedError)
    assert not outcome.error.restored


def test_a_mapping_that_the_device_refuses_by_its_rules() -> None:
    bench = Bench()
    error = bench.error(configure_pdo(bench.remote, PdoSettings(1, Direction.RPDO, 0x205, 255, (0x20000010,))))  # an input
    assert isinstance(error, PdoRefusedError)
    assert "step 3 of 6 (0x1600:01 = 0x20000010)" in str(error)
    assert "abort 0x06040041" in str(error)
    assert bench.parameters() == standing(OLD)


def test_a_full_queue_is_a_failed_step() -> None:
    bench = Bench()
    bench.start(configure_pdo(bench.remote, NEW))
    bench.bus.run_until(lambda: len(bench.downloads()) == 3)
    while bench.remote.sdo.waiting < bench.remote.sdo.max_queue:
        bench.remote.read(INPUT, bench.bus.now)
    bench.remote.sdo.max_queue = 0
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureFailed)
    assert isinstance(outcome.error, PdoRefusedError)
    assert not outcome.error.restored
    assert "requests are waiting already" in str(outcome.error)


def test_the_times_are_written_before_the_pdo_is_created_and_put_back() -> None:
    bench = Bench()
    wanted = PdoSettings(1, Direction.TPDO, 0x40000185, 255, (0x20000010,), inhibit_time=5 * MILLISECOND, event_time=SECOND)
    before = bench.result(configure_pdo(bench.remote, wanted))
    assert (before.inhibit_time, before.event_time) == (0, 0)
    assert bench.downloads()[-3:] == ["605#2B00180332000000", "605#2B001805E8030000", "605#2300180185010040"]
    bench.bus.events.clear()
    bench.device.writes = 0
    bench.device.refuse = lambda count: AbortCode.LOCAL_CONTROL if count == 8 else None  # the last one: its times are written
    error = bench.error(configure_pdo(bench.remote, replace(wanted, inhibit_time=0, event_time=0)))
    assert isinstance(error, PdoRefusedError)
    assert (error.step, error.restored) == (8, True)
    assert (bench.device.values.store[0x180003], bench.device.values.store[0x180005]) == (50, 1000)


# ---- what the device has now can not be read, or makes no sense: nothing is written ----


def with_variable(index: int, subindex: int, data_type: DataType, default: Value) -> ObjectDictionary:
    dictionary = io_device()
    found = dictionary.objects[index]
    variables = {**found.variables, subindex: Variable(index, subindex, "odd", data_type, Access.RW, default)}
    return dictionary.with_objects([Object.of(found.name, variables.values(), found.object_type)])


@pytest.mark.parametrize(
    ("dictionary", "text"),
    [
        (with_variable(0x1400, 1, DataType.UNSIGNED16, 0x205), "0x1400:01 came with 2 bytes, not 4"),
        (with_variable(0x1400, 2, DataType.UNSIGNED32, 0x100), "0x1400:02 came with 4 bytes, not 1"),
        (with_variable(0x1600, 0, DataType.UNSIGNED16, 1), "0x1600:00 came with 2 bytes, not 1"),
        (with_variable(0x1600, 0, DataType.OCTET_STRING, b""), "0x1600:00 came with 0 bytes, not 1"),
        (with_variable(0x1600, 1, DataType.UNSIGNED8, 1), "0x1600:01 came with 1 bytes, not 4"),
    ],
)
def test_a_length_that_is_not_the_objects(dictionary: ObjectDictionary, text: str) -> None:
    bench = Bench(dictionary)
    error = bench.error(configure_pdo(bench.remote, NEW))
    assert isinstance(error, UnexpectedLengthError)
    assert text in str(error)
    assert bench.downloads() == []


def test_more_entries_than_a_pdo_has_are_not_read() -> None:
    bench = Bench(with_variable(0x1600, 0, DataType.UNSIGNED8, 0xFE))  # an MPDO
    error = bench.error(configure_pdo(bench.remote, NEW))
    assert isinstance(error, InvalidPdoError)
    assert "a PDO of node 5 makes no sense: RPDO 1: 254 mapped objects; a PDO has 64 at most" in str(error)
    assert len(bench.bus.trace()) == 6
    assert bench.downloads() == []


def test_a_pdo_that_the_device_does_not_have() -> None:
    bench = Bench()
    error = bench.error(read_pdo(bench.remote, Direction.RPDO, 3))
    assert isinstance(error, SdoTransferError)
    assert error.abort_code == AbortCode.NO_SUCH_OBJECT


# ---- cancelled ----


@pytest.mark.parametrize("executed", [False, True])
@pytest.mark.parametrize("step", range(1, len(IN_ORDER) + 1))
def test_a_cancel_at_any_step_puts_the_old_settings_back(step: int, executed: bool) -> None:
    bench = Bench()
    bench.device.forget_to_answer = lambda count: executed and count == step
    request_id = bench.start(configure_pdo(bench.remote, NEW))
    bench.bus.run_until(lambda: len(bench.downloads()) == step)
    if executed:
        bench.bus.run_until(lambda: bench.device.writes == step)
    bench.master.cancel(request_id, bench.bus.now)
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureCancelled)
    assert outcome.clean_up_error is None
    assert bench.parameters() == standing(OLD)
    assert not bench.remote.sdo.busy


@pytest.mark.parametrize("uploads", range(1, 5))
def test_a_cancel_while_the_old_settings_are_read_writes_nothing(uploads: int) -> None:
    bench = Bench()
    request_id = bench.start(configure_pdo(bench.remote, NEW))
    bench.bus.run_until(lambda: len([frame for frame in bench.bus.trace() if frame.startswith("605#")]) == uploads)
    bench.master.cancel(request_id, bench.bus.now)
    assert isinstance(bench.outcome(), ProcedureCancelled)
    assert bench.downloads() == []


def test_where_a_cancel_can_not_put_the_old_settings_back_it_is_told() -> None:
    bench = Bench()
    bench.device.refuse = lambda count: AbortCode.HARDWARE_ERROR if count == 4 else None
    request_id = bench.start(configure_pdo(bench.remote, NEW))
    bench.bus.run_until(lambda: bench.device.writes == 3)
    bench.master.cancel(request_id, bench.bus.now)
    outcome = bench.outcome()
    assert isinstance(outcome, ProcedureCancelled)
    assert isinstance(outcome.clean_up_error, PdoRefusedError)
    assert "setting RPDO 1 of node 5 up was cancelled, and its old settings could not be put back" in str(outcome.clean_up_error)
    assert not outcome.clean_up_error.restored


def test_whoever_sets_up_a_pdo_beside_another_is_not_told_that_it_is_done() -> None:
    """Their downloads take turns on the wire: the device would have some entries of the one and some of the other."""
    bench = Bench()
    for settings in (NEW, replace(NEW, entries=(0x20020008,))):
        bench.start(configure_pdo(bench.remote, settings))
    bench.bus.settle()
    errors = [each.error for each in bench.bus.take_events(ProcedureFailed)]
    assert not bench.bus.take_events(ProcedureFinished)
    for error in errors:
        assert isinstance(error, PdoRefusedError)
        assert not error.restored
    assert [str(each) for each in errors] == [
        f"RPDO 1 of node 5 could not be set up: step {step}: somebody else of this program wrote this PDO at the same time; "
        "what it has now is not known"
        for step in ("1 of 6", "2 of 7")
    ]
    stored = bench.device.values.store[0x140001]
    assert isinstance(stored, int)
    assert stored & COB_ID_INVALID  # the device has it destroyed: nobody has made a mixture valid
