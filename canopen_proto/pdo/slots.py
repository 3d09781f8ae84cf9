"""The PDOs in a device's own file: which there are, which can be used as they are, and which can be given another mapping.

A file says it all before anything is sent: which PDO records there are, which of their objects can be written, which objects a
PDO may carry, and which CAN-IDs are in use. An EDS says it by its defaults, a DCF by its configured values. `pdos_of` reads the
settings, `slots_of` and `described_pdos` what can be used of them, `pdos_on_bus` what loads the bus; `PdoSlots` gives the
settings of a PDO for use.

`choose_pdos` takes the useful ones: every TPDO that carries something we want to hear, and as few RPDOs as are needed to carry
our commands. An RPDO also carries all else that is mapped into it; two RPDOs with the same object could contradict each other.

Impossible PDOs of a file (an object that does not exist, more than 64 bits, a COB-ID that no PDO may have) are not described:
lint reports them.

**CAN-IDs.** A PDO is ours if its CAN-ID belongs to this node in the predefined connection set, or to no node. Some files have the
CAN-IDs of the node-ID that they were exported from. Two drives with such a file would send with one CAN-ID, so these PDOs count
as another node's: they get a CAN-ID of the predefined connection set, or are destroyed (`foreign`).

Source: CiA 301 v4.2.0, 7.3.3 (predefined connection set), 7.5.2.35 to 7.5.2.38 (PDO parameters), 7.4.8.3 (access).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from canopen_proto import indices
from canopen_proto.cob_id import check_can_id
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Direction, ObjectDictionary, Variable
from canopen_proto.explained import counted
from canopen_proto.frame import COB_ID_EXTENDED, COB_ID_INVALID, COB_ID_NO_RTR, TPDO1
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.multiplexer import Mux, mapped, mapping_entry, mux, mux_text, split_mux
from canopen_proto.pdo.mapping import MAX_BITS, MAX_ENTRIES, Mapping, MappingError
from canopen_proto.pdo.multiplexed import MAPPABLE
from canopen_proto.pdo.settings import (
    COB_ID,
    CYCLIC_TYPES,
    EACH_SYNC,
    EVENT_DRIVEN,
    EVENT_TIMER,
    INHIBIT_TIME,
    INHIBIT_UNIT,
    PREDEFINED,
    TRANSMISSION_TYPE,
    PdoSettings,
    communication_index,
    mapping_index,
    muxes_of,
    places_of,
)

_PDO_CAN_IDS: Final = range(TPDO1 + 1, 0x580)
_CAN_ID: Final = 0x1FFF_FFFF


@dataclass(frozen=True, slots=True)
class PdoSlot:
    """One PDO of a dictionary. pdo: its settings as the file has them; without entries if they are impossible. capacity: how many
    objects can be mapped into it, 0..64; 0: its mapping is fixed. is_described: it can be used as the file has it. is_ours: see
    this module's text. can_move: its CAN-ID can be written."""

    pdo: PdoSettings
    capacity: int
    is_described: bool
    is_ours: bool
    can_move: bool


def number_in(dictionary: ObjectDictionary, index: int, subindex: int, node_id: int) -> int | None:
    """Return the number that an object of a device has when it starts, as 0x1400:01; None if the file gives none."""
    variable = dictionary.get(index, subindex)
    value = None if variable is None else variable.initial_of(node_id)
    return value if isinstance(value, int) else None


def pdos_of(dictionary: ObjectDictionary, node_id: int) -> list[PdoSettings]:
    """Return the PDOs for which a device with this dictionary has both records, as the file has them, RPDOs first.

    One without a COB-ID is not valid. An entry that is missing is 0. The entries of an MPDO mean nothing.
    """
    found = []
    for direction, number in places_of(dictionary.objects):
        communication, mapping = communication_index(direction, number), mapping_index(direction, number)
        if mapping not in dictionary.objects:
            continue
        cob_id = number_in(dictionary, communication, COB_ID, node_id)
        kind = number_in(dictionary, communication, TRANSMISSION_TYPE, node_id) or 0
        count = min(number_in(dictionary, mapping, 0, node_id) or 0, 0xFF)
        entries = tuple(number_in(dictionary, mapping, subindex, node_id) or 0 for subindex in range(1, count + 1))
        found.append(PdoSettings(number, direction, COB_ID_INVALID if cob_id is None else cob_id, kind & 0xFF, entries))
    return found


def pdos_on_bus(dictionary: ObjectDictionary, node_id: int) -> list[PdoSettings]:
    """Return the PDOs of `pdos_of` whose frames are on the bus: valid, with a CAN-ID that a PDO may have, and not empty.

    Their entries may name objects that the dictionary lacks: a device may have more than its file.
    """
    return [pdo for pdo in pdos_of(dictionary, node_id) if _is_in_use(pdo) and 0 < pdo.bits <= MAX_BITS]


def interval_of(pdo: PdoSettings, dictionary: ObjectDictionary, node_id: int) -> Time:
    """Return the shortest time between two frames of an event-driven TPDO, ns: its own, else the file's; 0: nobody tells."""
    index = communication_index(*pdo.place)
    inhibit, timer = (number_in(dictionary, index, subindex, node_id) or 0 for subindex in (INHIBIT_TIME, EVENT_TIMER))
    return pdo.inhibit_time or pdo.event_time or inhibit * INHIBIT_UNIT or timer * MILLISECOND


def slots_of(dictionary: ObjectDictionary, node_id: int) -> list[PdoSlot]:
    """Return the PDOs for which a device with this dictionary has both records, RPDOs first. node_id: 1..127."""
    found = []
    for pdo in pdos_of(dictionary, node_id):
        communication, mapping = communication_index(*pdo.place), mapping_index(*pdo.place)
        is_described = _is_in_use(pdo) and _is_possible(pdo.entries, dictionary)
        found.append(
            PdoSlot(
                pdo if is_described else replace(pdo, entries=()),
                _capacity(dictionary, communication, mapping),
                is_described,
                is_ours(pdo.cob_id, node_id),
                _is_writable(dictionary.get(communication, COB_ID)),
            )
        )
    return found


def described_pdos(dictionary: ObjectDictionary, node_id: int) -> list[PdoSettings]:
    """Return the valid PDOs that the dictionary's records describe for a device with this node-ID (1..127), RPDOs first."""
    return [slot.pdo for slot in slots_of(dictionary, node_id) if slot.is_described]


def choose_pdos(
    pdos: Collection[PdoSettings], commands: Collection[Mux], feedback: Collection[Mux]
) -> tuple[list[PdoSettings], list[Mux]]:
    """Return the useful PDOs, and the `commands` that none of them carries. commands, feedback: muxes to send and to hear."""
    chosen = [pdo for pdo in pdos if pdo.direction is Direction.TPDO and pdo.muxes & set(feedback)]
    missing = list(commands)
    candidates = [pdo for pdo in pdos if pdo.direction is Direction.RPDO]
    while missing and candidates:
        best = max(candidates, key=lambda pdo: (sum(mux in pdo.muxes for mux in missing), -len(pdo.entries), -pdo.number))
        served = [mux for mux in missing if mux in best.muxes]
        if not served:
            break
        chosen.append(best)
        missing = [mux for mux in missing if mux not in served]
        said = set(served)
        candidates = [pdo for pdo in candidates if not said & pdo.muxes]
    return chosen, missing


class PdoSlots:
    """The PDOs of one device, and what can be made of them. all: RPDOs first. listens: the device listens to SYNC."""

    def __init__(self, dictionary: ObjectDictionary, node_id: int) -> None:
        """node_id: 1..127. Nothing is kept of the dictionary."""
        self.all = slots_of(dictionary, node_id)
        self.listens = has_sync(dictionary)
        self._node_id = node_id

    def existing(self, direction: Direction) -> list[PdoSettings]:
        """Return the PDOs of one direction that can be used as the file has them: valid, ours, with a CAN-ID that no other one
        has, and of a transmission type that acts: at each n-th SYNC if the device listens to SYNC, or event-driven."""
        kinds = (*EVENT_DRIVEN, *(CYCLIC_TYPES if self.listens else ()))
        can_ids = [slot.pdo.cob_id & _CAN_ID for slot in self.all if slot.pdo.is_valid]
        usable = [slot.pdo for slot in self.all if slot.is_described and slot.is_ours and slot.pdo.transmission_type in kinds]
        return [pdo for pdo in usable if pdo.direction is direction and can_ids.count(pdo.cob_id & _CAN_ID) == 1]

    def foreign(self) -> list[PdoSlot]:
        """Return the valid PDOs with a CAN-ID of another node: they disturb what it sends, or obey what it is sent."""
        return [slot for slot in self.all if slot.pdo.is_valid and not slot.is_ours]

    def remapped(
        self,
        direction: Direction,
        wanted: Sequence[int],
        among: Iterable[PdoSlot],
        *,
        is_synchronous: bool,
        beside: Iterable[PdoSettings] = (),
    ) -> tuple[PdoSettings | None, list[str]]:
        """Return the settings of the PDO that can best be given these entries (None: there is none), and why others cannot.
        is_synchronous: at each SYNC; else event-driven.

        among: the PDOs that may be remapped. beside: PDOs that are going to be used too, whose CAN-IDs are taken.

        The best one loses nothing: all that it carries by the file is wanted, as much as possible. Else a PDO that the file does
        not use is taken, else one with another node's CAN-ID, else the first one.
        """
        objects, obstacles = muxes_of(wanted), []
        candidates: list[tuple[tuple[int, int, int], PdoSettings]] = []
        for slot in among:
            pdo = slot.pdo
            if pdo.direction is not direction:
                continue
            if slot.capacity < len(wanted):
                has = f"has room for {counted(slot.capacity, 'object')}" if slot.capacity else "has a fixed mapping"
                obstacles.append(f"{pdo.name} {has}")
                continue
            cob_id = _own_cob_id(slot, self._node_id)
            others = {other.pdo.cob_id & _CAN_ID for other in self.all if other is not slot and other.pdo.is_valid}
            others |= {other.cob_id & _CAN_ID for other in beside}
            if cob_id is None:
                obstacles.append(f"{pdo.name} has no CAN-ID that it may have on this node")
                continue
            if cob_id & _CAN_ID in others:
                obstacles.append(f"{pdo.name} cannot have CAN-ID 0x{cob_id & _CAN_ID:X}: another one has it")
                continue
            event_type = pdo.transmission_type if pdo.transmission_type in EVENT_DRIVEN else EVENT_DRIVEN[-1]
            kind = EACH_SYNC if is_synchronous else event_type
            is_lossless = pdo.muxes <= objects or not pdo.is_valid
            rank = 0 if is_lossless else 1 if not slot.is_ours else 2
            settings = replace(pdo, cob_id=cob_id, transmission_type=kind, entries=tuple(wanted))
            candidates.append(((rank, -len(pdo.muxes & objects), pdo.number), settings))
        return (min(candidates)[1] if candidates else None), obstacles


def spare_tpdos(chosen: Iterable[PdoSettings], own: Iterable[PdoSlot], welcome: Collection[Mux]) -> list[PdoSettings]:
    """Return the valid TPDOs that tell nothing of their own: the others of `chosen` bring it all at each SYNC, but for objects
    that are only `welcome`.

    own: the PDOs that may be switched off. Event-driven ones are spare before others, small ones before large ones.
    """
    cyclic = (pdo for pdo in chosen if pdo.direction is Direction.TPDO and pdo.transmission_type == EACH_SYNC)
    told = {pdo.number: pdo.muxes for pdo in cyclic}
    spare = []
    movable = [slot.pdo for slot in own if slot.is_ours and slot.can_move]
    tpdos = [pdo for pdo in movable if pdo.direction is Direction.TPDO and pdo.is_valid]
    for pdo in sorted(tpdos, key=lambda pdo: (pdo.number in told, len(pdo.muxes))):
        carried = told.get(pdo.number, pdo.muxes)
        others = set().union(*(muxes for number, muxes in told.items() if number != pdo.number))
        if carried and carried - set(welcome) <= others:
            told.pop(pdo.number, None)
            spare.append(pdo)
    return sorted(spare, key=lambda pdo: pdo.number)


def entry_of(dictionary: ObjectDictionary, key: Mux, direction: Direction) -> tuple[int | None, str]:
    """Return the mapping entry of an object in its full width and "", or None and the reason why no PDO of that direction can
    carry it."""
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


def shown_entries(dictionary: ObjectDictionary, entries: Iterable[int]) -> str:
    """Return mapping entries for people: "controlword, 16 bits empty, target_position"."""
    words = []
    for index, subindex, bits in map(mapped, entries):
        variable = dictionary.get(index, subindex)
        is_dummy = index < 0x1000
        words.append(
            f"{counted(bits, 'bit')} empty"
            if is_dummy
            else mux_text(mux(index, subindex))
            if variable is None
            else variable.label
        )
    return ", ".join(words)


def is_ours(cob_id: int, node_id: int) -> bool:
    """Return whether a node may have a PDO with this COB-ID; see this module's text."""
    if cob_id & COB_ID_EXTENDED:
        return True
    can_id = cob_id & _CAN_ID
    return check_can_id(cob_id) is None and (can_id not in _PDO_CAN_IDS or can_id & 0x7F == node_id)


def _is_in_use(pdo: PdoSettings) -> bool:
    """Return whether a PDO exists, and has a CAN-ID that a PDO may have."""
    return pdo.is_valid and check_can_id(pdo.cob_id) is None


def _is_possible(entries: Sequence[int], dictionary: ObjectDictionary) -> bool:
    """Return whether a PDO of a device with this dictionary can have these entries: none is missing, each can be mapped."""
    if not 0 < len(entries) <= MAX_ENTRIES or not all(entries):
        return False
    try:
        Mapping.from_parameters(entries, dictionary)
    except MappingError:
        return False
    return True


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


def _own_cob_id(slot: PdoSlot, node_id: int) -> int | None:
    """Return a valid COB-ID for a PDO: the file's CAN-ID if it is ours, else the predefined one; None if there is none."""
    direction, number = slot.pdo.place
    if slot.is_ours:
        return slot.pdo.cob_id & ~COB_ID_INVALID
    if number > len(PREDEFINED[direction]) or not slot.can_move:
        return None
    return (PREDEFINED[direction][number - 1] + node_id) | (COB_ID_NO_RTR if direction is Direction.TPDO else 0)
