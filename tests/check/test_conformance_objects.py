"""Chapters 4 and 5, object dictionary and emergency: a sound device passes, and one with a fault planted does not."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest

from canopen_check import dictionary_cases, emergency_cases
from canopen_check.catalogue import BY_NUMBER
from canopen_check.expectations import Notes
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, ObjectType, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.verdict import Result, ViolationError
from tests.check.conformance_rig import Fault, Site, check_caught, refused, verdict_of
from tests.check.faulty_nodes import (
    BusyWhenOperational,
    CountsStarts,
    Inverting,
    KeepsCommunication,
    KeepsErrors,
    OldestFirst,
    TakesShort,
    with_pdos,
)
from tests.core.full_device import LIMITED, PRIVATE, SECRET, SETTING, TYPED, full_device

U8, U16, U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32


def own(index: int, name: str, data_type: DataType, access: Access = Access.RW, **more: Any) -> Object:
    return Object.of(name, [Variable(index, 0, name, data_type, access, **more)])


def typed(structure: int, object_type: ObjectType = ObjectType.ARRAY) -> Object:
    fields = [
        Variable(TYPED, 0, "typed:highest_subindex", U8, Access.CONST, 1),
        Variable(TYPED, 1, "typed:value", U16, Access.RW),
        Variable(TYPED, 0xFF, "typed:structure", U32, Access.CONST, structure),
    ]
    return Object.of("typed", fields, object_type)


HISTORY_REFUSED = ("585#60031000.*", "585#8003100024000008")

FAULTS = [
    ("4.1", Fault("an object is missing", dictionary=full_device(without=(0x1200,))), "refused reading 0x1200:00"),
    ("4.1", Fault("too short", sent=[("585#43181004(.*)", r"585#4B181004\1")]), "number of bytes of identity_object:serial"),
    ("4.2", Fault("another default", dictionary=full_device(own(SETTING, "setting", U32, default=78))), "setting"),
    ("4.3", Fault("writable", dictionary=full_device(own(PRIVATE, "private", U16))), "private .* was not refused"),
    ("4.4", Fault("readable", dictionary=full_device(own(SECRET, "secret", U16))), "secret .* was not refused"),
    ("4.5", Fault("another data type", dictionary=full_device(typed(0x708))), "data type .* is 7 .* not 6"),
    ("4.5", Fault("another object type", dictionary=full_device(typed(0x609))), "object type .* is 9 .* not 8"),
    ("4.6", Fault("no limits", dictionary=full_device(own(LIMITED, "limited", U8, default=15))), "writing 9 to .* not refused"),
    ("4.6", Fault("narrow", dictionary=full_device(own(LIMITED, "limited", U8, default=15, low_limit=11, high_limit=19))),
     "writing 10, its limit, .* was refused"),
    ("4.7", Fault("busy", node=BusyWhenOperational, strict=True), "was refused with 0x08000022"),
    ("4.8", Fault("resets nothing", node=KeepsCommunication), ""),
    ("4.7", Fault("lacks an object", dictionary=full_device(without=(SETTING,))), "refused reading 0x2000:00"),
    ("4.9", Fault("inverts", node=Inverting, strict=True), "setting .* written back"),
    ("4.9", Fault("refuses", sent=[("585#60002000.*", "585#8000200030000906")]), "own value to setting .* with 0x06090030"),
    ("5.1", Fault("another COB-ID", dictionary=full_device(standard_object(0x1014, 0x86))), "0x1014:00 is 134"),
    ("5.1", Fault("takes a CAN-ID", heard=[("605#23141000FF010000", "605#2314100085000000")], strict=True),
     "a new CAN-ID in 0x1014:00"),
    ("5.2", Fault("an error", sent=[("585#4F011000.*", "585#4F01100001000000")], strict=True), "has an error"),
    ("5.3", Fault("an entry", sent=[("585#80031001.*", "585#4303100100000000")]), "was not refused"),
    ("5.3", Fault("one, but none", sent=[("585#4F031000.*", "585#4F03100001000000")]), "refused reading 0x1003:01"),
    ("5.4", Fault("silent", sent=[("085#.*", None)]), "did not come"),
    ("5.4", Fault("another code", sent=[("085#1082(.*)", r"085#2082\1")]), "error code is 33312"),
    ("5.4", Fault("not generic", sent=[("085#108211(.*)", r"085#108210\1")], strict=True), "lacks the generic error"),
    ("5.4", Fault("short", sent=[("085#(.{10})(.*)", r"085#\1")]), "length of the emergency message"),
    ("5.4", Fault("twice", sent=[("(085#.*)", r"\1 \1")]), "second emergency"),
    ("5.4", Fault("takes a short one", node=with_pdos(TakesShort), strict=True),
     "RPDO 1 was processed though it was too short: .* 01 55"),
    ("5.5", Fault("never cleared", node=KeepsErrors, strict=True), "is 0x11 after the reset"),
    ("5.5", Fault("no register", sent=[("085#108211(.*)", r"085#108200\1")], strict=True), "is empty"),
    ("5.5", Fault("register at once forgotten", sent=[("585#4F011000.*", "585#4F01100000000000")], strict=True),
     "0x1001:00 is 0x00 after"),
    ("5.5", Fault("no register at all", sent=[("585#4F011000.*", "585#8001100000000206")]), "refused reading 0x1001:00"),
    ("5.6", Fault("another entry", sent=[("585#430310011082(.*)", r"585#430310012082\1")]), "error code in 0x1003:01"),
    ("5.6", Fault("oldest first", node=OldestFirst, strict=True), "after another error the error code in 0x1003:01 is 33296"),
    ("5.6", Fault("not cleared", sent=[("585#4F031000.*", "585#4F03100001000000")]), "after clearing"),
    ("5.6", Fault("clears never", sent=[HISTORY_REFUSED]), "clearing 0x1003:00 was refused with 0x08000024"),
]  # fmt: skip
CASES = (*dictionary_cases.CASES, *emergency_cases.CASES)


@pytest.mark.thorough(3)
@pytest.mark.parametrize(("number", "fault", "said"), FAULTS, ids=[f"{number}-{fault.what}" for number, fault, _ in FAULTS])
def test_fault(number: str, fault: Fault, said: str) -> None:
    check_caught(number, fault, said=said)


def test_each_case_has_a_fault() -> None:
    assert {case.number for case in CASES} == {number for number, _, _ in FAULTS}


PLAIN = full_device(own(LIMITED, "limited", U8), own(SECRET, "secret", U16), without=(TYPED, 0x1001, 0x1003, 0x1014))


@pytest.mark.parametrize("number", ["4.4", "4.5", "4.6", "5.1", "5.2", "5.3", "5.4", "5.5", "5.6"])
def test_not_applicable(number: str) -> None:
    assert verdict_of(number, truth=PLAIN).result is Result.NOT_APPLICABLE


def test_one_limit_is_enough() -> None:
    low = full_device(own(LIMITED, "limited", U8, default=15, low_limit=10))
    assert verdict_of("4.6", truth=low).result is Result.PASSED
    assert verdict_of("2.10", truth=low).result is Result.PASSED  # by 0x1003:00
    high = full_device(own(LIMITED, "limited", U8, default=15, high_limit=20))
    assert verdict_of("4.6", truth=high).result is Result.PASSED
    assert verdict_of("2.11", truth=high).result is Result.NOT_APPLICABLE


@pytest.mark.parametrize("of_the_array", [False, True])
@pytest.mark.parametrize("number", ["4.7", "4.9"])
def test_what_a_download_leaves_alone_is_not_written_back(number: str, of_the_array: bool) -> None:
    """ObjFlags stand at the array, or at each of its entries."""
    array = typed(0x0608)
    entries = {key: replace(each, object_flags=not of_the_array) for key, each in array.variables.items()}
    site = Site(truth=full_device(replace(array, variables=entries, object_flags=of_the_array)))
    assert site.run(BY_NUMBER[number]).result is Result.PASSED
    assert [text for text in site.frames() if re.match("605#2.042001", text)] == []


def test_structure_of_a_record() -> None:
    """The data type of a record is its own, which nothing in the dictionary tells."""
    assert verdict_of("4.5", truth=full_device(typed(0x4009, ObjectType.RECORD))).result is Result.PASSED


def test_a_device_that_refuses_to_be_read() -> None:
    busy = Fault("busy", sent=[("585#4.012000.*", "585#8001200021000008")])
    assert "0x08000021" in verdict_of("4.1", busy).reason


def test_cob_id_of_emergency() -> None:
    assert "predefined" in verdict_of("5.1", truth=full_device(standard_object(0x1014, 0x86))).reason
    assert verdict_of("5.1", truth=full_device(standard_object(0x1014, 0x8000_0086))).result is Result.PASSED


def test_an_error_history_that_survives_a_reset() -> None:
    kept = Fault("kept", sent=[("585#4F031000.*", "585#4F03100001000000"), ("585#80031001.*", "585#4303100110820000")])
    assert verdict_of("5.3", kept).reason == "1 error"
    vague = Fault("vague", sent=[("(585#80031001).{8}", refused(AbortCode.GENERAL_ERROR))])
    assert verdict_of("5.3", vague).result is Result.PASSED


def private(default: int) -> ObjectDictionary:
    return full_device(own(PRIVATE, "private", U16, Access.RO, default=default, pdo_mappable=False))


def test_a_value_of_the_maker_that_resets_change_is_a_remark() -> None:
    verdict = verdict_of("4.2", Fault("counts", node=CountsStarts), truth=private(0))
    assert verdict.result is Result.REMARK
    assert not verdict.failures
    assert re.fullmatch(r"private .* changes with a reset \(.. 00, then .. 00\): .*", verdict.remarks[0])


def test_a_wrong_value_is_named_once() -> None:
    """A read-only value that stays the same is wrong; the next case that compares it does not name it again."""
    site = Site(Fault("another default", dictionary=private(5)), truth=private(7), strict=True)
    verdict = site.run(BY_NUMBER["4.2"])
    assert verdict.result is Result.FAILED
    assert [text for text in verdict.failures if "private" in text] == ["private (0x2003:00) is 05 00, not 07 00"]
    again = site.run(BY_NUMBER["4.2"])
    assert again.result is Result.PASSED
    assert "1 of them with another value, as named before" in again.reason


def test_one_failure_is_noted_once() -> None:
    notes = Notes()
    for _ in range(3):
        notes.fail(ViolationError("the same"))
    notes.fail(ViolationError("another"))
    assert notes.verdict(0).failures == ("the same", "another")
