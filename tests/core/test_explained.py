"""How every error speaks: counts in words."""

from __future__ import annotations

import pytest

from canopen_proto.explained import counted


@pytest.mark.parametrize(
    ("number", "what", "text"),
    [
        (0, "frame", "0 frames"),
        (1, "frame", "1 frame"),
        (2, "frame", "2 frames"),
        (1, "entry", "1 entry"),
        (2, "entry", "2 entries"),
        (0, "emergency", "0 emergencies"),
        (2, "key", "2 keys"),
        (1, "bus", "1 bus"),
        (2, "bus", "2 buses"),
    ],
)
def test_a_count_agrees_with_its_noun(number: int, what: str, text: str) -> None:
    assert counted(number, what) == text
