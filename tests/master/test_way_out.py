"""Leaving the master stops every drive: whatever it is and does, however it is commanded, and however the master is left.

All drives of the table stand on one bus and move at once. When the block has been left, each has velocity 0, or was named as one
that did not confirm that it stands.
"""

from __future__ import annotations

import asyncio
import itertools
import signal
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import pytest

from canopen_master import AxisSettings, HaltNotConfirmedError, HomingStyle, Host, Master, open_master
from canopen_proto.application import PlainMemory
from canopen_proto.dictionary import Direction
from canopen_proto.drives.axis import command, enable, set_mode
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.modes import Mode, ModeControl
from canopen_proto.drives.cia402.states import Command
from canopen_proto.pdo.configure import use_device_pdo
from canopen_proto.procedures.objects import write
from canopen_proto.procedures.steps import Procedure, act, all_of
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from canopen_proto.sync import SyncSent
from canopen_transports.loop import TaskStatus
from tests.examples import takes_all
from tests.loops import beside, loop
from tests.master.world import BUS, drives, simulated, value, virtual_time

PERIOD = 0.05
"""Seconds between two SYNCs."""
SPEED = 20_000
"""Counts/s."""
MODES = {
    Shape.STANDARD: (Mode.PROFILE_POSITION, Mode.PROFILE_VELOCITY, Mode.HOMING, Mode.INTERPOLATED_POSITION,
                     Mode.CYCLIC_SYNCHRONOUS_POSITION),
    Shape.SCHUNK_POWERBALL: (Mode.PROFILE_POSITION, Mode.VELOCITY, Mode.HOMING, Mode.INTERPOLATED_POSITION),
}  # fmt: skip
RPDOS = {"sdo": 0, "event-driven pdo": 1, "synchronous pdo": 4}
"""How the controlword goes: the standard drive's RPDO. The Powerball's only one is synchronous."""
DICTIONARIES = {shape: drive_dictionary(shape) for shape in Shape}
SET_POINTS = {Mode.INTERPOLATED_POSITION: "0x60C1:01", Mode.CYCLIC_SYNCHRONOUS_POSITION: "0x607A"}


class OurError(Exception):
    pass


@dataclass(frozen=True)
class Row:
    """A drive of the table."""

    node_id: int
    shape: Shape
    mode: Mode
    control: str
    style: HomingStyle | None

    def make(self) -> partial[DriveNode]:
        track = Track(-1e9, 1e9, home_switch=(-1e9, -1e8))  # homing takes a while
        settings = DriveSettings(shape=self.shape, track=track, homing_method=19)
        return partial(DriveNode, node_id=self.node_id, settings=settings, dictionary=DICTIONARIES[self.shape])

    def __str__(self) -> str:
        return f"node {self.node_id}: {self.shape.value} drive, {self.mode.name}, {self.control}, treated as {self.style}"


def table() -> Iterator[Row]:
    numbers = itertools.count(1)
    for shape in Shape:
        for mode, control, style in itertools.product(MODES[shape], RPDOS, (None, *HomingStyle)):
            if shape is Shape.STANDARD or control != "event-driven pdo":
                yield Row(next(numbers), shape, mode, control, style)


ROWS = tuple(table())


def begin(axis: Axis, row: Row) -> Procedure[None]:
    """Let the drive move."""
    node, rpdo = axis.node, RPDOS[row.control]
    if rpdo:
        number = rpdo if row.shape is Shape.STANDARD else 1
        yield from use_device_pdo(node, Direction.RPDO, number)
        yield from act(lambda now: node.enable_rpdo(number, now))
    yield from set_mode(axis, row.mode, waive_check=True)
    if row.mode is Mode.HOMING and row.shape is Shape.STANDARD:
        yield from write(node, "0x6098", 19)
    yield from write(node, "0x60C2:01", round(PERIOD * 1000))
    yield from enable(axis)
    match row.mode:
        case Mode.PROFILE_POSITION:
            yield from write(node, "0x607A", 10_000_000)
        case Mode.PROFILE_VELOCITY:
            yield from write(node, "0x60FF", SPEED)
        case Mode.VELOCITY:
            yield from write(node, "0x6042", SPEED)
    ramps = ModeControl.ENABLE_RAMP | ModeControl.UNLOCK_RAMP | ModeControl.REFERENCE_RAMP
    bits = {Mode.PROFILE_VELOCITY: 0, Mode.CYCLIC_SYNCHRONOUS_POSITION: 0, Mode.VELOCITY: ramps}.get(row.mode, 0x10)
    yield from command(axis, int(Command.ENABLE_OPERATION))
    yield from command(axis, Command.ENABLE_OPERATION | bits)


async def keep_moving(master: Master, rows: Sequence[Row], task_status: TaskStatus[None]) -> None:
    """Have all drives move; started when they do."""
    await master.nmt_start()
    master.sync_start(PERIOD)
    axes = {}
    for row in rows:
        node = master.node(row.node_id, DICTIONARIES[row.shape])
        axes[row] = master.device(node, settings=AxisSettings(homing=row.style)).axis
    await master.run(all_of(*(begin(axis, row) for row, axis in axes.items())))
    followers = [(axis, SET_POINTS[row.mode]) for row, axis in axes.items() if row.mode in SET_POINTS]
    for cycle in itertools.count(1):
        position = 3_000 + round(SPEED * PERIOD) * cycle
        await master.run(all_of(*(write(axis.node, key, position) for axis, key in followers)))
        await loop.sleep(PERIOD)
        if cycle == 5:
            task_status.started()


async def leave(way: str, host: Host, rows: Sequence[Row], obey: bool) -> None:
    """Let the drives move, and leave the master by that way. obey: else they take no more commands, and go on."""
    scope = loop.cancel_scope()
    with scope:
        async with open_master(BUS) as master, loop.open_nursery() as nursery:
            await nursery.start(keep_moving, master, rows)
            assert [str(row) for row, speed in speeds(host, rows).items() if not speed] == []
            if not obey:
                for node in drives(host):
                    node.application = PlainMemory()
            match way:
                case "end":
                    nursery.cancel_scope.cancel()
                case "exception":
                    raise OurError
                case "cancel":
                    scope.cancel()
                case "ctrl-c":
                    signal.raise_signal(signal.SIGINT)
                case "two ctrl-c":
                    beside(press, 0.0, 0.009)
                case "failing callback":
                    master.watch((SyncSent,), fail)
            await loop.sleep_forever()


async def press(*pauses: float) -> None:
    for seconds in pauses:
        await loop.sleep(seconds)
        signal.raise_signal(signal.SIGINT)


def fail(report: SyncSent) -> None:
    raise OurError


def speeds(host: Host, rows: Sequence[Row]) -> dict[Row, int]:
    for node in drives(host):
        node.drive.refresh(host.now())
    return {row: value(node, objects.VELOCITY_ACTUAL_VALUE) for row, node in zip(rows, drives(host), strict=True)}


def after(way: str, rows: Sequence[Row], deceleration: int, obey: bool = True) -> tuple[dict[Row, int], BaseException | None]:
    """The speeds when the master has been left, and what came out of its block."""
    found: list[tuple[dict[Row, int], BaseException | None]] = []

    @virtual_time
    async def test() -> None:
        async with simulated(makers=[row.make() for row in rows]) as host:
            for node in drives(host):
                node.values.store[objects.PROFILE_DECELERATION] = deceleration
            came: BaseException | None = None
            try:
                await leave(way, host, rows, obey)
            except BaseException as error:  # noqa: BLE001 - looked at by the test
                came = error
            found.append((speeds(host, rows), came))

    with suppress(KeyboardInterrupt):  # on asyncio it is a cancel here, and comes out of asyncio.run
        test()
    velocities, came = found[-1]
    return velocities, KeyboardInterrupt() if isinstance(came, asyncio.CancelledError) else came


def kinds_and_notes(error: BaseException | None) -> tuple[set[type[BaseException]], str]:
    """What an exception is, or what a group consists of; and all that it says, with its notes."""
    if error is None:
        return set(), ""
    kinds, text = set(), "\n".join([str(error), *getattr(error, "__notes__", ())])
    for each in error.exceptions if isinstance(error, BaseExceptionGroup) else ():
        inner = kinds_and_notes(each)
        kinds, text = kinds | inner[0], f"{text}\n{inner[1]}"
    return kinds or {type(error)}, text


WAYS: dict[str, set[type[BaseException]]] = {
    "end": set(),
    "exception": {OurError},
    "cancel": set(),
    "ctrl-c": {KeyboardInterrupt},
    "two ctrl-c": {KeyboardInterrupt},
    "failing callback": {OurError},
}
"""What comes out of the block, if all drives stand."""


@pytest.mark.thorough(3)
@pytest.mark.parametrize("way", WAYS)
def test_every_way_out_stops_every_drive(way: str) -> None:
    """Every day each drive is left by two ways."""
    place = 0 if takes_all() else [*WAYS].index(way) % 3
    velocities, came = after(way, ROWS[place :: 1 if takes_all() else 3], 400_000)
    assert {str(row): speed for row, speed in velocities.items() if speed} == {}
    kinds, text = kinds_and_notes(came)
    assert kinds == WAYS[way]
    assert "not confirmed" not in text


@pytest.mark.thorough(2)
@pytest.mark.parametrize("way", ["end", "exception", "cancel", "two ctrl-c"])
def test_a_drive_that_still_moves_is_told_however_the_master_is_left(way: str) -> None:
    """It does not obey any more. One whose ramp takes long is waited for, unless somebody presses Ctrl-C again.

    What tells of it stands in the exception: none that a cancel scope swallows.
    """
    obey = way == "two ctrl-c"
    style = HomingStyle.STANDARD if obey else HomingStyle.SCHUNK
    rows = [row for row in ROWS if row.control == "sdo" and row.shape is Shape.STANDARD and row.style is style]
    velocities, came = after(way, rows, 5_000, obey)
    kinds, text = kinds_and_notes(came)
    assert [str(row) for row, speed in velocities.items() if speed and f"(node {row.node_id} on" not in text] == []
    assert len([speed for speed in velocities.values() if speed]) > len(rows) / 3
    assert kinds == WAYS[way] or kinds == {HaltNotConfirmedError}
    assert kinds
