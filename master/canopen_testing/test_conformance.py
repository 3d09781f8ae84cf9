"""All conformance cases for one device: `pytest --pyargs canopen_testing.test_conformance --canopen-device 5 ...`."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_testing.conformance_fixture import RunCase


def test_conformance(canopen_check: RunCase) -> None:
    """Run one case."""
    canopen_check()
