"""A part of a recording, by time: `--since` and `--until` of all commands that read one; and the times of its lines by the clock.

A time is one of three: "12.5" or "12.5s" behind the first frame; "12:00:05", the first such time of day in the recording; or,
with its date, "2026-03-01T12:00:05". A time of day is that of this computer's zone, unless it names one ("...+00:00").
"""

from __future__ import annotations

import datetime
import math
import re
from typing import Final, TypeAlias

import click

from canopen_cli.shared.options import TextKind, option_group, together
from canopen_cli.shared.problem import usage
from canopen_data.durations import parse_duration
from canopen_proto.machine import SECOND, Time

When: TypeAlias = float | datetime.datetime | datetime.time
"""Seconds behind the first frame; a date with its time; a time of day."""

_PLAIN: Final = re.compile(r"[0-9]*\.?[0-9]+")
_OF_DAY: Final = re.compile(r"[0-9]{1,2}:[0-9]{2}(:[0-9]{2}(\.[0-9]+)?)?")
_DATED: Final = 10**9 * SECOND
"""Times of recordings that know the date are behind this one, of 2001; others count from the start of a recorder."""


class Moment(TextKind):
    """A time in a recording: see this module's text."""

    name = "moment"

    def read(self, text: str) -> When:
        given, text = text, text.strip()
        try:
            if _PLAIN.fullmatch(text):
                return float(text)
            if _OF_DAY.fullmatch(text):
                hour, _, rest = text.partition(":")
                return datetime.time.fromisoformat(f"{int(hour):02}:{rest}")
            if "-" in text or "T" in text:
                moment = datetime.datetime.fromisoformat(text)
                return moment if moment.tzinfo is not None else moment.astimezone()
            return parse_duration(text) / SECOND
        except (ValueError, OSError):
            raise ValueError(
                f"{given!r} is no time: 12.5s behind the first frame, or by the clock 12:00:05, 2026-03-01T12:00:05"
            ) from None


class Window:
    """A part of one recording: from when to when. None: from the beginning, to the end.

    Raises a CommandError if it runs backwards.
    """

    def __init__(self, since: When | None = None, until: When | None = None) -> None:
        self.since = since
        self.until = until
        self._is_met = since is None and until is None
        self._span: tuple[Time, Time] | None = None
        if type(since) is type(until) is not datetime.time and since is not None and until < since:  # type: ignore[operator]
            raise usage("CO001", "--until is before --since", tries=("--since 10s --until 20s",))

    def again(self) -> Window:
        """Return the same part, for another recording."""
        return Window(self.since, self.until)

    def has(self, time: Time, first: Time) -> bool:
        """Return whether a record is in it. time: its own; first: that of the first record, both in ns. Raises a CommandError if
        the recording has no date, and a time by the clock is asked for."""
        if self.since is None and self.until is None:
            return True
        self._span = first, time
        is_in = _at(self.since, first, -math.inf) <= time <= _at(self.until, first, math.inf)
        self._is_met = self._is_met or is_in
        return is_in

    def span(self, first: Time, last: Time) -> tuple[Time, bool]:
        """Return how long the recording watches the bus in this part, in ns; and whether both of its ends are known.

        first, last: the times of the first and the last record of the whole recording, in ns. Between these the recorder ran.
        When it began and ended is not known: so a part that reaches to one of them has no certain end there.
        """
        begin, end = _at(self.since, first, -math.inf), _at(self.until, first, math.inf)
        return int(max(min(end, last) - max(begin, first), 0)), first <= begin and end <= last

    def require(self, name: object) -> None:
        """Raise a CommandError if none of the records that were asked about is in it: nothing would look like no fault. name: of
        the recording."""
        if self._is_met or self._span is None:
            return
        first, last = self._span
        clock = f", from {time_of_day(first)} to {time_of_day(last)}" if first >= _DATED else ""
        seen = f"it is {(last - first) / SECOND:.6g} s long{clock}"
        raise usage("CO001", f"no frame of {name} is in this part", seen=seen, tries=(f"canopen log stats {name}",))


def _at(moment: When | None, first: Time, default: float) -> float:
    """Return when a moment is, in ns."""
    if moment is None:
        return default
    if isinstance(moment, float):
        return first + moment * SECOND
    if first < _DATED:
        raise usage(
            "CO001",
            "this recording has no time of day",
            seen="its times count from the start of its recorder",
            tries=("--since 12.5s    (seconds behind its first frame)",),
        )
    if isinstance(moment, datetime.datetime):
        return moment.timestamp() * SECOND
    begun = datetime.datetime.fromtimestamp(first // SECOND).astimezone()
    day = datetime.datetime.combine(begun.date(), moment).astimezone()
    if day < begun:  # the first one behind midnight
        day = datetime.datetime.combine(begun.date() + datetime.timedelta(days=1), moment).astimezone()
    return day.timestamp() * SECOND


windowed: Final = together(
    "window",
    Window,
    click.option(
        "--since",
        metavar="MOMENT",
        type=Moment(),
        help="Only from then on: 12.5s behind the first frame, 12:00:05, or 2026-03-01T12:00:05.",
    ),
    click.option("--until", metavar="MOMENT", type=Moment(), help="Only what is not behind this time."),
)
"""The options for a part of a recording. The command takes `window`."""

clocked: Final = option_group(click.option("--clock", is_flag=True, help="Times of day, not seconds since the first frame."))
"""The option for times by the clock. The command takes `clock`."""


def time_of_day(time: Time) -> str:
    """Return a recorded time by the clock of this computer's zone: "12:00:05.250"."""
    moment = datetime.datetime.fromtimestamp(time // SECOND)
    return f"{moment:%H:%M:%S}.{time % SECOND // 1_000_000:03}"
