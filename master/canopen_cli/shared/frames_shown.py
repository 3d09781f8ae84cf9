"""The frames that `--dry-run` shows: those of our side, with what they mean."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import Any, Final, TypeAlias

from canopen_cli.shared.options import Settings
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.observer.observer import Observer
from canopen_transports.record import Record

Row: TypeAlias = tuple[Time, Frame, str, str]
"""A frame of ours: when, its service, and what it means."""
NAMES: Final = ("ms", "frame", "service", "text")


def show_frames(
    settings: Settings, screen: Screen, records: Sequence[Record], observer: Observer, *, gone_out: Container[int] = ()
) -> None:
    """Show the frames that we would send. Reads are counted, or shown with -v; a repeated heartbeat is shown once.

    gone_out: the places in `records` of frames that were sent, since they only read.
    """
    rows, reads = frames_of(records, observer, gone_out=gone_out, with_reads=screen.verbosity > 0)
    if settings.json:
        screen.json(frames_json(rows))
        return
    if rows:
        cells = [(f"{time / MILLISECOND:.1f}", str(frame), *map(escape, words)) for time, frame, *words in rows]
        screen.table(("ms", "frame", "", "meaning"), cells, right=("ms",))
    else:
        screen.data("no frames, except those that read")
    screen.say(f"[dim]and {counted(reads, 'read')}{' (-v shows them)' * (screen.verbosity <= 0)}[/]")


def frames_json(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the rows for --json."""
    return [dict(zip(NAMES, (time / MILLISECOND, str(frame), *words), strict=True)) for time, frame, *words in rows]


def frames_of(
    records: Sequence[Record], observer: Observer, *, gone_out: Container[int] = (), with_reads: bool = False
) -> tuple[list[Row], int]:
    """Return the frames of our side, and the number of reads, which are among them only if `with_reads`."""
    rows: list[Row] = []
    reads = 0
    heartbeats: set[Frame] = set()
    for place, record in enumerate(records):
        frame = record.frame
        meaning = observer.observe(frame, record.time).meaning
        if not record.sent or frame in heartbeats:
            continue
        if meaning.service == "heartbeat":
            heartbeats.add(frame)
        if place in gone_out or (meaning.service == "SDO" and meaning.text.startswith("read ")):  # it changes nothing
            reads += 1
            if not with_reads:
                continue
        rows.append((record.time - records[0].time, frame, meaning.service, meaning.text))
    return rows, reads
