"""The values in a recording, one after the other: for `canopen log export`, `plot` and `diff`."""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import click

from canopen_cli.live.frame_lines import Buses, FrameChoice
from canopen_cli.live.source import reader_of, require_frames, tell_skipped
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import Kind, Settings
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.session import read_dictionary
from canopen_cli.shared.values import physical, plain_json
from canopen_data.durations import parse_duration
from canopen_proto.machine import SECOND, Time
from canopen_proto.observer.meaning import ShownObject
from canopen_transports.record import Record

F = TypeVar("F", bound=Callable[..., Any])

_PLAIN: Final = re.compile(r"[0-9]*\.?[0-9]+")


class Moment(Kind):
    """A time in a recording: "12.5" or "12.5s" behind its first frame, or by the clock: "2026-03-01T12:00:05"."""

    name = "moment"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | datetime.datetime:
        if isinstance(value, float | datetime.datetime):
            return value
        text = str(value).strip()
        try:
            if _PLAIN.fullmatch(text):
                return float(text)
            if "-" in text or "T" in text:
                moment = datetime.datetime.fromisoformat(text)
                return moment if moment.tzinfo is not None else moment.astimezone()
            return parse_duration(text) / SECOND
        except (ValueError, OSError):
            self.fail(
                f"{value!r} is neither a time behind the first frame (12.5s) nor one by the clock (2026-03-01T12:00:05)",
                param,
                ctx,
            )


class Window(NamedTuple):
    """From when to when; None: from the beginning, to the end."""

    since: float | datetime.datetime | None = None
    until: float | datetime.datetime | None = None

    def has(self, time: Time, first: Time) -> bool:
        """Return whether a record is in it. time: its own; first: that of the first record, both in ns."""
        return self._at(self.since, first, -math.inf) <= time <= self._at(self.until, first, math.inf)

    @staticmethod
    def _at(moment: float | datetime.datetime | None, first: Time, default: float) -> float:
        if moment is None:
            return default
        return first + moment * SECOND if isinstance(moment, float) else moment.timestamp() * SECOND


def windowed(command: F) -> F:
    """Add the options for a part of a recording. The command takes `since` and `until`."""
    for name, text in (
        ("--until", "Only what is before this time."),
        ("--since", "Only from then on: 12.5s behind the first frame, or 2026-03-01T12:00:05."),
    ):
        command = click.option(name, type=Moment(), help=text)(command)
    return command


@dataclass(frozen=True, slots=True)
class LoggedValue:
    """A value that a frame shows. seconds: since the first frame. service: "SDO", "TPDO 1" and the like."""

    record: Record
    seconds: float
    service: str
    shown: ShownObject
    physical: float | None
    unit: str

    @property
    def label(self) -> str:
        """The object, for people: "5 statusword"."""
        return f"{self.shown.node_id} {self.shown.name or f'{self.shown.index:04X}:{self.shown.subindex:02X}'}"

    @property
    def number(self) -> float | None:
        """The value as a number, in its unit if a side file gives one; None if it is no number."""
        value = self.shown.value if self.physical is None else self.physical
        return float(value) if isinstance(value, int | float) and math.isfinite(value) else None

    @property
    def plain(self) -> Any:
        """The value as JSON and CSV have it."""
        return None if self.shown.value is None else plain_json(self.shown.value)


class Choosing(NamedTuple):
    """What of a recording is wanted; see `choosing` and `windowed`."""

    nodes: tuple[int, ...] | None
    services: tuple[str, ...]
    objects: tuple[str, ...]
    changes: bool
    window: Window


def values_in(settings: Settings, screen: Screen, source: Path, wanted: Choosing) -> Iterator[LoggedValue]:
    """Yield the values in a recording that are wanted, in their order. Raises CommandError, LogFileError, ObjectNotFoundError."""
    files = NodeFiles(settings, screen, read_dictionary(screen))
    choice = FrameChoice(files, *wanted[:4])
    reader, buses = reader_of(source), Buses(files)
    first: Time | None = None
    frames = 0
    for record in reader:
        first = record.time if first is None else first
        frames += 1
        seconds, observation = buses.observe(record)
        if not (wanted.window.has(record.time, first) and choice.shows(record, observation)):
            continue
        meaning = observation.meaning
        for shown in meaning.objects:
            if shown.value is not None and choice.wants(shown):
                variable = files.dictionary_of(shown.node_id).get(shown.index, shown.subindex) if shown.node_id else None
                number = None if variable is None else physical(variable, shown.value)
                yield LoggedValue(record, seconds, meaning.service, shown, number, "" if variable is None else variable.unit)
    require_frames(reader, str(source), frames)
    tell_skipped(screen, reader)
