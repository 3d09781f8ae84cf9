"""What the cases make of files that say less than they should, other than usual, or nonsense: a verdict, whatever it is."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from canopen_check.catalogue import CASES, run_all
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Time
from canopen_proto.sdo.server import Pending
from canopen_proto.verdict import Result, Verdict
from tests.check.conformance_rig import Fault, Site, verdict_of
from tests.core.full_device import full_device

PDO_FIELDS = (*range(0x1400, 0x1404), *range(0x1800, 0x1804))


def altered(changes: Mapping[tuple[int, int], Mapping[str, Any] | None]) -> ObjectDictionary:
    """The full device with other attributes of some variables; None: without that variable."""
    device = full_device()
    objects = dict(device.objects)
    for (index, subindex), change in changes.items():
        variables = dict(objects[index].variables)
        variable = variables.pop(subindex)
        if change is not None:
            variables[subindex] = replace(variable, **change)
        objects[index] = replace(objects[index], variables=variables)
    return ObjectDictionary(objects.values())


def verdict(number: str, index: int, subindex: int = 0, **change: Any) -> Verdict:
    return verdict_of(number, truth=altered({(index, subindex): change}))


def test_pdos_with_fixed_can_ids_cannot_be_set_up() -> None:
    fixed = altered({(index, 1): {"access": Access.RO} for index in PDO_FIELDS})
    for number in ("3.4", "3.22", "5.4"):
        result = verdict_of(number, truth=fixed)
        assert result.result is Result.NOT_APPLICABLE
        assert "PDO has a COB-ID that can be written" in result.reason
    assert {verdict_of(number, truth=fixed).result for number in ("3.1", "3.2", "9.2", "9.3")} == {Result.PASSED}


@pytest.mark.parametrize("limits", [{"high_limit": 300}, {"low_limit": 50}, {"low_limit": 400}])
def test_times_keep_within_their_limits(limits: dict[str, int]) -> None:
    device = altered({(0x1017, 0): {"default": 400, **limits}, (0x1015, 0): {"default": 400, **limits}})
    if limits != {"low_limit": 50}:
        device = altered({(0x1015, 0): {"default": limits.get("low_limit", 0), **limits}})
    for number in ("2.2", "4.6", "4.8", "9.1"):
        assert verdict_of(number, truth=device).result is Result.PASSED, number


def test_the_highest_time_is_the_limit() -> None:
    for number, index in (("7.101", 0x1017), ("7.5", 0x100C)):
        assert verdict(number, index, high_limit=1000).result is Result.PASSED


def test_limits_of_communication_objects_are_no_promise() -> None:
    """A number of mapped objects is refused while the PDO is valid, whatever the limits."""
    device = altered({(0x1600, 0): {"low_limit": 0, "high_limit": 8}, (0x1005, 0): {"low_limit": 1}})
    assert verdict_of("4.6", truth=device).result is Result.PASSED


class Lacking(LocalNode):
    """Has not every value within the limits of its objects. code: with which it says so."""

    code = AbortCode.INVALID_VALUE

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        lacks = index in (OWN, OF_A_PROFILE) and data == b"\xf7"
        return self.code if lacks else super().write(index, subindex, data, now)


class Wrong(Lacking):
    """Calls such a value too low."""

    code = AbortCode.VALUE_TOO_LOW


OWN, OF_A_PROFILE = 0x2000, 0x6060


@pytest.mark.parametrize(
    ("index", "node", "result"),
    [
        (OF_A_PROFILE, Lacking, Result.PASSED),  # a mode of operation that the drive does not have
        (OF_A_PROFILE, Wrong, Result.FAILED),
        (OWN, Lacking, Result.FAILED),
    ],
)
def test_within_its_limits_an_object_of_a_profile_may_lack_values(index: int, node: type[LocalNode], result: Result) -> None:
    mode = Variable(index, 0, "mode", DataType.INTEGER8, low_limit=-9, high_limit=10)
    assert verdict_of("4.6", Fault("lacking", node=node), full_device(Object.of("mode", [mode]))).result is result


def test_a_device_is_compared_with_what_its_dcf_has_configured() -> None:
    dcf = {
        (0x1017, 0): {"configured": 700},
        (0x1400, 1): {"configured": 0x21D},
        (0x1600, 0): {"configured": 2},
        (0x1600, 2): {"configured": 0x6414_0020},
        (0x2003, 0): {"configured": 77},  # somebody read that once; no master can put it back
    }
    commissioned = altered(dcf)
    results = Site(truth=commissioned).result_of(lambda bench: run_all(bench))
    assert [(case.number, each.reason) for case, each in results if each.result is Result.FAILED] == []
    fresh = Fault("not commissioned", dictionary=full_device())
    for number, said in (("4.2", "0x1017:00"), ("3.1", "0x1400:01"), ("3.21", "number of objects in RPDO 1")):
        assert said in verdict_of(number, fresh, commissioned).reason


def test_what_the_file_does_not_tell_is_not_compared() -> None:
    silent = altered({(index, subindex): {"default": None} for index in PDO_FIELDS for subindex in (2, 3)})
    for number in ("3.1", "3.2", "4.2"):
        assert verdict_of(number, Fault("its own", dictionary=full_device()), silent).result is Result.PASSED
    for index in (0x100C, 0x1015, 0x1017):
        silent = silent.with_objects([altered({(index, 0): {"default": None}}).objects[index]])
    assert verdict_of("8.4", truth=silent).result is Result.NOT_APPLICABLE


@pytest.mark.parametrize("default", [0, 0x8000_0085])
def test_a_device_without_emergency_messages(default: int) -> None:
    for number in ("5.4", "7.6", "7.105", "7.106", "7.107"):
        result = verdict(number, 0x1014, default=default, adds_node_id=False)
        assert result == Verdict(Result.NOT_APPLICABLE, "0x1014:00 has no valid COB-ID by default")


def test_a_subindex_that_is_not_there() -> None:
    device = altered({(0x1400, 2): None, (0x1016, 1): None, (0x1016, 2): None, (0x1016, 3): None, (0x1016, 4): None})
    assert verdict_of("5.4", truth=device).reason == "the dictionary has no object 0x1400:02"
    assert verdict_of("7.104", truth=device).reason == "0x1016 has no entry that can be written"
    assert verdict_of("4.5", truth=altered({(0x2004, 1): None})).result is Result.PASSED


def test_values_that_their_type_cannot_hold() -> None:
    assert verdict("2.16", 0x1008, default="\N{EURO SIGN}").reason == "no object has more than four bytes"
    assert verdict("4.2", 0x2000, default="none").result is Result.PASSED
    assert verdict("8.4", 0x1015, default=-1).result is Result.PASSED
    assert "does not hold the number" in verdict("3.4", 0x1800, 1, data_type=DataType.UNSIGNED16).reason
    assert "number of bytes of 0x1017:00" in verdict("2.21", 0x1017, data_type=DataType.UNSIGNED64).reason


CHANGES: tuple[tuple[str, tuple[Any, ...]], ...] = (
    ("data_type", (DataType.UNSIGNED8, DataType.UNSIGNED64, DataType.INTEGER8, DataType.VISIBLE_STRING, DataType.REAL32)),
    ("access", tuple(Access)),
    ("default", (None, 0, 255, -1, 0x8000_0000, 2**40, "text", b"xy", 1.5)),
    ("configured", (0, 64, 0xFFFF_FFFF, 0x6200_0140)),
    ("low_limit", (-5, 1, 300, 2**33)),
    ("high_limit", (-5, 1, 300, 2**33)),
    ("pdo_mappable", (True, False)),
)


@pytest.mark.thorough(4)
@pytest.mark.parametrize("seed", range(6))
def test_nonsense_makes_a_verdict(seed: int) -> None:
    """Nothing but a ProcedureError may come out of a case, and that is caught: `run` would raise anything else here."""
    rng = random.Random(seed)
    places = [(variable.index, variable.subindex) for variable in full_device()]
    changes: dict[tuple[int, int], dict[str, Any] | None] = {}
    for place in rng.sample(places, 40):
        field, values = rng.choice(CHANGES)
        changes[place] = rng.choice(({field: rng.choice(values)}, {field: rng.choice(values)}, None))
    nonsense = altered(changes)
    device = Fault("sound", dictionary=full_device()) if seed % 2 else None
    for case in rng.sample(CASES, 15):
        assert Site(device, nonsense, stimulus=False).run(case).result in tuple(Result)
