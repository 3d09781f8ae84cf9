"""How a case states what it expects."""

from __future__ import annotations


class Violation(AssertionError):
    """A transport breaks a promise."""


class NotApplicable(Exception):
    """A transport lacks the feature that the case is about."""


def expect(condition: bool, otherwise: str) -> None:
    """Raise Violation with this text unless the condition holds."""
    if not condition:
        raise Violation(otherwise)


def expect_numbers(seen: list[int], expected: list[int], what: str) -> None:
    """Raise Violation unless the lists are equal. Its text shows where they differ, and which numbers are missing or surplus."""
    if seen == expected:
        return
    place = next(
        (at for at, pair in enumerate(zip(seen, expected, strict=False)) if pair[0] != pair[1]), min(len(seen), len(expected))
    )
    missing, surplus = sorted(set(expected) - set(seen)), sorted(set(seen) - set(expected))
    twice = len(seen) - len(set(seen))
    raise Violation(
        f"{what}: {len(seen)} frames instead of {len(expected)}; from place {place} on {seen[place : place + 5]} instead of "
        f"{expected[place : place + 5]}; missing {missing[:5]}, surplus {surplus[:5]}, {twice} more than once"
    )
