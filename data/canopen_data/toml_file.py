"""Our TOML files: parse them, and collect every error with its place. The standard library's `tomllib` parses; nothing is opened.

`tomllib` gives no lines for its values. `places_of` finds them in the text: by the headers and the keys that begin a line.
"""

from __future__ import annotations

import bisect
import math
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

from canopen_data.findings import DictionaryError, Finding, Severity
from canopen_proto.datatypes import real_of
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.machine import LocalProtocolError

MAX_TEXT: Final = 1 << 20
"""Characters of a file: enough for a thousand objects or joints with all their names. A larger file was chosen by mistake."""

Path: TypeAlias = tuple[str, ...]
"""The keys that lead to a value: ("joints", "elbow", "unit")."""

_PLACE: Final = re.compile(r".*\(at line ([0-9]+), column ([0-9]+)\)", re.DOTALL)
_KEY: Final = r"""(?:[A-Za-z0-9_-]+|"[^"\\]*"|'[^']*')"""
_KEYS: Final = rf"{_KEY}(?:[ \t]*\.[ \t]*{_KEY})*"
_HEADER: Final = re.compile(rf"[ \t]*\[[ \t]*({_KEYS})[ \t]*\][ \t]*(?:#.*)?")
_ARRAY: Final = re.compile(rf"[ \t]*\[\[[ \t]*({_KEYS})[ \t]*\]\][ \t]*(?:#.*)?")
_ENTRY: Final = re.compile(rf"[ \t]*({_KEYS})[ \t]*=")
_WORD: Final = re.compile(r"\w+")
_SHOWN: Final = 40


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Return the tables of a TOML text. Raises DictionaryError with line and column if it is not TOML. source: its name, for the
    error. Raises LocalProtocolError for what is no text."""
    if not isinstance(text, str):
        raise LocalProtocolError(f"{source}: the text of a file is expected, not {type(text).__name__}")
    if len(text) > MAX_TEXT:
        raise _failure(source, f"{len(text)} characters; a file of this kind has {MAX_TEXT} at most")
    try:
        return tomllib.loads(text, parse_float=real_of)
    except tomllib.TOMLDecodeError as error:
        place = _PLACE.fullmatch(str(error))
        line, column = (int(place[1]), int(place[2])) if place is not None else (text.count("\n") + 1, 1)
        raise _failure(source, str(error).partition(" (at ")[0], line, column) from None
    except (ValueError, RecursionError) as error:  # an odd number; arrays in arrays in arrays
        message = "arrays or tables are nested too deep" if isinstance(error, RecursionError) else str(error)
        raise _failure(source, message, _line_of_failure(text), 1) from None


def _line_of_failure(text: str) -> int:
    """Return the line at which a text fails in another way than by its syntax: then the lines before fail in no such way."""
    lines = text.split("\n")

    def fails(count: int) -> bool:
        try:
            tomllib.loads("\n".join(lines[:count]), parse_float=real_of)
        except tomllib.TOMLDecodeError:
            return False
        except (ValueError, RecursionError):
            return True
        return False

    return bisect.bisect_left(range(1, len(lines)), True, key=fails) + 1


def _failure(source: str, message: str, line: int = 0, column: int = 0) -> DictionaryError:
    return DictionaryError([Finding(Severity.ERROR, "toml", message, source, line, column)])


def places_of(text: str) -> dict[Path, tuple[int, int]]:
    """Return line and column of the tables and keys that begin a line, by their paths. The n-th [[table]] has n as its last key.

    A text with strings of several lines has no places: such a line may look like a key.
    """
    places: dict[Path, tuple[int, int]] = {}
    if '"""' in text or "'''" in text:
        return places
    table: Path = ()
    count: Counter[Path] = Counter()
    for number, line in enumerate(text.split("\n"), start=1):
        if (found := _ARRAY.fullmatch(line.rstrip("\r"))) is not None:
            name = _path(found[1])
            count[name] += 1
            path = table = (*name, str(count[name]))
        elif (found := _HEADER.fullmatch(line.rstrip("\r"))) is not None:
            path = table = _path(found[1])
        elif (found := _ENTRY.match(line)) is not None:
            path = (*table, *_path(found[1]))
        else:
            continue
        for length in range(1, len(path) + 1):  # `a.b = 1` is the place of a, too, if nothing else is
            places.setdefault(path[:length], (number, found.start(1) + 1))
    return places


def _path(keys: str) -> Path:
    return tuple(key.strip("\"'") for key in re.findall(_KEY, keys))


class ValueKind(NamedTuple):
    """The values that a key takes. expected: what fits, in words, for errors. fits: whether a value of TOML does. convert: makes
    our value of that; write: makes TOML's value of ours."""

    expected: str
    fits: Callable[[Any], bool]
    convert: Callable[[Any], Any] = lambda value: value
    write: Callable[[Any], Any] = lambda value: value


Keys: TypeAlias = Mapping[str, ValueKind]
"""The keys of a table, each with the values that it takes."""


def table_of(keys: Keys, entry: object, default: object, fields: Mapping[str, str] = MappingProxyType({})) -> dict[str, Any]:
    """Return the keys of an entry as a file has them, without those that have the value of `default`.

    fields: attributes of the entry whose name is not that of their key, by the key.
    """
    values = {key: (getattr(entry, fields.get(key, key)), getattr(default, fields.get(key, key))) for key in keys}
    return {key: keys[key].write(value) for key, (value, usual) in values.items() if value != usual}


@dataclass
class TomlReading:
    """Collects the errors of a file while it is read. code: of its findings. places: as of `places_of`."""

    source: str
    code: str
    places: Mapping[Path, tuple[int, int]] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)
    blamed: set[str] = field(default_factory=set)
    """The places that have errors."""

    def error(self, place: str, message: str, path: Path = ()) -> None:
        """Add an error. The line is that of the path, or of the innermost table on the way to it that has one. place: its name in
        the text. message: for people."""
        while path and path not in self.places:
            path = path[:-1]
        where = self.places.get(path, (0, 0))
        finding = Finding(Severity.ERROR, self.code, f"{place}: {message}", self.source, *where)
        self.blamed.add(place.partition(":")[0])
        if finding not in self.findings:  # a default is looked at for each entry
            self.findings.append(finding)

    def raise_errors(self) -> None:
        """Raise DictionaryError with all errors, in the order of their lines; do nothing if there is none."""
        if self.findings:
            raise DictionaryError(sorted(self.findings, key=lambda each: each.line))


class TomlTable:
    """One table of a file while it is read. place: its name in errors. keys: an error is added for each other key; None: any may
    be there. fallback: has values of keys that it lacks; or None. owner: in place of a name that the table lacks."""

    def __init__(
        self,
        reading: TomlReading,
        place: str,
        values: Mapping[str, Any],
        keys: Keys | None = None,
        path: Path = (),
        fallback: TomlTable | None = None,
        owner: str = "",
    ) -> None:
        self._reading = reading
        self._keys: Keys = {} if keys is None else keys
        self.fallback = fallback
        self.place = place
        self.values = values
        self.path = path
        for key in values if keys is not None else ():
            if key not in self._keys:
                message = f"there is no entry {key[:_SHOWN]!r}{did_you_mean(key, self._keys)}"
                reading.error(place or owner, message, (*path, key))

    def error(self, message: str, key: str = "") -> None:
        """Add an error about the table, or about one of its keys. message: for people."""
        place = ": ".join(filter(None, (self.place, key)))
        self._reading.error(place, message, (*self.path, key) if key else self.path)

    def error_naming(self, message: str) -> None:
        """Add an error about values of the table, at the line of the first one that it has of those that the message names; or at
        that in the fallback. message: for people."""
        named = _WORD.findall(message)
        table: TomlTable | None = self
        while table is not None:
            key = next((each for each in named if each in table.values), "")
            if key:
                self._reading.error(table.place, message, (*table.path, key))
                return
            table = table.fallback
        self.error(message)

    def has(self, key: str) -> bool:
        """Return whether the table, or its fallback, has a value for a key."""
        return key in self.values or (self.fallback is not None and self.fallback.has(key))

    def take(self, key: str, kind: ValueKind | None = None) -> Any:
        """Return the value of a key; None if it is missing, or if it does not fit, which adds an error. kind: in place of that of
        the table's keys."""
        kind = kind or self._keys[key]
        if key not in self.values:
            return None if self.fallback is None else self.fallback.take(key, kind)
        value = self.values[key]
        if kind.fits(value):
            return kind.convert(value)
        self.error(f"{kind.expected} is expected, not {repr(value)[:_SHOWN]}", key)
        return None

    def take_all(self, keys: Iterable[str]) -> dict[str, Any]:
        """Return the values of those keys that are there and fit; as `take`."""
        return {key: value for key in keys if (value := self.take(key)) is not None}

    def table(self, key: str, keys: Keys | None = None, fallback: TomlTable | None = None) -> TomlTable:
        """Return a table in this one; an empty one if there is none. keys, fallback: as of TomlTable."""
        place = f"{self.place}.{key}" if self.place else key
        return TomlTable(self._reading, place, self.take(key, TABLE) or {}, keys, (*self.path, key), fallback)


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and bool(value.strip())


def listed(value: Any) -> list[Any]:
    """Return a list as it is, and anything else as a list of it alone."""
    return value if isinstance(value, list) else [value]


def text(expected: str) -> ValueKind:
    """A text that is not blank. expected: what it is, for errors."""
    return ValueKind(expected, _is_text)


def texts(expected: str) -> ValueKind:
    """A text, or a list of them; always read as a tuple. expected: what it is, for errors."""
    return ValueKind(expected, lambda value: all(map(_is_text, listed(value))), lambda value: tuple(listed(value)), list)


def tables(expected: str) -> ValueKind:
    """A list of tables. expected: what it is, for errors."""
    return ValueKind(expected, lambda value: isinstance(value, list) and all(isinstance(each, dict) for each in value))


def one_of(choices: Iterable[str]) -> ValueKind:
    """One of these texts."""
    choices = tuple(choices)
    return ValueKind(" or ".join(map(repr, choices)), lambda value: isinstance(value, str) and value in choices)


def whole(expected: str, least: int, most: int) -> ValueKind:
    """A whole number of least..most. expected: what it is, for errors."""
    return ValueKind(f"{expected} of {least}..{most}", lambda value: type(value) is int and least <= value <= most)


def _is_number(value: Any) -> bool:
    if type(value) not in (int, float):
        return False
    try:
        return not math.isnan(value)
    except OverflowError:  # an integer of hundreds of digits
        return False


BOOLEAN: Final = ValueKind("true or false", lambda value: isinstance(value, bool))
TABLE: Final = ValueKind("a table", lambda value: isinstance(value, dict))
FALSE_OR_TABLE: Final = ValueKind("false, or a table", lambda value: value is False or isinstance(value, dict))
INTEGER: Final = ValueKind("a whole number", lambda value: type(value) is int)
NUMBER: Final = ValueKind("a number", _is_number, float)
"""Also `inf`, but not `nan`."""
