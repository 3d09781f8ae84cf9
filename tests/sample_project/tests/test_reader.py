import can
import pytest
from plant.reader import Reader, SdoAbortError, SdoTimeoutError, SdoToggleError

from canopen_proto.testing import Copy, Lose, sdo_answer


@pytest.fixture
def reader(sim_node, canopen_world):
    sim_node("sample_io.eds", node_id=5).set_value(0x1017, 0, 60_000, canopen_world.now)  # rare: so a wait for ever is short
    canopen_world.advance(1000)
    filters = [{"can_id": 0x585, "can_mask": 0x7FF, "extended": False}]
    with can.Bus(interface="canopen_world", channel="can0", can_filters=filters) as bus:
        yield Reader(bus, 5)


def test_it_reads_short_and_long_objects(reader):
    assert reader.read(0x1018, 1) == (0xFFFFFF01).to_bytes(4, "little")
    assert reader.read(0x1008) == b"Sample I/O"


def test_what_the_device_refuses_is_no_data(reader):
    with pytest.raises(SdoAbortError, match="0x06020000"):
        reader.read(0x5000)


@pytest.mark.canopen_faults(Lose(sdo_answer(5), nth=1))
def test_a_lost_answer_is_told(reader):
    with pytest.raises(SdoTimeoutError):
        reader.read(0x1018, 1)
    assert len(reader.read(0x1018, 1)) == 4


@pytest.mark.canopen_faults(Copy(sdo_answer(5), nth=2))
def test_a_segment_that_comes_twice_is_not_taken_twice(reader):
    with pytest.raises(SdoToggleError):
        reader.read(0x1008)
