"""`Explained`: what every error with a code says, and how it says it on one screen."""

from __future__ import annotations

from collections.abc import Iterable


class Explained:
    """The base of errors and reports that explain themselves. `str` gives the screen for people; the fields are for programs.

    code: such as "CO201"; docs/errors.md lists them. failed: what failed. seen: what was observed. cause: the likely causes, best
    first. tries: what to do next, best first; commands stand in them as they are typed.
    """

    def __init__(self, code: str, failed: str, *, seen: str = "", cause: str = "", tries: Iterable[str] = ()) -> None:
        self.code = code
        self.failed = failed
        self.seen = seen
        self.cause = cause
        self.tries = tuple(tries)

    def __str__(self) -> str:
        lines = [f"{self.code}: {self.failed}"]
        if self.seen:
            lines.append(f"  seen:  {self.seen}")
        if self.cause:
            lines.append(f"  cause: {self.cause}")
        lines += [f"  {'or:  ' if number else 'try: '}  {step}" for number, step in enumerate(self.tries)]
        return "\n".join(lines)
