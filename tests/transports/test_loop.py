"""The seam to the event loop: what is cancelled, and when, is alike on trio and asyncio; and what asyncio itself cancels."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, TypeAlias

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_transports.loop import CancelScope, TaskStatus
from tests import loops
from tests.examples import examples
from tests.loops import ASYNCIO, TRIO, loop

BOTH = pytest.mark.parametrize("on", [TRIO, ASYNCIO])
Program: TypeAlias = "tuple[Any, ...]"


def on_loop(name: str, test: Callable[[], Awaitable[Any]]) -> Any:
    loops.chosen = name
    try:
        return loops.run(test)
    finally:
        loops.chosen = TRIO


# ---- any program ends alike on both ----

DEADLINES = st.sampled_from([None, 1, 3, 5, 9])


def programs() -> st.SearchStrategy[list[Program]]:
    """Sequences of steps: waits, scopes around more steps, nurseries with tasks, errors, clean-ups; cancels of scopes."""
    leaf = st.one_of(
        st.tuples(st.just("sleep"), st.integers(0, 6)),
        st.just(("checkpoint",)),
        st.just(("if cancelled",)),
        st.just(("shielded checkpoint",)),
        st.tuples(st.just("cancel"), st.integers(0, 3)),
        st.just(("fail",)),
        st.tuples(st.just("deadline"), st.integers(0, 3), DEADLINES),
    )

    def more(steps: st.SearchStrategy[Program]) -> st.SearchStrategy[Program]:
        body = st.lists(steps, max_size=4)
        return st.one_of(
            st.tuples(st.just("scope"), DEADLINES, st.booleans(), body),
            st.tuples(st.just("nursery"), st.lists(body, max_size=3), body),
            st.tuples(st.just("finally"), body, body),
            st.tuples(st.just("start"), body, body),
        )

    return st.lists(st.recursive(leaf, more, max_leaves=12), min_size=1, max_size=5)


class Planned(Exception):
    """The program fails here."""


class Run:
    """Does the steps of a program, and notes what happens, and when."""

    def __init__(self) -> None:
        self.log: dict[str, list[tuple[float, str]]] = {}
        self.start = loop.current_time()
        self.tasks = self.deadlines = 0

    def note(self, who: str, what: str) -> None:
        self.log.setdefault(who, []).append((round(loop.current_time() - self.start, 6), what))

    def after(self, seconds: int | None) -> float:
        """A deadline, at which nothing else happens."""
        self.deadlines += 1
        return float("inf") if seconds is None else loop.current_time() + seconds + self.deadlines / 300

    async def steps(self, who: str, program: list[Program], scopes: list[CancelScope]) -> None:
        for number, step in enumerate(program):
            await self.step(f"{who}.{number}", step, scopes)

    async def task(self, offset: float, who: str, program: list[Program], scopes: list[CancelScope]) -> None:
        """No two tasks do anything at one time: which of them comes first, nobody promises."""
        await loop.sleep(offset)
        await self.steps(who, program, scopes)

    async def step(self, who: str, step: Program, scopes: list[CancelScope]) -> None:
        match step:
            case "sleep", seconds:
                await loop.sleep(seconds)
                self.note(who, "slept")
            case ("checkpoint",):
                await loop.checkpoint()
                self.note(who, "went on")
            case ("if cancelled",):
                await loop.checkpoint_if_cancelled()
                self.note(who, "went on")
            case ("shielded checkpoint",):
                await loop.cancel_shielded_checkpoint()
                self.note(who, "went on")
            case "cancel", depth:
                if depth < len(scopes):
                    scopes[-1 - depth].cancel()
            case "deadline", depth, seconds:
                if depth < len(scopes) and seconds is not None:
                    scopes[-1 - depth].deadline = self.after(seconds)
            case ("fail",):
                raise Planned
            case "scope", seconds, shield, body:
                with loop.cancel_scope(deadline=self.after(seconds), shield=shield) as scope:
                    await self.steps(who, body, [*scopes, scope])
                self.note(who, f"scope, cancelled: {scope.cancel_called} {scope.cancelled_caught}")
            case "nursery", tasks, body:
                async with loop.open_nursery() as nursery:
                    inner = [*scopes, nursery.cancel_scope]
                    for number, each in enumerate(tasks):
                        self.tasks += 1
                        nursery.start_soon(self.task, self.tasks / 1000, f"{who}/{number}", each, inner)
                    await self.steps(who, body, inner)
                self.note(who, f"nursery, cancelled: {nursery.cancel_scope.cancel_called}")
            case "start", before, after:
                async with loop.open_nursery() as nursery:
                    self.note(who, f"started: {await nursery.start(self.begin, who, before, after)}")
            case "finally", body, clean_up:
                try:
                    await self.steps(who, body, scopes)
                finally:
                    self.note(who, "cleans up")
                    await self.steps(f"{who}!", clean_up, [])  # tasks that are cancelled together clean up at one time

    async def begin(self, who: str, before: list[Program], after: list[Program], *, task_status: TaskStatus[str]) -> None:
        await self.steps(f"{who}>", before, [])
        task_status.started(who)
        await self.steps(f"{who}<", after, [])


def leaves(error: BaseException | None) -> list[str]:
    if isinstance(error, BaseExceptionGroup):
        return sorted(name for each in error.exceptions for name in leaves(each))
    return [] if error is None else [type(error).__name__]


def outcome(on: str, program: list[Program]) -> object:
    async def main() -> object:
        run = Run()
        came: BaseException | None = None
        with loop.move_on_after(50):
            try:
                await run.steps("main", program, [])
            except Exception as error:  # noqa: BLE001 - compared
                came = error
        return run.log, leaves(came), round(loop.current_time() - run.start, 6)

    return on_loop(on, main)


@examples(400)
@given(programs())
def test_any_program_ends_alike_on_both_loops(program: list[Program]) -> None:
    assert outcome(ASYNCIO, program) == outcome(TRIO, program)
