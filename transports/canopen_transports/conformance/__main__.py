"""`python -m canopen_transports.conformance LOCATOR ...`: all cases on a bus. Exit status 1 if one failed, 2 for a wrong call.

One locator: all members open it (virtual:trial, socketcan:vcan0, tcp, udp_multicast). Several: a member each (two or three
adapters that are cabled). NEVER on a bus with drives: they would be moved.
"""

from __future__ import annotations

import sys

from canopen_proto.conformance.case import Result
from canopen_transports.conformance.catalogue import run_all
from canopen_transports.conformance.site import Site, at


def main(locators: list[str]) -> int:
    """Run them, and say how each ended."""
    if not locators or locators[0].startswith("-"):
        print(__doc__, file=sys.stderr)
        return 2
    failed = 0
    for case, verdict in run_all(Site(at(*locators))):
        failed += verdict.result is Result.FAILED
        print(f"{verdict.result.value:14}  {case.title}")
        for line in verdict.reason.splitlines():
            print(f"{'':14}    {line}")
    print(f"{failed} failed" if failed else "none failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
