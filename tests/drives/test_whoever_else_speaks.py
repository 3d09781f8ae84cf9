"""Whatever is lost, whoever else speaks, however late: a command ends, and what it says is what the drive does.

The drive is the one of reference_drive.py, which knows the truth and shares no code with the simulated drive. Each run disturbs a
command at one step: one frame that its master sends.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

import pytest

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives import axis as drive
from canopen_proto.drives.axis.axis import Axis, AxisSettings
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Time
from canopen_proto.procedures.steps import Procedure, ProcedureError
from canopen_proto.testing import World
from tests.drives.drive_dictionaries import STANDARD
from tests.drives.reference_drive import HM, NODE, OE, POWER_ON, PP, PV, TQ, ReferenceDrive
from tests.examples import takes_all

INDICES: Final = {key >> 8 for key in POWER_ON}
DICTIONARY: Final = ObjectDictionary([each for index, each in STANDARD.objects.items() if index in INDICES], source="reference")
SETTINGS: Final = AxisSettings(min_position=-50_000.0, max_position=50_000.0, max_speed=40_000.0)
BOUND: Final = 30 * SECOND
"""How long each of these commands takes at most, whatever is lost."""


def sdo(key: int, value: int, size: int) -> str:
    """A write of up to four bytes, as somebody else sends it."""
    head = bytes([0x23 | (4 - size) << 2, key >> 8 & 0xFF, key >> 16, key & 0xFF])
    return f"605#{(head + (value & 0xFFFFFFFF).to_bytes(4, 'little')).hex()}"


def word(value: int) -> str:
    return sdo(0x604000, value, 2)


class Bench:
    """A world with the reference drive, and a master with an axis over it."""

    def __init__(self, seed: int = 1) -> None:
        self.world = World(seed=seed)
        self.drive = ReferenceDrive(self.world)
        self.world.advance(MILLISECOND)
        self.master = self.world.master()
        self.axis = Axis(self.master.node(NODE, DICTIONARY), SETTINGS)
        self.world.send(self.master, Frame(0, b"\1\0"))
        self.world.advance(MILLISECOND)
        self.ended_at: Time = 0

    def prepare(self, mode: int, words: tuple[int, ...], **objects: int) -> None:
        """Somebody else has brought the drive to where it is. objects: by their index, as o60FF=10000."""
        self.drive.write(0x606000, mode)
        for name, value in objects.items():
            self.drive.write(int(name[1:], 16) << 8, value)
        for each in words:
            self.drive.write(0x604000, each)
        self.world.advance(400 * MILLISECOND)
        self.drive.steps = 0

    def disturb(self, step: int, act: Callable[[], object]) -> None:
        """Let something happen when the drive gets the frame of this number."""

        def before(number: int, frame: Frame) -> bool:
            if number == step:
                act()
            return True

        self.drive.before = before

    def say(self, *frames: str) -> Callable[[], object]:
        return lambda: [self.world.bus().send(each) for each in frames]

    def run(self, procedure: Procedure[Any]) -> str:
        """Run a command to its end: "" if it says that it is done, else its error with all notes."""
        request = self.master.start(procedure)
        self.world.run_until(lambda: self.master.has_ended(request), BOUND)
        self.ended_at = self.world.now
        try:
            self.master.result(request)
        except (ProcedureError, LocalProtocolError) as error:
            return "\n".join([f"{type(error).__name__}: {error}", *getattr(error, "__notes__", ())])
        return ""

    def words_after(self, time: Time) -> list[str]:
        """The writes and RPDOs of the master that came after a time."""
        return [
            str(each.frame)
            for each in self.world.bus().trace
            if each.sender == "master" and each.time > time and each.frame.can_id == 0x605 and each.frame.data[0] & 0xE0 == 0x20
        ]


ENABLED: Final = (6, 7, 15)


def off(bench: Bench) -> None:
    bench.prepare(PP, ())


def enabled(bench: Bench) -> None:
    bench.prepare(PP, ENABLED)


def running(bench: Bench) -> None:
    bench.prepare(PV, ENABLED, o60FF=10_000)


def going(bench: Bench) -> None:
    bench.prepare(PP, (*ENABLED, 0x3F), o607A=40_000)


def homing(bench: Bench) -> None:
    bench.drive.write(0x609901, 500)
    bench.prepare(HM, (*ENABLED, 0x1F))


class Command(NamedTuple):
    """make: starts it. stands: a drive stands when it says that it is done. stops: it enables no drive."""

    prepare: Callable[[Bench], None]
    make: Callable[[Axis], Procedure[Any]]
    stands: bool = True
    stops: bool = False


def along(axis: Axis) -> Procedure[None]:
    return drive.move_along(axis, [drive.ProfileTarget(3000), drive.ProfileTarget(-1000)], timeout=5 * SECOND)


COMMANDS: Final = {
    "enable": Command(off, drive.enable, stands=False),
    "move": Command(enabled, lambda axis: drive.move_to(axis, 5000, timeout=5 * SECOND)),
    "move, from off": Command(off, lambda axis: drive.move_to(axis, 5000, timeout=5 * SECOND)),
    "move, relative": Command(enabled, lambda axis: drive.move_to(axis, -3000, relative=True, timeout=5 * SECOND)),
    "move, taking over": Command(running, lambda axis: drive.move_to(axis, 5000, timeout=5 * SECOND)),
    "set of set-points": Command(enabled, along),
    "home": Command(enabled, drive.home),
    "home, taking over": Command(going, drive.home),
    "run": Command(enabled, lambda axis: drive.run_at(axis, 6000, duration=700 * MILLISECOND)),
    "torque": Command(enabled, lambda axis: drive.apply_torque(axis, 0.1, 500 * MILLISECOND, max_speed=20_000)),
    "halt a velocity": Command(running, drive.halt, stops=True),
    "halt a move": Command(going, drive.halt, stops=True),
    "halt a homing": Command(homing, drive.halt, stops=True),
    "quick stop": Command(running, drive.quick_stop, stands=False, stops=True),
    "disable": Command(running, drive.shut_down, stands=False, stops=True),
    "brake": Command(going, drive.engage_brake, stands=False, stops=True),
}
TAKES_POWER: Final = (0x00, 0x02, 0x06, 0x07, 0x80)
RUNS: Final = (0x0F, 0x1F)
FOREIGN: Final = {
    **{f"another commands 0x{each:02X}": word(each) for each in (*TAKES_POWER, *RUNS, 0x10F)},
    **{f"another commands 0x{each:02X} by RPDO": f"205#{each:02X}00" for each in RUNS},
    **{f"another selects mode {each}": sdo(0x606000, each, 1) for each in (PP, PV, TQ, HM)},
    "another lowers 0x607D": sdo(0x607D02, 1000, 4),
    "another lowers 0x607F": sdo(0x607F00, 500, 4),
    "another lowers 0x6065": sdo(0x606500, 1, 4),
    "another lowers 0x60C5": sdo(0x60C500, 500, 4),
    "another writes 0x607A": sdo(0x607A00, 90_000, 4),
    "another writes 0x60FF": sdo(0x60FF00, -9000, 4),
    "another reads": "605#4041600000000000",
    "another aborts": "605#8040600000000405",
    "another sends NMT stop": "000#0205",
    "another sends pre-operational": "000#8005",
    "another resets the node": "000#8105",
}
MOVES_ON: Final = (
    *(f"another commands 0x{each:02X}{by}" for each in RUNS for by in ("", " by RPDO")),
    *(f"another selects mode {each}" for each in (PV, TQ, HM)),
    "another writes 0x60FF",
    "the cable is cut",
)
"""What may let a drive move although its command has stopped it: somebody else commands it, or no stop reaches it."""


def disturb(bench: Bench, kind: str, step: int) -> None:
    """Disturb a command at one step."""
    device, world = bench.drive, bench.world
    late = {"late by 60 ms": 60, "late by 700 ms": 700, "late by 1600 ms": 1600}
    stalls = {f"this computer stalls for {each} ms": each for each in (5, 60, 500)}
    if kind in FOREIGN:
        bench.disturb(step, bench.say(FOREIGN[kind]))
    elif kind in stalls:
        bench.disturb(step, lambda: setattr(bench.master, "paused_until", world.now + stalls[kind] * MILLISECOND))
    elif kind == "the drive boots":
        bench.disturb(step, device.boot)
    elif kind == "a fault":
        bench.disturb(step, lambda: device.fault(0x7300))
    elif kind == "an EMCY":
        bench.disturb(step, lambda: device.send(0x80 + NODE, bytes.fromhex("0042010000000000")))
    elif kind == "the cable is cut":
        bench.disturb(step, lambda: setattr(device, "is_cut", True))
    elif kind == "a request is lost":
        device.before = lambda number, frame: number != step
    else:
        answers = {"an answer is lost": [], "an answer comes twice": [0, 0]} | {
            f"an answer is {name}": [ms] for name, ms in late.items()
        }
        device.answers = lambda number, frame: [
            (each * MILLISECOND, frame) for each in (answers[kind] if number == step else [0])
        ]


KINDS: Final = (
    *FOREIGN,
    *(f"this computer stalls for {each} ms" for each in (5, 60, 500)),
    *(
        "the drive boots",
        "a fault",
        "an EMCY",
        "the cable is cut",
        "a request is lost",
        "an answer is lost",
        "an answer comes twice",
    ),
    *(f"an answer is late by {each} ms" for each in (60, 700, 1600)),
)
NAMES: Final = {
    "the drive boots": ("booted", "did not answer"),
    "another resets the node": ("booted", "did not answer"),
    "a fault": ("0x7300",),
    "the cable is cut": ("silent", "did not answer"),
}
"""What an error has to say of its cause."""


def problems(name: str, kind: str, step: int, seed: int) -> Iterator[str]:
    """Run a command with one disturbance; yield what must never happen."""
    command = COMMANDS[name]
    bench = Bench(seed)
    device = bench.drive
    command.prepare(bench)
    disturb(bench, kind, step)
    began = bench.world.now
    error = bench.run(command.make(bench.axis))
    device.look()
    stood, last = device.stands, bench.ended_at
    commanded = [each for each in bench.words_after(began) if each.startswith("605#2B406000")]
    bench.world.advance(5 * SECOND)
    if not error and command.stands and not stood and kind not in MOVES_ON:
        yield "it says that it is done, and the drive moves"
    if commanded and command.stands and not device.stands and kind not in MOVES_ON:
        yield "the drive still moves long after the end"
    if any(each > last for each in device.enabled_at) and kind not in MOVES_ON:
        yield "the drive is enabled after the end"
    if command.stops and any(each >= began for each in device.enabled_at) and kind not in FOREIGN:
        yield "a stop has enabled the drive"
    late = [each for each in bench.words_after(last + MILLISECOND) if each.startswith("605#2B")]
    if late and "stalls" not in kind:
        yield f"something that was pending fires after the end: {late}"
    if began < device.booted_at < last - MILLISECOND and not error:
        yield "the drive booted, and nothing is said"
    if error and not any(each in error for each in NAMES.get(kind, ("",))):
        yield f"the error does not name its cause: {error}"


# ---- each fault that this found ----


@pytest.mark.parametrize("jerk", [5_000, 20_000, 200_000])
@pytest.mark.parametrize("velocity", [4_000, 12_000])
def test_a_drive_with_limited_jerk_gets_its_time_and_its_way(jerk: int, velocity: int) -> None:
    bench = Bench()
    bench.prepare(PP, ENABLED, o6086=3)
    bench.drive.store[0x60A401] = jerk
    bench.axis.settings = AxisSettings(max_position=50_000.0, max_speed=40_000.0)
    error = bench.run(drive.run_at(bench.axis, velocity))
    assert "came near 50000" in error, "it reached its velocity, and ran until the limit"
    assert bench.drive.stands
    assert bench.drive.furthest <= 50_000
    bench = Bench()
    bench.prepare(PP, ENABLED, o6086=3)
    bench.drive.store[0x60A401] = jerk
    assert bench.run(drive.run_at(bench.axis, 2_000, duration=8 * SECOND)) == ""
    assert bench.drive.stands


@pytest.mark.parametrize("by", ["reset", "power"])
def test_a_run_whose_drive_boots_while_it_brakes_does_not_end_well(by: str) -> None:
    bench = Bench()
    enabled(bench)
    device = bench.drive

    def before(number: int, frame: Frame) -> bool:
        if device.word & 0x100 and 1000 < device.velocity < 3000 and device.booted_at < SECOND // 10:
            device.boot() if by == "power" else bench.say("000#8105")()
        return True

    device.before = before
    error = bench.run(drive.run_at(bench.axis, 6000, duration=700 * MILLISECOND))
    assert device.booted_at > SECOND // 2
    assert "it booted" in error
    assert device.stands


@pytest.mark.parametrize("takes", [word(0x00), word(0x06), "205#0000", "205#0700"])
def test_a_drive_that_loses_its_power_in_a_halt_is_not_told_as_standing_while_it_coasts(takes: str) -> None:
    bench = Bench()
    running(bench)
    bench.disturb(12, bench.say(takes))
    assert bench.run(drive.halt(bench.axis)) == ""
    assert bench.drive.stands
    assert bench.drive.enabled_at[-1] < 200 * MILLISECOND, "the halt has not enabled it again"


@pytest.mark.parametrize("runs", [word(0x0F), "205#0F00"])
def test_a_halt_that_another_master_takes_back_is_sent_again(runs: str) -> None:
    bench = Bench()
    running(bench)
    bench.disturb(12, bench.say(runs))
    assert bench.run(drive.halt(bench.axis)) == ""
    assert bench.drive.stands


@pytest.mark.parametrize(
    ("runs", "says"),
    [(word(0x0F), "another master commanded 0x000F"), ("205#0F00", "its controlword is 0x000F")],
)
def test_who_goes_on_taking_a_halt_back_is_named(runs: str, says: str) -> None:
    bench = Bench()
    running(bench)

    def again() -> None:
        bench.say(runs)()
        bench.world.after(40 * MILLISECOND, again)

    bench.world.after(60 * MILLISECOND, again)
    error = bench.run(drive.halt(bench.axis))
    assert "did not reach standstill" in error
    assert says in error
    sent = [each for each in bench.words_after(0) if "0F01" in each]
    assert 2 <= len(sent) <= 6, "it is no quarrel without end"


@pytest.mark.parametrize("name", ["move", "move, relative", "set of set-points", "home", "run", "torque"])
def test_a_motion_enables_no_drive_that_somebody_else_has_disabled_since_it_began(name: str) -> None:
    command = COMMANDS[name]
    bench = Bench()
    command.prepare(bench)
    bench.run(command.make(bench.axis))
    for step in range(1, min(bench.drive.steps, 70), 3):
        for takes in (0x00, 0x06, 0x07):
            bench = Bench(step)
            command.prepare(bench)
            said_at: list[Time] = []

            def say(bench: Bench = bench, said_at: list[Time] = said_at, takes: int = takes) -> None:
                said_at.append(bench.world.now)
                bench.say(word(takes))()

            bench.disturb(step, say)
            began = bench.world.now
            error = bench.run(command.make(bench.axis))
            crossed = [each for each in bench.drive.enabled_at if each > began]
            assert all(each < said_at[0] + 2 * MILLISECOND for each in crossed), (step, takes)
            assert bench.ended_at < said_at[0] + 3 * SECOND, (step, takes, "nor does it go on")
            assert bench.drive.stands
            assert "another master commanded" in error or "another SDO client" in error, (step, takes, error)


def test_an_axis_that_stands_disabled_by_somebody_else_is_enabled_by_the_next_motion() -> None:
    bench = Bench()
    enabled(bench)
    assert bench.run(drive.move_to(bench.axis, 1000, timeout=5 * SECOND)) == ""
    bench.say(word(0x06))()
    bench.world.advance(200 * MILLISECOND)
    assert bench.run(drive.move_to(bench.axis, 2000, timeout=5 * SECOND)) == ""
    assert bench.drive.state == OE


@pytest.mark.parametrize("lag", [120, 600])
@pytest.mark.parametrize("takes", [0x00, 0x06, 0x07])
def test_a_motion_that_another_master_has_ended_does_not_enable_a_drive_that_obeys_late(lag: int, takes: int) -> None:
    bench = Bench()
    enabled(bench)
    bench.drive.lag = lag * MILLISECOND
    bench.world.after(2 * lag * MILLISECOND + 400 * MILLISECOND, bench.say(word(takes)))
    began = bench.world.now
    error = bench.run(drive.home(bench.axis))
    assert "another master commanded" in error
    assert bench.drive.stands
    bench.world.advance(3 * SECOND)
    assert not [each for each in bench.drive.enabled_at if each >= began]


def test_a_request_that_a_boot_has_ended_names_the_boot() -> None:
    bench = Bench()
    enabled(bench)
    bench.disturb(3, bench.drive.boot)
    error = bench.run(drive.move_to(bench.axis, 1000, timeout=5 * SECOND))
    assert "it booted: it was reset, or its power was off" in error


def test_a_stop_that_was_not_confirmed_is_told_as_it_was_sent() -> None:
    bench = Bench()
    running(bench)
    bench.disturb(1, lambda: setattr(bench.drive, "is_cut", True))
    assert "commanded 0x0002 (quick stop)" in bench.run(drive.quick_stop(bench.axis))


@pytest.mark.parametrize("lag", [0, 120, 600])
def test_a_halt_enables_no_drive_that_somebody_else_was_just_heard_to_disable(lag: int) -> None:
    """Also one that obeys late, and so still shows that it is enabled."""
    bench = Bench()
    going(bench)
    bench.drive.lag = lag * MILLISECOND
    assert bench.run(drive.read_statusword(bench.axis)) == ""
    bench.say(word(0x06))()
    bench.world.advance(MILLISECOND)
    began = bench.world.now
    assert bench.run(drive.halt(bench.axis)) == ""
    assert bench.drive.stands
    bench.world.advance(2 * SECOND)
    assert not [each for each in bench.drive.enabled_at if each >= began]


@pytest.mark.parametrize("name", ["move", "move, relative", "set of set-points", "torque"])
def test_a_motion_whose_checks_fail_leaves_a_drive_as_it_is_and_one_that_has_begun_to_write_halts_it(name: str) -> None:
    reads = 0
    for step in range(1, 40):
        bench = Bench()
        running(bench)
        bench.drive.before = lambda number, frame, step=step: number != step  # type: ignore[misc]
        began = bench.world.now
        error = bench.run(COMMANDS[name].make(bench.axis))
        bench.drive.look()
        if bench.words_after(began):
            assert bench.drive.stands, step
        else:
            assert error
            assert bench.drive.velocity == 10_000, step
            reads += 1
    assert reads


@pytest.mark.parametrize("name", COMMANDS)
def test_whatever_happens_at_any_step_a_command_ends_and_tells_the_truth(name: str) -> None:
    draws = random.Random(name)
    bench = Bench()
    COMMANDS[name].prepare(bench)
    assert bench.run(COMMANDS[name].make(bench.axis)) == ""
    steps = bench.drive.steps
    kinds = KINDS if takes_all() else draws.sample(KINDS, 5)
    found = [
        (kind, step, seed, each)
        for kind in kinds
        for step in {draws.randint(1, min(steps, 60)), draws.randint(1, steps), draws.randint(max(1, steps - 20), steps)}
        for seed in [draws.randrange(1000)]
        for each in problems(name, kind, step, seed)
    ]
    assert found == []
