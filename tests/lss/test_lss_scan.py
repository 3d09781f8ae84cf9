"""Fastscan and search: which devices they find, with how many frames, with loss and late answers."""

from __future__ import annotations

from functools import partial

import pytest

from canopen_proto.frame import Frame
from canopen_proto.lss.messages import LssAddress, LssService, LssState
from canopen_proto.lss.scan import (
    BITS,
    LssError,
    LssFound,
    LssProgress,
    Pace,
    duration_of,
    fastscan,
    search,
    survey,
)
from canopen_proto.lss.slave import LssSlave
from canopen_proto.machine import MILLISECOND, LocalProtocolError, Outbox, Time
from tests.lss.lss_bench import QUICK, LssBench, random_addresses

TYPE = (0x360, 0x2, 0x10003)
scene = partial(LssBench, bare=True)


@pytest.mark.parametrize(
    ("known", "frames"),
    [
        ((None, None, None, None), 133),
        ((*TYPE, None), 37),
        ((*TYPE, 0xC0FFEE), 5),
        ((0x360, None, None, None), 101),
    ],
)
def test_a_fastscan_needs_the_least_number_of_frames(known: tuple[int | None, ...], frames: int) -> None:
    bench = scene([LssAddress(*TYPE, 0xC0FFEE)])
    assert bench.run(fastscan(bench.tool, bench.pace, known)) == (*TYPE, 0xC0FFEE)  # type: ignore[arg-type]
    assert bench.sent(LssService.FASTSCAN) == frames
    assert bench.slaves[0].state is LssState.CONFIGURATION
    assert [event.done for event in bench.events if isinstance(event, LssProgress)] == [1, 2, 3, 4]


@pytest.mark.parametrize("number", [0, 0xFFFF_FFFF, 1, 0x8000_0000])
def test_numbers_at_the_ends_of_their_range(number: int) -> None:
    address = LssAddress(number, number, number, number)
    bench = scene([address])
    assert bench.run(survey(bench.tool, bench.pace)).found == [address]


@pytest.mark.thorough(3)
@pytest.mark.parametrize(("count", "seed"), [(1, 1), (1, 2), (3, 3), (3, 4), (20, 5)])
def test_a_survey_finds_all_devices_without_a_node_id(count: int, seed: int) -> None:
    addresses = random_addresses(count, seed)
    bench = scene(addresses, together=True)
    bench.add(LssAddress(1, 2, 3, 4), 5)  # it has a node-ID
    result = bench.run(survey(bench.tool, bench.pace))
    assert (result.found, result.again) == (sorted(addresses), None)
    assert [event.address for event in bench.events if isinstance(event, LssFound)] == sorted(addresses)
    assert bench.sent(LssService.FASTSCAN) == 133 * count + 3  # it asks three times whether anybody is left
    assert bench.none_is_selected
    assert bench.ids == [255] * count + [5]


def test_two_that_differ_in_the_last_bit_only() -> None:
    addresses = [LssAddress(*TYPE, 6), LssAddress(*TYPE, 7), LssAddress(*TYPE, 0xFFFF_FFFF)]
    bench = scene(addresses[::-1])
    assert bench.run(survey(bench.tool, bench.pace)).found == addresses


def test_known_numbers_choose_the_devices() -> None:
    bench = scene([LssAddress(*TYPE, 1), LssAddress(0x29C, 2, 3, 1), LssAddress(*TYPE, 9)])
    assert [each.serial for each in bench.run(survey(bench.tool, bench.pace, (0x360, None, None, None))).found] == [1, 9]
    assert bench.run(survey(bench.tool, bench.pace, (*TYPE, 5))).found == []
    assert bench.none_is_selected


def test_nobody_is_there() -> None:
    bench = scene([LssAddress(1, 2, 3, 4)], [5])
    assert bench.run(survey(bench.tool, bench.pace)).found == []
    assert bench.bus.now < 50 * QUICK


@pytest.mark.thorough(3)
@pytest.mark.parametrize("seed", range(8))
def test_any_answers_may_be_lost_or_come_late(seed: int) -> None:
    addresses = random_addresses(3, seed, TYPE[:2])
    bench = scene(addresses, seed=seed, loss=0.004, delay=(100_000, 4 * MILLISECOND))
    found = bench.run(survey(bench.tool, bench.pace, (*TYPE[:2], None, None))).found
    assert sorted(found) == sorted(addresses)


@pytest.mark.parametrize("late", [2 * MILLISECOND, QUICK - MILLISECOND, QUICK + MILLISECOND, 3 * QUICK])
def test_one_slow_device_among_quick_ones(late: Time) -> None:
    addresses = random_addresses(3, 5, TYPE[:2])
    bench = scene(addresses)
    bench.bus.slow[1] = late
    assert bench.run(survey(bench.tool, bench.pace, (*TYPE[:2], None, None))).found == sorted(addresses)


@pytest.mark.thorough(6)
@pytest.mark.parametrize("frame", range(84))
def test_any_one_frame_may_be_lost(frame: int) -> None:
    addresses = [LssAddress(*TYPE, 0x1234_5678), LssAddress(*TYPE, 0x9234_5678)]
    bench = scene(addresses, lose=[frame])
    assert sorted(bench.run(survey(bench.tool, bench.pace, (*TYPE, None))).found) == addresses
    assert bench.none_is_selected


class Stubborn(LssSlave):
    """A slave that takes part in fastscans in "configuration", too, as CANopenNode's."""

    def receive(self, frame: Frame, now: Time) -> None:
        state = self.state
        if frame.data[0] == LssService.FASTSCAN:
            self.state = LssState.WAITING
            super().receive(frame, now)
            self.state = LssState(max(state, self.state))
        else:
            super().receive(frame, now)


def test_a_device_that_takes_part_though_it_is_selected_ends_the_survey() -> None:
    bench = scene([LssAddress(0x999, 1, 1, 1)])
    bench.bus.attach(Stubborn(Outbox(), LssAddress(1, 2, 3, 4)))
    result = bench.run(survey(bench.tool, bench.pace))
    assert (result.found, result.again) == ([(1, 2, 3, 4)], (1, 2, 3, 4))
    assert bench.none_is_selected


class NoFastscan(LssSlave):
    def receive(self, frame: Frame, now: Time) -> None:
        if frame.data[0] != LssService.FASTSCAN:
            super().receive(frame, now)


class LikeCanopenNode(LssSlave):
    """It does not know "who has no node-ID?" (0x4C)."""

    def receive(self, frame: Frame, now: Time) -> None:
        if frame.data[0] != LssService.IDENTIFY_NON_CONFIGURED:
            super().receive(frame, now)


@pytest.mark.parametrize("lost", [{2}, {2, 4}, {4}])
def test_a_device_that_knows_only_fastscan_is_found_though_the_first_questions_are_lost(lost: set[int]) -> None:
    bench = scene([], lose=lost)
    bench.bus.attach(LikeCanopenNode(Outbox(), LssAddress(1, 2, 3, 4)))
    assert bench.run(survey(bench.tool, bench.pace)).found == [(1, 2, 3, 4)]
    asked = [frame.data[0] for number, (_, frame) in enumerate(bench.bus.sent) if number in lost]
    assert LssService.FASTSCAN in asked


def test_devices_without_fastscan_are_told_of() -> None:
    bench = scene([])
    bench.bus.attach(NoFastscan(Outbox(), LssAddress(1, 2, 3, 4)))
    with pytest.raises(LssError, match="do not take part in a fastscan"):
        bench.run(survey(bench.tool, bench.pace))


def test_a_survey_that_is_cancelled_leaves_nobody_selected() -> None:
    bench = scene(random_addresses(2, 1, TYPE))
    request_id = bench.network.run(survey(bench.tool, bench.pace, (*TYPE, None)), bench.bus.now)
    bench.bus.run_until(lambda: not bench.none_is_selected)
    bench.network.cancel(request_id, bench.bus.now)
    bench.end_of(request_id)
    bench.bus.run(MILLISECOND)
    assert bench.none_is_selected


def test_a_search_finds_all_devices_of_a_type_with_and_without_a_node_id() -> None:
    addresses = [LssAddress(*TYPE, 5), LssAddress(*TYPE, 6), LssAddress(*TYPE[:2], 0xFFFF_FFFF, 0)]
    bench = scene([*addresses, LssAddress(9, 9, 9, 9)], [4])
    assert bench.run(search(bench.tool, bench.pace, *TYPE[:2])) == addresses
    assert bench.run(search(bench.tool, bench.pace, *TYPE[:2], serials=(6, 100))) == addresses[1:2]
    assert bench.run(search(bench.tool, bench.pace, 1, 1)) == []
    with pytest.raises(LocalProtocolError):
        bench.run(search(bench.tool, bench.pace, -1, 1))


@pytest.mark.thorough(3)
@pytest.mark.parametrize("seed", range(6))
def test_a_search_loses_nobody_though_frames_are_lost(seed: int) -> None:
    """Or it says so."""
    addresses = random_addresses(3, seed, TYPE[:2])
    bench = scene(addresses, seed=seed, loss=0.01)
    assert bench.run(search(bench.tool, bench.pace, *TYPE[:2])) == sorted(addresses)


class YesOnce(LssSlave):
    """A slave that answers one question of a search, and no other."""

    has_answered = False

    def receive(self, frame: Frame, now: Time) -> None:
        super().receive(frame, now)
        if frame.data[0] == LssService.IDENTIFY_SERIAL_HIGH and self.has_answered:
            self.out.frames.clear()
        self.has_answered |= bool(self.out.frames)


def test_a_search_says_that_its_answers_make_no_sense() -> None:
    bench = scene([])
    bench.bus.attach(YesOnce(Outbox(), LssAddress(*TYPE, 5)))
    with pytest.raises(LssError, match="in neither half of it"):
        bench.run(search(bench.tool, bench.pace, *TYPE[:2]))


@pytest.mark.parametrize("number", [0, 0xFFFF_FFFF])
def test_the_estimate_of_the_time_has_its_ends_at_all_zeros_and_all_ones(number: int) -> None:
    bench = scene([LssAddress(number, number, number, number)])
    least, greatest = duration_of(pace=bench.pace)
    start = bench.bus.now
    bench.run(survey(bench.tool, bench.pace, limit=1))
    expected = greatest if number else least
    assert abs(bench.bus.now - start - expected) < 0.2 * expected


def test_the_pace_knows_the_slowest_answer_and_loses_its_patience_never() -> None:
    pace = Pace()
    assert (duration_of((1, 2, 3, 4), pace), duration_of((1, 2, 3, None), pace)[1] // pace.window) == (
        (9 * pace.window,) * 2,
        9 + BITS,
    )
    for failures in (0, 1, 0, 2, 0):
        pace.slow_down(failures)  # as loss does it
    assert (pace.window, pace.repeats) == (100 * MILLISECOND, 3)
    for failures in range(10):
        pace.slow_down(failures)
    assert pace.after_answer == pace.window == 2_000 * MILLISECOND


class LateOnce(LssSlave):
    """A slave whose answer about the last bit comes late once: while the master asks "is it this one?"."""

    held: Frame | None = None
    was_late = False

    def receive(self, frame: Frame, now: Time) -> None:
        super().receive(frame, now)
        is_last_bit = frame.data[0] == LssService.FASTSCAN and frame.data[5:] == bytes((0, 3, 3))
        if self.held is not None:
            self.out.frames.append(self.held)
            self.held = None
        elif is_last_bit and self.out.frames and not self.was_late:
            self.was_late = True
            self.held = self.out.frames.pop()


def test_a_late_answer_to_the_last_question_is_not_believed() -> None:
    bench = scene([])
    address = LssAddress(*TYPE, 0x1234_5670)
    slave = bench.bus.attach(LateOnce(Outbox(), address))
    assert bench.run(survey(bench.tool, bench.pace, (*TYPE, None))).found == [address]
    assert slave.was_late
