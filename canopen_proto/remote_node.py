"""`RemoteNode`: the view that a master, a service tool or a bus monitor has of another node.

It is a group of machines for one node: SDO clients, heartbeat consumer, EMCY consumer, and the PDOs that it exchanges with us. It
holds

- `values`: the known values of the node's objects. PDOs are decoded into this image and built from it; an SDO read and a
  confirmed SDO write also set it. `heard_at`: when the node itself last sent the value (a PDO, a read). Objects that we command
  keep the value that we set, whatever is read: those of RPDOs that we send, and those in `commanded`. `may_hold` returns the
  other values that the device may have in them: those written as bytes, past `write`, and those not confirmed;
- `held`: the RPDOs whose data may wait in the device for the next SYNC, which would undo a write by SDO. So a `write` of an
  object in `commanded` (a controlword) first sends each such RPDO with this object again, with the new value: the next SYNC then
  brings the last command;
- `unread_pdos`: the PDOs that were exchanged as the device had them, and whose CAN-ID or mapping we have written since, or had
  written before it booted: a reset undoes that, unless the device has stored it. What their bytes mean is not known: such a TPDO
  is not received, such an RPDO not sent, until `add_tpdo` or `add_rpdo` says what they are now. A PDO that its user has described
  stays as described;
- `foreign_writes`: what other masters write to the node; it hears nothing unless it is asked to;
- `nmt_state`: the state in its heartbeat; without a heartbeat, the state that we commanded. A heartbeat right after a command may
  have been sent before it: the command counts until NMT_REACTION_TIME is over. A node whose heartbeat is lost keeps its state.

The reactions (CiA 301 v4.2.0, 7.3.2.2, table 37):

    node boots, or is lost          open SDO requests are aborted: their answers will not come
    node boots                      its values are old; its RPDOs must be enabled again: its mappings are the defaults. What we
                                    had set up anew goes into `unread_pdos`
    node Operational / not          its PDOs live / don't: RPDOs are not sent to a node that would ignore them
    SYNC sent or heard              synchronous RPDOs go out
    PDO received                    `values` is updated

Directions have the device's point of view: an RPDO is sent by us, a TPDO is received by us.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable
from typing import Any, Final

from canopen_proto.abort import AbortCode
from canopen_proto.compiling import mypyc_attr
from canopen_proto.datatypes import Codec, Value, ValueRangeError
from canopen_proto.dictionary import Direction, Key, Message, ObjectDictionary, PdoDescription, Values, Variable
from canopen_proto.emcy import EmcyConsumer
from canopen_proto.foreign_writes import ForeignWrites
from canopen_proto.frame import (
    KEY_EXTENDED,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    Frame,
    RoutingKey,
    key_of_cob_id,
    routing_key,
)
from canopen_proto.group import Entrance, Group
from canopen_proto.guarding import GuardingMaster, NodeGuardingLost
from canopen_proto.heartbeat import HeartbeatConsumer, HeartbeatLost, HeartbeatReceived, NodeBooted
from canopen_proto.machine import MILLISECOND, NEVER, LocalProtocolError, Machine, Outbox, RequestId, Time, check_node_id
from canopen_proto.multiplexer import Mux, mux, split_mux
from canopen_proto.nmt import NmtCommand, NmtState, target_of
from canopen_proto.pdo.consumer import PdoConsumer, PdoReceived
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.pdo.multiplexed import MpdoListener, MpdoReceived, destination_frame, suits_mpdo
from canopen_proto.pdo.producer import HeldRpdos, PdoProducer
from canopen_proto.pdo.settings import COB_ID, FIRST_PDO_RECORD, LAST_PDO_RECORD, MAX_PDOS, place_of
from canopen_proto.sdo.client import Block, SdoAborted, SdoClient, SdoDownloaded, SdoUploaded
from canopen_proto.sdo.transfer import Channel

FRESH: Final = 100 * MILLISECOND
"""A value younger than this is taken as the present one: ten cycles of the usual 10 ms."""

NMT_REACTION_TIME: Final = 50 * MILLISECOND
"""A heartbeat that comes this soon after an NMT command may not know of it yet: it waited in the node's or an adapter's queue."""


@mypyc_attr(allow_interpreted_subclasses=True)
class RemoteNode(Group):
    """All machines for one other node. Make it with a Network's `out`, then attach it to the Network."""

    __slots__ = (
        "_boot_listeners", "_decoded", "_in_doubt", "_listeners", "_mpdo_listener", "_mpdo_rpdos", "_sync_listeners", "_wanted",
        "_writes", "booted_at", "boots", "commanded", "commanded_at", "dictionary", "emcy", "foreign_writes", "guarding",
        "heard_at", "heartbeat", "held", "last_sync", "nmt_state", "node_id", "pdo_writes", "read_pdos", "rpdos", "sdo",
        "sdo_channels", "set_up", "tpdos", "unread_pdos", "values",
    )  # fmt: skip

    def __init__(
        self,
        out: Outbox,
        node_id: int,
        dictionary: ObjectDictionary,
        *,
        sdo_timeout: Time = 500 * MILLISECOND,
        heartbeat_timeout: Time = 0,
    ) -> None:
        """node_id: 1..127. dictionary: of the node. sdo_timeout: ns for one answer. heartbeat_timeout: ns until HeartbeatLost; 0
        = listen only."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.dictionary = dictionary
        self.values = Values(dictionary, node_id)
        self.heard_at: dict[Mux, Time] = {}
        self.nmt_state: NmtState | None = None
        self.boots = 0  # how often its boot-up was heard
        self.booted_at: Time = -NEVER  # when it was heard last
        self.last_sync: Time | None = None
        self.commanded_at: Time = -NEVER  # when we commanded its NMT state last
        self.sdo = SdoClient(self.inner, node_id, timeout=sdo_timeout)
        self.sdo_channels: list[SdoClient] = []
        self.heartbeat = HeartbeatConsumer(self.inner, node_id, heartbeat_timeout)
        self.emcy = EmcyConsumer(self.inner, node_id)
        self.guarding = GuardingMaster(self.inner, node_id)
        self.rpdos: dict[int, PdoProducer] = {}
        self.tpdos: dict[int, PdoConsumer] = {}
        self.unread_pdos: set[tuple[Direction, int]] = set()
        self.read_pdos: set[tuple[Direction, int]] = set()  # those that are exchanged as the device had them
        self.pdo_writes = 0  # how often we have written a CAN-ID or a mapping: what was read meanwhile may be half old, half new
        self.set_up: dict[tuple[Direction, int], int] = {}  # the same of each PDO, since the node booted
        self._mpdo_listener = MpdoListener(self.inner, node_id, self.values)
        self._mpdo_rpdos: dict[int, RoutingKey] = {}  # RPDO number -> key
        self.foreign_writes = ForeignWrites(self.inner, node_id, dictionary, self.rpdos, self.unread_pdos)
        self.commanded: set[Mux] = set()
        self._in_doubt: dict[Mux, set[Value | None]] = defaultdict(set)
        self.held = HeldRpdos()
        self._wanted: set[int] = set()
        self._writes: dict[RequestId, tuple[Variable, Value]] = {}
        self._decoded: tuple[SdoUploaded, Codec, Value] | None = None  # the last upload: whoever asked for it wants its value too
        self._listeners: list[Callable[[Collection[Mux], Time], None]] = []
        self._boot_listeners: list[Callable[[], None]] = []
        self._sync_listeners: tuple[Callable[[Time], None], ...] = ()
        for machine in (self.sdo, self.heartbeat, self.emcy, self._mpdo_listener, self.foreign_writes):
            self._members.attach(machine)
        self._reactions.update(
            {
                NodeBooted: self._on_boot,
                HeartbeatLost: self._on_lost,
                NodeGuardingLost: self._on_lost,
                HeartbeatReceived: self._on_heartbeat,
                PdoReceived: self._on_pdo,
                MpdoReceived: self._on_mpdo,
                SdoUploaded: self._on_uploaded,
                SdoDownloaded: self._on_downloaded,
                SdoAborted: self._on_aborted,
            }
        )

    @property
    def is_operational(self) -> bool:
        """Whether the node is in NMT state Operational, as far as we know."""
        return self.nmt_state is NmtState.OPERATIONAL

    def on_device(self, mux: Mux) -> Mux:
        """Return the number that an object has on the device: its own. The view of a further axis shifts it (FurtherAxis). mux:
        the object's number for the caller."""
        return mux

    def check_beside(self, others: Iterable[Machine]) -> None:
        """Refuse a second view of the same node: each of the two would hear the answers to the other's requests."""
        if any(isinstance(each, RemoteNode) and each.node_id == self.node_id for each in others):
            raise LocalProtocolError(f"there is a RemoteNode of node {self.node_id} in this network already")

    # ---- objects by SDO ----

    def read(self, key: Key, now: Time, *, urgent: bool = False, block: Block = False) -> RequestId:
        """Ask for an object by SDO. SdoUploaded (see `value_of`) or SdoAborted follows. block: see `Block`. key: a name, an index
        or (index, subindex), see `Key`. urgent: goes before all requests that are not.

        CiA 301 v4.2.0, 7.2.4.2.5
        """
        variable = self.dictionary.variable(key)
        return self.sdo.upload(variable.index, variable.subindex, now, urgent=urgent, block=block)

    def write(self, key: Key, value: Value, now: Time, *, urgent: bool = False, block: Block = False) -> RequestId:
        """Write an object by SDO. value: may be the name of a constant. SdoDownloaded or SdoAborted follows. block: see `Block`.
        key: a name, an index or (index, subindex), see `Key`. urgent: goes before all requests that are not.

        If the device may hold a synchronous RPDO with an object in `commanded`, that RPDO is sent first, with the new value.
        Raises LocalProtocolError for an unknown name or a read-only object, ValueRangeError for a value that does not fit;
        nothing is sent then. CiA 301 v4.2.0, 7.2.4.2.2
        """
        variable, meant, data = self.encode(key, value)
        frames = self.out.frames
        mark = len(frames)
        request_id = self.sdo.download(variable.index, variable.subindex, data, now, urgent=urgent, block=block)
        self._writes[request_id] = (variable, meant)
        if variable.mux in self.commanded:
            end = len(frames)
            self.replace_held(variable.mux, meant, now)
            frames[mark:] = frames[end:] + frames[mark:end]
        return request_id

    def cancel(self, request_id: RequestId, now: Time) -> bool:
        """Give up a request of `read` or `write`, or of an SDO client of this node: SdoAborted follows at once. request_id: the
        one that the request returned.

        Returns False if no such request is open.
        """
        mark = len(self.inner.events)
        was_open = any(client.cancel(request_id, now) for client in self._clients)
        self._settle(mark, now)
        return was_open

    def drop_waiting(self, mux: Mux, now: Time) -> None:
        """Give up the writes of an object that wait, on any channel, unless they are urgent: nothing of them was sent. SdoAborted
        (CANCELLED) follows for each.

        For an urgent write of the same object, which goes before them: sent behind it, they would undo it.
        """
        for client in self._clients:
            for request_id in client.waiting_writes(*split_mux(mux)):
                self.cancel(request_id, now)

    def make_way(self, now: Time) -> None:
        """End what an urgent request of `sdo` waits for: its transfer under way, and those of further channels, since a device
        may serve one at a time. SdoAborted (CANCELLED) follows. Transfers that are urgent themselves go on."""
        mark = len(self.inner.events)
        for client in self._clients:
            client.make_way(now, is_asked=client is not self.sdo)
        self._settle(mark, now)

    def add_sdo_channel(self, request_key: RoutingKey, response_key: RoutingKey) -> SdoClient:
        """Return a client for another SDO server of the node (0x1201 and on). request_key: to the server; response_key: from it.

        It has its own transfer and queue, so a long transfer does not delay the others. As with `sdo`, its requests end when the
        node boots or is lost, values that it reads or writes go into `values`, and `cancel` finds its requests. Raises
        LocalProtocolError for an invalid key, or one that this node already uses. CiA 301 v4.2.0, 7.5.2.33
        """
        self._check_channel(request_key, response_key, self._clients)
        client = SdoClient(self.inner, self.node_id, request_key=request_key, response_key=response_key, timeout=self.sdo.timeout)
        self.sdo_channels.append(client)
        self._members.attach(client)
        return client

    def remove_sdo_channel(self, client: SdoClient, now: Time) -> None:
        """Remove a channel that `add_sdo_channel` made; its open requests are aborted. client: the one that it returned."""
        mark = len(self.inner.events)
        client.abort_all(AbortCode.GENERAL_ERROR, now)
        self._settle(mark, now)
        self._members.detach(client)
        self.sdo_channels.remove(client)

    def move_sdo(self, channel: Channel | None, now: Time) -> None:
        """Use another SDO server of the node for all requests of `sdo`. channel: client to server, server to client; None: the
        first one again.

        For a program that leaves the first channel to another one. Open requests of `sdo` end as SdoAborted. Raises
        LocalProtocolError for an invalid key, or one that another channel of this node already uses.
        """
        first = (routing_key(SDO_CLIENT_TO_SERVER + self.node_id), routing_key(SDO_SERVER_TO_CLIENT + self.node_id))
        wanted = first if channel is None else channel
        self._check_channel(*wanted, self.sdo_channels)
        mark = len(self.inner.events)
        self.sdo.set_channel(wanted, now)
        self._settle(mark, now)

    def _check_channel(self, request_key: RoutingKey, response_key: RoutingKey, others: Iterable[SdoClient]) -> None:
        for key in (request_key, response_key):
            self._check_key("SDO channel", key)
        if request_key == response_key or any(response_key in client.can_ids() for client in others):
            raise LocalProtocolError(
                f"SDO channel of node {self.node_id}: another channel uses CAN-ID 0x{response_key & ~KEY_EXTENDED:X}"
            )

    @property
    def _clients(self) -> tuple[SdoClient, ...]:
        return (self.sdo, *self.sdo_channels)

    def encode(self, key: Key, value: Value) -> tuple[Variable, Value, bytes]:
        """Return the object, the value and the bytes that `write` would send. Raises as `write` does. key, value: as for
        `write`."""
        variable = self.dictionary.variable(key)
        if not variable.access.writable:
            raise LocalProtocolError(f"{variable.label} of node {self.node_id} is {variable.access}: it cannot be written")
        meant = self.dictionary.value_from(variable, value) if isinstance(value, str) else value
        if variable.low_limit is not None or variable.high_limit is not None:
            variable.check_limits(meant)
        return variable, meant, variable.codec.encode(meant, variable)

    def value_of(self, uploaded: SdoUploaded, variable: Variable | None = None) -> Value:
        """Return the value that an upload brought. variable: the object that was asked for; None: look it up.

        Raises ObjectNotFoundError; ValueRangeError if the length is not the object's.
        """
        if self._decoded is not None:
            last, codec, value = self._decoded
            if last is uploaded and (variable is None or variable.codec is codec):
                return value
        if variable is None:
            variable = self.dictionary.at(uploaded.index, uploaded.subindex)
        return variable.decode(uploaded.data)

    def message_of(self, uploaded: SdoUploaded) -> Message:
        """Return what an upload brought, by name and with its constants. Raises as `value_of` does."""
        variable = self.dictionary.at(uploaded.index, uploaded.subindex)
        return self.dictionary.message(self.node_id, variable, self.value_of(uploaded, variable), self.out.timestamp)

    def fresh(self, mux: Mux, now: Time, max_age: Time = FRESH) -> Value | None:
        """Return the image of an object if it was heard at most max_age ns ago, else None. mux: the object's number for the
        caller. max_age: 100 ms by default."""
        heard = self.heard_at.get(mux)
        return self.values.store[mux] if heard is not None and now - heard <= max_age else None

    # ---- PDOs ----

    def add_pdo(
        self, description: PdoDescription, now: Time, *, number: int | None = None, transmission_type: int = 1
    ) -> PdoConsumer | PdoProducer:
        """Exchange a PDO with the node as described. It replaces the one of this number and direction. description: its
        direction, CAN-ID and objects.

        number: 1..512; None = that of the predefined connection set. transmission_type: of an RPDO: 1..240 = sent at every n-th
        SYNC, 254 and 255 = when triggered. A TPDO is decoded when it comes. An RPDO is sent once `enable_rpdo` was called.
        """
        number = description.number if number is None else number
        if number is None:
            raise LocalProtocolError(f"PDO {description.name}: 0x{description.cob_base:X} has no predefined number; give one")
        mapping, key = Mapping.from_description(description), routing_key(description.can_id(self.node_id))
        if description.direction is Direction.TPDO:
            return self.add_tpdo(number, key, mapping, now)
        return self.add_rpdo(number, key, mapping, transmission_type)

    def add_tpdo(self, number: int, key: RoutingKey, mapping: Mapping, now: Time, *, is_read: bool = False) -> PdoConsumer:
        """Receive the device's TPDO `number` (1..512) on a CAN-ID (a routing key). mapping: its objects; their values go to
        `values`. It replaces the TPDO of this number. is_read: that is how the device has it; see `unread_pdos`."""
        self._check_pdo(Direction.TPDO, number, key)
        self.remove_pdo(Direction.TPDO, number)
        consumer = PdoConsumer(self.inner, self.node_id, number, key, mapping, self.values.store)
        consumer.set_enabled(True, now)  # a TPDO that comes shows that the node is Operational, whoever started it
        self.tpdos[number] = consumer
        if is_read:
            self.read_pdos.add((Direction.TPDO, number))
        self._members.attach(consumer)
        self._reroute()
        return consumer

    def add_rpdo(
        self, number: int, key: RoutingKey, mapping: Mapping, transmission_type: int = 1, *, is_read: bool = False
    ) -> PdoProducer:
        """Send the device's RPDO `number` (1..512) on a CAN-ID (a routing key), once `enable_rpdo` was called. mapping: its
        objects; their values are taken from `values`. transmission_type: 1..240 = sent at every n-th SYNC, 254 and 255 = when
        triggered. It replaces the RPDO of this number. is_read: that is how the device has it; see `unread_pdos`."""
        self._check_pdo(Direction.RPDO, number, key)
        before, was_unread = self.rpdos.get(number), (Direction.RPDO, number) in self.unread_pdos
        self.remove_pdo(Direction.RPDO, number)
        if before is not None and (was_unread or before.mapping.entries != mapping.entries):
            self.foreign_writes.forget(key)
        producer = PdoProducer(self.inner, self.node_id, number, key, mapping, self.values.store, transmission_type)
        if before is not None and (before.key, before.mapping.entries) == (producer.key, mapping.entries):
            producer.sent_at = before.sent_at  # the device may still hold the data of the one before
        self.rpdos[number] = producer
        if is_read:
            self.read_pdos.add((Direction.RPDO, number))
        self._members.attach(producer)
        self.foreign_writes.renew()
        return producer

    def _check_pdo(self, direction: Direction, number: int, key: RoutingKey) -> None:
        if not 1 <= number <= MAX_PDOS:
            raise LocalProtocolError(f"{direction} {number} of node {self.node_id}: a PDO has a number in 1..{MAX_PDOS}")
        self._check_key(f"{direction} {number}", key)

    def _check_key(self, what: str, key: RoutingKey) -> None:
        if key > 0x7FF and not key & KEY_EXTENDED:
            raise LocalProtocolError(f"{what} of node {self.node_id}: CAN-ID 0x{key:X} has more than 11 bits")

    def remove_pdo(self, direction: Direction, number: int) -> None:
        """Stop exchanging this PDO or MPDO; does nothing if it is not exchanged. direction: as the device sees it. number:
        1..512."""
        self.unread_pdos.discard((direction, number))
        self.read_pdos.discard((direction, number))
        machine = (self.tpdos if direction is Direction.TPDO else self.rpdos).pop(number, None)
        if machine is not None:
            self._members.detach(machine)
            self._reroute()
        if direction is Direction.RPDO:
            self._wanted.discard(number)
            self._mpdo_rpdos.pop(number, None)
            self.held.forget(number)
            self.foreign_writes.renew()
        else:
            self._mpdo_listener.set_pdo(number, None)

    def enable_rpdo(self, number: int, now: Time, enabled: bool = True) -> None:
        """Send an RPDO while the node is Operational, or stop it. Set `values` first: the next SYNC sends them. A boot of the
        node stops it too. number: 1..512, of one that was added and is not in `unread_pdos`, else LocalProtocolError. enabled:
        False stops it."""
        producer = self.rpdos.get(number)
        if producer is None:
            raise LocalProtocolError(f"node {self.node_id} has no RPDO {number} that we send; add_pdo makes one")
        if enabled and (Direction.RPDO, number) in self.unread_pdos:
            text = f"RPDO {number} of node {self.node_id} was set up anew, or reset, and not read since; exchange it again first"
            raise LocalProtocolError(text)
        (self._wanted.add if enabled else self._wanted.discard)(number)
        producer.set_enabled(enabled and self.is_operational, now)

    def rpdo_of(self, key: Key) -> PdoProducer | None:
        """Return the live RPDO that carries an object, or None. key: as in `Mapping.find_component`."""
        for producer in self.rpdos.values():
            if producer.is_live and producer.mapping.find_component(key) is not None:
                return producer
        return None

    def send_rpdo(self, producer: PdoProducer, now: Time) -> bool:
        """Send an RPDO to the node now. producer: the caller's own over `values.store`, with the device's transmission type.

        For a master that sends its RPDOs by hand, and a SYNC after them. Returns and raises as `PdoProducer.send` does.
        """
        self.held.sent_by_hand(producer)
        return producer.send(now)

    def keep_commanded(self, mux: Mux) -> None:
        """Count an object as commanded by us from now on: it goes into `commanded`. mux: the object's number for the caller."""
        self.commanded.add(mux)

    def may_hold(self, mux: Mux) -> set[Value | None]:
        """Return the values that the device may have in an object of `commanded`; None in the set is an unknown value. mux: the
        object's number for the caller."""
        image = {self.values.store[mux]} if mux in self.values.store else set()
        return image | self._in_doubt.get(mux, set())

    def replace_held(self, mux: Mux, value: Value, now: Time) -> bool:
        """Send each RPDO again that carries an object and that the device may hold for the next SYNC, with a new value. mux: the
        object's number for the caller.

        Returns False, and changes nothing, if the device holds none.
        """
        known = [each for number, each in self.rpdos.items() if (Direction.RPDO, number) not in self.unread_pdos]
        held = self.held.carrying(mux, known)
        if held:
            self.values.store[mux] = value
        for producer in held:
            producer.send_again(now)
        return bool(held)

    # ---- multiplexed PDOs ----

    def add_mpdo(self, direction: Direction, number: int, key: RoutingKey) -> None:
        """Exchange a multiplexed PDO with the node. It replaces the PDO of this number (1..512) and direction.

        A TPDO, in source address mode, is received with this key: it sets `values` and `heard_at`, and MpdoReceived is reported.
        `send_mpdo` sends an RPDO, in destination address mode. CiA 301 v4.2.0, 7.2.3
        """
        self._check_pdo(direction, number, key)
        self.remove_pdo(direction, number)
        if direction is Direction.TPDO:
            self._mpdo_listener.set_pdo(number, key)
        else:
            self._mpdo_rpdos[number] = key

    def send_mpdo(self, number: int, key: Key, value: Value, now: Time) -> bool:
        """Write an object of the node by its RPDO `number`, an MPDO, which is not confirmed. Sets `values`. key: a name, an index
        or (index, subindex), see `Key`.

        value: may be the name of a constant. Sends nothing and returns False while the node is not Operational. Raises
        LocalProtocolError if this RPDO was not added, or cannot carry the object; else as `write` does.
        """
        if number not in self._mpdo_rpdos:
            raise LocalProtocolError(f"node {self.node_id} has no RPDO {number} that is an MPDO; add_mpdo makes one")
        variable, meant, data = self.encode(key, value)
        if not suits_mpdo(variable, Direction.RPDO):
            raise LocalProtocolError(f"an MPDO cannot carry {variable.label} to node {self.node_id}")
        frame = destination_frame(self._mpdo_rpdos[number], self.node_id, variable.index, variable.subindex, data)
        if self.is_operational:
            self.out.frames.append(frame)
            self.values.store[variable.mux] = meant
        return self.is_operational

    def add_listener(
        self,
        listener: Callable[[Collection[Mux], Time], None] | None = None,
        on_boot: Callable[[], None] | None = None,
        on_sync: Callable[[Time], None] | None = None,
    ) -> None:
        """Call `listener` with the muxes of updated values. For code on top of this node, such as an Axis.

        on_boot: called when the node boots: all values that it sent before are old. on_sync: called at each SYNC that is sent or
        received, after the RPDOs for it were built.
        """
        if listener is not None:
            self._listeners.append(listener)
        if on_boot is not None:
            self._boot_listeners.append(on_boot)
        if on_sync is not None:
            self._sync_listeners = (*self._sync_listeners, on_sync)

    def remove_sync_listener(self, on_sync: Callable[[Time], None]) -> None:
        """End the calls of a function that was given to `add_listener` as `on_sync`; ValueError if it was not."""
        left = list(self._sync_listeners)
        left.remove(on_sync)
        self._sync_listeners = tuple(left)

    # ---- node guarding ----

    def start_guarding(self, guard_time: Time, life_time_factor: int, now: Time) -> None:
        """Ask the node once per guard time whether it is alive: for a node without a heartbeat. See GuardingMaster.start.
        guard_time: ns, 1 ms or more. life_time_factor: 1..255; so many guard times without an answer make the node lost.

        Its answers also count as heartbeats (HeartbeatReceived, `nmt_state`). NodeGuardingLost ends open SDO requests.
        """
        self.guarding.start(guard_time, life_time_factor, now)
        self._members.attach(self.guarding)

    def stop_guarding(self) -> None:
        """Stop asking."""
        self.guarding.stop()
        self._members.detach(self.guarding)

    # ---- what the rest of the network does ----

    def on_sync(self, counter: int | None, now: Time, *, heard: bool = False) -> None:
        self.last_sync = now
        self.held.on_sync(now, heard)
        for producer in self.rpdos.values():
            producer.on_sync(counter, now)
        listeners = self._sync_listeners
        for listener in listeners:
            if listeners is self._sync_listeners or listener in self._sync_listeners:  # else another one has removed it
                listener(now)

    def on_nmt_command(self, command: NmtCommand, now: Time) -> None:
        self.commanded_at = now
        self._enter(target_of(command), now)

    def _enter(self, state: NmtState, now: Time) -> None:
        self.nmt_state = state
        for number in self._wanted:
            self.rpdos[number].set_enabled(self.is_operational, now)

    def _on_boot(self, report: NodeBooted, now: Time) -> None:
        self.boots += 1
        self.booted_at = now
        self.held.on_boot(now)
        self._enter(NmtState.PRE_OPERATIONAL, now)
        self._wanted.clear()
        for where in self.set_up:
            if where in self.read_pdos:
                self._make_unread(where, now)
        self.set_up.clear()
        self.assume_boot()
        self._on_lost(report, now)

    def assume_boot(self) -> None:
        """Forget what the node told: it has booted, though its boot-up was not heard. Its PDOs and requests stay as they are."""
        self.heard_at.clear()
        self._in_doubt.clear()
        for on_boot in self._boot_listeners:
            on_boot()

    def _on_lost(self, report: NodeBooted | HeartbeatLost | NodeGuardingLost, now: Time) -> None:
        for client in self._clients:
            client.abort_all(AbortCode.NO_SDO_CONNECTION, now)

    def _entrance(self, key: RoutingKey) -> Machine:
        """Return the entrance for a key: that of the group, or one of our own for what comes most, PDOs and heartbeats."""
        machines = self._members.receivers.get(key, ())
        if len(machines) == 1:
            machine = machines[0]
            if type(machine) is PdoConsumer:
                return _PdoEntrance(self, machine)
            if machine is self.heartbeat:
                return _HeartbeatEntrance(self, self.heartbeat)
        return super()._entrance(key)

    def _on_heartbeat(self, report: HeartbeatReceived, now: Time) -> None:
        self._enter_heard(report.state, now)

    def _enter_heard(self, state: NmtState, now: Time) -> None:
        if state is not self.nmt_state and now >= self.commanded_at + NMT_REACTION_TIME:
            self._enter(state, now)

    def _heard(self, muxes: Collection[Mux], now: Time) -> None:
        keys: Collection[Any] = muxes  # Any: compiled, a number would be put into a new object for each entry
        time: Any = now
        for each in keys:
            self.heard_at[each] = time
        for listener in self._listeners:
            listener(muxes, now)

    def _on_pdo(self, report: PdoReceived, now: Time) -> None:
        self._heard(report.mapping.muxes, now)

    def _on_mpdo(self, report: MpdoReceived, now: Time) -> None:
        self._heard((mux(report.index, report.subindex),), now)

    def _on_uploaded(self, report: SdoUploaded, now: Time) -> None:
        variable = self.dictionary.get(report.index, report.subindex)
        if variable is None or self._is_ours(variable.mux):
            return
        try:
            value = variable.codec.decode(report.data, variable)
        except ValueRangeError:
            return  # a length that is not the object's: the caller that asked sees the bytes
        self._decoded = (report, variable.codec, value)
        self.values.store[variable.mux] = value
        self._heard((variable.mux,), now)

    def _is_ours(self, mux: Mux) -> bool:
        """Return whether we command an object: our image of it is then newer than any value that is read."""
        for producer in self.rpdos.values():  # written out: `any` over a generator costs more than the rest of a read's reaction
            if mux in producer.mapping.muxes:
                return True
        return mux in self.commanded

    def _on_downloaded(self, report: SdoDownloaded, now: Time) -> None:
        written = self._writes.pop(report.request_id, None)
        which = mux(report.index, report.subindex) if written is None else written[0].mux
        if self._in_doubt:
            self._in_doubt.pop(which, None)
        if FIRST_PDO_RECORD <= report.index <= LAST_PDO_RECORD:
            self._on_pdo_written(report.index, report.subindex, None if written is None else written[1], now)
        if written is not None:
            self.values.store[which] = written[1]
        elif which in self.commanded:
            self._in_doubt[which].add(None)

    def _on_aborted(self, report: SdoAborted, now: Time) -> None:
        written, which = self._writes.pop(report.request_id, None), mux(report.index, report.subindex)
        if report.not_confirmed:
            if which in self.commanded:
                self._in_doubt[which].add(None if written is None else written[1])
            if FIRST_PDO_RECORD <= report.index <= LAST_PDO_RECORD:
                self._on_pdo_written(report.index, report.subindex, None, now)

    def _on_pdo_written(self, index: int, subindex: int, value: Value | None, now: Time) -> None:
        """Exchange a PDO no more whose mapping or CAN-ID we have written, or may have written. value: None = unknown."""
        place = place_of(index)
        if place is None or not (place.is_mapping or subindex == COB_ID):
            return
        self.pdo_writes += 1
        where = (place.direction, place.number)
        self.set_up[where] = self.set_up.get(where, 0) + 1
        if where not in self.read_pdos:
            return
        key = (self.rpdos if place.direction is Direction.RPDO else self.tpdos)[place.number].key
        if not place.is_mapping and isinstance(value, int) and key_of_cob_id(value) == key:
            return  # it is destroyed or created, on the CAN-ID that it has
        self._make_unread(where, now)

    def _make_unread(self, where: tuple[Direction, int], now: Time) -> None:
        direction, number = where
        if direction is Direction.RPDO:
            self._wanted.discard(number)
            self.rpdos[number].set_enabled(False, now)
            self.foreign_writes.forget(self.rpdos[number].key)
        else:
            self.remove_pdo(direction, number)
        self.unread_pdos.add(where)


class _PdoEntrance(Entrance):
    """Where a node takes in the frames of one TPDO: what `PdoConsumer.receive` and the node's reaction do, in one call.

    That is for the usual frame: of the right length, whose data take effect at once. All others go the long way.
    """

    __slots__ = ("_consumer", "_heard_at", "_listeners", "_root")

    def __init__(self, node: RemoteNode, consumer: PdoConsumer) -> None:
        super().__init__(node, consumer)
        self._consumer = consumer
        self._root = self.out.root
        self._heard_at = node.heard_at
        self._listeners = node._listeners
        store = consumer.store
        muxes: tuple[Any, ...] = consumer.mapping.muxes
        for each in muxes:
            if each in store:
                store[each] = store.pop(each)  # its key is this very object from now on, and need not be compared

    def receive(self, frame: Frame, now: Time) -> None:
        consumer, data = self._consumer, frame.data
        mapping, unpack = consumer.mapping, consumer.at_once
        if unpack is None or len(data) != mapping.byte_length:
            super().receive(frame, now)
            return
        values = unpack(data)
        store, heard_at = consumer.store, self._heard_at
        muxes: tuple[Any, ...] = mapping.muxes  # Any: compiled, a number would be put into a new object for each entry
        time: Any = now
        position = 0
        for each in muxes:
            store[each] = values[position]
            heard_at[each] = time
            position += 1  # noqa: SIM113 - as in `Mapping.unpack_into`
        root = self._root
        if not root.quiet:
            report = PdoReceived(consumer.node_id, consumer.number, frame.key, mapping, data, values, root.timestamp)
            self._events.append(report)
        if not self._listeners:
            return
        events = self._events
        mark = len(events)
        for listener in self._listeners:
            listener(muxes, now)
        while mark < len(events):  # what a listener has reported, as `Entrance.receive` does
            reaction = self._reactions.get(type(events[mark]))
            if reaction is not None:
                reaction(events[mark], now)
            mark += 1


class _HeartbeatEntrance(Entrance):
    """Where a node takes in its heartbeats: what `HeartbeatConsumer.receive` and the node's reaction do, in one call.

    That is for the usual frame: the same byte as in the heartbeat before, and nothing was lost. All others go the long way.
    """

    __slots__ = ("_consumer", "_node", "_root")

    def __init__(self, node: RemoteNode, consumer: HeartbeatConsumer) -> None:
        super().__init__(node, consumer)
        self._consumer = consumer
        self._root = self.out.root
        self._node = node

    def receive(self, frame: Frame, now: Time) -> None:
        consumer = self._consumer
        if frame.data != consumer.usual:
            super().receive(frame, now)
            return
        consumer.last_heard = now
        root, told = self._root, consumer.told
        if not root.quiet:
            timestamp = root.timestamp
            self._events.append(told if timestamp is None else HeartbeatReceived(consumer.node_id, told.state, timestamp))
        timeout = consumer.timeout
        if timeout:
            consumer.deadline = deadline = now + timeout
            if deadline < consumer._wake:
                consumer._arm(deadline)
        node = self._node
        if told.state is not node.nmt_state:
            node._enter_heard(told.state, now)
