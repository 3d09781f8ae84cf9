"""Cancel scopes and nurseries on asyncio, with trio's way to cancel.

asyncio cancels a task once: it gets a CancelledError at the await where it is, and that is all. Here a scope that is cancelled
calls `Task.cancel` for each task inside it, and again if the task then awaits something else inside it, until the task has left
the scope. What this package awaits looks first (`AsyncioTasks.check`), and never begins. Foreign awaits are cancelled a turn of
the loop later; one that takes no notice is cancelled at longer and longer intervals (`_AGAIN`).

**What asyncio cancels itself** (`Task.cancel` by somebody, `asyncio.timeout`, `asyncio.TaskGroup`, the end of `asyncio.run`) is
told apart by `Task.cancelling`: scopes count what they have cancelled, and give it back by `Task.uncancel`. Such a cancel leaves
every scope as the CancelledError that it is. Within a shield it is held back: the await goes on, and the first await behind the
shield gets it. That holds for all that is awaited here, not for foreign awaits within a shield.
"""

from __future__ import annotations

import asyncio
import math
from asyncio import CancelledError, Future, Task
from collections.abc import Awaitable, Callable, Generator
from functools import partial
from types import TracebackType
from typing import Any, Final, Self

_AT_ONCE: Final = 8
"""So often a task is cancelled in turn, if it awaits on and on."""
_AGAIN: Final = (0.001, 0.05)
"""Seconds until it is cancelled once more then: at first, and at most."""


class Yield:
    """Lets the loop go round once."""

    def __await__(self) -> Generator[None, None, None]:
        yield


class _TaskState:
    """What is known of a task that is in a scope. delivered: how often scopes have cancelled it, of what `Task.cancelling`
    counts. held_back: a cancel of asyncio's own waits for the end of a shield."""

    __slots__ = ("delivered", "held_back", "passes", "scope", "task")

    def __init__(self, task: Task[Any], scope: AsyncioScope | None) -> None:
        self.task = task
        self.scope = scope
        self.delivered = 0
        self.passes = 0
        self.held_back = False

    @property
    def is_cancelled(self) -> bool:
        """Whether a scope cancels what is awaited now."""
        scope = self.scope
        while scope is not None:
            if scope.cancel_called:
                return True
            if scope.shield:
                return False
            scope = scope.parent
        return False

    @property
    def is_shielded(self) -> bool:
        scope = self.scope
        while scope is not None and not scope.shield:
            scope = scope.parent
        return scope is not None

    @property
    def from_outside(self) -> int:
        """How often asyncio itself has cancelled it."""
        return self.task.cancelling() - self.delivered

    def hold_back(self) -> None:
        """A cancel of asyncio's own has ended an await that goes on: it comes at the first one behind the shields."""
        if self.is_shielded:
            self.held_back = True
        else:
            self.held_back = False
            self.task.cancel()
            self.task.uncancel()  # it is counted already

    def settle(self) -> None:
        """The task has left a scope: give back what scopes have cancelled, and let through what was held back."""
        self.passes = 0
        if not self.is_cancelled:
            while self.delivered:
                self.delivered -= 1
                self.task.uncancel()
        if self.held_back and self.from_outside > 0:
            self.hold_back()


class AsyncioTasks:
    """The tasks of an asyncio loop that are in scopes."""

    def __init__(self, loop: asyncio.AbstractEventLoop, clock: Callable[[], float]) -> None:
        self.loop = loop
        self.clock = clock
        self._states: dict[Task[Any], _TaskState] = {}
        self._next: asyncio.Handle | None = None

    def entered(self, scope: AsyncioScope) -> _TaskState:
        """The present task enters a scope."""
        task = asyncio.current_task(self.loop)
        if task is None:
            raise RuntimeError("a cancel scope is entered outside of any task")
        state = self._states.get(task)
        if state is None:
            state = self._states[task] = _TaskState(task, None)
        scope.parent, state.scope = state.scope, scope
        return state

    def left(self, state: _TaskState, scope: AsyncioScope) -> None:
        """A task leaves a scope. Others may stand within it, if a generator left them open."""
        if state.scope is scope:
            state.scope = scope.parent
        else:
            inner = state.scope
            while inner is not None and inner.parent is not scope:
                inner = inner.parent
            if inner is not None:
                inner.parent = scope.parent
        state.settle()
        if state.scope is None:
            self._states.pop(state.task, None)
        elif state.is_cancelled:
            self.deliver()

    def begin(self, scope: AsyncioScope) -> Task[Any]:
        """The present task, a new one, begins within a scope. Return it."""
        task = asyncio.current_task(self.loop)
        assert task is not None
        self._states[task] = _TaskState(task, scope)
        if self._states[task].is_cancelled:
            self.deliver()
        return task

    def end(self, task: Task[Any]) -> None:
        """A task that began within a scope ends, or is destroyed with its loop."""
        self._states.pop(task, None)

    def deliver(self) -> None:
        """Cancel the tasks that wait in a cancelled scope."""
        if self._next is not None:
            self._next.cancel()
            self._next = None
        present = asyncio.current_task(self.loop)
        pause = math.inf
        for task, state in self._states.items():
            if not state.is_cancelled:
                continue
            waits_for: Future[Any] | None = getattr(task, "_fut_waiter", None)
            if task is not present and waits_for is not None and not waits_for.done():
                state.delivered += 1
                state.passes += 1
                task.cancel()
            first, most = _AGAIN
            late = state.passes - _AT_ONCE
            pause = min(pause, 0.0 if late < 0 else min(first * 2**late, most))
        if pause == 0:
            self._next = self.loop.call_soon(self.deliver)
        elif pause < math.inf:
            self._next = self.loop.call_later(pause, self.deliver)

    # ---- waiting ----

    async def check(self) -> None:
        """Raise CancelledError if a scope cancels what is awaited now, but let other tasks run before."""
        if self._states and self.is_cancelled():
            await Yield()
            raise CancelledError("by a cancel scope")

    def is_cancelled(self) -> bool:
        """Whether a scope cancels what the present task awaits."""
        task = asyncio.current_task(self.loop)
        state = self._states.get(task) if task is not None else None
        return state is not None and state.is_cancelled

    def is_shielded(self) -> bool:
        """Whether the present task is within a shield."""
        task = asyncio.current_task(self.loop)
        state = self._states.get(task) if task is not None else None
        return state is not None and state.is_shielded

    def goes_on(self, has_ended: bool = False) -> bool:
        """An await was ended by CancelledError: whether it goes on nevertheless, because a shield holds the cancel back.

        has_ended: it was over before, and cannot be cancelled.
        """
        task = asyncio.current_task(self.loop)
        assert task is not None
        state = self._states.get(task)
        if state is None:
            state = _TaskState(task, None)
        if not has_ended and (state.is_cancelled or not state.is_shielded):
            return False
        if state.from_outside > 0:
            state.hold_back()
        return True


class AsyncioScope:
    """A cancel scope on asyncio: see `CancelScope`, and this module's text."""

    def __init__(self, tasks: AsyncioTasks, deadline: float, shield: bool) -> None:
        self.parent: AsyncioScope | None = None
        self.cancel_called = False
        self.cancelled_caught = False
        self._tasks = tasks
        self._deadline = deadline
        self._shield = shield
        self._state: _TaskState | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._from_outside = 0

    @property
    def shield(self) -> bool:
        return self._shield

    @shield.setter
    def shield(self, shield: bool) -> None:
        self._shield = shield
        if not shield:
            self._tasks.deliver()

    @property
    def deadline(self) -> float:
        return self._deadline

    @deadline.setter
    def deadline(self, deadline: float) -> None:
        self._deadline = deadline
        self._set_timer()

    def _set_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._state is None or self.cancel_called or self._deadline == math.inf:
            return
        left = self._deadline - self._tasks.clock()
        if left <= 0:
            self.cancel()
        else:
            self._timer = self._tasks.loop.call_later(left, self._on_deadline)

    def _on_deadline(self) -> None:
        self._timer = None
        self.cancel()

    def cancel(self) -> None:
        """Cancel each await in the block, from now on."""
        if not self.cancel_called:
            self.cancel_called = True
            if self._timer is not None:
                self._timer.cancel()
                self._timer = None
            if self._state is not None:
                self._tasks.deliver()

    def __enter__(self) -> Self:
        if self._state is not None:
            raise RuntimeError("a cancel scope can be entered once only")
        self._state = self._tasks.entered(self)
        self._from_outside = self._state.from_outside
        self._set_timer()
        if self.cancel_called:
            self._tasks.deliver()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> bool:
        state = self._state
        assert state is not None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        came_from_outside = state.from_outside > self._from_outside and not state.is_shielded
        self._tasks.left(state, self)
        if not self.cancel_called or error is None or came_from_outside:
            return False
        if not self._shield and self._is_cancelled_around():
            return False  # a scope around this one catches it
        if isinstance(error, CancelledError):
            self.cancelled_caught = True
            return True
        if isinstance(error, BaseExceptionGroup):
            ours, rest = error.split(CancelledError)
            if ours is not None:
                self.cancelled_caught = True
                if rest is None:
                    return True
                raise rest
        return False

    def _is_cancelled_around(self) -> bool:
        scope = self.parent
        while scope is not None:
            if scope.cancel_called:
                return True
            if scope._shield:
                return False
            scope = scope.parent
        return False


class AsyncioNursery:
    """A nursery on asyncio: see `Nursery`. An error of its tasks or its block comes in a group, as trio's does; a CancelledError
    alone comes as it is, as asyncio.TaskGroup has it."""

    def __init__(self, tasks: AsyncioTasks) -> None:
        self.cancel_scope = AsyncioScope(tasks, math.inf, False)
        self._tasks = tasks
        self._children: dict[Task[None], Callable[[], Any] | None] = {}  # and what runs one that has not begun
        self._errors: list[BaseException] = []
        self._cancelled: CancelledError | None = None
        self._waiting: Future[None] | None = None
        self._is_closed = False

    def start_soon(self, function: Callable[..., Awaitable[object]], /, *args: Any) -> None:
        """Run a task."""
        self._spawn(partial(self._run, function, *args), getattr(function, "__qualname__", None))

    def _spawn(self, work: Callable[[], Any], name: str | None) -> None:
        if self._is_closed:
            raise RuntimeError("this nursery is closed to new tasks")
        task = self._tasks.loop.create_task(work(), name=name)
        self._children.setdefault(task, work)
        task.add_done_callback(self._on_end)

    def _begin(self) -> Task[Any]:
        task = self._tasks.begin(self.cancel_scope)
        self._children[task] = None
        return task

    async def _run(self, function: Callable[..., Awaitable[object]], *args: Any) -> None:
        task = self._begin()
        try:
            await function(*args)
        except CancelledError as error:
            self._cancelled = error  # by a scope; or somebody has cancelled this task alone
        except BaseException as error:  # noqa: BLE001 - raised by the end of this nursery
            self._fail(error)
        finally:
            self._tasks.end(task)

    def _fail(self, error: BaseException) -> None:
        self._errors.append(error)
        self.cancel_scope.cancel()
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise error  # asyncio leaves its loop with these, and takes it up again to end the other tasks

    def _on_end(self, task: Task[None]) -> None:
        work = self._children.pop(task)
        if work is not None and not self.cancel_scope.cancel_called:
            self._spawn(work, task.get_name())  # asyncio has cancelled it before it began: it has to see to that by itself
        elif not task.cancelled():
            task.exception()  # it is among our errors
        if not self._children and self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)

    async def start(self, function: Callable[..., Awaitable[object]], /, *args: Any) -> Any:
        """Run a task, which gets `task_status`; wait until it says that it is ready, and return what it says."""
        status = _Started(self._tasks)
        self._spawn(partial(self._run_starting, status, function, *args), getattr(function, "__qualname__", None))
        return await status.result()

    async def _run_starting(self, status: _Started, function: Callable[..., Awaitable[object]], *args: Any) -> None:
        task = self._begin()
        error: BaseException | None = None
        try:
            with status.scope:
                await function(*args, task_status=status)
            if status.scope.cancelled_caught:
                error = CancelledError()
            elif not status.is_started:
                error = RuntimeError("the task ended without calling task_status.started()")
        except BaseException as raised:  # noqa: BLE001 - raised by `start`, or by the end of this nursery
            error = raised
        finally:
            self._tasks.end(task)
        if status.ended(error):
            if isinstance(error, CancelledError):
                self._cancelled = error
            elif error is not None:
                self._fail(error)

    async def __aenter__(self) -> Self:
        self.cancel_scope.__enter__()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool:
        if error is not None:
            self.cancel_scope.cancel()
        tasks = self._tasks
        is_shielded = tasks.is_shielded()
        with AsyncioScope(tasks, math.inf, True):  # the tasks end in any case: what cancels this wait cancels them, too
            while self._children:
                self._waiting = tasks.loop.create_future()
                try:
                    await self._waiting
                except CancelledError:
                    tasks.goes_on()
                    if not is_shielded:
                        self.cancel_scope.cancel()
        self._is_closed = True
        errors = [each for each in (error, *self._errors) if each is not None and not isinstance(each, CancelledError)]
        cancelled = error if isinstance(error, CancelledError) else self._cancelled if tasks.is_cancelled() else None
        if errors and cancelled is not None and tasks.is_cancelled():
            errors.append(cancelled)  # a scope around this catches it
        result = BaseExceptionGroup("errors of a nursery", errors) if errors else cancelled
        if self.cancel_scope.__exit__(None if result is None else type(result), result, None):
            return True
        if result is None or result is error:
            return False
        try:
            raise result
        finally:
            del errors, result, cancelled  # they would hold this frame, which holds them


class _Started:
    """The status of a task that `AsyncioNursery.start` has begun. scope: around it, until it is ready."""

    def __init__(self, tasks: AsyncioTasks) -> None:
        self.scope = AsyncioScope(tasks, math.inf, False)
        self.is_started = False
        self._tasks = tasks
        self._future: Future[None] | None = None
        self._value: Any = None
        self._error: BaseException | None = None
        self._is_over = False

    def started(self, value: Any = None) -> None:
        if self.is_started:
            raise RuntimeError("task_status.started() was called twice")
        self.is_started = True
        self._value = value
        if not self.scope.cancel_called:  # else `start` waits for the end of the task
            self._end()

    def ended(self, error: BaseException | None) -> bool:
        """The task has ended; return whether `start` returned before."""
        if self._is_over:
            return True
        self._error = error
        self._end()
        return False

    def _end(self) -> None:
        self._is_over = True
        if self._future is not None and not self._future.done():
            self._future.set_result(None)

    async def result(self) -> Any:
        from_outside: CancelledError | None = None
        with AsyncioScope(self._tasks, math.inf, False) as wait:
            while not self._is_over:
                self._future = self._tasks.loop.create_future()
                try:
                    await self._future
                except CancelledError as error:
                    if self._tasks.goes_on():
                        continue
                    if not self._tasks.is_cancelled():
                        from_outside = error
                    self.scope.cancel()
                    wait.shield = True
        if from_outside is not None:
            raise from_outside
        if self._error is not None:
            raise self._error
        return self._value
