"""A limit switch stops a drive of ours: the master says which one, and moves the drive away again."""

from __future__ import annotations

import pytest

from canopen_proto.dictionary import Direction
from canopen_proto.drives.axis import LimitReachedError, move_to, start_cyclic_position, start_interpolation
from canopen_proto.drives.axis.axis import AxisSettings
from canopen_proto.drives.axis.controlword import put
from canopen_proto.drives.axis.reasons import look_at, reasons
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import ModeStatus
from canopen_proto.drives.cia402.states import StatusBit
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.drives.rig import CYCLE, Rig

LIMIT = 10_000
COUNTS = AxisSettings(counts_per_unit=1)


def rig_with_switches(position: float = 0, reaction: int = 0) -> Rig:
    rig = Rig(Shape.STANDARD, drive=DriveSettings(position=position, track=Track(-LIMIT, LIMIT), reaction=reaction))
    rig.axis.settings = COUNTS
    return rig


@pytest.mark.parametrize(("direction", "name"), [(1, "positive"), (-1, "negative")])
def test_a_move_onto_the_switch_says_so_at_once_and_a_move_away_works(direction: int, name: str) -> None:
    rig = rig_with_switches(reaction=50 * MILLISECOND)
    began = rig.bus.now
    with pytest.raises(LimitReachedError, match=f"it stands on its {name} limit switch \\(0x60FD\\).*Try: ") as caught:
        rig.run(move_to(rig.axis, direction * 30_000, timeout=60 * SECOND))
    assert rig.bus.now - began < 5 * SECOND
    assert f"not at its target {direction * 30_000}" in str(caught.value)
    view = rig.run(look_at(rig.remote))
    assert view is not None
    assert any(f"{name} limit switch" in each.what for each in reasons(view))
    place = rig.drive._servo.position
    assert LIMIT <= place * direction < LIMIT + 1_000
    with pytest.raises(LimitReachedError, match=name):  # further: it does not move
        rig.run(move_to(rig.axis, direction * 30_000, timeout=60 * SECOND))
    assert rig.drive._servo.position == pytest.approx(place, abs=1)
    rig.run(move_to(rig.axis, 0, timeout=60 * SECOND))
    assert rig.drive._servo.position == pytest.approx(0, abs=11)
    assert not rig.axis.statusword & StatusBit.INTERNAL_LIMIT


STARTS = {"ip": start_interpolation, "csp": start_cyclic_position}


@pytest.mark.parametrize("mode", STARTS)
def test_set_points_away_from_the_switch_are_followed(mode: str) -> None:
    rig = rig_with_switches()
    if mode == "csp":
        rig.run(use_device_pdo(rig.remote, Direction.RPDO, 3))
    rig.start_sync()

    def follow(step: int, cycles: int) -> None:
        begin = rig.run(STARTS[mode](rig.axis, CYCLE))
        for number in range(cycles):
            rig.axis.set_points.set_position(begin + step * number)
            put(rig.axis, objects.CONTROLWORD, rig.axis.controlword, rig.bus.now)  # sends the event-driven RPDO of csp
            rig.bus.run(CYCLE)

    follow(200, 120)  # 24 000 counts: over the switch
    view = rig.run(look_at(rig.remote))
    assert view is not None
    assert not view.statusword & ModeStatus.FOLLOWS_COMMAND  # the same bit in ip
    assert any("positive limit switch" in each.what for each in reasons(view))
    assert LIMIT <= rig.drive._servo.position < LIMIT + 1_000
    follow(200, 30)  # further: it stays
    assert rig.drive._servo.position < LIMIT + 1_000
    follow(-200, 30)
    assert rig.drive._servo.position < LIMIT - 4_000
    assert not rig.axis.statusword & StatusBit.INTERNAL_LIMIT
