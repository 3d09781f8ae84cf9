"""`canopen monitor`: what is said on a bus, as it is said. `canopen log decode` shows a recording by the same function."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import trio

from canopen_cli.live.frame_lines import Buses, FrameChoice, FrameLines, WantedFrames, choosing
from canopen_cli.live.line_writer import LineWriter, open_line_writer
from canopen_cli.live.source import Heard, LiveSource, no_file, open_live_source, recorded, tell_jumps, tell_skipped
from canopen_cli.live.window import Window, clocked
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import Settings, command, lasting, until_text
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.running import first_error, run_until_interrupted
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_proto.machine import SECOND, Time
from canopen_transports.errors import DEAF, BusStateChanged, ReceiveOverrun
from canopen_transports.record import Record

QUIET: Final = 0.5
"""Seconds without a frame, after which it is looked for what should have come."""
LATE: Final = SECOND // 4
"""Longer than a frame is on its way from the bus to us."""


@command()
@no_file
@recorded
@choosing
@clocked
@lasting()
def monitor(settings: Settings, screen: Screen, source: Path | None, wanted: WantedFrames, clock: bool, seconds: float) -> int:
    """Show what each frame on a bus means, until Ctrl-C. Nothing is sent.

    PDOs are shown by the mapping that was heard, else by the devices' own files, else by PDOs.csv. A line that begins with ! says
    what is wrong with the frame before it. A line that begins with = sums up frames before it: a fastscan (-v shows its frames),
    or what a node was told behind its boot-up.

    \b
    canopen monitor -b demo
    canopen monitor -b can0 --node 5 --service sdo,emcy
    canopen monitor -b can0 -e 5=drive.eds --object statusword --changes
    canopen monitor --log trace.log                      a recording, as canopen log decode shows it
    candump can0 | canopen monitor --log -
    """
    choice = FrameChoice(NodeFiles(settings, screen), wanted)
    watch = FrameMonitor(settings, screen, choice, source, clock=clock, seconds=seconds)

    async def show() -> None:
        try:
            with trio.move_on_after(seconds):
                await watch.show()
        finally:
            watch.tell_counts()

    run_until_interrupted(settings, screen, show, reads=source)
    return ExitCode.NO_ANSWER if watch.has_heard_nothing else ExitCode.OK


class FrameMonitor:
    """The frames of a source on the screen, and their counts. source: a recording; None: the bus of the options."""

    def __init__(
        self,
        settings: Settings,
        screen: Screen,
        choice: FrameChoice,
        source: Path | None,
        window: Window | None = None,
        *,
        clock: bool = False,
        seconds: float = math.inf,
    ) -> None:
        """window: what is shown of a recording; all of it is understood. clock: times of day in place of seconds. seconds: how
        long a bus will be shown; inf: until Ctrl-C."""
        self._seconds = seconds
        self._window = Window() if window is None else window
        self._clock = clock
        self._settings = settings
        self._screen = screen
        self._choice = choice
        self._source = source
        self._live: LiveSource | None = None
        self._writer: LineWriter | None = None
        self._begin: Time | None = None
        self._is_deaf = False  # the bus is away: that nothing comes says nothing about a node
        self._frames = 0
        self._in_window = 0
        self._shown = 0
        self._findings = 0

    async def show(self) -> None:
        """Show a recording to its end, or a bus for ever.

        Raises what LiveSource raises, and OSError if the reader of the output has gone.
        """
        lines = FrameLines(self._screen, clock=self._clock)
        async with (
            first_error(),
            open_live_source(self._settings, self._source, self._screen) as live,
            open_line_writer(self._screen, lines.gap, waits=not live.is_live, clear=live.clear) as writer,
        ):
            self._live, self._writer = live, writer
            if live.is_live:
                self._begin = live.now()
                how = "the adapter only listens" if live.is_silent else "nothing is sent"
                self._screen.say(f"[bold]{escape(live.name)}[/], {until_text(self._seconds)}; {how}")
            buses = Buses(self._choice.files, bitrate=live.bitrate or self._settings.told_bitrate() or 0)
            while (taken := await _next(live)) != []:
                lines.measure()
                for heard in taken or ():
                    await self._tell(heard, buses, lines, writer)
                if taken is None and not self._is_deaf:
                    await self._tell_silence(live.now() - LATE, buses, lines, writer)
            for channel, summary in buses.unfinished():
                if self._choice.tells(summary):
                    await writer.put(lines.summary(live.now(), channel, summary))
            tell_jumps(self._screen, buses.jumps)
            self._window.require(live.name)

    async def _tell(self, heard: Heard, buses: Buses, lines: FrameLines, writer: LineWriter) -> None:
        if isinstance(heard, Record):
            if self._begin is None:
                self._begin = heard.time
            self._frames += 1
            seconds, observation = buses.observe(heard)
            if not self._window.has(heard.time, self._begin):
                return
            self._in_window += 1
            self._findings += len(observation.findings)
            for summary in observation.summaries:
                if self._choice.tells(summary):
                    await writer.put(lines.summary(heard.time, heard.channel, summary))
            if self._choice.shows(heard, observation):
                self._shown += 1
                await writer.put(lines.frame(seconds, heard, observation))
        elif self._live is not None:
            if isinstance(heard, ReceiveOverrun):
                buses.lost(heard.seen, is_finding=not self._live.is_live)
                if not self._live.is_live:
                    return  # the next record tells it, at its time
            elif isinstance(heard, BusStateChanged):
                was_deaf, self._is_deaf = self._is_deaf, heard.state in DEAF
                if was_deaf or self._is_deaf:
                    buses.lost(heard.seen)  # what passes on the bus while it is away, nobody hears
            await writer.put(lines.report(buses.seconds(self._live.now()), self._live.now(), heard))

    async def _tell_silence(self, time: Time, buses: Buses, lines: FrameLines, writer: LineWriter) -> None:
        """Tell what is wrong because nothing came until this time."""
        for channel, findings, summaries in buses.idle(time):
            self._findings += len(findings)
            for finding in filter(self._choice.warns, findings):
                await writer.put(lines.finding(buses.seconds(time), time, channel, finding))
            for summary in filter(self._choice.tells, summaries):
                await writer.put(lines.summary(time, channel, summary))

    def tell_counts(self) -> None:
        """Tell what was heard and shown. Of a recording without a frame its error says all."""
        if self._live is None or self._writer is None or not (self._frames or self._live.is_live):
            return
        seconds = 0.0 if self._begin is None else (self._live.now() - self._begin) / SECOND
        parts = [f"{counted(self._frames, 'frame')} in {seconds:.1f} s"]
        if self._shown != self._frames:
            parts.append(f"{self._shown} shown")
        parts.append(counted(self._findings, "finding") if self._findings else "no findings")
        self._screen.say(", ".join(parts))
        if self._writer.left_out:
            self._screen.say(f"[yellow]{self._writer.left_out} of these are missing above: the reader was too slow[/]")
        if self._live.lost:
            self._screen.say(f"[yellow]{counted(self._live.lost, 'frame')} lost before they came here[/]")
        self.tell_skipped()

    def tell_passed_over(self) -> None:
        """Tell how many frames of a recording were read, if none of them is shown: nothing would look like an empty file."""
        if self._in_window and not self._shown:
            self._screen.say(f"{counted(self._in_window, 'frame')} passed over: none is what was asked for")

    @property
    def has_heard_nothing(self) -> bool:
        """Whether no frame came from a bus."""
        return self._live is not None and self._live.is_live and not self._frames

    def tell_skipped(self) -> None:
        """Tell what in the recording was no frame."""
        if self._live is not None:
            tell_skipped(self._screen, self._live)


async def _next(live: LiveSource) -> list[Heard] | None:
    """Return what comes next: nothing at the end of a recording, None if a bus was silent for QUIET."""
    with trio.move_on_after(QUIET if live.is_live else math.inf):
        return await live.take()
    return None
