"""The product's CSV files: from three texts to one dictionary.

indices.csv names objects, constants.csv names values of them, PDOs.csv names what PDOs carry; rows.py has the formats. A user
adds an object, a constant or a PDO by adding a line. This module takes texts; the caller reads the files.

Facts that are not in the files come from the standard or from convention:

- type: the standard's, where the length is the same (so position_actual_value is signed); otherwise UNSIGNED of that length, and
  bytes where the length varies;
- index 0x0000 is a pseudo object (NMT), index 0xFFFF a filler of PDOs (notused16);
- direction of a PDO: that of its COB-ID if it is of the predefined connection set, else the one in its alias.

Errors stop the load. One DictionaryError holds them all, each with file, line and column: a malformed row; one alias twice; an
alias that indices.csv does not have; one object with two lengths; a PDO of more than 8 bytes or of unknown direction. Warnings
come from lint.py and are returned.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import groupby
from typing import Final, TypeVar

from canopen_data.findings import MAX_SHOWN, DictionaryError, Finding, Severity
from canopen_data.lint import lint
from canopen_data.rows import (
    FILLER_INDEX,
    Cell,
    ConstantRow,
    IndexRow,
    PdoRow,
    read_constants,
    read_indices,
    read_pdos,
)
from canopen_proto.datatypes import DataType, integer_type
from canopen_proto.dictionary.model import Constant, Filler, Object, ObjectDictionary, PdoDescription, Variable, did_you_mean
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.multiplexer import Mux

MAX_PDO_BITS: Final = 64

_R = TypeVar("_R", IndexRow, ConstantRow, PdoRow)


def load_csv(
    indices: str,
    constants: str = "",
    pdos: str = "",
    *,
    sources: tuple[str, str, str] = ("indices.csv", "constants.csv", "PDOs.csv"),
) -> tuple[ObjectDictionary, list[Finding]]:
    """Return the dictionary of three texts, and the linter's warnings. sources: the names of the texts in errors.

    Raises DictionaryError, which holds every error of all three.
    """
    findings: list[Finding] = []
    index_rows = _once(read_indices(indices, sources[0], findings), findings)
    constant_rows = _once(read_constants(constants, sources[1], findings), findings)
    pdo_rows = _once(read_pdos(pdos, sources[2], findings), findings)

    by_place = _variables(index_rows, findings)
    entries: dict[str, Variable | Filler] = {name: each for each in by_place.values() for name in each.names}
    entries |= _fillers(index_rows, findings)
    names = _Aliases(entries, indices, sources[0])
    by_mux = _constants(constant_rows, names, findings)
    descriptions = [_pdo(row, names, findings) for row in pdo_rows]
    findings.sort(key=lambda each: (sources.index(each.source), each.line, each.column))
    if findings:
        raise DictionaryError(findings)

    if not index_rows:
        findings.append(Finding(Severity.WARNING, "empty", "there is no object in this file", sources[0]))
    findings += lint(index_rows, constant_rows, pdo_rows)
    dictionary = ObjectDictionary(
        _objects(by_place),
        constants=by_mux,
        pdos=[each for each in descriptions if each is not None],
        fillers=[each for each in entries.values() if isinstance(each, Filler)],
        source=sources[0],
    )
    return dictionary, findings


class _Aliases:
    """The objects and fillers of indices.csv, by alias."""

    def __init__(self, entries: Mapping[str, Variable | Filler], text: str, source: str) -> None:
        self.entries = entries
        self.source = source
        # Aliases whose own row has an error: that one error is enough.
        self.excused = {line.split()[0] for line in text.split("\n") if line.split()}

    def find(self, cell: Cell, findings: list[Finding]) -> Variable | Filler | None:
        found = self.entries.get(cell.text)
        if found is None and cell.text not in self.excused:
            near = did_you_mean(cell.text, self.entries) if len(findings) < MAX_SHOWN else ""
            findings.append(cell.error("unknown-alias", f"there is no object {cell.shown} in {self.source}{near}"))
        return found


def _once(rows: Iterable[_R], findings: list[Finding]) -> list[_R]:
    """Return the rows without those whose name occurs in an earlier row of the file."""
    first: dict[tuple[str, ...], _R] = {}
    for row in rows:
        twin = first.setdefault(tuple(cell.text for cell in row.own), row)
        if twin is not row:
            cell = row.own[-1]
            findings.append(cell.error("duplicate-alias", f"{cell.shown} is in line {twin.own[-1].line} already"))
    return list(first.values())


def _variables(rows: Iterable[IndexRow], findings: list[Finding]) -> dict[tuple[int, int], Variable]:
    """Return one variable for each index and subindex, with all its aliases. The mode of the first row counts."""
    variables: dict[tuple[int, int], Variable] = {}
    lengths: dict[tuple[int, int], IndexRow] = {}
    for row in rows:
        place = row.index, row.subindex
        if row.index == FILLER_INDEX:
            continue
        first = lengths.setdefault(place, row)
        if first is row:
            variables[place] = _variable(row)
        elif first.length == row.length:
            variables[place] = replace(variables[place], aliases=(*variables[place].aliases, row.alias.text))
        else:
            where = f"0x{row.index:04X}:{row.subindex:02X}"
            message = f"{where} has another length than as {first.alias.shown} in line {first.alias.line}"
            findings.append(row.cells[3].error("length", message))
    return variables


def _variable(row: IndexRow) -> Variable:
    standard = find_standard(row.index, row.subindex)
    if standard is not None and standard.size == row.length:
        data_type = standard.data_type
    elif row.length is None:
        data_type = DataType.OCTET_STRING
    else:
        data_type = integer_type(row.length)
    mappable = row.length is not None and (standard is None or standard.pdo_mappable)
    return Variable(row.index, row.subindex, row.alias.text, data_type, row.access, pdo_mappable=mappable)


def _fillers(rows: Iterable[IndexRow], findings: list[Finding]) -> dict[str, Filler]:
    fillers = {}
    for row in rows:
        if row.index == FILLER_INDEX and row.length is None:
            findings.append(row.cells[3].error("length", f"{row.alias.shown} is a filler of PDOs, which needs a length"))
        elif row.index == FILLER_INDEX:
            fillers[row.alias.text] = Filler(row.alias.text, 8 * (row.length or 0))
    return fillers


def _objects(variables: Mapping[tuple[int, int], Variable]) -> Iterable[Object]:
    for index, group in groupby(sorted(variables.items()), key=lambda item: item[0][0]):
        members = [variable for _, variable in group]
        records = {variable.name.rpartition(":")[0] for variable in members}
        record = records.pop() if len(records) == 1 else ""
        yield Object.of(record or (members[0].name if len(members) == 1 else f"object_{index:04X}"), members)


def _constants(rows: Iterable[ConstantRow], names: _Aliases, findings: list[Finding]) -> dict[Mux, list[Constant]]:
    by_mux: dict[Mux, list[Constant]] = {}
    for row in rows:
        found = names.find(row.alias, findings)
        if isinstance(found, Filler):
            findings.append(row.alias.error("filler", f"{row.alias.shown} is a filler of PDOs; it has no constants"))
        elif found is not None:
            constants = by_mux.setdefault(found.mux, [])
            if any(each.name == row.name.text for each in constants):  # through another alias of the object
                findings.append(row.name.error("duplicate-alias", f"{found.label} has a constant {row.name.shown} already"))
            constants.append(Constant(row.name.text, row.mask, row.value))
    return by_mux


def _pdo(row: PdoRow, names: _Aliases, findings: list[Finding]) -> PdoDescription | None:
    before = len(findings)
    entries: list[Variable | Filler] = []
    bits = 0
    for cell in row.entries:
        entry = names.find(cell, findings)
        if entry is None:
            continue
        if entry.bit_length is None:
            findings.append(cell.error("pdo-entry", f"{cell.shown} has no fixed length: a PDO cannot carry it"))
            continue
        if bits <= MAX_PDO_BITS < bits + entry.bit_length:
            findings.append(cell.error("pdo-too-long", f"with {cell.shown} {row.alias.shown} has more than 8 bytes"))
        bits += entry.bit_length
        entries.append(entry)
    direction, number = row.place
    if direction is None:
        message = f"COB-ID 0x{row.cob_base:X} is not of the predefined connection set, so the alias must say rPDO or tPDO"
        findings.append(row.alias.error("pdo-direction", message))
    if direction is None or len(findings) > before:
        return None
    return PdoDescription(row.alias.text, row.cob_base, direction, number, tuple(entries))
