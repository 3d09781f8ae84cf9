"""`GatewayService`: what all doors of a gateway share, and `GatewaySession`, one client of it. Neither knows of text or pages.

    async with open_master("socketcan:can0") as master, open_gateway(master, allow=parse_permissions("write")) as service:
        with service.open_session("a script") as session:
            data = await session.read(service.nets[0], 5, 0x1018, 1)

A service stands inside the master's block, and uses it like any other program: what it does ends with that block, which halts the
drives. It adds three things: what clients may not do (guard.py), how much they may do at a time (limits.py), and who moves the
machine (lease.py).

**One request at a time for each node.** Clients that ask the same node wait for each other; those that ask others do not. A
client's own time-out counts for its own requests alone: a halt, the question whether a drive has power, and whatever else this
master has to say to the node keep the master's. It never counts for a node that a running chain moves, nor for a controlword.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import AsyncIterator, Collection, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from typing import Final, NamedTuple

import trio

from canopen_gateway.errors import GatewayFullError, LeaseError, PdoTakenError
from canopen_gateway.guard import Guard, Permission, permission_to_write
from canopen_gateway.layer_settings import LayerSettings
from canopen_gateway.lease import Lease
from canopen_gateway.limits import Limits, RequestsUnderWay
from canopen_gateway.request_times import RequestTimes
from canopen_gateway.samples import PdoSamples
from canopen_gateway.traffic import NetTraffic
from canopen_gateway.traffic.traffic import ReadPdos
from canopen_gateway.values import ValueStream, WatchedObject
from canopen_master import ChainState, Master, Node
from canopen_master.motion.single_drive import look_at_drive
from canopen_master.pdo_reading import read_pdos
from canopen_master.plain_text import clean
from canopen_proto import LocalProtocolError, NmtCommand, NodeGuardingLost, OwnHeartbeat, indices
from canopen_proto.drives.axis.axis_node import node_of_axis
from canopen_proto.drives.axis.view import DriveView
from canopen_proto.frame import ALL_NODE_IDS
from canopen_proto.gateway import NodeEar, NodeReport, PdoPort, PdoReport
from canopen_proto.machine import MILLISECOND, Machine, Time
from canopen_proto.manager.scan import Scanner, scan
from canopen_proto.procedures.steps import act
from canopen_proto.sdo.client import Block
from canopen_transports.loop.beside import beside

LOG_LENGTH: Final = 100
"""Events that a service remembers, for those who look later."""
EVENTS_WAITING: Final = 256
"""Events that wait for one client; further ones are dropped, and counted."""
HEARTBEAT_TIME: Final = 2_500_000_000
"""ns without a heartbeat until a viewer is told that it is lost: the usual period is 1 s, and two of them may be late."""

SEARCH_LISTENS: Final = 100 * MILLISECOND
"""ns for which a search for nodes listens before it asks."""


class HeardOnNet(NamedTuple):
    """An event of a net, for a client. net: the name of its bus. event: a NodeReport, PdoReport or NodeGuardingLost."""

    net: str
    event: NodeReport | PdoReport | NodeGuardingLost


class GatewayService:
    """See this module's text; made by `open_gateway`. nets: the names of the buses, in the order in which they were opened; net n
    of a text protocol is the n-th, from 1. guard, limits: as given. lease: who moves the machine. log: the last events, oldest
    first. request_times: how long requests to nodes took. under_way: the requests
    of all clients."""

    def __init__(self, master: Master, *, allow: Collection[Permission] = (), limits: Limits | None = None) -> None:
        """master: an open one. allow: what clients may change; by default nothing."""
        self.master = master
        self.guard = Guard(allow)
        self.limits = Limits() if limits is None else limits
        self.nets = tuple(dict.fromkeys(bus.name for bus in master.buses.values()))
        self.lease = Lease(master, self.guard)
        self.log: deque[HeardOnNet] = deque(maxlen=LOG_LENGTH)
        self.request_times = RequestTimes()
        self._sessions: list[GatewaySession] = []
        self._last_number = 0
        self.under_way = RequestsUnderWay(self.limits.requests)
        self._searching = trio.Lock()
        self._turns: dict[tuple[str, int], trio.Lock] = defaultdict(trio.Lock)
        self._settings: dict[str, LayerSettings] = {}
        self._own_ids: dict[str, int] = {}
        self._heartbeats: dict[str, OwnHeartbeat] = {}
        self._traffic: dict[str, NetTraffic] = {}
        self._nursery: trio.Nursery | None = None

    def begin(self, nursery: trio.Nursery) -> None:
        """Let what runs in the background begin. nursery: for it."""
        self._nursery = nursery
        self.lease.begin(nursery)

    async def end(self) -> None:
        """Halt what a client moves, and listen no longer."""
        await self.lease.end()
        for traffic in self._traffic.values():
            traffic.close()

    def traffic(self, net: str) -> NetTraffic:
        """Return what passes on a net. It listens from the first call on, while the block of `open_gateway` runs."""
        if net not in self._traffic:
            assert self._nursery is not None, "the gateway does not run"
            self._traffic[net] = NetTraffic(self.master, net)
            self._nursery.start_soon(self._traffic[net].run)
        return self._traffic[net]

    @property
    def sessions(self) -> Sequence[GatewaySession]:
        """The clients that are connected."""
        return tuple(self._sessions)

    @contextmanager
    def open_session(self, name: str) -> Iterator[GatewaySession]:
        """Be a client while the block runs. name: for people. Raises GatewayFullError."""
        if len(self._sessions) >= self.limits.sessions:
            raise GatewayFullError("clients", self.limits.sessions)
        session = GatewaySession(self, name)
        self._sessions.append(session)
        try:
            yield session
        finally:
            session.close()
            self._sessions.remove(session)

    def node(self, net: str, node_id: int) -> Node:
        """Return a node as the master has it. Raises LocalProtocolError for a node-ID outside 1..127, UnknownChainError."""
        return self.master.node(node_id, bus=net)

    def layer_settings(self, net: str) -> LayerSettings:
        """Return the tool for layer setting services on a net."""
        if net not in self._settings:
            self._settings[net] = LayerSettings(self.master, self.guard, net)
        return self._settings[net]

    def set_own_id(self, net: str, node_id: int | None) -> None:
        """Give this gateway a node-ID on a net, for its heartbeat; None takes it away. A heartbeat under another one ends. Raises
        NotAllowedError; LocalProtocolError if the master's drives watch a heartbeat with this node-ID already: nobody else may
        change that."""
        self.guard.require(Permission.NMT, "a node-ID of this gateway")
        settings = self.master.watchdogs.settings
        if settings is not None and settings.node_id == node_id:
            raise LocalProtocolError(f"node-ID {node_id} is that of the master's own heartbeat, which its drives watch")
        if node_id == self._own_ids.get(net):
            return
        present = self._heartbeats.pop(net, None)
        if present is not None:
            present.stop(self.master.now())
            self.detach(net, present)
        self._own_ids.pop(net, None)
        if node_id is not None:
            self._own_ids[net] = node_id

    def set_own_heartbeat(self, net: str, period: Time) -> None:
        """Send a heartbeat of this gateway on a net. period: ns; 0 ends it. Raises NotAllowedError; LocalProtocolError if the
        gateway has no node-ID there."""
        self.guard.require(Permission.NMT, "a heartbeat of this gateway")
        if net not in self._own_ids:
            raise LocalProtocolError("this gateway has no node-ID there yet")
        if net not in self._heartbeats:
            self._heartbeats[net] = OwnHeartbeat(self.master.bus(net).network.out, self._own_ids[net])
            self.attach(net, self._heartbeats[net])
        heartbeat, now = self._heartbeats[net], self.master.now()
        if period:
            heartbeat.start(period, now)
        else:
            heartbeat.stop(now)
        self.pump()

    async def halt(self, net: str | None = None, node_id: int = 0) -> list[str]:
        """Stop what moves: everything, or one net, or one node; see `Lease.halt`. Everybody may, always."""
        return await self.lease.halt(net, node_id)

    def attach(self, net: str, machine: Machine) -> None:
        """Let a machine hear, and speak, on a net."""
        bus = self.master.bus(net)
        bus.network.attach(machine)
        bus.renew_filters()

    def detach(self, net: str, machine: Machine) -> None:
        """End `attach`."""
        bus = self.master.bus(net)
        bus.network.detach(machine)
        bus.renew_filters()

    def pump(self) -> None:
        """Send what a machine has just been told to send, and let it be woken in time."""
        self.master.pump.pump()

    @asynccontextmanager
    async def turn(self, net: str, node_id: int) -> AsyncIterator[Node]:
        """Have a node while the block runs."""
        node = self.node(net, node_id)
        with self.under_way:
            async with self._turns[net, node_id]:
                with self.request_times.measured(net):
                    yield node

    async def find_nodes(self, net: str) -> None:
        """Ask all node-IDs of a net that were not heard yet for their device type: reading, which everybody may. `heard_nodes` of
        its network has those that answered. One search at a time. Raises GatewayFullError, BusError."""
        bus = self.master.bus(net)
        async with self._searching:
            scanner = Scanner(bus.network.out)
            self.attach(net, scanner)
            try:
                with self.under_way:
                    heard = bus.network.heard_nodes()
                    silent = [each for each in ALL_NODE_IDS if each not in heard]  # nobody else asks these
                    await self.master.run(scan(scanner, silent, listen=SEARCH_LISTENS))
            finally:
                self.detach(net, scanner)

    async def look_at_drive(self, net: str, node_id: int, axis: int = 0) -> DriveView:
        """Read what a drive shows. axis: its number. Raises NodeIsNoDriveError; SdoTransferError if it does not answer."""
        async with self.turn(net, node_id) as node:
            view: DriveView = await self.master.run(look_at_drive(node_of_axis(node.remote, axis)))
        return view

    async def read_pdos(self, net: str, node_id: int) -> ReadPdos:
        """Ask a node for its PDOs: reading, which everybody may. `traffic` keeps the answer. Raises what `GatewaySession.read`
        does; SdoTransferError if it does not answer."""
        async with self.turn(net, node_id) as node:
            has_file = node.dictionary is not self.master.dictionary
            found = await read_pdos(self.master, node, node.dictionary if has_file else None)
        read = self.traffic(net).pdos_read[node_id] = ReadPdos(self.master.now(), tuple(found))
        return read

    def number_ear(self) -> int:
        """Return a number that no ear has yet."""
        self._last_number += 1
        return self._last_number

    def is_moved(self, node: Node) -> bool:
        """Return whether a chain uses this node at present, or is about to."""
        return any(
            (chain.state is not ChainState.OFF or chain.is_busy) and any(device.node is node for device in chain.devices)
            for chain in self.master.chains.values()
        )

    def lose_guarding(self, net: str, node_id: int) -> None:
        """Tell all clients that want the guarding of a node that it is lost: a chain begins to use the node."""
        guarding = self.node(net, node_id).remote.guarding
        lost = NodeGuardingLost(node_id, guarding.state, guarding.life_time)
        for session in self.sessions:
            session.lose_guarding(net, lost)


class GatewaySession:
    """A client of a gateway. name: for people. dropped: events that came faster than they were taken."""

    def __init__(self, service: GatewayService, name: str) -> None:
        self.service = service
        self.name = name
        self.dropped = 0
        self._ears: dict[str, NodeEar] = {}
        self._ports: dict[tuple[str, bool, int], PdoPort] = {}
        self._guarded: set[tuple[str, int]] = set()
        self._beating: set[tuple[str, int]] = set()
        self._put, self._events = trio.open_memory_channel[HeardOnNet](EVENTS_WAITING)
        self._watchers = [
            service.master.watch((NodeReport, PdoReport, NodeGuardingLost), partial(self._hear, net), service.master.bus(net))
            for net in service.nets
        ]
        self._watching = 0

    def close(self) -> None:
        """End all that this client has set up, and its hold on the machine."""
        self.service.lease.leave(self)
        for watcher in self._watchers:
            self.service.master.unwatch(watcher)
        for net, ear in self._ears.items():
            self.service.detach(net, ear)
        for (net, _, _), port in self._ports.items():
            self.service.detach(net, port)
        self._ears.clear()
        self._ports.clear()
        self._put.close()
        for place in tuple(self._guarded):
            self._end_guarding(place)

    # ---- objects ----

    async def read(
        self, net: str, node_id: int, index: int, subindex: int, *, timeout: float | None = None, block: Block = False
    ) -> bytes:
        """Read an object's bytes. timeout: seconds for each answer of the node. Raises SdoError and what else `Node.read_bytes`
        raises; GatewayFullError."""
        async with self.service.turn(net, node_id) as node:
            patience = None if self.service.is_moved(node) else timeout
            most = self.service.limits.value_bytes
            return await node.read_bytes(index, subindex, block=block, patience=patience, most=most)

    async def read_name(self, net: str, node_id: int) -> str:
        """Read the name that a device has of its maker (0x1008). Raises as `read`."""
        return clean((await self.read(net, node_id, indices.MANUFACTURER_DEVICE_NAME, 0)).decode("latin-1"))

    async def write(
        self,
        net: str,
        node_id: int,
        index: int,
        subindex: int,
        data: bytes,
        *,
        timeout: float | None = None,
        block: Block = False,
    ) -> None:
        """Write an object's bytes. timeout: seconds for each answer of the node. Raises NotAllowedError; LeaseError if it moves
        something while somebody else moves the machine, or may start a drive with power anew, or for a controlword whose drive
        was halted while it waited for its turn; else as `read`."""
        self.service.guard.require_write(index, subindex)
        permission, what = permission_to_write(index, subindex), f"writing 0x{index:04X}:{subindex:02X}"
        halts = self.service.lease.halts_of(self.service.node(net, node_id))
        async with self.service.turn(net, node_id) as node:
            # asked when its turn has come: the lease may have been taken meanwhile
            if permission is Permission.MOTION:
                self.service.lease.require_free(self, what)
                self.service.lease.require_no_halt(node, index, halts)
                self.service.lease.note_command(node, index)
            elif permission is Permission.PROGRAM:  # which may start the device anew
                await self.service.lease.require_no_power(self, net, node_id, what)
            elif permission is Permission.NMT:  # which may have this device command all others
                await self.service.lease.require_no_power(self, net, 0, what)
            patience = None if self.service.is_moved(node) else timeout
            await node.write_bytes(index, subindex, data, block=block, patience=patience)

    def watch_values(self, objects: Sequence[WatchedObject], period: float) -> ValueStream:
        """Return the values of objects, again and again: `async with session.watch_values(...) as values: async for ...`. period:
        seconds; see values.py. Raises GatewayFullError for more than the limits allow."""
        self._require_room(len(objects))
        least_period = self.service.limits.least_period

        async def read(place: WatchedObject) -> bytes:
            return await self.read(place.net, place.node_id, place.index, place.subindex)

        return ValueStream(tuple(objects), max(period, least_period), self.service.node, read, self._count_watched)

    def sample_pdos(self, objects: Sequence[WatchedObject]) -> PdoSamples:
        """Return every value of objects that PDOs bring: `with session.sample_pdos([...]) as samples: samples.take()`; see
        samples.py. Raises GatewayFullError for more than the limits allow."""
        self._require_room(len(objects))
        return PdoSamples(self.service.master, objects, self._count_watched)

    def _require_room(self, more: int) -> None:
        most = self.service.limits.subscriptions
        if self._watching + more > most:
            raise GatewayFullError("watched objects of one client", most)

    def _count_watched(self, change: int) -> None:
        self._watching += change

    # ---- network management ----

    async def nmt(self, net: str, command: NmtCommand, node_id: int = 0) -> None:
        """Send an NMT command to a node, or to all of a net (0). Raises NotAllowedError, LocalProtocolError, BusError; LeaseError
        if one of them has a drive with power, and this client does not have the lease."""
        what = f"NMT {command.name.lower().replace('_', ' ')}"
        self.service.guard.require(Permission.NMT, what)
        await self.service.lease.require_no_power(self, net, node_id, what)
        with self.service.under_way:
            await self.service.master.nmt(command, node_id, bus=net)

    def guard_node(self, net: str, node_id: int, guard_time: float, life_time_factor: int) -> None:
        """Ask a node once per guard time (seconds) whether it lives: node guarding. NodeGuardingLost follows. 0 for either ends
        it, unless another client wants it. Raises NotAllowedError, LocalProtocolError; LeaseError for a node that a chain uses,
        which is stopped without an answer, and for one that this master guards for itself. It ends, with that event, when a chain
        begins to use the node."""
        self.service.guard.require(Permission.NMT, "node guarding")
        node, place = self.service.node(net, node_id), (net, node_id)
        is_ours = any(place in session._guarded for session in self.service.sessions)
        if self.service.is_moved(node) or (node.remote.guarding.guard_time and not is_ours):
            why = "a chain uses it" if self.service.is_moved(node) else "this master guards it for itself"
            raise LeaseError(f"node guarding of {node.where} was refused: {why}", tries=("its heartbeat tells whether it lives",))
        if guard_time and life_time_factor:
            node.guard_for(guard_time, life_time_factor, partial(self.service.lose_guarding, net, node_id))
            self._guarded.add(place)
        else:
            self._end_guarding(place)

    def _end_guarding(self, place: tuple[str, int]) -> None:
        self._guarded.discard(place)
        if not any(place in session._guarded for session in self.service.sessions):
            self.service.node(*place).stop_guarding()

    def lose_guarding(self, net: str, lost: NodeGuardingLost) -> None:
        """Be told that the guarding of a node has ended; does nothing if this client did not want it."""
        self._hear(net, lost)
        self._guarded.discard((net, lost.node_id))

    # ---- events ----

    def hear_boot_ups(self, net: str, wanted: bool) -> None:
        """Be told of boot-ups and emergencies of all nodes of a net, or not any longer."""
        if wanted or net in self._ears:
            self._ear(net).hears_boot_ups = wanted

    def watch_heartbeat(self, net: str, node_id: int, timeout: Time) -> None:
        """Be told of the states of a node, its emergencies, and when its heartbeat is lost; see NodeEar. timeout: ns; 0 ends it.
        Raises LocalProtocolError."""
        if timeout:
            self._ear(net).watch(node_id, timeout)
            self.service.pump()
        elif net in self._ears:
            self._ears[net].forget(node_id)

    def watch_heard(self) -> None:
        """Watch each node that was heard with a heartbeat, and that this has not begun to watch before: it is lost after
        HEARTBEAT_TIME. See `watch_heartbeat`."""
        for net in self.service.nets:
            network = self.service.master.bus(net).network
            for node_id in network.heard_nodes():
                if (net, node_id) not in self._beating and network.heard(node_id).state_time is not None:
                    self._beating.add((net, node_id))
                    self.watch_heartbeat(net, node_id, HEARTBEAT_TIME)

    async def next_event(self) -> HeardOnNet:
        """Wait for the next event that this client has asked for. Raises trio.EndOfChannel once it is closed."""
        return await self._events.receive()

    def _ear(self, net: str) -> NodeEar:
        if net not in self._ears:
            ear = NodeEar(self.service.master.bus(net).network.out, self.service.number_ear())
            self.service.attach(net, ear)
            self._ears[net] = ear
        return self._ears[net]

    def _hear(self, net: str, event: NodeReport | PdoReport | NodeGuardingLost) -> None:
        """Take an event of a net, in the pump's turn; it is ours if our ear heard it, or we asked for the guarding."""
        if isinstance(event, NodeReport):
            is_ours = net in self._ears and self._ears[net].number == event.ear
        elif isinstance(event, PdoReport):
            is_ours = any(port.ear == event.ear for (where, _, _), port in self._ports.items() if where == net)
        else:
            is_ours = (net, event.node_id) in self._guarded
        if not is_ours:
            return
        heard = HeardOnNet(net, event)
        self.service.log.append(heard)
        try:
            self._put.send_nowait(heard)
        except trio.WouldBlock:
            self.dropped += 1

    # ---- PDOs of the gateway ----

    def set_pdo(self, net: str, number: int, cob_id: int, widths: Sequence[int], *, listens: bool) -> None:
        """Set up a PDO of the gateway: one that it receives (PdoReport follows), or one that it sends. number: 1..512. widths:
        bits of its objects; none: it is taken away. Raises NotAllowedError for one that it sends, PdoTakenError if another client
        has one with this number, LocalProtocolError, GatewayFullError."""
        if not listens:
            self.service.guard.require(Permission.MOTION, "a PDO that is sent")
        place = net, listens, number
        if any(place in session._ports for session in self.service.sessions if session is not self):
            raise PdoTakenError(number)
        present = self._ports.get(place)
        if widths:
            if present is None and len(self._ports) >= self.service.limits.ports:
                raise GatewayFullError("PDOs of one client", self.service.limits.ports)
            out = self.service.master.bus(net).network.out
            port = PdoPort(out, self.service.number_ear(), number, cob_id, widths, listens=listens)
            self.service.attach(net, port)
            self._ports[place] = port
        else:
            self._ports.pop(place, None)
        if present is not None:
            self.service.detach(net, present)

    def last_pdo(self, net: str, number: int) -> tuple[int, ...] | None:
        """Return the values of a PDO that came last; None if none has come. Raises LocalProtocolError if it was not set up."""
        return self._port(net, True, number).values

    async def send_pdo(self, net: str, number: int, values: Sequence[int]) -> None:
        """Send a PDO. Raises NotAllowedError, LeaseError if somebody else moves the machine, LocalProtocolError if it was not set
        up, or has other values."""
        self.service.guard.require(Permission.MOTION, "sending a PDO")
        self.service.lease.require_free(self, "sending a PDO")
        port = self._port(net, False, number)
        self.service.lease.note_pdo(net)
        with self.service.under_way:
            await self.service.master.run(act(lambda now: port.send(values, now)))

    def _port(self, net: str, listens: bool, number: int) -> PdoPort:
        port = self._ports.get((net, listens, number))
        if port is None:
            raise LocalProtocolError(f"this client has set up no PDO {number} of that direction")
        return port


@asynccontextmanager
async def open_gateway(
    master: Master, *, allow: Collection[Permission] = (), limits: Limits | None = None
) -> AsyncIterator[GatewayService]:
    """Serve a master while the block runs, which has to end before the master's own. At its end what a client moves is halted.

    allow: what clients may change; by default nothing. limits: how much they may do at a time.
    """
    service = GatewayService(master, allow=allow, limits=limits)
    async with beside(trio.open_nursery()) as nursery:
        service.begin(nursery)
        try:
            yield service
        finally:
            with trio.CancelScope(shield=True):
                await service.end()
