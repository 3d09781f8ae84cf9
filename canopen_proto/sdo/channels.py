"""The SDO channels of a device: the servers of 0x1200 to 0x127F, and the clients of 0x1280 to 0x12FF.

A record holds a channel: sub 1 the COB-ID from client to server, sub 2 the one from server to client, sub 3 the node-ID at the
other end. It exists while both COB-IDs are valid. A COB-ID is not valid while its bit 31 is set, or if it is 0, as in an empty
description. The first server (0x1200) has the predefined CAN-IDs and always exists.

    COB-ID        its CAN-ID and frame bit may not change while it is valid: 0x08000022. A restricted CAN-ID, or more than 11 bits
                  without the frame bit: 0x06090030. A client's may be those of another node's first server, which are restricted
                  because they belong there. Setting bit 31 is always allowed
    dynamic       bit 30 says that an SDO manager has given the COB-ID for now: all the same here, but it is not stored (0x1010)
    node-ID       above 127: 0x06090030. It is for people, and is the node-ID in the events of a client

A write that changes nothing is always allowed.

Servers share one store; each has its own transfer under way. A client has one transfer under way and a queue of its own, and
takes requests while its record is valid and SDO lives in the node's NMT state. A transfer that is under way ends

    with the record     by an abort on the channel as it was (0x08000022), of which a client reports each request as SdoAborted
    with the NMT state  without a frame: a node that is stopped or resets may not send any

Left out: channels that an SDO manager hands out (CiA 302-5); it only has to write these records.

Source: CiA 301 v4.2.0, 7.5.2.33 and 7.5.2.34; 7.3.5, table 40.
"""

from __future__ import annotations

from collections.abc import Container
from typing import Final

from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.cob_id import check_cob_id, is_valid
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Values
from canopen_proto.frame import (
    COB_ID_INVALID,
    MAX_NODE_ID,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    RoutingKey,
    key_of_cob_id,
    routing_key,
)
from canopen_proto.group import Members
from canopen_proto.machine import LocalProtocolError, Outbox, RequestId, Time
from canopen_proto.multiplexer import Mux, index_of, mux, subindex_of
from canopen_proto.owner import Owner
from canopen_proto.sdo.access import ObjectStore
from canopen_proto.sdo.client import SdoClient
from canopen_proto.sdo.server import SdoServer
from canopen_proto.sdo.transfer import Transfer

FURTHER_SERVERS: Final = indices.SDO_SERVERS[1:]

# subindices of a record
TO_SERVER: Final = 1
TO_CLIENT: Final = 2
OTHER_NODE: Final = 3

DYNAMIC: Final = 1 << 30
"""Bit of a COB-ID: assigned by an SDO manager."""

_FIRST_SERVERS: Final = {
    TO_SERVER: range(SDO_CLIENT_TO_SERVER + 1, SDO_CLIENT_TO_SERVER + MAX_NODE_ID + 1),
    TO_CLIENT: range(SDO_SERVER_TO_CLIENT + 1, SDO_SERVER_TO_CLIENT + MAX_NODE_ID + 1),
}
"""The CAN-IDs of the nodes' first servers."""


def is_dynamic(mux: Mux, value: Value) -> bool:
    """Return whether the object is the COB-ID of a channel, assigned by an SDO manager."""
    is_cob_id = SdoChannels.owns(index_of(mux)) and subindex_of(mux) in (TO_SERVER, TO_CLIENT)
    return is_cob_id and isinstance(value, int) and bool(value & DYNAMIC)


def _allowed(index: int, subindex: int) -> Container[int]:
    """Return the restricted CAN-IDs that a record may have."""
    return _FIRST_SERVERS[subindex] if index in indices.SDO_CLIENTS else ()


def channel_of(values: Values, index: int) -> tuple[RoutingKey, RoutingKey] | None:
    """Return the channel of the record at an index, as `Frame.key`: client to server, server to client.

    None if the record is not valid, or has a CAN-ID that no client could have written: a file may give a further server those of
    the first.
    """
    keys = []
    for subindex in (TO_SERVER, TO_CLIENT):
        cob_id = _number(values, index, subindex)
        if not is_valid(cob_id) or check_cob_id(cob_id, cob_id, in_use=False, allowed=_allowed(index, subindex)) is not None:
            return None
        keys.append(key_of_cob_id(cob_id))
    return keys[0], keys[1]


def _number(values: Values, index: int, subindex: int) -> int:
    value = values.store.get(mux(index, subindex))
    return value if isinstance(value, int) else 0


class ChannelClient(SdoClient):
    """The client of one record, for as long as the device lives; its channel comes and goes.

    index: of the record. While `is_open` is False, requests raise LocalProtocolError.
    """

    __slots__ = ("_lives", "index")

    def __init__(self, out: Outbox, node_id: int, index: int) -> None:
        """node_id: of the device itself, until the record names the server."""
        super().__init__(out, node_id)
        self.index = index
        self.channel = None
        self._lives = False

    @property
    def is_open(self) -> bool:
        """Whether it takes requests: it has a channel, and SDO lives in the NMT state of the device."""
        return self._lives and self.channel is not None

    def set_enabled(self, lives: bool, now: Time) -> None:
        """Tell whether SDO lives in the NMT state of the device. If not, open requests end without a frame."""
        if lives != self._lives:
            self._lives = lives
            if not lives:
                self.abort_all(AbortCode.DEVICE_STATE, now)  # `send` keeps it off the bus
            self._reroute()

    def can_ids(self) -> tuple[RoutingKey, ...]:
        return super().can_ids() if self.is_open else ()

    def _submit(self, transfer: Transfer, urgent: bool, now: Time, timeout: Time | None = None) -> RequestId:
        if self.channel is None:
            raise LocalProtocolError(f"{transfer}: 0x{self.index:04X} holds no channel: not both of its COB-IDs are valid")
        if not self._lives:
            raise LocalProtocolError(f"{transfer}: SDO does not live in the NMT state of this device")
        return super()._submit(transfer, urgent, now, timeout)

    def send(self, payload: bytes) -> None:
        if self._lives:
            super().send(payload)


class SdoChannels(Owner):
    """All SDO channels of one device; see this module's text.

    servers: by number, 1 (0x1200, there or not) to 128. clients: by number, 1 (0x1280) to 128. Each stands for ever, whether its
    record is valid or not. Read-only outside.
    """

    __slots__ = ("_values", "clients", "servers")

    def __init__(self, out: Outbox, node_id: int, values: Values, store: ObjectStore, members: Members) -> None:
        """Makes the machines and attaches them to `members`, mute; `reload` and `set_enabled` open them."""
        self._values = values
        self.servers: dict[int, SdoServer] = {1: SdoServer(out, node_id, store)}
        self.clients: dict[int, ChannelClient] = {}
        for index in sorted(values.dictionary.objects):
            if index in FURTHER_SERVERS:
                server = self.servers[index - indices.SDO_SERVER_PARAMETER + 1] = SdoServer(out, node_id, store)
                server.set_channel(None)
            elif index in indices.SDO_CLIENTS:
                self.clients[index - indices.SDO_CLIENT_1_PARAMETER + 1] = ChannelClient(out, node_id, index)
        for each in self.servers.values():
            each.disable()
        for machine in (*self.servers.values(), *self.clients.values()):
            members.attach(machine)

    @staticmethod
    def owns(index: int) -> bool:
        """Return whether an object is the record of a channel: then its writes are checked and applied here."""
        return index in FURTHER_SERVERS or index in indices.SDO_CLIENTS

    def set_node_id(self, node_id: int) -> None:
        """Be another node from now on (LSS): the first server has its channel by the node-ID."""
        for server in self.servers.values():
            server.node_id = node_id
        self.servers[1].set_channel((routing_key(SDO_CLIENT_TO_SERVER + node_id), routing_key(SDO_SERVER_TO_CLIENT + node_id)))

    def set_enabled(self, lives: bool, now: Time) -> None:
        """Whether SDO lives in the node's NMT state."""
        for server in self.servers.values():
            if lives:
                server.enable()
            else:
                server.disable()
        for client in self.clients.values():
            client.set_enabled(lives, now)

    def reload(self, now: Time) -> None:
        """Go by the values: at the start, and when a reset has put the defaults back."""
        for number in self.servers:
            if number > 1:
                self.apply(indices.SDO_SERVER_PARAMETER + number - 1, 0, now)
        for number in self.clients:
            self.apply(indices.SDO_CLIENT_1_PARAMETER + number - 1, 0, now)

    def client(self, number: int) -> ChannelClient:
        """The client of record 0x1280 + number - 1 (number: 1..128). It is the same one for ever.

        It takes requests while both COB-IDs of its record are valid and SDO lives in the NMT state of the device; else these
        raise LocalProtocolError. When that ends, each open request ends as SdoAborted (0x08000022, origin LOCAL). Events bear the
        node-ID of the record's sub 3. Raises LocalProtocolError where the dictionary has no such record.
        """
        client = self.clients.get(number)
        if client is None:
            known = ", ".join(map(str, self.clients)) or "none"
            raise LocalProtocolError(f"SDO client {number}: the dictionary has no record for it (0x1280 is 1). It has: {known}")
        return client

    # ---- as the owner of these objects ----

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        """Return why this value may not be written to a record, or None. Its type and limits are right. Changes nothing."""
        present = _number(self._values, index, subindex)
        if not isinstance(value, int) or value == present:
            return None
        if subindex == OTHER_NODE:
            return AbortCode.INVALID_VALUE if value > MAX_NODE_ID else None
        if subindex not in (TO_SERVER, TO_CLIENT) or value & COB_ID_INVALID:
            return None
        return check_cob_id(value, present, in_use=is_valid(present), allowed=_allowed(index, subindex))

    def apply(self, index: int, subindex: int, now: Time) -> None:
        """A value was stored in a record: its channel goes by it from now on.

        Not before the write is confirmed: it may have come over that very channel.
        """
        channel = channel_of(self._values, index)
        if index in FURTHER_SERVERS:
            self.servers[index - indices.SDO_SERVER_PARAMETER + 1].set_channel(channel)
            return
        client = self.clients[index - indices.SDO_CLIENT_1_PARAMETER + 1]
        client.set_channel(channel, now)
        server_id = _number(self._values, index, OTHER_NODE)
        if 1 <= server_id <= MAX_NODE_ID:
            client.node_id = server_id

    # ---- the host ----

    def complete(
        self, access_id: int, result: bytes | AbortCode | None, now: Time, *, more: bool = False, size: int | None = None
    ) -> None:
        """Give the host's answer to the server that waits for it, if one still does. See SdoServer.complete."""
        for server in self.servers.values():
            if server.complete(access_id, result, now, more=more, size=size):
                break

    def host_takes(self, index: int, subindex: int | None = None) -> bool:
        """Return whether an object (any of an index if subindex is None) is being downloaded to the host, over any channel."""
        taken = [server.object_for_host for server in self.servers.values()]
        return any(mux is not None and index_of(mux) == index and subindex in (None, subindex_of(mux)) for mux in taken)
