"""`Record`: one frame in a log; and what the readers and writers of all kinds of log files have in common.

A reader is a generator of records, in the order of its file. It passes over what is not a classical CAN frame, and says so by
`Skip`. It raises `LogDamagedError` after the last record that can be read. log_files.py chooses the reader or writer of a file.
"""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

from canopen_proto.frame import Frame

DEFAULT_CHANNEL: Final = "can0"
"""The bus, where a file names none."""


class Record(NamedTuple):
    """One frame in a log. time: ns since 1970, or since the file begins. channel: its bus. sent: by the recorder itself."""

    time: int
    channel: str
    frame: Frame
    sent: bool = False


class Skip(Protocol):
    """Takes why an entry of a file is not a classical CAN frame."""

    def __call__(self, reason: str, *, is_overrun: bool = False) -> None:
        """is_overrun: the recorder says by this entry that it lost frames."""


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

    def close(self) -> None:
        """End the file. Until then it may be unusable, unless it is a `.log`."""
