"""A trace to take away: the last frames of one or several buses as candump writes them, `candump -L`.

They are copied when it is asked for, and made into text while it is sent: so a client that takes it slowly gets what it asked
for, and holds up that copy alone. Both go in slices, and others have their turn between two of them. A frame that the ring gave
up before its slice came is missing, and so is one that the receiver has lost: a line says so where it was. `canopen log decode`,
`canopen monitor` and can-utils read it.
"""

from __future__ import annotations

import heapq
import math
import re
from collections import deque
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from itertools import islice
from typing import Final, NamedTuple

import trio

from canopen_gateway.traffic.ring import FrameCopy
from canopen_gateway.traffic.traffic import NetTraffic
from canopen_proto.machine import SECOND, Time
from canopen_transports.candump_text import log_line, lost_line
from canopen_transports.record import Record

LONGEST: Final = 86_400.0
"""Seconds that may be asked for; a ring holds fewer."""
CHUNK: Final = 256
"""Lines that are made at a time: some 0.5 ms."""
SLICE: Final = 1 << 13
"""Frames that are copied at a time: some 0.1 ms."""
MOST_NAME: Final = 40
"""Characters of a name in a file's name, or in a file."""

_STRANGE: Final = re.compile(r"[^A-Za-z0-9_.-]+")


class TrafficTrace:
    """The frames of some buses, made by `take`. name: of the file, with the site and the time of its end. frames: how many.
    lost: how many it should have besides."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.frames = 0
        self.lost = 0
        self._parts: list[_BusFrames] = []

    @classmethod
    async def take(
        cls, site: str, traffic: Mapping[str, NetTraffic], *, seconds: float = LONGEST, frames: int = 0
    ) -> TrafficTrace:
        """Copy the frames that are there now. site: where it is from. traffic: of the buses, by name. seconds: how far back from
        now. frames: how many of each bus at most; 0: all that are there."""
        spans: list[tuple[NetTraffic, int, int]] = []
        end: Time = 0
        zero = next(iter(traffic.values())).zero  # of all buses, which have one clock
        for each in traffic.values():
            ring, now = each.ring, each.now()
            first = ring.since(now - round(seconds * SECOND))
            spans.append((each, max(first, ring.count - frames) if frames else first, ring.count))
            end = max(end, now + zero)
        at = datetime.fromtimestamp(end // SECOND, UTC).strftime("%Y%m%dT%H%M%SZ")
        which = plain_name(next(iter(traffic))) if len(traffic) == 1 else "all-buses"
        trace = cls(f"{plain_name(site)}-{which}-{at}.log")
        for number, (net, span) in enumerate(zip(traffic, spans, strict=True)):
            await trace._copy(_BusFrames(channel_of(net, number), zero, []), *span)
        return trace

    async def _copy(self, part: _BusFrames, traffic: NetTraffic, first: int, end: int) -> None:
        """Copy frames of a ring, the oldest first: they are the next to go. A slice ends where the receiver has lost frames."""
        self._parts.append(part)
        ring = traffic.ring
        losses = deque(each for each in traffic.losses if first < each[0] <= end)
        while first < end or losses:
            lost = min(end, max(first, ring.first)) - first
            first += lost
            while losses and losses[0][0] <= first:
                lost += losses.popleft()[1]
            slice_end = min(first + SLICE, end, *(number for number, _ in list(losses)[:1]))
            part.slices.append((lost, ring.copy(first, slice_end)))
            self.lost += lost
            self.frames += slice_end - first
            first = slice_end
            await trio.lowlevel.checkpoint()

    def chunks(self) -> Iterator[bytes]:
        """Return the text, CHUNK lines at a time."""
        lines = heapq.merge(*map(_lines, self._parts), key=lambda line: line[0])
        while some := list(islice(lines, CHUNK)):
            yield "".join([text for _, text in some]).encode()


def channel_of(net: str, number: int) -> str:
    """Return the name of a bus in a log: can0 for SocketCAN's can0; others plainly, with their number if nothing is left."""
    name = net.removeprefix("socketcan:").partition("?")[0]
    return plain_name(name) if _STRANGE.sub("", name) else f"bus{number}"


def plain_name(text: str) -> str:
    """Return a name without what a file's name, a header or a line of a log should not have."""
    return _STRANGE.sub("-", text).strip("-.")[:MOST_NAME] or "canopen"


def number_asked_for(text: str, least: float, most: float, what: str) -> float:
    """Return a number that was asked for. Raises ValueError for what is none, or is out of its range."""
    try:
        number = float(text[:40])
    except ValueError:
        number = math.nan
    if not least <= number <= most:  # NaN is not
        raise ValueError(f"{text[:40]!r} is no number of {what}: {least:g} to {most:g}")
    return number


def whole_number_asked_for(text: str, least: int, most: int, what: str) -> int:
    """Return a whole number that was asked for. Raises ValueError for what is none, or is out of its range."""
    is_whole = text.isascii() and text.isdecimal() and len(text) < 19
    if not is_whole or not least <= int(text) <= most:
        raise ValueError(f"{text[:40]!r} is no whole number of {what}: {least} to {most}")
    return int(text)


class _BusFrames(NamedTuple):
    """The frames of one bus. zero: ns from its times to the time of day. slices: how many frames are missing before each, and its
    frames."""

    channel: str
    zero: Time
    slices: list[tuple[int, FrameCopy]]


def _lines(part: _BusFrames) -> Iterator[tuple[Time, str]]:
    """Return the lines of one bus, with their times."""
    channel, zero, slices = part
    time: Time = 0
    for lost, copy in slices:
        if lost:
            time = copy[0].time + zero if len(copy) else time
            yield time, lost_line(time, channel)
        for number in range(len(copy)):
            passed, frame, is_sent = copy[number]
            time = passed + zero
            yield time, log_line(Record(time, channel, frame, is_sent))
