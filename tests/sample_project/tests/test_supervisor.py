import pytest
import trio
from plant.supervisor import Supervisor

from canopen_proto import SECOND
from canopen_proto.testing import Pause, Reset, nmt


@pytest.fixture
def drive(sim_drive):
    return sim_drive(5)


async def supervised(master, seconds, work=None):
    """The supervisor after so many seconds; `work` runs beside it after the first one."""
    supervisor = Supervisor(master, 5)
    async with trio.open_nursery() as nursery:
        nursery.start_soon(supervisor.run)
        await trio.sleep(1)
        if work is not None:
            work()
        await trio.sleep(seconds - 1)
        nursery.cancel_scope.cancel()
    return supervisor


@pytest.mark.trio
async def test_a_node_that_is_well_is_left_alone(drive, canopen_master, canopen_bus):
    supervisor = await supervised(canopen_master, 10)
    assert not supervisor.silent
    assert supervisor.take_errors() == []
    canopen_bus.never(nmt("stop", 5))


@pytest.mark.trio
async def test_no_error_is_lost_and_its_end_is_none(drive, canopen_world, canopen_master, canopen_bus):
    def fail():
        now = canopen_world.now
        drive.raise_error(0x4210, 0x08, bytes(5), now)
        drive.raise_error(0x2310, 0x02, bytes(5), now)
        drive.clear_error(0x4210, now)
        drive.clear_error(0x2310, now)

    supervisor = await supervised(canopen_master, 3, fail)
    assert supervisor.take_errors() == [0x4210, 0x2310]
    assert supervisor.take_errors() == []
    canopen_bus.saw(nmt("stop", 5)).times(2)


@pytest.mark.trio
@pytest.mark.canopen_faults(Reset(5, at=2 * SECOND))
async def test_a_node_that_boots_is_started_again(drive, canopen_master, canopen_bus):
    await supervised(canopen_master, 4)
    assert drive.state.name == "OPERATIONAL"
    canopen_bus.saw(nmt("start", 5)).times(2)


@pytest.mark.trio
@pytest.mark.canopen_faults(Pause(5, at=3 * SECOND))
async def test_silence_is_told(drive, canopen_master):
    assert (await supervised(canopen_master, 5)).silent
