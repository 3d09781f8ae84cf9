"""The kit itself: the transport that docs/extending.md shows passes, and planted faults are found by the cases about them."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio
import trio.testing

from canopen_proto.frame import Frame
from canopen_proto.verdict import Result
from canopen_transports import Transport, TransportError
from canopen_transports.conformance import CASES, NotApplicable, Site, SiteBus, TransportCase, ViolationError, run_all
from canopen_transports.conformance.__main__ import main
from tests.transports.support import cases

CHAPTER = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8").split("## A transport\n")[1]
SHOWN: dict[str, Any] = {}
for example in re.findall(r"```python\n(.*?)```", CHAPTER, re.DOTALL)[:2]:
    exec(example, SHOWN)
Shown: Any = SHOWN["MyTransport"]


def site(made: Callable[[list[Transport]], Transport], **options: Any) -> Site:
    @asynccontextmanager
    async def bus() -> AsyncIterator[SiteBus]:
        members: list[Transport] = []

        async def join(_place: int) -> Transport:
            return made(members)

        yield SiteBus(join)

    return Site(bus, virtual_time=True, **options)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("case", cases(site(Shown)), ids=str)
def test_the_example_keeps_all_promises(case: TransportCase) -> None:
    case.run(site(Shown))


@pytest.mark.parametrize("case", [case for case in CASES if case.name in ("order", "filters")], ids=str)
def test_the_tests_that_the_chapter_shows_run(case: TransportCase) -> None:
    try:
        SHOWN["test_my_transport"](case)
    except pytest.skip.Exception:
        assert case.name == "filters"


# ---- faults ----


class Echoes(Shown):  # type: ignore[misc]
    async def send(self, frame: Frame) -> None:
        await super().send(frame)
        self.queue.put((frame, None))


class Swaps(Shown):  # type: ignore[misc]
    held: Frame | None = None

    async def send(self, frame: Frame) -> None:
        held, self.held = self.held, None if self.held else frame
        if held:
            await super().send(frame)
            await super().send(held)


class Loses(Shown):  # type: ignore[misc]
    count = 0

    async def send(self, frame: Frame) -> None:
        self.count += 1
        if self.count % 100:
            await super().send(frame)


class Repeats(Shown):  # type: ignore[misc]
    async def send(self, frame: Frame) -> None:
        await super().send(frame)
        if frame.data[:1] == b"\x10":
            await super().send(frame)


class Rewrites(Shown):  # type: ignore[misc]
    """What comes is not what was sent, in a way that `rewrite` says."""

    rewrite: Callable[[Frame, int], tuple[object, object]]

    async def receive(self) -> Any:
        frame, stamp = await super().receive()
        return type(self).rewrite(frame, stamp)


class ForgetsLengths(Rewrites):
    rewrite = staticmethod(lambda frame, stamp: (Frame(frame.can_id, frame.data, frame.flags, len(frame.data)), stamp))  # type: ignore[assignment]


class HandsOutItsBuffer(Rewrites):
    rewrite = staticmethod(lambda frame, stamp: (Frame(frame.can_id, bytearray(frame.data), frame.flags, frame.dlc), stamp))  # type: ignore[assignment,arg-type]


class CountsMicroseconds(Rewrites):
    rewrite = staticmethod(lambda frame, stamp: (frame, stamp // 1000))  # type: ignore[assignment]


class StampsRunBack(Rewrites):
    rewrite = staticmethod(lambda frame, stamp: (frame, stamp + frame.data[0] % 3))  # type: ignore[assignment]


class TakesWhatIsImpossible(Shown):  # type: ignore[misc]
    async def send(self, frame: Frame) -> None:
        await super().send(Frame(frame.can_id & 0x7FF))


class SendsThoughCancelled(Shown):  # type: ignore[misc]
    async def send(self, frame: Frame) -> None:
        with trio.CancelScope(shield=True):
            await super().send(frame)
        await trio.lowlevel.checkpoint()


class ReceivesThoughCancelled(Shown):  # type: ignore[misc]
    async def receive(self) -> Any:
        received = await super().receive()
        await trio.lowlevel.checkpoint()
        return received


class NeverYields(Shown):  # type: ignore[misc]
    async def receive(self) -> Any:
        if not self.closed and self.queue._items:
            return self.queue._items.popleft()
        return await super().receive()


class DropsSilently(Shown):  # type: ignore[misc]
    async def receive(self) -> Any:
        while len(self.queue._items) > 500:
            self.queue._items.popleft()
        return await super().receive()


class SleepsOnWhenClosed(Shown):  # type: ignore[misc]
    async def aclose(self) -> None:
        if not self.closed:
            self.closed = True
            self.bus.remove(self)
        await trio.lowlevel.checkpoint()


class SendsOnWhenClosed(Shown):  # type: ignore[misc]
    async def send(self, frame: Frame) -> None:
        for member in self.bus:
            if member is not self:
                member.queue.put((frame, None))
        await trio.lowlevel.checkpoint()


class ClosesOnce(Shown):  # type: ignore[misc]
    async def aclose(self) -> None:
        self.bus.remove(self)
        self.closed = True
        self.queue.close()
        await trio.lowlevel.checkpoint()


class ClosesLater(Shown):  # type: ignore[misc]
    async def aclose(self) -> None:
        await trio.lowlevel.checkpoint()
        await super().aclose()


class LeavesADescriptor(Shown):  # type: ignore[misc]
    left: list[int] = []

    async def aclose(self) -> None:
        self.left.append(os.open(os.devnull, os.O_RDONLY))
        await super().aclose()


class LeavesAThread(Shown):  # type: ignore[misc]
    end = threading.Event()

    async def aclose(self) -> None:
        threading.Thread(target=self.end.wait, name="left", daemon=True).start()
        await super().aclose()


class Overtakes(Shown):  # type: ignore[misc]
    """send waits a little, and send_nowait does not look at whether somebody waits."""

    async def send(self, frame: Frame) -> None:
        await trio.sleep(0.001)
        await super().send(frame)
        if self.held:
            await super().send(self.held)
            self.held = None

    held: Frame | None = None

    def send_nowait(self, frame: Frame) -> bool:
        self.held, held = frame, self.held
        return held is None


class TakesTooMuch(Shown):  # type: ignore[misc]
    async def receive_many(self, limit: int) -> Any:
        return [await self.receive(), *self.queue.take_many(limit)]


class TakesThoughCancelled(Shown):  # type: ignore[misc]
    async def receive_many(self, limit: int) -> Any:
        taken = await self.queue.get_many(limit)
        await trio.lowlevel.checkpoint()
        return taken


class OvertakesPromptly(Shown):  # type: ignore[misc]
    def receive_nowait(self, limit: int) -> Any:
        return self.queue.take_many(limit)[::-1]


class TakesTooMuchPromptly(Shown):  # type: ignore[misc]
    def receive_nowait(self, limit: int) -> Any:
        return self.queue.take_many(limit + 1)


class PushesPastOthers(Shown):  # type: ignore[misc]
    receiver: Callable[[Frame, int], None] | None = None

    def push_to(self, receiver: Callable[[Frame, int], None] | None) -> None:
        self.receiver = receiver

    async def send(self, frame: Frame) -> None:
        for member in self.bus:
            if member is not self and member.receiver is not None:
                member.receiver(frame, 0)
                return
        await super().send(frame)


class FiltersByIdentifierOnly(Shown):  # type: ignore[misc]
    filtered = True
    wanted: set[int] | None = None

    def set_filters(self, keys: Iterable[int] | None) -> bool:
        self.wanted = None if keys is None else {key & 0x1FFFFFFF for key in keys}
        return keys is not None

    async def receive(self) -> Any:
        while True:
            received = await super().receive()
            if self.wanted is None or received[0].can_id in self.wanted:
                return received


class GoesOnCyclically(Shown):  # type: ignore[misc]
    sends_sync = True

    def start_cyclic(self, frames: list[Frame], period: int) -> None:
        trio.lowlevel.spawn_system_task(self.say, frames, period)

    async def say(self, frames: list[Frame], period: int) -> None:
        while not self.closed:
            for frame in frames:
                for member in self.bus:
                    member.queue.put((frame, 0))
                    member.queue.wake()
                await trio.sleep(period / 1e9)

    def stop_cyclic(self) -> None: ...


@pytest.mark.thorough(4)
@pytest.mark.parametrize(
    ("faulty", "found_by", "said"),
    [
        (Echoes, "no_echo", "came back"),
        (Swaps, "order", "from place 0 on \\[\\d*1, \\d*0"),
        (Loses, "order", "nothing more"),
        (Loses, "stream", "1 before it were missing, 0 reported lost"),
        (Repeats, "stream", "twice, or out of order"),
        (ForgetsLengths, "every_kind_of_frame", "was sent, and"),
        (HandsOutItsBuffer, "every_kind_of_frame", "no Frame with bytes|bytes object expected"),
        (CountsMicroseconds, "time_stamps", "50000 ns apart"),
        (StampsRunBack, "time_stamps_in_a_stream", "run back"),
        (TakesWhatIsImpossible, "impossible_frames", "was accepted \\(identifier too high\\)"),
        (SendsThoughCancelled, "cancelled_send", "surplus \\[0"),
        (SendsThoughCancelled, "storm_on_send", "surplus"),
        (ReceivesThoughCancelled, "cancelled_receive", "did not come"),
        (ReceivesThoughCancelled, "storm_on_receive", "a frame that was sent has not come|missing"),
        (NeverYields, "others_run", "without letting another task run"),
        (DropsSilently, "burst_that_nobody_takes", "reported lost"),
        (SleepsOnWhenClosed, "closing_wakes_the_receiver", "the case hangs"),
        (SendsOnWhenClosed, "what_is_closed_stays_closed", "send on a closed transport returned"),
        (SendsOnWhenClosed, "closing_wakes_the_senders", "returned"),
        (ClosesOnce, "what_is_closed_stays_closed", "remove"),
        (ClosesOnce, "closing_by_two_tasks", "remove"),
        (ClosesLater, "cancelled_close", "hangs"),
        (LeavesADescriptor, "no_echo", "descriptor \\d+ \\(/dev/null\\)"),
        (LeavesAThread, "no_echo", "thread 'left'"),
        (Overtakes, "eager_send", "from place"),
        (TakesTooMuch, "many_at_once", "receive_many\\(1\\) returned 2 items"),
        (TakesThoughCancelled, "many_at_once", "missing"),
        (OvertakesPromptly, "what_has_come", "from place"),
        (TakesTooMuchPromptly, "what_has_come", "receive_nowait\\(3\\) returned 4 items"),
        (PushesPastOthers, "pushed_frames", "pushed past others"),
        (FiltersByIdentifierOnly, "filters", "came instead of"),
        (GoesOnCyclically, "cyclic_frames", "after they were stopped"),
    ],
)
def test_a_fault_is_found(faulty: Any, found_by: str, said: str) -> None:
    (case,) = [case for case in CASES if case.name == found_by]
    LeavesAThread.end.clear()
    try:
        verdict = case.verdict(site(faulty))
    finally:
        LeavesAThread.end.set()
        while LeavesADescriptor.left:
            os.close(LeavesADescriptor.left.pop())
    assert verdict.result is Result.FAILED
    assert re.search(said, verdict.reason), verdict.reason


# ---- errors on opening ----


def _opening(opened: Any) -> Any:
    async def attempt() -> Transport:
        if isinstance(opened, Exception):
            raise opened
        return opened()  # type: ignore[no-any-return]

    return attempt


GOOD = {"seen": "nothing", "cause": "no cable", "tries": ("plug it in",)}


@pytest.mark.parametrize(
    ("opened", "said"),
    [
        (TransportError("CO101", "my:0", "cannot open my:0", **GOOD), ""),  # type: ignore[arg-type]
        (TransportError("CO100", "my:0", "my:0 makes no sense", seen="no 0", tries=("my:1",)), ""),
        (TransportError("CO111", "my:0", "cannot open my:0", **GOOD), "the code is CO111"),  # type: ignore[arg-type]
        (TransportError("CO101", "my:0", "it does not work", **GOOD), "does not name the bus"),  # type: ignore[arg-type]
        (TransportError("CO101", "my:0", "cannot open my:0", cause="?", tries=("?",)), "what was seen"),
        (TransportError("CO101", "my:0", "cannot open my:0", seen="?", tries=("?",)), "does not say why"),
        (TransportError("CO101", "my:0", "cannot open my:0", seen="?", cause="?"), "what to do"),
        (TransportError("CO101", "my:0", "cannot open my:0", seen="?", cause="?", tries=["?"] * 9), "12 lines"),
        (OSError("no such device"), "OSError: no such device"),
        (lambda: Shown([]), "was opened"),
    ],
)
def test_errors_that_do_not_help_are_found(opened: Any, said: str) -> None:
    (case,) = [case for case in CASES if case.name == "what_cannot_be_opened_says_what_to_do"]
    verdict = case.verdict(site(Shown, unopenable=(_opening(opened),)))
    assert verdict.result is (Result.FAILED if said else Result.PASSED)
    assert said in verdict.reason


# ---- how it is run ----


def test_all_verdicts_of_a_transport() -> None:
    verdicts = {case.name: verdict for case, verdict in run_all(site(Loses))}
    assert list(verdicts) == [case.name for case in CASES]
    assert verdicts["order"].result is Result.FAILED
    assert verdicts["no_echo"].result is Result.PASSED
    assert verdicts["filters"].result is Result.NOT_APPLICABLE
    assert len({case.title for case in CASES}) == len(CASES)


def test_a_violation_is_a_failed_assertion() -> None:
    (case,) = [case for case in CASES if case.name == "filters"]
    with pytest.raises(NotApplicable, match="does not filter"):
        case.run(site(Shown))
    assert issubclass(ViolationError, AssertionError)


def test_the_command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run = trio.run

    def run_in_virtual_time(*arguments: Any, clock: None = None) -> Any:
        return run(*arguments, clock=trio.testing.MockClock(autojump_threshold=0))

    monkeypatch.setattr(trio, "run", run_in_virtual_time)
    for locators, status, said in (
        (["virtual:trial"], 0, "none failed"),
        (["virtual:one", "virtual:other"], 1, "it needs 3 members of a bus, and 2 were given"),
    ):
        assert main(locators) == status
        assert said in capsys.readouterr().out
    for locators, status, said in (
        ([], 2, "NEVER run it on a bus with drives"),
        (["file:/no/trace.log"], 1, "CO101: cannot open"),
    ):
        assert main(locators) == status
        said_to = capsys.readouterr()
        assert said in said_to.err
        assert not said_to.out
