"""A drive that follows set-points: whatever is lost, and whoever else speaks, it ends at rest, and the error says why.

The drive is the one of reference_drive.py, which knows the truth. Each run starts csp, ip or csv, streams set-points, and halts
the drive, as a program does. It is disturbed at one step: one frame that its master sends to it.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from functools import partial
from typing import Final

import pytest

from canopen_proto.dictionary import Direction, PdoDescription
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.bounds import MotionBounds
from canopen_proto.drives.axis.exclusive_motion import moves
from canopen_proto.drives.axis.failures import DriveError
from canopen_proto.drives.axis.following import Following, FollowingLost
from canopen_proto.drives.axis.following_procedures import following_limit
from canopen_proto.drives.axis.halting import halt_after
from canopen_proto.drives.axis.limits import read_limits
from canopen_proto.drives.cia402 import objects
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, Time
from canopen_proto.procedures.steps import Cancelled, Procedure, Wait
from canopen_proto.sync import SyncConsumer, SyncProducer, SyncSent
from tests.drives.reference_drive import CSP, CSV, IP, OE, RTSO
from tests.drives.test_whoever_else_speaks import KINDS, MOVES_ON, NAMES, TAKES_POWER, Bench, disturb, word
from tests.examples import takes_all

CYCLE: Final = 10 * MILLISECOND
SPEED: Final = 6000
"""Counts per second, of each stream."""
CYCLES: Final = 60
CARRIES: Final = {CSP: "0x607A", IP: "0x60C1:01", CSV: "0x60FF"}
CYCLIC: Final = dict.fromkeys((objects.STATUSWORD, objects.MODES_OF_OPERATION_DISPLAY, objects.POSITION_ACTUAL_VALUE), 1)
MODES: Final = {"csp": CSP, "ip": IP, "csv": CSV}


class StreamBench(Bench):
    """A bench whose master sends SYNC, and exchanges PDOs with the drive."""

    def __init__(self, mode: int, seed: int = 1) -> None:
        super().__init__(seed)
        self.mode = mode
        self.said_at: Time = NEVER  # when it was disturbed
        self.following = Following(self.axis)
        self.world.advance(150 * MILLISECOND)  # it hears that the drive is Operational
        node, now = self.axis.remote, self.world.now
        variable = node.dictionary.variable
        shown = (variable("0x6041"), variable("0x6061"), variable("0x6064"))
        sent = (variable("0x6040"), variable(CARRIES[mode]))
        node.add_pdo(PdoDescription("shown", 0x180, Direction.TPDO, 1, shown), now)
        node.add_pdo(PdoDescription("sent", 0x300, Direction.RPDO, 2, sent), now)
        self.drive.stream_by = int(variable(CARRIES[mode]).mux)
        self.sync, consumer = SyncProducer(self.master.runs.out), SyncConsumer(self.master.runs.out)
        self.master.runs.attach(self.sync)
        self.master.runs.attach(consumer)
        self.sync.start(CYCLE, now)


@moves
def stream(axis: Axis, bench: StreamBench) -> Procedure[None]:
    """Follow set-points at SPEED for CYCLES, then halt."""
    following, mode = bench.following, bench.mode
    bounds: MotionBounds | None = None
    if mode == CSV:
        bounds = yield from drive.bounds_of(axis)
        start = yield from drive.start_cyclic_velocity(axis, CYCLE)
    else:
        limit = yield from following_limit(axis, (yield from read_limits(axis)))
        begin = drive.start_cyclic_position if mode == CSP else drive.start_interpolation
        start = yield from begin(axis, CYCLE)
    try:
        if bounds is not None:
            following.begin_with_bounds(bounds, mode, cyclic=CYCLIC)
        else:
            following.begin(limit, mode, cyclic=CYCLIC, period=CYCLE)
        for number in range(1, CYCLES + 1):
            ramp = min(number, CYCLES - number) / 10
            if mode == CSV:
                axis.set_points.set_velocity(SPEED * min(1.0, ramp))
            else:
                axis.set_points.set_position(start + SPEED * number * CYCLE / SECOND)
            report = yield Wait(SECOND, axis.node, partial(concerns, axis), (SyncSent, FollowingLost))
            if report is None:
                raise DriveError(axis, "got no SYNC")
            if isinstance(report, FollowingLost):
                raise DriveError(axis, report.cause)
    except (Cancelled, Exception) as cause:
        following.end()
        yield from halt_after(axis, cause)
        raise
    following.end()
    yield from drive.halt(axis)


def concerns(axis: Axis, report: Event) -> bool:
    return isinstance(report, SyncSent) or axis.is_told_by(report)


LOST: Final = {f"{count} SYNCs are lost": count for count in (1, 4, 30)}
SYNC_KINDS: Final = (*LOST, "a SYNC comes twice", "another sends SYNC, too", "SYNC ends")
BY_RPDO: Final = {
    f"another commands 0x{each:02X} by the RPDO at SYNCs": f"305#{each:02X}0000000000" for each in (0x00, 0x06, 0x0F)
}
DISABLES: Final = [
    *(f"another commands 0x{each:02X}" for each in TAKES_POWER),
    *(f"another commands 0x{each:02X} by the RPDO at SYNCs" for each in (0x00, 0x06)),
]
STREAM_KINDS: Final = (*KINDS, *SYNC_KINDS, *BY_RPDO)
GOES_ON: Final = (
    *MOVES_ON,
    *(f"another selects mode {each}" for each in (1, 6)),
    "another commands 0x0F by the RPDO at SYNCs",  # with a set-point of its own
)
"""What may let a drive move although its stream has ended: somebody else commands it, or no stop reaches it."""


def disturb_stream(bench: StreamBench, kind: str, step: int) -> None:
    """Disturb a stream at one step."""
    if kind in LOST:
        bench.disturb(step, lambda: setattr(bench.drive, "lost_syncs", LOST[kind]))
    elif kind == "a SYNC comes twice":
        bench.disturb(step, bench.say("080#"))
    elif kind == "another sends SYNC, too":

        def again() -> None:
            bench.say("080#")()
            bench.world.after(7 * MILLISECOND, again)

        bench.disturb(step, again)
    elif kind == "SYNC ends":
        bench.disturb(step, bench.sync.stop)
    elif kind in BY_RPDO:
        bench.disturb(step, bench.say(BY_RPDO[kind]))
    else:
        disturb(bench, kind, step)
    act = bench.drive.before

    def before(number: int, frame: Frame) -> bool:
        if number == step:
            bench.said_at = bench.world.now
        return act(number, frame)

    bench.drive.before = before


def problems(mode: int, kind: str, step: int, seed: int) -> Iterator[str]:
    """Run a stream with one disturbance; yield what must never happen."""
    bench = StreamBench(mode, seed)
    device = bench.drive
    runs_already = seed % 2 == 1
    if runs_already:
        bench.prepare(3, (6, 7, 15), o60FF=3000)
    device.steps = 0
    disturb_stream(bench, kind, step)
    began, place = bench.world.now, device.place
    error = bench.run(stream(bench.axis, bench))
    device.look()
    stood, last = device.stands, bench.ended_at
    way = device.place - place
    commanded = [each for each in bench.words_after(began) if each.startswith("605#2B406000")]
    bench.world.advance(5 * SECOND)
    if not commanded:
        return  # its first reads have failed: the drive is left as it is
    if not error and not stood and kind not in GOES_ON:
        yield "it says that it is done, and the drive moves"
    slower = mode == CSV and kind == "another lowers 0x607F"  # a velocity has no following error (docs/limits.md)
    if not error and kind not in GOES_ON and not slower and way < 0.75 * CYCLES * SPEED * CYCLE / SECOND:
        yield f"it says that it is done, and the drive has gone {way:.0f}"
    if not device.stands and kind not in GOES_ON:
        yield f"the drive still moves long after the end: {error}"
    if any(each > last for each in device.enabled_at) and kind not in GOES_ON:
        yield "the drive is enabled after the end"
    if device.furthest > 6000 and not runs_already and kind not in GOES_ON:
        yield f"it jumped: {device.furthest:.0f}"
    if began < device.booted_at < last - MILLISECOND and not error:
        yield "the drive booted, and nothing is said"
    if kind in DISABLES and any(each > bench.said_at + 2 * MILLISECOND for each in device.enabled_at):
        yield "it was enabled again, though another master has disabled it"
    if error and not any(each in error for each in (*NAMES.get(kind, ("",)), "was reset")):
        yield f"the error does not name its cause: {error}"


@pytest.mark.parametrize("name", MODES)
@pytest.mark.parametrize("by", ["SDO", "the RPDO at SYNCs"])
def test_a_drive_that_another_master_disables_is_not_enabled_again_by_the_next_pdo(name: str, by: str) -> None:
    bench = StreamBench(MODES[name])
    bench.disturb(80, bench.say(word(0x06) if by == "SDO" else "305#060000000000"))
    error = bench.run(stream(bench.axis, bench))
    assert "another master commanded 0x0006 (shutdown)" in error
    bench.world.advance(SECOND)
    assert (len(bench.drive.enabled_at), bench.drive.state, bench.drive.stands) == (1, RTSO, True)


def test_nor_is_one_that_stands_behind_a_stream() -> None:
    bench = StreamBench(CSP)
    assert bench.run(stream(bench.axis, bench)) == ""
    assert bench.drive.state == OE
    bench.say(word(0x06))()
    bench.world.advance(SECOND)
    assert (len(bench.drive.enabled_at), bench.drive.state) == (1, RTSO)
    assert bench.run(stream(bench.axis, bench)) == "", "the next motion enables it"


def test_a_halt_by_pdo_is_sent_again_to_a_node_that_turns_out_to_hear_no_pdos() -> None:
    """It was set to Pre-operational, and only its next heartbeat says so. A drive in csv repeats its last velocity meanwhile."""
    bench = StreamBench(CSV)
    bench.disturb(113, bench.say("000#8005"))
    assert "is silent" in bench.run(stream(bench.axis, bench))
    assert bench.drive.stands
    assert bench.drive.furthest < 4000


@pytest.mark.parametrize("name", MODES)
def test_whatever_happens_at_any_step_a_stream_ends_at_rest_and_tells_the_truth(name: str) -> None:
    draws, mode = random.Random(name), MODES[name]
    bench = StreamBench(mode)
    assert bench.run(stream(bench.axis, bench)) == ""
    steps = bench.drive.steps
    kinds = STREAM_KINDS if takes_all() else draws.sample(STREAM_KINDS, 4)
    found = [
        (kind, step, seed, each)
        for kind in kinds
        for step in sorted({draws.randint(1, steps // 2), draws.randint(1, steps), draws.randint(steps - 20, steps)})
        for seed in [draws.randrange(1000)]
        for each in problems(mode, kind, step, seed)
    ]
    assert found == []
