"""Log files of CAN buses: candump's `.log`, and by python-can's readers and writers `.asc`, `.blf` (Vector) and `.trc` (PEAK).

`.log` is ours to read and write, since python-can's writer drops the length of remote frames. It is the default: text, one frame
a line, and nothing that CANopen has is lost, except what is below a microsecond:

    (1436509053.850870) can0 605#4041600000000000 T

T or R at the end, as `candump -L -x` writes it: sent by whoever recorded, or received. Files without it are read too, and so is
what candump shows on a screen (candump_text.py), in files that end in `.log` or `.txt`, and from standard input.

What the others lose is in LOSSES, measured with python-can 4.6 (see the tests). Entries that are no classical CAN frames (error
frames, CAN FD, a measuring program's own events) are passed over when a file is read, and counted. What is no log of its kind, or
ends in the middle, is an error, behind all frames that can be read.
"""

from __future__ import annotations

import codecs
import os
import re
import struct
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator
from io import BufferedReader, TextIOWrapper
from pathlib import Path
from typing import IO, Any, BinaryIO, Final, Protocol, TextIO

import can
from can.io.blf import BLFParseError

from canopen_proto.explained import Explained
from canopen_proto.frame import REMOTE
from canopen_transports.candump_text import EXAMPLE, NotAFrame, parse_line
from canopen_transports.messages import RefusedMessage, frame_of, message_of
from canopen_transports.record import Record

UNREADABLE: Final = "CO342"
DEFAULT_CHANNEL: Final = "can0"

LOSSES: Final = {
    ".log": "",
    ".asc": "names of buses become numbers; the date is kept to the millisecond, and without its time zone; frames earlier than "
    "the first one get its time",
    ".blf": "names of buses become numbers; times without a date (before 1990) are counted from the first frame's millisecond; "
    "frames earlier than the first one get its time",
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
    BLFParseError,
)
"""What python-can's readers raise over files that are none."""

_ENTRY: Final = {
    ".asc": re.compile(r"\s*[0-9]+\.[0-9]+\s+(?!Start of measurement)"),
    ".trc": re.compile(r"\s*[^\s;]"),
}
"""Lines that say what happened, as against headers and comments."""
_HEADER: Final = re.compile(r"\s*(;|(date|base)\s)", re.IGNORECASE)
_STATS: Final = "canopen log stats FILE    (what is in a file)"
_UTF16_MARKS: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def _old_code_page(error: UnicodeError) -> tuple[str, int]:
    """Makers' tools write in the code page of their computer: a German March is "M\\xe4r" there."""
    assert isinstance(error, UnicodeDecodeError)
    return error.object[error.start : error.end].decode("latin-1"), error.end


codecs.register_error("canopen-old-code-page", _old_code_page)


class LogFileError(Explained, Exception):
    """A log file cannot be read or written. line: where in it, from 1; 0 if that is not known. The rest: see Explained."""

    def __init__(self, failed: str, seen: str, cause: str, tries: tuple[str, ...], *, line: int = 0) -> None:
        super().__init__(UNREADABLE, failed, seen=seen, cause=cause, tries=tries)
        self.line = line


def kind_of(path: Path) -> str:
    """The kind of a log file by its name: a key of LOSSES. Raises LogFileError."""
    kind = path.suffix.lower()
    if kind not in LOSSES:
        raise LogFileError(
            f"the name {path} does not say what kind of log it is",
            f"it ends in {path.suffix!r}" if path.suffix else "it has no ending",
            "the ending of a log's name says which kind it is",
            (f"one of {', '.join(LOSSES)}, such as {path.with_suffix('.log').name}",),
        )
    return kind


class LogReader:
    """The records of a file, once, in its order. Iterating raises LogFileError, and holds the file open until its end or `close`.

    path: its ending says the kind; `.txt` is text of candump's, as `.log` is. stream: candump's text from elsewhere, such as
    standard input, in place of a file; path then only names it. skipped: how many entries were no classical CAN frames, so far;
    last_skip: why the last one was none.
    """

    def __init__(self, path: Path, stream: BufferedReader | None = None) -> None:
        self.path = path
        self.skipped = 0
        self.last_skip = ""
        self._stream = stream
        self._kind = ".log" if stream is not None or path.suffix.lower() == ".txt" else kind_of(path)

    def __iter__(self) -> Generator[Record]:
        # Opened here, as python-can's readers leave a file open when they raise.
        try:
            if self._stream is not None:
                text = _text(self._stream)
                try:
                    yield from self._candump_records(text)
                finally:
                    text.detach()  # the stream is the caller's to close
            elif self._kind == ".blf":
                with open(self.path, "rb") as file:
                    yield from self._binary_records(file)
            else:
                with open(self.path, "rb") as file, _text(file) as text:
                    yield from self._candump_records(text) if self._kind == ".log" else self._text_records(text)
        except OSError as error:
            raise _no_access("read", self.path, error) from error

    def _skip(self, reason: str) -> None:
        self.skipped += 1
        self.last_skip = reason

    def _not_understood(self, seen: str, line: int = 0, *tries: str) -> LogFileError:
        place = f"{self.path}:{line}" if line else str(self.path)
        cause = "the file is damaged, or of another kind than its name says"
        return LogFileError(f"{place} is not understood", seen, cause, tries or (_STATS,), line=line)

    # ---- .log ----

    def _candump_records(self, lines: Iterable[str]) -> Iterator[Record]:
        for number, line in enumerate(lines, 1):
            if not line.strip():
                continue
            try:
                yield parse_line(line.strip())
            except NotAFrame as reason:
                self._skip(str(reason))
            except ValueError as error:
                raise self._not_understood(str(error), number, EXAMPLE) from error

    # ---- the others, by python-can's readers ----

    def _text_records(self, file: TextIO) -> Iterator[Record]:
        lines = _Lines(file, _ENTRY[self._kind], self._skip)
        reader = can.ASCReader(lines, relative_timestamp=False) if self._kind == ".asc" else can.TRCReader(lines)  # type: ignore[arg-type]
        found = False
        try:
            for message in reader:
                if isinstance(reader, can.ASCReader) and reader.timestamps_format == "relative":
                    seen = "its times are counted from line to line (timestamps relative)"
                    raise self._not_understood(seen, 0, "have the program that wrote it write absolute times")
                found = True
                lines.entry = ""
                record = self._record_of_message(message)
                if record is not None:
                    yield record
        except _READING_ERRORS as error:
            raise self._not_understood(_reason(error), lines.number) from error
        if lines.number and not (found or lines.has_header):
            raise self._not_understood("it has neither a header nor frames")

    def _binary_records(self, file: BinaryIO) -> Iterator[Record]:
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        said = size
        try:
            reader = can.BLFReader(file)
            said = reader.file_size
            for message in reader:
                record = self._record_of_message(message)
                if record is not None:
                    yield record
        except _READING_ERRORS as error:
            if said <= size:
                raise self._not_understood(_reason(error)) from error
        if said > size:
            raise self._not_understood(
                f"it ends in the middle: {size} of {said} bytes are there", 0, "copy it again, once its recorder has ended it"
            )

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


class _Lines:
    """The lines of a text file, as python-can's readers take them, which are silent about what they cannot read.

    number: of the line read last. entry: that line, if it says what happened; "" once a reader has made a message of it.
    has_header: whether there were other lines, too.
    """

    def __init__(self, file: TextIO, entry: re.Pattern[str], skip: Callable[[str], None]) -> None:
        self.number = 0
        self.entry = ""
        self.has_header = False
        self._file = file
        self._pattern = entry
        self._skip = skip

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        if self.entry:
            self._skip(f"{self.entry[:60]!r}")
            self.entry = ""
        line = next(self._file)
        self.number += 1
        if self._pattern.match(line):
            self.entry = " ".join(line.split())
        elif _HEADER.match(line):
            self.has_header = True
        return line

    def close(self) -> None:
        """A reader's, at its end; ours is who has opened it."""


def _text(stream: BufferedReader) -> TextIOWrapper:
    """The text of a stream from its beginning, by the mark there; UTF-8 without one."""
    encoding = "utf-16" if stream.peek(2)[:2] in _UTF16_MARKS else "utf-8-sig"
    return TextIOWrapper(stream, encoding, errors="canopen-old-code-page")


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


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
        raise _no_access("write", path, error) from error


def _no_access(doing: str, path: Path, error: OSError) -> LogFileError:
    cause = f"it has another name, lies in another folder, or is not this user's to {doing}"
    return LogFileError(f"cannot {doing} {path}", error.strerror or str(error), cause, ("check the path",))


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
        self._holds_earlier = kind == ".trc"
        self._first: int | None = None
        self._file = _opened_to_write(path, kind)
        self._writer = _WRITERS[kind](self._file)
        self._channels: dict[str, int] = {}

    def write(self, record: Record) -> None:
        if record.frame.flags & REMOTE and not self._holds_remote:
            self.left_out += 1
            return
        if self._first is None:
            self._first = record.time
        message = message_of(record.frame)
        message.timestamp = (record.time if self._holds_earlier else max(record.time, self._first)) / 10**9
        message.is_rx = not record.sent
        message.channel = self._channels.setdefault(record.channel, len(self._channels))
        self._writer.on_message_received(message)

    def close(self) -> None:
        try:
            self._writer.stop()
        finally:
            self._file.close()


def _opened_to_write(path: Path, kind: str) -> IO[Any]:
    # Opened here, as python-can's writers leave a file open when they cannot end it. (The file's own name stands in a .trc.)
    return open(path, "wb") if kind == ".blf" else open(path, "w", encoding="utf-8", errors="backslashreplace")


class _AscWriter(can.ASCWriter):
    FORMAT_DATE = "%a %b %d %H:%M:%S.{:03d} %Y"  # python-can writes 7 ms as ".7"


_WRITERS: Final[dict[str, Callable[[Any], Any]]] = {".asc": _AscWriter, ".blf": can.BLFWriter, ".trc": can.TRCWriter}
