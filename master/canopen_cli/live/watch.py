"""`canopen watch`: a live table of the values of a node's objects."""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Final

import click
import trio
from rich.console import RenderableType

from canopen_cli.live.clocks import FrameClock
from canopen_cli.live.notes import note_lost, note_source, note_state
from canopen_cli.live.screen import LiveScreen
from canopen_cli.live.source import LiveSource, open_live_source, recorded
from canopen_cli.live.watch_polling import NO_ANSWER_TEXT, Load, Polling, load_text
from canopen_cli.live.watch_view import Around, picture, plain
from canopen_cli.live.watched import View, Watched, WatchedSample
from canopen_cli.shared.new_files import check_new_file, check_writable
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import Duration, NodeOfObject, Settings, command, lasting, with_named_object
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.running import first_error, run_until_interrupted
from canopen_cli.shared.screen import Screen, escape
from canopen_cli.shared.session import open_session
from canopen_cli.shared.values import TYPES, as_json, find_object, object_json, physical, place_text
from canopen_master.participant.bus import BusChanged, FramesLost
from canopen_master.plain_text import clean, json_text
from canopen_proto.dictionary import Object, ObjectDictionary, ObjectNotFoundError, Variable
from canopen_proto.drives.cia402.axes import axis_of
from canopen_proto.frame import SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.observer.observer import Observer
from canopen_transports.errors import BusStateChanged
from canopen_transports.log_files import LogFileError
from canopen_transports.record import Record

DRIVE_OBJECTS: Final = ("6041", "6061", "6064", "606C", "6077", "60F4", "603F")
"""Of --402, as far as the dictionary has them: state, mode, position, velocity, torque, following error, error code."""
REFRESH: Final = 0.2
"""Seconds between two pictures."""
SPAN: Final = 30.0
"""Seconds that the curves of --plot go back."""
KEYS: Final = "q end   p pause   r begin min and max again"
FLUSH: Final = 1.0
"""Seconds after which a CSV is written through."""
OTHERS: Final = "another program asks this node by SDO: nothing is asked until it is quiet"
STALE_AFTER: Final = 3
"""Periods of --every without a new value after which a value is stale."""


@command()
@click.argument("node_id", metavar="NODE", type=NodeOfObject())
@click.argument("keys", metavar="OBJECT...", nargs=-1)
@click.option("--402", "drive", is_flag=True, help="What a drive shows: state, mode, position, velocity, torque, errors.")
@click.option(
    "--every",
    type=Duration(10 * MILLISECOND),
    default="200ms",
    show_default=True,
    help="How often an object is read that no PDO brings.",
)
@click.option("--passive", is_flag=True, help="Send nothing: show what passes on the bus anyway.")
@recorded
@click.option("--channel", metavar="NAME", help="Of a file with several buses: the one of the node.")
@click.option("--csv", "csv_path", metavar="FILE", help="Write each value into a CSV file too.")
@click.option("--plot", is_flag=True, help=f"Draw the last {SPAN:g} s of each number below the table.")
@lasting("End after this time, instead of by q or Ctrl-C: 10s.")
@click.option("--type", "type_name", type=click.Choice(list(TYPES)), help="Of objects that the dictionary does not have.")
def watch(
    settings: Settings,
    screen: Screen,
    node_id: int,
    keys: tuple[str, ...],
    drive: bool,
    every: Time,
    passive: bool,
    source: Path | None,
    channel: str | None,
    csv_path: str | None,
    plot: bool,
    seconds: float,
    type_name: str | None,
) -> None:
    """Show the values of a node's objects, live.

    A PDO's values cost nothing: they are taken from the bus. An object that no PDO brings is read by SDO each --every, slower if
    that would take more than 5 % of the bus. A value that has not come again for a second, or for three times --every, is shown
    as stale. On a terminal it is a table that fills the screen; in a pipe it is a line for each change, or with --json for each
    value.

    \b
    canopen watch 3 statusword position_actual_value -b demo
    canopen watch 3 --402 --plot -b demo
    canopen watch 5 6041 6064 -e drive.eds --csv run.csv
    canopen watch 5 6064 --log trace.log
    ssh gateway candump -L can0 | canopen watch 5 6041 --log -
    """
    keys = keys if drive and not keys else with_named_object(keys, node_id)
    if csv_path is not None:
        check_new_file(settings, screen, csv_path)
        check_writable(csv_path)
    files = NodeFiles(settings, screen)
    dictionary, variables = _objects(files.dictionary_of(node_id), keys, drive, type_name)
    watched = Watched(node_id, dictionary, variables, STALE_AFTER * every, round(SPAN * SECOND) if plot else 0)
    drives = (node_id,) if any(axis_of(each.mux) is not None for each in variables) else ()
    observer = Observer(lambda each: dictionary if each == node_id else files.dictionary_of(each), drives=drives)
    with ExitStack() as stack:
        watching = _Watching(settings, screen, watched, observer, channel, plot)
        if csv_path is not None:
            watching.sinks.append(stack.enter_context(_csv_sink(csv_path, node_id)))
        if settings.json:
            watching.sinks.append(partial(_tell_json, screen, node_id))
        elif not watching.is_drawn:
            watching.sinks.append(watching.tell)
        bus = None if source is not None else settings.required_bus()
        passive = passive or bus is None or bus.startswith("file:")
        work = partial(watching.listen, source) if passive else partial(watching.ask, every)
        run_until_interrupted(settings, screen, partial(watching.show, work, seconds))


def _objects(
    dictionary: ObjectDictionary, keys: Sequence[str], drive: bool, type_name: str | None
) -> tuple[ObjectDictionary, list[Variable]]:
    """Return the named objects, and the dictionary with those that it lacks. Raises ObjectNotFoundError, CommandError."""
    variables = {each.mux: each for key in keys for each in [find_object(dictionary, key, type_name)]}
    for key in DRIVE_OBJECTS if drive else ():
        try:
            variable = dictionary.variable(key)
        except ObjectNotFoundError:
            continue
        variables.setdefault(variable.mux, variable)
    if not variables:
        raise usage("CO302", "the dictionary has none of the objects of a drive", tries=("-e FILE.eds", "the same without --402"))
    missing: dict[int, list[Variable]] = {}
    for each in variables.values():
        if dictionary.get(each.index, each.subindex) is None:
            present = dictionary.objects.get(each.index)
            missing.setdefault(each.index, list(present.variables.values()) if present is not None else []).append(each)
    more = [Object.of(group[-1].name, group) for group in missing.values()]
    return dictionary.with_objects(more) if more else dictionary, list(variables.values())


class _Watching:
    """One run of the command. sinks: take each value that comes. is_drawn: a table that fills the screen is shown."""

    def __init__(
        self, settings: Settings, screen: Screen, watched: Watched, observer: Observer, channel: str | None, plot: bool
    ) -> None:
        self._settings, self._screen = settings, screen
        self._watched, self._observer = watched, observer
        self._channel = channel
        self._plot = plot
        self._clock = FrameClock()
        self._live: LiveSource | None = None
        self._first: Time | None = None
        self._load = Load()
        self._polling: Polling | None = None
        self._bitrate: int | None = None
        self._where = ""
        self._how = ""
        self._lost = 0  # as the master tells
        self._has_value = False
        self._notes: dict[str, str] = {}
        self.is_drawn = screen.out.is_terminal and not screen.out.is_dumb_terminal and not settings.json
        self.sinks: list[Callable[[WatchedSample], None]] = []

    def now(self) -> Time:
        """Return the time of the frames, now."""
        return self._clock.now()

    # ---- what comes ----

    def heard(self, record: Record) -> None:
        """Take in a frame."""
        if self._channel is None:
            self._channel = record.channel
        if record.channel != self._channel:
            self._notes["several"] = (
                f"there are frames of other buses, too; these are of {self._channel}; or --channel {record.channel}"
            )
            return
        now = self._clock.set(record.time)
        self._first = now if self._first is None else self._first
        if record.frame.can_id in (SDO_CLIENT_TO_SERVER + self._watched.node_id, SDO_SERVER_TO_CLIENT + self._watched.node_id):
            self._load.add(record.frame, now)
            if self._polling is not None and not record.sent and record.frame.can_id >= SDO_CLIENT_TO_SERVER:
                self._polling.make_way()
        for sample in self._watched.take(self._observer.observe(record.frame, now).meaning, now):
            self._has_value = True
            for sink in self.sinks:
                sink(sample)

    async def listen(self, source: Path | None) -> None:
        """Take in what comes from a bus or a file, to its end."""
        async with open_live_source(self._settings, source, None if self.is_drawn else self._screen) as live:
            self._live, self._where = live, live.name
            self._how = "passive: nothing is sent" if live.is_live else "a recording"
            async for each in live:
                if isinstance(each, Record):
                    self.heard(each)
                elif isinstance(each, BusStateChanged):
                    note_state(self._notes, each.state, each.seen)

    async def ask(self, every: Time) -> None:
        """Take in what is on the bus, and ask for the rest; for ever."""
        failures: list[OSError] = []
        with trio.CancelScope() as scope:

            def heard(record: Record) -> None:
                if failures:
                    return
                try:
                    self.heard(record)
                except OSError as error:  # no room for the output, or its reader has gone; who overhears a bus must not raise
                    failures.append(error)
                    scope.cancel()

            await self._ask(every, heard)
        if failures:
            raise failures[0]

    async def _ask(self, every: Time, heard: Callable[[Record], None]) -> None:
        async with open_session(self._settings, self._screen) as session:
            bus = session.master.bus()
            zero = time.time_ns() - session.master.now()
            bus.listen(lambda frame, now, _, is_sent: heard(Record(now + zero, self._channel or "", frame, is_sent)))
            self._where = self._settings.required_bus()
            self._bitrate = bus.bitrate or self._settings.told_bitrate()
            session.master.watch((FramesLost, BusChanged), self._bus_event)
            node = session.node(self._watched.node_id)
            self._polling = Polling(session, node, self._watched, self.now, every, self._bitrate)
            await self._polling.run()

    def _bus_event(self, event: FramesLost | BusChanged) -> None:
        if isinstance(event, FramesLost):
            self._lost += event.lost
        else:
            note_state(self._notes, event.state, event.reason)

    # ---- what is shown ----

    async def show(self, work: Callable[[], Awaitable[None]], seconds: float) -> None:
        """Do the work, and show what comes: until its end, the time, or a key."""

        async def for_a_time() -> None:
            with trio.move_on_after(seconds):
                await work()

        failure: LogFileError | None = None
        try:
            if self.is_drawn:
                keys = {"r": self._watched.forget_limits}
                await LiveScreen(self._screen, self._view, self._picture, keys, REFRESH).during(for_a_time)
            else:
                await self._tell_during(for_a_time)
        except LogFileError as error:  # what could be read is shown
            failure = error
        if self.is_drawn:
            self._screen.data(plain(self._view(), self._around(None), self._screen.out.width))
        if failure is not None:
            raise failure
        if not self._has_value:
            raise self._nothing_came()
        silent = [row.place for row in self._view().rows if row.trouble == NO_ANSWER_TEXT]
        if silent:  # a script that goes on would take the last values for the present ones
            raise self._no_value(
                f"node {self._watched.node_id} has stopped answering: there are no new values of {', '.join(silent)}"
            )

    def _view(self) -> View:
        return self._watched.view(self.now())

    def _picture(self, view: View, width: int, height: int, paused: float | None) -> RenderableType:
        return picture(view, self._around(paused), width, height, span=SPAN if self._plot else 0.0)

    def _around(self, paused: float | None) -> Around:
        how = self._how or load_text(self._load.last_second(self.now()), self._bitrate)
        return Around(self._where, how, KEYS, tuple(self._all_notes().values()), paused)

    def _all_notes(self) -> dict[str, str]:
        note_lost(self._notes, self._lost)
        note_source(self._notes, self._live, self._clock)
        makes_way = self._polling is not None and self._polling.makes_way
        return {**self._notes, "others": OTHERS} if makes_way else self._notes

    def tell(self, sample: WatchedSample) -> None:
        """Print a value that has changed."""
        if sample.is_change:
            row = self._watched.row(sample.variable, sample.time)
            words = f" ({', '.join(row.words)})" if row.words else ""
            seconds = (sample.time - (self._first or 0)) / SECOND
            text = f"{row.place} {row.name} = {row.value} {row.unit}".rstrip()
            if self._live is not None:
                self._live.clear()
            self._screen.out.out(f"{seconds:12.6f} {clean(f'{text}{words}')}  [{clean(row.source)}]", highlight=False)

    async def _tell_during(self, work: Callable[[], Awaitable[None]]) -> None:
        """Do the work; say why values do not come."""
        told: dict[str, str] = {}
        async with first_error(), trio.open_nursery() as nursery:
            nursery.start_soon(self._tell_remarks, told)
            await work()
            nursery.cancel_scope.cancel()
        self._tell_new_remarks(told)

    async def _tell_remarks(self, told: dict[str, str]) -> None:
        while True:
            await trio.sleep(REFRESH)
            self._screen.check_reader()
            self._tell_new_remarks(told)

    def _tell_new_remarks(self, told: dict[str, str]) -> None:
        """Say the notes, and why rows have no new values; what was said is said again only once it was over."""
        remarks = dict(self._all_notes())
        is_live = self._live is None or self._live.is_live
        for row in self._view().rows:
            trouble = row.trouble or ("stale: nothing has brought it again" if row.is_stale and is_live else "")
            if trouble:
                remarks[row.place] = f"{row.place} {row.name}: {trouble}"
        for about, text in remarks.items():
            if told.get(about) != text:
                self._screen.say(f"[yellow]{escape(text)}[/]")
        told.clear()
        told.update(remarks)

    def _nothing_came(self) -> CommandError:
        """Return the problem of a watch that has shown nothing."""
        node_id = self._watched.node_id
        view = self._view()
        troubles = dict.fromkeys(row.trouble for row in view.rows if row.trouble)
        heard = "nothing was heard of it" if view.heard is None else "it was heard, and sent none of them"
        objects = ", ".join(row.place for row in view.rows)
        return self._no_value(f"no value of {objects} of node {node_id} has come", "; ".join(troubles) or heard)

    def _no_value(self, failed: str, seen: str = "") -> CommandError:
        node_id = self._watched.node_id
        tries: tuple[str, ...] = (f"canopen info {node_id}", "canopen monitor    (what passes on the bus)")
        if self._live is not None and not self._live.is_live:
            tries = (f"canopen log stats {self._live.name}    (what is in it)",)
        return CommandError(ExitCode.NO_ANSWER, "CO210", failed, seen=seen, tries=tries, node=node_id)


def _tell_json(screen: Screen, node_id: int, sample: WatchedSample) -> None:
    screen.out.out(json_text(_document(node_id, sample)), highlight=False)


def _document(node_id: int, sample: WatchedSample) -> dict[str, Any]:
    variable, value = sample.variable, sample.value
    return {
        "time": sample.time,
        "node": node_id,
        **object_json(variable),
        "value": as_json(variable, value),
        "physical": physical(variable, value),
        "unit": variable.unit,
        "source": sample.source,
    }


@contextmanager
def _csv_sink(path: str, node_id: int) -> Iterator[Callable[[WatchedSample], None]]:
    """Open a CSV file with a line for each value. Values that came until a second ago are in it, however the program ends."""
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("time", "node", "object", "name", "value", "physical", "unit", "source"))
        flushed = -math.inf

        def write(sample: WatchedSample) -> None:
            nonlocal flushed
            variable, value = sample.variable, sample.value
            amount = physical(variable, value)
            seconds, rest = divmod(sample.time, SECOND)
            cells = (place_text(variable), clean(variable.name), as_json(variable, value), "" if amount is None else amount)
            writer.writerow((f"{seconds}.{rest:09d}", node_id, *cells, clean(variable.unit), clean(sample.source)))
            if trio.current_time() - flushed >= FLUSH:
                flushed = trio.current_time()
                file.flush()

        yield write
