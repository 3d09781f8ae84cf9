"""0x6060 by PDO or SDO, whichever there is: image and object agree, and no RPDO undoes a mode."""

from __future__ import annotations

from dataclasses import replace

import pytest

from canopen_proto.dictionary import Direction
from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.objects import MODES_OF_OPERATION
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import SDO_CLIENT_TO_SERVER
from canopen_proto.machine import MILLISECOND
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.procedures.objects import write
from canopen_proto.simulation.drive.settings import Shape
from tests.drives.rig import CYCLE, Rig

WITH_MODE = 2
"""The number of the standard shape's RPDO with controlword and mode; it is event-driven."""


def rig_with_rpdo(transmission_type: int, *, live: bool = True) -> Rig:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.run(write(rig.remote, "0x1401:02", transmission_type))
    rig.run(use_device_pdo(rig.remote, Direction.RPDO, WITH_MODE))
    if live:
        rig.remote.enable_rpdo(WITH_MODE, rig.bus.now)
    return rig


def written_by_sdo(rig: Rig) -> list[int]:
    """The modes that SDO wrote: expedited downloads of 0x6060."""
    written = (frame.data for _, frame in rig.bus.sent if frame.can_id == SDO_CLIENT_TO_SERVER + 5)
    return [data[4] for data in written if data[:4] == b"\x2f\x60\x60\x00"]


def agree_on(rig: Rig, mode: int) -> None:
    """Object, image and display have this mode, now and after some SYNCs."""
    for _ in range(2):
        assert rig.drive.values.store[MODES_OF_OPERATION] == mode
        assert rig.remote.values.store[MODES_OF_OPERATION] == mode
        assert rig.drive.mode == mode
        rig.bus.run(5 * CYCLE)


@pytest.mark.parametrize("transmission_type", [1, 2, 255])
def test_a_live_rpdo_carries_the_mode(transmission_type: int) -> None:
    rig = rig_with_rpdo(transmission_type)
    rig.start_sync()
    for mode in (Mode.PROFILE_VELOCITY, Mode.INTERPOLATED_POSITION, Mode.HOMING):
        rig.run(drive.set_mode(rig.axis, mode))
        agree_on(rig, mode)
    assert written_by_sdo(rig) == []


def test_without_an_rpdo_that_is_sent_the_mode_goes_by_sdo() -> None:
    """Also if SYNC does not run: a synchronous RPDO would never leave."""
    rig = rig_with_rpdo(1)
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    assert written_by_sdo(rig) == [Mode.PROFILE_VELOCITY]
    rig.start_sync()
    agree_on(rig, Mode.PROFILE_VELOCITY)

    rig = rig_with_rpdo(1, live=False)
    rig.start_sync()
    rig.run(drive.set_mode(rig.axis, Mode.HOMING))
    assert written_by_sdo(rig) == [Mode.HOMING]
    rig.remote.enable_rpdo(WITH_MODE, rig.bus.now)
    agree_on(rig, Mode.HOMING)


@pytest.mark.parametrize("after", range(0, 10, 2))
def test_a_write_by_sdo_is_not_undone(after: int) -> None:
    """At whatever moment it falls between two SYNCs, the RPDO behind them has an older mode."""
    rig = rig_with_rpdo(1)
    rig.start_sync()
    rig.run(drive.set_mode(rig.axis, Mode.PROFILE_VELOCITY))
    rig.bus.run(after * MILLISECOND)
    shown = []
    rig.bus.on_event = lambda event: shown.append(rig.drive.mode)
    rig.run(write(rig.remote, "0x6060", Mode.HOMING))
    agree_on(rig, Mode.HOMING)
    assert shown == sorted(shown)  # pv, then homing, and not pv again


def test_a_mode_that_an_rpdo_asks_for_in_vain_is_asked_for_no_longer() -> None:
    rig = rig_with_rpdo(1)
    rig.start_sync()
    rig.run(drive.set_mode(rig.axis, Mode.HOMING))
    with pytest.raises(drive.ModeUnsupportedError, match="did not take up manufacturer’s mode -3; it shows homing"):
        rig.run(drive.set_mode(rig.axis, -3, waive_check=True))
    rig.bus.run(2 * CYCLE)
    agree_on(rig, Mode.HOMING)


def test_a_mode_beyond_its_object_is_refused_and_nothing_is_sent() -> None:
    rig = rig_with_rpdo(255)
    with pytest.raises(ValueError, match="modes_of_operation"):
        rig.run(drive.set_mode(rig.axis, 200, waive_check=True))
    assert MODES_OF_OPERATION not in rig.remote.commanded


def test_a_mode_that_is_there_already_is_the_one_that_the_rpdo_asks_for() -> None:
    """The drive takes no mode while it is enabled; another master has selected this one."""
    rig = rig_with_rpdo(1, live=False)
    rig.axis.settings = replace(rig.axis.settings, mode_change_state=State.SWITCHED_ON)
    rig.node.values.store[MODES_OF_OPERATION] = Mode.HOMING
    rig.drive.written(0x6060, 0, rig.bus.now)
    rig.run(drive.enable(rig.axis))
    rig.run(drive.set_mode(rig.axis, Mode.HOMING))
    assert rig.drive.state is State.OPERATION_ENABLED
    rig.start_sync()
    rig.remote.enable_rpdo(WITH_MODE, rig.bus.now)
    agree_on(rig, Mode.HOMING)
