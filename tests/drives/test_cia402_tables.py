"""The simulated drive against the tables of CiA 402: each state with each controlword, each option code of an axis that moves or
stands. The truth stands in cia402_oracle.py, written by hand."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from canopen_proto.drives.cia402 import states
from canopen_proto.drives.cia402.modes import Mode, describe_status, mode_name, supported_modes
from canopen_proto.drives.cia402.names import with_drive_names
from canopen_proto.drives.cia402.option_codes import OPTION_CODES
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, NEVER, SECOND
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.simulation import cia402_oracle as oracle
from tests.simulation.cia402_oracle import DISABLED, ENABLED, FAULT, NOT_READY, OPTIONS, QUICK_STOP, REACTION, Stop
from tests.simulation.drive_bench import DICTIONARIES, Bench

MODES = (0, 1, 3, 6, 7, 8)
OTHER_BITS = (0x0000, 0x0100, 0x0200, 0xFC00, 0xFF00)
"""Bits 8 to 15 of the controlword: they never change the state."""
SPEED = 20_000
RAMPS = {oracle.SLOW_DOWN: 40_000, oracle.QUICK: 200_000, oracle.HARDEST: 2_000_000}
BRAKING = {oracle.OFF: 0, oracle.SLOW_DOWN: 500, oracle.QUICK: 100, oracle.HARDEST: 10}
"""SPEED / ramp, in ms."""
SETTLED = 60
"""ms in which the axis has caught up with its demand."""


def bench_in(state: str, mode: int = 0, *, held_reset: bool = False) -> Bench:
    """A drive in a state. It stays there. held_reset: bit 7 of the last controlword is 1."""
    bench = Bench(DriveSettings(self_test=SECOND if state == NOT_READY else 0))
    bench.preset(0x605A, 6)
    bench.preset(0x605B, 0)
    bench.preset(0x605C, 0)
    last = 0x80 if held_reset else 0
    if state == NOT_READY:
        bench.put(0x6040, last)
    elif state == FAULT:
        bench.put(0x6040, last)
        bench.drive.raise_fault(0x5000, bench.now)
    else:
        bench.write(0x6060, 3 if state == REACTION else mode)
        for word in {oracle.READY: (6,), oracle.SWITCHED_ON: (6, 7), DISABLED: ()}.get(state, (6, 7, 0x0F)):
            bench.write(0x6040, word)
        if state == REACTION:
            bench.write(0x60FF, SPEED)
            bench.run(500)
        if state == QUICK_STOP:
            bench.write(0x6040, 0x02)
        bench.put(0x6040, bench.read(0x6040) | last)
        if state == REACTION:
            bench.drive.raise_fault(0x5000, bench.now)
    assert shown(bench) == state
    bench.events()
    return bench


def shown(bench: Bench) -> str:
    return oracle.state_of(bench.read(0x6041))


@pytest.mark.thorough(3)
@pytest.mark.parametrize("held_reset", [False, True], ids=["", "bit 7 held"])
@pytest.mark.parametrize("state", oracle.STATES)
def test_each_state_with_each_controlword(state: str, held_reset: bool) -> None:
    for word in range(0x100):
        bench = bench_in(state, held_reset=held_reset)
        before = bench.read(0x6040)
        expected = oracle.walk(state, word, before)
        bench.put(0x6040, word | OTHER_BITS[word % 5])
        assert (shown(bench), bench.transitions()) == expected, f"0x{word:04X} after 0x{before:04X}"


@pytest.mark.thorough(3)
@pytest.mark.parametrize("mode", MODES)
def test_no_mode_changes_the_state_machine(mode: int) -> None:
    """Each mode uses bits 4, 5, 6, 8 and 9 in its own way; the state depends on none of them."""
    for word in (*range(0, 0x80, 7), *(bits << 4 | low for bits in range(8) for low in (0x02, 0x06, 0x07, 0x0F))):
        for other in OTHER_BITS:
            bench = bench_in(ENABLED, mode)
            bench.put(0x6040, word | other)
            assert (shown(bench), bench.transitions()) == oracle.walk(ENABLED, word, 0x0F), f"0x{word | other:04X}"


def test_power_on_is_transitions_0_and_1() -> None:
    bench = Bench(DriveSettings(self_test=100 * MILLISECOND))
    assert (shown(bench), bench.transitions()) == (NOT_READY, [0])
    bench.run(100)
    assert (shown(bench), bench.transitions()) == (DISABLED, [1])


@pytest.mark.parametrize("state", [state for state in oracle.STATES if state not in (REACTION, FAULT)])
def test_a_fault_is_transitions_13_and_14_from_each_state(state: str) -> None:
    bench = bench_in(state)
    bench.drive.raise_fault(0x5000, bench.now)
    bench.run(SETTLED)
    assert (shown(bench), bench.transitions()) == (FAULT, [13, 14])


@pytest.mark.parametrize("state", oracle.STATES)
def test_each_statusword_shows_its_state_and_remote(state: str) -> None:
    word = bench_in(state).read(0x6041)
    assert [name for name, pattern in oracle.STATUSWORDS.items() if oracle.fits(word, pattern)] == [state]
    assert bool(word & 0x0200) is (state != NOT_READY)
    assert bool(word & 0x0010) is (state in (oracle.SWITCHED_ON, ENABLED, QUICK_STOP, REACTION))


# ---- option codes ----

CAUSES: dict[int, Callable[[Bench], object]] = {
    0x605A: lambda bench: bench.write(0x6040, 0x02),
    0x605B: lambda bench: bench.write(0x6040, 0x06),
    0x605C: lambda bench: bench.write(0x6040, 0x07),
    0x605D: lambda bench: bench.write(0x6040, 0x010F),
    0x605E: lambda bench: bench.drive.raise_fault(0x5000, bench.now),
}
CASES = [(index, value) for index, options in OPTIONS.items() for value in options]


def enabled(mode: int = 3) -> Bench:
    """A drive in Operation enabled, with the RAMPS."""
    bench = Bench(DriveSettings(position=0))
    for index, rate in RAMPS.items():
        bench.write(index, rate)
    bench.write(0x6060, mode)
    bench.control(0x06, 0x07, 0x0F)
    bench.events()
    return bench


def moving(mode: int) -> Bench:
    """The same, at SPEED."""
    bench = enabled(mode)
    match mode:
        case 1:
            bench.write(0x607A, 10**9)
            bench.write(0x6081, SPEED)
            bench.write(0x6040, 0x1F)
        case 3:
            bench.write(0x60FF, SPEED)
        case 6:
            bench.write(0x6098, 17)
            bench.write(0x6099, SPEED, 1)
            bench.write(0x6040, 0x1F)
    bench.run(1000)
    assert abs(bench.read(0x606B)) == SPEED
    return bench


def stands(bench: Bench) -> bool:
    return bench.read(0x606B) == 0


def assert_stops(bench: Bench, stop: Stop) -> None:
    """It brakes in `brakes_in` for exactly its ramp, and ends in `ends`."""
    if braking := BRAKING[stop.ramp]:
        bench.run(braking - 1)
        assert shown(bench) == stop.brakes_in
        assert not stands(bench)
        assert bench.read(0x6041) & 0x0400 == 0
        bench.run(1.1)
    assert stands(bench)
    assert shown(bench) == stop.ends
    assert bench.transitions() == stop.numbers
    bench.run(1000)
    assert stands(bench)
    assert (shown(bench), bench.transitions()) == (stop.ends, [])


@pytest.mark.thorough(3)
@pytest.mark.parametrize("mode", [1, 3, 6])
@pytest.mark.parametrize(("index", "value"), CASES, ids=lambda number: f"{number:X}")
def test_each_option_code_of_an_axis_that_moves(index: int, value: int, mode: int) -> None:
    bench = moving(mode)
    bench.write(index, value)
    CAUSES[index](bench)
    assert_stops(bench, OPTIONS[index][value])


@pytest.mark.parametrize(("index", "value"), CASES, ids=lambda number: f"{number:X}")
def test_each_option_code_of_an_axis_that_stands(index: int, value: int) -> None:
    bench = enabled()
    bench.write(index, value)
    CAUSES[index](bench)
    stop = OPTIONS[index][value]
    assert (shown(bench), bench.transitions(), stands(bench)) == (stop.ends, stop.numbers, True)


@pytest.mark.parametrize("index", OPTIONS, ids=lambda number: f"{number:X}")
def test_no_other_option_code_can_be_written(index: int) -> None:
    bench = Bench()
    for value in range(-20, 20):
        assert (bench.drive.check_write(index, 0, value) is None) is (value in OPTIONS[index])


@pytest.mark.parametrize("value", oracle.ABORT_CONNECTION_COMMANDS)
@pytest.mark.parametrize("state", [DISABLED, oracle.READY, oracle.SWITCHED_ON, ENABLED, QUICK_STOP, FAULT])
def test_a_lost_connection_in_each_state(state: str, value: int) -> None:
    bench = bench_in(state)
    bench.write(0x6007, value)
    bench.drive.connection_lost(bench.now, 0x8130)
    bench.run(SETTLED)
    meaning = oracle.ABORT_CONNECTION_COMMANDS[value]
    if meaning == "fault":
        expected = (FAULT, [] if state == FAULT else [13, 14])
    else:
        there, number = oracle.ARCS.get((state, meaning), (state, 0))
        expected = (there, [number] if number else [])
    assert (shown(bench), bench.transitions()) == expected


@pytest.mark.parametrize(
    ("value", "stop"),
    [
        (1, Stop(oracle.QUICK, FAULT, [13, 14], REACTION)),
        (2, Stop(oracle.OFF, DISABLED, [9])),
        (3, Stop(oracle.QUICK, DISABLED, [11, 12], QUICK_STOP)),
    ],
)
def test_a_lost_connection_of_an_axis_that_moves(value: int, stop: Stop) -> None:
    bench = moving(3)
    bench.write(0x6007, value)
    bench.drive.connection_lost(bench.now, 0x8130)
    assert_stops(bench, stop)


@pytest.mark.parametrize("mode", [1, 3, 6])
def test_a_halt_ends_with_its_bit_and_the_axis_goes_on(mode: int) -> None:
    bench = moving(mode)
    bench.write(0x6040, bench.read(0x6040) | 0x0100)
    bench.run(BRAKING[oracle.SLOW_DOWN] + SETTLED)
    assert stands(bench)
    assert bench.has(10)
    bench.write(0x6040, bench.read(0x6040) & ~0x0100)
    bench.run(1000)
    assert bench.drive.state is State.OPERATION_ENABLED
    assert not stands(bench)


# ---- the product's tables, which both sides use ----


def test_the_table_of_transitions_is_that_of_the_standard() -> None:
    words = {name: states.Command(states.command_of(word, 0)) for name, word in WORDS.items()}
    ours = {arc for arc in states.TRANSITIONS.items() if isinstance(arc[0][1], states.Command)}
    extra = ((State.READY_TO_SWITCH_ON, states.Command.ENABLE_OPERATION), (State.SWITCHED_ON, 3))  # of 0x0F: 3, then 4
    theirs = {((State(here), words[given]), (State(there), number)) for (here, given), (there, number) in oracle.ARCS.items()}
    assert ours == theirs | {extra}
    assert {number for _, number in states.TRANSITIONS.values()} == set(range(17))


WORDS = {
    "shutdown": 0x06,
    "switch on or disable operation": 0x07,
    "enable operation": 0x0F,
    "disable voltage": 0x00,
    "quick stop": 0x02,
    oracle.RESET: 0x80,
}


def test_a_drive_that_stands_needs_no_time() -> None:
    for state in oracle.STATES:
        bench = bench_in(state)
        bench.run(2000)
        assert bench.drive.deadline == NEVER


def test_each_option_code_has_a_name() -> None:
    named = {mux >> 8: set(names) for mux, names in OPTION_CODES.items()}
    assert named == {index: set(options) for index, options in OPTIONS.items()} | {0x6007: set(oracle.ABORT_CONNECTION_COMMANDS)}
    dictionary = with_drive_names(DICTIONARIES[Shape.STANDARD])
    for mux, names in OPTION_CODES.items():
        for value, name in names.items():
            assert dictionary.constant_value(mux, name) == value
            assert dictionary.names_of(mux, value) == (name,)


def test_each_mode_has_its_name_and_its_bits() -> None:
    assert {int(mode) for mode in Mode} == {0, *oracle.MODES}
    for mode, name in oracle.MODES.items():
        assert mode_name(mode).endswith(f"({name})")
        assert supported_modes(1 << (mode - 1)) == (mode,)
        for bit in (12, 13):
            is_named = describe_status(0x0237, mode) != describe_status(0x0237 | 1 << bit, mode)
            assert is_named is (bit in oracle.MODE_STATUS_BITS[mode]), f"{name}, bit {bit}"
