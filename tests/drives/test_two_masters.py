"""Two programs of ours that lead one drive, over one SDO channel, as two leases or two commands do: what each says is true.

Each run starts a motion, and a second master with a command of its own when the drive gets the frame of a drawn number. The drive
is the one of reference_drive.py, which knows the truth.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Final, NamedTuple

import pytest

from canopen_proto.drives.axis.axis import Axis
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, RequestId, Time
from canopen_proto.procedures.steps import ProcedureError
from canopen_proto.testing import WorldMaster
from tests.drives.reference_drive import NODE, OE
from tests.drives.test_whoever_else_speaks import BOUND, COMMANDS, DICTIONARY, SETTINGS, Bench
from tests.examples import takes_all

MOTIONS: Final = [name for name, command in COMMANDS.items() if not command.stops]
MOVE: Final = ("move", "move, from off", "move, taking over")
"""Those that go to 5000."""


class End(NamedTuple):
    """How a command ended. error: "" if it says that it is done. stands, position: of the drive, in truth."""

    at: Time
    error: str
    stands: bool
    position: float


def end_of(bench: Bench, master: WorldMaster, request: RequestId) -> End:
    bench.drive.look()
    error = ""
    try:
        master.result(request)
    except (ProcedureError, LocalProtocolError) as failed:
        error = "\n".join([f"{type(failed).__name__}: {failed}", *getattr(failed, "__notes__", ())])
    return End(bench.world.now, error, bench.drive.stands, bench.drive.position)


def both(bench: Bench, first: str, second: str, step: int) -> list[End]:
    """Run a command, and another master's from a step of it on; return how both ended. One that has not begun has no end."""
    COMMANDS[first].prepare(bench)
    other = bench.world.master()
    axis = Axis(other.node(NODE, DICTIONARY), SETTINGS)
    begun: list[tuple[WorldMaster, RequestId]] = []

    def begin() -> None:
        begun.append((other, other.start(COMMANDS[second].make(axis))))

    begun.append((bench.master, bench.master.start(COMMANDS[first].make(bench.axis))))
    bench.disturb(step, lambda: bench.world.after(MILLISECOND, begin))
    ends: dict[int, End] = {}

    def are_over() -> bool:
        for place, (master, request) in enumerate(begun):
            if place not in ends and master.has_ended(request):
                ends[place] = end_of(bench, master, request)
        return len(ends) == len(begun)

    bench.world.run_until(are_over, 2 * BOUND)
    return [ends[place] for place in range(len(begun))]


def problems(first: str, second: str, step: int, seed: int) -> Iterator[str]:
    """Run two commands; yield what must never happen."""
    bench, stops = Bench(seed), COMMANDS[second].stops
    device = bench.drive
    ends = both(bench, first, second, step)
    if len(ends) < 2:
        return
    mine, other = ends
    last = max(mine.at, other.at)
    bench.world.advance(5 * SECOND)
    if (stops or (COMMANDS[first].stands and COMMANDS[second].stands)) and not device.stands:
        yield "the drive still moves long after the end"
    if any(each > last for each in device.enabled_at):
        yield "the drive is enabled after the end"
    if second in ("quick stop", "disable", "brake") and device.state == OE:
        yield "the drive is enabled behind a command that takes its power"
    if stops and other.error:
        yield f"a stop failed: {other.error}"
    if stops and COMMANDS[second].stands and not other.stands:
        yield "a halt says that it is done, and the drive moves"
    for name, end in ((first, mine), (second, other)):
        if name in MOVE and not end.error and abs(end.position - 5000) > 20:
            yield f"a move says that it is done, and the drive is at {end.position:.0f}"


@pytest.mark.parametrize(
    ("first", "second", "step"),
    [
        ("set of set-points", "quick stop", 38),
        ("move, from off", "quick stop", 24),
        ("home", "brake", 13),
        ("move, relative", "disable", 50),
    ],
)
def test_a_stop_whose_answer_another_program_disturbs_looks_at_the_drive(first: str, second: str, step: int) -> None:
    for seed in range(20 if takes_all() else 6):
        assert list(problems(first, second, step, seed)) == []


@pytest.mark.parametrize("second", ["halt a move", "halt a homing", "halt a velocity"])
def test_a_halt_beside_the_halt_of_another_program_sees_that_the_drive_stands(second: str) -> None:
    """Both ask the drive for its state until it stands."""
    for step, seed in ((35, 658), (36, 284), (36, 540), (37, 844), (45, 174), (45, 779)):
        assert list(problems("move, relative", second, step, seed)) == []


@pytest.mark.parametrize("second", COMMANDS)
def test_whatever_another_program_commands_meanwhile_each_tells_the_truth(second: str) -> None:
    draws = random.Random(second)
    found = [
        (first, step, seed, each)
        for _ in range(100 if takes_all() else 3)
        for first, step, seed in [(draws.choice(MOTIONS), draws.randint(1, 60), draws.randrange(1000))]
        for each in problems(first, second, step, seed)
    ]
    assert found == []
