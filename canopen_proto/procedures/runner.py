"""`Runner`: runs procedures over one or more Networks.

A running procedure is a task: a generator and the one step that it waits for. `all_of` makes child tasks. A task ends in one
event, sent through the outbox of the Runner: ProcedureFinished, ProcedureFailed, ProcedureCancelled.

Cancelling a task (`cancel`, or a sibling's failure under `all_of`): its children are cancelled first and wait for; then its step
is taken back (a queued request is dropped, one under way is aborted on the wire); then `Cancelled` is thrown into the generator.
Steps that it yields after that are urgent (before all queued requests of their node), and the whole clean-up of a task has
CLEAN_UP_TIME. A second cancel does nothing.
"""

from __future__ import annotations

import enum
from typing import Any, Final, TypeVar

from canopen_proto.machine import NEVER, SECOND, Event, Machine, Outbox, Outcome, RequestId, Time, event
from canopen_proto.procedures.steps import Act, AllOf, Cancelled, Procedure, ProcedureError, Request, Step, Wait

T = TypeVar("T")

CLEAN_UP_TIME: Final = 1 * SECOND
"""What a cancelled procedure's clean-up may take in all. A drive halts in less; a dead node must not hold up a shutdown."""


@event
class ProcedureFinished(Outcome):
    """A procedure came to its end; `result` is what it returned."""

    result: Any


@event
class ProcedureFailed(Outcome):
    """A procedure raised: a ProcedureError with a message for people, or whatever else its code raised (a bug in it)."""

    error: Exception


@event
class ProcedureCancelled(Outcome):
    """A procedure was cancelled and has cleaned up. clean_up_error: what went wrong in that, or None."""

    clean_up_error: Exception | None


class CleanUpTimeout(ProcedureError):
    """The clean-up of a cancelled procedure did not end within CLEAN_UP_TIME and was given up."""


class _State(enum.Enum):
    RUNNING = enum.auto()
    CANCELLING = enum.auto()  # children are cleaning up, or its own clean-up runs
    DONE = enum.auto()


class _Task:
    __slots__ = (
        "cancelled", "children", "clean_up_by", "error", "failure", "generator", "parent",
        "request_id", "result", "state", "step", "token", "turn", "wake",
    )  # fmt: skip

    def __init__(self, generator: Procedure[Any], request_id: RequestId, parent: _Task | None) -> None:
        self.generator = generator
        self.request_id = request_id
        self.parent = parent
        self.state = _State.RUNNING
        self.cancelled = False  # Cancelled was thrown into it
        self.step: Step | None = None
        self.token: tuple[object, RequestId] | None = None  # of a Request under way
        self.wake: Time = NEVER
        self.clean_up_by: Time = NEVER
        self.children: list[_Task] = []
        self.result: object = None
        self.error: Exception | None = None
        self.failure: Exception | None = None  # the first of its children's
        self.turn = 0  # counts its resumptions: a step may end or resume the task that takes it


class Runner(Machine):
    """Runs procedures. Attach it to the Network whose outbox it was made with; that and others feed it by `observe`."""

    __slots__ = ("_requests", "_tasks")

    def __init__(self, out: Outbox) -> None:
        super().__init__(out)
        self._tasks: dict[RequestId, _Task] = {}
        self._requests: dict[tuple[object, RequestId], _Task] = {}

    @property
    def busy(self) -> bool:
        """Whether any procedure runs."""
        return bool(self._tasks)

    def start(self, procedure: Procedure[T], now: Time) -> RequestId:
        """Start a procedure: its first steps are taken at once. One Outcome event with the id that is returned follows."""
        task = self._add(procedure, None)
        self._resume(task, None, now)
        self._rearm()
        return task.request_id

    def cancel(self, request_id: RequestId, now: Time) -> None:
        """Cancel a running procedure; an unknown or ended one, or one that is being cancelled, is left alone."""
        task = self._tasks.get(request_id)
        if task is not None:
            self._cancel(task, now)
            self._rearm()

    def observe(self, root: object, report: Event, now: Time) -> None:
        """Take an event of the network whose `out.root` is given: the outcome or the news that a task waits for."""
        waiting = [task for task in self._tasks.values() if type(task.step) is Wait and task.step.match is not None]
        if isinstance(report, Outcome):
            task = self._requests.pop((root, report.request_id), None)
            if task is not None:
                task.token = None
                self._resume(task, report, now)
                self._rearm()
        for task in waiting:
            step = task.step
            if type(step) is not Wait or step.match is None or (step.source is not None and step.source.out.root is not root):
                continue
            if step.match(report):
                self._resume(task, report, now)
                self._rearm()

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        for task in tuple(self._tasks.values()):
            if task.state is not _State.DONE and task.clean_up_by <= now:
                self._give_up(task, now)
            elif task.wake <= now:
                self._resume(task, None, now)
        self._rearm()

    def _rearm(self) -> None:
        deadline = NEVER
        for task in self._tasks.values():
            deadline = min(deadline, task.wake, task.clean_up_by)
        if deadline != self.deadline:
            self._arm(deadline)

    def _add(self, procedure: Procedure[Any], parent: _Task | None) -> _Task:
        task = _Task(procedure, self.out.next_request_id(), parent)
        self._tasks[task.request_id] = task
        return task

    def _resume(self, task: _Task, value: object, now: Time, error: BaseException | None = None) -> None:
        """Go on with a task until it waits for something or ends."""
        task.step = None
        task.wake = NEVER
        task.turn += 1
        turn = task.turn
        while True:
            try:
                step = task.generator.send(value) if error is None else task.generator.throw(error)
            except StopIteration as stop:
                return self._end(task, stop.value, None, now)
            except Cancelled:
                return self._end(task, None, None, now)
            except Exception as raised:  # noqa: BLE001 - a procedure's code is our caller's: what it raises is its outcome
                return self._end(task, None, raised, now)
            try:
                value, error = self._take(task, step, now), None
            except Exception as refused:  # noqa: BLE001 - a refused step (LocalProtocolError) is the procedure's to handle
                value, error = None, refused
            if task.step is not None or task.turn != turn:
                return None

    def _take(self, task: _Task, step: Step, now: Time) -> object:
        """Begin a step. Sets task.step if it must be waited for, else returns its result."""
        match step:
            case Act():
                return step.function(now)
            case Request():
                request_id = step.submit(now, task.cancelled)
                task.token = (step.requester.out.root, request_id)
                self._requests[task.token] = task
            case Wait():
                task.wake = NEVER if step.timeout is None else now + step.timeout
            case AllOf():
                task.failure = None
                task.children = [self._add(procedure, task) for procedure in step.procedures]
                for child in task.children:
                    # A child that fails at once cancels its siblings, also those that have not begun.
                    if child.state is _State.RUNNING:
                        self._resume(child, None, now)
                if all(child.state is _State.DONE for child in task.children):
                    return self._results(task)
            case _:
                raise TypeError(f"a procedure yielded {step!r}, which is not a step; did it say 'yield' for 'yield from'?")
        task.step = step
        return None

    def _cancel(self, task: _Task, now: Time) -> None:
        if task.state is not _State.RUNNING:
            return
        task.state = _State.CANCELLING
        task.clean_up_by = now + CLEAN_UP_TIME
        self._drop_step(task, now)
        open_children = [child for child in task.children if child.state is not _State.DONE]
        for child in open_children:
            self._cancel(child, now)
        if all(child.state is _State.DONE for child in task.children):
            self._throw_cancelled(task, now)

    def _drop_step(self, task: _Task, now: Time) -> None:
        """Take back what the task waits for. Children are not touched."""
        step, task.step, task.wake = task.step, None, NEVER
        if isinstance(step, Request) and task.token is not None:
            del self._requests[task.token]
            step.requester.cancel(task.token[1], now)
            task.token = None

    def _throw_cancelled(self, task: _Task, now: Time) -> None:
        task.cancelled = True
        self._resume(task, None, now, Cancelled())

    def _give_up(self, task: _Task, now: Time) -> None:
        """The clean-up took too long: end the generator where it stands."""
        for child in task.children:
            if child.state is not _State.DONE:
                self._give_up(child, now)
        if task.state is _State.DONE:  # ending the last child ended it too
            return
        self._drop_step(task, now)
        error: Exception = CleanUpTimeout(f"the clean-up did not end within {CLEAN_UP_TIME / 1e9:g} s and was given up")
        try:
            task.generator.close()
        except Exception as raised:  # noqa: BLE001 - as in _resume; e.g. RuntimeError for a generator that yields in `finally`
            error = raised
        self._end(task, None, error, now)

    def _end(self, task: _Task, result: object, error: Exception | None, now: Time) -> None:
        was_cancelled = task.state is _State.CANCELLING
        task.state = _State.DONE
        task.step, task.wake, task.clean_up_by = None, NEVER, NEVER
        task.result, task.error = result, error
        del self._tasks[task.request_id]
        if task.parent is not None:
            self._child_ended(task.parent, task, was_cancelled, now)
        elif was_cancelled:
            self.out.events.append(ProcedureCancelled(0, task.request_id, error))
        elif error is not None:
            self.out.events.append(ProcedureFailed(0, task.request_id, error))
        else:
            self.out.events.append(ProcedureFinished(0, task.request_id, result))

    def _child_ended(self, parent: _Task, child: _Task, was_cancelled: bool, now: Time) -> None:
        if child.error is not None and not was_cancelled:
            parent.failure = parent.failure or child.error
            for sibling in parent.children:
                self._cancel(sibling, now)
        if any(other.state is not _State.DONE for other in parent.children):
            return
        if parent.state is _State.CANCELLING:
            if not parent.cancelled:
                self._throw_cancelled(parent, now)
        elif parent.step is not None:  # else it is still taking the AllOf step, and sees to it itself
            try:
                results = self._results(parent)
            except Exception as failure:  # noqa: BLE001 - whatever the child's procedure raised
                self._resume(parent, None, now, failure)
            else:
                self._resume(parent, results, now)

    def _results(self, parent: _Task) -> list[object]:
        """The results of an AllOf whose children have all ended, or the first one's failure raised."""
        children, parent.children = parent.children, []
        if parent.failure is not None:
            raise parent.failure
        return [child.result for child in children]
