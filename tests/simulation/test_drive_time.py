"""The simulated drive and time, and commands in any order."""

from __future__ import annotations

import itertools

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from canopen_proto.drives.cia402.states import TRANSITIONS, Command, State, command_of, state_of
from canopen_proto.machine import NEVER, SECOND
from canopen_proto.simulation.drive.drive import STEP
from canopen_proto.simulation.drive.events import DriveStateChanged
from tests.examples import examples
from tests.simulation.drive_bench import Bench

# ---- time ----


def test_early_wakes_do_nothing_and_a_clock_that_runs_back_is_no_matter() -> None:
    bench = Bench()
    bench.bring_to(State.OPERATION_ENABLED)
    shown = dict(bench.values.store)
    bench.drive.handle_timeout(bench.drive.deadline - 1)
    bench.drive.refresh(bench.now - SECOND)
    bench.drive.on_sync(bench.now - SECOND)
    assert bench.values.store == shown


def test_an_enabled_axis_that_stands_needs_no_wakes_and_a_moving_one_few() -> None:
    bench = Bench()
    bench.enable(1)
    bench.run(100)
    assert bench.drive.deadline == NEVER
    bench.put(0x607A, 10_000)
    bench.control(0x1F)
    assert bench.now < bench.drive.deadline <= bench.now + STEP
    bench.run(2000)
    assert bench.drive.deadline == NEVER


def test_a_very_late_wake_is_still_right() -> None:
    bench = Bench()
    bench.enable(1)
    bench.put(0x607A, 10_000)
    bench.control(0x1F)
    bench.now += 3600 * SECOND
    bench.drive.handle_timeout(bench.now)
    assert bench.position == 10_000
    assert bench.has(10, 12)


class AnyOrder(RuleBasedStateMachine):
    """Any control words, faults, lost connections and pauses: the drive never leaves the table, nor raises."""

    @initialize(
        stop=st.integers(-1, 9),
        shutdown=st.integers(0, 1),
        disable=st.integers(0, 1),
        fault=st.integers(0, 4),
        lost=st.integers(0, 3),
    )
    def power_on(self, stop: int, shutdown: int, disable: int, fault: int, lost: int) -> None:
        self.bench = Bench()
        for index, value in ((0x605A, stop), (0x605B, shutdown), (0x605C, disable), (0x605E, fault), (0x6007, lost)):
            self.bench.preset(index, value)
        self.bench.events()
        self.word = 0
        self.had_torque = self.sto = False

    def check(self, first: tuple[int, ...] | None = None) -> None:
        """What was reported is a walk through the table that ends where the drive is; `first` limits its first transition."""
        steps = self.bench.reported(DriveStateChanged)
        for step in steps:
            arcs = {arc for (state, _), arc in TRANSITIONS.items() if state is step.previous}
            assert (step.state, step.transition) in arcs
        for before, after in itertools.pairwise(steps):
            assert before.state is after.previous
        if steps:
            assert steps[-1].state is self.bench.state
        if first is not None and steps:
            assert steps[0].transition in first

    @rule(word=st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x1F, 0x10F, 0x80, 0x8F]) | st.integers(0, 0xFFFF))
    def command(self, word: int) -> None:
        before = self.bench.state
        command = command_of(word, self.word)
        self.bench.put(0x6040, word)
        self.word = word
        arc = TRANSITIONS.get((before, command)) if command is not None else None
        self.check(first=(arc[1],) if arc else ())
        ramped = command in (Command.SHUTDOWN, Command.DISABLE_OPERATION, Command.ENABLE_OPERATION)
        if arc and not ramped:
            assert self.bench.state is not before or before is State.QUICK_STOP_ACTIVE

    @rule(mode=st.sampled_from([0, 1, 3, 4, 6, 7, 8, 9, 10, 2, -1]))
    def choose_mode(self, mode: int) -> None:
        self.bench.put(0x6060, mode)
        self.had_torque |= mode in (4, 10)
        self.check(first=())

    @rule(set_point=st.integers(-(2**31), 2**31 - 1))
    def give_set_point(self, set_point: int) -> None:
        for index, subindex in ((0x607A, 0), (0x60C1, 1), (0x60FF, 0)):
            self.bench.put(index, set_point, subindex)
        self.bench.put(0x6071, max(-(2**15), min(2**15 - 1, set_point)))
        self.check(first=())

    @rule(code=st.sampled_from([0x2310, 0x4310, 0x8611]))
    def fault(self, code: int) -> None:
        self.bench.drive.raise_fault(code, self.bench.now)
        self.check(first=(13,))
        assert self.bench.state in (State.FAULT_REACTION_ACTIVE, State.FAULT)

    @rule()
    def lose_the_master(self) -> None:
        self.bench.drive.connection_lost(self.bench.now, 0x8130)
        self.check(first=(7, 9, 10, 11, 12, 13))

    @rule(is_active=st.booleans())
    def switch_sto(self, is_active: bool) -> None:
        self.bench.drive.set_safe_torque_off(is_active, self.bench.now)
        self.sto = is_active
        self.check(first=(7, 9, 10, 12, 14))

    @rule(blocked=st.booleans())
    def block(self, blocked: bool) -> None:
        self.bench.drive.block(blocked, self.bench.now)

    @rule(milliseconds=st.sampled_from([0.5, 3, 10, 200, 5000]))
    def wait(self, milliseconds: float) -> None:
        before = self.bench.state
        self.bench.run(milliseconds)
        self.check(first=(5, 8, 12, 13, 14))
        assert self.bench.state is not State.FAULT_REACTION_ACTIVE or before is not State.SWITCH_ON_DISABLED

    @rule()
    def sync(self) -> None:
        self.bench.sync()
        self.check(first=(5, 8, 12, 13, 14))

    @precondition(lambda self: self.bench.state is State.FAULT)
    @rule()
    def reset_fault(self) -> None:
        self.bench.put(0x6040, 0x00)
        self.bench.put(0x6040, 0x80)
        self.word = 0x80
        assert self.bench.state is State.SWITCH_ON_DISABLED
        self.check(first=(15,))

    @rule()
    def power_cycle(self) -> None:
        self.bench.drive.reset(self.bench.now)
        self.word = 0
        assert self.bench.state is State.SWITCH_ON_DISABLED
        self.check(first=(0,))

    @invariant()
    def no_power_no_motion(self) -> None:
        if hasattr(self, "bench"):
            if self.bench.state in (State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.FAULT):
                assert self.bench.read(0x606B) == 0
                if not self.had_torque:  # which needs a mass; without power that runs on until its brake has stopped it
                    assert self.bench.read(0x606C) == 0
            assert not self.sto or self.bench.state in (State.SWITCH_ON_DISABLED, State.FAULT, State.FAULT_REACTION_ACTIVE)
            assert (self.bench.read(0x603F) != 0) == (self.bench.state in (State.FAULT, State.FAULT_REACTION_ACTIVE))
            assert state_of(self.bench.read(0x6041)) is self.bench.drive.state
            for variable in self.bench.values.dictionary:
                variable.encode(self.bench.values.store[variable.mux])  # each value fits its type: a TPDO can be built


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = examples(60, steps=30)
