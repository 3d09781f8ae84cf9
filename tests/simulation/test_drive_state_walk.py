"""The master leads a drive from each state to each state, by SDO and by PDO, or says why not. The truth is cia402_oracle.py."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import pytest

from canopen_proto.dictionary import Direction
from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.steps import Procedure
from canopen_proto.simulation.drive.events import DriveStateChanged
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import Rig
from tests.simulation.cia402_oracle import (
    ARCS,
    DISABLED,
    ENABLED,
    FAULT,
    NOT_READY,
    QUICK_STOP,
    REACTION,
    READY,
    SWITCHED_ON,
)

SELF_TEST: Final = 300 * MILLISECOND
SPEED: Final = 20_000
RAMP: Final = 40_000
CODE: Final = 0x3210
MOVING = "operation enabled, and moving"
BRAKING = "quick stop active, and about to leave it"
STARTS = (NOT_READY, DISABLED, READY, SWITCHED_ON, ENABLED, MOVING, QUICK_STOP, BRAKING, REACTION, FAULT)
FAULTS = (REACTION, FAULT)
TARGETS = (DISABLED, READY, SWITCHED_ON, ENABLED, QUICK_STOP)
BY_ITSELF = {0, 1, 12, 13, 14}
"""The transitions that no command has to make."""


def rig_in(start: str, by_pdo: bool, axis: int = 0) -> Rig:
    """A master and a drive in a state; it has just got there."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(self_test=SELF_TEST if start == NOT_READY else 0), axis=axis)
    store = rig.drive.values.store
    store[objects.QUICK_STOP_DECELERATION] = store[objects.PROFILE_DECELERATION] = RAMP
    store[objects.QUICK_STOP_OPTION_CODE] = 2 if start == BRAKING else 6
    if by_pdo:
        rig.run(use_device_pdo(rig.remote, Direction.RPDO, 1))
        rig.run(use_device_pdo(rig.remote, Direction.TPDO, 2))
        rig.remote.enable_rpdo(1, rig.bus.now)
    rig.run(write(rig.axis.node, "0x6060", 3))
    if start in (MOVING, QUICK_STOP, BRAKING, REACTION):
        rig.run(write(rig.axis.node, "0x60FF", SPEED))
    words = {NOT_READY: (), DISABLED: (), FAULT: (), READY: (6,), SWITCHED_ON: (6, 7)}.get(start, (6, 7, 0x0F))
    for word in words:
        rig.run(write(rig.axis.node, "0x6040", word))
    if len(words) == 3:
        rig.bus.run(SECOND)
    if start in (QUICK_STOP, BRAKING):
        rig.run(write(rig.axis.node, "0x6040", 0x02))
    if start in FAULTS:
        rig.node.raise_fault(CODE, rig.bus.now, axis=axis)
    rig.bus.run(2 * MILLISECOND)
    assert str(rig.drive.state) == {MOVING: ENABLED, BRAKING: QUICK_STOP}.get(start, start)
    rig.bus.events.clear()
    return rig


def transitions(rig: Rig) -> list[int]:
    changes = [event for event in rig.bus.events if isinstance(event, DriveStateChanged)]
    others = {event.transition for event in changes if event.axis != rig.axis.number}
    assert others <= {1}, "the other axis of the node was led, too"
    return [event.transition for event in changes if event.axis == rig.axis.number]


def led(rig: Rig, procedure: Procedure[object]) -> str:
    """Run it; the state in which the drive is then, which the master knows, and in which it stays."""
    rig.run(procedure)
    state = rig.drive.state
    assert rig.axis.state is state
    rig.bus.run(2 * SECOND)
    rig.drive.refresh(rig.bus.now)
    assert rig.drive.state is state
    return str(state)


def stands(rig: Rig) -> bool:
    return rig.drive.values.store[objects.VELOCITY_DEMAND_VALUE] == 0


def can_be_led(start: str, target: str) -> bool:
    if start in FAULTS:
        return False
    return target != QUICK_STOP or start in (ENABLED, MOVING, QUICK_STOP, BRAKING)


@pytest.mark.thorough(3)
@pytest.mark.parametrize(("axis", "by_pdo"), [(0, False), (0, True), (1, False)])
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("start", STARTS)
def test_from_each_state_to_each_state(start: str, target: str, axis: int, by_pdo: bool) -> None:
    rig = rig_in(start, by_pdo, axis)
    procedure = drive.change_state(rig.axis, State(target))
    if can_be_led(start, target) and (start, target) != (BRAKING, QUICK_STOP):
        assert led(rig, procedure) == target
        if target not in (ENABLED, QUICK_STOP):
            assert stands(rig)
        used = transitions(rig)
        assert not {4, 16} & set(used) or target == ENABLED, "it gave power on its way"
        assert set(used) <= {number for _, number in ARCS.values()} | BY_ITSELF
        assert len(used) == len(set(used)), "it went a way twice"
    elif start == BRAKING and target == QUICK_STOP:
        rig.run(procedure)  # it is there for a moment
        rig.bus.run(2 * SECOND)
        assert rig.drive.state is State.SWITCH_ON_DISABLED
    elif start in FAULTS:
        with pytest.raises(drive.DriveInFaultError, match=f"{rig.axis.title} is in fault.*0x{CODE:04X}.*Try: "):
            rig.run(procedure)
    else:
        with pytest.raises(LocalProtocolError, match="a quick stop leads there from operation enabled, not from"):
            rig.run(procedure)


ENDS: dict[str, tuple[Callable[[Rig], Procedure[object]], dict[str, str]]] = {
    "quick stop": (
        lambda rig: drive.quick_stop(rig.axis),
        {ENABLED: QUICK_STOP, MOVING: QUICK_STOP, QUICK_STOP: QUICK_STOP},  # from all others: switch on disabled
    ),
    "shut down": (lambda rig: drive.shut_down(rig.axis), {REACTION: FAULT, FAULT: FAULT}),
    "engage brake": (
        lambda rig: drive.engage_brake(rig.axis),
        dict.fromkeys(STARTS, READY),
    ),
    "enable": (lambda rig: drive.enable(rig.axis), dict.fromkeys(STARTS, ENABLED)),
    "halt": (
        lambda rig: drive.halt(rig.axis),
        {
            READY: READY, SWITCHED_ON: SWITCHED_ON, ENABLED: ENABLED, MOVING: ENABLED, QUICK_STOP: QUICK_STOP, REACTION: FAULT,
            FAULT: FAULT,
        },
    ),
    "reset fault": (
        lambda rig: drive.reset_fault(rig.axis),
        {READY: READY, SWITCHED_ON: SWITCHED_ON, ENABLED: ENABLED, MOVING: ENABLED, QUICK_STOP: QUICK_STOP},
    ),
}  # fmt: skip
"""Procedure -> the state in which it leaves the drive, by the one in which it found it; where none stands: switch on disabled."""
REFUSES_FAULTS = ("quick stop", "engage brake", "enable")


@pytest.mark.thorough(3)
@pytest.mark.parametrize("by_pdo", [False, True])
@pytest.mark.parametrize("name", ENDS)
@pytest.mark.parametrize("start", STARTS)
def test_each_procedure_from_each_state(start: str, name: str, by_pdo: bool) -> None:
    rig = rig_in(start, by_pdo)
    make, ends = ENDS[name]
    if start in FAULTS and name in REFUSES_FAULTS:
        with pytest.raises(drive.DriveInFaultError, match=f"drive 5 is in fault.*0x{CODE:04X}.*Try: "):
            rig.run(make(rig))
        return
    if start == NOT_READY and name in ("halt", "reset fault"):  # they have nothing to do, and do not wait
        rig.run(make(rig))
        assert rig.drive.state is State.NOT_READY_TO_SWITCH_ON
        assert stands(rig)
        return
    if start == BRAKING and name in ("reset fault", "quick stop"):  # it brakes on
        rig.run(make(rig))
        rig.bus.run(2 * SECOND)
        assert rig.drive.state is State.SWITCH_ON_DISABLED
        return
    assert led(rig, make(rig)) == ends.get(start, DISABLED)
    moves = (start == MOVING and name == "reset fault") or (start in (MOVING, QUICK_STOP, BRAKING) and name == "enable")
    assert stands(rig) is not moves  # enabled in pv, it obeys its last target


@pytest.mark.parametrize("by_pdo", [False, True])
def test_a_fault_is_reset_also_where_bit_7_was_left_set(by_pdo: bool) -> None:
    """The reset is a rising edge, and another master may have commanded it before the cause was gone."""
    rig = rig_in(DISABLED, by_pdo)
    rig.node.raise_fault(CODE, rig.bus.now, lasting=True)
    rig.bus.send("205#8000")
    rig.bus.run(MILLISECOND)
    assert rig.drive.state is State.FAULT
    rig.drive.end_fault(CODE)
    assert led(rig, drive.reset_fault(rig.axis)) == DISABLED


def test_an_event_driven_tpdo_tells_a_mode_that_another_master_has_selected() -> None:
    rig = rig_in(ENABLED, by_pdo=True)
    for mode in (1, 6):
        rig.bus.send(f"305#0F00{mode:02X}")
        rig.bus.run(MILLISECOND)
        assert rig.axis.mode == rig.drive.mode == mode


def test_a_mode_that_was_shown_before_the_command_is_no_answer_to_it() -> None:
    """Another master has changed it since, and the drive takes its time."""
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(reaction=30 * MILLISECOND))
    for mode in (1, 3):
        rig.run(drive.set_mode(rig.axis, mode))
        rig.bus.send("305#000006")
        rig.bus.run(50 * MILLISECOND)
        assert rig.drive.mode == 6
        rig.run(drive.set_mode(rig.axis, mode))
        assert rig.drive.mode == mode
