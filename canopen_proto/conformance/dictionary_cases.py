"""Chapter 4 of the conformance test: the object dictionary (CiA 301 v4.2.0, 7.4): what the device has, against what it should
have.

Not compared with defaults are objects that live: the values of the process, the error objects, and those that do something.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from canopen_proto.conformance.bench import Bench
from canopen_proto.conformance.case import Case, Violation, does_not_apply, expect, expect_equal, expect_refusal
from canopen_proto.conformance.sdo_cases import (
    ANY_TIME,
    NEVER_WRITTEN,
    READ_ONLY,
    TOO_HIGH,
    TOO_LOW,
    limited,
    read_write_only,
    settings,
    takes_any_time,
)
from canopen_proto.dictionary import Access, ObjectType, Variable
from canopen_proto.nmt import NmtCommand
from canopen_proto.procedures.steps import Procedure, SdoFailed
from canopen_proto.sdo.abort import AbortCode

STRUCTURE: Final = 0xFF
"""The subindex that tells data type and object type."""

LIVING: Final = (0x1001, 0x1002, *NEVER_WRITTEN)


def with_default(bench: Bench) -> Iterator[Variable]:
    """The objects whose value after a reset is known."""
    for variable in bench.dictionary:
        is_process = variable.pdo_mappable and variable.access in (Access.RO, Access.RWR)
        is_alive = is_process or variable.index in LIVING
        if variable.access.readable and not is_alive and bench.content_of(variable) is not None:
            yield variable


def expect_defaults(bench: Bench, variables: Iterator[Variable]) -> Procedure[str]:
    """Look whether objects have their defaults."""
    count = 0
    for variable in variables:
        seen = yield from bench.read(variable.index, variable.subindex)
        expect_equal(seen, bench.content_of(variable), variable.label)
        count += 1
    return f"{count} objects"


def change_settings(bench: Bench) -> Procedure[list[tuple[Variable, bytes]]]:
    """Give some communication objects other values than they have after a reset; what they had."""
    before = []
    for variable in settings(bench):
        if takes_any_time(variable):
            before.append((variable, (yield from bench.read(variable.index, variable.subindex))))
            yield from bench.write(variable.index, variable.subindex, ANY_TIME)
    return before


def expect_put_back(bench: Bench, before: list[tuple[Variable, bytes]]) -> Procedure[None]:
    """Look whether a reset has undone what `change_settings` did."""
    for variable, content in before:
        expect_equal((yield from bench.read(variable.index, variable.subindex)), content, variable.label)


def read_all(bench: Bench) -> Procedure[str]:
    """4.1: what can be read can be read, with the length of its type."""
    count = 0
    for variable in bench.dictionary:
        if variable.access.readable and (yield from _read(bench, variable)) is not None:
            count += 1
    return f"{count} objects"


def _read(bench: Bench, variable: Variable) -> Procedure[bytes | None]:
    """None where there are no data at the moment (an entry of the error history)."""
    try:
        content = yield from bench.read(variable.index, variable.subindex)
    except SdoFailed as failed:
        if failed.abort_code in (AbortCode.NO_DATA, AbortCode.GENERAL_ERROR):
            return None
        raise
    if variable.size is not None:
        expect_equal(len(content), variable.size, f"the number of bytes of {variable.label}")
    return content


def compare_defaults(bench: Bench) -> Procedure[str]:
    """4.2: after power-on each object has its default."""
    return (yield from expect_defaults(bench, with_default(bench)))


def write_read_only(bench: Bench) -> Procedure[str]:
    """4.3: what is for reading only can't be written, not even with the value that it has."""
    count = 0
    for variable in bench.dictionary:
        if not variable.access.writable:
            value = bench.content_of(variable) or bytes(variable.size or 1)
            code = yield from bench.refusal_of_write(variable.index, variable.subindex, value)
            expect_refusal(code, READ_ONLY, f"writing {variable.label}")
            count += 1
    return f"{count} objects"


def compare_structure(bench: Bench) -> Procedure[str]:
    """4.5: subindex 255 tells the object type in its lowest byte, above it the data type (of an array: that of its elements)."""
    found = [described for described in bench.dictionary.objects.values() if STRUCTURE in described.variables]
    if not found:
        does_not_apply("no object has a subindex 255")
    for described in found:
        structure = yield from bench.number(described.index, STRUCTURE)
        label = described.variables[STRUCTURE].label
        expect_equal(structure & 0xFF, int(described.object_type), f"the object type in {label}")
        if described.object_type is ObjectType.ARRAY and 1 in described.variables:
            expect_equal(structure >> 8, int(described.variables[1].data_type), f"the data type in {label}")
    return f"{len(found)} objects"


def check_limits(bench: Bench) -> Procedure[str]:
    """4.6: an object takes the values at its limits, and none beyond.

    In the communication area more is asked of a value than to be within limits: not every COB-ID, number of entries ... is right.
    In the profile area a device may lack what it does not support (a mode of operation), but not call it too high or too low.
    """
    found = limited(bench)
    if not found:
        does_not_apply("no object has limits of its own")
    for variable, below, above in found:
        place = variable.index, variable.subindex
        for beyond, within, codes in ((below, variable.low_limit, TOO_LOW), (above, variable.high_limit, TOO_HIGH)):
            if beyond is not None and within is not None:
                code = yield from bench.refusal_of_write(*place, variable.encode(beyond))
                expect_refusal(code, codes, f"writing {beyond} to {variable.label}")
                if 0x1000 <= variable.index < 0x2000:
                    continue
                code = yield from bench.refusal_of_write(*place, variable.encode(within))
                is_lacking = variable.index >= 0x6000 and code == AbortCode.INVALID_VALUE
                expect(code is None or is_lacking, f"writing {within}, its limit, to {variable.label} was refused")
    return f"{len(found)} objects"


def write_back(bench: Bench) -> Procedure[str]:
    """4.9: what can be written takes the value that it has, and has it then."""
    count = 0
    for variable in bench.dictionary:
        access = variable.access
        if access.readable and access.writable and variable.index not in NEVER_WRITTEN:
            place = variable.index, variable.subindex
            content = yield from bench.read(*place)
            refusal = yield from bench.refusal_of_write(*place, content)
            if refusal is not None:
                raise Violation(f"writing its own value to {variable.label} was refused with 0x{refusal:08X}")
            expect_equal((yield from bench.read(*place)), content, f"{variable.label}, written back,")
            count += 1
    return f"{count} objects"


def in_operational(bench: Bench) -> Procedure[str]:
    """4.7: the same in Operational: reading, and writing back."""
    yield from bench.command(NmtCommand.START)
    yield from read_all(bench)
    return (yield from write_back(bench))


def compare_after_reset_communication(bench: Bench) -> Procedure[str]:
    """4.8: after reset communication the communication objects that can be written have their defaults."""
    before = yield from change_settings(bench)
    yield from bench.reset(NmtCommand.RESET_COMMUNICATION)
    yield from expect_put_back(bench, before)
    return (yield from expect_defaults(bench, (variable for variable in with_default(bench) if variable.index < 0x2000)))


CASES: Final = (
    Case("4.1", "OD 01", "Access each object by its access type", read_all),
    Case("4.2", "OD 02", "Compare each object with its default value", compare_defaults),
    Case("4.3", "OD 03", "Try to write what is read-only", write_read_only),
    Case("4.4", "OD 04", "Try to read what is write-only", read_write_only),
    Case("4.5", "OD 05", "Compare subindex 255 with data type and object type", compare_structure),
    Case("4.6", "OD 06", "Check the limits of objects that can be written", check_limits),
    Case("4.7", "OD 07", "Access each object by its access type, in Operational", in_operational),
    Case(
        "4.8", "OD 08", "Compare objects with their default values after reset communication", compare_after_reset_communication
    ),
    Case("4.9", "OD 09", "Write back what each rw object holds", write_back),
)
