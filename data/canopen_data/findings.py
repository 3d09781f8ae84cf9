"""The findings of reading a description: errors, collected and raised as one exception; warnings; notices."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from canopen_proto.explained import Explained, counted
from canopen_proto.machine import LocalProtocolError

__all__ = ["DictionaryError", "Finding", "Severity"]

MAX_SHOWN: Final = 10
"""Errors listed in the text of one exception. The rest is counted: a binary file read by mistake has thousands."""
LOST_SETTING: Final = "setting"
"""The code of an error about a configured value that the file has and the description has not."""
MAX_TOLD: Final = 6
"""Places listed in the text of one finding."""


class Severity(StrEnum):
    """The weight of a finding. Error: the description is unusable; warning: legal but dangerous; notice: what was done, and
    why."""

    ERROR = "error"
    WARNING = "warning"
    NOTICE = "notice"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing found in a file. code: a short name of the rule, for programs. line, column: from 1; 0 = the whole file."""

    severity: Severity
    code: str
    message: str
    source: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        where = f"{self.source}:{self.line}:{self.column}" if self.line else self.source
        return f"{where}: {self.severity}: {self.message} [{self.code}]"


def first_of(places: Sequence[str]) -> str:
    """Return the first MAX_TOLD places, and how many more there are: "0x2000, 0x2001 and 5 more"."""
    hidden = len(places) - MAX_TOLD
    return ", ".join(places) if hidden <= 0 else f"{', '.join(places[:MAX_TOLD])} and {hidden} more"


class DictionaryError(Explained, LocalProtocolError, ValueError):
    """A description cannot be used. findings: every error found. The text lists the first ones, each with its place."""

    def __init__(self, findings: Iterable[Finding], *tries: str) -> None:
        self.findings: tuple[Finding, ...] = tuple(findings)
        first, *rest = [str(each) for each in self.findings[:MAX_SHOWN]]
        hidden = len(self.findings) - MAX_SHOWN
        also = [*rest, counted(hidden, "more error")] if hidden > 0 else rest
        super().__init__("CO301", first, also=also, tries=tries or ("correct the file",))

    @property
    def source(self) -> str:
        """The file of the first error."""
        return self.findings[0].source

    @property
    def line(self) -> int:
        """The line of the first error, from 1."""
        return self.findings[0].line

    @property
    def column(self) -> int:
        """The column of the first error, from 1."""
        return self.findings[0].column
