"""The catalogue of planted bugs."""

from __future__ import annotations

from typing import NamedTuple


class Mutant(NamedTuple):
    """old becomes new in a file; why it is a bug; the tests that should find it. in_corpus: the corpus should too.

    file: as seen from `canopen_proto`, or, with the name of another package first, of that one: "canopen_data/eds/numbers.py".
    """

    name: str
    file: str
    old: str
    new: str
    why: str
    tests: tuple[str, ...]
    in_corpus: bool = True
