"""The seam to the event loop: what is cancelled, and when, is alike on trio and asyncio; and what asyncio itself cancels."""

from __future__ import annotations

import asyncio
import importlib.util
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any, TypeAlias

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st

from canopen_transports.loop import CancelScope, NoLoopError, RunVar, TaskStatus, current_loop, protected
from canopen_transports.loop.beside import beside
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


def in_earnest(name: str, test: Callable[[], Awaitable[Any]]) -> Any:
    """In real time, as threads and sockets want it."""

    async def main() -> Any:
        return await test()

    return trio.run(main) if name == TRIO else asyncio.run(main())


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


# ---- the parts, one by one ----


@BOTH
def test_a_scope_cancels_each_await_in_it_and_a_shield_stands_against_that(on: str) -> None:
    async def main() -> None:
        seen, start = [], loop.current_time()
        with loop.cancel_scope() as scope:
            scope.cancel()
            for _ in range(3):
                try:
                    await loop.sleep(1)
                except loop.Cancelled:
                    seen.append("cancelled")
            with loop.cancel_scope(shield=True):
                await loop.sleep(1)
                seen.append("slept")
            await loop.sleep(1)
        assert seen == ["cancelled"] * 3 + ["slept"]
        assert scope.cancelled_caught
        assert loop.current_time() - start == 1

    on_loop(on, main)


@BOTH
def test_tasks_beside_a_block_end_with_it_and_its_error_comes_out_as_it_is(on: str) -> None:
    ended: list[str] = []

    async def serve(name: str) -> None:
        try:
            await loop.sleep_forever()
        finally:
            ended.append(name)

    async def work(name: str, error: Exception | None) -> str:
        async with beside(loop.open_nursery()) as nursery:
            nursery.start_soon(serve, name)
            await loop.sleep(1)
            if error is not None:
                raise error
            return name

    async def main() -> None:
        assert await work("well", None) == "well"
        planned, cause = Planned(), ValueError()
        planned.__cause__ = cause
        with pytest.raises(Planned) as raised:
            await work("badly", planned)
        assert raised.value is planned
        assert planned.__cause__ is cause
        with loop.move_on_after(0.5) as scope:
            await work("cancelled", None)
        assert scope.cancelled_caught

    on_loop(on, main)
    assert ended == ["well", "badly", "cancelled"]


@BOTH
def test_a_task_that_fails_ends_the_block_beside_it(on: str) -> None:
    async def fail() -> None:
        raise Planned

    async def main() -> None:
        with pytest.raises(ExceptionGroup) as raised:
            async with beside(loop.open_nursery()) as nursery:
                nursery.start_soon(fail)
                await loop.sleep_forever()
        assert [type(each) for each in raised.value.exceptions] == [Planned]

    on_loop(on, main)


@BOTH
def test_a_lock_is_handed_on_in_order_also_past_those_who_gave_up(on: str) -> None:
    async def main() -> list[int]:
        lock, order = loop.lock(), []

        async def ask(number: int) -> None:
            with loop.move_on_after(5 if number == 2 else 100):
                async with lock:
                    order.append(number)
                    await loop.sleep(2)

        async with loop.open_nursery() as nursery:
            for number in range(5):
                nursery.start_soon(ask, number)
                await loop.sleep(0.1)
            assert lock.locked()
        assert not lock.locked()
        return order

    assert on_loop(on, main) == [0, 1, 2, 3, 4]


@BOTH
def test_who_gives_up_waiting_for_a_lock_does_not_get_it(on: str) -> None:
    async def main() -> list[int]:
        lock, order = loop.lock(), []

        async def ask(number: int) -> None:
            with loop.move_on_after(1 if number == 1 else 100):
                async with lock:
                    order.append(number)
                    await loop.sleep(2)

        async with loop.open_nursery() as nursery:
            for number in range(3):
                nursery.start_soon(ask, number)
                await loop.sleep(0.1)
        return order

    assert on_loop(on, main) == [0, 2]


@BOTH
def test_an_event_happens_once_for_all_who_wait(on: str) -> None:
    async def main() -> int:
        event, woken = loop.event(), 0

        async def wait() -> None:
            nonlocal woken
            await event.wait()
            woken += 1

        async with loop.open_nursery() as nursery:
            for _ in range(3):
                nursery.start_soon(wait)
            await loop.sleep(1)
            assert not event.is_set()
            event.set()
            await event.wait()
        return woken

    assert on_loop(on, main) == 3


@BOTH
def test_a_function_in_a_thread_returns_or_raises_and_may_be_left_behind(on: str) -> None:
    async def main() -> None:
        assert await loop.in_thread(lambda a, b: a + b, 2, 3) == 5
        with pytest.raises(Planned):
            await loop.in_thread(fail)
        release, ended = threading.Event(), threading.Event()

        def hang() -> None:
            release.wait(100)
            ended.set()

        with loop.cancel_scope() as scope:
            async with loop.open_nursery() as nursery:
                nursery.start_soon(cancel_when_it_runs, scope, hang)
        assert scope.cancelled_caught
        assert not ended.is_set()
        release.set()
        assert ended.wait(100)

    def fail() -> None:
        raise Planned

    async def cancel_when_it_runs(scope: CancelScope, hang: Callable[[], None]) -> None:
        runs = threading.Event()

        def work() -> None:
            runs.set()
            hang()

        async with loop.open_nursery() as nursery:
            nursery.start_soon(lambda: loop.in_thread(work, abandon_on_cancel=True))
            while not runs.is_set():
                await loop.checkpoint()
            scope.cancel()

    in_earnest(on, main)


@BOTH
def test_a_thread_that_is_not_left_behind_is_waited_for(on: str) -> None:
    async def main() -> bool:
        runs, release, ended = threading.Event(), threading.Event(), threading.Event()

        def work() -> None:
            runs.set()
            release.wait(100)
            ended.set()

        with loop.cancel_scope() as scope:
            async with loop.open_nursery() as nursery:
                nursery.start_soon(loop.in_thread, work)
                while not runs.is_set():
                    await loop.checkpoint()
                scope.cancel()
                release.set()
        return ended.is_set()

    assert in_earnest(on, main)


@BOTH
def test_another_thread_calls_into_the_loop_until_the_run_has_ended(on: str) -> None:
    async def main() -> tuple[Any, type[Exception]]:
        token, woken, calls = loop.token(), loop.event(), []

        def work() -> None:
            for _ in range(3):
                token.run_sync_soon(note, idempotent=True)
            token.run_sync_soon(woken.set)

        def note() -> None:
            calls.append(threading.current_thread() is threading.main_thread())

        thread = threading.Thread(target=work)
        thread.start()
        await woken.wait()
        thread.join()
        assert 1 <= len(calls) <= 3
        assert all(calls)
        return token, loop.RunFinishedError

    token, error = in_earnest(on, main)
    with pytest.raises(error):
        token.run_sync_soon(print)


@BOTH
def test_files_are_waited_for_by_one_task_at_a_time_until_they_are_closed(on: str) -> None:
    async def expect_closed(file: socket.socket) -> None:
        with pytest.raises(loop.ClosedResourceError):
            await loop.wait_readable(file)

    async def main() -> None:
        here, there = socket.socketpair()
        with here, there:
            await loop.wait_writable(here)
            there.send(b"x")
            await loop.wait_readable(here.fileno())
            assert here.recv(1) == b"x"
            async with loop.open_nursery() as nursery:
                nursery.start_soon(expect_closed, here)
                await loop.wait_all_tasks_blocked()
                with pytest.raises(loop.BusyResourceError):
                    await loop.wait_readable(here)
                loop.notify_closing(here)
            with loop.cancel_scope() as scope:
                scope.cancel()
                await loop.wait_readable(here)
            assert scope.cancelled_caught
            there.send(b"y")
            await loop.wait_readable(here)

    in_earnest(on, main)


@BOTH
def test_a_tcp_connection_sends_receives_ends_and_is_closed(on: str) -> None:
    async def main() -> None:
        with socket.create_server(("127.0.0.1", 0)) as server:
            host, port = server.getsockname()
            sock = await loop.connect_tcp(host, port)
            peer, _ = server.accept()
            peer.sendall(b"hello")
            assert await sock.recv(100) == b"hello"
            big = bytes(1 << 22)
            assert 0 < await sock.send(big) < len(big)  # as many as fit
            peer.close()
            with suppress(OSError):  # what was not taken by the peer is told
                assert await sock.recv(100) == b""
            sock.close()
            with pytest.raises((loop.ClosedResourceError, OSError)):
                await sock.recv(1)
        with pytest.raises(OSError):
            await loop.connect_tcp(host, port)  # nobody listens any longer

    in_earnest(on, main)


@BOTH
def test_a_value_of_a_run_is_its_own(on: str) -> None:
    made: RunVar[list[int]] = RunVar(list)

    async def main() -> list[int]:
        made.get().append(1)
        assert made.get() == [1]
        made.set([2])
        return made.get()

    assert [on_loop(on, main), on_loop(on, main)] == [[2], [2]]


@BOTH
def test_before_the_loop_sleeps_it_asks_and_what_is_asked_for_then_comes_first(on: str) -> None:
    async def main() -> None:
        token, times = loop.token(), []

        def look(timeout: float | None) -> None:
            if not times:
                token.run_sync_soon(times.append, loop_time())

        loop_time = loop.clock()
        start = loop_time()
        end = loop.before_sleep(look)
        await loop.sleep(5)
        assert times == [start]
        end()
        times.clear()
        await loop.sleep(5)
        assert times == []

    on_loop(on, main)


def test_outside_of_a_loop_there_is_none() -> None:
    with pytest.raises(NoLoopError, match=r"trio\.run.* or asyncio\.run"):
        current_loop()


def test_asyncio_needs_no_trio() -> None:
    script = """
import asyncio, sys
from canopen_transports import open_transport
from canopen_transports.loop import current_loop
async def main():
    async with await open_transport("virtual:a"):
        print(current_loop().name, "trio" in sys.modules)
asyncio.run(main())
"""
    assert subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout == "asyncio False\n"


# ---- what asyncio itself cancels ----


def in_asyncio(main: Callable[[], Awaitable[Any]]) -> Any:
    return on_loop(ASYNCIO, main)


def test_a_timeout_of_asyncio_waits_for_the_end_of_a_shield() -> None:
    async def main() -> None:
        slept = []
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(1):
                with loop.cancel_scope() as scope:
                    with loop.cancel_scope(shield=True):
                        await loop.sleep(3)
                        slept.append(loop.current_time())
                    await loop.sleep(3)
        assert slept == [3]
        assert loop.current_time() == 3
        assert not scope.cancelled_caught
        assert not cancels()

    in_asyncio(main)


def cancels() -> int:
    task = asyncio.current_task()
    assert task is not None
    return task.cancelling()


def test_scopes_give_back_what_they_have_cancelled() -> None:
    async def main() -> None:
        for sleep in (loop.sleep, asyncio.sleep):
            with loop.move_on_after(1):
                with suppress(loop.Cancelled):
                    await sleep(3)
                with suppress(loop.Cancelled):
                    await sleep(3)
                await sleep(3)
            assert not cancels()
        async with asyncio.timeout(5):  # counts from where it begins
            with loop.move_on_after(1) as scope:
                await asyncio.sleep(3)
        assert scope.cancelled_caught

    in_asyncio(main)


def test_a_cancel_from_outside_and_one_of_a_scope_at_one_time_leave_as_that_from_outside() -> None:
    async def main() -> None:
        scopes = []

        async def work() -> None:
            with loop.cancel_scope() as scope:
                scopes.append(scope)
                await loop.sleep_forever()

        task = asyncio.create_task(work())
        await asyncio.sleep(1)
        scopes[0].cancel()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    in_asyncio(main)


def test_a_task_of_a_nursery_that_asyncio_cancels_before_it_begins_begins_nevertheless() -> None:
    async def main() -> int:
        begun = 0

        async def work() -> None:
            nonlocal begun
            begun += 1

        async with loop.open_nursery() as nursery:
            nursery.start_soon(work)
            for task in asyncio.all_tasks() - {asyncio.current_task()}:
                task.cancel()
        return begun

    assert in_asyncio(main) == 1


def test_a_task_that_takes_no_notice_is_cancelled_again_but_does_not_keep_the_processor_busy() -> None:
    async def main() -> tuple[int, float]:
        count = 0

        async def stubborn() -> None:
            nonlocal count
            while loop.current_time() < 10:
                with suppress(asyncio.CancelledError):
                    await asyncio.sleep(1)
                count += 1

        async with loop.open_nursery() as nursery:
            nursery.start_soon(stubborn)
            await loop.sleep(0.5)
            nursery.cancel_scope.cancel()
        return count, loop.current_time()

    count, ended = in_asyncio(main)
    assert 100 < count < 300
    assert 10 <= ended < 10.1


def test_a_ctrl_c_in_a_protected_function_comes_when_it_is_over() -> None:
    seen = []

    @protected
    def turn() -> None:
        signal.raise_signal(signal.SIGINT)
        seen.append("whole")

    async def main() -> None:
        with loop.holding_interrupts():
            try:
                turn()
                await asyncio.sleep(100)
            finally:
                seen.append(loop.current_time())

    with pytest.raises(KeyboardInterrupt):
        in_asyncio(main)
    assert seen == ["whole", 0.0]


@pytest.mark.skipif(importlib.util.find_spec("uvloop") is None, reason="uvloop is not installed")
def test_uvloop_is_asyncio_too() -> None:
    async def main() -> None:
        calls = []
        end = loop.before_sleep(calls.append)
        begin = loop.current_time()
        with loop.move_on_after(0.02) as scope:
            await asyncio.sleep(100)
        assert scope.cancelled_caught
        await loop.sleep(0.02)
        assert loop.current_time() - begin > 0.035
        assert loop.is_real_time()
        while not calls:
            await loop.checkpoint()
        end()
        here, there = socket.socketpair()
        with here, there:
            there.send(b"x")
            await loop.wait_readable(here)

    with asyncio.Runner(loop_factory=importlib.import_module("uvloop").new_event_loop) as runner:
        runner.run(main())
