"""Kill the master, the joint, the bus, the power, in every mode: the axis stands within a named detection time and its ramp.

The times are computed here, from the objects that are in force. The detection times are those of docs/limits.md: 0x1016 (the
heartbeat of the master), 0x1006 and `sync_tolerance` (SYNC), 0 for what the drive notices at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import pytest

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, NotHeldError, Watchdog
from canopen_proto.drives.cia402.states import State
from canopen_proto.heartbeat import HeartbeatLost, NmtStateReported, NodeBooted
from canopen_proto.machine import MILLISECOND, SECOND, Event, Time
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.nmt import NmtCommand
from canopen_proto.testing import Lose, Pause, boot_up
from tests.drives.watchdog_world import NODE, HeldDrive, without

FASTEST: Final = 25_000
"""0x607F: no mode goes faster, torque control neither."""
SPEED: Final = 20_000
SLOW_DOWN: Final = 50_000
QUICK_STOP: Final = 100_000
"""0x6084, 0x6085 (vl: 0x6049, 0x604A)."""
CYCLE: Final = 10 * MILLISECOND
LOOK: Final = 5 * MILLISECOND
SETTLING: Final = 15 * MILLISECOND
"""The time that a mass under torque control needs behind the end of its ramp, or until its brake has stopped it: 20 N·m stop
0.5 kg·m² from FASTEST, which is 0.44 rad/s, in 11 ms."""

RATES = {
    mux(0x607F): FASTEST, mux(0x6084): SLOW_DOWN, mux(0x6085): QUICK_STOP, mux(0x6049, 1): SLOW_DOWN, mux(0x604A, 1): QUICK_STOP,
    mux(0x60C2, 1): CYCLE // MILLISECOND, mux(0x1006): CYCLE // 1000,
}  # fmt: skip


class Motion(NamedTuple):
    """How a mode is set in motion. before: objects written before it is enabled; words: the last controlwords.

    each_cycle: object -> its change in each cycle, 0 for the same value again; with SYNC. None: the mode needs no cycle.
    """

    mode: int
    before: dict[Mux, int]
    words: tuple[int, ...] = (0x06, 0x07, 0x0F)
    each_cycle: tuple[Mux, int] | None = None


STEP = SPEED * CYCLE // SECOND
MOTIONS = {
    "pp": Motion(1, {mux(0x607A): 10**8, mux(0x6081): SPEED}, (0x06, 0x07, 0x0F, 0x1F)),
    "vl": Motion(2, {mux(0x6042): SPEED}, (0x06, 0x07, 0x0F, 0x7F)),
    "pv": Motion(3, {mux(0x60FF): SPEED}),
    "tq": Motion(4, {mux(0x6071): 300}),
    "hm": Motion(6, {mux(0x6098): 18, mux(0x6099, 1): SPEED}, (0x06, 0x07, 0x0F, 0x1F)),
    "ip": Motion(7, {}, (0x06, 0x07, 0x0F, 0x1F), (mux(0x60C1, 1), STEP)),
    "csp": Motion(8, {}, each_cycle=(mux(0x607A), STEP)),
    "csv": Motion(9, {mux(0x60FF): SPEED}, each_cycle=(mux(0x60FF), 0)),
    "cst": Motion(10, {mux(0x6071): 300}, each_cycle=(mux(0x6071), 0)),
}
BY_SYNC = [name for name, motion in MOTIONS.items() if motion.each_cycle]


class Cell:
    """A held drive in motion, its master, and who keeps it going."""

    def __init__(
        self,
        name: str,
        dictionary: ObjectDictionary | None = None,
        watchdog: Watchdog | None = DEFAULT_WATCHDOG,
        *,
        starts: bool = True,
    ) -> None:
        """starts: the node is Operational; else it is commanded by SDO in Pre-operational."""
        self.world = world = HeldDrive(dictionary)
        self.bus, self.motion = world.bus(), MOTIONS[name]
        if starts:
            self.bus.send(f"000#01{NODE:02X}")
        self.world.advance(MILLISECOND)
        self.gap = world.take_hold(watchdog) if watchdog else ""
        for key, value in (RATES | self.motion.before).items():
            if key in world.store:
                world.put(key, value)
        world.node.set_value(0x1017, 0, 50, self.world.now)
        world.remote.heartbeat.set_timeout(150 * MILLISECOND, self.world.now)
        world.put(mux(0x6060), self.motion.mode)
        self.feeds = self.syncs = bool(self.motion.each_cycle)
        self.set_point = 0
        for word in self.motion.words:
            world.put(mux(0x6040), word)
            self.run(50 * MILLISECOND)
        self.run(SECOND // 2)
        assert world.node.drive.state is State.OPERATION_ENABLED
        assert SPEED * 0.8 <= self.speed() <= FASTEST
        world.holder.events.clear()

    def run(self, duration: Time) -> None:
        """Let time pass; in each cycle the master gives a set-point, and then a SYNC."""
        if not self.syncs:
            self.world.advance(duration)
            return
        for _ in range(duration // CYCLE):
            if self.feeds and self.motion.each_cycle:
                key, step = self.motion.each_cycle
                self.set_point += step
                self.world.put(key, self.set_point if step else self.motion.before[key])
            self.bus.send("080#")
            self.world.advance(CYCLE)

    def speed(self) -> float:
        self.world.node.drive.refresh(self.world.now)
        servo = self.world.node.drive._servo
        return max(abs(servo.velocity), abs(servo.demand_velocity))

    def time_to_stand(self, limit: Time = 3 * SECOND) -> Time:
        """ns until it stands; `limit` if it does not."""
        began = self.world.now
        while self.speed() >= 1.0 and self.world.now < began + limit:
            self.run(CYCLE if self.syncs else LOOK)
        return self.world.now - began


def ramp(rate: int) -> Time:
    return FASTEST * SECOND // rate


def kill_master(cell: Cell) -> None:
    cell.world.kill_master()
    cell.feeds = cell.syncs = False


def kill_master_but_not_its_sync(cell: Cell) -> None:
    """Another device makes the SYNC."""
    kill_master(cell)
    cell.syncs = True


def cut_bus(cell: Cell) -> None:
    cell.world.add_faults(Lose())
    cell.feeds = cell.syncs = False


def reset_joint(cell: Cell) -> None:
    cell.world.node.execute(NmtCommand.RESET_NODE, cell.world.now)


def reset_communication(cell: Cell) -> None:
    cell.world.node.execute(NmtCommand.RESET_COMMUNICATION, cell.world.now)


def take_power(cell: Cell) -> None:
    cell.world.add_faults(Lose(boot_up(NODE)), Pause(NODE, on=boot_up(NODE)))
    cell.world.node.execute(NmtCommand.RESET_NODE, cell.world.now)


def stop_node(cell: Cell) -> None:
    cell.bus.send(f"000#02{NODE:02X}")


class Kill(NamedTuple):
    """happen: the end of something; detection: the longest time until the drive notices; rate: how it brakes, 0: without power.

    told: the event by which the master learns of it; None: the master is what was killed.
    """

    happen: Callable[[Cell], None]
    detection: Time
    rate: int
    told: type[Event] | None = None


CONSUMER_TIME = DEFAULT_WATCHDOG.timeout
KILLS = {
    "master": Kill(kill_master, CONSUMER_TIME, QUICK_STOP),
    "master, not SYNC": Kill(kill_master_but_not_its_sync, CONSUMER_TIME, QUICK_STOP),
    "bus": Kill(cut_bus, CONSUMER_TIME, QUICK_STOP, HeartbeatLost),
    "joint": Kill(reset_joint, 0, 0, NodeBooted),
    "communication": Kill(reset_communication, 0, QUICK_STOP, NodeBooted),
    "power": Kill(take_power, 0, 0, HeartbeatLost),
    "NMT": Kill(stop_node, 0, QUICK_STOP, NmtStateReported),
}


def allowed(kill: Kill) -> Time:
    return kill.detection + (ramp(kill.rate) if kill.rate else 0) + SETTLING + CYCLE


@pytest.mark.thorough(5)
@pytest.mark.parametrize("name", KILLS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_it_stands_within_the_detection_time_and_its_ramp(motion: str, name: str) -> None:
    cell, kill = Cell(motion), KILLS[name]
    kill.happen(cell)
    assert cell.time_to_stand() <= allowed(kill)
    stood = cell.world.node.drive._servo.position
    cell.run(SECOND)
    assert cell.speed() < 1.0
    assert cell.world.node.drive._servo.position == pytest.approx(stood, abs=30)
    assert cell.world.node.drive.state is State.SWITCH_ON_DISABLED
    assert kill.told is None or any(isinstance(event, kill.told) and event.node_id == NODE for event in cell.world.holder.events)


@pytest.mark.thorough(3)
@pytest.mark.parametrize("name", ["joint", "communication", "NMT"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_drive_that_is_commanded_in_pre_operational_is_stopped_by_nmt_too(motion: str, name: str) -> None:
    """It gets no command any more (no SDO in Stopped), and a reset has ended its watch over the master (0x1016)."""
    cell, kill = Cell(motion, starts=False), KILLS[name]
    kill.happen(cell)
    assert cell.time_to_stand() <= allowed(kill)
    cell.run(SECOND)
    assert cell.world.node.drive.state is State.SWITCH_ON_DISABLED


SYNC_TIME = 100 * MILLISECOND
"""Three periods of 10 ms, and 100 ms at least."""


@pytest.mark.parametrize("name", BY_SYNC)
def test_without_a_watchdog_a_lost_sync_stops_the_modes_that_need_it(name: str) -> None:
    cell = Cell(name, watchdog=None)
    kill_master(cell)
    assert cell.time_to_stand() <= SYNC_TIME + ramp(QUICK_STOP) + SETTLING + CYCLE
    assert cell.world.node.drive.state is State.OPERATION_ENABLED


@pytest.mark.thorough(3)
@pytest.mark.parametrize(
    ("option", "rate", "state"),
    [(1, QUICK_STOP, State.FAULT), (2, 0, State.SWITCH_ON_DISABLED), (3, QUICK_STOP, State.SWITCH_ON_DISABLED)],
)
@pytest.mark.parametrize("name", MOTIONS)
def test_each_reaction_that_a_watchdog_may_ask_for(name: str, option: int, rate: int, state: State) -> None:
    cell = Cell(name, watchdog=Watchdog(abort_connection=option))
    assert cell.gap == ""
    kill_master(cell)
    assert cell.time_to_stand() <= allowed(Kill(kill_master, CONSUMER_TIME, rate))
    cell.world.advance(SECOND)
    assert cell.world.node.drive.state is state


@pytest.mark.thorough(5)
@pytest.mark.parametrize("lacks", [0x6007, 0x1016])
@pytest.mark.parametrize("name", MOTIONS)
def test_a_drive_that_cannot_notice_it_is_named_before_it_moves(name: str, lacks: int) -> None:
    """It goes on for ever in the modes that need no SYNC, and the master has said so. If it must not, it is not enabled."""
    cell = Cell(name, without(lacks))
    assert f"0x{lacks:04X}" in cell.gap
    kill_master(cell)
    assert (cell.time_to_stand() < 3 * SECOND) is (name in BY_SYNC)
    with pytest.raises(NotHeldError, match=f"would not stop by itself .*0x{lacks:04X}"):
        HeldDrive(without(lacks)).take_hold(Watchdog(required=True))
