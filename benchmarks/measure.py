"""Two ways of doing one thing, measured side by side in one process.

Rounds are interleaved (ours, theirs, ours, theirs ...; who begins alternates), so that a machine that slows down slows both. The
clock is the process's CPU time: other processes do not count, and neither library sleeps or waits in any case here. The garbage
collector is off inside a round and runs between rounds, as in `timeit`. How often a case is repeated in a round is found by trial
first, which also warms both up. The median over the rounds is the figure; the least is given too.
"""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

Repeat = Callable[[int], object]
"""Does the thing that many times."""


@dataclass
class Case:
    """title: what is done once. ours, theirs: do it n times. check: raises unless both come to the same result."""

    title: str
    ours: Repeat
    theirs: Repeat
    check: Callable[[], None]


@dataclass
class Result:
    """ns of CPU time for doing it once, round by round."""

    title: str
    ours: list[float]
    theirs: list[float]

    @property
    def ratio(self) -> float:
        """How many times faster ours is, median against median."""
        return statistics.median(self.theirs) / statistics.median(self.ours)

    @property
    def least_ratio(self) -> float:
        """The same, least against least."""
        return min(self.theirs) / min(self.ours)


def measure(case: Case, rounds: int, seconds: float) -> Result:
    """Measure a case: `rounds` times each side, each about `seconds` of CPU time long."""
    case.check()
    sides = [(case.ours, calibrate(case.ours, seconds)), (case.theirs, calibrate(case.theirs, seconds))]
    result = Result(case.title, [], [])
    for number in range(rounds):
        for side in (0, 1) if number % 2 == 0 else (1, 0):
            repeat, count = sides[side]
            (result.ours, result.theirs)[side].append(cpu_time(repeat, count) / count)
    return result


def calibrate(repeat: Repeat, seconds: float) -> int:
    """How often a thing is done in about so many seconds of CPU time."""
    count = 1
    while True:
        taken = cpu_time(repeat, count) / 1e9
        if taken >= seconds / 4:
            return max(1, round(count * seconds / taken))
        count *= 4


def cpu_time(repeat: Repeat, count: int) -> int:
    """ns of CPU time for doing it that many times."""
    gc.collect()
    gc.disable()
    try:
        begin = time.process_time_ns()
        repeat(count)
        return time.process_time_ns() - begin
    finally:
        gc.enable()


def table(results: list[Result], peer: str) -> str:
    """The results as a Markdown table: median (least) in microseconds, and how many times faster ours is."""
    lines = [
        f"| once | canopen-proto, us | {peer}, us | ratio of medians | ratio of leasts |",
        "|---|---:|---:|---:|---:|",
    ]
    for result in results:
        ours, theirs = (f"{_us(statistics.median(side))} ({_us(min(side))})" for side in (result.ours, result.theirs))
        lines.append(f"| {result.title} | {ours} | {theirs} | **{result.ratio:.1f}** | {result.least_ratio:.1f} |")
    return "\n".join(lines)


def _us(nanoseconds: float) -> str:
    microseconds = nanoseconds / 1000
    return f"{microseconds:.0f}" if microseconds >= 1000 else f"{microseconds:.2f}"
