"""`file:trace.log`: a log file as a bus. It replays the frames; what we send reaches nobody.

    file:trace.log                  at the recorded speed
    file:trace.log?speed=10         ten times as fast; 0.1 is ten times slower
    file:trace.log?speed=max        without waiting, as fast as frames are taken
    file:trace.log?speed=step       one frame for each call of `step`: for programs and tests
    file:trace.log?send=refuse      sending raises an error (CO111); by default the frame is swallowed

Waiting uses the loop's clock, so a recorded hour takes no time under a virtual clock. Time stamps are those of the file, in ns
since 1970 if it has dates. Where they go back by more than a second, the frames behind come in their own time all the same. After
the last frame `receive` reports the end once (BusStateChanged, DOWN), and then waits for ever.

Frames of all buses in the file come, also those that the recorder sent.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from pathlib import Path
from typing import Final

from canopen_proto.frame import Frame
from canopen_transports.errors import BUS_LOST, CANNOT_OPEN, BusState, BusStateChanged, Report, TransportError, bad_locator
from canopen_transports.locator import Option
from canopen_transports.log_files import LogFileError, LogReader
from canopen_transports.loop import AsyncResource, current_loop
from canopen_transports.record import Record, RecordClock
from canopen_transports.transport import Received, check_frame

MAX: Final = math.inf
STEP: Final = 0.0
_OPTIONS: Final = ("speed", "send")
_SENDS: Final = ("swallow", "refuse")


class ReplayTransport(AsyncResource):
    """The only member of a recorded bus. speed: how many times as fast; MAX: without waiting; STEP: by `step` only.

    refuses: whether `send` raises. swallowed: how many frames `send` took. Must be made where trio or asyncio runs; the replay
    begins then.
    """

    def __init__(self, locator: str, path: Path, speed: float = 1.0, *, refuses: bool = False) -> None:
        self._loop = current_loop()
        self.locator = locator
        self.swallowed = 0
        self._refuses = refuses
        self._speed = speed
        self._clock = RecordClock()
        self._first: int | None = None
        self._due = 0  # when the next one comes, on the clock of the records
        try:
            self._reader = LogReader(path)
        except LogFileError as error:
            raise self._unreadable(error) from error
        self._records: Generator[Record] = iter(self._reader)
        self._start = self._loop.current_time()
        self._next: Record | None = None
        self._granted = 0
        self._ended = False
        self._failure: TransportError | None = None
        self._closed = self._loop.event()
        self._stepped = self._loop.parking_lot()
        self._advance()  # a file that is not a log must not open

    @property
    def skipped(self) -> int:
        """Entries of the file, so far, that are not classical CAN frames."""
        return self._reader.skipped

    @property
    def ended(self) -> bool:
        """Whether all frames were handed out."""
        return self._next is None

    def step(self, count: int = 1) -> None:
        """Let `count` more frames come, with speed STEP."""
        self._granted += count
        self._stepped.unpark_all()

    async def send(self, frame: Frame) -> None:
        """Swallow the frame, or raise TransportError (CO111)."""
        check_frame(frame)
        await self._loop.checkpoint_if_cancelled()
        self._check_open()
        if self._refuses:
            raise TransportError(
                BUS_LOST,
                self.locator,
                f"cannot send {frame} on {self.locator}",
                seen="this bus is a recording",
                tries=("leave out send=refuse: then frames are swallowed",),
            )
        self.swallowed += 1
        await self._loop.cancel_shielded_checkpoint()

    async def receive(self) -> Received | Report:
        """Return the next frame when it is due; one BusStateChanged at the end. Raises TransportError for a damaged file."""
        await self._loop.checkpoint()
        self._check_open()
        while self._next is None:
            if self._failure is not None:
                raise self._failure
            if not self._ended:
                self._ended = True
                return BusStateChanged(self.locator, BusState.DOWN, "the recording has ended")
            await self._wait(math.inf)
        record = self._next
        if self._speed == STEP:
            while not self._granted:
                await self._stepped.park()
                self._check_open()
            self._granted -= 1
        elif self._speed != MAX:
            assert self._first is not None
            due = self._start + (self._due - self._first) / 1e9 / self._speed
            while self._loop.current_time() < due:
                await self._wait(due)
        try:
            self._advance()
        except TransportError as error:  # raised after this frame
            self._next, self._failure = None, error
        return record.frame, record.time

    async def aclose(self) -> None:
        """Close the file."""
        self._closed.set()
        self._records.close()
        self._stepped.unpark_all()
        await self._loop.checkpoint()

    async def _wait(self, until: float) -> None:
        with self._loop.move_on_at(until):
            await self._closed.wait()
        self._check_open()

    def _check_open(self) -> None:
        if self._closed.is_set():
            raise self._loop.ClosedResourceError(f"{self.locator} was closed")

    def _advance(self) -> None:
        try:
            self._next = next(self._records, None)
        except LogFileError as error:
            raise self._unreadable(error) from error
        if self._next is not None:
            self._due = self._clock.set(self._next.time)
            self._first = self._due if self._first is None else self._first

    def _unreadable(self, error: LogFileError) -> TransportError:
        opening = self._first is None
        return TransportError(
            CANNOT_OPEN if opening else BUS_LOST,
            self.locator,
            f"cannot {'open' if opening else 'go on with'} {self.locator}",
            seen=f"{error.failed}: {error.seen}",
            cause=error.cause,
            tries=error.tries,
        )


def open_replay(locator: str, channel: str, options: dict[str, Option]) -> ReplayTransport:
    """Open the bus for the parts of a locator. Raises TransportError: CO100, CO101. channel: the path of the log file."""
    speed = options.get("speed", 1)
    factor = {"max": MAX, "step": STEP}.get(speed) if isinstance(speed, str) else float(speed)
    sends = options.get("send", _SENDS[0])
    unknown = [name for name in options if name not in _OPTIONS]
    if unknown:
        raise _bad(locator, f"a log file has no option {unknown[0]!r}; it has {', '.join(_OPTIONS)}")
    if factor is None or isinstance(speed, bool) or factor < 0 or not (factor or speed == "step") or math.isnan(factor):
        raise _bad(locator, f"the speed {speed!r} is neither a positive number nor max nor step")
    if sends not in _SENDS:
        raise _bad(locator, f"send={sends} is neither swallow nor refuse")
    if not channel:
        raise _bad(locator, "the locator names no file")
    return ReplayTransport(locator, Path(channel), factor, refuses=sends == "refuse")


def _bad(locator: str, seen: str) -> TransportError:
    return bad_locator(locator, seen, ("file:trace.log", "file:trace.log?speed=max&send=refuse"))
