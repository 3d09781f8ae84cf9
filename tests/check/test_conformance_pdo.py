"""Chapter 3, PDO: a sound device passes each case, and one with a fault planted for it does not."""

from __future__ import annotations

from dataclasses import replace

import pytest

from canopen_check import pdo_cases, pdo_mapping_cases
from canopen_check.catalogue import BY_NUMBER
from canopen_data.declared import describe_device
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.declared import DeclaredDevice, Nameplate, Tpdo, variable
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object, standard_variable
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.sdo.server import Pending
from canopen_proto.verdict import Result, Verdict
from tests.check.conformance_rig import Alteration, Fault, Site, check_caught, verdict_of
from tests.check.faulty_nodes import SelfStarting
from tests.core.full_device import INPUT_16, OUTPUT_16, full_device

MAPPINGS = (*range(0x1600, 0x1800), *range(0x1A00, 0x1C00))


class Permissive(LocalNode):
    """Takes every mapping, at any time."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        if index in MAPPINGS:
            self.values.store[index << 8 | subindex] = int.from_bytes(data, "little")
            return None
        return super().write(index, subindex, data, now)


class Fixed(LocalNode):
    """Takes no mapping but what it has."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        if index in MAPPINGS and subindex:
            return AbortCode.CANNOT_BE_MAPPED
        return super().write(index, subindex, data, now)


class Forgetful(LocalNode):
    """Confirms mapping entries, and does not keep them."""

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        if index in MAPPINGS and subindex:
            return None
        return super().write(index, subindex, data, now)


STARTS = Fault("starts when told to stop", heard=[("000#0205", "000#0105")])
RUNS = Fault("starts by itself and stays", heard=[("000#8005", None)], node=SelfStarting)


def tpdo(cob_id: int, highest: int = 6) -> Object:
    return standard_object(0x1800, highest=highest, defaults={1: cob_id, 2: 255})


FAULTS = [
    ("3.1", Fault("another CAN-ID", dictionary=full_device(standard_object(0x1401, highest=5, defaults={1: 0x306, 2: 1}))),
     "0x1401:01"),
    ("3.1", Fault("one more", dictionary=full_device(standard_object(0x1404, highest=2))), "reading 0x1404:01 was not refused"),
    ("3.2", Fault("another type", dictionary=full_device(tpdo(0x40000185, 5))), "0x1800:00"),
    ("3.2", Fault("one more", dictionary=full_device(standard_object(0x1804, highest=2))), "reading 0x1804:01 was not refused"),
    *[(f"3.{number}", Fault("takes a reserved type",
      heard=[(rf"605#2F00{first}02F1(.*)", rf"605#2F00{first}02FF\1")], strict=True),
       "reserved transmission type 241 of .PDO 1 was not refused") for number, first in ((1, "14"), (2, "18"))],
    ("3.3", Fault("deaf to requests", heard=[("185#R2", None)], strict=True), "number of answers .* is 0"),
    ("3.3", Fault("answers at length", sent=[("185#....", "185#000000")], strict=True), "length of TPDO 1"),
    ("3.3", Fault("does not forbid", heard=[("605#230018018501004(.)", "605#2300180185010000")], strict=True),
     "number of answers .* is 1"),
    ("3.4", Fault("silent", sent=[("285#....", None)]), "number of TPDO 2 for one event is 0"),
    ("3.4", Fault("twice", sent=[("(185#....)", r"\1 \1")]), "number of TPDO 1 for one event is 2"),
    ("3.5", Fault("twice", sent=[("(185#....)", r"\1 \1")]), "TPDO 1 came 20 times in 1 s, one each 47.4 ms; the period"),
    ("3.5", Fault("never", sent=[("385#....", None)]), "TPDO 3 came 0 times in 1 s; the period is 100 ms"),
    ("3.5", Fault("big-endian", sent=[("185#(..)(..)", r"185#\2\1")], strict=True),
     "carries 00 01; its objects, read by SDO, are 01 00"),
    ("3.5", Fault("no inhibit time", heard=[("605#2B001803B80B(.*)", r"605#2B0018030000\1")], strict=True),
     "came again after 100 ms"),
    ("3.5", Fault("inhibit time in ms", heard=[("605#2B001803B80B(.*)", r"605#2B0018033075\1")], strict=True),
     "came 1 time in 1.2 s"),
    ("3.6", Fault("never", sent=[("185#....", None)]), "TPDO 1 of type 1 came"),
    ("3.6", Fault("each time", heard=[("605#2F01180203000000", "605#2F01180201000000")]), "TPDO 2 of type 3 came"),
    ("3.7", Fault("no SYNC", heard=[("605#2F00180200000000", "605#2F001802FF000000")]), "before SYNC"),
    ("3.7", Fault("each SYNC", heard=[("605#2F00180200000000", "605#2F00180201000000")]), "SYNC behind its event"),
    ("3.7", Fault("no SYNC at all", heard=[("080#", None)]), "SYNC behind its event"),
    ("3.8", Fault("no start value", heard=[("605#2F00180603000000", "605#2F00180600000000")]), "counters 1 to 7"),
    ("3.9", replace(STARTS, strict=True), "number of answers"),
    *[(f"3.{number}", STARTS, "") for number in range(10, 15)],
    ("3.15", replace(RUNS, strict=True), "number of answers"),
    *[(f"3.{number}", RUNS, "") for number in range(16, 21)],
    ("3.21", Fault("another count", dictionary=full_device(
        standard_object(0x1600, highest=8, defaults={0: 2, 1: 0x64110010, 2: 0x64110010}))), "number of objects in RPDO 1"),
    ("3.21", Fault("a missing object", dictionary=full_device(
        standard_object(0x1600, highest=8, defaults={0: 1, 1: 0x64120010}))), "not in the dictionary"),
    ("3.21", Fault("an output", dictionary=full_device(
        standard_object(0x1A01, highest=8, defaults={0: 1, 1: 0x64110010}))), "TPDO 2 carries output_16"),
    ("3.21", Fault("too wide", dictionary=full_device(
        standard_object(0x1A01, highest=8, defaults={0: 1, 1: 0x64010011}))), "with 17 bits"),
    ("3.22", Fault("fixed", node=Fixed), "refused a correct mapping"),
    ("3.22", Fault("forgetful", node=Forgetful), "0x1600:01"),
    ("3.23", Fault("permissive", node=Permissive), "was not refused"),
    ("3.23", Fault("takes it all the same", node=Permissive, sent=[("585#60(001601)00000000", r"585#80\g<1>22000008")]),
     "after a refused write"),
    ("3.24", Fault("permissive", node=Permissive), "which is valid, was not refused"),
    ("3.24", Fault("takes a CAN-ID", heard=[("605#2300140185020000", "605#2300140105020000")], strict=True),
     "new CAN-ID of RPDO 1, which is"),
    ("3.25", Fault("permissive", node=Permissive), "65 objects in RPDO 1 was not refused"),
    ("3.26", Fault("permissive", node=Permissive), "96 bits in RPDO 1 was not refused"),
    ("3.27", Fault("fixed", node=Fixed), "output_16 .* was refused with 0x06040041"),
    ("3.28", Fault("permissive", node=Permissive), "was not refused"),
    ("3.29", Fault("permissive", node=Permissive), "setting .* was not refused"),
    ("3.29", Fault("maps nothing", heard=[("605#2300160108000620", "605#2300160110001164")], strict=True),
     "is not there .* not refused"),
    ("3.30", Fault("fixed", node=Fixed), "was refused"),
    ("3.31", Fault("permissive", node=Permissive), "output_16 .* was not refused"),
    ("3.32", Fault("permissive", node=Permissive), "was not refused"),
    ("3.32", Fault("maps nothing", heard=[("605#23001A0108000620", "605#23001A0110000164")], strict=True),
     "is not there .* not refused"),
    ("3.33", Fault("shifted", heard=[("205#FFFF0100", "205#0100FFFF")]), "with a dummy object"),
]  # fmt: skip


@pytest.mark.thorough(6)
@pytest.mark.parametrize(("number", "fault", "said"), FAULTS, ids=[f"{number}-{fault.what}" for number, fault, _ in FAULTS])
def test_fault(number: str, fault: Fault, said: str) -> None:
    check_caught(number, fault, said=said)


def test_each_case_has_a_fault() -> None:
    assert {case.number for case in (*pdo_cases.CASES, *pdo_mapping_cases.CASES)} == {number for number, _, _ in FAULTS}


NO_PDOS = full_device(without=tuple(range(0x1400, 0x1C00)))
NUMBERS = [case.number for case in (*pdo_cases.CASES, *pdo_mapping_cases.CASES)]


@pytest.mark.parametrize("number", NUMBERS)
def test_device_without_pdos(number: str) -> None:
    assert verdict_of(number, truth=NO_PDOS).result is Result.NOT_APPLICABLE


def read_only(index: int, highest: int, defaults: dict[int, int]) -> Object:
    made = standard_object(index, highest=highest, defaults=defaults)
    return Object.of(made.name, [standard_variable(index, sub, access=Access.RO, default=defaults.get(sub, 0))
                                 for sub in made.variables if sub or index >= 0x1600])  # fmt: skip


def one_fixed_tpdo() -> ObjectDictionary:
    """A device of one TPDO, of which nothing may be changed but the COB-ID."""
    return full_device(
        Object.of("c", [
            standard_variable(0x1800, 1, default=0x185),
            standard_variable(0x1800, 2, default=255, low_limit=254),
        ]),
        read_only(0x1A00, 1, {0: 1, 1: INPUT_16 << 16 | 16}),
        without=(*range(0x1400, 0x1800), *range(0x1801, 0x1A00), *range(0x1A01, 0x1C00)),
    )  # fmt: skip


def test_device_whose_pdo_can_do_little() -> None:
    truth = one_fixed_tpdo()
    results = {number: verdict_of(number, truth=truth).result for number in NUMBERS}
    passed = {number for number, result in results.items() if result is Result.PASSED}
    assert passed == {"3.2", "3.3", "3.9", "3.15", "3.4", "3.10", "3.16", "3.21"}
    assert {result for number, result in results.items() if number not in passed} == {Result.NOT_APPLICABLE}


def test_unforced_events() -> None:
    for number in ("3.4", "3.7"):
        verdict = verdict_of(number, stimulus=False)
        assert verdict.result is Result.PASSED
        assert "no event could be caused" in verdict.reason


def test_type_0_that_does_not_wait_for_sync() -> None:
    hasty = Fault("hasty", heard=[("080#", None)], sent=[("(705#05)", r"\1 185#0000")])
    verdict = verdict_of("3.7", hasty, full_device(standard_object(0x1017, 30)), stimulus=False)
    assert "without SYNC" in verdict.reason


def test_a_dictionary_that_is_wrong_itself() -> None:
    twice = full_device(standard_object(0x1401, highest=5, defaults={1: 0x205, 2: 1}))
    assert "same CAN-ID" in verdict_of("3.1", truth=twice).reason
    restricted = full_device(standard_object(0x1401, highest=5, defaults={1: 0x601, 2: 1}))
    assert "restricted" in verdict_of("3.1", truth=restricted).reason
    extended = full_device(standard_object(0x1401, highest=5, defaults={1: 0x2000_0601, 2: 1}))
    assert verdict_of("3.1", truth=extended).result is Result.PASSED
    full = full_device(standard_object(0x1A00, highest=8, defaults={0: 3, 1: 0x64040020, 2: 0x64040020, 3: 0x64040020}))
    assert "carries 96 bits" in verdict_of("3.21", truth=full).reason
    mpdo = full_device(standard_object(0x1A00, highest=8, defaults={0: 254}))
    assert verdict_of("3.21", truth=mpdo).result is Result.PASSED
    dummy = full_device(standard_object(0x1600, highest=8, defaults={0: 1, 1: 0x00060010}))
    assert verdict_of("3.21", truth=dummy).result is Result.PASSED


def test_the_last_pdo_of_all() -> None:
    truth = full_device(standard_object(0x15FF, highest=2))
    assert verdict_of("3.1", truth=truth).reason == "5 PDOs"


def test_few_entries() -> None:
    narrow = full_device(*(standard_object(0x1600 + n, highest=1, defaults={0: 1, 1: 0x64110010}) for n in range(4)))
    assert verdict_of("3.26", truth=narrow).result is Result.PASSED
    check_caught("3.26", Fault("permissive", node=Permissive), narrow, "72 bits in RPDO 1")
    assert verdict_of("3.33", truth=narrow).result is Result.NOT_APPLICABLE


def test_what_is_not_there_to_be_mapped() -> None:
    outputs = full_device(without=(OUTPUT_16, 0x6414, 0x2005))
    assert verdict_of("3.27", truth=outputs).result is Result.NOT_APPLICABLE
    plain = full_device(
        Object.of("setting", [Variable(0x2000, 0, "setting", DataType.UNSIGNED32, pdo_mappable=True)]),
        without=(OUTPUT_16, 0x6414, 0x2005),
    )
    assert verdict_of("3.22", truth=plain).result is Result.PASSED
    assert "nothing else" in verdict_of("3.22", truth=full_device(without=(0x6414, 0x1013))).reason
    for number in ("3.22", "3.26"):
        assert verdict_of(number, truth=full_device(without=(OUTPUT_16, 0x6414))).result is Result.NOT_APPLICABLE
    invalid = full_device(*(standard_object(base + n, highest=5, defaults={1: 0x8000_0000 | 0x100 * n + own, 2: 255})
                            for base, own in ((0x1400, 0x205), (0x1800, 0x185)) for n in range(4)))  # fmt: skip
    assert verdict_of("3.24", truth=invalid).result is Result.NOT_APPLICABLE


def test_dummy_objects_are_optional() -> None:
    assert verdict_of("3.33", Fault("no dummies", node=Fixed)).result is Result.NOT_APPLICABLE


def test_tpdos_that_allow_no_remote_requests() -> None:
    """Refused, as a restricted CAN-ID is."""
    refuses = Fault("no requests", heard=[("605#23(..)1801....0000", r"605#23\g<1>180101060000")])
    verdict = verdict_of("3.3", refuses)
    assert verdict.result is Result.NOT_APPLICABLE
    assert "remote requests" in verdict.reason


def test_pdos_that_are_not_all_there() -> None:
    without_mapping = full_device(standard_object(0x1404, highest=2))
    assert verdict_of("3.1", truth=without_mapping).reason == "5 PDOs"
    assert verdict_of("3.21", truth=without_mapping).reason == "RPDO 5 has no mapping parameter"
    pdos = {index: standard_object(index, highest=2) for index in (*range(0x1400, 0x1404), *range(0x1800, 0x1804))}
    nameless = full_device(*pdos.values())
    assert "has a CAN-ID and a mapping" in verdict_of("3.22", truth=nameless).reason


# ---- devices whose values change by themselves ----


class SetsAgain(DeclaredDevice):
    """Its own code sets the value again, whatever the test has made of it."""

    nameplate = Nameplate("Sets again")
    period = 10 * MILLISECOND
    level = variable(0x2000, "Level", DataType.INTEGER16, access=Access.RO, pdo=True)
    pdos = (Tpdo(1, level),)

    def step(self) -> None:
        self.level = 215


class Counts(SetsAgain):
    nameplate = Nameplate("Counts")

    def step(self) -> None:
        self.level = (self.level + 1) % 100


class Flaps(SetsAgain):
    """At each SYNC of the test, which come in even times, it has the same value."""

    nameplate = Nameplate("Flaps")

    def step(self) -> None:
        self.level = 5 if self.level == 4 else 4


class ChangesAtSync(SetsAgain):
    nameplate = Nameplate("Changes at SYNC")

    def step(self) -> None:
        pass

    def sync(self) -> None:
        self.level = (self.level + 1) % 100


RESTLESS: list[type[DeclaredDevice]] = [SetsAgain, Counts, Flaps, ChangesAtSync]


def restless(
    number: str, device: type[DeclaredDevice], *sent: Alteration, heard: Alteration | None = None, strict: bool = False
) -> Verdict:
    """How a case ends on a device in Python."""
    changes = [heard] if heard else []
    fault = Fault("restless", node=lambda out, node_id, dictionary: device(out, node_id).node, sent=sent, heard=changes)
    return Site(fault, description=describe_device(device), strict=strict).run(BY_NUMBER[number])


@pytest.mark.thorough(2)
@pytest.mark.parametrize("device", RESTLESS)
def test_a_device_whose_values_change_by_themselves_passes(device: type[DeclaredDevice]) -> None:
    verdicts = {case.number: restless(case.number, device) for case in pdo_cases.CASES}
    assert {number: str(verdict) for number, verdict in verdicts.items() if verdict.result is Result.FAILED} == {}
    told = {number for number, verdict in verdicts.items() if "its values change by themselves" in verdict.reason}
    assert told == {
        SetsAgain: {"3.4"}, Counts: {"3.4", "3.5", "3.7"}, Flaps: {"3.4", "3.5", "3.7"}, ChangesAtSync: {"3.7"},
    }[device]  # fmt: skip


@pytest.mark.parametrize("device", RESTLESS)
def test_its_own_events_are_no_answers_to_remote_requests(device: type[DeclaredDevice]) -> None:
    for number in ("3.3", "3.9", "3.15"):
        assert restless(number, device, strict=True).result is Result.PASSED, number
    deaf = restless("3.3", device, ("185#....", None), strict=True)
    assert "number of answers to a remote request of TPDO 1 is 0" in str(deaf)


@pytest.mark.parametrize(("number", "device", "sent", "heard", "said"), [
    ("3.4", Counts, ("185#....", None), None, "number of TPDO 1 for one event is 0"),
    ("3.4", SetsAgain, ("(185#....)", r"\1 \1"), None, "number of TPDO 1 for one event is 3"),
    ("3.5", Counts, ("185#....", None), None, "TPDO 1 came 0 times in 1 s"),
    ("3.5", Counts, ("185#[0-2]...", None), None, "TPDO 1 did not come for"),
    ("3.7", SetsAgain, ("185#", None), ("605#2F00180200000000", "605#2F00180201000000"), "SYNC behind its event"),
    ("3.10", SetsAgain, ("185#", None), ("000#0205", "000#0105"), "number of TPDO 1 for one event is 1"),
])  # fmt: skip
def test_what_it_does_wrong_is_found_all_the_same(
    number: str, device: type[DeclaredDevice], sent: Alteration, heard: Alteration | None, said: str
) -> None:
    verdict = restless(number, device, sent, heard=heard)
    assert verdict.result is Result.FAILED, verdict
    assert said in str(verdict)
