"""Runs the async part of a command, so that Ctrl-C ends it in good order.

The first Ctrl-C (or SIGTERM) cancels the command. The master then halts what moves before it lets go of the bus, in at most
SHUTDOWN_TIME; a second Ctrl-C meanwhile changes nothing, since drives must not be left running. Then comes a `Problem` with exit
status 130, which tells what was done.
"""

from __future__ import annotations

import signal
from collections.abc import Awaitable, Callable, Iterable
from typing import TypeVar

import trio

from canopen_master.cli.options import Settings
from canopen_master.cli.problem import ExitCode, Problem, problem_of
from canopen_master.cli.screen import Screen

T = TypeVar("T")

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def run(
    settings: Settings, screen: Screen, command: Callable[[], Awaitable[T]], *, story: Callable[[], Iterable[str]] = lambda: ()
) -> T:
    """What `command` returns. story: on interruption, what has happened to the drives, line by line.

    Raises a Problem of status 130 after a Ctrl-C, and whatever the command raises.
    """
    return trio.run(_run, screen, command, story, clock=settings.clock)


async def _run(screen: Screen, command: Callable[[], Awaitable[T]], story: Callable[[], Iterable[str]]) -> T:
    results: list[T] = []
    failure: BaseException | None = None
    received: list[int] = []

    async def watch(scope: trio.CancelScope, task_status: trio.TaskStatus[None]) -> None:
        with trio.open_signal_receiver(*SIGNALS) as signals:
            task_status.started()
            async for number in signals:
                if received:
                    screen.say("[yellow]already ending: the drives are halted first[/]")
                else:
                    received.append(number)
                    screen.say("")  # off the line on which the terminal shows ^C
                    scope.cancel()

    async with trio.open_nursery() as nursery:
        with trio.CancelScope() as scope:
            await nursery.start(watch, scope)
            try:
                results.append(await command())
            except trio.Cancelled:
                raise
            except BaseException as error:  # noqa: BLE001 - handed on below; here it would come out wrapped in a group
                failure = error
        nursery.cancel_scope.cancel()
    if received:
        raise _interrupted(received[0], story(), failure)
    if failure is not None:
        raise failure
    return results[0]


def _interrupted(number: int, story: Iterable[str], failure: BaseException | None) -> Problem:
    problem = Problem(ExitCode.INTERRUPTED, "CO131", f"by {'Ctrl-C' if number == signal.SIGINT else signal.Signals(number).name}")
    problem.more += story
    errors = _without_cancelled(failure)
    if errors is not None:
        reason = problem_of(errors)
        problem.more += [f"{reason.code}: {reason.failed}", *reason.more]
        problem.seen = reason.seen
        problem.tries = reason.tries
        problem.__cause__ = errors
    return problem


def _without_cancelled(failure: BaseException | None) -> BaseException | None:
    if isinstance(failure, BaseExceptionGroup):
        return failure.split(trio.Cancelled)[1]
    return failure
