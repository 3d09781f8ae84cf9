"""Cancelled procedures whose clean-up takes too long: CLEAN_UP_TIME is shared by its steps, and enforced."""

from __future__ import annotations

import pytest

from canopen_proto.machine import SECOND
from canopen_proto.procedures.runner import CLEAN_UP_TIME, CleanUpTimeoutError
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, act, all_of, sleep
from tests.core.desk import Desk, cancel, cancelled, careful


@pytest.fixture
def desk() -> Desk:
    return Desk()


def test_the_time_for_clean_up_is_shared_by_its_steps(desk: Desk) -> None:
    def slow() -> Procedure[None]:
        try:
            yield from sleep(SECOND)
        except Cancelled:
            for _ in range(100):
                yield from sleep(CLEAN_UP_TIME // 10)

    request_id = desk.run(slow())
    cancel(desk, request_id)
    for _ in range(9):
        desk.wait(CLEAN_UP_TIME // 10)
    assert desk.outcomes == {}
    desk.wait(CLEAN_UP_TIME // 10)
    error = cancelled(desk, request_id)
    assert isinstance(error, CleanUpTimeoutError)
    assert str(error) == "the clean-up did not end within 1 s and was given up"


def test_a_dead_node_holds_nobody_up_and_the_halt_is_taken_back(desk: Desk) -> None:
    request_id = desk.run(careful(desk, "a", "halt"))
    cancel(desk, request_id)
    assert desk.network.next_deadline() == CLEAN_UP_TIME
    desk.wait(CLEAN_UP_TIME)
    assert isinstance(cancelled(desk, request_id), CleanUpTimeoutError)
    assert desk.clerk.log == ["a", "cancel a", "halt!", "cancel halt"]


def test_a_parent_whose_children_take_all_the_time_still_does_what_it_can_do_at_once(desk: Desk) -> None:
    done: list[str] = []

    def parent() -> Procedure[None]:
        try:
            yield from all_of(careful(desk, "a", "halt a"), all_of(careful(desk, "b", "halt b"), sleep(5)))
        except Cancelled:
            yield from act(lambda now: done.append("halt by PDO"))
            yield from all_of(desk.ask("brake"), desk.ask("brake 2"))
            done.append("never")

    request_id = desk.run(parent())
    cancel(desk, request_id)
    desk.wait(CLEAN_UP_TIME)
    assert done == ["halt by PDO"]
    assert isinstance(cancelled(desk, request_id), CleanUpTimeoutError)
    assert desk.clerk.log[-2:] == ["cancel brake", "cancel brake 2"]


def test_a_parent_that_can_do_all_at_once_when_its_children_are_given_up(desk: Desk) -> None:
    request_id = desk.run(all_of(all_of(careful(desk, "a", "halt a"))))
    cancel(desk, request_id)
    desk.wait(CLEAN_UP_TIME)
    assert isinstance(cancelled(desk, request_id), CleanUpTimeoutError)


def test_a_clean_up_side_by_side_is_given_up_with_all_that_it_runs(desk: Desk) -> None:
    log: list[str] = []

    def reluctant(name: str) -> Procedure[None]:
        try:
            yield from all_of(desk.ask(name), sleep(10 * SECOND))
        except Cancelled:
            log.append(name)
            yield from all_of(desk.ask(f"{name} again"), sleep(10 * SECOND))

    def parent() -> Procedure[None]:
        try:
            yield from sleep(SECOND)
        except Cancelled:
            try:
                yield from all_of(reluctant("x"), reluctant("y"), desk.ask("z"))
            except ProcedureError:
                log.append("the parent is closed and not resumed")

    request_id = desk.run(parent())
    cancel(desk, request_id)
    desk.wait(CLEAN_UP_TIME)
    assert isinstance(cancelled(desk, request_id), CleanUpTimeoutError)
    assert "the parent is closed and not resumed" not in log


def test_a_generator_that_waits_in_finally_is_told_and_ended(desk: Desk) -> None:
    def improper() -> Procedure[None]:
        try:
            yield from sleep(10 * SECOND)
        finally:
            yield from sleep(10 * SECOND)

    request_id = desk.run(improper())
    cancel(desk, request_id)  # Cancelled runs the `finally`, which waits: as bad as waiting in `except Cancelled`
    desk.wait(CLEAN_UP_TIME)
    assert isinstance(cancelled(desk, request_id), CleanUpTimeoutError)

    def worse() -> Procedure[None]:
        try:
            try:
                yield from sleep(10 * SECOND)
            except Cancelled:
                yield from sleep(10 * SECOND)
        finally:
            yield from sleep(10 * SECOND)

    request_id = desk.run(worse())
    cancel(desk, request_id)
    desk.wait(CLEAN_UP_TIME)
    assert str(cancelled(desk, request_id)) == "generator ignored GeneratorExit"


def test_a_generator_that_answers_its_closing_with_an_error(desk: Desk) -> None:
    def answering(answer: BaseException) -> Procedure[None]:
        try:
            try:
                yield from sleep(10 * SECOND)
            except Cancelled:
                yield from sleep(10 * SECOND)
        except GeneratorExit:
            raise answer from None

    for answer, told in [(ProcedureError("sorry"), "sorry"), (Cancelled(), "the clean-up did not end")]:
        request_id = desk.run(answering(answer))
        cancel(desk, request_id)
        desk.wait(CLEAN_UP_TIME)
        assert str(cancelled(desk, request_id)).startswith(told)
