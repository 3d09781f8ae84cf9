"""Procedures: steps, their results and failures, side by side and in sequence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import pytest

from canopen_proto.machine import SECOND, LocalProtocolError, Outbox, Time
from canopen_proto.procedures.runner import ProcedureFinished, Runner
from canopen_proto.procedures.steps import (
    Act,
    AllOf,
    Cancelled,
    Procedure,
    ProcedureError,
    Request,
    SdoTransferError,
    Step,
    Wait,
    act,
    all_of,
    current_time,
    download,
    sleep,
    upload,
)
from tests.core.desk import Desk, steps
from tests.core.machines import Answered, Clerk


@pytest.fixture
def desk() -> Desk:
    return Desk()


# ---- the helpers ----


def test_a_procedure_that_waits_for_nothing_ends_at_once(desk: Desk) -> None:
    def at_once() -> Procedure[Time]:
        first = yield from act(lambda now: now + 1)
        second = yield from current_time()
        return first + second

    desk.now = 5
    assert desk.result_of(at_once()) == 11


def test_many_acts_do_not_deepen_the_stack(desk: Desk) -> None:
    def many() -> Procedure[int]:
        total = 0
        for _ in range(5_000):
            total += yield from act(lambda now: 1)
            total += sum((yield from all_of(act(lambda now: 1))))
        return total

    assert desk.result_of(many()) == 10_000


def test_sleep_lasts_as_long_as_said(desk: Desk) -> None:
    request_id = desk.run(sleep(10))
    assert desk.network.next_deadline() == 10
    desk.wait(9)
    assert desk.outcomes == {}
    desk.wait(1)
    assert desk.result(request_id) is None


@pytest.mark.parametrize("duration", [0, -5])
def test_sleeping_for_no_time_is_no_end_of_sleep(desk: Desk, duration: Time) -> None:
    # Each new wake is over already when it is set: the runner must be woken for it all the same.
    def dozing() -> Procedure[int]:
        for _ in range(3):
            yield from sleep(duration)
        return 3

    desk.now = 100
    request_id = desk.run(dozing())
    for _ in range(3):
        assert desk.network.next_deadline() <= desk.now
        desk.wait(0)
    assert desk.result(request_id) == 3


def test_a_request_gives_its_outcome(desk: Desk) -> None:
    def asking() -> Procedure[str]:
        answered = yield from desk.ask("a")
        return answered.name

    first, second = desk.run(asking()), desk.run(desk.ask("b"))
    desk.answer("b")
    assert list(desk.outcomes) == [second]
    desk.answer("a")
    assert desk.result(first) == "a"


def test_an_answer_that_was_reported_before_anybody_drained_is_not_lost(desk: Desk) -> None:
    def hasty() -> Procedure[Answered]:
        def submit(now: Time, urgent: bool) -> int:
            request_id = desk.clerk.ask("a", urgent)
            desk.clerk.answer("a")
            return request_id

        return (yield Request(desk.clerk, submit))

    assert isinstance(desk.result_of(hasty()), Answered)


def test_a_refused_step_raises_in_the_procedure_which_may_go_on(desk: Desk) -> None:
    def refused(now: Time, urgent: bool = False) -> int:
        raise LocalProtocolError("busy")

    def stubborn(step: Step) -> Procedure[str]:
        try:
            yield step
        except LocalProtocolError as error:
            yield from sleep(10)
            return f"was told: {error}"
        return "was told nothing"

    for step in (Act(refused), Request(desk.clerk, refused)):
        request_id = desk.run(stubborn(step))
        desk.wait(10)
        assert desk.result(request_id) == "was told: busy"
        failed = desk.result_of(steps(step))
        assert isinstance(failed, LocalProtocolError)


@pytest.mark.parametrize("nonsense", [None, 5, "wait", sleep, Exception("x"), Wait, Step()])
def test_what_is_not_a_step_is_a_type_error_in_the_procedure(desk: Desk, nonsense: object) -> None:
    error = desk.result_of(steps(nonsense))
    assert isinstance(error, TypeError)
    assert "which is not a step; did it say 'yield' for 'yield from'?" in str(error)


def test_a_forgotten_from_is_told(desk: Desk) -> None:
    def forgetful() -> Procedure[None]:
        yield sleep(5)  # type: ignore[misc]

    assert isinstance(desk.result_of(forgetful()), TypeError)


def test_what_is_no_procedure_fails(desk: Desk) -> None:
    assert isinstance(desk.result_of(cast(Any, None)), AttributeError)
    assert isinstance(desk.result_of(all_of(cast(Any, 5))), AttributeError)
    assert isinstance(desk.result_of(steps(AllOf(cast(Any, 5)))), TypeError)


def test_a_bug_in_a_procedure_is_its_failure(desk: Desk) -> None:
    def buggy() -> Procedure[None]:
        yield from sleep(1)
        raise ZeroDivisionError("of mine")

    request_id = desk.run(buggy())
    desk.wait(1)
    assert isinstance(desk.result(request_id), ZeroDivisionError)


def test_a_procedure_that_raises_cancelled_by_itself_has_failed(desk: Desk) -> None:
    def wrong() -> Procedure[None]:
        yield from sleep(0)
        raise Cancelled

    request_id = desk.run(wrong())
    desk.wait(0)
    assert str(desk.result(request_id)) == "the procedure raised Cancelled, but nobody cancelled it"
    together = desk.run(all_of(wrong()))
    desk.wait(0)
    assert isinstance(desk.result(together), ProcedureError)


# ---- side by side ----


def test_all_of_nothing_is_nothing_at_once(desk: Desk) -> None:
    assert desk.result_of(all_of()) == []


def test_all_of_gives_the_results_in_order_however_they_end(desk: Desk) -> None:
    def named(name: str) -> Procedure[str]:
        return (yield from desk.ask(name)).name

    def timed(duration: Time) -> Procedure[str]:
        yield from sleep(duration)
        return str(duration)

    def at_once() -> Procedure[str]:
        return (yield from act(lambda now: "at once"))

    request_id = desk.run(all_of(named("a"), at_once(), timed(20), named("b"), timed(10)))
    desk.answer("b")
    desk.wait(10)
    desk.answer("a")
    assert desk.outcomes == {}
    desk.wait(10)
    assert desk.result(request_id) == ["a", "at once", "20", "b", "10"]


def test_all_of_may_be_nested_and_repeated(desk: Desk) -> None:
    def tree(depth: int) -> Procedure[int]:
        if depth == 0:
            yield from sleep(1)
            return 1
        total = 0
        for _ in range(2):
            total += sum((yield from all_of(tree(depth - 1), tree(depth - 1), act(lambda now: 0))))
        return total

    request_id = desk.run(tree(3))
    for _ in range(8):
        assert desk.outcomes == {}
        desk.wait(1)
    assert desk.result(request_id) == 4**3


def failing(text: str, before: Callable[[], Procedure[Any]] | None = None) -> Procedure[None]:
    if before is not None:
        yield from before()
    raise ProcedureError(text)


def test_the_first_failure_cancels_the_rest_and_is_raised_when_they_have_cleaned_up(desk: Desk) -> None:
    log: list[str] = []

    def careful(name: str) -> Procedure[None]:
        try:
            yield from desk.ask(name)
        except Cancelled:
            yield from desk.ask(f"halt {name}")
            log.append(f"{name} halted")
            raise

    request_id = desk.run(all_of(careful("a"), failing("broken", lambda: sleep(10)), careful("b"), sleep(SECOND)))
    desk.wait(10)
    assert desk.clerk.log == ["a", "b", "cancel a", "halt a!", "cancel b", "halt b!"]
    assert desk.outcomes == {}
    desk.answer("halt b")
    assert desk.outcomes == {}
    desk.answer("halt a")
    assert log == ["b halted", "a halted"]
    assert str(desk.result(request_id)) == "broken"


def test_the_original_failure_is_raised_not_what_its_siblings_do_then(desk: Desk) -> None:
    def sore_loser() -> Procedure[None]:
        try:
            yield from sleep(SECOND)
        except Cancelled:
            raise ProcedureError("could not halt") from None

    request_id = desk.run(all_of(sore_loser(), failing("broken", lambda: sleep(10)), sore_loser()))
    desk.wait(10)
    error = desk.result(request_id)
    assert str(error) == "broken"
    assert cast(Exception, error).__notes__ == ["and the clean-up of a procedure beside it failed: could not halt"]
    assert cast(Exception, error).__context__ is None


def test_a_failure_at_once_keeps_the_rest_from_beginning(desk: Desk) -> None:
    begun: list[str] = []

    def noted(name: str) -> Procedure[None]:
        begun.append(name)
        yield from sleep(10)

    error = desk.result_of(all_of(noted("a"), failing("broken"), noted("b")))
    assert str(error) == "broken"
    assert begun == ["a"]


def test_a_caught_failure_of_all_of_is_raised_once(desk: Desk) -> None:
    # Siblings that end at once when they are cancelled must not resume their parent a second time.
    def patient() -> Procedure[list[object]]:
        seen: list[object] = []
        for _ in range(2):
            try:
                yield from all_of(sleep(SECOND), failing("broken", lambda: sleep(10)), sleep(SECOND))
            except ProcedureError as error:
                seen.append(str(error))
            yield from sleep(100)
            seen.append((yield from current_time()))
        return seen

    request_id = desk.run(patient())
    for duration in (10, 50, 50, 10, 100):
        desk.wait(duration)
    assert desk.result(request_id) == ["broken", 110, "broken", 220]


def test_a_failure_two_levels_down_cancels_everything_beside_it(desk: Desk) -> None:
    log: list[str] = []

    def noted(name: str) -> Procedure[None]:
        try:
            yield from sleep(SECOND)
        except Cancelled:
            log.append(name)
            raise

    inner = all_of(noted("a"), failing("broken", lambda: sleep(10)))
    request_id = desk.run(all_of(noted("b"), all_of(noted("c"), inner), noted("d")))
    desk.wait(10)
    assert str(desk.result(request_id)) == "broken"
    assert log == ["a", "c", "b", "d"]


def test_a_procedure_may_start_and_await_another(desk: Desk) -> None:
    runner = desk.network.runner

    def second() -> Procedure[str]:
        yield from desk.ask("a")
        return "second"

    def first() -> Procedure[object]:
        outcome = yield Request(runner, lambda now, urgent: runner.start(second(), now))
        assert isinstance(outcome, ProcedureFinished)
        return outcome.result

    request_id = desk.run(first())
    desk.answer("a")
    assert desk.result(request_id) == "second"


def test_a_runner_works_alone() -> None:
    out = Outbox()
    runner = Runner(out)
    clerk = Clerk(out)
    request_id = runner.start(steps(Request(clerk, lambda now, urgent: clerk.ask("a", urgent)), Wait(10)), 0)
    clerk.answer("a")
    (report,) = out.events
    runner.observe(out.root, report, 5)
    assert runner.deadline == 15
    runner.handle_timeout(14)
    assert runner.busy
    runner.handle_timeout(15)
    assert out.events[1:] == [ProcedureFinished(0, request_id, None)]
    assert not runner.busy


# ---- SDO ----


def test_upload_and_download_by_sdo(desk: Desk) -> None:
    def copied() -> Procedure[bytes]:
        data = yield from upload(desk.sdo, 0x6041)
        yield from download(desk.sdo, 0x2000, 1, data)
        return data

    request_id = desk.run(copied())
    desk.receive("58C#4B41600037020000")
    desk.receive("58C#6000200100000000")
    assert desk.sent == ["60C#4041600000000000", "60C#2B00200137020000"]
    assert desk.result(request_id) == b"\x37\x02"


def test_a_refused_transfer_names_node_object_and_reason(desk: Desk) -> None:
    request_id = desk.run(upload(desk.sdo, 0x6041))
    desk.receive("58C#8041600000000206")
    error = desk.result(request_id)
    assert isinstance(error, SdoTransferError)
    assert str(error).startswith("node 12 refused reading 0x6041:00: abort 0x06020000, ")
    assert (error.node_id, error.index, error.subindex, error.abort_code) == (12, 0x6041, 0, 0x06020000)


def test_a_transfer_without_answer_tells_whether_it_may_have_been_executed(desk: Desk) -> None:
    reading = desk.run(upload(desk.sdo, 0x6041))
    desk.wait(desk.sdo.timeout)
    assert str(desk.result(reading)) == "node 12 did not answer reading 0x6041:00"
    writing = desk.run(download(desk.sdo, 0x6040, 0, b"\x06\x00"))
    desk.wait(desk.sdo.timeout)
    assert str(desk.result(writing)) == "node 12 did not answer writing 0x6040:00 (not confirmed: it may have been executed)"


def test_a_transfer_that_was_given_up_here_says_so(desk: Desk) -> None:
    request_id = desk.run(download(desk.sdo, 0x6040, 0, b"\x06\x00"))
    desk.sdo.abort_all(0x08000022, desk.now)
    desk.drain()
    assert str(desk.result(request_id)).startswith("writing 0x6040:00 of node 12 was given up: 0x08000022, ")
