"""The protocol of `tcp:`: lines of text, in candump's notation. Pure: bytes in, lines and frames out.

    canopen-bus 1                      hello and version: the first line of each side; the server's makes the other a member
    605#4041600000000000               a frame, as `Frame.parse` reads it; both ways
    lost 17                            server to member: 17 frames are missing here, as the member took them too slowly
    bye the line ... is no frame       server to member: why it is cut off; the last line

Lines end with LF; a CR before it is dropped. Each side checks identifiers, lengths and digits, and refuses any other line.

Why text: with `nc localhost 20301` and a typed hello, the bus is on the screen; typing a frame sends it. Records of 16 bytes
would be five times cheaper (0.6 us instead of 3.8 us to write and read a frame). But a frame's way through two sockets costs some
200 us anyway, and at full load of a 1 Mbit/s bus, 8000 frames a second, text takes 3 % of one core. The server does not parse
frames: it checks a line by one regular expression and passes it on unchanged (0.8 us).
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple, TypeAlias

from canopen_proto.frame import EXTENDED, REMOTE, Frame

HELLO: Final = b"canopen-bus 1"
MAX_LINE: Final = 256
"""Bytes of a line without its end. A frame has 25 at most; the rest is room for the reason in a `bye`."""
MAX_LOST: Final = 10**9

_FRAME: Final = re.compile(rb"([0-7][0-9A-F]{2}|[01][0-9A-F]{7})#(?:(R)([0-8]?)|((?:[0-9A-F]{2}){0,8}))")
_LOST: Final = re.compile(rb"lost ([1-9][0-9]{0,8})")
_BYE: Final = b"bye "


class FramingError(ValueError):
    """A line that is not part of the protocol. The text says which."""


class Lost(NamedTuple):
    """Frames are missing at this place."""

    frames: int


class Bye(NamedTuple):
    """The server ends the connection."""

    reason: str


Item: TypeAlias = Frame | Lost | Bye


class LineSplitter:
    """Splits chunks from a socket into lines. Keeps at most MAX_LINE + 1 bytes.

    A longer line comes out as its first MAX_LINE + 1 bytes, which no function here accepts. No line comes after it.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._is_deaf = False

    @property
    def pending(self) -> bool:
        """Whether a line was begun and not ended."""
        return bool(self._rest)

    def feed(self, chunk: bytes) -> list[bytes]:
        """Add a chunk; return the lines that are complete now, without their ends."""
        if self._is_deaf:
            return []
        *whole, self._rest = (self._rest + chunk).split(b"\n")
        lines = []
        for line in whole:
            if len(line) > MAX_LINE:
                self._rest = line
                break
            lines.append(line.removesuffix(b"\r"))
        if len(self._rest) > MAX_LINE:
            lines.append(self._rest[: MAX_LINE + 1])
            self._rest, self._is_deaf = b"", True
        return lines


def encode(frame: Frame) -> bytes:
    """Return the line, with its end, for a frame that has passed `check_frame`."""
    return b"%s\n" % str(frame).encode("ascii")


def lost_line(count: int) -> bytes:
    """Return the line for lost frames."""
    return b"lost %d\n" % min(count, MAX_LOST - 1)


def bye_line(reason: str) -> bytes:
    """Return the line that ends a connection, with the reason in ASCII and cut to fit."""
    text = " ".join(reason.split()).encode("ascii", "backslashreplace")
    return _BYE + text[: MAX_LINE - len(_BYE)] + b"\n"


def checked(line: bytes) -> bytes:
    """Return a frame's line as the server passes it on, with its end. Raises FramingError."""
    good = line.upper()
    if _FRAME.fullmatch(good) is None:
        raise FramingError(f"the line {shown(line)} is no CAN frame; a frame is written like 605#4041600000000000")
    return good + b"\n"


def decode(line: bytes) -> Item:
    """Return the meaning of a line from the server. Raises FramingError."""
    match = _FRAME.fullmatch(line)
    if match is not None:
        identifier, remote, dlc, data = match.groups()
        can_id, flags = int(identifier, 16), EXTENDED if len(identifier) == 8 else 0
        if remote:
            return Frame(can_id, b"", flags | REMOTE, int(dlc or b"0"))
        return Frame(can_id, bytes.fromhex(data.decode("ascii")), flags)
    match = _LOST.fullmatch(line)
    if match is not None:
        return Lost(int(match[1]))
    if line.startswith(_BYE) and len(line) <= MAX_LINE:
        return Bye(line.removeprefix(_BYE).decode("ascii", "backslashreplace"))
    raise FramingError(f"the line {shown(line)} has no meaning here")


def shown(line: bytes) -> str:
    """Return the beginning of a foreign line, for a message."""
    return repr(line[:40]).removeprefix("b") + ("..." if len(line) > 40 else "")
