"""Procedures that are cancelled: what is taken back, who cleans up when, and cancelling by their own code."""

from __future__ import annotations

import pytest

from canopen_proto.machine import SECOND, LocalProtocolError, RequestId, Time
from canopen_proto.procedures.runner import (
    CLEAN_UP_TIME,
    CleanUpTimeoutError,
    ProcedureCancelled,
    ProcedureFailed,
    ProcedureFinished,
)
from canopen_proto.procedures.steps import (
    Cancelled,
    Procedure,
    ProcedureError,
    Request,
    Wait,
    act,
    all_of,
    download,
    sleep,
    upload,
    wait_for_event,
)
from tests.core.desk import Desk, assert_idle, cancel, cancelled, careful, steps
from tests.core.machines import Heard


@pytest.fixture
def desk() -> Desk:
    return Desk()


# ---- what is under way is taken back ----


def test_a_request_is_taken_back_before_the_clean_up_whose_requests_are_urgent(desk: Desk) -> None:
    request_id = desk.run(careful(desk, "a", "halt", "brake"))
    cancel(desk, request_id)
    assert desk.clerk.log == ["a", "cancel a", "halt!"]
    desk.answer("halt")
    assert desk.outcomes == {}
    desk.answer("brake")
    assert desk.clerk.log[3:] == ["brake!"]
    assert cancelled(desk, request_id) is None


def test_a_transfer_under_way_is_aborted_on_the_wire_and_the_clean_up_goes_first(desk: Desk) -> None:
    def moving() -> Procedure[None]:
        try:
            yield from upload(desk.sdo, 0x6041)
        except Cancelled:
            yield from download(desk.sdo, 0x6040, 0, b"\x0f\x01")
            raise

    others = [desk.run(upload(desk.sdo, 0x1000, subindex)) for subindex in range(2)]
    request_id = desk.run(moving())
    desk.receive("58C#4300100000000000")
    desk.receive("58C#4300100100000000")
    assert [desk.outcomes[other].request_id for other in others] == others
    waiting = desk.run(upload(desk.sdo, 0x1001))
    cancel(desk, request_id)
    # Taking the running one back lets the next one in the queue go; the halt is next, before all that come later.
    later = desk.run(upload(desk.sdo, 0x1002))
    desk.receive("58C#4F01100000000000")
    desk.receive("58C#6040600000000000")
    desk.receive("58C#4302100000000000")
    assert desk.sent[2:] == [
        "60C#4041600000000000", "60C#8041600000000008", "60C#4001100000000000",
        "60C#2B4060000F010000", "60C#4002100000000000",
    ]  # fmt: skip
    assert isinstance(desk.outcomes[waiting], ProcedureFinished)
    assert isinstance(desk.outcomes[later], ProcedureFinished)
    assert cancelled(desk, request_id) is None


def test_an_answer_that_comes_after_the_cancel_is_nobodys(desk: Desk) -> None:
    request_id = desk.run(careful(desk, "a", "halt"))
    desk.clerk.answer("a")  # reported, but not yet fed
    desk.network.cancel(request_id, 0)
    assert desk.clerk.log == ["a", "halt!"]
    desk.drain()
    assert desk.outcomes == {}
    desk.answer("halt")
    assert cancelled(desk, request_id) is None


def test_clean_up_may_swallow_the_cancel_and_is_cancelled_all_the_same(desk: Desk) -> None:
    def stubborn() -> Procedure[int]:
        try:
            yield from sleep(SECOND)
        except Cancelled:
            yield from sleep(10)
        return 5

    request_id = desk.run(stubborn())
    cancel(desk, request_id)
    desk.wait(10)
    assert cancelled(desk, request_id) is None


def test_an_error_in_the_clean_up_is_told(desk: Desk) -> None:
    def clumsy() -> Procedure[None]:
        try:
            yield from sleep(SECOND)
        except Cancelled:
            raise ProcedureError("could not halt") from None

    request_id = desk.run(clumsy())
    cancel(desk, request_id)
    assert str(cancelled(desk, request_id)) == "could not halt"


def test_an_except_exception_does_not_swallow_the_cancel(desk: Desk) -> None:
    def greedy() -> Procedure[None]:
        while True:
            try:
                yield from sleep(10)
            except Exception:  # noqa: BLE001
                continue

    request_id = desk.run(greedy())
    cancel(desk, request_id)
    assert cancelled(desk, request_id) is None


def test_cancelling_twice_does_nothing_more(desk: Desk) -> None:
    request_id = desk.run(careful(desk, "a", "halt"))
    desk.wait(5)
    cancel(desk, request_id)
    desk.wait(CLEAN_UP_TIME - 1)
    cancel(desk, request_id)
    assert desk.clerk.log == ["a", "cancel a", "halt!"]
    desk.wait(1)  # counted from the first cancel
    assert isinstance(cancelled(desk, request_id), CleanUpTimeoutError)
    cancel(desk, request_id)
    assert_idle(desk)


# ---- side by side ----


def test_children_are_cancelled_and_have_cleaned_up_before_their_parent(desk: Desk) -> None:
    def arm() -> Procedure[None]:
        try:
            yield from all_of(careful(desk, "a", "halt a"), careful(desk, "b"), careful(desk, "c", "halt c"))
        except Cancelled:
            yield from desk.ask("brake")
            raise

    request_id = desk.run(arm())
    cancel(desk, request_id)
    assert desk.clerk.log[3:] == ["cancel a", "halt a!", "cancel b", "cancel c", "halt c!"]
    desk.answer("halt c", "halt a")
    assert desk.clerk.log[8:] == ["brake!"]
    assert desk.outcomes == {}
    desk.answer("brake")
    assert cancelled(desk, request_id) is None


def test_children_that_end_at_once_let_the_parent_clean_up_once(desk: Desk) -> None:
    times: list[str] = []

    def parent() -> Procedure[None]:
        try:
            yield from all_of(sleep(SECOND), all_of(sleep(SECOND), sleep(SECOND)), desk.ask("a"))
        except Cancelled:
            times.append("cleaned up")
            raise

    request_id = desk.run(parent())
    cancel(desk, request_id)
    assert times == ["cleaned up"]
    assert cancelled(desk, request_id) is None


def test_clean_up_may_go_side_by_side_and_all_of_it_is_urgent(desk: Desk) -> None:
    def arm() -> Procedure[None]:
        try:
            yield from sleep(SECOND)
        except Cancelled:
            names = yield from all_of(careful(desk, "halt a"), careful(desk, "halt b"))
            yield from desk.ask(" ".join(names))
            raise

    request_id = desk.run(arm())
    cancel(desk, request_id)
    assert desk.clerk.log == ["halt a!", "halt b!"]
    desk.answer("halt b", "halt a")
    assert desk.clerk.log[2:] == ["halt a halt b!"]
    desk.answer("halt a halt b")
    assert cancelled(desk, request_id) is None


def test_a_failure_side_by_side_in_the_clean_up_is_the_clean_up_error(desk: Desk) -> None:
    def broken() -> Procedure[None]:
        yield from sleep(5)
        raise ProcedureError("no halt")

    def arm() -> Procedure[None]:
        try:
            yield from sleep(SECOND)
        except Cancelled:
            yield from all_of(careful(desk, "halt a", "brake a"), broken())

    request_id = desk.run(arm())
    cancel(desk, request_id)
    desk.wait(5)
    desk.answer("brake a")
    assert desk.clerk.log == ["halt a!", "cancel halt a", "brake a!"]
    assert str(cancelled(desk, request_id)) == "no halt"


def test_an_error_in_a_childs_clean_up_is_told_by_its_parent(desk: Desk) -> None:
    def clumsy() -> Procedure[None]:
        try:
            yield from sleep(SECOND)
        except Cancelled:
            raise ProcedureError("could not halt") from None

    request_id = desk.run(all_of(sleep(SECOND), all_of(clumsy(), sleep(SECOND))))
    cancel(desk, request_id)
    assert str(cancelled(desk, request_id)) == "could not halt"


def test_cancelled_while_a_failures_siblings_clean_up(desk: Desk) -> None:
    def broken() -> Procedure[None]:
        yield from sleep(5)
        raise ProcedureError("broken")

    def parent() -> Procedure[None]:
        try:
            yield from all_of(broken(), careful(desk, "a", "halt a"))
        except Cancelled:
            yield from desk.ask("brake")
            raise

    request_id = desk.run(parent())
    desk.wait(5)
    desk.wait(5)
    cancel(desk, request_id)
    assert desk.outcomes == {}
    desk.answer("halt a")
    desk.answer("brake")
    assert cancelled(desk, request_id) is None
    assert desk.clerk.log == ["a", "cancel a", "halt a!", "brake!"]


def test_a_child_cannot_be_cancelled_from_outside(desk: Desk) -> None:
    request_id = desk.run(all_of(sleep(5), sleep(10)))
    for number in range(request_id + 1, request_id + 5):
        cancel(desk, number)
    desk.wait(9)
    assert desk.outcomes == {}
    desk.wait(1)
    assert isinstance(desk.outcomes[request_id], ProcedureFinished)


def test_news_that_cancels_is_no_news_to_the_clean_up(desk: Desk) -> None:
    def failing() -> Procedure[None]:
        yield from wait_for_event(desk.alarm, Heard, SECOND, "a frame")
        raise ProcedureError("heard")

    def waiting() -> Procedure[None]:
        try:
            yield from wait_for_event(desk.alarm, Heard, SECOND, "a frame")
        except Cancelled:
            yield from wait_for_event(desk.alarm, Heard, SECOND, "another frame")
            raise

    request_id = desk.run(all_of(failing(), waiting()))
    desk.receive("001#")
    assert desk.outcomes == {}
    desk.receive("001#")
    assert isinstance(desk.outcomes[request_id], ProcedureFailed)
    assert_idle(desk)


def test_a_clean_up_error_that_a_failure_bore_is_not_told_twice(desk: Desk) -> None:
    def failing() -> Procedure[None]:
        yield from sleep(5)
        raise ProcedureError("broken")

    def clumsy() -> Procedure[None]:
        try:
            yield from sleep(SECOND)
        except Cancelled:
            raise ProcedureError("could not halt") from None

    def parent() -> Procedure[None]:
        try:
            yield from all_of(failing(), clumsy())
        except ProcedureError:
            yield from all_of(sleep(1), sleep(2))  # and what failed before is over
            yield from sleep(SECOND)

    request_id = desk.run(parent())
    for _ in range(3):
        desk.wait(5)
    assert desk.outcomes == {}
    cancel(desk, request_id)
    assert cancelled(desk, request_id) is None


# ---- by its own code ----


def test_cancelled_by_its_own_step(desk: Desk) -> None:
    ids: list[RequestId] = []

    def suicidal() -> Procedure[None]:
        yield from sleep(5)
        try:
            yield from act(lambda now: desk.network.cancel(ids[0], now))
        except Cancelled:
            yield from desk.ask("halt")
            raise

    ids.append(desk.run(suicidal()))
    desk.wait(5)
    desk.answer("halt")
    assert cancelled(desk, ids[0]) is None
    assert desk.clerk.log == ["halt!"]


def test_cancelled_by_the_request_that_it_makes(desk: Desk) -> None:
    ids: list[RequestId] = []

    def submit(now: Time, urgent: bool) -> RequestId:
        desk.network.cancel(ids[0], now)
        return desk.clerk.ask("a", urgent)

    def suicidal() -> Procedure[None]:
        yield from sleep(5)
        yield Request(desk.clerk, submit)

    ids.append(desk.run(suicidal()))
    desk.wait(5)
    assert desk.clerk.log == ["a", "cancel a"]
    assert cancelled(desk, ids[0]) is None


def test_cancelled_by_a_step_that_is_refused_too(desk: Desk) -> None:
    ids: list[RequestId] = []

    def refuse(now: Time) -> None:
        desk.network.cancel(ids[0], now)
        raise LocalProtocolError("no")

    def suicidal() -> Procedure[None]:
        yield from sleep(5)
        yield from act(refuse)

    ids.append(desk.run(suicidal()))
    desk.wait(5)
    assert cancelled(desk, ids[0]) is None


@pytest.mark.parametrize("last", [False, True], ids=["then a step", "then its end"])
def test_cancelled_by_its_own_code_between_steps(desk: Desk, last: bool) -> None:
    ids: list[RequestId] = []
    seen: list[str] = []

    def suicidal() -> Procedure[None]:
        yield from sleep(5)
        desk.network.cancel(ids[0], desk.now)
        if not last:
            try:
                yield from desk.ask("never asked")
            except Cancelled:
                seen.append("cancelled at the next yield")
                raise

    ids.append(desk.run(suicidal()))
    desk.wait(5)
    assert cancelled(desk, ids[0]) is None
    assert desk.clerk.log == []
    assert seen == ([] if last else ["cancelled at the next yield"])


@pytest.mark.parametrize("directly", [False, True], ids=["in a step", "in its code"])
@pytest.mark.parametrize("delay", [0, 5])
def test_a_child_that_cancels_the_whole(desk: Desk, directly: bool, delay: Time) -> None:
    ids: list[RequestId] = []

    def killer() -> Procedure[None]:
        if delay:
            yield from sleep(delay)
        try:
            if directly:
                desk.network.cancel(ids[0], desk.now)
                yield from desk.ask("never asked")
            else:
                yield from act(lambda now: desk.network.cancel(ids[0], now))
        except Cancelled:
            yield from desk.ask("halt k")
            raise

    def parent() -> Procedure[None]:
        yield from sleep(1)
        try:
            yield from all_of(careful(desk, "a", "halt a"), killer(), careful(desk, "b", "halt b"))
        except Cancelled:
            yield from all_of(careful(desk, "brake 1"), careful(desk, "brake 2"))
            raise

    ids.append(desk.run(parent()))
    desk.wait(1)
    desk.wait(delay)
    if delay == 0:  # b had not begun: it has nothing to clean up
        assert "b" not in desk.clerk.log
    else:
        desk.answer("halt b")
    desk.answer("halt k", "halt a")
    assert desk.outcomes == {}
    desk.answer("brake 2", "brake 1")
    assert cancelled(desk, ids[0]) is None
    assert desk.clerk.log[-2:] == ["brake 1!", "brake 2!"]


def test_two_procedures_are_independent(desk: Desk) -> None:
    first, second = desk.run(careful(desk, "a", "halt a")), desk.run(careful(desk, "b"))
    third = desk.run(steps(Wait(None)))
    cancel(desk, first)
    desk.answer("b")
    assert isinstance(desk.outcomes[second], ProcedureFinished)
    desk.answer("halt a")
    assert isinstance(desk.outcomes[first], ProcedureCancelled)
    assert third not in desk.outcomes
    cancel(desk, third)
    assert_idle(desk)
    assert not any(isinstance(outcome, ProcedureFailed) for outcome in desk.outcomes.values())
