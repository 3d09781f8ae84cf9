"""The keys of a terminal, one by one: for commands that move something while a key is held.

A terminal tells that a key is held by repeating it: at first after half a second or so, then 10 to 30 times a second. It does not
tell the release. So a key counts as held from its first repetition on, and as released once none has come for HOLD. Everything
that is there at a time is one key, the last: what a stalled program finds later is no sign that the key is still held.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

import trio

HOLD: Final = 0.15
"""Seconds without a repetition after which a key counts as released."""
FIRST: Final = 0.8
"""Seconds within which a key that is held has to be repeated for the first time; terminals wait 0.25 to 0.66."""
RIGHT: Final = "\x1b[C"
LEFT: Final = "\x1b[D"
END: Final = "\x04"
"""The end of the input (Ctrl-D), or of the terminal."""
_SEQUENCE: Final = 3
"""Characters of a cursor key: Escape, [ and a letter; O in place of [ from some terminals."""


class TerminalKeys:
    """The keys that come. read: waits for input and returns it; nothing at its end."""

    def __init__(self, read: Callable[[], Awaitable[bytes]]) -> None:
        self._read = read
        self._back = ""

    async def next(self, within: float = float("inf")) -> str:
        """Return the next key; "" if none comes in time (seconds), END at the end of the input."""
        if self._back:
            key, self._back = self._back, ""
            await trio.lowlevel.checkpoint()
            return key
        with trio.move_on_after(within):
            return _last_key((await self._read()).decode(errors="replace"))
        return ""

    async def is_held(self, key: str) -> bool:
        """Return whether a key that has just come is repeated, as one that is held. Another key comes next."""
        return await self._is_repeated(key, FIRST)

    async def is_still_held(self, key: str) -> bool:
        """Return whether a key that is held is repeated in time. Another key comes next."""
        return await self._is_repeated(key, HOLD)

    async def _is_repeated(self, key: str, within: float) -> bool:
        again = await self.next(within)
        if again != key:
            self._back = again
        return again == key


def _last_key(text: str) -> str:
    if not text or END in text:
        return END
    begin = text.rfind("\x1b", -_SEQUENCE)
    return text[begin:].replace("\x1bO", "\x1b[") if begin >= 0 else text[-1]


async def read_terminal(terminal: int | None = None) -> bytes:
    """Wait for keys, and return them; nothing once the terminal is gone.

    terminal: a file descriptor, by default that of stdin.
    """
    fd = sys.stdin.fileno() if terminal is None else terminal
    try:
        await trio.lowlevel.wait_readable(fd)
        return os.read(fd, 1024)
    except OSError:  # EIO: the terminal was closed
        return b""


@contextmanager
def key_by_key(terminal: int | None = None) -> Iterator[None]:
    """Have the terminal give each key at once, and show none, while the block runs. Ctrl-C stays what it is.
    Ctrl-Z is a key like others: a program that is stopped would leave the terminal, and drives that move, as they are.

    terminal: a file descriptor, by default that of stdin.
    """
    import termios
    import tty

    fd = sys.stdin.fileno() if terminal is None else terminal
    before = termios.tcgetattr(fd)
    tty.setcbreak(fd)
    changed = termios.tcgetattr(fd)
    changed[6][termios.VSUSP] = bytes((os.fpathconf(fd, "PC_VDISABLE"),))
    termios.tcsetattr(fd, termios.TCSADRAIN, changed)
    try:
        yield
    finally:
        with suppress(termios.error):  # it is gone
            termios.tcsetattr(fd, termios.TCSADRAIN, before)
