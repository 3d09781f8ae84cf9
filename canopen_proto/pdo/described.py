"""The PDOs that a device's own file describes: an EDS by its defaults, a DCF by its configured values.

The PDO parameters of a dictionary (0x1400 to 0x1BFF) say which settings the device has, or shall have. `described_pdos` reads
them from the dictionary and sends nothing. `exchange_pdos` first reads the device's settings. If they differ, it writes the ones
that are wanted to the device (`configure_pdo`). Then it exchanges the PDO. So a device that was configured before is only read.

`choose_pdos` takes the useful ones: every TPDO that carries something we want to hear, and as few RPDOs as are needed to carry
our commands. An RPDO also carries all else that is mapped into it; two RPDOs with the same object could contradict each other.

Impossible entries of a file (an object that does not exist, more than 64 bits, a COB-ID that no PDO may have) are left out: lint
reports them.

Source: CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import Final

from canopen_proto.abort import AbortOrigin
from canopen_proto.cob_id import check_can_id
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.frame import COB_ID_INVALID, COB_ID_NO_RTR, key_of_cob_id
from canopen_proto.multiplexer import Mux, mapped, mux, split_mux
from canopen_proto.pdo.configure import PdoNode, configure_pdo, read_pdo
from canopen_proto.pdo.mapping import MAX_ENTRIES, Mapping, MappingError
from canopen_proto.pdo.settings import COB_ID, TRANSMISSION_TYPE, PdoSettings, place_of
from canopen_proto.procedures.objects import read_if_present
from canopen_proto.procedures.steps import Procedure, SdoFailed, act

EACH_SYNC: Final = 1
CYCLIC_TYPES: Final = range(1, 241)
"""Transmission types that send at every n-th SYNC. CiA 301 v4.2.0, 7.5.2.35."""


def described_pdos(dictionary: ObjectDictionary, node_id: int) -> list[PdoSettings]:
    """Return the valid PDOs that the dictionary's records describe for a device with this node-ID, RPDOs first."""
    found = []
    for index in dictionary.objects:
        place = place_of(index)
        if place is None or place.is_mapping:
            continue
        cob_id = _initial(dictionary, index, COB_ID, node_id)
        entries = _entries(dictionary, index + 0x200, node_id)
        if cob_id is not None and not cob_id & COB_ID_INVALID and check_can_id(cob_id) is None and entries:
            kind = _initial(dictionary, index, TRANSMISSION_TYPE, node_id) or 0
            settings = PdoSettings(place.number, place.direction, cob_id, kind & 0xFF, entries)
            if _mapping_of(settings, dictionary) is not None:
                found.append(settings)
    return found


def choose_pdos(
    pdos: Collection[PdoSettings], commands: Collection[Mux], feedback: Collection[Mux]
) -> tuple[list[PdoSettings], list[Mux]]:
    """Return the useful PDOs, and the `commands` that none of them carries. commands, feedback: muxes to send and to hear."""
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


def cyclic_objects(pdos: Iterable[PdoSettings]) -> dict[Mux, int]:
    """Return the objects that a device with these PDOs sends at SYNCs: mux -> n for "at every n-th SYNC"."""
    tpdos = (each for each in pdos if each.direction is Direction.TPDO and each.transmission_type in CYCLIC_TYPES)
    cyclic: dict[Mux, int] = {}
    for tpdo in tpdos:
        for each in _muxes(tpdo):
            cyclic[each] = min(tpdo.transmission_type, cyclic.get(each, CYCLIC_TYPES.stop))
    return cyclic


def exchange_pdos(node: PdoNode, pdos: Iterable[PdoSettings], *, sends_at_sync: bool = True) -> Procedure[None]:
    """Exchange these PDOs with the node; each is configured first if the node's settings differ.

    The node should be Pre-operational: most devices accept new settings only then. An RPDO is not sent before
    `RemoteNode.enable_rpdo`. sends_at_sync: an event-driven RPDO (types 254 and 255), which acts as soon as it comes, is sent at
    each SYNC too; else only when it is triggered. Raises SdoFailed, StrangePdo or UnexpectedLength if the node's settings cannot
    be read; PdoRefused if the node refuses these.
    """
    for settings in pdos:
        present = yield from read_pdo(node, settings.direction, settings.number)
        if not has_settings(present, settings):
            yield from configure_pdo(node, settings)
        yield from act(lambda now, settings=settings: _exchange(node, settings, sends_at_sync, now))  # type: ignore[misc]


def has_settings(present: PdoSettings, wanted: PdoSettings) -> bool:
    """Return whether a PDO of a device is as it is wanted. Bit 30 of the COB-ID does not count: we send no remote requests."""
    return replace(present, cob_id=present.cob_id | COB_ID_NO_RTR) == replace(wanted, cob_id=wanted.cob_id | COB_ID_NO_RTR)


def read_commanded(node: PdoNode, keys: Iterable[Mux]) -> Procedure[None]:
    """Read the present values of objects that an RPDO is going to carry, so that it sends these. 0 is sent for an object that
    cannot be read, such as a write-only command. Call it before the RPDO is exchanged. Raises SdoFailed if nobody answers."""
    for key in keys:
        try:
            yield from read_if_present(node, split_mux(key))
        except SdoFailed as failed:
            if failed.origin is not AbortOrigin.PEER:
                raise


def _exchange(node: PdoNode, settings: PdoSettings, sends_at_sync: bool, now: int) -> None:
    mapping, key = _mapping_of(settings, node.dictionary), key_of_cob_id(settings.cob_id)
    assert mapping is not None  # described_pdos has checked it
    if settings.direction is Direction.TPDO:
        node.add_tpdo(settings.number, key, mapping, now)
    else:
        kind = settings.transmission_type
        node.add_rpdo(settings.number, key, mapping, EACH_SYNC if sends_at_sync and kind not in CYCLIC_TYPES else kind)


def _mapping_of(settings: PdoSettings, dictionary: ObjectDictionary) -> Mapping | None:
    try:
        return Mapping.from_parameters(settings.entries, dictionary)
    except MappingError:
        return None


def _entries(dictionary: ObjectDictionary, index: int, node_id: int) -> tuple[int, ...]:
    """Return the mapping's entries; none at all if one is missing or 0."""
    count = _initial(dictionary, index, 0, node_id) or 0
    if not 0 < count <= MAX_ENTRIES:
        return ()
    entries = [_initial(dictionary, index, subindex, node_id) for subindex in range(1, count + 1)]
    return tuple(entry for entry in entries if entry) if all(entries) else ()


def _initial(dictionary: ObjectDictionary, index: int, subindex: int, node_id: int) -> int | None:
    variable = dictionary.get(index, subindex)
    value = None if variable is None else variable.initial_of(node_id)
    return value if isinstance(value, int) else None


def muxes_of(entries: Iterable[int]) -> set[Mux]:
    """Return the objects that mapping entries name."""
    return {mux(index, subindex) for index, subindex, _ in map(mapped, entries)}


def _muxes(pdo: PdoSettings) -> set[Mux]:
    return muxes_of(pdo.entries)
