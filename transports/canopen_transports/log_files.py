"""Log files of CAN buses: candump's `.log`; `.pcap` and `.pcapng` (Wireshark); `.asc`, `.blf` (Vector) and `.trc` (PEAK).

python-can reads and writes Vector's and PEAK's kinds (python_can_files.py), capture_files.py Wireshark's. candump_text.py reads
and writes `.log`, because python-can's writer drops the length of remote frames. That is the default kind: text, one frame a
line. It loses nothing that CANopen has, except times below a microsecond:

    (1436509053.850870) can0 605#4041600000000000 T

T at the end means sent by the recorder, R received, as `candump -L -x` writes it; files without it are read, too. Files ending in
`.log` or `.txt`, and standard input, may also contain what candump shows on a screen (candump_text.py). Standard input may be a
capture, too, as `tshark -w -` writes it: its first bytes tell.

LOSSES says what the other kinds lose, measured with python-can 4.6 (see the tests). The reader skips and counts entries that are
not classical CAN frames: error frames, CAN FD, a measuring program's own events. A file that is not of its kind, or that ends in
the middle, raises an error after all frames that can be read. A damaged line between candump's is skipped and counted, too.
"""

from __future__ import annotations

import codecs
import os
from collections.abc import Callable, Generator, Iterator
from io import BufferedReader, TextIOWrapper
from pathlib import Path
from typing import BinaryIO, Final

from canopen_proto.explained import Explained
from canopen_transports.candump_text import CandumpWriter, read_candump
from canopen_transports.capture_files import MAGICS, PcapngWriter, PcapWriter, read_capture
from canopen_transports.python_can_files import PythonCanWriter, read_blf, read_text
from canopen_transports.record import LogDamagedError, LogWriter, Record, Skip

UNREADABLE: Final = "CO342"

LOSSES: Final = {
    ".log": "",
    ".asc": "names of buses become numbers; the date is kept to the millisecond, and without its time zone; frames earlier than "
    "the first one get its time; where frames were lost",
    ".blf": "names of buses become numbers; times without a date (before 1990) are counted from the first frame's millisecond; "
    "frames earlier than the first one get its time; where frames were lost",
    ".trc": "remote frames are left out; names of buses become numbers; where frames were lost",
    ".pcap": "names of buses; which frames were sent",
    ".pcapng": "",
}
"""By the ending of a file, in words for people: what such a file cannot hold."""

_BINARY: Final[dict[str, Callable[[BinaryIO, Skip], Iterator[Record]]]] = {
    ".blf": read_blf,
    ".pcap": read_capture,
    ".pcapng": read_capture,
}
"""The readers of the kinds that are not text."""
_CAPTURES: Final[dict[str, Callable[[BinaryIO], LogWriter]]] = {".pcap": PcapWriter, ".pcapng": PcapngWriter}
_STATS: Final = "canopen log stats FILE    (what is in a file)"
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
    """Return the kind of a log file by its name: a key of LOSSES. Raises LogFileError. path: its ending counts."""
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
    last was not. overruns: how many of these say that frames are missing there: error frames of a recorder that was overrun, its
    own number of lost packets, and damaged lines between frames; last_overrun: what the last of them said.
    """

    def __init__(self, path: Path, stream: BufferedReader | None = None) -> None:
        self.path = path
        self.skipped = 0
        self.overruns = 0
        self.last_skip = self.last_overrun = ""
        self._stream = stream
        self._file: BufferedReader | None = None
        self._kind = ".log" if stream is not None or path.suffix.lower() == ".txt" else kind_of(path)

    def __iter__(self) -> Generator[Record]:
        # Opened here: python-can's readers leave a file open if they raise.
        try:
            if self._stream is not None:  # the caller closes it
                yield from self._records(self._stream, ".pcap" if self._stream.peek(4)[:4] in MAGICS else ".log")
            else:
                with open(self.path, "rb") as file:
                    self._file = file
                    yield from self._records(file, self._kind)
        except OSError as error:
            raise _no_access("read", self.path, error) from error
        except LogDamagedError as error:
            place = f"{self.path}:{error.line}" if error.line else str(self.path)
            cause = "the file is damaged, or of another kind than its name says"
            tries = error.tries or (_STATS,)
            raise LogFileError(f"{place} is not understood", str(error), cause, tries, line=error.line) from error

    @property
    def share(self) -> float | None:
        """How much of the file was read so far, 0 to 1; None: nobody knows, as of a stream, or of a file that is closed."""
        file = self._file
        try:
            size = 0 if file is None or file.closed else os.fstat(file.fileno()).st_size
            return None if file is None or not size else min(1.0, file.tell() / size)
        except (OSError, ValueError):
            return None

    def _records(self, file: BufferedReader, kind: str) -> Iterator[Record]:
        if kind in _BINARY:
            yield from _BINARY[kind](file, self._skip)
            return
        text = _text(file)
        try:
            yield from read_candump(text, self._skip) if kind == ".log" else read_text(text, kind, self._skip)
        finally:
            text.detach()

    def _skip(self, reason: str, *, is_overrun: bool = False) -> None:
        self.skipped += 1
        self.last_skip = reason
        if is_overrun:
            self.overruns += 1
            self.last_overrun = reason


def _text(stream: BufferedReader) -> TextIOWrapper:
    """Decode a stream from its beginning: by its byte order mark, as UTF-8 without one."""
    encoding = "utf-16" if stream.peek(2)[:2] in _UTF16_MARKS else "utf-8-sig"
    return TextIOWrapper(stream, encoding, errors="canopen-old-code-page")


def log_writer(path: Path) -> LogWriter:
    """Create a log file of the kind that its name says, replacing an older one. Raises LogFileError. path: its ending says the
    kind, see `kind_of`."""
    kind = kind_of(path)
    try:
        if kind == ".log":
            return CandumpWriter(open(path, "w", encoding="utf-8", buffering=1))
        return _CAPTURES[kind](open(path, "wb")) if kind in _CAPTURES else PythonCanWriter(path, kind)
    except OSError as error:
        raise _no_access("write", path, error) from error


def _no_access(doing: str, path: Path, error: OSError) -> LogFileError:
    cause = f"it has another name, lies in another folder, or is not this user's to {doing}"
    return LogFileError(f"cannot {doing} {path}", error.strerror or str(error), cause, ("check the path",))
