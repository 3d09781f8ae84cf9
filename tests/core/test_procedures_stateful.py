"""Any procedures whatever, with any cancels, answers, silences and times: each ends in one outcome, and leaves nothing behind."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, invariant, multiple, rule

from canopen_proto.machine import NEVER, LocalProtocolError, RequestId, Time
from canopen_proto.procedures.runner import CLEAN_UP_TIME, ProcedureCancelled, ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Cancelled, Procedure, Request, Wait, act, all_of, sleep
from tests.core.desk import Desk
from tests.core.machines import Heard, Rang
from tests.examples import examples

# A program is a tuple of instructions, each a tuple of a word and what belongs to it; `Desks.perform` makes a procedure of it.
LEAVES = st.one_of(
    st.tuples(st.just("sleep"), st.integers(-3, 20) | st.just(CLEAN_UP_TIME)),
    st.tuples(st.just("ask")),
    st.tuples(st.just("ask and be answered")),
    st.tuples(st.just("wait"), st.none() | st.integers(0, 20)),
    st.tuples(st.just("act")),
    st.tuples(st.just("be refused")),
    st.tuples(st.just("fail")),
    st.tuples(st.just("match badly")),
    st.tuples(st.just("yield nonsense")),
    st.tuples(st.just("raise Cancelled")),
    st.tuples(st.sampled_from(["cancel in a step", "cancel in a request", "cancel in the code"]), st.integers(0, 3)),
    st.tuples(st.just("wait in finally")),
)
PROGRAMS = st.recursive(
    st.lists(LEAVES, min_size=1, max_size=3).map(tuple),
    lambda programs: st.lists(
        LEAVES
        | st.tuples(st.just("all of"), st.lists(programs, max_size=3))
        | st.tuples(st.just("catch"), programs)
        | st.tuples(st.just("clean up"), programs, programs, st.booleans())
        | st.tuples(st.just("start"), programs),
        min_size=1,
        max_size=3,
    ).map(tuple),
    max_leaves=15,
)
Program = tuple[Any, ...]


class Desks(RuleBasedStateMachine):
    """One desk at which the programs run."""

    started = Bundle("started")

    def __init__(self) -> None:
        super().__init__()
        self.desk = Desk()
        self.ids: list[RequestId] = []
        self.cancelled: dict[RequestId, Time] = {}
        self.asked = 0

    # ---- what the programs do ----

    def perform(self, program: Program) -> Procedure[int]:
        count = 0
        for word, *rest in program:
            count += 1
            yield from self.instruction(word, rest)
        return count

    def instruction(self, word: str, rest: list[Any]) -> Procedure[None]:
        match word:
            case "sleep":
                yield from sleep(rest[0])
            case "ask":
                yield Request(self.desk.clerk, self.ask)
            case "ask and be answered":
                yield Request(self.desk.clerk, self.ask_and_be_answered)
            case "wait":
                yield Wait(rest[0], self.desk.alarm, lambda report: isinstance(report, Heard | Rang))
            case "act":
                yield from act(lambda now: self.desk.alarm.set(now + 5))
            case "be refused":
                yield Request(self.desk.clerk, self.refuse)
            case "fail":
                raise ZeroDivisionError
            case "match badly":
                yield Wait(10, None, lambda report: 1 // 0)
            case "yield nonsense":
                yield None  # type: ignore[misc]
            case "raise Cancelled":
                raise Cancelled
            case "cancel in a step":
                yield from act(lambda now: self.cancel_one(rest[0]))
            case "cancel in a request":
                yield Request(self.desk.clerk, lambda now, urgent: (self.cancel_one(rest[0]), self.ask(now, urgent))[1])
            case "cancel in the code":
                self.cancel_one(rest[0])
            case "wait in finally":
                try:
                    yield from sleep(5)
                finally:
                    yield from sleep(5)
            case "all of":
                results = yield from all_of(*map(self.perform, rest[0]))
                assert results == [len(program) for program in rest[0]]
            case "catch":
                try:
                    yield from self.perform(rest[0])
                except (ArithmeticError, LocalProtocolError, TypeError):
                    yield from sleep(1)
            case "clean up":
                try:
                    yield from self.perform(rest[0])
                except Cancelled:
                    yield from self.perform(rest[1])
                    if rest[2]:
                        raise
            case "start":
                yield from act(lambda now: self.start(rest[0]))

    def ask(self, now: Time, urgent: bool) -> RequestId:
        self.asked += 1
        return self.desk.clerk.ask(str(self.asked), urgent)

    def ask_and_be_answered(self, now: Time, urgent: bool) -> RequestId:
        request_id = self.ask(now, urgent)
        self.desk.clerk.answer(str(self.asked))
        return request_id

    def refuse(self, now: Time, urgent: bool) -> RequestId:
        raise LocalProtocolError("no")

    def start(self, program: Program) -> RequestId:
        request_id = self.desk.network.run(self.perform(program), self.desk.now)
        self.ids.append(request_id)
        return request_id

    def cancel_one(self, back: int) -> None:
        if back < len(self.ids):
            self.cancel(self.ids[-1 - back])

    def cancel(self, request_id: RequestId) -> None:
        if request_id in self.desk.network.runner.tasks:
            self.cancelled.setdefault(request_id, self.desk.now)
        self.desk.network.cancel(request_id, self.desk.now)

    # ---- what the world does ----

    @rule(target=started, program=PROGRAMS, drained=st.booleans())
    def run(self, program: Program, drained: bool) -> Any:
        if len(self.ids) > 20:
            return multiple()
        request_id = self.start(program)
        if drained:
            self.desk.drain()
        return request_id

    @rule(request_id=started, drained=st.booleans())
    def cancel_a_procedure(self, request_id: RequestId, drained: bool) -> None:
        self.cancel(request_id)
        if drained:
            self.desk.drain()

    @rule(pick=st.integers(0, 10), drained=st.booleans())
    def answer(self, pick: int, drained: bool) -> None:
        names = list(self.desk.clerk.open.values())
        if names:
            self.desk.clerk.answer(names[pick % len(names)])
        if drained:
            self.desk.drain()

    @rule()
    def news(self) -> None:
        self.desk.receive("001#")

    @rule(duration=st.integers(0, 25) | st.just(CLEAN_UP_TIME))
    def pass_time(self, duration: Time) -> None:
        self.desk.wait(duration)

    @rule()
    def reach_the_next_deadline(self) -> None:
        time = self.desk.network.next_deadline()
        if time != NEVER:
            self.desk.wait(max(0, time - self.desk.now))

    # ---- what must hold ----

    @invariant()
    def a_clean_up_ends_in_time(self) -> None:
        self.desk.drain()
        for request_id, time in self.cancelled.items():
            if request_id not in self.desk.outcomes:
                assert self.desk.now < time + CLEAN_UP_TIME
                assert self.desk.network.next_deadline() <= time + CLEAN_UP_TIME

    @invariant()
    def every_open_request_is_waited_for_by_a_task_that_lives(self) -> None:
        runner, clerk = self.desk.network.runner, self.desk.clerk
        tasks = runner.tasks.values()
        tokens = {task.token for task in tasks if task.token is not None}
        assert tokens == set(runner._requests)
        assert {number for _, number in tokens} == set(clerk.open)
        for task in tasks:
            assert task.step is not None or task.open_children, "a task that waits for nothing will never end"
            assert not task.active
            assert task.parent is None or task.parent.request_id in runner.tasks
            assert task.open_children == sum(child.request_id in runner.tasks for child in task.children)

    def teardown(self) -> None:
        for request_id in list(self.ids):
            self.cancel(request_id)
        for _ in range(1000):
            self.desk.drain()
            if not self.desk.network.runner.busy:
                break
            for request_id in self.ids:  # what a clean-up has started
                self.cancel(request_id)
            self.desk.wait(max(0, self.desk.network.next_deadline() - self.desk.now))
        runner = self.desk.network.runner
        assert not runner.busy
        assert runner._requests == {}
        assert runner.deadline == NEVER
        assert self.desk.clerk.open == {}
        assert sorted(self.desk.outcomes) == sorted(self.ids), "exactly one outcome each (Desk sees to the second)"
        for request_id, outcome in self.desk.outcomes.items():
            kind = ProcedureCancelled if request_id in self.cancelled else ProcedureFailed | ProcedureFinished
            assert isinstance(outcome, kind)


TestDesks = Desks.TestCase
TestDesks.settings = examples(120, steps=25)
