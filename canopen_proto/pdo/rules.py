"""The rules for writes to the PDO parameters of a device (CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.40).

`PdoWriteRules.check_write` is called before a value is stored. It changes nothing, and returns None or the abort code with which
the device refuses. Type and limits of the value have been checked before.

    COB-ID               while the PDO is valid, its CAN-ID may not change: 0x08000022. A restricted CAN-ID, or more than 11 bits
                         without the frame bit: 0x06090030. An invalid mapping: 0x06040043
    transmission type    241..251: 0x06090030; for RPDOs, which cannot be requested, also 252 and 253. One that is not
                         event-driven for an MPDO in source address mode: 0x06040043
    inhibit time         while the PDO is valid: 0x08000022
    SYNC start value     the same; over 240: 0x06090030 (in an RPDO the object has no effect)
    number of objects    while the PDO is valid: 0x08000022. More than 64 bits together, or more entries than there are:
                         0x06040042. An entry that would be refused by itself (below): its code. 0xFE and 0xFF make an MPDO.
                         Source address mode needs its list (else 0x06040042), and is for one event-driven TPDO (else 0x06040043)
    mapping entry        while the mapping is enabled (sub 0 is not 0): 0x06010000. While the PDO is valid: 0x08000022. No such
                         object: 0x06020000. Not mappable, not in this direction, not in this width: 0x06040041. Too wide for any
                         PDO: 0x06040042. Dummy entries are for RPDOs only
    scanner list         no such object: 0x06020000. One that no MPDO can send: 0x06040041. No block size: 0x06090030
    dispatching list     the same for our own object; an invalid node-ID of the producer: 0x06090030
    window (0x1007)      nothing is refused

A write that changes nothing is allowed, except to an entry of an enabled mapping: a master that forgot to write 0 to sub 0 learns
of it at the first entry, as CiA's conformance test (case 3.23) demands. Destroying a PDO by bit 31 is allowed whatever the other
bits are: many masters write a bare 0x80000000. An entry may be cleared with 0, but a cleared entry cannot be counted.
"""

from __future__ import annotations

from collections.abc import Container
from typing import Final

from canopen_proto.abort import AbortCode
from canopen_proto.cob_id import check_cob_id
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Direction, Values
from canopen_proto.frame import COB_ID_INVALID, MAX_NODE_ID
from canopen_proto.multiplexer import mapped, mux
from canopen_proto.pdo.consumer import LAST_SYNCHRONOUS
from canopen_proto.pdo.mapping import DUMMY_TYPES, LAST_DUMMY_INDEX, MAX_BITS, MAX_ENTRIES, may_have_width, number_at
from canopen_proto.pdo.multiplexed import (
    DISPATCHER_LISTS,
    MAPPABLE,
    SCANNER_LISTS,
    DispatcherEntry,
    MpdoMode,
    ScannerEntry,
    suits_mpdo,
)
from canopen_proto.pdo.producer import FIRST_EVENT_DRIVEN, SYNCHRONOUS_ON_REQUEST
from canopen_proto.pdo.settings import (
    COB_ID,
    INHIBIT_TIME,
    MAX_PDOS,
    SYNC_START,
    TRANSMISSION_TYPE,
    PdoPlace,
    communication_index,
    mapping_index,
    place_of,
)

_LISTS: Final = {Direction.RPDO: DISPATCHER_LISTS, Direction.TPDO: SCANNER_LISTS}


class PdoWriteRules:
    """The rules of one device. faults: the indices of its invalid mappings."""

    def __init__(self, values: Values, faults: Container[int]) -> None:
        self._values = values
        self._faults = faults

    def check_write(self, index: int, subindex: int, value: Value) -> AbortCode | None:
        """Return the abort code that refuses a write, or None if it is allowed or to no PDO parameter."""
        place = place_of(index)
        if place is not None and place.is_mapping and subindex and self._count(place):
            return AbortCode.UNSUPPORTED_ACCESS
        if not isinstance(value, int) or value == self._values.store.get(mux(index, subindex)):
            return None
        if place is None:
            return self._check_listed(index, value) if subindex and value else None
        if place.is_mapping:
            return self._check_entry(place, value) if subindex else self._check_count(place, value)
        match subindex:
            case _ if subindex == COB_ID:
                return self._check_cob_id(place, value)
            case _ if subindex == TRANSMISSION_TYPE:
                return self._check_transmission_type(place, value)
            case _ if subindex == SYNC_START and value > LAST_SYNCHRONOUS:
                return AbortCode.INVALID_VALUE
            case _ if subindex in (INHIBIT_TIME, SYNC_START) and self._is_valid(place):
                return AbortCode.DEVICE_STATE
        return None

    def _at(self, place: PdoPlace, subindex: int, default: int = 0) -> int:
        """Return a field of the communication parameter."""
        return number_at(self._values.store, mux(communication_index(place.direction, place.number), subindex), default)

    def _count(self, place: PdoPlace) -> int:
        """Return sub 0 of the mapping parameter."""
        return number_at(self._values.store, mux(mapping_index(place.direction, place.number)))

    def _is_valid(self, place: PdoPlace) -> bool:
        return not self._at(place, COB_ID, COB_ID_INVALID) & COB_ID_INVALID

    def _check_cob_id(self, place: PdoPlace, cob_id: int) -> AbortCode | None:
        if cob_id & COB_ID_INVALID:
            return None
        present = self._at(place, COB_ID, COB_ID_INVALID)
        refusal = check_cob_id(cob_id, present, in_use=not present & COB_ID_INVALID)
        if refusal is not None:
            return refusal
        if mapping_index(place.direction, place.number) in self._faults:
            return AbortCode.PARAMETER_INCOMPATIBLE
        return None

    def _check_transmission_type(self, place: PdoPlace, value: int) -> AbortCode | None:
        first = FIRST_EVENT_DRIVEN if place.direction == Direction.RPDO else SYNCHRONOUS_ON_REQUEST
        if LAST_SYNCHRONOUS < value < first:
            return AbortCode.INVALID_VALUE
        is_source = place.direction == Direction.TPDO and self._count(place) == MpdoMode.SOURCE
        return AbortCode.PARAMETER_INCOMPATIBLE if is_source and value < FIRST_EVENT_DRIVEN else None

    def _check_count(self, place: PdoPlace, count: int) -> AbortCode | None:
        if self._is_valid(place):
            return AbortCode.DEVICE_STATE
        if count in (MpdoMode.SOURCE, MpdoMode.DESTINATION):
            return self._check_mode(place) if count == MpdoMode.SOURCE else None
        index = mapping_index(place.direction, place.number)
        dictionary, store = self._values.dictionary, self._values.store
        if count > MAX_ENTRIES or any(dictionary.get(index, subindex) is None for subindex in range(1, count + 1)):
            return AbortCode.PDO_LENGTH_EXCEEDED
        entries = [number_at(store, mux(index, subindex)) for subindex in range(1, count + 1)]
        for entry in entries:
            refusal = self._check_mapped(place.direction, entry)
            if refusal is not None:
                return refusal
        return AbortCode.PDO_LENGTH_EXCEEDED if sum(bits for _, _, bits in map(mapped, entries)) > MAX_BITS else None

    def _check_mode(self, place: PdoPlace) -> AbortCode | None:
        """Check whether a PDO may be an MPDO in source address mode. CiA 301 v4.2.0, 7.2.3.2.2"""
        if not any(index in self._values.dictionary.objects for index in _LISTS[place.direction]):
            return AbortCode.PDO_LENGTH_EXCEEDED
        if place.direction == Direction.RPDO:
            return None
        if self._at(place, TRANSMISSION_TYPE, FIRST_EVENT_DRIVEN) < FIRST_EVENT_DRIVEN:
            return AbortCode.PARAMETER_INCOMPATIBLE
        others = (PdoPlace(Direction.TPDO, number, True) for number in range(1, MAX_PDOS + 1))
        has_one = any(self._count(other) == MpdoMode.SOURCE for other in others)
        return AbortCode.PARAMETER_INCOMPATIBLE if has_one else None

    def _check_entry(self, place: PdoPlace, entry: int) -> AbortCode | None:
        if self._is_valid(place):
            return AbortCode.DEVICE_STATE
        return self._check_mapped(place.direction, entry) if entry else None

    def _check_mapped(self, direction: Direction, entry: int) -> AbortCode | None:
        """Check whether a PDO of this direction may have an entry."""
        index, subindex, bit_length = mapped(entry)
        if 0 < index <= LAST_DUMMY_INDEX:
            dummy = DUMMY_TYPES.get(index)
            if direction != Direction.RPDO or subindex or dummy is None or not may_have_width(dummy, bit_length):
                return AbortCode.CANNOT_BE_MAPPED
            return None
        variable = self._values.dictionary.get(index, subindex)
        if variable is None:
            return AbortCode.NO_SUCH_OBJECT
        if not variable.pdo_mappable or variable.access not in MAPPABLE[direction] or variable.data_type == DataType.DOMAIN:
            return AbortCode.CANNOT_BE_MAPPED
        if bit_length > MAX_BITS:
            return AbortCode.PDO_LENGTH_EXCEEDED
        return None if may_have_width(variable.data_type, bit_length) else AbortCode.CANNOT_BE_MAPPED

    def _check_listed(self, index: int, number: int) -> AbortCode | None:
        """Check an entry of a scanner or dispatching list. None for other objects."""
        if index in SCANNER_LISTS:
            return self._check_objects(Direction.TPDO, ScannerEntry.of(number))
        if index in DISPATCHER_LISTS:
            entry = DispatcherEntry.of(number)
            if not 1 <= entry.producer <= MAX_NODE_ID:
                return AbortCode.INVALID_VALUE
            return self._check_objects(Direction.RPDO, entry.local)
        return None

    def _check_objects(self, direction: Direction, listed: ScannerEntry) -> AbortCode | None:
        """Check whether MPDOs can carry these objects of ours."""
        if listed.block == 0:
            return AbortCode.INVALID_VALUE
        for subindex in range(listed.first, listed.first + listed.block):
            variable = self._values.dictionary.get(listed.at, subindex) if subindex <= 0xFF else None
            if variable is None:
                return AbortCode.NO_SUCH_OBJECT
            if not suits_mpdo(variable, direction):
                return AbortCode.CANNOT_BE_MAPPED
        return None
