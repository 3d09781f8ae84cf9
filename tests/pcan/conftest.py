"""Fixtures of the tests with a PEAK adapter that is none."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator

import pytest

from tests.pcan.stand_in import stand_in


@pytest.fixture
def peak(monkeypatch: pytest.MonkeyPatch) -> Iterator[ctypes.CDLL]:
    """PCAN-Basic with eight free channels."""
    library = stand_in(monkeypatch)
    monkeypatch.setattr("canopen_transports.python_can.REOPEN_PAUSE", 0.1)
    yield library
    library.stand_in_clear()
