"""Chapter 1, the device's file: a sound one passes, and one with a mistake does not; and devices made of the sample files."""

from __future__ import annotations

import re

import pytest

from canopen_check.catalogue import BY_NUMBER, run_all
from canopen_data.description import DeviceDescription
from canopen_data.descriptions import load_description, read_file
from canopen_data.reading import read_description
from canopen_proto.verdict import Result, Verdict
from tests.check.conformance_rig import Site, verdict_of

SAMPLE = "sample_io.eds"

REASONS = {
    "2.10": "no object has a high limit of its own",
    "2.11": "no object has a low limit of its own",
    **dict.fromkeys(("3.3", "3.9", "3.15"), "no TPDO allows remote requests"),
    "2.29": "no further SDO server has COB-IDs that can be written",
    "3.22": "nothing else can be mapped to RPDO 1",
    "3.23": "nothing else can be mapped to RPDO 1",
    "3.33": "no RPDO could carry a dummy object and another one that can be read back",
    "4.5": "no object has a subindex 255",
    "4.6": "no object has limits of its own",
}
"""Why a case does not apply to a sample, where that is not an object that it has not."""


def with_mistakes(*mistakes: tuple[str, str]) -> DeviceDescription:
    """A sample with some of its text altered."""
    text = read_file(SAMPLE).decode()
    for before, after in mistakes:
        assert before in text
        text = text.replace(before, after, 1)
    return read_description(text.encode(), "faulty.eds")


def verdict_on(description: DeviceDescription) -> Verdict:
    return Site(description=description).run(BY_NUMBER["1.0"])


UNREADABLE = ("LowLimit=0\n", "LowLimit=none\n")
CROSSED = ("LowLimit=0\n", "LowLimit=10001\n")
TWO_BYTES = ("DefaultValue=0x62000108", "DefaultValue=0x62000110")
NO_TYPE = ("DefaultValue=0x00070191", "DefaultValue=0x100070191")
ABSENT = ("DefaultValue=0x60000108", "DefaultValue=0x60000208")
SURPRISING = ("DefaultValue=50\n", "DefaultValue=10001\n")


def test_a_sound_file() -> None:
    assert verdict_on(with_mistakes()) == Verdict(Result.PASSED)
    assert verdict_on(with_mistakes(SURPRISING)) == Verdict(Result.PASSED, "1 warning")


@pytest.mark.parametrize(
    ("mistakes", "said"),
    [
        pytest.param([UNREADABLE], r"faulty\.eds:\d+:\d+: error: .*LowLimit 'none'.*\[value\]", id="reading"),
        pytest.param([CROSSED], r"faulty\.eds:\d+:\d+: error: .*\[limits-crossed\]", id="checking"),
        pytest.param([CROSSED, TWO_BYTES, SURPRISING], r".*\[pdo-bits\]; .*\[limits-crossed\]", id="both errors"),
        pytest.param([CROSSED, TWO_BYTES, NO_TYPE, ABSENT], r"(?:faulty.*?error.*?){4}", id="all of them"),
    ],
)
def test_a_mistake_in_the_file(mistakes: list[tuple[str, str]], said: str) -> None:
    verdict = verdict_on(with_mistakes(*mistakes))
    assert verdict.result is Result.FAILED
    assert re.fullmatch(said, "; ".join(verdict.failures)), verdict


def test_without_a_file() -> None:
    assert verdict_of("1.0") == Verdict(Result.NOT_APPLICABLE, "there is no file of the device")


def test_the_file_is_checked_without_the_device() -> None:
    site = Site(description=load_description(SAMPLE))
    site.world.leave(site.device)
    sent = len(site.world.bus().trace)
    ((_, verdict),) = site.result_of(lambda bench: run_all(bench, [BY_NUMBER["1.0"]]))
    assert verdict.result is Result.PASSED
    assert len(site.world.bus().trace) == sent


@pytest.mark.thorough(2)
@pytest.mark.parametrize("name", [SAMPLE, "sample_drive.eds"])
def test_a_device_made_of_a_sample_passes(name: str) -> None:
    results = Site(description=load_description(name)).result_of(lambda bench: run_all(bench))
    unexpected = [
        (case.number, verdict)
        for case, verdict in results
        if verdict.result is not Result.PASSED
        and not (verdict.result is Result.NOT_APPLICABLE and _is_expected(case.number, verdict.reason))
    ]
    assert unexpected == []


def _is_expected(number: str, reason: str) -> bool:
    return REASONS.get(number) == reason or re.fullmatch("the dictionary has no object 0x1[0-9A-F]{3}", reason) is not None
