"""Chapter 3, continued: PDO mappings, and those that a device has to refuse (CiA 301 v4.2.0, 7.5.2.36 and 7.5.2.38).

The standard leaves open which step a device refuses: the entry, or the number of entries, which enables them.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from typing import Final

from canopen_check.bench import REACTION_TIME, Bench
from canopen_check.case import Case, for_each
from canopen_check.expectations import expect_refusal, expect_taken, some
from canopen_check.pdo_tools import (
    INTO,
    Pdo,
    all_pdos,
    create,
    destroy,
    entry_of,
    first_set_up,
    key_of,
    process_objects,
    try_entries,
    try_mapping,
    with_writable_mapping,
)
from canopen_check.sdo_cases import NO_CAN_ID, NO_OBJECT, NOT_NOW
from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Direction, Variable
from canopen_proto.explained import counted
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.multiplexer import mapped, mapping_entry, mux
from canopen_proto.nmt import NmtCommand
from canopen_proto.pdo.mapping import LAST_DUMMY_INDEX, MAX_BITS, MAX_ENTRIES
from canopen_proto.pdo.settings import COB_ID
from canopen_proto.procedures.steps import Procedure
from canopen_proto.verdict import ViolationError, does_not_apply, expect

BOTH: Final = (Direction.RPDO, Direction.TPDO)
OTHER: Final = {Direction.RPDO: Direction.TPDO, Direction.TPDO: Direction.RPDO}

NOT_MAPPABLE: Final = (AbortCode.CANNOT_BE_MAPPED, AbortCode.GENERAL_ERROR)
TOO_LONG: Final = (
    AbortCode.CANNOT_BE_MAPPED,
    AbortCode.PDO_LENGTH_EXCEEDED,
    AbortCode.PARAMETER_INCOMPATIBLE,
    AbortCode.GENERAL_ERROR,
)
TOO_MANY: Final = (*TOO_LONG, AbortCode.INVALID_VALUE, AbortCode.VALUE_TOO_HIGH)

DUMMY: Final = DataType.UNSIGNED16
_ALL_ACCESS: Final = tuple(Access)


def default_mappings(bench: Bench) -> Procedure[str]:
    """3.21: the objects that a PDO carries by default are in the dictionary, may be mapped in this direction and width, and have
    at most 64 bits together."""
    count = 0

    def look(pdo: Pdo) -> Procedure[None]:
        nonlocal count
        expect(bench.dictionary.get(pdo.mapping) is not None, f"{pdo} has no mapping parameter")
        yield from bench.expect_default(pdo.mapping, 0, f"after a reset, the number of objects in {pdo}")
        number = yield from bench.number(pdo.mapping)
        bits = 0
        for subindex in range(1, number + 1 if number <= MAX_ENTRIES else 1):
            entry = yield from bench.number(pdo.mapping, subindex)
            try:
                _check_entry(bench, pdo, entry)
            except ViolationError as violation:
                bench.notes.fail(violation)
            bits += mapped(entry)[2]
            count += 1
        expect(bits <= MAX_BITS, f"{pdo} carries {bits} bits")

    yield from for_each(bench, all_pdos(bench, *BOTH), look)
    return counted(count, "entry")


def _check_entry(bench: Bench, pdo: Pdo, entry: int) -> None:
    index, subindex, bits = mapped(entry)
    if index <= LAST_DUMMY_INDEX and pdo.direction is Direction.RPDO:
        return
    variable = bench.dictionary.get(index, subindex)
    if variable is None:
        raise ViolationError(f"{pdo} carries 0x{index:04X}:{subindex:02X}, which is not in the dictionary")
    may = variable.pdo_mappable and variable.access not in INTO[OTHER[pdo.direction]]
    expect(may, f"{pdo} carries {variable.label}, which is {variable.access} or not mappable")
    expect(variable.bit_length is None or 0 < bits <= variable.bit_length, f"{pdo} carries {variable.label} with {bits} bits")


def _candidates(bench: Bench, direction: Direction) -> list[Variable]:
    found = process_objects(bench, INTO[direction]) or process_objects(bench, (Access.RW,))
    return some(found, f"no object can be mapped to an {direction}")


def _new_entry(bench: Bench, pdo: Pdo) -> int:
    """Return an entry that differs from the PDO's first one."""
    present = bench.default(pdo.mapping, 1)
    found = [entry_of(variable) for variable in _candidates(bench, pdo.direction) if entry_of(variable) != present]
    return some(found, f"nothing else can be mapped to {pdo}")[0]


def new_mapping(bench: Bench) -> Procedure[str]:
    """3.22: a PDO takes a new mapping: PDO made not valid, mapping disabled, written, enabled, PDO made valid again."""

    def look(pdo: Pdo) -> Procedure[None]:
        yield from destroy(bench, pdo)
        entry = _new_entry(bench, pdo)
        refusal = yield from try_mapping(bench, pdo, [entry])
        if refusal is None:
            refusal = yield from create(bench, pdo)
        if refusal is not None:
            raise ViolationError(f"{pdo} refused a correct mapping (0x{entry:08X}) with 0x{refusal:08X}")
        yield from bench.expect_number(pdo.mapping, 0, 1, "with a new mapping")
        yield from bench.expect_number(pdo.mapping, 1, entry, "with a new mapping")

    return (yield from for_each(bench, with_writable_mapping(bench, *BOTH), look, "PDO"))


def without_procedure(bench: Bench) -> Procedure[str]:
    """3.23: an entry cannot be written while the mapping is enabled (subindex 0 is not 0). CiA's tool tries the entry's own
    value."""

    def look(pdo: Pdo) -> Procedure[None]:
        yield from destroy(bench, pdo)
        refusal = yield from bench.refusal_of_write(pdo.mapping, 1, _new_entry(bench, pdo))
        expect_refusal(refusal, NOT_NOW, f"{pdo}: an entry of an enabled mapping")
        yield from bench.expect_number(pdo.mapping, 1, bench.default(pdo.mapping, 1), f"{pdo}, after a refused write")
        own = yield from bench.refusal_of_write(pdo.mapping, 1, bench.default(pdo.mapping, 1))
        if own is None:
            bench.notes.remark(f"{pdo} takes the own value of an entry of an enabled mapping; CiA's tool wants it refused")

    return (yield from for_each(bench, with_writable_mapping(bench, *BOTH), look, "PDO"))


def while_valid(bench: Bench) -> Procedure[str]:
    """3.24: the mapping of a valid PDO cannot be written; nor, if the test is strict, its CAN-ID (7.5.2.35, 7.5.2.37)."""
    pdos = [pdo for pdo in with_writable_mapping(bench, *BOTH) if not bench.default(pdo.communication, COB_ID) & COB_ID_INVALID]

    def look(pdo: Pdo) -> Procedure[None]:
        refusal = yield from bench.refusal_of_write(pdo.mapping, 0, 0)
        if refusal is None:
            refusal = yield from try_entries(bench, pdo, [_new_entry(bench, pdo)])
        expect_refusal(refusal, NOT_NOW, f"a new mapping of {pdo}, which is valid,")
        if bench.strict:
            other = bench.default(pdo.communication, COB_ID) ^ 1 << 7
            refusal = yield from bench.refusal_of_write(pdo.communication, COB_ID, other)
            expect_refusal(refusal, (*NOT_NOW, *NO_CAN_ID), f"a new CAN-ID of {pdo}, which is valid,")

    return (yield from for_each(bench, some(pdos, "no PDO is valid by default"), look, "PDO"))


def too_many(bench: Bench) -> Procedure[str]:
    """3.25: no PDO has more than 64 entries."""

    def look(pdo: Pdo) -> Procedure[None]:
        yield from destroy(bench, pdo)
        yield from bench.write(pdo.mapping, 0, 0)
        refusal = yield from bench.refusal_of_write(pdo.mapping, 0, MAX_ENTRIES + 1)
        expect_refusal(refusal, TOO_MANY, f"{MAX_ENTRIES + 1} objects in {pdo}")

    return (yield from for_each(bench, with_writable_mapping(bench, *BOTH), look, "PDO"))


def too_long(bench: Bench) -> Procedure[str]:
    """3.26: no PDO takes objects of more than 64 bits together. If there are too few entries for that, one claims as many
    bits."""

    def look(pdo: Pdo) -> Procedure[None]:
        widest = max(_candidates(bench, pdo.direction), key=lambda variable: variable.bit_length or 0)
        entry = entry_of(widest)
        count = MAX_BITS // mapped(entry)[2] + 1
        entries = [entry] * count
        if bench.dictionary.get(pdo.mapping, count) is None:
            entries = [mapping_entry(widest.mux, MAX_BITS + 8)]
        yield from destroy(bench, pdo)
        refusal = yield from try_mapping(bench, pdo, entries)
        expect_refusal(refusal, TOO_LONG, f"{sum(bits for _, _, bits in map(mapped, entries))} bits in {pdo}")

    return (yield from for_each(bench, with_writable_mapping(bench, *BOTH), look, "PDO"))


def _each(bench: Bench, direction: Direction, found: list[Variable], valid: Collection[AbortCode]) -> Procedure[str]:
    """Map an object to each PDO; check that it is accepted (`valid` is empty), or refused with one of these codes."""
    variable = some(found, "the dictionary has no such object")[0]
    pdos = with_writable_mapping(bench, direction)

    def look(pdo: Pdo) -> Procedure[None]:
        yield from destroy(bench, pdo)
        refusal = yield from try_mapping(bench, pdo, [entry_of(variable)])
        what = f"{variable.label}, {variable.access}, in {pdo}"
        if valid:
            expect_refusal(refusal, valid, what)
        else:
            expect_taken(refusal, what)

    return f"{variable.label} in {(yield from for_each(bench, pdos, look, 'PDO'))}"


def map_rightly(direction: Direction, bench: Bench) -> Procedure[str]:
    """3.27 and 3.30: an object for this direction can be mapped."""
    return (yield from _each(bench, direction, process_objects(bench, INTO[direction]), ()))


def map_against_access(direction: Direction, bench: Bench) -> Procedure[str]:
    """3.28 and 3.31: an object for the other direction cannot be mapped."""
    return (yield from _each(bench, direction, process_objects(bench, INTO[OTHER[direction]]), NOT_MAPPABLE))


def map_unmappable(direction: Direction, bench: Bench) -> Procedure[str]:
    """3.29 and 3.32: an object that is not mappable cannot be mapped; nor, if the test is strict, one that is not there."""
    if bench.strict:
        free = next(index for index in indices.MANUFACTURER_AREA if not bench.dictionary.has_index(index))
        missing = Variable(free, 0, "an object that is not there", DataType.UNSIGNED8)
        yield from _each(bench, direction, [missing], (*NOT_MAPPABLE, *NO_OBJECT))
    found = process_objects(bench, _ALL_ACCESS, mappable=False)
    right = [variable for variable in found if variable.access not in INTO[OTHER[direction]]]
    return (yield from _each(bench, direction, right or found, NOT_MAPPABLE))


def map_dummy(bench: Bench) -> Procedure[str]:
    """3.33: a dummy object in an RPDO fills space: the object after it gets its value."""
    pdos = [pdo for pdo in with_writable_mapping(bench, Direction.RPDO) if bench.dictionary.get(pdo.mapping, 2) is not None]
    found = [variable for variable in _candidates(bench, Direction.RPDO) if variable.access.readable and variable.size == 2]
    if not found or not pdos:
        does_not_apply("no RPDO could carry a dummy object and another one that can be read back")
    variable = found[0]
    pdo = yield from first_set_up(bench, pdos)
    yield from destroy(bench, pdo)
    refusal = yield from try_mapping(bench, pdo, [mapping_entry(mux(DUMMY), 16), entry_of(variable)])
    if refusal is not None:
        does_not_apply(f"dummy objects are not supported: 0x{refusal:08X}")
    yield from create(bench, pdo)
    yield from bench.command(NmtCommand.START)
    yield from bench.send(key_of(bench, pdo), b"\xff\xff\x01\x00")
    yield from bench.sleep(REACTION_TIME)
    yield from bench.expect_number(variable.index, variable.subindex, 1, f"after a {pdo} with a dummy object")
    return str(pdo)


_R, _T = Direction.RPDO, Direction.TPDO

CASES: Final = (
    Case("3.21", "PDO 21", "Read the default mappings and look for their objects in the dictionary", default_mappings),
    Case("3.22", "PDO 22", "Write a new correct mapping with the mapping procedure", new_mapping),
    Case("3.23", "PDO 23", "Try to write a new mapping without the mapping procedure", without_procedure),
    Case("3.24", "PDO 24", "Try to write a new mapping to a valid PDO", while_valid),
    Case("3.25", "PDO 25", "Try to write an incorrect mapping: too many objects", too_many),
    Case("3.26", "PDO 26", "Try to write an incorrect mapping: objects too long", too_long),
    Case("3.27", "PDO 27", "Map an rww or wo object to an RPDO", partial(map_rightly, _R)),
    Case("3.28", "PDO 28", "Try to map an rwr or ro object to an RPDO", partial(map_against_access, _R)),
    Case("3.29", "PDO 29", "Try to map an object that is not mappable to an RPDO", partial(map_unmappable, _R)),
    Case("3.30", "PDO 30", "Map an rwr or ro object to a TPDO", partial(map_rightly, _T)),
    Case("3.31", "PDO 31", "Try to map an rww or wo object to a TPDO", partial(map_against_access, _T)),
    Case("3.32", "PDO 32", "Try to map an object that is not mappable to a TPDO", partial(map_unmappable, _T)),
    Case("3.33", "PDO 33", "Map a dummy object to an RPDO, if dummy objects are supported", map_dummy),
)
