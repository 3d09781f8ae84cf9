"""CiA 402 tables: states, commands, transitions, modes, and the way that a master finds through them."""

import pytest

from canopen_proto.drives.cia402.modes import (
    HOMING_BITS,
    HomingStatus,
    Mode,
    describe_command,
    describe_status,
    homing_status,
    mode_name,
    supported,
    supported_modes,
)
from canopen_proto.drives.cia402.states import (
    COMMANDS,
    STATUS_PATTERNS,
    TARGETS,
    TRANSITIONS,
    Command,
    Occurrence,
    State,
    command_of,
    next_command,
    state_of,
)
from canopen_proto.machine import LocalProtocolError

REAL_STATES = [state for state in State if state is not State.UNKNOWN]


def test_each_statusword_fits_at_most_one_pattern() -> None:
    for statusword in range(0x10000):
        fitting = [state for state, (mask, value) in STATUS_PATTERNS.items() if statusword & mask == value]
        assert [state_of(statusword)] == (fitting or [State.UNKNOWN])


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        (0x0000, State.NOT_READY_TO_SWITCH_ON),
        (0x0240, State.SWITCH_ON_DISABLED),
        (0x0270, State.SWITCH_ON_DISABLED),
        (0x0231, State.READY_TO_SWITCH_ON),
        (0x0233, State.SWITCHED_ON),
        (0x8637, State.OPERATION_ENABLED),
        (0x0217, State.QUICK_STOP_ACTIVE),
        (0x000F, State.FAULT_REACTION_ACTIVE),
        (0x0008, State.FAULT),
        (0x0238, State.FAULT),
        (0x0201, State.UNKNOWN),  # ready to switch on, but with the quick stop bit: no fault
        (0x004F, State.UNKNOWN),
        (0x12340, State.SWITCH_ON_DISABLED),  # longer than a statusword: the low bits count, nothing raises
    ],
)
def test_statuswords_as_drives_send_them(statusword: int, state: State) -> None:
    assert state_of(statusword) is state


def test_every_controlword_is_exactly_one_command() -> None:
    for word in range(256):
        fitting = [command for command, (mask, value) in COMMANDS.items() if word & mask == value]
        assert fitting == [command_of(word, previous=0)]


@pytest.mark.parametrize(
    ("word", "command"),
    [
        (0x0006, Command.SHUTDOWN),
        (0x000E, Command.SHUTDOWN),
        (0x0007, Command.SWITCH_ON),
        (0x000F, Command.ENABLE_OPERATION),
        (0x001F, Command.ENABLE_OPERATION),
        (0x010F, Command.ENABLE_OPERATION),
        (0x0000, Command.DISABLE_VOLTAGE),
        (0x0001, Command.DISABLE_VOLTAGE),  # the manual's disable_voltage
        (0x000D, Command.DISABLE_VOLTAGE),
        (0x0002, Command.QUICK_STOP),
        (0x000B, Command.QUICK_STOP),
        (0x0080, Command.FAULT_RESET),
        (0x008F, Command.FAULT_RESET),
    ],
)
def test_controlwords_as_masters_send_them(word: int, command: Command) -> None:
    assert command_of(word, previous=0x0000) is command


def test_a_fault_reset_is_a_rising_edge() -> None:
    assert command_of(0x0080, previous=0x000F) is Command.FAULT_RESET
    assert command_of(0x0080, previous=0x0080) is None
    assert command_of(0x0086, previous=0x0080) is None
    assert command_of(0x0006, previous=0x0086) is Command.SHUTDOWN


def test_the_typical_words_are_their_commands_and_disable_operation_is_switch_on() -> None:
    for command in Command:
        assert command_of(int(command), previous=0) is command
    assert Command.DISABLE_OPERATION is Command.SWITCH_ON


# Drawn from the figure of the standard, not from the table under test: number -> (from, to).
FIGURE = {
    0: {(State.UNKNOWN, State.NOT_READY_TO_SWITCH_ON)},
    1: {(State.NOT_READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED)},
    2: {(State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON)},
    3: {(State.READY_TO_SWITCH_ON, State.SWITCHED_ON)},
    4: {(State.SWITCHED_ON, State.OPERATION_ENABLED)},
    5: {(State.OPERATION_ENABLED, State.SWITCHED_ON)},
    6: {(State.SWITCHED_ON, State.READY_TO_SWITCH_ON)},
    7: {(State.READY_TO_SWITCH_ON, State.SWITCH_ON_DISABLED)},
    8: {(State.OPERATION_ENABLED, State.READY_TO_SWITCH_ON)},
    9: {(State.OPERATION_ENABLED, State.SWITCH_ON_DISABLED)},
    10: {(State.SWITCHED_ON, State.SWITCH_ON_DISABLED)},
    11: {(State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE)},
    12: {(State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)},
    13: {(state, State.FAULT_REACTION_ACTIVE) for state in REAL_STATES if "fault" not in state},
    14: {(State.FAULT_REACTION_ACTIVE, State.FAULT)},
    15: {(State.FAULT, State.SWITCH_ON_DISABLED)},
    16: {(State.QUICK_STOP_ACTIVE, State.OPERATION_ENABLED)},
}


def test_the_table_has_the_arcs_of_the_figure_and_no_other() -> None:
    arcs: dict[int, set[tuple[State, State]]] = {}
    for (state, _), (following, number) in TRANSITIONS.items():
        arcs.setdefault(number, set()).add((state, following))
    assert arcs == FIGURE


def test_automatic_transitions_have_occurrences_and_the_others_commands() -> None:
    automatic = {number for (_, trigger), (_, number) in TRANSITIONS.items() if isinstance(trigger, Occurrence)}
    commanded = {number for (_, trigger), (_, number) in TRANSITIONS.items() if isinstance(trigger, Command)}
    assert automatic == {0, 1, 12, 13, 14}
    assert commanded == {2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 15, 16}


@pytest.mark.parametrize(
    ("target", "words"),
    [
        # current: not ready, disabled, ready, on, enabled, quick stop, fault reaction, fault; None is "wait"
        (State.SWITCH_ON_DISABLED, [None, None, 0x00, 0x00, 0x00, 0x00, None, 0x80]),
        (State.READY_TO_SWITCH_ON, [None, 0x06, None, 0x06, 0x06, 0x00, None, 0x80]),
        (State.SWITCHED_ON, [None, 0x06, 0x07, None, 0x07, 0x00, None, 0x80]),
        (State.OPERATION_ENABLED, [None, 0x06, 0x07, 0x0F, None, 0x0F, None, 0x80]),
    ],
)
def test_the_next_command_from_each_state(target: State, words: list[int | None]) -> None:
    assert [next_command(current, target) for current in REAL_STATES] == words
    assert next_command(State.UNKNOWN, target) is None


def test_the_way_from_a_fault_to_operation() -> None:
    state, words = State.FAULT, []
    while (command := next_command(state, State.OPERATION_ENABLED)) is not None:
        words.append(command)
        state = TRANSITIONS[state, command][0]
    assert state is State.OPERATION_ENABLED
    assert words == [0x80, 0x06, 0x07, 0x0F]


def test_no_way_leads_through_operation_enabled() -> None:
    for current in REAL_STATES:
        for target in TARGETS:
            if target in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
                continue
            state = current
            while (command := next_command(state, target)) is not None:
                state = TRANSITIONS[state, command][0]
                assert state is not State.OPERATION_ENABLED


def test_quick_stop_is_reached_from_operation_enabled_only() -> None:
    assert next_command(State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE) is Command.QUICK_STOP
    assert next_command(State.QUICK_STOP_ACTIVE, State.QUICK_STOP_ACTIVE) is None
    for state in (State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.SWITCH_ON_DISABLED, State.FAULT):
        with pytest.raises(LocalProtocolError, match="quick stop leads there from operation enabled"):
            next_command(state, State.QUICK_STOP_ACTIVE)


@pytest.mark.parametrize("target", [State.FAULT, State.NOT_READY_TO_SWITCH_ON, State.FAULT_REACTION_ACTIVE, State.UNKNOWN])
def test_a_state_that_cannot_be_commanded_is_refused(target: State) -> None:
    with pytest.raises(LocalProtocolError, match="cannot be commanded"):
        next_command(State.SWITCHED_ON, target)


def test_supported_modes_as_drives_report_them() -> None:
    schunk, kollmorgen = 0x43, 0xE5
    assert supported_modes(schunk) == (Mode.PROFILE_POSITION, Mode.VELOCITY, Mode.INTERPOLATED_POSITION)
    assert not supported(schunk, Mode.HOMING)
    assert supported_modes(kollmorgen) == (1, 3, 6, 7, 8)
    assert supported_modes(0x780) == (8, 9, 10, 11)  # 11 is newer than our table: a number all the same
    assert not supported(0xFFFFFFFF, 0)
    assert not supported(0xFFFFFFFF, -1)
    assert not supported(0xFFFFFFFF, 17)


def test_names_of_modes_never_fail() -> None:
    assert mode_name(Mode.INTERPOLATED_POSITION) == "interpolated position (ip)"
    assert mode_name(0) == "no mode"
    assert mode_name(-3) == "manufacturer’s mode -3"
    assert mode_name(5) == "reserved mode 5"


@pytest.mark.parametrize(
    ("statusword", "status"),
    [
        (0x0237, HomingStatus.IN_PROGRESS),  # as a Kollmorgen AKD sends it while it homes
        (0x1637, HomingStatus.COMPLETE),  # and when it is done
        (0x0637, HomingStatus.INTERRUPTED),
        (0x1237, HomingStatus.ATTAINED),
        (0x2237, HomingStatus.ERROR_MOVING),
        (0x2637, HomingStatus.ERROR_STOPPED),
        (0x3637, HomingStatus.RESERVED),
    ],
)
def test_homing_status(statusword: int, status: HomingStatus) -> None:
    assert homing_status(statusword) is status


def test_homing_bits_are_the_other_way_round() -> None:
    for status, bits in HOMING_BITS.items():
        assert homing_status(bits) is status


def test_statuswords_for_people() -> None:
    assert describe_status(0x1637, Mode.HOMING) == ("operation enabled", "voltage enabled", "remote", "homing is complete")
    assert describe_status(0x0237, Mode.HOMING)[-1] == "homing is in progress"
    assert describe_status(0x0240, Mode.HOMING) == ("switch on disabled", "remote")  # homed, and without power since
    assert describe_status(0x1A37, Mode.INTERPOLATED_POSITION) == (
        "operation enabled",
        "voltage enabled",
        "remote",
        "internal limit active",
        "interpolation active",
    )
    assert describe_status(0x3437, Mode.PROFILE_POSITION)[-3:] == ("target reached", "set-point acknowledged", "following error")
    assert describe_status(0x3008) == ("fault",)
    assert describe_status(0x0081) == ("unknown state 0x0081", "warning")


def test_controlwords_in_words() -> None:
    assert describe_command(0x0000) == ("disable voltage",)
    assert describe_command(0x0006) == ("shutdown",)
    assert describe_command(0x0002, Mode.PROFILE_POSITION) == ("quick stop",)
    assert describe_command(0x003F) == ("enable operation", "bit 4", "bit 5")
    assert describe_command(0x033F, Mode.PROFILE_POSITION) == (
        "enable operation", "new set-point", "change immediately", "halt", "change on set-point",
    )  # fmt: skip
    assert describe_command(0x011F, Mode.HOMING) == ("enable operation", "homing", "halt")
    assert describe_command(0x80FF)[0] == "fault reset"
    assert describe_command(0x8007, Mode.CYCLIC_SYNCHRONOUS_POSITION)[1:] == ("bit 15",)
    assert all(describe_command(word) for word in range(0x10000))
