"""`canopen log record`: write what passes on a bus into a file, or into one file after the other. Nothing is sent."""

from __future__ import annotations

import datetime
import math
from contextlib import suppress
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
from canopen_proto.machine import SECOND, Time
from canopen_transports.errors import ReceiveOverrun
from canopen_transports.log_files import LOSSES, log_writer
from canopen_transports.record import LogWriter, Record

NAMED: Final = "%Y%m%d-%H%M%S"
"""Of the time in the name of each file, with --rotate."""


@command("record")
@click.argument("target", metavar="FILE", type=FILE)
@choosing
@click.option(
    "--rotate", type=Duration(SECOND), help="Begin a new file each time: 1h. Its name has the time: trace-20260301-120000.log."
)
@click.option("--keep", type=click.IntRange(1), help="With --rotate: how many files stay; the oldest is deleted.")
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
    files = _Files(target, rotate, keep)

    async def listen() -> None:
        try:
            async with time_left(screen, "recording", seconds):
                with trio.move_on_after(seconds):
                    await _record(settings, screen, choice, files, seconds)
        finally:
            files.close()

    run_until_interrupted(settings, screen, listen)
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


class _Files:
    """The file, or one after the other. written: those that are there. frames: in all of them. heard: how many came. lost: how
    many did not get here, at least."""

    def __init__(self, target: Path, rotate: Time | None, keep: int | None) -> None:
        self.written: list[Path] = []
        self.frames = 0
        self.heard = 0
        self.left_out = 0
        self.lost = 0
        self._last: tuple[Time, str] = 0, ""  # of the last frame
        self._target = target
        self._rotate = rotate
        self._keep = keep
        self._writer: LogWriter | None = None
        self._ends: float = math.inf

    def write(self, record: Record) -> None:
        """Write a frame into the file whose time it is. Raises OSError."""
        if self._writer is None or record.time >= self._ends:
            self._begin(record.time)
        assert self._writer is not None
        self._writer.write(record)
        self._last = record.time, record.channel
        self.frames += 1

    def lose(self, count: int) -> None:
        """Take note that frames were lost on their way here, and say so in the present file: who reads it would take what is
        missing for a fault of a node. Raises OSError."""
        self.lost += count
        if self._writer is not None:
            self._writer.lost(*self._last)

    def _begin(self, time: Time) -> None:
        self.close()
        path = self._target
        if self._rotate is not None:
            path = self._new_path(f"{self._target.stem}-{datetime.datetime.fromtimestamp(time / SECOND).strftime(NAMED)}")
            self._ends = time + self._rotate
        self._writer = log_writer(path)
        self.written.append(path)
        while self._keep is not None and len(self.written) > self._keep:
            with suppress(OSError):  # somebody else has taken it away
                self.written[0].unlink()
            del self.written[0]

    def _new_path(self, stem: str) -> Path:
        """Return a path where there is no file yet: an hour may come twice, as at the end of summer time."""
        path, number = self._target.with_stem(stem), 1
        while path.exists():
            number += 1
            path = self._target.with_stem(f"{stem}-{number}")
        return path

    def close(self) -> None:
        """End the present file."""
        if self._writer is not None:
            writer, self._writer = self._writer, None
            self.left_out += writer.left_out
            self.frames -= writer.left_out
            writer.close()


async def _record(settings: Settings, screen: Screen, choice: FrameChoice, files: _Files, seconds: float) -> None:
    async with open_live_source(settings, None) as live:
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
