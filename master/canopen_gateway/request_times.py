"""`RequestTimes`: how long the requests of a gateway's clients to nodes took, as a histogram for each net."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final

import trio

BOUNDS: Final = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Seconds: an SDO answer takes 1 to 20 ms; the usual time-out is 0.5 s."""


@dataclass
class TimesOfNet:
    """The requests on one net. counts: of those that took no longer than each of BOUNDS, and longer than the bound before; the
    last one of those that took longer than all. total: seconds of all. failed: those that ended with an error."""

    counts: list[int] = field(default_factory=lambda: [0] * (len(BOUNDS) + 1))
    total: float = 0.0
    failed: int = 0


class RequestTimes:
    """See this module's text. nets: by their names; a net is there once it was asked something."""

    def __init__(self) -> None:
        self.nets: dict[str, TimesOfNet] = {}

    @contextmanager
    def measured(self, net: str) -> Iterator[None]:
        """Measure the block: one request."""
        times = self.nets.setdefault(net, TimesOfNet())
        began = trio.current_time()
        try:
            yield
        except Exception:
            times.failed += 1
            raise
        finally:
            took = trio.current_time() - began
            times.counts[bisect_left(BOUNDS, took)] += 1
            times.total += took
