"""The PDOs of the nodes that carry the links: which one of a device, with which transmission type.

A PDO that somebody else sets up (`KnownNode.used`) stays as it is; if it sends what a link wants, the link's receivers listen to
it. Of the others the best one loses nothing: the file does not use it, or a link wants all that it carries. As good is an RPDO
that would set an object which a link feeds: it has to go anyway. The rest comes last. A PDO with a fixed mapping is usable if it
has just the entries that a link wants.

Source: CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from canopen_proto.cob_id import check_can_id
from canopen_proto.dictionary import Direction, Variable
from canopen_proto.explained import counted
from canopen_proto.frame import COB_ID_EXTENDED, COB_ID_INVALID
from canopen_proto.manager.linking.model import KnownNode, LinkedPdo, Timing
from canopen_proto.multiplexer import Mux
from canopen_proto.pdo.consumer import LAST_SYNCHRONOUS
from canopen_proto.pdo.settings import (
    EACH_SYNC,
    EVENT_DRIVEN,
    EVENT_TIMER,
    INHIBIT_TIME,
    TRANSMISSION_TYPE,
    PdoSettings,
    communication_index,
    muxes_of,
)
from canopen_proto.pdo.slots import PdoSlot, has_sync, slots_of


class Places:
    """The PDOs of all nodes, and which of them are taken. fed: by node, the objects that links feed. members: the nodes with a
    file."""

    def __init__(self, members: Sequence[KnownNode], fed: Mapping[str, set[Mux]]) -> None:
        self._fed = fed
        self._slots = {each.name: slots_of(each.dictionary, each.node_id) for each in members}
        self._taken = {(each.name, *pdo.place) for each in members for pdo in each.used}
        self._shared: set[tuple[str, int]] = set()

    def room(self, node: str) -> int:
        """Return the most entries that a free RPDO of a node can have."""
        return max((slot.capacity for slot in self.free(node, Direction.RPDO)), default=0)

    def free(self, node: str, direction: Direction) -> list[PdoSlot]:
        """Return the PDOs of a node that are not taken. direction: as the node sees it."""
        slots = [slot for slot in self._slots[node] if slot.pdo.direction is direction]
        return [slot for slot in slots if (node, *slot.pdo.place) not in self._taken]

    def ready(self, member: KnownNode, wanted: set[int], timing: Timing) -> LinkedPdo | None:
        """Take a TPDO that carries one of these entries as it is. Somebody else sets it up, or all TPDOs of the device have fixed
        mappings. Returns None if there is none. wanted: mapping entries. timing: of the link."""
        for pdo in member.used:
            key = (member.name, pdo.number)
            if (
                pdo.direction is Direction.TPDO
                and key not in self._shared
                and wanted & set(pdo.entries)
                and _has_timing(pdo, timing)
            ):
                self._shared.add(key)
                return LinkedPdo(member, pdo, PdoSlot(pdo, 0, is_described=True, is_ours=True, can_move=False), is_shared=True)
        free = self.free(member.name, Direction.TPDO)
        for slot in () if any(slot.capacity for slot in free) else free:
            entries = slot.pdo.entries
            if wanted & set(entries) and isinstance(chosen := self.take(member, slot, entries, timing), LinkedPdo):
                return chosen
        return None

    def take(self, member: KnownNode, slot: PdoSlot, entries: tuple[int, ...], timing: Timing) -> LinkedPdo | str:
        """Take a PDO, with the COB-ID of the file for now. Returns its obstacle, if it cannot be used: "a fixed mapping". slot:
        which PDO. entries: its new mapping. timing: of the link."""
        kind = _transmission_type(member, slot, timing)
        if obstacle := _obstacle(member, slot, entries, timing):
            return obstacle
        if kind is None:
            return f"no transmission type {EVENT_DRIVEN[-1] if timing.is_event_driven else timing.every}"
        self._taken.add((member.name, *slot.pdo.place))
        sends = slot.pdo.direction is Direction.TPDO
        settings = replace(
            slot.pdo,
            transmission_type=kind,
            entries=entries,
            inhibit_time=(sends and timing.inhibit_time) or None,
            event_time=(timing.event_timer if sends else timing.timeout) or None,
        )
        return LinkedPdo(member, settings, slot)

    def as_fixed(self, node: str, entries: tuple[int, ...]) -> tuple[int, ...]:
        """Return these entries in the order that a fixed mapping of a free RPDO has; as they are if there is none with them."""
        fixed = [slot.pdo.entries for slot in self.free(node, Direction.RPDO) if not slot.capacity]
        return next((each for each in fixed if sorted(each) == sorted(entries)), entries)

    def choose(self, member: KnownNode, direction: Direction, entries: tuple[int, ...], timing: Timing) -> LinkedPdo | str:
        """Take the best PDO of a node for these entries. Returns why there is none, if so. direction: as the node sees it.
        timing: of the link."""
        if direction is Direction.TPDO and timing.every and not has_sync(member.dictionary):
            return "the device does not listen to SYNC (no 0x1005); an event-driven link may do"
        obstacles: dict[str, list[str]] = {}
        for slot in sorted(self.free(member.name, direction), key=lambda slot: self._rank(member, slot, entries)):
            chosen = self.take(member, slot, entries, timing)
            if isinstance(chosen, LinkedPdo):
                return chosen
            obstacles.setdefault(chosen, []).append(slot.pdo.name)
        if obstacles:
            return "; ".join(f"{obstacle} ({', '.join(sorted(names))})" for obstacle, names in obstacles.items())
        has_any = any(slot.pdo.direction is direction for slot in self._slots[member.name])
        return f"its {direction}s are all taken" if has_any else f"its file describes no {direction}"

    def _rank(self, member: KnownNode, slot: PdoSlot, entries: tuple[int, ...]) -> tuple[int, int, int, int]:
        pdo, wanted = slot.pdo, muxes_of(entries)
        is_lost = pdo.direction is Direction.RPDO and pdo.muxes & self._fed.get(member.name, set())
        if pdo.is_valid and pdo.entries == entries:
            rank = 0
        elif not pdo.is_valid or pdo.muxes <= wanted or is_lost:
            rank = 1
        else:
            rank = 3 if slot.is_ours else 2
        return rank, -len(pdo.muxes & wanted), 0 if slot.can_move else 1, pdo.number


def _has_timing(pdo: PdoSettings, timing: Timing) -> bool:
    """Return whether a PDO is sent as a link wants it, without a change."""
    if pdo.cob_id & (COB_ID_INVALID | COB_ID_EXTENDED) or timing.inhibit_time or timing.event_timer:
        return False
    return pdo.transmission_type in (EVENT_DRIVEN if timing.is_event_driven else (timing.every,))


def _obstacle(member: KnownNode, slot: PdoSlot, entries: tuple[int, ...], timing: Timing) -> str:
    """Return why a PDO cannot have these entries and times; empty if it can."""
    pdo = slot.pdo
    if slot.capacity < len(entries) and pdo.entries != entries:
        return f"room for {counted(slot.capacity, 'object')} only" if slot.capacity else "a fixed mapping"
    if not slot.can_move and (not pdo.is_valid or pdo.cob_id & COB_ID_EXTENDED or check_can_id(pdo.cob_id) is not None):
        return f"a fixed COB-ID, 0x{pdo.cob_id:X}"
    if pdo.direction is Direction.RPDO:
        times = [(EVENT_TIMER, timing.timeout, "event timer, to watch for a timeout")]
    else:
        times = [(INHIBIT_TIME, timing.inhibit_time, "inhibit time"), (EVENT_TIMER, timing.event_timer, "event timer")]
    for subindex, time, name in times:
        variable = _field(member, slot, subindex)
        if time and (variable is None or not variable.access.writable):
            return f"no {name} that can be written, subindex {subindex}"
    return ""


def _transmission_type(member: KnownNode, slot: PdoSlot, timing: Timing) -> int | None:
    """Return the transmission type for a link's PDO; None if it cannot have one that fits."""
    direction, present = slot.pdo.direction, slot.pdo.transmission_type
    at_once = (*(kind for kind in EVENT_DRIVEN if kind == present), *reversed(EVENT_DRIVEN))
    if timing.is_event_driven:
        wanted = at_once
    elif direction is Direction.TPDO:
        wanted = (timing.every,) if has_sync(member.dictionary) else ()
    else:  # any of 1 to 240 takes effect at the next SYNC; a device without SYNC obeys at once
        wanted = (timing.every, EACH_SYNC, *at_once) if has_sync(member.dictionary) else at_once
    variable = _field(member, slot, TRANSMISSION_TYPE)
    if variable is not None and variable.access.writable:
        return next((kind for kind in wanted if variable.may_be(kind)), None)
    is_synchronous = direction is Direction.RPDO and EACH_SYNC in wanted and present <= LAST_SYNCHRONOUS
    return present if present in wanted or is_synchronous else None


def _field(member: KnownNode, slot: PdoSlot, subindex: int) -> Variable | None:
    return member.dictionary.get(communication_index(*slot.pdo.place), subindex)
