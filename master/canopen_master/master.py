"""`Master`: what a user of one or several CAN buses holds. Made by `open_master` (session.py).

Theory of operation
-------------------
A `Master` has one core Network per bus, all with one Runner, and the pump that drives them (pump.py). Everything that it offers
is one of three kinds:

- a command that only mutates: it is called, `pump` follows, done;
- a request with an outcome (an SDO transfer, a procedure): a task waits for the Outcome event of that id. If the task is
  cancelled, the request is taken back: a transfer is aborted on the wire; a procedure is cancelled, and its clean-up (it halts
  what it moved) is waited for, shielded;
- a subscription to events.

A node is (bus, node-ID): the same node-ID may stand on two buses. SYNC is one for all buses: it is sent on each of them at the
same instant, back to back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import trio
from trio.lowlevel import enable_ki_protection

from canopen_data import load_dictionary
from canopen_data.descriptions import load_description_with_names
from canopen_master.bus import Bus
from canopen_master.dispatch import Dispatcher, ProcedureTakenBack, Waiter, Watcher
from canopen_master.errors import UNKNOWN_CHAIN, BusError, MasterClosed, UnknownChain
from canopen_master.grip import Grips, NodeGrip
from canopen_master.halting import Halt, halts_needed
from canopen_master.motion.chain import Chain, ChainSettings
from canopen_master.motion.chain_file import ChainDescription, on_buses, parse_chains, read_chains
from canopen_master.motion.device import Device
from canopen_master.node import Node
from canopen_master.pump import Pump
from canopen_master.requests import OpenRequest
from canopen_master.subscription import Subscription
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drive.axis import Axis, AxisSettings
from canopen_proto.machine import SECOND, Event, LocalProtocolError, Outcome, RequestId, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtMaster
from canopen_proto.procedures.grip import DEFAULT_GRIP, Grip
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Procedure, all_of
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sync import SyncConsumer, SyncProducer
from canopen_transports import Transport, TransportError

T = TypeVar("T")
E = TypeVar("E", bound=Event)

SDO_TIMEOUT = 0.5
"""Seconds that a device may take for each answer."""

_LOOK = 0.1
"""Seconds between two looks whether a drive that is halted needs longer."""


class Master:
    """See this module's text. buses: the Bus objects by their names. failure: why the master went down, or None.

    Times are in seconds here, as everywhere in trio.
    """

    def __init__(
        self,
        transports: Mapping[str, Transport],
        *,
        aliases: Mapping[str, str] | None = None,
        sdo_timeout: float = SDO_TIMEOUT,
        heartbeat_timeout: float = 0.0,
        dictionary: ObjectDictionary | None = None,
        grip: Grip | None = DEFAULT_GRIP,
    ) -> None:
        """transports: open ones, by name. aliases: more names for them. The rest: see `open_master`."""
        self._sdo_timeout = nanoseconds(sdo_timeout)
        self._heartbeat_timeout = nanoseconds(heartbeat_timeout)
        self._dictionary = dictionary
        self._dispatcher = Dispatcher()
        self.buses: dict[str, Bus] = {}
        self._nmt: dict[Bus, NmtMaster] = {}
        self._sync: dict[Bus, SyncProducer] = {}
        for name, transport in transports.items():
            self._add_bus(name, transport)
        self._pump = Pump(tuple(self.buses.values()), self)
        self._own_buses = tuple(self.buses.values())
        self.runner = self._own_buses[0].network.runner
        self._root = self._own_buses[0].network.out.root
        for alias, name in (aliases or {}).items():
            self.buses[alias] = self.buses[name]
        self._nodes: dict[tuple[Bus, int], Node] = {}
        self._files: dict[str, ObjectDictionary] = {}
        self.devices: dict[Node, Device] = {}
        self.chains: list[Chain] = []
        self.halts: list[Halt] = []  # when it has been left: of the drives that it halted
        self._procedures: set[RequestId] = set()
        self._procedure_ended = trio.lowlevel.ParkingLot()
        self._subscriptions: dict[Subscription[Any], Watcher] = {}
        self.failure: Exception | None = None
        self.is_closed = False
        self._body = trio.CancelScope()
        self.grips = Grips(self, grip)

    def _add_bus(self, name: str, transport: Transport) -> None:
        network = Network(next(iter(self.buses.values())).network.runner if self.buses else None)
        sync, consumer = SyncProducer(network.out), SyncConsumer(network.out)
        bus = self.buses[name] = Bus(name, transport, network, sync, consumer)
        self._sync[bus] = sync
        self._nmt[bus] = NmtMaster(network.out)
        for machine in (sync, consumer, self._nmt[bus]):
            network.attach(machine)

    # ---- time, buses, state ----

    def now(self) -> Time:
        """The time of all machines: trio's clock, in ns."""
        return self._pump.now()

    @property
    def dictionary(self) -> ObjectDictionary:
        """What nodes are made with that are given no dictionary: that of the data files, unless `open_master` was given one."""
        if self._dictionary is None:
            self._dictionary, _ = load_dictionary()
        return self._dictionary

    @property
    def heartbeat_timeout(self) -> Time:
        """ns after which a node whose heartbeat stops is lost; 0 for no supervision."""
        return self._heartbeat_timeout

    def bus(self, name: str | None = None) -> Bus:
        """A bus by its name; the only one may go unnamed. Raises UnknownChain, LocalProtocolError."""
        names = ", ".join(self.buses)
        if name is None:
            if len(self._own_buses) > 1:
                raise LocalProtocolError(f"this master has several buses ({names}): say which one")
            return self._own_buses[0]
        if name not in self.buses:
            raise UnknownChain(UNKNOWN_CHAIN, f"this master has no bus {name!r}", seen=f"its buses are {names}")
        return self.buses[name]

    def check_open(self) -> None:
        """Raise BusError if a bus has failed, MasterClosed if the master has been left."""
        if self.failure is not None:
            raise self.failure
        if self.is_closed:
            raise MasterClosed

    # ---- nodes ----

    @enable_ki_protection
    def node(
        self,
        node_id: int,
        dictionary: ObjectDictionary | str | Path | None = None,
        *,
        bus: str | None = None,
        pdos: bool | None = None,
    ) -> Node:
        """The node of that ID on a bus; asked for again, the same object.

        dictionary: what the device is: its EDS, DCF, XDD or XDC file (or a sample's name); a dictionary; by default that of the
        data files. pdos: exchange the node's PDOs, by default if it is a file: the device is asked how it has them set up, and
        PdoReceived follows; see `Node.start` and node_pdos.py. Else nothing is sent.

        Raises LocalProtocolError for an ID outside 1..127, for a bus that is not said where there are several, and for another
        dictionary than the first time; DataError, DictionaryError for a file that cannot be read.
        """
        self.check_open()
        where = self.bus(bus)
        if has_file := isinstance(dictionary, str | Path):
            if str(dictionary) not in self._files:
                self._files[str(dictionary)] = load_description_with_names(dictionary).dictionary
            dictionary = self._files[str(dictionary)]
        known = self._nodes.get((where, node_id))
        if known is not None:
            if dictionary is not None and dictionary is not known.dictionary:
                raise LocalProtocolError(f"node {node_id} on {where.name} is in use with another dictionary")
            return known
        remote = RemoteNode(
            where.network.out,
            node_id,
            self.dictionary if dictionary is None else dictionary,
            sdo_timeout=self._sdo_timeout,
            heartbeat_timeout=self._heartbeat_timeout,
        )
        where.network.attach(remote)
        node = self._nodes[where, node_id] = Node(self, where, remote)
        where.renew_filters()
        if has_file if pdos is None else pdos:
            node.keep_pdos()
        return node

    @enable_ki_protection
    def device(self, node: Node, name: str = "", settings: AxisSettings | None = None) -> Device:
        """The drive on a node; it is halted when the master is left while it is enabled. One per node: asked for again, the same.

        name: for people, by default "node 12". settings: units and habits of the drive; what nobody says is as CiA 402 has it, or
        as Schunk's joints have it where the vendor-ID is Schunk's. Sends nothing. Raises LocalProtocolError that names the
        differences where the drive is known with other settings.
        """
        device = self.devices.get(node)
        if device is None:
            axis = Axis(node.remote, AxisSettings() if settings is None else settings)
            axis.grip = NodeGrip(self.grips, node)
            device = self.devices[node] = Device(self, name or f"node {node.node_id}", node, axis)
        else:
            if settings is not None:
                device.axis.check_settings(settings)
            device.name = name or device.name
        return device

    def chain(
        self,
        description: ChainDescription,
        settings: ChainSettings | None = None,
        *,
        axes: AxisSettings | Mapping[str, AxisSettings] | None = None,
        dictionary: ObjectDictionary | None = None,
    ) -> Chain:
        """The chain of a description. axes: the settings of all its joints, or by joint; see `device` for the others.

        Raises UnknownChain where the description names a bus that this master does not have, LocalProtocolError for a drive that
        is known with other settings.
        """
        devices = []
        for joint in description.joints:
            axis = axes.get(joint.name) if isinstance(axes, Mapping) else axes
            node = self.node(joint.node_id, dictionary, bus=joint.bus)
            devices.append(self.device(node, joint.name, axis))
        chain = Chain(self, description.name, devices, ChainSettings() if settings is None else settings)
        self.chains.append(chain)
        return chain

    def load_chains(
        self,
        path: str | Path = "",
        *,
        text: str | None = None,
        settings: ChainSettings | None = None,
        axes: AxisSettings | Mapping[str, AxisSettings] | None = None,
        dictionary: ObjectDictionary | None = None,
    ) -> dict[str, Chain]:
        """The chains of a file (see chain_file.py), or of a text in that form, by their names. Sends nothing.

        A bus that the file names must be one of this master; if both have only one, it is that one, whatever it is called. Raises
        ChainFileError with all that is wrong, DataError where the file cannot be read.
        """
        chains = read_chains(path) if text is None else parse_chains(text)
        placed = on_buses(chains, {name: bus.name for name, bus in self.buses.items()})
        return {each.name: self.chain(each, settings, axes=axes, dictionary=dictionary) for each in placed}

    # ---- network management and SYNC ----

    @enable_ki_protection
    async def nmt(self, command: NmtCommand, node_id: int = 0, *, bus: str | None = None) -> None:
        """Send an NMT command to one node, or to all (0; on all buses, unless one is named); returns when it is on its way.

        Nothing confirms it but the nodes' heartbeats. What we know of the nodes' states follows it.
        """
        self.check_open()
        buses = self._own_buses if bus is None and node_id == 0 else (self.bus(bus),)
        for each in buses:
            self._nmt[each].send(command, node_id, self.now())
        await self._sent(buses)

    def nmt_master(self, bus: Bus) -> NmtMaster:
        """For what is built upon the master (nodes): who sends the NMT commands of a bus."""
        return self._nmt[bus]

    async def nmt_start(self, node_id: int = 0, *, bus: str | None = None) -> None:
        """Start remote node: to Operational."""
        await self.nmt(NmtCommand.START, node_id, bus=bus)

    async def nmt_stop(self, node_id: int = 0, *, bus: str | None = None) -> None:
        """Stop remote node: to Stopped, where only NMT and heartbeat live."""
        await self.nmt(NmtCommand.STOP, node_id, bus=bus)

    async def nmt_enter_pre_operational(self, node_id: int = 0, *, bus: str | None = None) -> None:
        """Enter pre-operational: SDO, no PDOs."""
        await self.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, node_id, bus=bus)

    async def nmt_reset_node(self, node_id: int = 0, *, bus: str | None = None) -> None:
        """Reset node: as after power-on. `Node.reset` also waits for the boot-up."""
        await self.nmt(NmtCommand.RESET_NODE, node_id, bus=bus)

    async def nmt_reset_communication(self, node_id: int = 0, *, bus: str | None = None) -> None:
        """Reset communication: the communication objects as after power-on."""
        await self.nmt(NmtCommand.RESET_COMMUNICATION, node_id, bus=bus)

    @property
    def sync_period(self) -> Time:
        """ns between two SYNCs, 0 while none are sent."""
        return self._own_buses[0].sync_period

    @enable_ki_protection
    def sync_start(self, period: float) -> None:
        """Send SYNC on all buses, now and then once per period (seconds). What runs begins anew. Events: SyncSent"""
        self.check_open()
        self._start_sync(nanoseconds(period))

    def _start_sync(self, period: Time) -> None:
        now = self.now()
        for bus in self._own_buses:
            bus.start_sync(period, now)
        self._pump.pump()

    @enable_ki_protection
    def sync_stop(self) -> None:
        """Send no more SYNC by itself."""
        for bus in self._own_buses:
            bus.stop_sync()
        self._pump.pump()

    @enable_ki_protection
    async def send_sync(self) -> None:
        """Send one SYNC on all buses; returns when it is on its way. A running period keeps its phase."""
        self.check_open()
        now = self.now()
        for sync in self._sync.values():
            sync.send(now)
        await self._sent(self._own_buses)

    async def _sent(self, buses: Iterable[Bus]) -> None:
        self._pump.pump()
        await trio.lowlevel.checkpoint()
        for bus in buses:
            await bus.flush()
        if self.failure is not None:
            raise self.failure

    # ---- requests and procedures ----

    @enable_ki_protection
    async def request(self, bus: Bus, remote: RemoteNode, submit: Callable[[Time], RequestId]) -> Outcome:
        """Give a command with an outcome and wait for it. Cancelled, it takes the request back."""
        return await self.begin(bus, remote, submit).outcome()

    @enable_ki_protection
    def begin(self, bus: Bus, remote: RemoteNode, submit: Callable[[Time], RequestId]) -> OpenRequest:
        """Give a command with an outcome, which whoever has it waits for or takes back."""
        self.check_open()
        return OpenRequest(self._pump, self._dispatcher, bus, remote, submit)

    @enable_ki_protection
    async def run(self, procedure: Procedure[T]) -> T:
        """Run a procedure of `canopen_proto.procedures`, or your own, and wait for its end; its result.

        Cancelled, it cancels the procedure and waits for its clean-up first (CLEAN_UP_TIME, 1 s, at most, or longer for a drive
        that still slows down). Raises what the procedure raised: a ProcedureError.
        """
        self.check_open()
        request_id, waiter = self.launch(procedure)
        result: T = await self.outcome_of(request_id, waiter)
        return result

    @enable_ki_protection
    async def outcome_of(self, request_id: RequestId, waiter: Waiter) -> Any:
        """The result of a procedure that was launched; see `run`. ProcedureTakenBack if somebody else has cancelled it."""
        try:
            await waiter.done.wait()
        except BaseException:
            self.take_back(request_id)
            with trio.CancelScope(shield=True):
                await waiter.done.wait()
            raise
        return self.result_of(waiter)

    def result_of(self, waiter: Waiter) -> Any:
        """The result of a procedure that has ended; raises what it raised, or ProcedureTakenBack."""
        match waiter.result():
            case ProcedureFinished(result=result):
                return result
            case ProcedureFailed(error=error):
                raise error
            case outcome:
                assert isinstance(outcome, ProcedureCancelled)
                raise ProcedureTakenBack

    @enable_ki_protection
    def launch(self, procedure: Procedure[Any]) -> tuple[RequestId, Waiter]:
        """Start a procedure without waiting for it. May be called while events are delivered."""
        request_id = self.runner.start(procedure, self.now())
        self._procedures.add(request_id)
        waiter = self._dispatcher.expect(self._root, request_id, self.runner)
        self._pump.pump()
        return request_id, waiter

    @enable_ki_protection
    def take_back(self, request_id: RequestId) -> None:
        """Cancel a procedure; one that has ended is left alone."""
        self.runner.cancel(request_id, self.now())
        self._pump.pump()

    # ---- events ----

    @enable_ki_protection
    def events(self, *kinds: type[E], node: Node | None = None, bus: str | None = None) -> Subscription[E]:
        """All events of these kinds from now on, as an async iterator: `with master.events(HeartbeatLost) as events: ...`.

        node, bus: only those of one. The queue is bounded: see Subscription. `Event` as a kind means all.
        """
        self.check_open()
        if not kinds:
            raise LocalProtocolError("events of which kinds? Event means all")
        where = self.bus(node.bus) if node is not None else None if bus is None else self.bus(bus)
        subscription: Subscription[E] = Subscription(self._unsubscribe)
        watcher = self.watch(kinds, subscription.put, where, node.node_id if node is not None else 0)
        self._subscriptions[subscription] = watcher
        return subscription

    def _unsubscribe(self, subscription: Subscription[Any]) -> None:
        watcher = self._subscriptions.pop(subscription, None)
        if watcher is not None:
            self.unwatch(watcher)

    def unwatch(self, watcher: Watcher) -> None:
        """End a `watch`."""
        self._dispatcher.unwatch(watcher)

    def watch(
        self, kinds: tuple[type[Event], ...], callback: Callable[[Any], None], bus: Bus | None = None, node_id: int = 0
    ) -> Watcher:
        """For what is built upon the master (chains): a callback in the pump's turn. It must not raise or block."""
        return self._dispatcher.watch(kinds, callback, bus, node_id)

    # ---- what the pump tells ----

    def on_event(self, bus: Bus, event: Event) -> None:
        if isinstance(event, ProcedureFinished | ProcedureFailed | ProcedureCancelled) and bus is self._own_buses[0]:
            self._procedures.discard(event.request_id)
            self._procedure_ended.unpark_all()
        self._dispatcher.dispatch(bus, event)

    def on_failure(self, bus: Bus | None, error: Exception) -> None:
        if self.failure is None:
            self.failure = BusError(bus.name, error) if bus is not None and isinstance(error, TransportError) else error
        if not self.is_closed:  # else nobody waits any more, and what runs are the halts
            self._end_waiting(self.failure)
        self._body.cancel()

    def _end_waiting(self, reason: Exception) -> None:
        self._dispatcher.give_up(reason, self.now())
        for subscription in tuple(self._subscriptions):
            subscription.end(reason)
            subscription.close()
        self._pump.pump()

    # ---- the way out: for session.py ----

    @property
    def pump(self) -> Pump:
        """What drives the networks."""
        return self._pump

    @property
    def body(self) -> trio.CancelScope:
        """Around the user's block; cancelled when a bus fails."""
        return self._body

    @enable_ki_protection
    async def halt_and_flush(self, scope: trio.CancelScope, longest: float, in_a_hurry: Callable[[], bool]) -> None:
        """Take no new commands, end everything that runs, halt all drives that are enabled, and send what is queued.

        scope: around this; its deadline is put off while procedures ask for time, to `longest` (trio's clock) at most, and not
        when somebody is in a hurry. `halts` then tells which drives did not confirm that they stand. May be cancelled: what was
        sent is sent.
        """
        self.is_closed = True
        self._end_waiting(MasterClosed())
        for request_id in tuple(self._procedures):
            self.take_back(request_id)
        self.halts.extend(halts_needed(self, self._nodes.values()))
        halted = {halt.node for halt in self.halts}
        disabled = [node for node in self.grips.drives_held() if node not in halted and not self.bus(node.bus).failed]
        halts = (self.grips.let_go_after(halt.node, halt) for halt in self.halts if not halt.bus_failed)
        self.launch(all_of(*halts, *map(self.grips.let_go, disabled)))
        usual = scope.deadline
        while self._procedures:
            with trio.move_on_after(_LOOK):
                await self._procedure_ended.park()
            asked = trio.current_time() + (self.runner.needs_until - self.now()) / SECOND
            scope.deadline = usual if in_a_hurry() else min(max(scope.deadline, asked), longest)
        await self._pump.flush()


def nanoseconds(seconds: float) -> Time:
    """Seconds, as users give them, in ns, as machines take them."""
    return round(seconds * SECOND)
