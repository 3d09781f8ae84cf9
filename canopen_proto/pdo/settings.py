"""What a PDO of a device carries and when it is sent (`PdoSettings`), where that stands in its dictionary, and the writes that
set it up. Whoever chooses PDOs for a node returns such settings, and configure.py brings the device to them.

PDO n (1..512) has two records, one for communication and one for mapping (CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38):

    RPDO   0x1400 + n - 1   0x1600 + n - 1
    TPDO   0x1800 + n - 1   0x1A00 + n - 1

A device takes a new mapping in one order only (7.5.2.36): destroy the PDO (bit 31 of its COB-ID), disable its mapping (sub 0 is
0), write the entries, enable the mapping (sub 0 is their number), create the PDO. Transmission type and times are written right
before the last step, because some of them may change only while the PDO does not exist.

`PdoSettings.steps` returns the writes in that order.

Source: CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from canopen_proto import indices
from canopen_proto.datatypes import DataType, encode
from canopen_proto.dictionary import Direction, PdoDescription
from canopen_proto.dictionary.download_order import Write
from canopen_proto.frame import COB_ID_INVALID, COB_ID_NO_RTR, RPDO1, TPDO1, RoutingKey, can_id_of, key_of_cob_id
from canopen_proto.machine import MICROSECOND, MILLISECOND, LocalProtocolError, Time
from canopen_proto.multiplexer import Mux, mapped, mux
from canopen_proto.pdo.mapping import MAX_ENTRIES, MappedEntry, MappingError

MAX_PDOS: Final = 512

# subindices of the communication parameter
COB_ID: Final = 1
TRANSMISSION_TYPE: Final = 2
INHIBIT_TIME: Final = 3
"""UNSIGNED16, multiples of 100 us."""
EVENT_TIMER: Final = 5
"""UNSIGNED16, ms."""
SYNC_START: Final = 6
"""TPDOs only."""

INHIBIT_UNIT: Final = 100 * MICROSECOND

PREDEFINED: Final = {
    Direction.RPDO: tuple(range(RPDO1, RPDO1 + 0x400, 0x100)),
    Direction.TPDO: tuple(range(TPDO1, TPDO1 + 0x400, 0x100)),
}
"""The CAN-IDs of PDO 1 to 4 in the predefined connection set, without the node-ID. CiA 301 v4.2.0, 7.3.3."""

EACH_SYNC: Final = 1
CYCLIC_TYPES: Final = range(1, 241)
"""Transmission types of PDOs that are sent at every n-th SYNC. CiA 301 v4.2.0, 7.5.2.35."""
EVENT_DRIVEN: Final = (254, 255)
"""Transmission types of PDOs that are sent, and act, at once. 255 is the one that a device profile defines."""

_FIRST: Final = {Direction.RPDO: indices.RPDO1_COMMUNICATION_PARAMETER, Direction.TPDO: indices.TPDO1_COMMUNICATION_PARAMETER}
_MAPPING: Final = 0x200  # from the communication to the mapping parameter

FIRST_PDO_RECORD: Final = indices.RPDO1_COMMUNICATION_PARAMETER
LAST_PDO_RECORD: Final = indices.TPDO1_MAPPING_PARAMETER + MAX_PDOS - 1


class PdoPlace(NamedTuple):
    """The PDO whose record is at an index. is_mapping: it is the mapping record, not the communication record."""

    direction: Direction
    number: int
    is_mapping: bool


def communication_index(direction: Direction, number: int) -> int:
    """Return the index of a communication parameter, 0x1400.. or 0x1800... number: 1..512, else LocalProtocolError."""
    if not 1 <= number <= MAX_PDOS:
        raise LocalProtocolError(f"{direction} {number}: a PDO has a number in 1..{MAX_PDOS}")
    return _FIRST[direction] + number - 1


def mapping_index(direction: Direction, number: int) -> int:
    """Return the index of a mapping parameter, 0x1600.. or 0x1A00... number: 1..512, else LocalProtocolError."""
    return communication_index(direction, number) + _MAPPING


def place_of(index: int) -> PdoPlace | None:
    """Return the PDO whose record is at an index; None outside 0x1400..0x1BFF."""
    offset = index - _FIRST[Direction.RPDO]
    if not 0 <= offset < 4 * _MAPPING:
        return None
    direction = Direction.TPDO if offset & 2 * _MAPPING else Direction.RPDO
    return PdoPlace(direction, (offset & _MAPPING - 1) + 1, bool(offset & _MAPPING))


def places_of(objects: Iterable[int]) -> Iterator[tuple[Direction, int]]:
    """Return direction and number of the PDOs whose communication record is among these indices."""
    for place in map(place_of, objects):
        if place is not None and not place.is_mapping:
            yield place.direction, place.number


@dataclass(frozen=True, slots=True)
class PdoSettings:
    """The settings of one PDO of a device.

    number: 1..512. cob_id: with its flag bits; with bit 31 the PDO is destroyed. transmission_type: 0..255. entries: values of
    the mapping parameter, at most 64. inhibit_time: ns, in steps of 100 us, up to 6.5535 s. event_time: ns, in steps of 1 ms, up
    to 65.535 s. A time that is None is as the device has it: many devices lack these objects.
    """

    number: int
    direction: Direction
    cob_id: int
    transmission_type: int
    entries: tuple[int, ...]
    inhibit_time: Time | None = None
    event_time: Time | None = None

    @classmethod
    def from_description(
        cls, description: PdoDescription, node_id: int, transmission_type: int, number: int | None = None
    ) -> PdoSettings:
        """Return the settings of a PDO of PDOs.csv on a node. number: needed if the description has none. transmission_type:
        0..255.

        A TPDO is created with "no remote requests" (bit 30), which every device accepts. Raises LocalProtocolError if there is no
        number, MappingError if an object cannot be mapped.
        """
        number = description.number if number is None else number
        if number is None:
            raise LocalProtocolError(f"{description.name}: give the number of the {description.direction} in the device, 1..512")
        flags = COB_ID_NO_RTR if description.direction == Direction.TPDO else 0
        entries = tuple(MappedEntry.of(entry).parameter for entry in description.entries)
        return cls(number, description.direction, description.can_id(node_id) | flags, transmission_type, entries)

    @property
    def place(self) -> tuple[Direction, int]:
        """Its direction and number: which PDO of the device it is."""
        return self.direction, self.number

    @property
    def name(self) -> str:
        """The PDO for people: "RPDO 2"."""
        return f"{self.direction} {self.number}"

    @property
    def is_valid(self) -> bool:
        """Whether the PDO exists: bit 31 of its COB-ID is 0."""
        return not self.cob_id & COB_ID_INVALID

    @property
    def key(self) -> RoutingKey:
        """The routing key of its frames."""
        return key_of_cob_id(self.cob_id)

    @property
    def can_id_text(self) -> str:
        """Its CAN-ID for people: "0x203"."""
        return f"0x{can_id_of(self.key):X}"

    @property
    def muxes(self) -> set[Mux]:
        """The objects that it carries, and the data types of its dummy entries."""
        return muxes_of(self.entries)

    @property
    def bits(self) -> int:
        """The bits of its entries together."""
        return sum(mapped(entry)[2] for entry in self.entries)

    @property
    def size(self) -> int:
        """The bytes of its frames."""
        return (self.bits + 7) // 8

    @property
    def destroyed(self) -> PdoSettings:
        """The settings that destroy it: bit 31 of its COB-ID is 1, all else stays."""
        return replace(self, cob_id=self.cob_id | COB_ID_INVALID)

    def are_in(self, present: PdoSettings) -> bool:
        """Return whether a PDO of a device is as wanted here. present: as it was read, without times: a wanted time differs.

        Bit 30 of the COB-ID does not count: we send no remote requests.
        """
        return replace(present, cob_id=present.cob_id | COB_ID_NO_RTR) == replace(self, cob_id=self.cob_id | COB_ID_NO_RTR)

    def steps(self, current_cob_id: int | None = None) -> list[Write]:
        """Return the downloads that set the PDO up, in order; see this module's text.

        current_cob_id: the device's present one; strict devices want its CAN-ID unchanged in the step that destroys the PDO.
        Raises LocalProtocolError for a wrong number, MappingError for too many entries, ValueRangeError for a value that does not
        fit its object. Source: CiA 301 v4.2.0, 7.5.2.36 and 7.5.2.38.
        """
        communication, mapping = communication_index(*self.place), mapping_index(*self.place)
        if len(self.entries) > MAX_ENTRIES:
            raise MappingError(f"{self.name}: {len(self.entries)} entries; a PDO has {MAX_ENTRIES} at most")
        present = self.cob_id if current_cob_id is None else current_cob_id
        steps = [
            _step(communication, COB_ID, present | COB_ID_INVALID, DataType.UNSIGNED32),
            _step(mapping, 0, 0, DataType.UNSIGNED8),
            *(_step(mapping, subindex, each, DataType.UNSIGNED32) for subindex, each in enumerate(self.entries, start=1)),
            _step(mapping, 0, len(self.entries), DataType.UNSIGNED8),
            _step(communication, TRANSMISSION_TYPE, self.transmission_type, DataType.UNSIGNED8),
        ]
        times = ((INHIBIT_TIME, self.inhibit_time, INHIBIT_UNIT), (EVENT_TIMER, self.event_time, MILLISECOND))
        for subindex, time, unit in times:
            if time is not None:
                steps.append(_step(communication, subindex, time // unit, DataType.UNSIGNED16))
        return [*steps, _step(communication, COB_ID, self.cob_id, DataType.UNSIGNED32)]


def _step(index: int, subindex: int, value: int, data_type: DataType) -> Write:
    return index, subindex, encode(value, data_type, f"0x{index:04X}:{subindex:02X}")


def cob_id_step(pdo: PdoSettings) -> Write:
    """Return the download that sets only the COB-ID: with bit 31, it destroys the PDO."""
    return _step(communication_index(*pdo.place), COB_ID, pdo.cob_id, DataType.UNSIGNED32)


def step_text(step: Write) -> tuple[str, str]:
    """Return the object and the value of a download for people: ("0x1400:01", "0x80000203"). step: index, subindex and bytes."""
    index, subindex, data = step
    return f"0x{index:04X}:{subindex:02X}", f"0x{int.from_bytes(data, 'little'):0{2 * len(data)}X}"


def muxes_of(entries: Iterable[int]) -> set[Mux]:
    """Return the objects that mapping entries name."""
    return {mux(index, subindex) for index, subindex, _ in map(mapped, entries)}


def carried_by(pdos: Iterable[PdoSettings], direction: Direction) -> set[Mux]:
    """Return the objects that the PDOs of one direction carry."""
    return {key for pdo in pdos if pdo.direction is direction for key in pdo.muxes}


def cyclic_objects(pdos: Iterable[PdoSettings]) -> dict[Mux, int]:
    """Return the objects that a device with these PDOs sends at SYNCs: mux -> n for "at every n-th SYNC"."""
    cyclic: dict[Mux, int] = {}
    for tpdo in pdos:
        if tpdo.direction is Direction.TPDO and tpdo.transmission_type in CYCLIC_TYPES:
            for each in tpdo.muxes:
                cyclic[each] = min(tpdo.transmission_type, cyclic.get(each, CYCLIC_TYPES.stop))
    return cyclic
