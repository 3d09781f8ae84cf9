"""A loaded computer makes no device fail: the verdict of a case that goes by time, whatever pauses our own process makes."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_check.bench import Bench
from canopen_check.case import Case
from canopen_check.catalogue import BY_NUMBER
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.network import Network
from canopen_proto.procedures.steps import Procedure
from canopen_proto.verdict import Result, Verdict, ViolationError
from tests.check.conformance_rig import Fault, Site
from tests.examples import examples

BY_TIME = ["3.5", "6.2", "6.7", "7.6", "7.102", "7.103", "7.105", "7.106", "7.107", "7.204", "7.207", "9.3"]

Pauses = list[tuple[int, int]]
"""How long, in ms, our process runs, and how long it then stands still; from the beginning when it is through."""


class Halting(Network):
    """A network whose driver stands still now and then: frames wait, deadlines pass; then it goes on as the master's pump does,
    with the frames first. pauses: none, if empty."""

    pauses: Pauses = []

    def __init__(self) -> None:
        super().__init__()
        self._waiting: list[Frame] = []
        self._wakes: Time = NEVER

    def _still_until(self, now: Time) -> Time:
        """When the pause ends that we are in; `now` where we are in none."""
        cycle = sum(runs + stands for runs, stands in self.pauses) * MILLISECOND
        begin = now - now % cycle if cycle else now
        for runs, stands in self.pauses:
            begin += runs * MILLISECOND
            if now < begin:
                return now
            begin += stands * MILLISECOND
            if now < begin:
                return begin
        return now

    def receive(self, frame: Frame, now: Time, timestamp: int | None = None) -> None:
        end = self._still_until(now)
        if end > now:
            self._waiting.append(frame)
            self._wakes = min(self._wakes, end)
        else:
            self._catch_up(now)
            super().receive(frame, now, timestamp)

    def _catch_up(self, now: Time) -> None:
        waiting, self._waiting, self._wakes = self._waiting, [], NEVER
        for frame in waiting:
            super().receive(frame, now)

    def next_deadline(self) -> Time:
        deadline = min(super().next_deadline(), self._wakes)
        return deadline if deadline == NEVER else self._still_until(deadline)

    def handle_timeout(self, now: Time) -> None:
        if self._still_until(now) > now:
            return
        self._catch_up(now)
        super().handle_timeout(now)


def verdict_with(pauses: Pauses, number: str, fault: Fault | None = None) -> Verdict:
    site = Site(fault, master=Halting())
    assert isinstance(site.tester.runs, Halting)
    site.tester.runs.pauses = pauses
    return site.run(BY_NUMBER[number])


@examples(25)
@given(
    number=st.sampled_from(BY_TIME),
    pauses=st.lists(st.tuples(st.integers(1, 3000), st.integers(1, 700)), min_size=1, max_size=6),
)
def test_whatever_pauses_we_make_a_sound_device_never_fails(number: str, pauses: Pauses) -> None:
    verdict = verdict_with(pauses, number)
    assert verdict.result in (Result.PASSED, Result.NOT_JUDGED), verdict
    assert verdict.result is Result.PASSED or "this computer was late by" in verdict.reason


def test_a_pause_that_passes_is_no_remark() -> None:
    """The case is run again. A heartbeat each 100 ms, heard by a process that stands still when the count begins and ends."""
    for runs in range(0, 1000, 130):
        assert verdict_with([(runs, 900), (3_600_000, 1)], "7.105").result is Result.PASSED


SLOW = Fault("slow", heard=[("605#2B17100064000000", "605#2B17100078000000")])
MUTE = Fault("mute", sent=[("705#7F", None)])
GOES_ON = Fault("goes on", heard=[("605#2B17100000000000", "605#2B17100064000000")])


@pytest.mark.parametrize(
    ("number", "fault", "stands", "said"),
    [
        ("7.102", SLOW, 15, r"one each 1\d\d\.\d ms; the period is 100 ms . 10%"),
        ("7.102", MUTE, 15, "came 0 times"),
        ("7.103", GOES_ON, 15, "the heartbeat time is 0"),
        ("7.103", GOES_ON, 300, "the heartbeat time is 0"),  # wrong at any time
    ],
)
def test_a_faulty_device_fails_though_we_pause_a_little(number: str, fault: Fault, stands: int, said: str) -> None:
    """What is too late needs a process that is on time; what is wrong in itself does not."""
    verdict = verdict_with([(50, stands)], number, fault)
    assert verdict.result is Result.FAILED
    assert re.search(said, verdict.reason), verdict


def test_a_case_that_stores_is_run_once() -> None:
    """It may have left other values than it found: a second run would put those back."""
    deaf = Fault("no SYNC", sent=[("080#..", None)])
    verdict = verdict_with([(400, 600)], "6.8", deaf)
    assert verdict.result is Result.NOT_JUDGED
    assert "a SYNC did not come within 1 s" in verdict.reason


NO_ANSWER = Fault("no answer about 0x1008", sent=[("585#..081000.*", None)])
SOUND = Fault("none")


def wrong_and(look: str) -> Case:
    """A case that notes a certain failure, then waits for what the fault keeps away, or measures a period of 10 ms."""

    def body(bench: Bench) -> Procedure[None]:
        if look.startswith("wrong, "):
            bench.notes.fail(ViolationError("0x2000:00 was not refused"))
        if look.endswith("boot-up"):
            yield from bench.await_boot_up()
        elif look.endswith("answer"):
            yield from bench.read(0x1008)
        else:
            yield from bench.write(0x1017, 0, 110)
            yield from bench.expect_period(bench.error_control_key, 1000 * MILLISECOND, 10 * MILLISECOND, "the heartbeat")

    return Case("0.1", "Test 01", look, body)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("stands", [0, 15, 25, 150, 600, 3000])
@pytest.mark.parametrize("certain", [False, True])
@pytest.mark.parametrize(
    ("look", "fault", "said", "excuse"),
    [
        ("boot-up", SOUND, "the boot-up frame did not come within 5 s", 1000),
        ("answer", NO_ANSWER, "node 5 did not answer reading 0x1008:00", 200),
        ("period", SOUND, "the period is 10 ms", 20),
    ],
)
def test_two_failures_at_once(look: str, fault: Fault, said: str, excuse: int, certain: bool, stands: int) -> None:
    """Our lateness never takes away what is certain, and excuses a wait only if it is of the order of that wait."""
    site = Site(fault, master=Halting())
    assert isinstance(site.tester.runs, Halting)
    site.tester.runs.pauses = [(50, stands)] if stands else []
    verdict = site.run(wrong_and(f"wrong, {look}" if certain else look))
    is_excused = stands > excuse
    assert ("0x2000:00 was not refused" in verdict.failures) is certain
    assert any(said in each for each in verdict.failures) is not is_excused
    assert any(said in each for each in verdict.remarks) is is_excused
    assert verdict.result is (Result.NOT_JUDGED if is_excused and not certain else Result.FAILED)
