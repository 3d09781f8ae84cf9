"""The clock of a world that is simulated in this process: it stands still while the process does, so that nothing is late."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from contextlib import nullcontext

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st

from canopen_master.direct import Session
from canopen_master.direct import connection as direct_connection
from canopen_master.participant.alarm import CoarseAlarm, best_alarm
from canopen_master.participant.patient_clock import AT_ONCE, MADE_UP, PatientClock
from canopen_transports import TransportError
from tests.examples import examples
from tests.master.starved import StarvedClock
from tests.master.test_direct_stalls import outcome, scripted

MUCH = 3 * AT_ONCE
"""Lateness of a task: some looks at the clock, at each of which the processor may have been taken away."""


class Hand:
    """A real time that is set by hand."""

    def __init__(self) -> None:
        self.now = 50.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def hand() -> Hand:
    return Hand()


@pytest.fixture
def clock(hand: Hand) -> PatientClock:
    clock = PatientClock(hand)
    clock.start_clock()
    return clock


def test_time_passes_while_the_loop_sleeps_but_stops_at_the_deadline(clock: PatientClock, hand: Hand) -> None:
    assert clock.deadline_to_sleep_time(0.5) == 0.5
    hand.now += 0.2
    assert clock.current_time() == pytest.approx(0.2)  # woken by a file
    assert clock.deadline_to_sleep_time(0.5) == pytest.approx(0.3)
    hand.now += 100.0
    assert clock.current_time() == 0.5
    assert clock.lost == pytest.approx(99.7 - MADE_UP)


def test_time_goes_on_by_a_little_while_the_loop_works(clock: PatientClock, hand: Hand) -> None:
    for step in range(1, 4):
        hand.now += 7.0
        assert clock.current_time() == pytest.approx(step * AT_ONCE)
    hand.now += AT_ONCE / 2
    assert clock.current_time() == pytest.approx(3.5 * AT_ONCE)


def test_a_deadline_that_is_over_is_no_sleep(clock: PatientClock, hand: Hand) -> None:
    clock.deadline_to_sleep_time(5.0)
    hand.now += 5.0
    clock.current_time()
    clock.deadline_to_sleep_time(2.0)
    hand.now += 1.0
    assert clock.current_time() == pytest.approx(5.0 + AT_ONCE)


def test_it_keeps_pace_with_wake_ups_that_are_a_little_late(clock: PatientClock, hand: Hand) -> None:
    for cycle in range(1, 1001):
        due = cycle * 0.01
        hand.now += clock.deadline_to_sleep_time(due) + 0.0011
        assert clock.current_time() == due
    assert clock.lost == 0.0
    assert hand.now - 50.0 == pytest.approx(10.0, abs=MADE_UP)


def test_without_any_deadline_all_time_passes(clock: PatientClock, hand: Hand) -> None:
    assert clock.deadline_to_sleep_time(float("inf")) == float("inf")
    hand.now += 3600.0
    assert clock.current_time() == pytest.approx(3600.0)
    assert clock.lost == 0.0


def test_another_thread_may_ask_and_changes_nothing(clock: PatientClock, hand: Hand) -> None:
    async def ask() -> float:
        return await trio.to_thread.run_sync(clock.current_time)

    clock.deadline_to_sleep_time(0.5)
    hand.now += 0.2
    assert trio.run(ask) == pytest.approx(0.2)
    hand.now += 100.0
    assert trio.run(ask) == 0.5
    assert clock.current_time() == 0.5


@examples(30)
@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.003, 0.03, 0.3]), st.sampled_from([0.004, 0.1, 5.0]))
def test_whatever_stands_still_no_task_is_late(seed: int, share: float, longest: float) -> None:
    clock = StarvedClock(seed, share, longest)
    chance = random.Random(seed)

    async def sleeper() -> None:
        before = trio.current_time()
        for _ in range(50):
            due = trio.current_time() + chance.choice([0.0002, 0.01, 0.1, 0.5])
            await trio.sleep_until(due)
            now = trio.current_time()
            assert before <= due <= now
            assert now < due + tasks * MUCH
            before = now

    tasks = 4

    async def main() -> None:
        async with trio.open_nursery() as nursery:
            for _ in range(tasks):
                nursery.start_soon(sleeper)
        passed, began = clock.current_time(), 1000.0
        assert clock.real - began == pytest.approx(passed + clock.lost, abs=MADE_UP + 1e-3)

    trio.run(main, clock=clock)


def test_it_has_the_coarse_alarm() -> None:
    """The clock has to know all deadlines."""

    async def body() -> None:
        assert isinstance(best_alarm(), CoarseAlarm)

    trio.run(body, clock=PatientClock())


@examples(10)
@given(st.integers(0, 2**32), st.sampled_from([0.001, 0.01]), st.sampled_from([0.05, 5.0]))
def test_a_script_of_direct_on_a_starved_computer_moves_its_drives_along_its_path(
    seed: int, share: float, longest: float
) -> None:
    async def main() -> None:
        async with scripted(3, 4, waits=True) as script:
            assert await outcome(script, []) is None
            assert script.places() == [round(script.wanted[drive]) for drive in script.arm]

    clock = StarvedClock(seed, share, longest)
    trio.run(main, clock=clock)
    assert clock.lost > 0


@pytest.mark.parametrize(
    ("simulates", "buses", "is_patient"),
    [
        (["virtual:one"], {}, True),
        (["virtual:one"], {"more": "virtual:two"}, True),
        (["virtual"], {}, True),
        (["virtual:one"], {"more": "socketcan:can0"}, False),
        (["udp_multicast"], {}, False),
        ([], {"more": "virtual:two"}, False),
    ],
)
def test_direct_uses_it_only_for_a_world_that_is_in_this_process_as_a_whole(
    monkeypatch: pytest.MonkeyPatch, simulates: list[str], buses: Mapping[str, str], is_patient: bool
) -> None:
    clocks: list[trio.abc.Clock | None] = []

    def background(make: Callable[[], object], failure: object, *, clock: trio.abc.Clock | None) -> None:
        clocks.append(clock)
        raise TransportError("CO110", "a bus", "not opened in this test")

    monkeypatch.setattr(direct_connection, "Background", background)
    session = Session()
    bus = simulates[0] if simulates else "virtual:one"
    with session.simulated([3], bus=bus) if simulates else nullcontext():
        assert not session.open_connection(bus, buses=buses)
    assert [isinstance(clock, PatientClock) for clock in clocks] == [is_patient]
