"""`Bridge`: a machine as a ROS node sees it, without ROS. In trio's thread; `threads.py` is the way from other threads.

    async with open_bridge(NodeParameters.from_mapping({"chains": "arm joint1 can0 3", "simulate": True})) as bridge:
        reply = await bridge.chains["arm"].call("init")
        async for sample in bridge.samples():
            ...

**A bus that fails** ends the master, which halts what it can still reach, but not the bridge: services are refused with the
reason, the chains' state is "failed", and diagnostics go on telling. The node has to be started again.

**Leaving the block** ends all motions along their paths, halts all drives, and shuts the chains down, as far as they answer.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Final, NamedTuple
from weakref import WeakSet

import trio

from canopen_master.errors import MasterError
from canopen_master.machine_file import MachineFile
from canopen_master.master import Master
from canopen_master.motion.device import Device
from canopen_master.node import Node
from canopen_master.session import open_master
from canopen_proto.sync import SyncSent
from canopen_ros import diagnostics, objects
from canopen_ros.chain_bridge import ChainBridge
from canopen_ros.diagnostics import Diagnostic
from canopen_ros.parameters import NodeParameters
from canopen_ros.reply import Reply
from canopen_ros.samples import Sample, sample_of
from canopen_ros.simulated import on_virtual_buses, simulated_machine

MOST_SAMPLES: Final = 256
"""Samples that wait for a slow reader: some seconds. With more, the oldest are dropped."""
EARLY: Final = 0.002
"""Seconds that a sample may be early, so that a rate of 100 Hz takes each SYNC at 10 ms."""
SAME_AGAIN: Final = 5.0
"""Seconds until the same report is made again, unless it is news: commands may be refused a hundred times a second."""


class StateReport(NamedTuple):
    """The refusal of a command that has no answer, for the log. chain: its name. text: of the error."""

    chain: str
    text: str


class Bridge:
    """See this module's text. chains: by name. machine: the machine. failure: why the master ended; None while it works."""

    def __init__(
        self,
        master: Master,
        machine: MachineFile,
        nursery: trio.Nursery,
        parameters: NodeParameters | None = None,
        *,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        """master: an open one of this machine. nursery: inside its block; the tasks of topics run there. parameters: of the ROS
        node; None: the defaults for this machine. wall: returns the time for messages, ns since 1970."""
        parameters = NodeParameters(machine) if parameters is None else parameters
        self.master = master
        self.machine = machine
        self.parameters = parameters
        self.failure: Exception | None = None
        self._wall = wall
        self._loads = diagnostics.Loads()
        self._reports: deque[StateReport] = deque(maxlen=MOST_SAMPLES)
        self._reported: dict[tuple[str, str], float] = {}
        self._has_report = trio.lowlevel.ParkingLot()
        self._changed = trio.lowlevel.ParkingLot()
        self._readers: WeakSet[Samples] = WeakSet()
        self.chains: Mapping[str, ChainBridge] = {
            name: ChainBridge(
                chain,
                nursery,
                self._report,
                wall,
                self._wake,
                watchdog=parameters.velocity_watchdog,
                goal_time=parameters.goal_time,
                start_tolerance=parameters.start_tolerance,
            )
            for name, chain in master.chains.items()
        }
        for chain in self.chains.values():
            nursery.start_soon(self._watch, chain)
            for device in chain.chain.devices:
                nursery.start_soon(self._locate, chain, device)
        nursery.start_soon(self._offer_samples)

    async def _wake(self, node: Node) -> None:
        await self.master.nmt_enter_pre_operational(node.node_id, bus=node.bus)

    async def _locate(self, chain: ChainBridge, device: Device) -> None:
        """Ask a joint without power for its position, so that controllers and planners know where to begin."""
        while True:
            await chain.locate(device)
            await trio.sleep(self.parameters.look_period)

    async def _offer_samples(self) -> None:
        """Let readers have samples while no SYNC is sent."""
        while True:
            if not self.master.sync_period:
                for reader in tuple(self._readers):
                    reader.offer()
            await trio.sleep(self.parameters.look_period)

    async def _watch(self, chain: ChainBridge) -> None:
        async for _ in chain.states():
            self._changed.unpark_all()

    # ---- what is known ----

    def sample(self) -> Sample:
        """The joints of all chains, as last heard; see Sample."""
        devices = [device for chain in self.chains.values() for device in chain.chain.devices]
        return sample_of(devices, self.master.now(), self._wall())

    def samples(self) -> Samples:
        """A sample for each SYNC, or as often as `joint_states_rate` says, as an async iterator.

        While no SYNC is sent, one for each `look_period`, as far as the drives answer.
        """
        samples = Samples(self)
        self._readers.add(samples)
        return samples

    def diagnostics(self) -> list[Diagnostic]:
        """Each bus, chain and joint, as far as it is known. Never raises; also for a master that has failed."""
        failure = self.failure
        now = self.master.now()
        found = [diagnostics.of_bus(bus, self._loads.of(bus, now), failure) for bus in dict.fromkeys(self.master.buses.values())]
        for chain in self.chains.values():
            found.append(diagnostics.of_chain(chain.chain, chain.state, failure))
            found += [diagnostics.of_joint(device, chain.name, failure) for device in chain.chain.devices]
        return found

    async def changed(self) -> None:
        """Wait until the state of a chain changes, or for `diagnostics_period`: it is time for diagnostics."""
        with trio.move_on_after(self.parameters.diagnostics_period):
            await self._changed.park()

    async def reports(self) -> AsyncIterator[StateReport]:
        """The refusals of commands that have no answer: velocities, positions, and trajectories of the topic."""
        while True:
            while self._reports:
                yield self._reports.popleft()
            await self._has_report.park()

    # ---- objects ----

    async def get_object(self, node: str, object: str, cached: bool = False) -> Reply:
        """Read an object. node: the name of a joint or a node. object: its name, or its number: 6041, 6041sub0, 6041:00.

        cached: what was heard last, if it ever was. `Reply.value` has the value.
        """
        return await objects.get_object(self.master, node, object, cached)

    async def set_object(self, node: str, object: str, value: str, cached: bool = False) -> Reply:
        """Write an object. value: a number (also 0x...), or text. cached: nothing is sent if the object is known to have it."""
        return await objects.set_object(self.master, node, object, value, cached)

    # ---- for this module ----

    def fail(self, error: Exception) -> None:
        """Note that the master has ended by an error."""
        self.failure = error
        for chain in self.chains.values():
            chain.fail(error)
        self._changed.unpark_all()

    def _report(self, chain: str, text: str, is_news: bool) -> None:
        what, now = (chain, text.partition("\n")[0]), trio.current_time()
        self._reported = {each: at for each, at in self._reported.items() if now - at < SAME_AGAIN}
        if what in self._reported and not is_news:
            return
        self._reported[what] = now
        self._reports.append(StateReport(chain, text))
        self._has_report.unpark_all()


class Samples:
    """The iterator that `Bridge.samples` returns. dropped: samples that were lost because the reader was too slow."""

    def __init__(self, bridge: Bridge) -> None:
        self.dropped = 0
        self._bridge = bridge
        self._waiting: deque[Sample] = deque()
        self._news = trio.lowlevel.ParkingLot()
        self._last = -math.inf
        master = bridge.master
        self._watcher = master.watch((SyncSent,), self._take, master.bus(next(iter(master.buses))))

    def _take(self, sync: SyncSent) -> None:
        self.offer()

    def offer(self) -> None:
        """Let the reader have the present sample, if it is time for one, and if it has a joint."""
        now, rate = trio.current_time(), self._bridge.parameters.joint_states_rate
        if rate and now - self._last < 1 / rate - EARLY:
            return
        sample = self._bridge.sample()
        if not sample.names:
            return
        self._last = now
        if len(self._waiting) == MOST_SAMPLES:
            self._waiting.popleft()
            self.dropped += 1
        self._waiting.append(sample)
        self._news.unpark_all()

    def __aiter__(self) -> Samples:
        return self

    async def __anext__(self) -> Sample:
        await trio.lowlevel.checkpoint()
        while not self._waiting:
            await self._news.park()
        return self._waiting.popleft()


@asynccontextmanager
async def open_bridge(parameters: NodeParameters, *, wall: Callable[[], int] = time.time_ns) -> AsyncIterator[Bridge]:
    """Open the master of a machine, and the simulated devices if `simulate` is set; see this module's text. wall: gives ns since
    1970, for stamps.

    Raises BusError if a bus cannot be opened; on leaving the block HaltNotConfirmedError if a drive did not show that it stands.
    """
    machine = on_virtual_buses(parameters.machine) if parameters.simulate else parameters.machine
    failure: BaseException | None = None
    async with AsyncExitStack() as stack:
        if parameters.simulate:
            await stack.enter_async_context(simulated_machine(machine))
        async with trio.open_nursery() as nursery:
            session = _Session(machine, parameters, wall)
            bridge = await nursery.start(session.run)
            try:
                if bridge is not None:
                    yield bridge
            except BaseException as error:  # noqa: BLE001 - raised below: the nursery would make a group of it
                failure = error
            session.close()
        if failure is None:
            failure = session.failure
        if failure is not None:
            raise failure


class _Session:
    """The master, in a task of its own: a bus that fails ends it, and not the node."""

    def __init__(self, machine: MachineFile, parameters: NodeParameters, wall: Callable[[], int]) -> None:
        self._machine = machine
        self._parameters = parameters
        self._wall = wall
        self._over = trio.Event()
        self.failure: Exception | None = None

    def close(self) -> None:
        """Leave the master."""
        self._over.set()

    async def run(self, task_status: trio.TaskStatus[Bridge | None]) -> None:
        """Run the master until `close`."""
        bridge: Bridge | None = None
        try:
            async with open_master(machine=self._machine) as master, trio.open_nursery() as nursery:
                bridge = Bridge(master, self._machine, nursery, self._parameters, wall=self._wall)
                task_status.started(bridge)
                await self._over.wait()
                for chain in bridge.chains.values():
                    if chain.state != "off":
                        await chain.call("shutdown")
                nursery.cancel_scope.cancel()
        except MasterError as error:
            if bridge is None:
                self.failure = error
                task_status.started(None)
            elif self._over.is_set():
                self.failure = error
            else:
                bridge.fail(error)
