"""`--dry-run` of commands that command drives: the command is rehearsed on a likeness of each drive, and its frames are shown.

The drive itself is only read. A simulated drive then gets the values that were read, in the same state, on a bus of its own and
in virtual time. It gets the command, and the frames of our side are kept. So the frames depend on what the drive shows: the way
from its state, its modes, its limits, its refusals. The end by Ctrl-C is rehearsed too, for a command that has no other.

The likeness has its limits: the real drive may refuse what the simulated one accepts; its switches are not known, nor how long
its motions take. A drive that moves now is taken as one that stands.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, NamedTuple

import trio
import trio.testing

from canopen_cli.shared.frames_shown import show_frames
from canopen_cli.shared.options import Settings
from canopen_cli.shared.problem import usage
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, node_text
from canopen_cli.shared.session import BusSession, open_session
from canopen_data.configured import configure
from canopen_data.drive_from_file import drive_dictionary_of, drive_obstacle
from canopen_master.motion.joint_procedures import ensure_answers
from canopen_master.node import Node
from canopen_master.simulation.host import DeviceMaker
from canopen_master.simulation.serving import SimulatedDevices, simulated_devices
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.axes import axes_of, swapped
from canopen_proto.drives.cia402.states import FAULT_STATES, State, state_of
from canopen_proto.machine import Time
from canopen_proto.manager.parameters.walk import walk
from canopen_proto.multiplexer import Mux, index_of, mux, split_mux
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.procedures.steps import Procedure
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from canopen_transports.record import Record
from canopen_transports.tracing import recording

LOCATOR: Final = "virtual:dry-run"
INTERRUPTED_AFTER: Final = 1.0
"""Seconds of virtual time after which a command that has no end of its own is ended, as Ctrl-C would."""

_GENERIC_ERROR: Final = 0x1000
"""The error code of a fault that the drive does not name."""
_WORDS: Final = {State.READY_TO_SWITCH_ON: (0x06,), State.SWITCHED_ON: (0x06, 0x07), State.OPERATION_ENABLED: (0x06, 0x07, 0x0F)}
"""A state -> the controlwords that lead there from Switch on disabled."""


class ShownState(NamedTuple):
    """The state of the drive on an axis, as it was read."""

    axis: int
    state: State
    mode: int
    error_code: int


@dataclass(frozen=True)
class Likeness:
    """A node as it was read. make: makes the simulated one. axes: its drives."""

    node_id: int
    make: DeviceMaker
    axes: tuple[ShownState, ...]
    is_operational: bool

    def prepare(self, node: DriveNode, now: Time) -> None:
        """Lead the simulated drives, which have just booted, to the states that were read."""
        if self.is_operational:
            node.execute(NmtCommand.START, now)
        for axis, state, mode, error_code in self.axes:
            node.write(*split_mux(swapped(objects.MODES_OF_OPERATION, axis)), mode.to_bytes(1, "little", signed=True), now)
            if state in FAULT_STATES:
                node.raise_fault(error_code or _GENERIC_ERROR, now, axis=axis)
            for word in _WORDS.get(state, ()):
                node.write(*split_mux(swapped(objects.CONTROLWORD, axis)), word.to_bytes(2, "little"), now)


class Frames:
    """Keeps what is recorded: a `LogWriter` without a file."""

    def __init__(self) -> None:
        self.left_out = 0
        self.records: list[Record] = []

    def write(self, record: Record) -> None:
        self.records.append(record)

    def lost(self, time: int, channel: str) -> None:
        """Likenesses lose nothing."""

    def close(self) -> None:
        """Nothing to close."""


def rehearse(
    settings: Settings,
    screen: Screen,
    node_ids: Sequence[int],
    work: Callable[[BusSession], Awaitable[object]],
    *,
    ends: bool = True,
    axis: int = 0,
) -> None:
    """Do `work` on likenesses of these drives, and show the frames that it sends. ends: it ends without a Ctrl-C.
    axis: of each node.

    Nothing is sent to the drives, except what reads them. Raises what `work` raises, once the frames are shown.
    """
    likenesses: list[Likeness] = []

    async def look() -> BusSession:
        async with open_session(settings, screen) as session:
            likenesses.extend([await session.master.run(likeness_of(session.node(node_id, axis))) for node_id in node_ids])
            return session

    session = run(settings, screen, look)
    frames = Frames()
    clock = trio.testing.MockClock(autojump_threshold=0)
    apart = replace(settings, bus=LOCATOR, trace=None, clock=clock, dry_run=False)

    async def perform() -> None:
        async with simulated_devices({LOCATOR: [each.make for each in likenesses]}) as served:
            prepare(served, likenesses)
            async with open_session(apart, screen) as rehearsal:
                frames.records.clear()
                with trio.move_on_after(float("inf") if ends else INTERRUPTED_AFTER):
                    await work(rehearsal)

    try:
        with recording(frames):
            run(apart, screen, perform)
    finally:
        records = [record._replace(channel="") for record in frames.records]
        show_frames(settings, screen, records, lambda bus, node_id: session.dictionary_of(node_id))
    screen.say("nothing of this was sent: a simulated drive with the values of yours has answered. Yours may answer otherwise")


def prepare(served: SimulatedDevices, likenesses: Sequence[Likeness]) -> None:
    """Lead the simulated drives, which have just booted, to the states that were read. likenesses: what was read of each
    drive."""
    for each in likenesses:
        served.change(each.node_id, each.prepare)


def likeness_of(node: Node) -> Procedure[Likeness]:
    """Read the drives of a node. Raises a CommandError if no simulated drive can stand for it."""
    yield from ensure_answers(node)
    axes = axes_of(node.dictionary) or (0,)
    ranges = [sorted({index_of(swapped(mux(index), axis)) for axis in axes for index in drive_dictionary().objects})]
    read = yield from walk(node.remote, ranges, names=node.remote.dictionary)
    obstacle = drive_obstacle(read.dictionary)
    if obstacle:
        raise usage(
            "CO410",
            f"no simulated drive can stand for {node_text(node.node_id)}, so nothing was rehearsed",
            seen=obstacle,
            tries=(f"canopen info {node.node_id}    what it is",),
        )
    values = read.values

    def value_of(key: Mux, axis: int = 0) -> int:
        value = values.get(swapped(key, axis))
        return value if isinstance(value, int) else 0

    shape = Shape.SCHUNK_POWERBALL if value_of(objects.VENDOR_ID) == objects.SCHUNK_VENDOR_ID else Shape.STANDARD
    dictionary, _ = drive_dictionary_of(configure(read.dictionary, values, node.node_id), shape)
    drives, shown = [], []
    for axis in axes_of(dictionary) or (0,):
        position = float(value_of(objects.POSITION_ACTUAL_VALUE, axis))
        track = Track().moved(position)  # its own is not known: there are switches to home by, wherever it stands
        drives.append(DriveSettings(shape=shape, position=position, track=track, stops_at_switches=False))
        mode, error_code = (value_of(key, axis) for key in (objects.MODES_OF_OPERATION_DISPLAY, objects.ERROR_CODE))
        shown.append(ShownState(axis, state_of(value_of(objects.STATUSWORD, axis)), mode, error_code))
    settings = replace(drives[0], further_axes=tuple(drives[1:]))
    made = partial(DriveNode, node_id=node.node_id, settings=settings, dictionary=dictionary)
    return Likeness(node.node_id, made, tuple(shown), node.nmt_state is NmtState.OPERATIONAL)
