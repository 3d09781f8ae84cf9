import pytest
import trio
from plant.mover import DriveFaultError, run

from canopen_proto import MILLISECOND, SECOND
from canopen_proto.simulation.drive.settings import DriveSettings
from canopen_proto.testing import emcy, sdo_write

ENABLED = 0x04
SLOW = DriveSettings(reaction=30 * MILLISECOND)


@pytest.mark.trio
async def test_it_stands_at_each_target_without_power_at_the_end(sim_drive, canopen_master, canopen_bus):
    drive = sim_drive(3, SLOW)
    node = canopen_master.node(3)
    await run(node, [2000, 9000])
    await trio.sleep(0.1)
    assert drive.values.read("position_actual_value") == pytest.approx(9000, abs=50)
    assert not drive.values.read("statusword") & ENABLED
    canopen_bus.saw(sdo_write(3, "target_position", 2000)).then(sdo_write(3, "target_position", 9000))


@pytest.mark.trio
async def test_a_fault_ends_it_without_power(sim_drive, canopen_world, canopen_master, canopen_bus):
    drive = sim_drive(3)
    canopen_world.after(SECOND, lambda: drive.raise_fault(0x7300, canopen_world.now))
    with pytest.raises(DriveFaultError):
        await run(canopen_master.node(3), [100_000, -100_000])
    canopen_bus.saw(emcy(3)).then(sdo_write(3, "controlword", 0)).within(100 * MILLISECOND)


@pytest.mark.trio
async def test_a_drive_that_gets_no_torque_is_given_up_in_time(sim_drive, canopen_world, canopen_master):
    sim_drive(3, DriveSettings(torque_is_off=True))
    with pytest.raises(trio.TooSlowError), trio.fail_after(6):
        await run(canopen_master.node(3), [2000])
    assert canopen_world.now < 5 * SECOND
