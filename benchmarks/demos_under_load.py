"""Run `canopen demo` and the manual's demos beside busy loops, and count how they end: none fails.

    python benchmarks/demos_under_load.py --runs 100
    python benchmarks/demos_under_load.py --runs 10 --beside 3 --loops 4 multiple_devices demo

Each run must end with exit status 0, however slow the computer is. The last line of the table counts those that did not.
"""

from __future__ import annotations

import argparse
import multiprocessing
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
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
LONGEST: Final = 900
"""Seconds for one run."""


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


def once(name: str) -> tuple[str, str, float]:
    """Run one demo. Return its name, how it ended ("" for well), and its seconds."""
    bus = () if name == "demo" else ("--bus", "virtual")
    began = time.monotonic()
    try:
        done = subprocess.run((sys.executable, *COMMANDS[name], *bus), capture_output=True, text=True, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return name, f"not over after {LONGEST} s", time.monotonic() - began
    said = " | ".join(line.strip() for line in done.stderr.splitlines()[-8:]) or done.stdout[-200:]
    return name, f"exit status {done.returncode}: {said}" if done.returncode else "", time.monotonic() - began


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="DEMO", help=f"of {', '.join(COMMANDS)}; by default all")
    parser.add_argument("--runs", type=int, default=10, help="of each demo (default: 10)")
    parser.add_argument("--loops", type=int, default=4, help="busy processes (default: 4)")
    parser.add_argument("--beside", type=int, default=1, help="demos that run at the same time (default: 1)")
    arguments = parser.parse_args()
    names = arguments.names or list(COMMANDS)
    if unknown := [name for name in names if name not in COMMANDS]:
        parser.error(f"there is no demo {unknown[0]!r}")
    failed: Counter[str] = Counter()
    longest: Counter[str] = Counter()
    with busy(arguments.loops), ThreadPoolExecutor(arguments.beside) as pool:
        for name, problem, seconds in pool.map(once, names * arguments.runs):
            longest[name] = max(longest[name], round(seconds))
            if problem:
                failed[name] += 1
            print(f"{name}, {seconds:.0f} s: {problem or 'well'}", flush=True)
    for name in names:
        print(f"{name:32} {arguments.runs} runs, {failed[name]} failed, the longest took {longest[name]} s")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
