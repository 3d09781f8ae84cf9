"""How frames travel on `tcp:`: lines of text, in candump's notation. Pure: bytes in, lines and frames out.

    canopen-bus 1               hello and version, the first line of both sides; the server says it when the other is a member
    605#4041600000000000        a frame, as `Frame.parse` reads it; both ways
    lost 17                     server to member: at this place 17 frames are missing, as the member took them too slowly
    bye the line ... is no frame        server to member: why it is cut off; the last line

Lines end with LF; a CR before it is dropped. Everything else is refused: identifiers, lengths and digits are checked on both
sides.

Why text: `nc localhost 20301`, type the hello, and the bus is on the screen; a frame is sent by typing it. Records of 16 bytes
would be five times cheaper (0.6 us to write and read a frame, against 3.8 us), but next to what a frame costs anyway on its way
through two sockets (some 200 us) that is little, and at full load of a 1 Mbit/s bus, 8000 frames a second, it is 3 % of one core.
The server reads no frames at all: it checks a line by one regular expression and hands it on as it is (0.8 us).
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple, TypeAlias

from canopen_proto.frame import EXTENDED, REMOTE, Frame

HELLO: Final = b"canopen-bus 1"
MAX_LINE: Final = 256
"""Bytes of a line without its end. A frame has 25 at most, the rest is room for the reason behind `bye`."""
MAX_LOST: Final = 10**9

_FRAME: Final = re.compile(rb"([0-7][0-9A-F]{2}|[01][0-9A-F]{7})#(?:(R)([0-8]?)|((?:[0-9A-F]{2}){0,8}))")
_LOST: Final = re.compile(rb"lost ([1-9][0-9]{0,8})")
_BYE: Final = b"bye "


class FramingError(ValueError):
    """A line that has no place in the protocol. The text says which."""


class Lost(NamedTuple):
    """Frames are missing at this place."""

    frames: int


class Bye(NamedTuple):
    """The server ends the connection."""

    reason: str


Item: TypeAlias = Frame | Lost | Bye


class LineSplitter:
    """Lines from chunks as they come from a socket. At most MAX_LINE + 1 bytes are kept.

    A line that is longer comes out as its first MAX_LINE + 1 bytes, which nothing here accepts; after it no more lines come.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._is_deaf = False

    @property
    def pending(self) -> bool:
        """Whether a line was begun and not ended."""
        return bool(self._rest)

    def feed(self, chunk: bytes) -> list[bytes]:
        """The lines that are whole now, without their ends."""
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
    """The line of a frame that has passed `check_frame`, with its end."""
    return b"%s\n" % str(frame).encode("ascii")


def lost_line(count: int) -> bytes:
    """The line for lost frames."""
    return b"lost %d\n" % min(count, MAX_LOST - 1)


def bye_line(reason: str) -> bytes:
    """The line that ends a connection. The reason is cut to fit, and made plain ASCII."""
    text = " ".join(reason.split()).encode("ascii", "backslashreplace")
    return _BYE + text[: MAX_LINE - len(_BYE)] + b"\n"


def checked(line: bytes) -> bytes:
    """A line with a frame as it is handed on, with its end. Raises FramingError. For the server."""
    good = line.upper()
    if _FRAME.fullmatch(good) is None:
        raise FramingError(f"the line {shown(line)} is no CAN frame; a frame is written like 605#4041600000000000")
    return good + b"\n"


def decode(line: bytes) -> Item:
    """What a line of the server's says. Raises FramingError."""
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
    """A line of somebody else's, as a message may show it."""
    return repr(line[:40]).removeprefix("b") + ("..." if len(line) > 40 else "")
