"""What certified stacks do passes: a device that is right in another way than ours does not fail.

What they do is taken from the published session of CiA's tool (see tests/interop/cct_session.py) and from tests with C stacks.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import pytest

from canopen_check.catalogue import BY_NUMBER, CASES, run_all
from canopen_proto.dictionary import Access, ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.nmt import NmtState
from canopen_proto.verdict import Result
from tests.check import certified_nodes as nodes
from tests.check.certified_nodes import EXPECTS_SYNC, PRODUCES_SYNC, SYNC_PERIOD_US
from tests.check.conformance_rig import Fault, Site, verdict_of
from tests.check.faulty_nodes import SelfStarting
from tests.check.test_conformance_odd_files import altered
from tests.core.full_device import full_device

BRIEF_REGISTER = (("085#1082..(.*)", r"085#108200\1"), ("585#4F011000..000000", "585#4F01100000000000"))
NO_REMOTE = Fault("ignores remote requests, and lets them be allowed", heard=[("[1-4]85#R.", None)])

WITH_SYNC = ["3.6", "3.7", "3.8", "3.12", "3.18", "3.19", "3.20", "6.2", "6.3", "6.4", "6.5", "6.6", "6.7", "6.9", "6.8", "6.10"]
PASSED: Sequence[tuple[Fault, ObjectDictionary | None, Sequence[str]]] = [
    (Fault("starts by itself", node=SelfStarting), None,
     ["3.16", "3.17", "3.18", "3.19", "3.20", "7.102", "7.2", "7.203", "7.204", "7.205", "7.206", "7.207", "9.3", "10.2"]),
    (Fault("produces SYNC by default"), PRODUCES_SYNC, WITH_SYNC),
    (Fault("knows the period of SYNC by default", node=nodes.StateFirst), EXPECTS_SYNC, [*WITH_SYNC, "2.10", "2.11", "4.6"]),
    (Fault("holds on to its settings", node=nodes.FirmSettings), None, ["2.2", "3.22", "3.23", "3.24", "4.7", "4.9", "9.1"]),
    (Fault("one transfer at a time", node=nodes.OneAtATime), None, ["2.18"]),
    (Fault("counts SYNCs from the middle", node=nodes.from_the_middle), None, ["3.6", "3.8", "6.3"]),
    (Fault("counts SYNCs from the start value", node=nodes.after_the_start), None, ["3.6", "3.8", "6.3"]),
    (NO_REMOTE, None, ["3.4", "3.9"]),
]  # fmt: skip
REMARKED: Sequence[tuple[Fault, str, str]] = [
    (Fault("starts by itself", node=SelfStarting), "9.2", "starts by itself"),
    (Fault("starts by itself", node=SelfStarting), "10.1", "starts by itself"),
    (Fault("a lenient mapping", node=nodes.LenientMapping), "3.23", "takes the own value"),
    (Fault("lives", node=nodes.Restless), "4.9", "setting .*, written back, is 02 00 00 00, not 01 00 00 00"),
    (Fault("forgets its errors at once", sent=BRIEF_REGISTER), "5.4", "lacks the generic error"),
    (Fault("forgets its errors at once", sent=BRIEF_REGISTER), "5.5", "is empty"),
]


@pytest.mark.thorough(4)
@pytest.mark.parametrize(("device", "truth", "numbers"), PASSED, ids=lambda value: value.what if isinstance(value, Fault) else "")
def test_what_the_standard_allows_passes(device: Fault, truth: ObjectDictionary | None, numbers: Sequence[str]) -> None:
    verdicts = {number: verdict_of(number, device, truth) for number in numbers}
    lacking = {"3.9"} if device is NO_REMOTE else set()
    assert {number: each for number, each in verdicts.items() if each.result is not Result.PASSED and number not in lacking} == {}
    assert all(verdicts[number].result is Result.NOT_APPLICABLE for number in lacking)


@pytest.mark.parametrize(("device", "number", "said"), REMARKED, ids=[f"{number}-{each.what}" for each, number, _ in REMARKED])
def test_what_the_tool_does_not_look_at_is_a_remark(device: Fault, number: str, said: str) -> None:
    verdict = verdict_of(number, device)
    assert verdict.result is Result.REMARK, verdict
    assert verdict.failures == ()
    assert re.search(said, verdict.reason), verdict


@pytest.mark.parametrize("number", ["6.8", "6.10"])
def test_the_period_of_sync_is_put_back(number: str) -> None:
    site = Site(truth=EXPECTS_SYNC)
    assert site.run(BY_NUMBER[number]).result is Result.PASSED
    assert site.result_of(lambda bench: bench.reset()) is None
    assert [site.node.values.store[key] for key in (0x1005_00, 0x1006_00, 0x1019_00)] == [0x80, 10_000, 0]


def fixed(*places: tuple[int, int], access: Access = Access.RO, **change: Any) -> ObjectDictionary:
    """The full device, of which clients cannot write some objects. change: what else is different in them."""
    return altered({place: {"access": access, **change} for place in places})


PDO_TYPES = [(base + number, 2) for base in (0x1400, 0x1800) for number in range(4)]
UNUSUAL: dict[str, tuple[ObjectDictionary, Sequence[str]]] = {
    "its heartbeat time is fixed": (fixed((0x1017, 0), access=Access.CONST, default=1000), ["9.2", "9.3", "9.4", "10.1", "10.4"]),
    "its heartbeat is off for good": (fixed((0x1017, 0), default=0), ["7.2", "7.3", "7.6", "9.2", "9.4"]),
    "guarding cannot be set": (fixed((0x100C, 0), (0x100D, 0)), ["7.2", "7.3", "7.102"]),
    "the nodes that it monitors are fixed": (fixed(*((0x1016, number) for number in range(1, 5))), ["4.2"]),
    "one entry of its monitoring is fixed": (fixed((0x1016, 1)), ["7.104", "7.105", "7.106", "7.107"]),
    "its SYNC period is fixed": (fixed((0x1006, 0)), ["3.6", "6.3"]),
    "its transmission types are fixed": (fixed(*PDO_TYPES), ["5.4", "5.6", "9.3"]),
    "all its PDOs are synchronous": (fixed(*PDO_TYPES, default=1), ["9.3"]),
    "its EMCY inhibit time is 2 s": (full_device(standard_object(0x1015, 20_000)), ["5.4", "5.5", "5.6", "7.6", "7.106"]),
    "a PDO has a CAN-ID of 29 bits": (
        full_device(standard_object(0x1400, highest=5, defaults={1: 0x2000_0205, 2: 255})), ["8.10", "9.3"],
    ),
}  # fmt: skip
"""By what is unusual: a device that is right, and cases that it passes."""


@pytest.mark.thorough(4)
@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize("what", UNUSUAL)
def test_a_right_device_that_is_unusual_fails_nowhere(what: str, strict: bool) -> None:
    truth, passed = UNUSUAL[what]
    results = Site(truth=truth, strict=strict).result_of(lambda bench: run_all(bench))
    verdicts = {case.number: verdict for case, verdict in results}
    assert {number: each.failures for number, each in verdicts.items() if each.result is Result.FAILED} == {}
    assert {number: str(verdicts[number]) for number in passed if verdicts[number].result is not Result.PASSED} == {}


def test_what_the_file_forbids_is_no_refusal_of_the_device() -> None:
    verdict = verdict_of("7.103", truth=fixed((0x1017, 0), access=Access.CONST, default=1000))
    assert verdict.result is Result.NOT_APPLICABLE
    assert verdict.reason == "producer_heartbeat_time (0x1017:00) cannot be written: it is const in the file"


def test_an_error_history_that_cannot_be_cleared_is_wrong_whatever_the_file_says() -> None:
    verdict = verdict_of("5.6", truth=fixed((0x1003, 0)))
    assert verdict.failures == ("clearing 0x1003:00 was refused with 0x06010002",)


def certified_site(**more: Any) -> Site:
    return Site(Fault("all together", node=nodes.certified, sent=BRIEF_REGISTER), PRODUCES_SYNC, **more)


def test_a_certified_device_fails_nowhere() -> None:
    site = certified_site()
    results = site.result_of(lambda bench: run_all(bench))
    assert [case for case, _ in results] == list(CASES)
    assert {case.number: verdict.failures for case, verdict in results if verdict.result is Result.FAILED} == {}
    assert {case.number for case, verdict in results if verdict.result is Result.REMARK} == {"5.4", "5.5", "9.2", "10.1"}
    store = site.node.values.store
    assert (store[0x100500], store[0x100600], store[0x101900]) == (0x4000_0080, SYNC_PERIOD_US, 0)  # SYNC was put back
    assert site.node.state is NmtState.PRE_OPERATIONAL


def test_strict_says_more() -> None:
    """Where a strict test asks more, this device does what it may, but for what CiA's tool does not look at."""
    more = [BY_NUMBER[number] for number in ("2.2", "2.13", "4.7", "4.9", "5.2", "5.4", "5.5", "7.101", "9.2", "10.1")]
    results = certified_site(strict=True).result_of(lambda bench: run_all(bench, more))
    failed = {case.number for case, verdict in results if verdict.result is Result.FAILED}
    assert failed == {"5.4", "5.5", "9.2", "10.1"}
