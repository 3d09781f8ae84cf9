"""Chapter 2, continued: block transfers. A sound device passes each case, and one with a fault planted for it does not."""

from __future__ import annotations

import pytest

from canopen_check import block_cases
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, Variable
from canopen_proto.local_node import LocalNode
from canopen_proto.verdict import Result
from tests.check.conformance_rig import Fault, check_caught, verdict_of
from tests.check.faulty_nodes import Endless, without_crc
from tests.core.full_device import full_device

LOSES = [("605#815501(.*)", r"605#810000\1")]
NO_BLOCKS = Fault("no blocks", heard=[("605#[AC].*", "605#E000000000000000")])

FAULTS = [
    ("2.19", Fault("another size", sent=[("585#C6001000.*", "585#C600100005000000")]), "against the one announced"),
    ("2.19", Fault("five bytes", sent=[("585#C6001000.*", "585#C000100000000000"), ("585#CD(.*)", r"585#C9\1")]),
     "number of bytes of 0x1000:00 is 5"),
    ("2.19", Fault("begins with 2", sent=[("585#81(.*)", r"585#82\1")]), "sequence number of a segment is 2"),
    ("2.19", Fault("ends strangely", sent=[("585#CD(.*)", r"585#A1\1")]), "end of a block upload is 0xA1"),
    ("2.19", Fault("another object", sent=[("585#C6001000(.*)", r"585#C6001001\1")]), "names"),
    ("2.19", Fault("no segments", heard=[("605#A3.*", None)]), "segment 1 of a block did not come within 1 s"),
    ("2.19", Fault("silent", sent=[("585#8[01].*", None)]), "segment 1 of a block did not come"),
    ("2.20", Fault("loses it", heard=LOSES), "0x100C:00, read back"),
    ("2.20", Fault("acknowledges nothing", sent=[("585#A201(.*)", r"585#A200\1")]), "number of acknowledged segments is 0"),
    ("2.20", Fault("wants no segments", sent=[("585#A40C10007F(.*)", r"585#A40C100000\1")]), "asks for is 0"),
    ("2.21", Fault("loses it", heard=LOSES), "0x1017:00, read back"),
    ("2.21", Fault("aborts", sent=[("585#A1.*", "585#8017100000000008")]), "end of a block download was answered by abort"),
    ("2.21", Fault("ends strangely", sent=[("585#A1(.*)", r"585#A2\1")]), "answered by the command byte 0xA2"),
    ("2.22", Fault("another byte", sent=[("585#0163(.*)", r"585#0164\1")]), "by block transfer"),
    ("2.23", Fault("another CRC", sent=[("585#D1....(.*)", r"585#D10000\1")]), "the CRC is 0 "),
    ("2.24", Fault("hides its CRC", sent=[("585#A4(.*)", r"585#A0\1")]), "answered by abort 0x05040004"),
    ("2.24", Fault("loses it", heard=[("605#815501(.*)", r"605#810000\1"), ("605#D5....(.*)", r"605#D50000\1")]), "read back"),
    ("2.25", Fault("hides its CRC", sent=[("585#A4(.*)", r"585#A0\1")]), "answered by abort 0x05040004"),
    ("2.26", Fault("takes 128", heard=[("605#A008100080(.*)", r"605#A00810007F\1")]), "block size 128 was not refused"),
    ("2.26", Fault("in segments", sent=[("585#80081000.*", "585#4108100011000000")]), "answered by the command byte 0x41"),
    ("2.26", Fault("another code", sent=[("585#80081000.*", "585#8008100022000008")]), "with 0x08000022"),
    ("2.26", Fault("takes 0", heard=[("605#A008100000(.*)", r"605#A00810007F\1")], strict=True), "block size 0 was not refused"),
    *[(number, Fault("sends nothing again", heard=[("605#A200(.*)", r"605#A203\1")], strict=True), "sequence number of a segment")
      for number in ("2.22", "2.23")],
    ("2.27", Fault("takes 128", heard=[("605#A280(.*)", r"605#A203\1")]), "segment 128 was not refused"),
]  # fmt: skip
CASES = [case for case in block_cases.CASES if case.body is not None]


@pytest.mark.parametrize(("number", "fault", "said"), FAULTS, ids=[f"{number}-{fault.what}" for number, fault, _ in FAULTS])
def test_fault(number: str, fault: Fault, said: str) -> None:
    check_caught(number, fault, said=said)


def test_each_case_has_a_fault() -> None:
    assert {case.number for case in CASES} == {number for number, _, _ in FAULTS}


@pytest.mark.parametrize("number", [case.number for case in CASES])
def test_device_without_block_transfer(number: str) -> None:
    """To refuse the block size 128 it need not know block transfer."""
    assert verdict_of(number, NO_BLOCKS).result is (Result.PASSED if number == "2.26" else Result.NOT_APPLICABLE)


def test_device_without_crc() -> None:
    for number in ("2.23", "2.24", "2.25"):
        verdict = verdict_of(number, Fault("no CRC", node=without_crc))
        assert verdict.result is Result.PASSED
        assert verdict.reason == "the device has no CRC"


def test_wrong_block_size_that_is_refused_at_once() -> None:
    at_once = Fault("at once", sent=[("585#C6081000.*", "585#8008100002000405")])
    assert verdict_of("2.26", at_once).result is Result.PASSED


def test_several_sub_blocks() -> None:
    name = Object.of("name", [Variable(0x1008, 0, "name", DataType.VISIBLE_STRING, Access.CONST, "abcdefg" * 127 * 2)])
    assert verdict_of("2.23", truth=full_device(name)).result is Result.PASSED
    longer = Fault("longer", sent=[("585#83(.*)", r"585#03\1")])
    assert verdict_of("2.22", longer).result is Result.FAILED


def test_an_endless_upload_ends() -> None:
    assert "no last segment" in verdict_of("2.23", Fault("endless", node=Endless)).reason


def test_a_refusal_with_another_code() -> None:
    busy = Fault("busy", sent=[("585#C6001000.*", "585#8000100021000008")], node=LocalNode)
    assert "answered by abort 0x08000021" in verdict_of("2.19", busy).reason
