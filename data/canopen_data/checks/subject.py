"""Shared by all checks: the description under examination, and the making of findings about it.

A family of checks is a module with a table of rules (`Rule`: code, severity, text) and functions that take a `Subject` and yield
findings. A finding has its rule's severity.

Values are checked as the device would hold them after start-up: a DCF's configured value, else the default. The node-ID is that
of the commissioning; without one, values that depend on it are known only up to it (`Number.adds_node_id`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, NamedTuple

from canopen_data.description import DeviceDescription, FileKind
from canopen_data.eds.ini import EdsDocument
from canopen_data.findings import Finding, Severity
from canopen_proto import indices
from canopen_proto.dictionary.model import Variable
from canopen_proto.frame import MAX_NODE_ID

ERROR: Final = Severity.ERROR
WARNING: Final = Severity.WARNING
NOTICE: Final = Severity.NOTICE


class Rule(NamedTuple):
    """One thing that may be wrong. code: its name for programs. text: its meaning, for people."""

    code: str
    severity: Severity
    text: str


class Number(NamedTuple):
    """The first value of an object, a whole number. adds_node_id: the unknown node-ID is to be added."""

    value: int
    adds_node_id: bool = False

    def __str__(self) -> str:
        return f"$NODEID+0x{self.value:X}" if self.adds_node_id else f"0x{self.value:X}"


class Subject:
    """A description under examination. node_id: 1..127 if commissioned, else None. shared: findings about a line that stands for
    many sub-objects (CompactSubObj), by code, line and column."""

    def __init__(self, description: DeviceDescription, rules: Iterable[Rule]) -> None:
        self.description = description
        self.dictionary = description.dictionary
        self.shared: set[tuple[str, int, int]] = set()
        self._rules: Mapping[str, Rule] = {rule.code: rule for rule in rules}
        node_id = description.node_id
        self.node_id = node_id if node_id is not None and 1 <= node_id <= MAX_NODE_ID else None

    @property
    def has_lists(self) -> bool:
        """Whether the file lists its objects: EDS and DCF do."""
        return self.description.kind in (FileKind.EDS, FileKind.DCF)

    @property
    def profile(self) -> int | None:
        """The device profile's number, from the low half of 0x1000; None if the file does not say."""
        device_type = self.number(indices.DEVICE_TYPE)
        return None if device_type is None else device_type.value & 0xFFFF

    def number(self, index: int, subindex: int = 0) -> Number | None:
        """Return the first value of an object. None: there is no such object, it holds no number, or the file gives none."""
        variable = self.dictionary.get(index, subindex)
        if variable is None:
            return None
        is_configured = variable.configured is not None
        value = variable.configured if is_configured else variable.default
        if not isinstance(value, int):
            return None
        adds = variable.configured_adds_node_id if is_configured else variable.adds_node_id
        return Number(value + self.node_id) if adds and self.node_id is not None else Number(value, adds)

    # ---- findings ----

    def of_object(self, code: str, index: int, text: str, field: str = "") -> Finding:
        """Return a finding about a whole object. field: the file's name of the faulty field. code: of the rule. text: for
        people."""
        known = self.dictionary.objects.get(index)
        name = known.name if known is not None else ""
        return self._finding(code, f"in {self._section(index)}{f' {name}' if name else ''}: {text}", index, None, field)

    def of_variable(self, code: str, variable: Variable, text: str, field: str = "") -> Finding:
        """Return a finding about a sub-object, or a VAR. code: of the rule. text: for people. field: the file's name of the
        faulty field."""
        index, subindex = variable.index, variable.subindex
        name = f" {variable.name}" if variable.name else ""
        return self._finding(code, f"in {self._section(index, subindex)}{name}: {text}", index, subindex, field)

    def of_value(self, code: str, variable: Variable, text: str) -> Finding:
        """Return a finding about the first value of a sub-object. code: of the rule. text: for people."""
        return self.of_variable(code, variable, text, "DefaultValue" if variable.configured is None else "ParameterValue")

    def of_entry(self, code: str, section: str, entry: str, text: str) -> Finding:
        """Return a finding about an entry of a section that is not an object: [DeviceInfo] and the like. code: of the rule. text:
        for people."""
        where = f"in [{section}]: " if self.has_lists else ""
        document = self.description.document
        found = document.section(section) if isinstance(document, EdsDocument) else None
        return self._at(code, f"{where}{text}", *((0, 0) if found is None else found.place_of(entry)))

    def _finding(self, code: str, message: str, index: int, subindex: int | None, field: str) -> Finding:
        line, column = self.description.place_of(index, subindex, field)
        if line and subindex is not None and self._is_made(index, subindex, line):
            self.shared.add((code, line, column))
        return self._at(code, message, line, column)

    def _is_made(self, index: int, subindex: int, line: int) -> bool:
        """Return whether this line is about all entries of a compact array, and not about one."""
        document = self.description.document
        if not isinstance(document, EdsDocument) or subindex in document.subs.get(index, {}):
            return False
        whole = document.objects.get(index)
        is_of_whole = whole is not None and line in range(whole.line, whole.line + len(whole.values) + 1)
        return is_of_whole and whole is not None and whole.get("CompactSubObj") is not None

    def _at(self, code: str, message: str, line: int, column: int) -> Finding:
        return Finding(self._rules[code].severity, code, message, self.description.source, line, column)

    def _section(self, index: int, subindex: int | None = None) -> str:
        """Return the file's own name of the place."""
        if not self.has_lists:
            return f"{index:04X}" if subindex is None else f"{index:04X}:{subindex:02X}"
        known = self.dictionary.objects.get(index)
        alone = subindex is None or (known is not None and list(known.variables) == [0])
        return f"[{index:04X}]" if alone else f"[{index:04X}sub{subindex:X}]"
