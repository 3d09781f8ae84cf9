"""Chapter 8, storing, restoring, restricted CAN-IDs: a sound device passes, and one with a fault planted does not."""

from __future__ import annotations

import pytest

from canopen_check import storing_cases
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.verdict import Result
from tests.check.conformance_rig import Fault, check_caught, refused, verdict_of
from tests.check.faulty_nodes import KeepsNothing, LoadsAtOnce, RestoresNothing, StoresUnsigned
from tests.core.full_device import full_device

SAVE, LOAD = "73617665", "6C6F6164"
ANY_SIGNATURE = Fault("any signature", heard=[("605#231010(..)77726F6E", rf"605#231010\g<1>{SAVE}"),
                                              ("605#231110(..)77726F6E", rf"605#231110\g<1>{LOAD}")])  # fmt: skip
ANOTHER_CODE = Fault("another code", sent=[(r"(585#801[01]10..).{8}", refused(AbortCode.NO_SUCH_OBJECT))])
REFUSES_SAVE = Fault("refuses to save", heard=[(f"605#231010(..){SAVE}", r"605#231010\g<1>00000000")])
REFUSES_LOAD = Fault("refuses to load", heard=[(f"605#231110(..){LOAD}", r"605#231110\g<1>00000000")])
KEEPS = Fault("keeps nothing", node=KeepsNothing)
RESTORES = Fault("restores nothing", node=RestoresNothing)

FAULTS = [
    *[(number, ANY_SIGNATURE, "a wrong signature to .* was not refused") for number in ("8.1", "8.3", "8.5", "8.7")],
    *[(number, ANOTHER_CODE, "0x06020000") for number in ("8.1", "8.3", "8.5", "8.7")],
    *[(number, KEEPS, "saved by 0x1010:0., after a reset") for number in ("8.2", "8.6")],
    *[(number, REFUSES_SAVE, "saving by 0x1010:0. was refused with 0x08000020") for number in ("8.2", "8.6", "8.9")],
    *[(number, RESTORES, "restored by 0x1011:0., guard_time .* is 55 01, not 00 00") for number in ("8.4", "8.8")],
    *[(number, REFUSES_LOAD, "loading by 0x1011:0. was refused with 0x08000020") for number in ("8.4", "8.8")],
    *[
        (number, Fault("stores all the same", node=StoresUnsigned, strict=True), "was refused, and has stored guard_time")
        for number in ("8.1", "8.5")
    ],
    *[
        (number, Fault("loads at once", node=LoadsAtOnce, strict=True), "has changed guard_time .* at once")
        for number in ("8.4", "8.8")
    ],
    ("8.9", KEEPS, "saved, after a reset"),
    ("8.10", Fault("takes any for SYNC", sent=[("585#80051000.*", "585#6005100000000000")]), "0x000 in cob_id_sync .* was not"),
    ("8.10", Fault("takes any for EMCY", sent=[("585#80141000.*", "585#6014100000000000")]), "0x000 in cob_id_emergency"),
    ("8.10", Fault("takes any for RPDO 2", sent=[("585#80011401.*", "585#6001140100000000")]), "0x000 in rpdo2_"),
    ("8.10", Fault("takes it all the same", sent=[("585#43051000.*", "585#4305100001000000")]), "after refused writes"),
]
NUMBERS = [case.number for case in storing_cases.CASES]


@pytest.mark.thorough(3)
@pytest.mark.parametrize(("number", "fault", "said"), FAULTS, ids=[f"{number}-{fault.what}" for number, fault, _ in FAULTS])
def test_fault(number: str, fault: Fault, said: str) -> None:
    check_caught(number, fault, said=said)


def test_each_case_has_a_fault() -> None:
    assert set(NUMBERS) == {number for number, _, _ in FAULTS}


def unable(*subindices: int) -> ObjectDictionary:
    return full_device(*(standard_object(index, highest=3, defaults=dict.fromkeys(subindices, 0)) for index in (0x1010, 0x1011)))


@pytest.mark.thorough(3)
@pytest.mark.parametrize("number", [number for number in NUMBERS if number != "8.10"])
def test_device_that_does_not_store(number: str) -> None:
    assert verdict_of(number, truth=full_device(without=(0x1010, 0x1011))).result is Result.NOT_APPLICABLE
    assert verdict_of(number, truth=unable(1, 2)).result is Result.NOT_APPLICABLE
    all_at_once = full_device(*(standard_object(index, highest=1) for index in (0x1010, 0x1011)))
    expected = Result.NOT_APPLICABLE if number in ("8.5", "8.6", "8.7", "8.8") else Result.PASSED
    assert verdict_of(number, truth=all_at_once).result is expected


def read_only(index: int) -> Object:
    return Object.of(f"fixed_{index:04X}", [Variable(index, 0, f"fixed_{index:04X}", DataType.UNSIGNED32, Access.RO)])


FIXED = full_device(
    *(read_only(index) for index in (0x1005, 0x1012, 0x1014)),
    without=(0x100C, 0x1015, 0x1017, 0x1201, 0x1202, *range(0x1400, 0x1C00)),
)


@pytest.mark.parametrize("number", ["8.2", "8.4", "8.6", "8.8", "8.10"])
def test_device_without_anything_to_set(number: str) -> None:
    assert verdict_of(number, truth=FIXED).result is Result.NOT_APPLICABLE
