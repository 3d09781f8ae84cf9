"""All cases of the kit."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from canopen_proto.verdict import Verdict
from canopen_transports.conformance import (
    cancelling_cases,
    carrying_cases,
    closing_cases,
    flooding_cases,
    opening_cases,
    optional_cases,
)
from canopen_transports.conformance.bench import Site
from canopen_transports.conformance.case import TransportCase

CHAPTERS: Final = (opening_cases, carrying_cases, flooding_cases, cancelling_cases, closing_cases, optional_cases)
CASES: Final = tuple(each for chapter in CHAPTERS for each in vars(chapter).values() if isinstance(each, TransportCase))
"""All cases: each chapter's in the order in which they are written."""


def run_all(site: Site, on: str = "trio") -> Iterator[tuple[TransportCase, Verdict]]:
    """Run the cases one after the other, each when it is asked for. Call it where no loop runs: each case starts its own. on:
    "trio", or "asyncio"."""
    for each in CASES:
        yield each, each.verdict(site, on)
