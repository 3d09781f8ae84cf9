"""Random programs of eight threads on one blocking master, cancelled and interrupted, over a bus that loses frames.

The programs and the judge are those of tests/master/blocking_threads.py. One that fails is repeated by
`python -m fuzz blocking_threads NUMBER 1`: what its threads want to do is the same, how it mixes is not.
"""

from __future__ import annotations

from fuzz.cases import run_cases
from tests.master.blocking_threads import judge, program


def main(arguments: list[str]) -> int:
    """Run so many programs; see run_cases."""
    return run_cases("program", "programs", program, judge, arguments)
