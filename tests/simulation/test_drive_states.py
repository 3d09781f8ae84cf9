"""The simulated drive's state machine: each state with each command, option codes, faults, lost connections, and any sequence."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary.values import Values
from canopen_proto.drives.cia402.states import TRANSITIONS, State, command_of
from canopen_proto.machine import MILLISECOND, NEVER, Outbox
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.drive import Drive
from canopen_proto.simulation.drive.events import DriveFault, DriveFaultCleared, DriveStateChanged, StatuswordChanged
from canopen_proto.simulation.drive.settings import DriveSettings
from tests.simulation.drive_bench import NODE_ID, Bench

REACHABLE = [state for state in State if state not in (State.UNKNOWN, State.NOT_READY_TO_SWITCH_ON)]
WORDS = [0x00, 0x01, 0x02, 0x06, 0x07, 0x0F, 0x80, 0x86]


def test_power_on_goes_through_transitions_0_and_1() -> None:
    bench = Bench()
    assert bench.events() == [
        DriveStateChanged(NODE_ID, State.UNKNOWN, State.NOT_READY_TO_SWITCH_ON, 0),
        DriveStateChanged(NODE_ID, State.NOT_READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED, 1),
    ]
    assert bench.state is State.SWITCH_ON_DISABLED
    assert bench.drive.deadline == NEVER


def test_a_self_test_takes_its_time_and_hears_no_command() -> None:
    bench = Bench(DriveSettings(self_test=200 * MILLISECOND))
    assert bench.state is State.NOT_READY_TO_SWITCH_ON
    bench.run(199)
    bench.put(0x6040, 0x06)
    assert bench.state is State.NOT_READY_TO_SWITCH_ON
    bench.run(1)
    assert bench.state is State.SWITCH_ON_DISABLED
    assert bench.control(0x06) is State.READY_TO_SWITCH_ON


def test_before_power_on_nothing_happens_and_nothing_raises() -> None:
    drive = Drive(Outbox(), NODE_ID, Values(drive_dictionary(), NODE_ID), DriveSettings())
    drive.written(0x6040, 0, 5)
    drive.on_sync(6)
    drive.connection_lost(7, 0x8130)
    drive.raise_fault(0x5000, 8)
    drive.block(True, 9)
    drive.refresh(10)
    drive.handle_timeout(11)
    assert drive.state is State.UNKNOWN
    assert not [each for each in drive.out.events if not isinstance(each, StatuswordChanged)]


@pytest.mark.parametrize("state", REACHABLE)
@pytest.mark.parametrize("word", WORDS)
def test_each_state_with_each_command(state: State, word: int) -> None:
    bench = Bench()
    bench.preset(0x605A, 6)  # stay in Quick stop active, so that transition 16 is possible
    bench.preset(0x605B, 0)
    bench.preset(0x605C, 0)
    bench.bring_to(state)
    bench.events()
    bench.control(word)
    command = command_of(word, previous=0x0F)
    expected, arcs = state, []
    while command is not None and (arc := TRANSITIONS.get((expected, command))) is not None:
        expected = arc[0]
        arcs.append(arc[1])
    assert bench.transitions() == arcs
    assert bench.state is expected


def test_switch_on_and_enable_in_one_word_is_two_transitions() -> None:
    bench = Bench()
    bench.control(0x06)
    bench.events()
    assert bench.control(0x0F) is State.OPERATION_ENABLED
    assert bench.transitions() == [3, 4]


def test_the_statusword_of_each_state() -> None:
    words = {
        State.SWITCH_ON_DISABLED: 0x0240,
        State.READY_TO_SWITCH_ON: 0x0221,
        State.SWITCHED_ON: 0x0233,
        State.FAULT: 0x0208,
    }
    for state, word in words.items():
        bench = Bench()
        bench.bring_to(state)
        assert bench.read(0x6041) == word


def test_a_word_that_only_stands_commands_nothing() -> None:
    bench = Bench()
    bench.preset(0x605A, 2)
    bench.bring_to(State.QUICK_STOP_ACTIVE)
    bench.control(0x06)  # means nothing in Quick stop active, but it stands ...
    bench.run(1000)
    assert bench.state is State.SWITCH_ON_DISABLED  # ... and does not act when the state has changed,
    assert bench.control(0x06) is State.READY_TO_SWITCH_ON  # but when it is written again


# ---- faults ----


def test_fault_and_reset_on_the_rising_edge_only() -> None:
    bench = Bench()
    bench.control(0x06, 0x07, 0x0F)
    bench.events()
    bench.drive.raise_fault(0x4310, bench.now)
    assert bench.events() == [
        DriveFault(NODE_ID, 0x4310, 0x09),  # generic and temperature
        DriveStateChanged(NODE_ID, State.OPERATION_ENABLED, State.FAULT_REACTION_ACTIVE, 13),
        DriveStateChanged(NODE_ID, State.FAULT_REACTION_ACTIVE, State.FAULT, 14),
    ]
    assert bench.read(0x603F) == 0x4310
    assert bench.control(0x06, 0x07, 0x0F) is State.FAULT
    assert bench.control(0x80) is State.SWITCH_ON_DISABLED
    assert bench.events()[-1] == DriveFaultCleared(NODE_ID, 0x4310)
    assert bench.read(0x603F) == 0
    bench.drive.raise_fault(0x4310, bench.now)
    assert bench.control(0x80) is State.FAULT  # the bit stood: no edge
    assert bench.control(0x00, 0x80) is State.SWITCH_ON_DISABLED


def test_a_fault_whose_cause_lasts_cannot_be_reset() -> None:
    bench = Bench()
    bench.drive.raise_fault(0x3210, bench.now, lasting=True)
    assert bench.control(0x00, 0x80) is State.FAULT
    bench.drive.reset(bench.now)
    assert bench.state is State.FAULT  # power-on does not help either
    bench.drive.end_fault(0x3210)
    assert bench.control(0x00, 0x80) is State.SWITCH_ON_DISABLED


def test_a_second_fault_is_told_and_the_same_again_is_not() -> None:
    bench = Bench()
    bench.drive.raise_fault(0x3210, bench.now)
    bench.drive.raise_fault(0x4310, bench.now)
    bench.drive.raise_fault(0x3210, bench.now)
    assert [each.error_code for each in bench.reported(DriveFault)] == [0x3210, 0x4310]
    assert bench.read(0x603F) == 0x4310
    bench.control(0x80)
    assert [each.error_code for each in bench.reported(DriveFaultCleared)] == [0x3210, 0x4310]


@pytest.mark.parametrize(("option", "braking"), [(0, 0.0), (1, 200.0), (2, 50.0), (3, 0.1), (4, 0.1)])
def test_fault_reaction_option_code(option: int, braking: float) -> None:
    bench = Bench()
    bench.preset(0x605E, option)
    bench.preset(0x60C6, 1_000_000_000)
    bench.bring_to(State.OPERATION_ENABLED)  # at 20000 units/s; 6084h = 100000, 6085h = 400000
    bench.drive.raise_fault(0x5000, bench.now)
    if braking:
        assert bench.state is State.FAULT_REACTION_ACTIVE
        bench.run(braking - 0.09)
        assert bench.state is State.FAULT_REACTION_ACTIVE
        bench.run(0.09)
    assert bench.state is State.FAULT
    assert bench.read(0x606C) == 0


# ---- quick stop, shutdown, disable operation ----


@pytest.mark.parametrize(
    ("option", "braking", "stays"),
    [
        (0, 0.0, False),
        (1, 200.0, False),
        (2, 50.0, False),
        (3, 0.1, False),
        (4, 0.1, False),
        (5, 200.0, True),
        (6, 50.0, True),
        (7, 0.1, True),
        (8, 0.1, True),
    ],
)
def test_quick_stop_option_code(option: int, braking: float, stays: bool) -> None:
    bench = Bench()
    bench.preset(0x605A, option)
    bench.preset(0x60C6, 1_000_000_000)
    bench.bring_to(State.OPERATION_ENABLED)
    bench.events()
    bench.control(0x02)
    where = bench.position
    if braking:
        assert bench.state is State.QUICK_STOP_ACTIVE
        assert not bench.has(5)
        bench.run(braking - 0.09)
        assert bench.state is State.QUICK_STOP_ACTIVE
        bench.run(0.09)
    if stays:
        bench.run(500)
        assert bench.state is State.QUICK_STOP_ACTIVE
        assert bench.has(10)  # it stands
        assert bench.control(0x0F) is State.OPERATION_ENABLED
        assert bench.transitions() == [11, 16]
    else:
        assert bench.state is State.SWITCH_ON_DISABLED
        assert bench.transitions() == [11, 12]
    assert bench.position - where <= 20_000 * braking / 1000 / 2 + 101  # half the time at full speed, and the lag


def test_transition_16_is_refused_where_the_drive_will_not_stay() -> None:
    bench = Bench()
    bench.preset(0x605A, 1)
    bench.bring_to(State.QUICK_STOP_ACTIVE)
    assert bench.control(0x0F) is State.QUICK_STOP_ACTIVE
    bench.run(1000)
    assert bench.state is State.SWITCH_ON_DISABLED


@pytest.mark.parametrize(
    ("index", "word", "state", "number"),
    [(0x605B, 0x06, State.READY_TO_SWITCH_ON, 8), (0x605C, 0x07, State.SWITCHED_ON, 5)],
)
def test_shutdown_and_disable_operation_option_codes(index: int, word: int, state: State, number: int) -> None:
    bench = Bench()
    bench.preset(index, 0)
    bench.bring_to(State.OPERATION_ENABLED)
    assert bench.control(word) is state
    assert bench.read(0x606C) == 0

    bench = Bench()
    bench.preset(index, 1)
    bench.bring_to(State.OPERATION_ENABLED)
    bench.events()
    assert bench.control(word) is State.OPERATION_ENABLED  # it goes down the ramp first
    bench.run(100)
    assert bench.control(word) is State.OPERATION_ENABLED  # as each PDO says again
    bench.run(99)
    assert bench.state is State.OPERATION_ENABLED
    bench.run(1)
    assert bench.state is state
    assert bench.transitions() == [number]


def test_a_shutdown_that_is_taken_back_leaves_the_drive_enabled_and_standing() -> None:
    bench = Bench()
    bench.bring_to(State.OPERATION_ENABLED)
    bench.control(0x06)
    bench.run(50)
    assert bench.control(0x0F) is State.OPERATION_ENABLED
    bench.preset(0x60FF, 0)
    bench.put(0x60FF, 0)
    bench.run(500)
    assert bench.state is State.OPERATION_ENABLED
    assert bench.read(0x606C) == 0


def test_other_commands_overtake_a_shutdown_ramp() -> None:
    bench = Bench()
    bench.bring_to(State.OPERATION_ENABLED)
    bench.control(0x06)
    assert bench.control(0x07) is State.OPERATION_ENABLED
    bench.run(500)
    assert bench.state is State.SWITCHED_ON  # the later one counts

    bench = Bench()
    bench.bring_to(State.OPERATION_ENABLED)
    bench.control(0x06)
    assert bench.control(0x02) is State.QUICK_STOP_ACTIVE

    bench = Bench()
    bench.bring_to(State.OPERATION_ENABLED)
    bench.control(0x06)
    assert bench.control(0x00) is State.SWITCH_ON_DISABLED


# ---- connection lost ----


@pytest.mark.parametrize(
    ("option", "from_enabled", "from_switched_on"),
    [
        (0, [], []),
        (1, [13, 14], [13, 14]),
        (2, [9], [10]),
        (3, [11, 12], [10]),
    ],
)
def test_abort_connection_option_code(option: int, from_enabled: list[int], from_switched_on: list[int]) -> None:
    for words, expected in (([0x06, 0x07, 0x0F], from_enabled), ([0x06, 0x07], from_switched_on)):
        bench = Bench()
        bench.write(0x6007, option)
        bench.control(*words)
        bench.events()
        bench.drive.connection_lost(bench.now, 0x8130)
        assert bench.transitions() == expected
        bench.drive.connection_lost(bench.now, 0x8130)  # NMT stop, and the heartbeat is lost too: once is enough
        bench.drive.connection_lost(bench.now, 0x8100)
        bench.run(100)
        assert [each for each in bench.transitions() if each != 9] == []


@pytest.mark.parametrize("option", [0, 1, 2, 3])
def test_a_late_drive_obeys_no_command_from_before_its_connection_was_lost(option: int) -> None:
    """It would go on in that mode with nobody to stop it. With 0 it goes on in any case: that is what it was told."""
    bench = Bench(DriveSettings(reaction=200 * MILLISECOND))
    bench.write(0x6007, option)
    bench.write(0x60FF, 20_000)
    bench.write(0x6060, 3)
    for word in (0x06, 0x07, 0x0F):
        bench.write(0x6040, word)
    bench.run(150)
    bench.drive.connection_lost(bench.now, 0x8100)
    bench.run(1000)
    assert (bench.state is State.OPERATION_ENABLED) is (option == 0)
    assert bench.read(0x6061) == 3


def test_a_lost_connection_as_a_fault_has_its_own_error_code() -> None:
    bench = Bench()
    bench.write(0x6007, 1)
    bench.drive.connection_lost(bench.now, 0x8130)
    assert bench.reported(DriveFault) == [DriveFault(NODE_ID, 0x8130, 0x11)]
    bench = Bench()
    bench.write(0x6007, 1)
    bench.drive.connection_lost(bench.now, 0x8100)
    assert bench.reported(DriveFault) == [DriveFault(NODE_ID, 0x8100, 0x11)]


# ---- what may be written ----


def test_what_the_drive_holds_may_be_written_back_though_it_lacks_it() -> None:
    """A file gave it that value; a backup that is restored must not fail of it."""
    bench = Bench()
    for key, value in ((0x6060_00, -1), (0x6098_00, 15)):
        bench.preset(key >> 8, value)
        assert bench.drive.check_write(key >> 8, 0, value) is None
        assert bench.drive.check_write(key >> 8, 0, value + 1) is (None if value == -1 else AbortCode.INVALID_VALUE)  # 0: no mode


@pytest.mark.parametrize(
    ("index", "subindex", "value", "verdict"),
    [
        (0x6060, 0, 1, None),
        (0x6060, 0, 0, None),
        (0x6060, 0, 2, None),
        (0x6060, 0, 11, AbortCode.INVALID_VALUE),  # cstca: not in 6502h
        (0x6060, 0, -1, AbortCode.INVALID_VALUE),
        (0x6098, 0, 33, None),
        (0x6098, 0, 36, AbortCode.INVALID_VALUE),
        (0x605A, 0, 8, None),
        (0x605A, 0, 9, AbortCode.INVALID_VALUE),
        (0x605D, 0, 0, AbortCode.INVALID_VALUE),
        (0x6086, 0, 3, None),
        (0x6086, 0, 1, AbortCode.INVALID_VALUE),  # sin² ramp
        (0x60A3, 0, 4, AbortCode.INVALID_VALUE),
        (0x60C2, 1, 0, AbortCode.INVALID_VALUE),
        (0x60C2, 2, -4, None),
        (0x60C2, 2, 1, AbortCode.INVALID_VALUE),
        (0x607A, 0, -(2**31), None),
        (0x1008, 0, "text", None),  # not the drive's business
    ],
)
def test_values_that_the_drive_lacks_are_refused(index: int, subindex: int, value: int | str, verdict: AbortCode | None) -> None:
    assert Bench().drive.check_write(index, subindex, value) == verdict


def test_a_mode_that_a_pdo_brings_and_the_drive_lacks_changes_nothing() -> None:
    bench = Bench()
    bench.enable(1)
    bench.put(0x6060, 11)
    assert bench.read(0x6061) == 1
    bench.put(0x6060, -7)
    assert bench.read(0x6061) == 1


def test_changing_the_mode_of_a_moving_axis_stops_it() -> None:
    bench = Bench()
    bench.bring_to(State.OPERATION_ENABLED)
    bench.write(0x6060, 0)
    assert bench.read(0x6061) == 0
    bench.run(400)
    assert bench.state is State.OPERATION_ENABLED
    assert bench.read(0x606C) == 0
    assert bench.drive.deadline == NEVER
