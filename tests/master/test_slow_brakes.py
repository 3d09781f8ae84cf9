"""Leaving the master waits for a drive that takes seconds to brake, and not for one that is dead."""

from __future__ import annotations

import pytest

from canopen_master import HaltNotConfirmedError, Master, open_master
from canopen_master.session import SHUTDOWN_TIME
from canopen_master.simulation.host import standard_drives
from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.objects import PROFILE_DECELERATION
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from tests.loops import loop
from tests.master.world import BUS, drives, simulated, virtual_time

SPEED = 50_000
ENDLESS = Track(positive_limit=1e9)


async def running(master: Master) -> None:
    """Node 5 runs at SPEED."""
    node = master.node(5, drive_dictionary())
    device = master.device(node)
    await master.nmt_start(5)
    await master.run(drive.set_mode(device.axis, Mode.PROFILE_VELOCITY))
    await master.run(drive.enable(device.axis))
    await node.write("0x60FF", SPEED)
    await loop.sleep(1)


@virtual_time
@pytest.mark.thorough(3)
@pytest.mark.parametrize("ramp", [8_000, 16_000, 500_000])
async def test_a_drive_that_brakes_for_seconds_stands_when_the_master_has_gone(ramp: int) -> None:
    async with simulated(makers=standard_drives(5, settings=DriveSettings(track=ENDLESS))) as host:
        (node,) = drives(host)
        node.values.store[PROFILE_DECELERATION] = ramp
        async with open_master(BUS) as master:
            await running(master)
            left = loop.current_time()
        node.drive.refresh(host.now())
        assert node.drive._servo.velocity == 0
        assert loop.current_time() - left == pytest.approx(SPEED / ramp, abs=0.3)


@virtual_time
async def test_a_procedure_that_was_cancelled_has_halted_its_drive_when_it_returns() -> None:
    async with simulated(makers=standard_drives(5, settings=DriveSettings(track=ENDLESS))) as host:
        (node,) = drives(host)
        node.values.store[PROFILE_DECELERATION] = 16_000
        async with open_master(BUS) as master:
            device = master.device(master.node(5, drive_dictionary()))
            await master.nmt_start(5)
            await device.node.write("0x6081", SPEED)
            with loop.move_on_after(2):
                await master.run(drive.move_to(device.axis, 1_000_000, timeout=60 * SECOND))
            node.drive.refresh(host.now())
            assert node.drive._servo.velocity == 0


@virtual_time
async def test_a_drive_that_answers_and_goes_on_is_told_soon() -> None:
    """It acts 2.9 s late on whatever it is told."""
    makers = standard_drives(5, settings=DriveSettings(reaction=2900 * MILLISECOND, track=ENDLESS))
    async with simulated(makers=makers):
        with pytest.raises(HaltNotConfirmedError):
            async with open_master(BUS) as master:
                await running(master)
                await loop.sleep(3)
                left = loop.current_time()
        assert loop.current_time() - left <= SHUTDOWN_TIME + 1.5


@virtual_time
async def test_a_drive_that_is_dead_keeps_nobody_waiting() -> None:
    async with simulated(makers=standard_drives(5, settings=DriveSettings(track=ENDLESS))) as host:
        with pytest.raises(HaltNotConfirmedError):
            async with open_master(BUS) as master:
                await running(master)
                host.nodes[0].sdo.disable()
                left = loop.current_time()
        assert loop.current_time() - left <= SHUTDOWN_TIME
