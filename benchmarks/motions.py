"""Motions of chains: the share of a core that a cycle takes, and how long a re-plan and a stop take, for 6, 12 and 30 joints.

    python benchmarks/motions.py          # two minutes or so; run.py has the same tables

**Cycles.** The CPU time is that of the master's process alone: a SYNC goes out, the TPDOs of all joints come in and are decoded,
each joint is judged (state, mode, following error), the path and its clock give the next point, it is checked against the limits,
and the RPDOs go out. chain_cycle.py says how the simulated drives are kept out of it: a recording of their last frames answers in
their place. The path is a spline with a hundred segments a second, which the joints follow by so little that drives that stand
still are within their following error. "recorded": the chain's recording runs along, as CSV. On a real bus 30 joints at 1 ms do
not fit on 1 Mbit/s: these figures are about the calculation.

**Once.** A re-plan is all that `Chain.move` does in the turn of one cycle to take over from a motion: the plan from the present
state of motion (ruckig), its check, and what it leaves free for stops. A stop is `PathClock.stop`, over all moments of a plan.
Both hold up the cycle that they come in.
"""

from __future__ import annotations

import argparse
import random
import statistics
import time
from collections.abc import Callable
from functools import partial

import chain_cycle
from measure import said

from canopen_master.trajectories.point_to_point import point_to_point
from canopen_proto.drives.trajectory import JointLimits, PathClock, PathPoint

COUNTS = (6, 12, 30)
CYCLES_MS = (1, 4, 10)
CYCLES = 1000
"""Of one measurement."""
LIMITS = JointLimits(-180.0, 180.0, 90.0, 180.0, 1800.0)
PERIOD = 0.004
STOPS = 60
"""Moments of a plan at which a stop is measured."""


def share(joints: int, milliseconds: int, rounds: int, *, is_recorded: bool = False) -> str:
    """Return the share of a core that a cycle of a path takes, the least of some rounds; or why it could not be measured."""
    period = milliseconds / 1000
    task = chain_cycle.Task.RECORDED_PATH if is_recorded else chain_cycle.Task.PATH
    try:
        least = min(chain_cycle.cycle(joints, period, CYCLES, task=task) for _ in range(rounds))
    except Exception as error:  # noqa: BLE001 - the other rows go on
        return said(error)
    return f"{least / period / 1e7:.1f} %"


def random_point(rng: random.Random, joints: int) -> list[float]:
    """Return positions."""
    return [rng.uniform(-150.0, 150.0) for _ in range(joints)]


def taken(work: Callable[[], object]) -> float:
    """Return the CPU time that something takes, in ms."""
    begin = time.process_time_ns()
    work()
    return (time.process_time_ns() - begin) / 1e6


def replan(present: PathPoint, targets: list[float], limits: list[JointLimits]) -> None:
    """Take over from a motion."""
    PathClock(point_to_point(present, targets, limits), limits, PERIOD, moving=True)


def once(joints: int, rounds: int) -> tuple[str, str, str]:
    """Return the median time of a re-plan, the median of stops, and the longest of them, in ms."""
    rng = random.Random(joints)
    limits = [LIMITS] * joints
    rest = [0.0] * joints
    replans, stops = [], [[] for _ in range(STOPS)]
    path = point_to_point(PathPoint(random_point(rng, joints), rest, rest), random_point(rng, joints), limits)
    for _ in range(rounds):
        for number in range(STOPS):
            clock = PathClock(path, limits, PERIOD)
            clock.advance(path.duration * (number + 0.5) / STOPS)
            stops[number].append(taken(clock.stop))
        for _ in range(5):
            present, targets = path.at(path.duration * rng.uniform(0.1, 0.7)), random_point(rng, joints)
            replans.append(taken(partial(replan, present, targets, limits)))
    least = [min(each) for each in stops]
    return f"{statistics.median(replans):.2g}", f"{statistics.median(least):.2g}", f"{max(least):.2g}"


def _once(joints: int, rounds: int) -> tuple[str, str, str]:
    try:
        return once(joints, rounds)
    except Exception as error:  # noqa: BLE001 - the other rows go on
        return (said(error),) * 3


def tables(rounds: int) -> str:
    """Return both tables as Markdown."""
    lines = ["| the master's process alone, share of a core | " + " | ".join(f"{each} ms" for each in CYCLES_MS) + " |"]
    lines.append("|---" + "|---:" * len(CYCLES_MS) + "|")
    for joints in COUNTS:
        for title, is_recorded in (("along a path", False), ("along a path, recorded", True)):
            cells = [share(joints, each, rounds, is_recorded=is_recorded) for each in CYCLES_MS]
            lines.append(f"| {joints} joints {title} | {' | '.join(cells)} |")
    lines += [
        "",
        "| once, in ms | " + " | ".join(f"{each} joints" for each in COUNTS) + " |",
        "|---" + "|---:" * len(COUNTS) + "|",
    ]
    columns = [_once(joints, rounds) for joints in COUNTS]
    for title, row in zip(
        ("a re-plan while the joints move", "a stop on the path, median", "a stop on the path, the longest"),
        zip(*columns, strict=True),
        strict=True,
    ):
        lines.append(f"| {title} | {' | '.join(row)} |")
    return "\n".join(lines)


def main() -> None:
    """Read the arguments, measure, print."""
    parser = argparse.ArgumentParser(description="what motions of a chain cost the master")
    parser.add_argument("--rounds", type=int, default=3, help="rounds per case (default: 3)")
    print(tables(parser.parse_args().rounds))


if __name__ == "__main__":
    main()
