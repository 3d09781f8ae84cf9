"""The places of PDO parameters in the dictionary, and the order of writes that sets a PDO up.

PDO n (1..512) has two records, one for communication and one for mapping (CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38):

    RPDO   0x1400 + n - 1   0x1600 + n - 1
    TPDO   0x1800 + n - 1   0x1A00 + n - 1

A device takes a new mapping in one order only (7.5.2.36): destroy the PDO (bit 31 of its COB-ID), disable its mapping (sub 0 is
0), write the entries, enable the mapping (sub 0 is their number), create the PDO. Transmission type and times are written right
before the last step, because some of them may change only while the PDO does not exist.

`remap_steps` returns the writes in that order. `PdoSettings.from_read` returns the settings that a device had before, so that the
same order can restore them after a refused step.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

from canopen_proto import indices
from canopen_proto.datatypes import DataType, encode
from canopen_proto.dictionary import Direction, PdoDescription
from canopen_proto.frame import COB_ID_INVALID, COB_ID_NO_RTR
from canopen_proto.machine import LocalProtocolError
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

_FIRST: Final = {Direction.RPDO: indices.RPDO1_COMMUNICATION_PARAMETER, Direction.TPDO: indices.TPDO1_COMMUNICATION_PARAMETER}
_MAPPING: Final = 0x200  # from the communication to the mapping parameter


class PdoPlace(NamedTuple):
    """The PDO whose record is at an index. is_mapping: it is the mapping record, not the communication record."""

    direction: Direction
    number: int
    is_mapping: bool


RemapStep: TypeAlias = tuple[int, int, bytes]
"""One download: index, subindex, data."""


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


def remap_steps(
    number: int,
    direction: Direction,
    entries: Iterable[int | MappedEntry],
    transmission_type: int,
    cob_id: int,
    *,
    current_cob_id: int | None = None,
    inhibit_time_100us: int | None = None,
    event_time_ms: int | None = None,
) -> list[RemapStep]:
    """Return the downloads that set a PDO up, in order.

    entries: objects, or values of the mapping parameter. cob_id: with its flag bits; with bit 31 the PDO stays destroyed.
    current_cob_id: the device's present one; strict devices want its CAN-ID unchanged in the step that destroys the PDO. A time
    that is None is not written: many devices lack these objects. Raises LocalProtocolError for a wrong number, MappingError for
    too many entries, ValueRangeError for a value that does not fit its object. Source: CiA 301 v4.2.0, 7.5.2.36 and 7.5.2.38.
    """
    communication, mapping = communication_index(direction, number), mapping_index(direction, number)
    parameters = [each.parameter if isinstance(each, MappedEntry) else each for each in entries]
    if len(parameters) > MAX_ENTRIES:
        raise MappingError(f"{direction} {number}: {len(parameters)} entries; a PDO has {MAX_ENTRIES} at most")
    standing = cob_id if current_cob_id is None else current_cob_id
    steps = [
        _step(communication, COB_ID, standing | COB_ID_INVALID, DataType.UNSIGNED32),
        _step(mapping, 0, 0, DataType.UNSIGNED8),
        *(_step(mapping, subindex, each, DataType.UNSIGNED32) for subindex, each in enumerate(parameters, start=1)),
        _step(mapping, 0, len(parameters), DataType.UNSIGNED8),
        _step(communication, TRANSMISSION_TYPE, transmission_type, DataType.UNSIGNED8),
    ]
    if inhibit_time_100us is not None:
        steps.append(_step(communication, INHIBIT_TIME, inhibit_time_100us, DataType.UNSIGNED16))
    if event_time_ms is not None:
        steps.append(_step(communication, EVENT_TIMER, event_time_ms, DataType.UNSIGNED16))
    return [*steps, _step(communication, COB_ID, cob_id, DataType.UNSIGNED32)]


def _step(index: int, subindex: int, value: int, data_type: DataType) -> RemapStep:
    return index, subindex, encode(value, data_type, f"0x{index:04X}:{subindex:02X}")


def objects_to_read(number: int, direction: Direction, count: int = 0) -> list[tuple[int, int]]:
    """Return index and subindex of each object that `PdoSettings.from_read` needs.

    count: the number of mapped objects. Read the objects for count 0 first: the last of them is that number.
    """
    communication, mapping = communication_index(direction, number), mapping_index(direction, number)
    fixed = [(communication, COB_ID), (communication, TRANSMISSION_TYPE), (mapping, 0)]
    return fixed + [(mapping, subindex) for subindex in range(1, count + 1)]


@dataclass(frozen=True, slots=True)
class PdoSettings:
    """The settings of one PDO of a device. cob_id: with its flag bits. entries: values of the mapping parameter."""

    number: int
    direction: Direction
    cob_id: int
    transmission_type: int
    entries: tuple[int, ...]

    @classmethod
    def from_read(cls, number: int, direction: Direction, read: Mapping[tuple[int, int], bytes]) -> PdoSettings:
        """Return the settings from the bytes of `objects_to_read`. Raises MappingError if one is missing or too large."""
        fixed = objects_to_read(number, direction)
        missing = [place for place in fixed if place not in read]
        if not missing:
            cob_id, transmission_type, count = (int.from_bytes(read[place], "little") for place in fixed)
            if count > MAX_ENTRIES:
                raise MappingError(f"{direction} {number}: {count} mapped objects; a PDO has {MAX_ENTRIES} at most")
            places = objects_to_read(number, direction, count)
            missing = [place for place in places if place not in read]
        if missing:
            raise MappingError(f"{direction} {number}: 0x{missing[0][0]:04X}:{missing[0][1]:02X} was not read")
        entries = tuple(int.from_bytes(read[place], "little") for place in places[len(fixed) :])
        return cls(number, direction, cob_id, transmission_type, entries)

    @classmethod
    def from_description(
        cls, description: PdoDescription, node_id: int, transmission_type: int, number: int | None = None
    ) -> PdoSettings:
        """Return the settings of a PDO of PDOs.csv on a node. number: needed if the description has none.

        A TPDO is created with "no remote requests" (bit 30), which every device accepts. Raises LocalProtocolError if there is no
        number, MappingError if an object cannot be mapped.
        """
        number = description.number if number is None else number
        if number is None:
            raise LocalProtocolError(f"{description.name}: give the number of the {description.direction} in the device, 1..512")
        flags = COB_ID_NO_RTR if description.direction == Direction.TPDO else 0
        entries = tuple(MappedEntry.of(entry).parameter for entry in description.entries)
        return cls(number, description.direction, description.can_id(node_id) | flags, transmission_type, entries)

    def steps(self, current_cob_id: int | None = None) -> list[RemapStep]:
        """Return the downloads that set the PDO up; see `remap_steps`."""
        return remap_steps(
            self.number, self.direction, self.entries, self.transmission_type, self.cob_id, current_cob_id=current_cob_id
        )
