"""Makes foreign strings safe to show: those of a device, a file, a driver, an operating system.

A terminal obeys control characters: a device name with an escape sequence can clear the screen, write a line that looks like
ours, or fill a clipboard. So each foreign string passes `clean` on its way to a terminal or a page: a character that
cannot be printed is shown as its Python escape sequence (`\\x1b`), and a long string is cut. JSON escapes control characters by
itself, and nothing is cut there; `json_text` escapes those that JSON lets pass.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any, Final

MAX_SHOWN: Final = 2000
"""Characters of one string that are shown. A whole screen has about as many."""

_UNPRINTABLE: Final = re.compile(r"[\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Characters that JSON need not escape, but that a terminal may obey."""


def clean(text: str, limit: int = MAX_SHOWN) -> str:
    """Return the text in one line, with control characters escaped, cut after `limit` characters."""
    cut = "" if len(text) <= limit else f" ... ({len(text)} characters)"
    text = text[:limit]
    return (text if text.isprintable() else "".join(map(_shown, text))) + cut


def clean_lines(text: str) -> str:
    """Return a text of several lines with control characters escaped. It is not cut."""
    return "\n".join(clean(line, len(line)) for line in text.split("\n"))


def json_text(value: Any, indent: int | None = None) -> str:
    """Return a JSON document that is safe to show. NaN, infinities and values unknown to JSON become text. indent: spaces for
    each level; None: one line."""
    text = json.dumps(_finite(value), indent=indent, ensure_ascii=False, allow_nan=False, default=str)
    return _UNPRINTABLE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def _finite(value: Any) -> Any:
    """Return the document with NaN and infinities as text."""
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    return [_finite(each) for each in value] if isinstance(value, list | tuple) else value


def _shown(character: str) -> str:
    if character.isprintable():
        return character
    if character in "\u00a0\u2007\u202f\u3000":
        return " "  # blanks of other widths
    return character.encode("unicode_escape").decode("ascii")
