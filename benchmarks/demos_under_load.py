"""Run `canopen demo` and the manual's demos beside busy loops, and count how they end: none fails.

    python benchmarks/demos_under_load.py --runs 100 --beside 4
    python benchmarks/demos_under_load.py --runs 10 --beside 3 --loops 4 multiple_devices demo

Each run must end with exit status 0, however slow the computer is. The table at the end counts those that did not, by demo.
A run that failed is a line of JSON in the file of --failures: the demo, how it ended, its seconds, all of its output and stderr.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Final

ARM: Final = ("3", "4", "5", "6", "7", "8")
COMMANDS: Final[dict[str, tuple[str, ...]]] = {
    "demo": ("-c", "from canopen_cli.entry import main; raise SystemExit(main())", "demo"),
    "homing": ("-m", "canopen_cli.demos.homing", "12"),
    "single_device": ("-m", "canopen_cli.demos.single_device", "12"),
    "multiple_devices": ("-m", "canopen_cli.demos.multiple_devices", *ARM),
    "canopenmaster_single_device": (
        "-m",
        "canopen_cli.demos.canopenmaster_single_device",
    ),
    "canopenmaster_multiple_devices": (
        "-m",
        "canopen_cli.demos.canopenmaster_multiple_devices",
    ),
    "move_device": ("-m", "canopen_cli.demos.move_device", "12"),
    "getpos": ("-m", "canopen_cli.demos.getpos", *ARM),
    "memtest": ("-m", "canopen_cli.demos.memtest", "12"),
}
"""The arguments of Python, without the bus. The demos that need a held key are tested in tests/cli."""
LONGEST: Final = 3600
"""Seconds for one run. The simulated world stands still while its process does, so a run may take many times as long as alone."""


def spin() -> None:
    while True:
        pass


@contextmanager
def busy(loops: int) -> Iterator[None]:
    """Keep so many processes busy."""
    processes = [multiprocessing.Process(target=spin, daemon=True) for _ in range(loops)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.kill()


@dataclass(frozen=True)
class Run:
    """How a run of a demo ended. problem: "" if it ended well."""

    name: str
    problem: str
    seconds: float
    stdout: str
    stderr: str


def once(name: str) -> Run:
    """Run one demo."""
    bus = () if name == "demo" else ("--bus", "virtual")
    began = time.monotonic()
    with subprocess.Popen(
        (sys.executable, *COMMANDS[name], *bus), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace"
    ) as process:
        try:
            stdout, stderr = process.communicate(timeout=LONGEST)
            problem = f"exit status {process.returncode}" if process.returncode else ""
        except subprocess.TimeoutExpired:
            process.kill()
            stdout, stderr = process.communicate()
            problem = f"not over after {LONGEST} s"
    return Run(name, problem, time.monotonic() - began, stdout, stderr)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="DEMO", help=f"of {', '.join(COMMANDS)}; by default all")
    parser.add_argument("--runs", type=int, default=10, help="of each demo (default: 10)")
    parser.add_argument("--loops", type=int, default=4, help="busy processes (default: 4)")
    parser.add_argument("--beside", type=int, default=1, help="demos that run at the same time (default: 1)")
    parser.add_argument("--failures", type=Path, default=Path("demos_under_load.jsonl"), help="(default: %(default)s)")
    arguments = parser.parse_args()
    names = list(dict.fromkeys(arguments.names or COMMANDS))
    if unknown := [name for name in names if name not in COMMANDS]:
        parser.error(f"there is no demo {unknown[0]!r}")
    failed: Counter[str] = Counter()
    seconds: dict[str, list[float]] = {name: [] for name in names}
    arguments.failures.write_text("")
    with busy(arguments.loops), ThreadPoolExecutor(arguments.beside) as pool:
        for run in pool.map(once, names * arguments.runs):
            seconds[run.name].append(run.seconds)
            if run.problem:
                failed[run.name] += 1
                with arguments.failures.open("a") as file:
                    file.write(json.dumps(asdict(run)) + "\n")
            print(f"{run.name}, {run.seconds:.0f} s: {run.problem or 'well'}", flush=True)
    print(f"{'':32}{'runs':>6}{'failed':>8}{'median s':>10}{'longest s':>11}")
    for name, taken in seconds.items():
        print(f"{name:32}{len(taken):6}{failed[name]:8}{median(taken):10.1f}{max(taken):11.1f}")
    if failed:
        print(f"{failed.total()} runs failed: what each has said is in {arguments.failures}")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
