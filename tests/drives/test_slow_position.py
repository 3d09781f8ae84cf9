"""Set-points in profile position: the handshake on the wire, the lag that the watch allows, what ends it."""

from __future__ import annotations

from collections.abc import Callable, Collection

import pytest

from canopen_proto.dictionary import Direction
from canopen_proto.drives.axis import ModeUnsupportedError, engage_brake, halt, quick_stop, read_statusword
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.following import Following, FollowingLost
from canopen_proto.drives.axis.limits import Limit
from canopen_proto.drives.axis.slow_position import (
    HANDSHAKE_SYNCS,
    HANDSHAKE_TIME,
    feed_targets,
    profile_lag,
    start_slow_position,
)
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import Command, ControlBit
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.multiplexer import Mux
from canopen_proto.pdo.configure import configure_pdo, use_device_pdo
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.procedures.runner import ProcedureFinished
from canopen_proto.procedures.steps import Procedure
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from tests.drives.rig import CYCLE, Rig

RPDO = 3  # controlword, then target position
RPDO_CAN_ID = 0x405


class Feeding:
    """A drive that is fed with targets by that RPDO."""

    def __init__(self, transmission_type: int, reaction: Time = 0) -> None:
        self.rig = rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings(reaction=reaction))
        entries = (0x6040_0010, 0x607A_0020)
        rig.run(configure_pdo(rig.remote, PdoSettings(RPDO, Direction.RPDO, RPDO_CAN_ID, transmission_type, entries)))
        rig.run(use_device_pdo(rig.remote, Direction.RPDO, RPDO))
        rig.start_sync()
        self.following = Following(rig.axis)
        self.start()

    def start(self) -> None:
        rig = self.rig
        rig.run(start_slow_position(rig.axis))
        self.following.begin(Limit(1e9, "no limit"), 1, cyclic={}, slack=100)
        self.feeding = rig.master.run(feed_targets(self.following), rig.bus.now)

    def halt(self) -> None:
        self.rig.master.cancel(self.feeding, self.rig.bus.now)
        self.rig.run(halt(self.rig.axis))

    def commands(self) -> list[tuple[bool, int]]:
        """Return bit 4 and target of each RPDO so far."""
        frames = [frame.data for _, frame in self.rig.bus.sent if frame.can_id == RPDO_CAN_ID]
        return [(bool(data[0] & 0x10), int.from_bytes(data[2:6], "little", signed=True)) for data in frames]


def edges_of(commands: list[tuple[bool, int]]) -> list[int]:
    """Return the places at which bit 4 rises."""
    return [place for place in range(1, len(commands)) if commands[place][0] and not commands[place - 1][0]]


@pytest.mark.parametrize("transmission_type", [255, 1])
def test_a_target_is_in_the_drive_before_bit_4_rises(transmission_type: int) -> None:
    feeding = Feeding(transmission_type)
    rig = feeding.rig
    for target in (4_000, 5_000, 3_500):
        rig.axis.set_points.set_position_counts(target)
        rig.bus.run(600 * MILLISECOND)
    commands = feeding.commands()
    edges = edges_of(commands)
    assert [commands[place][1] for place in edges[-3:]] == [4_000, 5_000, 3_500]
    assert all(commands[place - 1][1] == commands[place][1] for place in edges)
    assert rig.axis.node.values.store[objects.TARGET_POSITION] == 3_500
    feeding.halt()
    assert rig.node.values.store[objects.POSITION_ACTUAL_VALUE] == 3_500


def test_the_newest_set_point_is_next_and_the_others_are_skipped() -> None:
    feeding = Feeding(1)
    for step in range(50):
        feeding.rig.axis.set_points.set_position_counts(3_000 + 10 * step)
        feeding.rig.bus.run(CYCLE)
    commands = feeding.commands()
    targets = [commands[place][1] for place in edges_of(commands)]
    assert targets == sorted(targets)
    assert 5 < len(targets) < 9  # at every seventh SYNC


def test_a_quick_drive_gets_no_more_than_20_targets_a_second() -> None:
    feeding = Feeding(255)
    before = len(edges_of(feeding.commands()))
    for step in range(100):
        feeding.rig.axis.set_points.set_position_counts(3_000 + 10 * step)
        feeding.rig.bus.run(CYCLE)
    assert 15 < len(edges_of(feeding.commands())) - before <= 21


def test_a_slow_drive_gets_its_next_target_once_it_has_taken_the_last_one() -> None:
    feeding = Feeding(255, reaction=50 * MILLISECOND)
    for step in range(100):
        feeding.rig.axis.set_points.set_position_counts(3_000 + 10 * step)
        feeding.rig.bus.run(CYCLE)
    assert 5 < len(edges_of(feeding.commands())) <= 11  # 50 ms for each edge of bit 4


def test_the_target_that_a_halt_has_kept_is_dropped_before_the_drive_may_move() -> None:
    feeding = Feeding(1)  # there are SYNCs in between, in which it could move
    rig = feeding.rig
    rig.axis.set_points.set_position_counts(90_000)
    rig.bus.run(SECOND)
    feeding.halt()
    positions = set()

    def look(muxes: Collection[Mux], now: Time) -> None:
        rig.drive.refresh(rig.bus.now)
        positions.add(rig.node.values.store[objects.POSITION_ACTUAL_VALUE])

    rig.remote.add_listener(look)
    feeding.start()
    rig.bus.run(SECOND)
    rig.run(read_statusword(rig.axis))
    assert 10_000 < min(positions) == max(positions) < 80_000  # type: ignore[type-var, operator]


@pytest.mark.parametrize("stop", [halt, quick_stop, engage_brake])
def test_no_target_under_way_undoes_a_stop(stop: Callable[[Axis], Procedure[None]]) -> None:
    """The stop is another task's: the feeding is told by nobody but the axis. The drive answers late, so a target takes long."""
    for later in range(0, 60, 3):
        feeding = Feeding(255, reaction=20 * MILLISECOND)
        rig = feeding.rig
        rig.axis.occupancy.occupy("chain arm")
        for step in range(40):
            rig.axis.set_points.set_position_counts(3_000 + 100 * step)
            rig.bus.run(CYCLE)
        rig.bus.run(later * MILLISECOND)
        stopping = rig.master.run(stop(rig.axis), rig.bus.now)
        rig.axis.set_points.set_position_counts(90_000)
        began = len(rig.bus.sent)
        assert isinstance(rig.outcome(stopping), ProcedureFinished)
        rig.bus.run(SECOND)
        frames = [frame.data for _, frame in rig.bus.sent[began:]]
        words = [data[0] | data[1] << 8 for data in frames if len(data) == 6]
        assert all(word & ControlBit.HALT for word in words if word & 0x0F == Command.ENABLE_OPERATION)
        lost = [event.cause for event in rig.bus.events if isinstance(event, FollowingLost)]
        assert not any("takes no more targets" in cause for cause in lost)


def test_a_fed_drive_that_loses_its_mode_ends_the_watch() -> None:
    feeding = Feeding(255)
    rig = feeding.rig
    rig.node.values.store[objects.MODES_OF_OPERATION] = 3
    rig.drive.written(0x6060, 0, rig.bus.now)
    rig.axis.set_points.set_position_counts(4_000)
    rig.bus.run(10 * SECOND)
    (lost,) = [event for event in rig.bus.events if isinstance(event, FollowingLost)]
    assert "takes no more targets" in lost.cause or "changed its mode" in lost.cause


def test_a_drive_without_profile_position_is_refused() -> None:
    rig = Rig(Shape.STANDARD, pdos=False)
    rig.node.values.store[objects.SUPPORTED_DRIVE_MODES] = 0x80
    with pytest.raises(ModeUnsupportedError):
        rig.run(start_slow_position(rig.axis))


@pytest.mark.parametrize(
    ("values", "cycle", "ramps"),
    [
        ({}, CYCLE, 0.4),  # 20,000 and twice 100,000
        ({objects.PROFILE_VELOCITY: 50_000, objects.PROFILE_DECELERATION: 200_000}, CYCLE, 0.75),
        ({objects.PROFILE_ACCELERATION: 1}, CYCLE, 2.0),  # no longer than that
        ({objects.PROFILE_VELOCITY: 0}, CYCLE, 1.0),  # it does not tell
        ({}, 5 * CYCLE, 0.4),
    ],
)
def test_how_far_it_may_be_behind(values: dict[Mux, int], cycle: int, ramps: float) -> None:
    rig = Rig(Shape.STANDARD, pdos=False, drive=DriveSettings())
    rig.node.values.store.update(values)
    handshakes = max(HANDSHAKE_TIME, HANDSHAKE_SYNCS * cycle)
    assert rig.run(profile_lag(rig.axis, cycle)) == handshakes + round(ramps * SECOND)
