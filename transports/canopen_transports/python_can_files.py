"""Log files that python-can reads and writes: `.asc`, `.blf` (Vector) and `.trc` (PEAK).

python-can's readers silently skip what they cannot read, and raise anything for files that are not of their kind. Here each entry
without a frame is counted, and a damaged file says what is wrong with it.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, BinaryIO, Final, TextIO

import can
from can.io.blf import BLFParseError

from canopen_proto.frame import REMOTE
from canopen_transports.messages import MessageRefusedError, frame_of, message_of
from canopen_transports.peak import has_overrun
from canopen_transports.record import LogDamagedError, Record, Skip

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
_HEADER: Final = re.compile(r"\s*(;|(?P<word>date|base)\s+(?P<rest>.*))", re.IGNORECASE)
_STATUS: Final = re.compile(r" (?:ST|Warng|FFFFFFFF) .*?((?:\b[0-9A-F]{2} ?){4})(?: |$)")
"""An entry of a `.trc` about the recorder's own adapter, with the four bytes of its status. Source: PEAK CAN TRC File Format,
error warnings (1.0 to 1.3) and hardware status (2.0, 2.1)."""


def read_text(file: TextIO, kind: str, skip: Skip) -> Iterator[Record]:
    """Yield the records of an `.asc` or a `.trc`. file: open for reading. kind: ".asc" or ".trc"."""
    lines = _EntryLines(file, _ENTRY[kind], skip)
    reader = can.ASCReader(lines, relative_timestamp=False) if kind == ".asc" else can.TRCReader(lines)  # type: ignore[arg-type]
    found = False
    try:
        for message in reader:
            if isinstance(reader, can.ASCReader) and reader.timestamps_format == "relative":
                seen = "each of its times counts from the line before (timestamps relative)"
                raise LogDamagedError(seen, 0, "have the program that wrote it write absolute times")
            found = True
            lines.entry = ""
            record = _record_of_message(message, skip)
            if record is not None:
                yield record
    except _READING_ERRORS as error:
        raise LogDamagedError(_reason(error), lines.number) from error
    if lines.number and not (found or lines.has_header):
        raise LogDamagedError("the file has neither a header nor frames")


def read_blf(file: BinaryIO, skip: Skip) -> Iterator[Record]:
    """Yield the records of a `.blf`. file: open for reading."""
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    said = size
    try:
        reader = can.BLFReader(file)
        said = reader.file_size
        for message in reader:
            record = _record_of_message(message, skip)
            if record is not None:
                yield record
    except _READING_ERRORS as error:
        if said <= size:
            raise LogDamagedError(_reason(error)) from error
    if said > size:
        seen = f"the file ends in the middle, after {size} of {said} bytes"
        raise LogDamagedError(seen, 0, "copy it again, after its recorder has closed it")


def _record_of_message(message: can.Message, skip: Skip) -> Record | None:
    if message.is_error_frame:
        skip("an error frame")
        return None
    try:
        frame = frame_of(message)
    except MessageRefusedError as reason:
        skip(str(reason))
        return None
    channel = "" if message.channel is None else str(message.channel)
    time = round(message.timestamp * 10**6) * 1000  # a float of today's date is not more exact
    return Record(time, f"can{channel}" if channel.isdecimal() else channel, frame, not message.is_rx)


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


class _EntryLines:
    """The lines of a text file for python-can's readers, which silently skip lines that they cannot read.

    number: of the last line that was read. entry: that line, if it records an event; "" once a reader has returned a message for
    it. has_header: whether there was a header line.
    """

    def __init__(self, file: TextIO, entry: re.Pattern[str], skip: Skip) -> None:
        self.number = 0
        self.entry = ""
        self.has_header = False
        self._has_entries = False
        self._base = ""
        self._file = file
        self._pattern = entry
        self._skip = skip

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        if self.entry:
            status = _STATUS.search(self.entry)
            lost = status is not None and has_overrun(int(status[1].replace(" ", ""), 16))
            self._skip(f"{self.entry[:60]!r}", is_overrun=lost)
            self.entry = ""
        line = next(self._file)
        self.number += 1
        if self._pattern.match(line):
            self._has_entries = True
            self.entry = " ".join(line.split())
        elif (header := _HEADER.match(line)) is not None:
            self.has_header = True
            if header["word"] is not None:
                return self._of_header(line, header["word"].lower(), " ".join(header["rest"].split()))
        return line

    def _of_header(self, line: str, word: str, rest: str) -> str:
        """Return a line of the header of an `.asc` in the form that python-can's reader understands where it stands: it takes a
        date from a second header only as that of a trigger block."""
        if word == "base":
            base = rest.lower() if "timestamps" in rest.lower() else f"{rest.lower()} timestamps absolute"
            if self._has_entries and base != self._base:
                raise LogDamagedError(f"a second header has other numbers or times: base {rest}", self.number)
            self._base = base
        return f"Begin Triggerblock {rest}\n" if word == "date" and self._has_entries else line

    def close(self) -> None:
        """Does nothing: python-can's readers call it at their end, but our caller closes the file."""


class PythonCanWriter:
    """Writes by python-can. Channels are numbered in the order of their first frames. kind: ".asc", ".blf" or ".trc"."""

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

    def lost(self, time: int, channel: str) -> None:
        """Do nothing: python-can writes no such entry that its readers give back."""

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
