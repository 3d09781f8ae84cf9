"""What a fleet tells: events, each about a place."""

from __future__ import annotations

from collections.abc import Mapping

from canopen_gateway.fleet.keys import FleetPlace
from canopen_proto.datatypes import Value
from canopen_proto.machine import Event
from canopen_proto.nmt import NmtState


class FleetNews(Event):
    """Base of what a fleet tells. place: the bus or the node; node_id: 0 if it is the bus."""

    __slots__ = ("place",)
    __match_args__ = ("node_id", "place")

    def __init__(self, place: FleetPlace) -> None:
        self.node_id = place.node_id
        self.place = place


class PlaceAppeared(FleetNews):
    """A bridge, or a node, is there: for the first time, or again. place: of it."""

    __slots__ = ()


class PlaceGone(FleetNews):
    """A bridge, or a node, is there no longer: it was ended or cut off, or its heartbeat was lost. place: of it. The nodes of a
    bridge go with it, each with an event of its own."""

    __slots__ = ()


class FleetState(FleetNews):
    """A node has another NMT state. place: of the node. state: None if the bridge sent one that this program does not know."""

    __slots__ = ("state",)
    __match_args__ = ("node_id", "place", "state")

    def __init__(self, place: FleetPlace, state: NmtState | None) -> None:
        self.node_id = place.node_id
        self.place = place
        self.state = state


class FleetEmcy(FleetNews):
    """A node has sent an emergency. place: of the node. code: 16 bits; 0x00xx: errors are gone. error_register: 0x1001 at that
    time. vendor_data: 5 bytes. time: of the bridge's clock, ns since 1970."""

    __slots__ = ("code", "error_register", "time", "vendor_data")
    __match_args__ = ("node_id", "place", "code", "error_register", "vendor_data", "time")

    def __init__(self, place: FleetPlace, code: int, error_register: int, vendor_data: bytes, time: int) -> None:
        self.node_id = place.node_id
        self.place = place
        self.code = code
        self.error_register = error_register
        self.vendor_data = vendor_data
        self.time = time


class FleetPdo(FleetNews):
    """A PDO has come to a bridge. place: of its node. number: 1..512. data: its bytes. values: by name; empty while the bridge
    has not told yet what it carries. time: of the bridge's clock, ns since 1970."""

    __slots__ = ("data", "number", "time", "values")
    __match_args__ = ("node_id", "place", "number", "data", "values", "time")

    def __init__(self, place: FleetPlace, number: int, data: bytes, values: Mapping[str, Value], time: int) -> None:
        self.node_id = place.node_id
        self.place = place
        self.number = number
        self.data = data
        self.values = values
        self.time = time
