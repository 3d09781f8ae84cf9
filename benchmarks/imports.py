"""Measure the cost of a start: the CPU time of a fresh interpreter that imports a module, less that of one that does nothing.

    python benchmarks/imports.py

User and system time of the child process count, the least of the rounds; bytecode is compiled before. `import typing` alone is a
good part of it: hardly a program is without, so it costs nothing more there. POSIX only.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys

NETWORK = "import canopen_proto.network"
HELP = "import sys; sys.argv = ['canopen', '--help']; from canopen_cli.entry import main; main()"
READ = "import sys; sys.argv = 'canopen read 5 1000 -b demo'.split(); from canopen_cli.entry import main; main()"
STARTS = {
    "import typing": "import typing",
    NETWORK: NETWORK,
    "from canopen_proto import RemoteNode": "from canopen_proto import RemoteNode",
    "from canopen_master import open_master": "from canopen_master import open_master",
    "canopen --help": HELP,
    "canopen read 5 1000 -b demo": READ,
    "import canopen (2.4.1)": "import canopen",
}


def _cpu_time(program: str) -> float:
    """ms of an interpreter that runs the program."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-c", program], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment, check=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime) * 1000


def over_bare(program: str, rounds: int = 10) -> float:
    """ms that the program costs over an empty one: least against least, rounds interleaved."""
    _cpu_time(program)  # compiles what was not compiled yet
    times = [(_cpu_time(program), _cpu_time("pass")) for _ in range(rounds)]
    return min(time for time, _ in times) - min(bare for _, bare in times)


def main() -> None:
    """Read the arguments, measure, print."""
    parser = argparse.ArgumentParser(description="what a start costs")
    parser.add_argument("--rounds", type=int, default=10, help="rounds per start; the least counts (default: 10)")
    arguments = parser.parse_args()
    print("| start | ms over bare Python |\n|---|---:|")
    for title, program in STARTS.items():
        print(f"| `{title}` | {over_bare(program, arguments.rounds):.0f} |")


if __name__ == "__main__":
    main()
