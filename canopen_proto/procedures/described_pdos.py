"""The PDOs that a device's own file describes: an EDS by its defaults, a DCF by what it configures.

Theory of operation
-------------------
The PDO parameters of a dictionary (0x1400 to 0x1BFF) say how the device is set up, or is to be. `described_pdos` reads them
there, without asking anybody. `exchange_described` makes them so: what the device has is read first; where it differs, the device
is set up as the file says (`configure_pdo`), and then the PDO is exchanged. A device that was configured before is so only read.

Not all of them are exchanged, but those that serve: every TPDO that carries something we want to hear, and as few RPDOs as carry
what we want to say. An RPDO also carries whatever else is mapped into it; two RPDOs with one object would contradict each other.

What stands in a file and cannot be (an object that is not there, more than 64 bits) is left out: lint tells of it.

Source: CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Final, NamedTuple

from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.frame import COB_ID_INVALID, key_of_cob_id
from canopen_proto.pdo.mapping import MAX_ENTRIES, Mapping, MappingError
from canopen_proto.pdo.settings import COB_ID, TRANSMISSION_TYPE, PdoSettings, place_of
from canopen_proto.procedures.configure_pdo import configure_pdo, read_pdo
from canopen_proto.procedures.steps import Procedure, act
from canopen_proto.remote_node import RemoteNode

EACH_SYNC: Final = 1
CYCLIC_TYPES: Final = range(1, 241)
"""Transmission types that send at every n-th SYNC. CiA 301 v4.2.0, 7.5.2.35."""


def described_pdos(dictionary: ObjectDictionary, node_id: int) -> list[PdoSettings]:
    """The valid PDOs that the dictionary's own records describe for a device of that node-ID, RPDOs first."""
    found = []
    for index in dictionary.objects:
        place = place_of(index)
        if place is None or place.is_mapping:
            continue
        cob_id = _initial(dictionary, index, COB_ID, node_id)
        entries = _entries(dictionary, index + 0x200, node_id)
        if cob_id is not None and not cob_id & COB_ID_INVALID and entries:
            kind = _initial(dictionary, index, TRANSMISSION_TYPE, node_id) or 0
            settings = PdoSettings(place.number, place.direction, cob_id, kind & 0xFF, entries)
            if _mapping_of(settings, dictionary) is not None:
                found.append(settings)
    return found


def choose_pdos(
    pdos: Collection[PdoSettings], commands: Collection[int], feedback: Collection[int]
) -> tuple[list[PdoSettings], list[int]]:
    """The PDOs that serve, and which of `commands` none of them carries. commands, feedback: muxes of what is said and heard."""
    chosen = [pdo for pdo in pdos if pdo.direction is Direction.TPDO and _muxes(pdo) & set(feedback)]
    missing = list(commands)
    candidates = [pdo for pdo in pdos if pdo.direction is Direction.RPDO]
    while missing and candidates:
        best = max(candidates, key=lambda pdo: (sum(mux in _muxes(pdo) for mux in missing), -len(pdo.entries), -pdo.number))
        served = [mux for mux in missing if mux in _muxes(best)]
        if not served:
            break
        chosen.append(best)
        missing = [mux for mux in missing if mux not in served]
        said = set(served)
        candidates = [pdo for pdo in candidates if not said & _muxes(pdo)]
    return chosen, missing


class Exchanged(NamedTuple):
    """What `exchange_described` has done. missing: muxes of commands that no RPDO carries."""

    pdos: list[PdoSettings]
    missing: list[int]

    @property
    def cyclic(self) -> dict[int, int]:
        """What the device sends at SYNCs, unasked: mux -> at every how many of them."""
        tpdos = (each for each in self.pdos if each.direction is Direction.TPDO and each.transmission_type in CYCLIC_TYPES)
        cyclic: dict[int, int] = {}
        for tpdo in tpdos:
            for mux in _muxes(tpdo):
                cyclic[mux] = min(tpdo.transmission_type, cyclic.get(mux, CYCLIC_TYPES.stop))
        return cyclic


def exchange_described(node: RemoteNode, commands: Collection[int], feedback: Collection[int]) -> Procedure[Exchanged]:
    """Exchange the PDOs of the node's dictionary that serve; see `choose_pdos`.

    The node should be pre-operational: most devices take new settings only then. An RPDO is not sent before
    `RemoteNode.enable_rpdo`; one that acts at once when it comes (types 254 and 255) is sent at each SYNC all the same. Raises
    SdoFailed, StrangePdo and UnexpectedLength where the device's settings cannot be read, PdoRefused where it does not take
    the file's.
    """
    chosen, missing = choose_pdos(described_pdos(node.dictionary, node.node_id), commands, feedback)
    for settings in chosen:
        present = yield from read_pdo(node, settings.direction, settings.number)
        if present != settings:
            yield from configure_pdo(node, settings)
        yield from act(lambda now, settings=settings: _exchange(node, settings, now))  # type: ignore[misc]
    return Exchanged(chosen, missing)


def _exchange(node: RemoteNode, settings: PdoSettings, now: int) -> None:
    mapping, key = _mapping_of(settings, node.dictionary), key_of_cob_id(settings.cob_id)
    assert mapping is not None  # described_pdos has looked
    if settings.direction is Direction.TPDO:
        node.add_tpdo(settings.number, key, mapping, now)
    else:
        kind = settings.transmission_type
        node.add_rpdo(settings.number, key, mapping, kind if kind in CYCLIC_TYPES else EACH_SYNC)


def _mapping_of(settings: PdoSettings, dictionary: ObjectDictionary) -> Mapping | None:
    try:
        return Mapping.from_parameters(settings.entries, dictionary)
    except MappingError:
        return None


def _entries(dictionary: ObjectDictionary, index: int, node_id: int) -> tuple[int, ...]:
    """The mapping; nothing where an entry is not there, or is none."""
    count = _initial(dictionary, index, 0, node_id) or 0
    if not 0 < count <= MAX_ENTRIES:
        return ()
    entries = [_initial(dictionary, index, subindex, node_id) for subindex in range(1, count + 1)]
    return tuple(entry for entry in entries if entry) if all(entries) else ()


def _initial(dictionary: ObjectDictionary, index: int, subindex: int, node_id: int) -> int | None:
    variable = dictionary.get(index, subindex)
    value = None if variable is None else variable.initial_of(node_id)
    return value if isinstance(value, int) else None


def _muxes(pdo: PdoSettings) -> set[int]:
    return {entry >> 8 for entry in pdo.entries}
