"""Log files of CAN buses: candump's `.log`, and by python-can's readers and writers `.asc`, `.blf` (Vector) and `.trc` (PEAK).

`.log` is ours to read and write, since python-can's writer drops the length of remote frames. It is the default: text, one frame
a line, and nothing that CANopen has is lost, except what is below a microsecond:

    (1436509053.850870) can0 605#4041600000000000 T

T or R at the end, as `candump -L -x` writes it: sent by whoever recorded, or received. Files without it are read too.

What the others lose is in LOSSES, measured with python-can 4.6 (see the tests). Frames that CANopen has no use for (error frames,
CAN FD) are passed over when a file is read, and counted.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import IO, Any, Final, NamedTuple, Protocol, TextIO

import can

from canopen_proto.frame import REMOTE, Frame
from canopen_transports.messages import RefusedMessage, frame_of, message_of

DEFAULT_CHANNEL: Final = "can0"

LOSSES: Final = {
    ".log": "",
    ".asc": "names of buses become numbers; the date is kept to the millisecond, and without its time zone",
    ".blf": "names of buses become numbers; times without a date (before 1990) are counted from the first frame",
    ".trc": "remote frames are left out; names of buses become numbers",
}
"""What a kind of file cannot hold, for people. The keys are the kinds."""

_READING_ERRORS: Final = (
    ValueError,  # numbers that are none, dates
    LookupError,
    TypeError,
    ArithmeticError,
    RuntimeError,  # NotImplementedError: versions of a format
    struct.error,
    zlib.error,
    can.CanError,  # BLFParseError
)
"""What python-can's readers raise over files that are none."""

_LINE: Final = re.compile(r"\(([0-9]{1,11})\.([0-9]{1,9})\)\s+(\S+)\s+([0-9A-Fa-f]+#\S*)(?:\s+([RT]))?\s*")
_RAW_DLC: Final = re.compile(r"_[0-9A-Fa-f]$")  # candump's way to show a DLC of 9 to 15, which means 8 bytes
_ERROR_FRAME: Final = 0x20000000


class Record(NamedTuple):
    """A frame in a log. time: ns since 1970, or since the file begins. sent: by whoever recorded it."""

    time: int
    channel: str
    frame: Frame
    sent: bool = False


class LogFileError(Exception):
    """A log file cannot be read or written. path, seen, tries: as of TransportError. line: where, 0 if that is not known."""

    def __init__(self, path: Path, failed: str, seen: str, *, line: int = 0, tries: tuple[str, ...] = ()) -> None:
        super().__init__(f"{failed}: {seen}")
        self.path = path
        self.failed = failed
        self.seen = seen
        self.line = line
        self.tries = tries


def kind_of(path: Path) -> str:
    """The kind of a log file by its name: a key of LOSSES. Raises LogFileError."""
    kind = path.suffix.lower()
    if kind not in LOSSES:
        raise LogFileError(
            path,
            f"what kind of log {path} is, its name does not say",
            f"it ends in {path.suffix!r}" if path.suffix else "it has no ending",
            tries=(f"one of {', '.join(LOSSES)}, such as {path.with_suffix('.log').name}",),
        )
    return kind


class LogReader:
    """The records of a file, once, in its order. Iterating raises LogFileError.

    skipped: how many entries were no frames of classical CAN, so far; last_skip: why the last one was none.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.skipped = 0
        self.last_skip = ""
        self._kind = kind_of(path)

    def __iter__(self) -> Iterator[Record]:
        try:
            if self._kind == ".log":
                yield from self._candump_records()
            else:
                yield from self._foreign_records()
        except OSError as error:
            raise LogFileError(self.path, f"cannot read {self.path}", error.strerror or str(error)) from error
        except UnicodeDecodeError as error:
            raise LogFileError(self.path, f"cannot read {self.path}", "it is no text", tries=_CONVERT) from error

    def _candump_records(self) -> Iterator[Record]:
        with open(self.path, encoding="utf-8") as file:
            for number, line in enumerate(file, 1):
                if line.strip():
                    record = self._record_of(number, line.strip())
                    if record is not None:
                        yield record

    def _record_of(self, number: int, line: str) -> Record | None:
        match = _LINE.fullmatch(line)
        if match is None:
            raise self._bad_line(number, f"{line[:60]!r} is no line of candump's")
        seconds, fraction, channel, text, direction = match.groups()
        identifier, _, data = text.partition("#")
        if data.startswith("#"):
            self._skip("a CAN FD frame")
            return None
        if len(identifier) == 8 and int(identifier, 16) & _ERROR_FRAME:
            self._skip("an error frame")
            return None
        try:
            frame = Frame.parse(_RAW_DLC.sub("", text))
        except ValueError as error:
            raise self._bad_line(number, str(error)) from error
        return Record(int(seconds) * 10**9 + int(fraction.ljust(9, "0")), channel, frame, direction == "T")

    def _bad_line(self, number: int, seen: str) -> LogFileError:
        tries = ("(1436509053.850870) can0 605#4041600000000000    (what a line looks like; `candump -L` writes such)",)
        return LogFileError(self.path, f"{self.path}:{number} is not understood", seen, line=number, tries=tries)

    def _skip(self, reason: str) -> None:
        self.skipped += 1
        self.last_skip = reason

    def _foreign_records(self) -> Iterator[Record]:
        # Opened here, as python-can's readers leave a file open when they raise. Makers' tools write in the code page of their
        # computer; what CANopen needs is ASCII.
        with self._opened() as file:
            try:
                for message in _READERS[self._kind](file):
                    record = self._record_of_message(message)
                    if record is not None:
                        yield record
            except _READING_ERRORS as error:
                seen = " ".join(str(error).split()) or type(error).__name__
                tries = ("is it really a log of this kind?",)
                raise LogFileError(self.path, f"{self.path} is not understood", seen, tries=tries) from error

    def _opened(self) -> IO[Any]:
        return open(self.path, "rb") if self._kind == ".blf" else open(self.path, encoding="utf-8", errors="replace")

    def _record_of_message(self, message: can.Message) -> Record | None:
        if message.is_error_frame:
            self._skip("an error frame")
            return None
        try:
            frame = frame_of(message)
        except RefusedMessage as reason:
            self._skip(str(reason))
            return None
        channel = "" if message.channel is None else str(message.channel)
        time = round(message.timestamp * 10**6) * 1000  # a float of today's date is no better than that
        return Record(time, f"can{channel}" if channel.isdecimal() else channel, frame, not message.is_rx)


class LogWriter(Protocol):
    """What a log file is written with. Raises OSError where there is no room."""

    left_out: int
    """How many frames the file cannot hold."""

    def write(self, record: Record) -> None:
        """Add a record."""

    def close(self) -> None:
        """End the file. Until then it may be of no use, except `.log`."""


def log_writer(path: Path) -> LogWriter:
    """Begin a log file, of the kind that its name says. A file that is there is replaced. Raises LogFileError."""
    kind = kind_of(path)
    try:
        return CandumpWriter(open(path, "w", encoding="utf-8", buffering=1)) if kind == ".log" else _ForeignWriter(path, kind)
    except OSError as error:
        raise LogFileError(path, f"cannot write {path}", error.strerror or str(error)) from error


class CandumpWriter:
    """Writes `.log`. A line is with the system as soon as it is written, so that a process that is killed leaves all of them."""

    def __init__(self, file: TextIO) -> None:
        self.left_out = 0
        self._file = file

    def write(self, record: Record) -> None:
        """Add a line."""
        seconds, fraction = divmod(record.time // 1000, 10**6)
        direction = "T" if record.sent else "R"
        self._file.write(f"({seconds:010d}.{fraction:06d}) {record.channel or DEFAULT_CHANNEL} {record.frame} {direction}\n")

    def close(self) -> None:
        """End the file."""
        self._file.close()


class _ForeignWriter:
    """Writes by python-can. Channels are numbered in the order in which they come."""

    def __init__(self, path: Path, kind: str) -> None:
        self.left_out = 0
        self._holds_remote = kind != ".trc"
        self._writer = _WRITERS[kind](str(path))
        self._channels: dict[str, int] = {}

    def write(self, record: Record) -> None:
        if record.frame.flags & REMOTE and not self._holds_remote:
            self.left_out += 1
            return
        message = message_of(record.frame)
        message.timestamp = record.time / 10**9
        message.is_rx = not record.sent
        message.channel = self._channels.setdefault(record.channel, len(self._channels))
        self._writer.on_message_received(message)

    def close(self) -> None:
        self._writer.stop()


def _read_asc(file: Any) -> can.ASCReader:
    return can.ASCReader(file, relative_timestamp=False)


_READERS: Final[dict[str, Callable[[Any], Iterable[can.Message]]]] = {
    ".asc": _read_asc,
    ".blf": can.BLFReader,
    ".trc": can.TRCReader,
}
_WRITERS: Final[dict[str, Callable[[str], Any]]] = {".asc": can.ASCWriter, ".blf": can.BLFWriter, ".trc": can.TRCWriter}
_CONVERT: Final = ("canopen log convert FILE OTHER.log",)
