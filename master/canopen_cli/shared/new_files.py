"""Check that a new file may be written, and write it whole or not at all.

Every command that writes a file which a user has named (-o, --trace, --plot ...) calls `check_new_file` before its work begins:
an existing file is overwritten only if the user agrees, on a terminal or by --force. One that another program has made meanwhile
is not overwritten.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Final

import click

from canopen_cli.shared.options import Settings
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.screen import Screen
from canopen_master.plain_text import clean
from canopen_master.whole_file import whole_file

_absent: Final[set[str]] = set()
"""The files that were not there at the check: one that is there at the end is somebody else's."""


def check_new_file(settings: Settings, screen: Screen, path: str | Path, *inputs: str) -> None:
    """Raise a CommandError if there is no folder for the file, or none that this user may look into, if it is one of the inputs,
    or if it exists and the user does not want it overwritten. inputs: the files that the command reads.

    Without a terminal nobody can be asked: then --force has to say so (CO135, exit status 2). If the path is not a
    regular file (/dev/null, a pipe), nothing is asked: nothing is overwritten there.
    """
    target = Path(path)
    try:
        has_folder, is_folder, is_file = target.parent.is_dir(), target.is_dir(), target.is_file()
    except OSError as error:  # a folder on the way that this user may not look into
        raise _cannot_write(str(path), error) from error
    if not has_folder:
        raise CommandError(
            ExitCode.BAD_FILE, "CO341", f"cannot write {path}: there is no folder {target.parent}", tries=("write elsewhere",)
        )
    if is_folder:
        raise CommandError(ExitCode.BAD_FILE, "CO341", f"cannot write {path}: it is a folder", tries=("the name of a file",))
    _check_no_input(target, inputs)
    (_absent.discard if is_file or settings.force else _absent.add)(str(path))
    if settings.force or not is_file:
        return
    if not (screen.err.is_terminal and sys.stdin.isatty()):
        tries = (f"another name than {path}", "the same with --force")
        raise usage("CO135", f"{path} is there already, and was not overwritten", seen="nothing was done", tries=tries)
    if not click.confirm(f"{clean(str(path))} is there already. Overwrite it?", err=True):
        raise CommandError(ExitCode.INTERRUPTED, "CO132", "by you: nothing was done")


def check_writable(path: str | Path) -> None:
    """Raise a CommandError if the file cannot be opened for writing. For files that are written where they stand, not as
    `new_file`.

    One that is not there is made and removed again: nothing else tells for sure. Pipes and devices are not tried.
    """
    target = Path(path)
    try:
        is_new = not target.exists()
        if not is_new and not target.is_file():
            return
        with target.open("ab"):
            pass
        if is_new:
            target.unlink()
    except OSError as error:
        raise _cannot_write(str(path), error) from error


def write_file(path: str, data: bytes, *inputs: str) -> None:
    """Write a file as `whole_file` does. Raises a CommandError if it is one of the inputs, or cannot be written."""
    _check_no_input(Path(path), inputs)
    try:
        with whole_file(path, is_new=path in _absent) as file:
            file.write(data)
    except (OSError, ValueError) as error:
        raise _cannot_write(path, error) from error


@contextmanager
def new_file(path: str) -> Iterator[IO[bytes]]:
    """Open a file as `whole_file` does. Raises a CommandError if it cannot be opened."""
    with ExitStack() as stack:
        try:
            file = stack.enter_context(whole_file(path, is_new=path in _absent))
        except (OSError, ValueError) as error:
            raise _cannot_write(path, error) from error
        yield file
        try:
            stack.close()
        except FileExistsError as error:
            raise _cannot_write(path, error) from error


def _cannot_write(path: str, error: OSError | ValueError) -> CommandError:
    if isinstance(error, FileExistsError):
        seen = "it was not there when this command began: another program has made it"
        return usage("CO135", f"{path} is there now, and was not overwritten", seen=seen, tries=(f"another name than {path}",))
    reason = error.strerror if isinstance(error, OSError) else error
    if isinstance(error, PermissionError):
        return CommandError(ExitCode.PERMISSION, "CO109", f"cannot write {path}: {reason}", tries=("another folder",))
    return CommandError(ExitCode.BAD_FILE, "CO341", f"cannot write {path}: {reason}", tries=("write elsewhere",))


def _check_no_input(target: Path, inputs: Iterable[str]) -> None:
    for each in inputs:
        with suppress(OSError):
            if target.exists() and target.samefile(each):
                raise usage(
                    "CO123", f"{target} is the file that is read; it is not overwritten", tries=("another name after -o",)
                )
