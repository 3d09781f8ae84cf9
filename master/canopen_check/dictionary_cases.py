"""Chapter 4 of the conformance test: the object dictionary (CiA 301 v4.2.0, 7.4): the device's objects against its description.

Some objects change by themselves and are not compared with defaults: process values, error objects, and objects that act when
they are written. Values are written back from 0x2000 on, unless the file (ObjFlags) excludes the object from a download; if the
test is strict, in the communication area too.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from functools import partial
from typing import Final, NoReturn

from canopen_check.bench import Bench
from canopen_check.case import Case, for_each
from canopen_check.expectations import expect_refusal, some
from canopen_check.sdo_cases import (
    ANY_TIME,
    NEVER_WRITTEN,
    READ_ONLY,
    STRUCTURE,
    TOO_HIGH,
    TOO_LOW,
    expect_own_value,
    limited,
    read_write_only,
    settings,
    takes_any_time,
)
from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import Access, Object, ObjectType, Variable
from canopen_proto.dictionary.download_order import NO_DOWNLOAD
from canopen_proto.explained import counted
from canopen_proto.indices import COMMUNICATION_AREA, ERROR_REGISTER, MANUFACTURER_AREA, MANUFACTURER_STATUS_REGISTER
from canopen_proto.nmt import NmtCommand
from canopen_proto.procedures.steps import Procedure, SdoTransferError
from canopen_proto.verdict import ViolationError, expect, expect_equal

FIRST_OF_MAKER: Final = 0x2000
"""The first index after the communication area."""

LIVING: Final = (ERROR_REGISTER, MANUFACTURER_STATUS_REGISTER, *NEVER_WRITTEN)


def with_default(bench: Bench) -> Iterator[Variable]:
    """Return the objects whose value after a reset is known."""
    for variable in bench.dictionary:
        is_process = variable.pdo_mappable and variable.access in (Access.RO, Access.RWR)
        is_alive = is_process or variable.index in LIVING
        if variable.access.readable and not is_alive and bench.content_of(variable) is not None:
            yield variable


def expect_defaults(bench: Bench, variables: Iterable[Variable]) -> Procedure[str]:
    """Check that objects have their defaults.

    A read-only object of the maker's may live, such as a counter of starts: the resets of this test change it. So one that
    differs is read again after one more reset; if that changes it, this is a remark. An object with the wrong value that an
    earlier case has named is not named again.
    """
    doubtful: list[tuple[Variable, bytes]] = []
    named_before = 0

    def look(variable: Variable) -> Procedure[None]:
        nonlocal named_before
        seen = yield from bench.read(variable.index, variable.subindex)
        if seen == bench.content_of(variable):
            return
        if bench.wrong_defaults.get(variable.mux) == seen:
            named_before += 1
        elif variable.access is Access.RO and variable.index in MANUFACTURER_AREA:
            doubtful.append((variable, seen))
        else:
            _name(bench, variable, seen)

    def look_again(doubt: tuple[Variable, bytes]) -> Procedure[None]:
        variable, before = doubt
        seen = yield from bench.read(variable.index, variable.subindex)
        if seen == before:
            _name(bench, variable, seen)
        changes = f"{before.hex(' ')}, then {seen.hex(' ')}"
        bench.notes.remark(f"{variable.label} changes with a reset ({changes}): it is not compared with its default")

    compared = yield from for_each(bench, variables, look)
    if doubtful:
        yield from bench.reset()
        yield from for_each(bench, doubtful, look_again)
    told = f", {named_before} of them with another value, as named before" if named_before else ""
    return f"{compared}{told}"


def _name(bench: Bench, variable: Variable, seen: bytes) -> NoReturn:
    """Raise ViolationError for an object with another value than its default."""
    bench.wrong_defaults[variable.mux] = seen
    raise ViolationError(f"{variable.label} is {seen.hex(' ') or 'nothing'}, not {(bench.content_of(variable) or b'').hex(' ')}")


def change_settings(bench: Bench) -> Procedure[list[tuple[Variable, bytes]]]:
    """Give some communication objects other values than after a reset; return the old values. An object that refuses keeps its
    own."""
    before = []
    for variable in settings(bench):
        if takes_any_time(variable):
            place = variable.index, variable.subindex
            content = yield from bench.read(*place)
            if (yield from bench.refusal_of_write(*place, ANY_TIME)) is None:
                before.append((variable, content))
    return before


def expect_put_back(bench: Bench, before: list[tuple[Variable, bytes]]) -> Procedure[None]:
    """Check that a reset has undone what `change_settings` did. before: the objects and their bytes."""

    def look(changed: tuple[Variable, bytes]) -> Procedure[None]:
        variable, content = changed
        expect_equal((yield from bench.read(variable.index, variable.subindex)), content, variable.label)

    yield from for_each(bench, before, look)


def read_all(bench: Bench) -> Procedure[str]:
    """4.1: every readable object can be read, with the length of its type."""
    readable = [variable for variable in bench.dictionary if variable.access.readable]
    return (yield from for_each(bench, readable, partial(_read, bench)))


def _read(bench: Bench, variable: Variable) -> Procedure[None]:
    """Read an object. There may be no data at the moment (an entry of the error history)."""
    try:
        content = yield from bench.read(variable.index, variable.subindex)
    except SdoTransferError as failed:
        if failed.abort_code in (AbortCode.NO_DATA, AbortCode.GENERAL_ERROR):
            return
        raise
    if variable.size is not None:
        expect_equal(len(content), variable.size, f"the number of bytes of {variable.label}")


def compare_defaults(bench: Bench) -> Procedure[str]:
    """4.2: after power-on each object has its default."""
    return (yield from expect_defaults(bench, with_default(bench)))


def write_read_only(bench: Bench) -> Procedure[str]:
    """4.3: a read-only object cannot be written, not even with its own value."""

    def look(variable: Variable) -> Procedure[None]:
        value = bench.content_of(variable) or bytes(variable.size or 1)
        code = yield from bench.refusal_of_write(variable.index, variable.subindex, value)
        expect_refusal(code, READ_ONLY, f"writing {variable.label}")

    constant = [variable for variable in bench.dictionary if not variable.access.writable]
    return (yield from for_each(bench, constant, look))


def compare_structure(bench: Bench) -> Procedure[str]:
    """4.5: subindex 255 holds the object type in its lowest byte, and above it the data type (of an array: of its elements)."""
    found = [described for described in bench.dictionary.objects.values() if STRUCTURE in described.variables]

    def look(described: Object) -> Procedure[None]:
        structure = yield from bench.number(described.index, STRUCTURE)
        label = described.variables[STRUCTURE].label
        expect_equal(structure & 0xFF, int(described.object_type), f"the object type in {label}")
        if described.object_type is ObjectType.ARRAY and 1 in described.variables:
            expect_equal(structure >> 8, int(described.variables[1].data_type), f"the data type in {label}")

    return (yield from for_each(bench, some(found, "no object has a subindex 255"), look))


def check_limits(bench: Bench) -> Procedure[str]:
    """4.6: an object takes the values at its limits, and none beyond.

    In the communication area a value within limits may still be wrong (a COB-ID, a number of entries). In the profile area a
    device may refuse a value that it does not support (a mode of operation), but not as too high or too low.
    """
    found = some(limited(bench), "no object has limits of its own")

    def look(limit: tuple[Variable, int, int | float, Collection[AbortCode]]) -> Procedure[None]:
        variable, beyond, within, codes = limit
        place = variable.index, variable.subindex
        code = yield from bench.refusal_of_write(*place, variable.encode(beyond))
        expect_refusal(code, codes, f"writing {beyond} to {variable.label}")
        if variable.index not in COMMUNICATION_AREA:
            code = yield from bench.refusal_of_write(*place, variable.encode(within))
            is_lacking = variable.index >= 0x6000 and code == AbortCode.INVALID_VALUE
            expect(code is None or is_lacking, f"writing {within}, its limit, to {variable.label} was refused")

    yield from bench.silence_sync()  # 0x1019 may be among them
    limits = [
        (variable, beyond, within, codes)
        for variable, below, above in found
        for beyond, within, codes in ((below, variable.low_limit, TOO_LOW), (above, variable.high_limit, TOO_HIGH))
        if beyond is not None and within is not None
    ]
    yield from for_each(bench, limits, look)
    return counted(len(found), "object")


def write_back(bench: Bench) -> Procedure[str]:
    """4.9: a writable object takes its own value. CiA's tool does not check that it has the value then: it may change by
    itself."""

    def look(variable: Variable) -> Procedure[None]:
        content = yield from bench.read(variable.index, variable.subindex)
        yield from expect_own_value(bench, variable, content)
        after = yield from bench.read(variable.index, variable.subindex)
        bench.notes.beyond(after == content, f"{variable.label}, written back, is {after.hex(' ')}, not {content.hex(' ')}")

    found = [
        variable
        for variable in bench.dictionary
        if variable.access.readable
        and variable.access.writable
        and variable.index not in NEVER_WRITTEN
        and (bench.strict or variable.index >= FIRST_OF_MAKER)
        and not (variable.object_flags | bench.dictionary.objects[variable.index].object_flags) & NO_DOWNLOAD
    ]
    return (yield from for_each(bench, found, look))


def access_all(bench: Bench) -> Procedure[str]:
    """4.7: reading, and writing back; if the test is strict, in Operational too."""
    yield from read_all(bench)
    seen = yield from write_back(bench)
    if bench.strict:
        yield from bench.command(NmtCommand.START)
        yield from read_all(bench)
        yield from write_back(bench)
    return seen


def compare_after_reset_communication(bench: Bench) -> Procedure[str]:
    """4.8: after reset communication the communication objects that can be written have their defaults."""
    before = yield from change_settings(bench)
    yield from bench.reset(NmtCommand.RESET_COMMUNICATION)
    yield from expect_put_back(bench, before)
    return (yield from expect_defaults(bench, (variable for variable in with_default(bench) if variable.index < FIRST_OF_MAKER)))


CASES: Final = (
    Case("4.1", "OD 01", "Access each object by its access type", read_all),
    Case("4.2", "OD 02", "Compare each object with its default value", compare_defaults),
    Case("4.3", "OD 03", "Try to write what is read-only", write_read_only),
    Case("4.4", "OD 04", "Try to read what is write-only", read_write_only),
    Case("4.5", "OD 05", "Compare subindex 255 with data type and object type", compare_structure),
    Case("4.6", "OD 06", "Check the limits of objects that can be written", check_limits),
    Case("4.7", "OD 07", "Access each object by its access type, and write it back", access_all),
    Case(
        "4.8", "OD 08", "Compare objects with their default values after reset communication", compare_after_reset_communication
    ),
    Case("4.9", "OD 09", "Write back what each rw object holds", write_back),
)
