"""Where a stream or a terminal cannot show a character, there is a mark in ASCII."""

from __future__ import annotations

import io
from typing import Any

import pytest

from canopen_cli.shared.marks import put_marks, wants_ascii
from canopen_cli.shared.screen import _console


class Terminal(io.TextIOWrapper):
    def isatty(self) -> bool:
        return True


def written(stream: io.TextIOWrapper, text: str) -> bytes:
    put_marks(stream)
    stream.write(text)
    stream.flush()
    buffer: Any = stream.buffer
    return bytes(buffer.getvalue())


def test_a_pipe_with_another_encoding_gets_marks() -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="latin-1")
    assert written(stream, "1 → 2 at 5° of ü ⣿⠀設") == "1 -> 2 at 5° of ü * ?".encode("latin-1")


@pytest.mark.parametrize(
    ("environment", "is_ascii"),
    [
        ({}, False),
        ({"LANG": "C"}, True),
        ({"LANG": "C", "LC_CTYPE": "C.UTF-8"}, True),  # PEP 538
        ({"LANG": "C", "LC_CTYPE": "de_DE.UTF-8"}, False),
        ({"LC_ALL": "POSIX", "LANG": "de_DE.UTF-8"}, True),
        ({"LC_ALL": "C.UTF-8"}, False),
        ({"LANG": "de_DE.UTF-8"}, False),
    ],
)
def test_who_says_c_means_it(environment: dict[str, str], is_ascii: bool) -> None:
    assert wants_ascii(environment) is is_ascii


def test_only_a_terminal_is_meant(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LC_ALL", raising=False)
    monkeypatch.delenv("LC_CTYPE", raising=False)
    monkeypatch.setenv("LANG", "C")
    assert written(Terminal(io.BytesIO(), encoding="utf-8"), "1 → ü") == b"1 -> ?"
    assert written(io.TextIOWrapper(io.BytesIO(), encoding="utf-8"), "1 → ü") == "1 → ü".encode()


def test_tables_have_rules_in_ascii_too() -> None:
    from canopen_cli.shared.screen import plain_table

    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    _console(stream, False).print(plain_table(["one", "two"], [["1", "→"]]))
    stream.flush()
    buffer: Any = stream.buffer
    text = buffer.getvalue().decode("ascii")
    assert "->" in text
    assert "?" not in text
