"""Read the PDOs of a node, with their times, and say in words when they are sent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final, NamedTuple

from canopen_master.master import Master
from canopen_master.node import Node, number_if_present
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.frame import can_id_of
from canopen_proto.machine import MILLISECOND
from canopen_proto.multiplexer import mapped
from canopen_proto.pdo.configure import InvalidPdoError, read_pdo
from canopen_proto.pdo.mapping import LAST_DUMMY_INDEX
from canopen_proto.pdo.settings import (
    CYCLIC_TYPES,
    EVENT_TIMER,
    INHIBIT_TIME,
    INHIBIT_UNIT,
    MAX_PDOS,
    SYNC_START,
    PdoSettings,
    communication_index,
    places_of,
)
from canopen_proto.procedures.objects import ABSENT, unless_refused

_TYPES: Final = {
    (Direction.TPDO, 0): "at a SYNC after a change",
    (Direction.TPDO, 252): "on request, as of the last SYNC",
    (Direction.TPDO, 253): "on request",
    (Direction.TPDO, 254): "by events of the maker",
    (Direction.TPDO, 255): "by events",
    (Direction.RPDO, 254): "at once",
    (Direction.RPDO, 255): "at once",
}


class PdoRead(NamedTuple):
    """A PDO of a device. settings: with its times, None where the device has none. sync_start: the SYNC counter at which it
    begins, None: not there. remark: why there are no settings."""

    direction: Direction
    number: int
    settings: PdoSettings | None
    sync_start: int | None = None
    remark: str = ""

    @property
    def name(self) -> str:
        """The PDO for people."""
        return f"{self.direction} {self.number}"

    def as_json(self, dictionary: ObjectDictionary) -> dict[str, Any]:
        """Return the PDO as plain data."""
        known: dict[str, Any] = {"pdo": self.name, "remark": self.remark or None}
        pdo = self.settings
        if pdo is None:
            return known
        return known | {
            "valid": pdo.is_valid,
            "can_id": can_id_of(pdo.key),
            "cob_id": pdo.cob_id,
            "transmission_type": pdo.transmission_type,
            "sent": type_text(pdo),
            "inhibit_time_ms": None if pdo.inhibit_time is None else pdo.inhibit_time / MILLISECOND,
            "event_timer_ms": None if pdo.event_time is None else pdo.event_time / MILLISECOND,
            "sync_start": self.sync_start,
            "bytes": pdo.size,
            "objects": [
                {"index": index, "sub": subindex, "bits": bits, "name": object_name(dictionary, index, subindex)}
                for index, subindex, bits in map(mapped, pdo.entries)
            ],
        }


async def read_pdos(master: Master, node: Node, dictionary: ObjectDictionary | None = None) -> list[PdoRead]:
    """Read all PDOs of a node, RPDOs first: those that its file has, else one after the other until it has no further one.

    dictionary: that of its own file; None: there is none. Raises what reading an object raises.
    """
    found: list[PdoRead] = []
    for direction, number, is_listed in _places(dictionary):
        if not is_listed and number > 1 and (not found or found[-1][:2] != (direction, number - 1)):
            continue  # it has no further one
        each = await read_one(master, node, direction, number)
        if each is not None:
            found.append(each)
    return found


def _places(dictionary: ObjectDictionary | None) -> Iterator[tuple[Direction, int, bool]]:
    if dictionary is not None and (listed := sorted(places_of(dictionary.objects), key=lambda each: (each[0].value, each[1]))):
        yield from ((direction, number, True) for direction, number in listed)
        return
    for direction in Direction:
        yield from ((direction, number, False) for number in range(1, MAX_PDOS + 1))


async def read_one(master: Master, node: Node, direction: Direction, number: int) -> PdoRead | None:
    """Read one PDO of a node, with its times; None if the device has none of this number."""
    try:
        settings = await master.run(unless_refused(read_pdo(node.remote, direction, number), ABSENT))
    except InvalidPdoError as strange:  # multiplexed, or impossible
        return PdoRead(direction, number, None, remark=str(strange))
    if settings is None:
        return None
    index = communication_index(direction, number)
    inhibit, timer, start = [await number_if_present(node, index, each) for each in (INHIBIT_TIME, EVENT_TIMER, SYNC_START)]
    settings = replace(
        settings,
        inhibit_time=None if inhibit is None else inhibit * INHIBIT_UNIT,
        event_time=None if timer is None else timer * MILLISECOND,
    )
    return PdoRead(direction, number, settings, start if direction is Direction.TPDO else None)


def type_text(pdo: PdoSettings) -> str:
    """Return in words when a PDO is sent, or acts."""
    kind = pdo.transmission_type
    if (pdo.direction, kind) in _TYPES:
        return _TYPES[pdo.direction, kind]
    if pdo.direction is Direction.RPDO and (kind == 0 or kind in CYCLIC_TYPES):
        return "at the next SYNC"
    if kind in CYCLIC_TYPES:
        return "at each SYNC" if kind == 1 else f"at every {kind} SYNCs"
    return "reserved"


def times_text(read: PdoRead) -> str:
    """Return the times of a PDO that are set."""
    pdo = read.settings
    parts = []
    if pdo is not None and pdo.event_time:
        each = f"each {pdo.event_time / MILLISECOND:g} ms"
        parts.append(f"{each} at the latest" if pdo.direction is Direction.TPDO else f"expected {each}")
    if pdo is not None and pdo.inhibit_time:
        parts.append(f"not within {pdo.inhibit_time / MILLISECOND:g} ms of the last one")
    if read.sync_start:
        parts.append(f"from SYNC {read.sync_start} on")
    return ", ".join(parts)


def object_name(dictionary: ObjectDictionary, index: int, subindex: int) -> str:
    """Return the name of a mapped object: in the dictionary, else in the standard, else its number."""
    if index <= LAST_DUMMY_INDEX:
        return "empty"
    variable = dictionary.get(index, subindex) or find_standard(index, subindex)
    return f"{index:04X}:{subindex:02X}" if variable is None else variable.name


def objects_text(dictionary: ObjectDictionary, pdo: PdoSettings) -> str:
    """Return the objects of a PDO in their order: "6041:00 statusword, 16 bits empty"."""
    words = []
    for index, subindex, bits in map(mapped, pdo.entries):
        place, name = f"{index:04X}:{subindex:02X}", object_name(dictionary, index, subindex)
        variable = dictionary.get(index, subindex)
        part = f"/{bits}" if variable is not None and variable.bit_length not in (None, bits) else ""
        words.append(f"{bits} bits empty" if index <= LAST_DUMMY_INDEX else f"{place}{part}{'' if name == place else ' ' + name}")
    return ", ".join(words) or "nothing"
