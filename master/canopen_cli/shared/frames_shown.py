"""The frames that `--dry-run` shows: those of our side, with what they mean."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias

from canopen_cli.shared.options import Settings
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.observer.observer import Observer
from canopen_transports.record import Record

COLUMNS: Final = ("ms", "bus", "frame", "", "meaning")

DictionaryOf: TypeAlias = Callable[[str, int], ObjectDictionary | None]
"""Gives the dictionary of a node: its bus, "" where the command has only one; its node-ID."""


class FrameShown(NamedTuple):
    """A frame of ours. time: ns, since the first one. bus: "" where the command has only one. service, text: what it means."""

    time: Time
    bus: str
    frame: Frame
    service: str
    text: str

    @property
    def cells(self) -> tuple[str, ...]:
        """The texts of COLUMNS."""
        return f"{self.time / MILLISECOND:.1f}", self.bus, str(self.frame), self.service, self.text

    def as_json(self) -> dict[str, Any]:
        """Return it for --json. Without a bus it has no such field."""
        bus = {"bus": self.bus} if self.bus else {}
        return {"ms": self.time / MILLISECOND, **bus, "frame": str(self.frame), "service": self.service, "text": self.text}


def show_frames(
    settings: Settings,
    screen: Screen,
    records: Sequence[Record],
    dictionary_of: DictionaryOf,
    *,
    gone_out: Container[int] = (),
) -> None:
    """Show the frames that we would send. Reads are counted, or shown with -v; a repeated heartbeat is shown once. The bus of
    each is shown if there are several.

    records: their channels are the names of the buses. gone_out: the places in `records` of frames that were sent, since they
    only read.
    """
    rows, reads = frames_of(records, dictionary_of, gone_out=gone_out, with_reads=screen.verbosity > 0)
    if settings.json:
        screen.json([row.as_json() for row in rows])
        return
    if rows:
        columns = [name for name in COLUMNS if name != "bus" or len({record.channel for record in records}) > 1]
        shown = [dict(zip(COLUMNS, row.cells, strict=True)) for row in rows]
        screen.table(columns, [[escape(each[name]) for name in columns] for each in shown], right=("ms",))
    else:
        screen.data("no frames, except those that read")
    screen.say(f"[dim]and {counted(reads, 'read')}{' (-v shows them)' * (screen.verbosity <= 0)}[/]")


def frames_of(
    records: Sequence[Record], dictionary_of: DictionaryOf, *, gone_out: Container[int] = (), with_reads: bool = False
) -> tuple[list[FrameShown], int]:
    """Return the frames of our side, and the number of reads, which are among them only if `with_reads`."""
    rows: list[FrameShown] = []
    reads = 0
    observers: dict[str, Observer] = {}
    heartbeats: set[tuple[str, Frame]] = set()
    for place, record in enumerate(records):
        bus, frame = record.channel, record.frame
        if bus not in observers:
            observers[bus] = Observer(partial(dictionary_of, bus))
        meaning = observers[bus].observe(frame, record.time).meaning
        if not record.sent or (bus, frame) in heartbeats:
            continue
        if meaning.service == "heartbeat":
            heartbeats.add((bus, frame))
        if place in gone_out or (meaning.service == "SDO" and meaning.text.startswith("read ")):  # it changes nothing
            reads += 1
            if not with_reads:
                continue
        rows.append(FrameShown(record.time - records[0].time, bus, frame, meaning.service, meaning.text))
    return rows, reads
