import pytest
from plant.thermometer import Thermometer

from canopen_proto import MILLISECOND, NmtCommand
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.procedures import SdoTransferError
from canopen_proto.testing import boot_up, can_frame, tpdo

OBJECTS = [
    Variable(0x1000, 0, "device type", DataType.UNSIGNED32, Access.RO),
    Variable(0x2000, 0, "temperature", DataType.INTEGER16, Access.RO, pdo_mappable=True),
    Variable(0x2001, 0, "place", DataType.VISIBLE_STRING, Access.RO),
    Variable(0x2002, 0, "not there", DataType.UNSIGNED8, Access.RO),
]
DICTIONARY = ObjectDictionary(Object.of(each.name, [each]) for each in OBJECTS)


@pytest.fixture
def thermometer(canopen_world):
    device = Thermometer(7, lambda frame: canopen_world.send(place, frame))
    place = canopen_world.listener(device.on_frame, name="thermometer")
    device.reset()
    canopen_world.run_until(boot_up(7))
    return device


@pytest.fixture
def master(thermometer, canopen_master):
    canopen_master.node(7, DICTIONARY)
    return canopen_master


def test_its_objects_are_read(thermometer, master, canopen_bus):
    thermometer.measure(-55)
    assert master.read(7, "temperature") == -55
    assert master.read(7, "place") == "cold store, north wall"
    canopen_bus.observer.clean()


def test_what_it_does_not_have_it_refuses(master):
    with pytest.raises(SdoTransferError, match="refused .* 0x06020000"):
        master.read(7, "not there")


def test_a_new_temperature_comes_at_once(canopen_world, thermometer, master, canopen_bus):
    thermometer.measure(10)
    canopen_world.advance(MILLISECOND)
    canopen_bus.never(tpdo(7))
    master.command(NmtCommand.START, 7)
    canopen_world.advance(MILLISECOND)
    thermometer.measure(-2)
    canopen_world.advance(MILLISECOND)
    canopen_bus.saw(can_frame("187#FEFF"))


def test_stopped_it_answers_nothing(canopen_world, master):
    master.command(NmtCommand.STOP, 7)
    canopen_world.advance(MILLISECOND)
    with pytest.raises(SdoTransferError, match="did not answer"):
        master.read(7, "temperature")


def test_it_boots_again(canopen_world, master):
    master.command(NmtCommand.RESET_NODE, 7)
    canopen_world.run_until(boot_up(7), limit=100 * MILLISECOND)
