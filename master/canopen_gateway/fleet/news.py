"""What a fleet tells: events, each about a place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from canopen_gateway.fleet.keys import FleetPlace, PdoCount
from canopen_proto.datatypes import DataType, Value
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


class FleetStatus(FleetNews):
    """A bridge says, once a second, how its bus is. place: of the bus. told: what it says, as `Fleet.status` returns it: whatever
    a bridge has sent, so it has to be looked at with care."""

    __slots__ = ("told",)
    __match_args__ = ("node_id", "place", "told")

    def __init__(self, place: FleetPlace, told: Mapping[str, Any]) -> None:
        super().__init__(place)
        self.told = told


class FleetState(FleetNews):
    """A node has another NMT state. place: of the node. state: None if the bridge sent one that this program does not know. time:
    of the bridge's clock, ns since 1970; None if it has not told."""

    __slots__ = ("state", "time")
    __match_args__ = ("node_id", "place", "state", "time")

    def __init__(self, place: FleetPlace, state: NmtState | None, time: int | None = None) -> None:
        super().__init__(place)
        self.state = state
        self.time = time


class FleetEmcy(FleetNews):
    """A node has sent an emergency. place: of the node. code: 16 bits; 0x00xx: errors are gone. error_register: 0x1001 at that
    time. vendor_data: 5 bytes. time: of the bridge's clock, ns since 1970."""

    __slots__ = ("code", "error_register", "time", "vendor_data")
    __match_args__ = ("node_id", "place", "code", "error_register", "vendor_data", "time")

    def __init__(self, place: FleetPlace, code: int, error_register: int, vendor_data: bytes, time: int) -> None:
        super().__init__(place)
        self.code = code
        self.error_register = error_register
        self.vendor_data = vendor_data
        self.time = time


class FleetField(NamedTuple):
    """A value in a PDO. object: "6041:00". name, unit: of the bridge's dictionary. data: its bytes; its bits, if it has no whole
    bytes, from the lowest on."""

    object: str
    name: str
    data_type: DataType
    unit: str
    value: Value
    data: bytes


class FleetPdo(FleetNews):
    """A PDO has come to a bridge. place: of its node. number: 1..512. data: its bytes. fields: what it carries, in its order;
    empty while the bridge has not told yet. time: of the bridge's clock, ns since 1970. count: which one of its kind it is, for
    who wants to know what was lost; None if the bridge does not count."""

    __slots__ = ("count", "data", "fields", "number", "time")
    __match_args__ = ("node_id", "place", "number", "data", "fields", "time", "count")

    def __init__(
        self,
        place: FleetPlace,
        number: int,
        data: bytes,
        fields: Sequence[FleetField],
        time: int,
        count: PdoCount | None = None,
    ) -> None:
        super().__init__(place)
        self.number = number
        self.data = data
        self.fields = fields
        self.time = time
        self.count = count

    @property
    def values(self) -> Mapping[str, Value]:
        """The values by name."""
        return {each.name: each.value for each in self.fields}
