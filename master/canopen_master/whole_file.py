"""`whole_file`: a file that is written whole, or stays as it was. `file_at`: which file is at a path."""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO


@contextmanager
def whole_file(path: str | Path, *, is_new: bool = False) -> Iterator[IO[bytes]]:
    """Open a file for writing. It has its new content when the block ends; if the block raises, the file stays as it was.
    is_new: one that is there by then is not replaced: FileExistsError.

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
        (_rename if is_new else os.replace)(beside, target)
    except BaseException:
        with suppress(OSError):
            os.unlink(beside)
        raise


def _rename(beside: str, target: str) -> None:
    """Give a file its name. Raises FileExistsError if another one has it."""
    try:
        os.link(beside, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        if os.path.lexists(target):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), target) from None
        os.replace(beside, target)
    else:
        os.unlink(beside)


def _mode_of(path: str | Path) -> int | None:
    try:
        return os.stat(path).st_mode
    except FileNotFoundError:
        return None


def file_at(path: Path) -> tuple[int, int] | None:
    """Return what tells the file at a path from any other one, also of the same name; None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino
