"""What tests of a history share: a clock that they set, and what a history answers. It is imported without the extra history."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from canopen_gateway.history.query import open_history

BEGIN = 1_800_000_000_123_456_789
SECOND = 10**9

needs_history = pytest.mark.skipif(
    not all(find_spec(name) for name in ("pyarrow", "duckdb")), reason="the extra history is not installed"
)
"""Their import takes half a second: it is for the worker alone that runs these tests."""


class Clock:
    """A clock that a test sets: ns since 1970."""

    def __init__(self) -> None:
        self.now = BEGIN

    def __call__(self) -> int:
        return self.now


def asked(folder: Path, sql: str, *values: Any) -> list[tuple[Any, ...]]:
    with open_history(folder) as history:
        return list(history.ask(sql, values).rows)
