"""The PDOs of a device: made of its dictionary, and kept in step with what is written there.

Theory of operation
-------------------
A device says which PDOs it has by the records that stand at 0x1400..0x15FF (RPDOs) and 0x1800..0x19FF (TPDOs); a mapping stands
0x200 above each. `DevicePdos` makes a consumer or a producer for each record, once; after that a write changes the machine and
does not replace it, so the owner attaches `machines` and need not care again.

A write passes two doors. `check_write` comes before the value is stored and is a pure question: None, or the abort code with
which the device refuses. `apply` comes after. What is refused is the table below (CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38):

    COB-ID               while the PDO is valid, its CAN-ID may not change: 0x08000022. A restricted CAN-ID, or more than 11 bits
                         without the frame bit: 0x06090030. A mapping that makes no sense: 0x06040043
    transmission type    241..253: 0x06090030 (252 and 253 ask for remote requests, which are not supported)
    inhibit time         while the PDO is valid: 0x08000022
    SYNC start value     the same; beyond 240: 0x06090030 (an RPDO has none; such an object has no effect)
    number of objects    while the PDO is valid: 0x08000022. Together more than 64 bits, more entries than there are, MPDO:
                         0x06040042. An entry that is refused by itself (below): its code
    mapping entry        while the PDO is valid or the mapping enabled (sub 0 is not 0): 0x08000022. No such object: 0x06020000.
                         Not mappable, not in this direction, not in this width: 0x06040041. Too wide for any PDO: 0x06040042.
                         Dummy entries are for RPDOs only

A write that changes nothing is always allowed. So is destroying a PDO by bit 31, whatever the other bits are: many masters
write a bare 0x80000000, and nothing is lost by it. An entry may be cleared with 0, but not counted then.

A default mapping that makes no sense (devices' EDS files have such) disables its PDO and stands in `faults`: it is no reason for
the whole device not to start.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Access, Direction, Values
from canopen_proto.frame import COB_ID_EXTENDED, COB_ID_INVALID, key_of_cob_id
from canopen_proto.machine import MICROSECOND, MILLISECOND, Outbox, Time
from canopen_proto.pdo.consumer import EVENT_DRIVEN, LAST_SYNCHRONOUS, PdoConsumer
from canopen_proto.pdo.mapping import (
    DUMMY_TYPES,
    LAST_DUMMY_INDEX,
    MAX_BITS,
    MAX_ENTRIES,
    Mapping,
    MappingError,
    may_have_width,
    number_at,
)
from canopen_proto.pdo.producer import FIRST_EVENT_DRIVEN, PdoProducer
from canopen_proto.pdo.settings import (
    COB_ID,
    EVENT_TIMER,
    INHIBIT_TIME,
    SYNC_START,
    TRANSMISSION_TYPE,
    PdoPlace,
    communication_index,
    mapping_index,
    place_of,
)
from canopen_proto.sdo.abort import AbortCode

INHIBIT_UNIT: Final = 100 * MICROSECOND

RESTRICTED_CAN_IDS: Final = (
    range(0x080),  # NMT; reserved
    range(0x101, 0x181),  # reserved
    range(0x581, 0x600),  # default SDO, server to client
    range(0x601, 0x680),  # default SDO, client to server
    range(0x6E0, 0x700),  # reserved
    range(0x701, 0x780),  # NMT error control
    range(0x780, 0x800),  # reserved
)
"""CAN-IDs that no configurable communication object may take (CiA 301 v4.2.0, 7.3.5, table 40)."""

_CAN_ID_AND_FRAME: Final = 0x3FFF_FFFF  # bits 0..29, which may change only while the PDO is not valid
_MAPPABLE: Final = {
    Direction.RPDO: (Access.RW, Access.RWW, Access.WO),
    Direction.TPDO: (Access.RW, Access.RWR, Access.RO, Access.CONST),
}
_NOTHING: Final = Mapping()


class DevicePdos:
    """All PDOs of one device; see this module's text.

    values: the device's memory; the PDOs read and write it. consumers, producers: by PDO number, 1..512; they are this outbox's
    machines, and none is added or taken away later. faults: what is wrong with a standing mapping, by the mapping's index.
    """

    __slots__ = ("_triggers", "_values", "consumers", "faults", "producers")

    def __init__(self, out: Outbox, node_id: int, values: Values) -> None:
        self._values = values
        self.consumers: dict[int, PdoConsumer] = {}
        self.producers: dict[int, PdoProducer] = {}
        self.faults: dict[int, str] = {}
        self._triggers: dict[int, list[PdoProducer]] = {}  # by the mux of what they carry
        for index in values.dictionary.objects:
            place = place_of(index)
            if place is None or place.is_mapping or values.dictionary.get(index, COB_ID) is None:
                continue
            if place.direction == Direction.RPDO:
                self.consumers[place.number] = PdoConsumer(out, node_id, place.number, None, _NOTHING, values.store)
            else:
                self.producers[place.number] = PdoProducer(out, node_id, place.number, None, _NOTHING, values.store)
        self.reload(0)

    @property
    def machines(self) -> Iterator[PdoConsumer | PdoProducer]:
        """All of them, to be attached once."""
        yield from self.consumers.values()
        yield from self.producers.values()

    def set_enabled(self, enabled: bool, now: Time) -> None:
        """Whether the device is in NMT state Operational, in which alone PDOs live. Starts the event timers; sends nothing."""
        for machine in self.machines:
            machine.set_enabled(enabled, now)

    def on_sync(self, counter: int | None, now: Time) -> None:
        """A SYNC came: TPDOs are sampled and sent, then the RPDOs held for it take effect.

        In this order, so that what a TPDO reports is the state at the SYNC and not yet what the SYNC sets off.
        """
        for producer in self.producers.values():
            producer.on_sync(counter, now)
        for consumer in self.consumers.values():
            consumer.on_sync(counter, now)

    def trigger(self, mux: int, now: Time) -> None:
        """The value at a mux changed: the TPDOs that carry it are triggered."""
        for producer in self._triggers.get(mux, ()):
            producer.trigger(now)

    def reload(self, now: Time) -> None:
        """Take up all parameters anew: at the start, and when a reset has put the defaults back."""
        for number in self.consumers:
            self._configure(Direction.RPDO, number, now)
        for number in self.producers:
            self._configure(Direction.TPDO, number, now)

    # ---- the two doors of a write ----

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        """What forbids writing this value there, or None. value: right in type and limits already. Changes nothing.

        None for everything that is not a PDO parameter. Source: CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38.
        """
        place = place_of(index)
        if place is None or not isinstance(value, int) or value == self._values.store.get(index << 8 | subindex):
            return None
        if place.is_mapping:
            return self._check_entry(place, value) if subindex else self._check_count(place, value)
        if subindex == COB_ID:
            return self._check_cob_id(place, value)
        if subindex == TRANSMISSION_TYPE:
            return AbortCode.INVALID_VALUE if LAST_SYNCHRONOUS < value < FIRST_EVENT_DRIVEN else None
        if subindex == SYNC_START and value > LAST_SYNCHRONOUS:
            return AbortCode.INVALID_VALUE
        if subindex in (INHIBIT_TIME, SYNC_START) and self._is_valid(place):
            return AbortCode.DEVICE_STATE
        return None

    def apply(self, index: int, subindex: int, now: Time) -> None:
        """A value was stored there: the PDO goes by it from now on. A changed CAN-ID is announced by the machine itself."""
        place = place_of(index)
        if place is not None and place.number in (self.consumers if place.direction == Direction.RPDO else self.producers):
            self._configure(place.direction, place.number, now)

    # ---- rules ----

    def _cob_id(self, place: PdoPlace) -> int:
        mux = communication_index(place.direction, place.number) << 8 | COB_ID
        return number_at(self._values.store, mux, COB_ID_INVALID)

    def _is_valid(self, place: PdoPlace) -> bool:
        return not self._cob_id(place) & COB_ID_INVALID

    def _check_cob_id(self, place: PdoPlace, cob_id: int) -> AbortCode | None:
        if cob_id & COB_ID_INVALID:
            return None
        if not cob_id & COB_ID_EXTENDED:
            can_id = cob_id & 0x1FFF_FFFF
            if can_id > 0x7FF or any(can_id in each for each in RESTRICTED_CAN_IDS):
                return AbortCode.INVALID_VALUE
        standing = self._cob_id(place)
        if not standing & COB_ID_INVALID and (standing ^ cob_id) & _CAN_ID_AND_FRAME:
            return AbortCode.DEVICE_STATE
        if mapping_index(place.direction, place.number) in self.faults:
            return AbortCode.PARAMETER_INCOMPATIBLE
        return None

    def _check_count(self, place: PdoPlace, count: int) -> AbortCode | None:
        if self._is_valid(place):
            return AbortCode.DEVICE_STATE
        index = mapping_index(place.direction, place.number)
        dictionary, store = self._values.dictionary, self._values.store
        if count > MAX_ENTRIES or any(dictionary.get(index, subindex) is None for subindex in range(1, count + 1)):
            return AbortCode.PDO_LENGTH_EXCEEDED
        entries = [number_at(store, index << 8 | subindex) for subindex in range(1, count + 1)]
        for entry in entries:
            refusal = self._check_mapped(place.direction, entry)
            if refusal is not None:
                return refusal
        return AbortCode.PDO_LENGTH_EXCEEDED if sum(entry & 0xFF for entry in entries) > MAX_BITS else None

    def _check_entry(self, place: PdoPlace, entry: int) -> AbortCode | None:
        enabled = number_at(self._values.store, mapping_index(place.direction, place.number) << 8)
        if enabled or self._is_valid(place):
            return AbortCode.DEVICE_STATE
        return self._check_mapped(place.direction, entry) if entry else None

    def _check_mapped(self, direction: Direction, entry: int) -> AbortCode | None:
        """Whether an entry can be part of a PDO of that direction."""
        index, subindex, bit_length = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        if 0 < index <= LAST_DUMMY_INDEX:
            dummy = DUMMY_TYPES.get(index)
            if direction != Direction.RPDO or subindex or dummy is None or not may_have_width(dummy, bit_length):
                return AbortCode.CANNOT_BE_MAPPED
            return None
        variable = self._values.dictionary.get(index, subindex)
        if variable is None:
            return AbortCode.NO_SUCH_OBJECT
        if not variable.pdo_mappable or variable.access not in _MAPPABLE[direction] or variable.data_type == DataType.DOMAIN:
            return AbortCode.CANNOT_BE_MAPPED
        if bit_length > MAX_BITS:
            return AbortCode.PDO_LENGTH_EXCEEDED
        return None if may_have_width(variable.data_type, bit_length) else AbortCode.CANNOT_BE_MAPPED

    # ---- effects ----

    def _configure(self, direction: Direction, number: int, now: Time) -> None:
        """Bring one machine into step with the dictionary."""
        mapping = self._standing_mapping(direction, number)
        store = self._values.store
        base = communication_index(direction, number) << 8
        cob_id = number_at(store, base | COB_ID, COB_ID_INVALID)
        key = None if cob_id & COB_ID_INVALID else key_of_cob_id(cob_id)
        transmission_type = number_at(store, base | TRANSMISSION_TYPE, EVENT_DRIVEN)
        event_time = number_at(store, base | EVENT_TIMER) * MILLISECOND
        if direction == Direction.RPDO:
            self.consumers[number].configure(key, mapping, transmission_type, event_time)
            return
        inhibit_time = number_at(store, base | INHIBIT_TIME) * INHIBIT_UNIT
        sync_start = number_at(store, base | SYNC_START)
        self.producers[number].configure(key, mapping, now, transmission_type, inhibit_time, event_time, sync_start)
        self._triggers.clear()
        for producer in self.producers.values():
            for mux in {entry.mux for entry in producer.mapping.components}:
                self._triggers.setdefault(mux, []).append(producer)

    def _standing_mapping(self, direction: Direction, number: int) -> Mapping:
        """What stands in the dictionary; an empty mapping, and an entry in `faults`, where that makes no sense."""
        index = mapping_index(direction, number)
        self.faults.pop(index, None)
        try:
            return Mapping.from_values(self._values, index)
        except MappingError as error:
            self.faults[index] = str(error)
            return _NOTHING
