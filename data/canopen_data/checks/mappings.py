"""Check PDOs: both records exist, and the device can send or receive the mapping.

PDOs are checked as they are after start-up. Entries beyond the number of mapped objects are reserves and are not checked; a
number of 0xFE or 0xFF makes a multiplexed PDO, which has no mapping.

Source: CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38; CiA 306-1 v1.4.0, PDOMapping, DummyUsage and NrOfRXPDO.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from canopen_data.checks.subject import ERROR, WARNING, Number, Rule, Subject
from canopen_data.findings import Finding
from canopen_proto import indices
from canopen_proto.dictionary.model import Direction, Variable
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.multiplexer import mapped
from canopen_proto.pdo.consumer import LAST_SYNCHRONOUS
from canopen_proto.pdo.mapping import DUMMY_TYPES, LAST_DUMMY_INDEX, MAX_BITS, MAX_ENTRIES, may_have_width
from canopen_proto.pdo.multiplexed import MpdoMode
from canopen_proto.pdo.producer import FIRST_EVENT_DRIVEN, SYNCHRONOUS_ON_REQUEST
from canopen_proto.pdo.settings import COB_ID, TRANSMISSION_TYPE, PdoPlace, communication_index, mapping_index, place_of

RULES: Final = (
    Rule("pdo-no-mapping", WARNING, "a PDO with a communication parameter, but no mapping parameter"),
    Rule("pdo-no-communication", WARNING, "a PDO with a mapping parameter, but no communication parameter"),
    Rule("pdo-entries", ERROR, "more objects are mapped than the mapping parameter has entries"),
    Rule("pdo-gap", ERROR, "an entry of the mapping is empty"),
    Rule("pdo-object", ERROR, "an object is mapped that the device does not have"),
    Rule("pdo-not-mappable", WARNING, "an object is mapped whose PDOMapping is 0"),
    Rule("pdo-access", ERROR, "an object that can only be read is in an RPDO, or one that can only be written in a TPDO"),
    Rule("pdo-direction", WARNING, "an object is mapped against the direction of its access: rwr is for TPDOs, rww for RPDOs"),
    Rule("pdo-bits", ERROR, "an object is mapped with a number of bits that its type cannot have"),
    Rule("pdo-part", WARNING, "an object is mapped with fewer bits than it has"),
    Rule("pdo-long", ERROR, f"a PDO of more than {MAX_BITS} bits"),
    Rule("pdo-dummy", WARNING, "a dummy entry that the device does not take"),
    Rule("transmission-type", WARNING, "a transmission type that is reserved"),
    Rule("sync-missing", WARNING, "a PDO goes by SYNC, but the device has no 0x1005"),
    Rule("pdo-count", WARNING, "the number of PDOs in the head of the file is not the number of PDOs described"),
)

_ONE_WAY: Final = {Direction.RPDO: "rwr", Direction.TPDO: "rww"}
"""The access that belongs to the other direction."""


def check_pdos(subject: Subject) -> Iterator[Finding]:
    """Check every PDO of the file."""
    objects = subject.dictionary.objects
    for index in objects:
        place = place_of(index)
        if place is None:
            continue
        communication, mapping = (each(place.direction, place.number) for each in (communication_index, mapping_index))
        name = f"{place.direction}{place.number}"
        if not place.is_mapping:
            if mapping not in objects:
                yield subject.of_object("pdo-no-mapping", index, f"{name} has no mapping parameter (0x{mapping:04X})")
            yield from _check_transmission_type(subject, place, index)
            continue
        if communication not in objects:
            text = f"{name} has no communication parameter (0x{communication:04X})"
            yield subject.of_object("pdo-no-communication", index, text)
        yield from _check_mapping(subject, place, index)


def _check_transmission_type(subject: Subject, place: PdoPlace, index: int) -> Iterator[Finding]:
    number = subject.number(index, TRANSMISSION_TYPE)
    if number is None:
        return
    variable = subject.dictionary.variable((index, TRANSMISSION_TYPE))
    first = FIRST_EVENT_DRIVEN if place.direction is Direction.RPDO else SYNCHRONOUS_ON_REQUEST
    if LAST_SYNCHRONOUS < number.value < first:
        text = f"transmission type {number.value} is reserved for {place.direction}s"
        yield subject.of_value("transmission-type", variable, text)
    elif number.value <= LAST_SYNCHRONOUS and indices.COB_ID_SYNC not in subject.dictionary.objects and is_valid(subject, index):
        yield subject.of_value("sync-missing", variable, "the PDO goes by SYNC, but there is no COB-ID SYNC (0x1005)")


def is_valid(subject: Subject, communication: int) -> bool:
    """Return whether a PDO exists after start-up: bit 31 of its COB-ID is 0. communication: the index of its communication
    record."""
    cob_id = subject.number(communication, COB_ID)
    return cob_id is not None and not cob_id.value & COB_ID_INVALID


def entries_of(subject: Subject, mapping: int) -> list[tuple[Variable, Number]]:
    """Return the entries of a mapping that are in use and that the file gives."""
    count = subject.number(mapping)
    found = []
    for subindex in range(1, (0 if count is None else min(count.value, MAX_ENTRIES)) + 1):
        entry = subject.number(mapping, subindex)
        if entry is not None:
            found.append((subject.dictionary.variable((mapping, subindex)), entry))
    return found


def _check_mapping(subject: Subject, place: PdoPlace, index: int) -> Iterator[Finding]:
    count = subject.number(index)
    if count is None or count.value in (MpdoMode.SOURCE, MpdoMode.DESTINATION):
        return
    standing = subject.dictionary.objects[index].variables
    held = sum(1 for subindex in standing if 1 <= subindex <= MAX_ENTRIES)
    if count.value > held:
        text = f"sub 0 is {count.value}, but there are {held} entries"
        yield subject.of_value("pdo-entries", standing[0], text)
    bits = 0
    for variable, entry in entries_of(subject, index):
        bits += mapped(entry.value)[2]
        yield from _check_entry(subject, place, variable, entry.value)
    if bits > MAX_BITS:
        text = f"{place.direction}{place.number} has {bits} bits; {MAX_BITS} is the most"
        yield subject.of_value("pdo-long", standing[0], text)


def _check_entry(subject: Subject, place: PdoPlace, variable: Variable, entry: int) -> Iterator[Finding]:
    index, subindex, bits = mapped(entry)
    if entry == 0:
        yield subject.of_value("pdo-gap", variable, "the entry is counted, but maps nothing")
        return
    if index <= LAST_DUMMY_INDEX:
        yield from _check_dummy(subject, place, variable, entry)
        return
    target = subject.dictionary.get(index, subindex)
    where = f"0x{entry:08X} maps {index:04X}:{subindex:02X}"
    if target is None:
        yield subject.of_value("pdo-object", variable, f"{where}, which is not in the file")
        return
    where = f"{where} ({target.name})"
    into = "an RPDO" if place.direction is Direction.RPDO else "a TPDO"
    if not (target.access.writable if place.direction is Direction.RPDO else target.access.readable):
        yield subject.of_value("pdo-access", variable, f"{where} into {into}, but it is {target.access}")
    elif target.access == _ONE_WAY[place.direction]:
        yield subject.of_value("pdo-direction", variable, f"{where} into {into}, but it is {target.access}")
    elif not target.pdo_mappable:
        yield subject.of_value("pdo-not-mappable", variable, f"{where}, whose PDOMapping is 0")
    if not may_have_width(target.data_type, bits):
        has = "cannot be mapped so" if target.bit_length is None else f"has {target.bit_length}"
        text = f"{where} with {bits} bits; its type {target.data_type.name} {has}"
        yield subject.of_value("pdo-bits", variable, text)
    elif target.bit_length is not None and bits < target.bit_length:
        yield subject.of_value("pdo-part", variable, f"{where} with {bits} bits; it has {target.bit_length}")


def _check_dummy(subject: Subject, place: PdoPlace, variable: Variable, entry: int) -> Iterator[Finding]:
    index, subindex, bits = mapped(entry)
    data_type = DUMMY_TYPES.get(index)
    dummies = subject.description.dummies
    where = f"0x{entry:08X}"
    if data_type is None or subindex or not may_have_width(data_type, bits):
        yield subject.of_value("pdo-dummy", variable, f"{where} is not a dummy entry: no such data type of so many bits")
    elif place.direction is Direction.TPDO:
        yield subject.of_value(
            "pdo-dummy", variable, f"{where} is a dummy entry ({data_type.name}) in a TPDO; they are for RPDOs"
        )
    elif dummies is not None and not dummies.get(index, False):
        text = f"{where} is a dummy entry, but [DummyUsage] does not allow {data_type.name} (Dummy{index:04X}=0)"
        yield subject.of_value("pdo-dummy", variable, text)


def check_pdo_counts(subject: Subject) -> Iterator[Finding]:
    """Check NrOfRXPDO and NrOfTXPDO of [DeviceInfo] against the records in the file."""
    info = subject.description.device_info
    for direction, told, entry in (
        (Direction.RPDO, info.rpdo_count, "NrOfRXPDO"),
        (Direction.TPDO, info.tpdo_count, "NrOfTXPDO"),
    ):
        places = (place_of(index) for index in subject.dictionary.objects)
        found = sum(1 for place in places if place is not None and place.direction is direction and not place.is_mapping)
        if told is not None and told != found:
            text = f"{entry}={told}, but the file has {found} {direction} communication parameters"
            yield subject.of_entry("pdo-count", "DeviceInfo", entry, text)


CHECKS: Final[tuple[Callable[[Subject], Iterator[Finding]], ...]] = (check_pdos, check_pdo_counts)
