"""Chapter 2, SDO: a sound device passes each case, and one with a fault planted for it does not."""

from __future__ import annotations

from dataclasses import replace

import pytest

from canopen_check import sdo_cases
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Time
from canopen_proto.sdo.server import Pending
from canopen_proto.verdict import Result
from tests.check.conformance_rig import Fault, check_caught, refused, verdict_of
from tests.check.faulty_nodes import AnyLength, Bottomless, Endless
from tests.core.full_device import LIMITED, SECRET, full_device


class Forgetful(LocalNode):
    """Confirms what is written to the EMCY inhibit time, and does not keep it."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        return None if index == 0x1015 else super().write(index, subindex, data, now)


class Particular(LocalNode):
    """Refuses a guard time."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        return AbortCode.INVALID_VALUE if index == 0x100C else super().write(index, subindex, data, now)


WRONG = refused(AbortCode.NO_DATA)
ANY_ABORT = [(r"(585#80.{6}).{8}", WRONG)]
LIMITLESS = Object.of("limited", [Variable(LIMITED, 0, "limited", DataType.UNSIGNED8, default=15)])
OPEN = Object.of("secret", [Variable(SECRET, 0, "secret", DataType.UNSIGNED16, Access.RW)])
CHATTY = Object.of("device_type", [Variable(0x1000, 0, "device_type", DataType.VISIBLE_STRING, Access.CONST, "a device")])

FAULTS = [
    ("2.1", Fault("another object's answer", sent=[("585#43001000(.*)", r"585#43011000\1")]), "names"),
    ("2.1", Fault("another device", dictionary=full_device(standard_object(0x1000, 0x192))), "0x1000.* is 92 01"),
    ("2.1", Fault("fewer bytes", sent=[("585#43001000(.*)", r"585#47001000\1")]), "number of bytes"),
    ("2.1", Fault("in segments", dictionary=full_device(CHATTY)), "segmented"),
    ("2.1", Fault("a short frame", sent=[("585#43001000(....)....", r"585#43001000\1")]), "length"),
    ("2.1", Fault("mute", sent=[("585#.*", None)]), "did not come"),
    ("2.1", Fault("abort", sent=[("585#43(001000).*", r"585#80\g<1>00000206")]), "abort 0x06020000"),
    ("2.1", Fault("another response", sent=[("585#43(001000.*)", r"585#60\1")]), "command byte 0x60"),
    ("2.2", Fault("loses it", heard=[("605#2B17100055010000", "605#2B17100000000000")]), "0x1017:00., read back"),
    ("2.2", Fault("forgetful", node=Forgetful, strict=True), "0x1015:00., read back"),
    ("2.2", Fault("particular", node=Particular, strict=True), "0x100C:00. = .* was refused"),
    ("2.3", Fault("another code", sent=ANY_ABORT), "0x08000024 .*not with"),
    ("2.3", Fault("accepts", sent=[("585#80(001000).{8}", r"585#60\g<1>00000000")]), "was not refused"),
    ("2.4", Fault("readable", dictionary=full_device(OPEN)), "secret.* was not refused"),
    ("2.3", Fault("names another object", sent=[("585#80001000(.*)", r"585#80000000\1")]),
     "did not answer writing .*: 585#8000000002000106, which it sent, is no answer"),
    ("2.5", Fault("no end", node=Bottomless, strict=True), "reading 0x1018:05 was not refused"),
    ("2.5", Fault("code of a missing object", sent=[("(585#80001001).{8}", refused(AbortCode.NO_SUCH_OBJECT))]), "0x06020000"),
    ("2.6", Fault("has it", dictionary=full_device(standard_object(0x1006), CHATTY, Object.of(
        "obsolete", [Variable(0x1004, 0, "obsolete", DataType.UNSIGNED32)]))), "was not refused"),
    ("2.7", Fault("another code", sent=ANY_ABORT), "specifier"),
    ("2.7", Fault("obeys", heard=[("605#E0(.*)", r"605#40\1")]), "was not refused"),
    ("2.8", Fault("takes two of four", heard=[("605#23(......)(....)(....)", r"605#2B\1\2\3")]), "was not refused"),
    ("2.8", Fault("any length", node=AnyLength, strict=True), "writing 4 bytes to secret .* was not refused"),
    ("2.9", Fault("any length", node=AnyLength, strict=True), "writing 1 byte to setting .* was not refused"),
    ("2.9", Fault("takes one for four", heard=[("605#2F(.*)", r"605#23\1")]), "0x06090030"),
    ("2.10", Fault("no limits", dictionary=full_device(LIMITLESS)), "writing 21 to limited"),
    ("2.10", Fault("takes any number of errors", heard=[("605#2F031000FF(.*)", r"605#2F03100000\1")]),
     "writing 255 to .*0x1003:00"),
    ("2.11", Fault("no limits", dictionary=full_device(LIMITLESS)), "writing 9 to limited"),
    ("2.12", Fault("another channel", dictionary=full_device(standard_object(0x1200, defaults={1: 0x606}))), "server"),
    ("2.12", Fault("serves node 6", heard=[("606#(.*)", r"605#\1")], strict=True), "request to node 6 was answered"),
    ("2.12", Fault("serves node 4", heard=[("604#(.*)", r"605#\1")], strict=True), "request to node 4 was answered"),
    ("2.13", Fault("another size", sent=[("585#43001000(.*)", r"585#4B001000\1")]), "number of bytes"),
    ("2.13", Fault("goes on", sent=[("585#80000000.*", "585#0100000000000000")], strict=True), "segment request .* not refused"),
    ("2.14", Fault("no segments", heard=[("605#21.*", "605#E000000000000000")]), "answered by abort"),
    ("2.14", Fault("loses it", heard=[("605#0B5501(.*)", r"605#0B0000\1")]), "0x100C:00, read back"),
    *[(number, Fault("takes any toggle bit", heard=[("605#1B(.*)", r"605#0B\1")], strict=True),
      "download segment with a wrong toggle")
      for number in ("2.14", "2.15")],
    ("2.15", Fault("toggles", sent=[("585#20(.*)", r"585#30\1")]), "toggle bit"),
    ("2.15", Fault("names another", sent=[("585#60171000(.*)", r"585#60171001\1")]), "names"),
    ("2.15", Fault("loses it", heard=[("605#0B5501(.*)", r"605#0B0000\1")]), "0x1017:00, read back"),
    ("2.16", Fault("another size", sent=[("585#41081000.*", "585#4108100010000000")]), "against the one announced"),
    ("2.16", Fault("expedited", sent=[("585#41081000.*", "585#4308100010000000")]), "expedited"),
    ("2.16", Fault("never toggles", sent=[("585#1(0.*)", r"585#0\1")]), "toggle bit"),
    ("2.16", Fault("few", sent=[("585#41081000.*", "585#4008100000000000"), ("585#0.*", "585#0961620000000000")]), "3 bytes"),
    ("2.17", Fault("does not care", heard=[("605#70(.*)", r"605#60\1")]), "was not refused"),
    ("2.17", Fault("another code", sent=ANY_ABORT), "wrong toggle bit"),
    ("2.18", Fault("answers an abort", heard=[("605#80(.*)", r"605#E0\1")], strict=True), "an abort was answered: 585#80"),
    ("2.18", Fault("a bit is wrong", sent=[("585#(0[^4]..)63(.*)", r"585#\g<1>62\2"), ("585#006.6.(.*)", r"585#006261\1")]),
     "in segments"),
]  # fmt: skip


@pytest.mark.thorough(3)
@pytest.mark.parametrize(("number", "fault", "said"), FAULTS, ids=[f"{number}-{fault.what}" for number, fault, _ in FAULTS])
def test_fault(number: str, fault: Fault, said: str) -> None:
    check_caught(number, fault, said=said)


def test_each_case_has_a_fault() -> None:
    assert {case.number for case in sdo_cases.CASES} == {number for number, _, _ in FAULTS}


def test_too_high_a_number_of_errors() -> None:
    """Where no object has a limit, CiA's tool writes to the error history."""
    limitless = full_device(LIMITLESS)
    check_caught("2.10", Fault("takes it", heard=[("605#2F031000FF(.*)", r"605#2F03100000\1")]), limitless, r"255 to .*0x1003:00")


def test_segmented_device_type() -> None:
    """A server may send four bytes in segments."""
    segments = [
        ("585#43001000(.*)", "585#4100100004000000"),
        ("585#80000000.*", "585#0791010400000000"),
    ]
    assert verdict_of("2.13", Fault("segments", sent=segments)).reason == "in segments"
    assert verdict_of("2.13").reason == "expedited"


def test_an_endless_upload_ends() -> None:
    assert "no last segment" in verdict_of("2.18", Fault("endless", node=Endless)).reason


BARE = full_device(LIMITLESS, OPEN, without=(0x1003, 0x1008, 0x1009, 0x1200, 0x100C))


@pytest.mark.parametrize("number", ["2.4", "2.10", "2.11", "2.12", "2.14", "2.16", "2.17", "2.18"])
def test_not_applicable(number: str) -> None:
    verdict = verdict_of(number, truth=BARE)
    assert verdict.result is Result.NOT_APPLICABLE
    assert verdict.reason


def test_device_without_settings() -> None:
    tiny = ObjectDictionary([standard_object(0x1000), standard_object(0x1017, 0)])
    assert verdict_of("2.8", truth=ObjectDictionary([standard_object(0x1000)])).result is Result.NOT_APPLICABLE
    assert verdict_of("2.8", truth=tiny).result is Result.PASSED


def test_object_1004_that_is_there() -> None:
    truth = full_device(Object.of("obsolete", [Variable(0x1004, 0, "obsolete", DataType.UNSIGNED32)]))
    assert verdict_of("2.6", truth=truth).result is Result.NOT_APPLICABLE


def test_no_answer_is_no_refusal() -> None:
    mute = Fault("mute", sent=[("585#80.*", None)])
    assert "did not answer writing 0x1000:00" in verdict_of("2.3", mute).reason
    assert "did not answer reading 0x1004:00" in verdict_of("2.6", mute).reason


def test_a_dictionary_with_text_in_place_of_a_number() -> None:
    text = Object.of("period", [Variable(0x1017, 0, "period", DataType.VISIBLE_STRING)])
    assert "does not hold the number 100" in verdict_of("7.103", truth=full_device(text)).reason


def test_codes_that_need_not_say_more() -> None:
    for number in ("2.3", "2.4", "2.5", "2.6", "2.7", "2.8", "2.9", "2.10", "2.11", "2.17"):
        vague = replace(Fault("vague"), sent=[("(585#80.{6}).{8}", refused(AbortCode.GENERAL_ERROR))])
        assert verdict_of(number, vague).result is Result.PASSED, number


def test_a_long_object_of_fixed_length() -> None:
    counter = Object.of("counter", [Variable(0x2010, 0, "counter", DataType.UNSIGNED64, Access.RO, default=1 << 40)])
    truth = full_device(counter, without=(0x1008, 0x1009))
    for number in ("2.16", "2.18", "2.22"):
        assert verdict_of(number, truth=truth).reason.startswith("counter"), number
