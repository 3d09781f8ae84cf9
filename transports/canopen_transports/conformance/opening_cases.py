"""Joining a bus, and failing to."""

from __future__ import annotations

from random import Random
from typing import Final

from canopen_proto.verdict import does_not_apply, expect
from canopen_transports.conformance.bench import TransportBench
from canopen_transports.conformance.case import case, held
from canopen_transports.conformance.frames import numbered
from canopen_transports.errors import BAD_LOCATOR, CANNOT_OPEN, NO_PERMISSION, TransportError
from canopen_transports.loop import current_loop

MAX_LINES: Final = 10
"""The most lines that an error text may have: nobody reads more."""
SEEDS: Final = range(12)


@case
async def what_cannot_be_opened_says_what_to_do(bench: TransportBench) -> None:
    """Opening a bus that cannot be opened raises TransportError with what was seen, why, and what to do; nothing stays open."""
    if not bench.site.unopenable:
        does_not_apply("the site names nothing that cannot be opened")
    for opening in bench.site.unopenable:
        before = held()
        try:
            member = await opening()
        except TransportError as caught:
            error = caught
        else:
            await member.aclose()
            expect(False, f"{opening} was opened")
        about = f"{error.failed!r} ({error.locator}):"
        expect(error.code in (BAD_LOCATOR, CANNOT_OPEN, NO_PERMISSION), f"{about} the code is {error.code}")
        expect(bool(error.locator) and error.locator in error.failed, f"{about} it does not name the bus")
        expect(bool(error.seen), f"{about} it does not say what was seen")
        # A locator that is not valid is its own cause.
        expect(bool(error.cause) or error.code == BAD_LOCATOR, f"{about} it does not say why; seen: {error.seen}")
        expect(bool(error.tries) and all(error.tries), f"{about} it does not say what to do")
        lines = str(error).splitlines()
        expect(len(lines) <= MAX_LINES, f"{about} its text has {len(lines)} lines")
        left = sorted(held() - before)
        expect(not left, f"{about} this is left open: {', '.join(left)}")


@case
async def opening_can_be_cancelled(bench: TransportBench) -> None:
    """A cancelled opening leaves nothing open, or returns the member; afterwards the bus can be joined."""
    for seed in SEEDS:
        with current_loop().cancel_scope() as scope:
            bench.disturb(scope, Random(seed))
            await bench.join(1)
        await bench.close_all()
    one, other = await bench.members(2)
    await one.send(numbered(1))
    expect(await bench.numbers(other, 1) == [1], "another frame than the one that was sent")
