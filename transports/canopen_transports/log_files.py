"""Log files of CAN buses: candump's `.log`; `.pcap` and `.pcapng` (Wireshark); `.asc`, `.blf` (Vector) and `.trc` (PEAK).

python-can reads and writes Vector's and PEAK's kinds, capture_files.py Wireshark's. We read and write `.log` ourselves, because
python-can's writer drops the length of remote frames. It is the default kind: text, one frame a line. It loses nothing that
CANopen has, except times below a microsecond:

    (1436509053.850870) can0 605#4041600000000000 T

T at the end means sent by the recorder, R received, as `candump -L -x` writes it; files without it are read, too. Files ending in
`.log` or `.txt`, and standard input, may also contain what candump shows on a screen (candump_text.py). Standard input may be a
capture, too, as `tshark -w -` writes it: its first bytes tell.

LOSSES says what the other kinds lose, measured with python-can 4.6 (see the tests). The reader skips and counts entries that are
not classical CAN frames: error frames, CAN FD, a measuring program's own events. A file that is not of its kind, or that ends in
the middle, raises an error after all frames that can be read.
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
from canopen_transports.capture_files import MAGICS, CaptureDamaged, PcapngWriter, PcapWriter, read_capture
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
    ".pcap": "names of buses; which frames were sent",
    ".pcapng": "",
}
"""By the ending of a file, in words for people: what such a file cannot hold."""

_READING_ERRORS: Final = (
    ValueError,  # invalid numbers and dates
    LookupError,
    TypeError,
    ArithmeticError,
    RuntimeError,  # NotImplementedError: versions of a format
    struct.error,
    zlib.error,
    BLFParseError,
)
"""Exceptions of python-can's readers for files that are not of their kind."""

_ENTRY: Final = {
    ".asc": re.compile(r"\s*[0-9]+\.[0-9]+\s+(?!Start of measurement)"),
    ".trc": re.compile(r"\s*[^\s;]"),
}
"""Lines that record an event, as opposed to headers and comments."""
_HEADER: Final = re.compile(r"\s*(;|(date|base)\s)", re.IGNORECASE)
_STATS: Final = "canopen log stats FILE    (what is in a file)"
_CAPTURES: Final[dict[str, Callable[[BinaryIO], LogWriter]]] = {".pcap": PcapWriter, ".pcapng": PcapngWriter}
_UTF16_MARKS: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def _old_code_page(error: UnicodeError) -> tuple[str, int]:
    r"""Decode as latin-1. Makers' tools write in their computer's code page: a German March is "M\xe4r" there."""
    assert isinstance(error, UnicodeDecodeError)
    return error.object[error.start : error.end].decode("latin-1"), error.end


codecs.register_error("canopen-old-code-page", _old_code_page)


class LogFileError(Explained, Exception):
    """A log file cannot be read or written. line: where in it, from 1; 0 if that is not known. The rest: see Explained."""

    def __init__(self, failed: str, seen: str, cause: str, tries: tuple[str, ...], *, line: int = 0) -> None:
        super().__init__(UNREADABLE, failed, seen=seen, cause=cause, tries=tries)
        self.line = line


def kind_of(path: Path) -> str:
    """Return the kind of a log file by its name: a key of LOSSES. Raises LogFileError."""
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
    """The records of a file, in its order. Iterate over it once; that raises LogFileError, and keeps the file open until its end
    or `close`.

    path: its ending says the kind; `.txt` is candump's text, like `.log`. stream: candump's text, or a capture, from elsewhere
    (standard input); path then only names it. skipped: how many entries were not classical CAN frames so far; last_skip: why the
    last was not. overruns: how many of these say that the recorder lost frames there: candump's error frames.
    """

    def __init__(self, path: Path, stream: BufferedReader | None = None) -> None:
        self.path = path
        self.skipped = 0
        self.overruns = 0
        self.last_skip = ""
        self._stream = stream
        self._kind = ".log" if stream is not None or path.suffix.lower() == ".txt" else kind_of(path)

    def __iter__(self) -> Generator[Record]:
        # Opened here: python-can's readers leave a file open if they raise.
        try:
            if self._stream is not None and self._stream.peek(4)[:4] in MAGICS:
                yield from self._captured_records(self._stream)
            elif self._stream is not None:
                text = _text(self._stream)
                try:
                    yield from self._candump_records(text)
                finally:
                    text.detach()  # the caller closes the stream
            elif self._kind == ".blf":
                with open(self.path, "rb") as file:
                    yield from self._binary_records(file)
            elif self._kind in _CAPTURES:
                with open(self.path, "rb") as file:
                    yield from self._captured_records(file)
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
                self.overruns += reason.is_overrun
            except ValueError as error:
                raise self._not_understood(str(error), number, EXAMPLE) from error

    # ---- .pcap, .pcapng ----

    def _captured_records(self, file: BinaryIO) -> Iterator[Record]:
        try:
            yield from read_capture(file, self._skip, DEFAULT_CHANNEL)
        except CaptureDamaged as error:
            raise self._not_understood(str(error)) from error

    # ---- the others, by python-can's readers ----

    def _text_records(self, file: TextIO) -> Iterator[Record]:
        lines = _Lines(file, _ENTRY[self._kind], self._skip)
        reader = can.ASCReader(lines, relative_timestamp=False) if self._kind == ".asc" else can.TRCReader(lines)  # type: ignore[arg-type]
        found = False
        try:
            for message in reader:
                if isinstance(reader, can.ASCReader) and reader.timestamps_format == "relative":
                    seen = "each of its times counts from the line before (timestamps relative)"
                    raise self._not_understood(seen, 0, "have the program that wrote it write absolute times")
                found = True
                lines.entry = ""
                record = self._record_of_message(message)
                if record is not None:
                    yield record
        except _READING_ERRORS as error:
            raise self._not_understood(_reason(error), lines.number) from error
        if lines.number and not (found or lines.has_header):
            raise self._not_understood("the file has neither a header nor frames")

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
                f"the file ends in the middle, after {size} of {said} bytes", 0, "copy it again, after its recorder has closed it"
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
        time = round(message.timestamp * 10**6) * 1000  # a float of today's date is not more exact
        return Record(time, f"can{channel}" if channel.isdecimal() else channel, frame, not message.is_rx)


class _Lines:
    """The lines of a text file for python-can's readers, which silently skip lines that they cannot read.

    number: of the last line that was read. entry: that line, if it records an event; "" once a reader has returned a message for
    it. has_header: whether there was a header line.
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
        """Does nothing: python-can's readers call it at their end, but our caller closes the file."""


def _text(stream: BufferedReader) -> TextIOWrapper:
    """Decode a stream from its beginning: by its byte order mark, as UTF-8 without one."""
    encoding = "utf-16" if stream.peek(2)[:2] in _UTF16_MARKS else "utf-8-sig"
    return TextIOWrapper(stream, encoding, errors="canopen-old-code-page")


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


class LogWriter(Protocol):
    """Writes a log file. Raises OSError if there is no room."""

    left_out: int
    """How many frames this kind of file could not hold."""

    def write(self, record: Record) -> None:
        """Add a record."""

    def close(self) -> None:
        """End the file. Until then it may be unusable, unless it is a `.log`."""


def log_writer(path: Path) -> LogWriter:
    """Create a log file of the kind that its name says, replacing an older one. Raises LogFileError."""
    kind = kind_of(path)
    try:
        if kind == ".log":
            return CandumpWriter(open(path, "w", encoding="utf-8", buffering=1))
        return _CAPTURES[kind](open(path, "wb")) if kind in _CAPTURES else _ForeignWriter(path, kind)
    except OSError as error:
        raise _no_access("write", path, error) from error


def _no_access(doing: str, path: Path, error: OSError) -> LogFileError:
    cause = f"it has another name, lies in another folder, or is not this user's to {doing}"
    return LogFileError(f"cannot {doing} {path}", error.strerror or str(error), cause, ("check the path",))


class CandumpWriter:
    """Writes `.log`. Each line goes to the system at once, so that a killed process leaves all of them."""

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
    """Writes by python-can. Channels are numbered in the order of their first frames."""

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
    # Opened here: python-can's writers leave a file open if they cannot end it. (A .trc contains the file's name.)
    return open(path, "wb") if kind == ".blf" else open(path, "w", encoding="utf-8", errors="backslashreplace")


class _AscWriter(can.ASCWriter):
    FORMAT_DATE = "%a %b %d %H:%M:%S.{:03d} %Y"  # python-can writes 7 ms as ".7"


_WRITERS: Final[dict[str, Callable[[Any], Any]]] = {".asc": _AscWriter, ".blf": can.BLFWriter, ".trc": can.TRCWriter}
