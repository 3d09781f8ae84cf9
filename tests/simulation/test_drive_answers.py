"""Wrong, late and refused answers of the simulated drive, for tests of masters."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.procedures.objects import read_int, write
from canopen_proto.procedures.steps import SdoTransferError
from canopen_proto.simulation.drive.answers import Answer
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import Rig

WINDOW = 0x6067


def rig_with(*answers: tuple[int, Answer]) -> Rig:
    return Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(answers=answers))


def test_a_table_of_the_settings_refuses_falsifies_and_delays() -> None:
    rig = rig_with(
        (objects.POSITION_WINDOW, Answer(abort=AbortCode.DEVICE_STATE)),
        (objects.SUPPORTED_DRIVE_MODES, Answer(value=1)),
        (objects.PROFILE_VELOCITY, Answer(delay=200 * MILLISECOND)),
    )
    with pytest.raises(SdoTransferError) as refused:
        rig.run(read_int(rig.remote, WINDOW))
    assert refused.value.abort_code == AbortCode.DEVICE_STATE
    assert rig.run(read_int(rig.remote, 0x6502)) == 1
    asked = rig.bus.now
    assert rig.run(read_int(rig.remote, 0x6081)) == 20_000
    assert 200 * MILLISECOND <= rig.bus.now - asked < 210 * MILLISECOND


def test_a_refused_write_writes_nothing_and_a_late_one_acts_late() -> None:
    rig = rig_with((objects.POSITION_WINDOW, Answer(abort=AbortCode.HARDWARE_ERROR)))
    with pytest.raises(SdoTransferError):
        rig.run(write(rig.remote, WINDOW, 77))
    assert rig.node.values.store[objects.POSITION_WINDOW] == 10
    rig.node.answer(WINDOW, 0, Answer(delay=300 * MILLISECOND))
    rig.master.run(write(rig.remote, WINDOW, 77), rig.bus.now)
    rig.bus.run(290 * MILLISECOND)
    assert rig.node.values.store[objects.POSITION_WINDOW] == 10
    rig.bus.run(20 * MILLISECOND)
    assert rig.node.values.store[objects.POSITION_WINDOW] == 77


def test_a_call_changes_the_answer_and_takes_it_back() -> None:
    rig = rig_with()
    rig.node.answer(WINDOW, 0, Answer(value=5))
    assert rig.run(read_int(rig.remote, WINDOW)) == 5
    assert rig.node.values.store[objects.POSITION_WINDOW] == 10
    rig.node.answer(WINDOW, 0, None)
    assert rig.run(read_int(rig.remote, WINDOW)) == 10


def test_bytes_go_as_they_are() -> None:
    rig = rig_with((objects.STATUSWORD, Answer(value=b"\x37\x06\x00")))
    assert rig.node.read(0x6041, 0, rig.bus.now) == b"\x37\x06\x00"


def test_later_than_the_master_waits() -> None:
    rig = rig_with((objects.POSITION_WINDOW, Answer(delay=3 * SECOND, value=5)))
    with pytest.raises(SdoTransferError) as late:
        rig.run(read_int(rig.remote, WINDOW))
    assert late.value.abort_code == 0x0504_0000
    assert rig.run(read_int(rig.remote, 0x6502)) == 0x3EF
    rig.bus.run(5 * SECOND)


def test_a_late_controlword_moves_the_drive_late() -> None:
    rig = rig_with((objects.CONTROLWORD, Answer(delay=100 * MILLISECOND)))
    asked = rig.bus.now
    rig.run(write(rig.remote, 0x6040, 0x06))
    assert rig.bus.now - asked >= 100 * MILLISECOND
    assert rig.run(read_int(rig.remote, 0x6041)) & 0x6F == 0x21
