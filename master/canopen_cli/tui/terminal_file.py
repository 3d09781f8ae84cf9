"""The terminal as the view's library writes to it: a character that it cannot show is ASCII of the same width.

And a terminal that is gone takes nothing more, without an error: the thread that writes would end with it, and the view would
wait for that thread for ever.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO, Any, cast

from canopen_cli.shared.marks import cells_of, wants_ascii


class TerminalFile:
    """A stream of a terminal; see this module's text. ascii: whether it gets ASCII alone."""

    def __init__(self, stream: IO[str], *, ascii: bool) -> None:
        self._stream = stream
        self._ascii = ascii

    def write(self, text: str) -> int:
        """Write a text, with escape sequences."""
        with suppress(OSError, ValueError):
            self._stream.write(cells_of(text) if self._ascii else text)
        return len(text)

    def flush(self) -> None:
        """Send what was written."""
        with suppress(OSError, ValueError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def terminal_file() -> Iterator[None]:
    """Make the process's own stderr a TerminalFile while the block runs: the library writes there."""
    stream = sys.__stderr__
    if stream is None:
        yield
        return
    encoding = (stream.encoding or "ascii").lower().replace("-", "")
    made = TerminalFile(stream, ascii=wants_ascii(os.environ) or not encoding.startswith("utf"))
    sys.__stderr__ = cast(Any, made)  # type: ignore[misc]
    try:
        yield
    finally:
        sys.__stderr__ = stream  # type: ignore[misc]
