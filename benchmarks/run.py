"""canopen-proto against `canopen` 2.4.1, in one run: Markdown tables with what users feel (goals.py), with what motions of chains
cost (motions.py, without a peer), with memory (memory.py), and with every case.

    python benchmarks/run.py                            # all cases, some eight minutes
    python benchmarks/run.py --into docs/speed.md       # the same, into the page, in place of the last figures of this build
    python benchmarks/run.py pdo --rounds 3             # the cases with "pdo" in their title, and no goals

Each of `MODULES` says what it compares and why that is fair; measure.py says how. The output names the build that was measured,
pure Python or compiled.
"""

from __future__ import annotations

import argparse
import gc
import os
import platform
import re
from pathlib import Path

import block_transfers
import devices
import eds_import
import goals
import heartbeats
import many_nodes
import master_edge
import memory
import motions
import observer
import pdos
import read_by_name
import sdo_transfers
from direct import VERSION
from measure import FAILED, Result, measure, table

MODULES = (sdo_transfers, read_by_name, block_transfers, pdos, heartbeats, many_nodes, observer, master_edge, devices, eds_import)


def report(results: list[Result], rounds: int, seconds: float, *, with_goals: bool) -> str:
    """Return the output, as Markdown."""
    python = f"{platform.python_implementation()} {platform.python_version()}"
    build = "compiled" if goals.COMPILED else "pure Python"
    machine = f"{python}, {platform.machine()}, {os.cpu_count()} CPUs; canopen-proto is {build}; canopen {VERSION}"
    parts = [f"{machine}; {rounds} interleaved rounds of\n{seconds} s CPU time each; cases: median (least) in us"]
    if with_goals:
        parts.append(goals.table({each.title: each for each in results}))
        parts.append(motions.tables(rounds=3))
        parts.append(memory.table())
    return "\n\n".join([*parts, table(results, f"canopen {VERSION}")])


def paste(page: str, text: str) -> str:
    """The page with the text between the marks of this build."""
    name = "compiled" if goals.COMPILED else "pure"
    marks = re.compile(f"(<!-- figures: {name} -->\n).*?(<!-- end -->)", re.DOTALL)
    pasted, count = marks.subn(lambda found: f"{found[1]}{text}\n{found[2]}", page)
    if count != 1:
        raise SystemExit(f"the page has {count} places for the figures of this build: <!-- figures: {name} --> ... <!-- end -->")
    return pasted


def main() -> None:
    """Read the arguments, measure, print."""
    parser = argparse.ArgumentParser(description="compare canopen-proto with canopen, in one run")
    parser.add_argument("words", nargs="*", help="only the cases with one of these words in their title")
    parser.add_argument("--rounds", type=int, default=9, help="rounds per case and side (default: 9)")
    parser.add_argument("--seconds", type=float, default=0.2, help="CPU time of a round (default: 0.2)")
    parser.add_argument("--into", type=Path, metavar="PAGE", help="a Markdown page to put the figures into")
    arguments = parser.parse_args()
    if arguments.into and arguments.words:
        parser.error("a page gets all figures or none")
    cases = [case for module in MODULES for case in module.cases()]
    if arguments.words:
        cases = [case for case in cases if any(word.lower() in case.title.lower() for word in arguments.words)]
    if not cases:
        parser.error("no case has one of these words in its title")
    gc.freeze()  # else each of hundreds of short rounds waits until the collector has looked at all that was imported
    results = [measure(case, arguments.rounds, arguments.seconds) for case in cases]
    text = report(results, arguments.rounds, arguments.seconds, with_goals=not arguments.words)
    print(text)
    if arguments.into:
        arguments.into.write_text(paste(arguments.into.read_text(encoding="utf-8"), text), encoding="utf-8")
    if FAILED in text:
        raise SystemExit("a case failed: its row says so, and its traceback is above")


if __name__ == "__main__":
    main()
