"""Warn of things in the CSV files that are legal but dangerous.

Each rule is a function over the rows of one file that yields findings; `lint` runs them all. A row that may be right for some
device gets a warning here, not an error in csv.py. The code of each finding is the rule's name for programs.

    decimal-looking      a number without 0x, such as 10 for sixteen: people may read it as decimal
    read-only            `rw` where the standard says that the object can only be read (the manual's torque_actual_value)
    length-differs       not the length that the standard gives the object
    two-aliases          two aliases for one object
    alias-number         an alias that looks like an index; alias-case: two aliases that differ in case only
    reserved-index       an index that no object can have
    outside-mask         a constant with bits outside its mask: no value ever matches it
    constant-too-wide    a constant that does not fit its object
    pdo-short            a PDO of less than 8 bytes; legal, but not what the manual's devices have
    pdo-direction        an alias that contradicts the COB-ID; the COB-ID counts
    pdo-access           an object that the device cannot send, or cannot receive, in a PDO of that direction
    cob-id               a COB-ID of another service, or one that already contains a node-ID
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from canopen_data.findings import Finding, Severity
from canopen_data.rows import FILLER_INDEX, Cell, ConstantRow, IndexRow, PdoRow, direction_in
from canopen_proto.dictionary.model import PSEUDO_INDEX, Access, Direction
from canopen_proto.dictionary.standard import find_standard

__all__ = ["Finding", "Severity", "lint"]

_OTHER_SERVICES: Final = {
    range(0x001, 0x080): "NMT",
    range(0x080, 0x100): "SYNC and EMCY",
    range(0x100, 0x101): "TIME",
    range(0x101, 0x181): "a reserved range",
    range(0x581, 0x600): "SDO",
    range(0x601, 0x680): "SDO",
    range(0x6E0, 0x700): "NMT, LSS and others",
    range(0x701, 0x780): "heartbeat",
    range(0x780, 0x800): "LSS and others",
}
"""Restricted CAN-IDs (CiA 301 v4.2.0, 7.3.5, table 40, and the predefined connection set)."""

_LIKE_A_NUMBER: Final = re.compile(r"(0[xX])?[0-9A-Fa-f]{4}([:.](0[xX])?[0-9A-Fa-f]{1,2})?", re.ASCII)


def lint(indices: Sequence[IndexRow], constants: Sequence[ConstantRow], pdos: Sequence[PdoRow]) -> list[Finding]:
    """Return all warnings, in the order of the files and lines. The rows must be free of errors among themselves (see csv.py)."""
    by_alias = {row.alias.text: row for row in indices}
    return [*_of_indices(indices), *_of_constants(constants, by_alias), *_of_pdos(pdos, by_alias)]


def _of_indices(rows: Sequence[IndexRow]) -> Iterator[Finding]:
    by_place: dict[tuple[int, int], IndexRow] = {}
    by_case: dict[str, IndexRow] = {}
    for row in rows:
        alias, where = row.alias, f"0x{row.index:04X}:{row.subindex:02X}"
        yield from _decimal_looking(row.cells[2], "subindex")
        if _LIKE_A_NUMBER.fullmatch(alias.text):
            yield alias.warning("alias-number", f"alias {alias.shown} reads like an index; the alias counts")
        twin = by_case.setdefault(alias.text.casefold(), row)
        if twin is not row:
            message = f"alias {alias.shown} differs from {twin.alias.shown} (line {twin.alias.line}) in case only"
            yield alias.warning("alias-case", message)
        if row.index in (PSEUDO_INDEX, FILLER_INDEX):
            continue
        if not 0x1000 <= row.index <= 0xBFFF:
            yield row.cells[1].warning("reserved-index", f"no device has an object at {where}: objects are at 0x1000 to 0xBFFF")
        first = by_place.setdefault((row.index, row.subindex), row)
        if first is not row:
            rights = f", whose mode {first.access} counts" if first.access != row.access else ""
            yield alias.warning("two-aliases", f"{where} is {first.alias.shown} already (line {first.alias.line}){rights}")
        yield from _against_the_standard(row, where)


def _against_the_standard(row: IndexRow, where: str) -> Iterator[Finding]:
    standard = find_standard(row.index, row.subindex)
    if standard is None:
        return
    if row.access.writable and not standard.access.writable:
        message = f"{where} is {standard.name}, which to the standard is {standard.access}, not {row.access}"
        yield row.cells[4].warning("read-only", message)
    if row.length != standard.size:
        length = "of any length" if standard.size is None else f"{standard.size} bytes long"
        yield row.cells[3].warning("length-differs", f"{where} is {standard.name}, which to the standard is {length}")


def _of_constants(rows: Sequence[ConstantRow], objects: Mapping[str, IndexRow]) -> Iterator[Finding]:
    for row in rows:
        yield from _decimal_looking(row.cells[2], "mask")
        yield from _decimal_looking(row.cells[3], "value")
        if row.value & ~row.mask:
            message = f"0x{row.value:X} has bits outside its mask 0x{row.mask:X}: no value can ever match {row.name.text}"
            yield row.cells[3].warning("outside-mask", message)
        length = objects[row.alias.text].length
        if length is not None and row.value >> 8 * length:
            message = f"0x{row.value:X} does not fit the {length} bytes of {row.alias.text}"
            yield row.cells[3].warning("constant-too-wide", message)


def _of_pdos(rows: Sequence[PdoRow], objects: Mapping[str, IndexRow]) -> Iterator[Finding]:
    for row in rows:
        cob_id = row.cells[1]
        by_alias = direction_in(row.alias.text)
        direction, _ = row.place
        if by_alias not in (None, direction):
            message = f"{row.alias.text} is called {by_alias}, but 0x{row.cob_base:X} is predefined as {direction}, which counts"
            yield row.alias.warning("pdo-direction", message)
        yield from _of_cob_base(cob_id, row.cob_base)
        size = sum(objects[entry.text].length or 0 for entry in row.entries)
        if size < 8:
            yield row.alias.warning("pdo-short", f"{row.alias.text} has {size} bytes, not 8")
        for entry in row.entries:
            if objects[entry.text].index != FILLER_INDEX:
                yield from _of_entry(entry, objects[entry.text].access, direction)


def _of_cob_base(cell: Cell, cob_base: int) -> Iterator[Finding]:
    used = range(cob_base + 1, cob_base + 0x80)
    services = {name: None for ids, name in _OTHER_SERVICES.items() if ids.start < used.stop and used.start < ids.stop}
    if services:
        yield cell.warning("cob-id", f"0x{cob_base:X} with a node-ID added meets the CAN-IDs of {' and '.join(services)}")
    elif cob_base % 0x80:
        yield cell.warning("cob-id", f"0x{cob_base:X} seems to have a node-ID in it; the node-ID is added to it")


def _of_entry(cell: Cell, access: Access, direction: Direction | None) -> Iterator[Finding]:
    if direction is Direction.RPDO and not access.writable:
        yield cell.warning("pdo-access", f"{cell.text} is {access}: a device cannot take it from an RPDO")
    elif direction is Direction.TPDO and not access.readable:
        yield cell.warning("pdo-access", f"{cell.text} is {access}: a device cannot send it in a TPDO")


def _decimal_looking(cell: Cell, what: str) -> Iterator[Finding]:
    if cell.text.isdigit() and int(cell.text, 10) != int(cell.text, 16):
        message = f"{what} {cell.text} is read as 0x{cell.text} ({int(cell.text, 16)}): write 0x before it"
        yield cell.warning("decimal-looking", message)
