"""`python -m canopen_transports.conformance [--asyncio] LOCATOR ...`: run all cases on a bus, in trio or in asyncio.

With one locator, all members open it (virtual:trial, socketcan:vcan0, tcp, udp_multicast). With several, each member has its own
(two or three adapters that are cabled). Exit status: 1 if a case failed, 2 for a wrong call.

NEVER run it on a bus with drives: it would move them.
"""

from __future__ import annotations

import functools
import sys

from canopen_proto.verdict import Result
from canopen_transports.conformance.bench import Site, at
from canopen_transports.conformance.case import RUN_ON
from canopen_transports.conformance.catalogue import run_all
from canopen_transports.errors import TransportError
from canopen_transports.opening import open_transport


def main(locators: list[str]) -> int:
    """Run the cases and print how each ended. Returns the exit status."""
    on = "asyncio" if locators[:1] == ["--asyncio"] else "trio"
    locators = locators[on == "asyncio" :]
    if not locators or locators[0].startswith("-"):
        print(__doc__, file=sys.stderr)
        return 2
    try:
        RUN_ON[on](functools.partial(_open, locators), False)
    except TransportError as error:  # one text instead of one for each case
        print(error, file=sys.stderr)
        return 1
    failed = 0
    for case, verdict in run_all(Site(at(*locators)), on):
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
