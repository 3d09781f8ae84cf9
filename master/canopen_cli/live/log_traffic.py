"""What a recording shows of each bus: the frames of each CAN-ID; and how long it was recorded. For `log stats`, `log diff`.

A recording may have several buses (`candump any`). Each has nodes and a load of its own: nothing of two buses is added up.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from canopen_cli.live.clocks import RecordClocks
from canopen_cli.live.reading import watched
from canopen_cli.live.source import frames_of
from canopen_cli.live.window import Window
from canopen_cli.shared.screen import Screen
from canopen_proto.frame import RoutingKey
from canopen_proto.frame_bits import frame_bits
from canopen_proto.machine import SECOND, Time
from canopen_proto.observer.observer import Observer
from canopen_transports.log_files import LogReader

LEAST_SPAN: Final = SECOND
"""From the first frame to the last, in ns: a few frames in less time come at once, and say nothing about a second."""


@dataclass
class IdTraffic:
    """The frames of one CAN-ID on one bus. can_id: as candump writes it. bits: of all these frames, on the wire."""

    channel: str
    can_id: str
    service: str
    node_id: int
    frames: int = 0
    bits: int = 0


class Traffic(NamedTuple):
    """What a part of a recording shows. ids: by bus, then by CAN-ID. elapsed: how long that part is, ns. span: the same where it
    is long enough to tell what comes in a second, else 0. jumps: how often the clock of the frames went back."""

    ids: tuple[IdTraffic, ...]
    elapsed: Time
    span: Time
    jumps: int

    @property
    def channels(self) -> tuple[str, ...]:
        """The buses, in the order in which they came."""
        return tuple(dict.fromkeys(each.channel for each in self.ids))

    def per_second(self, count: float) -> float | None:
        """Return how many come in a second; None if the span is not known, or is too short to tell."""
        return count * SECOND / self.span if self.span else None


def traffic_in(screen: Screen, reader: LogReader, window: Window) -> Traffic:
    """Count the frames in a part of a recording. Raises CommandError, LogFileError."""
    ids: dict[str, dict[RoutingKey, IdTraffic]] = {}
    observers: dict[str, Observer] = {}
    clocks = RecordClocks()
    first = begun = last = None
    for record in watched(screen, reader, frames_of(reader)):
        frame, channel = record.frame, record.channel
        now = clocks.set(channel, record.time)
        first = record.time if first is None else first
        begun = now if begun is None else min(begun, now)
        last = now if last is None else max(last, now)
        if not window.has(record.time, first):
            continue
        if channel not in ids:
            ids[channel], observers[channel] = {}, Observer()
        found = ids[channel].get(frame.key)
        if found is None:
            meaning = observers[channel].observe(frame, now).meaning
            service = "heartbeat" if meaning.service == "boot-up" else meaning.service  # the first one is the boot-up
            found = ids[channel][frame.key] = IdTraffic(channel, str(frame).partition("#")[0], service, meaning.node_id)
        found.frames += 1
        found.bits += frame_bits(frame)
    window.require(reader.path)
    elapsed, is_known = 0, False
    if first is not None and begun is not None and last is not None:
        if not clocks.jumps:
            elapsed, is_known = window.span(first, last)
        elif window.since is None and window.until is None:
            elapsed = last - begun  # of a part, nobody knows: its times came more than once
    rows = tuple(each[key] for each in ids.values() for key in sorted(each))
    return Traffic(rows, elapsed, elapsed if is_known or elapsed >= LEAST_SPAN else 0, clocks.jumps)
