"""`whole_file`: a file that is written whole, or stays as it was."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO


@contextmanager
def whole_file(path: str | Path) -> Iterator[IO[bytes]]:
    """Open a file for writing. It has its new content when the block ends; if the block raises, the file stays as it was.

    The bytes go into a file of another name in the same folder, which then takes its place. Links are followed; an older file
    keeps its permissions. A path that is not a regular file, such as a pipe or /dev/null, is written to directly; opening a
    pipe waits for its reader. Raises OSError, and ValueError if the path is not valid.
    """
    mode = _mode_of(path)
    if mode is not None and not stat.S_ISREG(mode):
        with open(path, "wb") as file:
            yield file
        return
    target = os.path.realpath(path)
    beside = os.path.join(os.path.dirname(target), f".canopen-{secrets.token_hex(8)}.part")
    try:
        with open(beside, "xb") as file:
            yield file
        if mode is not None and mode != os.stat(beside).st_mode:  # a file system without permissions has none to set
            os.chmod(beside, stat.S_IMODE(mode))
        os.replace(beside, target)
    except BaseException:
        with suppress(OSError):
            os.unlink(beside)
        raise


def _mode_of(path: str | Path) -> int | None:
    try:
        return os.stat(path).st_mode
    except FileNotFoundError:
        return None
