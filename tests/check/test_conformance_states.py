"""Chapters 7.1, 7.2, 9 and 10, guarding and NMT: a sound device passes, and one with a fault planted does not."""

from __future__ import annotations

import pytest

from canopen_check import guarding_cases, state_cases
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.verdict import Result
from tests.check.conformance_rig import Fault, check_caught, verdict_of
from tests.check.faulty_nodes import (
    AlwaysGuarded,
    EagerPdos,
    GuardedAtOnce,
    HearsInStopped,
    HearsInvalid,
    KeepsAll,
    KeepsToggle,
    NeverTakes,
    RatherGuarded,
    SelfStarting,
    SendsInvalid,
    TakesAtOnce,
    Talkative,
    with_pdos,
)
from tests.core.full_device import full_device

DEAF = Fault("deaf to requests", heard=[("705#R1", None)])

FAULTS = [
    ("7.1", Fault("another default", dictionary=full_device(standard_object(0x100D, 3))), "0x100D:00 is 3"),
    ("7.2", DEAF, "answer to a guarding request did not come"),
    ("7.2", Fault("another state", sent=[("705#7F", "705#05")]), "NMT state in a guarding answer is 5"),
    ("7.2", Fault("two bytes", sent=[("705#7F", "705#7F00")]), "length of a guarding answer"),
    ("7.3", Fault("never toggles", sent=[("705#FF", "705#7F")]), "toggle bit in five"),
    ("7.3", Fault("begins with 1", sent=[("705#FF", "705#7F"), ("705#7F", "705#FF")]), "toggle bit in five"),
    ("7.3", Fault("keeps the toggle bit", node=KeepsToggle, strict=True), "toggle bit in five"),
    ("7.4", Fault("answers for node 6", heard=[("706#R1", "705#R1")]), "node 6 was answered"),
    ("7.5", Fault("forgets", sent=[("585#4B0C100064000000", "585#4B0C100063000000")]), "0x100C:00 is 99"),
    ("7.5", Fault("narrow", sent=[("585#4B0C1000FFFF0000", "585#4B0C1000FF7F0000")], strict=True), "0x100C:00 is 32767"),
    ("7.6", Fault("does not care", sent=[("085#3081.*", None)]), "end of guarding did not come"),
    ("7.6", Fault("impatient", heard=[("605#2F0D100003000000", "605#2F0D100002000000")]), "after 200 ms; the time is 300 ms"),
    ("7.6", Fault("very impatient", heard=[("605#2B0C100064000000", "605#2B0C100014000000")]),
     "asked each 100 ms, its life time is 300 ms"),
    ("7.6", Fault("another code", sent=[("085#3081(.*)", r"085#2081\1")]), "error code of life guarding"),
    ("7.6", Fault("guarded at once", node=GuardedAtOnce, strict=True), "was not asked yet, and an emergency"),
    ("7.201", Fault("both", dictionary=full_device(standard_object(0x1017, 100))), "0x1017:00 is 100"),
    ("7.202", Fault("goes on", heard=[("605#2B17100000000000", "605#2B17100064000000")]), "the heartbeat is off"),
    ("7.203", DEAF, "did not come"),
    ("7.204", Fault("no heartbeat", sent=[("705#7F", None)]), "came 0 times in 1 s; the period is 100 ms"),
    ("7.205", Fault("always guarded", node=AlwaysGuarded), "came 20 times"),
    ("7.206", Fault("rather guarded", node=RatherGuarded), "came . times"),
    ("7.206", Fault("a guarding answer", sent=[("705#7F", "705#FF")]), "data of a heartbeat"),
    ("7.206", Fault("misses the requests", sent=[("(705#7F)", r"\1 085#3081110000000000")]), "though there is a heartbeat"),
    ("7.207", Fault("always guarded", node=AlwaysGuarded), "came 20 times"),
    ("9.1", Fault("keeps all", node=KeepsAll), "is 55 01"),
    ("9.1", Fault("two boot-ups", sent=[("705#00", "705#00 705#00")]), "more than one boot-up"),
    ("9.1", Fault("no boot-up", sent=[("705#00", None)]), "boot-up frame did not come"),
    ("9.1", Fault("a boot-up of two bytes", sent=[("705#00", "705#0000")]), "did not come within 5 s, only 705#0000"),
    ("9.2", Fault("starts by itself", node=SelfStarting, strict=True), "after boot-up, the device is OPERATIONAL"),
    ("9.2", Fault("PDOs", node=EagerPdos), "TPDO 1 came"),
    ("9.2", Fault("RPDOs", node=EagerPdos, sent=[("185#.*", None)]), "RPDO 1 was processed"),
    ("9.2", Fault("no SDO", sent=[("585#43001000.*", None)]), "answer to an SDO request did not come"),
    ("9.2", Fault("obeys others", heard=[("000#0106", "000#0105")]), "commands for node 6, which are not for it"),
    *[("9.2", Fault(f"obeys node {node_id}", heard=[(f"000#(..){node_id:02X}", r"000#\g<1>05")]),
      f"reset of node {node_id} has reset")
      for node_id in (6, 4, 0x85)],
    ("9.3", Fault("does not start", heard=[("000#0105", None)]), "started, the device is PRE_OPERATIONAL"),
    ("9.3", Fault("no TPDO", sent=[("185#.*", None)]), "TPDO 1 came 0 times"),
    ("9.3", Fault("no RPDO", heard=[("205#.*", None)]), "RPDO 1 was not processed"),
    ("9.3", Fault("big-endian", heard=[("205#(..)(..)", r"205#\2\1")], strict=True), "is 00 01 after RPDO 1 with 01 00"),
    ("9.3", Fault("hears PDOs not valid", node=with_pdos(HearsInvalid), strict=True),
     "RPDO 1 was processed though it is not valid"),
    ("9.3", Fault("sends PDOs not valid", node=with_pdos(SendsInvalid), strict=True),
     "TPDO 1 came 10 times though it is not valid"),
    ("9.3", Fault("does not wait for SYNC", node=with_pdos(TakesAtOnce), strict=True), "RPDO 1 was processed before SYNC"),
    ("9.3", Fault("no synchronous RPDO", node=with_pdos(NeverTakes), strict=True), "RPDO 1 was not processed at SYNC"),
    ("9.3", Fault("strange state", sent=[("705#05", "705#06")]), "shows no NMT state"),
    ("9.4", Fault("does not stop", heard=[("000#0205", None)]), "stopped, the device is PRE_OPERATIONAL"),
    ("9.4", Fault("talkative", node=Talkative), "more than is due to an SDO request: 585#"),
    ("9.4", Fault("hears PDOs", node=HearsInStopped, strict=True), "RPDO 1 was processed in Stopped"),
    ("9.4", Fault("tells errors", sent=[("705#04", "705#04 085#1082110000000000")], strict=True),
     "emergency message .* came in Stopped"),
    ("9.4", Fault("PDOs", node=EagerPdos), "TPDO 1 came"),
    ("9.4", Fault("obeys anything", heard=[("000#0305", "000#0105")]), "commands that are not for it"),
    ("10.1", Fault("no reset communication", heard=[("000#8205", None)]), "boot-up frame did not come"),
    ("10.1", Fault("deaf to all", heard=[("000#8100", None)]), "boot-up frame did not come"),
    ("10.1", Fault("starts by itself", node=SelfStarting, strict=True), "the device is OPERATIONAL"),
    ("10.2", Fault("deaf to all", heard=[("000#8000", None)]), "ENTER_PRE_OPERATIONAL from OPERATIONAL, sent to 0"),
    ("10.3", Fault("deaf to all", heard=[("000#0100", None)]), "START from PRE_OPERATIONAL, sent to 0"),
    ("10.4", Fault("deaf to all", heard=[("000#0200", None)]), "STOP from PRE_OPERATIONAL, sent to 0"),
]  # fmt: skip
CASES = (*guarding_cases.CASES, *state_cases.CASES)


@pytest.mark.thorough(3)
@pytest.mark.parametrize(("number", "fault", "said"), FAULTS, ids=[f"{number}-{fault.what}" for number, fault, _ in FAULTS])
def test_fault(number: str, fault: Fault, said: str) -> None:
    check_caught(number, fault, said=said)


def test_each_case_has_a_fault() -> None:
    assert {case.number for case in CASES} == {number for number, _, _ in FAULTS}


NO_ERROR_CONTROL = full_device(without=(0x100C, 0x100D, 0x1017))
STATES = [case.number for case in state_cases.CASES if case.number != "9.1"]


@pytest.mark.parametrize("number", [*(case.number for case in guarding_cases.CASES), *STATES])
def test_device_without_error_control(number: str) -> None:
    assert verdict_of(number, truth=NO_ERROR_CONTROL).result is Result.NOT_APPLICABLE


@pytest.mark.parametrize("number", [*(case.number for case in guarding_cases.CASES if len(case.number) == 3), *STATES])
def test_device_with_guarding_only(number: str) -> None:
    guarded = full_device(without=(0x1017,))
    assert verdict_of(number, truth=guarded).result is Result.PASSED
    assert verdict_of(number, DEAF, guarded).result is (Result.PASSED if number in ("7.1", "7.5") else Result.FAILED)


@pytest.mark.parametrize("number", STATES)
def test_states_of_a_device_without_pdos(number: str) -> None:
    bare = full_device(without=tuple(range(0x1400, 0x1C00)))
    assert verdict_of(number, truth=bare).result is Result.PASSED


def test_both_kinds_by_default() -> None:
    truth = full_device(standard_object(0x1017, 100), standard_object(0x100C, 100), standard_object(0x100D, 3))
    assert "both heartbeat and guarding are in use" in verdict_of("7.201", truth=truth).reason


def test_heartbeat_by_default() -> None:
    truth = full_device(standard_object(0x1017, 20))
    for number in ("9.1", "10.1", "7.203"):
        assert verdict_of(number, truth=truth).result is Result.PASSED
