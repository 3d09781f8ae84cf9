"""A master and a drive in any situation: loss, delay, copies, faults, a foreign master, power cycles, NMT, cancels at any moment.

The drive is the truth. Each procedure ends. Its result is true, or its error names the drive and the obstacle. A procedure that
moved the drive and did not succeed leaves it standing, or says that the halt failed. In the end the network heals, and then the
master leads the drive wherever it likes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import hypothesis
from hypothesis import Phase
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule, run_state_machine_as_test

from canopen_proto.dictionary import Direction
from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import FAULT_STATES, State
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, RequestId, Time
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Procedure, ProcedureError
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.drives.rig import CYCLE, MILLIDEGREES, Ended, Rig
from tests.examples import examples

LIMIT: Final = 60 * SECOND
"""No procedure takes longer, with the times of SETTINGS."""
SETTINGS: Final = replace(
    MILLIDEGREES,
    homing_method=17,
    velocity_unit=1.0,
    homing_timeout=20 * SECOND,
    state_timeout=SECOND // 2,
    reaction_time=SECOND // 5,
    halt_time=SECOND // 5,
)
MOVE: Final = 20 * SECOND
QUIET: Final = 200 * MILLISECOND
"""Until what was done to the drive has shown."""
LEFT_OVER: Final = 6_000
"""In 0x60FF: whoever enables the drive in pv moves it."""
RATES: Final = {0x60FF: LEFT_OVER, 0x6081: 10_000, 0x6084: 10_000, 0x6085: 20_000}
"""So slow that a ramp takes a second or less, and is seen."""
EVENT_DRIVEN: Final = ((1,), (1, 2))
BY_SYNC: Final = ((4,), (3,))
LINKS: Final = {"SDO": ((), ()), "event-driven PDOs": EVENT_DRIVEN, "PDOs by SYNC": BY_SYNC}


DURATIONS: Final = st.sampled_from([0, 5, 30, 100, 400, 1000, None])
"""In ms; None: to the end."""


AFTER: Final = st.sampled_from([0, 150, 600, 5_000, 40_000, 400_000, 1_500_000])
TROUBLES: Final = st.one_of(
    st.tuples(st.just("disturb"), st.sampled_from([0.02, 0.2, 0.6]), st.sampled_from([0.0, 0.2]), st.booleans()),
    st.tuples(st.just("cut")),
    st.tuples(st.just("heal")),
)
ACTS: Final = st.one_of(
    st.tuples(st.just("fail"), st.sampled_from([0x2310, 0x3210]), st.booleans()),
    st.tuples(
        st.just("another_master"),
        st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x010F, 0x1F, 0x80]),
        st.sampled_from([None, 0, 1, 3, 6, 7]),
    ),
    st.tuples(st.just("cycle_its_power"), st.sampled_from([MILLISECOND, 300 * MILLISECOND, 2 * SECOND])),
    st.tuples(st.just("command_nmt"), st.sampled_from([*NmtCommand])),
)


@dataclass(frozen=True)
class Task:
    """A procedure, and the truth that its result claims.

    moves: it has to leave the drive standing if it does not succeed; follows: it moves after its end, too.
    halts: it leaves the drive standing even if it is cancelled before it has done anything.
    """

    make: Callable[[Rig], Procedure[object]]
    is_true: Callable[[Rig], bool]
    moves: bool = False
    follows: bool = False
    halts: bool = False


def state(*states: State) -> Callable[[Rig], bool]:
    return lambda rig: rig.drive.state in states


def stands(rig: Rig) -> bool:
    return rig.node.values.store[objects.VELOCITY_DEMAND_VALUE] == 0


def follows(mode: Mode) -> Callable[[Rig], bool]:
    return lambda rig: rig.drive.state is State.OPERATION_ENABLED and rig.drive.mode == mode


OFF: Final = (State.NOT_READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED, State.FAULT)
TASKS: Final = {
    "enable": Task(lambda rig: drive.enable(rig.axis), state(State.OPERATION_ENABLED)),
    "halt": Task(lambda rig: drive.halt(rig.axis), stands, moves=True, halts=True),
    "quick stop": Task(lambda rig: drive.quick_stop(rig.axis), state(State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)),
    "shut down": Task(lambda rig: drive.shut_down(rig.axis), state(*OFF)),
    "reset fault": Task(lambda rig: drive.reset_fault(rig.axis), lambda rig: not rig.axis.has_fault),
    "into pp": Task(lambda rig: drive.set_mode(rig.axis, Mode.PROFILE_POSITION), lambda rig: rig.drive.mode == 1),
    "into pv": Task(lambda rig: drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY), lambda rig: rig.drive.mode == 3),
    "move": Task(lambda rig: drive.move_to(rig.axis, 0.1, timeout=MOVE), lambda rig: is_at(rig, 0.1), moves=True),
    "move back": Task(lambda rig: drive.move_to(rig.axis, 0.02, timeout=MOVE), lambda rig: is_at(rig, 0.02), moves=True),
    "home": Task(lambda rig: drive.home(rig.axis), lambda rig: stands(rig) and rig.drive._homing.is_referenced, moves=True),
    "ip": Task(
        lambda rig: drive.start_interpolation(rig.axis, CYCLE, sends_itself=True),
        follows(Mode.INTERPOLATED_POSITION),
        moves=True,
        follows=True,
    ),
    "csp": Task(
        lambda rig: drive.start_cyclic_position(rig.axis, CYCLE, sends_itself=True),
        follows(Mode.CYCLIC_SYNCHRONOUS_POSITION),
        moves=True,
        follows=True,
    ),
    "csv": Task(
        lambda rig: drive.start_cyclic_velocity(rig.axis, CYCLE, sends_itself=True),
        follows(Mode.CYCLIC_SYNCHRONOUS_VELOCITY),
        moves=True,
        follows=True,
    ),
    "cst": Task(
        lambda rig: drive.start_cyclic_torque(rig.axis, CYCLE, sends_itself=True),
        follows(Mode.CYCLIC_SYNCHRONOUS_TORQUE),
        moves=True,
        follows=True,
    ),
}
RUN: Final = Task(lambda rig: drive.run_at(rig.axis, 0.1), lambda rig: False, moves=True)
"""It ends only if it is cancelled."""


TAKE_MODE: Final = [TASKS[name] for name in ("into pp", "into pv", "move", "home", "ip", "csp", "csv", "cst")]
"""They end only once 0x6061 shows the mode."""


def is_at(rig: Rig, position: float) -> bool:
    """Whether the drive stands within its window of a target."""
    return abs(rig.drive._servo.position - rig.drive._servo.zero - rig.axis.scale.to_counts(position)) <= 11


class MasterAndDrive(RuleBasedStateMachine):
    """One master, one drive, and everything that comes between them."""

    @initialize(
        link=st.sampled_from([*LINKS]),
        reaction=st.sampled_from([0, 30 * MILLISECOND]),
        self_test=st.booleans(),
        is_hostile=st.booleans(),
    )
    def begin(self, link: str, reaction: Time, self_test: bool, is_hostile: bool) -> None:
        """is_hostile: others act on the drive, too; else only the network is bad, and tasks are cancelled."""
        self.is_hostile = is_hostile
        settings = DriveSettings(
            position=0, reaction=reaction, self_test=self_test * 50 * MILLISECOND, track=Track(negative_limit=-20_000)
        )
        self.rig = rig = Rig(Shape.STANDARD, pdos=False, drive=settings)
        for index, value in RATES.items():
            rig.node.set_value(index, 0, value, rig.bus.now)
        rig.axis.settings = SETTINGS
        rpdos, tpdos = LINKS[link]
        for number in rpdos:
            rig.run(use_device_pdo(rig.remote, Direction.RPDO, number))
            rig.remote.enable_rpdo(number, rig.bus.now)
        for number in tpdos:
            rig.run(use_device_pdo(rig.remote, Direction.TPDO, number))
        self.by_sync = link == "PDOs by SYNC"
        if self.by_sync:
            rig.start_sync()
        rig.bus.run(2 * QUIET)
        self.shows_state = bool(tpdos)
        self.shows_mode = 2 in tpdos
        self.is_known = self.is_mode_known = (
            False  # since the last disturbance the master has succeeded once, so that it knows the drive
        )
        self.is_clear = False  # nothing stood in the way of the task when it began
        self.stands_since: Time | None = None
        self.task: Task | None = None
        self.request: RequestId | None = None
        self.began_at: Time = 0
        self.acted_at: Time = -1  # something besides this master acted on the drive
        self.was_disturbed = False  # since the task began
        self.is_cut = self.is_lossy = False
        self.healed_at: Time = 0
        self.cancelled_at: Time = 0  # a late drive may obey what was commanded before
        self.lasting: set[int] = set()
        self.seen = len(rig.bus.events)

    # ---- the master ----

    @rule(name=st.sampled_from(["enable", "into pp", "into pv", "reset fault"]), duration=DURATIONS)
    def prepare(self, name: str, duration: int | None) -> None:
        self.do(name, duration)

    @rule(name=st.sampled_from(["move", "move back", "home", "ip", "csp", "csv", "cst"]), duration=DURATIONS)
    def move(self, name: str, duration: int | None) -> None:
        self.do(name, duration)

    @rule(name=st.sampled_from(["halt", "quick stop", "shut down"]), duration=DURATIONS)
    def stop(self, name: str, duration: int | None) -> None:
        self.do(name, duration)

    @rule()
    def recover(self) -> None:
        """All is well again."""
        self.heal()
        self.remove_the_cause()
        self.let(2 * QUIET)
        self.rig.nmt.start(0, self.rig.bus.now)
        self.let(QUIET)
        self.do("reset fault", None)

    @rule()
    def run_in_pv(self) -> None:
        """Move by what was left over."""
        self.do("into pv", None)
        self.do("enable", None)
        self.let(100 * MILLISECOND)

    @rule(name=st.sampled_from(["halt", "move", "home", "ip", "csp", "run"]), after=AFTER, moves=st.booleans())
    def interrupt(self, name: str, after: int, moves: bool) -> None:
        """Begin a task and cancel it, after so many us. moves: the axis moves before."""
        if moves:
            self.run_in_pv()
        self.do(name, 0)
        self.let(after * MICROSECOND)
        if self.request is not None:
            self.cancel()
            self.await_its_end()

    @rule(name=st.sampled_from([*TASKS]), moves=st.booleans())
    def finish(self, name: str, moves: bool) -> None:
        if moves:
            self.run_in_pv()
        self.do(name, None)

    def do(self, name: str, duration: int | None) -> None:
        """Begin a task, and let it run for so many ms, or (None) to its end. A task that is under way is cancelled before."""
        if self.request is not None:
            self.cancel()
            self.await_its_end()
        rig = self.rig
        self.task, self.began_at = TASKS.get(name, RUN), rig.bus.now
        self.stands_since = None
        self.sent_before = len(rig.bus.sent)
        self.was_disturbed = self.is_cut or self.is_lossy
        self.is_clear = (
            not self.was_disturbed
            and rig.bus.now > max(self.acted_at, self.healed_at, self.cancelled_at) + QUIET
            and rig.node.state is NmtState.OPERATIONAL
            and rig.remote.is_operational
            and (rig.drive.state not in FAULT_STATES or (name == "reset fault" and not self.lasting))
        )
        self.request = rig.master.run(self.task.make(rig), rig.bus.now)
        self.let((duration or 0) * MILLISECOND)
        if duration is None:
            self.await_its_end()

    @precondition(lambda self: self.request is not None)
    @rule()
    def cancel(self) -> None:
        assert self.request is not None
        self.rig.master.cancel(self.request, self.rig.bus.now)
        self.let(0)

    @precondition(lambda self: self.request is not None)
    @rule()
    def await_its_end(self) -> None:
        began = self.rig.bus.now
        while self.request is not None:
            assert self.rig.bus.now - began < LIMIT, "a wait that never ends"
            self.let(100 * MILLISECOND)

    @rule(duration=st.sampled_from([MILLISECOND, 5 * MILLISECOND, 20 * MILLISECOND, 100 * MILLISECOND, 500 * MILLISECOND]))
    def let(self, duration: Time) -> None:
        """Let time pass, and judge the task if it has ended."""
        bus = self.rig.bus
        end = bus.now + duration
        while True:
            bus.pump()
            new, self.seen = bus.events[self.seen :], len(bus.events)
            for event in new:
                if isinstance(event, Ended) and event.request_id == self.request:
                    self.judge(event)
            if bus.next_time() > end:
                break
            bus.step()
        bus.run(max(0, end - bus.now))

    @precondition(lambda self: self.by_sync)
    @rule(step=st.sampled_from([-50, 10, 200]), cycles=st.integers(1, 5))
    def give_set_points(self, step: int, cycles: int) -> None:
        axis = self.rig.axis
        for _ in range(cycles):
            axis.set_points.set_position_counts(axis.set_points.counts + step)
            self.let(CYCLE)

    # ---- everything else ----

    @rule(trouble=TROUBLES)
    def trouble(self, trouble: tuple[Any, ...]) -> None:
        """Something befalls the network."""
        name, *how = trouble
        getattr(self, name)(*how)

    @precondition(lambda self: self.is_hostile)
    @rule(act=ACTS)
    def others(self, act: tuple[Any, ...]) -> None:
        """Somebody else acts on the drive."""
        name, *how = act
        self.acted_at = self.rig.bus.now
        getattr(self, name)(*how)
        self.acted_at = self.rig.bus.now

    def disturb(self, loss: float, copies: float, slow: bool) -> None:
        self.is_lossy = self.was_disturbed = True
        self.is_known = self.is_mode_known = False
        self.rig.bus.disturb(loss=loss, copies=copies, delay=(100_000, (20 if slow else 1) * MILLISECOND))

    def heal(self) -> None:
        self.rig.bus.disturb(delay=(100_000, 100_000))
        self.is_lossy = self.is_cut = False
        self.healed_at = self.rig.bus.now

    def cut(self) -> None:
        self.rig.bus.disturb(loss=1.0, delay=(100_000, 100_000))
        self.is_cut = self.was_disturbed = True
        self.is_known = self.is_mode_known = False

    def fail(self, code: int, lasting: bool) -> None:
        self.rig.node.raise_fault(code, self.rig.bus.now, lasting=lasting)
        if lasting:
            self.lasting.add(code)
        self.let(0)

    def remove_the_cause(self) -> None:
        while self.lasting:
            self.rig.drive.end_fault(self.lasting.pop())

    def another_master(self, word: int, mode: int | None) -> None:
        self.rig.bus.send(
            f"205#{word.to_bytes(2, 'little').hex()}" if mode is None else f"305#{word & 255:02X}{word >> 8:02X}{mode:02X}"
        )
        self.let(MILLISECOND)

    def cycle_its_power(self, off: Time) -> None:
        rig = self.rig
        self.is_known = self.is_mode_known = False
        rig.node.execute(NmtCommand.RESET_NODE, rig.bus.now)
        rig.device.drain(rig.bus.now)
        rig.bus.detach(rig.device)
        self.let(off)
        rig.bus.attach(rig.device)
        rig.node.execute(NmtCommand.RESET_NODE, rig.bus.now)
        self.let(0)

    def command_nmt(self, command: NmtCommand) -> None:
        self.is_known = self.is_mode_known = False
        self.rig.nmt.send(command, 5, self.rig.bus.now)
        self.let(MILLISECOND)

    # ---- what has to hold ----

    @precondition(lambda self: self.shows_state and self.is_known)
    @rule()
    def look(self) -> None:
        """What PDOs show, the master knows."""
        rig = self.rig
        self.let(50 * MILLISECOND)
        if self.is_known and rig.node.state is NmtState.OPERATIONAL:
            rig.drive.refresh(rig.bus.now)
            assert rig.axis.state is rig.drive.state
            assert not (self.shows_mode and self.is_mode_known) or rig.axis.mode == rig.drive.mode

    @invariant()
    def what_stands_goes_on_standing(self) -> None:
        if getattr(self, "stands_since", None) is not None and self.acted_at < (self.stands_since or 0):
            self.rig.drive.refresh(self.rig.bus.now)
            assert stands(self.rig), f"it stood, and moves now: {self.truth()}"

    def judge(self, ended: Ended) -> None:
        task, rig = self.task, self.rig
        assert task is not None
        self.request = self.task = None
        is_ours = self.acted_at < self.began_at
        rig.drive.refresh(rig.bus.now)
        says = ""
        match ended:
            case ProcedureFinished():
                assert not is_ours or task.is_true(rig), f"it claims more than is true: {self.truth()}"
                if self.is_clear and is_ours and not self.was_disturbed:
                    self.is_known = True
                    self.is_mode_known = self.is_mode_known or task in TAKE_MODE
            case ProcedureCancelled(clean_up_error=error):
                self.cancelled_at = rig.bus.now
                says = "" if error is None else f"its halt failed: {error}"
            case ProcedureFailed(error=error):
                assert isinstance(error, ProcedureError), repr(error)
                says = " ".join(["its halt failed: " * task.halts, str(error), *getattr(error, "__notes__", ())])
                assert " 5" in says, f"it does not name the drive: {says}"
                if not self.was_disturbed:
                    is_lost = isinstance(error, drive.ReferenceLostError)  # a homing before it was cancelled
                    assert is_lost or not (self.is_clear and is_ours), f"nothing stood in the way: {says}"
                    assert not isinstance(error, drive.DriveInFaultError) or "0x2310" in says or "0x3210" in says
        if not task.moves or not is_ours or "halt" in says or not (task.halts or self.has_commanded()):
            return
        if not (isinstance(ended, ProcedureFinished) and task.follows):
            assert stands(rig), f"it leaves a drive that moves, and does not say so: {ended}; {self.truth()}"
            self.stands_since = rig.bus.now

    def has_commanded(self) -> bool:
        """Whether the task has sent anything but requests to read, and what RPDOs said before."""
        frames = [frame for _, frame in self.rig.bus.sent]
        new = {frame for frame in frames[self.sent_before :] if frame.can_id in (0x205, 0x505)}
        written = any(frame.can_id == 0x605 and frame.data[0] >> 5 == 1 for frame in frames[self.sent_before :])
        return written or bool(new - set(frames[: self.sent_before][-30:]))

    def truth(self) -> str:
        rig = self.rig
        servo = rig.drive._servo
        return f"{rig.drive.state}, mode {rig.drive.mode}, at {servo.position:g} with {servo.demand_velocity:g}"

    def teardown(self) -> None:
        """The network heals, the others are quiet: what is under way ends, and the master leads the drive where it likes."""
        if not hasattr(self, "rig"):
            return
        rig = self.rig
        self.heal()
        if self.request is not None:
            self.await_its_end()
        self.remove_the_cause()
        self.let(2 * SECOND)
        rig.nmt.start(0, rig.bus.now)
        self.let(200 * MILLISECOND)
        rig.run(drive.reset_fault(rig.axis))
        rig.run(drive.halt(rig.axis))
        rig.drive.refresh(rig.bus.now)
        assert stands(rig), self.truth()
        rig.run(drive.set_mode(rig.axis, Mode.PROFILE_POSITION))
        rig.run(drive.enable(rig.axis))
        self.agree(State.OPERATION_ENABLED)
        before = rig.drive._servo.position
        rig.run(drive.move_to(rig.axis, 0.02, timeout=MOVE, relative=True))
        assert abs(rig.drive._servo.position - before - rig.axis.scale.to_counts(0.02)) <= 25, self.truth()
        self.agree(State.OPERATION_ENABLED)
        rig.run(drive.shut_down(rig.axis))
        self.agree(State.SWITCH_ON_DISABLED)

    def agree(self, wanted: State) -> None:
        rig = self.rig
        rig.drive.refresh(rig.bus.now)
        assert rig.drive.state is rig.axis.state is wanted, self.truth()
        assert rig.drive.mode == rig.axis.mode == Mode.PROFILE_POSITION
        assert stands(rig)


def test_master_and_drive() -> None:
    settings = hypothesis.settings(examples(20, steps=20, least=12), phases=[Phase.generate])  # to make it short may take minutes
    run_state_machine_as_test(MasterAndDrive, settings=settings)
