"""Find out, by listening only, which PDO a frame is, and what its bytes mean.

Three sources say which settings a device's PDOs have, the surer one first: the recording, the device's own file (parameters.py),
and, if there is neither of these, the PDO descriptions of the dictionary (PDOs.csv): the first one with the frame's CAN-ID and
length. They may be those of another device: the name of such a PDO ends with "?". Such a guess needs a reason: the recording has
shown that the device is a drive (0x1000: CiA 402), or that it is of the vendor whose PDOs the file describes (0x1018:01).

If the mapping of a PDO is known and its COB-ID is not, the COB-ID is that of the predefined connection set (CiA 301 v4.2.0,
7.3.5). If two devices have the same COB-ID, the recording goes before a file, the sender before a receiver, then the lower
node-ID. A frame of a multiplexed PDO names its object itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final, TypeAlias

from canopen_proto.datatypes import ValueRangeError, bit_length_of
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.drives.cia402.axes import MAX_AXES
from canopen_proto.drives.cia402.objects import STATUSWORD
from canopen_proto.explained import counted
from canopen_proto.frame import COB_ID_INVALID, MAX_NODE_ID, RPDO1, TPDO1, Frame, RoutingKey, key_of_cob_id
from canopen_proto.indices import DEVICE_TYPE
from canopen_proto.multiplexer import AXIS_STEP, index_of
from canopen_proto.observer.meaning import ShownObject, Words, hex_text, object_text, shown_of, value_text
from canopen_proto.observer.parameters import ObservedParameters
from canopen_proto.pdo.mapping import MAX_ENTRIES, MappedEntry, MappingError, entries_of
from canopen_proto.pdo.mapping import Mapping as PdoMapping
from canopen_proto.pdo.multiplexed import DESTINATION_MODE, MPDO, MpdoMode
from canopen_proto.pdo.settings import COB_ID, communication_index, mapping_index, place_of

PREDEFINED_PDOS: Final = 4
_FIRST_COB_ID: Final = {Direction.TPDO: TPDO1, Direction.RPDO: RPDO1}
_NEXT_PDO: Final = 0x100  # from the function code of a PDO to that of the next in its direction

STATUSWORDS: Final = frozenset(index_of(STATUSWORD) + axis * AXIS_STEP for axis in range(MAX_AXES))
"""The statuswords of all axes that a device may have."""
VENDOR: Final = 0x332
"""0x1018:01 of the devices that PDOs.csv describes: SCHUNK's."""
PROFILE: Final = 402
"""The lower half of 0x1000, of a drive."""

_Place: TypeAlias = tuple[Direction, int]
"""Direction and number of a PDO of a device."""


class ObservedPdo:
    """A PDO of a device. Never changes.

    name: "TPDO 1", or its name in PDOs.csv and "?". is_recorded: the recording has shown its parameters. mapping: None for a
    multiplexed PDO. byte_length: of its frames. has_statusword: the device sends a statusword in it. say: puts a frame in words.
    """

    __slots__ = (
        "_dictionaries", "_statuswords", "byte_length", "direction", "has_statusword", "is_recorded", "mapping", "name",
        "node_id", "say",
    )  # fmt: skip

    def __init__(
        self,
        node_id: int,
        name: str,
        direction: Direction,
        mapping: PdoMapping | None,
        dictionaries: Mapping[int, ObjectDictionary],
        *,
        is_recorded: bool = False,
    ) -> None:
        self.node_id = node_id
        self.name = name
        self.direction = direction
        self.mapping = mapping
        self.is_recorded = is_recorded
        self.byte_length = MPDO.size if mapping is None else mapping.byte_length
        self.say = self._multiplexed if mapping is None else self._mapped
        self._dictionaries = dictionaries
        self._statuswords = () if mapping is None or direction is Direction.RPDO else tuple(_statuswords_of(mapping))
        self.has_statusword = bool(self._statuswords)

    def statuswords(self, data: bytes) -> tuple[tuple[int, int], ...]:
        """Return the statuswords in a frame of the right length, each with its index."""
        return tuple([(index, data[at] | data[at + 1] << 8) for index, at in self._statuswords])

    def _mapped(self, frame: Frame) -> Words:
        mapping, data = self.mapping, frame.data
        assert mapping is not None
        dictionary = self._dictionaries[self.node_id]
        try:
            values = mapping.unpack(data)
        except ValueRangeError as error:
            why = (
                f"shorter than its mapping of {counted(self.byte_length, 'byte')}" if len(data) < self.byte_length else str(error)
            )
            return Words(f"{why}: {hex_text(data)}")
        is_held = self.direction is Direction.TPDO
        objects = []
        texts = []
        for entry, label, value in zip(mapping.components, mapping.labels, values, strict=True):
            text = value_text(dictionary, entry.index, entry.subindex, value)
            objects.append(ShownObject(self.node_id, entry.index, entry.subindex, entry.name, value, text, is_held))
            texts.append(f"{_name_of(entry, label)} = {text}")
        if len(data) > self.byte_length:
            rest = data[self.byte_length :].hex(" ")
            texts.append(f"longer than its mapping of {counted(self.byte_length, 'byte')}: {rest} left over")
        return Words(", ".join(texts), tuple(objects))

    def _multiplexed(self, frame: Frame) -> Words:
        """A frame in source address mode names the producer and its object; in destination address mode, the consumer and its."""
        if len(frame.data) != MPDO.size:
            return Words(f"a multiplexed PDO has {MPDO.size} bytes: {hex_text(frame.data)}")
        address, index, subindex, data = MPDO.unpack(frame.data)
        node_id, is_source = address & ~DESTINATION_MODE, not address & DESTINATION_MODE
        dictionary = self._dictionaries.get(node_id) or self._dictionaries[self.node_id]
        variable = dictionary.get(index, subindex)
        bits = bit_length_of(variable.data_type) if variable is not None else None
        shown = shown_of(dictionary, node_id, index, subindex, data[: ((bits or 32) + 7) // 8], is_held=is_source)
        whose = f"of node {node_id}" if node_id else "of all nodes"
        return Words(f"{object_text(dictionary, index, subindex)} {whose} = {shown.text}", (shown,))


class ObservedPdos:
    """The PDOs of all devices on a bus; see this module's text. `renew` reads those of a device."""

    def __init__(self, parameters: ObservedParameters) -> None:
        self._parameters = parameters
        self._of_node: dict[int, dict[_Place, tuple[RoutingKey, ObservedPdo]]] = {}
        self._by_key: dict[RoutingKey, list[ObservedPdo]] = {}  # the surest one first
        self._crowded: set[RoutingKey] = set()  # those of several PDOs
        self._described: set[int] = set()  # nodes that PDOs.csv may describe

    def renew(self, node_id: int, index: int | None = None) -> None:
        """Take note that the parameters of a device have changed; index: only those of this object."""
        places = self._of_node.setdefault(node_id, {})
        changed = set(_pdos_at(self._parameters.indices(node_id))).union(places) if index is None else _pdos_at((index,))
        for place in changed:
            before = places.pop(place, None)
            if before is not None:
                self._by_key[before[0]].remove(before[1])
                self._sort(before[0])
            found = self._pdo_of(node_id, *place)
            if found is not None:
                places[place] = found
                self._by_key.setdefault(found[0], []).append(found[1])
                self._sort(found[0])

    def identified(self, node_id: int, index: int, value: int) -> bool:
        """Take note of a device's 0x1000, or its 0x1018:01. Return whether PDOs.csv may describe this device since then."""
        is_described = value & 0xFFFF == PROFILE if index == DEVICE_TYPE else value == VENDOR
        if not is_described or node_id in self._described:
            return False
        self._described.add(node_id)
        return True

    def _sort(self, key: RoutingKey) -> None:
        pdos = self._by_key[key]
        if len(pdos) > 1:
            pdos.sort(key=_rank)
            self._crowded.add(key)
        else:
            self._crowded.discard(key)
            if not pdos:
                del self._by_key[key]

    def find(self, key: RoutingKey) -> ObservedPdo | None:
        """Return the PDO with a routing key by the recording or by a file, or None."""
        pdos = self._by_key.get(key)
        return pdos[0] if pdos else None

    def shared(self) -> list[tuple[RoutingKey, ObservedPdo, ObservedPdo]]:
        """Return the PDOs that two nodes send with one COB-ID, with its routing key."""
        crowded = [(key, self._by_key[key]) for key in sorted(self._crowded)]
        return [
            (key, pdos[0], pdo)
            for key, pdos in crowded
            for pdo in pdos[1:]
            if pdos[0].node_id != pdo.node_id and Direction.RPDO not in (pdos[0].direction, pdo.direction)
        ]

    def guesses(self, key: RoutingKey) -> tuple[ObservedPdo, ...]:
        """Return the PDOs that PDOs.csv describes with a routing key, for a device that has shown none itself."""
        node_id = key & MAX_NODE_ID
        if node_id not in self._described or self._of_node.get(node_id):
            return ()
        dictionaries = self._parameters.dictionaries
        found = []
        for each in dictionaries[node_id].pdos if node_id in dictionaries else ():
            if each.can_id(node_id) == key:
                try:
                    mapping = PdoMapping.from_description(each)
                except MappingError:
                    continue
                found.append(ObservedPdo(node_id, f"{each.name}?", each.direction, mapping, dictionaries))
        return tuple(found)

    def _pdo_of(self, node_id: int, direction: Direction, number: int) -> tuple[RoutingKey, ObservedPdo] | None:
        """Return a PDO by the recording and by the device's file, with its routing key; None if it is not valid."""
        cob_id = self._cob_id(node_id, direction, number)
        if not cob_id or cob_id & COB_ID_INVALID:
            return None
        mapping, is_multiplexed = self._mapping(node_id, direction, number)
        if mapping is None and not is_multiplexed:
            return None
        places = communication_index(direction, number), mapping_index(direction, number)
        is_recorded = any(self._parameters.is_recorded(node_id, index) for index in places)
        dictionaries = self._parameters.dictionaries
        pdo = ObservedPdo(node_id, f"{direction} {number}", direction, mapping, dictionaries, is_recorded=is_recorded)
        return key_of_cob_id(cob_id), pdo

    def _cob_id(self, node_id: int, direction: Direction, number: int) -> int | None:
        stored = self._parameters.value(node_id, communication_index(direction, number), COB_ID)
        if stored is None and number <= PREDEFINED_PDOS:
            return _FIRST_COB_ID[direction] + _NEXT_PDO * (number - 1) + node_id
        return stored

    def _mapping(self, node_id: int, direction: Direction, number: int) -> tuple[PdoMapping | None, bool]:
        """Return the mapping, and whether there is none because the PDO is a multiplexed one.

        None if it is empty, not known, or impossible: the device has refused it then.
        """
        index = mapping_index(direction, number)
        count = self._parameters.value(node_id, index, 0) or 0
        if count in (MpdoMode.SOURCE, MpdoMode.DESTINATION):
            return None, True
        if not 0 < count <= MAX_ENTRIES:
            return None, False
        entries = [self._parameters.value(node_id, index, subindex) for subindex in range(1, count + 1)]
        if not all(entries):
            return None, False
        try:
            return PdoMapping(entries_of(filter(None, entries), self._parameters.dictionaries[node_id])), False
        except MappingError:
            return None, False


def _statuswords_of(mapping: PdoMapping) -> Iterator[tuple[int, int]]:
    """Return the index of each whole statusword in a PDO, and its first byte."""
    bit = 0
    for entry in mapping.entries:
        if entry.index in STATUSWORDS and not entry.subindex and entry.bit_length == 16 and not bit % 8:
            yield entry.index, bit // 8
        bit += entry.bit_length


def _name_of(entry: MappedEntry, label: str) -> str:
    """Return an object's label; with its index and subindex too, if several objects of the PDO have that name."""
    return label if label == entry.name else f"{label} {entry.name}"


def _rank(pdo: ObservedPdo) -> tuple[bool, bool, int, str]:
    """Return by what PDOs with one COB-ID are ordered; see this module's text."""
    return not pdo.is_recorded, pdo.direction is Direction.RPDO, pdo.node_id, pdo.name


def _pdos_at(indices: Iterable[int]) -> Iterator[_Place]:
    """Return the PDOs whose parameters have these indices."""
    for index in indices:
        place = place_of(index)
        if place is not None:
            yield place.direction, place.number
