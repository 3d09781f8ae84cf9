"""Velocity and torque go along with the set-points of a path, where the PDOs of a joint have room for them."""

from __future__ import annotations

import itertools
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest

from canopen_master import AxisSettings, Chain, ChainSettings, ChainState, PathRefusedError
from canopen_master.motion.path_motion import Torques
from canopen_proto.dictionary import Direction
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.trajectory import Path, PathPoint, Segment
from canopen_proto.pdo.configure import configure_pdo, use_device_pdo
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.simulation.drive.node import DriveNode
from tests.loops import loop
from tests.master.path_world import AXIS, COUNTS, CYCLE, arms, swing
from tests.master.world import drives, value, virtual_time


@asynccontextmanager
async def arm_with_offsets(joints: int, axis: AxisSettings = AXIS) -> AsyncIterator[tuple[Chain, list[DriveNode]]]:
    """A chain in csp, whose first joint has an RPDO with velocity and torque offset."""
    async with arms(joints, axis=axis, mode=Mode.CYCLIC_SYNCHRONOUS_POSITION) as (master, [arm], record):
        remote = arm.devices[0].node.remote
        offsets = PdoSettings(4, Direction.RPDO, 0x500 + remote.node_id, 1, (0x60B1_0020, 0x60B2_0010))
        await master.run(configure_pdo(remote, offsets))
        await master.run(use_device_pdo(remote, Direction.RPDO, 4))
        remote.enable_rpdo(4, master.now())
        yield arm, drives(record.hosts[0])


async def offsets_of(node: DriveNode, arm: Chain, path: Path, torques: Torques | None) -> list[tuple[float, float, float]]:
    """Follow a path; return time, velocity and torque offset of a drive in each cycle."""
    sent = []

    async def watch() -> None:
        async for progress in arm.progress():
            velocity, torque = value(node, objects.VELOCITY_OFFSET), value(node, objects.TORQUE_OFFSET)
            sent.append((progress.time, velocity / COUNTS, torque / 1000))

    async with loop.open_nursery() as nursery:
        nursery.start_soon(watch)
        await arm.follow(path, torques=torques)
    return sent


@virtual_time
async def test_a_path_whose_velocity_the_drive_can_never_be_given_moves_nothing() -> None:
    """A velocity unit of 1e-4 counts per second: 0x60B1 holds 0.21 units per second, and the speed limit of the joint is 1."""
    async with arm_with_offsets(1, replace(AXIS, velocity_unit=1e-4)) as (arm, [node]):
        await arm.follow()
        with pytest.raises(PathRefusedError, match=r"its limit of speed (.|\n)*: what 0x60B1 of the drive can hold") as refused:
            await arm.follow(swing(0.5))
        assert refused.value.tries == ("a path that takes longer",)
        assert value(node, objects.VELOCITY_OFFSET) == 0
        await arm.move([0.5])
        assert arm.desired_positions == pytest.approx([0.5])
        assert arm.state is ChainState.FOLLOWING


@virtual_time
async def test_nor_does_one_whose_velocity_its_record_cannot_hold() -> None:
    settings = ChainSettings(CYCLE, own_pdos=True, feed_forward=True)
    async with arms(1, settings=settings, axis=replace(AXIS, record_velocity_unit=1e-4)) as (_, [arm], record):
        await arm.follow()
        with pytest.raises(PathRefusedError, match=r"its limit of speed (.|\n)*: what 0x60C1:02 of the drive can hold"):
            await arm.follow(swing(0.5))
        assert record.largest(1) == 0


LATE = 2 * CYCLE
"""A point is made at a SYNC, sent behind the next one, and seen in the drive at the one after that."""


@virtual_time
async def test_the_velocity_goes_along_where_an_rpdo_carries_it_and_no_torque_by_itself() -> None:
    async with arm_with_offsets(2) as (arm, [node, other]):
        path = swing(0.5, -0.25)
        sent = await offsets_of(node, arm, path, None)
        expected = [path.at(time - LATE).velocities[0] for time, _, _ in sent]
        assert [velocity for _, velocity, _ in sent] == pytest.approx(expected, abs=1e-5)
        assert {torque for _, _, torque in sent} == {0.0}
        assert value(other, objects.VELOCITY_OFFSET) == 0
        stay = Path([[Segment(1.0, (0.5,))], [Segment(1.0, (-0.25,))]])
        with pytest.raises(PathRefusedError, match="j02 takes no torque"):
            await arm.follow(stay, torques=lambda point: point.accelerations)


@virtual_time
async def test_torques_that_the_caller_computes_go_along() -> None:
    async with arm_with_offsets(1) as (arm, [node]):
        path = swing(0.5)
        sent = await offsets_of(node, arm, path, lambda point: [0.1 + 0.2 * each for each in point.accelerations])
        expected = [0.1 + 0.2 * path.at(time - LATE).accelerations[0] for time, _, _ in sent[2:]]
        assert [torque for _, _, torque in sent[2:]] == pytest.approx(expected, abs=1e-3)


@pytest.mark.thorough(2)
@pytest.mark.parametrize("torques", [[math.nan], [], [0.1, 0.2], None, 0.5, ["a"]])
@virtual_time
async def test_torques_that_are_none_end_the_motion_and_not_the_master(torques: Any) -> None:
    async with arm_with_offsets(1) as (arm, _):
        asked = itertools.count()

        def feed(point: PathPoint) -> Any:
            return [0.0] if next(asked) < 50 else torques

        with pytest.raises(PathRefusedError, match="the torque function gave no torques"):
            await arm.follow(swing(0.5), torques=feed)
        assert arm.state is ChainState.HALTED
        await arm.recover()


@virtual_time
async def test_a_plan_with_feed_forward_has_an_rpdo_for_it() -> None:
    """By the drive's own file, and a setting of its chain: nothing else has to be done."""
    settings = ChainSettings(CYCLE, own_pdos=True, mode=Mode.CYCLIC_SYNCHRONOUS_POSITION, feed_forward=True)
    async with arms(1, settings=settings) as (_, [arm], record):
        (node,) = drives(record.hosts[0])
        plan = arm.devices[0].plan
        assert plan is not None
        assert "fed forward" in dict(plan.facts)
        path = swing(0.5)
        sent = await offsets_of(node, arm, path, lambda point: [0.1 for _ in point.positions])
        expected = [path.at(time - LATE).velocities[0] for time, _, _ in sent]
        assert [velocity for _, velocity, _ in sent] == pytest.approx(expected, abs=1e-5)
        assert {torque for _, _, torque in sent[2:]} == {0.1}
        await arm.halt()
        await loop.sleep(3 * CYCLE)
        assert value(node, objects.VELOCITY_OFFSET) == value(node, objects.TORQUE_OFFSET) == 0


@virtual_time
async def test_records_of_ip_have_the_velocity_of_the_path() -> None:
    """By two settings. The drive passes each position at that velocity, so its speed has no steps."""
    settings = ChainSettings(CYCLE, own_pdos=True, feed_forward=True)
    async with arms(1, settings=settings, axis=replace(AXIS, record_velocity_unit=10.0)) as (_, [arm], record):
        (node,) = drives(record.hosts[0])
        assert "fed forward" in dict(arm.devices[0].plan.facts)  # type: ignore[union-attr]
        path, sent = swing(0.5), []

        async def watch() -> None:
            async for progress in arm.progress():
                velocity = value(node, objects.INTERPOLATION_VELOCITY) * 10 / COUNTS
                sent.append((progress.time, velocity))

        async with loop.open_nursery() as nursery:
            nursery.start_soon(watch)
            await arm.follow(path)
        assert value(node, objects.INTERPOLATION_SUB_MODE_SELECT) == -1
        assert [velocity for _, velocity in sent] == pytest.approx(
            [path.at(time - LATE).velocities[0] for time, _ in sent], abs=2e-5
        )
        assert record.rows[-1] == pytest.approx([0.5], abs=3e-6)
