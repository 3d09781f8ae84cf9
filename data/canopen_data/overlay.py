"""Side files in TOML: units, factors, names of values and bits, and aliases, which no EDS has.

An EDS says that 0x6064 is an INTEGER32; only the manual says that it counts thousandths of a degree. A side file says it too, and
is laid over the dictionary of any file. Its one table, `objects`, has a table for each object by index, index and subindex, or
name:

    [objects.6064]
    aliases = ["position"]              # further names
    unit = "deg"                        # of the physical value, which is
    factor = 0.001                      #   factor * value
    description = "where the axis is"

    [objects."2001:02".values]          # names of values
    off = 0
    on = 1

    [objects.6041.bits]                 # names of bits, by their number ...
    moving = 8
    mode_ready = {mask = 0x3000, value = 0x1000}        # ... or of a value of several bits

Numbers of objects are hexadecimal without 0x, as everywhere; all other numbers are TOML's. A name replaces one that the object
has already.

A text that is not TOML gives one error, with its line and column. All other faults are found in one pass, each with its path
("objects.6041.bits.moving"). An object that the dictionary lacks is a warning: one side file may serve several devices.

Source: the format is ours. TOML v1.0.0.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final, TypeGuard

from canopen_data.findings import DictionaryError, Finding, Severity
from canopen_data.toml_file import parse_toml
from canopen_proto.datatypes import is_integer, is_number
from canopen_proto.dictionary.model import Constant, NotInDictionaryError, ObjectDictionary, Variable, did_you_mean
from canopen_proto.multiplexer import Mux

_FIELDS: Final = ("aliases", "unit", "factor", "description", "values", "bits")
_SHOWN: Final = 40


@dataclass
class _Reading:
    """The findings while a side file is read."""

    source: str
    findings: list[Finding] = field(default_factory=list)

    def error(self, path: str, message: str) -> None:
        self.findings.append(Finding(Severity.ERROR, "overlay", f"{path}: {message}", self.source))

    def warn(self, path: str, message: str) -> None:
        self.findings.append(Finding(Severity.WARNING, "overlay", f"{path}: {message}", self.source))


def lay_over(dictionary: ObjectDictionary, text: str, source: str = "overlay") -> tuple[ObjectDictionary, list[Finding]]:
    """Return the dictionary with the additions of a side file, and warnings. source: the name of the text in findings.

    Raises DictionaryError, which holds every error.
    """
    return lay_tables_over(dictionary, parse_toml(text, source), source)


def lay_tables_over(
    dictionary: ObjectDictionary, tables: Mapping[str, Any], source: str = "overlay"
) -> tuple[ObjectDictionary, list[Finding]]:
    """Do as `lay_over`, with tables that are parsed already. source: the name for findings."""
    reading = _Reading(source)
    for name in tables.keys() - {"objects"}:
        reading.error(_path(name), f"there is no such table{did_you_mean(name, ['objects'])}")
    variables: dict[Mux, Variable] = {}
    constants: dict[Mux, list[Constant]] = {}
    for key, table in _table(reading, "objects", tables.get("objects", {})).items():
        path = _path("objects", key)
        try:
            variable = dictionary.variable(key)
        except NotInDictionaryError as error:
            reading.warn(path, str(error))
            continue
        before = variables.get(variable.mux, variable)
        variables[variable.mux] = _changed(reading, path, before, _table(reading, path, table), dictionary)
        constants.setdefault(variable.mux, []).extend(_constants(reading, path, variable, table))
    if any(each.severity is Severity.ERROR for each in reading.findings):
        raise DictionaryError(each for each in reading.findings if each.severity is Severity.ERROR)
    by_index: dict[int, dict[int, Variable]] = {}
    for variable in variables.values():
        by_index.setdefault(variable.index, {})[variable.subindex] = variable
    objects = [
        replace(dictionary.objects[index], variables=MappingProxyType({**dictionary.objects[index].variables, **changed}))
        for index, changed in by_index.items()
        if index in dictionary.objects
    ]
    names = ObjectDictionary([], constants=constants)
    return dictionary.with_objects(objects).with_names_of(names), reading.findings


def _path(*keys: str) -> str:
    """Return a path as the file would have it, with long keys cut."""
    return ".".join(key[:_SHOWN] if re.fullmatch("[A-Za-z0-9_-]+", key) else repr(key[:_SHOWN]) for key in keys)


def _table(reading: _Reading, path: str, value: object) -> Mapping[str, Any]:
    if isinstance(value, dict):
        return value
    reading.error(path, f"a table is expected, not {_show(value)}")
    return {}


def _show(value: object) -> str:
    return repr(value)[:_SHOWN]


def _changed(
    reading: _Reading, path: str, variable: Variable, table: Mapping[str, Any], dictionary: ObjectDictionary
) -> Variable:
    """Return the variable with the additions of its table."""
    for key in table.keys() - set(_FIELDS):
        reading.error(f"{path}.{_path(key)}", f"there is no such entry{did_you_mean(key, _FIELDS)}")
    changes: dict[str, Any] = {}
    for key, check in _CHECKS.items():
        if key in table:
            complaint = check(table[key], variable)
            if complaint:
                reading.error(f"{path}.{key}", f"{complaint}, not {_show(table[key])}")
            else:
                changes[key] = table[key]
    if "factor" in changes:
        changes["factor"] = float(changes["factor"])
    if "aliases" in changes:
        _check_free(reading, f"{path}.aliases", changes["aliases"], variable, dictionary)
        changes["aliases"] = tuple(dict.fromkeys((*variable.aliases, *changes["aliases"])))
    return replace(variable, **changes)


def _check_free(reading: _Reading, path: str, names: list[str], variable: Variable, dictionary: ObjectDictionary) -> None:
    """Report each name that another object has already."""
    for name in names:
        if name in dictionary and (other := dictionary.variable(name)).mux != variable.mux:
            reading.error(path, f"{_show(name)} means {other.label} already")


def _check_aliases(value: object, variable: Variable) -> str:
    names = value if isinstance(value, list) else [None]
    return "" if all(isinstance(name, str) and name.strip() for name in names) else "a list of names is expected"


def _check_text(value: object, variable: Variable) -> str:
    return "" if isinstance(value, str) else "a text is expected"


def _check_factor(value: object, variable: Variable) -> str:
    if not is_number(variable.data_type):
        return f"a factor is for numbers ({variable.label} is {variable.data_type.name})"
    is_factor = isinstance(value, int | float) and not isinstance(value, bool) and _is_finite(value) and value != 0
    return "" if is_factor else "a number other than 0 is expected"


def _is_finite(value: int | float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer of hundreds of digits
        return False


_CHECKS: Final[dict[str, Callable[[object, Variable], str]]] = {
    "aliases": _check_aliases,
    "unit": _check_text,
    "factor": _check_factor,
    "description": _check_text,
}


def _constants(reading: _Reading, path: str, variable: Variable, table: object) -> list[Constant]:
    """Return the constants of `values` and `bits`."""
    if not isinstance(table, dict) or not table.keys() & {"values", "bits"}:
        return []
    bits = variable.bit_length
    if bits is None or not (is_integer(variable.data_type) or bits == 1):
        reading.error(path, f"names of values and bits are for integers, and {variable.label} is {variable.data_type.name}")
        return []
    whole = (1 << bits) - 1
    found = []
    for name, value in _table(reading, f"{path}.values", table.get("values", {})).items():
        if not _is_integer(value, -(whole // 2 + 1), whole):
            reading.error(f"{path}.values.{_path(name)}", f"a number of {bits} bits is expected, not {_show(value)}")
            continue
        found.append(Constant(name, whole, value & whole))
    for name, value in _table(reading, f"{path}.bits", table.get("bits", {})).items():
        constant = _bits(name, value, bits)
        if constant is None:
            expected = f"a bit number of 0..{bits - 1} or {{mask = ..., value = ...}} of {bits} bits is expected"
            reading.error(f"{path}.bits.{_path(name)}", f"{expected}, not {_show(value)}")
            continue
        found.append(constant)
    return found


def _bits(name: str, value: object, bits: int) -> Constant | None:
    if _is_integer(value, 0, bits - 1):
        return Constant(name, 1 << value, 1 << value)
    if isinstance(value, dict) and "mask" in value and value.keys() <= {"mask", "value"}:
        mask = value["mask"]
        if _is_integer(mask, 1, (1 << bits) - 1):
            pattern = value.get("value", mask)
            if _is_integer(pattern, 0, mask) and not pattern & ~mask:
                return Constant(name, mask, pattern)
    return None


def _is_integer(value: object, low: int, high: int) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high
