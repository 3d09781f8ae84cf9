"""The PDOs with the device's own settings, compared with those that its dictionary describes.

The device's mapping decides what the bytes of a PDO mean. If the file says something else, values would be wrong and nobody would
notice. So the device's own mapping is read and used, and each difference is reported.

Source: CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.frame import COB_ID_INVALID, key_of_cob_id
from canopen_proto.machine import Time
from canopen_proto.multiplexer import mapped
from canopen_proto.pdo.configure import PdoNode, StrangePdo, check_rpdo, read_pdo
from canopen_proto.pdo.described import CYCLIC_TYPES, EACH_SYNC, described_pdos, read_commanded
from canopen_proto.pdo.mapping import Mapping, MappingError, entries_of
from canopen_proto.pdo.settings import PdoSettings, place_of
from canopen_proto.procedures.objects import ABSENT
from canopen_proto.procedures.steps import Procedure, SdoFailed, act


@dataclass(frozen=True, slots=True)
class PdoDifference:
    """A PDO whose settings in the device differ from its dictionary's. None: not valid, or not there."""

    direction: Direction
    number: int
    described: PdoSettings | None
    present: PdoSettings | None

    def __str__(self) -> str:
        return f"{self.direction} {self.number} is {_text(self.present)}; the file says {_text(self.described)}"


def exchange_device_pdos(node: PdoNode) -> Procedure[tuple[PdoDifference, ...]]:
    """Exchange the PDOs that the dictionary has records for, with the device's settings; return where the dictionary differs.

    A TPDO is received from now on. For an RPDO, the present values of its objects are read first, so that it sends these once it
    is enabled (`RemoteNode.enable_rpdo`); until then it is not sent. A PDO that maps objects which the dictionary lacks is
    exchanged too; they become unsigned numbers. MPDOs are left out. Raises SdoFailed if the device does not answer; StrangePdo,
    UnexpectedLength.
    """
    described = {(pdo.direction, pdo.number): pdo for pdo in described_pdos(node.dictionary, node.node_id)}
    differences = []
    for direction, number in _records(node.dictionary):
        try:
            present = _if_valid((yield from read_pdo(node, direction, number)))
        except SdoFailed as failed:
            if failed.abort_code not in ABSENT:
                raise
            present = None
        except StrangePdo:
            continue  # an MPDO, or impossible settings: there is no mapping to use
        wanted = described.get((direction, number))
        if _place_and_objects(present) != _place_and_objects(wanted):
            differences.append(PdoDifference(direction, number, wanted, present))
        if present is not None:
            yield from _exchange(node, present)
    return tuple(differences)


def _records(dictionary: ObjectDictionary) -> Iterator[tuple[Direction, int]]:
    for index in dictionary.objects:
        place = place_of(index)
        if place is not None and not place.is_mapping:
            yield place.direction, place.number


def _if_valid(settings: PdoSettings) -> PdoSettings | None:
    return None if settings.cob_id & COB_ID_INVALID or not settings.entries else settings


def _place_and_objects(settings: PdoSettings | None) -> object:
    return None if settings is None else (key_of_cob_id(settings.cob_id), settings.entries)


def _exchange(node: PdoNode, settings: PdoSettings) -> Procedure[None]:
    try:
        mapping = Mapping(entries_of(settings.entries, node.dictionary))
    except MappingError as error:
        raise StrangePdo(f"{settings.direction} {settings.number} of node {node.node_id}: {error}") from error
    check_rpdo(node, settings)
    key, kind = key_of_cob_id(settings.cob_id), settings.transmission_type
    if settings.direction is Direction.TPDO:

        def receive(now: Time) -> None:
            node.add_tpdo(settings.number, key, mapping, now)

        yield from act(receive)
        return
    yield from read_commanded(node, mapping.muxes)
    yield from act(lambda now: node.add_rpdo(settings.number, key, mapping, kind if kind in CYCLIC_TYPES else EACH_SYNC))


def _text(settings: PdoSettings | None) -> str:
    if settings is None:
        return "not in use"
    objects = ", ".join(f"{index:04X}:{subindex:02X}/{bits}" for index, subindex, bits in map(mapped, settings.entries))
    return f"0x{key_of_cob_id(settings.cob_id) & 0x1FFF_FFFF:X} with {objects}"
