"""A failure as one screen for people, one JSON object for programs, and one exit status for scripts.

A command that cannot go on raises a `CommandError`: what failed (node, object, value), what was seen, the likely cause, what to
try next. `failures.problem_of` makes one of every other exception. A traceback is shown with -vv only.
"""

from __future__ import annotations

import errno
import re
import shlex
from enum import IntEnum
from pathlib import Path
from typing import Any, Unpack

from canopen_proto.explained import ErrorWords, Explained


class ExitCode(IntEnum):
    """Exit statuses of the command line."""

    OK = 0
    DIFFERENT = 1
    """Finished, with findings or differences."""
    USAGE = 2
    CANNOT_OPEN = 3
    BUS_FAULT = 4
    NO_ANSWER = 5
    BAD_FILE = 6
    PARTIAL = 7
    """Finished, but something could not be read, or too many cycles were late."""
    PERMISSION = 9
    INTERNAL = 10
    SDO_ABORT = 11
    DRIVE_FAULT = 12
    VERIFY_MISMATCH = 13
    INTERRUPTED = 130

    @property
    def kind(self) -> str:
        """The kind of a failure, for --json."""
        return "other" if self in (ExitCode.OK, ExitCode.DIFFERENT) else self.name.lower()


NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""Errors of a file system that cannot take more data."""


class CommandError(Explained, Exception):
    """A command cannot go on. code: "CO201" and the like; node, index, subindex, abort: what it is about, else None."""

    def __init__(
        self,
        exit_code: ExitCode,
        code: str,
        failed: str,
        *,
        node: int | None = None,
        index: int | None = None,
        subindex: int | None = None,
        abort: int | None = None,
        **words: Unpack[ErrorWords],
    ) -> None:
        super().__init__(code, failed, **words)
        self.exit_code = exit_code
        self.node = node
        self.index = index
        self.subindex = subindex
        self.abort = abort

    def on_bus(self, bus: str | None, machine: str | None = None) -> CommandError:
        """Add the bus of -b, and the machine file of -m, to each command that it advises, so that the next command asks the same
        bus. Returns itself."""
        self.tries = tuple(with_bus(step, bus, machine) for step in self.tries)
        return self

    def as_json(self) -> dict[str, Any]:
        """Return the error for --json."""
        return {
            "code": self.code,
            "kind": self.exit_code.kind,
            "node": self.node,
            "index": self.index,
            "sub": self.subindex,
            "abort": self.abort,
            "message": self.failed,
            "seen": self.seen,
            "cause": [self.cause] if self.cause else [],
            "also": self.also,
            "try": list(self.tries),
        }


def usage(code: str, failed: str, **more: Any) -> CommandError:
    """Make a CommandError about what the user typed. code: such as "CO123". failed: what failed, for the text."""
    return CommandError(ExitCode.USAGE, code, failed, **more)


def cannot_read(path: str | Path, error: OSError) -> CommandError:
    """Make a CommandError about a file that cannot be read."""
    return CommandError(ExitCode.BAD_FILE, "CO340", f"cannot read {path}: {error.strerror}", tries=("check the path",))


_ON_A_BUS = re.compile(
    r"canopen (?:lss [a-z-]+|net (?:check|boot|watch)|scan|info|read|write|nmt|home|drive|sim|backup|restore|flash|dump"
    r"|store|reset-defaults|sync|time|monitor|top|tui|watch|listen|pdo|emcy|move|jog|shell"
    r"|(?:check|compare) [0-9])\b"
)
_BEFORE_BUS = re.compile(r"(?=    | -- |$)")  # before a remark, or before arguments that must stand last


def with_bus(step: str, bus: str | None, machine: str | None) -> str:
    """Return a step with -b and -m, if it is a command about a bus. bus, machine: what to put there; None: nothing."""
    options = "".join(f" {option} {shlex.quote(value)}" for option, value in (("-m", machine), ("-b", bus)) if value is not None)
    if not options or _ON_A_BUS.match(step) is None or re.search(r" (-b|--bus|--help)\b", step) is not None:
        return step
    return _BEFORE_BUS.sub(lambda place: options, step, count=1)
