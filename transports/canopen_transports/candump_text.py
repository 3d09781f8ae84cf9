"""Text of can-utils' candump: read the lines of its log files, and those that it shows on a screen; write its log files.

    (1436509053.850870) can0 605#4041600000000000 T                        candump -l, candump -L
      can0  605   [8]  40 41 60 00 00 00 00 00                             candump can0
     (000.035899)  can0  TX - -  605   [8]  40 41 60 00 00 00 00 00        candump -t z -x can0

A line from a screen has a time only with candump's option -t; without it, the time is 0. Differences (-t d) stay differences.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from datetime import datetime
from typing import Final, TextIO

from canopen_proto.frame import Frame
from canopen_transports.error_frames import ErrorReport
from canopen_transports.record import DEFAULT_CHANNEL, LogDamagedError, Record, Skip

EXAMPLE: Final = "(1436509053.850870) can0 605#4041600000000000    (a line as `candump -L` writes it)"

MAX_DAMAGED: Final = 100
"""Lines in a row that are not candump's: more are a file of another kind."""

_LOGGED: Final = re.compile(r"\(([0-9]{1,11})\.([0-9]{1,9})\)\s+(\S+)\s+([0-9A-Fa-f]+#\S*)(?:\s+([RT]))?")
_SHOWN: Final = re.compile(
    r"(?:\((?:([0-9]{1,11})\.([0-9]{1,9})|([0-9]{4}-[0-9-]{5} [0-9:.]{8,15}))\)\s+)?"  # -t
    r"(\S+)\s+(?:(RX|TX) [-B] [-E]\s+)?"  # -x
    r"([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+\[([0-9]{1,2})\](?:\s+(.*))?"
)
_RAW_DLC: Final = re.compile(r"_[0-9A-Fa-f]$")  # how candump shows a DLC of 9 to 15, which means 8 bytes
_BYTES: Final = re.compile(r"(?:[0-9A-Fa-f]{2}){0,8}")
_ERROR_FRAME: Final = 0x20000000
LOST: Final = "20000004#0001000000000000"
"""linux/can/error.h: CAN_ERR_CRTL, with CAN_ERR_CRTL_RX_OVERFLOW in data[1]."""


class NotAFrameError(ValueError):
    """The line is candump's, but not a frame of classical CAN. The text says what it is.

    is_overrun: it is an error frame by which the recorder's controller says that it lost frames.
    """

    def __init__(self, text: str, *, is_overrun: bool = False) -> None:
        super().__init__(text)
        self.is_overrun = is_overrun


def read_candump(lines: Iterable[str], skip: Skip) -> Iterator[Record]:
    """Yield the records of lines; empty lines are allowed. skip: told of each line that is no frame of classical CAN, and of each
    line between frames that is not candump's: frames are missing there. Raises LogDamagedError for such a line before all frames,
    or behind the last one, and for more than MAX_DAMAGED of them in a row."""
    damaged: list[LogDamagedError] = []  # behind the last line that was understood
    is_begun = False
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if not text:
            continue
        try:
            record = parse_line(text)
        except NotAFrameError as reason:
            skip(str(reason), is_overrun=reason.is_overrun)
            continue
        except ValueError as error:
            damaged.append(LogDamagedError(str(error), number, EXAMPLE))
            if not is_begun or len(damaged) > MAX_DAMAGED:
                break
            continue
        for each in damaged:
            skip(f"line {each.line} is damaged: {each}", is_overrun=True)
        damaged.clear()
        is_begun = True
        yield record
    if damaged:
        raise damaged[0]


def parse_line(line: str) -> Record:
    """Return the frame on a line, with its time. Raises NotAFrameError; ValueError for a line that is not candump's."""
    logged = _LOGGED.fullmatch(line)
    if logged is not None:
        seconds, fraction, channel, text, direction = logged.groups()
        return Record(_time(seconds, fraction), channel, _logged_frame(text), direction == "T")
    shown = _SHOWN.fullmatch(line)
    if shown is None:
        raise ValueError(f"{line[:60]!r} is not a line of candump")
    seconds, fraction, date, channel, direction, identifier, length, rest = shown.groups()
    time = _time(seconds, fraction) if seconds else 0 if date is None else _time_of_date(date)
    return Record(time, channel, _shown_frame(identifier, length, rest or ""), direction == "TX")


def _time(seconds: str, fraction: str) -> int:
    return int(seconds) * 10**9 + int(fraction.ljust(9, "0"))


def _time_of_date(date: str) -> int:
    """Return the time in ns since 1970. The date has no time zone; we take ours."""
    return round(datetime.fromisoformat(date).timestamp() * 10**6) * 1000


def _logged_frame(text: str) -> Frame:
    identifier, _, data = text.partition("#")
    if data.startswith("#"):
        raise NotAFrameError("a CAN FD frame")
    _check_identifier(identifier, data)
    return Frame.parse(_RAW_DLC.sub("", text) if "_" in text else text)


def _shown_frame(identifier: str, length: str, rest: str) -> Frame:
    if len(length) == 2:  # "[08]", "[64]": classical CAN has one digit
        raise NotAFrameError("a CAN FD frame")
    data = rest.split()[: int(length)]  # with -a, the bytes follow as text
    _check_identifier(identifier, "".join(data))
    if rest.startswith("remote request"):
        return Frame.parse(f"{identifier}#R{length}")
    if len(data) < int(length) or not all(len(byte) == 2 for byte in data):
        raise ValueError(f"the line announces {length} bytes, but has {rest[:40]!r}")
    return Frame.parse(f"{identifier}#{''.join(data)}")


def _check_identifier(identifier: str, data: str) -> None:
    if len(identifier) == 8 and int(identifier, 16) & _ERROR_FRAME:
        pairs = _BYTES.match(data)
        report = ErrorReport(int(identifier, 16), bytes.fromhex(pairs[0] if pairs else ""))
        raise NotAFrameError("an error frame", is_overrun=report.overrun)


def log_line(record: Record) -> str:
    """Return the line of a frame in a log, with its end."""
    return f"{_head(record.time, record.channel)} {record.frame} {'T' if record.sent else 'R'}\n"


def lost_line(time: int, channel: str) -> str:
    """Return the line that says that frames are missing here: SocketCAN's error frame of a receive buffer that overran. time,
    channel: as of a Record."""
    return f"{_head(time, channel)} {LOST} R\n"


def _head(time: int, channel: str) -> str:
    seconds, fraction = divmod(time // 1000, 10**6)
    return f"({seconds:010d}.{fraction:06d}) {channel or DEFAULT_CHANNEL}"


class CandumpWriter:
    """Writes `.log`. Each line goes to the system at once, so that a killed process leaves all of them. file: open for
    writing."""

    def __init__(self, file: TextIO) -> None:
        self.left_out = 0
        self._file = file

    def write(self, record: Record) -> None:
        """Add a line."""
        self._file.write(log_line(record))

    def lost(self, time: int, channel: str) -> None:
        """Add the line by which `read_candump` knows that frames are missing."""
        self._file.write(lost_line(time, channel))

    def close(self) -> None:
        """Close the file."""
        self._file.close()
