"""The standard streams of the process: some are closed from the start, others go away while a command runs."""

from __future__ import annotations

import os
import stat
import sys
from contextlib import suppress
from typing import IO


def open_closed_streams() -> None:
    """Replace a standard stream that the shell closed (`canopen scan >&-`): Python has None in its place."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115 - until the process ends


def put_to_rest(stream: IO[str]) -> None:
    """Throw away what is still to be written; or Python would complain when it flushes the stream at the end."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def put_closed_pipes_to_rest() -> None:
    """Throw away what is still to be written to readers that have gone, of stdout and of stderr: perhaps both have."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            put_to_rest(stream)


def put_lost_terminal_to_rest() -> None:
    """Throw away what is written to a terminal that is gone: each write would fail."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            number = stream.fileno()
            if stat.S_ISCHR(os.fstat(number).st_mode) and not os.isatty(number):
                put_to_rest(stream)
