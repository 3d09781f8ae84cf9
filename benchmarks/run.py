"""canopen-proto against `canopen` 2.4.1, in one run: prints a Markdown table with ratios.

    python benchmarks/run.py                # all cases, about two minutes
    python benchmarks/run.py pdo --rounds 3 # those with "pdo" in their title

What is compared, and what makes it fair, stands in each of `MODULES`; how it is measured, in measure.
"""

from __future__ import annotations

import argparse
import os
import platform

import block_transfers
import eds_import
import heartbeats
import many_nodes
import pdos
import read_by_name
import sdo_transfers
from direct import VERSION
from measure import measure, table

MODULES = (sdo_transfers, read_by_name, block_transfers, pdos, heartbeats, many_nodes, eds_import)


def main() -> None:
    """Read the arguments, measure, print."""
    parser = argparse.ArgumentParser(description="compare canopen-proto with canopen, in one run")
    parser.add_argument("words", nargs="*", help="only the cases with one of these words in their title")
    parser.add_argument("--rounds", type=int, default=9, help="rounds per case and side (default: 9)")
    parser.add_argument("--seconds", type=float, default=0.2, help="CPU time of a round (default: 0.2)")
    arguments = parser.parse_args()
    cases = [case for module in MODULES for case in module.cases()]
    if arguments.words:
        cases = [case for case in cases if any(word.lower() in case.title.lower() for word in arguments.words)]
    if not cases:
        parser.error("no case has one of these words in its title")
    results = [measure(case, arguments.rounds, arguments.seconds) for case in cases]
    python = f"{platform.python_implementation()} {platform.python_version()}"
    print(f"{python}, {platform.machine()}, {os.cpu_count()} CPUs; canopen {VERSION}; {arguments.rounds} interleaved rounds of")
    print(f"{arguments.seconds} s CPU time each; median (least) in us\n")
    print(table(results, f"canopen {VERSION}"))


if __name__ == "__main__":
    main()
