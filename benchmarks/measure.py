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
import traceback
from collections.abc import Callable
from dataclasses import dataclass

Repeat = Callable[[int], object]
"""Does the thing that many times."""

FAILED = "failed: "
"""With this a cell begins whose case could not be measured."""


@dataclass
class Case:
    """title: what is done once. ours, theirs: do it n times. check: raises unless both come to the same result."""

    title: str
    ours: Repeat
    theirs: Repeat
    check: Callable[[], None]


@dataclass
class Result:
    """ns of CPU time for doing it once, round by round. failure: why there are none, if the case failed."""

    title: str
    ours: list[float]
    theirs: list[float]
    failure: str = ""

    def _succeed(self) -> None:
        if self.failure:
            raise RuntimeError(f"{self.title}: {self.failure}")

    @property
    def ratio(self) -> float:
        """How many times faster ours is, median against median."""
        self._succeed()
        return statistics.median(self.theirs) / statistics.median(self.ours)

    @property
    def least_ratio(self) -> float:
        """The same, least against least."""
        self._succeed()
        return min(self.theirs) / min(self.ours)


def measure(case: Case, rounds: int, seconds: float) -> Result:
    """Measure a case: `rounds` times each side, each about `seconds` of CPU time long. A case that fails is told in its row."""
    try:
        return _measure(case, rounds, seconds)
    except Exception as error:  # noqa: BLE001 - the other cases go on
        return Result(case.title, [], [], said(error))


def said(error: Exception) -> str:
    """Return an exception as a cell of a table: its kind, and the first line of its text. Its traceback goes to stderr."""
    traceback.print_exception(error)
    return f"{FAILED}{type(error).__name__}: {str(error).partition(chr(10))[0]}".replace("|", "/")


def _measure(case: Case, rounds: int, seconds: float) -> Result:
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
        if result.failure:
            lines.append(f"| {result.title} | {result.failure} | | | |")
            continue
        ours, theirs = (f"{_us(statistics.median(side))} ({_us(min(side))})" for side in (result.ours, result.theirs))
        lines.append(f"| {result.title} | {ours} | {theirs} | **{result.ratio:.1f}** | {result.least_ratio:.1f} |")
    return "\n".join(lines)


def _us(nanoseconds: float) -> str:
    microseconds = nanoseconds / 1000
    return f"{microseconds:.0f}" if microseconds >= 1000 else f"{microseconds:.2f}"
