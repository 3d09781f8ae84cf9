"""The values in a recording, one after the other: for `canopen log export`, `plot` and `diff`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from canopen_cli.live.frame_lines import Buses, FrameChoice, WantedFrames
from canopen_cli.live.reading import watched
from canopen_cli.live.source import frames_of, reader_of, tell_skipped
from canopen_cli.live.window import Window
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import Settings
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.values import physical, plain_json
from canopen_proto.machine import Time
from canopen_proto.observer.meaning import ShownObject
from canopen_transports.record import Record


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


def values_in(settings: Settings, screen: Screen, source: Path, wanted: WantedFrames, window: Window) -> Iterator[LoggedValue]:
    """Yield the values in a recording that are wanted, in their order. Raises CommandError, LogFileError, ObjectNotFoundError."""
    files = NodeFiles(settings, screen)
    choice = FrameChoice(files, wanted)
    reader, buses = reader_of(source), Buses(files)
    first: Time | None = None
    for record in watched(screen, reader, frames_of(reader)):
        first = record.time if first is None else first
        seconds, observation = buses.observe(record)
        if not (window.has(record.time, first) and choice.shows(record, observation)):
            continue
        meaning = observation.meaning
        for shown in meaning.objects:
            if shown.value is not None and choice.wants(shown):
                variable = files.dictionary_of(shown.node_id).get(shown.index, shown.subindex) if shown.node_id else None
                number = None if variable is None else physical(variable, shown.value)
                yield LoggedValue(record, seconds, meaning.service, shown, number, "" if variable is None else variable.unit)
    window.require(source)
    tell_skipped(screen, reader)
