"""`record_fleet`: takes what a fleet tells, and lets a HistoryWriter bring it to a disk. On trio, or on asyncio.

- **Nothing is made up.** A value that did not come has no row. That it did not come has one: each PDO has a count beside it
  (keys.py), and a jump in it is a row `gap` with the number that was lost and the times before and after. A bridge or a node that
  is away is `gone` until it `appeared`; an object that could not be read is a sample without a value, and with a `problem`.
- **What a kill loses** is what came since the last flush: `flush` seconds, or FLUSH_AT rows if that is sooner. The row `written`
  of the recorder says up to when all is on the disk.
- **Nobody waits for the disk.** Files are written in a thread. A disk that takes nothing is tried again at each flush; one that
  hangs is not waited for at the end.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from canopen_gateway.errors import HistoryError
from canopen_gateway.fleet.fleet import Fleet, FleetValue
from canopen_gateway.fleet.keys import FleetPlace, PdoCount
from canopen_gateway.fleet.news import FleetEmcy, FleetNews, FleetPdo, FleetState, PlaceAppeared, PlaceGone
from canopen_gateway.history.layout import RECORDER
from canopen_gateway.history.rows import (
    APPEARED,
    EMERGENCY,
    GAP,
    GONE,
    MOST_NAME,
    SAMPLE,
    STATE,
    HistoryRow,
    exact,
    sound_time,
)
from canopen_gateway.history.writer import FLUSH_AT, HistoryWriter
from canopen_master.participant.subscription import Subscription
from canopen_proto.error_codes import error_text
from canopen_transports.loop import Loop, current_loop

FLUSH: Final = 60.0
"""Seconds from one flush to the next."""
LEAST_FLUSH: Final = 1.0
CLOSING: Final = 60.0
"""Seconds that a flush may take before its disk counts as hung."""
LOGGER: Final = logging.getLogger("canopen_gateway")


@dataclass
class Recorded:
    """What `record_fleet` has done. run: the word of its files. rows, files: on the disk. lost: samples that are known to be
    lost, on the way or because the disk took none. problem: why the disk did not take the last flush; "" if it did."""

    run: str = ""
    rows: int = 0
    files: int = 0
    lost: int = 0
    problem: str = ""


@dataclass
class _Seen:
    """The last PDO of a kind. time: the site's."""

    count: PdoCount
    time: int | None


@dataclass
class FleetRecorder:
    """Turns what a fleet tells into rows; see this module's text. pattern: whose. writer: takes them. lost: how many samples are
    known to be lost on the way."""

    pattern: FleetPlace
    writer: HistoryWriter
    lost: int = 0
    _seen: dict[tuple[FleetPlace, int], _Seen] = field(default_factory=dict)
    _bus_lost: dict[FleetPlace, tuple[bytes, int]] = field(default_factory=dict)

    def take(self, event: FleetNews) -> None:
        """Take an event of the fleet."""
        place = event.place
        if not (place.matches(self.pattern) if self.pattern.node_id else place.bus_place.matches(self.pattern)):
            return
        now = self.writer.clock()
        match event:
            case FleetPdo():
                self._take_pdo(event, now)
            case FleetState():
                state = "unknown" if event.state is None else event.state.name
                self.writer.add(place, HistoryRow(now, STATE, sound_time(event.time), text=state))
            case FleetEmcy():
                raw = bytes((event.error_register,)) + event.vendor_data
                text, time = error_text(event.code), sound_time(event.time)
                self.writer.add(place, HistoryRow(now, EMERGENCY, time, integer=event.code, text=text, raw=raw))
            case PlaceAppeared():
                self.writer.add(place, HistoryRow(now, APPEARED))
            case PlaceGone():
                self.writer.add(place, HistoryRow(now, GONE))

    def take_value(self, value: FleetValue) -> None:
        """Take an object that was read, or could not be."""
        self.writer.add(
            value.place,
            HistoryRow(
                self.writer.clock(),
                SAMPLE,
                sound_time(value.time),
                None,
                value.object or value.key,
                (value.name or value.key)[:MOST_NAME],
                value.data_type[:MOST_NAME],
                value.unit[:MOST_NAME],
                raw=None if value.problem else value.data,
                problem=value.problem[:MOST_NAME] or None,
                **exact(value.value),
            ),
        )

    def lose(self, count: int, why: str, name: str | None = None) -> None:
        """Note samples that this recorder itself has lost, of no place in particular."""
        self.lost += count
        self.writer.add(RECORDER, HistoryRow(self.writer.clock(), GAP, name=name, lost=count, problem=why))

    def _take_pdo(self, event: FleetPdo, now: int) -> None:
        place, time = event.place, sound_time(event.time)
        if event.count is not None:
            self._look_for_gap(event, event.count, time, now)
        if not event.fields:
            why = "what this PDO carries was not known yet"
            self.writer.add(place, HistoryRow(now, SAMPLE, time, event.number, raw=event.data, problem=why))
        for each in event.fields:
            self.writer.add(
                place,
                HistoryRow(
                    now,
                    SAMPLE,
                    time,
                    event.number,
                    each.object,
                    each.name[:MOST_NAME],
                    each.data_type.name,
                    each.unit[:MOST_NAME],
                    raw=each.data,
                    **exact(each.value),
                ),
            )

    def _look_for_gap(self, event: FleetPdo, count: PdoCount, time: int | None, now: int) -> None:
        """Note what was lost since the last PDO of this kind, and on its bus."""
        place, number = event.place, event.number
        before = self._seen.get((place, number))
        if before is not None and before.count.run == count.run and count.number <= before.count.number:
            return  # an older one, which was overtaken
        self._seen[place, number] = _Seen(count, time)
        if before is not None and before.count.run != count.run:
            why = "the bridge began anew: what came between is not known"
            self.writer.add(place, HistoryRow(now, GAP, time, number, begun=before.time, problem=why))
        elif before is not None and count.number > before.count.number + 1:
            lost = count.number - before.count.number - 1
            self.lost += lost
            why = "lost between the bridge and this recorder"
            self.writer.add(place, HistoryRow(now, GAP, time, number, lost=lost, begun=before.time, problem=why))
        bus = place.bus_place
        run, lost_before = self._bus_lost.get(bus, (count.run, count.lost))
        if run == count.run and count.lost > lost_before:
            lost = count.lost - lost_before
            self.lost += lost
            why = "they came faster than the bridge took them; of which nodes is not known"
            self.writer.add(bus, HistoryRow(now, GAP, time, lost=lost, problem=why))
        self._bus_lost[bus] = count.run, count.lost


async def record_fleet(
    fleet: Fleet,
    folder: Path,
    *,
    pattern: FleetPlace = FleetPlace("*", "*", 0),  # noqa: B008 - a tuple
    objects: Sequence[str] = (),
    every: float = 1.0,
    flush: float = FLUSH,
    started: Callable[[Recorded], None] = lambda recorded: None,
    told: Recorded | None = None,
) -> Recorded:
    """Record a fleet until cancelled: PDOs, states, emergencies, who comes and goes. At its end it writes what waits.

    folder: is made if it is not there; several recorders may share one. pattern: a bus with all of it, or a node. objects: are
    read from each of these nodes, too, each `every` seconds. flush: seconds. started: called once it listens. told: where to say
    what was done, also for who cancels it. Raises HistoryError if the folder cannot be written at the start, PackageMissingError.
    """
    loop = current_loop()
    recorded = Recorded() if told is None else told
    try:
        writer = await loop.in_thread(HistoryWriter, folder)
        await loop.in_thread(writer.write, writer.take())  # a folder that cannot be written is told now, and not in a minute
    except OSError as error:
        raise HistoryError(f"{folder} cannot be written", seen=str(error), tries=("another folder",)) from error
    recorder = FleetRecorder(pattern, writer)
    recorded.run = writer.run
    try:
        with (
            fleet.news(FleetPdo) as pdos,
            fleet.news(FleetState, FleetEmcy, PlaceAppeared, PlaceGone) as news,
        ):
            for place in (*fleet.buses, *fleet.nodes):
                recorder.take(PlaceAppeared(place))
            started(recorded)
            async with loop.open_nursery() as nursery:
                nursery.start_soon(_take_pdos, pdos, recorder)
                nursery.start_soon(_take_news, news, recorder)
                for each in objects:
                    nursery.start_soon(_read_again, loop, fleet, recorder, each, every)
                await _flush_again(loop, recorder, recorded, max(flush, LEAST_FLUSH))
    finally:
        await _flush(loop, recorder, recorded, last=True)
    return recorded


async def _take_pdos(pdos: Subscription[FleetPdo], recorder: FleetRecorder) -> None:
    async for event in pdos:  # what is dropped here is missing in the counts, and so becomes a gap
        recorder.take(event)


async def _take_news(news: Subscription[Any], recorder: FleetRecorder) -> None:
    dropped = 0
    async for event in news:
        recorder.take(event)
        if news.dropped > dropped:
            recorder.lose(news.dropped - dropped, "states and emergencies came faster than this recorder took them")
            dropped = news.dropped


async def _read_again(loop: Loop, fleet: Fleet, recorder: FleetRecorder, key: str, every: float) -> None:
    """Read an object of all nodes, once in each period. What was too late is not read later."""
    due = loop.current_time()
    pattern = recorder.pattern if recorder.pattern.node_id else recorder.pattern._replace(node_id=-1)
    while True:
        for value in await fleet.read_all(pattern, key):
            recorder.take_value(value)
        due += every
        late = loop.current_time() - due
        if late > 0:
            missed = int(late / every) + 1
            due += missed * every
            recorder.lose(missed, "periods in which nothing was read: the answers took longer", key)
        await loop.sleep_until(due)


async def _flush_again(loop: Loop, recorder: FleetRecorder, recorded: Recorded, period: float) -> None:
    while True:
        with loop.move_on_after(period):
            while recorder.writer.waiting < FLUSH_AT:
                await loop.sleep(LEAST_FLUSH)
        await _flush(loop, recorder, recorded)
        if recorded.problem:
            await loop.sleep(LEAST_FLUSH)


async def _flush(loop: Loop, recorder: FleetRecorder, recorded: Recorded, *, last: bool = False) -> None:
    """Bring what waits to the disk. What it does not take waits on."""
    writer = recorder.writer
    if writer.is_busy:
        return  # the disk hangs since the last flush
    taken = writer.take()

    def work() -> None:
        try:
            writer.write(taken, last=last)
            writer.put_together(last=last)
        finally:
            writer.is_busy = False

    writer.is_busy = True
    recorded.problem = "the disk hangs"
    with loop.move_on_after(CLOSING, shield=True):  # a file that is being written gets its name
        try:
            await loop.in_thread(work, abandon_on_cancel=True)
            recorded.problem = ""
        except (OSError, ValueError) as error:  # ValueError: a file of this run was changed by somebody
            recorded.problem = str(error)
            LOGGER.warning("the history could not be written, and is tried again: %s", error)
            writer.give_back(taken)
    recorded.rows, recorded.files, recorded.lost = writer.rows, writer.files, writer.lost + recorder.lost
