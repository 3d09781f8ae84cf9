"""Trajectories against bare ruckig: the time of a plan and of a re-plan, and what a cycle costs, for 6, 12 and 30 joints.

    python benchmarks/trajectory.py               # all cases, about a minute
    python benchmarks/trajectory.py cycle         # the cases with "cycle" in their title

The peer is ruckig as its own examples use it, from Python and in the same process; measure.py says how. Ours does more with it:

- A plan: ours checks its arguments, and returns the exact polynomials with their position limits checked. ruckig's trajectory is
  calculated, and left where it is.
- A cycle of a path: ours is `PathClock.advance`, which scales speed and acceleration by the clock's rate and can stop at any
  time; ruckig's `at_time` evaluates its trajectory in C++.
- A cycle of a stream: a new target for each joint in each cycle, so both calculate anew. Ours keeps the position limits too.

No bus and no tasks: chain_cycle.py has the rest of a cycle. The second table has the costs as shares of cycles of 1, 4 and 10 ms.
"""

from __future__ import annotations

import argparse
import math
import platform
import statistics
from typing import Any

import ruckig
from measure import Case, Result, measure, table

from canopen_master.trajectories.point_to_point import point_to_point
from canopen_master.trajectories.target_stream import TargetStream
from canopen_proto.drives.trajectory import JointLimits, Path, PathClock, PathPoint

COUNTS = (6, 12, 30)
LIMITS = JointLimits(-90.0, 90.0, 100.0, 400.0, 4000.0)
LONG = JointLimits(speed=100.0, acceleration=400.0, jerk=4000.0)
CYCLE = 0.004
CYCLES_MS = (1, 4, 10)
TARGETS = 500
"""Different targets of a stream, made beforehand."""


def request_of(start: PathPoint, targets: list[float]) -> Any:
    """Return the input of bare ruckig."""
    count = len(targets)
    request = ruckig.InputParameter(count)
    request.current_position, request.current_velocity, request.current_acceleration = start
    request.target_position = targets
    request.max_velocity = [100.0] * count
    request.max_acceleration = [400.0] * count
    request.max_jerk = [4000.0] * count
    return request


def calculated(start: PathPoint, targets: list[float]) -> Any:
    """Return the trajectory of bare ruckig."""
    trajectory = ruckig.Trajectory(len(targets))
    ruckig.Ruckig(len(targets)).calculate(request_of(start, targets), trajectory)
    return trajectory


def same(ours: list[float], theirs: list[float], tolerance: float = 1e-6) -> None:
    """Raise unless both are the same positions."""
    assert all(math.isclose(one, other, abs_tol=tolerance) for one, other in zip(ours, theirs, strict=True)), (ours, theirs)


def at_rest(count: int) -> PathPoint:
    """Return the start of all cases: each joint somewhere else."""
    return PathPoint([-60.0 + joint for joint in range(count)], [0.0] * count, [0.0] * count)


def planning(title: str, start: PathPoint, targets: list[float]) -> Case:
    """Return the case of one plan."""
    limits = [LIMITS] * len(targets)

    def ours(times: int) -> None:
        for _ in range(times):
            point_to_point(start, targets, limits, margin=0.0)

    def theirs(times: int) -> None:
        for _ in range(times):
            calculated(start, targets)

    def check() -> None:
        path, trajectory = point_to_point(start, targets, limits, margin=0.0), calculated(start, targets)
        for part in range(11):
            same(path.at(part / 10.0 * path.duration).positions, trajectory.at_time(part / 10.0 * trajectory.duration)[0])

    return Case(title, ours, theirs, check)


def path_cycle(count: int) -> Case:
    """Return the case of one cycle of a path of 20 s. At its end both begin again, ours with another clock."""
    start, targets = at_rest(count), [2000.0 + joint for joint in range(count)]
    path: Path = point_to_point(start, targets, [LONG] * count, margin=0.0)
    trajectory = calculated(start, targets)
    roomy = [JointLimits(speed=100.0, acceleration=800.0, jerk=8000.0)] * count  # the plan leaves nothing free of its own
    cycles = int(path.duration / CYCLE)

    def ours(times: int) -> None:
        for first in range(0, times, cycles):
            clock = PathClock(path, roomy, CYCLE)
            for _ in range(min(cycles, times - first)):
                clock.advance(CYCLE)

    def theirs(times: int) -> None:
        for first in range(0, times, cycles):
            for number in range(min(cycles, times - first)):
                trajectory.at_time((number + 1) * CYCLE)

    def check() -> None:
        clock = PathClock(path, roomy, CYCLE)
        for number in range(cycles):
            same(clock.advance(CYCLE).positions, trajectory.at_time((number + 1) * CYCLE)[0])

    return Case(f"cycle of a path, {count} joints", ours, theirs, check)


def stream_cycle(count: int) -> Case:
    """Return the case of one cycle of a stream that gets a new target each time."""
    start, limits = at_rest(count), [LIMITS] * count
    feed = [
        [(40.0 + joint) * math.sin(math.tau * (number / TARGETS + joint / count)) for joint in range(count)]
        for number in range(TARGETS)
    ]

    def ours(times: int) -> list[float]:
        stream = TargetStream(start, limits, CYCLE)
        for number in range(times):
            stream.aim_at(feed[number % TARGETS])
            stream.step()
        return stream.point.positions

    def theirs(times: int) -> list[float]:
        generator = ruckig.Ruckig(count, CYCLE)
        request, output = request_of(start, start.positions), ruckig.OutputParameter(count)
        request.synchronization = ruckig.Synchronization.No
        for number in range(times):
            request.target_position = feed[number % TARGETS]
            generator.update(request, output)
            output.pass_to_input(request)
        return list(output.new_position)

    def check() -> None:
        same(ours(2 * TARGETS), theirs(2 * TARGETS), 0.2)  # a thousand plans, each from where the one before was left

    return Case(f"cycle of a stream, {count} joints", ours, theirs, check)


def cases() -> list[Case]:
    """Return all cases."""
    found = []
    for count in COUNTS:
        start, targets = at_rest(count), [60.0 - 2.0 * joint for joint in range(count)]
        others = [50.0 - joint for joint in range(count)]
        found.append(planning(f"plan, {count} joints", start, targets))
        way = point_to_point(start, targets, [LIMITS] * count, margin=0.0)
        found.append(planning(f"re-plan on the way, {count} joints", way.at(way.duration * 0.4), others))
    return [*found, *map(path_cycle, COUNTS), *map(stream_cycle, COUNTS)]


def shares(results: list[Result]) -> str:
    """Return what the cycles cost of their time, as a Markdown table."""
    lines = [
        "| share of a core | " + " | ".join(f"{each} ms" for each in CYCLES_MS) + " |",
        "|---" + "|---:" * len(CYCLES_MS) + "|",
    ]
    for result in results:
        if result.title.startswith("cycle"):
            cost = statistics.median(result.ours) / 1e6
            lines.append(f"| {result.title} | " + " | ".join(f"{cost / each:.2%}" for each in CYCLES_MS) + " |")
    return "\n".join(lines)


def main() -> None:
    """Read the arguments, measure, print."""
    parser = argparse.ArgumentParser(description="measure plans, paths and streams beside bare ruckig")
    parser.add_argument("words", nargs="*", help="only the cases with one of these words in their title")
    parser.add_argument("--rounds", type=int, default=9, help="rounds per case and side (default: 9)")
    parser.add_argument("--seconds", type=float, default=0.2, help="CPU time of a round (default: 0.2)")
    arguments = parser.parse_args()
    chosen = [each for each in cases() if not arguments.words or any(word.lower() in each.title for word in arguments.words)]
    if not chosen:
        parser.error("no case has one of these words in its title")
    results = [measure(case, arguments.rounds, arguments.seconds) for case in chosen]
    print(f"{platform.python_implementation()} {platform.python_version()}, {platform.machine()}; ruckig {ruckig.__version__}")
    print("", table(results, f"ruckig {ruckig.__version__}"), "", shares(results), sep="\n")


if __name__ == "__main__":
    main()
