"""The places for PDOs in a device's dictionary: which PDOs can be used as they are, and which can be given another mapping.

A file says it all before anything is sent: which PDO records there are, which of their objects can be written, which objects a
PDO may carry, and which CAN-IDs are in use. `slots_of` reads that, `existing` and `remapped` give the settings of a PDO for use.

**CAN-IDs.** A PDO is ours if its CAN-ID belongs to this node in the predefined connection set, or to no node. Some files have the
CAN-IDs of the node-ID that they were exported from. Two drives with such a file would send with one CAN-ID, so these PDOs count
as another node's: they get a CAN-ID of the predefined connection set, or are destroyed (`foreign`).

Source: CiA 301 v4.2.0, 7.3.3 (predefined connection set), 7.5.2.35 to 7.5.2.38 (PDO parameters), 7.4.8.3 (access).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from canopen_proto import indices
from canopen_proto.cob_id import check_can_id
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Direction, ObjectDictionary, Variable
from canopen_proto.frame import COB_ID_EXTENDED, COB_ID_INVALID, COB_ID_NO_RTR, RPDO1, TPDO1, key_of_cob_id
from canopen_proto.multiplexer import Mux, mapped, mapping_entry, mux, mux_text, split_mux
from canopen_proto.pdo.described import CYCLIC_TYPES, EACH_SYNC, described_pdos, muxes_of
from canopen_proto.pdo.mapping import MAX_BITS
from canopen_proto.pdo.multiplexed import MAPPABLE
from canopen_proto.pdo.settings import COB_ID, TRANSMISSION_TYPE, PdoSettings, mapping_index, place_of

EVENT_DRIVEN: Final = (254, 255)
"""Transmission types of PDOs that are sent, and act, at once. 255 is the one that a device profile defines."""

_FIRST_CAN_ID: Final = {Direction.RPDO: RPDO1, Direction.TPDO: TPDO1}
_PREDEFINED: Final = range(1, 5)  # the numbers of the PDOs that have a predefined CAN-ID
_PDO_CAN_IDS: Final = range(TPDO1 + 1, 0x580)
_CAN_ID: Final = 0x1FFF_FFFF


@dataclass(frozen=True, slots=True)
class Slot:
    """One PDO of a dictionary. cob_id, transmission_type, entries: as the file gives them; entries are empty if it has none, or
    impossible ones. capacity: how many objects can be mapped into it; 0: its mapping is fixed. is_described: it can be used as
    the file has it. is_ours: see this module's text. can_move: its CAN-ID can be written."""

    direction: Direction
    number: int
    cob_id: int
    transmission_type: int
    entries: tuple[int, ...]
    capacity: int
    is_described: bool
    is_ours: bool
    can_move: bool

    @property
    def is_valid(self) -> bool:
        """Whether the PDO exists when the device starts: bit 31 of its COB-ID is 0."""
        return not self.cob_id & COB_ID_INVALID

    @property
    def muxes(self) -> set[Mux]:
        """The objects that it carries by the file."""
        return muxes_of(self.entries)

    @property
    def name(self) -> str:
        """The PDO for people: "RPDO 2"."""
        return f"{self.direction} {self.number}"

    @property
    def settings(self) -> PdoSettings:
        """Its settings as the file has them."""
        return PdoSettings(self.number, self.direction, self.cob_id, self.transmission_type, self.entries)


def slots_of(dictionary: ObjectDictionary, node_id: int) -> list[Slot]:
    """Return the PDOs for which a device with this dictionary has both records, RPDOs first."""
    described = {(pdo.direction, pdo.number): pdo for pdo in described_pdos(dictionary, node_id)}
    found = []
    for index in dictionary.objects:
        place = place_of(index)
        if place is None or place.is_mapping or mapping_index(place.direction, place.number) not in dictionary.objects:
            continue
        cob_id, kind = (_initial(dictionary.get(index, subindex), node_id) for subindex in (COB_ID, TRANSMISSION_TYPE))
        pdo = described.get((place.direction, place.number))
        found.append(
            Slot(
                place.direction,
                place.number,
                COB_ID_INVALID if cob_id is None else cob_id,
                (kind or 0) & 0xFF,
                () if pdo is None else pdo.entries,
                _capacity(dictionary, index, mapping_index(place.direction, place.number)),
                pdo is not None,
                cob_id is not None and is_ours(cob_id, node_id),
                _is_writable(dictionary.get(index, COB_ID)),
            )
        )
    return found


def existing(slots: Sequence[Slot], direction: Direction, *, has_sync: bool) -> list[PdoSettings]:
    """Return the PDOs of one direction that can be used as the file has them: valid, ours, with a CAN-ID that no other one has,
    and of a transmission type that acts: at each n-th SYNC if the device listens to SYNC (`has_sync`), or event-driven.

    slots: all PDOs of the device.
    """
    can_ids = [slot.cob_id & _CAN_ID for slot in slots if slot.is_valid]
    return [
        slot.settings
        for slot in slots
        if slot.direction is direction
        and slot.is_described
        and slot.is_ours
        and can_ids.count(slot.cob_id & _CAN_ID) == 1
        and (slot.transmission_type in EVENT_DRIVEN or (has_sync and slot.transmission_type in CYCLIC_TYPES))
    ]


def foreign(slots: Iterable[Slot]) -> list[Slot]:
    """Return the valid PDOs that would disturb, or obey, another node."""
    return [slot for slot in slots if slot.is_valid and not slot.is_ours]


def spare_tpdos(chosen: Iterable[PdoSettings], own: Iterable[Slot], welcome: Collection[Mux]) -> list[Slot]:
    """Return the valid TPDOs that tell nothing of their own: the others of `chosen` bring it all at each SYNC, but for objects
    that are only `welcome`.

    own: the PDOs that may be switched off. Event-driven ones are spare before others, small ones before large ones.
    """
    told = {pdo.number: muxes_of(pdo.entries) for pdo in chosen if _is_cyclic_tpdo(pdo)}
    spare = []
    tpdos = [slot for slot in own if slot.direction is Direction.TPDO and slot.is_valid and slot.is_ours and slot.can_move]
    for slot in sorted(tpdos, key=lambda slot: (slot.number in told, len(slot.muxes))):
        carried = told.get(slot.number, slot.muxes)
        others = set().union(*(muxes for number, muxes in told.items() if number != slot.number))
        if carried and carried - set(welcome) <= others:
            told.pop(slot.number, None)
            spare.append(slot)
    return sorted(spare, key=lambda slot: slot.number)


def _is_cyclic_tpdo(pdo: PdoSettings) -> bool:
    return pdo.direction is Direction.TPDO and pdo.transmission_type == EACH_SYNC


def remapped(
    slots: Sequence[Slot],
    direction: Direction,
    node_id: int,
    wanted: Sequence[int],
    *,
    is_synchronous: bool,
    beside: Collection[PdoSettings] = (),
    among: Collection[Slot] | None = None,
) -> tuple[PdoSettings | None, list[str]]:
    """Return the settings of the PDO that can best be given these entries (None: there is none), and why others cannot.

    slots: all PDOs of the device. beside: PDOs that are going to be used too, whose CAN-IDs are taken.
    among: the PDOs that may be remapped; None: all.

    The best one loses nothing: all that it carries by the file is wanted, as much as possible. Else a PDO that the file does not
    use is taken, else one with another node's CAN-ID, else the first one.
    """
    objects, obstacles = muxes_of(wanted), []
    candidates: list[tuple[tuple[int, int, int], PdoSettings]] = []
    for slot in slots if among is None else among:
        if slot.direction is not direction:
            continue
        if slot.capacity < len(wanted):
            has = f"has room for {slot.capacity} objects" if slot.capacity else "has a fixed mapping"
            obstacles.append(f"{slot.name} {has}")
            continue
        cob_id = _own_cob_id(slot, node_id)
        others = {other.cob_id & _CAN_ID for other in slots if other is not slot and other.is_valid}
        others |= {pdo.cob_id & _CAN_ID for pdo in beside}
        if cob_id is None:
            obstacles.append(f"{slot.name} has no CAN-ID that it may have on this node")
            continue
        if cob_id & _CAN_ID in others:
            obstacles.append(f"{slot.name} cannot have CAN-ID 0x{cob_id & _CAN_ID:X}: another one has it")
            continue
        event_type = slot.transmission_type if slot.transmission_type in EVENT_DRIVEN else EVENT_DRIVEN[-1]
        kind = EACH_SYNC if is_synchronous else event_type
        settings = PdoSettings(slot.number, slot.direction, cob_id, kind, tuple(wanted))
        is_lossless = slot.muxes <= objects or not slot.is_valid
        rank = 0 if is_lossless else 1 if not slot.is_ours else 2
        candidates.append(((rank, -len(slot.muxes & objects), slot.number), settings))
    return (min(candidates)[1] if candidates else None), obstacles


def entry_of(dictionary: ObjectDictionary, key: Mux, direction: Direction) -> tuple[int | None, str]:
    """Return the mapping entry of an object in its full width, or None and why a PDO of that direction cannot carry it."""
    variable = dictionary.get(*split_mux(key))
    if variable is None:
        return None, f"it has no {mux_text(key)}"
    if not variable.pdo_mappable:
        return None, f"no PDO can carry {variable.label} (PDOMapping)"
    if variable.access not in MAPPABLE[direction]:
        return None, f"no {direction} can carry {variable.label}: it is {variable.access}"
    if not variable.bit_length or variable.bit_length > MAX_BITS or variable.data_type is DataType.DOMAIN:
        return None, f"no PDO can carry {variable.label}: it is {variable.data_type.name}"
    return mapping_entry(key, variable.bit_length), ""


def as_fit(entries: Iterable[int]) -> tuple[int, ...]:
    """Return the entries that fit into one PDO together, the first ones first."""
    taken: list[int] = []
    left = MAX_BITS
    for entry in entries:
        bits = mapped(entry)[2]
        if bits <= left:
            taken.append(entry)
            left -= bits
    return tuple(taken)


def has_sync(dictionary: ObjectDictionary) -> bool:
    """Return whether a device listens to SYNC: 0x1005 is mandatory then (CiA 301 v4.2.0, 7.5.2.5)."""
    return dictionary.get(indices.COB_ID_SYNC, 0) is not None


def destroying(slot: Slot) -> PdoSettings:
    """Return the settings that destroy a PDO: bit 31 of its COB-ID is 1, all else stays."""
    return PdoSettings(slot.number, slot.direction, slot.cob_id | COB_ID_INVALID, slot.transmission_type, slot.entries)


def shown_entries(dictionary: ObjectDictionary, entries: Iterable[int]) -> str:
    """Return mapping entries for people: "controlword, 16 bits empty, target_position"."""
    words = []
    for index, subindex, bits in map(mapped, entries):
        variable = dictionary.get(index, subindex)
        is_dummy = index < 0x1000
        words.append(f"{bits} bits empty" if is_dummy else mux_text(mux(index, subindex)) if variable is None else variable.label)
    return ", ".join(words)


def key_text(cob_id: int) -> str:
    """Return the CAN-ID of a COB-ID for people: "0x203"."""
    return f"0x{key_of_cob_id(cob_id & ~COB_ID_INVALID) & _CAN_ID:X}"


def is_ours(cob_id: int, node_id: int) -> bool:
    """Return whether a node may have a PDO with this COB-ID; see this module's text."""
    if cob_id & COB_ID_EXTENDED:
        return True
    can_id = cob_id & _CAN_ID
    return check_can_id(cob_id) is None and (can_id not in _PDO_CAN_IDS or can_id & 0x7F == node_id)


def _initial(variable: Variable | None, node_id: int) -> int | None:
    value = None if variable is None else variable.initial_of(node_id)
    return value if isinstance(value, int) else None


def _is_writable(variable: Variable | None) -> bool:
    return variable is not None and variable.access.writable


def _capacity(dictionary: ObjectDictionary, communication: int, mapping: int) -> int:
    """Return how many objects can be mapped into the PDO with these records; 0 if its settings are fixed."""
    steps = ((communication, COB_ID), (communication, TRANSMISSION_TYPE), (mapping, 0))
    if not all(_is_writable(dictionary.get(index, subindex)) for index, subindex in steps):
        return 0
    count = 0
    while _is_writable(dictionary.get(mapping, count + 1)):
        count += 1
    limit = dictionary.objects[mapping].variables[0].high_limit
    return min(count, limit) if isinstance(limit, int) else count


def _own_cob_id(slot: Slot, node_id: int) -> int | None:
    """Return a valid COB-ID for a PDO: the file's CAN-ID if it is ours, else the predefined one; None if there is none."""
    if slot.is_ours:
        return slot.cob_id & ~COB_ID_INVALID
    if slot.number not in _PREDEFINED or not slot.can_move:
        return None
    flags = COB_ID_NO_RTR if slot.direction is Direction.TPDO else 0
    return (_FIRST_CAN_ID[slot.direction] + 0x100 * (slot.number - 1) + node_id) | flags
