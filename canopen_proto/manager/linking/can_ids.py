"""The CAN-IDs of linked PDOs: one for each, which all its ends have.

The first free one of these is taken: the predefined CAN-ID of the PDO that sends (or, if the master sends, of the one that
receives); the one that its file gives it; the other predefined PDO CAN-IDs of that node; 0x680 to 0x6DF, which no service has;
and at last those of node-IDs that nobody on the bus has, for a device that is new on the bus would send or obey on them. None of
them is restricted (CiA 301 v4.2.0, 7.3.5, table 40).

Not free is a CAN-ID that a file gives to another PDO that is valid and stays, or to SYNC, TIME, EMCY or an SDO channel. A PDO
whose COB-ID cannot be written brings its own.

Source: CiA 301 v4.2.0, 7.3.3 (predefined connection set), 7.3.5.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import Final

from canopen_proto import indices
from canopen_proto.cob_id import check_can_id
from canopen_proto.dictionary import Direction
from canopen_proto.frame import COB_ID_EXTENDED, COB_ID_INVALID, EMCY, MAX_NODE_ID, SYNC, TIME
from canopen_proto.manager.linking.model import KnownNode, LinkedPdo
from canopen_proto.pdo.settings import PREDEFINED, PdoSettings
from canopen_proto.pdo.slots import number_in

_WITHOUT_SERVICE: Final = range(0x680, 0x6E0)
_CAN_ID: Final = 0x7FF
_BROADCASTS: Final = (indices.COB_ID_SYNC, indices.COB_ID_TIME_STAMP)


class CanIds:
    """Gives CAN-IDs to PDOs. node_ids: of all nodes on the bus, also of those without a file. members: those whose PDOs are
    known."""

    def __init__(self, members: Iterable[KnownNode], node_ids: Collection[int]) -> None:
        self._node_ids = set(node_ids)
        self._owners: dict[int, str] = {SYNC: "SYNC", TIME: "TIME"}
        for member in members:
            self._node_ids.add(member.node_id)
            for name, cob_id in _services(member):
                self._hold(cob_id, name)
            for pdo in member.used:
                self._hold(pdo.cob_id, f"{pdo.name} of {member.name}")
        for node_id in self._node_ids:
            self._owners.setdefault(EMCY + node_id, f"EMCY of node {node_id}")

    def hold(self, member: KnownNode, pdo: PdoSettings) -> None:
        """Keep the CAN-ID of a PDO that stays as its file has it."""
        self._hold(pdo.cob_id, f"{pdo.name} of {member.name}")

    def give(self, owner: LinkedPdo, others: Iterable[LinkedPdo]) -> int | str:
        """Return the CAN-ID for a PDO, or why there is none. owner: the end that the predefined connection set counts by. others:
        the PDOs of its other ends."""
        fixed = [each for each in (owner, *others) if not each.slot.can_move]
        can_ids = {each.slot.pdo.cob_id & _CAN_ID for each in fixed}
        if len(can_ids) > 1:
            ends = " and ".join(f"{each.name} of {each.node}" for each in fixed)
            return f"{ends} have different CAN-IDs that cannot be written"
        for can_id in can_ids or self._candidates(owner):
            is_shared = owner.is_shared and can_id == owner.slot.pdo.cob_id & _CAN_ID
            if check_can_id(can_id) is None and (is_shared or can_id not in self._owners):
                self._owners[can_id] = f"{owner.name} of {owner.node}"
                return can_id
        if can_ids:
            (can_id,) = can_ids
            end = f"{fixed[0].name} of {fixed[0].node}"
            return f"{end} cannot change its CAN-ID 0x{can_id:X}, which is that of {self._owners.get(can_id, 'no PDO')}"
        return "no CAN-ID is left for it"

    def _hold(self, cob_id: int, owner: str) -> None:
        if not cob_id & (COB_ID_INVALID | COB_ID_EXTENDED):
            self._owners.setdefault(cob_id & _CAN_ID, owner)

    def _candidates(self, owner: LinkedPdo) -> Iterator[int]:
        slot, node_id = owner.slot, owner.member.node_id
        direction, number = slot.pdo.place
        bases = PREDEFINED[direction]
        if number <= len(bases):
            yield bases[number - 1] + node_id
        if slot.pdo.is_valid and slot.is_ours and not slot.pdo.cob_id & COB_ID_EXTENDED:
            yield slot.pdo.cob_id & _CAN_ID
        yield from self._predefined(node_id, direction)
        yield from _WITHOUT_SERVICE
        for free in range(MAX_NODE_ID, 0, -1):
            if free not in self._node_ids:
                yield from self._predefined(free, direction)

    def _predefined(self, node_id: int, first: Direction) -> Iterator[int]:
        for direction in (first, *(other for other in Direction if other is not first)):
            yield from (base + node_id for base in PREDEFINED[direction])


def _services(member: KnownNode) -> Iterator[tuple[str, int]]:
    """Return the COB-IDs of a node's services that are no PDOs, by its file."""
    dictionary = member.dictionary
    places = [(index, 0) for index in (*_BROADCASTS, indices.COB_ID_EMERGENCY)]
    places += [(index, subindex) for index in dictionary.objects if index in _SDO_CHANNELS for subindex in (1, 2)]
    for index, subindex in places:
        value = number_in(dictionary, index, subindex, member.node_id)
        if value is not None and value & _CAN_ID:
            cob_id = value & (_CAN_ID | COB_ID_EXTENDED) if index in _BROADCASTS else value  # bits 30, 31: it produces, consumes
            yield f"0x{index:04X} of {member.name}", cob_id


_SDO_CHANNELS: Final = range(indices.SDO_SERVER_PARAMETER, indices.SDO_CLIENTS.stop)
