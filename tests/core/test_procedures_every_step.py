"""A composite procedure that is cancelled at every step: from outside, twice, with a silent node, by each of its own parts."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import pytest

from canopen_proto.machine import SECOND, RequestId, Time
from canopen_proto.procedures.runner import CLEAN_UP_TIME, CleanUpTimeoutError, ProcedureCancelled, ProcedureFinished
from canopen_proto.procedures.steps import Cancelled, Procedure, Request, act, all_of, current_time, sleep, wait_for_event
from tests.core.desk import Desk, assert_idle, cancel, cancelled
from tests.core.machines import Heard


class Rig:
    """A composite procedure at a desk, and what its clean-up must have done."""

    def __init__(self) -> None:
        self.desk = desk = Desk()
        self.moving = 0
        self.largest = 0
        self.request_id = desk.run(self.whole())

    def whole(self) -> Procedure[str]:
        yield from self.desk.ask("identify")
        yield from sleep(10)
        for _ in range(2):
            yield from all_of(self.axis("x", 1), self.axis("y", 2), self.pair())
        yield from act(lambda now: None)
        yield from wait_for_event(self.desk.alarm, Heard, SECOND, "the end")
        return "done"

    def pair(self) -> Procedure[None]:
        yield from sleep(3)
        yield from all_of(self.axis("v", 2), self.axis("w", 1))

    def axis(self, name: str, rounds: int) -> Procedure[Time]:
        yield from self.desk.ask(f"mode {name}")
        try:
            self.moving += 1
            for _ in range(rounds):
                yield from self.desk.ask(f"move {name}")
                yield from sleep(7)
            yield from self.desk.ask(f"halt {name}")
            self.moving -= 1
        except Cancelled:
            yield from self.desk.ask(f"halt {name}")
            yield from sleep(20)
            self.moving -= 1
            raise
        return (yield from current_time())

    def step(self, answering: bool = True) -> None:
        """Let one thing happen."""
        desk = self.desk
        if desk.clerk.open and answering:
            desk.answer(next(iter(desk.clerk.open.values())))
        elif (time := desk.network.next_deadline()) < SECOND // 2:
            desk.wait(max(0, time - desk.now))
        else:
            desk.receive("001#")

    def end(self, answering: bool = True) -> None:
        for _ in range(200):
            if not self.desk.network.runner.busy:
                break
            if not answering:
                self.desk.wait(self.desk.network.next_deadline() - self.desk.now)
            else:
                self.step()
        assert_idle(self.desk)
        assert list(self.desk.outcomes) == [self.request_id]


def count_steps() -> int:
    rig = Rig()
    count = 0
    while rig.desk.network.runner.busy:
        rig.step()
        count += 1
    assert rig.desk.outcomes[rig.request_id] == ProcedureFinished(0, rig.request_id, "done")
    assert rig.moving == 0
    return count


STEPS = count_steps()


@pytest.mark.parametrize("at", range(STEPS))
def test_cancelled_at_any_step_it_cleans_up_and_leaves_nothing(at: int) -> None:
    rig = Rig()
    for _ in range(at):
        rig.step()
    cancelled_at = rig.desk.now
    cancel(rig.desk, rig.request_id)
    log = len(rig.desk.clerk.log)
    rig.end()
    assert cancelled(rig.desk, rig.request_id) is None
    assert rig.moving == 0
    assert all(line.startswith("halt") and line.endswith("!") for line in rig.desk.clerk.log[log:])
    assert rig.desk.now <= cancelled_at + CLEAN_UP_TIME


@pytest.mark.parametrize("at", range(STEPS))
def test_cancelled_at_any_step_with_a_node_that_is_silent_from_then_on(at: int) -> None:
    rig = Rig()
    for _ in range(at):
        rig.step()
    cancelled_at, moving = rig.desk.now, rig.moving
    cancel(rig.desk, rig.request_id)
    rig.end(answering=False)
    assert isinstance(cancelled(rig.desk, rig.request_id), CleanUpTimeoutError) == (moving > 0)
    assert rig.desk.now == cancelled_at + (CLEAN_UP_TIME if moving else 0)


def test_cancelled_at_any_step_and_again_at_any_later_step() -> None:
    for at in range(0, STEPS, 3):
        for later in range(12):
            rig = Rig()
            for _ in range(at):
                rig.step()
            cancel(rig.desk, rig.request_id)
            for _ in range(later):
                if rig.desk.network.runner.busy:
                    rig.step()
            cancel(rig.desk, rig.request_id)
            rig.end()
            assert cancelled(rig.desk, rig.request_id) is None
            assert rig.moving == 0


class Hook(Generator[Any, Any, Any]):
    """A procedure around another, that cancels itself in its n-th step, be it by an act or in its own code."""

    def __init__(self, rig: Rig, inner: Procedure[Any], at: int, by_act: bool) -> None:
        self.rig, self.inner, self.at, self.by_act = rig, inner, at, by_act

    def send(self, value: Any) -> Any:
        step = self.inner.send(value)
        self.at -= 1
        if self.at == 0:
            if not self.by_act:
                self.rig.desk.network.cancel(self.rig.request_id, self.rig.desk.now)
            elif isinstance(step, Request):
                submit = step.submit

                def cancel_and_submit(now: Time, urgent: bool) -> RequestId:
                    self.rig.desk.network.cancel(self.rig.request_id, now)
                    return submit(now, urgent)

                return Request(step.requester, cancel_and_submit)
        return step

    def throw(self, *error: Any) -> Any:
        return self.inner.throw(*error)


@pytest.mark.parametrize("by_act", [False, True])
@pytest.mark.parametrize("who", range(6))
def test_cancelled_by_itself_at_any_step_of_any_of_its_procedures(by_act: bool, who: int) -> None:
    for at in range(1, 9):

        class Hooked(Rig):
            count = 0

            def axis(self, name: str, rounds: int) -> Procedure[Time]:
                Hooked.count += 1
                inner = super().axis(name, rounds)
                return Hook(self, inner, at, by_act) if Hooked.count - 1 == who else inner  # noqa: B023

        rig = Hooked()
        rig.end()
        outcome = rig.desk.outcomes[rig.request_id]
        assert isinstance(outcome, ProcedureCancelled | ProcedureFinished)
        assert rig.moving == 0
