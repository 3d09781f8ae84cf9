"""Multiplexed PDOs: one CAN-ID carries many objects, and each frame names its object (CiA 301 v4.2.0, 7.2.3).

An MPDO always has eight bytes: a node-ID with the address mode in bit 7, an object's index and subindex, and up to four bytes of
its value. Sub 0 of the mapping parameter of an MPDO is not a number of entries, but one of two modes:

    0xFE   source address mode (bit 7 is 0): node-ID and object are the producer's. The producer sends an object of its object
           scanner list (0x1FA0 to 0x1FCF) when it changes. A consumer finds in its object dispatching list (0x1FD0 to 0x1FFF)
           which of its own objects takes the value, and ignores objects that are not listed. A device has at most one such TPDO,
           and it is event-driven
    0xFF   destination address mode (bit 7 is 1): node-ID (0 = all) and object are the consumer's, like an SDO without
           confirmation. The application sends it (`send_to`). A consumer that lacks the object sends EMCY 0x8230

    0x1FA0 and on, UNSIGNED32     block size << 24 | index << 8 | subindex: so many subindices from this one on
    0x1FD0 and on, UNSIGNED64     block size << 56 | local index << 40 | local subindex << 32
                                  | producer's index << 16 | producer's subindex << 8 | producer's node-ID

`MpdoConsumer` serves all RPDOs of a device that are MPDOs, `MpdoProducer` all such TPDOs. Both use the device's `Values`, without
checking limits, because a PDO has no way to refuse a value. An MPDO carries only objects of up to four bytes that may be mapped
to a PDO of its direction.

The inhibit time of a producer in source address mode is the least time between any two of its frames. Objects that change
meanwhile wait, each once, and are sent with the values of that moment. With an event time, the producer also sends the next
object of its list if it sent nothing for that long. Frames in destination address mode are sent at once.

`MpdoListener` receives the MPDOs of another node in source address mode, as a master, a service tool or a bus monitor does. It
needs no dispatching list: the frame names the producer's object, and the listener updates its image of that object. It ignores
frames in destination address mode, which are for their consumer; `destination_frame` makes such frames.

MPDOs exist in NMT state Operational only, like all PDOs.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from enum import IntEnum
from typing import Final, NamedTuple

from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary import Access, Direction, ObjectDictionary, Values, Variable
from canopen_proto.frame import MAX_NODE_ID, Frame, RoutingKey, frame_for_key
from canopen_proto.machine import NEVER, Event, FrameIgnored, LocalProtocolError, Machine, Outbox, Time, check_node_id
from canopen_proto.multiplexer import Mux, index_of, mux, subindex_of
from canopen_proto.pdo.consumer import EMCY_PDO_NOT_PROCESSED, PdoLengthUnexpected
from canopen_proto.pdo.mapping import number_at
from canopen_proto.pdo.producer import PdoNotSent

SCANNER_LISTS: Final = range(0x1FA0, 0x1FD0)
DISPATCHER_LISTS: Final = range(0x1FD0, 0x2000)

ALL_NODES: Final = 0
MAX_VALUE_BYTES: Final = 4
EMCY_DESTINATION_NOT_AVAILABLE: Final = 0x8230

MAPPABLE: Final = {
    Direction.RPDO: (Access.RW, Access.RWW, Access.WO),
    Direction.TPDO: (Access.RW, Access.RWR, Access.RO, Access.CONST),
}
"""The access rights with which a PDO of a direction may carry an object. CiA 301 v4.2.0, 7.4.8.3 and CiA 306."""

MPDO: Final = struct.Struct("<BHB4s")
DESTINATION_MODE: Final = 0x80


class MpdoMode(IntEnum):
    """Sub 0 of the mapping parameter of an MPDO. CiA 301 v4.2.0, 7.5.2.36 and 7.5.2.38."""

    SOURCE = 0xFE
    DESTINATION = 0xFF


class MpdoReceived(Event):
    """The value of an MPDO is in the dictionary.

    number, key: of the RPDO. producer: the sending node in source address mode, else 0. index, subindex: of our object that took
    the value. An MpdoListener reports the producer's TPDO and object instead. timestamp: of the frame, from the transport.
    """

    __match_args__ = ("node_id", "number", "key", "producer", "index", "subindex", "value", "timestamp")

    def __init__(
        self,
        node_id: int,
        number: int,
        key: RoutingKey,
        producer: int,
        index: int,
        subindex: int,
        value: Value,
        timestamp: int | None,
    ) -> None:
        self.node_id = node_id
        self.number = number
        self.key = key
        self.producer = producer
        self.index = index
        self.subindex = subindex
        self.value = value
        self.timestamp = timestamp


class MpdoNotProcessed(Event):
    """An MPDO in destination address mode names an object that we lack, or that no MPDO can write. emcy_code: 0x8230. number: of
    the PDO, 1..512. key: the routing key of its frames. index, subindex: as the frame has them."""

    __match_args__ = ("node_id", "number", "key", "index", "subindex", "emcy_code")

    def __init__(self, node_id: int, number: int, key: RoutingKey, index: int, subindex: int, emcy_code: int) -> None:
        self.node_id = node_id
        self.number = number
        self.key = key
        self.index = index
        self.subindex = subindex
        self.emcy_code = emcy_code


class ScannerEntry(NamedTuple):
    """One entry of an object scanner list: `block` subindices of an object, from `first` on."""

    block: int
    at: int
    first: int

    @classmethod
    def of(cls, number: int) -> ScannerEntry:
        """Return the entry for a value of 0x1FA0:01 and the like."""
        return cls(number >> 24 & 0xFF, number >> 8 & 0xFFFF, number & 0xFF)


class DispatcherEntry(NamedTuple):
    """One entry of an object dispatching list: subindices of a producer's object, and the subindices of ours that take them."""

    local: ScannerEntry
    at: int
    first: int
    producer: int

    @classmethod
    def of(cls, number: int) -> DispatcherEntry:
        """Return the entry for a value of 0x1FD0:01 and the like."""
        return cls(ScannerEntry.of(number >> 32), number >> 16 & 0xFFFF, number >> 8 & 0xFF, number & 0xFF)


def destination_frame(key: RoutingKey, node_id: int, index: int, subindex: int, data: bytes) -> Frame:
    """Return an MPDO in destination address mode, which writes an object of one node, or of all (node_id 0). key: the MPDO's
    routing key. index, subindex: of the consumer's object.

    data: 1 to 4 bytes. Raises LocalProtocolError for a value out of range.
    """
    if not ALL_NODES <= node_id <= MAX_NODE_ID:
        raise LocalProtocolError(f"MPDO to node-ID {node_id}: outside 0 (all) to {MAX_NODE_ID}")
    if not 0 <= index <= 0xFFFF or not 0 <= subindex <= 0xFF:
        raise LocalProtocolError(f"MPDO to object 0x{index:04X}:{subindex:02X}: index or subindex out of range")
    if not 1 <= len(data) <= MAX_VALUE_BYTES:
        raise LocalProtocolError(f"an MPDO carries 1 to {MAX_VALUE_BYTES} bytes, not {len(data)}")
    return frame_for_key(key, MPDO.pack(node_id | DESTINATION_MODE, index, subindex, data))


def suits_mpdo(variable: Variable, direction: Direction) -> bool:
    """Return whether an MPDO of this direction can carry an object: mappable, and at most four bytes long."""
    fits = variable.size is not None and variable.size <= MAX_VALUE_BYTES
    return fits and variable.pdo_mappable and variable.access in MAPPABLE[direction]


def listed(values: Values, lists: range) -> Iterator[int]:
    """Return the entries in use of a device's scanner or dispatching lists, in order."""
    for index in lists:
        described = values.dictionary.objects.get(index)
        for subindex in sorted(described.variables) if described is not None else ():
            number = number_at(values.store, mux(index, subindex)) if subindex else 0
            if number:
                yield number


class MpdoConsumer(Machine):
    """Receives a device's RPDOs that are MPDOs; see this module's text. enabled: the node is Operational (read-only)."""

    def __init__(self, out: Outbox, node_id: int, values: Values) -> None:
        """node_id: our own, 1..127. values: the memory to write to."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.enabled = False
        self._values = values
        self._pdos: dict[int, tuple[RoutingKey, MpdoMode]] = {}  # RPDO number -> key and mode
        self._routes: dict[RoutingKey, list[tuple[int, MpdoMode]]] = {}  # key -> numbers and modes
        self._dispatch: dict[tuple[int, int], list[DispatcherEntry]] = {}  # by producer and its index

    def can_ids(self) -> Iterable[RoutingKey]:
        return tuple(self._routes)

    def set_pdo(self, number: int, key: RoutingKey | None, mode: MpdoMode | None) -> None:
        """Set RPDO `number`: an MPDO with this key and mode, or no MPDO (key or mode is None)."""
        wanted = None if key is None or mode is None else (key, mode)
        if wanted == self._pdos.get(number):
            return
        self._pdos.pop(number, None)
        if wanted is not None:
            self._pdos[number] = wanted
        self._routes = {}
        for each, (its_key, its_mode) in self._pdos.items():
            self._routes.setdefault(its_key, []).append((each, its_mode))
        self._reroute()

    def reload_lists(self) -> None:
        """Read the dispatching lists again from the values."""
        self._dispatch = {}
        for number in listed(self._values, DISPATCHER_LISTS):
            entry = DispatcherEntry.of(number)
            self._dispatch.setdefault((entry.producer, entry.at), []).append(entry)

    def set_enabled(self, enabled: bool) -> None:
        """Set whether the node is in NMT state Operational."""
        self.enabled = enabled

    def receive(self, frame: Frame, now: Time) -> None:
        """Write the value of an MPDO to its object.

        Events: MpdoReceived; MpdoNotProcessed; PdoLengthUnexpected for less than eight bytes; FrameIgnored for the wrong mode.
        CiA 301 v4.2.0, 7.2.3
        """
        if not self.enabled:
            return
        key, data = frame.key, frame.data
        for number, mode in self._routes.get(key, ()):
            if not _is_whole(self, number, key, data):
                continue
            address, index, subindex, content = MPDO.unpack(data)
            node_id = address & ~DESTINATION_MODE
            if (mode is MpdoMode.DESTINATION) != bool(address & DESTINATION_MODE):
                self.out.events.append(FrameIgnored(self.node_id, frame, f"not the address mode of RPDO {number}, {mode.name}"))
            elif mode is MpdoMode.SOURCE:
                self._dispatch_to(number, key, node_id, index, subindex, content)
            elif node_id in (ALL_NODES, self.node_id) and not self._write(number, key, 0, index, subindex, content):
                code = EMCY_DESTINATION_NOT_AVAILABLE
                self.out.events.append(MpdoNotProcessed(self.node_id, number, key, index, subindex, code))

    def _dispatch_to(self, number: int, key: RoutingKey, producer: int, index: int, subindex: int, content: bytes) -> None:
        for entry in self._dispatch.get((producer, index), ()):
            offset = subindex - entry.first
            if 0 <= offset < entry.local.block:
                self._write(number, key, producer, entry.local.at, entry.local.first + offset, content)

    def _write(self, number: int, key: RoutingKey, producer: int, index: int, subindex: int, content: bytes) -> bool:
        """Write the value. Return False if no object can take it."""
        variable = self._values.dictionary.get(index, subindex)
        if variable is None or not suits_mpdo(variable, Direction.RPDO):
            return False
        value = variable.decode(content[: variable.size])
        self._values.store[variable.mux] = value
        stamp = self.out.timestamp
        self.out.events.append(MpdoReceived(self.node_id, number, key, producer, index, subindex, value, stamp))
        return True


class MpdoListener(Machine):
    """Receives the TPDOs of one node that are MPDOs in source address mode; see this module's text."""

    def __init__(self, out: Outbox, node_id: int, values: Values) -> None:
        """node_id: of the producer, 1..127. values: our image of its objects, which received values update."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self._values = values
        self._keys: dict[int, RoutingKey] = {}  # TPDO number -> key

    def can_ids(self) -> Iterable[RoutingKey]:
        return tuple(self._keys.values())

    def set_pdo(self, number: int, key: RoutingKey | None) -> None:
        """Receive the node's TPDO `number` by this key; None = stop."""
        self._keys.pop(number, None)
        if key is not None:
            self._keys[number] = key
        self._reroute()

    def receive(self, frame: Frame, now: Time) -> None:
        """Take the value of an MPDO of this node. An MPDO of another producer on the same CAN-ID is ignored.

        Events: MpdoReceived; PdoLengthUnexpected for less than eight bytes; FrameIgnored for the other address mode, and for an
        object that is not in the node's dictionary or that no TPDO can carry.
        """
        key, data = frame.key, frame.data
        number = next(each for each, its_key in self._keys.items() if its_key == key)
        if not _is_whole(self, number, key, data):
            return
        address, index, subindex, content = MPDO.unpack_from(data)
        if address & DESTINATION_MODE:
            self.out.events.append(FrameIgnored(self.node_id, frame, f"TPDO {number} is an MPDO in source address mode"))
            return
        if address != self.node_id:
            return
        variable = self._values.dictionary.get(index, subindex)
        if variable is None or not suits_mpdo(variable, Direction.TPDO):
            reason = f"an MPDO with object 0x{index:04X}:{subindex:02X}, which no TPDO can carry"
            self.out.events.append(FrameIgnored(self.node_id, frame, reason))
            return
        value = variable.decode(content[: variable.size])
        self._values.store[variable.mux] = value
        report = MpdoReceived(self.node_id, number, key, address, index, subindex, value, self.out.timestamp)
        self.out.events.append(report)


def _is_whole(receiver: MpdoConsumer | MpdoListener, number: int, key: RoutingKey, data: bytes) -> bool:
    """Return whether an MPDO has eight bytes at least; report PdoLengthUnexpected if not."""
    is_whole = len(data) >= MPDO.size
    if not is_whole:
        code, stamp = EMCY_PDO_NOT_PROCESSED, receiver.out.timestamp
        receiver.out.events.append(PdoLengthUnexpected(receiver.node_id, number, key, MPDO.size, len(data), code, stamp))
    return is_whole


class MpdoProducer(Machine):
    """Sends a device's TPDOs that are MPDOs; see this module's text.

    enabled: the node is Operational. has_source: changed objects are sent: there is a valid MPDO in source address mode, and the
    node is Operational. Both are read-only.
    """

    def __init__(self, out: Outbox, node_id: int, values: Values) -> None:
        """node_id: our own, 1..127. values: the memory to read from."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.enabled = False
        self.has_source = False
        self._values = values
        self._destinations: dict[int, RoutingKey] = {}  # TPDO number -> key, in destination address mode
        self._source: tuple[int, RoutingKey] | None = None  # TPDO number and key, in source address mode
        self._inhibit_time: Time = 0
        self._event_time: Time = 0
        self._inhibited_until: Time = -NEVER
        self._event_due: Time = NEVER
        self._scanned: dict[Mux, Variable] = {}  # by mux, in the order of the scanner lists
        self._pending: dict[Mux, None] = {}  # objects that wait for the end of the inhibit time, in order
        self._next = 0  # the scanned object that the event timer sends next

    def set_pdo(
        self, number: int, key: RoutingKey | None, mode: MpdoMode | None, now: Time, inhibit_time: Time = 0, event_time: Time = 0
    ) -> None:
        """Set TPDO `number` (1..512): an MPDO with this key and mode, or no MPDO (key or mode is None). inhibit_time, event_time:
        ns; 0 = none; only source address mode has them."""
        self._destinations.pop(number, None)
        was_source = self._source is not None and self._source[0] == number
        if key is not None and mode is MpdoMode.DESTINATION:
            self._destinations[number] = key
        if key is not None and mode is MpdoMode.SOURCE:
            before = (self._source, self._inhibit_time)
            is_other_timer = event_time != self._event_time
            self._source = (number, key)
            self._inhibit_time, self._event_time = inhibit_time, event_time
            if before != (self._source, inhibit_time):
                self._restart(now)
            elif is_other_timer:
                self._start_timer(now)  # what waits is sent: nothing else would tell of it
        elif was_source:
            self._source = None
            self._restart(now)

    def reload_lists(self) -> None:
        """Read the scanner lists again from the values."""
        dictionary = self._values.dictionary
        self._scanned = {variable.mux: variable for variable in scanned(dictionary, listed(self._values, SCANNER_LISTS))}
        self._pending = {mux: None for mux in self._pending if mux in self._scanned}
        self._next = 0

    def set_enabled(self, enabled: bool, now: Time) -> None:
        """Set whether the node is in NMT state Operational. Leaving it drops the objects that wait."""
        if enabled != self.enabled:
            self.enabled = enabled
            self._restart(now)

    def trigger(self, mux: Mux, now: Time) -> None:
        """Send the value at a mux, which has changed, if a scanner list has it: now, or when the inhibit time is over.

        Event: PdoNotSent if the object's type cannot hold the value.
        """
        if not self.has_source or mux not in self._scanned:
            return
        self._pending[mux] = None
        if now >= self._inhibited_until:
            self._send_next(now)
        self._rearm()

    def send_to(self, number: int, node_id: int, index: int, subindex: int, data: bytes, now: Time) -> bool:
        """Write an object of another node, or of all, by TPDO `number` in destination address mode. No consumer confirms it.

        node_id: 1..127, or 0 for all. index, subindex: of the consumer's object. data: 1 to 4 bytes, filled up with zeros. Sends
        nothing and returns False if the node is not Operational. Raises LocalProtocolError for a value out of range, and if this
        TPDO is no valid MPDO in this mode. CiA 301 v4.2.0, 7.2.3
        """
        key = self._destinations.get(number)
        if key is None:
            raise LocalProtocolError(f"TPDO {number} of node {self.node_id} is not a valid MPDO in destination address mode")
        frame = destination_frame(key, node_id, index, subindex, data)
        if self.enabled:
            self.out.frames.append(frame)
        return self.enabled

    def handle_timeout(self, now: Time) -> None:
        """Send one object at the end of the inhibit time if one waits, or when the event time has passed. Event: PdoNotSent."""
        if now < self.deadline:
            return
        if not self._pending and self._scanned and now >= self._event_due:
            muxes = tuple(self._scanned)
            self._pending[muxes[self._next % len(muxes)]] = None
            self._next = (self._next + 1) % len(muxes)
        if self._pending and now >= self._inhibited_until:
            self._send_next(now)
        elif now >= self._event_due:
            self._event_due = now + self._event_time  # nothing is scanned
        self._rearm()

    def _send_next(self, now: Time) -> None:
        assert self._source is not None
        number, key = self._source
        mux = next(iter(self._pending))
        del self._pending[mux]
        try:
            content = self._scanned[mux].encode(self._values.store[mux])
        except ValueRangeError as error:
            self.out.events.append(PdoNotSent(self.node_id, number, key, str(error)))
            content = b""
        if content:
            self.out.frames.append(frame_for_key(key, MPDO.pack(self.node_id, index_of(mux), subindex_of(mux), content)))
            self._inhibited_until = now + self._inhibit_time
        self._event_due = now + self._event_time if self._event_time else NEVER

    def _restart(self, now: Time) -> None:
        self.has_source = self.enabled and self._source is not None
        self._pending.clear()
        self._inhibited_until = now
        self._start_timer(now)

    def _start_timer(self, now: Time) -> None:
        self._event_due = now + self._event_time if self.has_source and self._event_time else NEVER
        self._rearm()

    def _rearm(self) -> None:
        self._arm(self._inhibited_until if self._pending else self._event_due)


def scanned(dictionary: ObjectDictionary, entries: Iterable[int]) -> Iterator[Variable]:
    """Return the objects in the entries of scanner lists that an MPDO can carry."""
    for number in entries:
        block, at, first = ScannerEntry.of(number)
        described = dictionary.objects.get(at)
        for subindex, variable in sorted(described.variables.items()) if described is not None else ():
            if first <= subindex < first + block and suits_mpdo(variable, Direction.TPDO):
                yield variable
