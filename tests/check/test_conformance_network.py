"""Chapters 6 and 7.1xx, SYNC and heartbeat: a sound device passes, and one with a fault planted does not."""

from __future__ import annotations

import pytest

from canopen_check import heartbeat_cases, sync_cases
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.verdict import Result
from tests.check.conformance_rig import Fault, check_caught, verdict_of
from tests.check.faulty_nodes import KeepsAll, KeepsNothing
from tests.core.full_device import full_device

NO_PRODUCER = Fault("no producer", sent=[("585#60051000.*", "585#8005100030000906")])
DEAF = Fault("deaf to heartbeats", heard=[("70[1-46-9]#05", None)])
SHORT = Fault("impatient", heard=[("605#231610(..)F401(....)", r"605#231610\g<1>6400\2")])

FAULTS = [
    ("6.1", Fault("another CAN-ID", dictionary=full_device(standard_object(0x1005, 0x81))), "after a reset"),
    ("6.2", Fault("twice", sent=[("080#", "080# 080#")]), "came 200 times in 10 s, one each 49.7 ms; the period is 100 ms . 10%"),
    ("6.2", Fault("never", sent=[("080#", None)]), "SYNC came 0 times in 10 s; the period"),
    ("6.3", Fault("never", sent=[("285#....", None)]), "TPDO 2 of type 10 after 100 SYNCs is 0"),
    ("6.3", Fault("each time", heard=[("605#2F0018020A000000", "605#2F00180201000000")]), "TPDO 1 .* after 100 SYNCs is 100"),
    ("6.4", Fault("goes on", heard=[("605#2306100000000000", "605#23061000A0860100")]), "0x1006 is 0, and a SYNC"),
    ("6.4", Fault("stays producer", heard=[("605#2305100080000000", "605#2305100080000040")]), "is a consumer, and a SYNC"),
    ("6.5", Fault("takes 1", sent=[("585#80191000.*", "585#6019100000000000")]), "writing 1 to 0x1019:00 was not refused"),
    ("6.5", Fault("another code", sent=[("585#80191000.*", "585#8019100022000008")]), "0x08000022"),
    ("6.5", Fault("keeps 1", sent=[("585#4F191000.*", "585#4F19100001000000")]), "after the refusal of 1"),
    ("6.6", Fault("counts", sent=[("080#", "080#01")]), "without counter"),
    ("6.6", Fault("never", sent=[("080#", None)]), "no SYNC came"),
    ("6.7", Fault("counts to 6", sent=[("080#05", "080#06")]), "counter of SYNC 5 is 06, not 05"),
    ("6.7", Fault("never", sent=[("080#..", None)]), "a SYNC did not come"),
    ("6.9", Fault("takes it", sent=[("585#80191000.*", "585#6019100000000000")]), "was not refused"),
    ("6.8", Fault("keeps nothing", node=KeepsNothing), "0x1019:00 is 0"),
    ("6.8", Fault("counts to 6", sent=[("080#05", "080#06")]), "counter of SYNC 5"),
    ("6.10", Fault("keeps nothing", node=KeepsNothing), "saved, after a reset"),
    ("6.10", Fault("never", sent=[("080#..", None)]), "0 SYNCs came"),
    ("6.10", Fault("no counter", sent=[("080#..", "080#")]), "have no counter"),
    ("7.101", Fault("forgets", sent=[("585#4B17100064000000", "585#4B17100063000000")]), "is 99 "),
    ("7.101", Fault("narrow", sent=[("585#4B171000FFFF0000", "585#4B171000FF7F0000")], strict=True), "is 32767 "),
    ("7.102", Fault("never", sent=[("705#7F", None)]), "the heartbeat came 0 times in 10 s; the period is 100 ms"),
    ("7.102", Fault("another state", sent=[("705#7F", "705#05")]), "in pre-operational"),
    ("7.103", Fault("goes on", heard=[("605#2B17100000000000", "605#2B17100064000000")]), "the heartbeat time is 0"),
    ("7.103", Fault("never", sent=[("705#7F", None)]), "a heartbeat did not come"),
    ("7.104", Fault("takes it twice", sent=[("585#80161002.*", "585#6016100200000000")]), "twice was not refused"),
    ("7.105", SHORT, "came each 250 ms, the consumer time is 500 ms, and an emergency message came too: 085#3081"),
    ("7.106", DEAF, "lost heartbeat of node 1 did not come"),
    ("7.106", SHORT, "reported after 100 ms; the time is 500 ms"),
    ("7.106", Fault("another code", sent=[("085#3081(.*)", r"085#2081\1")]), "error code"),
    ("7.106", Fault("hasty", sent=[("(585#60161002.*)", r"\1 085#3081110200000000")]), "node 2 was not heard yet"),
    ("7.107", Fault("keeps all", node=KeepsAll), "nobody is monitored after a reset"),
    ("7.107", DEAF, "lost heartbeat of node 1 did not come"),
    ("7.107", Fault("no heartbeat", sent=[("705#7F", None)]), "own heartbeat did not come"),
]  # fmt: skip
CASES = [case for case in (*sync_cases.CASES, *heartbeat_cases.CASES) if case.body is not None]


@pytest.mark.thorough(5)
@pytest.mark.parametrize(("number", "fault", "said"), FAULTS, ids=[f"{number}-{fault.what}" for number, fault, _ in FAULTS])
def test_fault(number: str, fault: Fault, said: str) -> None:
    check_caught(number, fault, said=said)


def test_each_case_has_a_fault() -> None:
    assert {case.number for case in CASES} == {number for number, _, _ in FAULTS}


@pytest.mark.parametrize("number", [case.number for case in CASES])
def test_not_applicable(number: str) -> None:
    bare = full_device(without=(0x1005, 0x1006, 0x1016, 0x1017, 0x1019))
    assert verdict_of(number, truth=bare).result is Result.NOT_APPLICABLE


@pytest.mark.parametrize("number", ["6.2", "6.4", "6.6", "6.7", "6.10"])
def test_device_that_is_no_sync_producer(number: str) -> None:
    assert verdict_of(number, NO_PRODUCER).result is Result.NOT_APPLICABLE


def test_cyclic_types_that_are_not_supported() -> None:
    few = Fault("few types", sent=[("585#60001802.*", "585#8000180230000906")])
    assert "transmission type 10" in verdict_of("6.3", few).reason


def test_default_can_id_of_sync() -> None:
    assert "the default CAN-ID of SYNC is 129" in verdict_of("6.1", truth=full_device(standard_object(0x1005, 0x81))).reason


def test_device_that_monitors_one_node() -> None:
    truth = full_device(standard_object(0x1016, highest=1))
    assert verdict_of("7.104", truth=truth).reason == "the device monitors one node only"


def test_monitoring_by_default() -> None:
    truth = full_device(standard_object(0x1016, highest=2, defaults={1: 0x0010_0400}))
    assert verdict_of("7.107", truth=truth).result is Result.PASSED
