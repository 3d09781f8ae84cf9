"""`Runner`: runs procedures over one or more Networks.

A running procedure is a task: a generator and the one step that it waits for. `all_of` makes child tasks. A task that was started
by `start` ends in one event, sent through the outbox of the Runner: ProcedureFinished, ProcedureFailed or ProcedureCancelled.

A task is cancelled by `cancel`, or by the failure of a sibling under `all_of`. First its children are cancelled and awaited, or
its step is cancelled (a queued request is dropped, one under way is aborted on the wire). Then `Cancelled` is thrown into the
generator. The steps that follow, also those of procedures that the clean-up runs, are urgent: they go before all queued requests
of their node. The whole clean-up of a task has CLEAN_UP_TIME, or more if it asks for more (`ask_for_time`). A task that is
cancelled by its own code or step gets Cancelled at its present or next yield. A second cancel does nothing.

When the time is over, the task is closed at its present yield. If it still waits for its children to clean up, it gets Cancelled
first: so a command that needs no wait (a halt by PDO) still goes out.
"""

from __future__ import annotations

import enum
from collections.abc import Collection
from typing import Any, Final, TypeVar

from canopen_proto.group import Group
from canopen_proto.machine import NEVER, SECOND, Event, LocalProtocolError, Machine, Outbox, Outcome, RequestId, Time
from canopen_proto.procedures.steps import (
    Act,
    AllOf,
    AskForTime,
    Cancelled,
    Procedure,
    ProcedureError,
    Request,
    Requester,
    Step,
    Wait,
)
from canopen_proto.sdo.events import SdoProgress

T = TypeVar("T")

CLEAN_UP_TIME: Final = 1 * SECOND
"""How long the clean-up of a cancelled procedure may take, unless it asks for more: a dead node must not delay a shutdown."""


_OF_REQUESTS: Final = (Outcome, SdoProgress)
"""The events that tell of a Request."""


class ProcedureFinished(Outcome):
    """A procedure came to its end. result: its return value. request_id: the one that `run` returned."""

    __slots__ = ("result",)
    __match_args__ = ("node_id", "request_id", "result")

    def __init__(self, node_id: int, request_id: RequestId, result: Any) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.result = result


class ProcedureFailed(Outcome):
    """A procedure raised. error: a ProcedureError with a message for people, or any other exception (a bug in the procedure).
    request_id: the one that `run` returned."""

    __slots__ = ("error",)
    __match_args__ = ("node_id", "request_id", "error")

    def __init__(self, node_id: int, request_id: RequestId, error: Exception) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.error = error


class ProcedureCancelled(Outcome):
    """A procedure was cancelled and has cleaned up. clean_up_error: an error of the clean-up, or None. request_id: the one that
    `run` returned."""

    __slots__ = ("clean_up_error",)
    __match_args__ = ("node_id", "request_id", "clean_up_error")

    def __init__(self, node_id: int, request_id: RequestId, clean_up_error: Exception | None) -> None:
        self.node_id = node_id
        self.request_id = request_id
        self.clean_up_error = clean_up_error


class CleanUpTimeoutError(ProcedureError):
    """The clean-up of a cancelled procedure did not end in time (CLEAN_UP_TIME) and was given up."""


class _State(enum.Enum):
    RUNNING = enum.auto()
    CANCELLING = enum.auto()  # children are cleaning up, or its own clean-up runs
    DONE = enum.auto()


class _Task:
    __slots__ = (
        "active", "cancelled_at", "children", "clean_up_by", "clean_up_error", "error", "failure", "generator", "needs_until",
        "open_children", "parent", "request_id", "result", "state", "step", "thrown", "token", "urgent", "wake",
    )  # fmt: skip

    def __init__(self, generator: Procedure[Any], request_id: RequestId, parent: _Task | None) -> None:
        self.generator = generator
        self.request_id = request_id
        self.parent = parent
        self.state = _State.RUNNING
        self.active = False  # its code runs, or begins a step: a cancel meanwhile leaves the rest to _resume
        self.thrown = False  # Cancelled was thrown into it
        self.urgent: bool = parent is not None and parent.urgent  # it cleans up, or belongs to a clean-up
        self.step: Step | None = None  # the step that it waits for
        self.token: tuple[object, RequestId] | None = None  # of a Request under way
        self.wake: Time = NEVER
        self.cancelled_at: Time = NEVER
        self.clean_up_by: Time = NEVER
        self.needs_until: Time = -NEVER  # the time that it, or a child of it, asked for by AskForTime
        self.children: list[_Task] = []  # of the AllOf under way
        self.open_children = 0
        self.failure: Exception | None = None  # of the child that failed, if one did
        self.clean_up_error: Exception | None = None  # the first error in the clean-up of cancelled children
        self.result: object = None
        self.error: Exception | None = None

    @property
    def must_throw(self) -> bool:
        """Whether the task is cancelled, and Cancelled is still to be thrown into it."""
        return self.state is _State.CANCELLING and not self.thrown


class Runner(Machine):
    """Runs procedures. Attach it to the Network whose outbox it was made with; this and other Networks feed it by `observe`."""

    __slots__ = ("_asked_about_all", "_requests", "_waiting", "tasks")

    def __init__(self, out: Outbox) -> None:
        super().__init__(out)
        self.tasks: dict[RequestId, _Task] = {}
        self._requests: dict[tuple[object, RequestId], _Task] = {}
        # By kind of event, under None for those that are asked about each event: the tasks that wait for one, by their ids.
        self._asked_about_all: dict[RequestId, tuple[_Task, Wait]] = {}
        self._waiting: dict[type[Event] | None, dict[RequestId, tuple[_Task, Wait]]] = {None: self._asked_about_all}

    @property
    def busy(self) -> bool:
        """Whether any procedure runs."""
        return bool(self.tasks)

    @property
    def waits_for_the_usual(self) -> bool:
        """Whether a procedure waits for what may come with each frame (`Event.is_usual`), or is asked about each event."""
        return any(told and (kind is None or kind.is_usual) for kind, told in self._waiting.items())

    @property
    def needs_until(self) -> Time:
        """Until when the running procedures have asked for time, even if they end before; -NEVER if none has asked."""
        return max((task.needs_until for task in self.tasks.values()), default=-NEVER)

    def start(self, procedure: Procedure[T], now: Time) -> RequestId:
        """Start a procedure; it runs at once to its first wait. One Outcome event with the returned id follows."""
        task = self._add(procedure, None)
        self._resume(task, None, now)
        self._rearm()
        return task.request_id

    def cancel(self, request_id: RequestId, now: Time) -> None:
        """Cancel a procedure. Does nothing if the id is unknown, or if the procedure has ended or is being cancelled. request_id:
        the one that `run` returned."""
        task = self.tasks.get(request_id)
        if task is not None and task.parent is None:
            self._cancel(task, now)
            self._rearm()

    def observe(self, root: object, report: Event, now: Time) -> None:
        """Hand an event of the network with this `out.root` to the tasks that wait for it."""
        told, asked = self._waiting.get(type(report)), self._asked_about_all
        if not told and not asked and not isinstance(report, _OF_REQUESTS):
            return
        # In the order in which they were started. A task that begins to wait because of this event does not get it.
        waiting = [each for _, each in sorted([*(told or {}).items(), *asked.items()])]
        asking: _Task | None = None
        if isinstance(report, Outcome):
            asking = self._requests.pop((root, report.request_id), None)
            if asking is not None:
                asking.token = None
                self._resume(asking, report, now)
        elif isinstance(report, SdoProgress):
            asking = self._requests.get((root, report.request_id))
            if asking is not None:
                self._inform(asking, report, now)
        has_resumed = asking is not None
        for task, step in waiting:
            if task.step is step and (step.source is None or step.source.out.root is root):
                has_resumed |= self._tell(task, step, report, now)
        if has_resumed:
            self._rearm()

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        for task in tuple(self.tasks.values()):
            if task.clean_up_by <= now:
                self._give_up(task, now)
            elif task.wake <= now:
                self._resume(task, None, now)
        self._rearm()

    def _rearm(self) -> None:
        deadline = NEVER
        for task in self.tasks.values():
            deadline = min(deadline, task.wake, task.clean_up_by)
        self._arm(deadline)

    def _inform(self, task: _Task, report: SdoProgress, now: Time) -> None:
        """Hand the progress of a stream to the step that runs it."""
        step = task.step
        if not isinstance(step, Request) or step.news is None:
            return
        try:
            step.news(report, now)
        except Exception as error:  # noqa: BLE001 - a procedure's code too
            if task.step is step:  # else the task has cancelled itself
                self._drop_step(task, now)
                self._resume(task, None, now, error)

    def _tell(self, task: _Task, step: Wait, report: Event, now: Time) -> bool:
        """Resume a task if this is the event that it waits for; return whether it was."""
        assert step.match is not None
        error = None
        try:
            if not step.match(report):
                return False
        except Exception as raised:  # noqa: BLE001 - a procedure's code too
            error = raised
        self._resume(task, report, now, error)
        return True

    def _add(self, procedure: Procedure[Any], parent: _Task | None) -> _Task:
        task = _Task(procedure, self.out.next_request_id(), parent)
        self.tasks[task.request_id] = task
        return task

    def _resume(self, task: _Task, value: object, now: Time, error: BaseException | None = None) -> None:
        """Run a task until it waits for a step or ends."""
        self._leave_step(task)
        task.active = True
        result: object = None
        failure: Exception | None = None
        while True:
            try:
                step = task.generator.send(value) if error is None else task.generator.throw(error)
            except StopIteration as stop:
                result = stop.value
                break
            except Cancelled:
                if task.state is _State.RUNNING:
                    failure = ProcedureError("the procedure raised Cancelled, but nobody cancelled it")
                break
            except Exception as raised:  # noqa: BLE001 - the procedure is the caller's code: any exception is its outcome
                failure = raised
                break
            if not task.must_throw:
                try:
                    value, error = self._take(task, step, now), None
                except Exception as refused:  # noqa: BLE001 - a refused step (LocalProtocolError) is the procedure's to handle
                    value, error = None, refused
            if task.must_throw:  # it has cancelled itself
                self._drop_step(task, now)
                if not task.open_children:
                    value, error = None, self._cancelled(task)
            if task.step is not None or task.open_children:
                task.active = False
                return
        # Not in the except clauses: an error that the parent raises would get ours as its context.
        self._end(task, result, failure, now)

    def _take(self, task: _Task, step: Step, now: Time) -> object:
        """Begin a step. Returns its result, or sets task.step if the task has to wait for it."""
        match step:
            case Act():
                return step.function(now)
            case Request():
                root = step.requester.out.root
                if self._is_attached:
                    _check_attached(step.requester)
                task.token = (root, step.submit(now, task.urgent))
                self._requests[task.token] = task
            case Wait():
                task.wake = NEVER if step.timeout is None else now + step.timeout
                if step.match is not None:
                    for kind in _kinds_of(step):
                        self._waiting.setdefault(kind, {})[task.request_id] = task, step
            case AllOf():
                self._start_children(task, step, now)
                if not task.open_children:
                    results, failure = self._results(task)
                    if failure is not None:
                        raise failure
                    return results
            case AskForTime():
                self._grant(task, now + step.duration)
                return None
            case _:
                raise TypeError(f"a procedure yielded {step!r}, which is not a step; did it say 'yield' for 'yield from'?")
        task.step = step
        return None

    def _grant(self, task: _Task | None, until: Time) -> None:
        """Give a task, and those that wait for it, more time for its clean-up."""
        while task is not None:
            task.needs_until = max(task.needs_until, until)
            if task.state is _State.CANCELLING:
                task.clean_up_by = max(task.clean_up_by, until)
            task = task.parent

    def _start_children(self, task: _Task, step: AllOf, now: Time) -> None:
        task.failure = None
        task.children = [self._add(procedure, task) for procedure in tuple(step.procedures)]
        task.open_children = len(task.children)
        for child in task.children:
            if child.state is _State.RUNNING:  # a child that fails at once also cancels siblings that have not begun
                self._resume(child, None, now)

    def _cancel(self, task: _Task, now: Time) -> None:
        if task.state is not _State.RUNNING:
            return
        task.state = _State.CANCELLING
        task.cancelled_at, task.clean_up_by = now, now + CLEAN_UP_TIME
        self._drop_step(task, now)
        if task.open_children:
            for child in task.children:
                self._cancel(child, now)  # the last one that ends throws Cancelled into this one
        elif not task.active:
            self._resume(task, None, now, self._cancelled(task))

    def _cancelled(self, task: _Task) -> Cancelled:
        task.thrown = task.urgent = True
        return Cancelled()

    def _drop_step(self, task: _Task, now: Time) -> None:
        """Cancel the step that the task waits for, but not its children."""
        step = self._leave_step(task)
        if isinstance(step, Request) and task.token is not None:
            del self._requests[task.token]
            _cancel_request(step.requester, task.token[1], now)
            task.token = None

    def _leave_step(self, task: _Task) -> Step | None:
        """Let the task wait no longer for its step, and return the step."""
        step, task.step, task.wake = task.step, None, NEVER
        if isinstance(step, Wait) and step.match is not None:
            for kind in _kinds_of(step):
                self._waiting[kind].pop(task.request_id, None)  # a kind may stand in it twice
        return step

    def _give_up(self, task: _Task, now: Time) -> None:
        """End a clean-up that took too long: close the generator at its present yield, and all tasks that it runs."""
        if task.must_throw:
            self._give_up_children(task, now)  # the last one throws Cancelled into this one
        if task.state is _State.DONE:
            return
        self._drop_step(task, now)
        task.active = True  # so that the end of its children does not resume it
        self._give_up_children(task, now)
        error: Exception = CleanUpTimeoutError(
            f"the clean-up did not end within {(now - task.cancelled_at) / 1e9:g} s and was given up"
        )
        try:
            task.generator.close()
        except Cancelled:
            pass  # the generator has ended, as it should when it is closed
        except Exception as raised:  # noqa: BLE001 - as in _resume; e.g. RuntimeError for a generator that yields in `finally`
            error = raised
        self._end(task, None, error, now)

    def _give_up_children(self, task: _Task, now: Time) -> None:
        for child in tuple(task.children):
            if child.state is not _State.DONE:
                self._give_up(child, now)

    def _end(self, task: _Task, result: object, error: Exception | None, now: Time) -> None:
        was_cancelled = task.state is _State.CANCELLING
        if was_cancelled:
            error = error or task.clean_up_error
        self._leave_step(task)
        task.state, task.active, task.clean_up_by = _State.DONE, False, NEVER
        task.result, task.error = result, error
        del self.tasks[task.request_id]
        if task.parent is not None:
            self._child_ended(task.parent, task, was_cancelled, now)
        elif was_cancelled:
            self.out.events.append(ProcedureCancelled(0, task.request_id, error))
        elif error is not None:
            self.out.events.append(ProcedureFailed(0, task.request_id, error))
        else:
            self.out.events.append(ProcedureFinished(0, task.request_id, result))

    def _child_ended(self, parent: _Task, child: _Task, was_cancelled: bool, now: Time) -> None:
        if child.error is not None:
            if was_cancelled:
                parent.clean_up_error = parent.clean_up_error or child.error
            else:
                parent.failure = child.error  # the only one: a child that fails from now on was cancelled
                for sibling in parent.children:
                    self._cancel(sibling, now)
        parent.open_children -= 1
        if parent.open_children or parent.active:
            return  # other children have not ended, or the parent's own _resume does the rest
        if parent.must_throw:
            self._resume(parent, None, now, self._cancelled(parent))
            return
        results, failure = self._results(parent)
        self._resume(parent, results, now, failure)

    def _results(self, parent: _Task) -> tuple[list[object], Exception | None]:
        """Return the result of an AllOf whose children have all ended: their results, or the first failure."""
        children, parent.children = parent.children, []
        failure = parent.failure
        if failure is not None and parent.clean_up_error is not None:
            failure.add_note(f"and the clean-up of a procedure beside it failed: {parent.clean_up_error}")
            parent.clean_up_error = None
        return [child.result for child in children], failure


def _cancel_request(requester: Requester, request_id: RequestId, now: Time) -> None:
    """Cancel a request. The group of a member, such as the node of an SDO client, reacts to how it ends, as to all else."""
    owner = requester.out.owner
    mark = len(requester.out.events)
    requester.cancel(request_id, now)
    if isinstance(owner, Group):
        owner._settle(mark, now)


def _kinds_of(step: Wait) -> Collection[type[Event] | None]:
    """Return the kinds of event that a step waits for; None alone if it has to be asked about each event."""
    return (None,) if step.kinds is None else step.kinds


def _check_attached(requester: Requester) -> None:
    """Refuse the request of a machine that no network hands its answers to: it would have no outcome."""
    machine: object = requester
    out = requester.out
    while out.owner is not None:
        machine, out = out.owner, out.owner.out
    if isinstance(machine, Machine) and not machine._is_attached:
        node_id = getattr(machine, "node_id", None)
        name = type(machine).__name__ + ("" if node_id is None else f" of node {node_id}")
        raise LocalProtocolError(f"the {name} is not attached, so no answer would reach it: network.attach(...) comes first")
