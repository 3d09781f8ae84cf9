"""`canopen log record`: write what passes on a bus into a file, or into one file after the other. Nothing is sent."""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click
import trio

from canopen_cli.live.frame_lines import Buses, FrameChoice, WantedFrames, choosing
from canopen_cli.live.source import open_live_source
from canopen_cli.shared.new_files import check_new_file
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import FILE, Duration, Settings, command, lasting, until_text
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.running import run_until_interrupted
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_cli.shared.time_left import time_left
from canopen_master.whole_file import file_at
from canopen_proto.machine import SECOND, Time
from canopen_transports.errors import ReceiveOverrun
from canopen_transports.log_files import LOSSES, log_writer
from canopen_transports.record import LogWriter, Record

NAMED: Final = "%Y%m%d-%H%M%S"
"""Of the time in the name of each file, with --rotate."""
LOOK: Final = 10 * SECOND
"""Between two looks whether the file is still there."""


@command("record")
@click.argument("target", metavar="FILE", type=FILE)
@choosing
@click.option(
    "--rotate", type=Duration(SECOND), help="Begin a new file each time: 1h. Its name has the time: trace-20260301-120000.log."
)
@click.option("--keep", type=click.IntRange(1), help="With --rotate: how many files of this run stay; the oldest is deleted.")
@lasting()
def record(
    settings: Settings, screen: Screen, target: Path, wanted: WantedFrames, rotate: Time | None, keep: int | None, seconds: float
) -> int:
    """Write what passes on a bus into a file, until Ctrl-C. Nothing is sent.

    The ending tells the kind: .log (candump's), .asc, .blf, .trc, .pcap, .pcapng. Exit status 5: no frame at all was heard.

    \b
    canopen log record trace.log -b can0
    canopen log record trace.log -b can0 --node 5 --service emcy,sdo
    canopen log record trace.log -b can0 --rotate 1h --keep 24
    """
    if target.suffix.lower() not in LOSSES and target.suffix.lower() != ".txt":
        raise usage(
            "CO123",
            f"{target} has no ending of a log file",
            tries=(f"{target.with_suffix('.log')}", f"one of {', '.join(LOSSES)}"),
        )
    if keep is not None and rotate is None:
        raise usage("CO001", "--keep goes with --rotate", tries=("--rotate 1h --keep 24",))
    if rotate is None:
        check_new_file(settings, screen, target)
    choice = FrameChoice(NodeFiles(settings, screen), wanted)
    files = _Files(target, rotate, keep, lambda text: screen.say(f"[yellow]{escape(text)}[/]"))

    async def listen() -> None:
        async with time_left(screen, "recording", seconds):
            with trio.move_on_after(seconds):
                await _record(settings, screen, choice, files, seconds)

    try:
        run_until_interrupted(settings, screen, listen)
        files.close()
    finally:
        files.give_up()
    if settings.json:
        screen.json(
            {
                "files": [str(each) for each in files.written],
                "frames": files.frames,
                "left_out": files.left_out,
                "lost": files.lost,
            }
        )
    names = ", ".join(str(each) for each in files.written) or "no file"
    screen.say(f"{counted(files.frames, 'frame')}: [bold]{escape(names)}[/]")
    if files.lost:
        screen.say(f"[yellow]{counted(files.lost, 'frame')} lost before they came here[/]")
    if not files.heard:
        screen.say("[yellow]no frame at all was heard[/]")
        return ExitCode.NO_ANSWER
    if files.left_out:
        raise CommandError(
            ExitCode.BAD_FILE, "CO343", f"{counted(files.left_out, 'frame')} could not be kept in {target.suffix}",
            seen=LOSSES.get(target.suffix.lower(), ""), tries=("a file that ends in .log holds all",),
        )  # fmt: skip
    return ExitCode.OK


@dataclass
class _FileOfRun:
    """A file of a recording, and how many frames are in it."""

    path: Path
    frames: int = 0


class _Files:
    """The file, or one after the other. written: those that are there. frames: in all of them. heard: how many came. lost: how
    many did not get here, at least. tell: says what a person has to know."""

    def __init__(self, target: Path, rotate: Time | None, keep: int | None, tell: Callable[[str], object] = print) -> None:
        self.heard = 0
        self.left_out = 0
        self.lost = 0
        self._parts: list[_FileOfRun] = []  # those that are there, the present one last
        self._last: tuple[Time, str] = 0, ""  # of the last frame
        self._target = target
        self._rotate = rotate
        self._keep = keep
        self._tell = tell
        self._writer: LogWriter | None = None
        self._is: tuple[int, int] | None = None  # what tells the present file from another one of its name
        self._begins: float = -math.inf
        self._ends: float = math.inf
        self._look_at: Time = 0

    @property
    def written(self) -> list[Path]:
        return [part.path for part in self._parts]

    @property
    def frames(self) -> int:
        return sum(part.frames for part in self._parts)

    def write(self, record: Record) -> None:
        """Write a frame into the file whose time it is. Raises CommandError."""
        try:
            if self._is_over(record.time):
                self._begin(record.time)
            assert self._writer is not None
            self._writer.write(record)
        except OSError as error:
            raise self._failed(error) from error
        self._last = record.time, record.channel
        self._parts[-1].frames += 1

    def lose(self, count: int) -> None:
        """Take note that frames were lost on their way here, and say so in the present file: who reads it would take what is
        missing for a fault of a node. Raises CommandError."""
        self.lost += count
        if self._writer is not None:
            try:
                self._writer.lost(*self._last)
            except OSError as error:
                raise self._failed(error) from error

    def _is_over(self, time: Time) -> bool:
        """Return whether a frame of this time belongs into a new file."""
        if self._writer is None or not self._begins <= time < self._ends:  # before its begin: the clock was set back
            return True
        return not self._look_at - LOOK <= time < self._look_at and self._is_away(time)

    def _begin(self, time: Time) -> None:
        self._end()
        path = self._target
        if self._rotate is not None:
            path = self._target.with_stem(f"{path.stem}-{datetime.datetime.fromtimestamp(time / SECOND).strftime(NAMED)}")
            self._begins, self._ends = time, time + self._rotate
        if self._rotate is not None or self._is is not None:
            path = _free(path)
        self._writer = log_writer(path)
        self._is, self._look_at = file_at(path), time + LOOK
        self._parts.append(_FileOfRun(path))
        while self._keep is not None and len(self._parts) > self._keep:
            oldest = self._parts.pop(0).path
            try:
                oldest.unlink(missing_ok=True)  # somebody else has taken it away
            except OSError as error:
                self._tell(f"{oldest} is one more than --keep, and cannot be deleted: {error.strerror}")

    def _is_away(self, time: Time) -> bool:
        """Return whether somebody has removed or renamed the present file, and say so: what is written into it is not where it is
        looked for."""
        self._look_at = time + LOOK
        part = self._parts[-1]
        if file_at(part.path) == self._is:
            return False
        self._end()
        self._parts.pop()
        self._tell(f"{part.path} was taken away, with {counted(part.frames, 'frame')}; a new file begins")
        return True

    def close(self) -> None:
        """End the present file. Raises CommandError."""
        try:
            self._end()
        except OSError as error:
            raise self._failed(error) from error

    def give_up(self) -> None:
        """Close the present file, whether it can be ended or not."""
        with suppress(OSError):
            self._end()

    def _end(self) -> None:
        if self._writer is not None:
            writer, self._writer = self._writer, None
            self.left_out += writer.left_out
            self._parts[-1].frames -= writer.left_out
            writer.close()

    def _failed(self, error: OSError) -> CommandError:
        """Return the error of a file that could not be written any more."""
        seen = f"{error.strerror}; {counted(self.frames, 'frame')} were written before: {', '.join(map(str, self.written))}"
        failed = f"cannot write {self._parts[-1].path if self._parts else self._target}"
        return CommandError(ExitCode.BAD_FILE, "CO341", failed, seen=seen, tries=("make room, or write elsewhere",))


def _free(path: Path) -> Path:
    """Return a path where there is no file yet: an hour may come twice, as at the end of summer time."""
    found, number = path, 1
    while found.exists():
        number += 1
        found = path.with_stem(f"{path.stem}-{number}")
    return found


async def _record(settings: Settings, screen: Screen, choice: FrameChoice, files: _Files, seconds: float) -> None:
    async with open_live_source(settings, None, is_dated=True) as live:
        screen.say(f"[bold]{escape(live.name)}[/], {until_text(seconds)}; nothing is sent")
        buses = Buses(choice.files)
        async for heard in live:
            if not isinstance(heard, Record):
                if isinstance(heard, ReceiveOverrun):
                    files.lose(heard.lost)
                screen.say(f"[yellow]{escape(heard.failed)}: {escape(heard.seen)}[/]")
                continue
            files.heard += 1
            _, observation = buses.observe(heard)
            if choice.shows(heard, observation):
                files.write(heard)
