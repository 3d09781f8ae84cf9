"""The PDOs of a device under test: find them, and set them up (CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from canopen_check.bench import Bench
from canopen_check.expectations import some
from canopen_proto.datatypes import DataType, ValueRangeError
from canopen_proto.dictionary import Access, Direction, ObjectNotFoundError, Variable
from canopen_proto.frame import COB_ID_INVALID, COB_ID_NO_RTR, RoutingKey, key_of_cob_id
from canopen_proto.indices import COMMUNICATION_AREA
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.multiplexer import mapped, mapping_entry
from canopen_proto.pdo.mapping import MAX_BITS, MAX_ENTRIES, Mapping, MappingError
from canopen_proto.pdo.settings import (
    COB_ID,
    EVENT_TIMER,
    INHIBIT_TIME,
    INHIBIT_UNIT,
    SYNC_START,
    TRANSMISSION_TYPE,
    communication_index,
    mapping_index,
    place_of,
)
from canopen_proto.procedures.steps import Procedure
from canopen_proto.verdict import does_not_apply

PROFILE_EVENTS: Final = 255

_CAN_ID: Final = 0x3FFF_FFFF  # with the frame bit

INTO: Final = {Direction.RPDO: (Access.RWW, Access.WO), Direction.TPDO: (Access.RWR, Access.RO)}
"""The access rights of objects that surely may be mapped in a direction."""


class Pdo(NamedTuple):
    """One PDO of the device."""

    direction: Direction
    number: int

    @property
    def communication(self) -> int:
        """The index of the PDO's communication parameter."""
        return communication_index(self.direction, self.number)

    @property
    def mapping(self) -> int:
        """The index of the PDO's mapping parameter."""
        return mapping_index(self.direction, self.number)

    def __str__(self) -> str:
        return f"{self.direction} {self.number}"


def all_pdos(bench: Bench, *directions: Direction) -> list[Pdo]:
    """Return the PDOs that the dictionary describes; without any, the case does not apply."""
    found = []
    for index in bench.dictionary.objects:
        place = place_of(index)
        if place is not None and not place.is_mapping and place.direction in directions:
            pdo = Pdo(place.direction, place.number)
            if bench.dictionary.get(pdo.communication, COB_ID) is not None:
                found.append(pdo)
    return some(found, f"the dictionary has no {' and no '.join(directions)}")


def usable(bench: Bench, *directions: Direction) -> list[Pdo]:
    """Return the PDOs that have a CAN-ID (valid or not) and a mapping by default, and can be set up."""
    found = [
        pdo
        for pdo in all_pdos(bench, *directions)
        if bench.default(pdo.communication, COB_ID) & _CAN_ID
        and 0 < bench.default(pdo.mapping) <= MAX_ENTRIES
        and 0 < length_of(bench, pdo) <= MAX_BITS // 8
    ]
    found = some(found, f"no {' and no '.join(directions)} has a CAN-ID and a mapping by default")
    settable = [pdo for pdo in found if has(bench, pdo, COB_ID)]
    return some(settable, f"no {' and no '.join(directions)} has a COB-ID that can be written")


def with_writable_mapping(bench: Bench, *directions: Direction) -> list[Pdo]:
    """Return the PDOs whose mapping a client may change."""
    found = []
    for pdo in usable(bench, *directions):
        count, entry = bench.dictionary.get(pdo.mapping), bench.dictionary.get(pdo.mapping, 1)
        if count is not None and entry is not None and count.access.writable and entry.access.writable:
            found.append(pdo)
    return some(found, f"no {' and no '.join(directions)} has a mapping that can be written")


def has(bench: Bench, pdo: Pdo, subindex: int) -> bool:
    """Return whether a PDO's communication parameter has this subindex, and it can be written."""
    variable = bench.dictionary.get(pdo.communication, subindex)
    return variable is not None and variable.access.writable


def key_of(bench: Bench, pdo: Pdo) -> RoutingKey:
    """Return the PDO's default CAN-ID, which the cases use."""
    return key_of_cob_id(bench.default(pdo.communication, COB_ID))


def length_of(bench: Bench, pdo: Pdo) -> int:
    """Return the number of bytes that a PDO carries by default."""
    count = bench.default(pdo.mapping)
    bits = sum(mapped(bench.default(pdo.mapping, subindex))[2] for subindex in range(1, count + 1))
    return (bits + 7) // 8


def content_of(bench: Bench, pdo: Pdo) -> Procedure[bytes | None]:
    """Return the data that a TPDO with its default mapping would have now: read its objects by SDO. None: one cannot be read, or
    does not fit."""
    entries = [bench.default(pdo.mapping, subindex) for subindex in range(1, bench.default(pdo.mapping) + 1)]
    try:
        mapping, values = Mapping.from_parameters(entries, bench.dictionary), []
        for component in mapping.components:
            variable = bench.dictionary.variable((component.index, component.subindex))
            if not variable.access.readable:
                return None
            values.append(variable.decode((yield from bench.read(variable.index, variable.subindex))))
        return mapping.pack(values)
    except (MappingError, ObjectNotFoundError, ValueRangeError):
        return None


def mapped_variable(bench: Bench, pdo: Pdo) -> Variable | None:
    """Return the first object that a PDO carries by default."""
    index, subindex, _ = mapped(bench.default(pdo.mapping, 1))
    return bench.dictionary.get(index, subindex)


def destroy(bench: Bench, pdo: Pdo) -> Procedure[None]:
    """Make a PDO not valid; then all its parameters can be written."""
    cob_id = bench.default(pdo.communication, COB_ID)
    yield from bench.write(pdo.communication, COB_ID, cob_id | COB_ID_INVALID)


def create(bench: Bench, pdo: Pdo, *, requests: bool = False) -> Procedure[int | None]:
    """Make a PDO valid; return the abort code if the device refuses. requests: let a TPDO answer remote frames."""
    cob_id = bench.default(pdo.communication, COB_ID) & _CAN_ID
    if pdo.direction is Direction.TPDO and not requests:
        cob_id |= COB_ID_NO_RTR
    return (yield from bench.refusal_of_write(pdo.communication, COB_ID, cob_id))


def set_up(
    bench: Bench,
    pdo: Pdo,
    transmission_type: int,
    *,
    event_time: Time = 0,
    inhibit_time: Time = 0,
    sync_start: int = 0,
    requests: bool = False,
) -> Procedure[bool]:
    """Set up a PDO with its default CAN-ID and mapping. Return False if the device does not support the type, or remote
    frames."""
    yield from destroy(bench, pdo)
    if not bench.is_writable(pdo.communication, TRANSMISSION_TYPE):
        bench.variable(pdo.communication, TRANSMISSION_TYPE)
        if bench.default(pdo.communication, TRANSMISSION_TYPE) != transmission_type:
            return False
    elif (yield from bench.refusal_of_write(pdo.communication, TRANSMISSION_TYPE, transmission_type)) is not None:
        return False
    times = (INHIBIT_TIME, inhibit_time // INHIBIT_UNIT), (EVENT_TIMER, event_time // MILLISECOND)
    for subindex, value in (*times, (SYNC_START, sync_start)):
        if has(bench, pdo, subindex):
            yield from bench.write(pdo.communication, subindex, value)
    return (yield from create(bench, pdo, requests=requests)) is None


def first_set_up(bench: Bench, pdos: Sequence[Pdo]) -> Procedure[Pdo]:
    """Set up the first of these PDOs that can be event-driven; return it. Without any, the case does not apply."""
    for pdo in pdos:
        if (yield from set_up(bench, pdo, PROFILE_EVENTS)):
            return pdo
    does_not_apply(f"no {pdos[0].direction} supports transmission type {PROFILE_EVENTS}")


def try_mapping(bench: Bench, pdo: Pdo, entries: Sequence[int]) -> Procedure[int | None]:
    """Write a mapping to a PDO that is not valid: disable it, write the entries, enable it. Return the abort code of a
    refusal."""
    yield from bench.write(pdo.mapping, 0, 0)
    return (yield from try_entries(bench, pdo, entries))


def try_entries(bench: Bench, pdo: Pdo, entries: Sequence[int]) -> Procedure[int | None]:
    """Write the entries and their number; return the abort code of a refusal."""
    for subindex, entry in (*enumerate(entries, start=1), (0, len(entries))):
        refusal = yield from bench.refusal_of_write(pdo.mapping, subindex, entry)
        if refusal is not None:
            return refusal
    return None


def entry_of(variable: Variable) -> int:
    """Return the mapping entry of an object in its full width."""
    assert variable.bit_length is not None
    return mapping_entry(variable.mux, variable.bit_length)


def process_objects(bench: Bench, access: Sequence[Access], *, mappable: bool = True) -> list[Variable]:
    """Return the objects with these access rights that are mappable, or are not, by index."""
    return [
        variable
        for variable in bench.dictionary
        if variable.access in access
        and variable.pdo_mappable == mappable
        and variable.bit_length is not None
        and variable.data_type is not DataType.DOMAIN
        and (mappable or variable.index not in COMMUNICATION_AREA)
    ]
