"""Chains whose joints follow set-points in the mode that their own file allows: csp, ip, or slowly in profile position."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from functools import partial
from itertools import pairwise

import pytest

from canopen_master import Chain, ChainError, ChainFaultError, ChainSettings, ChainState, Host, Master, open_master
from canopen_master.motion.joint_procedures import contact
from canopen_proto import indices
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives.axis.axis import AxisSettings
from canopen_proto.drives.axis.motion_plan import NoMotionPlanError
from canopen_proto.drives.axis.slow_position import HANDSHAKE_TIME
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import SECOND, LocalProtocolError
from canopen_proto.multiplexer import mux
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings
from tests.drives.drive_dictionaries import NOTHING_MAPPABLE, Changes, changed, empty_pdos, supports, unmappable, without_pdos
from tests.loops import loop
from tests.master.world import BUS, arm_of, drives, position_of, simulated, virtual_time

DEGREES = AxisSettings(counts_per_unit=1000, max_speed=20.0, following_error_limit=1.0)
HERE = 3.0
"""Where a simulated drive stands: it counts millidegrees."""
SLOW = supports(0x01)
EVENT_DRIVEN = {mux(0x1400, 2): {"default": 255}}

KINDS: dict[str, tuple[Changes, Collection[int]]] = {
    "target and controlword by an event-driven RPDO": (SLOW, ()),
    "by an RPDO at each SYNC": (SLOW | {mux(0x1402, 2): {"default": 1}}, ()),
    "target by SDO": (SLOW | empty_pdos() | unmappable(objects.TARGET_POSITION), ()),
    "target by RPDO, controlword by SDO": (SLOW | empty_pdos() | unmappable(objects.CONTROLWORD), ()),
    "all by SDO": (SLOW | NOTHING_MAPPABLE, without_pdos()),
    "without SYNC": (SLOW | empty_pdos(), [indices.COB_ID_SYNC]),
}


@asynccontextmanager
async def planned_arm(*dictionaries: ObjectDictionary, cycle_time: float = 0.01) -> AsyncIterator[tuple[Host, Master, Chain]]:
    """Joints with these dictionaries, from node 3 on, that are ready to move; their chain chooses how."""
    makers = [
        partial(DriveNode, node_id=node_id, settings=DriveSettings(), dictionary=each)
        for node_id, each in enumerate(dictionaries, start=3)
    ]
    async with simulated(makers=makers) as host, open_master(BUS) as master:
        for node_id, each in enumerate(dictionaries, start=3):
            master.node(node_id, each)
        nodes = range(3, 3 + len(dictionaries))
        arm = arm_of(master, *nodes, axes=DEGREES, mode=None, cycle_time=cycle_time)
        await arm.initialise()
        yield host, master, arm


async def follow_path(arm: Chain, *, seconds: float = 1.0, way: float = 5.0) -> None:
    """Follow a smooth path, and stay at its end for as long again."""
    start = arm.desired_positions
    async for cycle in arm.cycles():
        share = min(cycle.time / seconds, 1.0)
        arm.set_positions([each + way * (1 - math.cos(math.pi * share)) / 2 for each in start])
        if cycle.time >= 2 * seconds:
            return


@virtual_time
async def test_the_best_mode_for_each_joint() -> None:
    joints = [
        changed({}),
        changed(supports(0x41)),
        changed(SLOW),
        changed(supports(0x80)),
    ]  # the last one has csp, and no mode to stand in
    async with planned_arm(*joints) as (host, _, arm):
        assert [device.plan.mode for device in arm.devices if device.plan is not None] == [8, 7, 1, 8]
        await arm.follow()
        assert [drive.drive.mode for drive in drives(host)] == [8, 7, 1, 8]
        await follow_path(arm)
        assert arm.positions == pytest.approx([HERE + 5.0] * 4, abs=0.05)
        assert arm.skipped_cycles == arm.missed_cycles == 0
        await arm.halt()
        await arm.recover()
        assert arm.state is ChainState.FOLLOWING
        await follow_path(arm, way=-2.0)
        assert [position_of(host, node) for node in drives(host)] == pytest.approx([6000] * 4, abs=50)
        await arm.shut_down()


@virtual_time
async def test_interpolated_position_is_the_manuals_name_for_chains_in_ip() -> None:
    async with planned_arm(changed({})) as (_, _, arm):
        with pytest.raises(ChainError, match="joint1 in csp") as caught:
            await arm.enable_interpolated_position()
        assert caught.value.tries == ("await chain.follow()",)
        assert arm.state is ChainState.READY


@virtual_time
async def test_a_chain_may_ask_for_a_mode() -> None:
    async with simulated(makers=[partial(DriveNode, node_id=3, settings=DriveSettings())]) as host, open_master(BUS) as master:
        master.node(3, changed({}))
        arm = arm_of(master, 3, axes=DEGREES, mode=Mode.CYCLIC_SYNCHRONOUS_POSITION, own_pdos=True)
        await arm.initialise()
        await arm.follow()
        assert drives(host)[0].drive.mode == Mode.CYCLIC_SYNCHRONOUS_POSITION
        await arm.shut_down()


def test_modes_in_which_a_chain_follows_set_points() -> None:
    assert ChainSettings(mode=8).mode is Mode.CYCLIC_SYNCHRONOUS_POSITION  # type: ignore[arg-type]
    with pytest.raises(LocalProtocolError, match="csp, ip, pp"):
        ChainSettings(mode=Mode.HOMING)


@virtual_time
async def test_a_joint_that_cannot_follow_is_named_with_each_obstacle() -> None:
    async with simulated(makers=[partial(DriveNode, node_id=3, settings=DriveSettings())]) as host, open_master(BUS) as master:
        drives(host)[0].values.store[objects.SUPPORTED_DRIVE_MODES] = 0x24
        master.node(3, changed({}))
        arm = arm_of(master, 3, axes=DEGREES, mode=None)
        with pytest.raises(ChainError, match=r"joint1 .* csp: 0x6502 of the drive lists pv, hm; ip: .*; pp: "):
            await arm.initialise()
        device = arm.devices[0]
        with pytest.raises(NoMotionPlanError):
            await master.run(contact(device, arm.settings))


@virtual_time
async def test_a_joint_that_limits_its_acceleration_catches_up_after_a_late_set_point() -> None:
    """The path pauses for a cycle and goes on: a jump in speed, which the drive's 0x60C5 does not allow."""
    slowly = {objects.MAX_ACCELERATION: {"default": 200_000}, objects.MAX_DECELERATION: {"default": 200_000}}
    async with planned_arm(changed(slowly)) as (host, _, arm):
        await arm.follow()
        limited = 0
        (node,) = drives(host)
        async for cycle in arm.cycles():
            start = 1 - math.cos(math.pi * min(cycle.time, 1.0))
            if cycle.number == 50:
                arm.hold()
            else:
                arm.set_positions([HERE + 2.5 * start])
            limited += bool(arm.devices[0].statusword & 0x800)
            if cycle.time >= 1.5:
                break
        assert 2 < limited < 40
        assert position_of(host, node) == pytest.approx(1000 * (HERE + 5), abs=5)
        await arm.shut_down()


# ---- slow joints ----


@pytest.mark.thorough(4)
@pytest.mark.parametrize("kind", KINDS)
@virtual_time
async def test_a_slow_joint_follows_and_halts(kind: str) -> None:
    changes, without = KINDS[kind]
    async with planned_arm(changed(changes, without=without)) as (host, _, arm):
        (joint,), (node,) = arm.devices, drives(host)
        assert joint.plan is not None
        assert joint.plan.is_slow
        await arm.follow()
        assert node.drive.mode == Mode.PROFILE_POSITION
        assert position_of(host, node) == 1000 * HERE
        await follow_path(arm)
        assert position_of(host, node) == pytest.approx(1000 * (HERE + 5), abs=20)
        assert joint.largest_following_error > 0.05  # it is slower than one in ip
        assert arm.skipped_cycles == arm.missed_cycles == 0
        arm.set_positions([HERE], cycles=100)
        await loop.sleep(0.5)
        await arm.halt()
        stands_at = position_of(host, node)
        await loop.sleep(1)
        assert position_of(host, node) == stands_at
        assert node.drive.state is State.OPERATION_ENABLED
        await arm.follow()  # the target that the halt has kept is dropped
        await loop.sleep(1)
        assert position_of(host, node) == pytest.approx(stands_at, abs=20)
        await arm.shut_down()


@pytest.mark.thorough(4)
@pytest.mark.parametrize("kind", KINDS)
@virtual_time
async def test_a_slow_joint_that_stops_is_seen_after_its_lag(kind: str) -> None:
    changes, without = KINDS[kind]
    async with planned_arm(changed(changes, without=without)) as (host, _, arm):
        await arm.follow()
        (node,) = drives(host)
        node.drive.block(True, host.now())
        seen_at = 0.0
        with pytest.raises(ChainFaultError, match=r"off its path.*the settings \(following_error_limit\)"):
            async for cycle in arm.cycles():
                arm.set_positions([HERE + 10 * cycle.time])
                seen_at = cycle.time
        ramps, beyond_limit = 2 * 20_000 / 100_000, 0.1  # of 20 degrees per second; 1 degree at 10 degrees per second
        least = ramps + HANDSHAKE_TIME / SECOND + beyond_limit
        assert least < seen_at < least + 0.2
        node.drive.block(False, host.now())  # so that it can be seen to stand


@virtual_time
async def test_a_slow_joint_in_fault_stops_its_chain() -> None:
    async with planned_arm(changed(SLOW), changed(SLOW)) as (host, _, arm):
        await arm.follow()
        drives(host)[0].raise_fault(0x2310, host.now())
        host.pump()
        with pytest.raises(ChainFaultError, match="joint1"):
            await follow_path(arm)
        assert arm.state is ChainState.FAULT
        await arm.recover()
        await follow_path(arm)
        await arm.shut_down()


@virtual_time
async def test_a_fault_that_no_pdo_shows_is_seen_when_it_is_read() -> None:
    """Statusword, position and mode of three joints are read in turn, one behind each SYNC: every 90 ms."""
    by_sdo = changed(SLOW | NOTHING_MAPPABLE, without=without_pdos())
    async with planned_arm(by_sdo, by_sdo, by_sdo) as (host, _, arm):
        await arm.follow()
        for place in range(3):
            drives(host)[place].raise_fault(0x2310, host.now())
            host.pump()
            began = loop.current_time()
            while arm.state is not ChainState.FAULT:
                arm.hold()
                await loop.sleep(0.001)
            assert loop.current_time() - began < 0.09 + 0.01
            await arm.recover()
        await arm.shut_down()


@virtual_time
async def test_a_joint_that_takes_no_targets_stops_its_chain() -> None:
    async with planned_arm(changed(SLOW | NOTHING_MAPPABLE, without=without_pdos())) as (host, _, arm):
        await arm.follow()
        (node,) = drives(host)
        node.deferred.add(0x607A)  # no answer follows
        with pytest.raises(ChainFaultError, match="takes no more targets"):
            await follow_path(arm, seconds=20)


@virtual_time
async def test_slow_answers_do_not_delay_the_cycle() -> None:
    """SDO goes beside the cycle: no SYNC is late, and a joint in csp gets each set-point."""
    slow = changed(SLOW | NOTHING_MAPPABLE, without=without_pdos())
    async with planned_arm(changed({}), slow, slow) as (host, _, arm):
        await arm.follow()
        given: list[float] = []
        store = drives(host)[0].values.store
        async for cycle in arm.cycles():
            given.append(store[objects.TARGET_POSITION] / 1000)  # type: ignore[operator]
            arm.set_positions([HERE + 0.05 * cycle.number] * 3)
            if cycle.number == 100:
                break
        assert arm.skipped_cycles == arm.missed_cycles == 0
        steps = [after - before for before, after in pairwise(given[3:])]
        assert steps == pytest.approx([0.05] * len(steps))
        await arm.shut_down()


@pytest.mark.thorough(4)
@pytest.mark.parametrize("kind", [each for each in KINDS if each.startswith(("target and", "by an RPDO", "all by SDO"))])
@pytest.mark.parametrize("ending", ["left", "halt()"])
@virtual_time
async def test_nothing_feeds_a_slow_joint_that_is_halted(kind: str, ending: str) -> None:
    """A target that came after the halt would end it: bit 8 falls with it."""
    changes, without = KINDS[kind]
    dictionary = changed(changes, without=without)
    for moment in (0, 23, 46):
        async with simulated(makers=[partial(DriveNode, node_id=3, settings=DriveSettings(), dictionary=dictionary)]) as host:
            (node,) = drives(host)
            async with open_master(BUS) as master:
                master.node(3, dictionary)
                arm = arm_of(master, 3, axes=DEGREES, mode=None)
                await arm.initialise()
                await arm.follow()
                arm.set_positions([HERE + 15], cycles=150)
                await loop.sleep(0.5 + moment / 1000)
                if ending == "halt()":
                    await arm.halt()
            stands_at = position_of(host, node)
            assert 3_000 < stands_at < 17_000
            await loop.sleep(2)
            assert position_of(host, node) == stands_at
