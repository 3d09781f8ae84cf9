"""How a case says what it expects, and what ends it when that is not so."""

from __future__ import annotations


class Violation(AssertionError):
    """A transport does not keep a promise."""


class NotApplicable(Exception):
    """A transport does not have what the case is about."""


def expect(condition: bool, otherwise: str) -> None:
    """Go on if the condition holds, else Violation with that text."""
    if not condition:
        raise Violation(otherwise)


def expect_numbers(seen: list[int], expected: list[int], what: str) -> None:
    """Go on if the lists are equal, else Violation that shows where they part, and what is missing or too much."""
    if seen == expected:
        return
    place = next(
        (at for at, pair in enumerate(zip(seen, expected, strict=False)) if pair[0] != pair[1]), min(len(seen), len(expected))
    )
    missing, surplus = sorted(set(expected) - set(seen)), sorted(set(seen) - set(expected))
    twice = len(seen) - len(set(seen))
    raise Violation(
        f"{what}: {len(seen)} frames instead of {len(expected)}; from place {place} on {seen[place : place + 5]} instead of "
        f"{expected[place : place + 5]}; missing {missing[:5]}, too much {surplus[:5]}, {twice} more than once"
    )
