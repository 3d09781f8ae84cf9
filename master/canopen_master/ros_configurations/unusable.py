"""Values that cannot be used end nothing: each is told, and the rest is imported as if it were not there.

A value is left out with what would be wrong without it: a PDO as a whole, and a list in which places count.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final, NamedTuple

from canopen_master.ros_configurations.report import ImportReport
from canopen_master.ros_configurations.yaml_text import UnusableValueError, Value

MAX_UNUSABLE: Final = 100
"""In one configuration. With more of them it is another kind of file."""
_WHOLES: Final = re.compile(r"(?P<pdo>.*\.[tr]pdo\.\d+)\..*|(?P<list>.*\.(?:channels|channel_names))\[.*")


class Unusable(NamedTuple):
    """What is left out: part, which holds the value that the error is about, or is it."""

    error: UnusableValueError
    part: Value

    def tell(self, report: ImportReport) -> None:
        """Tell of the value, and of the part that goes with it."""
        value = self.error.value
        report.left_out(value, self.error.message)
        if self.part.place != value.place:
            what = "the PDO" if self.part.kind == "map" else "the list"
            report.left_out(self.part, f"{value.place} cannot be used, and without it {what} would be another one")


def unusable_part(top: Mapping[str, Value], error: UnusableValueError) -> Unusable:
    """Return what has to be left out with a value."""
    match = _WHOLES.fullmatch(error.value.place)
    place = error.value.place if match is None else match["pdo"] or match["list"]
    parts = (each for value in top.values() for each in _all(value) if each.place == place)
    return Unusable(error, next(parts, error.value))


def without(top: Mapping[str, Value], unusable: Iterable[Unusable]) -> dict[str, Value]:
    """Return the values of files without these parts."""
    places = {each.part.place for each in unusable}
    return {key: _rest(value, places) for key, value in top.items() if value.place not in places}


def _all(value: Value) -> Iterator[Value]:
    yield value
    for each in (*value.entries.values(), *value.items):
        yield from _all(each)


def _rest(value: Value, places: set[str]) -> Value:
    entries = {key: _rest(each, places) for key, each in value.entries.items() if each.place not in places}
    return replace(value, entries=entries, items=tuple(_rest(each, places) for each in value.items if each.place not in places))
