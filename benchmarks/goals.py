"""The figures that users feel, in one table: the figure now, the least that is asked for, and the figure that we want.

A ratio says how many times less CPU time ours takes than `canopen` does for the same; of several cases the worst counts. Shares,
costs and milliseconds are smaller where they are better.
"""

from __future__ import annotations

import math
import operator
import statistics
from collections.abc import Callable, Mapping
from typing import NamedTuple

import chain_cycle
import imports
import master_edge
import observer
from measure import Result, said

import canopen_proto

COMPILED: bool = getattr(canopen_proto, "COMPILED", False)

Results = Mapping[str, Result]
"""The measured results, by the titles of their cases."""


class Goal(NamedTuple):
    """pure, compiled: the least of each build. unit: "" for a ratio to canopen, where more is better."""

    work: str
    now: Callable[[Results], float]
    pure: float
    compiled: float
    wanted: float
    unit: str = ""

    def row(self, results: Results) -> str:
        """Its line of the table. A case that failed says so there; the other cases go on."""
        least = self.compiled if COMPILED else self.pure
        try:
            now = self.now(results)
        except Exception as error:  # noqa: BLE001 - the other rows go on
            return f"| {self.work} | {said(error)} | {self._text(least)} | {self._text(self.wanted)} |"
        better = operator.le if self.unit else operator.ge
        mark = "" if better(now, least) else " (missed)"
        cells = (self._text(now) + mark, self._text(least), self._text(self.wanted))
        return f"| {self.work} | {' | '.join(cells)} |"

    def _text(self, value: float) -> str:
        digits = max(0, 1 - math.floor(math.log10(value))) if value > 0 else 0
        return f"{value:.{min(digits, 2)}f}{self.unit}"


def worst(*titles: str) -> Callable[[Results], float]:
    """The least ratio of these cases: medians against medians."""
    return lambda results: min(results[title].ratio for title in titles)


def among_many(results: Results) -> float:
    """Return the cost of a frame among 127 nodes, as a multiple of its cost among 6."""
    few, many = (results[f"a frame among {nodes} nodes (RemoteNode)"] for nodes in (6, 127))
    return min(many.ours) / min(few.ours)


def full_bus(results: Results) -> float:
    """Percent of a core."""
    return observer.share(statistics.median(results[observer.VIEWED].ours))


def of_cycles(joints: int, milliseconds: int) -> Callable[[Results], float]:
    """Percent of a core: the least of three rounds."""
    return lambda _: min(chain_cycle.cycle(joints, milliseconds / 1000) for _ in range(3)) / milliseconds / 1e4


def starting(program: str) -> Callable[[Results], float]:
    """ms over bare Python."""
    return lambda _: imports.over_bare(program)


GOALS = (
    Goal(
        "read by name, decoded, RemoteNode",
        worst("read by name, object (RemoteNode)", "read by name, field of a record (RemoteNode)"),
        1.5, 3, 5,
    ),
    Goal("expedited upload, Networks", worst("SDO expedited upload (Networks)"), 1.8, 4, 5),
    Goal(
        "segmented 64 KiB, RemoteNode, both ways",
        worst("SDO upload of 64 KiB (RemoteNode)", "SDO download of 64 KiB (RemoteNode)"),
        3.5, 7, 10,
    ),
    Goal(
        "block 1 MiB, Networks, both ways",
        worst("SDO block upload of 1 MiB (Networks)", "SDO block download of 1 MiB (Networks)"),
        3.5, 6, 10,
    ),
    Goal("PDO in, four values, RemoteNode", worst("PDO decode, 4 objects (RemoteNode)"), 4.2, 8, 10),
    Goal("heartbeat, RemoteNode, one by one", worst("heartbeat, frame to state (RemoteNode, one by one)"), 1.2, 3, 3),
    Goal(
        "heartbeat, RemoteNode, one by one, each told",
        worst("heartbeat, frame to state (RemoteNode, one by one, each told)"),
        1.2, 3, 3,
    ),
    Goal("cost for a frame, 127 nodes / 6 nodes", among_many, 1.1, 1.1, 1.0, " times"),
    Goal("`open_master` read, virtual bus", worst(master_edge.READ), 1.8, 2.2, 3),
    Goal("`open_master` read, virtual bus; ratio to a bare trio ping-pong", worst(master_edge.PING_PONG), 0.5, 0.6, 0.8),
    Goal("frames into a master", worst(master_edge.FRAMES), 1.5, 3, 3),
    Goal("frames into a master with a subscriber", worst(master_edge.SUBSCRIBED), 1.5, 3, 3),
    Goal("frames into a master with a subscriber in batches", worst(master_edge.BATCHED), 1.5, 3, 3),
    Goal("frames into a master with a callback", worst(master_edge.CALLED), 1.5, 3, 3),
    Goal("9,000 frames/s into a master, share of a core", master_edge.share(master_edge.FRAMES), 4.5, 3, 2, " %"),
    Goal("9,000 frames/s into a master with a subscriber", master_edge.share(master_edge.SUBSCRIBED), 4.5, 3, 2, " %"),
    Goal("a full bus of 1 Mbit/s into an Observer and a BusView, share of a core", full_bus, 50, 25, 10, " %"),
    Goal("6 joints at 1 ms, the master's process alone, share of a core", of_cycles(6, 1), 18, 10, 10, " %"),
    Goal("30 joints at 4 ms, the master's process alone, share of a core", of_cycles(30, 4), 15, 8, 8, " %"),
    Goal(f"`{imports.NETWORK}`, over bare Python", starting(imports.NETWORK), 20, 12, 10, " ms"),
    Goal("`canopen --help`, over bare Python", starting(imports.HELP), 70, 70, 50, " ms"),
    Goal("`canopen read` of a simulated node, over bare Python", starting(imports.READ), 250, 250, 200, " ms"),
)  # fmt: skip


def table(results: Results) -> str:
    """All goals as a Markdown table."""
    build = "compiled" if COMPILED else "pure Python"
    head = f"| work (ratio to canopen unless it has a unit) | now, {build} | least | wanted |\n|---|---:|---:|---:|"
    return "\n".join([head, *(goal.row(results) for goal in GOALS)])
