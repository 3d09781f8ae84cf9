"""Where PDO parameters stand, and the order in which a PDO is set up anew (CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38)."""

from __future__ import annotations

import pytest

from canopen_proto.datatypes import DataType, ValueRangeError
from canopen_proto.dictionary import Direction, Filler, PdoDescription, Variable
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.pdo.mapping import MappedEntry, MappingError
from canopen_proto.pdo.settings import PdoSettings, communication_index, mapping_index, place_of
from tests.core.pdo_device import U16, Device

RPDO, TPDO = Direction.RPDO, Direction.TPDO


@pytest.fixture
def device() -> Device:
    return Device()


def test_where_the_records_stand() -> None:
    assert [communication_index(RPDO, 1), mapping_index(RPDO, 1)] == [0x1400, 0x1600]
    assert [communication_index(TPDO, 512), mapping_index(TPDO, 512)] == [0x19FF, 0x1BFF]
    for number in (0, 513, -1):
        with pytest.raises(LocalProtocolError, match="1..512"):
            communication_index(TPDO, number)
    every = [(RPDO, False), (RPDO, True), (TPDO, False), (TPDO, True)]
    expected = [(direction, number, is_mapping) for direction, is_mapping in every for number in range(1, 513)]
    assert [place_of(index) for index in range(0x1400, 0x1C00)] == expected
    assert place_of(0x13FF) is None
    assert place_of(0x1C00) is None


def test_the_steps_that_set_a_pdo_up() -> None:
    entries = (0x60400010, MappedEntry(6, 0, 16, U16).parameter, 0x60C10120)
    steps = PdoSettings(1, RPDO, 0x20C, 1, entries).steps(0x222)
    assert [(f"{index:04X}:{subindex:02X}", data.hex()) for index, subindex, data in steps] == [
        ("1400:01", "22020080"),  # destroy, the CAN-ID unchanged
        ("1600:00", "00"),
        ("1600:01", "10004060"),
        ("1600:02", "10000600"),
        ("1600:03", "2001c160"),
        ("1600:00", "03"),
        ("1400:02", "01"),
        ("1400:01", "0c020000"),  # create
    ]
    steps = PdoSettings(2, TPDO, 0x4000028C, 255, (), inhibit_time=MILLISECOND, event_time=SECOND).steps()
    assert [(f"{index:04X}:{subindex:02X}", data.hex()) for index, subindex, data in steps] == [
        ("1801:01", "8c0200c0"),
        ("1A01:00", "00"),
        ("1A01:00", "00"),
        ("1801:02", "ff"),
        ("1801:03", "0a00"),
        ("1801:05", "e803"),
        ("1801:01", "8c020040"),
    ]


def test_no_steps_for_nonsense() -> None:
    with pytest.raises(MappingError, match="RPDO 1: 65 entries"):
        PdoSettings(1, RPDO, 0x20C, 1, (0x20000001,) * 65).steps()
    with pytest.raises(LocalProtocolError, match="a PDO has a number in 1..512"):
        PdoSettings(0, RPDO, 0x20C, 1, ()).steps()
    with pytest.raises(ValueRangeError, match="0x1400:02: 256 is outside"):
        PdoSettings(1, RPDO, 0x20C, 256, ()).steps()
    with pytest.raises(ValueRangeError, match="0x1801:05"):
        PdoSettings(2, TPDO, 0x28C, 255, (), event_time=65536 * MILLISECOND).steps()


def settings_of(device: Device, number: int, direction: Direction) -> PdoSettings:
    """What stands in the device."""

    def at(index: int, subindex: int) -> int:
        return int.from_bytes(device.values.raw(index, subindex), "little")

    communication, mapping = communication_index(direction, number), mapping_index(direction, number)
    entries = tuple(at(mapping, subindex) for subindex in range(1, at(mapping, 0) + 1))
    return PdoSettings(number, direction, at(communication, 1), at(communication, 2), entries)


def test_a_device_takes_the_steps_and_the_old_settings_come_back(device: Device) -> None:
    for number, direction in ((1, RPDO), (2, RPDO), (1, TPDO), (2, TPDO)):
        old = settings_of(device, number, direction)
        new = PdoSettings(number, direction, 0x345, 254, (0x20000008, 0x607A0020))
        for settings, current in ((new, old.cob_id), (old, new.cob_id)):
            for index, subindex, data in settings.steps(current):
                assert device.write(index, subindex, int.from_bytes(data, "little")) is None
            assert settings_of(device, number, direction) == settings


def test_settings_from_a_description() -> None:
    status, text = Variable(0x6041, 0, "statusword", U16), Variable(0x2007, 0, "text", DataType.VISIBLE_STRING)
    tpdo = PdoDescription("t", 0x180, TPDO, 1, (status, Filler("notused16", 16)))
    assert PdoSettings.from_description(tpdo, 12, 1) == PdoSettings(1, TPDO, 0x4000018C, 1, (0x60410010, 0x00060010))
    rpdo = PdoDescription("r", 0x6A0, RPDO, None, (status,))
    assert PdoSettings.from_description(rpdo, 12, 255, number=3) == PdoSettings(3, RPDO, 0x6AC, 255, (0x60410010,))
    with pytest.raises(LocalProtocolError, match="r: give the number of the RPDO"):
        PdoSettings.from_description(rpdo, 12, 255)
    with pytest.raises(MappingError, match="text"):
        PdoSettings.from_description(PdoDescription("x", 0x180, TPDO, 1, (text,)), 12, 1)
