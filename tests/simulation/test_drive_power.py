"""The power stage of the simulated drive: STO input, brake, and overload (I²t)."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from canopen_proto.drives.cia402.drive_bit import DriveBit
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import NEVER, Outbox
from canopen_proto.simulation.drive.events import DriveFault
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.plant import Mechanics
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from tests.simulation.drive_bench import NODE_ID, Bench

JOINT = Mechanics()
UNITS = JOINT.units_per_radian
BOTH = pytest.mark.parametrize("mechanics", [None, JOINT], ids=["lag", "mass"])
WITH_BRAKE = DriveSettings(
    position=0, brake_bit=DriveBit(0x60FD_00, 16), mechanics=replace(JOINT, load=5.0, brake_release=0.1, brake_apply=0.05)
)


def moving(settings: DriveSettings) -> Bench:
    """A drive that moves at 20,000 units/s."""
    bench = Bench(settings)
    bench.write(0x60FF, 20_000)
    bench.enable(3)
    bench.run(1_000)
    assert bench.read(0x606C) == pytest.approx(20_000, abs=2)
    return bench


# ---- STO ----


@BOTH
def test_sto_takes_the_torque_at_once_and_the_enable_is_refused_while_it_lasts(mechanics: Mechanics | None) -> None:
    bench = moving(DriveSettings(position=0, mechanics=mechanics))
    bench.drive.set_safe_torque_off(True, bench.now)
    assert bench.state is State.SWITCH_ON_DISABLED
    assert bench.read(0x6077) == 0
    assert not bench.has(4)
    assert bench.read(0x60FD) >> 31 == 1
    bench.run(500)
    assert bench.read(0x606C) == 0
    assert bench.control(0x06, 0x07, 0x0F) is State.SWITCH_ON_DISABLED
    bench.drive.set_safe_torque_off(False, bench.now)
    assert bench.read(0x60FD) >> 31 == 0
    assert bench.control(0x00, 0x06, 0x07, 0x0F) is State.OPERATION_ENABLED


@pytest.mark.parametrize(
    "state", [State.READY_TO_SWITCH_ON, State.SWITCHED_ON, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE]
)
def test_sto_in_each_state(state: State) -> None:
    bench = Bench()
    bench.preset(0x605A, 6)
    bench.bring_to(state)
    bench.drive.set_safe_torque_off(True, bench.now)
    assert bench.state is (State.FAULT if state is State.FAULT_REACTION_ACTIVE else State.SWITCH_ON_DISABLED)


def test_sto_may_make_a_fault_which_lasts_as_long_as_it_does() -> None:
    bench = moving(DriveSettings(position=0, sto_fault=0xFF01))
    bench.events()
    bench.drive.set_safe_torque_off(True, bench.now)
    assert bench.state is State.FAULT
    assert [fault.error_code for fault in bench.reported(DriveFault)] == [0xFF01]
    assert bench.control(0x00, 0x80) is State.FAULT
    bench.drive.set_safe_torque_off(False, bench.now)
    assert bench.control(0x00, 0x80) is State.SWITCH_ON_DISABLED


def test_sto_without_power_makes_no_fault() -> None:
    bench = Bench(DriveSettings(sto_fault=0xFF01))
    bench.control(0x06)
    bench.drive.set_safe_torque_off(True, bench.now)
    assert bench.control(0x06) is State.SWITCH_ON_DISABLED


def test_sto_at_power_on_and_through_it() -> None:
    bench = Bench(DriveSettings(torque_is_off=True))
    assert bench.control(0x06) is State.SWITCH_ON_DISABLED
    bench.drive.reset(bench.now)
    assert bench.control(0x06) is State.SWITCH_ON_DISABLED
    bench.drive.set_safe_torque_off(False, bench.now)
    assert bench.control(0x00, 0x06) is State.READY_TO_SWITCH_ON


def test_a_makers_own_bit_shows_it() -> None:
    bench = Bench(DriveSettings(sto_bit=DriveBit(0x60FE_02, 4, 0)))  # active low, in an object that the dictionary has
    assert bench.read(0x60FE, 2) == 0x10
    bench.drive.set_safe_torque_off(True, bench.now)
    assert bench.read(0x60FE, 2) == 0
    assert bench.read(0x60FD) >> 31 == 0


def test_the_node_tells_of_it() -> None:
    node = DriveNode(Outbox(), NODE_ID, DriveSettings(sto_fault=0xFF01))
    node.boot(0)
    for word in (0x06, 0x07, 0x0F):
        node.values.store[0x6040_00] = word
        node.drive.written(0x6040, 0, 1)
    node.out.frames.clear()
    node.set_safe_torque_off(True, 2)
    assert [frame.data[:2] for frame in node.out.frames if frame.can_id == 0x80 + NODE_ID] == [b"\x01\xff"]


# ---- the brake ----


def test_the_brake_opens_before_operation_is_enabled() -> None:
    bench = Bench(WITH_BRAKE)
    bench.write(0x6060, 1)
    assert bench.read(0x60FD) >> 16 == 1
    assert bench.control(0x06, 0x07, 0x0F) is State.SWITCHED_ON
    bench.run(90)
    assert bench.state is State.SWITCHED_ON
    assert bench.read(0x60FD) >> 16 == 1
    bench.run(20)
    assert bench.state is State.OPERATION_ENABLED
    assert bench.read(0x60FD) >> 16 == 0
    bench.run(1_000)
    assert abs(bench.position) <= 1
    assert bench.drive.deadline == NEVER


@pytest.mark.parametrize(
    ("word", "state"), [(0x07, State.SWITCHED_ON), (0x06, State.READY_TO_SWITCH_ON), (0x00, State.SWITCH_ON_DISABLED)]
)
def test_another_command_ends_the_opening(word: int, state: State) -> None:
    bench = Bench(WITH_BRAKE)
    bench.write(0x6060, 1)
    bench.control(0x06, 0x07, 0x0F)
    bench.run(50)
    assert bench.control(word) is state
    bench.run(200)
    assert bench.state is state
    assert bench.read(0x60FD) >> 16 == 1


@pytest.mark.parametrize(("word", "sags"), [(0x07, False), (0x06, False), (0x00, True)])
def test_the_load_is_held_while_the_brake_closes_unless_the_power_is_cut(word: int, sags: bool) -> None:
    bench = Bench(WITH_BRAKE)
    bench.write(0x6060, 1)
    bench.control(0x06, 0x07, 0x0F)
    bench.run(1_000)
    bench.control(word)
    bench.run(500)
    assert bench.read(0x6077) == 0
    assert bench.read(0x60FD) >> 16 == 1
    fall = 0.5 * (5.0 - JOINT.coulomb_friction) / JOINT.inertia * 0.05**2 * UNITS
    assert -bench.position > 0.9 * fall if sags else abs(bench.position) <= 1


def test_sto_lets_the_load_sag_until_the_brake_is_closed() -> None:
    bench = Bench(WITH_BRAKE)
    bench.write(0x6060, 1)
    bench.control(0x06, 0x07, 0x0F)
    bench.run(1_000)
    bench.drive.set_safe_torque_off(True, bench.now)
    bench.run(500)
    assert -2_000 < bench.position < -500
    assert bench.read(0x606C) == 0


def test_the_master_may_command_the_brake() -> None:
    bench = Bench(DriveSettings(position=0, mechanics=replace(JOINT, load=5.0)))
    bench.write(0x60FE, 0, 1)
    bench.write(0x60FE, 1, 2)  # open, without power: the load falls
    bench.run(100)
    assert bench.position < -1_000
    bench.write(0x60FE, 1, 1)
    bench.run(500)
    rest = bench.position
    bench.run(100)
    assert bench.position == rest
    bench.write(0x60FE, 0, 2)  # the drive's again
    bench.enable(1)
    bench.run(500)
    assert bench.read(0x606C) == 0
    assert bench.read(0x60FE, 1) == 1  # what was written stays


def test_a_closed_brake_keeps_an_enabled_axis_from_moving() -> None:
    bench = Bench(DriveSettings(position=0, mechanics=replace(JOINT, brake_torque=50.0)))
    bench.enable(1)
    bench.write(0x60FE, 1, 1)
    bench.write(0x60FE, 1, 2)
    bench.write(0x607A, 10_000)
    bench.control(0x1F)
    bench.run(300)
    assert bench.position == 0
    assert bench.has(11)


# ---- overload ----

FREE = Track(-math.inf, math.inf)


def overloaded(fault: int = 0) -> Bench:
    """A drive that gives 3 times its rated torque against a blocked axis; it may do so for 2 s."""
    settings = DriveSettings(position=0, mechanics=replace(JOINT, overload_time=2.0), overload_fault=fault, track=FREE)
    bench = Bench(settings)
    bench.write(0x6087, 1_000_000)
    bench.write(0x6071, 3_000)
    bench.drive.block(True, bench.now)
    bench.enable(4)
    return bench


def test_an_overload_limits_the_torque_to_the_rated_one_until_the_motor_is_cooler() -> None:
    bench = overloaded()
    bench.run(1_950)
    assert bench.read(0x6077) == 3_000
    assert not bench.has(7)
    bench.run(100)
    assert bench.read(0x6077) == pytest.approx(1_000, abs=1)
    assert bench.has(7, 11)
    bench.run(5_000)
    assert bench.has(7)  # the rated torque keeps it warm
    bench.write(0x6071, 0)
    bench.run(1_000)
    assert bench.has(7)
    bench.run(1_000)  # from 16 to 14.4 K·s, at 1 a second without torque
    assert not bench.has(7)
    assert not bench.has(11)


def test_half_the_excess_lasts_longer() -> None:
    bench = overloaded()
    bench.write(0x6071, 2_000)
    bench.run(2.0 * 8 / 3 * 1_000 - 50)
    assert not bench.has(7)
    bench.run(100)
    assert bench.has(7)


def test_an_overload_may_make_a_fault() -> None:
    bench = overloaded(0x2310)
    bench.run(2_100)
    assert bench.state is State.FAULT
    assert [fault.error_code for fault in bench.reported(DriveFault)] == [0x2310]
