"""Chains: from the chain file to motion, with the cycle as the design has it."""

import dataclasses
import math
from fractions import Fraction

import pytest

from canopen_master import (
    ChainHaltedError,
    ChainSettings,
    ChainState,
    SetPointRefusedError,
    open_master,
    standard_drives,
)
from canopen_master.motion.cycles import SetPoints
from canopen_proto.drives.axis.axis import MILLIDEGREES_PER_RADIAN, SCHUNK_POWERBALL, AxisSettings, HomingStyle
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import LocalProtocolError
from canopen_proto.nmt import NmtState
from canopen_transports import open_transport
from tests.loops import loop
from tests.master.world import (
    BUS,
    arm_of,
    assert_all_halted,
    assert_all_stand,
    chain_text,
    drives,
    following_arm,
    position_of,
    simulated,
    value,
    virtual_time,
)

MILLIDEGREE = math.pi / 180_000
FAST = dataclasses.replace(SCHUNK_POWERBALL, max_speed=2.0)


@virtual_time
async def test_a_joint_that_has_its_reference_need_not_home() -> None:
    async with simulated(3, 4), open_master(BUS) as master:
        arm = arm_of(master, 3, 4)
        await arm.initialise()
        await arm.home()
        began = loop.current_time()
        await arm.home(if_needed=True)
        assert loop.current_time() - began < 0.1
        assert arm.is_homed


@virtual_time
async def test_from_power_on_to_motion_and_back() -> None:
    async with simulated(3, 4) as host, open_master(BUS) as master:
        arm = arm_of(master, 3, 4)
        assert arm.state is ChainState.OFF
        await arm.initialise()
        assert arm.state is ChainState.READY
        assert all(node.drive.state is State.OPERATION_ENABLED for node in drives(host))
        assert not arm.is_homed
        await arm.home()
        assert arm.is_homed
        assert arm.positions == [0, 0]
        await arm.enable_interpolated_position()
        assert arm.state is ChainState.FOLLOWING
        async for cycle in arm.cycles():
            arm.set_positions([0.001 * cycle.number, -0.002 * cycle.number])
            if cycle.number == 100:
                break
        await loop.sleep(0.065)
        assert arm.positions == pytest.approx([0.1, -0.2], abs=2 * MILLIDEGREE)  # it follows with a lag
        assert arm.desired_positions == pytest.approx([0.1, -0.2], abs=MILLIDEGREE)
        assert [position_of(host, node) for node in drives(host)] == [5730, -11459]
        assert arm.missed_cycles == 5  # since the break
        await arm.shut_down()
        await loop.sleep(0.001)  # nothing confirms the last command: the devices take it in a moment later
        assert arm.state is ChainState.OFF
        assert all(node.drive.state is State.SWITCH_ON_DISABLED for node in drives(host))
        assert all(node.state is NmtState.STOPPED for node in host.nodes)
        assert master.sync_period == 0
        assert repr(arm) == "<Chain arm: joint1, joint2; off>"


@virtual_time
async def test_what_is_known_of_a_joint() -> None:
    async with following_arm(3, axes=FAST) as (host, _, arm):
        joint = arm.joints["joint1"]
        async for cycle in arm.cycles():
            arm.set_positions([arm.devices[0].axis.scale.from_counts(3000) + 0.01 * cycle.number])
            if cycle.number == 50:
                break
        assert joint.velocity == pytest.approx(1, rel=0.05)
        assert arm.velocities == [joint.velocity]
        assert joint.state is State.OPERATION_ENABLED
        assert joint.mode == 7
        assert joint.statusword == value(drives(host)[0], 0x6041_00)
        assert joint.torque == pytest.approx(value(drives(host)[0], 0x6077_00) / 1000, abs=0.2)
        assert joint.nmt_state is NmtState.OPERATIONAL
        assert not joint.is_homed
        assert not joint.has_fault
        assert joint.error_code == 0
        assert joint.emcy is None
        assert joint.sdo_round_trips > 5
        # the simulated drive lags by 5 ms, at 1 rad/s
        assert 0.004 < joint.largest_following_error < 0.011
        assert abs(joint.following_error) <= joint.largest_following_error
        assert "operation enabled" in joint.describe()
        assert repr(joint) == f"<Device joint1: node 3 on {BUS}>"
        await arm.halt()
        assert joint.following_error == 0


@virtual_time
async def test_the_velocity_that_a_drive_sends_goes_before_our_own_sum() -> None:
    async with simulated(makers=standard_drives(3)) as host, open_master(BUS) as master:
        node = master.node(3)
        joint = master.device(node, settings=AxisSettings())
        assert joint.name == "node 3"
        assert await node.read("velocity_actual_value") == 0
        assert joint.velocity == 0
        assert master.device(node, "elbow") is joint
        assert joint.name == "elbow"
        assert host.nodes[0].node_id == 3


@virtual_time
async def test_a_set_point_goes_out_behind_the_next_sync() -> None:
    async with following_arm(3, 4) as (_, _, arm), await open_transport(BUS) as spy:
        seen: list[str] = []
        async with loop.open_nursery() as nursery:

            async def listen() -> None:
                while True:
                    seen.append(str((await spy.receive())[0]))

            nursery.start_soon(listen)
            async for cycle in arm.cycles():
                await loop.sleep(0.004)
                seen.append(f"given {cycle.number}")
                arm.set_positions([counts * MILLIDEGREE for counts in (3000 + cycle.number, 3000 - cycle.number)])
                if cycle.number == 2:
                    break
            await loop.sleep(0.01)
            nursery.cancel_scope.cancel()
        sent = [each for each in seen if each.startswith(("080", "20", "given"))]
        first = sent.index("given 1")
        assert sent[first : first + 7] == [
            "given 1",
            "080#",
            "203#1F000000B90B0000",
            "204#1F000000B70B0000",
            "given 2",
            "080#",
            "203#1F000000BA0B0000",
        ]


@virtual_time
async def test_a_late_cycle_slows_the_path_and_says_so() -> None:
    async with following_arm(3) as (_, _, arm):
        start = arm.positions
        seen = []
        async for cycle in arm.cycles():
            arm.set_positions(start)
            seen.append((cycle.number, cycle.skipped, round(cycle.time, 6), round(cycle.late, 6)))
            if cycle.number == 1:
                await loop.sleep(0.035)  # late: cycles 2, 3 and 4 come meanwhile
            if cycle.number == 3:
                break
        assert seen == [(0, 0, 0, 0), (1, 0, 0.01, 0), (2, 2, 0.02, 0.02), (3, 0, 0.03, 0.02)]
        assert arm.missed_cycles == 2  # the set-point of cycle 1 went out behind SYNC 2; behind 3 and 4 it was repeated


@virtual_time
async def test_periods_without_a_sync_are_counted_too() -> None:
    set_points = SetPoints((), 0.01, None)
    set_points.begin([])
    for skipped in (0, 3, 0):
        set_points.on_sync(skipped)
    assert (set_points.number, set_points.sync_cycles, set_points.skipped_cycles) == (6, 3, 3)


@virtual_time
async def test_without_set_points_the_last_is_repeated_and_then_the_chain_halts() -> None:
    async with following_arm(3, 4) as (host, _, arm):
        start = arm.positions
        with pytest.raises(ChainHaltedError, match="10 cycles in a row brought no set-points") as caught:
            async for cycle in arm.cycles():
                if cycle.number < 20:
                    arm.set_positions([position + 0.001 * cycle.number for position in start])
                last = cycle.number
        assert last == 29
        assert caught.value.code == "CO403"
        assert arm.state is ChainState.HALTED
        assert arm.missed_cycles == 10
        assert_all_halted(host)
        await assert_all_stand(host)
        with pytest.raises(ChainHaltedError):
            arm.set_positions(start)
        with pytest.raises(ChainHaltedError):
            arm.cycles()
        # and it goes on from where it stands
        stood = arm.positions
        await arm.enable_interpolated_position()
        async for cycle in arm.cycles():
            arm.set_positions([position - 0.001 * cycle.number for position in stood])
            if cycle.number == 20:
                break


@virtual_time
async def test_a_cycle_that_holds_is_not_missed() -> None:
    async with following_arm(3) as (_, _, arm):
        async for cycle in arm.cycles():
            arm.hold()
            if cycle.number == 50:
                break
        assert arm.missed_cycles == 0
        assert arm.sync_cycles >= 50


@virtual_time
async def test_before_anybody_follows_the_cycles_none_is_missed() -> None:
    async with following_arm(3) as (_, _, arm):
        await loop.sleep(1)
        assert arm.missed_cycles == 0
        assert arm.state is ChainState.FOLLOWING


@virtual_time
async def test_a_straight_line_over_several_cycles_only_where_asked() -> None:
    async with following_arm(3) as (_, _, arm):
        (start,) = arm.positions
        sent = []
        async for cycle in arm.cycles():
            if cycle.number == 0:
                arm.set_positions([start + 0.01], cycles=5)
            if cycle.number == 5:
                arm.hold()
            sent.append(round(arm.desired_positions[0] - start, 4))
            if cycle.number == 5:
                break
        assert sent == [0.002, 0.004, 0.006, 0.008, 0.01, 0.01]
        assert arm.missed_cycles == 0
        with pytest.raises(LocalProtocolError, match="1 cycle or more"):
            arm.set_positions([start], cycles=0)
        for cycles in (None, 1.5, "2", True):
            with pytest.raises(LocalProtocolError, match="a whole number"):
                arm.set_positions([start], cycles=cycles)  # type: ignore[arg-type]


@virtual_time
async def test_set_points_that_are_refused_change_nothing() -> None:
    async with following_arm(3, 4, max_step=0.01, axes=FAST) as (_, _, arm):
        start = arm.positions
        before = arm.desired_positions
        for wrong, message in (
            ([0.0], "1 for 2 joints"),
            (None, "None is no list of numbers; the joints are joint1, joint2"),
            ("0.1", "'0.1' is no list of numbers"),
            (0.1, "0.1 is no list of numbers"),
            ([None, 0.0], "None is no number"),
            ([0.0, 10**400], "a whole number of 1329 bits is beyond all positions"),
            ([-(10**5000), 0.0], "a whole number of 16610 bits is beyond all positions"),
            ([0.0, Fraction(10**400, 3)], "a number is beyond all positions"),
            (["0.1", 0.0], "'0.1' is no number"),
            ([True, 0.0], "True is no number"),
            ({"joint1": 0.1, "joint2": 0.1}, "is no list of numbers; the joints are joint1, joint2"),
            ({0.1: 0.1, 0.2: 0.1}, "is no list of numbers; the joints are joint1, joint2"),  # its keys were taken
            ([*start, 0.0], "the joints are joint1, joint2"),
            ([start[0], math.nan], "joint2 was refused"),
            ([start[0], math.inf], "not a finite number"),
            ([start[0] + 0.001, start[1] + 0.011], "max_step = 0.01"),
        ):
            with pytest.raises(SetPointRefusedError, match=message) as caught:
                arm.set_positions(wrong)  # type: ignore[arg-type]
            assert isinstance(caught.value, ValueError)
            assert caught.value.code == "CO321"
            assert arm.desired_positions == before
        arm.set_positions([position + 0.01 for position in start])
        arm.set_positions([start[0] - 0.01, start[1] + 0.1], cycles=10)  # measured from what was sent
        await loop.sleep(0.015)
        with pytest.raises(SetPointRefusedError, match="joint1"):
            arm.set_positions([start[0] + 0.01, start[1]])


@virtual_time
async def test_a_set_point_that_does_not_fit_the_object() -> None:
    async with following_arm(3) as (_, _, arm):
        with pytest.raises(SetPointRefusedError, match="ip_data_position"):
            arm.set_positions([1e9])


@virtual_time
async def test_units_and_direction_are_settings_of_the_axis() -> None:
    degrees = dataclasses.replace(SCHUNK_POWERBALL, counts_per_unit=1000, direction=-1)
    async with simulated(3, 4) as host, open_master(BUS) as master:
        arm = master.load_chains(text=chain_text(3, 4), axes={"joint1": degrees})["arm"]
        await arm.initialise()
        await arm.home()
        await arm.enable_interpolated_position()
        async for cycle in arm.cycles():
            arm.set_positions([cycle.number * 0.1, 0])
            if cycle.number == 100:
                break
        await loop.sleep(0.06)
        assert [position_of(host, node) for node in drives(host)] == [-10_000, 0]


@virtual_time
async def test_standard_drives_with_pdos_that_are_declared_to_them() -> None:
    standard = AxisSettings(MILLIDEGREES_PER_RADIAN, homing=HomingStyle.STANDARD, homing_method=35)
    async with simulated(makers=standard_drives(3, 4)) as host, open_master(BUS, heartbeat_timeout=0.6) as master:
        settings = ChainSettings(define_pdos=True, max_step=0.01, cycle_time=0.008)
        arm = master.load_chains(text=chain_text(3, 4), settings=settings, axes=standard)["arm"]
        await arm.initialise()
        assert [value(node, 0x1017_00) for node in drives(host)] == [200, 200]
        assert value(drives(host)[0], 0x1600_00) == 3
        await arm.home()
        await arm.enable_interpolated_position()
        assert value(drives(host)[0], 0x60C2_01) == 8
        async for cycle in arm.cycles():
            arm.set_positions([0.001 * cycle.number] * 2)
            if cycle.number == 50:
                break
        await loop.sleep(0.05)
        assert arm.positions == pytest.approx([0.05, 0.05], abs=MILLIDEGREE)
