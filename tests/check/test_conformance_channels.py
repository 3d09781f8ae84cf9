"""Chapter 2, at its end: further SDO channels. A sound device passes each case, and one with a fault planted does not."""

from __future__ import annotations

import pytest

from canopen_check import channel_cases
from canopen_proto.abort import AbortCode
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.verdict import Result
from tests.check.conformance_rig import Fault, check_caught, refused, verdict_of
from tests.check.faulty_nodes import KeepsChannels, KeepsCommunication, KeepsNothing
from tests.core.full_device import full_device

SERVERS, CLIENTS = (0x1201, 0x1202), (0x1280, 0x1281)
ONE_MORE = full_device(*(standard_object(index) for index in (0x1203, 0x1282)))

FAULTS = [
    ("2.28", Fault("one more", dictionary=ONE_MORE), "reading 0x1203:00.* was not refused"),
    ("2.28", Fault("another code", sent=[(r"(585#80..12..).{8}", refused(AbortCode.NO_DATA))]), "0x08000024"),
    ("2.28", Fault("one less", dictionary=full_device(without=(0x1202,))), "refused reading 0x1202"),
    ("2.28", Fault("another default", dictionary=full_device(standard_object(0x1202))), "sdo_server_3.* is 00 00 00 80"),
    ("2.28", Fault("does not listen", heard=[("6D8#.*", None)]), "server of 0x1202 did not come"),
    ("2.28", Fault("does not take them", sent=[("585#60011201.*", "585#8001120122000008")]), "refused writing 0x1201:01"),
    ("2.28", Fault("answers elsewhere", sent=[("6D1#(.*)", r"585#\1")]), "server of 0x1201 did not come"),
    ("2.28", Fault("answers twice", sent=[("6D1#(.*)", r"6D1#\1 585#\1")]), "beside the answer of .*: 585#"),
    ("2.28", Fault("answers another", sent=[("6D1#43(.*)", r"6D1#4F\1")]), "answer of the server of 0x1201 is 4f"),
    ("2.28", Fault("one COB-ID is enough", heard=[("605#23011202D1060080", "605#23011202D1060000")]), "one valid COB-ID: 6D1"),
    ("2.28", Fault("the first server does it", heard=[("6D0#(.*)", r"605#\1")]), "one valid COB-ID: the first server answered"),
    ("2.28", Fault("never closes", heard=[("605#23011201D0060080", "605#23011201D0060000")]), "no longer valid: 6D1"),
    ("2.29", Fault("keeps the channels", node=KeepsChannels), "after reset communication: 6D1"),
    ("2.29", Fault("keeps all", node=KeepsCommunication), "after reset communication: 6D1"),
    ("2.29", Fault("one more", dictionary=ONE_MORE), "reading 0x1203:00.* was not refused"),
    ("2.29", Fault("shows what was", sent=[("585#43011201.*", "585#43011201D0060000")]), "sdo_server_2.* is d0 06"),
    ("2.30", Fault("keeps nothing", node=KeepsNothing), "after reset communication, 0x1280:01 is 2147483648"),
    ("2.30", Fault("one more", dictionary=ONE_MORE), "reading 0x1282:00.* was not refused"),
    ("2.30", Fault("refuses to save", heard=[("605#23101001.*", "605#2310100100000000")]), "saving .* was refused"),
]  # fmt: skip


@pytest.mark.thorough(3)
@pytest.mark.parametrize(("number", "fault", "said"), FAULTS, ids=[f"{number}-{fault.what}" for number, fault, _ in FAULTS])
def test_fault(number: str, fault: Fault, said: str) -> None:
    check_caught(number, fault, said=said)


def test_each_case_has_a_fault() -> None:
    assert {case.number for case in channel_cases.CASES} == {number for number, _, _ in FAULTS}


def test_a_device_without_further_channels() -> None:
    bare = full_device(without=(*SERVERS, *CLIENTS))
    assert verdict_of("2.28", truth=bare).result is Result.PASSED
    for number in ("2.29", "2.30"):
        verdict = verdict_of(number, truth=bare)
        assert verdict.result is Result.NOT_APPLICABLE
        assert "COB-IDs that can be written" in verdict.reason


def test_a_device_that_does_not_store() -> None:
    assert verdict_of("2.30", truth=full_device(without=(0x1010,))).result is Result.NOT_APPLICABLE


def test_vague_codes_will_do() -> None:
    vague = Fault("vague", sent=[("(585#80.{6}).{8}", refused(AbortCode.GENERAL_ERROR))])
    for number in ("2.28", "2.29", "2.30"):
        assert verdict_of(number, vague).result is Result.PASSED


def test_restricted_can_ids_of_a_server() -> None:
    takes_any = Fault("takes any", sent=[("585#80011202.*", "585#6001120200000000")])
    check_caught("8.10", takes_any, said="0x000 in sdo_server_2_parameter:cob_id_server_to_client .*was not refused")
