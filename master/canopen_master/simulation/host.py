"""Simulated devices on a bus: the device's side of the same pump. For demonstrations and tests, without hardware.

    await nursery.start(simulate, await open_transport("virtual:demo"), powerballs(3, 4, 5, 6, 7, 8))

All devices of one call are one participant of the bus, as if they shared one CAN controller: they do not hear each other.

A `DeviceModel` makes a device of any dictionary, such as that of an EDS or DCF. A simulated drive may stand behind it, and a
script may animate it (hooks.py). The Host keeps the parameters that a device stores (0x1010), and the node-ID and bit rate that
LSS stores, as a real host would.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Final, TypeAlias

from canopen_master.errors import BusError
from canopen_master.participant.bus import Bus, BusChanged
from canopen_master.participant.pump import Pump
from canopen_master.simulation.hooks import Hooks, Script
from canopen_master.simulation.parameter_keeper import ParameterKeeper
from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.local_node import LocalNode
from canopen_proto.lss.messages import OK, UNCONFIGURED
from canopen_proto.lss.slave import STORAGE_FAILED, LssStoreRequested
from canopen_proto.machine import SECOND, Event, LocalProtocolError, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.parameter_storage import SIGNATURES
from canopen_proto.sdo.server import ObjectAccessPending
from canopen_proto.simulation.drive.node import DriveNode, powerball
from canopen_proto.simulation.drive.settings import SYNC_TOLERANCE, DriveSettings
from canopen_transports import BusState, Transport, TransportError
from canopen_transports.loop import TASK_STATUS_IGNORED, Nursery, TaskStatus, current_loop

if TYPE_CHECKING:
    from canopen_proto.declared import DeclaredDevice

PATIENCE: Final = 16
"""Rounds of the loop. A master in this process is stalled together with its devices, and takes some rounds to send its
SYNC; the devices wait for it before they handle their own timeouts."""

IN_PROCESS: Final = 60 * SECOND
"""The tolerance of SYNC for drives in the process of their master: a computer that has no time for the one has none for the
other, and no drive shall fail by that. A loop of such a master may be as late."""

DeviceMaker: TypeAlias = Callable[[Outbox], LocalNode]
"""Makes a device with the outbox of the network that it will be attached to."""


def patient_cycles(cycle_time: float) -> int:
    """Return how many cycles IN_PROCESS is. cycle_time: seconds."""
    return round(IN_PROCESS / SECOND / cycle_time)


@dataclass(frozen=True)
class DeviceModel:
    """Makes a device of a dictionary: a DeviceMaker.

    drive: the drive behind it, which must suit the dictionary (`drive_obstacle`); code: the device written in Python, whose
    dictionary it is. Without both, its objects are plain memory. script: animates it.
    """

    dictionary: ObjectDictionary
    node_id: int
    drive: DriveSettings | None = None
    script: Script | None = None
    code: type[DeclaredDevice] | None = None

    def __call__(self, out: Outbox) -> LocalNode:
        if self.code is not None:
            return self.code(out, self.node_id, self.dictionary).node
        if self.drive is None:
            return LocalNode(out, self.node_id, self.dictionary)
        return DriveNode(out, self.node_id, self.drive, self.dictionary)


def powerballs(*node_ids: int, sync_tolerance: Time = SYNC_TOLERANCE, waits_for_sync: bool = False) -> list[DeviceMaker]:
    """Joints of the Schunk Powerball arm, as the manual's library knows them. The other parameters: see DriveSettings."""
    make = partial(powerball, sync_tolerance=sync_tolerance, waits_for_sync=waits_for_sync)
    return [partial(make, node_id=node_id) for node_id in node_ids]


def standard_drives(*node_ids: int, settings: DriveSettings | None = None) -> list[DeviceMaker]:
    """Drives that follow CiA 402 to the letter."""
    return [partial(DriveNode, node_id=node_id, settings=settings or DriveSettings()) for node_id in node_ids]


def _require_own_ids(nodes: Sequence[LocalNode], bus: str) -> None:
    """Raise LocalProtocolError if two nodes have one node-ID: they would answer each request twice."""
    by_id: dict[int, LocalNode] = {}
    for node in nodes:
        other = by_id.setdefault(node.node_id, node)
        if other is not node and node.node_id != UNCONFIGURED:
            raise LocalProtocolError(
                f"{_name_of(other)} and {_name_of(node)} both have node-ID {node.node_id} on {bus}; give each its own. For a bus"
                " with a double node-ID, which is a fault, serve the second device in a block, or a task, of its own"
            )


def _name_of(node: LocalNode) -> str:
    """Return the name that a device has in its dictionary (0x1008), else what it is."""
    variable = node.dictionary.get(indices.MANUFACTURER_DEVICE_NAME, 0)
    name = None if variable is None else variable.initial_of(node.node_id)
    return repr(name) if isinstance(name, str) and name else f"a {type(node).__name__}"


async def simulate(
    transport: Transport,
    devices: Iterable[DeviceMaker],
    *,
    on_event: Callable[[Event], object] | None = None,
    task_status: TaskStatus[Host] = TASK_STATUS_IGNORED,
) -> None:
    """Serve devices on a transport until cancelled; then close it. They boot at once, in the order given.

    `nursery.start` returns the Host with its `nodes`, to look into or to break. on_event: called with each event of the devices;
    it must not block. Raises BusError when the bus fails; LocalProtocolError if two of them have one node-ID.
    """
    try:
        await Host(transport, devices, on_event).serve(task_status)
    finally:
        with current_loop().cancel_scope(shield=True):
            await transport.aclose()


class Host:
    """Devices on one transport. Call `pump()` after each change made to one of them by hand (`node.raise_error(...)`).

    keeper: keeps what they store, by the node-ID with which they were made (255, 256 ... for those without one); by default in
    memory. say: called with the messages and errors of scripts. on_event: called with each event of the devices. Raises
    ScriptError if a script cannot be run; LocalProtocolError if two devices have one node-ID (255, none yet, may come twice).
    """

    def __init__(
        self,
        transport: Transport,
        devices: Iterable[DeviceMaker],
        on_event: Callable[[Event], object] | None = None,
        *,
        keeper: ParameterKeeper | None = None,
        say: Callable[[str], object] = lambda text: None,
    ) -> None:
        network = Network()
        self._bus = Bus(getattr(transport, "locator", "bus"), transport, network)
        self._pump = Pump((self._bus,), self._on_events, self.on_failure, PATIENCE)
        self._on_event = on_event
        self._keeper = ParameterKeeper() if keeper is None else keeper
        self._say = say
        self._failure: Exception | None = None
        self._is_bus_off = False
        self._ended = current_loop().event()
        made = [(make, make(network.out)) for make in devices]
        self.nodes = tuple(node for _, node in made)
        _require_own_ids(self.nodes, self._bus.name)
        self._hooks = {
            node: Hooks(make.script, node, self, say)
            for make, node in made
            if isinstance(make, DeviceModel) and make.script is not None
        }
        self._places: dict[LocalNode, int] = {}
        without_id = count(UNCONFIGURED)
        for node in self.nodes:
            network.attach(node)
            node.pdos.sends_on_start = True
            place = self._places[node] = next(without_id) if node.node_id == UNCONFIGURED else node.node_id
            stored = self._keeper.kept_lss(place)
            if stored is not None:
                node.take_stored(stored)
            kept = self._keeper.kept(place)
            if kept is not None:
                node.storage.load(kept)

    def now(self) -> int:
        """Return the devices' time, in ns."""
        return self._pump.now()

    def pump(self) -> None:
        """Send the frames and report the events of the devices."""
        self._pump.pump()

    async def serve(self, task_status: TaskStatus[Host] = TASK_STATUS_IGNORED) -> None:
        """Boot the devices and serve them until cancelled. Raises BusError when the bus fails."""
        async with current_loop().open_nursery() as nursery:
            nursery.start_soon(self._pump.run)
            try:
                async with current_loop().open_nursery() as scripts:
                    await self._boot(scripts)
                    await self._pump.flush()  # a master that opens now must not take these boot-ups for resets
                    task_status.started(self)
                    await self._ended.wait()
                    scripts.cancel_scope.cancel()
            finally:
                self._pump.stop()
        if self._failure is not None:
            raise self._failure

    async def _boot(self, scripts: Nursery) -> None:
        for hooks in self._hooks.values():
            hooks.set_up()
            await scripts.start(hooks.run)
        for node in self.nodes:
            node.boot(self.now())
        self._pump.pump()

    def on_event(self, bus: Bus, event: Event) -> None:
        if isinstance(event, ObjectAccessPending) and event.index in SIGNATURES:
            self._store(event)
        elif isinstance(event, LssStoreRequested):
            self._store_lss()
        elif isinstance(event, BusChanged):
            self._tell_bus_off(event.state)
        if self._hooks:
            node = self._node(event.node_id)
            hooks = None if node is None else self._hooks.get(node)
            if hooks is not None:
                hooks.on_event(event)
        if self._on_event is not None:
            self._on_event(event)

    def _on_events(self, bus: Bus, events: Sequence[Event]) -> None:
        for each in events:
            try:
                self.on_event(bus, each)
            except Exception as error:  # noqa: BLE001 - the other events are told
                self.on_failure(None, error)

    def _tell_bus_off(self, state: BusState) -> None:
        """Tell the devices that their controller has gone bus-off, or is back."""
        if state is BusState.BUS_OFF and not self._is_bus_off:
            self._is_bus_off = True
            for node in self.nodes:
                node.bus_off(self.now())
        elif self._is_bus_off and state in (BusState.ACTIVE, BusState.WARNING, BusState.PASSIVE, BusState.UP):
            self._is_bus_off = False
            for node in self.nodes:
                node.bus_recovered(self.now())

    def _store(self, access: ObjectAccessPending) -> None:
        """Store or restore the parameters of a device."""
        node = self._node(access.node_id)
        if node is None or access.index in node.deferred:
            return  # the script or host that deferred it serves it
        try:
            self._keeper.keep(self._places[node], node.storage.to_keep(access.index, access.subindex))
        except OSError as error:
            self._say(f"node {access.node_id}: what it stores cannot be kept: {error}")
            node.complete(access.access_id, AbortCode.HARDWARE_ERROR, self.now())
        else:
            node.complete(access.access_id, None, self.now())

    def _store_lss(self) -> None:
        """Store the node-ID and the bit rate of the devices that ask for it."""
        for node in self.nodes:
            if node.lss.is_storing:
                try:
                    self._keeper.keep_lss(self._places[node], node.lss.pending)
                except OSError as error:
                    self._say(f"node {node.node_id}: the node-ID that it stores cannot be kept: {error}")
                    node.lss.complete_store(STORAGE_FAILED, self.now())
                else:
                    node.lss.complete_store(OK, self.now())

    def _node(self, node_id: int) -> LocalNode | None:
        """Return the device that has a node-ID at present; LSS may have changed it."""
        return next((node for node in self.nodes if node.node_id == node_id), None)

    def on_failure(self, bus: Bus | None, error: Exception) -> None:
        self._failure = BusError(bus.name, error) if bus is not None and isinstance(error, TransportError) else error
        self._ended.set()
