"""ASCII in place of characters that a stream or a terminal cannot show: -> for an arrow, deg for a degree sign.

A stream whose encoding lacks a character (`LANG=de_DE.ISO-8859-1`) would show a question mark. And a terminal whose user says
LANG=C or POSIX gets ASCII alone, though Python itself would write UTF-8 there (PEP 538, PEP 540). A pipe gets UTF-8 then: who
reads it has not said what it can show.
"""

from __future__ import annotations

import codecs
import os
import unicodedata
from collections.abc import Mapping
from typing import IO, Final

NAME: Final = "canopen.marks"
"""Of the error handler, as `errors` of a stream takes it."""

_MARKS: Final = {
    "→": "->", "←": "<-", "─": "-", "━": "-", "│": "|", "…": "...", "°": "deg", "µ": "u", "·": ".", "²": "2", "³": "3", "±": "+-",
    "✔": "ok", "✘": "x", "●": "*", "’": "'", "“": '"', "”": '"', "–": "-", "—": "-", "\N{NO-BREAK SPACE}": " ",
}  # fmt: skip
_CELLS: Final = {"→": ">", "…": "~", "°": "o", "±": "~", "✔": "+"}
_LINES: Final = range(0x2500, 0x2580)
_BLOCKS: Final = range(0x2580, 0x25A0)
_BRAILLE: Final = range(0x2800, 0x2900)
_NOTHING: Final = 0x2800
_LOCALES: Final = ("C", "POSIX")


def ascii_of(character: str) -> str:
    """Return what stands for a character; a question mark for one that has no mark."""
    if ord(character) in _BRAILLE:  # the dots of a curve
        return " " if ord(character) == _NOTHING else "*"
    return _MARKS.get(character, "?")


def cells_of(text: str) -> str:
    """Return a text in ASCII that fills as many cells of a terminal: for a picture whose parts stand beside each other."""
    return text if text.isascii() else "".join(each if each.isascii() else _cell_of(each) for each in text)


def _cell_of(character: str) -> str:
    number = ord(character)
    if number in _LINES:
        name = unicodedata.name(character)
        sides = ("HORIZONTAL" in name or "LEFT" in name or "RIGHT" in name, "VERTICAL" in name or "UP" in name or "DOWN" in name)
        return {(True, False): "-", (False, True): "|"}.get(sides, "+")
    if number in _BLOCKS:
        return "#"
    if unicodedata.combining(character):
        return ""
    mark = _CELLS.get(character) or ascii_of(character)
    return mark[0] * (2 if unicodedata.east_asian_width(character) in ("W", "F") else 1)


def _handler(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(ascii_of, error.object[error.start : error.end])), error.end


codecs.register_error(NAME, _handler)


def wants_ascii(environment: Mapping[str, str]) -> bool:
    """Return whether a user has said that terminals show ASCII alone. A locale that was not named says nothing."""
    named = environment.get("LC_ALL") or environment.get("LC_CTYPE", "")
    if named in ("", "C.UTF-8"):  # as Python itself sets it where LANG is C (PEP 538)
        named = environment.get("LANG", "")
    return named in _LOCALES


def put_marks(stream: IO[str]) -> None:
    """Have a stream write marks where it cannot write a character: a pipe with another encoding must not end a command."""
    if not hasattr(stream, "reconfigure"):
        return
    if stream.isatty() and wants_ascii(os.environ):
        stream.reconfigure(encoding="ascii", errors=NAME)
    else:
        stream.reconfigure(errors=NAME)
