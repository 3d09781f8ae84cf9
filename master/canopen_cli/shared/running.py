"""Run the async part of a command, so that Ctrl-C ends it in good order.

The first Ctrl-C, SIGTERM, or SIGHUP (the terminal is gone) cancels the command. The master then halts moving drives before it
closes the bus; canopen_master/session.py says how long that may take. A second one meanwhile changes nothing, since drives must
not be left running. The result is a `CommandError` with exit status 130, which says what was done.

With --trace all traffic of the buses is recorded meanwhile, including the last frames of that ending.
"""

from __future__ import annotations

import logging
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any, Final, TypeAlias, TypeVar

import trio

from canopen_cli.shared.new_files import check_new_file
from canopen_cli.shared.options import DEMO, Settings
from canopen_cli.shared.over_text import check_has_way
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.streams import put_lost_terminal_to_rest
from canopen_master.errors import HaltNotConfirmedError
from canopen_master.participant.patient_clock import PatientClock
from canopen_master.watchdog import LOGGER
from canopen_transports.tracing import Trace, recording

T = TypeVar("T")

Story: TypeAlias = Callable[[bool], list[str]]
"""Tells what happened to the drives, line by line. Its argument: whether all of them confirmed that they stand."""

SIGNALS = (signal.SIGINT, signal.SIGTERM)
HANG_UP: Final = getattr(signal, "SIGHUP", None)
"""The terminal is gone; None on a system that does not tell (Windows)."""


def run(
    settings: Settings,
    screen: Screen,
    command: Callable[[], Awaitable[T]],
    *,
    story: Story = lambda confirmed: [],
    devices: bool = False,
    reads: Path | None = None,
    over_text: bool = False,
    loop: Callable[..., Any] | None = None,
) -> T:
    """Run `command` and return its result.

    story: told on interruption. devices: this command is about its simulated devices. reads: a log file that it reads. over_text:
    it has a way over a text gateway. loop: runs trio, as `trio.run` does.

    Raises a CommandError with status 130 after a Ctrl-C, a CommandError if --trace would overwrite a file, LogFileError if
    --trace cannot begin, and what the command raises.
    """
    if not over_text:
        check_has_way(settings.named_bus())
    if settings.clock is None and settings.named_bus() == DEMO:
        settings.clock = PatientClock()

    def work() -> T:
        result: T = (loop or trio.run)(_run, screen, command, story, clock=settings.clock)
        return result

    if settings.trace is None:
        with _warnings_on(screen):
            return work()
    bus = settings.named_bus() or ""
    replayed = Path(bus.removeprefix("file:").partition("?")[0]) if bus.startswith("file:") else reads
    if replayed is not None and same_file(replayed, settings.trace):
        raise usage("CO123", f"--trace would replace {replayed}, which is being read", tries=("--trace other.log",))
    check_new_file(settings, screen, settings.trace)
    from canopen_transports.log_files import log_writer  # formats of logs need long to import

    with _warnings_on(screen), recording(log_writer(settings.trace), devices_are_ours=devices) as trace:
        try:
            return work()
        finally:
            trace.close()
            settings.late = _missing(settings.trace, trace)
            if settings.late is None:
                screen.say(f"[dim]{counted(trace.recorded, 'frame')} recorded: {escape(str(settings.trace))}[/]")


def run_until_interrupted(
    settings: Settings,
    screen: Screen,
    command: Callable[[], Awaitable[None]],
    *,
    devices: bool = False,
    reads: Path | None = None,
    loop: Callable[..., Any] | None = None,
) -> None:
    """Run a command that is meant to end by Ctrl-C. devices, reads, loop: as for `run`."""
    screen.tell_at_once()
    try:
        run(settings, screen, command, devices=devices, reads=reads, loop=loop)
    except CommandError as ended:
        if ended.exit_code is not ExitCode.INTERRUPTED:
            raise
        screen.say("ended")


def first_of(error: BaseException) -> BaseException:
    """Return the error that nurseries wrapped in groups: the first one, if there are several."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error


@asynccontextmanager
async def first_error() -> AsyncIterator[None]:
    """Raises the first error of what nurseries put into a group, with its own cause, in the place of the group."""
    try:
        yield
    except ExceptionGroup as group:
        first = first_of(group)
        raise first from first.__cause__


@contextmanager
def _warnings_on(screen: Screen) -> Iterator[None]:
    """Shows warnings of the master (a drive that will not stop by itself) and of a gateway on the screen."""

    class OnScreen(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            screen.say(f"[yellow]{escape(record.getMessage())}[/]")

    handler = OnScreen(logging.WARNING)
    loggers = LOGGER, logging.getLogger("canopen_gateway")
    for logger in loggers:
        logger.addHandler(handler)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeHandler(handler)


def _missing(path: Path, trace: Trace) -> CommandError | None:
    """Return a CommandError if the trace lacks something."""
    from canopen_transports.log_files import LOSSES

    tries = ("--trace FILE.log, where there is room",)
    if trace.failure is not None:
        seen = f"{trace.failure.strerror} after {counted(trace.recorded, 'frame')}"
    elif trace.left_out:
        seen = f"{counted(trace.left_out, 'frame')} missing in it ({path.suffix}: {LOSSES[path.suffix.lower()]})"
    elif trace.lost:
        seen, tries = f"{counted(trace.lost, 'frame')} lost before being recorded", ("once more, on a computer less busy",)
    else:
        return None
    return CommandError(ExitCode.BAD_FILE, "CO343", f"the trace {path} is not complete", seen=seen, tries=tries)


def same_file(one: Path, other: Path) -> bool:
    """Return whether two paths lead to the same existing file."""
    try:
        return one.samefile(other)
    except OSError:
        return False


async def _run(screen: Screen, command: Callable[[], Awaitable[T]], story: Story) -> T:
    results: list[T] = []
    failure: BaseException | None = None
    received: list[int] = []

    async def watch(signals: AsyncIterator[int], scope: trio.CancelScope) -> None:
        async for number in signals:
            if number == HANG_UP:
                put_lost_terminal_to_rest()
            if received:
                screen.say("[yellow]already ending: the drives are halted first[/]")
            else:
                received.append(number)
                scope.cancel()

    numbers: tuple[int, ...] = SIGNALS
    if HANG_UP is not None and signal.getsignal(HANG_UP) is not signal.SIG_IGN:  # as `nohup` has it
        numbers = (*SIGNALS, HANG_UP)
    with trio.open_signal_receiver(*numbers) as signals:
        async with trio.open_nursery() as nursery:
            with trio.CancelScope() as scope:
                nursery.start_soon(watch, signals, scope)
                try:
                    results.append(await command())
                except BaseException as error:  # raised below: if raised here, it would come out wrapped in a group
                    failure = error
                    if not isinstance(error, Exception):
                        raise
            nursery.cancel_scope.cancel()
    if received and not results:
        raise _interrupted(received[0], story, failure)
    if failure is not None:
        raise failure
    return results[0]


def _interrupted(number: int, story: Story, failure: BaseException | None) -> CommandError:
    names = {signal.SIGINT: "Ctrl-C", HANG_UP: "the end of its terminal"}
    name = names.get(number) or signal.Signals(number).name
    problem = CommandError(ExitCode.INTERRUPTED, "CO132", f"interrupted by {name}")
    problem.also = story(all_stand(failure)) + notes_of(failure)
    errors = failure.split(trio.Cancelled)[1] if isinstance(failure, BaseExceptionGroup) else failure
    if errors is not None and not isinstance(errors, trio.Cancelled):
        from canopen_cli.shared.failures import problem_of  # only here: it knows the errors of all rooms

        reason = problem_of(errors)
        problem.also += [f"{reason.code}: {reason.failed}", *(text for text in reason.also if text not in problem.also)]
        problem.seen, problem.cause, problem.tries = reason.seen, reason.cause, reason.tries
        problem.__cause__ = errors
    return problem


def all_stand(error: BaseException | None) -> bool:
    """Return whether all drives confirmed that they stand: no exception is HaltNotConfirmedError, and none has a note about
    it."""
    if isinstance(error, BaseExceptionGroup):
        return all(all_stand(each) for each in error.exceptions)
    is_halt = isinstance(error, HaltNotConfirmedError) or (
        error is not None and isinstance(error.__cause__, HaltNotConfirmedError)
    )
    return not is_halt and not notes_of(error)


def notes_of(error: BaseException | None) -> list[str]:
    """Return the notes of an exception, and of those in a group: which drives did not confirm that they stand."""
    notes: list[str] = list(getattr(error, "__notes__", ()))
    if isinstance(error, BaseExceptionGroup):
        for each in error.exceptions:
            notes += notes_of(each)
    return notes
