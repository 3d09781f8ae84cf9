"""Procedures that wait for an event: which one ends a wait, and what it is asked about."""

from __future__ import annotations

from typing import cast

import pytest

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, Time
from canopen_proto.network import Network
from canopen_proto.procedures.runner import ProcedureCancelled
from canopen_proto.procedures.steps import Procedure, StepTimeoutError, Wait, all_of, current_time, sleep, wait_for_event
from tests.core.desk import Desk, assert_idle, cancelled, steps
from tests.core.machines import Alarm, Answered, Heard, Rang


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_wait_for_event_takes_the_kind_that_matches(desk: Desk) -> None:
    second = wait_for_event(desk.alarm, Heard, SECOND, "the frame", lambda heard: heard.frame.data == b"\x02")
    request_id = desk.run(second)
    desk.alarm.set(desk.now)
    desk.wait(0)
    desk.receive("001#01")
    assert desk.outcomes == {}
    desk.receive("001#02")
    assert desk.result(request_id) == Heard(0, "alarm", Frame(1, b"\x02"), None)


def test_news_that_does_not_come_is_a_step_timeout(desk: Desk) -> None:
    request_id = desk.run(wait_for_event(desk.alarm, Heard, 250 * MILLISECOND, "the frame"))
    desk.wait(250 * MILLISECOND)
    error = desk.result(request_id)
    assert isinstance(error, StepTimeoutError)
    assert str(error) == "the frame did not come within 0.25 s"


def test_news_in_time_ends_the_timeout(desk: Desk) -> None:
    def twice() -> Procedure[Time]:
        yield from wait_for_event(desk.alarm, Heard, 10, "the frame")
        yield from sleep(100)
        return (yield from current_time())

    request_id = desk.run(twice())
    desk.wait(9)
    desk.receive("001#")
    desk.wait(1)
    desk.wait(99)
    assert desk.result(request_id) == 109


def test_who_begins_to_wait_because_of_an_event_is_not_told_of_it(desk: Desk) -> None:
    def two() -> Procedure[list[Time]]:
        times = []
        for _ in range(2):
            yield from wait_for_event(desk.alarm, Heard, SECOND, "a frame")
            times.append((yield from current_time()))
        return times

    def after_an_answer() -> Procedure[object]:
        yield from desk.ask("a")
        return (yield Wait(20, None, lambda report: isinstance(report, Answered)))

    request_id, other = desk.run(two()), desk.run(after_an_answer())
    desk.wait(5)
    desk.receive("001#")
    desk.answer("a")
    desk.wait(5)
    desk.receive("001#")
    desk.wait(20)
    assert desk.result(request_id) == [5, 10]
    assert desk.result(other) is None


def test_one_event_is_news_to_all_that_wait(desk: Desk) -> None:
    def heard() -> Procedure[str]:
        return (yield from wait_for_event(desk.alarm, Heard, SECOND, "a frame")).name

    together, alone = desk.run(all_of(heard(), heard())), desk.run(heard())
    desk.receive("001#")
    assert desk.result(together) == ["alarm", "alarm"]
    assert desk.result(alone) == "alarm"


def test_news_of_any_network_where_no_source_is_named(desk: Desk) -> None:
    other = Network(desk.network.runner)
    alarm = Alarm(other.out, "other", [1])
    other.attach(alarm)
    anywhere = desk.run(steps(Wait(None, None, lambda report: isinstance(report, Heard))))
    there = desk.run(steps(Wait(None, alarm, lambda report: isinstance(report, Heard))))
    desk.receive("001#01")
    assert list(desk.outcomes) == [anywhere]
    other.receive(Frame(1), 0)
    other.drain(0)
    desk.drain()
    assert cast(Heard, desk.result(there)).name == "other"


class LoudlyRang(Rang):
    """Another kind of event, though derived from Rang."""

    __slots__ = ()


def test_a_wait_for_some_kinds_is_asked_about_these_only(desk: Desk) -> None:
    asked: list[Event] = []

    def match(report: Event) -> bool:
        asked.append(report)
        return isinstance(report, Heard)

    kinds = [Heard, Rang, Rang]  # one of them twice
    request_id = desk.run(steps(Wait(None, desk.alarm, match, kinds), Wait(10, desk.alarm, match, ())))
    reports = [LoudlyRang(0, "", 1), Answered(1, 99, ""), Rang(0, "", 2), Heard(0, "", Frame(1), None), Rang(0, "", 3)]
    desk.network.out.events.extend(reports)
    desk.drain()
    assert asked == [reports[2], reports[3]]
    desk.wait(10)
    assert desk.result(request_id) is None
    assert_idle(desk)


def test_a_wait_for_some_kinds_ends_by_its_timeout_or_by_a_cancel_as_any_other(desk: Desk) -> None:
    late = desk.run(steps(Wait(10, desk.alarm, lambda report: True, (Rang,))))
    endless = desk.run(steps(Wait(None, desk.alarm, lambda report: True, (Rang,))))
    desk.wait(10)
    desk.network.cancel(endless, desk.now)
    desk.drain()
    assert desk.result(late) is None
    assert cancelled(desk, endless) is None
    desk.network.out.events.append(Rang(0, "", 1))
    desk.drain()


def test_a_wait_that_an_event_lets_begin_does_not_get_this_event(desk: Desk) -> None:
    wait = Wait(None, desk.alarm, lambda report: True, (Rang,))
    request_id = desk.run(steps(wait, wait))
    first, second = Rang(0, "first", 1), Rang(0, "second", 1)
    desk.network.out.events.append(first)
    desk.drain()
    assert desk.outcomes == {}
    desk.network.out.events.append(second)
    desk.drain()
    assert desk.result(request_id) is second


def test_procedures_get_an_event_in_the_order_of_their_start_however_they_wait_for_it(desk: Desk) -> None:
    told: list[str] = []

    def waiting(name: str, kinds: tuple[type[Event], ...] | None, *first: str) -> Procedure[None]:
        for each in first:
            yield from desk.ask(each)
        yield Wait(None, None, lambda report: isinstance(report, Rang), kinds)
        told.append(name)

    desk.run(waiting("a", (Rang,), "begin"))
    desk.run(waiting("b", None))
    desk.run(waiting("c", (Heard, Rang)))
    desk.answer("begin")  # it waits last, and was started first
    desk.alarm.set(3)
    desk.wait(3)
    assert told == ["a", "b", "c"]


def test_a_match_that_raises_fails_its_own_procedure_only(desk: Desk) -> None:
    failing = desk.run(steps(Wait(None, None, lambda report: 1 / 0 > 1)))
    fine = desk.run(steps(Wait(None, None, lambda report: isinstance(report, Rang))))
    desk.alarm.set(3)
    desk.wait(3)
    assert isinstance(desk.result(failing), ZeroDivisionError)
    assert isinstance(desk.result(fine), Rang)


def test_a_wait_without_match_and_timeout_waits_for_ever(desk: Desk) -> None:
    request_id = desk.run(steps(Wait(None)))
    desk.receive("001#")
    desk.wait(1000 * SECOND)
    assert desk.outcomes == {}
    assert desk.network.next_deadline() == NEVER
    desk.network.cancel(request_id, desk.now)
    assert desk.drain() == [ProcedureCancelled(0, request_id, None)]
