import pytest
import trio
from plant.configure import WrongDeviceError, configure

from canopen_proto import MILLISECOND
from canopen_proto.testing import Lie, heartbeat, nmt, sdo_write, tpdo


@pytest.fixture
def node(sim_node):
    return sim_node("sample_io.eds", node_id=5)


@pytest.mark.trio
async def test_the_temperature_comes_and_a_heartbeat(node, canopen_master, canopen_bus):
    await configure(canopen_master.node(5, "sample_io.eds"))
    await trio.sleep(0.9)
    canopen_bus.saw(nmt("start", 5)).then(tpdo(5)).within(300 * MILLISECOND)
    canopen_bus.saw(heartbeat(5)).times(5)
    canopen_bus.observer.clean()


@pytest.mark.trio
async def test_it_is_configured_before_it_starts(node, canopen_master, canopen_bus):
    await configure(canopen_master.node(5, "sample_io.eds"))
    await trio.sleep(0.1)
    started = canopen_bus.saw(nmt("start", 5))
    canopen_bus.never(sdo_write(5, (0x1A00, 0)), after=started.time)


@pytest.mark.trio
@pytest.mark.canopen_faults(Lie(5, (0x1018, 1), 0x1234))
async def test_a_device_of_somebody_else_is_not_started(node, canopen_master, canopen_bus):
    with pytest.raises(WrongDeviceError):
        await configure(canopen_master.node(5, "sample_io.eds"))
    canopen_bus.never(nmt("start", 5))
