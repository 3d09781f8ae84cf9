"""`LiveSource`: the frames of a bus, of a log file or of standard input, in their order and with their times.

    async with open_live_source(settings, source) as live:
        async for heard in live:
            if isinstance(heard, Record): ...

`canopen monitor`, `watch`, `top` and `emcy watch` read it, so that each shows a bus and a recording alike: they take a recording
by `--log FILE` (`recorded`). On a bus it sends nothing, and where the adapter can, it listens only.

A frame of a bus gets the time stamp of its transport, moved to the system's clock: the stamp is not late when this process is. A
recorded frame keeps its own time.
"""

from __future__ import annotations

import os
import stat
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import AsyncIterator, Generator, Iterator
from contextlib import AsyncExitStack, asynccontextmanager, closing, contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, TypeAlias, cast

import click
import trio

from canopen_cli.live.clocks import SystemClock, trio_now
from canopen_cli.live.reading import FileReading
from canopen_cli.shared.options import DEMO, Settings, option_group
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_master.simulation.serving import DEMO_LOCATOR, DEMO_NODES, simulated_drives
from canopen_proto.machine import Time
from canopen_transports import open_transport
from canopen_transports.errors import BusState, BusStateChanged, ReceiveOverrun, Report
from canopen_transports.locator import parse_bitrate, parse_locator
from canopen_transports.log_files import LogFileError, LogReader
from canopen_transports.loop import current_loop
from canopen_transports.receive_test import NO_WIRE, silently
from canopen_transports.record import Record
from canopen_transports.stamp_clock import StampClock
from canopen_transports.transport import BatchTransport, RatedTransport, Transport

if TYPE_CHECKING:
    from io import BufferedReader

FILE_OR_INPUT: Final = click.Path(dir_okay=False, path_type=Path, allow_dash=True)
"""The argument of a command that takes a log file, or - for standard input."""
INPUT: Final = Path("-")
INPUT_NAME: Final = "standard input"


class _NoFile(click.Argument):
    """The place where a recording once stood as an argument: a word there is refused, with what to type."""

    def get_usage_pieces(self, ctx: click.Context) -> list[str]:
        return []


def _refused(ctx: click.Context, param: click.Parameter, value: str | None) -> None:
    """Name the options, if a recording is given as an argument."""
    if value is None:
        return
    tries = [f"--log {value}    (if it is a recording)", *([f"-b {value}    (if it is a bus)"] if value != "-" else ())]
    raise usage("CO001", f"{ctx.command_path} takes no {value!r} as an argument", tries=tries)


recorded: Final = option_group(
    click.option("--log", "source", metavar="FILE", type=FILE_OR_INPUT, help="A recording in place of the bus; - is stdin."),
)
"""The option by which all commands of a bus take a recording in its place. The command takes `source`: Path | None."""


def no_file(command: Any) -> Any:
    """Add the refusal of a recording as an argument, to a command that has no arguments."""
    return click.argument("word", required=False, cls=_NoFile, expose_value=False, callback=_refused)(command)


Heard: TypeAlias = Record | Report
"""A frame; or the report of a loss, or of the state of a bus, at its place among the frames. A recording has only losses."""

BATCH: Final = 256
"""The most frames that are handed over at once; between two batches other tasks run."""
AHEAD: Final = 4096
"""Frames that are read from standard input before they are asked for."""


class LiveSource(ABC):
    """See this module's text. Iterate over it once, or call `take` until it returns nothing.

    name: the file or the bus, for people. is_live: a bus, whose time goes on between its frames; False: a recording. is_silent: a
    bus whose adapter does not even acknowledge frames. bitrate: of the bus, bit/s; None if it is not known. lost: frames that
    were lost on their way here. skipped: entries of a recording that are not classical CAN frames; last_skip: why the last one is
    none.
    """

    is_live = False
    is_silent = False
    bitrate: int | None = None

    def __init__(self, name: str) -> None:
        self.name = name
        self.lost = 0
        self._taken: deque[Heard] = deque()
        self._last: Time = 0

    def __aiter__(self) -> AsyncIterator[Heard]:
        return self

    async def __anext__(self) -> Heard:
        if not self._taken:
            self._taken.extend(await self.take())
        if not self._taken:
            raise StopAsyncIteration
        return self._taken.popleft()

    @abstractmethod
    async def take(self) -> list[Heard]:
        """Wait until there is something; return 1 to BATCH frames and reports in order, or nothing at the end of a recording.

        Raises LogFileError for a damaged file, after all that can be read; CommandError for a recording without a frame;
        TransportError for a bus that fails.
        """

    def now(self) -> Time:
        """Return the present, in ns on the clock of the frames: in a recording the time of the last frame that was taken."""
        return self._last

    def clear(self) -> None:  # noqa: B027 - a bus has none
        """Take the bar away that shows how far a recording is read: a line comes."""

    @property
    def skipped(self) -> int:
        return 0

    @property
    def last_skip(self) -> str:
        return ""


@asynccontextmanager
async def open_live_source(
    settings: Settings, source: Path | None, screen: Screen | None = None, *, is_dated: bool = False
) -> AsyncIterator[LiveSource]:
    """Open the file, or the bus of the options if there is none, while the block runs. source: - is standard input. screen: where
    to show how far a file is read; None for a picture that fills the screen. is_dated: times of a bus follow the system's clock
    where that is set, for a recording of weeks; else time only goes on.

    Raises CommandError, TransportError, LogFileError.
    """
    if source is not None:
        with _open_recording(source, screen) as recording:
            yield recording
        return
    bus = settings.required_bus()
    async with AsyncExitStack() as stack:
        locator = DEMO_LOCATOR if bus == DEMO else bus
        transport = await open_transport(silently(parse_locator(locator)))
        await stack.enter_async_context(transport)
        if bus == DEMO:
            await stack.enter_async_context(simulated_drives((DEMO_LOCATOR, node_id) for node_id in DEMO_NODES))
        yield _BusSource(bus, locator, transport, SystemClock() if is_dated and current_loop().is_real_time() else None)


def rate_of(text: str) -> int:
    """Return the bit rate, bit/s, that the option --bitrate gives. Raises CommandError."""
    try:
        return parse_bitrate(text)
    except ValueError as error:
        raise usage("CO001", str(error), tries=("--bitrate 500k",)) from None


def tell_skipped(screen: Screen, source: LogReader | LiveSource) -> None:
    """Tell how many entries of a recording were no frames, if any."""
    if source.skipped:
        screen.say(f"[yellow]{escape(skipped_text(source))}[/]")


def skipped_text(source: LogReader | LiveSource) -> str:
    """Return how many entries of a recording were no frames, and why the last was not."""
    return f"{counted(source.skipped, 'entry')} passed over, the last: {source.last_skip}"


def overrun_text(reader: LogReader) -> str:
    """Return why frames are missing from a recording before the record that was read last."""
    is_by_controller = reader.last_overrun == "an error frame"
    return "the controller of the recorder was overrun" if is_by_controller else reader.last_overrun


def tell_jumps(screen: Screen, jumps: int) -> None:
    """Tell how often the clock of a recording went back, if it did."""
    if jumps:
        screen.say(f"[yellow]{jumps_text(jumps)}[/]")


def jumps_text(jumps: int) -> str:
    """Return how often the clock of the frames went back. jumps: at least 1."""
    return f"the clock of the frames went back {counted(jumps, 'time')}; time goes on from there"


def frames_of(reader: LogReader) -> Generator[Record]:
    """Yield the frames of a recording, as all commands read it.

    Raises a CommandError if there was none: silence would look like a bus without faults.
    """
    record = None
    for record in reader:
        yield record
    if record is None:
        seen = skipped_text(reader) if reader.skipped else "it is empty"
        raise CommandError(ExitCode.BAD_FILE, "CO342", f"there is no frame in {reader.path}", seen=seen)


class _BusSource(LiveSource):
    is_live = True

    def __init__(self, name: str, locator: str, transport: Transport, system: SystemClock | None = None) -> None:
        super().__init__(name)
        self._system = system
        parsed = parse_locator(locator)
        self.is_silent = silently(parsed) != parsed.text and parsed.interface not in NO_WIRE
        self.bitrate = parsed.bitrate or (transport.bitrate if isinstance(transport, RatedTransport) else None)
        self._channel = parsed.channel or parsed.interface
        self._transport = transport
        self._batch = transport if isinstance(transport, BatchTransport) else None
        self._is_replay = parsed.interface == "file"
        self._clock = StampClock(time.time_ns() - trio_now() if system is None else system.zero)

    async def take(self) -> list[Heard]:
        received = [await self._transport.receive()] if self._batch is None else await self._batch.receive_many(BATCH)
        heard: list[Heard] = []
        if self._system is not None:
            self._clock.zero = self._system.look()
        for each in received:
            if isinstance(each, tuple):
                frame, stamp = each
                self._last = self._clock.time_of(stamp, trio_now())
                if self._is_replay and stamp is not None:
                    self._last = stamp  # of another day
                heard.append(Record(self._last, self._channel, frame))
            elif self._is_replay and isinstance(each, BusStateChanged) and each.state is BusState.DOWN:
                return heard  # the recording has ended
            else:
                self.lost += each.lost if isinstance(each, ReceiveOverrun) else 0
                heard.append(each)
        return heard

    def now(self) -> Time:
        return self._last if self._is_replay else max(self._last, trio_now() + self._clock.zero)


class _Recording(LiveSource):
    """A log file: read between the turns of other tasks."""

    def __init__(self, reader: LogReader, screen: Screen | None) -> None:
        super().__init__(str(reader.path))
        self._reader = reader
        self._read = frames_of(reader)
        self._reading = None if screen is None else FileReading(screen, reader, self._read)
        self._records = self._read if self._reading is None else iter(self._reading)
        self._failure: Exception | None = None
        self._overruns = 0

    async def take(self) -> list[Heard]:
        await trio.lowlevel.checkpoint()
        found: list[Heard] = []
        while len(found) < BATCH and (heard := self._next()):
            found += heard
        return self._handed_over(found)

    def _next(self) -> list[Heard]:
        """Return the next record, behind the report of what the recorder lost before it; nothing at the end."""
        try:
            record = next(self._records, None)
        except (LogFileError, CommandError) as error:  # told after all records before it
            self._failure = error
            return []
        if record is None:
            return []
        lost, self._overruns = self._reader.overruns - self._overruns, self._reader.overruns
        return [ReceiveOverrun(self.name, lost, overrun_text(self._reader)), record] if lost else [record]

    def _handed_over(self, found: list[Heard]) -> list[Heard]:
        if found:
            self._last = next((each.time for each in reversed(found) if isinstance(each, Record)), self._last)
        elif self._failure is not None:
            raise self._failure
        return found

    def clear(self) -> None:
        if self._reading is not None:
            self._reading.clear()

    def close(self) -> None:
        """Close the file."""
        self._records.close()
        self._read.close()

    @property
    def skipped(self) -> int:
        return self._reader.skipped

    @property
    def last_skip(self) -> str:
        return self._reader.last_skip


class _Stream(_Recording):
    """Standard input, which may make its reader wait: a thread reads it, at most AHEAD frames before they are taken."""

    def __init__(self, reader: LogReader) -> None:
        super().__init__(reader, None)
        self._ready: deque[Heard] = deque()
        self._room = threading.Semaphore(AHEAD)
        self._is_over = False
        self._woken = trio.Event()
        self._token = trio.lowlevel.current_trio_token()
        threading.Thread(target=self._run, name=f"read {self.name}", daemon=True).start()

    async def take(self) -> list[Heard]:
        await trio.lowlevel.checkpoint()
        while not self._ready and not self._is_over:
            self._woken = trio.Event()
            await self._woken.wait()
        found = [self._ready.popleft() for _ in range(min(BATCH, len(self._ready)))]
        if found:
            self._room.release(len(found))
        return self._handed_over(found)

    def close(self) -> None:
        """Let the thread end once its present wait for input is over; it keeps no process alive."""
        self._is_over = True
        self._room.release()

    def _run(self) -> None:
        with suppress(trio.RunFinishedError), closing(self._read):  # the run has ended: nobody takes any more
            while not self._is_over and (heard := self._next()):
                for each in heard:
                    self._room.acquire()
                    self._ready.append(each)
                self._token.run_sync_soon(self._wake, idempotent=True)
            self._is_over = True
            self._token.run_sync_soon(self._wake)

    def _wake(self) -> None:
        self._woken.set()


@contextmanager
def _open_recording(source: Path, screen: Screen | None) -> Iterator[_Recording]:
    recording: _Recording
    if source != INPUT:
        recording = _Recording(_reader_of_file(source), screen)
    elif _waits(sys.stdin):  # a handle of our own: at the end Python would wait for a thread that reads its own
        stream = open(sys.stdin.fileno(), "rb", closefd=False)  # noqa: SIM115 - the thread may read as long as the process lives
        recording = _Stream(LogReader(Path(INPUT_NAME), stream))
    else:
        recording = _Recording(reader_of(INPUT), screen)
    try:
        yield recording
    finally:
        recording.close()


def reader_of(source: Path) -> LogReader:
    """Return a reader of a log file; of standard input for -."""
    if source == INPUT:
        return LogReader(Path(INPUT_NAME), cast("BufferedReader", sys.stdin.buffer))
    return LogReader(source)


def _reader_of_file(source: Path) -> LogReader:
    if not source.suffix and not source.exists():
        raise usage("CO001", f"there is no file {source}", tries=(f"-b {source}    (if it is a bus)",))
    return LogReader(source)


def _waits(stream: IO[str]) -> bool:
    """Return whether a read of this stream may have to wait: it is a pipe, a terminal, a socket."""
    try:
        return not stat.S_ISREG(os.fstat(stream.fileno()).st_mode)
    except (OSError, ValueError):  # not a file: a test, a notebook
        return False
