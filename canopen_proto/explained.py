"""`Explained`: what every error with a code says, and how it says it on one screen."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypedDict


def counted(number: int, what: str) -> str:
    """Return a text such as "1 entry", "2 entries". what: in the singular."""
    if number == 1:
        return f"{number} {what}"
    if what.endswith("y") and what[-2:-1] not in "aeiou":
        return f"{number} {what[:-1]}ies"
    return f"{number} {what}{'es' if what.endswith(('s', 'x', 'sh', 'ch')) else 's'}"


class ErrorWords(TypedDict, total=False):
    """What an error may say beside what failed; see `Explained`. An error class with fields of its own passes these words on."""

    seen: str
    cause: str
    also: Iterable[str]
    tries: Iterable[str]


class Explained:
    """The base of errors and reports that explain themselves. `str` gives the screen for people; the fields are for programs.

    code: such as "CO201"; docs/errors.md lists them. failed: what failed. seen: what was observed. cause: the likely causes, best
    first. also: what else went wrong, or was done. tries: what to do next, best first; commands stand in them as they are typed.
    """

    def __init__(
        self, code: str, failed: str, *, seen: str = "", cause: str = "", also: Iterable[str] = (), tries: Iterable[str] = ()
    ) -> None:
        self.code = code
        self.failed = failed
        self.seen = seen
        self.cause = cause
        self.also = list(also)
        self.tries = tuple(tries)

    def __str__(self) -> str:
        return "\n".join([f"{self.code}: {self.failed}", *(f"  {label} {text}" for label, text in self.details())])

    def details(self) -> list[tuple[str, str]]:
        """Return the lines below the first one, as (label, text)."""
        rows = [("seen: ", self.seen)] if self.seen else []
        rows += [("cause:", self.cause)] if self.cause else []
        rows += [("also: ", text) for text in self.also]
        return rows + [("or:   " if number else "try:  ", text) for number, text in enumerate(self.tries)]
