"""`Record`: one frame in a log; `RecordClock`: their times, where a clock was set back; and what the readers and writers of all
kinds of log files have in common.

A reader is a generator of records, in the order of its file. It passes over what is not a classical CAN frame, and says so by
`Skip`. It raises `LogDamagedError` after the last record that can be read. log_files.py chooses the reader or writer of a file.
"""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

from canopen_proto.frame import Frame
from canopen_proto.machine import SECOND, Time

DEFAULT_CHANNEL: Final = "can0"
"""The bus, where a file names none."""


class Record(NamedTuple):
    """One frame in a log. time: ns since 1970, or since the file begins. channel: its bus. sent: by the recorder itself."""

    time: int
    channel: str
    frame: Frame
    sent: bool = False


class RecordClock:
    """The time of the frames of one bus, which never goes back.

    jumps: how often the clock of the frames went back by more than a second.

    Behind such a jump, as where two recordings were put together, or where a recorder's clock was set, time goes on from where it
    was: else what was heard before would look as if it had just come, and an hour would pass in which nothing does.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._ahead: Time = 0  # what was added for the jumps
        self._last: Time | None = None

    def set(self, time: Time) -> Time:
        """Take the time of a frame that has just come, ns; return it on this clock."""
        shown = time + self._ahead
        if self._last is not None and shown < self._last:
            if self._last - shown > SECOND:
                self.jumps += 1
                self._ahead += self._last - shown
            shown = self._last
        self._last = shown
        return shown


class Skip(Protocol):
    """Takes why an entry of a file is not a classical CAN frame."""

    def __call__(self, reason: str, *, is_overrun: bool = False) -> None:
        """is_overrun: the recorder says by this entry that it lost frames, or frames stood in its place."""


class LogDamagedError(Exception):
    """A file ends in the middle, or is not of its kind. The text says what was seen.

    line: where in the file, from 1; 0 if that is not known. tries: what to do; empty if nothing special helps.
    """

    def __init__(self, seen: str, line: int = 0, *tries: str) -> None:
        super().__init__(seen)
        self.line = line
        self.tries = tries


class LogWriter(Protocol):
    """Writes a log file. Raises OSError if there is no room."""

    left_out: int
    """How many frames this kind of file could not hold."""

    def write(self, record: Record) -> None:
        """Add a record."""

    def lost(self, time: int, channel: str) -> None:
        """Say that frames are missing here: the recorder lost them. Does nothing if this kind of file cannot say it. time,
        channel: as of a Record."""

    def close(self) -> None:
        """End the file. Until then it may be unusable, unless it is a `.log`."""
