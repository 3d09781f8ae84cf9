"""The report of a configuration: the fate of each of its keys."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from canopen_master.ros_configurations.yaml_text import Value


class KeyOutcome(StrEnum):
    """The fate of a key."""

    TAKEN = "taken"
    """It is in the machine file, or in a file beside it."""
    NOT_NEEDED = "not needed"
    """Nothing is lost: it says how the predecessor works, or what happens here anyway."""
    LEFT_OUT = "left out"
    """It had an effect that is lost. The text says why, and what to do."""


class Told(NamedTuple):
    """One line of the report. source, line: where the key stands; line 0: it does not, and the predecessor's default counts."""

    outcome: KeyOutcome
    key: str
    text: str
    source: str
    line: int


@dataclass(slots=True)
class ImportReport:
    """Collects the lines; one that was told before, for another node with the same default, is not told again."""

    lines: dict[Told, None] = field(default_factory=dict)

    def taken(self, value: Value, text: str) -> None:
        """The key became this."""
        self._tell(KeyOutcome.TAKEN, value, text)

    def not_needed(self, value: Value, text: str) -> None:
        """The key needs no counterpart, for this reason."""
        self._tell(KeyOutcome.NOT_NEEDED, value, text)

    def left_out(self, value: Value, text: str) -> None:
        """The effect of the key is lost, for this reason."""
        self._tell(KeyOutcome.LEFT_OUT, value, text)

    def assumed(self, key: str, text: str) -> None:
        """A key that is missing has this effect."""
        self.lines[Told(KeyOutcome.TAKEN, key, text, "", 0)] = None

    def missing(self, key: str, text: str) -> None:
        """A key that is missing has this effect in the predecessor, which is lost."""
        self.lines[Told(KeyOutcome.LEFT_OUT, key, text, "", 0)] = None

    def _tell(self, outcome: KeyOutcome, value: Value, text: str) -> None:
        self.lines[Told(outcome, value.place, text, value.source, value.line)] = None


class YamlSection:
    """One map of a file while it is read. defaults: has the values of keys that it lacks."""

    def __init__(self, entries: Mapping[str, Value], report: ImportReport, defaults: YamlSection | None = None) -> None:
        self._entries = entries
        self._report = report
        self._defaults = defaults
        self._taken: set[str] = set()

    def take(self, key: str) -> Value | None:
        """Return the value of a key, or of the defaults; None if both lack it. The caller tells what becomes of it."""
        self._taken.add(key)
        if self._defaults is None:
            return self._entries.get(key)
        default = self._defaults.take(key)
        return self._entries.get(key, default)

    def take_both(self, key: str) -> tuple[Value | None, Value | None]:
        """Return the section's own value and that of the defaults."""
        self._taken.add(key)
        return self._entries.get(key), None if self._defaults is None else self._defaults.take(key)

    def into(self, table: dict[str, Any], key: str, made: Callable[[Value], Any], ours: str = "", where: str = "") -> None:
        """Put the value of a key, if it is there, into a table of the machine file, and tell so.

        made: our value of it. ours: our key; by default the same. where: the table, for people.
        """
        if (value := self.take(key)) is not None:
            ours = ours or key
            table[ours] = made(value)
            self._report.taken(value, f"{key_text(ours, table[ours])}{where}")

    def not_needed(self, reasons: Mapping[str, str]) -> None:
        """Tell of these keys, by name, why they need no counterpart."""
        for key, reason in reasons.items():
            if (value := self.take(key)) is not None:
                self._report.not_needed(value, reason)

    def left_out(self, reasons: Mapping[str, str]) -> None:
        """Tell of these keys, by name, why they are left out."""
        for key, reason in reasons.items():
            if (value := self.take(key)) is not None:
                self._report.left_out(value, reason)

    def close(self) -> None:
        """Tell of the keys that nobody took. The defaults are closed by their owner, behind all sections."""
        for key, value in self._entries.items():
            if key not in self._taken:
                self._report.left_out(value, "this key is not known")


def key_text(key: str, value: object) -> str:
    """Return a key of the machine file with its value, nearly as TOML has it: for people."""
    return f"{key} = {str(value).lower() if isinstance(value, bool) else repr(value)}".replace("'", '"')


def section_of(value: Value | None, report: ImportReport, defaults: YamlSection | None = None) -> YamlSection:
    """Return a section of a map; an empty one if there is none. Raises DictionaryError for another value."""
    if value is None or value.kind == "null":
        return YamlSection(_NOTHING, report, defaults)
    value.check("map")
    return YamlSection(value.entries, report, defaults)


_NOTHING: Final[Mapping[str, Value]] = MappingProxyType({})
