"""Read the rows of the product's three CSV files, and check each by itself.

The files are tables of the manual (indices.csv, constants.csv, PDOs.csv). Each line is a row; any white space separates columns;
a column that begins with `#` begins a comment; blank lines are skipped. Numbers are always hexadecimal, with or without 0x, as
the manual warns; only the length of an object is decimal.

    indices.csv     alias  index  subindex  length  mode       statusword 0x6041 0x0 2 ro
    constants.csv   alias of the object  name  mask  value     statusword operation_enable 0x6F 0x27
    PDOs.csv        alias  COB-ID  alias of an object ...      schunk_default_tPDO 0x180 statusword torque_actual_value ...

length: 1 to 8 bytes, or `-` if it varies (texts). mode: what the device permits, ro, rw or wo (rwr, rww and const of CiA 306 are
accepted too); it never decides the direction of a transfer.

This module checks single rows; csv.py checks rows and files against each other; lint.py warns of what is legal but dangerous. A
row with an error is left out, and reading goes on, so that one pass finds everything.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from canopen_data.findings import Finding, Severity
from canopen_proto.dictionary.model import Access, Direction
from canopen_proto.explained import counted

_COLUMN: Final = re.compile(r"\S+")
_HEX: Final = re.compile(r"(?:0[xX])?[0-9A-Fa-f]{1,16}", re.ASCII)
_LENGTH: Final = re.compile(r"[1-8]", re.ASCII)

FILLER_INDEX: Final = 0xFFFF
"""The index of fillers in indices.csv; CiA 301 v4.2.0, table 41, leaves it unused."""

PREDEFINED_PDOS: Final[Mapping[int, tuple[Direction, int]]] = {
    0x180: (Direction.TPDO, 1),
    0x200: (Direction.RPDO, 1),
    0x280: (Direction.TPDO, 2),
    0x300: (Direction.RPDO, 2),
    0x380: (Direction.TPDO, 3),
    0x400: (Direction.RPDO, 3),
    0x480: (Direction.TPDO, 4),
    0x500: (Direction.RPDO, 4),
}
"""Direction and number by COB-ID without node-ID: the predefined connection set (CiA 301 v4.2.0, 7.3.3)."""

ANY_LENGTH: Final = "-"
MAX_COB_BASE: Final = 0x780
"""With node-ID 127 added this is 0x7FF, the last CAN-ID of 11 bits."""


def direction_in(alias: str) -> Direction | None:
    """Return the direction that the alias of a PDO names; None if it names none, or both."""
    lower = alias.lower()
    spoken = [direction for direction in Direction if direction.lower() in lower]
    return spoken[0] if len(spoken) == 1 else None


class Cell(NamedTuple):
    """One column of one line, and its place."""

    text: str
    source: str
    line: int
    column: int

    def error(self, code: str, message: str) -> Finding:
        return Finding(Severity.ERROR, code, message, self.source, self.line, self.column)

    def warning(self, code: str, message: str) -> Finding:
        return Finding(Severity.WARNING, code, message, self.source, self.line, self.column)

    @property
    def shown(self) -> str:
        """The text for an error message, cut if it is long."""
        return ascii(self.text) if len(self.text) <= 60 else f"{self.text[:57]!a}..."


@dataclass(frozen=True, slots=True)
class IndexRow:
    """A row of indices.csv. length: bytes, None = any."""

    alias: Cell
    index: int
    subindex: int
    length: int | None
    access: Access
    cells: tuple[Cell, ...]

    @property
    def own(self) -> tuple[Cell, ...]:
        """The cells that must be unique among the rows."""
        return (self.alias,)


@dataclass(frozen=True, slots=True)
class ConstantRow:
    """A row of constants.csv."""

    alias: Cell
    name: Cell
    mask: int
    value: int
    cells: tuple[Cell, ...]

    @property
    def own(self) -> tuple[Cell, ...]:
        """The cells that must be unique among the rows."""
        return self.alias, self.name


@dataclass(frozen=True, slots=True)
class PdoRow:
    """A row of PDOs.csv. cob_base: the CAN-ID without the node-ID. entries: the aliases of its objects. cells: all of the row."""

    alias: Cell
    cob_base: int
    entries: tuple[Cell, ...]
    cells: tuple[Cell, ...]

    @property
    def own(self) -> tuple[Cell, ...]:
        """The cells that must be unique among the rows."""
        return (self.alias,)

    @property
    def place(self) -> tuple[Direction | None, int | None]:
        """Direction and number: from the COB-ID if that is of the predefined connection set, else the direction in the alias."""
        return PREDEFINED_PDOS.get(self.cob_base, (direction_in(self.alias.text), None))


def read_indices(text: str, source: str, findings: list[Finding]) -> list[IndexRow]:
    """Return the valid rows of indices.csv; errors go to `findings`. text: of the file. source: its name, for findings."""
    rows = []
    for cells in _lines(text, source):
        if not _has_columns(cells, ("alias", "index", "subindex", "length", "mode"), findings):
            continue
        alias, index, subindex, length, mode = cells
        numbers = _hexadecimal(index, 0xFFFF, "index", findings), _hexadecimal(subindex, 0xFF, "subindex", findings)
        if length.text != ANY_LENGTH and not _LENGTH.fullmatch(length.text):
            message = f"length {length.shown} is not 1 to 8 bytes (decimal), nor {ANY_LENGTH} for any length"
            findings.append(length.error("length", message))
            continue
        try:
            access = Access(mode.text.lower())
        except ValueError:
            findings.append(mode.error("mode", f"mode {mode.shown} is not ro, rw or wo"))
            continue
        if numbers[0] is not None and numbers[1] is not None:
            size = None if length.text == ANY_LENGTH else int(length.text)
            rows.append(IndexRow(alias, numbers[0], numbers[1], size, access, cells))
    return rows


def read_constants(text: str, source: str, findings: list[Finding]) -> list[ConstantRow]:
    """Return the valid rows of constants.csv; errors go to `findings`. text: of the file. source: its name, for findings."""
    rows = []
    for cells in _lines(text, source):
        if not _has_columns(cells, ("alias of an object", "name", "mask", "value"), findings):
            continue
        mask = _hexadecimal(cells[2], 0xFFFF_FFFF_FFFF_FFFF, "mask", findings)
        value = _hexadecimal(cells[3], 0xFFFF_FFFF_FFFF_FFFF, "value", findings)
        if mask is not None and value is not None:
            rows.append(ConstantRow(cells[0], cells[1], mask, value, cells))
    return rows


def read_pdos(text: str, source: str, findings: list[Finding]) -> list[PdoRow]:
    """Return the valid rows of PDOs.csv; errors go to `findings`. text: of the file. source: its name, for findings."""
    rows = []
    for cells in _lines(text, source):
        if len(cells) < 3:
            findings.append(cells[-1].error("columns", f"a PDO needs an alias, a COB-ID and objects, not {_counted(cells)}"))
            continue
        cob_base = _hexadecimal(cells[1], MAX_COB_BASE, "COB-ID", findings)
        if cob_base == 0:
            findings.append(cells[1].error("cob-id", "COB-ID 0 is that of NMT; a PDO cannot have it"))
        elif cob_base is not None:
            rows.append(PdoRow(cells[0], cob_base, cells[2:], cells))
    return rows


def _lines(text: str, source: str) -> Iterator[tuple[Cell, ...]]:
    """Yield the columns of each line that has any. A byte order mark, which some editors write first, is skipped."""
    for number, line in enumerate(text.removeprefix("\ufeff").split("\n"), 1):
        cells = []
        for match in _COLUMN.finditer(line):
            if match[0].startswith("#"):
                break
            cells.append(Cell(match[0], source, number, match.start() + 1))
        if cells:
            yield tuple(cells)


def _has_columns(cells: tuple[Cell, ...], names: tuple[str, ...], findings: list[Finding]) -> bool:
    if len(cells) == len(names):
        return True
    at = cells[len(names)] if len(cells) > len(names) else cells[-1]
    hint = " (columns are separated by white space)" if any(mark in cells[0].text for mark in ",;") else ""
    message = f"a row has {counted(len(names), 'column')} ({', '.join(names)}), not {_counted(cells)}{hint}"
    findings.append(at.error("columns", message))
    return False


def _counted(cells: tuple[Cell, ...]) -> str:
    return f"{len(cells)}, ending at {cells[-1].shown}"


def _hexadecimal(cell: Cell, highest: int, what: str, findings: list[Finding]) -> int | None:
    if not _HEX.fullmatch(cell.text):
        findings.append(cell.error("number", f"{what} {cell.shown} is not a hexadecimal number of at most 64 bits"))
        return None
    number = int(cell.text, 16)
    if number > highest:
        findings.append(cell.error("number", f"{what} 0x{number:X} is more than 0x{highest:X}"))
        return None
    return number
