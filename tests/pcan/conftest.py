"""Fixtures of the tests with a PEAK adapter that is none."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator

import pytest

from tests.pcan.stand_in import needs_compiler, stand_in


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if "peak" in getattr(item, "fixturenames", ()):
            item.add_marker(needs_compiler)


@pytest.fixture
def peak(monkeypatch: pytest.MonkeyPatch) -> Iterator[ctypes.CDLL]:
    """PCAN-Basic with eight free channels."""
    library = stand_in(monkeypatch)
    monkeypatch.setattr("canopen_transports.python_can.REOPEN_PAUSE", 0.1)
    yield library
    library.stand_in_clear()
