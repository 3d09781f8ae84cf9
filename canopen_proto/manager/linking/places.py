"""The PDOs of the nodes that carry the links: which one of a device, with which transmission type.

A PDO that somebody else sets up (`Member.used`) stays as it is; if it sends what a link wants, the link's receivers listen to it.
Of the others the best one loses nothing: the file does not use it, or a link wants all that it carries. As good is an RPDO that
would set an object which a link feeds: it has to go anyway. The rest comes last. A PDO with a fixed mapping is usable if it has
just the entries that a link wants.

Source: CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from canopen_proto.cob_id import check_can_id
from canopen_proto.dictionary import Direction, Variable
from canopen_proto.frame import COB_ID_EXTENDED, COB_ID_INVALID
from canopen_proto.manager.linking.model import Member, Timing
from canopen_proto.multiplexer import Mux
from canopen_proto.pdo.consumer import LAST_SYNCHRONOUS
from canopen_proto.pdo.described import EACH_SYNC, muxes_of
from canopen_proto.pdo.settings import EVENT_TIMER, INHIBIT_TIME, TRANSMISSION_TYPE, PdoSettings, communication_index
from canopen_proto.pdo.slots import EVENT_DRIVEN, Slot, has_sync, slots_of


class Chosen(NamedTuple):
    """A PDO of a node for a link. is_shared: somebody else sets it up."""

    member: Member
    slot: Slot
    transmission_type: int
    entries: tuple[int, ...]
    is_shared: bool = False


class Places:
    """The PDOs of all nodes, and which of them are taken. fed: by node, the objects that links feed."""

    def __init__(self, members: Sequence[Member], fed: Mapping[str, set[Mux]]) -> None:
        self._fed = fed
        self._slots = {each.name: slots_of(each.dictionary, each.node_id) for each in members}
        self._taken = {(each.name, pdo.direction, pdo.number) for each in members for pdo in each.used}
        self._shared: set[tuple[str, int]] = set()

    def room(self, node: str) -> int:
        """Return the most entries that a free RPDO of a node can have."""
        return max((slot.capacity for slot in self.free(node, Direction.RPDO)), default=0)

    def free(self, node: str, direction: Direction) -> list[Slot]:
        """Return the PDOs of a node that are not taken."""
        slots = self._slots[node]
        return [slot for slot in slots if slot.direction is direction and (node, direction, slot.number) not in self._taken]

    def ready(self, member: Member, wanted: set[int], timing: Timing) -> Chosen | None:
        """Take a TPDO that carries one of these entries as it is. Somebody else sets it up, or all TPDOs of the device have fixed
        mappings. Returns None if there is none."""
        for pdo in member.used:
            key = (member.name, pdo.number)
            if (
                pdo.direction is Direction.TPDO
                and key not in self._shared
                and wanted & set(pdo.entries)
                and _has_timing(pdo, timing)
            ):
                self._shared.add(key)
                slot = Slot(pdo.direction, pdo.number, pdo.cob_id, pdo.transmission_type, pdo.entries, 0, True, True, False)
                return Chosen(member, slot, pdo.transmission_type, pdo.entries, is_shared=True)
        free = self.free(member.name, Direction.TPDO)
        for slot in () if any(slot.capacity for slot in free) else free:
            if wanted & set(slot.entries) and isinstance(chosen := self.take(member, slot, slot.entries, timing), Chosen):
                return chosen
        return None

    def take(self, member: Member, slot: Slot, entries: tuple[int, ...], timing: Timing) -> Chosen | str:
        """Take a PDO. Returns its obstacle, if it cannot be used: "a fixed mapping"."""
        kind = _transmission_type(member, slot, timing)
        if obstacle := _obstacle(member, slot, entries, timing):
            return obstacle
        if kind is None:
            return f"no transmission type {EVENT_DRIVEN[-1] if timing.is_event_driven else timing.every}"
        self._taken.add((member.name, slot.direction, slot.number))
        return Chosen(member, slot, kind, entries)

    def as_fixed(self, node: str, entries: tuple[int, ...]) -> tuple[int, ...]:
        """Return these entries in the order that a fixed mapping of a free RPDO has; as they are if there is none with them."""
        fixed = [slot.entries for slot in self.free(node, Direction.RPDO) if not slot.capacity]
        return next((each for each in fixed if sorted(each) == sorted(entries)), entries)

    def choose(self, member: Member, direction: Direction, entries: tuple[int, ...], timing: Timing) -> Chosen | str:
        """Take the best PDO of a node for these entries. Returns why there is none, if so."""
        if direction is Direction.TPDO and timing.every and not has_sync(member.dictionary):
            return "the device does not listen to SYNC (no 0x1005); an event-driven link may do"
        obstacles: dict[str, list[str]] = {}
        for slot in sorted(self.free(member.name, direction), key=lambda slot: self._rank(member, slot, entries)):
            chosen = self.take(member, slot, entries, timing)
            if isinstance(chosen, Chosen):
                return chosen
            obstacles.setdefault(chosen, []).append(slot.name)
        if obstacles:
            return "; ".join(f"{obstacle} ({', '.join(sorted(names))})" for obstacle, names in obstacles.items())
        has_any = any(slot.direction is direction for slot in self._slots[member.name])
        return f"its {direction}s are all taken" if has_any else f"its file describes no {direction}"

    def _rank(self, member: Member, slot: Slot, entries: tuple[int, ...]) -> tuple[int, int, int, int]:
        wanted = muxes_of(entries)
        is_lost = slot.direction is Direction.RPDO and slot.muxes & self._fed.get(member.name, set())
        if slot.is_valid and slot.entries == entries:
            rank = 0
        elif not slot.is_valid or slot.muxes <= wanted or is_lost:
            rank = 1
        else:
            rank = 3 if slot.is_ours else 2
        return rank, -len(slot.muxes & wanted), 0 if slot.can_move else 1, slot.number


def _has_timing(pdo: PdoSettings, timing: Timing) -> bool:
    """Return whether a PDO is sent as a link wants it, without a change."""
    if pdo.cob_id & (COB_ID_INVALID | COB_ID_EXTENDED) or timing.inhibit_time or timing.event_timer:
        return False
    return pdo.transmission_type in (EVENT_DRIVEN if timing.is_event_driven else (timing.every,))


def _obstacle(member: Member, slot: Slot, entries: tuple[int, ...], timing: Timing) -> str:
    """Return why a PDO cannot have these entries and times; empty if it can."""
    if slot.capacity < len(entries) and slot.entries != entries:
        return f"room for {slot.capacity} objects only" if slot.capacity else "a fixed mapping"
    if not slot.can_move and (not slot.is_valid or slot.cob_id & COB_ID_EXTENDED or check_can_id(slot.cob_id) is not None):
        return f"a fixed COB-ID, 0x{slot.cob_id:X}"
    if slot.direction is Direction.RPDO:
        times = [(EVENT_TIMER, timing.timeout, "event timer, to watch for a timeout")]
    else:
        times = [(INHIBIT_TIME, timing.inhibit_time, "inhibit time"), (EVENT_TIMER, timing.event_timer, "event timer")]
    for subindex, time, name in times:
        variable = _field(member, slot, subindex)
        if time and (variable is None or not variable.access.writable):
            return f"no {name} that can be written, subindex {subindex}"
    return ""


def _transmission_type(member: Member, slot: Slot, timing: Timing) -> int | None:
    """Return the transmission type for a link's PDO; None if it cannot have one that fits."""
    at_once = (*(kind for kind in EVENT_DRIVEN if kind == slot.transmission_type), *reversed(EVENT_DRIVEN))
    if timing.is_event_driven:
        wanted = at_once
    elif slot.direction is Direction.TPDO:
        wanted = (timing.every,) if has_sync(member.dictionary) else ()
    else:  # any of 1 to 240 takes effect at the next SYNC; a device without SYNC obeys at once
        wanted = (timing.every, EACH_SYNC, *at_once) if has_sync(member.dictionary) else at_once
    variable = _field(member, slot, TRANSMISSION_TYPE)
    if variable is not None and variable.access.writable:
        return next((kind for kind in wanted if _may_be(variable, kind)), None)
    is_synchronous = slot.direction is Direction.RPDO and EACH_SYNC in wanted and slot.transmission_type <= LAST_SYNCHRONOUS
    return slot.transmission_type if slot.transmission_type in wanted or is_synchronous else None


def _may_be(variable: Variable, value: int) -> bool:
    low, high = variable.low_limit, variable.high_limit
    if low is not None and high is not None and low > high:  # no limits
        return True
    return (low is None or low <= value) and (high is None or value <= high)


def _field(member: Member, slot: Slot, subindex: int) -> Variable | None:
    return member.dictionary.get(communication_index(slot.direction, slot.number), subindex)
