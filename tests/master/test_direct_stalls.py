"""A script of `direct` that stalls, or whose process does: it goes on slowly, or ends with our own lateness as the cause.

In virtual time: the script's part of `send_pos` and `send_sync` runs as a task beside the master's.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

import pytest
import trio
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_master import Host, Master, NodeSilentError, open_master, powerballs
from canopen_master.direct import Session
from canopen_master.direct.connection import Connection
from canopen_master.direct.drive import COUNTS, DirectDrive, HandSync
from canopen_master.participant.participant import ON_TIME
from canopen_master.simulation.host import IN_PROCESS
from canopen_proto.abort import AbortCode
from canopen_proto.drives.axis import DriveError
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND
from canopen_proto.network import Network
from canopen_proto.procedures.steps import ProcedureError
from canopen_proto.simulation.drive.answers import Answer
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import SYNC_TOLERANCE
from canopen_transports import VirtualTransport
from tests.examples import examples
from tests.master.direct_world import devices
from tests.master.test_stalls import stall
from tests.master.world import BUS, drives, position_of, simulated, virtual_time

pytestmark = pytest.mark.trio_only("`direct` has a trio loop of its own")

INTERVAL = 10 * MILLISECOND
PERIOD = 0.01
LIMIT = 10_550.0
"""Counts per second: the drives' speed limit. The path is slower by as much as a SYNC may come too early (ON_TIME)."""
STEP = int(LIMIT * PERIOD * (1 - 1 / ON_TIME))

RAMP = 40_000
"""Counts per second²: without SYNC a drive goes on by a dozen steps until it stands."""
NODES = (3, 4)
WAYS = {3: 1.0, 4: -0.5}

Turn = tuple[bool, float, float]
"""Whether the whole process stalls, or only the script; for how long; and the time until the next turn."""

times = st.one_of(st.just(0.0), st.floats(0.0, 0.02), st.floats(0.0, 0.3))
turns = st.lists(st.tuples(st.booleans(), times, times), min_size=1, max_size=6)


class Script:
    """The manual's script: to and fro, one step each 10 ms, as fast as it gets its turn. synced: when each SYNC was sent."""

    def __init__(self, master: Master, host: Host, arm: Sequence[DirectDrive], hand_sync: HandSync) -> None:
        self.master, self.host, self.arm, self.hand_sync = master, host, arm, hand_sync
        self.wanted = {drive: drive.axis.set_points.position for drive in arm}
        self.synced: list[float] = []
        self.largest = 0.0
        self.pause = 0.0
        self._due = 0.0

    async def send_pos(self, drive: DirectDrive, position: float) -> None:
        if not drive.give(round(position)):
            await drive.send_position(round(position))

    async def send_sync(self) -> None:
        await self.hand_sync.send(INTERVAL)
        self.synced.append(trio.current_time())
        now = trio.current_time()
        self._due = self._due + PERIOD if now <= self._due + PERIOD <= now + PERIOD else now + PERIOD
        await trio.sleep(self._due - now)

    async def steps(self, count: int, share: float = 1.0) -> None:
        for _ in range(count):
            for drive in self.arm:
                self.wanted[drive] += share * WAYS[drive.node.node_id] * STEP
                await self.send_pos(drive, self.wanted[drive])
            pause, self.pause = self.pause, 0.0
            await trio.sleep(pause)
            await self.send_sync()

    async def run(self) -> None:
        await self.steps(1, 0.0)
        await self.steps(25)
        await self.steps(25, -1.0)
        for _ in range(20):  # drives that were late may still be on their way
            await self.steps(10, 0.0)
            if all(drive.is_on_path for drive in self.arm):
                break

    async def measure(self) -> None:
        """Note the largest speed that any drive has."""
        for each in itertools.cycle((0.0019, 0.0032)):
            for node in drives(self.host):
                node.drive.refresh(self.host.now())
                self.largest = max(self.largest, abs(node.drive._servo.demand_velocity))
            await trio.sleep(each)

    async def late(self, turns: Sequence[Turn]) -> None:
        await trio.sleep(0.1)
        for is_process, seconds, pause in turns:
            if is_process:
                stall(seconds)
            else:
                self.pause += seconds
            await trio.sleep(pause)

    def places(self) -> list[int]:
        return [position_of(self.host, node) for node in drives(self.host)]


@asynccontextmanager
async def scripted(*node_ids: int, tolerance: int = IN_PROCESS, waits: bool = False) -> AsyncIterator[Script]:
    """A script whose drives follow. waits: for SYNC, as those that `direct.simulated` makes."""
    makers = powerballs(*node_ids, sync_tolerance=tolerance, waits_for_sync=waits)
    async with simulated(makers=makers) as host, open_master(BUS) as master:
        hand_sync = HandSync(master)
        for node in drives(host):
            node.values.store[0x6085_00] = RAMP
        await master.nmt_start()
        arm = []
        for node_id in node_ids:
            device = master.device(master.node(node_id), settings=COUNTS)
            drive = DirectDrive(master, device, "schunk_default_rPDO", "schunk_default_tPDO", True, hand_sync)
            await drive.change_state(State.OPERATION_ENABLED)
            await drive.set_max_speed(LIMIT)
            await drive.follow()
            arm.append(drive)
        yield Script(master, host, arm, hand_sync)


async def outcome(script: Script, turns: Sequence[Turn]) -> Exception | None:
    """Run the script while things are late; return the error that ended it."""
    error: Exception | None = None
    async with trio.open_nursery() as nursery:
        nursery.start_soon(script.measure)
        nursery.start_soon(script.late, turns)
        try:
            await script.run()
        except (ProcedureError, NodeSilentError) as raised:
            error = raised
        nursery.cancel_scope.cancel()
    return error


@examples(15, least=4)
@example([(True, 0.009, 0.2), (False, 0.045, 0.2), (True, 0.015, 0.1), (False, 0.095, 0.2)])
@given(turns)
def test_a_script_that_stalls_goes_on_slowly(turns: Sequence[Turn]) -> None:
    """Where drives bear it: no drive exceeds its speed, and all end where the script wanted them."""

    @virtual_time
    async def run() -> None:
        async with scripted(*NODES) as script:
            start = script.places()
            assert await outcome(script, turns) is None
            assert script.largest <= LIMIT + 1 / PERIOD  # positions are whole counts
            assert script.places() == pytest.approx(start, abs=2)

    run()


@examples(15, least=4)
@example([(False, 0.3, 0.2)])
@example([(True, 0.5, 0.2), (False, 0.2, 0.1)])
@given(turns)
def test_joints_that_wait_for_sync_are_within_a_step_of_their_path_after_three_syncs(turns: Sequence[Turn]) -> None:
    """As the manual's demos end: however late SYNC was, no joint has gone far beyond its path and still comes back from there."""

    @virtual_time
    async def run() -> None:
        async with scripted(*NODES, waits=True) as script:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(script.late, turns)
                await script.steps(25)
                nursery.cancel_scope.cancel()
            await script.steps(3, 0.0)
            assert script.places() == pytest.approx([script.wanted[drive] for drive in script.arm], abs=STEP)

    run()


def test_the_drives_that_direct_simulates_wait_for_sync() -> None:
    connection = Connection()
    with connection.simulated((3,), "virtual:own"):
        ((_, (make,)),) = connection._simulated
        drive = make(Network().out)
    assert isinstance(drive, DriveNode)
    assert drive.drive._servo.settings.waits_for_sync


@examples(15, least=4)
@example([(True, 0.13, 0.2)])
@example([(False, 0.3, 0.2)])
@given(turns)
def test_a_script_that_stops_names_how_late_our_own_sync_was(turns: Sequence[Turn]) -> None:
    """Where drives stop following without SYNC for a tenth of a second: it goes on slowly or ends so, and nothing is too fast."""

    @virtual_time
    async def run() -> None:
        async with scripted(*NODES, tolerance=SYNC_TOLERANCE) as script:
            error = await outcome(script, turns)
            assert script.largest <= LIMIT + 1 / PERIOD  # positions are whole counts
            if error is not None:
                ended = trio.current_time()
                named = re.search(r"our own SYNC was (\d+) ms late", str(error))
                assert named is not None, error
                sent = [*script.synced, ended]
                gaps = [1000 * (after - before - PERIOD) for before, after in itertools.pairwise(sent) if ended - after < 1.3]
                assert any(abs(gap - int(named[1])) < 25 for gap in gaps), (named[0], gaps)  # or seen lost before SYNC came

    run()


@pytest.mark.thorough(2)
@pytest.mark.parametrize("waits", [False, True])
def test_a_drive_that_comes_back_to_its_path_has_a_whole_interval_for_each_step(waits: bool) -> None:
    """A script that makes up for lost time sends SYNC early, cycle after cycle: steps at the speed limit were too fast then."""
    late = [(True, 0.0, 0.0), (True, 0.0188, 0.0391), (False, 0.2458, 0.2484), (False, 0.0, 0.0041), (False, 0.0098, 0.0059)]

    @virtual_time
    async def run() -> None:
        async with scripted(*NODES, waits=waits) as script:
            assert await outcome(script, late) is None
            assert script.largest <= LIMIT + 1 / PERIOD  # positions are whole counts

    run()


@virtual_time
async def test_a_drive_that_does_not_tell_where_it_is_is_halted_before_sync() -> None:
    async with scripted(*NODES) as script:
        await script.steps(30)
        drives(script.host)[1].answer(0x6064, 0, Answer(abort=AbortCode.GENERAL_ERROR))
        script.pause = 0.08
        with pytest.raises(DriveError, match=r"SYNC was (79|8\d) ms late, and node 4 did not tell where it is"):
            await script.steps(2)


@virtual_time
async def test_set_points_wait_for_our_own_sync_only() -> None:
    """As soon as somebody else sends SYNC, they are sent at once."""
    stranger = VirtualTransport("test")
    async with scripted(3) as script:
        (drive,) = script.arm
        await script.steps(3, 0.0)
        assert drive.give(round(script.wanted[drive]) + 10)
        await trio.sleep(0.001)
        await stranger.send(Frame(0x080))
        await trio.sleep(0.001)
        assert not script.hand_sync.is_ours
        await stranger.send(Frame(0x080))
        await trio.sleep(0.1)
        assert script.places() == [round(script.wanted[drive]) + 10]
        assert not drive.give(round(script.wanted[drive]))
    await stranger.aclose()


@virtual_time
async def test_a_command_that_ends_the_following_drops_what_waits() -> None:
    async with scripted(3) as script:
        (drive,) = script.arm
        await script.steps(3, 0.0)
        place = script.places()
        assert drive.give(round(script.wanted[drive]) + 10)
        await drive.halt()
        await script.send_sync()
        await trio.sleep(0.1)
        assert script.places() == place


def test_a_cycle_is_one_hand_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each one blocks the script until the master's thread has run."""
    calls = [0]
    call = Connection.call

    def counted(connection: Connection, function: object) -> object:
        calls[0] += 1
        return call(connection, function)  # type: ignore[arg-type]

    with devices(*NODES) as arm, Session() as session:
        assert session.open_connection(arm.bus)
        session.init_nmt()
        for node in NODES:
            assert session.init_device(node)
            assert session.enable_ip_mode(node)
        session.send_sync(1)
        monkeypatch.setattr(Connection, "call", counted)
        for cycle in range(5):
            for node in NODES:
                session.send_pos(node, 3000 + cycle)
            session.send_sync(1)
        assert calls == [5]
