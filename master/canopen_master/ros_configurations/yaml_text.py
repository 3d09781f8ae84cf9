"""Read YAML as data only: maps, lists and scalars, each with its text, line and place. No object is ever made of a tag.

The scalars are those of YAML 1.1, as ROS reads them: `010` is 8, `1:30` is 90, `on` is true. Numbers keep their text, so that
nothing is rounded. Everything that could grow or mislead is refused with its line: a file over MAX_BYTES, more than MAX_VALUES
values once aliases are followed, more than MAX_DEPTH levels, a value that contains itself, a key twice, tags, dates.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Final

from canopen_data.findings import DictionaryError, Finding, Severity
from canopen_master.errors import PackageMissingError

MAX_BYTES: Final = 1 << 18
"""A machine of 127 nodes, each with 30 lines of its own, has a quarter of it."""
MAX_VALUES: Final = 30_000
MAX_DEPTH: Final = 50
MAX_DIGITS: Final = 400
"""Of one number; the largest float has 309."""
_SHOWN: Final = 60
_TAG: Final = "tag:yaml.org,2002:"


@dataclass(frozen=True, slots=True)
class Value:
    """One value of a file. kind: "map", "list", "str", "int", "float", "bool" or "null"; text: of a scalar.

    place: its keys, such as "nodes.arm.id". source, line: where it stands. A value with any other tag, such as a date, has
    that for its kind, and no text: no getter returns it.
    """

    kind: str
    text: str
    place: str
    source: str
    line: int
    entries: dict[str, Value] = field(default_factory=dict)
    items: tuple[Value, ...] = ()

    def __str__(self) -> str:
        shown = self.text if self.kind in (*_SCALARS, "null") else f"a {self.kind}"
        return shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}..."

    def failure(self, message: str) -> UnusableValueError:
        """Return an error about this value."""
        return UnusableValueError(self, message)

    def check(self, *kinds: str) -> None:
        """Raise DictionaryError if it is of none of these kinds."""
        if self.kind not in kinds:
            kind = f" ({self.kind})" if self.kind in _KINDS.values() else ""
            raise self.failure(f"a {' or '.join(kinds)} is expected, not {self}{kind}")

    def number(self) -> Fraction:
        """Return a number exactly; a text that is one counts. Raises DictionaryError for anything else."""
        found = number_of(self.text) if self.kind in ("int", "float", "str") else None
        if found is None:
            raise self.failure(f"a number is expected, not {self}")
        return found

    def integer(self, least: int, most: int) -> int:
        """Return a whole number of least..most. Raises DictionaryError for anything else."""
        number = self.number()
        if number.denominator != 1 or not least <= number <= most:
            raise self.failure(f"a whole number of {least}..{most} is expected, not {self}")
        return int(number)

    def truth(self) -> bool:
        """Return a boolean. Raises DictionaryError for anything else."""
        self.check("bool")
        return self.text.lower() in ("y", "yes", "true", "on")

    def string(self) -> str:
        """Return the text of a scalar, as it stands in the file. Raises DictionaryError for maps, lists and empty values."""
        if self.kind not in _SCALARS or not self.text.strip():
            raise self.failure(f"a text is expected, not {str(self) or 'nothing'}")
        return self.text


class UnusableValueError(DictionaryError):
    """A value that cannot be used. message: why, without the place."""

    def __init__(self, value: Value, message: str) -> None:
        text = f"{value.place or 'the file'}: {message}"
        super().__init__([Finding(Severity.ERROR, "yaml", text, value.source, value.line, 1 if value.line else 0)])
        self.value = value
        self.message = message


_SCALARS: Final = ("str", "int", "float", "bool")
_DECIMAL: Final = re.compile(r"[-+]?(\d[\d_]*\.?[\d_]*|\.\d[\d_]*)([eE][-+]?\d{1,3})?")
_OTHER_BASES: Final = ((re.compile("0[xX][0-9a-fA-F_]+"), 16), (re.compile("0[bB][01_]+"), 2), (re.compile("0[0-7_]+"), 8))
_SIXTIES: Final = re.compile(r"\d[\d_]*(:[0-5]?\d)+(\.\d*)?")


def number_of(text: str) -> Fraction | None:
    """Return a number of YAML 1.1 exactly; None for another text, for infinity, and for more than MAX_DIGITS digits."""
    text = text.strip()
    if len(text) > MAX_DIGITS:
        return None
    sign, digits = (-1, text[1:]) if text[:1] == "-" else (1, text.removeprefix("+"))
    for pattern, base in _OTHER_BASES:
        if pattern.fullmatch(digits):
            return Fraction(sign * int(digits.replace("_", "") if base == 8 else digits[2:].replace("_", ""), base))
    if _SIXTIES.fullmatch(digits):
        total = Fraction(0)
        for part in digits.replace("_", "").split(":"):
            total = total * 60 + Fraction(part)
        return sign * total
    return Fraction(text.replace("_", "")) if _DECIMAL.fullmatch(text) else None


def read_yaml(content: bytes, source: str) -> Value:
    """Return the map that a file is. Raises DictionaryError with the line; PackageMissingError without `ruamel.yaml`."""
    try:
        from ruamel.yaml import YAML
        from ruamel.yaml.error import MarkedYAMLError, YAMLError
    except ImportError as error:
        raise PackageMissingError("ruamel.yaml", "yaml", "reading YAML", error) from error
    if len(content) > MAX_BYTES:
        raise _failure(source, f"the file has {len(content)} bytes; more than {MAX_BYTES} are not read")
    yaml = YAML(typ="safe", pure=True)
    yaml.version = (1, 1)
    try:
        text = content.decode("utf-8-sig")
        _check_size(yaml.parse(text), source)
        document = yaml.compose(text)
    except UnicodeDecodeError as error:
        raise _failure(source, f"byte {error.start} is not UTF-8") from None
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise _failure(source, f"this is no YAML: {error.problem or error.context}", mark.line + 1 if mark else 0) from None
    except YAMLError as error:
        raise _failure(source, f"this is no YAML: {str(error).splitlines()[0]}") from None
    if document is None:
        raise _failure(source, "the file is empty")
    value = _YamlReader(source).value(document, "", 0)
    value.check("map")
    return value


def _check_size(events: Iterator[Any], source: str) -> None:
    """Raise DictionaryError if a text has too many values or levels: its tree, which is made recursively, is not made then."""
    depth = 0
    for count, event in enumerate(events):
        name = type(event).__name__
        depth += name.endswith("StartEvent") - name.endswith("EndEvent")
        if depth > MAX_DEPTH + _AROUND or count > 2 * MAX_VALUES:
            what = f"more than {MAX_VALUES} values" if depth <= MAX_DEPTH + _AROUND else f"more than {MAX_DEPTH} levels"
            raise _failure(source, f"the file has {what}", event.start_mark.line + 1)


_AROUND: Final = 2
"""Levels of events that are the stream and the document."""


class _YamlReader:
    """Makes our values of the nodes of a document. An alias is its value once more: both count."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._count = 0

    def value(self, node: Any, place: str, depth: int, line: int = 0) -> Value:
        """line: that of the key; an alias stands elsewhere than its value."""
        line = line or node.start_mark.line + 1
        self._count += 1
        if self._count > MAX_VALUES:
            raise _failure(self._source, f"{place}: with its aliases the file has more than {MAX_VALUES} values", line)
        if depth > MAX_DEPTH:
            raise _failure(
                self._source, f"{place[:_SHOWN]}: it is nested deeper than {MAX_DEPTH} levels, or contains itself", line
            )
        tag = str(node.tag or "")
        kind = _KINDS.get(tag.removeprefix(_TAG) if tag.startswith(_TAG) else "")
        if kind is None:
            return Value(f"value with the tag {tag!r}, which is not read", "", place, self._source, line)
        if kind == "map":
            return Value(kind, "", place, self._source, line, entries=dict(self._entries(node, place, depth)))
        if kind == "list":
            items = [self.value(each, f"{place}[{number}]", depth + 1) for number, each in enumerate(node.value)]
            return Value(kind, "", place, self._source, line, items=tuple(items))
        return Value(kind, str(node.value), place, self._source, line)

    def _entries(self, node: Any, place: str, depth: int) -> Iterator[tuple[str, Value]]:
        lines: dict[str, int] = {}
        merged: dict[str, Value] = {}
        for key, value in node.value:
            line = key.start_mark.line + 1
            if key.tag == f"{_TAG}merge":
                others = self.value(value, place, depth + 1, line)
                for each in others.items or (others,):
                    each.check("map")
                    merged = {**each.entries, **merged}  # the first one counts
                continue
            if not isinstance(key.value, str):
                raise _failure(self._source, f"{place or 'the file'}: a key is a map or a list", line)
            if key.value in lines:
                raise _failure(self._source, f"{place}.{key.value}: it stands in line {lines[key.value]} already", line)
            lines[key.value] = line
            yield key.value, self.value(value, f"{place}.{key.value}" if place else key.value, depth + 1, line)
        yield from ((key, value) for key, value in merged.items() if key not in lines)


_KINDS: Final = {"map": "map", "seq": "list", "str": "str", "int": "int", "float": "float", "bool": "bool", "null": "null"}


def _failure(source: str, message: str, line: int = 0) -> DictionaryError:
    return DictionaryError([Finding(Severity.ERROR, "yaml", message, source, line, 1 if line else 0)])
