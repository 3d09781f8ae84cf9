"""`ForeignWrites`: commands of other masters to one node: objects that somebody else writes by SDO or by an RPDO.

A participant does not receive its own frames. So an SDO request to the node, or an RPDO of it, that comes at all is another
master's. Only these frames are received here. The last write of each object that matters is kept; of an RPDO the last frame is,
and its meaning is worked out only when it is asked for.

RPDOs are listened to on the CAN-IDs of those that we send ourselves, and on the four of the predefined connection set. The
meaning is known of those that we send, unless they were set up anew and not read since; the caller may know others. Left out:
writes of more than four bytes, and of an SDO channel other than the first.

Source: CiA 301 v4.2.0, 7.2.4.3.3 (SDO download initiate), 7.3.3 (predefined connection set).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Set
from typing import Final, NamedTuple

from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.frame import RPDO1, RPDO2, RPDO3, RPDO4, SDO_CLIENT_TO_SERVER, Frame, RoutingKey
from canopen_proto.machine import Machine, Outbox, Time
from canopen_proto.multiplexer import Mux, split_mux
from canopen_proto.pdo.mapping import Mapping as PdoMapping
from canopen_proto.pdo.producer import PdoProducer
from canopen_proto.sdo.codec import REQUESTS, SIZE_BIT, SdoFrame, expedited_data, mux_in

_NONE: Final[dict[RoutingKey, PdoMapping]] = {}


class ForeignWrite(NamedTuple):
    """A write by another master. time: when it came. key: of its frame. value: None if what it wrote is not known."""

    time: Time
    key: RoutingKey
    value: Value | None


class ForeignWrites(Machine):
    """Hears the commands of other masters to one node; see this module's text. Hears nothing until `listen`."""

    __slots__ = ("_dictionary", "_listeners", "_node_id", "_pdos", "_rpdos", "_sdo_key", "_unread", "_wanted", "_written")

    def __init__(
        self,
        out: Outbox,
        node_id: int,
        dictionary: ObjectDictionary,
        rpdos: Mapping[int, PdoProducer],
        unread: Set[tuple[Direction, int]] = frozenset(),
    ) -> None:
        """rpdos: those that we send to the node; call `renew` when they change. unread: the PDOs whose mapping is not known."""
        super().__init__(out)
        self._node_id = node_id
        self._dictionary = dictionary
        self._rpdos = rpdos
        self._unread = unread
        self._sdo_key = RoutingKey(SDO_CLIENT_TO_SERVER + node_id)
        self._wanted: set[Mux] = set()
        self._written: dict[Mux, ForeignWrite] = {}
        self._pdos: dict[RoutingKey, tuple[Time, bytes]] = {}
        self._listeners: tuple[Callable[[Time], None], ...] = ()

    def listen(self, muxes: Collection[Mux], listener: Callable[[Time], None]) -> None:
        """Hear writes of these objects, too. listener: called at once, with its time, when a write or an RPDO was heard."""
        self._wanted.update(muxes)
        self._listeners = (*self._listeners, listener)
        self._reroute()

    def renew(self) -> None:
        """Hear the RPDOs that we send now."""
        if self._wanted:
            self._reroute()

    def forget(self, key: RoutingKey | None) -> None:
        """Forget the RPDO that was heard with a key: from now on it may have another meaning."""
        if key is not None:
            self._pdos.pop(key, None)

    def _ours(self) -> dict[RoutingKey | None, PdoMapping]:
        unread = self._unread
        return {each.key: each.mapping for number, each in self._rpdos.items() if (Direction.RPDO, number) not in unread}

    @property
    def unknown(self) -> set[RoutingKey]:
        """The keys of RPDOs that were heard, and that we do not send ourselves, or whose mapping is not known."""
        return self._pdos.keys() - self._ours().keys()

    def last(self, wanted: Mux, others: Mapping[RoutingKey, PdoMapping] = _NONE) -> ForeignWrite | None:
        """Return the last write of an object; None if there was none. wanted: its mux.

        others: the mappings of RPDOs that we do not send. An RPDO of unknown mapping is left out: any device may send PDOs to it.
        """
        found = self._written.get(wanted)
        ours = self._ours()
        for key, (time, data) in self._pdos.items():
            mapping = ours.get(key) or others.get(key)
            position = None if mapping is None else mapping.position_of(wanted)
            if mapping is None or position is None or (found is not None and found.time > time):
                continue
            try:
                found = ForeignWrite(time, key, mapping.unpack(data)[position])
            except ValueRangeError:
                found = ForeignWrite(time, key, None)
        return found

    def can_ids(self) -> Iterable[RoutingKey]:
        if not self._wanted:
            return ()
        ours = [producer.key for producer in self._rpdos.values() if producer.key is not None]
        return (self._sdo_key, *(RoutingKey(base + self._node_id) for base in (RPDO1, RPDO2, RPDO3, RPDO4)), *ours)

    def receive(self, frame: Frame, now: Time) -> None:
        """Keep a command. Frames of other kinds change nothing."""
        data = frame.data
        if frame.key != self._sdo_key:
            self._pdos[frame.key] = now, data
        elif len(data) == 8 and REQUESTS[data[0]] is SdoFrame.DOWNLOAD and (which := mux_in(data)) in self._wanted:
            self._written[which] = ForeignWrite(now, frame.key, self._value(which, data))
        else:
            return
        for listener in self._listeners:
            listener(now)

    def _value(self, which: Mux, request: bytes) -> Value | None:
        variable, data = self._dictionary.get(*split_mux(which)), expedited_data(request)
        if variable is None or data is None:
            return None
        if not request[0] & SIZE_BIT:
            data = data[: (variable.bit_length or 32) // 8]
        try:
            return variable.decode(data)
        except ValueRangeError:
            return None
