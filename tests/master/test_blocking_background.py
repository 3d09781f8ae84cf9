"""A trio context in a thread of its own, and calls into it. Nothing here is about CANopen."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import AsyncIterator, Iterator

import pytest
import trio

from canopen_master.blocking.background import Background, _Call
from canopen_master.blocking.loop_thread import WATCH_INTERVAL, Waker
from canopen_master.errors import MasterClosedError
from canopen_proto.machine import LocalProtocolError

LIMIT = 60.0
"""Seconds after which a test gives up."""


class Place:
    """What the contexts of these tests give. log: what happened in them; failure: why they came to an end."""

    def __init__(self) -> None:
        self.log: list[str] = []
        self.failure: Exception | None = None
        self.scope = trio.CancelScope()

    async def answer(self) -> int:
        await trio.sleep(0)
        return 42

    async def wait(self) -> None:
        self.log.append("waiting")
        try:
            await trio.sleep_forever()
        except trio.Cancelled:
            with trio.CancelScope(shield=True):
                await trio.sleep(0.05)
            self.log.append("cleaned up")
            raise


@contextlib.asynccontextmanager
async def context(place: Place, leaving: Exception | None = None) -> AsyncIterator[Place]:
    with place.scope:
        yield place
    place.log.append("left")
    if leaving is not None:
        raise leaving


@pytest.fixture
def place() -> Place:
    return Place()


@pytest.fixture
def background(place: Place) -> Iterator[Background[Place]]:
    background = Background(lambda: context(place), lambda place: place.failure)
    background.start()
    yield background
    background.stop()


def until(condition: object) -> None:
    deadline = time.monotonic() + LIMIT
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < deadline
        time.sleep(0.005)


def interrupt_when(condition: object) -> threading.Thread:
    """Press Ctrl-C when something has happened."""

    def press() -> None:
        until(condition)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=press)
    thread.start()
    return thread


def test_a_call_gives_the_result(background: Background[Place]) -> None:
    assert background.is_running
    assert background.call(Place.answer) == 42


def test_a_call_raises_what_the_function_raises(background: Background[Place]) -> None:
    async def fail(place: Place) -> None:
        raise KeyError("k")

    with pytest.raises(KeyError):
        background.call(fail)
    assert background.call(Place.answer) == 42


def test_even_a_system_exit_of_the_function_only_ends_the_call(background: Background[Place]) -> None:
    async def leave(place: Place) -> None:
        raise SystemExit(3)

    with pytest.raises(SystemExit):
        background.call(leave)
    assert background.call(Place.answer) == 42


def test_a_loop_is_woken_without_what_only_linux_has(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "eventfd", raising=False)
    background = Background(lambda: context(place))
    background.start()
    assert [background.call(Place.answer) for _ in range(3)] == [42] * 3
    assert background.do(len, "four") == 4
    background.stop()


def test_many_threads_call_at_the_same_time(background: Background[Place]) -> None:
    inside = 0
    most = 0

    async def meet(place: Place) -> None:
        nonlocal inside, most
        inside += 1
        most = max(most, inside)
        with trio.move_on_after(LIMIT):
            while most < 8:
                await trio.sleep(0.001)
        inside -= 1

    threads = [threading.Thread(target=background.call, args=(meet,)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LIMIT)
    assert most == 8


def test_stop_ends_the_calls_that_wait(background: Background[Place], place: Place) -> None:
    errors: list[BaseException] = []

    def wait() -> None:
        try:
            background.call(Place.wait)
        except MasterClosedError as error:
            errors.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    until(lambda: place.log)
    assert background.stop() is None
    thread.join(LIMIT)
    assert len(errors) == 1
    assert place.log == ["waiting", "cleaned up", "left"]
    assert not background.is_running


def test_stop_ends_a_call_with_tasks_of_its_own_for_the_same_reason(background: Background[Place], place: Place) -> None:
    """What a nursery makes of its cancelled tasks may be a group."""
    errors: list[BaseException] = []

    async def wait_in_two_tasks(place: Place) -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(place.wait)
            nursery.start_soon(place.wait)

    def wait() -> None:
        try:
            background.call(wait_in_two_tasks)
        except BaseException as error:  # noqa: BLE001 - looked at below
            errors.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    until(lambda: len(place.log) == 2)
    background.stop()
    thread.join(LIMIT)
    assert [type(error) for error in errors] == [MasterClosedError]


def test_after_stop_nothing_is_called(background: Background[Place]) -> None:
    background.stop()
    with pytest.raises(MasterClosedError):
        background.call(Place.answer)
    assert background.stop() is None


def test_a_call_before_start_is_refused(place: Place) -> None:
    with pytest.raises(MasterClosedError):
        Background(lambda: context(place)).call(Place.answer)


def test_a_call_while_the_context_is_left_is_refused(place: Place) -> None:
    leaving = threading.Event()

    @contextlib.asynccontextmanager
    async def slow() -> AsyncIterator[Place]:
        yield place
        leaving.set()
        await trio.sleep(0.2)

    background = Background(slow)
    background.start()
    stopper = threading.Thread(target=background.stop)
    stopper.start()
    assert leaving.wait(LIMIT)
    with pytest.raises(MasterClosedError):
        background.call(Place.answer)
    stopper.join(LIMIT)


def test_entering_that_fails_raises_from_start() -> None:
    @contextlib.asynccontextmanager
    async def closed() -> AsyncIterator[Place]:
        raise OSError("no such bus")
        yield Place()

    background = Background(closed)
    with pytest.raises(OSError, match="no such bus"):
        background.start()
    assert not background.is_running
    assert background.stop() is None  # it was told


def test_what_leaving_raises_is_given_by_stop(place: Place) -> None:
    error = OSError("not halted")
    background = Background(lambda: context(place, error))
    background.start()
    assert background.stop() is error
    assert background.stop() is None  # once


def test_a_context_that_ends_by_itself_ends_the_calls_with_its_reason(background: Background[Place], place: Place) -> None:
    async def end(place: Place) -> None:
        place.failure = OSError("cable")
        place.scope.cancel()
        await trio.sleep_forever()

    with pytest.raises(OSError, match="cable"):
        background.call(end)
    until(lambda: "left" in place.log)
    with pytest.raises(OSError, match="cable"):
        background.call(Place.answer)


@pytest.mark.parametrize("turn", range(30))
def test_a_call_that_meets_the_very_end_of_the_context_is_told_so(background: Background[Place], place: Place, turn: int) -> None:
    """trio mixes up the order of what is due: this end and that call come in either order, in some of the turns."""
    late: list[_Call] = []

    async def end(place: Place) -> None:
        place.failure = OSError("cable")
        place.scope.cancel()
        try:
            await trio.sleep_forever()
        finally:
            late.append(_Call(background, place.answer, (), {}, None))
            background._soon(late[0].begin)

    with pytest.raises(OSError, match="cable"):
        background.call(end)
    until(lambda: late[0].is_done)
    assert str(late[0]._error) == "cable"
    until(lambda: "left" in place.log)


def test_a_call_in_the_thread_itself_is_refused(background: Background[Place]) -> None:
    async def call_again(place: Place) -> None:
        background.call(Place.answer)

    with pytest.raises(LocalProtocolError, match="own thread"):
        background.call(call_again)


def test_an_interrupt_takes_the_call_back_and_waits_for_its_clean_up(background: Background[Place], place: Place) -> None:
    thread = interrupt_when(lambda: place.log)
    with pytest.raises(KeyboardInterrupt):
        background.call(Place.wait)
    assert place.log == ["waiting", "cleaned up"]
    thread.join(LIMIT)
    assert background.call(Place.answer) == 42


def test_an_interrupt_while_the_thread_begins_leaves_none(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    begin = threading.Thread.start
    begun: list[threading.Thread] = []

    def interrupted(thread: threading.Thread) -> None:
        begin(thread)
        begun.append(thread)
        raise KeyboardInterrupt

    monkeypatch.setattr(threading.Thread, "start", interrupted)
    background = Background(lambda: context(place))
    with pytest.raises(KeyboardInterrupt):
        background.start()
    assert place.log == ["left"]
    begun[0].join(LIMIT)
    assert not begun[0].is_alive()


def test_an_interrupt_of_start_leaves_no_thread(place: Place) -> None:
    entering = threading.Event()

    @contextlib.asynccontextmanager
    async def slow() -> AsyncIterator[Place]:
        entering.set()
        while not background._is_stopping:
            await trio.sleep(0.005)
        yield place
        place.log.append("left")

    background = Background(slow)
    thread = interrupt_when(entering.is_set)
    with pytest.raises(KeyboardInterrupt):
        background.start()
    thread.join(LIMIT)
    assert place.log == ["left"]
    assert not any(each.name == "canopen master" for each in threading.enumerate())


class Inner:
    """What the contexts below give. log: how they ended."""

    def __init__(self) -> None:
        self.log: list[str] = []

    @contextlib.asynccontextmanager
    async def held(self, *, swallows: bool = False, leaving: Exception | None = None) -> AsyncIterator[int]:
        try:
            yield 42
        except ValueError as error:
            self.log.append(f"raised {error}")
            if not swallows:
                raise
        except trio.Cancelled:
            self.log.append("cancelled")
            raise
        else:
            self.log.append("left")
        if leaving is not None:
            raise leaving


def test_a_context_is_held_in_the_loop_while_a_block_runs(background: Background[Place]) -> None:
    inner = Inner()
    with background.held(inner.held) as value:
        assert value == 42
        assert inner.log == []
        assert background.call(Place.answer) == 42
    assert inner.log == ["left"]


def test_an_error_of_the_block_reaches_the_context_and_goes_on(background: Background[Place]) -> None:
    inner = Inner()
    error = ValueError("of mine")
    with pytest.raises(ValueError, match="of mine") as caught, background.held(inner.held):
        raise error
    assert caught.value is error
    assert inner.log == ["raised of mine"]
    with background.held(lambda: inner.held(swallows=True)):
        raise ValueError("of mine")


def test_an_interrupt_of_the_block_cancels_the_context(background: Background[Place]) -> None:
    inner = Inner()
    with pytest.raises(KeyboardInterrupt), background.held(inner.held):
        raise KeyboardInterrupt
    assert inner.log == ["cancelled"]


def test_what_leaving_a_held_context_raises_is_raised_at_the_end_of_the_block(background: Background[Place]) -> None:
    with pytest.raises(OSError, match="not halted"), background.held(lambda: Inner().held(leaving=OSError("not halted"))):
        pass


def test_a_held_context_that_cannot_be_entered_raises_at_once(background: Background[Place]) -> None:
    @contextlib.asynccontextmanager
    async def closed() -> AsyncIterator[int]:
        raise OSError("no such file")
        yield 0

    with pytest.raises(OSError, match="no such file"):
        background.held(closed).__enter__()


def test_a_held_context_ends_with_what_holds_it(background: Background[Place]) -> None:
    inner = Inner()
    with pytest.raises(MasterClosedError), background.held(inner.held):
        background.stop()
        assert inner.log == ["cancelled"]
    with pytest.raises(MasterClosedError):
        background.held(inner.held).__enter__()


def test_a_call_that_was_taken_back_before_it_began_never_begins(background: Background[Place], place: Place) -> None:
    """The loop is busy, so that the call waits; it is given up meanwhile, and the loop must not do it then."""
    done: list[str] = []
    goes_on = threading.Event()

    async def late(place: Place) -> None:
        done.append("late")

    busy = threading.Thread(target=background.do, args=(goes_on.wait, LIMIT))
    busy.start()
    until(lambda: background._calls)
    calls = [_Call(background, late, (place,), {}, None) for _ in range(3)]
    for call in calls:
        background.loop.hand_over(call.begin)
        background.loop.hand_over(call.cancel)
    goes_on.set()
    busy.join(LIMIT)
    until(lambda: all(call.is_done for call in calls))
    assert background.call(Place.answer) == 42
    assert done == []


@pytest.mark.parametrize("comes_late", [False, True])
def test_an_interrupt_right_before_or_behind_a_wake_loses_none(
    background: Background[Place], place: Place, monkeypatch: pytest.MonkeyPatch, comes_late: bool
) -> None:
    """An interrupt may come between any two lines: the loop has two tasks to wake, and neither may sleep on for ever."""
    wake, interrupts = Waker.wake, [True] * 4

    def interrupted(waker: Waker) -> None:
        if interrupts and interrupts.pop():
            interrupts.append(False)  # the taking back is not interrupted
            if comes_late:
                before = len(place.log)
                wake(waker)
                until(lambda: len(place.log) > before)  # the task that was woken is busy with the call
            raise KeyboardInterrupt
        wake(waker)

    loop = background.loop
    monkeypatch.setattr(Waker, "wake", interrupted)
    while interrupts:
        if comes_late:
            until(lambda: loop._front_waits and loop._dispatcher_waits)
        with pytest.raises(KeyboardInterrupt):
            background.call(Place.wait)
    assert background.call(Place.answer) == 42


def test_a_signal_handler_may_call_in_the_midst_of_a_call(background: Background[Place], monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither task of the loop may need anything that the interrupted call holds. Each would serve one call all the same."""
    wake, answers = Waker.wake, list[int]()

    def interrupted(waker: Waker) -> None:
        if not answers:
            monkeypatch.setattr(Waker, "wake", wake)
            answers.extend(background.call(Place.answer) for _ in range(5))
        wake(waker)

    monkeypatch.setattr(Waker, "wake", interrupted)
    assert background.call(Place.answer) == 42
    assert answers == [42] * 5


def test_an_interrupt_of_stop_is_raised_once_the_context_is_left() -> None:
    place, hurried = Place(), threading.Event()

    @contextlib.asynccontextmanager
    async def slow() -> AsyncIterator[Place]:
        yield place
        place.log.append("leaving")
        while not hurried.is_set():
            await trio.sleep(0.005)
        place.log.append("left")

    background = Background(slow, hurry=hurried.set)
    background.start()
    thread = interrupt_when(lambda: place.log)
    with pytest.raises(KeyboardInterrupt):
        background.stop()
    thread.join(LIMIT)
    assert place.log == ["leaving", "left"]


def test_what_goes_last_outlives_the_others_when_its_thread_has_ended() -> None:
    log: list[str] = []

    @contextlib.asynccontextmanager
    async def named(name: str) -> AsyncIterator[str]:
        yield name
        if name == "master":  # halting its drives takes it longer than they would need to be gone
            await trio.sleep(4 * WATCH_INTERVAL)
        log.append(name)

    backgrounds: list[Background[str]] = []

    def hold() -> None:
        owner = threading.current_thread()
        for name, goes_last in (("drives", True), ("master", False)):
            backgrounds.append(
                Background(
                    lambda name=name: named(name),  # type: ignore[misc]
                    shares_loop=True,
                    owner=owner,
                    goes_last=goes_last,
                )
            )
            backgrounds[-1].start()

    thread = threading.Thread(target=hold)
    thread.start()
    thread.join(LIMIT)
    for background in backgrounds:
        until(lambda: not background.is_running)  # noqa: B023 - it is waited for here
        background.stop()
    assert log == ["master", "drives"]
