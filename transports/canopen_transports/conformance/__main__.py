"""`python -m canopen_transports.conformance LOCATOR ...`: all cases on a bus. Exit status 1 if one failed, 2 for a wrong call.

One locator: all members open it (virtual:trial, socketcan:vcan0, tcp, udp_multicast). Several: a member each (two or three
adapters that are cabled). NEVER on a bus with drives: they would be moved.
"""

from __future__ import annotations

import sys

import trio

from canopen_proto.verdict import Result
from canopen_transports.conformance.bench import Site, at
from canopen_transports.conformance.catalogue import run_all
from canopen_transports.errors import TransportError
from canopen_transports.opening import open_transport


def main(locators: list[str]) -> int:
    """Run them, and say how each ended."""
    if not locators or locators[0].startswith("-"):
        print(__doc__, file=sys.stderr)
        return 2
    try:
        trio.run(_open, locators)
    except TransportError as error:  # one text, not one for each case
        print(error, file=sys.stderr)
        return 1
    failed = 0
    for case, verdict in run_all(Site(at(*locators))):
        failed += verdict.result is Result.FAILED
        print(f"{verdict.result.value:14}  {case.title}")
        for line in verdict.reason.splitlines():
            print(f"{'':14}    {line}")
    print(f"{failed} failed" if failed else "none failed")
    return 1 if failed else 0


async def _open(locators: list[str]) -> None:
    for locator in locators:
        await (await open_transport(locator)).aclose()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
