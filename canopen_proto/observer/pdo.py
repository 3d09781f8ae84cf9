"""Find out, by listening only, which PDO a frame is, and what its bytes mean.

Three sources say which settings a device's PDOs have, the surer one first:

1. the recording: PDO parameters (0x1400 to 0x1BFF) that were written to the device, or read from it. A boot-up ends that: the
   device has its power-on values again.
2. the device's own file: the defaults of an EDS, the values of a DCF.
3. the PDO descriptions of the dictionary (PDOs.csv), if there is neither of these: the first one with the frame's CAN-ID and
   length.

If the mapping of a PDO is known and its COB-ID is not, the COB-ID is that of the predefined connection set (CiA 301 v4.2.0,
7.3.5). If two devices have the same COB-ID, the recording goes before a file, the sender before a receiver, then the lower
node-ID.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.frame import COB_ID_INVALID, RPDO1, TPDO1, RoutingKey, key_of_cob_id
from canopen_proto.multiplexer import Mux, index_of, mux
from canopen_proto.pdo.mapping import MAX_ENTRIES, MappingError, entries_of
from canopen_proto.pdo.mapping import Mapping as PdoMapping
from canopen_proto.pdo.settings import COB_ID, communication_index, mapping_index, place_of

PREDEFINED_PDOS: Final = 4
_FIRST_COB_ID: Final = {Direction.TPDO: TPDO1, Direction.RPDO: RPDO1}
_NEXT_PDO: Final = 0x100  # from the function code of a PDO to that of the next in its direction


class OverheardPdo(NamedTuple):
    """A PDO of a device. name: "TPDO 1", or its name in PDOs.csv; is_guess: the latter, which may be of another device."""

    node_id: int
    name: str
    direction: Direction
    mapping: PdoMapping
    is_recorded: bool
    is_guess: bool = False


class OverheardPdos:
    """The PDOs of all devices on a bus; see this module's text. dictionaries: by node-ID.

    shared: those that two nodes send with one COB-ID; `find` fills it.
    """

    def __init__(self, dictionaries: Mapping[int, ObjectDictionary]) -> None:
        self._dictionaries = dictionaries
        self._recorded: dict[int, dict[Mux, int]] = {}  # by node-ID: mux -> value
        self._of_node = {node_id: self._pdos_of(node_id) for node_id in dictionaries}  # with their routing keys
        self._by_key: dict[int, OverheardPdo] | None = None
        self.shared: list[tuple[RoutingKey, OverheardPdo, OverheardPdo]] = []

    def settle(self, node_id: int, index: int, subindex: int, data: bytes) -> None:
        """Take note that the device holds this value. Does nothing if the object is not a PDO parameter."""
        if place_of(index) is not None and len(data) <= 4:
            self._recorded.setdefault(node_id, {})[mux(index, subindex)] = int.from_bytes(data, "little")
            self._renew(node_id)

    def booted(self, node_id: int) -> None:
        """Take note of a boot-up: the device has its power-on values again."""
        if self._recorded.pop(node_id, None):
            self._renew(node_id)

    def find(self, key: RoutingKey, node_id: int, length: int) -> OverheardPdo | None:
        """Return the PDO with a routing key, or None. node_id: of the CAN-ID; length: bytes of the frame; both for PDOs.csv."""
        if self._by_key is None:
            self._by_key = {}
            self.shared = []
            known = [pair for pairs in self._of_node.values() for pair in pairs]
            known.sort(key=lambda pair: (not pair[1].is_recorded, pair[1].direction is Direction.RPDO))
            for each, pdo in known:
                first = self._by_key.setdefault(each, pdo)
                if first.node_id != pdo.node_id and Direction.RPDO not in (first.direction, pdo.direction):
                    self.shared.append((each, first, pdo))
        if key in self._by_key or self._of_node.get(node_id):
            return self._by_key.get(key)
        return self._of_csv(key, node_id, length)

    def _renew(self, node_id: int) -> None:
        self._of_node[node_id] = self._pdos_of(node_id)
        self._by_key = None
        self.shared = []

    def _of_csv(self, key: RoutingKey, node_id: int, length: int) -> OverheardPdo | None:
        pdos = self._dictionaries[node_id].pdos if node_id in self._dictionaries else ()
        candidates = [each for each in pdos if each.can_id(node_id) == key]
        if not candidates:
            return None
        best = next((each for each in candidates if (each.bit_length + 7) // 8 == length), candidates[0])
        try:
            return OverheardPdo(node_id, best.name, best.direction, PdoMapping.from_description(best), False, True)
        except MappingError:
            return None

    def _pdos_of(self, node_id: int) -> list[tuple[RoutingKey, OverheardPdo]]:
        """Return the valid PDOs of a device by the recording and by its file, with their routing keys."""
        recorded = set(_pdos_at(index_of(mux) for mux in self._recorded.get(node_id, ())))
        found = []
        for direction, number in sorted({*recorded, *_pdos_at(self._dictionaries[node_id].objects)}):
            cob_id, mapping = self._cob_id(node_id, direction, number), self._mapping(node_id, direction, number)
            if cob_id and not cob_id & COB_ID_INVALID and mapping is not None:
                pdo = OverheardPdo(node_id, f"{direction} {number}", direction, mapping, (direction, number) in recorded)
                found.append((key_of_cob_id(cob_id), pdo))
        return found

    def _cob_id(self, node_id: int, direction: Direction, number: int) -> int | None:
        stored = self._value(node_id, communication_index(direction, number), COB_ID)
        if stored is None and number <= PREDEFINED_PDOS:
            return _FIRST_COB_ID[direction] + _NEXT_PDO * (number - 1) + node_id
        return stored

    def _mapping(self, node_id: int, direction: Direction, number: int) -> PdoMapping | None:
        """Return the mapping; None if it is empty, not known, or impossible: the device has refused it then."""
        index = mapping_index(direction, number)
        count = self._value(node_id, index, 0) or 0
        if not 0 < count <= MAX_ENTRIES:
            return None
        entries = [self._value(node_id, index, subindex) for subindex in range(1, count + 1)]
        if not all(entries):
            return None
        try:
            return PdoMapping(entries_of(filter(None, entries), self._dictionaries[node_id]))
        except MappingError:
            return None

    def _value(self, node_id: int, index: int, subindex: int) -> int | None:
        recorded = self._recorded.get(node_id, {}).get(mux(index, subindex))
        if recorded is not None:
            return recorded
        variable = self._dictionaries[node_id].get(index, subindex)
        value = None if variable is None else variable.initial_of(node_id)
        return value if isinstance(value, int) else None


def _pdos_at(indices: Iterable[int]) -> Iterator[tuple[Direction, int]]:
    """Return the PDOs whose parameters have these indices."""
    for index in indices:
        place = place_of(index)
        if place is not None:
            yield place.direction, place.number
