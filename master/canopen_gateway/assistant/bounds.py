"""What an assistant is given: bounded, and with the words of devices marked as such.

An assistant reads text, and a device may have any text in its name: also one that looks like an instruction. So such a string
stands in an object of its own, {"text_from_device": "..."}; the server's instructions say that it is data.
"""

from __future__ import annotations

from typing import Any, Final

from canopen_gateway.plain_data import Plain
from canopen_master.plain_text import clean, json_text

MAX_OUTPUT: Final = 20_000
"""Characters of an answer."""
MAX_TEXT: Final = 500
"""Characters of a string of a device."""


def from_device(text: str) -> Plain:
    """Return a string of a device, marked, in one line, and cut."""
    return {"text_from_device": clean(text, MAX_TEXT)}


def bounded(data: Plain | list[Any]) -> str:
    """Return an answer as JSON. A list that is too long is cut, and "left_off" says how many are missing; any other answer that
    is too long is replaced by its beginning."""
    text = json_text(data)
    if len(text) <= MAX_OUTPUT:
        return text
    if isinstance(data, list):
        rows: list[Any] = []
        size = 100
        for row in data:
            size += len(json_text(row)) + 2
            if size > MAX_OUTPUT:
                break
            rows.append(row)
        if rows:
            return json_text({"rows": rows, "left_off": len(data) - len(rows), "advice": "ask for less: a search, one node"})
    return json_text({"beginning": text[: MAX_OUTPUT // 3], "left_off_characters": len(text) - MAX_OUTPUT // 3})
