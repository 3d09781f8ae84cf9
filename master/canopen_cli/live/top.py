"""`canopen top`: a bus at a glance, live: its nodes, their states and rates, load, SYNC, errors."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from typing import Final

import click
import trio
from rich.console import RenderableType

from canopen_cli.live.clocks import FrameClock
from canopen_cli.live.notes import note_source, note_state
from canopen_cli.live.screen import LiveScreen
from canopen_cli.live.source import LiveSource, no_file, open_live_source, rate_of, recorded
from canopen_cli.live.top_view import SORTS, BusShown, TopView, as_json, picture, plain
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import Settings, command, lasting
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.running import run_until_interrupted
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.time_left import time_left
from canopen_proto.machine import Time
from canopen_proto.observer.bus_view import BusView
from canopen_proto.observer.observer import Observer
from canopen_transports.errors import DEAF, BusState, BusStateChanged
from canopen_transports.log_files import LogFileError
from canopen_transports.record import Record

REFRESH: Final = 0.5
"""Seconds between two pictures."""
LISTENING: Final = 3.0
"""Seconds for which a bus is listened to where one table is printed: three of the usual heartbeats."""
MAX_BUSES: Final = 16
"""Buses of a file: a gateway has fewer."""


@command()
@no_file
@recorded
@click.option("--once", is_flag=True, help=f"Print one table, and end. Of a bus after {LISTENING:g} s, or --for.")
@click.option("--sort", type=click.Choice(list(SORTS)), default="node", show_default=True, help="The order of the nodes.")
@click.option("--bitrate", metavar="RATE", default="", help="For the load, where the bus does not tell it: 1M, 250k.")
@lasting("End after this time, instead of by q or Ctrl-C: 10s.")
def top(settings: Settings, screen: Screen, source: Path | None, once: bool, sort: str, bitrate: str, seconds: float) -> None:
    """Show a bus at a glance: nodes, states, rates, load, SYNC, errors, and what is wrong. Nothing is sent.

    On a terminal the picture fills the screen, until q or Ctrl-C; p holds it, s sorts, b shows the next bus of a file. In a pipe,
    and with --once or --json, it is printed once.

    \b
    canopen top -b socketcan:can0
    canopen top --log trace.log
    ssh gateway candump -L can0 | canopen top --log -
    """
    rate = rate_of(bitrate) if bitrate else 0
    is_drawn = screen.out.is_terminal and not screen.out.is_dumb_terminal and not (once or settings.json)
    if source is None and not is_drawn and seconds == math.inf:
        seconds = LISTENING
    command = _Top(settings, screen, sort, rate)
    run_until_interrupted(settings, screen, partial(command.show, source, seconds, is_drawn))


class _ObservedBus:
    """One bus: each in a file has its own observer. last: the time of its last frame. lost: why frames behind
    that one were not heard; "" if all were."""

    def __init__(self, name: str, observer: Observer, view: BusView) -> None:
        self.name = name
        self.observer = observer
        self.view = view
        self.last: Time = 0
        self.lost = ""


class _Top:
    """One run of the command."""

    def __init__(self, settings: Settings, screen: Screen, sort: str, bitrate: int) -> None:
        self._settings, self._screen = settings, screen
        self._files = NodeFiles(settings, screen)
        self._bitrate = bitrate
        self._buses: dict[str, _ObservedBus] = {}
        self._sorts = list(SORTS)
        self._sort = self._sorts.index(sort)
        self._chosen = 0
        self._source = ""
        self._clock = FrameClock()
        self._live: LiveSource | None = None
        self._notes: dict[str, str] = {}
        self._state: BusState | None = None

    # ---- what comes ----

    async def listen(self, source: Path | None, screen: Screen | None) -> None:
        """Take in what comes from a bus or a file, to its end. screen: see open_live_source."""
        async with open_live_source(self._settings, source, screen) as live:
            self._source = live.name
            self._bitrate = self._bitrate or live.bitrate or self._settings.told_bitrate() or 0
            self._live = live
            if live.is_live:
                self._clock.set(live.now())
            async for each in live:
                if isinstance(each, Record):
                    self._take(each)
                    continue
                state = each.state if isinstance(each, BusStateChanged) else None
                if state is None or state in DEAF or self._state in DEAF:
                    for bus in self._buses.values():  # what was lost, or passes while the bus is away, nobody hears
                        bus.lost = each.seen
                if isinstance(each, BusStateChanged):
                    self._state = each.state
                    note_state(self._notes, each.state, each.seen)

    def _take(self, record: Record) -> None:
        bus = self._buses.get(record.channel)
        if bus is None and len(self._buses) == MAX_BUSES:
            self._notes["many"] = f"only the first {MAX_BUSES} buses are shown"
            return
        now = self._clock.set(record.time)
        if bus is None:
            observer = Observer(self._files.dictionary_of, bitrate=self._bitrate)
            bus = self._buses[record.channel] = _ObservedBus(record.channel, observer, BusView(bitrate=self._bitrate))
        lost = bus.observer.lost(bus.lost, now) if bus.lost else None
        bus.lost = ""
        observation = bus.observer.observe(record.frame, now)
        if lost is not None:
            observation = observation.behind(lost)
        bus.view.add(record.frame, observation, now)
        bus.last = now

    # ---- what is shown ----

    async def show(self, source: Path | None, seconds: float, is_drawn: bool) -> None:
        """Listen, and show what comes: until its end, the time, or a key."""

        async def for_a_time() -> None:
            with trio.move_on_after(seconds):
                await self.listen(source, None if is_drawn else self._screen)

        failure: LogFileError | None = None
        try:
            await self._show(for_a_time, seconds, is_drawn, source is None)
        except LogFileError as error:  # what could be read is shown
            failure = error
        view = self._view()
        if not any(bus.figures.frames for bus in view.buses):
            raise failure or self._nothing_came()
        if self._settings.json:
            self._screen.json(as_json(view))
        else:
            self._screen.data(plain(view, self._screen.out.width))
        if failure is not None:
            raise failure

    async def _show(self, work: Callable[[], Awaitable[None]], seconds: float, is_drawn: bool, is_live: bool) -> None:
        if is_drawn:
            keys = {"s": self._next_sort, "b": self._next_bus, "\t": self._next_bus}
            await LiveScreen(self._screen, self._view, _draw, keys, REFRESH).during(work)
        else:
            async with time_left(self._screen, "listening", seconds if is_live else 0.0):
                await work()

    def _view(self) -> TopView:
        now = self._clock.now()
        buses = [BusShown(bus.name, bus.view.figures(now), now, bus.last, bus.view.bitrate) for bus in self._buses.values()] or [
            BusShown("", BusView(bitrate=self._bitrate).figures(now), now, now, self._bitrate)
        ]
        note_source(self._notes, self._live, self._clock)
        chosen, sort = self._chosen % len(buses), self._sorts[self._sort]
        return TopView(self._source, tuple(buses), chosen, sort, tuple(self._notes.values()), self._state)

    def _next_sort(self) -> None:
        self._sort = (self._sort + 1) % len(self._sorts)

    def _next_bus(self) -> None:
        self._chosen += 1

    def _nothing_came(self) -> CommandError:
        seen = "; ".join(self._notes.values())  # why: the state of the bus
        return CommandError(
            ExitCode.NO_ANSWER,
            "CO210",
            f"no frame came on {self._source or self._settings.required_bus()}",
            seen=seen,
            cause="no node has power or sends anything, or the bit rate or the wiring is wrong",
            tries=("canopen listen --bitrates", "canopen scan    (asks each node)"),
        )


def _draw(view: TopView, width: int, height: int, paused: float | None) -> RenderableType:
    return picture(view, width, height, paused)
