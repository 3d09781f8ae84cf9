"""A device with an application: what it is asked, and what it is told."""

from __future__ import annotations

from collections.abc import Iterable

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Machine, Outbox, Time
from tests.core.device_bench import (
    PRE_OPERATIONAL,
    RESET_COMMUNICATION,
    RESET_NODE,
    START,
    STOP,
    SYNC,
    DeviceBench,
)
from tests.core.devices import INPUT, LIMITED, OUTPUT, io_device

READ_INPUT = "605#4000200000000000"


class Recorder(Machine):
    """An application that writes down what it is told, and refuses 13."""

    def __init__(self, out: Outbox, node: LocalNode) -> None:
        super().__init__(out)
        self.node = node
        self.log: list[str] = []

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        return AbortCode.LOCAL_CONTROL if value == 13 else None

    def written(self, index: int, subindex: int, now: Time) -> None:
        self.log.append(f"written {index:04X}:{subindex:02X} = {self.node.values.store[index << 8 | subindex]!r}")

    def refresh(self, now: Time, index: int | None = None, subindex: int = 0) -> None:
        self.node.values.store[INPUT << 8] = now // MILLISECOND % 1000

    def on_sync(self, now: Time) -> None:
        self.log.append(f"sync, output {self.node.values.store[OUTPUT << 8]!r}")

    def connection_lost(self, now: Time, error_code: int) -> None:
        self.log.append(f"connection lost, {self.node.state.name}")

    def reset(self, now: Time) -> None:
        self.log.append("reset")

    def take(self) -> Iterable[str]:
        taken, self.log = self.log, []
        return taken


def with_application(dictionary: ObjectDictionary | None = None) -> tuple[DeviceBench, Recorder]:
    bench = DeviceBench(dictionary)
    recorder = Recorder(bench.node.inner, bench.node)
    bench.node.application = recorder
    return bench, recorder


def test_an_application_is_asked_before_a_value_is_stored_and_told_behind_it() -> None:
    bench, application = with_application()
    assert bench.write(LIMITED, 0, 12, 1) is None
    assert application.take() == ["written 2002:00 = 12"]
    assert bench.write(LIMITED, 0, 13, 1) == AbortCode.LOCAL_CONTROL
    assert bench.write(LIMITED, 0, 99, 1) == AbortCode.VALUE_TOO_HIGH  # not asked
    assert bench.number(LIMITED) == 12
    assert application.take() == []
    assert bench.write(0x1017, 0, 13, 2) is None  # the node's own


def test_an_application_hears_of_pdos_at_once_or_with_their_sync() -> None:
    bench, application = with_application()
    bench.tell(START, "205#0500")
    assert application.take() == ["written 2001:00 = 5"]
    bench.tell("305#0600")
    assert application.take() == []
    bench.tell(SYNC)
    assert application.take() == ["written 2001:00 = 6", "sync, output 6"]


def test_an_application_hears_of_multiplexed_pdos() -> None:
    own = [standard_object(0x1400, highest=2, defaults={1: 0x1C1}), standard_object(0x1600, highest=1, defaults={0: 0xFF})]
    bench, application = with_application(io_device().with_objects(own))
    bench.tell(START, "1C1#8501200005000000")
    assert application.take() == ["written 2001:00 = 5"]


def test_at_a_sync_tpdos_are_sampled_before_rpdos_are_taken() -> None:
    dictionary = io_device().with_objects([standard_object(0x1A01, highest=2, defaults={0: 1, 1: 0x20010010})])
    bench = DeviceBench(dictionary)
    assert bench.tell(START, "305#0600", SYNC, SYNC) == ["285#0000", "285#0600"]


def test_what_an_application_shows_is_up_to_date_wherever_it_is_read() -> None:
    bench, _ = with_application()
    bench.write(0x1800, 5, 30, 2)
    bench.tell(START)
    bench.wait(7)
    assert bench.number(INPUT) == 7
    assert bench.tell(SYNC) == ["285#0700"]
    assert bench.wait(30) == ["30 185#1E00"]  # by the event timer
    assert bench.wait(35) == ["60 185#3C00"]
    assert bench.tell("185#R2") == ["185#4800"]  # 72 ms: asked for


def test_an_application_hears_of_lost_connections_and_resets() -> None:
    bench, application = with_application()
    bench.tell(PRE_OPERATIONAL, STOP)
    assert application.take() == ["connection lost, STOPPED"]  # of a client that commands by SDO
    bench.tell(PRE_OPERATIONAL, START)
    assert application.take() == []
    bench.tell(STOP)
    assert application.take() == ["connection lost, STOPPED"]
    bench.tell(RESET_COMMUNICATION)
    assert application.take() == []
    bench.tell(RESET_COMMUNICATION)
    assert application.take() == ["connection lost, INITIALISING"]
    bench.tell(RESET_NODE)
    assert application.take() == ["connection lost, INITIALISING", "reset"]
    bench.tell(START, PRE_OPERATIONAL)
    assert application.take() == ["connection lost, PRE_OPERATIONAL"]
    bench.write(0x1016, 1, 9 << 16 | 100, 4)
    bench.write(0x1029, 1, 1, 1)
    bench.tell(START, "709#05")
    bench.wait(150)
    assert application.take() == ["connection lost, OPERATIONAL"]
